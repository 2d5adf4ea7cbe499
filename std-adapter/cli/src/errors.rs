//! `bcap errors`, `bcap clear` and `bcap messages`. While a stream of Slave Mode runs they send nothing that would end it.

use std::fmt;
use std::time::{Duration, Instant};

use bcap_core::bcap::{FunctionId, Object, StreamState};
use bcap_core::hresult::HResult;
use bcap_core::variant::Variant;

use crate::args;
use crate::error::Failure;
use crate::output::{print_json, print_line};
use crate::plain;
use crate::session::Session;
use crate::stream::StreamCheck;
use crate::value::{Value, integer, text};

/// Runs `bcap errors`.
pub(crate) fn errors(session: &mut Session, json: bool) -> Result<(), Failure> {
    let mut check = StreamCheck::default();
    let count = count(session, &mut check)?;
    if count == 0 && !json {
        print_line("no errors")?;
    }
    // each at once: a refusal of a later one does not hide it
    (0..count).try_for_each(|index| {
        let (code, message) = error(session, &mut check, index)?;
        print_error(code, &message, json)
    })
}

/// Reads the present errors of the controller with their texts, the latest first. Fails with [`Failure::Unfit`] while a stream
/// runs.
pub(crate) fn present(session: &mut Session, check: &mut StreamCheck) -> Result<Vec<(HResult, String)>, Failure> {
    (0..count(session, check)?).map(|index| error(session, check, index)).collect()
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
    let message = elements.get(1).map(|message| plain::to_plain(*message)).unwrap_or_default();
    Ok((code.unwrap_or_default(), message))
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
    let mut check = StreamCheck::default();
    // any other answer lets the user clear: a controller with errors may refuse slvGetMode
    if check.ask(session)? == StreamState::Runs {
        check.require(session, FunctionId::CONTROLLER_EXECUTE, Some("ClearError"))?;
    }
    controller(session, "ClearError", &()).map(drop)
}

/// Executes a command of the controller, unless it would end a stream.
fn checked(
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

/// Runs `bcap messages`.
pub(crate) fn messages(args: &args::Messages, session: &mut Session, json: bool) -> Result<(), Failure> {
    const INTERVAL: Duration = Duration::from_millis(50);
    let mut check = StreamCheck::default();
    let Some(time) = args.time else { return fetch(session, &mut check, json) };
    let interrupt = session.handle_signals()?;
    let until = Instant::now() + time;
    loop {
        session.restart_budget();
        fetch(session, &mut check, json)?;
        let left = until.saturating_duration_since(Instant::now());
        if left.is_zero() || interrupt.sleep(INTERVAL.min(left)).is_err() {
            return Ok(());
        }
    }
}

/// Prints the messages that the controller has.
fn fetch(session: &mut Session, check: &mut StreamCheck, json: bool) -> Result<(), Failure> {
    while let Some(message) = next_message(session, check)? {
        let Message { number, source, time, text } = &message;
        if json {
            let line = serde_json::json!({ "number": number, "source": source, "time": time, "text": text });
            print_json(&line.to_string())?;
        } else {
            print_line(&message.to_string())?;
        }
    }
    Ok(())
}

/// A message of the controller.
pub(crate) struct Message {
    number: String,
    source: String,
    time: String,
    text: String,
}

impl fmt::Display for Message {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { number, source, time, text } = self;
        write!(f, "{time} {source} {number}: {text}")
    }
}

impl Message {
    /// Formats the message without its time, the text first.
    pub(crate) fn short(&self) -> String {
        format!("{} ({} {})", self.text, self.source, self.number)
    }
}

/// Fetches the oldest message that the controller has for this client; `None` without one. Fails with [`Failure::Unfit`]
/// while a stream runs.
pub(crate) fn next_message(session: &mut Session, check: &mut StreamCheck) -> Result<Option<Message>, Failure> {
    check.require(session, FunctionId::CONTROLLER_GET_MESSAGE, None)?;
    let arguments = [integer(session.controller()?)?];
    let (code, value) = session.call("messages", FunctionId::CONTROLLER_GET_MESSAGE, &arguments)?;
    let handle = value.as_ref().and_then(|value| value.as_variant().as_i32());
    let Some(handle) = handle.filter(|_| code == HResult::S_OK) else { return Ok(None) };
    let message = read_message(session, check, handle);
    session.release(Object::Message, handle)?;
    message.map(Some)
}

fn read_message(session: &mut Session, check: &mut StreamCheck, handle: i32) -> Result<Message, Failure> {
    let mut field = |function| {
        check.require(session, function, None)?;
        let (_, value) = session.call("message", function, &[integer(handle)?])?;
        Ok::<_, Failure>(plain::to_plain(value.unwrap_or_default().as_variant()))
    };
    Ok(Message {
        number: field(FunctionId::MESSAGE_GET_NUMBER)?,
        source: field(FunctionId::MESSAGE_GET_SOURCE)?,
        time: field(FunctionId::MESSAGE_GET_DATE_TIME)?,
        text: field(FunctionId::MESSAGE_GET_DESCRIPTION)?,
    })
}
