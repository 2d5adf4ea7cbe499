//! BSTR: text in UTF-16LE, in its encoding on the wire.
//!
//! ```text
//!  u32 length in bytes | length bytes of UTF-16LE, no terminator
//! ```
//!
//! A [`Bstr`] borrows the bytes that the peer sent. NULs are characters. An unpaired surrogate is kept, compared and sent
//! unchanged; only the conversions to `char` and `str` treat it as an error.

use core::fmt;

/// A borrowed string of the wire.
#[derive(Clone, Copy, Default)]
pub struct Bstr<'a> {
    /// An even number of bytes.
    bytes: &'a [u8],
}

impl<'a> Bstr<'a> {
    /// Views UTF-16LE bytes; `None` if their number is odd.
    #[must_use]
    pub const fn from_utf16le(bytes: &'a [u8]) -> Option<Self> {
        if bytes.len().is_multiple_of(2) { Some(Self { bytes }) } else { None }
    }

    /// Views UTF-16LE bytes, without a last odd one.
    pub(crate) fn truncated(bytes: &'a [u8]) -> Self {
        Self { bytes: bytes.get(..bytes.len() & !1).unwrap_or_default() }
    }

    /// Returns the UTF-16LE bytes.
    #[must_use]
    pub const fn as_bytes(self) -> &'a [u8] {
        self.bytes
    }

    /// Returns the number of 16-bit units.
    #[must_use]
    pub const fn len(self) -> usize {
        self.bytes.len() >> 1
    }

    /// Returns whether the text is empty.
    #[must_use]
    pub const fn is_empty(self) -> bool {
        self.bytes.is_empty()
    }

    /// Iterates over the 16-bit units.
    pub fn units(self) -> impl ExactSizeIterator<Item = u16> + Clone + use<'a> {
        self.bytes.as_chunks::<2>().0.iter().map(|unit| u16::from_le_bytes(*unit))
    }

    /// Iterates over the characters; an unpaired surrogate is `Err` with its unit.
    pub fn chars(self) -> impl Iterator<Item = Result<char, u16>> + Clone + use<'a> {
        char::decode_utf16(self.units()).map(|c| c.map_err(|e| e.unpaired_surrogate()))
    }

    /// Returns whether the text is valid Unicode: every surrogate is paired.
    #[must_use]
    pub fn is_unicode(self) -> bool {
        self.chars().all(|c| c.is_ok())
    }

    /// Copies the text as UTF-8 to the front of `buffer` and returns it.
    ///
    /// `None` if it does not fit or is not valid Unicode.
    #[must_use]
    pub fn to_str(self, buffer: &mut [u8]) -> Option<&str> {
        let mut len = 0_usize;
        for c in self.chars() {
            let rest = buffer.get_mut(len..)?;
            len = len.wrapping_add(put_utf8(c.ok()?, rest)?);
        }
        core::str::from_utf8(buffer.get(..len)?).ok()
    }

    /// Compares with `other`, ignoring ASCII case, as controllers compare names.
    #[must_use]
    pub fn eq_ignore_ascii_case(self, other: &str) -> bool {
        let mut theirs = other.encode_utf16();
        let equal = self.units().all(|unit| theirs.next().is_some_and(|u| fold(u) == fold(unit)));
        equal && theirs.next().is_none()
    }
}

/// Converts an ASCII letter to lower case.
fn fold(unit: u16) -> u16 {
    if (0x41..=0x5a).contains(&unit) { unit | 0x20 } else { unit }
}

/// Writes one character as UTF-8, `char::encode_utf8` without its panic on a short buffer.
pub(crate) fn put_utf8(c: char, buffer: &mut [u8]) -> Option<usize> {
    let code = u32::from(c);
    let byte = |shift: u32, mask: u32, tag: u32| u8::try_from(((code >> shift) & mask) | tag).unwrap_or(0);
    match code {
        0..0x80 => *buffer.first_chunk_mut()? = [byte(0, 0x7f, 0)],
        0x80..0x800 => *buffer.first_chunk_mut()? = [byte(6, 0x1f, 0xc0), byte(0, 0x3f, 0x80)],
        0x800..0x1_0000 => {
            *buffer.first_chunk_mut()? = [byte(12, 0x0f, 0xe0), byte(6, 0x3f, 0x80), byte(0, 0x3f, 0x80)];
        }
        _ => {
            *buffer.first_chunk_mut()? =
                [byte(18, 0x07, 0xf0), byte(12, 0x3f, 0x80), byte(6, 0x3f, 0x80), byte(0, 0x3f, 0x80)];
        }
    }
    Some(c.len_utf8())
}

impl PartialEq for Bstr<'_> {
    fn eq(&self, other: &Self) -> bool {
        self.bytes == other.bytes
    }
}

impl Eq for Bstr<'_> {}

impl PartialEq<str> for Bstr<'_> {
    fn eq(&self, other: &str) -> bool {
        self.units().eq(other.encode_utf16())
    }
}

impl PartialEq<&str> for Bstr<'_> {
    fn eq(&self, other: &&str) -> bool {
        *self == **other
    }
}

/// Writes the text; an unpaired surrogate becomes U+FFFD.
impl fmt::Display for Bstr<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        use fmt::Write as _;
        self.chars().try_for_each(|c| f.write_char(c.unwrap_or(char::REPLACEMENT_CHARACTER)))
    }
}

/// Writes the text as a quoted and escaped literal.
impl fmt::Debug for Bstr<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        use fmt::Write as _;
        f.write_char('"')?;
        for c in self.chars() {
            match c {
                Ok('\'') => f.write_char('\'')?,
                Ok(c) => write!(f, "{}", c.escape_debug())?,
                Err(unit) => write!(f, "\\u{{{unit:x}}}")?,
            }
        }
        f.write_char('"')
    }
}

#[cfg(feature = "defmt")]
impl defmt::Format for Bstr<'_> {
    fn format(&self, f: defmt::Formatter<'_>) {
        for c in self.chars() {
            defmt::write!(f, "{}", c.unwrap_or(char::REPLACEMENT_CHARACTER));
        }
    }
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use std::vec::Vec;
    use std::{format, string::ToString};

    fn utf16(text: &str) -> Vec<u8> {
        text.encode_utf16().flat_map(u16::to_le_bytes).collect()
    }

    #[test]
    fn text_of_every_utf8_length_comes_out_whole() {
        let text = "aé€😀\0z";
        let bytes = utf16(text);
        let bstr = Bstr::from_utf16le(&bytes).unwrap();
        assert_eq!(bstr, text);
        assert!(bstr.is_unicode());
        assert!(bstr == text && bstr == *text && bstr != "aé€😀\0" && bstr != *"aé€😀\0z.");
        assert_eq!(bstr.to_string(), text);
        assert_eq!((bstr.len(), bstr.is_empty()), (7, false));
        assert!(Bstr::from_utf16le(&[]).unwrap().is_empty());
        let mut buffer = [0; 12];
        assert_eq!(bstr.to_str(&mut buffer), Some(text));
        assert_eq!(bstr.to_str(&mut [0; 11]), None);
    }

    #[test]
    fn utf8_writer_agrees_with_the_standard_library() {
        for code in (0..=0x10_ffff_u32).step_by(7) {
            let Some(c) = char::from_u32(code) else { continue };
            let (mut ours, mut theirs) = ([0; 4], [0; 4]);
            assert_eq!(put_utf8(c, &mut ours), Some(c.encode_utf8(&mut theirs).len()));
            assert_eq!(ours, theirs);
        }
    }

    #[test]
    fn a_lone_surrogate_is_kept_and_shown() {
        let bytes = [0x41, 0, 0x00, 0xd8, 0x42, 0];
        let bstr = Bstr::from_utf16le(&bytes).unwrap();
        assert!(!bstr.is_unicode());
        assert!(!bstr.is_unicode());
        assert_eq!(bstr.to_string(), "A\u{fffd}B");
        assert_eq!(format!("{bstr:?}"), "\"A\\u{d800}B\"");
        assert_eq!(bstr.to_str(&mut [0; 16]), None);
        assert_eq!(bstr.as_bytes(), bytes);
    }

    #[test]
    fn odd_bytes_are_no_bstr() {
        assert!(Bstr::from_utf16le(&[0x41]).is_none());
        assert_eq!(Bstr::truncated(&[0x41, 0, 0x42]), "A");
    }

    #[test]
    fn names_compare_without_case() {
        let bytes = utf16("TakeArm");
        let bstr = Bstr::from_utf16le(&bytes).unwrap();
        assert!(bstr.eq_ignore_ascii_case("Takearm"));
        assert!(!bstr.eq_ignore_ascii_case("Takear"));
        assert!(!bstr.eq_ignore_ascii_case("TakeArms"));
        assert!(!bstr.eq_ignore_ascii_case("Take`rm"));
    }
}
