//! `bcap errors`. While a stream of Slave Mode runs it sends nothing that would end it.

use std::time::Duration;

use bcap_capture::duration;
use bcap_core::bcap::{FunctionId, StreamState};
use bcap_core::hresult::HResult;
use bcap_core::variant::Variant;
use clap::Args;

use crate::commands::robot::messages;
use crate::failure::{Failure, hint_of};
use crate::output::{print_json, print_line};
use crate::session::Session;
use crate::session::slave_mode::StreamCheck;
use crate::values::{Value, integer, text};
use bcap_capture::value::data;

/// Lists the errors of the controller, the first cause first, with their meanings and remedies; clears them; follows messages
///
/// A controller keeps messages for each session from its start on, so --follow prints those that arrive while it waits. The shell
/// prints new ones before its prompt.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  bcap errors
  bcap errors --json
  bcap errors --clear
  bcap errors --follow --for 100ms")]
pub(crate) struct Errors {
    /// Clears the errors instead of listing them
    #[arg(long)]
    pub(crate) clear: bool,

    /// Prints the messages of the controller as they arrive: number, source, time and text; Ctrl-C ends that
    #[arg(long, conflicts_with = "clear")]
    pub(crate) follow: bool,

    /// Ends --follow after this time
    #[arg(long = "for", value_name = "TIME", value_parser = duration::parse, requires = "follow")]
    pub(crate) time: Option<Duration>,
}

/// Runs `bcap errors`.
pub(crate) fn errors(args: &Errors, session: &mut Session, json: bool) -> Result<(), Failure> {
    match args {
        Errors { clear: true, .. } => clear(session),
        Errors { follow: true, time, .. } => messages::follow(*time, session, json),
        _ => list(session, json),
    }
}

/// Prints the present errors.
pub(crate) fn list(session: &mut Session, json: bool) -> Result<(), Failure> {
    let mut check = StreamCheck::default();
    let count = count(session, &mut check)?;
    if count == 0 && !json {
        print_line("no errors")?;
    }
    // the last one is the first cause; each is printed at once, so that a refusal of a later one does not hide it
    (0..count).rev().try_for_each(|index| {
        let (code, message) = error(session, &mut check, index)?;
        print_error(code, &message, json)
    })
}

/// Reads the present errors of the controller with their texts, the first cause first. Fails with [`Failure::Unfit`] while a stream
/// runs.
pub(crate) fn present(session: &mut Session, check: &mut StreamCheck) -> Result<Vec<(HResult, String)>, Failure> {
    (0..count(session, check)?).rev().map(|index| error(session, check, index)).collect()
}

/// Reads the number of present errors.
fn count(session: &mut Session, check: &mut StreamCheck) -> Result<i32, Failure> {
    let count = checked(session, check, "GetCurErrorCount", &())?;
    Ok(count.as_variant().as_i32().unwrap_or(0).max(0))
}

fn error(session: &mut Session, check: &mut StreamCheck, index: i32) -> Result<(HResult, String), Failure> {
    let info = checked(session, check, "GetCurErrorInfo", &index)?;
    let elements: Vec<Variant<'_>> = info.as_variant().as_array().map(|info| info.iter().collect()).unwrap_or_default();
    let code = elements.first().and_then(|code| code.as_i32()).map(HResult);
    let message = elements.get(1).map(|message| data::format(*message)).unwrap_or_default();
    Ok((code.unwrap_or_default(), message))
}

fn print_error(code: HResult, message: &str, json: bool) -> Result<(), Failure> {
    let hint = hint_of(code);
    if json {
        let line = serde_json::json!({
            "code": code.0, "hresult": code.name(), "level": code.level(), "meaning": code.meaning(),
            "message": message, "hint": hint
        });
        return Ok(print_json(&line.to_string())?);
    }
    print_line(&described(code, message))?;
    hint.map_or(Ok(()), |hint| Ok(print_line(&format!("  hint: {hint}"))?))
}

/// Formats an error: its code, its meaning, and the controller's own text if that says something else.
pub(crate) fn described(code: HResult, text: &str) -> String {
    let own = own(code, text);
    match code.meaning() {
        Some(meaning) if own.is_empty() => format!("{code} {meaning}"),
        Some(meaning) if !own.contains(meaning) => format!("{code} {meaning} The controller says: {own}"),
        _ => format!("{code} {own}"),
    }
}

/// Returns the controller's own text; some controllers begin it with the name of the code.
pub(crate) fn own(code: HResult, text: &str) -> &str {
    code.name().and_then(|name| text.strip_prefix(name)?.strip_prefix(": ")).unwrap_or(text)
}

/// Clears the errors.
fn clear(session: &mut Session) -> Result<(), Failure> {
    let mut check = StreamCheck::default();
    // any other answer lets the user clear: a controller with errors may refuse slvGetMode
    if check.ask(session)? == StreamState::Runs {
        check.require(session, FunctionId::CONTROLLER_EXECUTE, Some("ClearError"))?;
    }
    controller(session, "ClearError", &()).map(drop)
}

/// Executes a command of the controller, unless it would end a stream.
pub(crate) fn checked(
    session: &mut Session,
    check: &mut StreamCheck,
    command: &str,
    parameter: &impl bcap_core::variant::Encode,
) -> Result<Value, Failure> {
    check.require(session, FunctionId::CONTROLLER_EXECUTE, Some(command))?;
    controller(session, command, parameter)
}

/// Executes a command of the controller.
fn controller(
    session: &mut Session,
    command: &str,
    parameter: &impl bcap_core::variant::Encode,
) -> Result<Value, Failure> {
    let arguments = [integer(session.controller()?)?, text(command)?, Value::new(parameter)?];
    let (_, value) = session.call(command, FunctionId::CONTROLLER_EXECUTE, &arguments)?;
    Ok(value.unwrap_or_default())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_error_has_its_meaning_once_and_then_the_text_of_the_controller() {
        let (code, meaning) = (HResult::E_MOTOR_OFF, HResult::E_MOTOR_OFF.meaning().unwrap());
        for same in ["", meaning, &format!("E_MOTOR_OFF: {meaning}")] {
            assert_eq!(described(code, same), format!("{code} {meaning}"));
        }
        assert_eq!(described(code, "Motor is off."), format!("{code} {meaning} The controller says: Motor is off."));
        let unknown = HResult::from_u32(0x8550_F001);
        assert!(described(unknown, "New fault.").ends_with("published meaning. The controller says: New fault."));
        assert_eq!(described(HResult(-1), "text"), "0xffffffff text");
    }
}
