//! Scalars that Rust has no type for: currency, OLE dates, and NULL.
//!
//! Both contain the number on the wire, so they are sent unchanged. Conversions are exact or return `None`.

use core::fmt;

use super::float::FloatFormat;

/// The value of VT_NULL; the unit `()` stands for VT_EMPTY.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Null;

/// An amount of VT_CY: a signed count of ten-thousandths, as on the wire.
///
/// # Examples
///
/// ```
/// use bcap_core::variant::Currency;
///
/// let price = Currency::from_parts(-3, 2_500).ok_or("out of range")?;
/// assert_eq!(price.raw(), -32_500);
/// assert_eq!(price.to_string(), "-3.2500");
/// # Ok::<(), &str>(())
/// ```
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(transparent))]
pub struct Currency(i64);

impl Currency {
    /// Units of the wire in one.
    pub const SCALE: i64 = 10_000;

    /// Creates an amount from the number on the wire.
    #[must_use]
    pub const fn from_raw(ten_thousandths: i64) -> Self {
        Self(ten_thousandths)
    }

    /// Returns the number on the wire.
    #[must_use]
    pub const fn raw(self) -> i64 {
        self.0
    }

    /// Creates an amount from its whole part and the ten-thousandths after the point, both with the sign of `whole`.
    ///
    /// `None` if `ten_thousandths` is 10000 or more, or the amount does not fit. Use [`from_raw`](Self::from_raw) for amounts
    /// between -1 and 0, whose whole part has no sign.
    #[must_use]
    pub const fn from_parts(whole: i64, ten_thousandths: u16) -> Option<Self> {
        if ten_thousandths >= 10_000 {
            return None;
        }
        let Some(scaled) = whole.checked_mul(Self::SCALE) else { return None };
        let fraction = widen(ten_thousandths);
        let sum = if whole < 0 { scaled.checked_sub(fraction) } else { scaled.checked_add(fraction) };
        match sum {
            Some(raw) => Some(Self(raw)),
            None => None,
        }
    }

    /// Returns the whole part, rounded towards zero, and the ten-thousandths after the point.
    #[must_use]
    pub fn to_parts(self) -> (i64, u16) {
        let whole = self.0.wrapping_div(Self::SCALE);
        let rest = self.0.wrapping_rem(Self::SCALE).unsigned_abs();
        (whole, u16::try_from(rest).unwrap_or(0))
    }
}

#[expect(clippy::as_conversions, reason = "From is not const; u16 to i64 is lossless")]
const fn widen(value: u16) -> i64 {
    value as i64
}

impl fmt::Display for Currency {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (whole, rest) = self.to_parts();
        let sign = if self.0 < 0 { "-" } else { "" };
        write!(f, "{sign}{}.{rest:04}", whole.unsigned_abs())
    }
}

/// A point in time of VT_DATE: days since 1899-12-30 00:00, as on the wire.
///
/// The fraction of a day counts forward in time for negative dates too: -1.25 is 1899-12-29 06:00. There is no time zone;
/// a controller sends its local time.
#[derive(Clone, Copy, Debug, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(transparent))]
pub struct OleDate(f64);

/// A date and a time of day on the Gregorian calendar, without a zone.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct CivilTime {
    /// 100 to 9999, the range of OLE dates.
    pub year: i16,
    /// 1 to 12.
    pub month: u8,
    /// 1 to 31.
    pub day: u8,
    /// 0 to 23.
    pub hour: u8,
    /// 0 to 59.
    pub minute: u8,
    /// 0 to 59.
    pub second: u8,
    /// 0 to 999.
    pub millisecond: u16,
}

const MILLIS_PER_DAY: u32 = 86_400_000;
/// 1970-01-01 as an OLE date.
const UNIX_EPOCH_DAY: i32 = 25_569;
/// 0100-01-01 and 9999-12-31, the first and last day of the OLE calendar.
const FIRST_DAY: i32 = -657_434;
const LAST_DAY: i32 = 2_958_465;

impl OleDate {
    /// Creates a date from the number on the wire.
    #[must_use]
    pub const fn from_raw(days: f64) -> Self {
        Self(days)
    }

    /// Returns the number on the wire.
    #[must_use]
    pub const fn raw(self) -> f64 {
        self.0
    }

    /// Returns the date for a count of milliseconds since 1970-01-01 00:00; `None` outside the years 100 to 9999.
    #[must_use]
    pub fn from_unix_millis(millis: i64) -> Option<Self> {
        let of = i64::from(MILLIS_PER_DAY);
        let day = i32::try_from(millis.div_euclid(of)).ok()?.checked_add(UNIX_EPOCH_DAY)?;
        Self::from_day_and_millis(day, u32::try_from(millis.rem_euclid(of)).ok()?)
    }

    /// Returns the milliseconds since 1970-01-01 00:00, rounded to the nearest; `None` outside the years 100 to 9999.
    #[must_use]
    pub fn to_unix_millis(self) -> Option<i64> {
        let (day, millis) = self.to_day_and_millis()?;
        let days = i64::from(day.checked_sub(UNIX_EPOCH_DAY)?);
        days.checked_mul(i64::from(MILLIS_PER_DAY))?.checked_add(i64::from(millis))
    }

    /// Returns the date for a calendar time; `None` if it does not exist (30th of February) or is out of range.
    #[must_use]
    pub fn from_civil(time: CivilTime) -> Option<Self> {
        let clock = time.hour < 24 && time.minute < 60 && time.second < 60 && time.millisecond < 1000;
        if !clock || !(100..=9999).contains(&time.year) {
            return None;
        }
        let day = day_from_civil(time.year, time.month, time.day)?;
        let minutes = u32::from(time.hour).wrapping_mul(60).wrapping_add(u32::from(time.minute));
        let seconds = minutes.wrapping_mul(60).wrapping_add(u32::from(time.second));
        Self::from_day_and_millis(day, seconds.wrapping_mul(1000).wrapping_add(u32::from(time.millisecond)))
    }

    /// Returns the calendar time, rounded to the nearest millisecond; `None` outside the years 100 to 9999.
    #[must_use]
    pub fn to_civil(self) -> Option<CivilTime> {
        let (day, millis) = self.to_day_and_millis()?;
        let (year, month, day) = civil_from_day(day)?;
        let part = |unit: u32, of| millis.checked_div(unit)?.checked_rem(of)?.try_into().ok();
        Some(CivilTime {
            year,
            month,
            day,
            hour: part(3_600_000, 24)?,
            minute: part(60_000, 60)?,
            second: part(1000, 60)?,
            millisecond: u16::try_from(millis % 1000).unwrap_or(0),
        })
    }

    fn from_day_and_millis(day: i32, millis: u32) -> Option<Self> {
        if !(FIRST_DAY..=LAST_DAY).contains(&day) {
            return None;
        }
        let fraction = FloatFormat::Double.of_ratio(u64::from(millis), u64::from(MILLIS_PER_DAY));
        // OLE dates count the fraction away from zero
        let sum = FloatFormat::Double.plus_whole(fraction, day.unsigned_abs());
        Some(Self(f64::from_bits(if day < 0 { sum | FloatFormat::Double.sign() } else { sum })))
    }

    /// Returns the day, towards zero, and the milliseconds of the day.
    fn to_day_and_millis(self) -> Option<(i32, u32)> {
        let bits = self.0.to_bits() & !FloatFormat::Double.sign();
        // the upper half are days, the lower half parts of a day
        let (days, fraction) = FloatFormat::Double.fixed(bits)?;
        let day = i32::try_from(days).ok()?;
        let day = if self.0.is_sign_negative() { day.checked_neg()? } else { day };
        if !(FIRST_DAY..=LAST_DAY).contains(&day) {
            return None;
        }
        let (above, below) = (fraction >> 32, fraction & u64::from(u32::MAX));
        let of = u64::from(MILLIS_PER_DAY);
        // both products are below 2^59
        let scaled = above.wrapping_mul(of).wrapping_add(below.wrapping_mul(of) >> 32);
        let millis = u32::try_from(scaled.wrapping_add(1 << 31) >> 32).ok()?;
        // rounding may reach midnight of the day after
        if millis >= MILLIS_PER_DAY {
            let next = day.checked_add(1)?;
            return (next <= LAST_DAY).then_some((next, 0));
        }
        Some((day, millis))
    }
}

/// Compares the bits, as all values of this crate do: NaN equals itself, and 0.0 is not -0.0.
impl PartialEq for OleDate {
    fn eq(&self, other: &Self) -> bool {
        self.0.to_bits() == other.0.to_bits()
    }
}

impl Eq for OleDate {}

impl CivilTime {
    /// Returns midnight of a date. [`OleDate::from_civil`] checks whether the date exists.
    #[must_use]
    pub const fn date(year: i16, month: u8, day: u8) -> Self {
        Self { year, month, day, hour: 0, minute: 0, second: 0, millisecond: 0 }
    }

    /// Returns the same date at another time of day.
    #[must_use]
    pub const fn at(self, hour: u8, minute: u8, second: u8) -> Self {
        Self { hour, minute, second, millisecond: 0, ..self }
    }
}

/// Writes `2026-11-21T08:05:00.000`.
impl fmt::Display for CivilTime {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { year, month, day, hour, minute, second, millisecond } = self;
        write!(f, "{year:04}-{month:02}-{day:02}T{hour:02}:{minute:02}:{second:02}.{millisecond:03}")
    }
}

// Both conversions count in years that begin on the 1st of March, so that the leap day is the last of its year, and in
// eras of 400 years, after which the calendar repeats (146097 days). Years here are 100 to 9999, all sums are small.

/// OLE date of 0000-03-01.
const ERA_ORIGIN: i32 = -693_899;

fn day_from_civil(year: i16, month: u8, day: u8) -> Option<i32> {
    let date = (year, month, day);
    let (year, month, day) = (u32::try_from(year).ok()?, u32::from(month), i32::from(day));
    let (year, month) =
        if month < 3 { (year.wrapping_sub(1), month.wrapping_add(9)) } else { (year, month.wrapping_sub(3)) };
    let leap_days = (year / 4).wrapping_sub(year / 100).wrapping_add(year / 400);
    let month_days = month.wrapping_mul(153).wrapping_add(2) / 5;
    let days = year.wrapping_mul(365).wrapping_add(leap_days).wrapping_add(month_days);
    let day = day.wrapping_sub(1).wrapping_add_unsigned(days).wrapping_add(ERA_ORIGIN);
    // an invalid day has the number of a valid one
    (civil_from_day(day) == Some(date)).then_some(day)
}

fn civil_from_day(day: i32) -> Option<(i16, u8, u8)> {
    // in quarters of a day a century has 146097 of them, and a year 1461
    let quarters = u32::try_from(day.checked_sub(ERA_ORIGIN)?).ok()?.wrapping_mul(4).wrapping_add(3);
    let of_century = (quarters % 146_097) | 3;
    let of_year = of_century % 1461 / 4;
    let year = (quarters / 146_097).wrapping_mul(100).wrapping_add(of_century / 1461);
    // months of 30 and 31 days, as the days of March to July are
    let fifths = of_year.wrapping_mul(5).wrapping_add(2);
    let (month, day) = (fifths / 153, (fifths % 153 / 5).wrapping_add(1));
    let (year, month) =
        if month < 10 { (year, month.wrapping_add(3)) } else { (year.wrapping_add(1), month.wrapping_sub(9)) };
    Some((i16::try_from(year).ok()?, u8::try_from(month).ok()?, u8::try_from(day).ok()?))
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use std::string::ToString;

    #[test]
    fn currency_parts_are_exact_in_both_signs() {
        assert_eq!(Currency::from_parts(1234, 5678), Some(Currency::from_raw(12_345_678)));
        assert_eq!(Currency::from_raw(-12_345_678).to_parts(), (-1234, 5678));
        assert_eq!(Currency::from_raw(-5).to_string(), "-0.0005");
        assert_eq!(
            (Currency::from_raw(0).to_string(), Currency::from_raw(5).to_string()),
            ("0.0000".into(), "0.0005".into())
        );
        assert_eq!(Currency::from_raw(i64::MIN).to_string(), "-922337203685477.5808");
        assert_eq!(Currency::from_parts(0, 5), Some(Currency::from_raw(5)));
        assert_eq!(Currency::from_parts(1, 10_000), None);
        assert_eq!(Currency::from_parts(i64::MAX, 0), None);
    }

    #[test]
    fn times_are_shown_as_iso_8601_does() {
        let time = CivilTime { millisecond: 7, ..CivilTime::date(2026, 1, 2).at(3, 4, 5) };
        assert_eq!(time.to_string(), "2026-01-02T03:04:05.007");
        assert_eq!(time.at(6, 7, 8).to_string(), "2026-01-02T06:07:08.000");
    }

    #[test]
    fn known_dates() {
        let known = [
            (0.0, CivilTime::date(1899, 12, 30)),
            (1.0, CivilTime::date(1899, 12, 31)),
            (-1.0, CivilTime::date(1899, 12, 29)),
            (25_569.0, CivilTime::date(1970, 1, 1)),
            (36_585.0, CivilTime::date(2000, 2, 29)),
            (-657_434.0, CivilTime::date(100, 1, 1)),
            (2_958_465.0, CivilTime::date(9999, 12, 31)),
            (-1.25, CivilTime::date(1899, 12, 29).at(6, 0, 0)),
            (2.75, CivilTime::date(1900, 1, 1).at(18, 0, 0)),
        ];
        for (raw, civil) in known {
            assert_eq!(OleDate::from_raw(raw).to_civil(), Some(civil), "{raw}");
            assert_eq!(OleDate::from_civil(civil), Some(OleDate::from_raw(raw)), "{civil}");
        }
        assert_eq!(OleDate::from_raw(25_569.0).to_unix_millis(), Some(0));
        assert_eq!(OleDate::from_raw(-1.25).to_unix_millis(), Some(-2_209_248_000_000 + 6 * 3_600_000));
    }

    #[test]
    fn every_day_of_the_calendar_round_trips_and_follows_the_day_before() {
        let mut last = None;
        for day in FIRST_DAY..=LAST_DAY {
            let (y, m, d) = civil_from_day(day).unwrap();
            assert_eq!(day_from_civil(y, m, d), Some(day));
            assert!(last < Some((y, m, d)));
            last = Some((y, m, d));
        }
    }

    #[test]
    fn milliseconds_round_trip_on_both_sides_of_the_origin() {
        for millis in [0, 1, 999, 43_200_001, 86_399_999] {
            for day in [FIRST_DAY, -25_569, -1, 0, 1, 45_000, LAST_DAY] {
                let unix = i64::from(day - UNIX_EPOCH_DAY) * i64::from(MILLIS_PER_DAY) + millis;
                let date = OleDate::from_unix_millis(unix).unwrap();
                assert_eq!(date.to_unix_millis(), Some(unix), "{unix}");
                assert_eq!(OleDate::from_civil(date.to_civil().unwrap()), Some(date));
            }
        }
    }

    /// The algorithm of Windows, in doubles.
    fn in_doubles(day: i32, millis: u32) -> f64 {
        let fraction = f64::from(millis) / f64::from(MILLIS_PER_DAY);
        f64::from(day) + if day < 0 { -fraction } else { fraction }
    }

    #[test]
    fn dates_have_the_bits_that_doubles_have() {
        let days = [FIRST_DAY, -25_569, -2, -1, 0, 1, 2, 3, 1023, 1024, 45_000, 46_347, LAST_DAY];
        let check = |day, millis| {
            let date = OleDate::from_day_and_millis(day, millis).unwrap();
            assert_eq!(date.raw().to_bits(), in_doubles(day, millis).to_bits(), "{day} {millis}");
            assert_eq!(date.to_day_and_millis(), Some((day, millis)), "{day} {millis}");
        };
        for day in days {
            (0..MILLIS_PER_DAY).step_by(7919).chain(0..100).for_each(|millis| check(day, millis));
        }
    }

    #[test]
    #[ignore = "the milliseconds of a few days take a minute, see `just floats`"]
    fn every_millisecond_has_the_bits_that_doubles_have() {
        for day in [-1, 0, 1, 46_347] {
            for millis in 0..MILLIS_PER_DAY {
                let date = OleDate::from_day_and_millis(day, millis).unwrap();
                assert_eq!(date.raw().to_bits(), in_doubles(day, millis).to_bits(), "{day} {millis}");
                assert_eq!(date.to_day_and_millis(), Some((day, millis)), "{day} {millis}");
            }
        }
    }

    #[test]
    fn what_is_no_date_is_none() {
        for raw in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 1e300, 2_958_466.0, -657_435.0, 2_958_465.999_999_999_9]
        {
            assert_eq!(OleDate::from_raw(raw).to_civil(), None, "{raw}");
        }
        for civil in [
            CivilTime::date(2023, 2, 29),
            CivilTime::date(1900, 2, 29),
            CivilTime::date(2023, 0, 1),
            CivilTime::date(2023, 13, 1),
            CivilTime::date(2023, 4, 31),
            CivilTime::date(99, 1, 1),
            CivilTime::date(10_000, 1, 1),
            CivilTime::date(2023, 1, 1).at(24, 0, 0),
            CivilTime::date(2023, 1, 1).at(0, 60, 0),
            CivilTime::date(2023, 1, 1).at(0, 0, 60),
            CivilTime { millisecond: 1000, ..CivilTime::date(2023, 1, 1) },
        ] {
            assert_eq!(OleDate::from_civil(civil), None, "{civil}");
        }
        // the time nearest to midnight belongs to the next day, even before 1899-12-30
        assert_eq!(OleDate::from_raw(1.999_999_999_9).to_civil(), Some(CivilTime::date(1900, 1, 1)));
        assert_eq!(OleDate::from_raw(-2.999_999_999_9).to_civil(), Some(CivilTime::date(1899, 12, 29)));
        for (tenths, millis) in [(10.0, 1), (3.0, 0), (7.0, 1), (13.0, 1), (17.0, 2)] {
            let time = OleDate::from_raw(0.5 + tenths / 864_000_000.0).to_civil().unwrap();
            assert_eq!(time.millisecond, millis, "{tenths} tenths of a millisecond");
        }
        let last = CivilTime { millisecond: 999, ..CivilTime::date(9999, 12, 31).at(23, 59, 59) };
        assert_eq!(OleDate::from_civil(last).unwrap().to_civil(), Some(last));
    }
}
