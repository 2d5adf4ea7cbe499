//! What goes on beside a stream: progress on the terminal, Ctrl-C, and the halt of a second one.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering::Relaxed};
use std::sync::mpsc::{self, Receiver, RecvTimeoutError, Sender};
use std::thread::{self, JoinHandle};
use std::time::Duration;

use bcap_core::time::micros;
use indicatif::{ProgressBar, ProgressStyle};

use crate::args::LinkArgs;
use crate::error::Failure;
use crate::escape;
use crate::halt;
use crate::signal;

/// What the stream's thread and the others tell each other.
#[derive(Debug)]
pub(crate) struct Shared {
    /// Set by the first Ctrl-C; the trajectory ends then.
    stop: AtomicBool,
    /// Whether the robot was halted.
    halted: AtomicBool,
    given: AtomicU32,
    late: AtomicU32,
    refused: AtomicU32,
    /// The margin of the buffer in microseconds; `NO_MARGIN` without one.
    margin: AtomicU32,
}

const NO_MARGIN: u32 = u32::MAX;

impl Shared {
    pub(crate) fn is_stopped(&self) -> bool {
        self.stop.load(Relaxed)
    }

    pub(crate) fn was_halted(&self) -> bool {
        self.halted.load(Relaxed)
    }

    /// Takes note of how the stream goes; short, as it is called each cycle.
    pub(crate) fn note(&self, given: u32, late: u32, refused: u32, margin: Option<Duration>) {
        self.given.store(given, Relaxed);
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

/// The thread that watches over a stream.
pub(crate) struct Live {
    pub(crate) shared: Arc<Shared>,
    done: Option<Sender<()>>,
    thread: Option<JoinHandle<()>>,
}

impl Live {
    /// Begins to listen for signals and to show progress up to `cycles`.
    pub(crate) fn start(link: &LinkArgs, signals: Receiver<()>, cycles: u32) -> Result<Self, Failure> {
        let shared = Arc::new(Shared {
            stop: AtomicBool::new(false),
            halted: AtomicBool::new(false),
            given: AtomicU32::new(0),
            late: AtomicU32::new(0),
            refused: AtomicU32::new(0),
            margin: AtomicU32::new(NO_MARGIN),
        });
        let (done, ended) = mpsc::channel();
        let (link, watched) = (link.clone(), Arc::clone(&shared));
        let thread = thread::Builder::new()
            .name("live".into())
            .spawn(move || watch(&link, &watched, &signals, &ended, cycles))?;
        Ok(Self { shared, done: Some(done), thread: Some(thread) })
    }

    /// Takes the progress from the terminal.
    pub(crate) fn end(mut self) {
        self.join();
    }

    fn join(&mut self) {
        drop(self.done.take());
        if let Some(thread) = self.thread.take() {
            // a display that has panicked has said so
            let _ = thread.join();
        }
    }
}

impl Drop for Live {
    fn drop(&mut self) {
        self.join();
    }
}

fn watch(link: &LinkArgs, shared: &Shared, signals: &Receiver<()>, ended: &Receiver<()>, cycles: u32) {
    const EACH: Duration = Duration::from_millis(50);
    let bar = ProgressBar::new(cycles.into());
    let template = "{bar:30} {pos}/{len} {elapsed} {msg}";
    if let Ok(style) = ProgressStyle::with_template(template) {
        bar.set_style(style);
    }
    loop {
        match signals.recv_timeout(EACH) {
            Ok(()) if !shared.stop.swap(true, Relaxed) => {
                tell(&bar, "stopping: the robot slows down, then the arm is given back; Ctrl-C again halts it at once");
            }
            Ok(()) => {
                shared.halted.store(true, Relaxed);
                let told = match halt::halt_now(link) {
                    Ok(_) => "halted".into(),
                    Err(failure) => {
                        format!("the halt has failed: {}; use the emergency stop", escape::failure(&failure))
                    }
                };
                tell(&bar, &told);
            }
            Err(RecvTimeoutError::Timeout) => {}
            // there will be no more signals
            Err(RecvTimeoutError::Disconnected) => thread::sleep(EACH),
        }
        bar.set_position(shared.given.load(Relaxed).into());
        bar.set_message(shared.message());
        if let Err(mpsc::TryRecvError::Disconnected) = ended.try_recv() {
            bar.finish_and_clear();
            return;
        }
    }
}

/// Prints a line, above the progress where that is shown.
fn tell(bar: &ProgressBar, line: &str) {
    if bar.is_hidden() {
        anstream::eprintln!("{line}");
    } else {
        bar.println(line);
    }
}

/// Begins to listen for signals.
pub(crate) fn signals() -> Result<Receiver<()>, Failure> {
    Ok(signal::each()?)
}
