//! The events of a capture as lines of text or of JSON.

use std::fmt::Write as _;

use bcap_core::hresult::HResult;
use bcap_core::variant::OwnedVariant as Value;
use serde::Serialize;
use serde_json::value::RawValue;

use super::call::{Argument, Call, Event};
use crate::value;

/// The format of lines.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// For people; times count from the first event.
    Text,
    /// One JSON object for each event, with times since 1970.
    Json,
}

/// Writes events as lines.
#[derive(Clone, Copy, Debug)]
pub struct Printer {
    format: Format,
    /// The time of the first event, from which text counts.
    began: u64,
}

impl Printer {
    /// A printer for a capture that began at nanoseconds since 1970.
    #[must_use]
    pub const fn new(format: Format, began: u64) -> Self {
        Self { format, began }
    }

    /// Returns the line of an event, without its end.
    #[must_use]
    pub fn line(&self, event: &Event) -> String {
        if self.format == Format::Json {
            return to_json(event);
        }
        let at = seconds(event.at().saturating_sub(self.began));
        match event {
            Event::Link(link) => {
                format!("{at} {}: {}, client {}, server {}", link.name, link.protocol, link.client, link.server)
            }
            Event::Note(note) => format!("{at} {}: note: {}", note.link, note.text),
            Event::Call(call) => format!("{at} {} {}", call.link, call_text(call)),
        }
    }
}

/// Formats nanoseconds as seconds, to the microsecond.
pub(super) fn seconds(nanos: u64) -> String {
    format!("{:4}.{:06}", nanos / 1_000_000_000, nanos / 1000 % 1_000_000)
}

/// Formats nanoseconds as milliseconds, to the microsecond.
fn millis(nanos: u64) -> String {
    format!("{}.{:03} ms", nanos / 1_000_000, nanos / 1000 % 1000)
}

fn call_text(call: &Call) -> String {
    let mut out = request_text(call);
    match &call.reply {
        Some(reply) => {
            // writing to a string cannot fail, here and below
            let _ = write!(out, " -> {}", reply_text(reply.code, reply.value.as_ref()));
            if let Some(opened) = &reply.opened {
                let _ = write!(out, " = {opened}");
            }
            let _ = write!(out, " [{}]", millis(reply.after));
        }
        None => out.push_str(" -> no reply"),
    }
    if call.attempts > 1 {
        let _ = write!(out, " [{} attempts]", call.attempts);
    }
    if call.executing > 0 {
        let _ = write!(out, " [{} x S_EXECUTING]", call.executing);
    }
    out
}

/// A call without its reply: `#5 Variable_GetValue(variable: I1)`.
pub(crate) fn request_text(call: &Call) -> String {
    let serial = call.serial.map(|serial| format!("#{serial} ")).unwrap_or_default();
    let arguments: Vec<String> = call.arguments.iter().map(argument_text).collect();
    format!("{serial}{}({})", call.function, arguments.join(", "))
}

/// A reply: `S_OK I4(5)`.
pub(crate) fn reply_text(code: HResult, value: Option<&Value>) -> String {
    let value = value.map(|value| format!(" {}", short(value))).unwrap_or_default();
    format!("{}{value}", code_text(code))
}

/// The name of a code; of an error also its number and its meaning.
fn code_text(code: HResult) -> String {
    match (code.name(), code.meaning()) {
        (Some(name), _) if code.is_ok() => name.into(),
        (_, Some(meaning)) => format!("{code}: {}", meaning.trim_end_matches('.')),
        (_, None) => code.to_string(),
    }
}

pub(super) fn argument_text(argument: &Argument) -> String {
    let value = match (&argument.object, &argument.value) {
        (Some(object), _) => object.clone(),
        (None, Some(value)) => short(value),
        (None, None) => "?".into(),
    };
    argument.name.map(|name| format!("{name}: {value}")).unwrap_or(value)
}

/// A value as text; a long one as its type and size.
pub(super) fn short(value: &Value) -> String {
    const LONGEST: usize = 512;
    if value.as_bytes().len() <= LONGEST { format!("{:?}", value.as_variant()) } else { value::describe(Some(value)) }
}

/// An event as a line of JSON.
#[derive(Serialize)]
struct EventLine<'a> {
    /// Seconds since 1970; a string, because a float has too few digits for nanoseconds.
    time: String,
    link: &'a str,
    #[serde(flatten)]
    event: EventFields<'a>,
}

#[derive(Serialize)]
#[serde(untagged)]
enum EventFields<'a> {
    Link { protocol: &'a str, client: &'a str, server: &'a str },
    Note { note: &'a str },
    Call(CallFields<'a>),
}

#[derive(Serialize)]
struct CallFields<'a> {
    #[serde(skip_serializing_if = "Option::is_none")]
    serial: Option<u16>,
    function: &'a str,
    #[serde(skip_serializing_if = "Option::is_none")]
    command: Option<&'a str>,
    args: Vec<ArgumentFields<'a>>,
    attempts: u32,
    executing: u32,
    /// `null` without a reply.
    code: Option<i32>,
    hresult: Option<&'static str>,
    #[serde(skip_serializing_if = "Option::is_none")]
    meaning: Option<&'static str>,
    /// Microseconds from the first attempt to the reply.
    us: Option<u64>,
    value: Option<Box<RawValue>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    opened: Option<&'a str>,
}

#[derive(Serialize)]
struct ArgumentFields<'a> {
    #[serde(skip_serializing_if = "Option::is_none")]
    object: Option<&'a str>,
    /// `{"vt":3,"v":100}`, as `bcap decode --reverse` takes it.
    #[serde(skip_serializing_if = "Option::is_none")]
    value: Option<Box<RawValue>>,
}

fn to_json(event: &Event) -> String {
    let at = event.at();
    let time = format!("{}.{:09}", at / 1_000_000_000, at % 1_000_000_000);
    let (link, event) = match event {
        Event::Link(link) => {
            (&link.name, EventFields::Link { protocol: link.protocol, client: &link.client, server: &link.server })
        }
        Event::Note(note) => (&note.link, EventFields::Note { note: &note.text }),
        Event::Call(call) => (&call.link, EventFields::Call(call_fields(call))),
    };
    // serializing strings, numbers and values cannot fail
    serde_json::to_string(&EventLine { time, link, event }).unwrap_or_default()
}

fn call_fields(call: &Call) -> CallFields<'_> {
    let raw = |value: &Value| RawValue::from_string(value::to_json(value.as_variant())).ok();
    let argument = |argument: &'_ Argument| argument.value.as_ref().and_then(raw);
    let reply = call.reply.as_ref();
    CallFields {
        serial: call.serial,
        function: &call.function,
        command: call.command.as_deref(),
        args: call
            .arguments
            .iter()
            .map(|found| ArgumentFields { object: found.object.as_deref(), value: argument(found) })
            .collect(),
        attempts: call.attempts,
        executing: call.executing,
        code: reply.map(|reply| reply.code.0),
        hresult: reply.and_then(|reply| reply.code.name()),
        meaning: call.error().and_then(HResult::meaning),
        us: reply.map(|reply| reply.after / 1000),
        value: reply.and_then(|reply| reply.value.as_ref().and_then(raw)),
        opened: reply.and_then(|reply| reply.opened.as_deref()),
    }
}
