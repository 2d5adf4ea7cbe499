//! The readings of the arm, which commands and system variables answer.

use super::Arm;
use crate::context::Context;
use crate::kinematics::{measured, six};
use crate::value::Value;

/// Reads a value of the arm.
pub(crate) type Reading = fn(&Arm, &Context<'_>) -> Value;

pub(super) fn current_position(arm: &Arm, ctx: &Context<'_>) -> Value {
    Value::R8s(arm.robot.coordinates().position(&arm.robot.joints(ctx.now)))
}

pub(super) fn current_angle(arm: &Arm, ctx: &Context<'_>) -> Value {
    Value::R8s(measured(arm.robot.axes(ctx.now)))
}

pub(super) fn current_trans(arm: &Arm, ctx: &Context<'_>) -> Value {
    Value::R8s(arm.robot.coordinates().trans(&arm.robot.joints(ctx.now)))
}

pub(super) fn timed_position(arm: &Arm, ctx: &Context<'_>) -> Value {
    timed(ctx, current_position(arm, ctx))
}

pub(super) fn timed_angle(arm: &Arm, ctx: &Context<'_>) -> Value {
    timed(ctx, current_angle(arm, ctx))
}

pub(super) fn timed_trans(arm: &Arm, ctx: &Context<'_>) -> Value {
    timed(ctx, current_trans(arm, ctx))
}

pub(super) fn timed_target_position(arm: &Arm, ctx: &Context<'_>) -> Value {
    timed(ctx, target_position(arm, ctx))
}

pub(super) fn timed_target_angle(arm: &Arm, ctx: &Context<'_>) -> Value {
    timed(ctx, target_angle(arm, ctx))
}

pub(super) fn timed_target_trans(arm: &Arm, ctx: &Context<'_>) -> Value {
    timed(ctx, target_trans(arm, ctx))
}

/// Puts the time in ms before a reading.
fn timed(ctx: &Context<'_>, reading: Value) -> Value {
    let millis = ctx.now.as_micros() as f64 / 1000.0;
    match reading {
        Value::R8s(numbers) => Value::R8s([vec![millis], numbers].concat()),
        other => other,
    }
}

pub(super) fn target_position(arm: &Arm, _: &Context<'_>) -> Value {
    Value::R8s(arm.robot.coordinates().position(&six(&arm.robot.destination())))
}

pub(super) fn target_angle(arm: &Arm, _: &Context<'_>) -> Value {
    Value::R8s(measured(arm.robot.destination()))
}

pub(super) fn target_trans(arm: &Arm, _: &Context<'_>) -> Value {
    Value::R8s(arm.robot.coordinates().trans(&six(&arm.robot.destination())))
}

pub(super) fn figure_of(arm: &Arm, ctx: &Context<'_>) -> Value {
    Value::I4(arm.robot.geometry().figure(&arm.robot.joints(ctx.now)).into())
}

pub(super) fn tool(arm: &Arm, _: &Context<'_>) -> Value {
    Value::I4(arm.robot.settings().tool)
}

pub(super) fn work(arm: &Arm, _: &Context<'_>) -> Value {
    Value::I4(arm.robot.settings().work)
}

pub(super) fn robot_type(_: &Arm, ctx: &Context<'_>) -> Value {
    Value::from(ctx.config.robot_type.as_str())
}

/// Defines the readings of speed, acceleration and deceleration.
macro_rules! percents {
    ($($name:ident $kind:ident $part:ident;)*) => {
        $(pub(super) fn $name(arm: &Arm, _: &Context<'_>) -> Value {
            Value::R4(arm.robot.settings().$kind.$part)
        })*
    };
}

percents! {
    speed line speed;
    accel line accel;
    decel line decel;
    joint_speed joint speed;
    joint_accel joint accel;
    joint_decel joint decel;
    external_speed external speed;
    external_accel external accel;
    external_decel external decel;
}
