//! The commands of Robot_Execute: one table of names, parameters and handlers.

use bcap_core::hresult::HResult;
use bcap_core::rac::VariableKind as Kind;
use bcap_core::variant::Variant;

use super::poses::FrameKind;
use super::readings::{self, Reading};
use super::{Arm, area_commands, measures, moves, path_point_commands, poses, settings};
use crate::answer::{Answer, Answered};
use crate::codes::{OTHER_GROUP, UNDEFINED_GROUP, WRONG_KEEP};
use crate::context::Context;
use crate::model::Functions;
use crate::path::Blocked;
use crate::robot::{Percent, percent};
use crate::rules;
use crate::slave;
use crate::table::Command;
use crate::value::{numbers, one_int, owned, whole};
use crate::waits::Wait;

/// Executes a command.
type Execute = fn(&mut Arm, &mut Context<'_>, &Variant<'_>) -> Answered;

/// The handler of a command.
#[derive(Clone, Copy, Debug)]
pub(crate) enum RobotHandler {
    Read(Reading),
    Execute(Execute),
}

const fn read(name: &'static str, reading: Reading) -> Command<RobotHandler> {
    Command::new(name, RobotHandler::Read(reading))
}

const fn command(name: &'static str, execute: Execute) -> Command<RobotHandler> {
    Command::new(name, RobotHandler::Execute(execute))
}

const DRIVE: &str = "pairs or [pairs, option]: pairs are \"@E (axis, value), ...\" or [[axis, value], ...], with axes \
                     1 to 6, and 7 and 8 where the arm has them; option as for Robot_Move";
const APPROACH: &str = "[interpolation, pose, length] or [..., option]: interpolation 1 or 2; length in mm: a number, \
                        \"@P 30\", or [30, \"\", \"@P\"]";
const DEPART: &str = "[interpolation, length] or [..., option]: interpolation 1 or 2; length in mm: a number, \"@P 30\", or \
                      [30, \"\", \"@P\"]";
const DEVIATION: &str = "[pose, offset]: two poses in any form, the offset a P or a T";
const TOOL: &str = "one number, 0 to 63";
const WORK: &str = "one number, 0 to 7";
const DEFINE: &str = "[number, pose]: 1 to 63; a P in any form, or its 6 numbers";
const DEFINE_WORK: &str =
    "[number, pose] or [number, pose, attribute]: 1 to 7; a P in any form; attribute 0, or 1 fixed tool";
const SWITCH: &str = "one number: 0 off, otherwise on";
const AREA: &str = "one number, 0 to 31";
const PATH: &str = "one number, 1 to 20";
const JOINTS: &str = "6 to 8 numbers in degrees, \"J(...)\", \"J1\" or [numbers, \"J\"]";
const POSITION: &str = "6 or 7 numbers (X Y Z RX RY RZ Fig), \"P(...)\", \"P1\" or [numbers, \"P\"]";
const TRANS: &str = "9 or 10 numbers (position, orient, approach, Fig), \"T(...)\", \"T1\" or [numbers, \"T\"]";

const fn has_preparation(functions: Functions) -> bool {
    functions.preparation
}

/// The commands.
pub(crate) const COMMANDS: &[Command<RobotHandler>] = &[
    read("CurPos", readings::current_position),
    read("HighCurPos", readings::current_position),
    read("CurJnt", readings::current_angle),
    read("HighCurJnt", readings::current_angle),
    read("CurTrn", readings::current_trans),
    read("HighCurTrn", readings::current_trans),
    read("CurPosEx", readings::timed_position),
    read("HighCurPosEx", readings::timed_position),
    read("CurJntEx", readings::timed_angle),
    read("HighCurJntEx", readings::timed_angle),
    read("CurTrnEx", readings::timed_trans),
    read("HighCurTrnEx", readings::timed_trans),
    read("DestPos", readings::target_position),
    read("DestJnt", readings::target_angle),
    read("DestTrn", readings::target_trans),
    read("DestPosEx", readings::timed_target_position),
    read("DestJntEx", readings::timed_target_angle),
    read("DestTrnEx", readings::timed_target_trans),
    read("CurSpd", readings::speed),
    read("CurAcc", readings::accel),
    read("CurDec", readings::decel),
    read("CurJSpd", readings::joint_speed),
    read("CurJAcc", readings::joint_accel),
    read("CurJDec", readings::joint_decel),
    read("CurExtSpd", readings::external_speed),
    read("CurExtAcc", readings::external_accel),
    read("CurExtDec", readings::external_decel),
    read("CurFig", readings::figure_of),
    read("CurTool", readings::tool),
    read("CurWork", readings::work),
    read("GetRobotTypeName", readings::robot_type),
    command("RobInfo", robot_info).accepts("one number: 0 the number of the type, 1 the type, 2 the distances of the axes"),
    command("J2P", |arm, ctx, param| poses::convert(arm, ctx, Kind::J, Kind::P, param)).accepts(JOINTS),
    command("J2T", |arm, ctx, param| poses::convert(arm, ctx, Kind::J, Kind::T, param)).accepts(JOINTS),
    command("P2J", |arm, ctx, param| poses::convert(arm, ctx, Kind::P, Kind::J, param)).accepts(POSITION),
    command("P2T", |arm, ctx, param| poses::convert(arm, ctx, Kind::P, Kind::T, param)).accepts(POSITION),
    command("T2J", |arm, ctx, param| poses::convert(arm, ctx, Kind::T, Kind::J, param)).accepts(TRANS),
    command("T2P", |arm, ctx, param| poses::convert(arm, ctx, Kind::T, Kind::P, param)).accepts(TRANS),
    command("Dev", |arm, ctx, param| poses::deviation(arm, ctx, param, false)).accepts(DEVIATION),
    command("DevH", |arm, ctx, param| poses::deviation(arm, ctx, param, true)).accepts(DEVIATION),
    command("TMul", poses::product).accepts("[T, T]: two transforms in any form"),
    command("TInv", poses::inverse).accepts(TRANS),
    command("TNorm", poses::normalised).accepts(TRANS),
    command("MPS", measures::line_percent).accepts("one number: mm per second"),
    command("RPM", measures::axis_percent).accepts("[axis, revolutions per minute]: axis 1 to 8"),
    command("DPS", measures::turn_percent).accepts("degrees per second, or [axis, degrees per second]: axis 1 to 8"),
    command("OutRange", poses::out_range)
        .accepts("a pose, or [pose, tool, work]: the pose as text or with its type, tool -1 to 63, work -1 to 7"),
    command("GetToolDef", |arm, _, param| poses::definition(arm, FrameKind::Tool, param)).accepts(TOOL),
    command("GetWorkDef", |arm, _, param| poses::definition(arm, FrameKind::Work, param)).accepts(WORK),
    command("SetToolDef", |arm, ctx, param| poses::define(arm, ctx, FrameKind::Tool, param)).accepts(DEFINE),
    command("SetWorkDef", |arm, ctx, param| poses::define(arm, ctx, FrameKind::Work, param)).accepts(DEFINE_WORK),
    command("WorkAttribute", poses::attribute).accepts(WORK),
    command("GetBaseDef", |arm, _, param| poses::definition(arm, FrameKind::Base, param)).accepts(WORK),
    command("SetBaseDef", |arm, ctx, param| poses::define(arm, ctx, FrameKind::Base, param)).accepts(DEFINE_WORK),
    command("GetAreaDef", area_commands::definition).accepts(AREA),
    command("SetAreaDef", area_commands::define).accepts(
        "[area, P, V, IO, variable, detection] or [area, numbers]: area 0 to 31; 11 to 34 numbers",
    ),
    command("AreaSize", area_commands::size).accepts(AREA),
    command("GetAreaEnabled", area_commands::is_enabled).accepts(AREA),
    command("SetAreaEnabled", |arm, ctx, param| area_commands::enable(arm, ctx, None, param))
        .accepts("[area, enabled]: area 0 to 31, BOOL"),
    command("SetArea", |arm, ctx, param| area_commands::enable(arm, ctx, Some(true), param)).accepts(AREA),
    command("ResetArea", |arm, ctx, param| area_commands::enable(arm, ctx, Some(false), param)).accepts(AREA),
    command("AddPathPoint", path_point_commands::add).accepts("[path, pose]: path 1 to 20"),
    command("ClrPathPoint", path_point_commands::clear).accepts(PATH),
    command("LoadPathPoint", path_point_commands::clear).accepts(PATH),
    command("GetPathPoint", path_point_commands::point).accepts("[path, point]: path 1 to 20, point from 1"),
    command("GetPathPointCount", path_point_commands::count).accepts(PATH),
    command("CrtMotionAllow", settings::crt_motion_allow).accepts("[on, mm] or [on, mm, degrees]; 0 alone is off"),
    command("EncMotionAllow", settings::enc_motion_allow).accepts("[on, value] or [on, value, mode]: mode 0 degrees or mm, 1 pulses; 0 alone is off"),
    command("EncMotionAllowJnt", settings::enc_motion_allow_jnt).accepts("[on, axis, value] or [on, axis, value, mode]: axis 1 to 8; [0, axis] is off"),
    command("ErAlw", settings::er_alw).accepts("[on, axis, value]: axis 1 to 8; [0, axis] is off, with the axis 0 for all"),
    command("GrvCtrl", settings::switch).accepts(SWITCH),
    command("GrvOffset", settings::switch).accepts(SWITCH),
    command("HighPathAccuracy", settings::switch).accepts(SWITCH),
    command("CurLmt", settings::cur_lmt).accepts("[on, axis, percent]: axis 1 to 8, 1 to 100 percent; [0, axis] is off, with the axis 0 for all"),
    command("Zforce", settings::zforce).accepts("one number"),
    command("MotionTimeout", settings::motion_timeout).accepts("[on, timeout]: 1 to 30000 ms; 0 alone is off"),
    command("SingularAvoid", settings::singular_avoid).accepts("one number: 0 off, 2 on"),
    command("StartServoLog", |_, _, _| Ok(Answer::Done)),
    command("StopServoLog", |_, _, _| Ok(Answer::Done)),
    command("ClearServoLog", |_, _, _| Ok(Answer::Done)),
    command("SetHandIO", measures::set_hand_io).accepts("[first, value, count]: an IO, and 1 to 32 of them"),
    command("GetHandIO", measures::hand_io).accepts("[first, count]: an IO, and 1 to 32 of them"),
    command("TakeArm", take_arm).accepts("nothing, the group, or [group, keep]: group 0 to 31, keep 0 or 1"),
    command("GiveArm", give_arm).resumes(RobotHandler::Execute(give_arm)),
    command("TakeArmState", arm_state).accepts("nothing, or one number: a group, or -1 for any"),
    command("Motor", motor).accepts(MOTOR),
    command("ExtSpeed", external_speed)
        .accepts("a speed, [speed, accel] or [speed, accel, decel], in percent, 0.0001 to 100; accel, decel -1 or -2"),
    command("DriveEx", |arm, ctx, param| moves::drive_command(&mut arm.robot, ctx, false, param)).accepts(DRIVE),
    command("DriveAEx", |arm, ctx, param| moves::drive_command(&mut arm.robot, ctx, true, param)).accepts(DRIVE),
    command("Approach", |arm, ctx, param| moves::approach(&mut arm.robot, ctx, param))
        .accepts(APPROACH),
    command("Depart", |arm, ctx, param| moves::depart(&mut arm.robot, ctx, param))
        .accepts(DEPART),
    command("RotateH", |arm, ctx, param| moves::rotate_tool(&mut arm.robot, ctx, param))
        .accepts("an angle of -180 to 180 degrees, perhaps with a pass (\"@P 30\"), or [angle, motion option]"),
    command("Draw", |arm, ctx, param| moves::draw(&mut arm.robot, ctx, param)).accepts(
        "[interpolation, vector] or [..., option]: interpolation 1 or 2; \"@P V(x,y,z)\", \"V1\" or [[x,y,z], \"V\", \"@P\"]",
    ),
    command("ArchMove", |arm, ctx, param| moves::arch(&mut arm.robot, ctx, param))
        .accepts("[pose, height], [..., rise] or [..., rise, fall]: in mm, rise and fall at most the height"),
    command("Arrive", |arm, ctx, param| moves::arrive(&mut arm.robot, ctx, param))
        .accepts("one number: percent of the motion under way, above 0 to 100"),
    command("MotionSkip", motion_skip).accepts("nothing, the group, or [group, mode]: group -1 to 31, mode 0 to 3"),
    command("MotionComplete", motion_complete)
        .accepts("nothing, the group, or [group, mode]: group -1 to 31, mode 0 (commands) or 1 (motion)"),
    command("slvChangeMode", |arm, ctx, param| slave::change_mode(&mut arm.robot, ctx, param))
        .accepts("one number: 0, 0x001 to 0x003, 0x101 to 0x103, 0x201 to 0x203"),
    read("slvGetMode", |arm, _| owned(slave::mode(&arm.robot))),
    command("slvMove", |arm, ctx, param| arm.slave.do_move(&mut arm.robot, ctx, param))
        .resumes(RobotHandler::Execute(|arm, ctx, param| arm.slave.stored(&arm.robot, ctx, param)))
        .accepts(
            "an array of 7 (P), 8 (J) or 10 (T) numbers by the mode, with an option element and J7, J8 where the arm has \
             them; with IO: [pose, MiniIO, user IO offset, size, bytes, offset, size, HandIO] by the formats",
        ),
    command("slvSendFormat", |arm, ctx, param| arm.slave.send_format(ctx, param))
        .accepts("one number: 0, 0x20, 0x100, 0x120, 0x200 or 0x220, of the parts that the controller has"),
    command("slvRecvFormat", |arm, ctx, param| arm.slave.receive_format(ctx, param)).accepts(
        "format or [format, unit]: the pose 1 to 5, plus 0x10, 0x20, 0x40, 0x100, 0x200; unit 0 or 1",
    ),
    command("ManualResetPreparation", |arm, ctx, _| arm.preparation.prepare_reset(ctx.config))
    .of(has_preparation),
    command("MotionPreparation", |arm, ctx, _| arm.preparation.prepare_motion(ctx)).of(has_preparation),
    read("GetMotionPreparationState", |arm, _| owned(arm.preparation.is_motion_ready()))
        .of(has_preparation),
    command("AutoCal", |arm, ctx, _| arm.preparation.calibrate(ctx)).of(has_preparation),
    command("ClearLog", |arm, ctx, _| {
        arm.trace.clear(ctx.now);
        Ok(Answer::Done)
    }),
    command("StartLog", |arm, _, _| arm.trace.start().map(|()| Answer::Done)),
    command("StopLog", |arm, _, _| arm.trace.stop().map(|()| Answer::Done)),
    read("GetCtrlLogMaxTime", |arm, _| owned(arm.trace.length())),
    command("SetCtrlLogMaxTime", |arm, _, param| arm.trace.set_length(one_int(param)?).map(|()| Answer::Done))
        .accepts("one number: 10 to 240 s"),
    read("GetCtrlLogInterval", |arm, _| owned(arm.trace.interval())),
    command("SetCtrlLogInterval", |arm, _, param| arm.trace.set_interval(one_int(param)?).map(|()| Answer::Done))
        .accepts("one number: 8 to 32 ms"),
    read("GetLogCount", |arm, _| owned(i32::try_from(arm.trace.len()).unwrap_or(i32::MAX))),
    command("GetLogRecord", |arm, _, param| measures::log_record(arm, param))
        .accepts("one number: the index, from 0 to below GetLogCount"),
    command("GetAllSrvData", measures::all_servo_data),
    command("GetSrvData", measures::servo_data)
        .accepts("one number: 1 speeds, 2, 4, 5, 7 zero, 8 positions, 17 and 18 speeds of the tool centre point, 19, 20 zero"),
    command("GetSrvJntData", measures::axis_data).accepts("[number, axis]: 1, 2, 4, 5 or 8, axis 1 to 8"),
    command("PayLoad", measures::payload)
        .accepts("[mass, centre, inertia]: g, and two arrays of 3 numbers or \"V(x,y,z)\", the last of which may be absent"),
    command("SpeedMode", measures::speed_mode).accepts("one number, 0 to 3"),
    command("ConvertPosWork", poses::convert_work)
        .accepts("[pose, from] or [pose, from, to]: a pose, and two numbers of work coordinates, 0 to 7"),
    command("CheckVirtualFence", poses::check_fence).accepts("a pose in any form"),
    Command::missing("ForceSensor"),
    Command::missing("ForceValue"),
    Command::missing("ForceCtrl"),
    Command::missing("ForceParam"),
    Command::missing("SyncTimeStart"),
    Command::missing("SyncTimeEnd"),
    Command::missing("SyncMoveStart"),
    Command::missing("SyncMoveEnd"),
    Command::missing("ForceWaitCondition"),
    Command::missing("ForceChangeTable"),
    Command::missing("GenerateNonStopPath"),
    Command::missing("CurScene"),
    Command::missing("CurSubScene"),
    Command::missing("SceneInfo"),
];

/// The parameter of Motor.
pub(crate) const MOTOR: &str = "one number or BOOL: 0 off, otherwise on; or [state, no wait]";

fn take_arm(arm: &mut Arm, ctx: &mut Context<'_>, param: &Variant<'_>) -> Answered {
    let (group, keep) = match numbers(param)?.as_slice() {
        [] => (0, 0),
        [group] => (whole(*group)?, 0),
        [group, keep] => (whole(*group)?, whole(*keep)?),
        _ => return Err(HResult::E_INVALIDARG),
    };
    // the groups differ in extended joints, which this model always moves
    if !(0..=31).contains(&group) {
        return Err(UNDEFINED_GROUP);
    }
    // -1 is TRUE
    if ![-1, 0, 1].contains(&keep) {
        return Err(WRONG_KEEP);
    }
    arm.robot.may(ctx, &rules::TAKE_ARM)?;
    if arm.robot.group_of(ctx.peer).is_some_and(|own| own != group) {
        return Err(OTHER_GROUP);
    }
    arm.robot.set_owner(Some((ctx.peer, group)));
    ctx.record("arm taken");
    if keep == 0 {
        arm.robot.reset_settings();
    }
    Ok(Answer::Done)
}

fn give_arm(arm: &mut Arm, ctx: &mut Context<'_>, _: &Variant<'_>) -> Answered {
    if arm.robot.owner() != Some(ctx.peer) {
        return Ok(Answer::Code(HResult::S_FALSE));
    }
    if arm.robot.is_moving() {
        return Ok(Answer::Until(Wait::Rest));
    }
    arm.robot.set_owner(None);
    ctx.record("arm given back");
    Ok(Answer::Done)
}

fn arm_state(arm: &mut Arm, ctx: &mut Context<'_>, param: &Variant<'_>) -> Answered {
    let wanted = if param.is_empty() { -1 } else { one_int(param)? };
    let is_owner = arm.robot.group_of(ctx.peer).is_some_and(|group| [-1, group].contains(&wanted));
    Answer::of(i32::from(is_owner))
}

/// Reads `[group, mode]`. Both, or only the mode, may be absent.
fn group_and_mode(param: &Variant<'_>, most: i32) -> Result<i32, HResult> {
    let (group, mode) = match numbers(param)?.as_slice() {
        [] => (-1, 0),
        [group] => (whole(*group)?, 0),
        [group, mode] => (whole(*group)?, whole(*mode)?),
        _ => return Err(HResult::E_INVALIDARG),
    };
    if (-1..=31).contains(&group) && (0..=most).contains(&mode) { Ok(mode) } else { Err(HResult::E_INVALIDARG) }
}

fn motion_skip(arm: &mut Arm, ctx: &mut Context<'_>, param: &Variant<'_>) -> Answered {
    // 2 and 3 brake at the deceleration of the motion
    let gently = group_and_mode(param, 3)? >= 2;
    arm.robot.may(ctx, &rules::SETTING)?;
    let skipped = arm.robot.skip_motion(gently, ctx.now, ctx.waits);
    Ok(Answer::done_if(skipped.map_err(Blocked::code)?))
}

fn motion_complete(arm: &mut Arm, ctx: &mut Context<'_>, param: &Variant<'_>) -> Answered {
    Answer::of(match group_and_mode(param, 1)? {
        0 => arm.robot.commands_are_complete(ctx.now),
        _ => !arm.robot.is_moving(),
    })
}

/// Executes Motor, a command of both the robot and the controller.
pub(crate) fn motor(arm: &mut Arm, ctx: &mut Context<'_>, param: &Variant<'_>) -> Answered {
    let (state, no_wait) = match numbers(param)?.as_slice() {
        [state] => (whole(*state)?, 0),
        [state, no_wait] => (whole(*state)?, whole(*no_wait)?),
        _ => return Err(HResult::E_INVALIDARG),
    };
    arm.switch_motor(ctx, state != 0, no_wait == 0)
}

fn robot_info(arm: &mut Arm, ctx: &mut Context<'_>, param: &Variant<'_>) -> Answered {
    match one_int(param)? {
        0 => Answer::of(0),
        1 => readings::robot_type(arm, ctx).map(Answer::Value),
        // a new arm: the distances since delivery are not counted
        2 => Answer::of([0.0; 8]),
        _ => Err(HResult::E_INVALIDARG),
    }
}

fn external_speed(arm: &mut Arm, _: &mut Context<'_>, param: &Variant<'_>) -> Answered {
    let given = numbers(param)?;
    let [speed, rest @ ..] = given.as_slice() else { return Err(HResult::E_INVALIDARG) };
    let square = Percent::of_speed(percent(*speed)?);
    let present = arm.robot.settings().external;
    // -1 keeps the value, -2 derives it from the speed
    let chosen = |given: f64, present: f32, derived: f32| match given {
        -1.0 => Ok(present),
        -2.0 => Ok(derived),
        value => percent(value),
    };
    let mut external = square;
    if let [accel, ..] = rest {
        external.accel = chosen(*accel, present.accel, square.accel)?;
    }
    match rest {
        [] | [_] => {}
        [_, decel] => external.decel = chosen(*decel, present.decel, square.decel)?,
        _ => return Err(HResult::E_INVALIDARG),
    }
    arm.robot.settings_mut().external = external;
    Ok(Answer::Done)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::table::assert_documented;

    #[test]
    fn every_command_is_documented() {
        let sources = [
            include_str!("../arm.rs"),
            include_str!("area_commands.rs"),
            include_str!("path_point_commands.rs"),
            include_str!("settings.rs"),
            include_str!("../slave.rs"),
            include_str!("../preparation.rs"),
        ];
        assert_documented(COMMANDS, &sources);
    }
}
