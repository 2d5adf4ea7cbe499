//! `bcap halt`: halts the robot over a connection of its own.

use bcap_std::blocking::Halted;

use crate::args::LinkArgs;
use crate::error::Failure;
use crate::output::{print_json, print_line};
use crate::session::with_session;

/// Runs `bcap halt`.
pub(crate) fn halt(link: &LinkArgs, json: bool) -> Result<(), Failure> {
    let moved = halt_now(link)? == Halted::Halted;
    match (json, moved) {
        (true, _) => print_json(&format!("{{\"halted\":{moved}}}"))?,
        (false, true) => print_line("halted")?,
        (false, false) => print_line("nothing was moving")?,
    }
    Ok(())
}

/// Halts the robot.
///
/// The whole operation has one short time limit, so that a failure is reported while the user still has time to act.
pub(crate) fn halt_now(link: &LinkArgs) -> Result<Halted, Failure> {
    with_session(&link.limited(), |session| {
        let halted = session.connected()?.robot().and_then(|mut robot| robot.halt());
        halted.map_err(|error| session.ended(error))
    })
}
