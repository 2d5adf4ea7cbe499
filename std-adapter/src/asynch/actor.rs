//! The actor of a controller: the tokio task that owns the connection.
//!
//! ```text
//!  handles ── requests ──► actor ──► session ──► socket
//!                           │   └──► subscriptions, motion
//!                           └─ lost ─► report, wait, connect again
//! ```
//!
//! While there is no session, requests fail, but a halt is not refused: it ends the wait, and is sent over the next session.
//!
//! The actor carries out requests sequentially. While a motion is in progress it polls the robot between them. If the caller of
//! a request has gone, the request is dropped if it has not begun, and completed otherwise, because a call cannot be cancelled
//! on the controller. No request is carried out twice.

use std::any::Any;
use std::collections::hash_map::RandomState;
use std::future::poll_fn;
use std::hash::{BuildHasher, Hasher};
use std::io;
use std::ops::ControlFlow;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::task::Poll;
use std::time::Duration;

use bcap_core::bcap::FunctionId;
use bcap_core::io::asynch::Running;
use bcap_core::procedure::{MotionQueue, Procedure, StepError, Until};
use bcap_core::time::Instant;
use tokio::sync::{OwnedSemaphorePermit, mpsc, oneshot, watch};

use super::ending::Open;
use super::socket::{self, BoxFuture, Socket, SocketConnection};
use super::state::{Counters, State};
use super::subscription::{Scanner, Subscriber};
use crate::CallError;
use crate::address::Address;
use crate::error::Error;
use crate::moves::Move;
use crate::recovery::Recovery;
use crate::session::{ArmId, ROBOT, SESSION, Session};
use crate::settings::{Backoff, Settings};

/// A request of a handle.
pub(super) enum Request {
    /// Runs a function of the session.
    Run(Box<dyn Job>),
    Move(Box<MoveRequest>),
    /// Halts the robot if a motion begun with this arm may be in progress.
    GiveUp(ArmId),
    /// Gives this arm back, if it is still taken.
    GiveArm(ArmId),
    Subscribe(Vec<Subscriber>, Duration),
    Close(oneshot::Sender<Result<(), Error>>),
}

/// Motions in sequence, the next motion, and the waiting caller.
pub(super) struct MoveRequest {
    pub(super) arm: ArmId,
    pub(super) queue: MotionQueue,
    pub(super) motion: Option<Move>,
    pub(super) until: Until,
    pub(super) reply: oneshot::Sender<Result<MotionQueue, Error>>,
    /// Its slot in the queue, released at its turn; `None` if it needs no slot.
    pub(super) permit: Option<OwnedSemaphorePermit>,
}

/// A function of a session, with the receiver of its result.
pub(super) trait Job: Send {
    fn run<'a>(self: Box<Self>, session: &'a mut Session<Socket>) -> BoxFuture<'a, Outcome>;
    fn fail(self: Box<Self>, error: Error);
    /// Whether the caller has gone, so that it need not run.
    fn is_abandoned(&self) -> bool;
    /// Whether it stops something, so that it waits for the next session.
    fn is_urgent(&self) -> bool;
}

/// Whether a request succeeded, for the counters.
type Outcome = bool;

/// The result of a function, or its panic, which continues in its caller.
pub(super) type Worked<T> = Result<Result<T, Error>, Box<dyn Any + Send>>;

/// A [`Job`] made of a closure.
pub(super) struct Work<F, T> {
    pub(super) work: F,
    pub(super) reply: oneshot::Sender<Worked<T>>,
    /// Its slot in the queue, released at its turn; `None` if it needs no slot.
    pub(super) permit: Option<OwnedSemaphorePermit>,
    /// Whether it runs although the caller has gone, because it stops something.
    pub(super) always: bool,
    /// The time limit of its calls.
    pub(super) limit: Option<Duration>,
}

impl<F, T> Job for Work<F, T>
where
    F: for<'a> FnOnce(&'a mut Session<Socket>) -> BoxFuture<'a, Result<T, Error>> + Send + 'static,
    T: Send + 'static,
{
    fn run<'a>(self: Box<Self>, session: &'a mut Session<Socket>) -> BoxFuture<'a, Outcome> {
        let Self { work, reply, permit, limit, .. } = *self;
        drop(permit);
        let begun = Begun::new(reply, || Ok(Err(unanswered(FunctionId::CONTROLLER_EXECUTE, SESSION))));
        Box::pin(async move {
            session.set_limit(limit);
            let result = caught(work(session)).await;
            session.set_limit(None);
            let succeeded = matches!(result, Ok(Ok(_)));
            begun.send(result);
            succeeded
        })
    }

    fn fail(self: Box<Self>, error: Error) {
        let _ = self.reply.send(Ok(Err(error)));
    }

    fn is_abandoned(&self) -> bool {
        !self.always && self.reply.is_closed()
    }

    fn is_urgent(&self) -> bool {
        self.always
    }
}

/// The receiver of the result of a request that has begun. A runtime that ends drops it with its task: then the request may
/// have been carried out.
struct Begun<T> {
    reply: Option<oneshot::Sender<T>>,
    dropped: fn() -> T,
}

impl<T> Begun<T> {
    const fn new(reply: oneshot::Sender<T>, dropped: fn() -> T) -> Self {
        Self { reply: Some(reply), dropped }
    }

    fn send(mut self, result: T) {
        // a caller that has gone does not need the result
        drop(self.reply.take().map(|reply| reply.send(result)));
    }

    fn is_closed(&self) -> bool {
        self.reply.as_ref().is_none_or(oneshot::Sender::is_closed)
    }

    /// Waits until the caller has gone.
    async fn closed(&mut self) {
        if let Some(reply) = &mut self.reply {
            reply.closed().await;
        }
    }
}

impl<T> Drop for Begun<T> {
    fn drop(&mut self) {
        drop(self.reply.take().map(|reply| reply.send((self.dropped)())));
    }
}

/// Runs a future, and returns its panic, so that a panic of the caller's code does not end the session.
async fn caught<T>(mut future: BoxFuture<'_, T>) -> Result<T, Box<dyn Any + Send>> {
    poll_fn(|context| match catch_unwind(AssertUnwindSafe(|| future.as_mut().poll(context))) {
        Ok(polled) => polled.map(Ok),
        Err(panic) => Poll::Ready(Err(panic)),
    })
    .await
}

/// Owns the connection of a controller, and carries out the requests of its handles.
pub(super) struct Actor {
    pub(super) requests: mpsc::UnboundedReceiver<Request>,
    pub(super) state: watch::Sender<State>,
    pub(super) counters: Arc<Counters>,
    /// `None` over a stream of the caller, which cannot be connected again.
    pub(super) address: Option<Address>,
    pub(super) settings: Settings,
    /// Whether each session opens the robot at its start, so that a halt takes one call.
    pub(super) opens_robot: bool,
    pub(super) scan: Scanner,
    /// The recovery of the robot after the last lost connection.
    pub(super) recovered: watch::Sender<Option<Recovery>>,
    /// The stop requests for the next session.
    pub(super) urgent: Vec<Box<dyn Job>>,
}

/// How the service of one session ended.
enum SessionEnd {
    /// The connection was lost.
    Lost(Error),
    /// A handle closed the controller, and waits for the result.
    Closed(oneshot::Sender<Result<(), Error>>),
    /// All handles were dropped.
    Dropped,
}

/// Connects, and opens a session.
pub(super) async fn open(
    connection: SocketConnection,
    settings: &Settings,
    opens_robot: bool,
) -> Result<Session<Socket>, Error> {
    let mut session = Session::start(connection, settings).await?;
    if opens_robot && let Err(error) = session.robot().await {
        let _ = session.release().await;
        return Err(error);
    }
    Ok(session)
}

/// Connects to an address, and opens a session.
pub(super) async fn connect(
    address: &Address,
    settings: &Settings,
    opens_robot: bool,
) -> Result<Session<Socket>, Error> {
    open(socket::connect(address, settings).await?, settings, opens_robot).await
}

impl Actor {
    /// Runs until all handles are dropped or one of them closes the controller.
    pub(super) async fn run(mut self, session: Option<Session<Socket>>) {
        // its drop ends the session when the runtime ends
        let mut open = Open::new(session, self.address.as_ref(), &self.settings);
        let mut delays = Delays::new(self.settings.reconnect);
        loop {
            let error = match &mut open.session {
                Some(session) => {
                    delays = Delays::new(self.settings.reconnect);
                    self.counters.connections.add();
                    self.scan.restart();
                    self.state.send_replace(State::Connected);
                    match self.serve(session).await {
                        SessionEnd::Lost(error) => {
                            self.counters.losses.add();
                            open.lose();
                            error
                        }
                        ended => return self.end(ended, open).await,
                    }
                }
                None => match self.connect(&mut open).await {
                    ControlFlow::Continue(Ok(session)) => {
                        open.session = Some(session);
                        continue;
                    }
                    ControlFlow::Continue(Err(error)) => {
                        self.fail_urgent(&error);
                        error
                    }
                    ControlFlow::Break(ended) => return self.end(ended, open).await,
                },
            };
            tracing::info!(address = ?self.address, %error, "there is no session with the controller");
            if let Some(ended) = self.wait(error, delays.next()).await {
                return self.end(ended, open).await;
            }
        }
    }

    /// Ends the session and the task.
    async fn end(self, ended: SessionEnd, mut open: Open) {
        let released = match &mut open.session {
            Some(session) => session.release().await,
            None => Ok(()),
        };
        open.session = open.session.take().filter(Session::uses_robot);
        let released = open.end_now().unwrap_or(released);
        self.state.send_replace(State::Closed);
        match (ended, released) {
            (SessionEnd::Closed(reply), released) => drop(reply.send(released)),
            (_, Err(error)) => tracing::warn!(address = ?self.address, %error, "the session was not closed"),
            (_, Ok(())) => {}
        }
    }

    /// Opens a session. First ends the effects that a lost session may have left on the robot. Requests fail in the meantime.
    async fn connect(&mut self, open: &mut Open) -> ControlFlow<SessionEnd, Result<Session<Socket>, Error>> {
        let Some(address) = self.address.clone() else { return ControlFlow::Break(SessionEnd::Dropped) };
        self.state.send_replace(State::Connecting);
        let (settings, opens_robot, recovered) = (self.settings.clone(), self.opens_robot, self.recovered.clone());
        let (left, mut opened) = (&mut open.left, None);
        let opening = async {
            let session = opened.insert(connect(&address, &settings, opens_robot).await?);
            if let Some(state) = left.as_mut() {
                let recovery = state.recover(session).await?;
                tracing::warn!(%address, ?recovery, "the robot was recovered after a lost connection");
                *left = None;
                recovered.send_replace(Some(recovery));
            }
            Ok(())
        };
        let ended = self.meanwhile("the controller is being connected", opening).await;
        if !matches!(ended, ControlFlow::Continue(Ok(()))) {
            // it may have taken the arm
            match (&mut open.left, opened.take()) {
                (Some(state), Some(session)) => state.add(session),
                (_, session) => open.session = session,
            }
        }
        ended.map_continue(|ended| ended.and_then(|()| opened.ok_or(Error::Closed)))
    }

    /// Waits before the next attempt, unless a stop request is pending. Other requests fail in the meantime.
    async fn wait(&mut self, error: Error, delay: Duration) -> Option<SessionEnd> {
        let reason = reason(&error);
        self.scan.fail(&Arc::new(error));
        if self.address.is_none() {
            self.state.send_replace(State::Closed);
            return self.meanwhile(&reason, std::future::pending::<()>()).await.break_value();
        }
        self.state.send_replace(State::Disconnected { reason: reason.clone(), retry_in: delay });
        let mut delay = std::pin::pin!(tokio::time::sleep(delay));
        while self.urgent.is_empty() {
            tokio::select! {
                biased;
                request = self.requests.recv() => {
                    let ended = self.refuse(request, &reason);
                    if ended.is_some() {
                        return ended;
                    }
                }
                () = &mut delay => break,
            }
        }
        None
    }

    /// Waits for `event`, and fails all requests until then.
    async fn meanwhile<T>(&mut self, reason: &str, event: impl Future<Output = T>) -> ControlFlow<SessionEnd, T> {
        let mut event = std::pin::pin!(event);
        loop {
            tokio::select! {
                biased;
                request = self.requests.recv() => {
                    if let Some(ended) = self.refuse(request, reason) {
                        return ControlFlow::Break(ended);
                    }
                }
                value = &mut event => return ControlFlow::Continue(value),
            }
        }
    }

    /// Fails the pending stop requests, because there is no session.
    fn fail_urgent(&mut self, error: &Error) {
        for job in self.urgent.drain(..) {
            self.counters.failures.add();
            job.fail(not_connected(&reason(error)));
        }
    }

    /// Fails a request, because there is no session. Stop requests stay queued for the next session.
    fn refuse(&mut self, request: Option<Request>, reason: &str) -> Option<SessionEnd> {
        let error = || not_connected(reason);
        match request {
            None => return Some(SessionEnd::Dropped),
            Some(Request::Close(reply)) => return Some(SessionEnd::Closed(reply)),
            Some(Request::Run(job)) if job.is_urgent() && self.address.is_some() => {
                self.urgent.push(job);
                return None;
            }
            Some(Request::Run(job)) => job.fail(error()),
            Some(Request::Move(request)) if request.queue.is_new() => drop(request.reply.send(Err(error()))),
            // the robot may still move
            Some(Request::Move(request)) => drop(request.reply.send(Err(unanswered_motion()))),
            Some(Request::Subscribe(subscribers, interval)) => {
                self.scan.add(subscribers, interval);
                self.scan.fail(&Arc::new(error()));
                return None;
            }
            Some(Request::GiveArm(_) | Request::GiveUp(_)) => return None,
        }
        self.counters.failures.add();
        None
    }

    /// Carries out requests until the session ends. Each round performs at most one step whose deadline has passed and
    /// one request, so neither starves the other.
    async fn serve(&mut self, session: &mut Session<Socket>) -> SessionEnd {
        let mut motion = None;
        for job in std::mem::take(&mut self.urgent) {
            let succeeded = job.run(session).await;
            self.count(succeeded);
        }
        loop {
            let now = session.now();
            motion = match motion {
                Some(motion) => step(session, motion, now).await,
                None => None,
            };
            if self.scan.next().is_some_and(|next| next <= now) && self.scan.read(session).await {
                self.counters.scanned.add();
            }
            session.verify().await;
            if let Some(error) = session.lost() {
                return lost(motion, error);
            }
            let deadline = motion.as_ref().map(|motion| motion.deadline).into_iter().chain(self.scan.next()).min();
            tokio::select! {
                biased;
                // first, because the next round halts the robot
                () = gone(&mut motion) => {}
                request = self.requests.recv() => match request {
                    None => return SessionEnd::Dropped,
                    Some(Request::Close(reply)) => {
                        drop(motion);
                        return SessionEnd::Closed(reply);
                    }
                    Some(Request::Move(request)) => motion = self.start(session, request, motion).await,
                    Some(Request::GiveArm(arm)) if arm == session.arm_id() => {
                        motion = None;
                        self.give_arm(session).await;
                    }
                    Some(Request::GiveUp(arm)) if arm == session.arm_id() => {
                        motion = None;
                        give_up(session).await;
                    }
                    Some(Request::GiveArm(_) | Request::GiveUp(_)) => {}
                    Some(Request::Subscribe(subscribers, interval)) => self.scan.add(subscribers, interval),
                    Some(Request::Run(job)) => {
                        if !job.is_abandoned() {
                            let succeeded = job.run(session).await;
                            self.count(succeeded);
                        }
                    }
                },
                error = session.transport().idle_until(deadline) => if let Some(error) = error {
                    return lost(motion, session.lose(&error));
                },
            }
            // a clock that does not wait must not keep other tasks from running
            tokio::task::yield_now().await;
        }
    }

    fn count(&self, succeeded: Outcome) {
        self.counters.operations.add();
        if !succeeded {
            self.counters.failures.add();
        }
    }

    async fn give_arm(&mut self, session: &mut Session<Socket>) {
        let given = session.end_arm().await;
        self.count(given.is_ok());
        if let Err(error) = given {
            tracing::warn!(address = ?self.address, %error, "the arm was not given back");
        }
    }

    /// Starts a motion. If an earlier motion of the same arm is in progress, its caller has abandoned it, so the robot is
    /// halted first.
    async fn start(
        &mut self,
        session: &mut Session<Socket>,
        request: Box<MoveRequest>,
        earlier: Option<ActiveMotion>,
    ) -> Option<ActiveMotion> {
        let MoveRequest { arm, queue, motion, until, reply, permit } = *request;
        drop(permit);
        if arm != session.arm_id() {
            self.count(false);
            let _ = reply.send(Err(Error::ArmLost));
            return earlier;
        }
        let halted = match earlier {
            Some(_) => session.halt().await.map(drop),
            None => Ok(()),
        };
        if reply.is_closed() {
            return None;
        }
        let begun = match halted {
            Ok(()) => session.queue(queue, motion, until).await,
            Err(error) => Err(error),
        };
        self.count(begun.is_ok());
        match begun {
            Ok(running) => {
                let reply = Begun::new(reply, || Err(unanswered_motion()));
                Some(ActiveMotion { steps: Box::new(running), deadline: Instant::ZERO, reply })
            }
            Err(error) => {
                let _ = reply.send(Err(error));
                None
            }
        }
    }
}

/// A motion in progress, with the receiver of its outcome.
struct ActiveMotion {
    steps: Box<dyn MotionSteps>,
    /// When the robot is polled.
    deadline: Instant,
    reply: Begun<Result<MotionQueue, Error>>,
}

/// A running motion as a trait object.
trait MotionSteps: Send {
    fn advance<'a>(
        &'a mut self,
        session: &'a mut Session<Socket>,
    ) -> BoxFuture<'a, ControlFlow<Result<MotionQueue, Error>, Instant>>;
}

impl<P: Procedure<Output = MotionQueue, Error = StepError> + Send> MotionSteps for Running<P, io::Error> {
    fn advance<'a>(
        &'a mut self,
        session: &'a mut Session<Socket>,
    ) -> BoxFuture<'a, ControlFlow<Result<MotionQueue, Error>, Instant>> {
        Box::pin(session.advance(self))
    }
}

/// Polls a motion at its deadline; halts the robot if the caller has gone. Returns the motion while it is in progress.
async fn step(session: &mut Session<Socket>, mut motion: ActiveMotion, now: Instant) -> Option<ActiveMotion> {
    let ActiveMotion { steps, deadline, reply } = &mut motion;
    if now < *deadline && !reply.is_closed() {
        return Some(motion);
    }
    let step = tokio::select! {
        biased;
        () = reply.closed() => None,
        step = steps.advance(session) => Some(step),
    };
    match step {
        Some(ControlFlow::Continue(at)) => {
            *deadline = at;
            return Some(motion);
        }
        Some(ControlFlow::Break(ended)) => motion.reply.send(ended),
        None => give_up(session).await,
    }
    None
}

/// Halts the robot if it may move, because its caller has gone.
async fn give_up(session: &mut Session<Socket>) {
    if session.is_moving()
        && let Err(error) = session.halt().await
    {
        tracing::warn!(%error, "a motion was given up, and the robot was not halted");
    }
}

/// Waits until the caller of a motion has gone.
async fn gone(motion: &mut Option<ActiveMotion>) {
    match motion {
        Some(motion) => motion.reply.closed().await,
        None => std::future::pending().await,
    }
}

/// Ends the service of a lost session. The caller of the motion gets an error: the motion may have moved the robot.
fn lost(motion: Option<ActiveMotion>, error: Error) -> SessionEnd {
    drop(motion);
    SessionEnd::Lost(error)
}

/// Returns the error of an accepted motion whose outcome is unknown because the connection was lost.
fn unanswered_motion() -> Error {
    unanswered(FunctionId::ROBOT_MOVE, ROBOT)
}

fn unanswered(function: FunctionId, object: &str) -> Error {
    Error::call(function, object, CallError::Disconnected)
}

/// Returns the text of an error, with the error of the operating system.
fn reason(error: &Error) -> String {
    match error {
        Error::Connect(error) => error.in_full(),
        error => error.to_string(),
    }
}

fn not_connected(reason: &str) -> Error {
    Error::NotConnected { reason: reason.to_owned() }
}

/// The delays between attempts to connect: each is twice the previous delay, less a random part.
struct Delays {
    backoff: Backoff,
    next: Duration,
}

impl Delays {
    const fn new(backoff: Backoff) -> Self {
        Self { backoff, next: backoff.min }
    }

    /// Returns the next delay, between half of it and all of it, so that many clients do not connect at the same time.
    fn next(&mut self) -> Duration {
        let delay = self.next.min(self.backoff.max);
        self.next = delay.saturating_mul(2);
        // the standard library seeds its hash maps with random keys
        let random = RandomState::new().build_hasher().finish() % 1000;
        let part = u32::try_from(random).unwrap_or(0);
        delay / 2 + delay / 2000 * part
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn delays_double_up_to_the_maximum_and_differ() {
        let (min, max) = (Duration::from_millis(100), Duration::from_secs(1));
        let mut delays = Delays::new(Backoff::default().min(min).max(max));
        for bound in [100, 200, 400, 800, 1000, 1000] {
            let delay = delays.next();
            let bound = Duration::from_millis(bound);
            assert!(bound / 2 <= delay && delay <= bound, "{delay:?} for {bound:?}");
        }
        let once: Vec<_> = (0..50).map(|_| Delays::new(Backoff::default().min(max).max(max)).next()).collect();
        assert!(once.iter().any(|delay| *delay != once[0]));
    }
}
