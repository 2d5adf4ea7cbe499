//! `bcap fuzz`: the arguments, the captures and the output of the fuzzer of `bcap-testkit`.

use std::io;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use bcap_capture::record::{Ends, Recorder, Recording};
use bcap_capture::{Role, duration};
use bcap_gateway::AllowBuf;
use bcap_std::Protocol;
use bcap_testkit::fuzz::{self, Device, Error, Finding, Gate, Plan, Range, Saved};
use bcap_testkit::grammar::Grammar;
use bcap_testkit::restart::Restarter;
use bcap_testkit::step::Step;
use bcap_testkit::wire::{self, Link, Tape};
use clap::Args;
use serde_json::{Value, json};

use crate::commands::judge::Recovery;
use crate::commands::robot_ports::{self, RobotPorts};
use crate::failure::Failure;
use crate::interrupt::Interrupt;
use crate::link::LinkArgs;
use crate::output::{note, print_block, print_json, print_line, print_result};

/// Fuzzes a device that you may break: sends valid, nearly valid and hostile sessions, and saves what goes wrong
///
/// Each session has a separate connection, and depends only on --seed and its number. After it a new client must be
/// served. A finding is a crash, a hang, a connection that the device closes after a valid frame, a wrong reply
/// (malformed, serial, type of the value), a handle that is valid without being open, or a leak of handles. It is
/// repeated, reduced to the steps that it needs, and saved in --out as steps (for --again) and as a capture (for `bcap
/// decode` and Wireshark). With findings the exit code is 1.
///
/// By default the fuzzer sends only functions that open, read and release, and commands that read, as `bcap replay` does without
/// --allow. That holds for hostile bytes too: a damaged frame whose function could be another one is not sent. Still a device with a
/// fault may do anything with any packet. Keep its emergency stop at hand. The address of --robot chooses the link of b-CAP, TCP or UDP.
/// RAC is fuzzed if its port is open.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  bcap fuzz --robot 192.168.0.1 --seed 1 --duration 2s --yes-this-device-is-mine
  bcap fuzz --robot 192.168.0.1 --seed 7 --runs 20 --rate 500 --with-writes I/90-99 --yes-this-device-is-mine
  bcap fuzz --robot udp:192.168.0.1 --runs 20 --reconnect 500ms --yes-this-device-is-mine
  bcap fuzz --robot 192.168.0.1 --again finding.steps --yes-this-device-is-mine")]
pub(crate) struct Fuzz {
    /// Confirms that the device may crash, and that no person or machine depends on it
    #[arg(long)]
    pub(crate) yes_this_device_is_mine: bool,

    /// Chooses the sessions; the same number gives the same ones
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub(crate) seed: u64,

    /// Ends after this time
    #[arg(long, value_name = "TIME", value_parser = duration::parse, default_value = "1min")]
    pub(crate) duration: Duration,

    /// Ends after this number of sessions
    #[arg(long, value_name = "N")]
    pub(crate) runs: Option<u64>,

    /// Ends after this number of different findings
    #[arg(long, value_name = "N", default_value_t = 20, value_parser = clap::value_parser!(u64).range(1..))]
    pub(crate) findings: u64,

    /// Retries refused connections for this time, for devices with few slots. A restart within this time is not detected
    #[arg(long, value_name = "TIME", value_parser = duration::parse)]
    pub(crate) reconnect: Option<Duration>,

    /// Sends at most this number of packets in a second; 0 is no limit
    #[arg(long, value_name = "N", default_value_t = 200)]
    pub(crate) rate: u32,

    /// Runs the steps of a file once instead
    #[arg(long, value_name = "FILE")]
    pub(crate) again: Option<PathBuf>,

    /// The folder for findings; it is made for the first one
    #[arg(long, value_name = "DIR", default_value = "fuzz-findings")]
    pub(crate) out: PathBuf,

    /// Writes these variables too, KIND[/FIRST[-LAST]] such as I/90-99; the option may be repeated
    #[arg(long, value_name = "RANGE", value_parser = range)]
    pub(crate) with_writes: Vec<AllowBuf>,

    /// Sends every function of the specification, and commands that move or set, such as Draw, Motor, SetTool and KillAll
    ///
    /// The robot moves, tasks start and stop, and settings and files change. `bcap call --list --effects` lists them.
    #[arg(long)]
    pub(crate) with_motion: bool,

    #[command(flatten)]
    pub(crate) recovery: Recovery,

    /// The robot's address for RAC [default: the host of --robot and port 5006]
    #[arg(long, value_name = "HOST[:PORT]")]
    pub(crate) robot_rac: Option<String>,
}

/// Parses a range of variables; a fuzzer sends any value, so a rule with values would promise too much.
fn range(text: &str) -> Result<AllowBuf, String> {
    if text.contains('=') {
        return Err("a fuzzer sends any value; write KIND[/FIRST[-LAST]], such as I/90-99".into());
    }
    AllowBuf::parse(text).map_err(|error| error.to_string())
}

/// Runs `bcap fuzz`.
pub(crate) fn fuzz(args: &Fuzz, link: &LinkArgs, json: bool) -> Result<(), Failure> {
    if !args.yes_this_device_is_mine {
        return Err(Failure::Input(
            "a fuzzer may crash the device, and a faulty device may do anything; if it is yours to break, add \
             --yes-this-device-is-mine"
                .into(),
        ));
    }
    let again = args.again.as_deref().map(fuzz::read).transpose()?;
    if again.is_none() && link.write.is_some() {
        return Err(Failure::Input(
            "every finding has a capture in --out; --write records only the steps of --again".into(),
        ));
    }
    let interrupt = Interrupt::install(|_| {})?;
    let is_ended = || interrupt.is_interrupted();
    let mut device = device(args, link, &is_ended)?;
    if let Some(finding) = device.probe(None)? {
        return Err(Failure::Connection {
            message: format!("the device does not serve a client before the first packet: {finding}"),
            hint: "check --robot with `bcap doctor`".into(),
        });
    }
    match again {
        Some(steps) => run_again(&mut device, &steps, link, json),
        None => run(&mut device, args, link, json),
    }
}

fn device<'a>(args: &Fuzz, link: &LinkArgs, is_ended: &'a dyn Fn() -> bool) -> Result<Device<'a>, Failure> {
    let robot = robot_ports::resolve(&RobotPorts { robot_udp: None, robot_rac: args.robot_rac.clone() }, link)?;
    let (bcap, over) = match link.network_target()?.protocol {
        Protocol::Tcp => (robot.tcp, Link::Tcp),
        Protocol::Udp => (vec![robot.udp], Link::Udp),
    };
    let range = |rule: &bcap_gateway::AllowBuf| {
        let allow = rule.as_allow();
        Range { kind: allow.kind, first: allow.first, last: allow.last }
    };
    let gate = Gate::new(args.with_writes.iter().map(range).collect(), args.with_motion);
    let mut device = Device::new(bcap, over, gate, link.timeout(), is_ended);
    let Recovery { restart, restarts, .. } = &args.recovery;
    device.restarter = restart.as_deref().map(|command| Restarter::new(command, *restarts));
    device.reconnect = args.reconnect.unwrap_or_default();
    device.interval = Duration::from_secs(1).checked_div(args.rate).unwrap_or_default();
    match device.with_rac(robot.rac) {
        Ok(()) => {}
        Err(error) if args.robot_rac.is_some() => {
            return Err(Failure::Connection {
                message: format!("cannot connect to RAC: {error}"),
                hint: "check --robot-rac; without it only b-CAP is fuzzed if the port is closed".into(),
            });
        }
        Err(error) => note(&format!("RAC is not fuzzed: {error}")),
    }
    Ok(device)
}

fn run(device: &mut Device<'_>, args: &Fuzz, link: &LinkArgs, json: bool) -> Result<(), Failure> {
    let began = Instant::now();
    let plan = Plan {
        seed: args.seed,
        grammar: Grammar { datagrams: device.is_datagrams(), ..device.gate.grammar(link.provider()) },
        until: began + args.duration,
        sessions: args.runs.unwrap_or(u64::MAX),
        findings: args.findings,
        wait: args.recovery.wait,
        out: args.out.clone(),
    };
    let mut count = 0;
    let result = fuzz::fuzz(device, &plan, &mut record, |saved| {
        count += 1;
        Ok::<_, Failure>(if json { print_json(&line(saved)) } else { print_block(&text(saved)) }?)
    });
    let (sessions, answers) = result?;
    if !answers {
        note(&format!("the device has not answered for {} ms, so the run ends", args.recovery.wait.as_millis()));
    }
    let (seed, packets, ms) = (args.seed, device.packets(), millis(began.elapsed()));
    let totals = json!({ "seed": seed, "sessions": sessions, "packets": packets, "findings": count, "ms": ms });
    let line = format!("seed {seed}: {sessions} sessions, {packets} packets, {count} findings in {ms} ms");
    print_result(json, &totals, &line)?;
    if count == 0 { Ok(()) } else { Err(Failure::Reported(format!("{count} findings"))) }
}

/// Runs the steps of a file once.
fn run_again(device: &mut Device<'_>, steps: &[Step], link: &LinkArgs, json: bool) -> Result<(), Failure> {
    if let Some(step) = steps.iter().find(|step| !device.gate.may_pass(step)) {
        return Err(Failure::Input(format!(
            "this step may move or write: {step}; nothing was sent. Allow it with --with-motion, or a variable with --with-writes"
        )));
    }
    let recording = link.write.as_deref().map(|file| Recording::start(Some(file), |_| {})).transpose()?;
    let recorder = recording.as_ref().map(|recording| Records(recording.recorder().clone()));
    let found = device.run(steps, recorder.as_ref().map(|recorder| recorder as &dyn wire::Recorder));
    recording.map_or(Ok(()), Recording::finish)?;
    let Some(finding) = found? else { return Ok(print_line("no finding")?) };
    print_result(json, &object(&finding), &finding.to_string())?;
    Err(Failure::Reported("1 findings".into()))
}

impl From<Error> for Failure {
    fn from(error: Error) -> Self {
        match error {
            Error::Ended => Self::Interrupted(error.to_string()),
            other => Self::Input(other.to_string()),
        }
    }
}

/// Begins the capture of a finding.
fn record(file: &Path) -> io::Result<Box<dyn fuzz::Recording>> {
    let recording = Recording::start(Some(file), |_| {}).map_err(io::Error::other)?;
    let recorder = Records(recording.recorder().clone());
    Ok(Box::new(Capture { recording, recorder }))
}

/// The capture of a finding.
struct Capture {
    recording: Recording,
    recorder: Records,
}

impl fuzz::Recording for Capture {
    fn recorder(&self) -> &dyn wire::Recorder {
        &self.recorder
    }

    fn finish(self: Box<Self>) -> io::Result<()> {
        self.recording.finish().map_err(io::Error::other)
    }
}

/// Records connections to the file of a recording.
struct Records(Recorder);

impl wire::Recorder for Records {
    fn opened(&self, is_tcp: bool, client: SocketAddr, server: SocketAddr) -> Box<dyn Tape> {
        let ends = Ends { is_tcp, client, server };
        self.0.opened(ends);
        Box::new(Taped(self.0.clone(), ends))
    }
}

/// A recorded connection.
#[derive(Debug)]
struct Taped(Recorder, Ends);

impl Tape for Taped {
    fn bytes(&self, is_request: bool, bytes: &[u8]) {
        let sender = if is_request { Role::Request } else { Role::Response };
        self.0.bytes(self.0.now(), self.1, sender, bytes);
    }
}

impl Drop for Taped {
    fn drop(&mut self) {
        self.0.closed(self.1);
    }
}

fn text(saved: &Saved) -> String {
    let Saved { finding, session, after, steps, is_repeatable, files } = saved;
    let repeated = if *is_repeatable { "repeatable" } else { "not repeated" };
    format!(
        "{finding}\n  session {session}, after {} ms, {repeated}, {steps} steps: {}",
        after.as_millis(),
        files.steps.display()
    )
}

/// A finding as JSON.
fn object(finding: &Finding) -> Value {
    json!({ "kind": finding.kind.name(), "subject": finding.subject, "detail": finding.detail })
}

fn line(saved: &Saved) -> String {
    let capture = Some(&saved.files.capture).filter(|path| path.exists());
    let mut line = object(&saved.finding);
    line["session"] = saved.session.into();
    line["after_ms"] = millis(saved.after).into();
    line["repeatable"] = saved.is_repeatable.into();
    line["steps"] = saved.steps.into();
    line["file"] = saved.files.steps.display().to_string().into();
    line["capture"] = capture.map(|path| path.display().to_string()).into();
    line.to_string()
}

fn millis(time: Duration) -> u64 {
    u64::try_from(time.as_millis()).unwrap_or(u64::MAX)
}
