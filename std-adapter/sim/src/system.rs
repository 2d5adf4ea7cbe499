//! The system variables of the controller, the robot and the tasks: names, types, and who may write them.
//!
//! Reading one that is for writing only answers `E_ACCESSDENIED`, writing one that is for reading only
//! `E_CAO_NOT_WRITABLE`. Those without something behind them in this model keep the value of a controller at peace:
//! `@DEADMAN_SW`, `@PROTECTIVE_STOP` and `@TSR_BUSY_STATUS` are false, `@AUTO_ENABLE` is true, `@IO_ALLOC_MODE` and a
//! task's `@STATUS_DETAILS` are 0. `@LOCK`, the machine lock, is kept but has no effect: nothing here really moves.

use std::time::Duration;

use bcap_core::handler::PeerId;
use bcap_core::hresult::HResult;
use bcap_core::rac::VariableKind as Kind;
use bcap_core::variant::{OleDate, Variant};

use crate::config::Mode;
use crate::controller::Controller;
use crate::dispatch::{Answer, Answered};
use crate::errors::description;
use crate::kinematics::six;
use crate::robot::{Percent, percent, position, trans};
use crate::value::{Value, number, one_int};

/// The object that a system variable belongs to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Owner {
    Controller,
    Robot,
    /// The task's place in the list.
    Task(usize),
}

/// What may be done with a variable.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Access {
    Read,
    Write,
    ReadWrite,
}

use Access::{Read, ReadWrite, Write};

const CONTROLLER: &[(&str, Access)] = &[
    ("@MODE", Read),
    ("@LOCK", ReadWrite),
    ("@TIME", Read),
    ("@CURRENT_TIME", Read),
    ("@BUSY_STATUS", Read),
    ("@TSR_BUSY_STATUS", Read),
    ("@NORMAL_STATUS", Read),
    ("@ERROR_CODE", ReadWrite),
    ("@ERROR_CODE_HEX", Read),
    ("@ERROR_DESCRIPTION", Read),
    ("@EMERGENCY_STOP", Read),
    ("@DEADMAN_SW", Read),
    ("@AUTO_ENABLE", Read),
    ("@PROTECTIVE_STOP", Read),
    ("@MAKER_NAME", Read),
    ("@TYPE", Read),
    ("@VERSION", Read),
    ("@FIRMWARE", Read),
    ("@SERIAL_NO", Read),
    ("@IO_ALLOC_MODE", Read),
    ("@VAR_I_LEN", Read),
    ("@VAR_F_LEN", Read),
    ("@VAR_D_LEN", Read),
    ("@VAR_V_LEN", Read),
    ("@VAR_P_LEN", Read),
    ("@VAR_J_LEN", Read),
    ("@VAR_T_LEN", Read),
    ("@VAR_S_LEN", Read),
    ("@VAR_IO_LEN", Read),
];

const ROBOT: &[(&str, Access)] = &[
    ("@CURRENT_POSITION", Read),
    ("@CURRENT_ANGLE", Read),
    ("@CURRENT_TRANS", Read),
    ("@HIGH_CURRENT_POSITION", Read),
    ("@HIGH_CURRENT_ANGLE", Read),
    ("@HIGH_CURRENT_TRANS", Read),
    ("@DEST_POSITION", Read),
    ("@DEST_ANGLE", Read),
    ("@DEST_TRANS", Read),
    ("@SERVO_ON", ReadWrite),
    ("@BUSY_STATUS", Read),
    ("@TYPE_NAME", Read),
    ("@TYPE", Read),
    ("@CURRENT_TOOL", ReadWrite),
    ("@CURRENT_WORK", ReadWrite),
    ("@SPEED", Read),
    ("@ACCEL", Read),
    ("@DECEL", Read),
    ("@JSPEED", Read),
    ("@JACCEL", Read),
    ("@JDECEL", Read),
    ("@EXTSPEED", ReadWrite),
    ("@EXTACCEL", Read),
    ("@EXTDECEL", Read),
];

const TASK: &[(&str, Access)] = &[
    ("@STATUS", Read),
    ("@STATUS_DETAILS", Read),
    ("@PRIORITY", Read),
    ("@LINE_NO", Read),
    ("@CYCLE_TIME", Read),
    ("@ELAPSED_TIME", Read),
    ("@START", Write),
    ("@STOP", Write),
];

/// The priority of every task.
const PRIORITY: i32 = 128;

/// The greatest number of a tool or of work coordinates.
pub(crate) const LAST_COORDINATES: i32 = 63;

/// Returns the variables of an object.
pub(crate) fn names(owner: Owner) -> &'static [(&'static str, Access)] {
    match owner {
        Owner::Controller => CONTROLLER,
        Owner::Robot => ROBOT,
        Owner::Task(_) => TASK,
    }
}

/// Finds a system variable, whatever the case of its name.
pub(crate) fn find(owner: Owner, name: &str) -> Option<&'static str> {
    names(owner).iter().map(|(known, _)| *known).find(|known| known.eq_ignore_ascii_case(name.trim()))
}

/// Says what may be written to a system variable.
pub(crate) fn accepted(name: &str) -> Option<&'static str> {
    Some(match name {
        "@LOCK" | "@SERVO_ON" => "BOOL, or an integer: 0 is off",
        "@ERROR_CODE" => "0, which clears the errors",
        "@CURRENT_TOOL" | "@CURRENT_WORK" => "one number, 0 to 63",
        "@EXTSPEED" => "one number: percent, 0.0001 to 100",
        "@START" => "one number: 1 one cycle, 2 continuous, 3 one line",
        "@STOP" => "one number, 0 to 4",
        _ => return None,
    })
}

fn access(owner: Owner, name: &str) -> Result<Access, HResult> {
    let found = names(owner).iter().find(|(known, _)| *known == name);
    found.map(|(_, access)| *access).ok_or(HResult::E_CAO_OBJECT_NOTFOUND)
}

impl Controller {
    /// Reads a system variable.
    pub(crate) fn system_get(&self, owner: Owner, name: &'static str) -> Result<Value, HResult> {
        if access(owner, name)? == Access::Write {
            return Err(HResult::E_ACCESSDENIED);
        }
        match owner {
            Owner::Controller => self.controller_get(name),
            Owner::Robot => self.robot_get(name),
            Owner::Task(n) => self.task_get(n, name),
        }
    }

    /// Writes a system variable.
    ///
    /// Writing true to `@SERVO_ON` answers when the motor is on, as `Motor` does without its NoWait.
    pub(crate) fn system_put(
        &mut self,
        peer: PeerId,
        owner: Owner,
        name: &'static str,
        value: &Variant<'_>,
    ) -> Answered {
        if access(owner, name)? == Access::Read {
            return Err(HResult::E_CAO_NOT_WRITABLE);
        }
        match (owner, name) {
            (Owner::Controller, "@LOCK") => self.locked = truth(value)?,
            (Owner::Controller, "@ERROR_CODE") => match one_int(value)? {
                0 => self.clear_error()?,
                _ => return Err(HResult::E_INVALIDARG),
            },
            (Owner::Robot, "@SERVO_ON") => {
                let wait = self.config().servo_on_waits;
                return self.switch_motor(peer, truth(value)?, wait);
            }
            (Owner::Robot, "@CURRENT_TOOL") => {
                self.may_set_arm(peer)?;
                self.robot.tool = coordinates(one_int(value)?)?;
            }
            (Owner::Robot, "@CURRENT_WORK") => {
                self.may_set_arm(peer)?;
                self.robot.work = coordinates(one_int(value)?)?;
            }
            (Owner::Robot, "@EXTSPEED") => {
                let speed = percent(number(&value.flatten()).ok_or(HResult::E_INVALIDARGTYPE)?)?;
                self.robot.external = Percent::of_speed(speed);
            }
            (Owner::Task(n), "@START") => self.task_start(peer, n, one_int(value)?)?,
            (Owner::Task(n), "@STOP") => {
                self.task_stop(n, one_int(value)?)?;
            }
            _ => return Err(HResult::E_CAO_NOT_WRITABLE),
        }
        Ok(Answer::Done)
    }

    fn controller_get(&self, name: &str) -> Result<Value, HResult> {
        let config = self.config();
        let code = self.errors.code();
        if let Some(kind) = length_of(name) {
            return Ok(Value::I4(config.sizes.of(kind).into()));
        }
        Ok(match name {
            "@MODE" => Value::I4(self.mode() as i32),
            "@LOCK" => Value::Bool(self.locked),
            // the count of milliseconds wraps as a 32-bit counter does
            "@TIME" => Value::I4((self.now.as_micros() / 1000) as i32),
            "@CURRENT_TIME" => Value::Date(self.date(self.now)?),
            "@BUSY_STATUS" => Value::Bool(self.is_moving() || self.tasks.iter().any(|t| t.is_running())),
            "@TSR_BUSY_STATUS" | "@DEADMAN_SW" | "@PROTECTIVE_STOP" => Value::Bool(false),
            "@AUTO_ENABLE" => Value::Bool(true),
            "@NORMAL_STATUS" => Value::Bool(code.is_ok()),
            "@ERROR_CODE" => Value::I4(code.0),
            "@ERROR_CODE_HEX" => Value::Text(format!("{:08X}", code.to_u32())),
            "@ERROR_DESCRIPTION" if code.is_ok() => Value::from(""),
            "@ERROR_DESCRIPTION" => Value::Text(description(code)),
            "@EMERGENCY_STOP" => Value::Bool(self.emergency_stopped()),
            "@MAKER_NAME" => Value::from("bcap-sim"),
            "@TYPE" => Value::from(config.profile.type_name()),
            "@VERSION" | "@FIRMWARE" => Value::from(config.version.as_str()),
            "@SERIAL_NO" => Value::from(config.serial_number.as_str()),
            "@IO_ALLOC_MODE" => Value::I4(0),
            _ => return Err(HResult::E_CAO_OBJECT_NOTFOUND),
        })
    }

    fn robot_get(&self, name: &str) -> Result<Value, HResult> {
        let robot = &self.robot;
        let (here, there) = (self.joints(), robot.destination());
        Ok(match name {
            "@CURRENT_POSITION" | "@HIGH_CURRENT_POSITION" => Value::R8s(position(&here)),
            "@CURRENT_ANGLE" | "@HIGH_CURRENT_ANGLE" => Value::R8s(self.axes().to_vec()),
            "@CURRENT_TRANS" | "@HIGH_CURRENT_TRANS" => Value::R8s(trans(&here)),
            "@DEST_POSITION" => Value::R8s(position(&six(&there))),
            "@DEST_ANGLE" => Value::R8s(there.to_vec()),
            "@DEST_TRANS" => Value::R8s(trans(&six(&there))),
            "@SERVO_ON" => Value::Bool(robot.motor_is_on()),
            "@BUSY_STATUS" => Value::Bool(self.is_moving()),
            "@TYPE_NAME" => Value::from(self.config().robot_type.as_str()),
            "@TYPE" => Value::I4(0),
            "@CURRENT_TOOL" => Value::I4(robot.tool),
            "@CURRENT_WORK" => Value::I4(robot.work),
            "@SPEED" => Value::R4(robot.hand.speed),
            "@ACCEL" => Value::R4(robot.hand.accel),
            "@DECEL" => Value::R4(robot.hand.decel),
            "@JSPEED" => Value::R4(robot.joint.speed),
            "@JACCEL" => Value::R4(robot.joint.accel),
            "@JDECEL" => Value::R4(robot.joint.decel),
            "@EXTSPEED" => Value::R4(robot.external.speed),
            "@EXTACCEL" => Value::R4(robot.external.accel),
            "@EXTDECEL" => Value::R4(robot.external.decel),
            _ => return Err(HResult::E_CAO_OBJECT_NOTFOUND),
        })
    }

    fn task_get(&self, n: usize, name: &str) -> Result<Value, HResult> {
        let task = self.tasks.get(n).ok_or(HResult::E_CAO_OBJECT_NOTFOUND)?;
        let millis = |time: Duration| Value::I4(i32::try_from(time.as_millis()).unwrap_or(i32::MAX));
        Ok(match name {
            "@STATUS" => Value::I4(task.status() as i32),
            "@STATUS_DETAILS" => Value::I4(0),
            "@PRIORITY" => Value::I4(PRIORITY),
            "@LINE_NO" => Value::I4s(vec![task.line()]),
            "@CYCLE_TIME" => millis(task.cycle_time()),
            "@ELAPSED_TIME" => millis(task.elapsed()),
            _ => return Err(HResult::E_CAO_OBJECT_NOTFOUND),
        })
    }

    /// Returns the wall clock at a time of the model.
    pub(crate) fn date(&self, at: bcap_core::time::Instant) -> Result<OleDate, HResult> {
        let millis = i64::try_from(at.as_micros() / 1000).unwrap_or(i64::MAX);
        let millis = self.config().wall_clock_origin_ms.saturating_add(millis);
        OleDate::from_unix_millis(millis).ok_or(HResult::DISP_E_OVERFLOW)
    }

    /// Returns the `@MODE` that motion needs.
    pub(crate) fn is_auto(&self) -> bool {
        self.mode() == Mode::Auto
    }
}

/// Finds the kind of variables that `@VAR_x_LEN` counts.
fn length_of(name: &str) -> Option<Kind> {
    let kind = name.strip_prefix("@VAR_")?.strip_suffix("_LEN")?;
    Kind::ALL.into_iter().find(|k| k.name() == kind)
}

fn truth(value: &Variant<'_>) -> Result<bool, HResult> {
    value.flatten().as_bool().ok_or(HResult::E_INVALIDARGTYPE)
}

/// Checks the number of a tool or of work coordinates.
pub(crate) fn coordinates(number: i32) -> Result<i32, HResult> {
    if (0..=LAST_COORDINATES).contains(&number) { Ok(number) } else { Err(HResult::E_INVALIDARG) }
}
