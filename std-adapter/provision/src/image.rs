//! The images that a board accepts as updates.

use std::fs;
use std::path::Path;

use bcap_board::identity::{self, Identity};
use bcap_board::vectors;

use crate::elf;
use crate::error::Error;
use crate::uf2;

/// Reads an image, which is an ELF file or a binary, and its target board.
///
/// # Errors
///
/// [`Error::Invalid`] if the file cannot be read, is damaged, or is not an image for updates.
pub fn read(path: &Path) -> Result<(Vec<u8>, Identity), Error> {
    let invalid = |reason: &str| Error::at(path, reason);
    let file = fs::read(path).map_err(|error| invalid(&error.to_string()))?;
    if uf2::is_uf2(&file) {
        return Err(invalid("a UF2 file is for the boot ROM: send the ELF file it was made from"));
    }
    let image = match elf::is_elf(&file) {
        true => {
            let flat = elf::flatten(&file).map(|(_, image)| image);
            flat.ok_or_else(|| invalid("the ELF file is damaged, or is not for a board with 32 bits"))?
        }
        false => file,
    };
    let identity = identity::find(&image).ok_or_else(|| {
        invalid("the image does not tell its board, so it was not built for updates (--features updates)")
    })?;
    if !vectors::is_table(&image) {
        return Err(invalid(
            "the image does not start with a vector table: send the ELF file, or a binary without a boot loader",
        ));
    }
    Ok((image, identity))
}
