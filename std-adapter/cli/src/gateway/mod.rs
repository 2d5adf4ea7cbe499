//! `bcap gateway`: the gateway of the core between the sockets of this machine, with rules and an audit log.
//!
//! [`bcap_std::gateway`] drives it. This module turns arguments into its configuration and its reports into the log.

mod audit;
mod rotate;
mod throttle;

use std::convert::Infallible;
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use bcap_core::bcap::client;
use bcap_gateway::modbus::Entry;
use bcap_gateway::{Config, Gateway, Memory, Rules};
use bcap_std::gateway::{Driver, Limits, Moved, Report, Traffic};
use bcap_terminal::signal;
use tokio::net::TcpListener;
use tokio::time::sleep;

use self::audit::{Audit, Bounds};
use crate::args::{self, LinkArgs};
use crate::error::Failure;
use crate::listen::{runtime, taken};
use crate::output::{note, print_line};
use crate::rules::Setup;
use bcap_capture::Role;
use bcap_capture::record::{Ends, Recorder, Recording};
use bcap_std::Protocol;

/// The most clients at the same time.
const CLIENTS: usize = 64;

/// Memory for the clients, and for the handles of 256 variables.
type Places = Memory<CLIENTS, 256>;

/// The longest time for a call that the robot keeps alive.
const CALL: Duration = Duration::from_secs(8);

/// The time between two looks whether lines of the log were suppressed, or the recording has failed.
const REPORT: Duration = Duration::from_secs(1);

/// Runs `bcap gateway` until a signal ends it.
pub(crate) fn gateway(args: &args::Gateway, link: &LinkArgs) -> Result<(), Failure> {
    let target = link.network_target()?;
    let more: Vec<Entry> = args.register.iter().chain(&args.coil).copied().collect();
    let Setup { rules, map } = Setup::read(args.rules.as_deref(), &args.clients, &args.allow_put, &more)?;
    if args.modbus.is_some() && map.is_empty() {
        let hint = "--register 100=I/10-19, --coil 0=IO/128-143, or the same in --rules";
        return Err(Failure::Input(format!("--modbus needs a map of registers or coils: {hint}")));
    }
    let config = config(link, target.protocol, rules);
    let limits = Limits::default()
        .connections_per_address(args.clients_per_address)
        .evict_after(Duration::from_secs(args.evict_after.into()));
    let bounds = Bounds {
        rate: args.audit_rate,
        size: u64::from(args.audit_size).saturating_mul(1 << 20),
        keep: args.audit_keep,
    };
    let audit = Arc::new(Mutex::new(Audit::open(&args.audit, target.to_string(), bounds)?));
    let recording = link.write.as_deref().map(|file| Recording::start(Some(file), |_| {})).transpose()?;
    let recorder = recording.as_ref().map(|recording| recording.recorder().clone());
    let counters = runtime()?.block_on(async {
        // the signals first: a reader of the line may send one at once
        let ended = signal::wait()?;
        let listener = TcpListener::bind(args.rac).await.map_err(|error| taken("--rac", args.rac, &error))?;
        let modbus = match args.modbus {
            Some(address) => {
                Some(TcpListener::bind(address).await.map_err(|error| taken("--modbus", address, &error))?)
            }
            None => None,
        };
        let mut ready = format!("ready rac={}", listener.local_addr()?);
        if let Some(modbus) = &modbus {
            ready += &format!(" modbus={}", modbus.local_addr()?);
        }
        print_line(&ready)?;
        // the memory lives as long as the command
        let gateway = Gateway::new(config, Box::leak(Box::new(Places::new())));
        let logged = Arc::clone(&audit);
        let log = move |report: &Report<'_>| lock(&logged).log(report);
        let driver = Driver::new(gateway, (target.host, target.port), log);
        let driver = driver.limits(limits).connect_timeout(link.timeout());
        let driver = match modbus {
            Some(listener) => driver.modbus(listener, Vec::leak(map)),
            None => driver,
        };
        let driver = match recorder {
            Some(recorder) => driver.tap(move |traffic| record(&recorder, traffic)),
            None => driver,
        };
        tokio::select! {
            counters = driver.run(listener, ended) => Ok::<_, Failure>(counters),
            never = report(&audit, recording.as_ref()) => match never {},
        }
    })?;
    // the driver has dropped its log
    if let Some(audit) = Arc::into_inner(audit) {
        audit.into_inner().unwrap_or_else(PoisonError::into_inner).close(&counters);
    }
    Ok(recording.map_or(Ok(()), Recording::finish)?)
}

/// Records the traffic of a connection of the gateway.
fn record(recorder: &Recorder, traffic: &Traffic<'_>) {
    let ends = Ends { is_tcp: traffic.is_tcp, client: traffic.client, server: traffic.server };
    match traffic.moved {
        Moved::Request(bytes) => recorder.bytes(recorder.now(), ends, Role::Request, bytes),
        Moved::Reply(bytes) => recorder.bytes(recorder.now(), ends, Role::Response, bytes),
        Moved::Closed => recorder.closed(ends),
        _ => {}
    }
}

fn lock(audit: &Mutex<Audit>) -> std::sync::MutexGuard<'_, Audit> {
    audit.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Writes the counts of suppressed lines at the end of their interval, even when nothing else is logged. Reports once
/// that the recording has failed: the gateway may run for months after that.
async fn report(audit: &Mutex<Audit>, recording: Option<&Recording>) -> Infallible {
    let mut recording = recording;
    loop {
        sleep(REPORT).await;
        lock(audit).report_suppressed();
        if let Some(failed) = recording.take_if(|recording| recording.has_failed()) {
            let file = failed.file().unwrap_or(Path::new("")).display();
            note(&format!("the recording has failed, and the gateway goes on without it: {file}"));
        }
    }
}

fn config(link: &LinkArgs, protocol: Protocol, rules: Rules<'static>) -> Config<'static> {
    let client = match protocol {
        Protocol::Tcp => client::Config::TCP,
        Protocol::Udp => client::Config::UDP,
    };
    let call = CALL.max(link.timeout());
    let timing = client::Timing {
        // the attempts share the time
        attempt_timeout: (link.timeout() / client.timing.attempts.into()).max(Duration::from_millis(1)),
        deadline: call,
        keep_alive: call,
        ..client.timing
    };
    Config {
        client: client::Config { timing, ..client },
        service: String::leak(link.start_option()),
        provider: String::leak(link.provider().to_owned()),
        option: String::leak(link.option().to_owned()),
        request_timeout: call.saturating_add(Duration::from_secs(2)),
        rules,
        ..Config::RC8
    }
}
