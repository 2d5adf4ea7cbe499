//! Decimal digits to the nearest binary float, exactly.
//!
//! ```text
//!  digits * 10^e  =  N / M * 2^e      N = digits * 5^e, M = 1      for e >= 0
//!                                     N = digits, M = 5^-e         for e < 0
//! ```
//!
//! The quotient is made bit by bit, 64 of them, and one more that says whether anything is left; so the rounding to 24
//! or 53 bits is right for any digits, ties included. There are three ways, and each gives what the next would give:
//!
//! | numbers                                                | by                             | instructions |
//! |--------------------------------------------------------|--------------------------------|--------------|
//! | digits up to 2^53, exponent up to 22: nearly all       | one operation on exact doubles | 300          |
//! | up to 19 digits, power of five below 2^64: 17 digits   | division of 64-bit integers    | 1,400        |
//! | all others, as 1e300                                   | integers of 2112 bits          | up to 40,000 |
//!
//! It is written here because the libraries for it take 8 to 18 KiB of flash, the generic ones nearly twice that for
//! R4 and R8 together, and leave panics in the image. This takes 2 KiB for both and has none.

use core::cmp::Ordering;

use crate::num::to_usize;

/// A binary format of floats.
#[derive(Clone, Copy)]
pub(super) struct Format {
    /// Bits of the significand, the hidden one included.
    precision: u32,
    /// The exponent of the last bit of the least number.
    least: i32,
    /// The bits of infinity.
    infinity: u64,
}

/// A number `digits * 10^exponent`, in two pieces because of the point between them.
#[derive(Clone, Copy)]
pub(super) struct Decimal<'a> {
    /// ASCII digits without zeros in front.
    pub(super) integer: &'a [u8],
    /// ASCII digits without zeros at the end; together with the others, at most [`MAX_DIGITS`].
    pub(super) fraction: &'a [u8],
    /// The exponent of the digit in front of the point.
    pub(super) exponent: i32,
}

/// The most digits that [`Big`] has room for, whatever their exponent.
pub(super) const MAX_DIGITS: usize = 500;

/// Where the first digit of a number can stand that is neither 0 nor infinite in any format, with room to spare.
const POINTS: core::ops::RangeInclusive<i32> = -330..=310;

impl Format {
    pub(super) const SINGLE: Self = Self { precision: 24, least: -149, infinity: 0x7f80_0000 };
    pub(super) const DOUBLE: Self = Self { precision: 53, least: -1074, infinity: 0x7ff0_0000_0000_0000 };

    pub(super) const fn infinity(self) -> u64 {
        self.infinity
    }

    /// Returns the NaN without a payload.
    pub(super) const fn nan(self) -> u64 {
        self.infinity | 1 << self.precision.wrapping_sub(2)
    }

    /// Returns the bit of the sign.
    pub(super) const fn sign(self) -> u64 {
        // the exponent of infinity is all ones, and the sign is in front of it
        (self.infinity << 1) & !self.infinity & !(self.infinity >> 1)
    }

    /// Returns the bits of the float nearest to a whole number; every `u64` is in the range of both formats.
    #[inline]
    pub(super) fn of_whole(self, number: u64) -> u64 {
        let Some(top) = number.checked_ilog2() else { return 0 };
        let zeros = 63_u32.wrapping_sub(top);
        match self.precision.wrapping_sub(1).checked_sub(top) {
            // it fits as it is
            Some(spare) => {
                let above = 0_i32.wrapping_sub_unsigned(spare).abs_diff(self.least);
                (u64::from(above) << self.precision.wrapping_sub(1)).wrapping_add(number << spare)
            }
            None => self.round(number << zeros, 0_i32.wrapping_sub_unsigned(zeros), false),
        }
    }

    /// Returns the bits of the float nearest to a number that is not 0; `None` when that is 0 or infinite.
    pub(super) fn of_decimal(self, decimal: &Decimal<'_>) -> Option<u64> {
        let Decimal { integer, fraction, exponent } = *decimal;
        let mut significant = fraction;
        while let ([], [b'0', rest @ ..]) = (integer, significant) {
            significant = rest;
        }
        let count = integer.len().wrapping_add(significant.len());
        let exponent = exponent.checked_sub(i32::try_from(fraction.len()).ok()?)?;
        let point = exponent.checked_add(i32::try_from(count).ok()?)?;
        if count == 0 || count > MAX_DIGITS || !POINTS.contains(&point) {
            return None;
        }
        let digits = || integer.iter().chain(significant).map(|digit| digit & 0x0f);
        // 19 digits fit 64 bits
        let number = (count <= 19).then(|| digits().fold(0_u64, |n, d| n.wrapping_mul(10).wrapping_add(u64::from(d))));
        if let Some(bits) = number.and_then(|number| self.of_exact(number, exponent)) {
            return Some(bits);
        }
        let (quotient, scale, inexact) = match number.and_then(|number| small_quotient(number, exponent)) {
            Some(small) => small,
            None => big_quotient(digits(), exponent),
        };
        let bits = self.round(quotient, scale, inexact);
        (bits != 0 && bits < self.infinity).then_some(bits)
    }

    /// Returns the bits of `number * 10^exponent` where one operation on two exact doubles gives them.
    #[expect(clippy::as_conversions, reason = "below 2^53 the conversion is exact; that to f32 rounds as it should")]
    fn of_exact(self, number: u64, exponent: i32) -> Option<u64> {
        let power = *POWERS.get(to_usize(exponent.unsigned_abs()))?;
        if number > 1 << 53 {
            return None;
        }
        let number = number as f64;
        let double = if exponent < 0 { number / power } else { number * power };
        match self.precision {
            53 => Some(double.to_bits()),
            // rounded twice, a number may have become a tie that it is not
            _ if double.to_bits() & 0x1fff_ffff == 0x1000_0000 => None,
            _ => Some(u64::from((double as f32).to_bits())),
        }
    }

    /// Rounds `(number + a bit more if inexact) * 2^scale`, to even if it is a tie; the first bit of `number` is set.
    fn round(self, number: u64, scale: i32, inexact: bool) -> u64 {
        let unit = scale.wrapping_add(64).wrapping_sub_unsigned(self.precision).max(self.least);
        let (Some(drop), Ok(above)) =
            (unit.checked_sub(scale).map(i32::unsigned_abs), u64::try_from(unit.wrapping_sub(self.least)))
        else {
            return 0;
        };
        let kept = number.checked_shr(drop).unwrap_or(0);
        let lost = match drop {
            0..64 => number & (1_u64 << drop).wrapping_sub(1),
            _ => number,
        };
        // a number whose every bit is lost is over a half only if just these 64 bits are
        let half = if drop > 64 { u64::MAX } else { 1_u64 << (drop.wrapping_sub(1) & 63) };
        let up = match lost.cmp(&half) {
            Ordering::Less => false,
            Ordering::Equal => drop <= 64 && (inexact || kept & 1 == 1),
            Ordering::Greater => true,
        };
        // the hidden bit, and a carry out of the rounding, add 1 to the exponent, as they should
        (above << self.precision.wrapping_sub(1)).wrapping_add(kept).wrapping_add(u64::from(up))
    }
}

/// Powers of ten; all of them are exact.
const POWERS: [f64; 23] = [
    1e0, 1e1, 1e2, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8, 1e9, 1e10, 1e11, 1e12, 1e13, 1e14, 1e15, 1e16, 1e17, 1e18, 1e19, 1e20,
    1e21, 1e22,
];

/// 64 bits of a quotient, the first one set; their scale; whether there is more.
type Quotient = (u64, i32, bool);

/// Divides with 64-bit integers; `None` when the number takes more.
fn small_quotient(number: u64, exponent: i32) -> Option<Quotient> {
    let (mut number, mut divisor) = (number, 1_u64);
    // 5^28 does not fit, so whatever needs more has left the loop by then
    for _ in 0..exponent.unsigned_abs().min(28) {
        let scaled = if exponent < 0 { &mut divisor } else { &mut number };
        *scaled = scaled.checked_mul(5)?;
    }
    let (zeros, divisor_zeros) = (number.leading_zeros(), divisor.leading_zeros());
    let (mut rest, divisor) = (number << zeros, divisor << divisor_zeros);
    let mut scale = exponent.wrapping_add_unsigned(divisor_zeros).wrapping_sub_unsigned(zeros).wrapping_sub(63);
    let mut quotient = 0_u64;
    let first = rest >= divisor;
    if first {
        rest = rest.wrapping_sub(divisor);
        quotient = 1;
    } else {
        scale = scale.wrapping_sub(1);
    }
    for _ in u32::from(first)..64 {
        let carry = rest >> 63 == 1;
        rest <<= 1;
        quotient <<= 1;
        if carry || rest >= divisor {
            rest = rest.wrapping_sub(divisor);
            quotient |= 1;
        }
    }
    Some((quotient, scale, rest != 0))
}

/// Divides numbers of any size.
#[inline(never)]
fn big_quotient(digits: impl Iterator<Item = u8>, exponent: i32) -> Quotient {
    let mut number = Big::new(0);
    for digit in digits {
        number.multiply_add(10, u32::from(digit));
    }
    let mut divisor = Big::new(1);
    let scaled = if exponent < 0 { &mut divisor } else { &mut number };
    let mut fives = exponent.unsigned_abs();
    while fives > 0 {
        // 5^13 is the largest that fits a limb
        let step = fives.min(13);
        scaled.multiply_add(5_u32.wrapping_pow(step), 0);
        fives = fives.wrapping_sub(step);
    }
    // both get the same length
    let shift = divisor.bits().wrapping_sub(number.bits());
    let shorter = if shift < 0 { &mut divisor } else { &mut number };
    shorter.shift_left(shift.unsigned_abs());
    let mut scale = exponent.wrapping_sub(shift).wrapping_sub(63);
    if number.compare(&divisor) == Ordering::Less {
        number.shift_left(1);
        scale = scale.wrapping_sub(1);
    }
    let mut quotient = 0_u64;
    for _ in 0..64 {
        quotient <<= 1;
        if number.compare(&divisor) != Ordering::Less {
            number.subtract(&divisor);
            quotient |= 1;
        }
        number.shift_left(1);
    }
    (quotient, scale, number.bits() != 0)
}

/// A large integer: room for 5^830, 64 bits more, and what rounds that up.
struct Big {
    /// Least significant first.
    limbs: [u32; 66],
    /// Limbs above are 0.
    len: usize,
}

impl Big {
    fn new(number: u32) -> Self {
        let mut limbs = [0; 66];
        if let Some(first) = limbs.first_mut() {
            *first = number;
        }
        Self { limbs, len: 1 }
    }

    fn multiply_add(&mut self, factor: u32, term: u32) {
        let mut carry = u64::from(term);
        for limb in self.limbs.iter_mut().take(self.len) {
            let product = u64::from(*limb).wrapping_mul(u64::from(factor)).wrapping_add(carry);
            *limb = low(product);
            carry = product >> 32;
        }
        if carry != 0
            && let Some(limb) = self.limbs.get_mut(self.len)
        {
            *limb = low(carry);
            self.len = self.len.wrapping_add(1);
        }
    }

    fn shift_left(&mut self, bits: u32) {
        let mut left = bits;
        while left > 0 {
            let step = left.min(31);
            self.multiply_add(1 << step, 0);
            left = left.wrapping_sub(step);
        }
    }

    /// Subtracts what is not larger.
    fn subtract(&mut self, other: &Self) {
        let mut borrow = false;
        for (limb, other) in self.limbs.iter_mut().zip(&other.limbs).take(self.len) {
            let (difference, under) = limb.overflowing_sub(*other);
            let (difference, again) = difference.overflowing_sub(u32::from(borrow));
            *limb = difference;
            borrow = under || again;
        }
    }

    fn compare(&self, other: &Self) -> Ordering {
        let len = self.len.max(other.len);
        let both = || self.limbs.iter().zip(&other.limbs).take(len);
        both().rev().map(|(a, b)| a.cmp(b)).find(|order| order.is_ne()).unwrap_or(Ordering::Equal)
    }

    /// Returns the number of bits up to the first one that is set.
    fn bits(&self) -> i32 {
        let top = self.limbs.iter().take(self.len).rposition(|limb| *limb != 0);
        let bits = top.and_then(|top| {
            let limb = self.limbs.get(top)?;
            i32::try_from(top).ok()?.checked_mul(32)?.checked_add_unsigned(32_u32.checked_sub(limb.leading_zeros())?)
        });
        bits.unwrap_or(0)
    }
}

/// Returns the lower half.
fn low(number: u64) -> u32 {
    let [a, b, c, d, ..] = number.to_le_bytes();
    u32::from_le_bytes([a, b, c, d])
}

#[cfg(test)]
mod tests {
    extern crate std;

    use super::*;
    use std::format;

    fn both(text: &str) -> (Option<u64>, Option<u64>) {
        let (mantissa, exponent) = text.split_once('e').unwrap_or((text, "0"));
        let (integer, fraction) = mantissa.split_once('.').unwrap_or((mantissa, ""));
        let decimal = Decimal {
            integer: integer.trim_start_matches('0').as_bytes(),
            fraction: fraction.trim_end_matches('0').as_bytes(),
            exponent: exponent.parse().unwrap(),
        };
        (Format::SINGLE.of_decimal(&decimal), Format::DOUBLE.of_decimal(&decimal))
    }

    /// Checks against the standard library, where 0 and infinity are what is out of range here.
    fn check(text: &str) {
        let single = text.parse::<f32>().unwrap();
        let double = text.parse::<f64>().unwrap();
        let single = (single != 0.0 && single.is_finite()).then_some(u64::from(single.to_bits()));
        let double = (double != 0.0 && double.is_finite()).then_some(double.to_bits());
        assert_eq!(both(text), (single, double), "{text}");
    }

    #[test]
    fn limits_and_ties_go_the_right_way() {
        for text in [
            "1",
            "10",
            "0.1",
            "0.3",
            "123.01",
            "5e-324",
            "2.4703282292062327e-324",
            "2.4703282292062328e-324",
            "2.2250738585072011e-308",
            "2.2250738585072014e-308",
            "1.7976931348623157e308",
            "1.7976931348623158e308",
            "1.7976931348623159e308",
            "1.4e-45",
            "7.006492e-46",
            "7.0064923216240854e-46",
            "7.0064923216240862e-46",
            "1.17549435e-38",
            "3.4028235e38",
            "3.4028235677973366e38",
            "3.40282357e38",
            "9007199254740993",
            "9007199254740995",
            "16777217",
            "16777219",
            "8.5899345920000000e9",
            "1e22",
            "1e23",
            "1e-22",
            "1e-27",
            "1e-28",
            "18446744073709551615",
            "18446744073709551616",
            "9999999999999999999e-19",
            "1e400",
            "1e-400",
            "0",
            "0e5",
            "0.000000000000000000000000000000000000000000000000000000001e57",
        ] {
            check(text);
        }
        // halfway between two floats, and a digit beyond that, with as many digits as it takes to say so
        let half = "8007199254740992.5";
        check(half);
        check("8007199254740993.5");
        check(&format!("{half}{}1", "0".repeat(450)));
        check(&format!("{}e-460", "9".repeat(490)));
        let least_half = "2.470328229206232720882843964341106861825299013071623822127928412503377536351043759326499181808179\
            961898982823477228588654633283551779698981993873980053909390631503565951557022639229085839244910518443593180284\
            993653615250031937045767824921936562366986365848075700158576926990370631192827955855133292783433840935197801553\
            1246597263579574622766465272827220056374006485499977096599470454020828166226237857393450736339007967761930577506\
            7401763246736009689513405355374585166611342237666786041621596804619144672918403005300575308490487653917113865916";
        let (digits, rest) = least_half.split_at(460);
        assert!(!rest.is_empty());
        check(&format!("{digits}e-324"));
    }

    #[test]
    fn every_power_of_ten_and_of_two_is_right() {
        for exponent in -350..330 {
            for mantissa in ["1", "9", "1.5", "2.5", "7.0000001", "9007199254740993", "123456789012345678901234"] {
                check(&format!("{mantissa}e{exponent}"));
            }
        }
        for bits in (1..2047_u64).map(|exponent| exponent << 52) {
            for near in [bits, bits | 1, bits.wrapping_sub(1)] {
                check(&format!("{:e}", f64::from_bits(near)));
            }
        }
    }

    #[test]
    fn signs_and_specials_are_the_hardware_s() {
        assert_eq!(Format::SINGLE.sign(), u64::from((-0.0_f32).to_bits()));
        assert_eq!(Format::DOUBLE.sign(), (-0.0_f64).to_bits());
        assert_eq!(Format::SINGLE.infinity(), u64::from(f32::INFINITY.to_bits()));
        assert_eq!(Format::DOUBLE.infinity(), f64::INFINITY.to_bits());
        assert_eq!((Format::SINGLE.nan(), Format::DOUBLE.nan()), (0x7fc0_0000, 0x7ff8 << 48));
        assert_eq!((Format::SINGLE.of_whole(0), Format::SINGLE.of_whole(16_777_217)), (0, 0x4b80_0000));
        for number in (0..64).map(|bit| 1_u64 << bit).flat_map(|n| [n, n | 1, n.wrapping_sub(1), n | n >> 1]) {
            let text = format!("{number}");
            let (single, double) = (text.parse::<f32>().unwrap(), text.parse::<f64>().unwrap());
            assert_eq!(Format::SINGLE.of_whole(number), u64::from(single.to_bits()), "{number}");
            assert_eq!(Format::DOUBLE.of_whole(number), double.to_bits(), "{number}");
        }
    }
}
