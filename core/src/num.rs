//! Integer conversions that cannot fail on the supported targets.
//!
//! `as` is denied in this crate, because a silently truncated length from the wire breaks a codec. Widths change only in
//! these functions.

const _: () = assert!(usize::BITS >= 32, "bcap-core needs a target with at least 32-bit addresses");

/// Widens a length from the wire; lossless, because the assertion above excludes smaller targets.
#[inline]
#[expect(clippy::as_conversions, reason = "u32 to usize is lossless on the targets that compile")]
pub(crate) const fn to_usize(value: u32) -> usize {
    value as usize
}

/// Narrows a length to the wire's width, saturating: every limit refuses a length of 4 GiB or more.
#[inline]
pub(crate) fn to_u32(value: usize) -> u32 {
    u32::try_from(value).unwrap_or(u32::MAX)
}

/// Narrows a count to 16 bits, saturating.
#[inline]
pub(crate) fn to_u16(value: usize) -> u16 {
    u16::try_from(value).unwrap_or(u16::MAX)
}
