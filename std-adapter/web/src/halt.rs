//! HALT: each robot has a separate thread and connection for it, so that it does not wait for other calls.

use std::iter::once;
use std::mem::replace;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Mutex};
use std::thread;

use bcap_live::link::{Access, Stopper};
use bcap_std::blocking::Halted;
use tokio::sync::oneshot;

use crate::text::safe;
use crate::threads::lock;

/// The outcome of a halt: the robot was seen at rest, or why it may still move.
pub(crate) type Outcome = Result<String, String>;

/// The outcome of a halt of a robot at rest.
pub(crate) const AT_REST: &str = "the robot was at rest; nothing was moving";

/// A press of HALT, which waits for its outcome.
type Press = oneshot::Sender<Outcome>;

/// The thread that halts a robot, and its session.
#[derive(Clone)]
pub(crate) struct Halter {
    presses: Sender<Press>,
    /// Locked during a halt.
    stopper: Arc<Mutex<Stopper>>,
    access: Access,
}

impl Halter {
    pub(crate) fn start(access: Access) -> std::io::Result<Self> {
        let (sender, presses) = channel();
        let stopper = Arc::new(Mutex::new(Stopper::new(access.clone())));
        let shared = Arc::clone(&stopper);
        thread::Builder::new().name("halt".into()).spawn(move || run(&shared, &presses))?;
        Ok(Self { presses: sender, stopper, access })
    }

    /// Opens a new session for the next halt, because the controller may have started again. A halt does not wait for it.
    pub(crate) fn prepare(&self) {
        let mut opened = Stopper::new(self.access.clone());
        if opened.prepare().is_err() {
            // the last session may still exist; a halt replaces a lost session, or reports why it cannot
            return;
        }
        // a running halt replaces a lost session itself
        let last = self.stopper.try_lock().map(|mut stopper| replace(&mut *stopper, opened));
        drop(last);
    }

    /// Halts the robot.
    pub(crate) async fn halt(&self) -> Outcome {
        self.begin().await.unwrap_or_else(|_| ended())
    }

    /// Halts the robot as [`halt`](Self::halt) does, but blocks the thread.
    pub(crate) fn halt_now(&self) -> Outcome {
        self.begin().blocking_recv().unwrap_or_else(|_| ended())
    }

    fn begin(&self) -> oneshot::Receiver<Outcome> {
        let (sender, outcome) = oneshot::channel();
        // without a receiver the thread has panicked, and the outcome has no sender
        let _ = self.presses.send(sender);
        outcome
    }
}

fn ended() -> Outcome {
    Err("NOT HALTED, use the emergency stop: the thread that halts has ended".into())
}

fn run(stopper: &Mutex<Stopper>, presses: &Receiver<Press>) {
    while let Ok(first) = presses.recv() {
        // presses that arrived during the last halt get one outcome
        let all: Vec<_> = once(first).chain(presses.try_iter()).collect();
        let outcome = halt(&mut lock(stopper));
        for press in all {
            // a page that is closed needs no outcome
            let _ = press.send(outcome.clone());
        }
    }
}

fn halt(stopper: &mut Stopper) -> Outcome {
    match stopper.halt() {
        Ok(Halted::NothingMoved) => Ok(AT_REST.into()),
        Ok(Halted::TasksStopped(tasks)) => Ok(format!("halted, the robot rests; {tasks}")),
        Ok(_) => Ok("halted, the robot rests".into()),
        Err(error) => Err(format!("NOT HALTED, use the emergency stop: {}", safe(&error))),
    }
}
