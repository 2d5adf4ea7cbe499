//! The standard output. Every line is escaped, because part of its text may come from outside.

use std::io::{self, Write};

use bcap_terminal::escape;
use serde::Serialize;

/// Prints one line for people.
pub(crate) fn print_line(line: &str) -> io::Result<()> {
    print_raw(&escape::line(line))
}

/// Prints lines of the command's own layout.
pub(crate) fn print_block(lines: &str) -> io::Result<()> {
    print_raw(&escape::block(lines))
}

/// Prints one line of JSON, or several.
pub(crate) fn print_json(lines: &str) -> io::Result<()> {
    print_raw(&escape::json(lines))
}

/// Prints one line, of JSON if `json`.
pub(crate) fn print(line: &str, json: bool) -> io::Result<()> {
    if json { print_json(line) } else { print_line(line) }
}

/// Prints a result: the object with `--json`, otherwise the line.
pub(crate) fn print_result(json: bool, object: &impl Serialize, line: &str) -> io::Result<()> {
    // serializing strings and numbers cannot fail
    if json { print_json(&serde_json::to_string(object).unwrap_or_default()) } else { print_line(line) }
}

/// Prints text as it is, with an end of line: nothing of it may come from outside.
pub(crate) fn print_raw(text: &str) -> io::Result<()> {
    let mut out = io::stdout().lock();
    out.write_all(text.as_bytes())?;
    out.write_all(b"\n")?;
    out.flush()
}

/// Prints a note on the standard error.
pub(crate) fn note(text: &str) {
    // an error of the standard error cannot be reported
    let _ = writeln!(io::stderr().lock(), " note: {}", escape::line(text));
}
