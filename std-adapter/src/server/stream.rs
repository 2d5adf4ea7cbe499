//! One connection of a stream: its bytes to and from a session of the core, whatever its protocol.

use std::io;
use std::sync::Arc;
use std::time::Duration;

use bcap_core::handler::PeerId;
use bcap_core::session::Session;
use bcap_core::time::Instant;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;
use tokio::sync::watch;
use tokio::time::timeout;

use super::Limits;
use super::shared::{Changes, Held, Shared, Tapped};
use crate::clock::{now, until};
use crate::connect::STREAM_ROOM;

/// A session of either protocol, whose handler is shared.
pub(super) trait Machine<H>: for<'h> Session<Held<'h, H>> + Send {}

impl<H, S: for<'h> Session<Held<'h, H>> + Send> Machine<H> for S {}

/// How many replies a connection may send in a row before others have their turn: a peer that has many requests in our
/// buffer, and reads as fast as we write, would have the thread to itself.
const TURN: u32 = 32;

/// The silence after which a connection gives back the memory that its last request or reply took.
const MEMORY_KEPT: Duration = Duration::from_secs(5);

/// Serves one connection until it ends or the server stops.
pub(super) async fn serve<H: Send, M: Machine<H>>(
    stream: TcpStream,
    session: M,
    peer: PeerId,
    shared: Arc<Shared<H>>,
    limits: Limits,
    stopped: watch::Receiver<()>,
) {
    let changes = shared.changes();
    let mut connection =
        Connection { stream, session, peer, shared, changes, limits, partial_since: None, heard: now() };
    match connection.run(stopped).await {
        Ok(reason) => tracing::debug!(peer = peer.0, reason, "connection ended"),
        Err(error) => tracing::debug!(peer = peer.0, %error, "connection failed"),
    }
    connection.session.close(&mut connection.shared.handler(), peer, now());
    connection.shared.has_changed();
}

struct Connection<H, M> {
    stream: TcpStream,
    session: M,
    peer: PeerId,
    shared: Arc<Shared<H>>,
    changes: Changes<H>,
    limits: Limits,
    /// When the first byte of an unfinished request came.
    partial_since: Option<Instant>,
    /// When bytes came last, or a reply left.
    heard: Instant,
}

impl<H, M: Machine<H>> Connection<H, M> {
    /// Moves bytes until there is a reason to end.
    async fn run(&mut self, mut stopped: watch::Receiver<()>) -> io::Result<&'static str> {
        let mut sent = 0_u32;
        loop {
            self.think();
            if !self.session.transmit().is_empty() {
                if let Some(reason) = self.send(&mut stopped).await? {
                    return Ok(reason);
                }
                self.heard = now();
                sent = sent.wrapping_add(1);
                if sent.is_multiple_of(TURN) {
                    tokio::task::yield_now().await;
                }
                continue;
            }
            if self.session.is_finished() {
                let _ = self.stream.shutdown().await;
                return Ok("the peer sent no valid frame");
            }
            self.note_partial();
            let due = self.due();
            let room = self.session.receive_buffer();
            let is_full = room.is_empty();
            let (mut reader, writer) = self.stream.split();
            tokio::select! {
                count = reader.read(room), if !is_full => match count? {
                    0 => return Ok("the peer has closed it"),
                    count => {
                        self.heard = now();
                        self.session.received(count);
                    }
                },
                () = tokio::time::sleep(until(due.unwrap_or(Instant::ZERO))), if due.is_some() => {
                    if self.partial_since.is_some_and(|since| since.saturating_add(self.limits.receive) <= now()) {
                        return Ok("a request took too long to arrive");
                    }
                    if self.silent_until().is_some_and(|until| until <= now()) {
                        return Ok("the peer was silent for too long");
                    }
                    if self.memory_kept_until().is_some_and(|until| until <= now()) {
                        self.session.shrink(STREAM_ROOM);
                    }
                }
                closed = closed(writer.as_ref()), if is_full => {
                    closed?;
                    return Ok("the peer has closed it, behind bytes that have not been read");
                }
                () = self.changes.next() => {}
                _ = stopped.changed() => return Ok("the server stops"),
            }
        }
    }

    /// Lets the session do what it can.
    fn think(&mut self) {
        // said beforehand: what others change while the handler is asked must not be missed
        self.changes.wait(self.session.is_running().into());
        while self.step() {}
        if self.session.is_running() && self.changes.waiting() == 0 {
            // the handler has just begun to wait; ask once more, now that changes are heard
            self.changes.wait(1);
            self.step();
        }
    }

    /// Lets the session do one thing; `false` when it has nothing to do.
    fn step(&mut self) -> bool {
        let Some(event) = self.session.run(&mut self.shared.handler(), self.peer, now()) else { return false };
        tracing::trace!(peer = self.peer.0, ?event);
        self.shared.has_changed();
        // a request was whole, so what there is of another has only just come
        self.partial_since = None;
        true
    }

    /// Sends what it can; says why when the connection is to end.
    async fn send(&mut self, stopped: &mut watch::Receiver<()>) -> io::Result<Option<&'static str>> {
        let bytes = self.session.transmit();
        match self.shared.tapped(self.peer, bytes) {
            None => return Ok(Some("the tap closes it")),
            Some(Tapped::Instead(instead)) => {
                let count = bytes.len();
                self.session.transmitted(count);
                let mut rest = &instead[..];
                while !rest.is_empty() {
                    match patiently(self.stream.write(rest), self.limits.send, stopped).await? {
                        Ok(written) => rest = rest.get(written..).unwrap_or_default(),
                        Err(reason) => return Ok(Some(reason)),
                    }
                }
                return Ok(None);
            }
            Some(Tapped::Untouched) => {}
        }
        let count = match self.stream.try_write(bytes) {
            Err(error) if error.kind() == io::ErrorKind::WouldBlock => {
                match patiently(self.stream.write(bytes), self.limits.send, stopped).await? {
                    Ok(count) => count,
                    Err(reason) => return Ok(Some(reason)),
                }
            }
            written => written?,
        };
        self.session.transmitted(count);
        Ok(None)
    }

    fn note_partial(&mut self) {
        self.partial_since = self.session.is_receiving().then(|| self.partial_since.unwrap_or_else(now));
    }

    /// Returns when something is due even if no bytes come.
    fn due(&self) -> Option<Instant> {
        let partial = self.partial_since.map(|since| since.saturating_add(self.limits.receive));
        let memory = self.memory_kept_until();
        [self.session.poll_timeout(), partial, self.silent_until(), memory].into_iter().flatten().min()
    }

    /// Returns when memory that lies idle is to be given back.
    fn memory_kept_until(&self) -> Option<Instant> {
        let idle = !self.session.is_running() && !self.session.is_receiving();
        (idle && self.session.memory() > 2 * STREAM_ROOM).then(|| self.heard.saturating_add(MEMORY_KEPT))
    }

    /// Returns when the peer has been silent for too long, unless it waits for us.
    fn silent_until(&self) -> Option<Instant> {
        let idle = self.limits.idle.filter(|_| !self.session.is_running())?;
        Some(self.heard.saturating_add(idle))
    }
}

/// Waits until a peer takes bytes; says why it waits no longer.
async fn patiently<T>(
    written: impl Future<Output = io::Result<T>>,
    limit: Duration,
    stopped: &mut watch::Receiver<()>,
) -> io::Result<Result<T, &'static str>> {
    tokio::select! {
        written = timeout(limit, written) => match written {
            Ok(written) => written.map(Ok),
            Err(_) => Ok(Err("the peer does not read")),
        },
        _ = stopped.changed() => Ok(Err("the server stops")),
    }
}

/// Waits until the peer has closed the connection, even if it has sent what there is no room for: whoever goes must not let
/// the robot go on because of that.
#[cfg(any(target_os = "linux", target_os = "android"))]
async fn closed(stream: &TcpStream) -> io::Result<()> {
    use tokio::io::Interest;
    loop {
        if stream.ready(Interest::PRIORITY).await?.is_read_closed() {
            return Ok(());
        }
        // urgent bytes, which nobody looks at
        let _ = stream.try_io(Interest::PRIORITY, || Err::<(), _>(io::ErrorKind::WouldBlock.into()));
    }
}

/// Waits for ever: here it shows only when there is room again.
#[cfg(not(any(target_os = "linux", target_os = "android")))]
async fn closed(_: &TcpStream) -> io::Result<()> {
    std::future::pending().await
}
