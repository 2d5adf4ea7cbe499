//! One TCP connection: moves bytes between its socket and a session of the core, for either protocol.

use std::borrow::Cow;
use std::io;
use std::sync::Arc;
use std::time::Duration;

use bcap_core::handler::PeerId;
use bcap_core::peers::datagrams::SharedState as _;
use bcap_core::peers::{Exceeded, StreamTimes};
use bcap_core::time::{Instant, earliest};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;
use tokio::time::timeout;

use super::activity::{Activity, Registered};
use super::limits::Limits;
use super::shared::{Changes, ServeLocked, ServerState};
use crate::clock::{now, until};
use crate::connect::STREAM_ROOM;

/// The bytes that a connection may receive and send before it yields to other tasks. Without this limit, a peer that sends
/// and reads as fast as the server does would starve the others.
///
/// A request of this size or more is carried out by another thread, because it takes longer than a turn.
const TURN: usize = 256 << 10;

/// The share of a turn that one request costs, in bytes: a turn has 32 small requests.
const REQUEST: usize = TURN / 32;

/// The silence after which a connection releases the memory of its last request or reply.
const MEMORY_KEPT: Duration = Duration::from_secs(5);

/// Why a connection ends when the server stops.
const STOPPED: &str = "the server stops";

/// Serves one connection until it ends or the server stops.
pub(super) async fn serve<H: Send + 'static, M: ServeLocked<H> + 'static>(
    stream: TcpStream,
    session: M,
    peer: PeerId,
    shared: Arc<ServerState<H>>,
    limits: Limits,
    activity: Arc<Activity>,
) {
    // a connection that is closed already has no address, and makes no call
    if let Ok(address) = stream.peer_addr() {
        shared.connected(peer, address.ip());
    }
    let changes = shared.changes();
    let mut session = Box::new(session);
    let mut connection = StreamConnection {
        stream,
        peer,
        shared,
        changes,
        limits,
        activity,
        registered: Registered::default(),
        times: StreamTimes::new(now()),
        time: now(),
        moved: 0,
    };
    loop {
        match connection.run(&mut *session).await {
            Ok(Pause::LargeRequest) => match connection.run_elsewhere(session).await {
                Some(back) => session = back,
                // the runtime is shutting down
                None => return,
            },
            Ok(Pause::Ended(reason)) => {
                tracing::debug!(peer = peer.0, reason, "connection ended");
                break;
            }
            Err(error) => {
                tracing::debug!(peer = peer.0, %error, "connection failed");
                break;
            }
        }
    }
    connection.shared.close(&mut *session, peer, now());
}

struct StreamConnection<H> {
    stream: TcpStream,
    peer: PeerId,
    shared: Arc<ServerState<H>>,
    changes: Changes<H>,
    limits: Limits,
    activity: Arc<Activity>,
    registered: Registered,
    times: StreamTimes,
    /// The time after the last wait or request.
    time: Instant,
    /// The used part of the turn, in bytes.
    moved: usize,
}

/// Why a connection stopped moving bytes.
enum Pause {
    /// Another thread must carry out the next request.
    LargeRequest,
    /// The connection must end.
    Ended(&'static str),
}

impl<H: Send + 'static> StreamConnection<H> {
    /// Moves bytes until a large request has arrived or the connection must end.
    async fn run<M: ServeLocked<H>>(&mut self, session: &mut M) -> io::Result<Pause> {
        loop {
            if self.moved >= TURN && self.end_turn().await {
                return Ok(Pause::Ended(STOPPED));
            }
            if session.next_request() >= TURN {
                return Ok(Pause::LargeRequest);
            }
            self.run_session(session);
            if !session.transmit().is_empty() {
                self.activity.set(None);
                if let Some(reason) = self.send(session).await? {
                    return Ok(Pause::Ended(reason));
                }
                self.times.moved(self.time);
                continue;
            }
            if session.is_finished() {
                let _ = self.stream.shutdown().await;
                return Ok(Pause::Ended("the peer sent no valid frame"));
            }
            if let Some(reason) = self.wait(session).await? {
                return Ok(Pause::Ended(reason));
            }
        }
    }

    /// Yields to other tasks, because this one has used its turn; returns whether the server stops.
    async fn end_turn(&mut self) -> bool {
        self.moved = 0;
        tokio::task::yield_now().await;
        self.time = now();
        self.activity.is_stopped()
    }

    /// Waits until bytes arrive, a deadline passes or something changes; returns the reason if the connection must end.
    async fn wait<M: ServeLocked<H>>(&mut self, session: &mut M) -> io::Result<Option<&'static str>> {
        let deadline = match self.times.deadline(session, self.limits.times(), self.time) {
            Ok(deadline) => deadline,
            Err(Exceeded::Receive) => return Ok(Some("a request took too long to arrive")),
            Err(Exceeded::Idle) => return Ok(Some("the peer was silent for too long")),
        };
        let kept_until = self.memory_kept_until(session);
        let deadline = earliest(deadline, kept_until);
        let is_idle = !session.is_running();
        self.activity.set(is_idle.then_some(self.times.last_active()));
        let room = session.receive_buffer();
        let is_full = room.is_empty();
        let room = room.split_at_mut(room.len().min(TURN)).0;
        let waits_for_change = self.changes.waiting() > 0;
        let (mut reader, writer) = self.stream.split();
        tokio::select! {
            // The read comes first: while requests arrive, the other branches need not be polled. `end_turn` checks whether the
            // server stops for a peer whose requests never pause.
            biased;
            count = reader.read(room), if !is_full => match count? {
                0 => return Ok(Some("the peer closed it")),
                count => {
                    self.time = now();
                    self.times.moved(self.time);
                    self.moved += count;
                    session.received(count);
                }
            },
            // a connection whose call has just begun is not evicted: that would stop a motion
            evicted = self.activity.ended(&mut self.registered, is_idle) => {
                return Ok(Some(if evicted { "another connection needs its slot" } else { STOPPED }));
            }
            () = sleep_until(deadline), if deadline.is_some() => {
                self.time = now();
                if kept_until.is_some_and(|until| until <= self.time) {
                    session.shrink(STREAM_ROOM);
                }
            }
            closed = closed(writer.as_ref()), if is_full => {
                closed?;
                return Ok(Some("the peer closed it before all of its bytes were read"));
            }
            () = self.changes.next(), if waits_for_change => self.time = now(),
        }
        Ok(None)
    }

    /// Runs the session until it has no more work, or a request for another thread.
    fn run_session<M: ServeLocked<H>>(&mut self, session: &mut M) {
        let Self { changes, shared, peer, times, time, moved, .. } = self;
        changes.run(session, |session| {
            if session.next_request() >= TURN || !shared.step(session, *peer, *time) {
                return false;
            }
            *time = now();
            *moved += REQUEST;
            times.ran();
            true
        });
    }

    /// Performs one step of the session on another thread, so that a large request does not delay other connections;
    /// `None` if that thread did not finish.
    async fn run_elsewhere<M: ServeLocked<H> + 'static>(&mut self, mut session: Box<M>) -> Option<Box<M>> {
        self.activity.set(None);
        let (shared, peer) = (Arc::clone(&self.shared), self.peer);
        let step = tokio::task::spawn_blocking(move || {
            shared.step(&mut *session, peer, now());
            session
        });
        self.times.ran();
        let session = step.await.ok();
        self.time = now();
        session
    }

    /// Sends pending bytes; returns the reason if the connection must end.
    async fn send<M: ServeLocked<H>>(&mut self, session: &mut M) -> io::Result<Option<&'static str>> {
        let bytes = session.transmit();
        match self.shared.tapped(self.peer, bytes) {
            None => return Ok(Some("the tap closes it")),
            Some(Cow::Owned(replacement)) => {
                let count = bytes.len();
                session.transmitted(count);
                let mut rest = &replacement[..];
                while !rest.is_empty() {
                    let part = &rest[..rest.len().min(TURN)];
                    match self.write(part).await? {
                        Ok(written) => rest = rest.get(written..).unwrap_or_default(),
                        Err(reason) => return Ok(Some(reason)),
                    }
                    self.moved += part.len();
                    if self.moved >= TURN && self.end_turn().await {
                        return Ok(Some(STOPPED));
                    }
                }
                return Ok(None);
            }
            Some(Cow::Borrowed(_)) => {}
        }
        let bytes = &bytes[..bytes.len().min(TURN)];
        let count = match self.stream.try_write(bytes) {
            Err(error) if error.kind() == io::ErrorKind::WouldBlock => match self.write(bytes).await? {
                Ok(count) => count,
                Err(reason) => return Ok(Some(reason)),
            },
            written => written?,
        };
        session.transmitted(count);
        self.moved += count;
        Ok(None)
    }

    /// Writes bytes as soon as the socket takes some; returns the reason why the connection must end, such as the time limit.
    async fn write(&mut self, bytes: &[u8]) -> io::Result<Result<usize, &'static str>> {
        let written = tokio::select! {
            written = timeout(self.limits.send, self.stream.write(bytes)) => match written {
                Ok(written) => written.map(Ok),
                Err(_) => Ok(Err("the peer does not read")),
            },
            _ = self.activity.ended(&mut self.registered, false) => Ok(Err(STOPPED)),
        };
        self.time = now();
        written
    }

    /// Returns when unused memory must be released; `None` if the session is busy or has no unused memory.
    fn memory_kept_until<M: ServeLocked<H>>(&self, session: &M) -> Option<Instant> {
        let idle = !session.is_running() && !session.is_receiving();
        (idle && session.memory() > 2 * STREAM_ROOM).then(|| self.times.last_active().saturating_add(MEMORY_KEPT))
    }
}

/// Waits for a deadline, if there is one. A timer is created only when it is polled.
pub(super) async fn sleep_until(deadline: Option<Instant>) {
    match deadline {
        Some(at) => tokio::time::sleep(until(at)).await,
        None => std::future::pending().await,
    }
}

/// Waits until the peer has closed the connection, even if bytes before the close do not fit into the receive buffer. A
/// client that disconnects must stop its motion in this case too.
#[cfg(any(target_os = "linux", target_os = "android"))]
async fn closed(stream: &TcpStream) -> io::Result<()> {
    use tokio::io::Interest;
    loop {
        if stream.ready(Interest::PRIORITY).await?.is_read_closed() {
            return Ok(());
        }
        // urgent (out-of-band) bytes are ignored
        let _ = stream.try_io(Interest::PRIORITY, || Err::<(), _>(io::ErrorKind::WouldBlock.into()));
    }
}

/// Never returns: on this platform a close is detected only once the receive buffer has room again.
#[cfg(not(any(target_os = "linux", target_os = "android")))]
async fn closed(_: &TcpStream) -> io::Result<()> {
    std::future::pending().await
}
