//! Reads the file of an image.

use std::fs;

use bcap_board::identity::{self, Identity};
use bcap_board::vectors;

use super::elf;
use crate::failure::Failure;

/// The first bytes of a UF2 file.
const UF2: &[u8] = b"UF2\n";

/// Reads an image and the board that it is for.
pub(super) fn read(path: &str) -> Result<(Vec<u8>, Identity), Failure> {
    let invalid = |reason: &str| Failure::Input(format!("{path}: {reason}"));
    let file = fs::read(path).map_err(|error| invalid(&error.to_string()))?;
    if file.starts_with(UF2) {
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
