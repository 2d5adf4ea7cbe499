//! Recoveries, step by step, and the logs of a controller.

use std::sync::Arc;
use std::thread;

use bcap_capture::LogEntry;
use bcap_core::hresult::HResult;
use bcap_live::errors::described;
use bcap_live::history::Log;
use bcap_live::link::{Error, Link};
use bcap_live::recovery::{self, Recovery};
use serde_json::{Value, json};

use crate::app::App;
use crate::robot::Robot;
use crate::text::safe;
use crate::threads::lock;

/// The entries that are read from each end of a log: each is a call.
const ENTRIES: usize = 50;

/// Begins a recovery. Nothing is changed before the user agrees to the first step.
pub(crate) fn start(app: &Arc<App>, robot: &Arc<Robot>, who: String) -> Result<Arc<Recovery>, String> {
    let recovery = Arc::new(Recovery::default());
    let mut last = lock(&robot.recovery);
    if last.as_ref().is_some_and(|last| last.state().outcome.is_none()) {
        return Err("the last recovery of this robot has not ended; wait a moment".into());
    }
    let (app, of, held) = (Arc::clone(app), Arc::clone(robot), Arc::clone(&recovery));
    let thread = thread::Builder::new().name("recovery".into()).spawn(move || {
        recovery::run(&of.access, &held);
        let state = held.state();
        let made: Vec<_> = state.done.iter().map(|(step, _)| step.name()).collect();
        let what = format!("the recovery ends after [{}]", made.join(", "));
        app.audit.write(&who, &of.name, &what, &state.outcome.unwrap_or(Ok("")));
    });
    thread.map_err(|error| format!("a thread cannot be started: {error}; nothing was done"))?;
    *last = Some(Arc::clone(&recovery));
    Ok(recovery)
}

/// Returns the last recovery of a robot.
pub(crate) fn section(robot: &Robot) -> Value {
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

/// Reads the logs of the controller, the latest entry first.
pub(crate) fn log(link: &mut Link) -> Result<Value, Error> {
    let mut entries = Vec::new();
    for mut log in [Log::errors(), Log::operations()] {
        log.read(link, ENTRIES, &mut entries)?;
    }
    entries.sort();
    Ok(entries.iter().rev().map(entry).collect())
}

fn entry(entry: &LogEntry) -> Value {
    let LogEntry { time, code, client, text, program, line, is_error, .. } = entry;
    let what = if *code == 0 { text.clone() } else { described(HResult(*code), text) };
    let place = if program.is_empty() { String::new() } else { format!("{program}, line {line}") };
    json!([safe(time), if *is_error { "error" } else { "operation" }, client, safe(&what), safe(&place)])
}
