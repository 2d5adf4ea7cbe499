//! The readings of the arm, which commands and system variables answer.

use super::Arm;
use crate::context::Context;
use crate::kinematics::{measured, six};
use crate::value::{ValueResult, numbers_of_array, owned};

/// Reads a value of the arm.
pub(crate) type Reading = fn(&Arm, &Context<'_>) -> ValueResult;

pub(super) fn current_position(arm: &Arm, ctx: &Context<'_>) -> ValueResult {
    owned(arm.robot.coordinates().position(&arm.robot.joints(ctx.now)))
}

pub(super) fn current_angle(arm: &Arm, ctx: &Context<'_>) -> ValueResult {
    owned(measured(arm.robot.axes(ctx.now)))
}

pub(super) fn current_trans(arm: &Arm, ctx: &Context<'_>) -> ValueResult {
    owned(arm.robot.coordinates().trans(&arm.robot.joints(ctx.now)))
}

pub(super) fn timed_position(arm: &Arm, ctx: &Context<'_>) -> ValueResult {
    timed(ctx, current_position(arm, ctx))
}

pub(super) fn timed_angle(arm: &Arm, ctx: &Context<'_>) -> ValueResult {
    timed(ctx, current_angle(arm, ctx))
}

pub(super) fn timed_trans(arm: &Arm, ctx: &Context<'_>) -> ValueResult {
    timed(ctx, current_trans(arm, ctx))
}

pub(super) fn timed_target_position(arm: &Arm, ctx: &Context<'_>) -> ValueResult {
    timed(ctx, target_position(arm, ctx))
}

pub(super) fn timed_target_angle(arm: &Arm, ctx: &Context<'_>) -> ValueResult {
    timed(ctx, target_angle(arm, ctx))
}

pub(super) fn timed_target_trans(arm: &Arm, ctx: &Context<'_>) -> ValueResult {
    timed(ctx, target_trans(arm, ctx))
}

/// Puts the time in ms before a reading.
fn timed(ctx: &Context<'_>, reading: ValueResult) -> ValueResult {
    let millis = ctx.now.as_micros() as f64 / 1000.0;
    owned([vec![millis], numbers_of_array(&reading?.as_variant())?].concat())
}

pub(super) fn target_position(arm: &Arm, _: &Context<'_>) -> ValueResult {
    owned(arm.robot.coordinates().position(&six(&arm.robot.destination())))
}

pub(super) fn target_angle(arm: &Arm, _: &Context<'_>) -> ValueResult {
    owned(measured(arm.robot.destination()))
}

pub(super) fn target_trans(arm: &Arm, _: &Context<'_>) -> ValueResult {
    owned(arm.robot.coordinates().trans(&six(&arm.robot.destination())))
}

pub(super) fn figure_of(arm: &Arm, ctx: &Context<'_>) -> ValueResult {
    owned(i32::from(arm.robot.geometry().figure(&arm.robot.joints(ctx.now))))
}

pub(super) fn tool(arm: &Arm, _: &Context<'_>) -> ValueResult {
    owned(arm.robot.settings().tool)
}

pub(super) fn work(arm: &Arm, _: &Context<'_>) -> ValueResult {
    owned(arm.robot.settings().work)
}

pub(super) fn robot_type(_: &Arm, ctx: &Context<'_>) -> ValueResult {
    owned(&ctx.config.robot_type)
}

/// Defines the readings of speed, acceleration and deceleration.
macro_rules! percents {
    ($($name:ident $kind:ident $part:ident;)*) => {
        $(pub(super) fn $name(arm: &Arm, _: &Context<'_>) -> ValueResult {
            owned(arm.robot.settings().$kind.$part)
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
