//! The measurements and logs of the robot, and its load as set by a client. The tables are in [`arm`](super).

use std::time::Duration;

use bcap_core::hresult::HResult;
use bcap_core::variant::{Bstr, Encode, Variant};

use super::Arm;
use crate::answer::{Answer, Answered};
use crate::context::Context;
use crate::kinematics::{measured, six};
use crate::path::{LINE_SPEED, TURN_SPEED};
use crate::pose::vector;
use crate::robot::Load;
use crate::rules;
use crate::value::{numbers, one_int, whole};

/// The time over which a speed is measured.
const SPEED_TIME: Duration = Duration::from_millis(1);

/// Executes GetLogRecord.
pub(super) fn log_record(arm: &Arm, param: &Variant<'_>) -> Answered {
    let index = usize::try_from(one_int(param)?).map_err(|_| HResult::DISP_E_BADINDEX)?;
    let point = arm.trace.get(index).ok_or(HResult::DISP_E_BADINDEX)?;
    let mut items = Vec::new();
    for angle in measured(point.axes) {
        // commanded position, position, current, load
        items.extend([angle, angle, 0.0, 0.0].map(Variant::R8));
    }
    // the counter wraps as a counter of 32 bits does
    let millis = (point.at.as_micros() / 1000) as i32;
    let name = Variant::Bstr(Bstr::default());
    items.extend([Variant::I4(0), Variant::I4(0), name, Variant::I4(0), Variant::I4(millis)]);
    items.extend([point.tool, point.work].map(Variant::I4));
    Answer::of(items)
}

/// Executes GetSrvData.
pub(super) fn servo_data(arm: &mut Arm, ctx: &mut Context<'_>, param: &Variant<'_>) -> Answered {
    Answer::of(measured(axes_data(arm, ctx, one_int(param)?)?))
}

/// Executes GetAllSrvData: eight arrays, of which a public program names \[2\], the joints, \[4\], speeds in revolutions per
/// minute, and \[7\], the load in 0.1 percent. The speeds are joint speeds; the other arrays are 0. The type R4 is a decision;
/// such an answer fits a datagram.
pub(super) fn all_servo_data(arm: &mut Arm, ctx: &mut Context<'_>, _: &Variant<'_>) -> Answered {
    let speeds = axes_data(arm, ctx, 1)?.map(|speed| speed / 6.0);
    let mut arrays = [[0.0_f32; 8]; 8];
    arrays[2] = arm.robot.axes(ctx.now).map(|angle| angle as f32);
    arrays[4] = speeds.map(|speed| speed as f32);
    Answer::of(arrays.each_ref().map(|array| array as &dyn Encode))
}

/// The deviation of a joint while the motor is on, in GetSrvData 2. Not 0, because a public program treats 0 as a motor that is
/// off.
const DEVIATION: f64 = 0.001;

/// Executes GetSrvJntData: `[number, axis]`.
pub(super) fn axis_data(arm: &mut Arm, ctx: &mut Context<'_>, param: &Variant<'_>) -> Answered {
    let [number, axis] = numbers(param)?[..] else { return Err(HResult::E_INVALIDARG) };
    let (number @ (1 | 2 | 4 | 5 | 8), axis @ 1..=8) = (whole(number)?, whole(axis)?) else {
        return Err(HResult::E_INVALIDARG);
    };
    let data = axes_data(arm, ctx, number)?;
    Answer::of(data[axis.unsigned_abs() as usize - 1] as f32)
}

/// Returns the servo data of a number. The arm follows its commands exactly, and has no mass.
fn axes_data(arm: &Arm, ctx: &Context<'_>, number: i32) -> Result<[f64; 8], HResult> {
    let (here, soon) = (arm.robot.axes(ctx.now), arm.robot.axes(ctx.now.saturating_add(SPEED_TIME)));
    let speed = |from: f64, to: f64| (to - from) / SPEED_TIME.as_secs_f64();
    let coordinates = arm.robot.coordinates();
    let [from, to] = [here, soon].map(|axes| coordinates.place(&six(&axes)).to_xyz_rpy());
    // an angle that passes 180 degrees continues at -180
    let turning = |from: f64, to: f64| speed(0.0, (to - from + 180.0).rem_euclid(360.0) - 180.0);
    let [x, y, z] = [0, 1, 2].map(|i| speed(from[i], to[i]));
    let [rx, ry, rz] = [3, 4, 5].map(|i| turning(from[i], to[i]));
    Ok(match number {
        1 => [0, 1, 2, 3, 4, 5, 6, 7].map(|i| speed(here[i], soon[i])),
        2 if arm.robot.motor_is_on() => {
            [0, 1, 2, 3, 4, 5, 6, 7].map(|i| if i < coordinates.arm.joints() { DEVIATION } else { 0.0 })
        }
        2 | 4 | 5 | 7 | 19 | 20 => [0.0; 8],
        8 => here,
        17 => [x, y, z, 0.0, 0.0, 0.0, 0.0, 0.0],
        18 => [x, y, z, rx, ry, rz, 0.0, 0.0],
        _ => return Err(HResult::E_INVALIDARG),
    })
}

/// Executes MPS: the percentage of a speed along a line, in mm per second.
pub(super) fn line_percent(_: &mut Arm, _: &mut Context<'_>, param: &Variant<'_>) -> Answered {
    let [speed] = numbers(param)?[..] else { return Err(HResult::E_INVALIDARG) };
    percentage(speed, LINE_SPEED)
}

/// Executes RPM: the percentage of a speed of an axis, `[axis, revolutions per minute]`.
pub(super) fn axis_percent(arm: &mut Arm, _: &mut Context<'_>, param: &Variant<'_>) -> Answered {
    let [axis, rpm] = numbers(param)?[..] else { return Err(HResult::E_INVALIDARG) };
    percentage(rpm * 6.0, axis_speed(arm, axis)?)
}

/// Executes DPS: the percentage of a turning speed in degrees per second, or of one axis, `[axis, speed]`.
pub(super) fn turn_percent(arm: &mut Arm, _: &mut Context<'_>, param: &Variant<'_>) -> Answered {
    match numbers(param)?[..] {
        [speed] => percentage(speed, TURN_SPEED),
        [axis, speed] => percentage(speed, axis_speed(arm, axis)?),
        _ => Err(HResult::E_INVALIDARG),
    }
}

fn axis_speed(arm: &Arm, axis: f64) -> Result<f64, HResult> {
    let place = usize::try_from(whole(axis)?).ok().and_then(|axis| axis.checked_sub(1));
    place.and_then(|place| arm.robot.geometry().speeds.get(place).copied()).ok_or(HResult::E_INVALIDARG)
}

fn percentage(speed: f64, full: f64) -> Answered {
    if !speed.is_finite() {
        return Err(HResult::E_INVALIDARG);
    }
    Answer::of((speed / full * 100.0) as f32)
}

/// Executes SetHandIO: `[first, value, count]`.
pub(super) fn set_hand_io(_: &mut Arm, ctx: &mut Context<'_>, param: &Variant<'_>) -> Answered {
    let [first, value, count] = numbers(param)?[..] else { return Err(HResult::E_INVALIDARG) };
    let (range, value) = (io_range(ctx, first, count)?, whole(value)?);
    ctx.may_write()?;
    for (bit, n) in range.enumerate() {
        ctx.variables.set_io(n, value >> bit & 1 != 0);
    }
    Ok(Answer::Done)
}

/// Executes GetHandIO: `[first, count]`.
pub(super) fn hand_io(_: &mut Arm, ctx: &mut Context<'_>, param: &Variant<'_>) -> Answered {
    let [first, count] = numbers(param)?[..] else { return Err(HResult::E_INVALIDARG) };
    let bits = io_range(ctx, first, count)?.rev().fold(0, |bits, n| bits << 1 | i32::from(ctx.variables.io(n)));
    Answer::of(bits)
}

/// Checks a range of at most 32 IO.
fn io_range(ctx: &Context<'_>, first: f64, count: f64) -> Result<std::ops::Range<usize>, HResult> {
    let (Ok(first), count @ 1..=32) = (usize::try_from(whole(first)?), whole(count)?) else {
        return Err(HResult::E_INVALIDARG);
    };
    let end = first.saturating_add(count.unsigned_abs() as usize);
    if end <= ctx.variables.io_len() { Ok(first..end) } else { Err(HResult::DISP_E_BADINDEX) }
}

/// Executes PayLoad: `[mass, centre, inertia]`; the last ones may be absent.
pub(super) fn payload(arm: &mut Arm, ctx: &mut Context<'_>, param: &Variant<'_>) -> Answered {
    let param = param.flatten();
    let (mass, centre, inertia) = match param {
        // one array of numbers is the mass alone
        Variant::Array(array) if array.len() <= 3 => {
            let item = |place: usize| array.get(place).unwrap_or(Variant::Empty);
            let vector = |place| match item(place).flatten() {
                Variant::Empty | Variant::Null => Ok([0.0; 3]),
                given => vector(&given, ctx.variables),
            };
            (one_int(&item(0))?, vector(1)?, vector(2)?)
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
