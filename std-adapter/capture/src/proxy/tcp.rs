//! TCP connections: a task for each direction.

use std::collections::HashMap;
use std::io;
use std::net::SocketAddr;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use bcap_core::bcap::EOT;
use bcap_core::peers::{Admission, Holder, SlotState, Slots};
use bcap_core::time::Instant;
use bcap_std::now;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::tcp::{OwnedReadHalf, OwnedWriteHalf};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::Notify;
use tokio::task::{Id, JoinError, JoinSet};
use tokio::time::{sleep, timeout};

use super::shared::{CALL, CLIENTS, Shared};
use crate::faults::Faults;
use crate::record::{Ends, Recorder};
use crate::role::Role;

/// The maximum number of bytes that are forwarded in one step.
const BUFFER: usize = 64 << 10;

/// The time to wait when a connection cannot be accepted, such as without a free file descriptor.
const ACCEPT_PAUSE: Duration = Duration::from_millis(50);

/// The slots for connections.
const SLOTS: Slots = Slots { total: CLIENTS, per_host: CLIENTS, evict_after: Some(Duration::from_secs(10)) };

/// Accepts connections, and forwards each until it ends.
pub(super) async fn listen(listener: TcpListener, robot: Arc<[SocketAddr]>, is_rac: bool, shared: Shared) {
    // dropped with this future, which ends the connections
    let mut connections = JoinSet::new();
    let mut holders = HashMap::new();
    let mut is_full = false;
    loop {
        let accepted = tokio::select! {
            accepted = listener.accept() => accepted,
            Some(ended) = connections.join_next_with_id() => {
                free(&mut holders, ended);
                continue;
            }
        };
        // those that have ended do not count
        while let Some(ended) = connections.try_join_next_with_id() {
            free(&mut holders, ended);
        }
        match accepted {
            Ok((stream, client)) if !has_slot(&mut holders) => {
                drop(stream);
                // one note until a slot is free, even if a client connects repeatedly
                if !std::mem::replace(&mut is_full, true) {
                    let ends = Ends { is_tcp: true, client, server: robot.first().copied().unwrap_or(client) };
                    shared.recorder.note(ends, format!("closed connections: {CLIENTS} connections are open"));
                }
            }
            Ok((stream, client)) => {
                is_full = false;
                let activity = Arc::new(ConnectionActivity::new(is_rac));
                let task = connection(stream, client, Arc::clone(&robot), Arc::clone(&activity), shared.clone());
                holders.insert(connections.spawn(task).id(), activity);
            }
            Err(_) => sleep(ACCEPT_PAUSE).await,
        }
    }
}

/// Frees the slot of a connection that has ended.
fn free(holders: &mut HashMap<Id, Arc<ConnectionActivity>>, ended: Result<(Id, ()), JoinError>) {
    holders.remove(&ended.map_or_else(|error| error.id(), |(id, ())| id));
}

/// Returns whether there is a slot for a new connection, and ends the connection that loses it.
fn has_slot(holders: &mut HashMap<Id, Arc<ConnectionActivity>>) -> bool {
    let now = now();
    let taken = holders.iter().map(|(&key, held)| Holder { key, is_same_host: false, state: held.state(now) });
    match SLOTS.admit(taken, now) {
        Admission::Free => true,
        Admission::Instead(id) => {
            if let Some(activity) = holders.remove(&id) {
                activity.evicted.notify_one();
            }
            true
        }
        Admission::Refused => false,
    }
}

/// When the last bytes of a connection passed, and the signal that evicts it.
struct ConnectionActivity {
    is_rac: bool,
    last: Mutex<LastBytes>,
    evicted: Notify,
}

#[derive(Clone, Copy)]
struct LastBytes {
    at: Instant,
    /// Whether they are the end of a request, so the robot has to reply.
    is_request: bool,
}

impl ConnectionActivity {
    fn new(is_rac: bool) -> Self {
        Self { is_rac, last: Mutex::new(LastBytes { at: now(), is_request: false }), evicted: Notify::new() }
    }

    fn passed(&self, sender: Role, bytes: &[u8]) {
        let end = if self.is_rac { b'\r' } else { EOT };
        let last = LastBytes { at: now(), is_request: sender == Role::Request && bytes.last() == Some(&end) };
        *self.last.lock().unwrap_or_else(PoisonError::into_inner) = last;
    }

    fn state(&self, now: Instant) -> SlotState {
        let last = *self.last.lock().unwrap_or_else(PoisonError::into_inner);
        if last.is_request && now.saturating_since(last.at) < CALL { SlotState::Busy } else { SlotState::Idle(last.at) }
    }
}

async fn connection(
    stream: TcpStream,
    client: SocketAddr,
    robot: Arc<[SocketAddr]>,
    activity: Arc<ConnectionActivity>,
    shared: Shared,
) {
    let recorder = &shared.recorder;
    let first = robot.first().copied().unwrap_or(client);
    let server = match timeout(shared.connect_timeout, TcpStream::connect(&*robot)).await {
        Ok(Ok(server)) => server,
        Ok(Err(error)) => return refused(recorder, client, first, &error),
        Err(_) => return refused(recorder, client, first, &io::ErrorKind::TimedOut.into()),
    };
    let shown = if shared.shows_listener { stream.local_addr() } else { server.peer_addr() };
    let ends = Ends { is_tcp: true, client, server: shown.unwrap_or(first) };
    recorder.opened(ends);
    // the first read reports an error
    let _ = (stream.set_nodelay(true), server.set_nodelay(true));
    let faults = shared.faults(activity.is_rac).map(|faults| Arc::new(Mutex::new(faults)));
    let direction = |sender, from, to| Direction {
        sender,
        from,
        to,
        ends,
        recorder: recorder.clone(),
        faults: faults.clone(),
        activity: Arc::clone(&activity),
    };
    let ((from_client, to_client), (from_server, to_server)) = (stream.into_split(), server.into_split());
    let both = async {
        tokio::try_join!(
            direction(Role::Request, from_client, to_server).forward(),
            direction(Role::Response, from_server, to_client).forward(),
        )
    };
    tokio::select! {
        // an error in one direction ends both
        _ = both => {}
        () = activity.evicted.notified() => {
            recorder.note(ends, "closed an idle connection: another needs its slot".into());
        }
    }
    recorder.closed(ends);
}

fn refused(recorder: &Recorder, client: SocketAddr, server: SocketAddr, error: &io::Error) {
    recorder.note(Ends { is_tcp: true, client, server }, format!("cannot connect to the robot at {server}: {error}"));
}

/// One direction of a connection.
struct Direction {
    sender: Role,
    from: OwnedReadHalf,
    to: OwnedWriteHalf,
    ends: Ends,
    recorder: Recorder,
    faults: Option<Arc<Mutex<Faults>>>,
    activity: Arc<ConnectionActivity>,
}

impl Direction {
    /// Forwards bytes until the sender closes its side, then closes that side to the receiver.
    async fn forward(mut self) -> io::Result<()> {
        let mut buffer = vec![0; BUFFER];
        let mut partial = Vec::new();
        loop {
            let count = self.from.read(&mut buffer).await?;
            let at = self.recorder.now();
            let bytes = buffer.get(..count).unwrap_or_default();
            self.activity.passed(self.sender, bytes);
            if count == 0 {
                self.send(at, &partial, None).await?;
                return self.to.shutdown().await;
            }
            match self.faults.clone() {
                None => self.send(at, bytes, None).await?,
                Some(faults) => {
                    partial.extend_from_slice(bytes);
                    self.frames(at, &mut partial, &faults).await?;
                }
            }
        }
    }

    /// Sends bytes, and records them as the client sent or received them.
    async fn send(&mut self, at: u64, bytes: &[u8], note: Option<(String, &[u8])>) -> io::Result<()> {
        // the reply must not be recorded first, so recording does not wait for a slow receiver
        let sent = self.to.try_write(bytes).unwrap_or(0);
        match note {
            None => self.recorder.bytes(at, self.ends, self.sender, bytes),
            Some((note, seen)) => self.recorder.bytes_with(at, self.ends, self.sender, seen, note),
        }
        self.to.write_all(bytes.get(sent..).unwrap_or_default()).await
    }

    /// Sends the whole frames, each with its faults.
    async fn frames(&mut self, at: u64, partial: &mut Vec<u8>, faults: &Mutex<Faults>) -> io::Result<()> {
        loop {
            let (original, verdict) = {
                let mut faults = faults.lock().unwrap_or_else(PoisonError::into_inner);
                let Some(length) = faults.first(partial).filter(|length| *length > 0) else { return Ok(()) };
                let original: Vec<u8> = partial.drain(..length).collect();
                let verdict = faults.judge(self.sender, &original);
                (original, verdict)
            };
            if verdict.note.is_empty() {
                self.send(at, &original, None).await?;
                continue;
            }
            let is_request = self.sender == Role::Request;
            if verdict.is_dropped {
                // the client has sent a request, but not received a reply
                if is_request {
                    self.recorder.bytes_with(at, self.ends, self.sender, &original, verdict.note);
                } else {
                    self.recorder.note(self.ends, verdict.note);
                }
                continue;
            }
            let forwarded = verdict.applied(&original);
            if is_request {
                self.recorder.bytes_with(at, self.ends, self.sender, &original, verdict.note);
                sleep(verdict.delay).await;
                self.to.write_all(&forwarded).await?;
            } else {
                sleep(verdict.delay).await;
                self.send(self.recorder.now(), &forwarded, Some((verdict.note, &forwarded))).await?;
            }
        }
    }
}
