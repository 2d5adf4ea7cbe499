//! Reads and writes the settings block of an image, on a host.

use core::fmt;
use core::ops::Range;

use crate::{BLOCK, InvalidLine, MAGIC, Settings};

/// Why settings cannot be read from an image, or written into it.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub enum ImageError<'a> {
    /// The image has no block, or is cut off inside it.
    NoBlock,
    /// The image contains [`MAGIC`] more than once.
    ManyBlocks,
    /// A line of the settings is invalid.
    Invalid(InvalidLine<'a>),
    /// The settings are longer than the block.
    TooLong {
        /// Their length in bytes.
        len: usize,
    },
}

impl fmt::Display for ImageError<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NoBlock => f.write_str("the image has no configuration block"),
            Self::ManyBlocks => f.write_str("the image has more than one configuration block"),
            Self::Invalid(line) => line.fmt(f),
            Self::TooLong { len } => write!(f, "the settings take {len} bytes of {}", BLOCK - MAGIC.len()),
        }
    }
}

impl core::error::Error for ImageError<'_> {}

/// Returns the text of the settings in an image.
///
/// # Errors
///
/// An [`ImageError`] when there is not exactly one block.
pub fn text(image: &[u8]) -> Result<&[u8], ImageError<'static>> {
    let text = image.get(find(image)?).unwrap_or_default();
    Ok(text.split(|byte| *byte == 0).next().unwrap_or_default())
}

/// Replaces the settings in an image.
///
/// # Errors
///
/// An [`ImageError`]; the image is then unchanged.
///
/// # Examples
///
/// ```
/// use bcap_board::{BLOCK, MAGIC, image};
///
/// let mut file = vec![0x55; 4096];
/// file[1000..1008].copy_from_slice(MAGIC);
/// image::write(&mut file, b"robot=192.168.0.1:5007\n")?;
/// assert_eq!(image::text(&file)?, b"robot=192.168.0.1:5007\n");
/// assert_eq!(file[1000 + BLOCK], 0x55, "bytes after the block are unchanged");
/// # Ok::<(), image::ImageError<'_>>(())
/// ```
pub fn write<'a>(image: &mut [u8], settings: &'a [u8]) -> Result<(), ImageError<'a>> {
    Settings::check(settings).map_err(ImageError::Invalid)?;
    let range = find(image)?;
    match image.get_mut(range).unwrap_or_default().split_at_mut_checked(settings.len()) {
        Some((text, rest)) => {
            text.copy_from_slice(settings);
            rest.fill(0);
            Ok(())
        }
        None => Err(ImageError::TooLong { len: settings.len() }),
    }
}

/// Returns the range of the settings' text in an image.
fn find(image: &[u8]) -> Result<Range<usize>, ImageError<'static>> {
    let mut found = image.windows(MAGIC.len()).enumerate().filter(|(_, window)| window == MAGIC);
    let (start, _) = found.next().ok_or(ImageError::NoBlock)?;
    if found.next().is_some() {
        return Err(ImageError::ManyBlocks);
    }
    // an image that ends inside its block is cut off
    let block = start..start + BLOCK;
    image.get(block.clone()).map(|_| block.start + MAGIC.len()..block.end).ok_or(ImageError::NoBlock)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;
    use std::{format, vec};

    fn image() -> Vec<u8> {
        let mut image = vec![0x55; 5000];
        image[1234..1234 + MAGIC.len()].copy_from_slice(MAGIC);
        image[1234 + MAGIC.len()..1234 + BLOCK].fill(0);
        image
    }

    #[test]
    fn write_replaces_only_the_settings() {
        let mut image = image();
        write(&mut image, b"provider=a long one\necho=7\n").unwrap();
        assert_eq!(text(&image).unwrap(), b"provider=a long one\necho=7\n");
        write(&mut image, b"echo=8\n").unwrap();
        assert_eq!(text(&image).unwrap(), b"echo=8\n");
        write(&mut image, b"").unwrap();
        assert_eq!(image, self::image());
    }

    #[test]
    fn settings_longer_than_the_block_are_refused() {
        let mut image = image();
        let room = BLOCK - MAGIC.len();
        let fill = |len: usize| format!("provider={}", "x".repeat(len - 9));
        write(&mut image, fill(room).as_bytes()).unwrap();
        assert_eq!(text(&image).unwrap(), fill(room).as_bytes());
        assert_eq!(image[1234 + BLOCK], 0x55);
        let before = image.clone();
        assert_eq!(write(&mut image, fill(room + 1).as_bytes()), Err(ImageError::TooLong { len: room + 1 }));
        assert_eq!(image, before);
    }

    #[test]
    fn invalid_settings_and_invalid_images_have_distinct_errors() {
        let mut image = image();
        let error = write(&mut image, b"echo=7\nput=X\nrate=x\n").unwrap_err();
        let text =
            "invalid setting \"put=X\": unknown kind of variable: expected one of I F D S V P J T IO, at column 5";
        assert_eq!(error.to_string(), text);
        assert_eq!(image, self::image());
        assert_eq!(write(&mut [0x55; 4096], b""), Err(ImageError::NoBlock));
        assert_eq!(write(&mut image[..3000], b""), Err(ImageError::NoBlock), "cut off");
        image[100..108].copy_from_slice(MAGIC);
        assert_eq!(write(&mut image, b""), Err(ImageError::ManyBlocks));
    }

    use std::string::ToString;
}
