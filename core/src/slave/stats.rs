//! Figures on how well a stream runs, in fixed counters.

use core::time::Duration;

/// A histogram of times in microseconds, up to two seconds; a quantile is right within an eighth.
pub type Histogram = crate::histogram::Histogram<8, 152>;

/// Counts since the start of a stream; they saturate.
#[derive(Clone, Debug, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Stats {
    /// Poses that the controller took.
    pub cycles: u32,
    /// Poses that were sent later after their deadline than [`Config::late_after`](super::Config::late_after).
    pub late: u32,
    /// Answers E_BUF_FULL; the pose was sent again.
    pub refused: u32,
    /// Errors 0x84201482: the buffer was empty while the robot moved.
    pub underflows: u32,
    /// The least time that the controller's buffer would have lasted when a pose was sent, as this side estimates it;
    /// `None` before the buffer was full once, and in mode 1.
    pub least_margin: Option<Duration>,
    /// Round trips: from sending a pose to its reply.
    pub rtt: Histogram,
    /// Jitter: how far from its deadline a pose was sent; in mode 2, how far the interval was from the cycle.
    pub jitter: Histogram,
}
