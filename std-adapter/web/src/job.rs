//! A job of the screen of backups: its progress, its end, and its outcome.

use std::sync::Mutex;

use bcap_backup::controller::Progress;
use bcap_backup::plan::Plan;
use bcap_live::link::Error;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use crate::control::Client;
use crate::text::safe;
use crate::threads::lock;

/// The maximum number of lines of a plan or a difference that a page shows; the others are counted.
const LINES: usize = 500;

/// A kind of work.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize)]
#[serde(rename_all = "lowercase")]
pub(crate) enum Kind {
    /// Saves the controller in a folder.
    Dump,
    /// Compares a folder with another folder, or with the controller.
    Diff,
    /// Plans a restore.
    Plan,
    /// Writes the plan that this page has made last.
    Restore,
}

/// The work of a job.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Work {
    #[serde(rename = "work")]
    pub(crate) kind: Kind,
    pub(crate) folder: String,
    /// The folder to compare with; `None` for the controller.
    pub(crate) with: Option<String>,
    /// Whether a plan has the I/O.
    #[serde(default)]
    pub(crate) io: bool,
}

/// A job, and what a page shows of it.
pub(crate) struct Job {
    pub(crate) client: Client,
    pub(crate) work: Work,
    pub(crate) state: Mutex<State>,
}

/// The progress and the outcome of a job.
#[derive(Default)]
pub(crate) struct State {
    pub(crate) part: String,
    pub(crate) done: usize,
    pub(crate) count: usize,
    pub(crate) lines: Vec<String>,
    pub(crate) left_out: usize,
    pub(crate) notes: Vec<String>,
    /// The plan that a restore may take, once.
    pub(crate) plan: Option<Plan>,
    end: Option<String>,
    pub(crate) outcome: Option<Result<String, String>>,
}

impl Job {
    /// Ends the job between two calls. An ended dump or restore can be continued.
    pub(crate) fn end(&self, why: &str) {
        lock(&self.state).end.get_or_insert_with(|| why.to_owned());
    }

    /// Returns whether the job is a restore of this page.
    pub(crate) fn is_restore_of(&self, client: Client) -> bool {
        self.client == client && self.work.kind == Kind::Restore
    }

    /// Records the progress. Fails at the end.
    pub(crate) fn watch(&self, at: Progress<'_>) -> Result<(), Error> {
        let mut state = lock(&self.state);
        (state.done, state.count) = (at.done, at.count);
        at.part.clone_into(&mut state.part);
        state.end.as_ref().map_or(Ok(()), |why| Err(Error::Invalid(format!("ended: {why}"))))
    }

    /// Returns the job for a page.
    pub(crate) fn section(&self, client: Client) -> Value {
        let state = lock(&self.state);
        json!({
            "work": self.work.kind,
            "folder": self.work.folder,
            "part": state.part,
            "done": state.done,
            "count": state.count,
            "lines": state.lines,
            "left_out": state.left_out,
            "notes": state.notes,
            "can_restore": self.client == client && state.plan.as_ref().is_some_and(|plan| !plan.is_empty()),
            "running": state.outcome.is_none(),
            "failed": state.outcome.as_ref().is_some_and(Result::is_err),
            "outcome": state.outcome.as_ref().map(|outcome| safe(match outcome { Ok(text) | Err(text) => text })),
        })
    }

    /// Shows lines of a difference or a plan.
    pub(crate) fn show(&self, lines: &[String]) {
        let mut state = lock(&self.state);
        state.lines = lines.iter().take(LINES).map(safe).collect();
        state.left_out = lines.len().saturating_sub(LINES);
    }
}
