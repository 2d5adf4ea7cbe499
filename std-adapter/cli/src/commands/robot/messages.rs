//! `bcap messages`: the messages of the controller. While a stream of Slave Mode runs, nothing is sent that would end it.

use std::fmt;
use std::time::{Duration, Instant};

use bcap_capture::duration;
use bcap_core::bcap::{FunctionId, Object};
use bcap_core::hresult::HResult;
use clap::Args;

use crate::failure::Failure;
use crate::output::{print_json, print_line};
use crate::session::Session;
use crate::session::slave_mode::StreamCheck;
use crate::values::integer;
use bcap_capture::value::data;

/// Fetches the messages of the controller and prints them: number, source, time and text
///
/// A controller keeps messages for each session from its start on, so a single command gets those that arrive while it
/// waits (--for); in the shell `messages` prints those since the last call.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  bcap messages
  bcap messages --for 100ms --json")]
pub(crate) struct Messages {
    /// Waits this long for further messages; Ctrl-C ends that
    #[arg(long = "for", value_name = "TIME", value_parser = duration::parse)]
    pub(crate) time: Option<Duration>,
}

/// Runs `bcap messages`.
pub(crate) fn messages(args: &Messages, session: &mut Session, json: bool) -> Result<(), Failure> {
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
