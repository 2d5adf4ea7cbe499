//! b-CAP over TCP: a listener, and a task for each connection.

use std::io;
use std::sync::Arc;
use std::time::Duration;

use bcap_core::bcap::server::{Config, Handler, Session};
use bcap_core::bcap::{Decoder, FrameWriter, Progress};
use bcap_core::handler::PeerId;
use bcap_core::hresult::HResult;
use bcap_core::time::Instant;
use socket2::SockRef;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::watch;
use tokio::task::JoinSet;
use tokio::time::timeout;

use super::Limits;
use super::shared::{Changes, Shared};
use crate::clock::{now, until};
use crate::connect::{STREAM_ROOM, set_up_tcp};

/// Handles that one peer can have open.
const OBJECTS: usize = 1000;
/// Connections over the limit that are told so at the same time; more are closed without a word.
const REFUSALS: usize = 32;
/// How long a connection over the limit has for its first request.
const REFUSAL_TIME: Duration = Duration::from_secs(2);

type StreamSession = Session<Vec<u8>, Vec<u8>, OBJECTS>;

/// Accepts connections until the server stops.
pub(super) async fn listen<H: Handler + Send + 'static>(
    listener: TcpListener,
    shared: Arc<Shared<H>>,
    limits: Limits,
    stopped: watch::Receiver<()>,
) -> io::Result<()> {
    accept(listener, limits, stopped.clone(), refuse, |stream| {
        let peer = shared.next_peer();
        let changes = shared.changes();
        serve(stream, peer, Arc::clone(&shared), changes, limits, stopped.clone())
    })
    .await
}

/// Accepts connections, serves as many as the limit allows and refuses the others.
pub(super) async fn accept<S, R>(
    listener: TcpListener,
    limits: Limits,
    mut stopped: watch::Receiver<()>,
    refuse: impl Fn(TcpStream) -> R,
    mut serve: impl FnMut(TcpStream) -> S,
) -> io::Result<()>
where
    S: Future<Output = ()> + Send + 'static,
    R: Future<Output = ()> + Send + 'static,
{
    let mut served = JoinSet::new();
    let mut refused = JoinSet::new();
    loop {
        let accepted = tokio::select! {
            accepted = listener.accept() => accepted,
            _ = stopped.changed() => break,
            _ = served.join_next(), if !served.is_empty() => continue,
            _ = refused.join_next(), if !refused.is_empty() => continue,
        };
        match accepted {
            Ok((stream, address)) => {
                if let Err(error) = set_up_tcp(SockRef::from(&stream), limits.keep_alive) {
                    tracing::debug!(%address, %error, "the connection was gone at once");
                } else if served.len() < limits.connections {
                    served.spawn(serve(stream));
                } else if refused.len() < REFUSALS {
                    tracing::warn!(%address, limit = limits.connections, "too many connections");
                    refused.spawn(refuse(stream));
                }
            }
            // what one connection does wrong is not the listener's end; out of files is over when some are closed
            Err(error) => {
                tracing::warn!(%error, "cannot accept a connection");
                tokio::time::sleep(Duration::from_millis(50)).await;
            }
        }
    }
    refused.abort_all();
    while served.join_next().await.is_some() {}
    Ok(())
}

/// Answers the first request of a connection over the limit with E_MAX_CONNECT.
async fn refuse(mut stream: TcpStream) {
    let answer = async {
        let mut buffer = [0; 512];
        let mut len = 0;
        let serial = loop {
            let count = stream.read(buffer.get_mut(len..)?).await.ok()?;
            len += count;
            match Decoder::TCP.decode(buffer.get(..len)?) {
                Ok(Progress::Complete(frame, _)) => break frame.serial,
                Ok(Progress::NeedMore(_)) if count > 0 => {}
                _ => return None,
            }
        };
        let mut reply = [0; 16];
        let reply = FrameWriter::new(&mut reply).ok()?.finish(serial, 0, HResult::E_MAX_CONNECT.0).ok()?;
        stream.write_all(reply).await.ok()?;
        stream.shutdown().await.ok()
    };
    let _ = timeout(REFUSAL_TIME, answer).await;
}

/// Serves one connection until it ends or the server stops.
async fn serve<H: Handler + Send + 'static>(
    stream: TcpStream,
    peer: PeerId,
    shared: Arc<Shared<H>>,
    changes: Changes<H>,
    limits: Limits,
    stopped: watch::Receiver<()>,
) {
    let mut config = Config::TCP;
    config.limits.frame = limits.frame;
    let session = Box::new(Session::new(config, vec![0; STREAM_ROOM], vec![0; STREAM_ROOM]));
    let mut connection = Connection { stream, session, peer, shared, changes, limits, partial_since: None };
    match connection.run(stopped).await {
        Ok(reason) => tracing::debug!(peer = peer.0, reason, "b-CAP connection ended"),
        Err(error) => tracing::debug!(peer = peer.0, %error, "b-CAP connection failed"),
    }
    connection.session.close(&mut *connection.shared.handler(), peer, now());
    connection.shared.has_changed();
}

struct Connection<H> {
    stream: TcpStream,
    session: Box<StreamSession>,
    peer: PeerId,
    shared: Arc<Shared<H>>,
    changes: Changes<H>,
    limits: Limits,
    /// When the first byte of an unfinished request came.
    partial_since: Option<Instant>,
}

impl<H: Handler + Send + 'static> Connection<H> {
    /// Moves bytes until there is a reason to end.
    async fn run(&mut self, mut stopped: watch::Receiver<()>) -> io::Result<&'static str> {
        loop {
            self.think();
            if !self.session.transmit().is_empty() {
                if !self.send().await? {
                    return Ok("the peer does not read");
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
            tokio::select! {
                count = self.stream.read(room), if !room.is_empty() => match count? {
                    0 => return Ok("the peer has closed it"),
                    count => self.session.received(count),
                },
                () = tokio::time::sleep(until(due.unwrap_or(Instant::ZERO))), if due.is_some() => {
                    if self.partial_since.is_some_and(|since| since.saturating_add(self.limits.receive) <= now()) {
                        return Ok("a request took too long to arrive");
                    }
                }
                () = self.changes.next() => {}
                _ = stopped.changed() => return Ok("the server stops"),
            }
        }
    }

    /// Lets the session do what it can.
    fn think(&mut self) {
        // said beforehand: what others change while the handler is asked must not be missed
        self.changes.wait(self.session.is_running());
        let mut changed = false;
        loop {
            let event = self.session.run(&mut *self.shared.handler(), self.peer, now());
            let Some(event) = event else { break };
            tracing::trace!(peer = self.peer.0, ?event);
            changed = true;
        }
        if changed {
            self.shared.has_changed();
        }
        if self.session.is_running() && !self.changes.is_waiting() {
            // the handler has just begun to wait; ask once more, now that changes are heard
            self.changes.wait(true);
            let _ = self.session.run(&mut *self.shared.handler(), self.peer, now());
        }
    }

    /// Sends what it can; `false` when the peer takes nothing for too long.
    async fn send(&mut self) -> io::Result<bool> {
        let bytes = self.session.transmit();
        let count = match self.stream.try_write(bytes) {
            Err(error) if error.kind() == io::ErrorKind::WouldBlock => {
                match timeout(self.limits.send, self.stream.write(bytes)).await {
                    Ok(written) => written?,
                    Err(_) => return Ok(false),
                }
            }
            written => written?,
        };
        self.session.transmitted(count);
        Ok(true)
    }

    fn note_partial(&mut self) {
        self.partial_since = self.session.is_receiving().then(|| self.partial_since.unwrap_or_else(now));
    }

    /// Returns when something is due even if no bytes come.
    fn due(&self) -> Option<Instant> {
        let partial = self.partial_since.map(|since| since.saturating_add(self.limits.receive));
        match (self.session.poll_timeout(), partial) {
            (Some(a), Some(b)) => Some(a.min(b)),
            (a, b) => a.or(b),
        }
    }
}
