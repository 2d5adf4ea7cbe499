//! `bcap gateway`: the gateway of the core between the sockets of this machine.
//!
//! A task for each client and one for the robot share one [`Gateway`]. Whoever has moved bytes lets it take its steps,
//! then wakes those whom the events are about; the robot's task also keeps the gateway's time.

mod audit;
mod clients;
mod robot;
mod rules;

use std::collections::HashMap;
use std::io;
use std::net::SocketAddr;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use bcap_core::bcap::client;
use bcap_core::gateway::{Config, Event, Gateway, Memory, RobotError};
use bcap_core::handler::PeerId;
use tokio::net::TcpListener;
use tokio::sync::{Notify, watch};

use self::audit::{Answer, Audit, Record};
use crate::args::{self, LinkArgs};
use crate::error::Failure;
use crate::item::print_line;
use crate::signal;
use crate::sim::{runtime, taken};
use crate::target::Transport;

pub(crate) use self::rules::AllowPut;

/// Clients at once, and handles that are kept at the robot.
type Places = Memory<64, 256>;

/// How long the robot may take for a call that it shows to be working on.
const CALL: Duration = Duration::from_secs(8);

/// Runs `bcap gateway`, until a signal ends it.
pub(crate) fn gateway(args: &args::Gateway, link: &LinkArgs) -> Result<(), Failure> {
    let target = link.target()?;
    if target.transport != Transport::Tcp {
        return Err(Failure::Input(format!("{target}: the gateway reaches the robot over TCP; write tcp:HOST[:PORT]")));
    }
    let config = config(args, link)?;
    let audit = Audit::open(&args.audit)?;
    let shared = runtime()?.block_on(async {
        // the signals first: who reads the line may send one at once
        let ended = signal::wait()?;
        let listener = TcpListener::bind(args.rac).await.map_err(|error| taken("--rac", args.rac, &error))?;
        print_line(&format!("ready rac={}", listener.local_addr()?))?;
        // what it takes lives as long as the command
        let gateway = Gateway::new(config, Box::leak(Box::new(Places::new())));
        let shared = Arc::new(Shared::new(gateway, target.to_string(), audit));
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
    let client =
        client::Config { attempt_timeout: link.timeout(), deadline: call, keep_alive: call, ..client::Config::TCP };
    Ok(Config {
        client,
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
    /// Wakes its task.
    wake: Arc<Notify>,
}

impl Shared {
    fn new(gateway: Gateway<'static>, robot: String, audit: Audit) -> Self {
        let inner = Inner { gateway, clients: HashMap::new(), audit, robot, trouble: None };
        Self { inner: Mutex::new(inner), robot: Notify::new() }
    }

    /// Takes the gateway for as long as nothing is awaited.
    fn lock(&self) -> MutexGuard<'_, Inner> {
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Lets the gateway take its steps, and tells those whom they concern.
    fn step(&self) {
        let mut inner = self.lock();
        while let Some(event) = inner.gateway.poll_event(bcap_std::now()) {
            inner.log(event);
            if let Some(client) = event.peer().and_then(|peer| inner.clients.get(&peer)) {
                client.wake.notify_one();
            }
        }
    }

    /// Closes the log.
    fn end(self) {
        let Inner { gateway, audit, .. } = self.inner.into_inner().unwrap_or_else(PoisonError::into_inner);
        audit.end(gateway.counters());
    }
}

impl Inner {
    /// Tells the gateway that there is no connection to the robot, and keeps the reason for the log.
    fn robot_lost(&mut self, error: &io::Error) {
        self.trouble = Some(error.to_string());
        self.gateway.robot_closed(bcap_std::now());
    }

    fn log(&mut self, event: Event) {
        let answer = |peer, result| {
            let client = self.clients.get(&peer).map(|client| client.address.to_string()).unwrap_or_default();
            Answer::new(client, self.gateway.line(peer), result)
        };
        let record = match event {
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
        };
        self.audit.write(&record);
    }
}

/// Tells whether a call on a socket has to wait; any other error is the end of the connection.
fn must_wait<T>(result: &io::Result<T>) -> bool {
    matches!(result, Err(error) if error.kind() == io::ErrorKind::WouldBlock)
}
