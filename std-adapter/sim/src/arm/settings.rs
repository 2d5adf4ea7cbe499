//! The settings that this model checks and ignores: the arm follows its path exactly, and has no currents and no gravity.
//!
//! | command                                 | parameter                                                    |
//! |-----------------------------------------|--------------------------------------------------------------|
//! | CrtMotionAllow                          | \[on, mm, degrees\]: the precision of `@C`                   |
//! | EncMotionAllow                          | \[on, degrees or mm, mode\]: the precision of `@E`           |
//! | EncMotionAllowJnt                       | \[on, axis, degrees or mm, mode\]                            |
//! | ErAlw                                   | \[on, axis, degrees or mm\]: the allowed deviation           |
//! | GrvCtrl, GrvOffset, HighPathAccuracy    | on                                                           |
//! | CurLmt                                  | \[on, axis, 1 to 100 percent\]                               |
//! | Zforce                                  | the thrust                                                   |
//! | MotionTimeout                           | \[on, 1 to 30000 ms\]                                        |
//! | SingularAvoid                           | 0 or 2                                                       |
//! | StartServoLog, StopServoLog, ClearServoLog | -; there is no servo to record                            |
//!
//! "On" is 0 or another number; with 0 the values after it may be absent, but not the axis. The mode is 0 or 1.

use bcap_core::hresult::HResult;
use bcap_core::variant::Variant;

use super::Arm;
use crate::answer::{Answer, Answered};
use crate::context::Context;
use crate::rules;
use crate::value::numbers;

/// The largest number of an axis.
const LAST_AXIS: f64 = 8.0;

/// The largest precision or deviation.
const MOST: f64 = f64::MAX;

/// Executes CrtMotionAllow.
pub(super) fn crt_motion_allow(arm: &mut Arm, ctx: &mut Context<'_>, param: &Variant<'_>) -> Answered {
    check(arm, ctx, param, |given| matches!(given, [0.0, ..] | [_, 0.0..=MOST] | [_, 0.0..=MOST, 0.0..=MOST]))
}

/// Executes EncMotionAllow.
pub(super) fn enc_motion_allow(arm: &mut Arm, ctx: &mut Context<'_>, param: &Variant<'_>) -> Answered {
    check(arm, ctx, param, |given| matches!(given, [0.0, ..] | [_, 0.0..=MOST] | [_, 0.0..=MOST, 0.0 | 1.0]))
}

/// Executes EncMotionAllowJnt.
pub(super) fn enc_motion_allow_jnt(arm: &mut Arm, ctx: &mut Context<'_>, param: &Variant<'_>) -> Answered {
    check(arm, ctx, param, |given| {
        matches!(
            given,
            [0.0, 1.0..=LAST_AXIS, ..] | [_, 1.0..=LAST_AXIS, 0.0..=MOST] | [_, 1.0..=LAST_AXIS, 0.0..=MOST, 0.0 | 1.0]
        )
    })
}

/// Executes ErAlw.
pub(super) fn er_alw(arm: &mut Arm, ctx: &mut Context<'_>, param: &Variant<'_>) -> Answered {
    check(arm, ctx, param, |given| matches!(given, [0.0, 0.0..=LAST_AXIS, ..] | [_, 1.0..=LAST_AXIS, 0.0..=MOST]))
}

/// Executes CurLmt.
pub(super) fn cur_lmt(arm: &mut Arm, ctx: &mut Context<'_>, param: &Variant<'_>) -> Answered {
    check(arm, ctx, param, |given| matches!(given, [0.0, 0.0..=LAST_AXIS, ..] | [_, 1.0..=LAST_AXIS, 1.0..=100.0]))
}

/// Executes Zforce.
pub(super) fn zforce(arm: &mut Arm, ctx: &mut Context<'_>, param: &Variant<'_>) -> Answered {
    check(arm, ctx, param, |given| given.len() == 1)
}

/// Executes MotionTimeout.
pub(super) fn motion_timeout(arm: &mut Arm, ctx: &mut Context<'_>, param: &Variant<'_>) -> Answered {
    check(arm, ctx, param, |given| matches!(given, [0.0, ..] | [_, 1.0..=30_000.0]))
}

/// Executes SingularAvoid.
pub(super) fn singular_avoid(arm: &mut Arm, ctx: &mut Context<'_>, param: &Variant<'_>) -> Answered {
    check(arm, ctx, param, |given| matches!(given, [0.0 | 2.0]))
}

/// Executes GrvCtrl, GrvOffset, HighPathAccuracy.
pub(super) fn switch(arm: &mut Arm, ctx: &mut Context<'_>, param: &Variant<'_>) -> Answered {
    check(arm, ctx, param, |given| given.len() == 1)
}

fn check(arm: &mut Arm, ctx: &mut Context<'_>, param: &Variant<'_>, is_valid: fn(&[f64]) -> bool) -> Answered {
    if !is_valid(&numbers(param)?) {
        return Err(HResult::E_INVALIDARG);
    }
    arm.robot.may(ctx, &rules::SETTING)?;
    Ok(Answer::Done)
}
