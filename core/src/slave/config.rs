//! How an engine streams.

use core::fmt;
use core::time::Duration;

use super::format::{Format, FormatError};
use super::limits::AxisLimits;
use super::pose::Pose;
use crate::error::EncodeError;
use crate::procedure::Handles;
use crate::time::micros_u32;

/// How an [`Engine`](super::Engine) streams; [`new`](Self::new) gives values that suit most robots.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Config {
    /// The mode, and what is sent and received.
    pub format: Format,
    /// The handles of the connection that moves the robot.
    pub motion: Handles,
    /// The handles of a second connection, over which the controller's errors are read; `None` reads them over the first.
    pub watch: Option<Handles>,
    /// The control cycle: 8 ms.
    pub cycle: Duration,
    /// The arm group and the Keep of TakeArm; `None` when the client has the arm already, and keeps it.
    pub arm: Option<[i32; 2]>,
    /// Whether to switch the motor on.
    pub motor: bool,
    /// Where the robot has to stand before the stream begins; `None` accepts where it stands.
    pub start: Option<Pose>,
    /// By how much each number of `start` may be missed, in mm or degrees.
    pub tolerance: f64,
    /// What is refused before it is sent.
    pub limits: AxisLimits,
    /// How long a stop slows down at least; longer when the limits want it.
    pub ramp: Duration,
    /// How many joints the robot has: what the controller answers for others is not looked at.
    pub joints: u8,
    /// How late after its time a pose counts as late.
    pub late_after: Duration,
    /// For how long the controller may answer E_BUF_FULL before the stream is given up.
    pub stall: Duration,
}

impl Config {
    /// Takes the arm (group 0) and switches the motor on; no limits, no expected start, six joints, no second connection.
    ///
    /// A stop slows down within 200 ms; poses are late after half a cycle, and the stream is given up after 1 s of
    /// E_BUF_FULL.
    #[must_use]
    pub const fn new(format: Format, motion: Handles) -> Self {
        Self {
            format,
            motion,
            watch: None,
            cycle: Duration::from_millis(8),
            arm: Some([0, 1]),
            motor: true,
            start: None,
            tolerance: 0.05,
            limits: AxisLimits::NONE,
            ramp: Duration::from_millis(200),
            joints: 6,
            late_after: Duration::from_millis(4),
            stall: Duration::from_secs(1),
        }
    }

    /// Returns so many cycles.
    ///
    /// In microseconds: `Duration`'s own products leave a panic in the image.
    pub(super) fn cycles(&self, count: u32) -> Duration {
        Duration::from_micros(u64::from(micros_u32(self.cycle)).wrapping_mul(u64::from(count)))
    }

    /// Tells whether every number can be compared: what is not one is within any bound.
    pub(super) fn has_numbers(&self) -> bool {
        let bounds = self.limits.speed.iter().chain(&self.limits.acceleration).chain([&self.tolerance]);
        self.start.is_none_or(|start| start.is_finite()) && !bounds.copied().any(f64::is_nan)
    }

    /// Returns the cycle in seconds.
    pub(super) const fn seconds(&self) -> f64 {
        self.cycle.as_secs_f64()
    }
}

/// An engine cannot be made.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum ConfigError {
    /// The start does not have the layout of the format.
    Start(FormatError),
    /// The frame of slvMove does not fit the engine's memory: give its `N` more bytes.
    Frame(EncodeError),
    /// The cycle is below one microsecond.
    Cycle,
    /// The start has a number that is not finite, or the tolerance or a limit is NaN: every pose would be within it.
    Number,
}

impl fmt::Display for ConfigError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Start(error) => write!(f, "the start of the stream: {error}"),
            Self::Frame(error) => write!(f, "the frame of slvMove: {error}"),
            Self::Cycle => f.write_str("the cycle is too short"),
            Self::Number => f.write_str("the start, the tolerance or a limit is not a number"),
        }
    }
}

impl core::error::Error for ConfigError {}
