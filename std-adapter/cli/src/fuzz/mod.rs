//! `bcap fuzz`: sends sessions to a device and saves what goes wrong.
//!
//! ```text
//!  engine    a seed -> sessions; reduces, confirms and saves findings
//!  device    runs steps and judges the replies; a new client must be served afterwards
//!  gate      what may be sent
//!  session   the handles of a connection, and their permitted uses
//!  minimise  delta debugging
//! ```
//!
//! The generators and the judge of replies come from `bcap-testkit`.

mod device;
mod engine;
mod finding;
mod gate;
mod minimise;
mod save;
mod session;
mod wire;

use std::time::{Duration, Instant};

use bcap_std::Protocol;
use bcap_testkit::grammar::Grammar;
use bcap_testkit::step::{Argument, Step};
use serde::Serialize;

use self::device::Device;
use self::engine::{Plan, Saved};
use self::finding::{Finding, Kind};
use self::gate::Gate;
use crate::args::{Fuzz, LinkArgs, RobotPorts};
use crate::error::Failure;
use crate::interrupt::Interrupt;
use crate::output::{note, print_block, print_json, print_line};
use crate::robot;
use bcap_capture::record::Recording;

/// Runs `bcap fuzz`.
pub(crate) fn fuzz(args: &Fuzz, link: &LinkArgs, json: bool) -> Result<(), Failure> {
    if !args.yes_this_device_is_mine {
        return Err(Failure::Input(
            "a fuzzer may crash the device, and a faulty device may do anything; if it is yours to break, add \
             --yes-this-device-is-mine"
                .into(),
        ));
    }
    let again = args.again.as_deref().map(save::read).transpose()?;
    if again.is_none() && link.write.is_some() {
        return Err(Failure::Input(
            "every finding has a capture in --out; --write records only the steps of --again".into(),
        ));
    }
    let mut device = device(args, link)?;
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

fn device(args: &Fuzz, link: &LinkArgs) -> Result<Device, Failure> {
    let robot = robot::resolve(&RobotPorts { robot_udp: None, robot_rac: args.robot_rac.clone() }, link)?;
    let (bcap, protocol) = match link.network_target()?.protocol {
        Protocol::Tcp => (robot.tcp, wire::Protocol::Bcap),
        Protocol::Udp => (vec![robot.udp], wire::Protocol::Datagrams),
    };
    let mut device = Device {
        bcap,
        protocol,
        reconnect: args.reconnect.unwrap_or_default(),
        rac: None,
        timeout: link.timeout(),
        gate: Gate::new(args.with_writes.clone(), args.with_motion),
        interrupt: Interrupt::install(|_| {})?,
        interval: Duration::from_secs(1).checked_div(args.rate).unwrap_or_default(),
        next: Instant::now(),
        packets: 0,
    };
    match wire::Wire::connect(&robot.rac, wire::Protocol::Rac, device.timeout, None) {
        Ok(_) => device.rac = Some(robot.rac),
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

fn run(device: &mut Device, args: &Fuzz, link: &LinkArgs, json: bool) -> Result<(), Failure> {
    let began = Instant::now();
    let plan = Plan {
        seed: args.seed,
        grammar: Grammar {
            datagrams: device.protocol == wire::Protocol::Datagrams,
            ..device.gate.grammar(link.provider())
        },
        until: began + args.duration,
        sessions: args.runs.unwrap_or(u64::MAX),
        findings: args.findings,
        restart: args.restart,
        out: args.out.clone(),
    };
    let mut count = 0;
    let result = engine::fuzz(device, &plan, |saved| {
        count += 1;
        Ok(if json { print_json(&line(saved)) } else { print_block(&text(saved)) }?)
    });
    let (sessions, answers) = result?;
    if !answers {
        note(&format!("the device has not answered for {} ms, so the run ends", args.restart.as_millis()));
    }
    let totals =
        Totals { seed: args.seed, sessions, packets: device.packets, findings: count, ms: began.elapsed().as_millis() };
    if json {
        // serializing numbers cannot fail
        print_json(&serde_json::to_string(&totals).unwrap_or_default())?;
    } else {
        let Totals { seed, sessions, packets, findings, ms } = totals;
        print_line(&format!("seed {seed}: {sessions} sessions, {packets} packets, {findings} findings in {ms} ms"))?;
    }
    if count == 0 { Ok(()) } else { Err(Failure::Findings(count)) }
}

/// Runs the steps of a file once.
fn run_again(device: &mut Device, steps: &[Step], link: &LinkArgs, json: bool) -> Result<(), Failure> {
    if let Some(step) = steps.iter().find(|step| !may_pass(&device.gate, step)) {
        return Err(Failure::Input(format!(
            "this step may move or write: {step}; nothing was sent. Allow it with --with-motion, or a variable with --with-writes"
        )));
    }
    let recording = link.write.as_deref().map(|file| Recording::start(Some(file), |_| {})).transpose()?;
    let found = device.run(steps, recording.as_ref().map(Recording::recorder));
    recording.map_or(Ok(()), Recording::finish)?;
    let shown = match found? {
        None => return Ok(print_line("no finding")?),
        Some(finding) => finding,
    };
    if json {
        // serializing strings cannot fail
        print_json(&serde_json::to_string(&Shown::of(&shown)).unwrap_or_default())?;
    } else {
        print_line(&shown.to_string())?;
    }
    Err(Failure::Findings(1))
}

/// Returns whether the gate would send a step. A write depends on the variable that is open then, so a step that writes passes if any
/// variable may be written; the gate checks it again when it is sent.
fn may_pass(gate: &Gate, step: &Step) -> bool {
    match step {
        Step::Call(call) => gate.has_call(&call.to_frame(1, |_: &Argument| 0), gate.any_variable().as_deref()),
        Step::Bytes(bytes) => gate.has_bytes(bytes),
        Step::Line(line) => gate.has_lines(line),
        Step::Reconnect => true,
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

/// A finding as a line of JSON.
#[derive(Serialize)]
struct Shown<'a> {
    kind: Kind,
    subject: &'a str,
    detail: &'a str,
}

impl<'a> Shown<'a> {
    fn of(finding: &'a Finding) -> Self {
        Self { kind: finding.kind, subject: &finding.subject, detail: &finding.detail }
    }
}

#[derive(Serialize)]
struct SavedLine<'a> {
    #[serde(flatten)]
    finding: Shown<'a>,
    session: u64,
    after_ms: u128,
    repeatable: bool,
    steps: usize,
    file: String,
    capture: Option<String>,
}

fn line(saved: &Saved) -> String {
    let capture = Some(&saved.files.capture).filter(|path| path.exists());
    let line = SavedLine {
        finding: Shown::of(&saved.finding),
        session: saved.session,
        after_ms: saved.after.as_millis(),
        repeatable: saved.is_repeatable,
        steps: saved.steps,
        file: saved.files.steps.display().to_string(),
        capture: capture.map(|path| path.display().to_string()),
    };
    // serializing strings and numbers cannot fail
    serde_json::to_string(&line).unwrap_or_default()
}

/// The numbers at the end.
#[derive(Serialize)]
struct Totals {
    seed: u64,
    sessions: u64,
    packets: u64,
    findings: usize,
    ms: u128,
}
