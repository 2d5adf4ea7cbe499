//! `bcap restore`: writes a backup back to the controller.
//!
//! The user may read the plan for hours, so the command's session does not stay open during that time, and each value and file
//! is checked again.

use std::path::{Path, PathBuf};

use clap::Args;
use serde_json::json;

use bcap_backup::contents::Contents;
use bcap_backup::folder;
use bcap_backup::journal::{Journal, Past};
use bcap_backup::plan::Plan;
use bcap_backup::replaced::Replaced;
use bcap_backup::restore::{self, Options};

use crate::failure::Failure;
use crate::output::{print_json, print_line, print_result};
use crate::session::Session;
use crate::session::confirm::Question;

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
    let plan = session.before_question(|session| planned(args, &backup, session))?;
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
        restore::write(session, &plan, &mut journal, &replaced, |_| interrupt.check("interrupted between two writes"))
    });
    conclude(&args.dir, &mut journal, written, json)
}

/// Compares the backup with the controller.
fn planned(args: &Restore, backup: &Contents, session: &mut Session) -> Result<Plan, Failure> {
    session.begin()?;
    let options = Options { io: args.io, other_controller: args.other_controller };
    restore::plan(session, backup, options, |_| Ok(()))
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

/// Prints the plan.
fn show(plan: &Plan, most: usize, json: bool) -> Result<(), Failure> {
    let outputs = (plan.unwritten_io > 0)
        .then(|| format!("{} IO differ; they switch outputs and are written only with --io", plan.unwritten_io));
    let mut notes = outputs.iter().chain(&plan.notes);
    if json {
        plan.json_lines().iter().try_for_each(|line| print_json(line))?;
        return notes.try_for_each(|text| note(text, true));
    }
    let lines = plan.lines();
    lines.iter().take(most).try_for_each(|line| print_line(line))?;
    if lines.len() > most {
        print_line(&format!("... and {} more, which --dry-run shows", lines.len() - most))?;
    }
    notes.try_for_each(|text| note(&format!("note: {text}"), false))
}

/// Records and reports how the restore ended.
fn conclude(dir: &Path, journal: &mut Journal, written: Result<(), Failure>, json: bool) -> Result<(), Failure> {
    journal.end(&written.as_ref().err().map_or("complete".into(), ToString::to_string))?;
    let shown = Past::read(dir)?.map_or(Ok(()), |past| summary(&past, json));
    written.and(shown)
}
