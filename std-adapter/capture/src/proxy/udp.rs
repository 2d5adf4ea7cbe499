//! Datagrams: a socket to the robot for each client, so that the robot can tell clients apart.

use std::collections::HashMap;
use std::io;
use std::net::{Ipv4Addr, Ipv6Addr, SocketAddr};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use bcap_core::bcap::{Decoder, FunctionId};
use bcap_core::peers::{Admission, Holder, SlotState, Slots};
use bcap_core::time::Instant;
use tokio::net::UdpSocket;
use tokio::task::{AbortHandle, JoinSet};
use tokio::time::{sleep, timeout};

use super::shared::{CLIENTS, Shared};
use crate::faults::Faults;
use crate::record::{Ends, Recorder};
use crate::role::Role;

/// The silence of the robot after which a client's socket is closed. A client that comes back gets another one.
const SILENCE: Duration = Duration::from_secs(600);

/// The same after the reply to Service_Stop, which the client requests again if it is lost.
const STOPPED: Duration = Duration::from_secs(5);

/// The same for a client that the robot has never answered.
const UNANSWERED: Duration = Duration::from_secs(30);

/// The slots for clients.
const SLOTS: Slots = Slots { total: CLIENTS, per_host: CLIENTS, evict_after: Some(Duration::from_secs(10)) };

/// The largest datagram.
const DATAGRAM: usize = 65_535;

type Clients = Arc<Mutex<HashMap<SocketAddr, (Client, AbortHandle)>>>;

/// A client with its socket to the robot.
#[derive(Clone)]
struct Client {
    ends: Ends,
    /// Where its datagrams arrive and its replies leave.
    here: Arc<UdpSocket>,
    robot: Arc<UdpSocket>,
    recorder: Recorder,
    faults: Option<Arc<Mutex<Faults>>>,
    state: Arc<Mutex<SlotState>>,
}

/// Forwards datagrams until it is dropped.
pub(super) async fn serve(socket: UdpSocket, robot: SocketAddr, shared: Shared) {
    let (here, clients) = (Arc::new(socket), Clients::default());
    let mut replies = JoinSet::new();
    let mut is_full = false;
    let mut buffer = vec![0; DATAGRAM];
    loop {
        let received = tokio::select! {
            received = here.recv_from(&mut buffer) => received,
            Some(_) = replies.join_next() => continue,
        };
        // an ICMP error for an earlier reply does not affect the socket
        let Ok((count, from)) = received else { continue };
        let at = shared.recorder.now();
        let known = lock(&clients).get(&from).map(|(client, _)| client.clone());
        let ends = Ends { is_tcp: false, client: from, server: robot };
        let client = match known {
            Some(client) => client,
            None if !has_slot(&clients) => {
                // one note until a slot is free: a flood of datagrams must not become a flood of notes
                if !std::mem::replace(&mut is_full, true) {
                    let text = format!("dropped datagrams of more than {CLIENTS} clients over UDP");
                    shared.recorder.note(ends, text);
                }
                continue;
            }
            None => match open(&here, from, robot, &shared).await {
                Ok(client) => {
                    is_full = false;
                    let task = replies.spawn(forward_replies(client.clone(), Arc::clone(&clients)));
                    lock(&clients).insert(from, (client.clone(), task));
                    client
                }
                Err(error) => {
                    shared.recorder.note(ends, format!("no socket to the robot at {robot}: {error}"));
                    continue;
                }
            },
        };
        let request = buffer.get(..count).unwrap_or_default();
        *lock(&client.state) = match Decoder::UDP.decode_datagram(request).map(|frame| frame.function()) {
            Ok(FunctionId::SERVICE_STOP) => SlotState::Over,
            _ => SlotState::Idle(bcap_std::now()),
        };
        client.forward(Role::Request, at, request).await;
    }
}

/// Tells whether there is a slot for a new client, and closes the socket of the client that loses it.
fn has_slot(clients: &Clients) -> bool {
    let mut clients = lock(clients);
    let holders =
        clients.iter().map(|(&key, (client, _))| Holder { key, is_same_host: false, state: *lock(&client.state) });
    match SLOTS.admit(holders, bcap_std::now()) {
        Admission::Free => true,
        Admission::Instead(address) => {
            if let Some((client, task)) = clients.remove(&address) {
                task.abort();
                client.recorder.closed(client.ends);
            }
            true
        }
        Admission::Refused => false,
    }
}

fn lock<T>(shared: &Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    shared.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Opens the socket to the robot for a client.
async fn open(here: &Arc<UdpSocket>, from: SocketAddr, robot: SocketAddr, shared: &Shared) -> io::Result<Client> {
    let any = if robot.is_ipv4() { Ipv4Addr::UNSPECIFIED.into() } else { Ipv6Addr::UNSPECIFIED.into() };
    let socket = UdpSocket::bind(SocketAddr::new(any, 0)).await?;
    socket.connect(robot).await?;
    let shown = if shared.shows_listener { here.local_addr()? } else { robot };
    Ok(Client {
        ends: Ends { is_tcp: false, client: from, server: shown },
        here: Arc::clone(here),
        robot: Arc::new(socket),
        recorder: shared.recorder.clone(),
        faults: shared.faults(false).map(|faults| Arc::new(Mutex::new(faults))),
        state: Arc::new(Mutex::new(SlotState::Idle(Instant::ZERO))),
    })
}

/// Forwards the robot's datagrams to a client, until the service has stopped or the robot is silent.
async fn forward_replies(client: Client, clients: Clients) {
    let mut buffer = vec![0; DATAGRAM];
    let mut silence = UNANSWERED;
    loop {
        let limit = if *lock(&client.state) == SlotState::Over { STOPPED } else { silence };
        match timeout(limit, client.robot.recv(&mut buffer)).await {
            Ok(Ok(count)) => {
                silence = SILENCE;
                let at = client.recorder.now();
                client.forward(Role::Response, at, buffer.get(..count).unwrap_or_default()).await;
            }
            // an ICMP error: no server listens there now
            Ok(Err(error)) => client.recorder.note(client.ends, format!("the robot: {error}")),
            Err(_) => break,
        }
    }
    lock(&clients).remove(&client.ends.client);
    client.recorder.closed(client.ends);
}

impl Client {
    /// Forwards a datagram with its faults, and records it as the client sent or received it.
    async fn forward(&self, sender: Role, at: u64, bytes: &[u8]) {
        let verdict = self.faults.as_deref().map(|faults| lock(faults).judge(sender, bytes));
        let Some(verdict) = verdict.filter(|verdict| !verdict.note.is_empty()) else {
            let sent = self.try_send(sender, bytes);
            // the reply must not be recorded first, so recording does not wait for the socket
            self.recorder.bytes(at, self.ends, sender, bytes);
            if sent.is_err_and(|error| error.kind() == io::ErrorKind::WouldBlock) {
                self.send(sender, bytes).await;
            }
            return;
        };
        if sender == Role::Request {
            self.recorder.bytes_with(at, self.ends, sender, bytes, verdict.note.clone());
        } else if verdict.is_dropped {
            return self.recorder.note(self.ends, verdict.note);
        }
        if verdict.is_dropped {
            return;
        }
        let (client, forwarded) = (self.clone(), verdict.applied(bytes));
        let deliver = async move {
            sleep(verdict.delay).await;
            client.send(sender, &forwarded).await;
            if sender == Role::Response {
                client.recorder.bytes_with(client.recorder.now(), client.ends, sender, &forwarded, verdict.note);
            }
        };
        // others may overtake it, as on a network
        drop(tokio::spawn(deliver));
    }

    fn try_send(&self, sender: Role, bytes: &[u8]) -> io::Result<usize> {
        match sender {
            Role::Request => self.robot.try_send(bytes),
            Role::Response => self.here.try_send_to(bytes, self.ends.client),
        }
    }

    async fn send(&self, sender: Role, bytes: &[u8]) {
        // a datagram that cannot be sent is lost, as on a network
        let _ = match sender {
            Role::Request => self.robot.send(bytes).await,
            Role::Response => self.here.send_to(bytes, self.ends.client).await,
        };
    }
}
