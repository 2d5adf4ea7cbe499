//! The settings of a board ([`bcap_board::Settings`]): checked here, and again by the board.

use std::fs;
use std::path::Path;

use bcap_board::Settings;
use bcap_board::console::LINE;
use bcap_board::crc::Crc32;
use bcap_board::slots::TEXT;

use crate::console::{Answer, Console};
use crate::error::Error;

/// The hint after a refused change.
const UNCHANGED: &str = "the settings of the board are unchanged";

/// Reads and checks settings: `KEY=VALUE`, or `@FILE` with one setting on each line and comments after `#`. In the result each
/// setting ends with a line feed.
///
/// # Errors
///
/// [`Error::Invalid`] with the first setting that a board would refuse.
pub fn read(arguments: &[String]) -> Result<String, Error> {
    let mut settings = String::new();
    let mut add = |line: &str| settings.extend([line, "\n"]);
    for argument in arguments {
        match argument.strip_prefix('@') {
            Some(path) => {
                let text = fs::read_to_string(path).map_err(|error| Error::at(Path::new(path), error))?;
                Settings::lines_of_file(&text).for_each(&mut add);
            }
            None => add(argument),
        }
    }
    Settings::check(settings.as_bytes()).map_err(|error| Error::Invalid(error.to_string()))?;
    let most = LINE - "add ".len();
    if let Some(line) = settings.lines().find(|line| line.len() > most || line.is_empty()) {
        return Err(Error::Invalid(format!(
            "a setting has 1 to {most} bytes, but this has {}: \"{line}\"",
            line.len()
        )));
    }
    if settings.len() > TEXT {
        return Err(Error::Invalid(format!("the settings take {} bytes of {TEXT}", settings.len())));
    }
    Ok(settings)
}

/// Sends a request that changes the settings, such as `factory`, or restarts the board.
///
/// # Errors
///
/// [`Error::Refused`] if the board refuses it; the errors of the connection.
pub fn request(console: &mut Console, request: &str) -> Result<Answer, Error> {
    let answer = console.ask(request)?;
    answer.accepted(request, UNCHANGED)?;
    Ok(answer)
}

/// Replaces the settings of a board by the result of [`read`], and calls `accepted` with each request that the board has
/// accepted. The settings change with the last request, so an earlier failure changes nothing.
///
/// # Errors
///
/// Same as [`request`], plus the errors of `accepted`.
pub fn replace<E: From<Error>>(
    console: &mut Console,
    settings: &str,
    mut accepted: impl FnMut(&str, &Answer) -> Result<(), E>,
) -> Result<(), E> {
    console.ask("new")?.accepted("new", UNCHANGED)?;
    let crc = Crc32::new().and(settings.as_bytes()).value();
    let requests = settings.lines().map(|line| format!("add {line}")).chain([format!("save {crc:08x}")]);
    for line in requests {
        accepted(&line, &request(console, &line)?)?;
    }
    Ok(())
}
