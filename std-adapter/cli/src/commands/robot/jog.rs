//! `bcap jog` and `bcap teach`: moves the robot by one step, and stores where it is.

use std::fmt;
use std::str::FromStr;

use bcap_capture::value::data;
use bcap_core::bcap::FunctionId;
use bcap_core::position::Position;
use bcap_core::rac::{Variable, VariableKind};
use bcap_std::{Move, ObjectPath};
use clap::Args;
use serde_json::json;

use crate::commands::robot::motion::{self, MotionArgs, MoveArgs};
use crate::failure::Failure;
use crate::output::print_result;
use crate::session::Session;
use crate::session::slave_mode::spare;
use crate::session::variables::get_one;
use crate::values::integer;

/// Moves the robot by one step of a joint or along an axis, and prints where it rests then
///
/// It does what `bcap move` does, with the same question and limits: it takes the arm, switches the motor on, moves, switches the
/// motor off and gives the arm back. Ctrl-C halts the robot. The robot must rest before.
///
/// X, Y and Z are the axes of the work coordinates, along which the tool centre point moves in a line; RX, RY and RZ change
/// its angles around them. They are not the axes of the tool.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  bcap jog J1 +5
  bcap jog Z -10 --tool 1")]
pub(crate) struct Jog {
    /// J1 to J8, X, Y, Z, RX, RY or RZ
    #[arg(value_name = "AXIS")]
    pub(crate) axis: Axis,

    /// The step, in mm or degrees
    #[arg(value_name = "STEP", allow_negative_numbers = true)]
    pub(crate) by: f64,

    #[command(flatten)]
    pub(crate) how: MotionArgs,
}

/// Writes the present position of the robot to a variable, and prints the old and the new value
///
/// The position is of the selected tool and work coordinates, which are printed too. The robot must rest.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  bcap teach P5
  bcap teach P5 --joints J3")]
pub(crate) struct Teach {
    /// The variable of type P
    #[arg(value_name = "P", required_unless_present = "joints")]
    pub(crate) position: Option<String>,

    /// The variable of type J for the joints
    #[arg(long, value_name = "J")]
    pub(crate) joints: Option<String>,
}

/// A joint or a coordinate, with its place among the numbers of a position.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Axis {
    Joint(u8),
    Coordinate(usize),
}

const COORDINATES: [&str; 6] = ["X", "Y", "Z", "RX", "RY", "RZ"];

impl FromStr for Axis {
    type Err = String;

    fn from_str(name: &str) -> Result<Self, String> {
        let upper = name.to_ascii_uppercase();
        let joint =
            upper.strip_prefix('J').and_then(|number| number.parse().ok()).filter(|joint| (1..=8).contains(joint));
        let coordinate = COORDINATES.iter().position(|known| *known == upper).map(Self::Coordinate);
        joint.map(Self::Joint).or(coordinate).ok_or_else(|| "write J1 to J8, X, Y, Z, RX, RY or RZ".into())
    }
}

impl fmt::Display for Axis {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Joint(joint) => write!(f, "J{joint}"),
            Self::Coordinate(place) => f.write_str(COORDINATES.get(*place).unwrap_or(&"?")),
        }
    }
}

impl Axis {
    /// Returns the motion by a step. The arm must be taken, and the tool selected, so that the position is still true when the
    /// robot moves.
    pub(crate) fn motion(self, by: f64, session: &mut Session) -> Result<Move, Failure> {
        require_rest(session)?;
        match self {
            Self::Joint(joint) => Ok(Move::drive_by([(joint, by)])),
            Self::Coordinate(place) => {
                let mut numbers = session.with(|controller| controller.robot()?.position())?.to_array();
                numbers.iter_mut().skip(place).take(1).for_each(|number| *number += by);
                let to = Position::from_array(numbers);
                to.map(Move::line).ok_or_else(|| Failure::Input(format!("{self}: the position has no valid Fig")))
            }
        }
    }

    /// Reads where the robot is on this axis.
    fn read(self, session: &mut Session) -> Result<f64, Failure> {
        let numbers = session.with(|controller| match self {
            Self::Joint(_) => Ok(controller.robot()?.joints()?.degrees.to_vec()),
            Self::Coordinate(_) => Ok(controller.robot()?.position()?.to_array().to_vec()),
        })?;
        let place = match self {
            Self::Joint(joint) => usize::from(joint).saturating_sub(1),
            Self::Coordinate(place) => place,
        };
        Ok(numbers.get(place).copied().unwrap_or(f64::NAN))
    }
}

/// Fails unless the robot rests: a position on the way is not one to start from.
fn require_rest(session: &mut Session) -> Result<(), Failure> {
    if !session.with(|controller| controller.robot()?.read::<bool>("@BUSY_STATUS"))? {
        return Ok(());
    }
    Err(Failure::unfit("the robot moves", "wait until it rests, or halt it with `bcap halt`"))
}

/// Runs `bcap jog`.
pub(crate) fn jog(args: &Jog, session: &mut Session, json: bool) -> Result<(), Failure> {
    check_jog(args)?;
    let Jog { axis, by, how } = args;
    let args = MoveArgs {
        to: format!("the end of the step {axis} {by:+}"),
        line: matches!(axis, Axis::Coordinate(_)),
        wait: true,
        no_wait: false,
        how: how.clone(),
        step: Some((*axis, *by)),
    };
    if !motion::confirmed(&args, session)? {
        return Ok(());
    }
    let rests = axis.read(session)?;
    let object = json!({ "axis": axis.to_string(), "position": rests });
    Ok(print_result(json, &object, &format!("{axis} = {rests:.3}"))?)
}

/// Checks the arguments before the first call.
pub(crate) fn check_jog(args: &Jog) -> Result<(), Failure> {
    motion::check_speed(args.how.speed)?;
    if args.by.is_finite() && args.by != 0.0 {
        return Ok(());
    }
    Err(Failure::Input(format!("{}: write a step in mm or degrees, such as +5 or -0.1", args.by)))
}

/// Runs `bcap teach`.
pub(crate) fn teach(args: &Teach, session: &mut Session, json: bool) -> Result<(), Failure> {
    check_teach(args)?;
    spare(session, FunctionId::VARIABLE_PUT_VALUE, None)?;
    require_rest(session)?;
    let mut read =
        |name: &str| Ok::<_, Failure>(data::format(get_one(session, &ObjectPath::variable(name)?)?.as_variant()));
    let (tool, work) = (read("robot/@CURRENT_TOOL")?, read("robot/@CURRENT_WORK")?);
    for (name, source) in [(&args.position, "robot/@CURRENT_POSITION"), (&args.joints, "robot/@CURRENT_ANGLE")] {
        let Some(name) = name else { continue };
        let (path, mut now) = (ObjectPath::variable(name)?, get_one(session, &ObjectPath::variable(source)?)?);
        let before = get_one(session, &path)?;
        now = data::to_write(name, &data::format(now.as_variant()), before.as_variant()).map_err(Failure::Input)?;
        let variable = session.object(&path)?;
        session.call(name, FunctionId::VARIABLE_PUT_VALUE, &[integer(variable)?, now])?;
        let (before, now) = (data::format(before.as_variant()), data::format(get_one(session, &path)?.as_variant()));
        let object = json!({ "name": name, "old": before, "new": now, "tool": tool, "work": work });
        let line = format!("{name} = {now} (tool {tool}, work {work}); it was {before}");
        print_result(json, &object, &line)?;
    }
    Ok(())
}

/// Checks the arguments before the first call.
pub(crate) fn check_teach(args: &Teach) -> Result<(), Failure> {
    for (name, kind) in [(&args.position, VariableKind::P), (&args.joints, VariableKind::J)] {
        let Some(name) = name else { continue };
        if !name.parse::<Variable>().is_ok_and(|variable| variable.kind == kind) {
            let kind = kind.name();
            return Err(Failure::Input(format!("{name} is not a variable of type {kind}: write {kind}1, for example")));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_axis_is_a_joint_or_a_coordinate() {
        for (name, axis) in
            [("j1", Axis::Joint(1)), ("J8", Axis::Joint(8)), ("x", Axis::Coordinate(0)), ("RZ", Axis::Coordinate(5))]
        {
            assert_eq!(name.parse(), Ok(axis));
            assert_eq!(axis.to_string(), name.to_uppercase());
        }
        for name in ["J0", "J9", "J", "J01x", "W", "FIG", ""] {
            assert!(name.parse::<Axis>().is_err(), "{name}");
        }
    }
}
