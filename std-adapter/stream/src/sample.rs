//! One cycle of a stream, as it is recorded for the plot.

/// The cycle of a controller, in seconds.
pub const CYCLE: f64 = 0.008;

/// The poses of one cycle.
#[derive(Clone, Copy, Debug)]
pub struct Sample {
    /// The time of the answer, in seconds since the first answer.
    pub at: f64,
    /// The pose that was commanded.
    pub commanded: [f64; 10],
    /// The pose that was answered.
    pub actual: [f64; 10],
}
