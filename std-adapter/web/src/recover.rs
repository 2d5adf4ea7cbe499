//! The recovery of a page, step by step, and the logs of a controller.

use std::sync::Arc;

use bcap_capture::LogEntry;
use bcap_core::hresult::HResult;
use bcap_live::errors::described;
use bcap_live::history::Log;
use bcap_live::link::Link;
use bcap_live::recovery::{self, Recovery};
use serde_json::{Value, json};

use crate::motions;
use crate::socket::{Answer, Page};
use crate::text::safe;
use crate::threads::lock;

/// The entries that are read from each end of a log: each is a call.
const ENTRIES: usize = 50;

impl Page {
    /// Begins a recovery. It changes nothing before the user agrees to the first step. `name` is the robot's name in the
    /// question.
    pub(crate) fn begin_recovery(&self, number: usize, name: &str, revoked: u64) -> Answer {
        let (who, robot) = self.mover(number)?;
        robot.check_name(name)?;
        self.end_motion("a recovery begins");
        let recovery = Arc::new(Recovery::default());
        let mut last = lock(&robot.recovery);
        // under the lock: a HALT after this check ends this recovery
        robot.check_since(revoked)?;
        if last.as_ref().is_some_and(|last| last.state().outcome.is_none()) {
            return Err("the last recovery of this robot has not ended; wait a moment".into());
        }
        let (app, of, running) = (Arc::clone(&self.app), Arc::clone(&robot), Arc::clone(&recovery));
        self.app.spawn("recovery", move || {
            recovery::run(&of.access, &running);
            let state = running.state();
            let made: Vec<_> = state.done.iter().map(|(step, _)| step.name()).collect();
            let what = format!("the recovery ends after [{}]", made.join(", "));
            app.audit.write(&who, &of.name, &what, &state.outcome.unwrap_or(Ok("")));
        })?;
        *last = Some(Arc::clone(&recovery));
        lock(&self.motions).recovery = Some((number, recovery));
        Ok(Value::Null)
    }

    /// Returns the recovery of this page.
    fn recovery(&self, number: usize) -> Result<Arc<Recovery>, String> {
        let recovery =
            lock(&self.motions).recovery.clone().filter(|(robot, _)| *robot == number).map(|(_, found)| found);
        recovery.ok_or_else(|| "there is no recovery of this page; begin one".into())
    }

    /// Makes the next step of the recovery.
    pub(crate) fn agree(&self, number: usize, step: &str, revoked: u64) -> Answer {
        let (who, robot) = self.mover(number)?;
        // a HALT after the check ends the recovery
        let recovery = self.recovery(number)?;
        let agreed = robot.check_since(revoked).and_then(|()| recovery.agree(step));
        self.audited(&who, &robot, &format!("agrees to {}", safe(step)), agreed)
    }

    /// Ends the recovery.
    pub(crate) fn stop(&self, number: usize) -> Answer {
        motions::end_recovery(&self.app, number, self.recovery(number)?, "the user ended it");
        Ok(Value::Null)
    }

    /// Reads the logs of the controller, the latest entry first.
    pub(crate) async fn log(&self, number: usize) -> Answer {
        let read = |link: &mut Link| {
            let mut entries = Vec::new();
            Log::errors().read(link, ENTRIES, &mut entries)?;
            Log::operations().read(link, ENTRIES, &mut entries)?;
            entries.sort();
            Ok(entries.iter().rev().map(entry).collect())
        };
        self.robot(number)?.order(read).await
    }
}

fn entry(entry: &LogEntry) -> Value {
    let LogEntry { time, code, client, text, program, line, is_error, .. } = entry;
    let what = if *code == 0 { text.clone() } else { described(HResult(*code), text) };
    let place = if program.is_empty() { String::new() } else { format!("{program}, line {line}") };
    json!([safe(time), if *is_error { "error" } else { "operation" }, client, safe(&what), safe(&place)])
}
