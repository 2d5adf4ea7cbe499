//! The tasks, and the files of a controller.

use bcap_core::bcap::FunctionId;
use bcap_live::files;
use bcap_live::link::Link;
use bcap_live::stream::StreamCheck;
use bcap_std::{TaskStart, TaskStop};
use serde_json::json;

use crate::order::What;
use crate::socket::{Answer, Page};
use crate::text::safe;

/// The maximum number of lines of a file that a page shows.
const LINES: usize = 5000;

/// The maximum number of names of a folder that a page shows.
const NAMES: usize = 1000;

/// A start of a task, which may move the robot, or a stop.
enum Change {
    Start(TaskStart),
    Stop(TaskStop),
}

impl What {
    /// Returns the change, and its text for the audit log.
    const fn change(self) -> (Change, &'static str) {
        match self {
            Self::Once => (Change::Start(TaskStart::OneCycle), "runs once"),
            Self::Forever => (Change::Start(TaskStart::Continuous), "runs again and again"),
            Self::Step => (Change::Start(TaskStart::OneStep), "runs one step of"),
            Self::Stop => (Change::Stop(TaskStop::Now), "stops"),
            Self::Cycle => (Change::Stop(TaskStop::AfterCycle), "stops after its cycle"),
            Self::Reset => (Change::Stop(TaskStop::Initialize), "stops and resets"),
        }
    }
}

impl Page {
    /// Starts or stops a task.
    pub(crate) async fn task(&self, number: usize, of: &str, name: String, what: What, revoked: Option<u64>) -> Answer {
        let (change, words) = what.change();
        let (who, robot) = match change {
            Change::Start(_) => self.mover(number)?,
            Change::Stop(_) => self.holder(number)?,
        };
        robot.check_name(of)?;
        // no halt revokes a stop
        let since = match change {
            Change::Start(_) => revoked.ok_or("a start needs the number of the last HALT; nothing was done")?,
            Change::Stop(_) => 0,
        };
        let (what, mut permit) = (format!("{words} {}", safe(&name)), robot.permit_since(since));
        let made = move |link: &mut Link| match change {
            Change::Start(mode) => link.start_task(&name, mode, || permit.check_move()),
            Change::Stop(mode) => link.stop_task(&name, mode),
        };
        self.recorded(who, &robot, what, made).await
    }

    /// Reads the line of a task.
    pub(crate) async fn line(&self, number: usize, name: String) -> Answer {
        Ok(json!(self.robot(number)?.order(move |link| link.task_line(&name)).await?))
    }

    /// Lists a folder.
    pub(crate) async fn files(&self, number: usize, folder: String) -> Answer {
        let list = move |link: &mut Link| {
            StreamCheck::default().require(link, FunctionId::CONTROLLER_GET_FILE_NAMES, None)?;
            files::list(link, &folder)
        };
        let entries = self.robot(number)?.order(list).await?;
        let row = |(name, is_folder): &(String, bool)| json!([safe(name), is_folder, safe(name) == *name]);
        let rows: Vec<_> = entries.iter().take(NAMES).map(row).collect();
        Ok(json!({ "rows": rows, "left_out": entries.len() - rows.len() }))
    }

    /// Reads a file as lines.
    pub(crate) async fn view(&self, number: usize, path: String) -> Answer {
        let read = move |link: &mut Link| {
            StreamCheck::default().require(link, FunctionId::CONTROLLER_GET_FILE, None)?;
            files::text(link, &path)
        };
        let text = self.robot(number)?.order(read).await?;
        let mut lines = text.lines();
        let shown: Vec<_> = lines.by_ref().take(LINES).map(safe).collect();
        Ok(json!({ "lines": shown, "left_out": lines.count() }))
    }
}
