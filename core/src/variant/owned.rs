//! Owned values of any size: the encoding of a value in a `Vec`.

use alloc::vec;
use alloc::vec::Vec;
use core::fmt;

use super::encode::Element;
use super::text::{complete, value as text_value};
use super::{ConvertError, Encode, FromVariant, Nested, Opaque, VarType, Variant, VariantBufError, check, is_opaque};
use crate::error::{EncodeError, TextError, TextErrorKind};
use crate::limits::{Limits, MAX_DEPTH, Strictness};
use crate::wire::{Reader, Writer};

/// The size up to which a buffer grows, in bytes. Frames of 16 MiB are the largest that peers accept.
const MAX: usize = 32 * 1024 * 1024;

/// The size of values that are encoded on the stack first, in bytes.
const SMALL: usize = 64;

/// A value of any size that owns its bytes. Needs the feature `alloc`.
///
/// It contains the canonical, validated encoding, and [`as_variant`](Self::as_variant) views it. A value of up to
/// 64 bytes, and one made of a [`Variant`], takes one allocation; EMPTY takes none.
///
/// With the feature `serde` it is serialised together with its VARTYPE: `{"I4":7}`, `{"BSTR":"P1"}`,
/// `{"ARRAY":{"R4":[1.5,2.0]}}`, `"EMPTY"`. So deserialisation returns the same value. CY is the count of ten-thousandths, DATE
/// the days since 1899-12-30, and ERROR the signed number. A value of unknown VARTYPE and a string with an unpaired surrogate
/// cannot be serialised. JSON has no NaN and no infinity: `serde_json` writes them as `null`, which is then refused.
///
/// # Examples
///
/// ```
/// use bcap_core::variant::OwnedVariant;
///
/// let value = OwnedVariant::new(&["P1", "P2"])?;
/// assert_eq!(value.convert::<Vec<String>>()?, ["P1", "P2"]);
/// assert_eq!(format!("{value:?}"), r#"BSTR["P1", "P2"]"#);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Default)]
pub struct OwnedVariant {
    /// One canonical value, or the type and the bytes of one of unknown VARTYPE; empty stands for EMPTY.
    bytes: Vec<u8>,
}

impl OwnedVariant {
    /// The value EMPTY.
    pub const EMPTY: Self = Self { bytes: Vec::new() };

    /// Encodes `value`.
    ///
    /// # Errors
    ///
    /// [`EncodeError::Full`] when its encoding is over 32 MiB; other [`EncodeError`]s as `value` returns them.
    pub fn new<T: Encode + ?Sized>(value: &T) -> Result<Self, EncodeError> {
        Self::build(SMALL, |error| *error == EncodeError::Full, |out| value.encode(out))
    }

    /// Validates `bytes` as exactly one value and keeps a canonical copy.
    ///
    /// # Errors
    ///
    /// The [`DecodeError`](crate::error::DecodeError) of the bytes.
    pub fn decode(bytes: &[u8], limits: &Limits, strictness: Strictness) -> Result<Self, VariantBufError> {
        let value = Variant::decode(bytes, limits, strictness).map_err(VariantBufError::Decode)?;
        Self::copy(&value).map_err(VariantBufError::Encode)
    }

    /// Parses the text of one value, such as `8196,1,2.5,-3`.
    ///
    /// # Errors
    ///
    /// A [`TextError`] with the column.
    ///
    /// # Examples
    ///
    /// ```
    /// use bcap_core::variant::OwnedVariant;
    ///
    /// assert_eq!(OwnedVariant::parse_text(b"8196,1,2.5,-3")?.convert::<[f64; 3]>()?, [1.0, 2.5, -3.0]);
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn parse_text(text: &[u8]) -> Result<Self, TextError> {
        // most values of text take fewer bytes than this
        let size = text.len().saturating_mul(4).saturating_add(16);
        Self::build(
            size,
            |error: &TextError| error.kind == TextErrorKind::Full,
            |out| complete(text, |text| text_value(text, out)),
        )
    }

    /// Copies a validated value with one allocation.
    fn copy(value: &Variant<'_>) -> Result<Self, EncodeError> {
        let data = match value {
            Variant::Empty => return Ok(Self::EMPTY),
            Variant::Bstr(text) => text.as_bytes(),
            Variant::Array(array) => array.as_bytes(),
            Variant::Nested(Nested(inner)) => inner,
            Variant::Opaque(Opaque { vartype, bytes }) => {
                return Ok(Self { bytes: [vartype.0.to_le_bytes().as_slice(), bytes].concat() });
            }
            _ => &[],
        };
        // the head, and a number or the length of a string; the canonical data are not longer than these
        let size = data.len().saturating_add(14);
        Self::build(size, |error| *error == EncodeError::Full, |out| value.encode(out))
    }

    /// Fills a buffer with the output of `write`, which must be one value. The buffer grows while `write` is out of space.
    fn build<E: From<EncodeError>>(
        size: usize,
        is_full: impl Fn(&E) -> bool,
        mut write: impl FnMut(&mut Writer<'_>) -> Result<(), E>,
    ) -> Result<Self, E> {
        // most values are small: they take one allocation, of their length
        let mut small = [0; SMALL];
        let mut large = Vec::new();
        let mut size = size;
        loop {
            let is_small = size <= SMALL;
            if !is_small {
                large = vec![0; size];
            }
            let mut out = Writer::new(if is_small { &mut small } else { &mut large });
            match write(&mut out) {
                Err(error) if is_full(&error) && size < MAX => size = size.max(SMALL).saturating_mul(4).min(MAX),
                Err(error) => return Err(error),
                Ok(()) => {
                    let len = out.len();
                    let bytes = match small.get(..len) {
                        Some(bytes) if is_small => bytes.to_vec(),
                        _ => {
                            large.truncate(len);
                            large.shrink_to_fit();
                            large
                        }
                    };
                    // a tree that is deeper than any decoder accepts is not a validated value
                    let deepest = Limits { depth: MAX_DEPTH, ..Limits::STREAM };
                    return match check(&mut Reader::new(&bytes), &deepest, Strictness::Lenient) {
                        Ok(()) => Ok(Self { bytes }),
                        Err(_) => Err(EncodeError::TooDeep.into()),
                    };
                }
            }
        }
    }

    /// Views the value.
    #[must_use]
    pub fn as_variant(&self) -> Variant<'_> {
        match self.bytes.split_first_chunk() {
            Some((vartype, bytes)) if is_opaque(&self.bytes) => {
                Variant::Opaque(Opaque { vartype: VarType(u16::from_le_bytes(*vartype)), bytes })
            }
            _ => Variant::from_checked(&self.bytes),
        }
    }

    /// Returns the value's encoding. A value of unknown VARTYPE cannot be decoded.
    #[must_use]
    pub fn as_bytes(&self) -> &[u8] {
        if self.bytes.is_empty() { &[0, 0, 1, 0, 0, 0] } else { &self.bytes }
    }

    /// Converts the value to a Rust type, see [`FromVariant`].
    ///
    /// # Errors
    ///
    /// A [`ConvertError`] when the value has another type or number of elements, or the type cannot hold it.
    pub fn convert<'a, T: FromVariant<'a>>(&'a self) -> Result<T, ConvertError> {
        self.as_variant().convert()
    }
}

/// Copies the value, also one of unknown VARTYPE.
impl From<Variant<'_>> for OwnedVariant {
    fn from(value: Variant<'_>) -> Self {
        // a validated value always encodes, and the buffer of `copy` is large enough
        Self::copy(&value).unwrap_or_default()
    }
}

impl<'a> FromVariant<'a> for OwnedVariant {
    fn from_variant(value: Variant<'a>) -> Result<Self, ConvertError> {
        Ok(value.into())
    }
}

impl Encode for OwnedVariant {
    fn encode(&self, out: &mut Writer<'_>) -> Result<(), EncodeError> {
        match self.as_variant() {
            Variant::Opaque(opaque) => Err(EncodeError::Unsendable(opaque.vartype.0)),
            _ => out.put_slice(self.as_bytes()),
        }
    }
}

/// An element of an array of VARIANT.
impl Element for OwnedVariant {
    const TYPE: VarType = VarType::VARIANT;

    fn put(&self, out: &mut Writer<'_>) -> Result<(), EncodeError> {
        self.encode(out)
    }
}

impl PartialEq for OwnedVariant {
    fn eq(&self, other: &Self) -> bool {
        self.as_variant() == other.as_variant()
    }
}

impl Eq for OwnedVariant {}

impl PartialEq<Variant<'_>> for OwnedVariant {
    fn eq(&self, other: &Variant<'_>) -> bool {
        self.as_variant() == *other
    }
}

impl fmt::Debug for OwnedVariant {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.as_variant().fmt(f)
    }
}

#[cfg(feature = "defmt")]
impl defmt::Format for OwnedVariant {
    fn format(&self, f: defmt::Formatter<'_>) {
        self.as_variant().format(f);
    }
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use crate::variant::{Bstr, Null, VariantBuf};
    use std::format;
    use std::string::{String, ToString};

    fn owned(value: impl Encode) -> OwnedVariant {
        OwnedVariant::new(&value).unwrap()
    }

    #[test]
    fn values_of_every_size_are_kept() {
        for len in [0, 1, 27, 28, 200, 100_000] {
            let text = "x".repeat(len);
            let value = owned(text.as_str());
            assert_eq!(value.convert::<String>().unwrap(), text);
            assert_eq!((value.bytes.len(), value.bytes.capacity()), (10 + 2 * len, 10 + 2 * len));
            assert_eq!(OwnedVariant::from(value.as_variant()), value);
        }
    }

    #[test]
    fn it_is_the_encoding_of_the_value() {
        let value = (1, ["a", "b"], [1.5_f64], (), true);
        let expected = VariantBuf::<128>::new(&value).unwrap();
        assert_eq!(owned(value).as_bytes(), expected.as_bytes());
        let copy = OwnedVariant::from(expected.as_variant());
        assert_eq!(copy.as_bytes(), expected.as_bytes());
        assert_eq!(copy, expected.as_variant());
        assert_eq!(format!("{copy:?}"), format!("{expected:?}"));
        assert_eq!(owned(&copy), copy);
        assert_ne!(copy, owned(1));
    }

    #[test]
    fn empty_takes_no_memory() {
        let empty = OwnedVariant::from(Variant::Empty);
        assert_eq!((empty.bytes.capacity(), empty.as_bytes()), (0, &[0, 0, 1, 0, 0, 0][..]));
        assert_eq!(empty, OwnedVariant::default());
        assert_eq!(empty, owned(()));
        assert_ne!(empty, owned(Null));
        assert_eq!(empty.convert::<Option<i32>>(), Ok(None));
    }

    #[test]
    fn a_copy_is_canonical() {
        let lenient = [11, 0x20, 2, 0, 0, 0, 1, 0, 0, 0];
        let value = OwnedVariant::decode(&lenient, &Limits::STREAM, Strictness::Lenient).unwrap();
        assert_eq!(value.as_bytes(), [11, 0x20, 2, 0, 0, 0, 0xff, 0xff, 0, 0]);
        let error = OwnedVariant::decode(&lenient[..9], &Limits::STREAM, Strictness::Lenient).unwrap_err();
        assert_eq!(error.to_string(), "array count 2 is above what the remaining bytes can hold at byte 2");
    }

    #[test]
    fn an_unknown_type_is_kept_and_not_sent() {
        let opaque = Variant::Opaque(Opaque { vartype: VarType(16), bytes: &[1, 0, 0, 0, 127] });
        let value = OwnedVariant::from(opaque);
        assert_eq!(value, opaque);
        assert_eq!(OwnedVariant::new(&value), Err(EncodeError::Unsendable(16)));
    }

    #[test]
    fn text_of_any_length_is_parsed() {
        let text = format!("8197{}", ",0".repeat(1000));
        assert_eq!(OwnedVariant::parse_text(text.as_bytes()).unwrap(), owned([0.0; 1000]));
        let error = OwnedVariant::parse_text(b"8194,1,x").unwrap_err();
        assert_eq!(error.to_string(), "not a digit of the number at column 8");
    }

    #[test]
    fn a_value_that_never_fits_is_refused() {
        struct Endless;
        impl Encode for Endless {
            fn encode(&self, out: &mut Writer<'_>) -> Result<(), EncodeError> {
                loop {
                    out.put([0; 4096])?;
                }
            }
        }
        assert_eq!(OwnedVariant::new(&Endless), Err(EncodeError::Full));
    }

    #[test]
    fn lists_of_values_nest_up_to_the_limit() {
        let mut value = owned(7);
        for _ in 0..16 {
            value = owned([value]);
        }
        assert_eq!(OwnedVariant::new(&[value]), Err(EncodeError::TooDeep));
        let list = owned([owned(1), owned("x"), owned(Bstr::default())]);
        assert_eq!(format!("{list:?}"), "VARIANT[I4(1), \"x\", \"\"]");
    }
}
