//! Owned values: the encoding of a value in a fixed buffer.

use core::fmt;

use heapless::Vec;

use super::{Encode, Variant, check};
use crate::error::{DecodeError, EncodeError};
use crate::limits::{Limits, MAX_DEPTH, Strictness};
use crate::wire::{Reader, Writer};

/// A value that owns its bytes, at most `N` of them.
///
/// It contains the canonical, validated encoding, and [`as_variant`](Self::as_variant) views it. A pose of 8 doubles takes
/// 70 bytes.
///
/// # Examples
///
/// ```
/// use bcap_core::variant::{Variant, VariantBuf};
///
/// let name = VariantBuf::<32>::new(&"Arm0")?;
/// assert_eq!(name.as_variant().as_bstr().map(|s| s.len()), Some(4));
/// assert!(VariantBuf::<16>::new(&"too long for it").is_err());
/// # Ok::<(), bcap_core::error::EncodeError>(())
/// ```
#[derive(Clone)]
pub struct VariantBuf<const N: usize> {
    /// One canonical value; empty stands for EMPTY.
    bytes: Vec<u8, N>,
}

impl<const N: usize> VariantBuf<N> {
    /// The value EMPTY.
    pub const EMPTY: Self = Self { bytes: Vec::new() };

    /// Encodes `value`.
    ///
    /// # Errors
    ///
    /// [`EncodeError::Full`] when its encoding is over `N` bytes.
    pub fn new<T: Encode + ?Sized>(value: &T) -> Result<Self, EncodeError> {
        Self::build(|out| value.encode(out))
    }

    /// Validates `bytes` as exactly one value and keeps a canonical copy.
    ///
    /// # Errors
    ///
    /// The [`DecodeError`] of the bytes, or [`EncodeError::Full`] when the copy is over `N` bytes.
    pub fn decode(bytes: &[u8], limits: &Limits, strictness: Strictness) -> Result<Self, VariantBufError> {
        let value = Variant::decode(bytes, limits, strictness).map_err(VariantBufError::Decode)?;
        Self::new(&value).map_err(VariantBufError::Encode)
    }

    /// Replaces the value.
    ///
    /// # Errors
    ///
    /// [`EncodeError::Full`] if the encoding is over `N` bytes; the old value stays.
    pub fn set<T: Encode + ?Sized>(&mut self, value: &T) -> Result<(), EncodeError> {
        *self = Self::new(value)?;
        Ok(())
    }

    /// Fills a buffer with the output of `write`, which must be one value.
    pub(crate) fn build<E: From<EncodeError>>(write: impl FnOnce(&mut Writer<'_>) -> Result<(), E>) -> Result<Self, E> {
        let mut bytes = Vec::new();
        bytes.resize_default(N).map_err(|_| EncodeError::Full)?;
        let mut out = Writer::new(&mut bytes);
        write(&mut out)?;
        let len = out.len();
        bytes.truncate(len);
        // a tree that is deeper than any decoder accepts is not a validated value
        let deepest = Limits { depth: MAX_DEPTH, ..Limits::STREAM };
        match check(&mut Reader::new(&bytes), &deepest, Strictness::Lenient) {
            Ok(_) => Ok(Self { bytes }),
            Err(_) => Err(EncodeError::TooDeep.into()),
        }
    }

    /// Views the value.
    #[must_use]
    pub fn as_variant(&self) -> Variant<'_> {
        Variant::from_checked(&self.bytes)
    }

    /// Returns the value's encoding.
    #[must_use]
    pub fn as_bytes(&self) -> &[u8] {
        if self.bytes.is_empty() { &[0, 0, 1, 0, 0, 0] } else { &self.bytes }
    }
}

impl<const N: usize> Default for VariantBuf<N> {
    fn default() -> Self {
        Self::EMPTY
    }
}

impl<const N: usize> Encode for VariantBuf<N> {
    fn encode(&self, out: &mut Writer<'_>) -> Result<(), EncodeError> {
        out.put_slice(self.as_bytes())
    }
}

impl<const N: usize, const M: usize> PartialEq<VariantBuf<M>> for VariantBuf<N> {
    fn eq(&self, other: &VariantBuf<M>) -> bool {
        self.as_variant() == other.as_variant()
    }
}

impl<const N: usize> Eq for VariantBuf<N> {}

impl<const N: usize> fmt::Debug for VariantBuf<N> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.as_variant().fmt(f)
    }
}

#[cfg(feature = "defmt")]
impl<const N: usize> defmt::Format for VariantBuf<N> {
    fn format(&self, f: defmt::Formatter<'_>) {
        self.as_variant().format(f);
    }
}

/// The reason why bytes did not become a [`VariantBuf`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum VariantBufError {
    /// They are not a valid value.
    Decode(DecodeError),
    /// The value does not fit.
    Encode(EncodeError),
}

impl fmt::Display for VariantBufError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Decode(e) => e.fmt(f),
            Self::Encode(e) => e.fmt(f),
        }
    }
}

impl core::error::Error for VariantBufError {}
