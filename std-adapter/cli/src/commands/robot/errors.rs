//! `bcap errors`. While a stream of Slave Mode runs, the command sends nothing that would end it.

use std::time::Duration;

use bcap_capture::duration;
use bcap_core::hresult::HResult;
use bcap_live::errors::{count, error};
pub(crate) use bcap_live::errors::{described, present};
use bcap_live::messages::{Message, next_message};
use bcap_live::reader::MESSAGES;
use clap::Args;

use crate::failure::{Failure, hint_of};
use crate::output::{print_json, print_line, print_result};
use crate::session::Session;
use bcap_live::stream::StreamCheck;

/// Lists the errors of the controller, the first cause first, with their meanings and remedies; clears them; follows messages
///
/// A controller keeps messages for each session from its start on, so --follow prints those that arrive while it waits. The shell
/// prints new ones before its prompt.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  bcap errors
  bcap errors --json
  bcap errors --clear
  bcap errors --follow --for 100ms")]
pub(crate) struct Errors {
    /// Clears the errors instead of listing them
    #[arg(long)]
    pub(crate) clear: bool,

    /// Prints the messages of the controller as they arrive: number, source, time and text; Ctrl-C ends that
    #[arg(long, conflicts_with = "clear")]
    pub(crate) follow: bool,

    /// Ends --follow after this time
    #[arg(long = "for", value_name = "TIME", value_parser = duration::parse, requires = "follow")]
    pub(crate) time: Option<Duration>,
}

/// Runs `bcap errors`.
pub(crate) fn errors(args: &Errors, session: &mut Session, json: bool) -> Result<(), Failure> {
    match args {
        Errors { clear: true, .. } => bcap_live::errors::clear(session),
        Errors { follow: true, time, .. } => follow(*time, session, json),
        _ => list(session, json),
    }
}

/// Prints the messages of the controller as they arrive, until a signal or the end of the time.
fn follow(time: Option<Duration>, session: &mut Session, json: bool) -> Result<(), Failure> {
    let mut check = StreamCheck::default();
    session.repeat(Duration::from_millis(50), time, |session| {
        // the others follow in the next round
        for _ in 0..MESSAGES {
            let Some(message) = next_message(session, &mut check)? else { break };
            let Message { number, source, time, text } = &message;
            let object = serde_json::json!({ "number": number, "source": source, "time": time, "text": text });
            print_result(json, &object, &message.to_string())?;
        }
        Ok(())
    })
}

/// Prints the current errors.
pub(crate) fn list(session: &mut Session, json: bool) -> Result<(), Failure> {
    let mut check = StreamCheck::default();
    let count = count(session, &mut check)?;
    if count == 0 && !json {
        print_line("no errors")?;
    }
    // the last error is the first cause; each is printed immediately, so that a refusal of a later query does not hide it
    (0..count).rev().try_for_each(|index| {
        let (code, message) = error(session, &mut check, index)?;
        print_error(code, &message, json)
    })
}

fn print_error(code: HResult, message: &str, json: bool) -> Result<(), Failure> {
    let hint = hint_of(code);
    if json {
        let line = serde_json::json!({
            "code": code.0, "hresult": code.name(), "level": code.level(), "meaning": code.meaning(),
            "message": message, "hint": hint
        });
        return Ok(print_json(&line.to_string())?);
    }
    print_line(&described(code, message))?;
    hint.map_or(Ok(()), |hint| Ok(print_line(&format!("  hint: {hint}"))?))
}
