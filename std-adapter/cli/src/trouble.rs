//! `bcap errors`, `bcap clear` and `bcap messages`.

use std::time::{Duration, Instant};

use bcap_core::bcap::{FunctionId, Object};
use bcap_core::hresult::HResult;
use bcap_core::variant::Variant;

use crate::args::Messages;
use crate::error::Failure;
use crate::output::{print_json, print_line};
use crate::plain;
use crate::session::Session;
use crate::value::{Value, integer, text};

/// Runs `bcap errors`.
pub(crate) fn errors(session: &mut Session, json: bool) -> Result<(), Failure> {
    let count = controller(session, "GetCurErrorCount", &())?;
    let count = count.as_variant().as_i32().unwrap_or(0);
    if count == 0 && !json {
        print_line("no errors")?;
    }
    for index in 0..count {
        let info = controller(session, "GetCurErrorInfo", &index)?;
        let elements: Vec<Variant<'_>> =
            info.as_variant().as_array().map(|info| info.iter().collect()).unwrap_or_default();
        let code = elements.first().and_then(|code| code.as_i32()).map(HResult);
        let message = elements.get(1).map(|message| plain::to_plain(*message)).unwrap_or_default();
        print_error(code.unwrap_or_default(), &message, json)?;
    }
    Ok(())
}

fn print_error(code: HResult, message: &str, json: bool) -> Result<(), Failure> {
    if json {
        let (name, hint) = (code.name(), code.hint());
        let line = serde_json::json!({ "code": code.0, "hresult": name, "message": message, "hint": hint });
        return Ok(print_json(&line.to_string())?);
    }
    print_line(&format!("{code} {message}"))?;
    if let Some(hint) = code.hint() {
        print_line(&format!("  hint: {hint}"))?;
    }
    Ok(())
}

/// Runs `bcap clear`.
pub(crate) fn clear(session: &mut Session) -> Result<(), Failure> {
    controller(session, "ClearError", &()).map(drop)
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

/// Runs `bcap messages`.
pub(crate) fn messages(args: &Messages, session: &mut Session, json: bool) -> Result<(), Failure> {
    const INTERVAL: Duration = Duration::from_millis(50);
    let Some(time) = args.time else { return fetch(session, json) };
    let interrupt = session.handle_signals()?;
    let until = Instant::now() + time;
    loop {
        session.restart_budget();
        fetch(session, json)?;
        let left = until.saturating_duration_since(Instant::now());
        if left.is_zero() || interrupt.sleep(INTERVAL.min(left)).is_err() {
            return Ok(());
        }
    }
}

/// Prints the messages that the controller has.
fn fetch(session: &mut Session, json: bool) -> Result<(), Failure> {
    loop {
        let arguments = [integer(session.controller()?)?];
        let (code, value) = session.call("messages", FunctionId::CONTROLLER_GET_MESSAGE, &arguments)?;
        let handle = value.as_ref().and_then(|value| value.as_variant().as_i32());
        let Some(handle) = handle.filter(|_| code == HResult::S_OK) else { return Ok(()) };
        let printed = print_message(session, handle, json);
        session.release(Object::Message, handle)?;
        printed?;
    }
}

fn print_message(session: &mut Session, handle: i32, json: bool) -> Result<(), Failure> {
    let mut field = |function| {
        let (_, value) = session.call("message", function, &[integer(handle)?])?;
        Ok::<_, Failure>(plain::to_plain(value.unwrap_or_default().as_variant()))
    };
    let number = field(FunctionId::MESSAGE_GET_NUMBER)?;
    let source = field(FunctionId::MESSAGE_GET_SOURCE)?;
    let time = field(FunctionId::MESSAGE_GET_DATE_TIME)?;
    let text = field(FunctionId::MESSAGE_GET_DESCRIPTION)?;
    if json {
        let line = serde_json::json!({ "number": number, "source": source, "time": time, "text": text });
        return Ok(print_json(&line.to_string())?);
    }
    Ok(print_line(&format!("{time} {source} {number}: {text}"))?)
}
