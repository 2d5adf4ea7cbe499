//! Halting a robot over a connection of its own.

use std::io;
use std::sync::{Arc, Mutex, PoisonError};

use bcap_core::bcap::FunctionId;
use bcap_core::bcap::call;
use bcap_core::hresult::HResult;
use bcap_core::procedure::{self, Handles};

use super::session::open_robot;
use super::socket::{self, Socket};
use super::{Connection, Transport};
use crate::address::Address;
use crate::error::Error;
use crate::settings::Settings;

/// Halts the robot from any thread, also while another call of the [`Controller`](super::Controller) waits.
///
/// It has a connection and a session of its own, which are open before they are needed. It is not an emergency stop: it
/// needs the network, this computer and the controller.
#[derive(Clone, Debug)]
pub struct Stopper {
    session: Arc<Mutex<StopperSession>>,
}

/// The effect of [`Stopper::halt`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[must_use]
pub enum Halted {
    /// The robot was moving, and has been halted.
    Halted,
    /// The robot was not moving.
    NothingMoved,
}

#[derive(Debug)]
struct StopperSession {
    /// `None` over a stream of the caller.
    address: Option<Address>,
    settings: Settings,
    connection: Connection<Socket, Vec<u8>>,
    handles: Handles,
}

impl Stopper {
    pub(super) fn connect(address: &Address, settings: &Settings) -> Result<Self, Error> {
        Ok(Self::of(StopperSession::connect(address, settings)?))
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

    /// Halts the robot, and waits until it rests. If the connection is lost, it connects again once.
    ///
    /// # Errors
    ///
    /// An [`Error`]; the robot may still move.
    pub fn halt(&self) -> Result<Halted, Error> {
        // a panic cannot leave the session in a state that prevents a halt
        let mut session = self.session.lock().unwrap_or_else(PoisonError::into_inner);
        match (session.halt(), session.address.clone()) {
            (Err(error), Some(address)) if error.is_lost() => {
                *session = StopperSession::connect(&address, &session.settings)?;
                session.halt()
            }
            (ended, _) => ended,
        }
    }
}

impl StopperSession {
    fn connect(address: &Address, settings: &Settings) -> Result<Self, Error> {
        Self::open(socket::connect(address, settings)?, Some(address.clone()), settings)
    }

    fn open(
        mut connection: Connection<Socket, Vec<u8>>,
        address: Option<Address>,
        settings: &Settings,
    ) -> Result<Self, Error> {
        let handles = open_robot(&mut connection, settings)?;
        Ok(Self { address, settings: settings.clone(), connection, handles })
    }

    fn halt(&mut self) -> Result<Halted, Error> {
        let halted = self.connection.call(call::robot_halt(self.handles.robot, "")).map(drop);
        halted.map_err(|error| Error::call(FunctionId::ROBOT_HALT, "the robot", error))?;
        Ok(match self.connection.last_result() {
            Some(HResult::S_FALSE) => Halted::NothingMoved,
            _ => Halted::Halted,
        })
    }
}

impl Drop for StopperSession {
    fn drop(&mut self) {
        // a server releases the objects of a client that does not say goodbye
        let _ = self.connection.run(procedure::release_robot(self.handles));
    }
}
