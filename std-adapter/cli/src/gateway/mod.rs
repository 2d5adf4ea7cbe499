//! `bcap gateway`: the gateway of the core between the sockets of this machine.
//!
//! A task for each client and one for the robot share one [`Gateway`]. After moving bytes, a task polls the gateway and
//! wakes the tasks its events concern; the robot's task also keeps the gateway's time.

mod audit;
mod clients;
mod robot;
mod rotate;
mod rules;
mod throttle;

use std::collections::HashMap;
use std::io;
use std::net::SocketAddr;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use bcap_core::bcap::client;
use bcap_core::gateway::{Config, Event, Gateway, Memory, RobotError};
use bcap_core::handler::PeerId;
use bcap_core::rac::Verb;
use bcap_core::time::Instant;
use bcap_std::server::{Admission, SlotState, Slots};
use tokio::net::TcpListener;
use tokio::sync::{Notify, watch};

use self::audit::{Answer, Audit, Bounds, Record};
use crate::args::{self, LinkArgs};
use crate::error::Failure;
use crate::item::print_line;
use crate::signal;
use crate::sim::{runtime, taken};
use crate::target::Transport;

pub(crate) use self::rules::AllowPut;

/// Clients at once.
pub(crate) const CLIENTS: usize = 64;

/// Memory for the clients, and for the handles that are kept at the robot.
type Places = Memory<CLIENTS, 256>;

/// How long the robot may take for a call that it shows to be working on.
const CALL: Duration = Duration::from_secs(8);

/// Runs `bcap gateway`, until a signal ends it.
pub(crate) fn gateway(args: &args::Gateway, link: &LinkArgs) -> Result<(), Failure> {
    let target = link.target()?;
    if target.transport != Transport::Tcp {
        return Err(Failure::Input(format!("{target}: the gateway reaches the robot over TCP; write tcp:HOST[:PORT]")));
    }
    let config = config(args, link)?;
    let bounds = Bounds {
        rate: args.audit_rate,
        size: u64::from(args.audit_size).saturating_mul(1 << 20),
        keep: args.audit_keep,
    };
    let audit = Audit::open(&args.audit, bounds)?;
    let slots = Slots {
        total: CLIENTS,
        per_address: args.clients_per_address,
        evict_after: Duration::from_secs(args.evict_after.into()),
    };
    let shared = runtime()?.block_on(async {
        // the signals first: who reads the line may send one at once
        let ended = signal::wait()?;
        let listener = TcpListener::bind(args.rac).await.map_err(|error| taken("--rac", args.rac, &error))?;
        print_line(&format!("ready rac={}", listener.local_addr()?))?;
        // what it takes lives as long as the command
        let gateway = Gateway::new(config, Box::leak(Box::new(Places::new())));
        let shared = Arc::new(Shared::new(gateway, slots, target.to_string(), audit));
        let (stop, stopped) = watch::channel(());
        let robot = robot::run(Arc::clone(&shared), target, link.timeout(), stopped.clone());
        let clients = clients::listen(listener, Arc::clone(&shared), stopped);
        let signal = async {
            ended.await;
            drop(stop);
        };
        tokio::join!(robot, clients, signal);
        Ok::<_, Failure>(shared)
    })?;
    if let Ok(shared) = Arc::try_unwrap(shared) {
        shared.end();
    }
    Ok(())
}

fn config(args: &args::Gateway, link: &LinkArgs) -> Result<Config<'static>, Failure> {
    let call = CALL.max(link.timeout());
    let timing =
        client::Timing { attempt_timeout: link.timeout(), deadline: call, keep_alive: call, ..client::Timing::TCP };
    Ok(Config {
        client: client::Config { timing, ..client::Config::TCP },
        service: String::leak(link.start_option()),
        provider: String::leak(link.provider.clone()),
        request_timeout: call.saturating_add(Duration::from_secs(2)),
        rules: rules::read(args.rules.as_deref(), &args.allow_put)?,
        ..Config::RC8
    })
}

/// What all tasks share.
struct Shared {
    inner: Mutex<Inner>,
    /// Wakes the robot's task.
    robot: Notify,
}

struct Inner {
    gateway: Gateway<'static>,
    slots: Slots,
    clients: HashMap<PeerId, Client>,
    audit: Audit,
    /// The robot's address, for the log.
    robot: String,
    /// Why the last connection to the robot ended, or none was to be had.
    trouble: Option<String>,
}

/// A client that is connected.
struct Client {
    address: SocketAddr,
    /// When bytes were received or sent last.
    last_active: Instant,
    /// Wakes its task.
    wake: Arc<Notify>,
}

impl Shared {
    fn new(gateway: Gateway<'static>, slots: Slots, robot: String, audit: Audit) -> Self {
        let inner = Inner { gateway, slots, clients: HashMap::new(), audit, robot, trouble: None };
        Self { inner: Mutex::new(inner), robot: Notify::new() }
    }

    /// Takes the gateway for as long as nothing is awaited.
    fn lock(&self) -> MutexGuard<'_, Inner> {
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Polls the gateway, and wakes the tasks that its events concern.
    fn step(&self) {
        let mut inner = self.lock();
        while let Some(event) = inner.gateway.poll_event(bcap_std::now()) {
            inner.log(event);
            if let Some(client) = event.peer().and_then(|peer| inner.clients.get(&peer)) {
                client.wake.notify_one();
            }
        }
        inner.audit.report();
    }

    /// Closes the log.
    fn end(self) {
        let inner = self.inner.into_inner().unwrap_or_else(PoisonError::into_inner);
        let totals = inner.gateway.counters().into();
        inner.audit.close(totals);
    }
}

impl Inner {
    /// Tells the gateway that there is no connection to the robot, and keeps the reason for the log.
    fn robot_lost(&mut self, error: &io::Error) {
        self.trouble = Some(error.to_string());
        self.gateway.robot_closed(bcap_std::now());
    }

    /// Seats a client that has connected; `None` when it gets no slot.
    fn open(&mut self, address: SocketAddr) -> Option<(PeerId, Arc<Notify>)> {
        let taken = self.clients.iter().map(|(peer, client)| (*peer, client.address.ip(), self.state(*peer, client)));
        match self.slots.admit(taken, address.ip(), bcap_std::now()) {
            Admission::Free => {}
            Admission::Instead(peer) => self.close(peer),
            Admission::Refused => return None,
        }
        let peer = self.gateway.open()?;
        let wake = Arc::new(Notify::new());
        self.clients.insert(peer, Client { address, last_active: bcap_std::now(), wake: Arc::clone(&wake) });
        Some((peer, wake))
    }

    fn state(&self, peer: PeerId, client: &Client) -> SlotState {
        match self.gateway.is_running(peer) || !self.gateway.transmit(peer).is_empty() {
            true => SlotState::Busy,
            false => SlotState::Idle(client.last_active),
        }
    }

    /// Frees the slot of a client, and ends its task if that still runs.
    fn close(&mut self, peer: PeerId) {
        self.gateway.close(peer);
        if let Some(client) = self.clients.remove(&peer) {
            client.wake.notify_one();
            self.log_client(client.address, |client| Record::Disconnected { client });
        }
    }

    /// Records that bytes of a client were received or sent.
    fn moved(&mut self, peer: PeerId) {
        if let Some(client) = self.clients.get_mut(&peer) {
            client.last_active = bcap_std::now();
        }
    }

    /// Writes a record about a client, unless there are too many of its address.
    fn log_client(&mut self, client: SocketAddr, record: impl FnOnce(String) -> Record) {
        if self.audit.admits(client.ip()) {
            self.audit.write(&record(client.to_string()));
        }
    }

    fn log(&mut self, event: Event) {
        if let Some(client) = event.peer().and_then(|peer| self.clients.get(&peer)) {
            let address = client.address;
            // what has changed the robot is never left out
            let must = matches!(event, Event::Served { request, .. } if request.verb == Verb::Put);
            if must || self.audit.admits(address.ip()) {
                let record = self.record(event, address.to_string());
                self.audit.write(&record);
            }
        } else {
            let record = self.record(event, String::new());
            self.audit.write(&record);
        }
    }

    /// Describes an event; `client` is the address of the client that it concerns.
    fn record(&mut self, event: Event, client: String) -> Record {
        let answer = |peer, result| Answer::new(client, self.gateway.line(peer), result);
        match event {
            Event::Served { peer, result, time, .. } => Record::Served(answer(peer, result).took(time)),
            Event::Failed { peer, result, time, .. } => Record::Failed(answer(peer, result).took(time)),
            Event::Refused { peer, refusal } => {
                Record::Refused(answer(peer, refusal.hresult()).because(refusal.to_string()))
            }
            Event::RobotUp => Record::RobotUp { robot: self.robot.clone() },
            Event::RobotDown { error, pause } => Record::RobotDown {
                robot: self.robot.clone(),
                reason: match (error, self.trouble.take()) {
                    (RobotError::Closed, Some(trouble)) => trouble,
                    (error, _) => error.to_string(),
                },
                retry_ms: u64::try_from(pause.as_millis()).unwrap_or(u64::MAX),
            },
        }
    }
}

/// Tells whether a call on a socket has to wait; any other error is the end of the connection.
fn must_wait<T>(result: &io::Result<T>) -> bool {
    matches!(result, Err(error) if error.kind() == io::ErrorKind::WouldBlock)
}
