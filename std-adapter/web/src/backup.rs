//! Backups of a robot's controller: dump, difference, the plan of a restore and the restore, each in a thread over its own session.
//!
//! A dump and a comparison only read. A restore needs the control, and a question to the user.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;
use std::sync::{Arc, Mutex};

use bcap_backup::compare;
use bcap_backup::contents::{Contents, Omission};
use bcap_backup::controller::{self, Progress};
use bcap_backup::dump;
use bcap_backup::folder::{self, Folder};
use bcap_backup::journal::{Journal, Past};
use bcap_backup::plan::Plan;
use bcap_backup::replaced::Replaced;
use bcap_backup::restore::{self, Options};
use bcap_capture::trace::Packets;
use bcap_live::link::{Error, Link};
use serde_json::{Value, json};

use crate::job::{Job, Kind, Work};
use crate::names::{names_in, path_in};
use crate::robot::Robot;
use crate::socket::{Answer, Page};
use crate::text::safe;
use crate::threads::{lock, on_disk};

/// The maximum number of folders that a page shows.
const FOLDERS: usize = 200;

impl Page {
    /// Returns the folder of the backups.
    fn folder(&self) -> Result<&Path, String> {
        let folder = self.app.config.backups.as_deref();
        folder.ok_or_else(|| "this server keeps no backups; start it with --backups DIR".into())
    }

    /// Lists the folders with backups.
    pub(crate) async fn backups(&self) -> Answer {
        let folder = self.folder()?.to_owned();
        let list = move || {
            let row = |name: &String| {
                let past = Past::read(&folder.join(name)).ok().flatten().filter(|past| !past.is_complete());
                json!([name, past.map(|past| safe(&past.summary()))])
            };
            let is_backup = |name: &&String| folder.join(name).join("backup.json").exists();
            Ok(names_in(&folder)?.iter().filter(is_backup).take(FOLDERS).map(row).collect())
        };
        on_disk(list).await
    }

    /// Begins a dump, a comparison, or the plan of a restore.
    pub(crate) fn work(&self, number: usize, work: Work) -> Answer {
        if work.kind == Kind::Restore {
            return Err("a restore needs the name of the robot; nothing was done".into());
        }
        let robot = self.robot(number)?;
        let who = robot.control.user(self.client).unwrap_or_else(|_| "a page".into());
        self.begin(&robot, who, work, None)
    }

    /// Begins the restore that this page has planned. `name` is the robot's name in the question.
    pub(crate) fn restore(&self, number: usize, name: &str, folder: String, revoked: u64) -> Answer {
        let (who, robot) = self.writer(number)?;
        robot.check_name(name)?;
        self.begin(&robot, who, Work { kind: Kind::Restore, folder, with: None, io: false }, Some(revoked))
    }

    /// Ends the work on backups of a robot between two calls.
    pub(crate) fn end_work(&self, number: usize) -> Answer {
        self.robot(number)?.end_work(self.client).map(|()| Value::Null)
    }

    fn begin(&self, robot: &Arc<Robot>, who: String, work: Work, revoked: Option<u64>) -> Answer {
        let path = path_in(self.folder()?, &work.folder)?;
        let with = work.with.as_deref().map(|with| path_in(self.folder()?, with)).transpose()?;
        let mut last = lock(&robot.backup);
        // under the lock: a HALT after this check ends this restore
        revoked.map_or(Ok(()), |since| robot.check_since(since))?;
        if last.as_ref().is_some_and(|last| lock(&last.state).outcome.is_none()) {
            return Err("the last work on backups of this robot has not ended; end it, or wait".into());
        }
        let plan = match work.kind {
            Kind::Restore => {
                // by the same page, for the same folder
                let planned =
                    last.as_ref().filter(|last| last.client == self.client && last.work.folder == work.folder);
                Some(planned.and_then(|last| lock(&last.state).plan.take()).ok_or("plan the restore first")?)
            }
            _ => None,
        };
        let job = Arc::new(Job { client: self.client, work, state: Mutex::default() });
        let (app, of, own) = (Arc::clone(&self.app), Arc::clone(robot), Arc::clone(&job));
        self.app.spawn("backup", move || {
            let work = AssertUnwindSafe(|| perform(&own, &of, &path, with.as_deref(), plan));
            let panicked = |_| Err(Error::Unexpected("the work panicked; it is unknown what was done".into()));
            let outcome = catch_unwind(work).unwrap_or_else(panicked).map_err(|error| error.to_string());
            let Work { kind, folder, with, .. } = &own.work;
            let what = match kind {
                Kind::Dump => format!("dumps to {folder}"),
                Kind::Diff => format!("compares {folder} with {}", with.as_deref().unwrap_or("the controller")),
                Kind::Plan => format!("plans to restore {folder}"),
                Kind::Restore => format!("restores {folder}"),
            };
            app.audit.write(&who, &of.name, &what, &outcome);
            lock(&own.state).outcome = Some(outcome);
        })?;
        *last = Some(job);
        Ok(Value::Null)
    }
}

fn perform(job: &Job, robot: &Robot, path: &Path, with: Option<&Path>, plan: Option<Plan>) -> Result<String, Error> {
    let watch = |at: Progress<'_>| job.watch(at);
    let connect = || Link::connect(&robot.access, &Packets::new());
    match (job.work.kind, plan) {
        (Kind::Dump, _) => {
            let mut link = connect()?;
            let folder = Folder::begin(path, controller::about(&mut link)?)?;
            let contents = dump::dump(&mut link, &folder, watch)?;
            lock(&job.state).notes =
                contents.omitted.iter().map(|part| format!("not saved: {}", safe(&part.reason))).collect();
            Ok(format!("saved: {}; {} refused", contents.summary(), contents.refused()))
        }
        (Kind::Diff, _) => {
            let saved = folder::load(path)?;
            let other = match with {
                Some(with) => folder::load(with)?,
                None => controller::contents(&mut connect()?, watch)?,
            };
            Ok(show_differences(job, &saved, &other))
        }
        (Kind::Plan, _) => {
            let backup = folder::load(path)?;
            let options = Options { io: job.work.io, other_controller: false };
            let plan = restore::plan(&mut connect()?, &backup, options, watch)?;
            job.show(&plan.lines());
            let mut state = lock(&job.state);
            let outputs = (plan.unwritten_io > 0).then(|| format!("{} I/O differ and stay", plan.unwritten_io));
            state.notes = outputs.iter().chain(&plan.notes).map(safe).collect();
            let count = plan.names().len();
            state.plan = Some(plan);
            Ok(if count == 0 {
                "nothing to write: the controller has the values of the backup".into()
            } else {
                format!("{count} writes are planned")
            })
        }
        (Kind::Restore, Some(plan)) => {
            let mut link = connect()?;
            let mut journal = Journal::begin(path, &robot.access.address.to_string(), &plan.names())?;
            let written = restore::write(&mut link, &plan, &mut journal, &Replaced::new(path), watch);
            journal.end(&written.as_ref().err().map_or("complete".into(), ToString::to_string))?;
            let past = Past::read(path)?.map(|past| past.summary()).unwrap_or_default();
            written
                .map_err(|error| Error::Unexpected(format!("{error}; {past}; plan it again to write the rest")))
                .map(|()| past)
        }
        (Kind::Restore, None) => Err(Error::Invalid("plan the restore first".into())),
    }
}

/// Shows the differences of two backups, and the parts that were not compared. Returns the outcome.
fn show_differences(job: &Job, saved: &Contents, other: &Contents) -> String {
    let variables = compare::variables(saved, other, false);
    let files = compare::files(saved, other);
    let lines: Vec<_> =
        variables.iter().map(ToString::to_string).chain(files.iter().map(ToString::to_string)).collect();
    job.show(&lines);
    let note = |(is_first, part): (bool, &Omission)| {
        let side = if is_first { "the backup" } else { "the other side" };
        format!("not compared: {}, in {side}", safe(&part.reason))
    };
    let notes: Vec<_> = compare::omitted(saved, other, false).map(note).collect();
    let found = if lines.is_empty() { "no differences".into() } else { format!("{} differences", lines.len()) };
    let outcome = match notes.len() {
        0 => found,
        count => format!("{found} in what could be compared; parts not compared: {count}"),
    };
    lock(&job.state).notes = notes;
    outcome
}
