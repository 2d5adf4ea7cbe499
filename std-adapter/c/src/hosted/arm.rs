//! The arm: motions, halting, recovery.

use std::ffi::c_char;
use std::ops::ControlFlow;
use std::sync::Arc;
use std::sync::atomic::Ordering::Relaxed;
use std::time::Duration;

use bcap_std::blocking::{Arm, Moving};
use bcap_std::core::procedure::{Motion, RecoveryConfig, RecoveryStep};
use bcap_std::{Move, Pass};

use super::controller::bcap_controller;
use super::table::Cell;
use super::{Failure, enter, table, taken};
use crate::memory::{caller, copy, get, put, read_text};
use crate::status::{BCAP_E_HALTED, BCAP_E_MOTION_TIMEOUT, BCAP_E_NO_MOTION, BCAP_E_RANGE, BCAP_E_UNSURE, bcap_status};

/// The robot rests exactly at the destination.
pub const BCAP_PASS_EXACT: i32 = 0;
/// The commanded position reaches the destination; the arm may lag behind it.
pub const BCAP_PASS_COMMANDED: i32 = -1;
/// The robot passes near the destination, at a distance that the controller chooses.
pub const BCAP_PASS_NEAR: i32 = -2;

/// A motion. Fields that are 0 have the meaning that is stated.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct bcap_motion {
    /// The destination: a variable (`P1`, `J3`), or a pose as the controller writes it (`J(0, 45, 90, 0, 45, 0)`).
    pub to: *const c_char,
    /// The speed in percent; 0 is 10 %.
    pub speed_percent: f64,
    /// How the motion ends: one of `BCAP_PASS_...`, or a positive distance in mm at which the next motion may begin.
    pub pass: i32,
    /// Whether the tool moves along a line; otherwise all joints move at the same time.
    pub line: bool,
}

/// Halts a robot from any thread, while another thread waits for a motion. It has a separate connection.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct bcap_stopper {
    /// Private.
    pub id: u64,
}

/// Runs calls with the arm, which must be taken. It stays taken.
fn with_arm<T>(cell: &mut Cell, calls: impl FnOnce(&mut Arm<'_>) -> Result<T, Failure>) -> Result<T, Failure> {
    let mut arm = taken(cell.at_rest()?)?;
    let ended = calls(&mut arm);
    arm.keep();
    ended
}

/// Reads a motion of C.
///
/// # Safety
///
/// As for [`get`] and [`read_text`].
unsafe fn motion(motion: *const bcap_motion) -> Result<Move, Failure> {
    let bcap_motion { to, speed_percent, pass, line } = caller!(get(motion))?;
    let to = caller!(read_text(to))?;
    let motion = if line { Move::line(to) } else { Move::joint(to) };
    let range = |text: &str| Failure::new(BCAP_E_RANGE, text);
    if !(0.0..=100.0).contains(&speed_percent) {
        return Err(range("speed_percent must be above 0 and at most 100, or 0 for 10 %"));
    }
    let pass = match pass {
        BCAP_PASS_EXACT => Pass::Exact,
        BCAP_PASS_COMMANDED => Pass::Commanded,
        BCAP_PASS_NEAR => Pass::Near,
        mm => Pass::Within(u16::try_from(mm).map_err(|_| range("pass must be BCAP_PASS_... or 1 to 65535 mm"))?),
    };
    Ok(motion.pass(pass).speed_percent(if speed_percent == 0.0 { 10.0 } else { speed_percent }))
}

/// Returns the outcome of a motion: only an arrival is a success.
fn outcome(motion: Motion) -> Result<(), Failure> {
    Err(match motion {
        Motion::Arrived => return Ok(()),
        Motion::Halted => BCAP_E_HALTED.into(),
        Motion::TimedOut => BCAP_E_MOTION_TIMEOUT.into(),
        Motion::Failed(code) => Failure::from(code.0),
        _ => BCAP_E_UNSURE.into(),
    })
}

/// Takes the arm of the robot, so that this session can move it.
#[unsafe(no_mangle)]
pub extern "C" fn bcap_take_arm(cell: bcap_controller) -> bcap_status {
    table::on(cell.id, |cell| Ok(cell.at_rest()?.robot()?.take_arm().map(Arm::keep)?))
}

/// Halts a running motion, switches the motor off if this session has switched it on, and gives the arm back.
#[unsafe(no_mangle)]
pub extern "C" fn bcap_give_arm(cell: bcap_controller) -> bcap_status {
    table::on(cell.id, |cell| {
        let ended = taken(cell.controller()?)?.give();
        cell.motion = None;
        Ok(ended?)
    })
}

/// Switches the motor on or off, and waits until it is.
#[unsafe(no_mangle)]
pub extern "C" fn bcap_motor(cell: bcap_controller, on: bool) -> bcap_status {
    table::on(cell.id, |cell| with_arm(cell, |arm| Ok(if on { arm.motor_on() } else { arm.motor_off() }?)))
}

/// Sets the external speed in percent of the maximum, which scales the speed of motions.
#[unsafe(no_mangle)]
pub extern "C" fn bcap_set_speed(cell: bcap_controller, percent: f64) -> bcap_status {
    table::on(cell.id, |cell| with_arm(cell, |arm| Ok(arm.set_speed(percent)?)))
}

/// Moves, and waits until the motion ends, at most `limit_ms`; the robot is halted then. `BCAP_OK` says that the robot rests at the
/// destination. Any other status says how the motion ended: see `bcap_status_text` and `bcap_message`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn bcap_move(cell: bcap_controller, motion_: *const bcap_motion, limit_ms: u32) -> bcap_status {
    table::on(cell.id, |cell| {
        let (motion, limit) = (caller!(motion(motion_))?, Duration::from_millis(limit_ms.into()));
        with_arm(cell, |arm| outcome(arm.move_to(&motion, limit)?))
    })
}

/// Starts a motion, and returns when it has begun. Variables can be read and written until `bcap_wait` or `bcap_halt` ends it.
/// If a motion is running, this motion follows it. `limit_ms` of the first motion is the time limit of all.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn bcap_start(cell: bcap_controller, motion_: *const bcap_motion, limit_ms: u32) -> bcap_status {
    table::on(cell.id, |cell| {
        let (motion, limit) = (caller!(motion(motion_))?, Duration::from_millis(limit_ms.into()));
        cell.motion = Some(match cell.motion.take() {
            Some(kept) => cell.controller()?.resume(kept)?.then(&motion)?.keep(),
            None => with_arm(cell, |arm| Ok(arm.start(&motion, limit).map(Moving::keep)?))?,
        });
        Ok(())
    })
}

/// Waits until the motions of `bcap_start` end; the status is the outcome, as for `bcap_move`.
#[unsafe(no_mangle)]
pub extern "C" fn bcap_wait(cell: bcap_controller) -> bcap_status {
    table::on(cell.id, |cell| {
        let kept = cell.motion.take().ok_or(BCAP_E_NO_MOTION)?;
        outcome(cell.controller()?.resume(kept)?.wait()?)
    })
}

/// Halts the robot, even without the arm, and waits until it rests. After any status other than `BCAP_OK` it may still move.
/// While another thread waits for a motion, use `bcap_stopper_halt`.
#[unsafe(no_mangle)]
pub extern "C" fn bcap_halt(cell: bcap_controller) -> bcap_status {
    table::on(cell.id, |cell| {
        let halted = match cell.motion.take() {
            Some(kept) => cell.controller()?.resume(kept)?.halt(),
            None => cell.controller()?.robot()?.halt(),
        };
        Ok(halted.map(drop)?)
    })
}

/// Recovers the robot after an error: clears the errors, takes the arm and switches the motor on. **The arm of a COBOTTA can move**, so
/// a person must have looked at the robot. `is_alone` says that no other client uses the robot.
#[unsafe(no_mangle)]
pub extern "C" fn bcap_recover(cell: bcap_controller, is_alone: bool) -> bcap_status {
    table::on(cell.id, |cell| {
        let has_arm = Arc::clone(&cell.has_arm);
        let controller = cell.at_rest()?;
        if controller.has_arm() {
            controller.arm()?.give()?;
            has_arm.store(false, Relaxed);
        }
        let config = RecoveryConfig { is_alone, ..RecoveryConfig::default() };
        let observe = |step, ended: Result<(), _>| {
            if step == RecoveryStep::TakeArm && ended.is_ok() {
                has_arm.store(true, Relaxed);
            }
            ControlFlow::Continue(())
        };
        Ok(controller.make_ready(Some(config), observe).map(Arm::keep)?)
    })
}

/// Reads the joints in degrees or mm; joints that the robot does not have are 0.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn bcap_joints(cell: bcap_controller, joints: *mut f64) -> bcap_status {
    table::on(cell.id, |cell| {
        let found = cell.controller()?.robot()?.joints()?;
        Ok(caller!(copy(&found.degrees, joints, found.degrees.len()))?)
    })
}

/// Opens a second connection, over which any thread can halt the robot at any time. Open it before the first motion. It is not an
/// emergency stop: it needs the network, this computer and the controller.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn bcap_stopper_open(cell: bcap_controller, stopper: *mut bcap_stopper) -> bcap_status {
    enter(|| {
        caller!(put(stopper, bcap_stopper { id: 0 }))?;
        let opened = table::with(cell.id, |cell| Ok(cell.controller()?.stopper()?))?;
        Ok(caller!(put(stopper, bcap_stopper { id: table::add_stopper(opened) }))?)
    })
}

/// Halts the robot, and waits until it rests. After another status than `BCAP_OK` it may still move.
#[unsafe(no_mangle)]
pub extern "C" fn bcap_stopper_halt(stopper: bcap_stopper) -> bcap_status {
    enter(|| Ok(table::stopper(stopper.id)?.halt().map(drop)?))
}

/// Closes a stopper.
#[unsafe(no_mangle)]
pub extern "C" fn bcap_stopper_close(stopper: bcap_stopper) -> bcap_status {
    enter(|| table::close_stopper(stopper.id))
}
