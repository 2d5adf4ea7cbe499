//! `bcap restore`: writes a backup back to the controller.
//!
//! ```text
//!  plan (first session) ─► confirm ─► write (second session), for each variable:
//!                                     read, is it still as planned? ─► journal ─► write ─► read back ─► journal
//! ```
//!
//! A file is checked in the same way, and the one that it replaces is saved in the folder before the write.
//!
//! The user may read the plan for hours, so the command's own session does not stay open meanwhile, and each value and file is
//! checked again.

use std::path::{Path, PathBuf};

use bcap_capture::value::to_json;
use bcap_core::bcap::{FunctionId, Object};
use bcap_std::ObjectPath;
use clap::Args;
use serde_json::json;

use bcap_backup::compare::entry_text;
use bcap_backup::contents::{About, Contents};
use bcap_backup::folder;
use bcap_backup::journal::{Journal, Past};
use bcap_backup::plan::{Change, FileChange, Plan};
use bcap_backup::replaced::Replaced;

use super::controller;
use crate::failure::Failure;
use crate::interrupt::Interrupt;
use crate::output::{print_json, print_line, print_result};
use crate::session::confirm::Question;
use crate::session::variables::{get_one, read};
use crate::session::{Session, remote_files};
use crate::values::{Value, integer};
use bcap_capture::value::named::Entry;

/// Writes a backup back to the controller
///
/// Compares the backup with the controller, shows what is going to be written, and asks. Only what differs is written, and
/// each value and file is read back. The command stops at the first refusal, and if a value or a file has changed since the
/// plan was shown. It writes nothing while the controller is busy or has an error, if a part that the backup has cannot be
/// read there, or if a variable of the backup does not exist or has another type there. Nothing is deleted. System variables
/// are never written, and IO only with --io, because they switch outputs.
///
/// Each write is recorded in DIR/restore.jsonl before it is sent, and a file that is replaced is saved in DIR/replaced. If the
/// command is killed, `bcap restore --status DIR` says what was written, and the same restore again writes the rest.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  bcap restore --dry-run backup
  bcap restore --yes backup
  bcap restore --status backup")]
pub(crate) struct Restore {
    /// The folder of `bcap dump`
    #[arg(value_name = "DIR")]
    pub(crate) dir: PathBuf,

    /// Writes without asking for confirmation
    #[arg(long)]
    pub(crate) yes: bool,

    /// Shows the whole plan and writes nothing
    #[arg(long, conflicts_with = "yes")]
    pub(crate) dry_run: bool,

    /// Writes IO variables too, which switches the outputs of the controller
    #[arg(long)]
    pub(crate) io: bool,

    /// Writes even if the controller's type or serial number differs from the backup, or if the number is unknown
    #[arg(long)]
    pub(crate) other_controller: bool,

    /// Says what the last restore from this folder has written, without a controller
    #[arg(long, conflicts_with_all = ["yes", "dry_run", "io", "other_controller"])]
    pub(crate) status: bool,
}

/// The lines of the plan that are shown before the question.
const SHOWN: usize = 20;

/// Runs `bcap restore`.
pub(crate) fn restore(args: &Restore, session: &mut Session, json: bool) -> Result<(), Failure> {
    if args.status {
        return status(&args.dir, json);
    }
    let backup = folder::load(&args.dir)?;
    if let Some(past) = Past::read(&args.dir)?.filter(|past| !past.is_complete()) {
        summary(&past, json)?;
    }
    // the session of the shell stays open, and a lost one stays lost
    let is_own = !session.is_open() && !session.is_lost();
    let plan = planned(args, &backup, session);
    if is_own {
        session.close();
    }
    let plan = plan?;
    show(&plan, if args.dry_run || json { usize::MAX } else { SHOWN }, json)?;
    if plan.is_empty() {
        return note("there is nothing to write: the controller has the values of the backup", json);
    }
    if args.dry_run {
        return Ok(());
    }
    let target = session.link().target()?.to_string();
    let what = format!(
        "{} variables and {} files are going to be written to {target}",
        plan.variables.len(),
        plan.files.len()
    );
    let question = Question {
        what: &what,
        warning: "Tasks and robot must stay at rest meanwhile.",
        refused: "nothing was written",
    };
    question.confirm(session, args.yes)?;
    let mut journal = Journal::begin(&args.dir, &target, &plan.names())?;
    let replaced = Replaced::new(&args.dir);
    let interrupt = session.handle_signals()?;
    // the question may have taken long
    session.restart_budget();
    let written = session.begin().and_then(|()| {
        Writing { session, journal: &mut journal, replaced: &replaced, interrupt: &interrupt }.run(&plan)
    });
    conclude(&args.dir, &mut journal, written, json)
}

/// Compares the backup with the controller.
fn planned(args: &Restore, backup: &Contents, session: &mut Session) -> Result<Plan, Failure> {
    session.begin()?;
    check_state(session)?;
    let controller = controller::contents(session)?;
    check_controller(args, &backup.about, &controller.about)?;
    Ok(Plan::new(backup, &controller, args.io)?)
}

/// Prints the writes of the last restore.
fn status(dir: &Path, json: bool) -> Result<(), Failure> {
    let Some(past) = Past::read(dir)? else {
        return note(&format!("nothing was restored from {}", dir.display()), json);
    };
    let written = past.written.iter().map(|name| (name, "written"));
    let uncertain = past.uncertain.iter().map(|name| (name, "may be written"));
    let rest = past.rest.iter().map(|name| (name, "not written"));
    for (name, state) in written.chain(uncertain).chain(rest) {
        print_result(json, &json!({ "name": name, "state": state }), &format!("{name}: {state}"))?;
    }
    if past.is_complete() {
        return summary(&past, json);
    }
    Err(Failure::unfit(past.summary(), format!("`bcap restore {}` compares again and writes the rest", dir.display())))
}

/// Prints how many writes of a restore are made.
fn summary(past: &Past, json: bool) -> Result<(), Failure> {
    let line = json!({
        "robot": past.robot,
        "end": past.end,
        "written": past.written.len(),
        "uncertain": past.uncertain,
        "not_written": past.rest.len(),
    });
    Ok(print_result(json, &line, &past.summary())?)
}

/// Prints a remark.
fn note(text: &str, json: bool) -> Result<(), Failure> {
    Ok(print_result(json, &json!({ "note": text }), text)?)
}

/// Checks that nothing else changes the controller now, as far as it tells.
fn check_state(session: &mut Session) -> Result<(), Failure> {
    for (name, fitting, wrong) in [
        ("@BUSY_STATUS", Value::new(&false)?, "the controller is busy: stop its tasks and the robot first"),
        ("@NORMAL_STATUS", Value::new(&true)?, "the controller has an error: clear it first"),
        ("@EMERGENCY_STOP", Value::new(&false)?, "the emergency stop is pressed: release it first"),
    ] {
        match get_one(session, &ObjectPath::variable(name)?) {
            Ok(value) if value == fitting => {}
            Ok(value) => return Err(unfit(format!("{wrong} ({name} is {})", entry_text(Some(&Entry::Value(value)))))),
            Err(Failure::Refused { doing, code }) => {
                return Err(unfit(format!("the state of the controller is not known: {doing}: {code}")));
            }
            Err(failure) => return Err(failure),
        }
    }
    Ok(())
}

fn check_controller(args: &Restore, backup: &About, controller: &About) -> Result<(), Failure> {
    if args.other_controller || backup.is_same_controller(controller) {
        return Ok(());
    }
    Err(unfit(format!(
        "the backup is of {}, and this is {}; give --other-controller if that is intended",
        backup.describe(),
        controller.describe()
    )))
}

/// Prints the plan.
fn show(plan: &Plan, most: usize, json: bool) -> Result<(), Failure> {
    if json {
        plan.json_lines().iter().try_for_each(|line| print_json(line))?;
        return plan.notes.iter().try_for_each(|text| note(text, true));
    }
    let lines = plan.lines();
    lines.iter().take(most).try_for_each(|line| print_line(line))?;
    if lines.len() > most {
        print_line(&format!("... and {} more, which --dry-run shows", lines.len() - most))?;
    }
    plan.notes.iter().try_for_each(|text| note(&format!("note: {text}"), false))
}

/// Records and reports how the restore ended.
fn conclude(dir: &Path, journal: &mut Journal, written: Result<(), Failure>, json: bool) -> Result<(), Failure> {
    journal.end(&written.as_ref().err().map_or("complete".into(), ToString::to_string))?;
    if let Some(past) = Past::read(dir)? {
        summary(&past, json)?;
    }
    written
}

/// A restore under way.
struct Writing<'a> {
    session: &'a mut Session,
    journal: &'a mut Journal,
    replaced: &'a Replaced,
    interrupt: &'a Interrupt,
}

impl Writing<'_> {
    fn run(&mut self, plan: &Plan) -> Result<(), Failure> {
        let mut kind = None;
        for change in &plan.variables {
            let own = change.name.trim_end_matches(|c: char| c.is_ascii_digit());
            if kind.replace(own) != Some(own) {
                // a task may have been started since
                check_still_clear(self.session)?;
            }
            self.variable(change)?;
        }
        for file in &plan.files {
            check_still_clear(self.session)?;
            self.file(file)?;
        }
        Ok(())
    }

    fn variable(&mut self, change: &Change) -> Result<(), Failure> {
        let Change { name, was, value } = change;
        self.check_signal()?;
        let path = ObjectPath::variable(name)?;
        let variable = self.session.object(&path)?;
        let now = read(self.session, &path, variable)?;
        if now != *was {
            let [now, was] = [now, was.clone()].map(|value| entry_text(Some(&Entry::Value(value))));
            return Err(stopped(format!("{name} is {now} now and was {was} in the plan: another program writes it")));
        }
        self.journal.writing(name, &to_json(was.as_variant()), &to_json(value.as_variant()))?;
        self.session.call(name, FunctionId::VARIABLE_PUT_VALUE, &[integer(variable)?, value.clone()])?;
        let now = read(self.session, &path, variable)?;
        if now != *value {
            let [now, value] = [now, value.clone()].map(|value| entry_text(Some(&Entry::Value(value))));
            return Err(stopped(format!("{name} is {now} after {value} was written")));
        }
        self.journal.written(name)?;
        self.session.release(Object::Variable, variable)
    }

    fn file(&mut self, file: &FileChange) -> Result<(), Failure> {
        self.check_signal()?;
        let name = format!("file:{}", file.path);
        if content_now(self.session, file)? != file.was {
            return Err(stopped(format!("{name} has changed since the plan: another program writes it")));
        }
        let saved = file.was.as_ref().map(|was| self.replaced.save(&file.path, was)).transpose()?;
        self.journal.writing(&name, &file.was_json(saved.as_deref()), &file.value_json())?;
        remote_files::make_folders(self.session, &file.path)?;
        remote_files::write(self.session, &file.path, &file.bytes)?;
        Ok(self.journal.written(&name)?)
    }

    /// Ends the restore between two writes after a signal.
    fn check_signal(&self) -> Result<(), Failure> {
        self.interrupt.check("interrupted between two writes")
    }
}

/// Reads a file before it is written; `None` if it does not exist.
fn content_now(session: &mut Session, file: &FileChange) -> Result<Option<Vec<u8>>, Failure> {
    if file.was.is_none() && !remote_files::exists(session, &file.path)? {
        return Ok(None);
    }
    remote_files::read(session, &file.path).map(Some)
}

/// Checks the state in the middle of a restore, where something may have been written.
fn check_still_clear(session: &mut Session) -> Result<(), Failure> {
    check_state(session).map_err(|failure| match failure {
        Failure::Unfit { message, .. } => stopped(message.trim_end_matches(". Nothing was written").to_owned()),
        failure => failure,
    })
}

fn stopped(message: String) -> Failure {
    Failure::unfit(message, "nothing more was written")
}

/// Returns the failure of a restore that has written nothing.
fn unfit(message: String) -> Failure {
    bcap_backup::Error::unfit(message).into()
}
