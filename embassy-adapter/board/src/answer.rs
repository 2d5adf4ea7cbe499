//! The answers of the console.

use core::fmt;

use embedded_io::{Write, WriteFmtError};

/// Answers with the result of an operation on the flash.
pub(crate) fn result<W: Write, E: fmt::Display>(port: &mut W, result: Result<(), E>) -> Result<(), W::Error> {
    match result {
        Ok(()) => answer(port, format_args!("ok")),
        Err(error) => answer(port, format_args!("error {error}")),
    }
}

/// Answers with a line.
pub(crate) fn answer<W: Write>(port: &mut W, text: fmt::Arguments<'_>) -> Result<(), W::Error> {
    match port.write_fmt(text) {
        Err(WriteFmtError::Other(error)) => return Err(error),
        // the texts here cannot fail
        Err(WriteFmtError::FmtError) | Ok(()) => {}
    }
    port.write_all(b"\n")?;
    port.flush()
}
