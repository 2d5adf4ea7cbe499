//! `bcap jog` and `bcap teach`: moves the robot by steps, and stores where it is.

use std::path::PathBuf;

use bcap_capture::value::data;
use bcap_core::bcap::FunctionId;
use bcap_core::rac::{Variable, VariableKind};
use bcap_core::variant::OwnedVariant as Value;
use bcap_live::axis::Axis;
use bcap_std::ObjectPath;
use clap::Args;
use serde_json::json;

use crate::commands::robot::axis::{self, require_rest};
#[cfg(feature = "screens")]
use crate::commands::robot::keys::by_keys;
use crate::commands::robot::motion::{self, MotionArgs};
use crate::commands::variables::labels;
use crate::failure::Failure;
use crate::output::print_result;
use crate::session::Session;
use crate::session::variables::get_one;
use bcap_live::stream::spare;

/// Moves the robot by one step of a joint or along an axis, and prints where it rests then; without AXIS by the keys of a screen
///
/// It does what `bcap move` does, with the same question and limits: it takes the arm, switches the motor on, moves, switches the
/// motor off and gives the arm back. Ctrl-C halts the robot. The robot must rest before.
///
/// On the screen Up and Down select the axis, Left and Right move it by a step, [ and ] change the step: 0.1, 1, 5 or 10. A step
/// repeats while its key repeats. Keys that arrive during a step are dropped, so that no motion follows a released key. Esc, Space,
/// h, q and Ctrl-C halt the robot and end the command.
///
/// X, Y and Z are the axes of the work coordinates, along which the tool centre point moves in a line; RX, RY and RZ change
/// its angles around them. They are not the axes of the tool.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  bcap jog
  bcap jog J1 +5
  bcap jog Z -10 --tool 1")]
pub(crate) struct Jog {
    /// J1 to J8, X, Y, Z, RX, RY or RZ
    #[arg(value_name = "AXIS", requires = "by")]
    pub(crate) axis: Option<Axis>,

    /// The step, in mm or degrees
    #[arg(value_name = "STEP", allow_negative_numbers = true)]
    pub(crate) by: Option<f64>,

    #[command(flatten)]
    pub(crate) how: MotionArgs,
}

/// Writes the current position of the robot to a variable, and prints the old and the new value
///
/// The position is of the selected tool and work coordinates, which are printed too. The robot must rest.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  bcap teach P5
  bcap teach P5 --joints J3 --label 'above the tray' --labels cell1.labels")]
pub(crate) struct Teach {
    /// The variable of type P
    #[arg(value_name = "P", required_unless_present = "joints")]
    pub(crate) position: Option<String>,

    /// The variable of type J for the joints
    #[arg(long, value_name = "J")]
    pub(crate) joints: Option<String>,

    /// The label of the position, for the file of labels
    #[arg(long, value_name = "TEXT", requires = "labels")]
    pub(crate) label: Option<String>,

    /// The file of labels, as for `bcap io`; it is made if it does not exist
    #[arg(long, value_name = "FILE", requires = "label")]
    pub(crate) labels: Option<PathBuf>,
}

/// Runs `bcap jog`.
pub(crate) fn jog(args: &Jog, session: &mut Session, json: bool) -> Result<(), Failure> {
    check_jog(args)?;
    let Some((axis, by)) = args.axis.zip(args.by) else { return by_keys(&args.how, session, json) };
    if !motion::confirmed(&motion::step(axis, by, &args.how), session)? {
        return Ok(());
    }
    let rests = axis::read(axis, session)?;
    let object = json!({ "axis": axis.to_string(), "position": rests });
    Ok(print_result(json, &object, &format!("{axis} = {rests:.3}"))?)
}

#[cfg(not(feature = "screens"))]
fn by_keys(_: &MotionArgs, _: &mut Session, _: bool) -> Result<(), Failure> {
    Err(Failure::Input("this program has no screens; write an axis and a step, such as J1 +5".into()))
}

/// Checks the arguments before the first call.
pub(crate) fn check_jog(args: &Jog) -> Result<(), Failure> {
    motion::check_speed(args.how.speed)?;
    match args.by {
        Some(by) if !by.is_finite() || by == 0.0 => {
            Err(Failure::Input(format!("{by}: write a step in mm or degrees, such as +5 or -0.1")))
        }
        _ => Ok(()),
    }
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
        session.call(name, FunctionId::VARIABLE_PUT_VALUE, &[Value::new(&variable)?, now])?;
        let (before, now) = (data::format(before.as_variant()), data::format(get_one(session, &path)?.as_variant()));
        let object =
            json!({ "name": name, "old": before, "new": now, "tool": tool, "work": work, "label": args.label });
        let line = format!("{name} = {now} (tool {tool}, work {work}); it was {before}");
        print_result(json, &object, &line)?;
        if let Some((label, file)) = args.label.as_ref().zip(args.labels.as_ref()) {
            labels::write(file, &name.to_uppercase(), label)?;
        }
    }
    Ok(())
}

/// Checks the arguments before the first call.
pub(crate) fn check_teach(args: &Teach) -> Result<(), Failure> {
    if args.label.as_ref().is_some_and(|label| label.contains('\n')) {
        return Err(Failure::Input("write the label as one line".into()));
    }
    // a file that cannot be used is found before the position is written
    if let Some(file) = args.labels.as_ref().filter(|file| file.exists()) {
        labels::read(file)?;
    }
    for (name, kind) in [(&args.position, VariableKind::P), (&args.joints, VariableKind::J)] {
        let Some(name) = name else { continue };
        if !name.parse::<Variable>().is_ok_and(|variable| variable.kind == kind) {
            let kind = kind.name();
            return Err(Failure::Input(format!("{name} is not a variable of type {kind}: write {kind}1, for example")));
        }
    }
    Ok(())
}
