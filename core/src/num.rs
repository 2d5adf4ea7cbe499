//! Conversions between the widths of numbers.
//!
//! `as` is denied in this crate, because a silently truncated length from the wire breaks a codec. Widths change only in
//! these functions. Those between lengths cannot fail on the supported targets.

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

/// Returns the nearest f32; infinite above its range.
#[inline]
#[expect(clippy::as_conversions, reason = "there is no other conversion from f64 to f32")]
pub(crate) const fn to_f32(value: f64) -> f32 {
    value as f32
}

/// Returns the integer that equals `value`.
#[inline]
#[expect(clippy::as_conversions, reason = "there is no other conversion from f64 to i64; the result is compared")]
pub(crate) fn exact_i64(value: f64) -> Option<i64> {
    // `as` saturates, and i64::MAX rounds up to 2^63, which is out of range
    let whole = value as i64;
    (whole != i64::MAX && whole as f64 == value).then_some(whole)
}

/// Returns the integer that equals `value`.
#[inline]
#[expect(clippy::as_conversions, reason = "there is no other conversion from f64 to u64; the result is compared")]
pub(crate) fn exact_u64(value: f64) -> Option<u64> {
    let whole = value as u64;
    (whole != u64::MAX && whole as f64 == value).then_some(whole)
}

/// Returns the float that equals `value`.
#[inline]
#[expect(clippy::as_conversions, reason = "there is no other conversion from i64 to f64; the result is compared")]
pub(crate) fn exact_f64_of_i64(value: i64) -> Option<f64> {
    Some(value as f64).filter(|float| exact_i64(*float) == Some(value))
}

/// Returns the float that equals `value`.
#[inline]
#[expect(clippy::as_conversions, reason = "there is no other conversion from u64 to f64; the result is compared")]
pub(crate) fn exact_f64_of_u64(value: u64) -> Option<f64> {
    Some(value as f64).filter(|float| exact_u64(*float) == Some(value))
}

/// Returns the f32 that equals `value`.
#[inline]
pub(crate) fn exact_f32(value: f64) -> Option<f32> {
    Some(to_f32(value)).filter(|single| f64::from(*single) == value)
}
