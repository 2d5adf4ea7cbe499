//! Scalars that Rust has no type for: currency, OLE dates, and NULL.
//!
//! Both keep the wire's own number, so nothing is lost on the way through; the helpers convert exactly or say `None`.

use core::fmt;

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
pub struct Currency(i64);

impl Currency {
    /// How many of the wire's units make one.
    pub const SCALE: i64 = 10_000;

    /// Takes the wire's number.
    #[must_use]
    pub const fn from_raw(ten_thousandths: i64) -> Self {
        Self(ten_thousandths)
    }

    /// Returns the wire's number.
    #[must_use]
    pub const fn raw(self) -> i64 {
        self.0
    }

    /// Makes an amount from its whole part and the ten-thousandths behind the point, both of the sign of `whole`.
    ///
    /// `None` when `ten_thousandths` is 10000 or more, or the amount does not fit. Amounts between -1 and 0 have no
    /// whole part to carry the sign: use [`from_raw`](Self::from_raw).
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

    /// Returns the whole part, towards zero, and the ten-thousandths behind the point.
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
/// The fraction of a day counts forward in time for negative dates too: -1.25 is 1899-12-29 06:00. The wire has no
/// time zone; what a controller means is its own wall clock.
#[derive(Clone, Copy, Debug, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct OleDate(f64);

/// A date and a time of day on the Gregorian calendar, without a zone.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
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

const MILLIS_PER_DAY: i64 = 86_400_000;
/// 1970-01-01 as an OLE date.
const UNIX_EPOCH_DAY: i64 = 25_569;
/// 0100-01-01 and 9999-12-31, the first and last day of the OLE calendar.
const FIRST_DAY: i64 = -657_434;
const LAST_DAY: i64 = 2_958_465;

impl OleDate {
    /// Takes the wire's number.
    #[must_use]
    pub const fn from_raw(days: f64) -> Self {
        Self(days)
    }

    /// Returns the wire's number.
    #[must_use]
    pub const fn raw(self) -> f64 {
        self.0
    }

    /// Returns the date for a count of milliseconds since 1970-01-01 00:00; `None` outside the years 100 to 9999.
    #[must_use]
    pub fn from_unix_millis(millis: i64) -> Option<Self> {
        let day = millis.div_euclid(MILLIS_PER_DAY).checked_add(UNIX_EPOCH_DAY)?;
        Self::from_day_and_millis(day, millis.rem_euclid(MILLIS_PER_DAY))
    }

    /// Returns the milliseconds since 1970-01-01 00:00, rounded to the nearest; `None` outside the years 100 to 9999.
    #[must_use]
    pub fn to_unix_millis(self) -> Option<i64> {
        let (day, millis) = self.to_day_and_millis()?;
        day.checked_sub(UNIX_EPOCH_DAY)?.checked_mul(MILLIS_PER_DAY)?.checked_add(millis)
    }

    /// Returns the date for a calendar time; `None` when it is none (a 30th of February) or out of range.
    #[must_use]
    pub fn from_civil(time: CivilTime) -> Option<Self> {
        let clock = time.hour < 24 && time.minute < 60 && time.second < 60 && time.millisecond < 1000;
        if !clock || !(100..=9999).contains(&time.year) {
            return None;
        }
        let day = day_from_civil(time.year, time.month, time.day)?;
        let seconds = i64::from(time.hour)
            .checked_mul(3600)?
            .checked_add(i64::from(time.minute).checked_mul(60)?)?
            .checked_add(i64::from(time.second))?;
        Self::from_day_and_millis(day, seconds.checked_mul(1000)?.checked_add(i64::from(time.millisecond))?)
    }

    /// Returns the calendar time, rounded to the nearest millisecond; `None` outside the years 100 to 9999.
    #[must_use]
    pub fn to_civil(self) -> Option<CivilTime> {
        let (day, millis) = self.to_day_and_millis()?;
        let (year, month, day) = civil_from_day(day)?;
        let part = |unit: i64, of: i64| millis.checked_div(unit).and_then(|n| n.checked_rem(of));
        Some(CivilTime {
            year,
            month,
            day,
            hour: u8::try_from(part(3_600_000, 24)?).ok()?,
            minute: u8::try_from(part(60_000, 60)?).ok()?,
            second: u8::try_from(part(1000, 60)?).ok()?,
            millisecond: u16::try_from(part(1, 1000)?).ok()?,
        })
    }

    #[expect(clippy::as_conversions, reason = "both numbers are far below 2^53, so the conversions are exact")]
    fn from_day_and_millis(day: i64, millis: i64) -> Option<Self> {
        if !(FIRST_DAY..=LAST_DAY).contains(&day) {
            return None;
        }
        let fraction = millis as f64 / MILLIS_PER_DAY as f64;
        // OLE counts the fraction away from zero
        Some(Self(if day < 0 { day as f64 - fraction } else { day as f64 + fraction }))
    }

    #[expect(clippy::as_conversions, reason = "float to integer casts truncate and saturate; both are wanted here")]
    fn to_day_and_millis(self) -> Option<(i64, i64)> {
        if !self.0.is_finite() {
            return None;
        }
        let day = self.0 as i64;
        if !(FIRST_DAY..=LAST_DAY).contains(&day) {
            return None;
        }
        let fraction = (self.0 - day as f64).abs();
        let millis = (fraction * MILLIS_PER_DAY as f64 + 0.5) as i64;
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
    /// Makes midnight of a date; whether that date exists is checked by [`OleDate::from_civil`].
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
const ERA_ORIGIN: i64 = -693_899;

fn day_from_civil(year: i16, month: u8, day: u8) -> Option<i64> {
    if day == 0 || day > days_in_month(year, month)? {
        return None;
    }
    let (year, month, day) = (i64::from(year), i64::from(month), i64::from(day));
    let (year, month) =
        if month < 3 { (year.checked_sub(1)?, month.checked_add(9)?) } else { (year, month.checked_sub(3)?) };
    let leap_days = year.checked_div(4)?.checked_sub(year.checked_div(100)?)?.checked_add(year.checked_div(400)?)?;
    let month_days = month.checked_mul(153)?.checked_add(2)?.checked_div(5)?;
    year.checked_mul(365)?
        .checked_add(leap_days)?
        .checked_add(month_days)?
        .checked_add(day)?
        .checked_sub(1)?
        .checked_add(ERA_ORIGIN)
}

fn civil_from_day(day: i64) -> Option<(i16, u8, u8)> {
    let days = day.checked_sub(ERA_ORIGIN)?;
    let era = days.checked_div(146_097)?;
    let of_era = days.checked_rem(146_097)?;
    // the last day of a 4-year, 100-year and 400-year span does not start a new year
    let leap = of_era
        .checked_div(1460)?
        .checked_sub(of_era.checked_div(36_524)?)?
        .checked_add(of_era.checked_div(146_096)?)?;
    let year_of_era = of_era.checked_sub(leap)?.checked_div(365)?;
    let before = year_of_era
        .checked_mul(365)?
        .checked_add(year_of_era.checked_div(4)?)?
        .checked_sub(year_of_era.checked_div(100)?)?;
    let of_year = of_era.checked_sub(before)?;
    let month = of_year.checked_mul(5)?.checked_add(2)?.checked_div(153)?;
    let first = month.checked_mul(153)?.checked_add(2)?.checked_div(5)?;
    let day = of_year.checked_sub(first)?.checked_add(1)?;
    let year = era.checked_mul(400)?.checked_add(year_of_era)?;
    let (year, month) =
        if month < 10 { (year, month.checked_add(3)?) } else { (year.checked_add(1)?, month.checked_sub(9)?) };
    Some((i16::try_from(year).ok()?, u8::try_from(month).ok()?, u8::try_from(day).ok()?))
}

fn days_in_month(year: i16, month: u8) -> Option<u8> {
    let leap = year.checked_rem(4)? == 0 && (year.checked_rem(100)? != 0 || year.checked_rem(400)? == 0);
    match month {
        1 | 3 | 5 | 7 | 8 | 10 | 12 => Some(31),
        4 | 6 | 9 | 11 => Some(30),
        2 => Some(if leap { 29 } else { 28 }),
        _ => None,
    }
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
        assert_eq!(Currency::from_raw(i64::MIN).to_string(), "-922337203685477.5808");
        assert_eq!(Currency::from_parts(1, 10_000), None);
        assert_eq!(Currency::from_parts(i64::MAX, 0), None);
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
                let unix = (day - UNIX_EPOCH_DAY) * MILLIS_PER_DAY + millis;
                let date = OleDate::from_unix_millis(unix).unwrap();
                assert_eq!(date.to_unix_millis(), Some(unix), "{unix}");
                assert_eq!(OleDate::from_civil(date.to_civil().unwrap()), Some(date));
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
        ] {
            assert_eq!(OleDate::from_civil(civil), None, "{civil}");
        }
    }
}
