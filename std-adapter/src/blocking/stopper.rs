//! Halting a robot over a separate connection.

use std::io;
use std::sync::{Arc, Mutex, PoisonError};

use super::Transport;
use super::socket::{self, Blocking, BlockingConnection, ready};
use crate::address::Address;
use crate::error::Error;
use crate::session::{Halted, Session};
use crate::settings::Settings;

/// Halts the robot from any thread, even while another call of the [`Controller`](super::Controller) waits.
///
/// It has a separate connection and session, which are open before they are needed. It is not an emergency stop: it needs the
/// network, this computer and the controller.
///
/// # Examples
///
/// ```no_run
/// use bcap_std::Settings;
/// use bcap_std::blocking::Stopper;
///
/// // a guard that halts the robot when a light curtain is broken, even if another client moves the robot
/// let stopper = Stopper::connect("tcp:192.168.0.1", &Settings::rc9())?;
/// let other = stopper.clone();
/// std::thread::spawn(move || println!("{:?}", other.halt()));
/// # Ok::<(), bcap_std::Error>(())
/// ```
#[derive(Clone, Debug)]
pub struct Stopper {
    session: Arc<Mutex<StopperSession>>,
}

#[derive(Debug)]
struct StopperSession {
    /// `None` over a stream of the caller.
    address: Option<Address>,
    settings: Settings,
    session: Session<Blocking>,
}

impl Stopper {
    /// Connects to the controller at an [`Address`], and opens the robot of the settings. A program that moves the robot
    /// itself calls [`Controller::stopper`](super::Controller::stopper).
    ///
    /// # Errors
    ///
    /// An [`Error`] for a wrong address, a failed connection, or a refused call.
    pub fn connect(address: &str, settings: &Settings) -> Result<Self, Error> {
        Self::open(&address.parse()?, settings)
    }

    pub(super) fn open(address: &Address, settings: &Settings) -> Result<Self, Error> {
        match address {
            Address::Serial(_) => Err(Error::NoSecondSession),
            address => Ok(Self::of(StopperSession::connect(address, settings)?)),
        }
    }

    /// Starts the session of a stopper over a stream of the caller. It does not connect again.
    ///
    /// # Errors
    ///
    /// An [`Error`] for a refused call, or one without a reply.
    pub fn over(
        stream: impl Transport<Error = io::Error> + Send + 'static,
        settings: &Settings,
    ) -> Result<Self, Error> {
        Ok(Self::of(StopperSession::open(socket::over(stream, settings), None, settings)?))
    }

    fn of(session: StopperSession) -> Self {
        Self { session: Arc::new(Mutex::new(session)) }
    }

    /// Halts the robot, and waits until it rests. If the connection is lost, the halt has no reply, or the controller has
    /// ended the session, it connects again once.
    ///
    /// A controller refuses a halt while one of its tasks owns the arm. Then all tasks are stopped (KillAll, or Task_Stop of each
    /// task if KillAll is refused or has no effect), and the robot is halted again: [`Halted::TasksStopped`]. Each starts at its first
    /// line when it is started again. Rest is not assumed: the robot is polled until it rests, at most for one second after each means.
    ///
    /// # Errors
    ///
    /// An [`Error`]; the robot may still move. [`Error::NotHalted`] if the robot still moved, or the halt stays
    /// refused.
    pub fn halt(&self) -> Result<Halted, Error> {
        // a panic cannot leave the session in a state that prevents a halt
        let mut session = self.session.lock().unwrap_or_else(PoisonError::into_inner);
        match (ready(session.session.halt_and_verify()), session.address.clone()) {
            (Err(error), Some(address)) if error.ends_session() => {
                let new = StopperSession::connect(&address, &session.settings)?;
                let old = std::mem::replace(&mut *session, new);
                let halted = ready(session.session.halt_and_verify());
                // its end may wait for a controller that does not answer
                drop(old);
                halted
            }
            (ended, _) => ended,
        }
    }
}

impl StopperSession {
    fn connect(address: &Address, settings: &Settings) -> Result<Self, Error> {
        Self::open(socket::connect(address, settings)?, Some(address.clone()), settings)
    }

    fn open(connection: BlockingConnection, address: Option<Address>, settings: &Settings) -> Result<Self, Error> {
        let mut session = ready(Session::start(connection, settings))?;
        // opened now, so that a halt does not wait for it
        let opened = ready(session.robot());
        let stopper = Self { address, settings: settings.clone(), session };
        opened.map(|_| stopper)
    }
}

impl Drop for StopperSession {
    fn drop(&mut self) {
        // a server releases the objects of a client that ends without notice
        let _ = ready(self.session.release());
    }
}
