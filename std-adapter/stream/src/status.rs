//! The progress of a stream, which another thread shows and stops.

use std::sync::atomic::{AtomicBool, AtomicU32, Ordering::Relaxed};
use std::time::Duration;

use bcap_core::time::micros;

/// The state that the thread of a stream shares with the thread that shows it.
#[derive(Debug)]
pub struct StreamStatus {
    /// Set by the first Ctrl-C; the trajectory then ends.
    stop: AtomicBool,
    /// Set by the second Ctrl-C.
    halted: AtomicBool,
    sent: AtomicU32,
    late: AtomicU32,
    refused: AtomicU32,
    /// The margin of the controller's buffer in microseconds; `NO_MARGIN` without a buffer.
    margin: AtomicU32,
}

const NO_MARGIN: u32 = u32::MAX;

impl Default for StreamStatus {
    fn default() -> Self {
        let [sent, late, refused] = [0; 3].map(AtomicU32::new);
        let [stop, halted] = [false; 2].map(AtomicBool::new);
        Self { stop, halted, sent, late, refused, margin: AtomicU32::new(NO_MARGIN) }
    }
}

impl StreamStatus {
    /// Stops the stream after its current cycle. Returns whether this is the first call.
    pub fn stop(&self) -> bool {
        !self.stop.swap(true, Relaxed)
    }

    /// Records that the robot was halted.
    pub fn set_halted(&self) {
        self.halted.store(true, Relaxed);
    }

    /// Returns the number of poses that were sent.
    #[must_use]
    pub fn sent(&self) -> u32 {
        self.sent.load(Relaxed)
    }

    /// Returns whether the stream stops.
    #[must_use]
    pub fn is_stopped(&self) -> bool {
        self.stop.load(Relaxed)
    }

    /// Returns whether the robot was halted.
    #[must_use]
    pub fn was_halted(&self) -> bool {
        self.halted.load(Relaxed)
    }

    /// Records the progress of the stream. It is called in each cycle, so it must be short.
    pub fn update(&self, sent: u32, late: u32, refused: u32, margin: Option<Duration>) {
        self.sent.store(sent, Relaxed);
        self.late.store(late, Relaxed);
        self.refused.store(refused, Relaxed);
        let margin = margin.map_or(NO_MARGIN, |margin| u32::try_from(micros(margin)).unwrap_or(NO_MARGIN - 1));
        self.margin.store(margin, Relaxed);
    }

    /// Describes the progress: the margin of the buffer, late and refused poses.
    #[must_use]
    pub fn message(&self) -> String {
        let margin = match self.margin.load(Relaxed) {
            NO_MARGIN => String::new(),
            margin => format!("buffer {:4.1} ms, ", f64::from(margin) / 1000.0),
        };
        let stopping = if self.is_stopped() { "stopping, " } else { "" };
        format!("{stopping}{margin}late {}, refused {}", self.late.load(Relaxed), self.refused.load(Relaxed))
    }
}
