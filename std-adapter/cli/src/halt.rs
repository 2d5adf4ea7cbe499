//! `bcap halt`: the robot stops, over a connection that is used for nothing else.

use bcap_core::bcap::FunctionId;
use bcap_core::hresult::HResult;

use crate::args::LinkArgs;
use crate::error::Failure;
use crate::object::Path;
use crate::output::{print_json, print_line};
use crate::session::{integer, text, with_session};

/// Runs `bcap halt`.
pub(crate) fn halt(link: &LinkArgs, json: bool) -> Result<(), Failure> {
    let code = halt_now(link)?;
    let moved = code != HResult::S_FALSE;
    match (json, moved) {
        (true, _) => print_json(&format!("{{\"halted\":{moved}}}"))?,
        (false, true) => print_line("halted")?,
        (false, false) => print_line("nothing was moving")?,
    }
    Ok(())
}

/// Halts the robot, and returns the controller's code: S_FALSE when nothing was moving.
///
/// All of it has one short time limit: a controller that does not halt must be reported while there is time to act.
pub(crate) fn halt_now(link: &LinkArgs) -> Result<HResult, Failure> {
    with_session(&link.limited(), |session| {
        let robot = Path::parse("robot").transpose().map_err(Failure::Input)?;
        let robot = session.object(&robot.unwrap_or(Path { steps: Vec::new() }))?;
        let (code, _) = session.call_for_code(FunctionId::ROBOT_HALT, &[integer(robot)?, text("")?])?;
        if code.is_err() {
            return Err(Failure::Refused { doing: FunctionId::ROBOT_HALT.to_string(), code });
        }
        Ok(code)
    })
}
