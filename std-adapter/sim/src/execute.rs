//! Controller_Execute and Task_Execute, and how tasks are started.
//!
//! | command                            | parameter           | answer                                           |
//! |------------------------------------|---------------------|--------------------------------------------------|
//! | ClearError                         | -                   | EMPTY; the error's code while its cause persists |
//! | GetErrorDescription                | I4, UI4, ERROR code | BSTR; see [`explain`](crate::explain)            |
//! | GetCurErrorCount, GetErrorLogCount | -                   | I4                                               |
//! | GetCurErrorInfo                    | I4 index            | an array of VARIANT, see below                   |
//! | GetErrorLog                        | I4 index            | an array of VARIANT, see below                   |
//! | SysState                           | -                   | I4 of bits, see [`Bit`]                          |
//! | SysInfo                            | I4: 0               | BSTR, the serial number                          |
//! | Motor                              | as Robot_Execute's  | as Robot_Execute's                               |
//! | StoState                           | -                   | BOOL; RC9, COBOTTA                               |
//! | ManualReset, ResetStoState         | -                   | EMPTY; likewise; `E_ACCESSDENIED` in emergency stop |
//! | ManualResetPreparation             | -                   | see [`preparation`](crate::preparation); COBOTTA |
//! | HandMoveA, HandMoveH, ...          | see [`hand`]        | likewise                                         |
//!
//! ```text
//! GetCurErrorInfo  code I4, message BSTR, subcode I4, file and line I4, program BSTR, line I4, file I4
//! GetErrorLog      code, year, month, day, hour, minute, second, millisecond, subcode, file, line I4,
//!                  program, message BSTR
//! ```
//!
//! Index 0 is the newest error and the greatest the oldest, the first cause: clients that print the list from its end
//! show it in order. An index out of range answers `DISP_E_BADINDEX`. Of GetErrorLog's array only the place of the
//! message (12) is known from public clients; the other places are this model's.
//!
//! A command that real controllers have and this one has not answers `E_NOTIMPL`; a name that none has answers
//! `E_INVALID_CMD_NAME`.

use bcap_core::handler::PeerId;
use bcap_core::hresult::HResult;
use bcap_core::variant::Variant;

use crate::config::Profile;
use crate::controller::Controller;
use crate::dispatch::{Answer, Answered};
use crate::errors::{ErrorEntry, description};
use crate::hand;
use crate::tasks::Task;
use crate::value::{Value, one_int};

/// The commands that every model has.
const COMMANDS: &[&str] = &[
    "ClearError",
    "GetErrorDescription",
    "GetCurErrorCount",
    "GetCurErrorInfo",
    "GetErrorLogCount",
    "GetErrorLog",
    "SysState",
    "SysInfo",
    "Motor",
];

/// Commands of real controllers that this one has not.
const NOT_HERE: &[&str] = &["GetOprLogCount", "GetOprLog", "HandMoveAH", "HandMoveVH", "SetAutoMode"];

/// The bits of SysState, by their numbers; those that are not here are never set.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Bit {
    /// A task is running.
    Running = 0,
    /// An error is present.
    Error = 1,
    /// The motor is on.
    ServoOn = 2,
    /// The controller has started; always.
    Initialized = 3,
    /// Auto mode.
    Auto = 4,
    /// The executable token is not with the teach pendant.
    TokenOutside = 5,
    /// A task runs over and over.
    Continuous = 8,
    /// The emergency stop is pressed.
    EmergencyStop = 10,
    /// Auto mode is enabled; always.
    AutoEnable = 11,
    /// The arm is calibrated; always, but for a COBOTTA before AutoCal.
    Calibrated = 17,
    /// Manual or teach check mode.
    Manual = 18,
    /// A task runs to the end of its cycle or line.
    OneCycle = 19,
    /// The robot moves; bit 21 says the same.
    Moving = 20,
}

impl Controller {
    pub(crate) fn controller_execute(&mut self, peer: PeerId, command: &str, param: &Variant<'_>) -> Answered {
        let known = |name: &&&str| name.eq_ignore_ascii_case(command.trim());
        if command.trim().eq_ignore_ascii_case("ManualResetPreparation")
            && let Some(answered) = self.preparation_command(peer, command.trim())
        {
            return answered;
        }
        if let Some(answered) = self.hand_command(peer, command.trim(), param) {
            return answered;
        }
        let sto = self.config().profile.has_safe_torque_off();
        let count = |n: usize| Value::I4(i32::try_from(n).unwrap_or(i32::MAX));
        let value = match command.trim().to_ascii_lowercase().as_str() {
            "clearerror" => {
                self.clear_error()?;
                Value::Empty
            }
            "geterrordescription" => Value::Text(self.describe(code_of(param)?)),
            "getcurerrorcount" => count(self.errors.present().len()),
            "geterrorlogcount" => count(self.errors.log().len()),
            "getcurerrorinfo" => {
                let entry = self.errors.present().get(index(param)?).ok_or(HResult::DISP_E_BADINDEX)?;
                error_info(entry)
            }
            "geterrorlog" => {
                let entry = self.errors.log().get(index(param)?).ok_or(HResult::DISP_E_BADINDEX)?;
                self.log_entry(entry)?
            }
            "sysstate" => Value::I4(self.system_state()),
            "sysinfo" => match one_int(param)? {
                0 => Value::from(self.config().serial_number.as_str()),
                _ => return Err(HResult::E_NOTIMPL),
            },
            "stostate" if sto => Value::Bool(self.torque_off),
            "manualreset" | "resetstostate" if sto && self.emergency_stopped() => return Err(HResult::E_ACCESSDENIED),
            "manualreset" | "resetstostate" if sto => {
                self.use_manual_reset()?;
                self.torque_off = false;
                Value::Empty
            }
            "motor" => return self.motor_command(peer, param),
            _ if NOT_HERE.iter().any(|name| known(&name)) => return Err(HResult::E_NOTIMPL),
            _ => return Err(HResult::E_INVALID_CMD_NAME),
        };
        Ok(value.into())
    }

    /// Describes a code; one that refuses arguments together with the last call that it refused.
    fn describe(&self, code: HResult) -> String {
        match self.refusals.last(code) {
            Some(refusal) => format!("{} Last refused: {refusal}", description(code)),
            None => description(code),
        }
    }

    /// Iterates over the commands of Controller_Execute that this controller has.
    pub(crate) fn command_names(&self) -> impl Iterator<Item = &'static str> + use<> {
        let profile = self.config().profile;
        let has = |there: bool, names: &'static [&'static str]| if there { names } else { &[] };
        COMMANDS
            .iter()
            .chain(has(profile.has_safe_torque_off(), &["StoState", "ManualReset", "ResetStoState"]))
            .chain(has(profile.wants_preparation(), &["ManualResetPreparation"]))
            .chain(has(profile == Profile::Cobotta, &hand::COMMANDS))
            .copied()
    }

    /// Returns the bits of SysState.
    pub(crate) fn system_state(&self) -> i32 {
        let running = self.tasks.iter().any(Task::is_running);
        let bits = [
            (Bit::Running as u32, running),
            (Bit::Error as u32, self.errors.code().is_err()),
            (Bit::ServoOn as u32, self.motor_is_on()),
            (Bit::Initialized as u32, true),
            (Bit::Auto as u32, self.is_auto()),
            (Bit::TokenOutside as u32, self.token_is_outside()),
            (Bit::Continuous as u32, self.tasks.iter().any(Task::is_continuous)),
            (Bit::EmergencyStop as u32, self.emergency_stopped()),
            (Bit::AutoEnable as u32, true),
            (Bit::Calibrated as u32, self.preparation.calibrated),
            (Bit::Manual as u32, !self.is_auto()),
            (Bit::OneCycle as u32, self.tasks.iter().any(|t| t.is_running() && !t.is_continuous())),
            (Bit::Moving as u32, self.is_moving()),
            (Bit::Moving as u32 + 1, self.is_moving()),
        ];
        bits.iter().filter(|(_, on)| *on).fold(0, |state, (bit, _)| state | 1 << bit)
    }

    fn log_entry(&self, entry: &ErrorEntry) -> Result<Value, HResult> {
        let time = self.date(entry.at)?.to_civil().ok_or(HResult::DISP_E_OVERFLOW)?;
        let mut items = vec![Value::I4(entry.code.0), Value::I4(time.year.into())];
        items.extend([time.month, time.day, time.hour, time.minute, time.second].map(|n| Value::I4(n.into())));
        items.push(Value::I4(time.millisecond.into()));
        items.extend([Value::I4(0), Value::I4(0), Value::I4(0), Value::from("")]);
        items.push(Value::Text(description(entry.code)));
        Ok(Value::List(items))
    }

    pub(crate) fn task_execute(&mut self, n: usize, command: &str) -> Answered {
        if command.trim().eq_ignore_ascii_case("GetStatus") {
            return Ok(Value::I4(self.tasks[n].status() as i32).into());
        }
        Err(HResult::E_INVALID_CMD_NAME)
    }

    /// Starts a task, which needs Auto mode, the executable token and no error.
    pub(crate) fn task_start(&mut self, peer: PeerId, n: usize, mode: i32) -> Result<(), HResult> {
        self.may_execute(peer)?;
        let now = self.now;
        self.tasks[n].start(mode, now)
    }

    /// Stops a task, which anybody may.
    pub(crate) fn task_stop(&mut self, n: usize, mode: i32) -> Answered {
        match self.tasks[n].stop(mode)? {
            true => Ok(Answer::Done),
            // it was not running
            false => Ok(Answer::Code(HResult::S_FALSE)),
        }
    }
}

/// Reads the code that GetErrorDescription asks about: I4, UI4, ERROR, or any number that is one.
fn code_of(param: &Variant<'_>) -> Result<HResult, HResult> {
    match param.flatten() {
        Variant::Error(code) => Ok(code),
        Variant::Bstr(_) | Variant::Array(_) => one_int(param).map(HResult),
        value => match value.as_i64() {
            Some(n) => i32::try_from(n)
                .or_else(|_| u32::try_from(n).map(u32::cast_signed))
                .map(HResult)
                .map_err(|_| HResult::DISP_E_OVERFLOW),
            None => Err(HResult::E_INVALIDARGTYPE),
        },
    }
}

fn index(param: &Variant<'_>) -> Result<usize, HResult> {
    usize::try_from(one_int(param)?).map_err(|_| HResult::DISP_E_BADINDEX)
}

fn error_info(entry: &ErrorEntry) -> Value {
    let (zero, program) = (|| Value::I4(0), Value::from(""));
    let message = Value::Text(description(entry.code));
    Value::List(vec![Value::I4(entry.code.0), message, zero(), zero(), program, zero(), zero()])
}
