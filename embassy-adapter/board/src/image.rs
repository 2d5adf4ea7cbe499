//! The block of settings in an image, for the host that writes it.

use core::fmt;
use core::ops::Range;

use crate::{BLOCK, MAGIC, SettingError, Settings};

/// Why settings cannot be read from an image, or written into it.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub enum ImageError<'a> {
    /// The image has no block.
    NoBlock,
    /// The letters of the block stand in the image more than once.
    ManyBlocks,
    /// A line of the settings is invalid.
    Invalid {
        /// The line.
        line: &'a [u8],
        /// What is wrong with it.
        error: SettingError,
    },
    /// The settings are longer than the block.
    TooLong {
        /// Their bytes.
        len: usize,
    },
}

impl fmt::Display for ImageError<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NoBlock => f.write_str("the image has no configuration block"),
            Self::ManyBlocks => f.write_str("the image has more than one configuration block"),
            Self::Invalid { line, error } => write!(f, "invalid setting \"{}\": {error}", line.escape_ascii()),
            Self::TooLong { len } => write!(f, "the settings take {len} bytes of {}", BLOCK - MAGIC.len()),
        }
    }
}

impl core::error::Error for ImageError<'_> {}

/// Views the settings in an image.
///
/// # Errors
///
/// An [`ImageError`] when there is not exactly one block.
pub fn text(image: &[u8]) -> Result<&[u8], ImageError<'static>> {
    let text = image.get(find(image)?).unwrap_or_default();
    Ok(text.split(|byte| *byte == 0).next().unwrap_or_default())
}

/// Writes settings into an image, in the place of those that were there.
///
/// # Errors
///
/// An [`ImageError`]; the image is then as it was.
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
/// assert_eq!(file[1000 + BLOCK], 0x55, "what stands behind the block is as it was");
/// # Ok::<(), image::ImageError<'_>>(())
/// ```
pub fn write<'a>(image: &mut [u8], settings: &'a [u8]) -> Result<(), ImageError<'a>> {
    let mut invalid = None;
    let _ = Settings::read(settings, |line, error| {
        invalid.get_or_insert(ImageError::Invalid { line, error });
    });
    if let Some(error) = invalid {
        return Err(error);
    }
    let place = find(image)?;
    match image.get_mut(place).unwrap_or_default().split_at_mut_checked(settings.len()) {
        Some((text, rest)) => {
            text.copy_from_slice(settings);
            rest.fill(0);
            Ok(())
        }
        None => Err(ImageError::TooLong { len: settings.len() }),
    }
}

/// Finds the text of the one block in an image.
fn find(image: &[u8]) -> Result<Range<usize>, ImageError<'static>> {
    let mut found = image.windows(MAGIC.len()).enumerate().filter(|(_, window)| window == MAGIC);
    let (start, _) = found.next().ok_or(ImageError::NoBlock)?;
    if found.next().is_some() {
        return Err(ImageError::ManyBlocks);
    }
    // an image that ends inside of its block is cut off
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
    fn settings_replace_the_ones_before_and_nothing_else() {
        let mut image = image();
        write(&mut image, b"provider=a long one\necho=7\n").unwrap();
        assert_eq!(text(&image).unwrap(), b"provider=a long one\necho=7\n");
        write(&mut image, b"echo=8\n").unwrap();
        assert_eq!(text(&image).unwrap(), b"echo=8\n");
        write(&mut image, b"").unwrap();
        assert_eq!(image, self::image());
    }

    #[test]
    fn a_block_can_be_full_and_no_more() {
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
    fn wrong_settings_and_wrong_images_are_told_apart() {
        let mut image = image();
        let error = write(&mut image, b"echo=7\nput=X\nrate=x\n").unwrap_err();
        let text =
            "invalid setting \"put=X\": unknown kind of variable: expected one of I F D S V P J T IO, at column 1";
        assert_eq!(error.to_string(), text);
        assert_eq!(image, self::image());
        assert_eq!(write(&mut [0x55; 4096], b""), Err(ImageError::NoBlock));
        assert_eq!(write(&mut image[..3000], b""), Err(ImageError::NoBlock), "cut off");
        image[100..108].copy_from_slice(MAGIC);
        assert_eq!(write(&mut image, b""), Err(ImageError::ManyBlocks));
    }

    use std::string::ToString;
}
