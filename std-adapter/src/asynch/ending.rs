//! The end of a controller's task, however it ends.
//!
//! A runtime that ends drops its tasks where they wait. So does a panic in a function that a task runs. Dropping
//! [`Open`] then halts the robot, switches the motor off and gives the arm back, with calls that block.

use std::sync::Arc;

use super::socket::Socket;
use crate::address::Address;
use crate::blocking::ending;
use crate::error::Error;
use crate::recovery::Recovery;
use crate::session::{self, Session};
use crate::settings::Settings;

/// The session of a task, and the remaining effects of a lost session.
pub(super) struct Open {
    pub(super) session: Option<Session<Socket>>,
    /// The possible effects of a lost session on the robot, until a new session has ended them.
    pub(super) left: Option<LostSessions>,
    address: Option<Address>,
    settings: Arc<Settings>,
}

/// Lost sessions, and their possible effects on the robot.
pub(super) struct LostSessions {
    state: session::Left,
    /// The lost sessions that the controller keeps alive until their services are stopped. The last session has the effects.
    sessions: Vec<Session<Socket>>,
}

/// The maximum number of lost sessions that are kept; the oldest ones are dropped.
const SESSIONS: usize = 8;

impl LostSessions {
    /// Ends the effects over a new session.
    pub(super) async fn recover(&mut self, over: &mut Session<Socket>) -> Result<Recovery, Error> {
        let Self { state, sessions } = self;
        let stop = async {
            // each is removed after its end, so that an interrupted recovery skips none
            for index in (0..sessions.len()).rev() {
                if let Some(lost) = sessions.get_mut(index)
                    && lost.stop_lost_service().await
                {
                    sessions.remove(index);
                }
            }
        };
        over.recover(*state, stop).await
    }

    /// Adds a session that was lost before it had recovered the robot: it may have taken the arm.
    pub(super) fn add(&mut self, mut session: Session<Socket>) {
        if session.outlasts_its_link() {
            if self.sessions.len() == SESSIONS {
                self.sessions.remove(0);
            }
            self.sessions.push(session);
        }
    }
}

impl Open {
    pub(super) fn new(session: Option<Session<Socket>>, address: Option<&Address>, settings: &Settings) -> Self {
        Self { session, left: None, address: address.cloned(), settings: Arc::new(settings.clone()) }
    }

    /// Drops a lost session, but keeps its possible effects on the robot.
    pub(super) fn lose(&mut self) {
        if let Some(mut session) = self.session.take()
            && let Some(state) = session.take_left()
        {
            let mut left = LostSessions { state, sessions: Vec::new() };
            left.add(session);
            self.left = Some(left);
        }
    }
}

impl Open {
    /// Ends the effects that this session, or an earlier lost session, has left on the robot, once, with calls that block.
    /// Returns `None` without such effects, and an error unless their end was verified.
    pub(super) fn end_now(&mut self) -> Option<Result<(), Error>> {
        let Self { session, left, address, settings } = self;
        // a session that has changed nothing ends with its connection, if it has one
        session.take_if(|session| !session.uses_robot() && !session.outlasts_its_link());
        let mut session = session.take();
        let of_session =
            session.as_mut().and_then(Session::left).map(|state| LostSessions { state, sessions: Vec::new() });
        let over = |session: Session<Socket>| session.over(|socket| socket.into_blocking(address.as_ref()));
        match (session.and_then(over), left.take().or(of_session), &*address) {
            (Some(mut session), ..) => Some(ending::end_now(&mut session, address.as_ref(), settings).robot),
            (None, Some(LostSessions { state, sessions }), Some(address)) => {
                let mut lost: Vec<_> = sessions.into_iter().filter_map(over).collect();
                Some(ending::recover_now(address, settings, state, &mut lost))
            }
            (None, Some(_), None) => {
                tracing::error!("the connection was lost, and the robot may be moving");
                Some(Err(Error::NotEnded(Recovery::default())))
            }
            (None, None, _) => None,
        }
    }
}

impl Drop for Open {
    fn drop(&mut self) {
        // it has logged its error
        let _ = self.end_now();
    }
}
