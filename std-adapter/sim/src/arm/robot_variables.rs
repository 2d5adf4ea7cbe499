//! The system variables of the robot.

use bcap_core::hresult::HResult;
use bcap_core::variant::Variant;

use super::Arm;
use super::readings::{self, Reading};
use crate::answer::{Answer, Answered};
use crate::context::Context;
use crate::robot::{Percent, Settings, percent, tool, work};
use crate::rules;
use crate::table::Property;
use crate::value::{TRUTH, number, one_int, owned, truth};

type ArmSetter = fn(&mut Arm, &mut Context<'_>, &Variant<'_>) -> Answered;

const fn read(name: &'static str, get: Reading) -> Property<Reading, ArmSetter> {
    Property::read(name, get)
}

const TOOL: &str = "one number, 0 to 63";
const WORK: &str = "one number, 0 to 7";

/// The variables, in the order of Robot_GetVariableNames.
pub(crate) const VARIABLES: &[Property<Reading, ArmSetter>] = &[
    read("@CURRENT_POSITION", readings::current_position),
    read("@CURRENT_ANGLE", readings::current_angle),
    read("@CURRENT_TRANS", readings::current_trans),
    read("@HIGH_CURRENT_POSITION", readings::current_position),
    read("@HIGH_CURRENT_ANGLE", readings::current_angle),
    read("@HIGH_CURRENT_TRANS", readings::current_trans),
    read("@DEST_POSITION", readings::target_position),
    read("@DEST_ANGLE", readings::target_angle),
    read("@DEST_TRANS", readings::target_trans),
    read("@SERVO_ON", |arm, _| owned(arm.robot.motor_is_on())).and_write(put_servo_on, TRUTH),
    read("@BUSY_STATUS", |arm, _| owned(arm.robot.is_moving())),
    read("@TYPE_NAME", |_, ctx| owned(&ctx.config.robot_type)),
    read("@TYPE", |_, _| owned(0)),
    read("@CURRENT_TOOL", readings::tool).and_write(put_tool, TOOL),
    read("@CURRENT_WORK", readings::work).and_write(put_work, WORK),
    read("@SPEED", readings::speed)
        .and_write(|arm, ctx, value| put_internal(arm, ctx, value, |settings| &mut settings.line.speed), PERCENT),
    read("@ACCEL", readings::accel)
        .and_write(|arm, ctx, value| put_internal(arm, ctx, value, |settings| &mut settings.line.accel), PERCENT),
    read("@DECEL", readings::decel)
        .and_write(|arm, ctx, value| put_internal(arm, ctx, value, |settings| &mut settings.line.decel), PERCENT),
    read("@JSPEED", readings::joint_speed)
        .and_write(|arm, ctx, value| put_internal(arm, ctx, value, |settings| &mut settings.joint.speed), PERCENT),
    read("@JACCEL", readings::joint_accel)
        .and_write(|arm, ctx, value| put_internal(arm, ctx, value, |settings| &mut settings.joint.accel), PERCENT),
    read("@JDECEL", readings::joint_decel)
        .and_write(|arm, ctx, value| put_internal(arm, ctx, value, |settings| &mut settings.joint.decel), PERCENT),
    read("@EXTSPEED", readings::external_speed).and_write(put_external_speed, PERCENT),
    read("@EXTACCEL", readings::external_accel)
        .and_write(|arm, ctx, value| put_external(arm, ctx, value, |settings| &mut settings.external.accel), PERCENT),
    read("@EXTDECEL", readings::external_decel)
        .and_write(|arm, ctx, value| put_external(arm, ctx, value, |settings| &mut settings.external.decel), PERCENT),
];

const PERCENT: &str = "one number: percent, 0.0001 to 100";

/// Finds a percentage among the settings.
type Percentage = fn(&mut Settings) -> &mut f32;

/// Writing true answers when the motor is on, as `Motor` does without its NoWait.
fn put_servo_on(arm: &mut Arm, ctx: &mut Context<'_>, value: &Variant<'_>) -> Answered {
    let wait = ctx.config.servo_on_waits;
    arm.switch_motor(ctx, truth(value)?, wait)
}

fn put_tool(arm: &mut Arm, ctx: &mut Context<'_>, value: &Variant<'_>) -> Answered {
    arm.robot.may(ctx, &rules::SETTING)?;
    arm.robot.settings_mut().tool = tool(one_int(value)?)?;
    Ok(Answer::Done)
}

fn put_work(arm: &mut Arm, ctx: &mut Context<'_>, value: &Variant<'_>) -> Answered {
    arm.robot.may(ctx, &rules::SETTING)?;
    arm.robot.settings_mut().work = work(one_int(value)?)?;
    Ok(Answer::Done)
}

fn put_internal(arm: &mut Arm, ctx: &mut Context<'_>, value: &Variant<'_>, of: Percentage) -> Answered {
    arm.robot.may(ctx, &rules::SETTING)?;
    put_external(arm, ctx, value, of)
}

fn put_external(arm: &mut Arm, _: &mut Context<'_>, value: &Variant<'_>, of: Percentage) -> Answered {
    *of(arm.robot.settings_mut()) = percent(number(&value.flatten()).ok_or(HResult::E_INVALIDARGTYPE)?)?;
    Ok(Answer::Done)
}

fn put_external_speed(arm: &mut Arm, _: &mut Context<'_>, value: &Variant<'_>) -> Answered {
    let speed = percent(number(&value.flatten()).ok_or(HResult::E_INVALIDARGTYPE)?)?;
    arm.robot.settings_mut().external = Percent::of_speed(speed);
    Ok(Answer::Done)
}
