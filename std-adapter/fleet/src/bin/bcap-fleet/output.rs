//! The lines of the standard output.

use std::io::{self, Write as _};

use bcap_terminal::escape;
use serde::Serialize;

/// Prints a line for people.
pub(crate) fn print_line(line: &str) -> io::Result<()> {
    print(&escape::line(line))
}

/// Prints a value as a line of JSON.
pub(crate) fn print_json(value: &impl Serialize) -> io::Result<()> {
    print(&escape::json(&serde_json::to_string(value)?))
}

/// Prints a block without text from outside.
pub(crate) fn print(text: &str) -> io::Result<()> {
    let mut out = io::stdout().lock();
    out.write_all(text.as_bytes())?;
    out.write_all(b"\n")?;
    out.flush()
}
