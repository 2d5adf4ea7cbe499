//! Differences and totals of a replay as text and JSON.

use std::fmt;

use bcap_core::hresult::HResult;
use bcap_core::variant::OwnedVariant as Value;
use serde::Serialize;
use serde_json::value::RawValue;

use super::link::{Came, Outcome};
use crate::decode::{reply_text, request_text};
use crate::value;

/// The numbers at the end of a replay.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[non_exhaustive]
pub struct Totals {
    /// The connections of the capture.
    pub connections: usize,
    /// The calls that were made, or could not be made.
    pub calls: usize,
    /// The calls with a recorded reply.
    pub compared: usize,
    /// The replies that differ.
    pub differences: usize,
}

impl Totals {
    pub(super) fn count(&mut self, outcome: &Outcome<'_>) {
        self.calls += 1;
        self.compared += usize::from(outcome.call.reply.is_some());
        self.differences += usize::from(outcome.is_different);
    }
}

impl fmt::Display for Totals {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let counted = |count: usize, noun: &str| format!("{count} {noun}{}", if count == 1 { "" } else { "s" });
        let (calls, connections) = (counted(self.calls, "call"), counted(self.connections, "connection"));
        let differences = counted(self.differences, "difference");
        write!(f, "{calls} of {connections}, {} replies compared, {differences}", self.compared)
    }
}

/// The call, the recorded reply and the reply of the replay, in three lines.
impl fmt::Display for Outcome<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let call = self.call;
        let recorded = call.reply.as_ref().map(|reply| reply_text(reply.code, reply.value.as_ref()));
        let recorded = recorded.unwrap_or_else(|| "no reply".into());
        let came = match &self.came {
            Came::Reply(code, value) => reply_text(*code, value.as_ref()),
            Came::Nothing(why) => format!("no reply: {why}"),
        };
        write!(f, "{} {}\n  recorded: {recorded}\n  replayed: {came}", call.link, request_text(call))
    }
}

/// A difference as a line of JSON.
#[derive(Serialize)]
struct Difference<'a> {
    link: &'a str,
    #[serde(skip_serializing_if = "Option::is_none")]
    serial: Option<u16>,
    call: String,
    recorded: Option<ReplyFields>,
    replayed: Option<ReplyFields>,
    #[serde(skip_serializing_if = "Option::is_none")]
    error: Option<&'a str>,
}

#[derive(Serialize)]
struct ReplyFields {
    code: i32,
    hresult: Option<&'static str>,
    value: Option<Box<RawValue>>,
}

impl ReplyFields {
    fn new(code: HResult, value: Option<&Value>) -> Self {
        let value = value.and_then(|value| RawValue::from_string(value::to_json(value.as_variant())).ok());
        Self { code: code.0, hresult: code.name(), value }
    }
}

impl Outcome<'_> {
    /// Returns the outcome as a line of JSON.
    #[must_use]
    pub fn to_json(&self) -> String {
        let call = self.call;
        let recorded = call.reply.as_ref().map(|reply| ReplyFields::new(reply.code, reply.value.as_ref()));
        let (replayed, error) = match &self.came {
            Came::Reply(code, value) => (Some(ReplyFields::new(*code, value.as_ref())), None),
            Came::Nothing(why) => (None, Some(why.as_str())),
        };
        let line =
            Difference { link: &call.link, serial: call.serial, call: request_text(call), recorded, replayed, error };
        // serializing strings, numbers and values cannot fail
        serde_json::to_string(&line).unwrap_or_default()
    }
}
