//! The state of the robots as JSON, in sections: a page gets the sections of its screen, each when it has changed.

use std::sync::atomic::Ordering;
use std::time::Duration;

use bcap_capture::{Role, dissect, hex};
use bcap_core::bcap::StreamState;
use bcap_core::hresult::HResult;
use bcap_live::axis::Axis;
use bcap_live::errors::own;
use bcap_live::jog::{FASTEST, LONGEST, Phase};
use bcap_live::log::Entry;
use bcap_live::model::Variable;
use bcap_live::tap::Status;
use bcap_std::Examination;
use serde_json::{Value, json};

use crate::app::App;
use crate::arm;
use crate::control::Client;
use crate::robot::{Live, Robot, TARGET};
use crate::text::safe;
use crate::threads::lock;

const NOT_READ: &str = "the state was not read for 3 s";

/// Writes a hint as a sentence.
fn sentence(text: &str) -> String {
    let mut letters = text.chars();
    let Some(first) = letters.next() else { return String::new() };
    let end = if text.ends_with('.') { "" } else { "." };
    format!("{}{}{end}", first.to_uppercase(), letters.as_str())
}

/// Returns the tile of a robot for a page.
pub(crate) fn tile(number: usize, robot: &Robot, client: Client) -> Value {
    let (holder, mine) = (robot.control.holder(), robot.control.user(client).is_ok());
    let live = robot.live();
    let (level, state, reasons) = condition(&live);
    json!({
        "robot": number,
        "name": safe(&robot.name),
        "address": safe(&robot.access.address),
        "virtual": live.is_virtual,
        "holder": holder,
        "mine": mine,
        "revoked": robot.revoked(),
        "level": level,
        "state": state,
        "words": live.model.words.iter().map(safe).collect::<Vec<_>>(),
        "reasons": reasons,
        "errors": live.model.errors.as_ref().map_or(0, Vec::len),
        "speed": live.model.robot.speed.as_deref().map(safe),
        "tool": live.model.robot.tool.as_deref().map(safe),
        "work": live.model.robot.work.as_deref().map(safe),
        "joints": live.model.robot.joints,
        "units": arm::units(live.type_name.as_deref().unwrap_or_default(), live.model.robot.joints.len()),
        "position": live.model.robot.position,
        "tasks": live.model.tasks.iter().map(|(name, state)| [safe(name), safe(state)]).collect::<Vec<_>>(),
    })
}

/// Returns the state of a robot at a glance: `good`, `busy`, `bad` or `unknown` for the colour, the state in words, and why it
/// is not ready, each with its remedy.
fn condition(live: &Live) -> (&'static str, &'static str, Vec<[String; 2]>) {
    if let Some(why) = &live.model.lost {
        let remedy = "bcap web tries again every second. Check that the controller is on, the cable, and the address.";
        return ("unknown", "not connected", vec![[safe(why), remedy.into()]]);
    }
    let examination = match &live.examination {
        Some(_) if live.is_old() => {
            let remedy = "An order takes long, or the pages show too many variables. HALT does not wait for that.";
            return ("unknown", "unknown", vec![[NOT_READ.into(), remedy.into()]]);
        }
        Some(Ok(examination)) => examination,
        Some(Err(why)) => return ("unknown", "unknown", vec![[safe(why), String::new()]]),
        None => return ("unknown", "unknown", vec![["it is being read".into(), String::new()]]),
    };
    if examination.stream == StreamState::Runs {
        let remedy = "Nothing is sent that would end the stream. HALT stops the robot.".into();
        return ("busy", "streaming", vec![["another client streams in Slave Mode".into(), remedy]]);
    }
    let mut reasons = reasons(examination);
    if examination.state.is_some_and(|state| state.is_moving()) {
        return ("busy", "moving", reasons);
    }
    if examination.error_count > 0 || live.model.has_error {
        return ("bad", "error", reasons);
    }
    if !reasons.is_empty() {
        return ("bad", "not ready", reasons);
    }
    if examination.state.is_some_and(|state| state.motor_is_on()) {
        return ("good", "ready", reasons);
    }
    reasons.push(["the motor is off".into(), "The program that moves the robot switches it on.".into()]);
    ("good", "ready, motor off", reasons)
}

fn reasons(examination: &Examination) -> Vec<[String; 2]> {
    let obstacles = examination.obstacles().map(|obstacle| {
        let text = obstacle.to_string();
        let (what, remedy) = text.split_once(": ").unwrap_or((&text, ""));
        [safe(what), sentence(&safe(remedy))]
    });
    let errors = examination.errors().iter().map(|code| {
        let meaning = code.meaning().unwrap_or("an error without a published meaning");
        [format!("{code} {meaning}"), code.hint().map(|hint| sentence(&hint.to_string())).unwrap_or_default()]
    });
    // an error that only a person can remove is an obstacle too
    let mut reasons: Vec<[String; 2]> = Vec::new();
    for reason in errors.chain(obstacles.filter(|[what, _]| !what.starts_with("the error "))) {
        if !reasons.contains(&reason) {
            reasons.push(reason);
        }
    }
    reasons
}

/// Returns the variables of a page: name, text, whether it changed a moment ago, whether it has a value, number, whether the text is
/// exact.
pub(crate) fn variables(client: Client, robot: &Robot) -> Value {
    let live = robot.live();
    let names = live.names.get(&client).map(Vec::as_slice).unwrap_or_default();
    let row = |variable: &Variable| {
        let number = variable.value.as_ref().and(variable.history.last());
        json!([
            safe(&variable.name),
            safe(&variable.text),
            variable.has_changed(live.model.now),
            variable.value.is_some(),
            number,
            safe(&variable.text) == variable.text
        ])
    };
    // the thread of the robot reads them in the order of their names
    let find = |name: &String| {
        let found = live.model.variables.binary_search_by(|variable| variable.name.cmp(name)).ok()?;
        live.model.variables.get(found)
    };
    Value::Array(names.iter().filter_map(find).map(row).collect())
}

/// Returns what the server allows, its robots, and the last actions.
pub(crate) fn session(app: &App) -> Value {
    json!({
        "write": app.config.allow_write,
        "motion": app.config.allow_motion,
        "login": app.guard.login.is_some(),
        "backups": app.config.backups.is_some(),
        "labels": app.config.labels.len(),
        "recordings": app.config.recordings.as_ref().map(|_| app.robots.iter().filter_map(|robot| recording(robot)).collect::<Vec<_>>()),
        "robots": app.robots.iter().map(|robot| [safe(&robot.name), safe(&robot.access.address)]).collect::<Vec<_>>(),
        "audit": app.audit.last(),
    })
}

/// Returns the recording of a robot: its file, whether it runs, its size, its length in seconds, and why it ended early.
fn recording(robot: &Robot) -> Option<Value> {
    let (file, row) = match robot.access.tap.status() {
        Status::Off => return None,
        Status::Runs { file, size, length } => (file, json!([true, size, length.as_secs(), null])),
        Status::Ended((file, outcome)) => (file, json!([false, 0, 0, outcome.err().map(|why| safe(&why))])),
    };
    Some(json!([safe(&robot.name), safe(&file.file_name()?.to_string_lossy()), row]))
}

/// Returns the alarms: the current errors with their meanings and remedies, the first cause first, and the messages.
pub(crate) fn alarms(robot: &Robot) -> Value {
    let (recovery, live) = (recovery(robot), robot.live());
    let examination = live.examination.iter().flatten().filter(|_| !live.is_old());
    let steps = examination.clone().filter(|state| !state.is_ready()).flat_map(|state| state.steps(false));
    let obstacles = examination.clone().flat_map(Examination::obstacles);
    let skipped = live.model.errors.as_ref().err().map(safe);
    json!({
        "errors": live.model.errors.iter().flatten().map(|(code, text)| error(*code, text)).collect::<Vec<_>>(),
        "skipped": skipped.or_else(|| live.is_old().then(|| NOT_READ.into())),
        "recovery": recovery,
        "known": examination.count() > 0,
        "steps": steps.map(|step| step.name()).collect::<Vec<_>>(),
        "obstacles": obstacles.map(|obstacle| sentence(&obstacle.to_string())).collect::<Vec<_>>(),
        "messages": live.model.messages.iter().rev().map(safe).collect::<Vec<_>>(),
    })
}

/// Returns the last recovery of a robot.
fn recovery(robot: &Robot) -> Value {
    let Some(recovery) = lock(&robot.recovery).clone() else { return Value::Null };
    let state = recovery.state();
    let result = |result: &Result<(), HResult>| result.err().map(|code| format!("left out: {code}"));
    json!({
        "plan": state.plan.iter().map(|step| step.name()).collect::<Vec<_>>(),
        "done": state.done.iter().map(|(step, made)| json!([step.name(), result(made)])).collect::<Vec<_>>(),
        "next": state.next().map(|step| step.name()),
        "busy": state.is_busy(),
        "failed": state.outcome.as_ref().is_some_and(Result::is_err),
        "outcome": state.outcome.map(|outcome| safe(&outcome.map_or_else(|why| why, str::to_owned))),
    })
}

/// Returns a result code with its meaning and remedy.
pub(crate) fn error(code: HResult, text: &str) -> Value {
    json!({
        "code": format!("{:#010X}", code.to_u32()),
        "name": code.name(),
        "text": safe(own(code, text)),
        "meaning": code.meaning(),
        "cause": code.cause(),
        "remedy": code.hint().map(|hint| sentence(&hint.to_string())),
        "level": code.level(),
    })
}

/// Returns the type and the dimensions of an arm, and where it was commanded to.
pub(crate) fn arm(robot: &Robot) -> Value {
    let live = robot.live();
    let type_name = live.type_name.clone().unwrap_or_default();
    let target = live.model.variables.iter().find(|variable| variable.name == TARGET);
    let target = target.and_then(|variable| variable.value.as_ref()?.as_variant().as_array());
    let commanded: Option<Vec<_>> = target.map(|joints| joints.iter().filter_map(|joint| joint.as_f64()).collect());
    json!({ "type": safe(&type_name), "links": arm::dimensions(&type_name), "commanded": commanded })
}

/// Returns the tasks with their states.
pub(crate) fn tasks(robot: &Robot) -> Value {
    // an escaped name would be another task's, so such a task has no buttons
    let row = |(name, state): &(String, String)| json!([safe(name), safe(state), safe(name) == *name]);
    robot.live().model.tasks.iter().map(row).collect()
}

/// Returns the state of a jog, and the highest speed of each axis in percent.
pub(crate) fn jog(robot: &Robot) -> Value {
    let (grip, jog) = {
        let grip = lock(&robot.grip);
        (grip.clone(), robot.jogs.load(Ordering::Relaxed))
    };
    let phase = match grip.as_ref().map(|grip| grip.phase()) {
        None | Some(Phase::Ended) => "off",
        Some(Phase::Starting) => "starting",
        Some(Phase::Ready) => "ready",
        Some(Phase::Moving) => "moving",
        Some(Phase::Ending) => "ending",
    };
    let outcome = grip.as_ref().and_then(|grip| grip.outcome());
    let live = robot.live();
    let type_name = live.type_name.as_deref().unwrap_or_default();
    let joints = live.model.robot.joints.len().min(8);
    let axes = (1u8..).map(Axis::Joint).take(joints).chain((0..6).map(Axis::Coordinate));
    let axes: Vec<_> = axes.map(|axis| json!([axis.to_string(), arm::percent(type_name, axis)])).collect();
    json!({
        "jog": jog,
        "phase": phase,
        "ends": grip.as_ref().and_then(|grip| grip.ends()).map(|why| safe(&why)),
        "failed": outcome.as_ref().is_some_and(Result::is_err),
        "outcome": outcome.map(|outcome| safe(&outcome.map_or_else(|why| why, str::to_owned))),
        "axes": axes,
        "longest": LONGEST,
        "fastest": FASTEST,
    })
}

/// The maximum number of bytes and fields of a packet that a page shows.
const SHOWN: usize = 4096;
const FIELDS: usize = 500;

/// Returns the last call with a serial number, packet by packet; empty for a call of an earlier session, whose numbers repeat.
pub(crate) fn packet(robot: &Robot, serial: u16, at: f64) -> Value {
    let live = robot.live();
    let call = if at < live.opened.as_secs_f64() { Vec::new() } else { live.tape.call(serial) };
    call.into_iter().map(|(role, bytes)| dissected(role, bytes)).collect()
}

/// Returns a packet with its fields: the offset, the length and the text of each.
pub(crate) fn dissected(role: Role, bytes: &[u8]) -> Value {
    let invalid = |error| vec![(0..bytes.len(), format!("not a frame: {error}"))];
    let fields = dissect::fields_of(bytes, role).unwrap_or_else(invalid);
    let fields: Value = fields.iter().take(FIELDS).map(|(at, text)| json!([at.start, at.len(), safe(text)])).collect();
    let shown = bytes.get(..SHOWN).unwrap_or(bytes);
    json!({ "request": role == Role::Request, "size": bytes.len(), "bytes": hex::spaced(shown), "fields": fields })
}

/// Returns each function and object once: the count, the calls per second, the time since the last call, and its reply.
pub(crate) fn calls(robot: &Robot) -> Value {
    let live = robot.live();
    let age = |last: Duration| live.model.now.saturating_sub(last).as_secs_f64();
    let rows = live.model.log.calls();
    rows.map(|(name, call)| json!([safe(name), call.count, call.rate(), age(call.last), safe(&call.reply)])).collect()
}

/// The maximum number of packets of a message; the others are counted.
const PACKETS: u64 = 200;

/// Returns the packets after the first `seen`, and how many of them are left out; `None` if there are no new ones.
pub(crate) fn packets(robot: &Robot, seen: &mut u64) -> Option<Value> {
    let live = robot.live();
    let log = &live.model.log;
    let new = log.total().checked_sub(*seen).filter(|new| *new > 0)?;
    let row =
        |entry: &Entry| json!([entry.at.as_secs_f64(), safe(&entry.number), safe(&entry.call), safe(&entry.reply)]);
    let kept = log.entries().rev().take(usize::try_from(new.min(PACKETS)).unwrap_or(usize::MAX));
    let mut rows: Vec<_> = kept.map(row).collect();
    rows.reverse();
    *seen = log.total();
    Some(json!({ "rows": rows, "left_out": new - rows.len() as u64 }))
}

#[cfg(test)]
mod tests {
    use std::time::Instant;

    use super::*;

    #[test]
    fn an_old_state_is_not_shown_as_the_present_one() {
        let state = |age: Option<u64>| {
            let examined = age.map(|age| Instant::now().checked_sub(Duration::from_secs(age)).unwrap());
            let mut live = Live { examination: Some(Err("refused".into())), examined, ..Live::default() };
            live.model.lost = None;
            condition(&live).2[0][0].clone()
        };
        assert_eq!(state(Some(1)), "refused");
        assert_eq!([state(Some(4)), state(None)], [NOT_READ, NOT_READ]);
    }
}
