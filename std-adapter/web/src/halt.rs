//! HALT: a thread and a connection for each robot that do nothing else, so that it waits for no other call.

use std::iter::once;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread;

use bcap_live::link::{Access, Stopper};
use bcap_std::blocking::Halted;
use tokio::sync::oneshot;

use crate::text::safe;

/// The outcome of a halt, which is certain, or why the robot may still move.
pub(crate) type Outcome = Result<String, String>;

/// The outcome of a halt that had nothing to stop.
pub(crate) const AT_REST: &str = "the robot was at rest; nothing was moving";

/// An order to the thread: a halt with the receiver of its outcome, or `None` to open the connection anew.
type Order = Option<oneshot::Sender<Outcome>>;

/// The thread that halts a robot.
#[derive(Clone)]
pub(crate) struct Halter(Sender<Order>);

impl Halter {
    pub(crate) fn start(access: Access) -> std::io::Result<Self> {
        let (sender, orders) = channel();
        thread::Builder::new().name("halt".into()).spawn(move || run(access, &orders))?;
        Ok(Self(sender))
    }

    /// Opens the connection anew, so that it is there when it is needed: the controller may have started again.
    pub(crate) fn prepare(&self) {
        // without a receiver the thread has panicked, which a halt reports
        let _ = self.0.send(None);
    }

    /// Halts the robot.
    pub(crate) async fn halt(&self) -> Outcome {
        self.begin().await.unwrap_or_else(|_| ended())
    }

    /// Halts the robot as [`halt`](Self::halt) does, and blocks the thread meanwhile.
    pub(crate) fn halt_now(&self) -> Outcome {
        self.begin().blocking_recv().unwrap_or_else(|_| ended())
    }

    fn begin(&self) -> oneshot::Receiver<Outcome> {
        let (sender, outcome) = oneshot::channel();
        // without a receiver the thread has panicked, and the outcome has no sender
        let _ = self.0.send(Some(sender));
        outcome
    }
}

fn ended() -> Outcome {
    Err("NOT HALTED, use the emergency stop: the thread that halts has ended".into())
}

fn run(access: Access, orders: &Receiver<Order>) {
    let mut stopper = Stopper::new(access);
    while let Ok(first) = orders.recv() {
        // presses that came during the last halt get one outcome
        let presses: Vec<_> = once(first).chain(orders.try_iter()).flatten().collect();
        if presses.is_empty() {
            stopper.renew();
            // a halt tries again, and reports why
            let _ = stopper.prepare();
            continue;
        }
        let outcome = halt(&mut stopper);
        for press in presses {
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
