//! The axes of `bcap jog`: the motion by a step, and where the robot is.

use bcap_live::axis::Axis;
use bcap_std::Move;

use crate::failure::Failure;
use crate::session::Session;

/// Returns the motion by a step. The arm must be taken, and the tool selected, so that the position is still true when the
/// robot moves.
pub(crate) fn step(axis: Axis, by: f64, session: &mut Session) -> Result<Move, Failure> {
    require_rest(session)?;
    let step = session.with(|controller| axis.step(by, &mut controller.robot()?))?;
    step.map(|step| step.motion).ok_or_else(|| Failure::Input(format!("{axis}: the position has no valid Fig")))
}

/// Reads where the robot is on each axis.
pub(crate) fn read_all(session: &mut Session) -> Result<Vec<(Axis, f64)>, Failure> {
    session.with(|controller| Axis::read_all(&mut controller.robot()?))
}

/// Reads where the robot is on an axis.
pub(crate) fn read(axis: Axis, session: &mut Session) -> Result<f64, Failure> {
    let all = read_all(session)?;
    Ok(all.iter().find(|(known, _)| *known == axis).map_or(f64::NAN, |(_, position)| *position))
}

/// Fails unless the robot rests: a position on the way is not one to start from.
pub(crate) fn require_rest(session: &mut Session) -> Result<(), Failure> {
    if !session.with(|controller| controller.robot()?.read::<bool>("@BUSY_STATUS"))? {
        return Ok(());
    }
    Err(Failure::unfit("the robot moves", "wait until it rests, or halt it with `bcap halt`"))
}
