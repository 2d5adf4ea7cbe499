//! The configuration of an engine.

use core::fmt;
use core::time::Duration;

use super::format::{Format, FormatError};
use super::limits::AxisLimits;
use super::pose::Pose;
use crate::error::EncodeError;
use crate::procedure::Handles;
use crate::time::micros_u32;

/// The configuration of an [`Engine`](super::Engine); [`new`](Self::new) returns values that suit most robots.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Config {
    /// The mode, and the layout of slvMove and its reply.
    pub format: Format,
    /// The handles of the connection that moves the robot.
    pub motion: Handles,
    /// The handles of a second connection, over which the engine reads the controller's errors; `None` uses the first.
    pub watch: Option<Handles>,
    /// The control cycle: 8 ms.
    pub cycle: Duration,
    /// The arm group and Keep of TakeArm; `None` when the client already owns the arm, and keeps it.
    pub arm: Option<[i32; 2]>,
    /// Whether to switch the motor on.
    pub motor: bool,
    /// Whether to switch the motor off at the end if [`motor`](Self::motor) is set, even if it was on before the stream.
    pub motor_off: bool,
    /// The required position of the robot at the start of the stream; `None` accepts any position.
    pub start: Option<Pose>,
    /// The tolerance of each value of `start`, in mm or degrees.
    pub tolerance: f64,
    /// The limits on speed and acceleration; poses that exceed them are not sent.
    pub limits: AxisLimits,
    /// Minimum duration of the ramp of a stop; longer if the limits require it.
    pub ramp: Duration,
    /// The number of joints of the robot; the engine ignores the values of others in replies.
    pub joints: u8,
    /// How long after its deadline a pose counts as late.
    pub late_after: Duration,
    /// For how long the controller may reply E_BUF_FULL before the stream fails.
    pub stall: Duration,
}

impl Config {
    /// Takes the arm (group 0) and switches the motor on, and off at the end; no limits, no expected start, six joints, no
    /// second connection.
    ///
    /// A stop slows down within 200 ms; poses are late after half a cycle, and the stream fails after 1 s of E_BUF_FULL.
    #[must_use]
    pub const fn new(format: Format, motion: Handles) -> Self {
        Self {
            format,
            motion,
            watch: None,
            cycle: Duration::from_millis(8),
            arm: Some([0, 1]),
            motor: true,
            motor_off: true,
            start: None,
            tolerance: 0.05,
            limits: AxisLimits::NONE,
            ramp: Duration::from_millis(200),
            joints: 6,
            late_after: Duration::from_millis(4),
            stall: Duration::from_secs(1),
        }
    }

    /// Returns the duration of `count` cycles.
    ///
    /// It multiplies microseconds, because the multiplication of `Duration` can panic.
    pub(super) fn cycles(&self, count: u32) -> Duration {
        Duration::from_micros(u64::from(micros_u32(self.cycle)).wrapping_mul(u64::from(count)))
    }

    /// Returns whether no number is NaN, which would pass every comparison, and the start is finite.
    pub(super) fn has_numbers(&self) -> bool {
        let bounds = self.limits.speed.iter().chain(&self.limits.acceleration).chain([&self.tolerance]);
        self.start.is_none_or(|start| start.is_finite()) && !bounds.copied().any(f64::is_nan)
    }

    /// Returns the cycle in seconds.
    pub(super) const fn seconds(&self) -> f64 {
        self.cycle.as_secs_f64()
    }
}

/// The configuration of an engine is invalid.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum ConfigError {
    /// The start does not have the layout of the format.
    Start(FormatError),
    /// The frame of slvMove does not fit the engine's buffer: increase its `N`.
    Frame(EncodeError),
    /// The cycle is below one microsecond.
    Cycle,
    /// The start has a value that is not finite, or the tolerance or a limit is NaN, which every pose would pass.
    Number,
}

impl fmt::Display for ConfigError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Start(error) => write!(f, "the start of the stream: {error}"),
            Self::Frame(error) => write!(f, "the frame of slvMove: {error}"),
            Self::Cycle => f.write_str("the cycle is below one microsecond"),
            Self::Number => f.write_str("the start is not finite, or the tolerance or a limit is not a number"),
        }
    }
}

impl core::error::Error for ConfigError {}
