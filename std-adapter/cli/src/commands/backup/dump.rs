//! `bcap dump`: saves a controller in a folder.

use std::path::PathBuf;

use bcap_terminal::progress::{Progress, bar};
use clap::Args;
use serde_json::json;

use crate::failure::Failure;
use crate::output::{print_line, print_result};
use crate::session::Session;
use bcap_backup::contents::Contents;
use bcap_backup::folder::Folder;
use bcap_backup::{controller, dump};

/// Saves all variables and files of the controller in a folder
///
/// The folder has a file of lines of JSON for each kind of variable, one for the system variables, and the controller's
/// files as they are; docs/backup.md describes it. `bcap diff` compares two of them, `bcap restore` writes one back. Nothing
/// is written to the controller. A dump that was interrupted or killed goes on where it was when the same command runs
/// again. The values are read one after another, so a program that runs meanwhile may change some of them.
///
/// The exit code is 1 if the controller refused a part; backup.json names it.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  bcap dump backup
  bcap dump --robot tcp:192.168.0.1 cell1-monday")]
pub(crate) struct Dump {
    /// The folder, which must not exist, be empty, or have an interrupted dump of the same controller
    #[arg(value_name = "DIR")]
    pub(crate) dir: PathBuf,
}

/// Runs `bcap dump`.
pub(crate) fn dump(args: &Dump, session: &mut Session, json: bool) -> Result<(), Failure> {
    let interrupt = session.handle_signals()?;
    let shown = args.dir.display().to_string();
    session.begin()?;
    let folder = Folder::begin(&args.dir, controller::about(session)?)?;
    if folder.is_resumed && !json {
        print_line(&format!("{shown}: the interrupted dump goes on"))?;
    }
    let mut progress = Progress::default();
    let contents = dump::dump(session, &folder, |at| {
        interrupt.check(&format!("interrupted; run `bcap dump {shown}` again to go on"))?;
        let (part, done, count) = (at.part, at.done as u64, at.count as u64);
        progress.show(|elapsed| format!("{part:4} {} {done}/{count} {elapsed}", bar(done, count)));
        Ok(())
    })?;
    print_summary(&shown, &contents, json)?;
    match contents.refused() + contents.omitted.len() {
        0 => Ok(()),
        missing => Err(Failure::unfit(
            format!("{shown}: the controller refused {missing} parts, which the backup does not have"),
            missing_parts(&contents),
        )),
    }
}

fn print_summary(shown: &str, contents: &Contents, json: bool) -> Result<(), Failure> {
    let Contents { about, variables, system, files, omitted } = contents;
    let object = json!({
        "dir": shown, "variables": variables.len(), "system": system.len(), "files": files.len(),
        "refused": contents.refused(), "omitted": omitted, "controller": about
    });
    let line = format!("{shown}: {} of {}", contents.summary(), about.describe());
    Ok(print_result(json, &object, &line)?)
}

fn missing_parts(contents: &Contents) -> String {
    let first =
        contents.omitted.first().map(|first| format!("the first of them is {}; ", first.reason)).unwrap_or_default();
    format!("{first}lines with \"refused\" and \"omitted\" in backup.json have their codes; over UDP, use TCP instead")
}
