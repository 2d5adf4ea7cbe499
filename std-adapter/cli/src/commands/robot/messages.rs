//! `bcap errors --follow`: the messages of the controller. While a stream of Slave Mode runs, nothing is sent that would end it.

use std::fmt;
use std::time::{Duration, Instant};

use bcap_core::bcap::{FunctionId, Object};
use bcap_core::hresult::HResult;

use crate::failure::Failure;
use crate::output::print_result;
use crate::session::Session;
use crate::session::slave_mode::StreamCheck;
use crate::values::integer;
use bcap_capture::value::data;

/// Prints the messages of the controller as they arrive, until a signal or the end of the time.
pub(crate) fn follow(time: Option<Duration>, session: &mut Session, json: bool) -> Result<(), Failure> {
    const INTERVAL: Duration = Duration::from_millis(50);
    let mut check = StreamCheck::default();
    let interrupt = session.handle_signals()?;
    let began = Instant::now();
    loop {
        session.restart_budget();
        fetch(session, &mut check, json)?;
        let left = time.map_or(INTERVAL, |time| time.saturating_sub(began.elapsed()));
        if left.is_zero() || interrupt.sleep(INTERVAL.min(left)).is_err() {
            return Ok(());
        }
    }
}

/// Prints the messages that the controller has.
fn fetch(session: &mut Session, check: &mut StreamCheck, json: bool) -> Result<(), Failure> {
    while let Some(message) = next_message(session, check)? {
        let Message { number, source, time, text } = &message;
        let object = serde_json::json!({ "number": number, "source": source, "time": time, "text": text });
        print_result(json, &object, &message.to_string())?;
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
        let Self { source, time, text, .. } = self;
        write!(f, "{time} {source} {}: {text}", self.number())
    }
}

impl Message {
    /// Returns the number; the code of an error as everything else prints it.
    fn number(&self) -> String {
        match self.number.parse() {
            Ok(code @ ..0) => format!("{:#010x}", HResult(code).to_u32()),
            _ => self.number.clone(),
        }
    }

    /// Formats the message without its time, the text first.
    #[cfg(feature = "screens")]
    pub(crate) fn short(&self) -> String {
        format!("{} ({} {})", self.text, self.source, self.number())
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
        Ok::<_, Failure>(data::format(value.unwrap_or_default().as_variant()))
    };
    Ok(Message {
        number: field(FunctionId::MESSAGE_GET_NUMBER)?,
        source: field(FunctionId::MESSAGE_GET_SOURCE)?,
        time: field(FunctionId::MESSAGE_GET_DATE_TIME)?,
        text: field(FunctionId::MESSAGE_GET_DESCRIPTION)?,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_code_of_an_error_is_hexadecimal() {
        let message = |number: &str| Message {
            number: number.into(),
            source: "RC8".into(),
            time: "10:00".into(),
            text: "Motor is off.".into(),
        };
        assert_eq!(message("-2125459453").to_string(), "10:00 RC8 0x81501003: Motor is off.");
        assert_eq!(message("7").to_string(), "10:00 RC8 7: Motor is off.");
    }
}
