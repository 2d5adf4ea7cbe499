//! Replays the calls of a capture, and compares the replies.
//!
//! ```text
//!  plan   the capture  -> connections with their calls; the calls that each call waits for; the calls to allow
//!  order  lets a call begin when the calls that were answered before it have been answered again
//!  link   a thread for each connection: handles are replaced, calls made, replies compared
//!  report a difference as text or JSON
//! ```
//!
//! # Examples
//!
//! ```no_run
//! use std::net::SocketAddr;
//! use std::time::Duration;
//!
//! use bcap_capture::replay::{Options, Plan};
//! use bcap_capture::decode;
//! use bcap_capture::proxy::Robot;
//! use bcap_core::limits::Strictness;
//!
//! let (events, read) = decode::events("session.pcapng".as_ref(), Strictness::Lenient);
//! read?;
//! let plan = Plan::new(events)?;
//! // refuses calls that may move or write
//! plan.check(&[])?;
//! let address: SocketAddr = ([192, 168, 0, 1], 5007).into();
//! let robot = Robot { tcp: vec![address], udp: address, rac: vec![] };
//! let totals = plan.run(&robot, &Options::new(Duration::from_secs(3)), |outcome| {
//!     if outcome.is_different {
//!         println!("{outcome}");
//!     }
//!     Ok(())
//! })?;
//! println!("{totals}");
//! # Ok::<(), bcap_capture::Error>(())
//! ```

mod link;
mod options;
mod order;
mod plan;
mod report;

use std::io;
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::sync::{Mutex, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

use self::link::LinkReplay;
pub use self::link::{Came, Outcome};
pub use self::options::Options;
use self::order::Order;
pub use self::plan::Plan;
pub use self::report::Totals;
use crate::error::Error;
use crate::proxy::Robot;

impl Plan {
    /// Makes the calls, and passes the outcome of each to `each`. An error of `each` ends the replay: no more calls are made.
    ///
    /// It does not check which calls are allowed; [`Plan::check`] does. The end of each connection halts the robot, switches the
    /// motor off and gives the arm back, as far as its calls have made that necessary.
    ///
    /// # Errors
    ///
    /// [`Error::NotEnded`] if the end of a connection failed. Otherwise when a thread cannot be started, when the replay is
    /// interrupted, and the error of `each`.
    pub fn run(
        &self,
        robot: &Robot,
        options: &Options,
        mut each: impl FnMut(&Outcome<'_>) -> io::Result<()>,
    ) -> Result<Totals, Error> {
        let order = Order::new(self.answered);
        let began = (!options.fast).then(Instant::now);
        let failed_ends = Mutex::default();
        let mut totals = Totals { connections: self.links.len(), ..Totals::default() };
        let done = thread::scope(|scope| {
            let (outcomes, received) = channel();
            let start = || {
                self.links.iter().try_for_each(|planned| {
                    let (outcomes, order, failed_ends) = (outcomes.clone(), &order, &failed_ends);
                    let link = LinkReplay { planned, robot, order, began, options, failed_ends };
                    thread::Builder::new().spawn_scoped(scope, move || link.run(&outcomes)).map(drop)
                })
            };
            let started =
                start().map_err(|error| Error::Replay(format!("cannot start a thread for each connection: {error}")));
            drop(outcomes);
            let done = started.and_then(|()| {
                while let Some(outcome) = next(&received, options)? {
                    totals.count(&outcome);
                    each(&outcome)?;
                }
                Ok(())
            });
            if done.is_err() {
                // the robot must not move while the caller cannot see the replay
                order.stop();
            }
            done
        });
        let failed_ends = failed_ends.into_inner().unwrap_or_else(PoisonError::into_inner);
        if !failed_ends.is_empty() {
            return Err(Error::NotEnded(failed_ends.join("; ")));
        }
        done.map(|()| totals)
    }
}

/// The interval at which a replay checks for an interruption.
const LOOK: Duration = Duration::from_millis(20);

/// Waits for the next outcome; `None` at the end of all connections.
fn next<'a>(received: &Receiver<Outcome<'a>>, options: &Options) -> Result<Option<Outcome<'a>>, Error> {
    loop {
        if options.is_interrupted.is_some_and(|is_interrupted| is_interrupted()) {
            return Err(Error::Replay("interrupted".into()));
        }
        match received.recv_timeout(LOOK) {
            Ok(outcome) => return Ok(Some(outcome)),
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => return Ok(None),
        }
    }
}
