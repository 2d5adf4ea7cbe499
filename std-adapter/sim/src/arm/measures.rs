//! The measurements and logs of the robot, and its load as set by a client. The tables are in [`arm`](super).

use std::time::Duration;

use bcap_core::hresult::HResult;
use bcap_core::variant::Variant;

use super::Arm;
use crate::answer::{Answer, Answered};
use crate::context::Context;
use crate::kinematics::{measured, six};
use crate::robot::Load;
use crate::rules;
use crate::value::{Value, numbers, numbers_of_text, one_int, whole};

/// The time over which a speed is measured.
const SPEED_TIME: Duration = Duration::from_millis(1);

/// Executes GetLogRecord.
pub(super) fn log_record(arm: &Arm, param: &Variant<'_>) -> Answered {
    let index = usize::try_from(one_int(param)?).map_err(|_| HResult::DISP_E_BADINDEX)?;
    let point = arm.trace.get(index).ok_or(HResult::DISP_E_BADINDEX)?;
    let mut items = Vec::new();
    for angle in measured(point.axes) {
        // commanded position, position, current, load
        items.extend([angle, angle, 0.0, 0.0].map(Value::R8));
    }
    // the counter wraps as a counter of 32 bits does
    let millis = (point.at.as_micros() / 1000) as i32;
    items.extend([Value::I4(0), Value::I4(0), Value::from(""), Value::I4(0), Value::I4(millis)]);
    items.extend([Value::I4(point.tool), Value::I4(point.work)]);
    Ok(Value::List(items).into())
}

/// Executes GetSrvData.
pub(super) fn servo_data(arm: &mut Arm, ctx: &mut Context<'_>, param: &Variant<'_>) -> Answered {
    Ok(Value::R8s(match one_int(param)? {
        // the arm follows its commands exactly, and has no mass
        2 | 4 => vec![0.0; 8],
        17 => {
            let coordinates = arm.robot.coordinates();
            let place = |at| coordinates.place(&six(&arm.robot.axes(at))).position;
            let (here, soon) = (place(ctx.now), place(ctx.now.saturating_add(SPEED_TIME)));
            let [x, y, z] = [0, 1, 2].map(|i| (soon[i] - here[i]) / SPEED_TIME.as_secs_f64());
            measured([x, y, z, 0.0, 0.0, 0.0, 0.0, 0.0])
        }
        _ => return Err(HResult::E_NOTIMPL),
    })
    .into())
}

/// Executes PayLoad: `[mass, centre, inertia]`; the last ones may be absent.
pub(super) fn payload(arm: &mut Arm, ctx: &mut Context<'_>, param: &Variant<'_>) -> Answered {
    let param = param.flatten();
    let (mass, centre, inertia) = match param {
        // one array of numbers is the mass alone
        Variant::Array(array) if array.len() <= 3 => {
            let item = |place: usize| array.get(place).unwrap_or(Variant::Empty);
            (one_int(&item(0))?, vector(&item(1))?, vector(&item(2))?)
        }
        Variant::Array(_) => return Err(HResult::E_INVALIDARG),
        _ => (one_int(&param)?, [0.0; 3], [0.0; 3]),
    };
    if mass < 0 {
        return Err(HResult::E_INVALIDARG);
    }
    arm.robot.may(ctx, &rules::SETTING)?;
    let load = &mut arm.robot.settings_mut().load;
    *load = Load { mass, centre, inertia, ..*load };
    Ok(Answer::Done)
}

/// Executes SpeedMode.
pub(super) fn speed_mode(arm: &mut Arm, ctx: &mut Context<'_>, param: &Variant<'_>) -> Answered {
    let mode = match numbers(param)?[..] {
        [mode] => whole(mode)?,
        _ => return Err(HResult::E_INVALIDARG),
    };
    if !(0..=3).contains(&mode) {
        return Err(HResult::E_INVALIDARG);
    }
    arm.robot.may(ctx, &rules::SETTING)?;
    arm.robot.settings_mut().load.speed_mode = mode;
    Ok(Answer::Done)
}

/// Reads a vector: an array of 3 numbers, `V(x,y,z)`, or nothing, which is zero.
fn vector(value: &Variant<'_>) -> Result<[f64; 3], HResult> {
    let numbers = match value.flatten() {
        Variant::Empty | Variant::Null => return Ok([0.0; 3]),
        Variant::Bstr(text) => {
            let text = text.to_string();
            let list = text.trim().strip_prefix(['V', 'v']).map(str::trim).and_then(|rest| rest.strip_prefix('('));
            numbers_of_text(list.and_then(|rest| rest.strip_suffix(')')).ok_or(HResult::E_INVALIDARG)?)?
        }
        other => numbers(&other)?,
    };
    let vector: [f64; 3] = numbers.try_into().map_err(|_| HResult::E_INVALIDARG)?;
    if vector.iter().all(|n| n.is_finite()) { Ok(vector) } else { Err(HResult::E_INVALIDARG) }
}
