//! The name of the board that an image is for, and the image's version, for hosts and for the board.
//!
//! ```text
//!  "BCAPNAME"  board, 32 bytes  version, 20 bytes  CRC-32 of these 60 bytes (little-endian)
//! ```
//!
//! The block is stored unencoded in ELF and binary images, so a host can find it with [`find`]. The CRC distinguishes it from
//! the same eight letters elsewhere in the image.

use core::str;

use crate::crc::Crc32;

/// The bytes of a block in which an image is sent to a board, except for its last one.
pub const BLOCK: usize = 128;

const MAGIC: &[u8; 8] = b"BCAPNAME";
/// The maximum size of the board's name in bytes, and of the version.
pub const NAME: usize = 32;
/// The maximum size of the version in bytes.
pub const VERSION: usize = 20;
const TEXTS: usize = MAGIC.len() + NAME + VERSION;
/// The size of the block in bytes.
pub const SIZE: usize = TEXTS + 4;

/// The board that an image is for, and its version.
///
/// # Examples
///
/// ```
/// use bcap_board::identity::{Identity, find};
///
/// static IDENTITY: Identity = Identity::new("w5500-evb-pico", "0.1.0");
/// let image = [&b"BCAPNAME other bytes "[..], IDENTITY.as_bytes(), b" more"].concat();
/// assert_eq!(find(&image).unwrap().board(), "w5500-evb-pico");
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Identity([u8; SIZE]);

impl Identity {
    /// Creates the block of an image.
    ///
    /// # Panics
    ///
    /// While the image is compiled, when the name has more than 32 bytes, the version has more than 20, or one of them has a
    /// space.
    #[must_use]
    pub const fn new(board: &str, version: &str) -> Self {
        assert!(board.len() <= NAME && version.len() <= VERSION, "the name or the version is too long");
        let mut block = [0; SIZE];
        copy(&mut block, 0, MAGIC);
        copy(&mut block, MAGIC.len(), board.as_bytes());
        copy(&mut block, MAGIC.len() + NAME, version.as_bytes());
        let crc = Crc32::new().and(block.split_at(TEXTS).0).value().to_le_bytes();
        copy(&mut block, TEXTS, &crc);
        Self(block)
    }

    /// Returns the name of the board.
    #[must_use]
    pub fn board(&self) -> &str {
        text(self.0.get(MAGIC.len()..MAGIC.len() + NAME))
    }

    /// Returns the version of the image.
    #[must_use]
    pub fn version(&self) -> &str {
        text(self.0.get(MAGIC.len() + NAME..TEXTS))
    }

    /// Returns the block as it is in the image.
    #[must_use]
    pub const fn as_bytes(&self) -> &[u8; SIZE] {
        &self.0
    }
}

/// Finds the block of an image; `None` if it has no block or several different ones.
#[must_use]
pub fn find(image: &[u8]) -> Option<Identity> {
    let mut blocks = image.windows(SIZE).filter(|window| window.starts_with(MAGIC)).filter_map(|window| {
        let block = *window.first_chunk::<SIZE>()?;
        let (texts, crc) = block.split_last_chunk::<4>()?;
        (Crc32::new().and(texts).value() == u32::from_le_bytes(*crc)).then_some(Identity(block))
    });
    let first = blocks.next()?;
    blocks.all(|other| other == first).then_some(first)
}

/// Copies bytes to an offset of the block, and refuses spaces, which end a word of the console's protocol.
const fn copy(block: &mut [u8; SIZE], offset: usize, bytes: &[u8]) {
    let mut at = 0;
    while at < bytes.len() {
        assert!(offset == TEXTS || bytes[at] != b' ', "the name or the version has a space");
        block[offset + at] = bytes[at];
        at += 1;
    }
}

fn text(field: Option<&[u8]>) -> &str {
    let bytes = field.and_then(|field| field.split(|byte| *byte == 0).next()).unwrap_or_default();
    str::from_utf8(bytes).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    const PICO: Identity = Identity::new("w5500-evb-pico", "0.1.0");

    #[test]
    fn a_block_is_found_at_any_offset() {
        for before in 0..9 {
            let image = [&b"xBCAPNAM"[..before], PICO.as_bytes(), b"BCAPNAME"].concat();
            let found = find(&image).unwrap();
            assert_eq!((found.board(), found.version()), ("w5500-evb-pico", "0.1.0"));
        }
        let longest = Identity::new(&"b".repeat(NAME), &"1".repeat(VERSION));
        assert_eq!((longest.board().len(), longest.version().len()), (NAME, VERSION));
    }

    #[test]
    fn a_damaged_block_and_two_different_ones_are_not_found() {
        for at in 0..SIZE {
            let mut image = *PICO.as_bytes();
            image[at] ^= 4;
            assert_eq!(find(&image), None, "byte {at}");
        }
        let other = Identity::new("w5500-evb-pico2", "0.1.0");
        assert_eq!(find(&[*PICO.as_bytes(), *other.as_bytes()].concat()), None);
        assert_eq!(find(&[*PICO.as_bytes(), *PICO.as_bytes()].concat()), Some(PICO));
        assert_eq!(find(&PICO.as_bytes()[..SIZE - 1]), None);
    }
}
