//! HALT: a thread and a connection for each robot that do nothing else, so that it waits for no other call.

use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread;

use bcap_live::link::{Access, Stopper};
use bcap_std::blocking::Halted;
use bcap_terminal::escape;
use tokio::sync::oneshot;

/// An order to the thread.
enum Order {
    /// The controller may have started again: opens the connection anew.
    Prepare,
    Halt(oneshot::Sender<Result<String, String>>),
}

/// The thread that halts a robot.
#[derive(Clone, Debug)]
pub(crate) struct Halter(Sender<Order>);

impl Halter {
    pub(crate) fn start(access: Access) -> std::io::Result<Self> {
        let (sender, orders) = channel();
        thread::Builder::new().name("halt".into()).spawn(move || run(access, &orders))?;
        Ok(Self(sender))
    }

    /// Opens the connection, so that it is there when it is needed.
    pub(crate) fn prepare(&self) {
        // without a receiver the thread has panicked, which a halt reports
        let _ = self.0.send(Order::Prepare);
    }

    /// Halts the robot. Returns the outcome, which is certain, or why the robot may still move.
    pub(crate) async fn halt(&self) -> Result<String, String> {
        self.begin().await.unwrap_or_else(|_| ended())
    }

    /// Halts the robot as [`halt`](Self::halt) does, and blocks the thread meanwhile.
    pub(crate) fn halt_now(&self) -> Result<String, String> {
        self.begin().blocking_recv().unwrap_or_else(|_| ended())
    }

    fn begin(&self) -> oneshot::Receiver<Result<String, String>> {
        let (sender, outcome) = oneshot::channel();
        // without a receiver the thread has panicked, and the outcome has no sender
        let _ = self.0.send(Order::Halt(sender));
        outcome
    }
}

fn ended() -> Result<String, String> {
    Err("NOT HALTED, use the emergency stop: the thread that halts has ended".into())
}

fn run(access: Access, orders: &Receiver<Order>) {
    let mut stopper = Stopper::new(access);
    while let Ok(first) = orders.recv() {
        let mut waiting = Vec::new();
        let mut is_renewed = false;
        // presses that came during the last halt get one outcome
        for order in std::iter::once(first).chain(orders.try_iter()) {
            match order {
                Order::Prepare => is_renewed = true,
                Order::Halt(reply) => waiting.push(reply),
            }
        }
        if !waiting.is_empty() {
            let outcome = halt(&mut stopper);
            for reply in waiting {
                // a page that is closed needs no outcome
                let _ = reply.send(outcome.clone());
            }
        } else if is_renewed {
            stopper.renew();
            // a halt tries again, and reports why
            let _ = stopper.prepare();
        }
    }
}

fn halt(stopper: &mut Stopper) -> Result<String, String> {
    match stopper.halt() {
        Ok(Halted::NothingMoved) => Ok("the robot was at rest; nothing was moving".into()),
        Ok(Halted::TasksStopped(tasks)) => Ok(format!("halted, the robot rests; {tasks}")),
        Ok(_) => Ok("halted, the robot rests".into()),
        Err(error) => Err(format!("NOT HALTED, use the emergency stop: {}", escape::line(&escape::cut(&error)))),
    }
}
