//! The monitor thread of a stream: shows the progress, stops the stream on Ctrl-C, and halts the robot on a second one.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering::Relaxed};
use std::sync::mpsc::{self, Receiver, Sender};
use std::thread::{self, JoinHandle};
use std::time::Duration;

use bcap_core::time::micros;
use bcap_terminal::escape;
use bcap_terminal::progress::{Progress, bar};

use crate::commands::robot::halt;
use crate::failure::Failure;
use crate::interrupt::Interrupt;
use crate::link::LinkArgs;

/// The state that the stream's thread and the monitor share.
#[derive(Debug)]
pub(crate) struct StreamStatus {
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

impl StreamStatus {
    pub(crate) fn is_stopped(&self) -> bool {
        self.stop.load(Relaxed)
    }

    pub(crate) fn was_halted(&self) -> bool {
        self.halted.load(Relaxed)
    }

    /// Records the progress of the stream. It is called in each cycle, so it must be short.
    pub(crate) fn update(&self, sent: u32, late: u32, refused: u32, margin: Option<Duration>) {
        self.sent.store(sent, Relaxed);
        self.late.store(late, Relaxed);
        self.refused.store(refused, Relaxed);
        let margin = margin.map_or(NO_MARGIN, |margin| u32::try_from(micros(margin)).unwrap_or(NO_MARGIN - 1));
        self.margin.store(margin, Relaxed);
    }

    fn message(&self) -> String {
        let margin = match self.margin.load(Relaxed) {
            NO_MARGIN => String::new(),
            margin => format!("buffer {:4.1} ms, ", f64::from(margin) / 1000.0),
        };
        let stopping = if self.is_stopped() { "stopping, " } else { "" };
        format!("{stopping}{margin}late {}, refused {}", self.late.load(Relaxed), self.refused.load(Relaxed))
    }
}

/// The monitor thread of a stream.
pub(crate) struct Monitor {
    pub(crate) status: Arc<StreamStatus>,
    done: Option<Sender<()>>,
    thread: Option<JoinHandle<()>>,
}

impl Monitor {
    /// Starts to handle signals and to show the progress up to `cycles`.
    pub(crate) fn start(link: &LinkArgs, interrupt: Interrupt, cycles: u32) -> Result<Self, Failure> {
        let status = Arc::new(StreamStatus {
            stop: AtomicBool::new(false),
            halted: AtomicBool::new(false),
            sent: AtomicU32::new(0),
            late: AtomicU32::new(0),
            refused: AtomicU32::new(0),
            margin: AtomicU32::new(NO_MARGIN),
        });
        let (done, ended) = mpsc::channel();
        let (link, shared) = (link.clone(), Arc::clone(&status));
        let thread = thread::Builder::new()
            .name("monitor".into())
            .spawn(move || monitor(&link, &shared, &interrupt, &ended, cycles))?;
        Ok(Self { status, done: Some(done), thread: Some(thread) })
    }

    /// Clears the progress from the terminal and ends the thread.
    pub(crate) fn end(mut self) {
        self.join();
    }

    fn join(&mut self) {
        drop(self.done.take());
        if let Some(thread) = self.thread.take() {
            // a panic of the thread has printed its message
            let _ = thread.join();
        }
    }
}

impl Drop for Monitor {
    fn drop(&mut self) {
        self.join();
    }
}

fn monitor(link: &LinkArgs, status: &StreamStatus, interrupt: &Interrupt, ended: &Receiver<()>, cycles: u32) {
    const INTERVAL: Duration = Duration::from_millis(50);
    let (mut progress, mut handled) = (Progress::default(), 0);
    loop {
        if interrupt.wait_for(handled + 1, INTERVAL) > handled {
            handled += 1;
            progress.print(&signalled(link, status));
        }
        let sent = status.sent.load(Relaxed);
        let bar = || bar(sent.into(), cycles.into());
        progress.show(|elapsed| format!("{} {sent}/{cycles} {elapsed} {}", bar(), status.message()));
        if let Err(mpsc::TryRecvError::Disconnected) = ended.try_recv() {
            return;
        }
    }
}

/// Stops the stream at the first signal, and halts the robot at the others. Returns the line that says so.
fn signalled(link: &LinkArgs, status: &StreamStatus) -> String {
    let is_first = !status.stop.swap(true, Relaxed);
    match (is_first, link.is_serial()) {
        (true, true) => "stopping: the robot slows down and the arm is released".into(),
        (true, false) => "stopping: the robot slows down and the arm is released; Ctrl-C again halts it at once".into(),
        (false, true) => {
            "a serial line carries one session, so nothing can halt the robot now; use the emergency stop".into()
        }
        (false, false) => {
            status.halted.store(true, Relaxed);
            match halt::halt_now(link) {
                Ok(_) => "halted".into(),
                Err(failure) => format!("the halt failed: {}; use the emergency stop", escape::failure(&failure)),
            }
        }
    }
}
