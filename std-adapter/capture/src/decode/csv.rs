//! Calls as rows of comma-separated values.

use super::call::Call;
use super::print::{argument_text, seconds, short};

/// The columns.
const COLUMNS: [&str; 10] =
    ["time", "link", "serial", "function", "command", "arguments", "attempts", "hresult", "ms", "value"];

/// Returns the names of the columns as a row.
#[must_use]
pub fn heading() -> String {
    COLUMNS.join(",")
}

/// Returns a call as a row, of a capture that began at nanoseconds since 1970. A call without a reply has an empty result, response time and value.
#[must_use]
pub fn line(call: &Call, began: u64) -> String {
    let arguments: Vec<_> = call.arguments.iter().map(argument_text).collect();
    let reply = call.reply.as_ref();
    let code = reply.map(|reply| reply.code.name().map_or_else(|| reply.code.to_string(), str::to_owned));
    let millis = reply.map(|reply| format!("{}.{:03}", reply.after / 1_000_000, reply.after / 1000 % 1000));
    let fields: [String; COLUMNS.len()] = [
        seconds(call.at.saturating_sub(began)).trim_start().to_owned(),
        call.link.clone(),
        call.serial.map(|serial| serial.to_string()).unwrap_or_default(),
        call.function.clone(),
        call.command.clone().unwrap_or_default(),
        arguments.join(", "),
        call.attempts.to_string(),
        code.unwrap_or_default(),
        millis.unwrap_or_default(),
        reply.and_then(|reply| reply.value.as_ref()).map(short).unwrap_or_default(),
    ];
    row(&fields)
}

/// Joins fields to a row, with the quotes that they need.
#[must_use]
pub fn row(fields: &[String]) -> String {
    let quoted = |field: &String| match field.contains([',', '"', '\n', '\r']) {
        true => format!("\"{}\"", field.replace('"', "\"\"")),
        false => field.clone(),
    };
    fields.iter().map(quoted).collect::<Vec<_>>().join(",")
}
