//! Interval arithmetic: the values and slopes of a function of one variable while the variable is in an interval.

use std::f64::consts::{FRAC_PI_2, PI, TAU};
use std::ops::{Add, Mul, Neg, Sub};

/// The bound of a slope that is infinite somewhere. It is finite so that its product with 0 is 0.
const STEEP: f64 = 1e100;

/// An interval, both ends included.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Interval {
    pub(super) low: f64,
    pub(super) high: f64,
}

impl Interval {
    pub(super) const fn new(low: f64, high: f64) -> Self {
        Self { low, high }
    }

    pub(super) const fn point(value: f64) -> Self {
        Self::new(value, value)
    }

    pub(super) const fn middle(self) -> f64 {
        self.low.midpoint(self.high)
    }

    pub(super) const fn width(self) -> f64 {
        self.high - self.low
    }

    /// Returns whether 0 is farther away than `margin`.
    pub(super) fn excludes_zero(self, margin: f64) -> bool {
        self.low > margin || self.high < -margin
    }

    /// Returns the common part; both contain the same value, so it is not empty but for rounding.
    fn and(self, other: Self) -> Self {
        let (low, high) = (self.low.max(other.low), self.high.min(other.high));
        Self::new(low.min(high), high.max(low))
    }

    fn cos(self) -> Self {
        let contains = |place: f64| ((self.low - place) / TAU).ceil() * TAU + place <= self.high;
        let (a, b) = (self.low.cos(), self.high.cos());
        Self::new(if contains(PI) { -1.0 } else { a.min(b) }, if contains(0.0) { 1.0 } else { a.max(b) })
    }

    fn squared(self) -> Self {
        let (a, b) = (self.low * self.low, self.high * self.high);
        Self::new(if self.excludes_zero(0.0) { a.min(b) } else { 0.0 }, a.max(b))
    }
}

impl Add for Interval {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        Self::new(self.low + other.low, self.high + other.high)
    }
}

impl Neg for Interval {
    type Output = Self;

    fn neg(self) -> Self {
        Self::new(-self.high, -self.low)
    }
}

impl Mul for Interval {
    type Output = Self;

    fn mul(self, other: Self) -> Self {
        let products = [self.low * other.low, self.low * other.high, self.high * other.low, self.high * other.high];
        let bound = |limit: f64, pick: fn(f64, f64) -> f64| products.into_iter().fold(limit, pick);
        Self::new(bound(f64::INFINITY, f64::min), bound(f64::NEG_INFINITY, f64::max))
    }
}

impl Mul<f64> for Interval {
    type Output = Self;

    fn mul(self, factor: f64) -> Self {
        self * Self::point(factor)
    }
}

/// The values of a function while its variable is in an interval, and its slopes there.
#[derive(Clone, Copy, Debug)]
pub(super) struct Enclosure {
    pub(super) value: Interval,
    pub(super) slope: Interval,
}

impl Enclosure {
    /// Returns the sine and the cosine of the variable.
    pub(super) fn sin_cos(angle: Interval) -> (Self, Self) {
        let cosine = angle.cos();
        let sine = (angle + Interval::point(-FRAC_PI_2)).cos();
        (Self { value: sine, slope: cosine }, Self { value: cosine, slope: -sine })
    }

    pub(super) fn squared(self) -> Self {
        Self { value: self.value.squared(), slope: self.value * self.slope * 2.0 }
    }

    /// Returns the square root where it exists; `None` if the function is negative everywhere, or too large to be computed.
    pub(super) fn sqrt(self) -> Option<Self> {
        let Interval { low, high } = self.value;
        if high.is_nan() || high < 0.0 {
            return None;
        }
        let value = Interval::new(low.max(0.0).sqrt(), high.sqrt());
        let slope = match low > 0.0 {
            true => self.slope * Interval::new(0.5 / value.high, 0.5 / value.low),
            false => Interval::new(-STEEP, STEEP),
        };
        Some(Self { value, slope })
    }

    /// Returns the reciprocal of a function that is not negative.
    pub(super) fn reciprocal(self) -> Self {
        let Interval { low, high } = self.value;
        if low <= 0.0 {
            return Self {
                value: Interval::new(1.0 / high.max(1.0 / STEEP), STEEP),
                slope: Interval::new(-STEEP, STEEP),
            };
        }
        let value = Interval::new(1.0 / high, 1.0 / low);
        Self { value, slope: -(self.slope * value.squared()) }
    }

    /// Returns the same function if it is known to be within ±1.
    pub(super) fn of_unit(self) -> Self {
        Self { value: self.value.and(Interval::new(-1.0, 1.0)), ..self }
    }

    /// Narrows the values to those that the slopes permit from the value in the middle of the interval of the variable.
    pub(super) fn narrowed(self, variable: Interval, middle: Interval) -> Self {
        let half = variable.width() / 2.0;
        Self { value: self.value.and(middle + self.slope * Interval::new(-half, half)), ..self }
    }
}

impl Add for Enclosure {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        Self { value: self.value + other.value, slope: self.slope + other.slope }
    }
}

impl Sub for Enclosure {
    type Output = Self;

    fn sub(self, other: Self) -> Self {
        self + other * -1.0
    }
}

impl Mul for Enclosure {
    type Output = Self;

    fn mul(self, other: Self) -> Self {
        Self { value: self.value * other.value, slope: self.slope * other.value + self.value * other.slope }
    }
}

impl Add<f64> for Enclosure {
    type Output = Self;

    fn add(self, number: f64) -> Self {
        Self { value: self.value + Interval::point(number), ..self }
    }
}

impl Mul<f64> for Enclosure {
    type Output = Self;

    fn mul(self, factor: f64) -> Self {
        Self { value: self.value * factor, slope: self.slope * factor }
    }
}
