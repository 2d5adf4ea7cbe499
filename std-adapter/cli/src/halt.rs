//! `bcap halt`: halts the robot over a connection of its own, in `bcap shell` and `bcap run` over theirs.

use bcap_std::blocking::Halted;

use crate::args::LinkArgs;
use crate::error::Failure;
use crate::output::{print_json, print_line};
use crate::session::{Session, with_session};

/// Runs `bcap halt`.
pub(crate) fn halt(session: &mut Session, json: bool) -> Result<(), Failure> {
    let halted = if session.is_open() { halt_in(session) } else { halt_now(session.link()) };
    let moved = halted? == Halted::Halted;
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
    with_session(&link.limited(), halt_in)
}

fn halt_in(session: &mut Session) -> Result<Halted, Failure> {
    session.with(|controller| controller.robot()?.halt())
}
