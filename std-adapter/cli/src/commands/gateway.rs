//! `bcap gateway`: the gateway of the core between the sockets of this machine, with rules and an audit log.
//!
//! [`bcap_std::gateway`] drives it. This module turns arguments into its configuration and its reports into the log.

use std::convert::Infallible;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use bcap_capture::Role;
use bcap_capture::record::{Ends, Recorder, Recording};
use bcap_core::bcap::client;
use bcap_gateway::modbus::Entry;
use bcap_gateway::{Config, Memory, Network, Rules};
use bcap_service::audit::{Audit, Bounds};
use bcap_service::rules::{AllowPut, Setup, network};
use bcap_std::Protocol;
use bcap_std::gateway::{Driver, Limits, Moved, Report, Traffic};
use bcap_terminal::signal;
use clap::Args;
use tokio::time::sleep;

use crate::failure::Failure;
use crate::link::LinkArgs;
use crate::listen::{runtime, tcp, tcp_if};
use crate::output::{note, print_line};

/// Lets PLCs that speak RAC or Modbus TCP read, and if rules allow it write, the variables of a robot that speaks b-CAP
///
/// Prints one line, `ready rac=IP:PORT` and with --modbus `modbus=IP:PORT`, when it listens, then the audit log: one JSON object a line for every request and
/// for each change of the robot's session. While the robot is disconnected, every request is answered with E_NOT_CONNECTED
/// at once. SIGINT, SIGTERM and SIGHUP end it with 0, after running requests have been answered.
#[derive(Debug, Args)]
#[command(after_help = "\
A file of rules. By default everything may be read and nothing written.
  clients = [\"10.0.0.0/24\"]               # who may connect; left out, all clients
  convert = true                            # a value of another type is converted where nothing is lost
  rate = { per_second = 50, burst = 10 }    # for each client
  [[get]]
  kind = \"P\"
  [[put]]
  kind = \"I\"
  index = [0, 99]                           # or one number
  values = [-10, 10]                        # or a list of ranges, one for each element
  clients = \"10.0.0.7\"                    # for this client or network only
The same file may have the map of Modbus, before the first [[get]] or [[put]].
  register = [\"100=I/10-19:i16\", \"200=F/0-9\"]
  coil = [\"0=IO/128-143\"]
Examples:
  bcap gateway --robot tcp:192.168.0.1
  bcap gateway --robot udp:192.168.0.1 --allow-put I/0-99,IO/128-143 --allow-put F/5=0..1
  bcap gateway --rac [::]:5006 --clients 10.0.0.0/24 --robot tcp:192.168.0.1 --rules rules.toml --audit /var/log/gateway.jsonl
  bcap gateway --robot tcp:192.168.0.1 --modbus 127.0.0.1:5020 --register 100=I/10-19:i16 --coil 0=IO/128-143")]
pub(crate) struct Gateway {
    /// Where RAC listens
    #[arg(long, value_name = "ADDR", default_value = "127.0.0.1:5006")]
    pub(crate) rac: SocketAddr,

    /// Where Modbus TCP listens, usually on port 502; off by default. The map says which variables its clients read and write
    #[arg(long, value_name = "ADDR")]
    pub(crate) modbus: Option<SocketAddr>,

    /// Maps holding registers to variables: ADDRESS=KIND[/FIRST[-LAST]][:FORMAT][:low]; can be repeated
    ///
    /// Addresses count from 0. FORMAT is i16, u16 or i32 for I, and f32 or f64 for D. A number begins with its high register,
    /// with low with its low one.
    #[arg(long, value_name = "ENTRY", requires = "modbus", value_parser = Entry::registers)]
    pub(crate) register: Vec<Entry>,

    /// Maps coils to variables: ADDRESS=IO[/FIRST[-LAST]]; can be repeated
    #[arg(long, value_name = "ENTRY", requires = "modbus", value_parser = Entry::coils)]
    pub(crate) coil: Vec<Entry>,

    /// The rules for clients, in TOML
    #[arg(long, value_name = "FILE")]
    pub(crate) rules: Option<PathBuf>,

    /// The networks whose clients may connect, in addition to the rules: IPv4 ADDRESS[/PREFIX], several separated by commas.
    /// Without any, all clients may
    ///
    /// The connection of any other client is reset. A client that connects over IPv6 belongs to no network except 0.0.0.0/0.
    #[arg(long, value_name = "NETWORKS", value_delimiter = ',', value_parser = network)]
    pub(crate) clients: Vec<Network>,

    /// Allows variables to be written, in addition to the rules: KIND[/FIRST[-LAST]][=MIN..MAX[,MIN..MAX]...], several
    /// separated by commas
    ///
    /// Each range is about one element of the value, the last range also about the elements after it. Without a range any
    /// finite value may be written; an infinity only if a range has it as its bound.
    #[arg(long, value_name = "RULES", value_parser = AllowPut::parse)]
    pub(crate) allow_put: Vec<AllowPut>,

    /// Connections of one IP address at the same time, of 64 in all, with RAC and Modbus
    #[arg(long, value_name = "COUNT", default_value_t = 16)]
    pub(crate) clients_per_address: usize,

    /// The seconds of silence after which a connection may be closed when another needs its slot. The connection that has
    /// been idle longest is closed first
    #[arg(long, value_name = "SECONDS", default_value_t = 10)]
    pub(crate) evict_after: u32,

    /// Where the audit log goes; a file is appended to, - is the standard output
    #[arg(long, value_name = "FILE", default_value = "-")]
    pub(crate) audit: PathBuf,

    /// The lines a second that one IP address may cause in the audit log, and ten times as many at once. Further lines are
    /// counted only; 0 writes all. Successful writes are always logged
    #[arg(long, value_name = "LINES", default_value_t = 10)]
    pub(crate) audit_rate: u32,

    /// The size in MiB at which a log file is renamed to FILE.1 and a new file begins; 0 for any size
    #[arg(long, value_name = "MIB", default_value_t = 16)]
    pub(crate) audit_size: u32,

    /// The number of old log files to keep; FILE.1 is the newest
    #[arg(long, value_name = "COUNT", default_value_t = 4)]
    pub(crate) audit_keep: u32,
}

/// The maximum number of clients at the same time.
const CLIENTS: usize = 64;

/// Memory for the clients, and for the handles of 256 variables.
type Places = Memory<CLIENTS, 256>;

/// Maximum time for a call that the robot keeps alive.
const CALL: Duration = Duration::from_secs(8);

/// Interval of the checks for suppressed log lines, and for a failed recording.
const REPORT: Duration = Duration::from_secs(1);

/// Runs `bcap gateway` until a signal ends it.
pub(crate) fn gateway(args: &Gateway, link: &LinkArgs) -> Result<(), Failure> {
    let target = link.network_target()?;
    let more: Vec<Entry> = args.register.iter().chain(&args.coil).copied().collect();
    let Setup { rules, map } =
        Setup::read(args.rules.as_deref(), &args.clients, &args.allow_put, &more).map_err(Failure::Input)?;
    if args.modbus.is_some() && map.is_empty() {
        let hint = "--register 100=I/10-19, --coil 0=IO/128-143, or the same in --rules";
        return Err(Failure::Input(format!("--modbus needs a map of registers or coils: {hint}")));
    }
    let config = config(link, target.protocol, rules);
    let limits = Limits {
        connections_per_address: args.clients_per_address,
        evict_after: Some(Duration::from_secs(args.evict_after.into())),
        ..Limits::default()
    };
    let bounds = Bounds {
        rate: args.audit_rate,
        size: u64::from(args.audit_size).saturating_mul(1 << 20),
        keep: args.audit_keep,
    };
    let audit = Audit::open(&args.audit, target.to_string(), bounds);
    let audit = Arc::new(Mutex::new(audit.map_err(|error| Failure::Input(error.to_string()))?));
    let recording = link.write.as_deref().map(|file| Recording::start(Some(file), |_| {})).transpose()?;
    let recorder = recording.as_ref().map(|recording| recording.recorder().clone());
    let counters = runtime()?.block_on(async {
        // install the signal handlers first: a reader of the `ready` line may send a signal immediately
        let ended = signal::wait()?;
        let listener = tcp("--rac", args.rac).await?;
        let modbus = tcp_if("--modbus", args.modbus).await?;
        let mut ready = format!("ready rac={}", listener.local_addr()?);
        if let Some(modbus) = &modbus {
            ready += &format!(" modbus={}", modbus.local_addr()?);
        }
        print_line(&ready)?;
        // the memory lives as long as the command
        let gateway = bcap_gateway::Gateway::new(config, Box::leak(Box::new(Places::new())));
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
    let (client, attempts) = match protocol {
        Protocol::Tcp => (client::Config::TCP, 1),
        Protocol::Udp => (client::Config::UDP, link.attempts()),
    };
    let call = CALL.max(link.timeout());
    let timing = client::Timing {
        attempts,
        // they share the time
        attempt_timeout: (link.timeout() / u32::from(attempts)).max(Duration::from_millis(1)),
        deadline: call,
        keep_alive: call,
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

#[cfg(test)]
mod tests {
    use clap::Parser as _;

    use super::*;
    use crate::cli::Cli;

    #[test]
    fn the_attempts_over_udp_are_those_of_the_option() {
        let args = ["bcap", "gateway", "--robot", "udp:127.0.0.1", "--attempts", "2", "--attempt-timeout", "500"];
        let link = Cli::try_parse_from(args).unwrap().link;
        let timing = |protocol| config(&link, protocol, Rules::READ_ONLY).client.timing;
        let attempt = Duration::from_millis(500);
        assert_eq!((timing(Protocol::Udp).attempts, timing(Protocol::Udp).attempt_timeout), (2, attempt));
        assert_eq!((timing(Protocol::Tcp).attempts, timing(Protocol::Tcp).attempt_timeout), (1, 2 * attempt));
    }
}
