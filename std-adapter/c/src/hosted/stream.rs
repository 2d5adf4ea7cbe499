//! Streams of Slave Mode whose loop the caller owns.

use std::time::Duration;

use bcap_std::core::slave::{AxisLimits, Next, Pose, PoseType, Stats};

use bcap_stream::steps::{StepError, Steps, format};

use super::controller::bcap_controller;
use super::{Failure, table, taken};
use crate::memory::{caller, check, copy, get, put, slice};
use crate::status::{BCAP_E_CLOSED, BCAP_E_NO_STREAM, BCAP_E_PANIC, BCAP_E_RANGE, BCAP_E_STREAM, bcap_status};

/// The number of joints of a pose.
const JOINTS: usize = 8;

/// How poses are streamed. Fields that are 0 have the default that is stated.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct bcap_stream_options {
    /// The maximum speed of each joint in degrees or mm per second; 0 is 30. A pose beyond it is not sent, and the robot stops.
    pub speed: f64,
    /// The maximum acceleration of each joint, per second squared; 0 is 300.
    pub acceleration: f64,
    /// Maximum time that the program may take for a pose, in ms; 0 is 100. After that the robot stops in an orderly way.
    pub pose_timeout_ms: u32,
    /// The mode of Slave Mode: 1 paces by the clock of this computer; 0 and 2 by the buffer of the controller.
    pub mode: i32,
}

/// The counts of a stream.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct bcap_stream_stats {
    /// Poses that the controller stored.
    pub cycles: u32,
    /// Poses that were sent late.
    pub late: u32,
    /// Number of times that the controller's buffer was empty while the robot moved.
    pub underflows: u32,
}

impl From<StepError> for Failure {
    fn from(error: StepError) -> Self {
        match error {
            StepError::Failed(error) => error.into(),
            StepError::Panicked => Self::new(BCAP_E_PANIC, error),
            error => Self::new(BCAP_E_STREAM, error),
        }
    }
}

/// Ends the stream of a cell, whose controller returns to the cell.
fn end(cell: &mut table::Cell, last: Next) -> Result<Stats, Failure> {
    let (controller, ended) = cell.stream.take().ok_or(BCAP_E_NO_STREAM)?.end(last);
    cell.controller = controller;
    Ok(ended?)
}

/// Waits for the next cycle, and returns the joints that the controller reports; if the stream has ended instead, returns why.
fn next_cycle(cell: &mut table::Cell) -> Result<Vec<f64>, Failure> {
    let wanted = cell.stream.as_ref().ok_or(BCAP_E_NO_STREAM)?.wanted();
    if let Some(step) = wanted {
        return Ok(step.actual);
    }
    end(cell, Next::Stop)?;
    Err(Failure::new(BCAP_E_STREAM, "Slave Mode: the stream has ended"))
}

/// Ends the stream after a failure: the robot stops.
fn or_end(cell: &mut table::Cell, ended: Result<(), Failure>) -> Result<(), Failure> {
    if ended.is_err() && cell.stream.is_some() {
        // the failure matters, not the outcome of the stream
        let _ = end(cell, Next::Stop);
    }
    ended
}

/// Sends the joints of the next cycle, and waits for the cycle after it.
///
/// # Safety
///
/// As for [`slice`] and [`copy`].
unsafe fn step(cell: &mut table::Cell, joints: *const f64, actual: *mut f64) -> Result<(), Failure> {
    let joints: [f64; JOINTS] = caller!(slice(joints, JOINTS))?.try_into().map_err(|_| BCAP_E_RANGE)?;
    if !actual.is_null() {
        check(actual)?;
    }
    cell.stream.as_ref().ok_or(BCAP_E_NO_STREAM)?.send(Next::Pose(Pose::j(joints)));
    let found = next_cycle(cell)?;
    if actual.is_null() { Ok(()) } else { Ok(caller!(copy(&found, actual, JOINTS))?) }
}

/// Returns a field, or its default if it is 0.
fn or(value: f64, default: f64, name: &str) -> Result<f64, Failure> {
    match value {
        0.0 => Ok(default),
        value if value > 0.0 && value.is_finite() => Ok(value),
        value => {
            let text = format_args!("{name} is {value}; pass a positive number, or 0 for {default}");
            Err(Failure::new(BCAP_E_RANGE, text))
        }
    }
}

/// Starts a stream of joints (8 numbers, in degrees or mm), and returns the joints at its start. The arm must be taken and the motor on.
/// Until `bcap_stream_finish` other functions of this controller return `BCAP_E_STREAMING`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn bcap_stream_start(
    cell: bcap_controller,
    options: *const bcap_stream_options,
    joints: *mut f64,
) -> bcap_status {
    table::on(cell.id, |cell| {
        let options = caller!(get(options))?;
        check(joints)?;
        let acceleration = or(options.acceleration, 300.0, "acceleration")?;
        let limits = AxisLimits::uniform(or(options.speed, 30.0, "speed")?, acceleration);
        let late = Duration::from_millis(or(options.pose_timeout_ms.into(), 100.0, "pose_timeout_ms")? as u64);
        let invalid = || Failure::new(BCAP_E_RANGE, format_args!("mode {} is invalid; pass 0, 1 or 2", options.mode));
        let format = format(options.mode, PoseType::J).ok_or_else(invalid)?;
        taken(cell.at_rest()?)?.keep();
        let controller = cell.controller.take().ok_or(BCAP_E_CLOSED)?;
        cell.stream = Some(Steps::start(controller, format, limits, late));
        let start = next_cycle(cell)?;
        or_end(cell, caller!(copy(&start, joints, JOINTS)).map_err(Failure::from))
    })
}

/// Sends the joints of the next cycle, and waits for the cycle after it, 8 ms later. `actual` gets the joints that the controller
/// reports; it may be null. Any status other than `BCAP_OK` ends the stream: the robot stops, and does not follow further
/// poses.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn bcap_stream_step(cell: bcap_controller, joints: *const f64, actual: *mut f64) -> bcap_status {
    table::on(cell.id, |cell| {
        let ended = caller!(step(cell, joints, actual));
        or_end(cell, ended)
    })
}

/// Ends the stream: the robot comes to rest at the last pose, and Slave Mode is left. `stats` may be null.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn bcap_stream_finish(cell: bcap_controller, stats: *mut bcap_stream_stats) -> bcap_status {
    table::on(cell.id, |cell| {
        let Stats { cycles, late, underflows, .. } = end(cell, Next::Finish)?;
        if stats.is_null() {
            return Ok(());
        }
        Ok(caller!(put(stats, bcap_stream_stats { cycles, late, underflows }))?)
    })
}
