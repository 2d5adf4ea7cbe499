//! Integer conversions that are total on every target this crate supports.
//!
//! `as` is denied in this crate: a silent truncation of a length that came from the wire is how codecs break. These
//! few functions are the only places where widths change.

const _: () = assert!(usize::BITS >= 32, "bcap-core needs a target with at least 32-bit addresses");

/// Widens a length from the wire; lossless because targets under 32 bits are refused above.
#[inline]
#[expect(clippy::as_conversions, reason = "u32 to usize is lossless on the targets that compile")]
pub(crate) const fn to_usize(value: u32) -> usize {
    value as usize
}

/// Narrows a length to the wire's width, saturating: a length of 4 GiB or more is refused by every limit anyway.
#[inline]
pub(crate) fn to_u32(value: usize) -> u32 {
    u32::try_from(value).unwrap_or(u32::MAX)
}

/// Narrows a count to 16 bits, saturating.
#[inline]
pub(crate) fn to_u16(value: usize) -> u16 {
    u16::try_from(value).unwrap_or(u16::MAX)
}
