//! Writes a backup back to a controller.
//!
//! ```text
//!  plan ─► a person agrees ─► write, for each variable:
//!                             read, is it still as planned? ─► journal ─► write ─► read back ─► journal
//! ```
//!
//! A file is checked in the same way, and the replaced file is saved in the folder before the write.

use bcap_capture::value::named::Entry;
use bcap_capture::value::to_json;
use bcap_core::bcap::{FunctionId, Object};
use bcap_core::variant::OwnedVariant as Value;
use bcap_live::calls::{Calls, Failure as _};
use bcap_live::files as remote_files;
use bcap_live::stream::CheckedCalls;
use bcap_live::variables::{get_one, read};
use bcap_std::ObjectPath;

use crate::compare::entry_text;
use crate::contents::{About, Contents};
use crate::controller::{self, Progress};
use crate::error::Error;
use crate::journal::Journal;
use crate::plan::{Change, FileChange, Plan};
use crate::replaced::Replaced;

/// Permitted differences of a restore.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Options {
    /// Writes IO variables too, which switches the outputs of the controller.
    pub io: bool,
    /// Writes to a controller whose type or serial number differs, or is unknown.
    pub other_controller: bool,
}

/// Compares a backup with a controller that is at rest. `watch` gets the progress; its error ends the work.
///
/// # Errors
///
/// [`Error::Unfit`] if not everything can be written, [`Error::OtherController`]; the error of a call, or of `watch`.
pub fn plan<C: Calls>(
    session: &mut C,
    backup: &Contents,
    options: Options,
    watch: impl FnMut(Progress<'_>) -> Result<(), C::Error>,
) -> Result<Plan, C::Error>
where
    C::Error: From<Error>,
{
    if let Some(obstacle) = obstacle(session)? {
        return Err(Error::unfit(obstacle).into());
    }
    let controller = controller::contents(session, watch)?;
    check_controller(options, &backup.about, &controller.about)?;
    Ok(Plan::new(backup, &controller, options.io)?)
}

/// Returns the reason why the controller may change now, if it reports one: `None` if it is at rest and has no error.
fn obstacle<C: Calls>(session: &mut C) -> Result<Option<String>, C::Error> {
    for (name, fitting, wrong) in [
        ("@BUSY_STATUS", Value::new(&false)?, "the controller is busy: stop its tasks and the robot first"),
        ("@NORMAL_STATUS", Value::new(&true)?, "the controller has an error: clear it first"),
        ("@EMERGENCY_STOP", Value::new(&false)?, "the emergency stop is pressed: release it first"),
    ] {
        match get_one(session, &ObjectPath::variable(name)?) {
            Ok(value) if value == fitting => {}
            Ok(value) => return Ok(Some(format!("{wrong} ({name} is {})", entry_text(Some(&Entry::Value(value)))))),
            Err(refused) if refused.code().is_some() => {
                let why = refused.omission().unwrap_or_default();
                return Ok(Some(format!("the state of the controller is not known: {why}")));
            }
            Err(failure) => return Err(failure),
        }
    }
    Ok(None)
}

fn check_controller(options: Options, backup: &About, controller: &About) -> Result<(), Error> {
    if options.other_controller || backup.is_same_controller(controller) {
        return Ok(());
    }
    Err(Error::OtherController { backup: backup.describe(), controller: controller.describe() })
}

/// Writes a plan. `watch` gets the progress before each write; its error ends the restore between two writes.
///
/// # Errors
///
/// The error of a call, of the journal, or of `watch`; [`Failure::unfit`](bcap_live::calls::Failure::unfit) if the controller has
/// changed since the plan.
pub fn write<C: Calls>(
    session: &mut C,
    plan: &Plan,
    journal: &mut Journal,
    replaced: &Replaced,
    mut watch: impl FnMut(Progress<'_>) -> Result<(), C::Error>,
) -> Result<(), C::Error>
where
    C::Error: From<Error>,
{
    let session = &mut CheckedCalls::new(session);
    let count = plan.variables.len().saturating_add(plan.files.len());
    let mut kind = None;
    for (done, change) in plan.variables.iter().enumerate() {
        let own = change.name.trim_end_matches(|c: char| c.is_ascii_digit());
        if kind.replace(own) != Some(own) {
            // a task may have been started since
            check_still_clear(session)?;
        }
        watch(Progress { part: own, done, count })?;
        write_variable(session, change, journal)?;
    }
    for (done, file) in (plan.variables.len()..).zip(&plan.files) {
        check_still_clear(session)?;
        watch(Progress { part: "file", done, count })?;
        write_file(session, file, journal, replaced)?;
    }
    Ok(())
}

fn write_variable<C: Calls>(session: &mut C, change: &Change, journal: &mut Journal) -> Result<(), C::Error>
where
    C::Error: From<Error>,
{
    let Change { name, was, value } = change;
    let path = ObjectPath::variable(name)?;
    let variable = session.object(&path)?;
    let now = read(session, &path, variable)?;
    if now != *was {
        let [now, was] = [now, was.clone()].map(|value| entry_text(Some(&Entry::Value(value))));
        return Err(stopped(format!("{name} is {now} now and was {was} in the plan: another program writes it")));
    }
    journal.writing(name, &to_json(was.as_variant()), &to_json(value.as_variant()))?;
    session.call(name, FunctionId::VARIABLE_PUT_VALUE, &[Value::new(&variable)?, value.clone()])?;
    let now = read(session, &path, variable)?;
    if now != *value {
        let [now, value] = [now, value.clone()].map(|value| entry_text(Some(&Entry::Value(value))));
        return Err(stopped(format!("{name} is {now} after {value} was written")));
    }
    journal.written(name)?;
    session.release(Object::Variable, variable)
}

fn write_file<C: Calls>(
    session: &mut C,
    file: &FileChange,
    journal: &mut Journal,
    replaced: &Replaced,
) -> Result<(), C::Error>
where
    C::Error: From<Error>,
{
    let name = format!("file:{}", file.path);
    if content_now(session, file)? != file.was {
        return Err(stopped(format!("{name} has changed since the plan: another program writes it")));
    }
    let saved = file.was.as_ref().map(|was| replaced.save(&file.path, was)).transpose()?;
    journal.writing(&name, &file.was_json(saved.as_deref()), &file.value_json())?;
    remote_files::make_folders(session, &file.path)?;
    remote_files::write(session, &file.path, &file.bytes)?;
    Ok(journal.written(&name)?)
}

/// Reads a file before it is written; `None` if it does not exist.
fn content_now<C: Calls>(session: &mut C, file: &FileChange) -> Result<Option<Vec<u8>>, C::Error> {
    if file.was.is_none() && !remote_files::exists(session, &file.path)? {
        return Ok(None);
    }
    remote_files::read(session, &file.path).map(Some)
}

/// Checks the state in the middle of a restore, where something may have been written.
fn check_still_clear<C: Calls>(session: &mut C) -> Result<(), C::Error> {
    obstacle(session)?.map_or(Ok(()), |obstacle| Err(stopped(obstacle)))
}

fn stopped<F: bcap_live::calls::Failure>(message: String) -> F {
    F::unfit(message).with_hint("nothing more was written")
}
