//! The areas: their definitions, as numbers.
//!
//! | command                        | parameter                                          | answer                       |
//! |--------------------------------|----------------------------------------------------|------------------------------|
//! | GetAreaDef                     | I4, 0 to 31                                        | R8\[34\]                     |
//! | SetAreaDef                     | \[area, P, V, IO, variable, detection\]            | EMPTY                        |
//! |                                | \[area, numbers\]: the first 11 to 34              | likewise                     |
//! | AreaSize                       | I4                                                 | R8\[3\]: the sides in mm     |
//! | GetAreaEnabled, SetAreaEnabled | I4; \[area, BOOL\]                                 | BOOL; EMPTY                  |
//! | SetArea, ResetArea             | I4                                                 | EMPTY; as SetAreaEnabled     |
//!
//! ```text
//! X Y Z RX RY RZ DX DY DZ IO Position Error Time DRX DRY DRZ Margin, Position1 Margin1 to Position8 Margin8, Enable
//! ```
//!
//! The arm may enter an area without an effect: the guide has only the names of the numbers.

use bcap_core::hresult::HResult;
use bcap_core::variant::{Array, Variant};

use super::Arm;
use crate::answer::{Answer, Answered};
use crate::areas::{ENABLED, IO, SIDES};
use crate::context::Context;
use crate::pose::{Pose, vector};
use crate::rules;
use crate::value::{numbers_of_array, one_int, truth};

/// Executes SetAreaDef.
pub(super) fn define(arm: &mut Arm, ctx: &mut Context<'_>, param: &Variant<'_>) -> Answered {
    let Variant::Array(array) = param.flatten() else { return Err(HResult::E_INVALIDARGTYPE) };
    let area = one_int(&item(array, 0))?;
    let given = match array.len() {
        2 => numbers_of_array(&item(array, 1))?,
        5 | 6 => {
            let Pose::Frame(frame, _) = Pose::parse(&item(array, 1), ctx.variables)? else {
                return Err(HResult::E_INVALIDARG);
            };
            let place = |n| item(array, n).is_empty().then_some(0).map_or_else(|| one_int(&item(array, n)), Ok);
            let places = [place(3)?, place(4)?, place(5)?].map(f64::from);
            [&frame.to_xyz_rpy()[..], &vector(&item(array, 2), ctx.variables)?, &places].concat()
        }
        _ => return Err(HResult::E_INVALIDARG),
    };
    arm.robot.may(ctx, &rules::SETTING)?;
    if given.len() > IO && !(-1.0..ctx.variables.io_len() as f64).contains(&given[IO]) {
        return Err(HResult::E_INVALIDARG);
    }
    arm.areas.set(area, &given).map(|()| Answer::Done)
}

/// Executes SetAreaEnabled; `enabled` of SetArea and ResetArea is known.
pub(super) fn enable(arm: &mut Arm, ctx: &mut Context<'_>, enabled: Option<bool>, param: &Variant<'_>) -> Answered {
    let (area, enabled) = match (param.flatten(), enabled) {
        (_, Some(enabled)) => (one_int(param)?, enabled),
        (Variant::Array(array), None) if array.len() == 2 => (one_int(&item(array, 0))?, truth(&item(array, 1))?),
        _ => return Err(HResult::E_INVALIDARG),
    };
    arm.robot.may(ctx, &rules::SETTING)?;
    arm.areas.get_mut(area)?[ENABLED] = f64::from(u8::from(enabled));
    Ok(Answer::Done)
}

/// Executes GetAreaDef.
pub(super) fn definition(arm: &mut Arm, _: &mut Context<'_>, param: &Variant<'_>) -> Answered {
    Answer::of(arm.areas.get(one_int(param)?)?)
}

/// Executes AreaSize.
pub(super) fn size(arm: &mut Arm, _: &mut Context<'_>, param: &Variant<'_>) -> Answered {
    Answer::of(arm.areas.get(one_int(param)?)?[SIDES..SIDES + 3].to_vec())
}

/// Executes GetAreaEnabled.
pub(super) fn is_enabled(arm: &mut Arm, _: &mut Context<'_>, param: &Variant<'_>) -> Answered {
    Answer::of(arm.areas.get(one_int(param)?)?[ENABLED] != 0.0)
}

fn item<'v>(array: Array<'v>, n: usize) -> Variant<'v> {
    array.get(n).unwrap_or(Variant::Empty).flatten()
}
