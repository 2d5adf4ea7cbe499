//! Backups of a robot's controller: dump, difference, the plan of a restore and the restore, each in a thread over its own session.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::thread;
use std::time::Instant;

use bcap_backup::compare::{self, entry_text};
use bcap_backup::controller::{self, Progress};
use bcap_backup::folder::{self, Folder};
use bcap_backup::journal::{Journal, Past};
use bcap_backup::plan::Plan;
use bcap_backup::replaced::Replaced;
use bcap_backup::restore::{self, Options};
use bcap_backup::{contents::Contents, dump};
use bcap_capture::trace::Packets;
use bcap_live::link::{Error, Link};
use serde_json::{Value, json};

use crate::app::App;
use crate::control::Client;
use crate::job::{Job, Kind, Work};
use crate::robot::Robot;
use crate::text::safe;
use crate::threads::lock;

/// The most folders that a page shows.
const FOLDERS: usize = 200;

/// Returns the folder of the backups.
fn backups(app: &App) -> Result<&Path, String> {
    app.config.backups.as_deref().ok_or_else(|| "this server keeps no backups; start it with --backups DIR".into())
}

/// Returns the path of a file or a folder. A name cannot leave its folder.
pub(crate) fn path_in(folder: &Path, name: &str) -> Result<PathBuf, String> {
    let is_plain = |c: char| c.is_ascii_alphanumeric() || "-_.".contains(c);
    if name.is_empty() || name.len() > 64 || name.starts_with('.') || !name.chars().all(is_plain) {
        return Err(format!(
            "{name:?}: a name has letters, digits, `-`, `_` and `.`, at most 64, and begins with no `.`"
        ));
    }
    Ok(folder.join(name))
}

/// Returns the names in a folder that a page may use, in their order; none if the folder does not exist.
pub(crate) fn names_in(folder: &Path) -> Result<Vec<String>, String> {
    let entries = match std::fs::read_dir(folder) {
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(Vec::new()),
        entries => entries.map_err(|error| format!("{}: {error}", folder.display()))?,
    };
    let names = entries.filter_map(|entry| entry.ok()?.file_name().into_string().ok());
    let mut names: Vec<_> = names.filter(|name| path_in(folder, name).is_ok()).collect();
    names.sort();
    Ok(names)
}

/// Lists the folders with backups.
pub(crate) fn list(app: &App) -> Result<Value, String> {
    let backups = backups(app)?;
    let row = |name: &String| {
        let past = Past::read(&backups.join(name)).ok().flatten().filter(|past| !past.is_complete());
        json!([name, past.map(|past| safe(&past.summary()))])
    };
    let names = names_in(backups)?;
    Ok(names.iter().filter(|name| backups.join(name).join("backup.json").exists()).take(FOLDERS).map(row).collect())
}

/// Begins a job.
pub(crate) fn start(
    app: &Arc<App>,
    robot: &Arc<Robot>,
    client: Client,
    who: String,
    work: Work,
) -> Result<Value, String> {
    let path = path_in(backups(app)?, &work.folder)?;
    let with = work.with.as_deref().map(|with| path_in(backups(app)?, with)).transpose()?;
    let mut last = lock(&robot.backup);
    if last.as_ref().is_some_and(|last| last.is_running()) {
        return Err("the last work on backups of this robot has not ended; end it, or wait".into());
    }
    let plan = match work.kind {
        Kind::Restore => {
            Some(last.as_ref().and_then(|last| planned(last, client, &work)).ok_or("plan the restore first")?)
        }
        _ => None,
    };
    let job = Arc::new(Job::new(client, work));
    let (app, of, own) = (Arc::clone(app), Arc::clone(robot), Arc::clone(&job));
    let run = move || {
        let outcome = perform(&own, &of, &path, with.as_deref(), plan).map_err(|error| error.to_string());
        let Work { kind, folder, with, .. } = &own.work;
        let what = match kind {
            Kind::Dump => format!("dumps to {folder}"),
            Kind::Diff => format!("compares {folder} with {}", with.as_deref().unwrap_or("the controller")),
            Kind::Plan => format!("plans to restore {folder}"),
            Kind::Restore => format!("restores {folder}"),
        };
        app.audit.write(&who, &of.name, &what, &outcome);
        own.lock().outcome = Some(outcome);
    };
    thread::Builder::new()
        .name("backup".into())
        .spawn(run)
        .map_err(|error| format!("a thread cannot be started: {error}; nothing was done"))?;
    *last = Some(job);
    Ok(Value::Null)
}

/// Takes the plan that the same page has made for the same folder.
fn planned(last: &Job, client: Client, wanted: &Work) -> Option<Plan> {
    let is_wanted = last.work.kind == Kind::Plan && last.client == client && last.work.folder == wanted.folder;
    if is_wanted { last.lock().plan.take() } else { None }
}

fn perform(job: &Job, robot: &Robot, path: &Path, with: Option<&Path>, plan: Option<Plan>) -> Result<String, Error> {
    let mut asked = Instant::now();
    let watch = |link: &mut Link, at: Progress<'_>| job.watch(link, at, &mut asked);
    let connect = || Link::connect(&robot.access, &Packets::new());
    match (job.work.kind, plan) {
        (Kind::Dump, _) => {
            let mut link = connect()?;
            let folder = Folder::begin(path, controller::about(&mut link)?)?;
            let contents = dump::dump(&mut link, &folder, watch)?;
            job.lock().notes =
                contents.omitted.iter().map(|part| format!("not saved: {}", safe(&part.reason))).collect();
            let Contents { variables, system, files, .. } = &contents;
            let [variables, system, files] = [variables.len(), system.len(), files.len()];
            Ok(format!(
                "saved: {variables} variables, {system} system variables, {files} files; {} refused",
                contents.refused()
            ))
        }
        (Kind::Diff, _) => {
            let saved = folder::load(path)?;
            let other = match with {
                Some(with) => folder::load(with)?,
                None => {
                    let mut link = connect()?;
                    controller::contents(&mut link, watch)?
                }
            };
            let lines = difference_lines(&saved, &other);
            job.show(&lines);
            Ok(if lines.is_empty() { "no differences".into() } else { format!("{} differences", lines.len()) })
        }
        (Kind::Plan, _) => {
            let backup = folder::load(path)?;
            let options = Options { io: job.work.io, other_controller: false };
            let plan = restore::plan(&mut connect()?, &backup, options, watch)?;
            job.show(&plan.lines());
            let mut state = job.lock();
            state.notes = plan.notes.iter().map(safe).collect();
            let count = plan.names().len();
            (state.can_restore, state.plan) = (count > 0, Some(plan));
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

/// Returns a line for each difference, first the value of the saved one.
fn difference_lines(a: &Contents, b: &Contents) -> Vec<String> {
    let variables = compare::variables(a, b, false);
    let variables =
        variables.iter().map(|found| format!("{}: {} -> {}", found.name, entry_text(found.a), entry_text(found.b)));
    let size =
        |bytes: Option<&Vec<u8>>| bytes.map_or("does not exist".to_owned(), |bytes| format!("{} bytes", bytes.len()));
    let files = compare::files(a, b);
    let files = files.iter().map(|found| format!("file:{}: {} -> {}", found.name, size(found.a), size(found.b)));
    variables.chain(files).collect()
}

/// Returns the last job of a robot.
pub(crate) fn section(robot: &Robot, client: Client) -> Value {
    let Some(job) = lock(&robot.backup).clone() else { return Value::Null };
    let state = job.lock();
    json!({
        "work": job.work.kind,
        "folder": job.work.folder,
        "part": state.part,
        "done": state.done,
        "count": state.count,
        "lines": state.lines,
        "left_out": state.left_out,
        "notes": state.notes,
        "can_restore": state.can_restore && state.plan.is_some() && job.client == client,
        "running": state.outcome.is_none(),
        "failed": state.outcome.as_ref().is_some_and(Result::is_err),
        "outcome": state.outcome.as_ref().map(|outcome| safe(match outcome { Ok(text) | Err(text) => text })),
    })
}
