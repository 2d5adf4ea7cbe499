//! The end of a session that has taken the arm, within a time limit, on sockets that block.
//!
//! The sessions of tokio end here too when their runtime ends before them.

use std::time::Duration;

use bcap_core::io::asynch::SendTransport;

use super::socket::{self, Blocking, ready};
use crate::address::Address;
use crate::error::Error;
use crate::recovery::Recovery;
use crate::session::{Left, Session};
use crate::settings::Settings;

/// The time limit for the end of a session.
const LIMIT: Duration = Duration::from_secs(5);

/// The time limit for connecting again at the end of a program.
const CONNECT: Duration = Duration::from_secs(2);

/// Runs the end of a session within [`LIMIT`], or within its deadline.
pub(crate) fn within_limit<T>(session: &mut Session<Blocking>, end: impl FnOnce(&mut Session<Blocking>) -> T) -> T {
    let deadline = session.connection().transport().deadline();
    let limit = SendTransport::now(session.connection().transport()) + LIMIT;
    session.connection().transport().set_deadline(Some(deadline.unwrap_or(limit)));
    let ended = end(session);
    session.connection().transport().set_deadline(deadline);
    ended
}

/// How a session has ended.
pub(crate) struct EndResult {
    /// An error unless its effects on the robot are verified to have ended.
    pub(crate) robot: Result<(), Error>,
    /// Whether its objects were released and its service stopped.
    pub(crate) objects: Result<(), Error>,
}

/// Ends a session: gives the arm back, releases all objects and stops the service. If the connection was lost while the session had
/// the arm, or the controller did not answer, it connects once more for that.
pub(crate) fn end_now(session: &mut Session<Blocking>, address: Option<&Address>, settings: &Settings) -> EndResult {
    let (given, objects) = within_limit(session, |session| {
        let given = match session.lost() {
            None => ready(session.end_arm()),
            Some(lost) if session.left().is_some() => Err(lost),
            Some(_) => Ok(()),
        };
        (given, ready(session.release_objects()))
    });
    if let Err(error) = &given {
        tracing::warn!(?address, %error, "the arm was not given back");
    }
    if let Err(error) = &objects {
        tracing::warn!(?address, %error, "the session was not closed");
    }
    let robot = match (session.take_left(), address) {
        (Some(left), Some(address)) => recover_now(address, settings, left, std::slice::from_mut(session)),
        _ => given,
    };
    EndResult { robot, objects }
}

/// Ends the effects that a lost session may have left, over a new connection. Over UDP the lost sessions are stopped too. Fails
/// unless the effects are verified to have ended.
pub(crate) fn recover_now(
    address: &Address,
    settings: &Settings,
    left: Left,
    lost: &mut [Session<Blocking>],
) -> Result<(), Error> {
    let mut stopped = false;
    let stopping = async {
        stopped = true;
        stop(lost).await;
    };
    let recovered = recover(address, settings, left, stopping);
    match &recovered {
        Ok(recovery) => tracing::warn!(%address, ?recovery, "the robot was recovered over a new connection"),
        Err(error) => {
            tracing::error!(%address, %error, "the connection was lost, and the robot may be moving");
            if !stopped {
                ready(stop(lost));
            }
        }
    }
    match recovered {
        Ok(recovery) if !recovery.is_complete() => Err(Error::NotEnded(recovery)),
        recovered => recovered.map(drop),
    }
}

/// Stops the services of lost sessions.
async fn stop(lost: &mut [Session<Blocking>]) {
    for lost in lost {
        let transport = lost.connection().transport();
        transport.set_deadline(Some(SendTransport::now(transport) + LIMIT));
        lost.stop_lost_service().await;
    }
}

fn recover(
    address: &Address,
    settings: &Settings,
    left: Left,
    stop: impl Future<Output = ()>,
) -> Result<Recovery, Error> {
    let mut settings = settings.clone();
    settings.options = settings.options.connect_timeout(settings.options.connect_timeout.min(CONNECT));
    let mut connection = socket::connect(address, &settings)?;
    connection.transport().set_deadline(Some(crate::now() + LIMIT));
    let mut session = ready(Session::start(connection, &settings))?;
    let recovered = ready(session.recover(left, stop));
    // the objects are released with the connection if this fails
    let _ = ready(session.release());
    recovered
}
