//! Statistics of a stream: counters, round trips and jitter.

use core::time::Duration;

/// A histogram of times in microseconds, up to two seconds; a quantile is at most an eighth above the true one.
pub type Histogram = crate::histogram::Histogram<8, 152>;

/// Counts since the start of a stream; they saturate.
#[derive(Clone, Debug, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub struct Stats {
    /// Poses that the controller stored.
    pub cycles: u32,
    /// Poses that were sent more than [`Config::late_after`](super::Config::late_after) after their deadline.
    pub late: u32,
    /// Replies E_BUF_FULL; the engine sent the pose again.
    pub refused: u32,
    /// Errors 0x84201482: the buffer was empty while the robot moved.
    pub underflows: u32,
    /// The minimum of the estimated time that the controller's buffer would have lasted when a pose was sent; `None` before
    /// the buffer was full once, and in mode 1.
    pub least_margin: Option<Duration>,
    /// Round trips: from sending a pose to its reply.
    pub rtt: Histogram,
    /// Jitter: how far from its deadline a pose was sent; in mode 2, how far the interval was from the cycle.
    pub jitter: Histogram,
}
