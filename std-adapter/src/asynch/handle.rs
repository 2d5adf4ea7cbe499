//! The handle of a controller's task.

use std::io;
use std::panic::resume_unwind;
use std::sync::Arc;
use std::time::Duration;

use bcap_core::variant::{Encode, OwnedVariant};
use tokio::sync::{OwnedSemaphorePermit, Semaphore, mpsc, oneshot, watch};
use tracing::Instrument as _;

use super::SendTransport;
use super::actor::{self, Actor, Request, Work};
use super::socket::{self, BoxFuture, Socket};
use super::state::{Counters, State};
use super::subscription::Scanner;
use crate::address::Address;
use crate::error::Error;
use crate::recovery::Recovery;
use crate::session::Session;
use crate::settings::Settings;

/// A handle of a controller's task. The task ends with its last handle.
#[derive(Clone, Debug)]
pub(super) struct Handle {
    requests: mpsc::UnboundedSender<Request>,
    pub(super) state: watch::Receiver<State>,
    pub(super) counters: Arc<Counters>,
    pub(super) recovered: watch::Receiver<Option<Recovery>>,
    /// `None` over a stream of the caller.
    pub(super) address: Option<Address>,
    pub(super) settings: Settings,
    /// Limits the queued calls of all handles.
    queue: Arc<Semaphore>,
    /// The time limit of each call of this handle.
    limit: Option<Duration>,
}

/// The maximum number of queued calls, including calls whose caller has gone. Further calls wait before they enter the queue,
/// so a controller that is too slow for its callers uses no more memory than they do.
const QUEUE: usize = 256;

impl Handle {
    /// Connects and opens a session, with the robot if `opens_robot`, and starts the task.
    pub(super) async fn connect(address: Address, settings: &Settings, opens_robot: bool) -> Result<Self, Error> {
        let session = actor::connect(&address, settings, opens_robot).await?;
        Ok(Self::start(Some(address), settings, opens_robot, Some(session)))
    }

    /// Opens a session over a stream of the caller, and starts the task.
    pub(super) async fn over(
        stream: impl SendTransport<Error = io::Error> + Send + Sync + 'static,
        settings: &Settings,
        opens_robot: bool,
    ) -> Result<Self, Error> {
        let session = actor::open(socket::over(stream, settings), settings, opens_robot).await?;
        Ok(Self::start(None, settings, opens_robot, Some(session)))
    }

    /// Starts the task.
    pub(super) fn start(
        address: Option<Address>,
        settings: &Settings,
        opens_robot: bool,
        session: Option<Session<Socket>>,
    ) -> Self {
        let (requests, receiver) = mpsc::unbounded_channel();
        let begun = if session.is_some() { State::Connected } else { State::Connecting };
        let (sender, state) = watch::channel(begun);
        let (reporter, recovered) = watch::channel(None);
        let counters = Arc::<Counters>::default();
        let actor = Actor {
            requests: receiver,
            state: sender,
            counters: Arc::clone(&counters),
            address: address.clone(),
            settings: settings.clone(),
            opens_robot,
            scan: Scanner::default(),
            recovered: reporter,
            urgent: Vec::new(),
        };
        let span = tracing::info_span!("controller", address = address.as_ref().map(tracing::field::display));
        tokio::spawn(actor.run(session).instrument(span));
        let (queue, settings) = (Arc::new(Semaphore::new(QUEUE)), settings.clone());
        Self { requests, state, counters, recovered, address, settings, queue, limit: None }
    }

    /// Returns this handle with a time limit for each call.
    pub(super) fn within(&self, limit: Duration) -> Self {
        Self { limit: Some(limit), ..self.clone() }
    }

    pub(super) fn send(&self, request: Request) -> Result<(), Error> {
        self.requests.send(request).map_err(|_| Error::Closed)
    }

    /// Waits for a slot in the queue.
    pub(super) async fn slot(&self) -> Option<OwnedSemaphorePermit> {
        // nothing closes the semaphore
        Arc::clone(&self.queue).acquire_owned().await.ok()
    }

    /// Runs a function of the session in the task, unless the caller has gone before its turn. It waits while the queue is full.
    pub(super) async fn run<T, F>(&self, work: F) -> Result<T, Error>
    where
        F: for<'a> FnOnce(&'a mut Session<Socket>) -> BoxFuture<'a, Result<T, Error>> + Send + 'static,
        T: Send + 'static,
    {
        self.carry_out(work, self.slot().await, false).await
    }

    /// Runs a function of the session in the task, even if the caller has gone. It does not wait for a full queue, and no time
    /// limit applies, because such a function stops something.
    pub(super) async fn run_always<T, F>(&self, work: F) -> Result<T, Error>
    where
        F: for<'a> FnOnce(&'a mut Session<Socket>) -> BoxFuture<'a, Result<T, Error>> + Send + 'static,
        T: Send + 'static,
    {
        self.carry_out(work, None, true).await
    }

    async fn carry_out<T, F>(&self, work: F, permit: Option<OwnedSemaphorePermit>, always: bool) -> Result<T, Error>
    where
        F: for<'a> FnOnce(&'a mut Session<Socket>) -> BoxFuture<'a, Result<T, Error>> + Send + 'static,
        T: Send + 'static,
    {
        let (reply, result) = oneshot::channel();
        let limit = self.limit.filter(|_| !always);
        self.send(Request::Run(Box::new(Work { work, reply, permit, always, limit })))?;
        match result.await {
            Ok(Ok(result)) => result,
            Ok(Err(panic)) => resume_unwind(panic),
            Err(_) => Err(Error::Closed),
        }
    }
}

/// Copies an argument, which outlives its caller in the task.
pub(super) fn owned(value: &impl Encode) -> Result<OwnedVariant, Error> {
    OwnedVariant::new(value).map_err(Error::Argument)
}

#[cfg(test)]
mod tests {
    use std::pin::pin;
    use std::task::{Context, Waker};

    use super::*;

    #[test]
    fn calls_given_up_before_their_turn_keep_their_slot_in_the_queue() {
        let (requests, mut waiting) = mpsc::unbounded_channel();
        let handle = Handle {
            requests,
            state: watch::channel(State::Connected).1,
            counters: Arc::default(),
            recovered: watch::channel(None).1,
            address: None,
            settings: Settings::rc9(),
            queue: Arc::new(Semaphore::new(QUEUE)),
            limit: None,
        };
        let begin_and_give_up = |count| {
            for _ in 0..count {
                let call = pin!(handle.run(|_| Box::pin(async { Ok(()) })));
                assert!(call.poll(&mut Context::from_waker(Waker::noop())).is_pending());
            }
        };
        begin_and_give_up(2 * QUEUE);
        assert_eq!(waiting.len(), QUEUE);
        // the task takes one, so the queue has room for one more
        drop(waiting.try_recv().unwrap());
        begin_and_give_up(2);
        assert_eq!(waiting.len(), QUEUE);
    }
}
