//! The options of a replay.

use std::time::Duration;

use crate::record::Recorder;

/// The options of a replay.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct Options {
    /// Makes each call as soon as the replies before it have arrived, instead of at its time.
    pub fast: bool,
    /// The time limit for connecting, and for each reply.
    pub timeout: Duration,
    /// Functions (`FUNCTION[/COMMAND]`) and objects whose values are not compared.
    pub volatile: Vec<String>,
    /// Records the replay.
    pub recorder: Option<Recorder>,
    /// Returns whether the replay is to end: no more calls are made, and each connection ends its effects on the robot.
    pub is_interrupted: Option<fn() -> bool>,
}

impl Options {
    /// Calls at their times, all values compared, nothing recorded.
    #[must_use]
    pub const fn new(timeout: Duration) -> Self {
        Self { fast: false, timeout, volatile: Vec::new(), recorder: None, is_interrupted: None }
    }
}
