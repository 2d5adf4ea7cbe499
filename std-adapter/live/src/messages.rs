//! The messages of a controller. The controller keeps them for each session from the start of the session on.

use std::fmt;

use bcap_capture::value::data;
use bcap_core::bcap::{FunctionId, Object};
use bcap_core::hresult::HResult;
use bcap_core::variant::OwnedVariant;
use bcap_std::ObjectPath;

use crate::calls::Calls;
use crate::stream::StreamCheck;

/// A message of the controller. All fields are its own text.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Message {
    /// The number, as it was sent.
    pub number: String,
    /// The part of the controller that sent it.
    pub source: String,
    /// The controller's time.
    pub time: String,
    /// The text.
    pub text: String,
}

impl fmt::Display for Message {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { source, time, text, .. } = self;
        write!(f, "{time} {source} {}: {text}", self.number())
    }
}

impl Message {
    /// Returns the number; the code of an error in the usual form.
    fn number(&self) -> String {
        match self.number.parse() {
            Ok(code @ ..0) => format!("{:#010x}", HResult(code).to_u32()),
            _ => self.number.clone(),
        }
    }

    /// Formats the message without its time, the text first.
    #[must_use]
    pub fn short(&self) -> String {
        format!("{} ({} {})", self.text, self.source, self.number())
    }
}

/// Fetches the oldest message that the controller has for this client; `None` without one.
///
/// # Errors
///
/// [`Failure::skipped`](crate::calls::Failure::skipped) while a stream runs, or the error of a call.
pub fn next_message<C: Calls>(calls: &mut C, check: &mut StreamCheck) -> Result<Option<Message>, C::Error> {
    check.require(calls, FunctionId::CONTROLLER_GET_MESSAGE, None)?;
    let arguments = [OwnedVariant::new(&calls.object(&ObjectPath::controller())?)?];
    let (code, value) = calls.call("messages", FunctionId::CONTROLLER_GET_MESSAGE, &arguments)?;
    let handle = value.as_ref().and_then(|value| value.as_variant().as_i32());
    let Some(handle) = handle.filter(|_| code == HResult::S_OK) else { return Ok(None) };
    let message = read_message(calls, check, handle);
    calls.release(Object::Message, handle)?;
    message.map(Some)
}

fn read_message<C: Calls>(calls: &mut C, check: &mut StreamCheck, handle: i32) -> Result<Message, C::Error> {
    let mut field = |function| {
        check.require(calls, function, None)?;
        let (_, value) = calls.call("message", function, &[OwnedVariant::new(&handle)?])?;
        Ok::<_, C::Error>(data::format(value.unwrap_or_default().as_variant()))
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
