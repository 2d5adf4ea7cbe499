//! Tasks, and the files of a controller.

use std::fmt;

use bcap_core::bcap::FunctionId;
use bcap_live::files;
use bcap_live::link::{Error, Link};
use bcap_live::stream::StreamCheck;
use bcap_std::{TaskStart, TaskStop};
use serde::Deserialize;
use serde_json::{Value, json};

use crate::robot::Robot;
use crate::text::safe;

/// The most lines of a file that a page shows.
const LINES: usize = 5000;

/// The most names of a folder that a page shows.
const NAMES: usize = 1000;

/// An order for a task.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(crate) enum What {
    /// Runs the program once.
    Once,
    /// Runs the program again and again.
    Forever,
    /// Runs one step of the program.
    Step,
    /// Stops at once.
    Stop,
    /// Stops after the present cycle.
    Cycle,
    /// Stops at once; the next start begins at the first line.
    Reset,
}

impl fmt::Display for What {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Once => "runs once",
            Self::Forever => "runs again and again",
            Self::Step => "runs one step of",
            Self::Stop => "stops",
            Self::Cycle => "stops after its cycle",
            Self::Reset => "stops and resets",
        })
    }
}

impl What {
    /// Returns whether it starts the task, which may move the robot.
    pub(crate) const fn is_start(self) -> bool {
        matches!(self, Self::Once | Self::Forever | Self::Step)
    }

    /// Starts or stops a task.
    pub(crate) fn perform(self, link: &mut Link, name: &str) -> Result<(), Error> {
        match self {
            Self::Once => link.start_task(name, TaskStart::OneCycle),
            Self::Forever => link.start_task(name, TaskStart::Continuous),
            Self::Step => link.start_task(name, TaskStart::OneStep),
            Self::Stop => link.stop_task(name, TaskStop::Now),
            Self::Cycle => link.stop_task(name, TaskStop::AfterCycle),
            Self::Reset => link.stop_task(name, TaskStop::Initialize),
        }
    }
}

/// Returns the tasks with their states.
pub(crate) fn section(robot: &Robot) -> Value {
    // an escaped name would be another task's, so such a task has no buttons
    let row = |(name, state): &(String, String)| json!([safe(name), safe(state), safe(name) == *name]);
    robot.live().model.tasks.iter().map(row).collect()
}

/// Lists a folder.
pub(crate) fn list(link: &mut Link, folder: &str) -> Result<Value, Error> {
    StreamCheck::default().require(link, FunctionId::CONTROLLER_GET_FILE_NAMES, None)?;
    let entries = files::list(link, folder)?;
    let rows: Vec<_> = entries
        .iter()
        .take(NAMES)
        .map(|(name, is_folder)| json!([safe(name), is_folder, safe(name) == *name]))
        .collect();
    Ok(json!({ "rows": rows, "left_out": entries.len() - rows.len() }))
}

/// Reads a file as lines.
pub(crate) fn text(link: &mut Link, path: &str) -> Result<Value, Error> {
    StreamCheck::default().require(link, FunctionId::CONTROLLER_GET_FILE, None)?;
    let text = files::text(link, path)?;
    let mut lines = text.lines();
    let shown: Vec<_> = lines.by_ref().take(LINES).map(safe).collect();
    Ok(json!({ "lines": shown, "left_out": lines.count() }))
}
