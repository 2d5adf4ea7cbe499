//! Datagrams: a socket to the robot for each client, so that the robot can tell clients apart.

use std::collections::HashMap;
use std::io;
use std::net::{Ipv4Addr, Ipv6Addr, SocketAddr};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use bcap_core::bcap::{Decoder, FunctionId};
use bcap_core::hresult::HResult;
use bcap_core::peers::{Admission, Holder, SlotState, Slots};
use bcap_core::time::Instant;
use tokio::net::UdpSocket;
use tokio::task::{AbortHandle, JoinSet};
use tokio::time::{sleep, timeout};

use super::shared::{CALL, CLIENTS, Shared};
use crate::faults::Faults;
use crate::record::{Ends, Recorder};
use crate::role::Role;

/// The silence of the robot after which a client's socket is closed. A client that returns gets a new socket.
const SILENCE: Duration = Duration::from_secs(600);

/// The same after the reply to Service_Stop, which the client requests again if it is lost.
const STOPPED: Duration = Duration::from_secs(5);

/// The same for a client without any reply from the robot.
const UNANSWERED: Duration = Duration::from_secs(30);

/// The slots for clients.
const SLOTS: Slots = Slots { total: CLIENTS, per_host: CLIENTS, evict_after: Some(Duration::from_secs(10)) };

/// The largest datagram.
const DATAGRAM: usize = 65_535;

/// The maximum number of delayed requests of all clients, and of delayed replies to one client: each needs memory.
const DELAYED: usize = 4096;

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
    activity: Arc<Mutex<Activity>>,
}

/// The activity of a client, with the time of the last datagram that changed it.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Activity {
    Idle(Instant),
    /// The robot has to reply.
    Waiting(Instant),
    /// The client has stopped its service.
    Over,
}

impl Activity {
    fn request(&mut self, bytes: &[u8], now: Instant) {
        *self = match (Decoder::UDP.decode_datagram(bytes).map(|frame| frame.function()), *self) {
            (Ok(FunctionId::SERVICE_STOP), _) => Self::Over,
            (Ok(_), _) => Self::Waiting(now),
            (Err(_), Self::Waiting(since)) => Self::Waiting(since),
            (Err(_), _) => Self::Idle(now),
        };
    }

    fn reply(&mut self, bytes: &[u8], now: Instant) {
        if let (Self::Waiting(_), Ok(frame)) = (*self, Decoder::UDP.decode_datagram(bytes)) {
            *self = if frame.hresult() == HResult::S_EXECUTING { Self::Waiting(now) } else { Self::Idle(now) };
        }
    }

    fn state(self, now: Instant) -> SlotState {
        match self {
            Self::Waiting(since) if now.saturating_since(since) < CALL => SlotState::Busy,
            Self::Waiting(since) | Self::Idle(since) => SlotState::Idle(since),
            Self::Over => SlotState::Over,
        }
    }
}

/// Forwards datagrams until it is dropped.
pub(super) async fn serve(socket: UdpSocket, robot: SocketAddr, shared: Shared) {
    let (here, clients) = (Arc::new(socket), Clients::default());
    // dropped with this future, which ends the clients and the delayed requests
    let (mut replies, mut delayed) = (JoinSet::new(), JoinSet::new());
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
        lock(&client.activity).request(request, bcap_std::now());
        client.forward(&mut delayed, Role::Request, at, request).await;
    }
}

/// Returns whether there is a slot for a new client, and closes the socket of the client that loses it.
fn has_slot(clients: &Clients) -> bool {
    let (mut clients, now) = (lock(clients), bcap_std::now());
    let state = |client: &Client| lock(&client.activity).state(now);
    let holders = clients.iter().map(|(&key, (client, _))| Holder { key, is_same_host: false, state: state(client) });
    match SLOTS.admit(holders, now) {
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
        activity: Arc::new(Mutex::new(Activity::Idle(Instant::ZERO))),
    })
}

/// Forwards the robot's datagrams to a client, until the service has stopped or the robot is silent.
async fn forward_replies(client: Client, clients: Clients) {
    let mut buffer = vec![0; DATAGRAM];
    let mut silence = UNANSWERED;
    let mut delayed = JoinSet::new();
    loop {
        let limit = if *lock(&client.activity) == Activity::Over { STOPPED } else { silence };
        match timeout(limit, client.robot.recv(&mut buffer)).await {
            Ok(Ok(count)) => {
                silence = SILENCE;
                let at = client.recorder.now();
                let reply = buffer.get(..count).unwrap_or_default();
                lock(&client.activity).reply(reply, bcap_std::now());
                client.forward(&mut delayed, Role::Response, at, reply).await;
            }
            // an ICMP error: no server listens there now
            Ok(Err(error)) => client.recorder.note(client.ends, format!("the robot: {error}")),
            Err(_) => break,
        }
    }
    lock(&clients).remove(&client.ends.client);
    client.recorder.closed(client.ends);
    // the delay of a reply may be longer than the silence
    while delayed.join_next().await.is_some() {}
}

impl Client {
    /// Forwards a datagram with its faults, and records it as the client sent or received it. Dropping `delayed`
    /// drops the delayed datagrams.
    async fn forward(&self, delayed: &mut JoinSet<()>, sender: Role, at: u64, bytes: &[u8]) {
        let verdict = self.faults.as_deref().map(|faults| lock(faults).judge(sender, bytes));
        let Some(mut verdict) = verdict.filter(|verdict| !verdict.note.is_empty()) else {
            let sent = self.try_send(sender, bytes);
            // the reply must not be recorded first, so recording does not wait for the socket
            self.recorder.bytes(at, self.ends, sender, bytes);
            if sent.is_err_and(|error| error.kind() == io::ErrorKind::WouldBlock) {
                self.send(sender, bytes).await;
            }
            return;
        };
        while delayed.try_join_next().is_some() {}
        if !verdict.is_dropped && delayed.len() >= DELAYED {
            verdict.is_dropped = true;
            verdict.note = format!("fault: dropped a datagram: {DELAYED} others are delayed");
        }
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
        delayed.spawn(deliver);
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

#[cfg(test)]
mod tests {
    use bcap_core::bcap::FrameWriter;

    use super::*;
    use crate::faults::FaultPlan;
    use crate::record::Recording;

    const HERE: &str = "127.0.0.1:0";

    /// The state of a proxy that delays all datagrams.
    fn delaying() -> Shared {
        let recording = Recording::start(None, |_| {}).unwrap();
        let faults = FaultPlan { delay: vec!["60s".parse().unwrap()], ..FaultPlan::default() };
        Shared::new(&recording, Duration::ZERO, faults, 0, false)
    }

    #[tokio::test]
    async fn a_delayed_request_is_not_sent_after_the_end_of_the_proxy() {
        let (robot, here) = (UdpSocket::bind(HERE).await.unwrap(), UdpSocket::bind(HERE).await.unwrap());
        let client = UdpSocket::bind(HERE).await.unwrap();
        client.send_to(b"x", here.local_addr().unwrap()).await.unwrap();
        let serving = serve(here, robot.local_addr().unwrap(), delaying());
        let tasks = tokio::runtime::Handle::current().metrics();
        let begun = async {
            // one for the replies, and one that waits to send the request
            while tasks.num_alive_tasks() < 2 {
                tokio::task::yield_now().await;
            }
        };
        tokio::select! {
            () = serving => {}
            () = begun => {}
        }
        let ended = async {
            while tasks.num_alive_tasks() > 0 {
                tokio::task::yield_now().await;
            }
        };
        timeout(Duration::from_secs(30), ended).await.unwrap();
    }

    #[tokio::test]
    async fn the_number_of_delayed_datagrams_is_limited() {
        let here = Arc::new(UdpSocket::bind(HERE).await.unwrap());
        let address = here.local_addr().unwrap();
        let client = open(&here, address, address, &delaying()).await.unwrap();
        let mut delayed = JoinSet::new();
        for _ in 0..=DELAYED {
            client.forward(&mut delayed, Role::Request, 0, b"x").await;
        }
        assert_eq!(delayed.len(), DELAYED);
    }

    fn frame(buffer: &mut [u8; 16], code: i32) -> &[u8] {
        FrameWriter::new(buffer).unwrap().finish(1, 0, code).unwrap()
    }

    #[test]
    fn a_client_that_waits_for_a_reply_keeps_its_slot() {
        let mut buffers = [[0; 16]; 3];
        let [request, executing, reply] = &mut buffers;
        let request = frame(request, FunctionId::SERVICE_START.0);
        let (executing, reply) = (frame(executing, HResult::S_EXECUTING.0), frame(reply, HResult::S_OK.0));
        let at = Instant::from_millis;
        let mut client = Activity::Idle(at(0));
        client.request(request, at(1));
        client.request(b"x", at(2));
        client.reply(executing, at(3));
        assert_eq!(client.state(at(600_002)), SlotState::Busy);
        assert_eq!(client.state(at(600_003)), SlotState::Idle(at(3)));
        client.reply(reply, at(4));
        assert_eq!(client.state(at(5)), SlotState::Idle(at(4)));
    }
}
