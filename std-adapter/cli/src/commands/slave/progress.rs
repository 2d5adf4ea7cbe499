//! The monitor thread of a stream: shows the progress, stops the stream on Ctrl-C, and halts the robot on a second one.

use std::sync::Arc;
use std::sync::mpsc::{self, Receiver, Sender};
use std::thread::{self, JoinHandle};
use std::time::Duration;

use bcap_stream::status::StreamStatus;
use bcap_terminal::escape;
use bcap_terminal::progress::{Progress, bar};

use crate::commands::robot::halt;
use crate::failure::Failure;
use crate::interrupt::Interrupt;
use crate::link::LinkArgs;

/// The monitor thread of a stream.
pub(crate) struct StreamMonitor {
    pub(crate) status: Arc<StreamStatus>,
    done: Option<Sender<()>>,
    thread: Option<JoinHandle<()>>,
}

impl StreamMonitor {
    /// Starts to handle signals and to show the progress up to `cycles`.
    pub(crate) fn start(link: &LinkArgs, interrupt: Interrupt, cycles: u32) -> Result<Self, Failure> {
        let status = Arc::new(StreamStatus::default());
        let (done, ended) = mpsc::channel();
        let (link, shared) = (link.clone(), Arc::clone(&status));
        let thread = thread::Builder::new()
            .name("monitor".into())
            .spawn(move || monitor(&link, &shared, &interrupt, &ended, cycles))?;
        Ok(Self { status, done: Some(done), thread: Some(thread) })
    }
}

impl Drop for StreamMonitor {
    /// Clears the progress from the terminal and ends the thread.
    fn drop(&mut self) {
        drop(self.done.take());
        if let Some(thread) = self.thread.take() {
            // a panic of the thread has printed its message
            let _ = thread.join();
        }
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
        let sent = status.sent();
        let bar = || bar(sent.into(), cycles.into());
        progress.show(|elapsed| format!("{} {sent}/{cycles} {elapsed} {}", bar(), status.message()));
        if let Err(mpsc::TryRecvError::Disconnected) = ended.try_recv() {
            return;
        }
    }
}

/// Stops the stream at the first signal, and halts the robot at the others. Returns the line that says so.
fn signalled(link: &LinkArgs, status: &StreamStatus) -> String {
    let is_first = status.stop();
    match (is_first, link.is_serial()) {
        (true, true) => "stopping: the robot slows down and the arm is released".into(),
        (true, false) => "stopping: the robot slows down and the arm is released; Ctrl-C again halts it at once".into(),
        (false, true) => {
            "a serial line carries one session, so nothing can halt the robot now; use the emergency stop".into()
        }
        (false, false) => match halt::halt_now(link) {
            Ok(_) => {
                status.set_halted();
                "halted".into()
            }
            Err(failure) => format!("the halt failed: {}; use the emergency stop", escape::failure(&failure)),
        },
    }
}
