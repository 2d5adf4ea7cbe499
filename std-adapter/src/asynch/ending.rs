//! The end of a controller's task, however it ends.
//!
//! A runtime that ends drops its tasks where they wait. So does a panic in a function that a task runs. Dropping
//! [`Open`] then halts the robot, switches the motor off and gives the arm back, with calls that block.

use std::sync::Arc;

use super::socket::Socket;
use crate::address::Address;
use crate::blocking::ending;
use crate::error::Error;
use crate::session::{self, Recovery, Session};
use crate::settings::Settings;

/// The session of a task, and the effects that a lost session left behind.
pub(super) struct Open {
    pub(super) session: Option<Session<Socket>>,
    /// The possible effects of a lost session on the robot, until a new session has ended them.
    pub(super) left: Option<Left>,
    address: Option<Address>,
    settings: Arc<Settings>,
}

/// The possible effects of a lost session on the robot.
pub(super) struct Left {
    state: session::Left,
    /// The lost session, if the controller keeps it alive until its service is stopped.
    session: Option<Session<Socket>>,
}

impl Left {
    /// Ends the effects over a new session.
    pub(super) async fn recover(&mut self, over: &mut Session<Socket>) -> Result<Recovery, Error> {
        let Self { state, session } = self;
        let stop = async {
            if let Some(lost) = session {
                lost.stop_lost_service().await;
            }
        };
        over.recover(*state, stop).await
    }
}

impl Open {
    pub(super) fn new(session: Option<Session<Socket>>, address: Option<&Address>, settings: &Settings) -> Self {
        Self { session, left: None, address: address.cloned(), settings: Arc::new(settings.clone()) }
    }

    /// Forgets a lost session, but not its possible effects on the robot.
    pub(super) fn lose(&mut self) {
        if let Some(mut session) = self.session.take()
            && let Some(state) = session.take_left()
        {
            let session = session.outlasts_its_link().then_some(session);
            self.left = Some(Left { state, session });
        }
    }
}

impl Drop for Open {
    fn drop(&mut self) {
        let Self { session, left, address, settings } = self;
        // a session that has changed nothing ends with its connection
        let session = session.take().filter(Session::uses_robot);
        match session.and_then(|session| session.over(|socket| socket.into_blocking(address.as_ref()))) {
            Some(mut session) => ending::end_now(&mut session, address.as_ref(), settings),
            None => {
                if let (Some(Left { state, session }), Some(address)) = (left.take(), &*address) {
                    let mut lost =
                        session.and_then(|session| session.over(|socket| socket.into_blocking(Some(address))));
                    ending::recover_now(address, settings, state, lost.as_mut());
                }
            }
        }
    }
}
