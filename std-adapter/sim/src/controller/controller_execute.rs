//! The commands of Controller_Execute.
//!
//! | command                            | parameter           | answer                                           |
//! |------------------------------------|---------------------|--------------------------------------------------|
//! | ClearError                         | -                   | EMPTY; the code of an error that remains, of level 5 |
//! | GetErrorDescription                | I4, UI4, ERROR code | BSTR; see [`explain`](crate::explain)            |
//! | GetCurErrorCount, GetErrorLogCount | -                   | I4                                               |
//! | GetCurErrorInfo                    | I4 index            | an array of VARIANT, see below                   |
//! | GetErrorLog                        | I4 index            | an array of VARIANT, see below                   |
//! | GetOprLogCount                     | -                   | I4                                               |
//! | GetOprLog                          | I4 index            | an array of VARIANT, see below                   |
//! | SysState                           | -                   | I4 of bits, see [`SysStateBit`]                          |
//! | SysInfo                            | I4: 0, 1            | BSTR: the serial number; a MAC address           |
//! |                                    | I4: 3               | I4\[8\]: the numbers of I F D V P J T S variables |
//! |                                    | I4: 8, 10, 12       | I4: minutes since the controller was switched on |
//! |                                    | I4: 5; 14           | I4: 3000, the user level; starts of the motor    |
//! |                                    | I4: 15              | I4: -1 when the battery's date has passed, or 0  |
//! |                                    | I4: others to 16    | I4: 0                                            |
//! | Motor                              | as Robot_Execute's  | as Robot_Execute's                               |
//! | KillAll, SuspendAll, StepStopAll   | -, or I4: 0 or 1    | EMPTY, with 1 when tasks and robot rest          |
//! | ContinueStartAll                   | -                   | EMPTY; continues the suspended tasks             |
//! | KillAllTsr, RunAllTsr              | -, or I4: 0 or 1    | EMPTY; there are no supervisory tasks            |
//! | GetPublicValue                     | \[task, variable, index\] | the value of a public variable of a scenario's task |
//! | SetPublicValue                     | \[value, task, variable, index\] | EMPTY; a value of the same type and count |
//! | StoState                           | -                   | BOOL; RC9, COBOTTA                               |
//! | ManualReset, ResetStoState         | -                   | EMPTY; likewise; 0x83500178 in emergency stop |
//! | ManualResetPreparation             | -                   | see [`preparation`](crate::preparation); COBOTTA |
//! | HandMoveA, HandMoveH, ...          | see [`hand`](crate::hand) | likewise                                   |
//!
//! ```text
//! GetCurErrorInfo  code I4, message BSTR, code I4, file and line I4, program BSTR, line I4, file I4, DATE
//! GetErrorLog      code, year, month, day of the week, day, hour, minute, second, millisecond, tick in ms I4, program BSTR,
//!                  line I4, message BSTR, original code, client I4
//! GetOprLog        code 0 to tick, as GetErrorLog; client I4, operation BSTR
//! ```
//!
//! The day of the week counts from Sunday, 0. The client is 0 the controller, 3 a client, 4 a task, -1 unknown.
//!
//! File and line, program and its line name the task in which an error has occurred, and its step.
//!
//! Index 0 is the latest error, the greatest index the oldest one, which is the first cause: clients that print the list
//! from its end show it in order. An index out of range answers `DISP_E_BADINDEX`.
//!
//! A command of real controllers that this model lacks answers `E_NOTIMPL`, another name `E_INVALID_CMD_NAME`.

use bcap_core::handler::PeerId;
use bcap_core::hresult::HResult;
use bcap_core::rac::VariableKind as Kind;
use bcap_core::time::Instant;
use bcap_core::variant::{Encode, Variant};

use super::{Controller, Shared};
use crate::answer::{Answer, Answered};
use crate::arm::robot_execute::{MOTOR, motor};
use crate::config::{Config, Token};
use crate::errors::{ErrorEntry, Occurrence, description};
use crate::model::Functions;
use crate::operations::Operation;
use crate::rules;
use crate::table::Command;
use crate::tasks::{Task, Tasks};
use crate::value::{numbers, one_int};
use crate::waits::Wait;

type ControllerHandler = fn(&mut Controller, PeerId, &Variant<'_>) -> Answered;

const fn command(name: &'static str, run: ControllerHandler) -> Command<ControllerHandler> {
    Command::new(name, run)
}

const fn has_hand(functions: Functions) -> bool {
    functions.hand
}

const fn has_safe_torque_off(functions: Functions) -> bool {
    functions.safe_torque_off
}

/// The commands, in the order of Controller_GetCommandNames.
pub(super) const COMMANDS: &[Command<ControllerHandler>] = &[
    command("ClearError", |controller, peer, _| controller.clear_error(peer)),
    command("GetErrorDescription", |controller, _, param| Answer::of(controller.describe(code_of(param)?)))
        .accepts("one code: I4, UI4, ERROR or another integer"),
    command("GetCurErrorCount", |controller, _, _| count(controller.shared.errors.present().len())),
    command("GetCurErrorInfo", |controller, _, param| {
        let entry = controller.shared.errors.present().get(index(param)?).ok_or(HResult::DISP_E_BADINDEX)?;
        error_info(&controller.shared.config, entry)
    })
    .accepts("one number: the index, from 0 to below GetCurErrorCount"),
    command("GetErrorLogCount", |controller, _, _| count(controller.shared.errors.log().len())),
    command("GetErrorLog", |controller, _, param| {
        let entry = controller.shared.errors.log().get(index(param)?).ok_or(HResult::DISP_E_BADINDEX)?;
        log_entry(&controller.shared.config, entry)
    })
    .accepts("one number: the index, from 0 to below GetErrorLogCount"),
    command("GetOprLogCount", |controller, _, _| count(controller.shared.operations.log().len())),
    command("GetOprLog", |controller, _, param| {
        let entry = controller.shared.operations.log().get(index(param)?).ok_or(HResult::DISP_E_BADINDEX)?;
        operation(&controller.shared.config, entry)
    })
    .accepts("one number: the index, from 0 to below GetOprLogCount"),
    command("SysState", |controller, _, _| Answer::of(controller.system_state())),
    command("SysInfo", |controller, _, param| controller.system_info(one_int(param)?)).accepts("one number, 0 to 16"),
    command("Motor", |controller, peer, param| motor(&mut controller.arm, &mut controller.shared.context(peer), param))
        .accepts(MOTOR),
    command("KillAll", |controller, _, param| controller.stop_all(param, Tasks::kill)).accepts(SYNC),
    command("SuspendAll", |controller, _, param| controller.stop_all(param, Tasks::suspend)).accepts(SYNC),
    command("StepStopAll", |controller, _, param| controller.stop_all(param, Tasks::step_stop)).accepts(SYNC),
    command("ContinueStartAll", |controller, peer, _| {
        controller.shared.context(peer).may(&rules::START_TASK)?;
        controller.tasks.continue_start(controller.shared.now);
        controller.record_operation("all tasks continued");
        Ok(Answer::Done)
    }),
    // there are no supervisory tasks
    command("KillAllTsr", |_, _, param| synchronous(param).map(|_| Answer::Done)).accepts(SYNC),
    command("RunAllTsr", |_, _, param| synchronous(param).map(|_| Answer::Done))
        .accepts("nothing, or one number: 0 the tasks of the root folder, 1 all"),
    command("GetPublicValue", |controller, _, param| {
        let (task, name, index) = public_value(param, 0)?;
        let task = controller.tasks.position(&task).ok_or(HResult::E_CAO_OBJECT_NOTFOUND)?;
        Ok(controller.tasks.get(task)?.public().get(&name, index)?.into())
    })
    .accepts("[task, variable] or [task, variable, index]"),
    command("SetPublicValue", |controller, peer, param| {
        let (task, name, index) = public_value(param, 1)?;
        controller.shared.context(peer).may_write()?;
        let task = controller.tasks.position(&task).ok_or(HResult::E_CAO_OBJECT_NOTFOUND)?;
        let value = element(param, 0).unwrap_or(Variant::Empty);
        controller.tasks.get_mut(task)?.public_mut().put(&name, index, &value)?;
        Ok(Answer::Done)
    })
    .accepts("[value, task, variable] or [value, task, variable, index]: a value of the type of the variable"),
    command("StoState", |controller, _, _| Answer::of(controller.arm.preparation().is_torque_off()))
        .of(has_safe_torque_off),
    command("ManualReset", manual_reset).of(has_safe_torque_off),
    command("ResetStoState", manual_reset).of(has_safe_torque_off),
    command("ManualResetPreparation", |controller, _, _| {
        controller.arm.preparation_mut().prepare_reset(&controller.shared.config)
    })
    .of(|functions| functions.preparation),
    command("HandMoveA", |controller, peer, param| {
        controller.arm.hand_mut().move_absolute(&mut controller.shared.context(peer), param)
    })
    .of(has_hand)
    .accepts("[place, speed], perhaps with \"Next\": 0 to 30 mm, 1 to 100 percent"),
    command("HandMoveR", |controller, peer, param| {
        controller.arm.hand_mut().move_relative(&mut controller.shared.context(peer), param)
    })
    .of(has_hand)
    .accepts("[way, speed]: in mm and within 0 to 30 mm, 1 to 100 percent"),
    command("HandMoveH", |controller, peer, param| {
        controller.arm.hand_mut().grip(&mut controller.shared.context(peer), param)
    })
    .of(has_hand)
    .accepts("[force, close], perhaps with \"Next\": 6 to 20 N, BOOL or a number"),
    command("HandMoveAH", |controller, peer, param| {
        controller.arm.hand_mut().move_and_grip(&mut controller.shared.context(peer), param)
    })
    .of(has_hand)
    .accepts("[place, speed, force]: 0 to 30 mm, 1 to 100 percent, 6 to 20 N"),
    command("HandMoveVH", |controller, peer, param| {
        controller.arm.hand_mut().suck(&mut controller.shared.context(peer), param)
    })
    .of(has_hand)
    .accepts("[power, on]: 0 to 100 percent, BOOL or a number"),
    command("HandHoldState", |_, _, _| Answer::of(false)).of(has_hand),
    command("HandStop", |controller, _, _| {
        let now = controller.shared.now;
        let stopped = controller.arm.hand_mut().stop(HResult::E_ABORT, now, &mut controller.shared.waits);
        Ok(Answer::done_if(stopped))
    })
    .of(has_hand),
    command("HandCurPos", |controller, _, _| Answer::of(controller.hand_position())).of(has_hand),
    command("HandCurLoad", |_, _, _| Answer::of(0.0)).of(has_hand),
    Command::missing("SetAutoMode"),
];

const SYNC: &str = "nothing, or one number: 0, answer at once, or 1, answer when tasks and robot rest";

/// The number of an unknown client in the logs.
const UNKNOWN_CLIENT: i32 = -1;

/// Iterates over the names of the commands that a model has.
pub(super) fn names(functions: Functions) -> impl Iterator<Item = &'static str> {
    COMMANDS.iter().filter(move |command| command.exists(functions)).map(|command| command.name)
}

/// The bits of SysState, by their numbers. Other bits are never set: 16 (program start reset) and 24 (command
/// processing complete), because no source says when, and the reserved bits.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SysStateBit {
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
    /// The battery is exhausted, as a scenario says.
    Battery = 6,
    /// The robot warns, as a scenario says.
    Warning = 7,
    /// A task that is stopped within its cycle can continue.
    ContinueStart = 8,
    /// The emergency stop is pressed.
    EmergencyStop = 10,
    /// Auto mode is enabled; always.
    AutoEnable = 11,
    /// The protective stop is active, as a scenario says.
    ProtectiveStop = 12,
    /// The robot brakes for Halt.
    Stopping = 13,
    /// The arm is calibrated; always, except for a COBOTTA before AutoCal.
    Calibrated = 17,
    /// Manual or teach check mode.
    Manual = 18,
    /// A task has completed the one cycle for which it was started, and was not started again.
    CycleComplete = 19,
    /// The robot moves, by its commands.
    Moving = 20,
    /// The robot moves, by its encoders; here always the same.
    EncoderMoving = 21,
}

impl Controller {
    /// Removes the errors, even during an emergency stop. An error of level 5 cannot be removed, and is the answer.
    pub(super) fn clear_error(&mut self, peer: PeerId) -> Answered {
        self.arm.preparation().check_manual_reset(&self.shared.context(peer))?;
        self.clear_errors(self.shared.now);
        Ok(self.shared.errors.lasting().map_or(Answer::Done, Answer::Code))
    }

    /// Stops all tasks, and waits until tasks and robot rest if `param` says so.
    fn stop_all(&mut self, param: &Variant<'_>, stop: fn(&mut Tasks, Instant)) -> Answered {
        let waits = synchronous(param)?;
        stop(&mut self.tasks, self.shared.now);
        self.free_arm_of_tasks();
        self.record_operation("all tasks stopped");
        Ok(match (waits, self.tasks.iter().any(Task::is_running), self.is_moving()) {
            (true, true, _) => Answer::Until(Wait::Tasks),
            (true, false, true) => Answer::Until(Wait::Rest),
            _ => Answer::Done,
        })
    }

    /// Returns a fact about the controller. Minutes are those since it was switched on; the times of programs are not counted.
    fn system_info(&self, number: i32) -> Answered {
        let Shared { config, panel, now, .. } = &self.shared;
        let minutes = i32::try_from(now.as_micros() / 60_000_000).unwrap_or(i32::MAX);
        let kinds = [Kind::I, Kind::F, Kind::D, Kind::V, Kind::P, Kind::J, Kind::T, Kind::S];
        match number {
            0 => Answer::of(&config.serial_number),
            // no network card
            1 => Answer::of("00:00:00:00:00:00"),
            3 => Answer::of(kinds.map(|kind| i32::from(config.sizes.of(kind)))),
            // maintainer
            5 => Answer::of(3000),
            8 | 10 | 12 => Answer::of(minutes),
            14 => Answer::of(self.arm.robot().motor_starts()),
            // -1 when the date of the encoders' battery has passed
            15 => Answer::of(if panel.battery_low { -1 } else { 0 }),
            // no pendant, an unknown processor, no supervisory tasks, no panel
            2 | 4 | 6 | 7 | 9 | 11 | 13 | 16 => Answer::of(0),
            _ => Err(HResult::E_INVALIDARG),
        }
    }

    /// Describes a code, with the last call that it refused.
    fn describe(&self, code: HResult) -> String {
        match self.refusals.last(code) {
            Some(refusal) => format!("{} Last refused: {refusal}", description(code)),
            None => description(code),
        }
    }

    /// Returns the bits of SysState.
    fn system_state(&self) -> i32 {
        let panel = self.shared.panel;
        let running = self.tasks.iter().any(Task::is_running);
        let bits = [
            (SysStateBit::Running as u32, running),
            (SysStateBit::Error as u32, self.shared.errors.code().is_err()),
            (SysStateBit::ServoOn as u32, self.motor_is_on()),
            (SysStateBit::Initialized as u32, true),
            (SysStateBit::Auto as u32, panel.is_auto()),
            (SysStateBit::TokenOutside as u32, panel.token != Token::TeachPendant),
            (SysStateBit::Battery as u32, panel.battery_low),
            (SysStateBit::Warning as u32, panel.warning),
            (SysStateBit::ContinueStart as u32, self.tasks.iter().any(Task::can_continue)),
            (SysStateBit::EmergencyStop as u32, panel.emergency_stop),
            (SysStateBit::AutoEnable as u32, true),
            (SysStateBit::ProtectiveStop as u32, panel.protective_stop),
            (SysStateBit::Stopping as u32, self.arm.robot().is_halting()),
            (SysStateBit::Calibrated as u32, self.arm.preparation().is_calibrated()),
            (SysStateBit::Manual as u32, !panel.is_auto()),
            (SysStateBit::CycleComplete as u32, self.tasks.iter().any(Task::has_completed)),
            (SysStateBit::Moving as u32, self.is_moving()),
            (SysStateBit::EncoderMoving as u32, self.is_moving()),
        ];
        bits.iter().filter(|(_, on)| *on).fold(0, |state, (bit, _)| state | 1 << bit)
    }
}

fn manual_reset(controller: &mut Controller, peer: PeerId, _: &Variant<'_>) -> Answered {
    controller.arm.preparation_mut().manual_reset(&mut controller.shared.context(peer))
}

fn count(n: usize) -> Answered {
    Answer::of(i32::try_from(n).unwrap_or(i32::MAX))
}

/// Returns the 15 places of an entry of the error log.
fn log_entry(config: &Config, entry: &Occurrence) -> Answered {
    let (code, time) = (entry.error.code, civil_time(config, entry.error.at)?);
    let (program, line) = place_of(entry);
    let mut items: Vec<&dyn Encode> = vec![&code.0];
    items.extend(time.each_ref().map(|part| part as &dyn Encode));
    let (message, origin) = (description(code), entry.origin as i32);
    items.extend([&program as &dyn Encode, &line, &message, &code.0, &origin]);
    Answer::of(items)
}

/// Returns the 12 places of an entry of the log of operations.
fn operation(config: &Config, entry: &Operation) -> Answered {
    let [year, month, weekday, day, hour, minute, second, milli, tick] = civil_time(config, entry.at)?;
    let items: [&dyn Encode; 12] =
        [&0, &year, &month, &weekday, &day, &hour, &minute, &second, &milli, &tick, &UNKNOWN_CLIENT, &entry.text];
    Answer::of(items)
}

/// Returns year, month, day of the week (0 Sunday), day, hour, minute, second, millisecond and tick of a time.
fn civil_time(config: &Config, at: Instant) -> Result<[i32; 9], HResult> {
    let time = config.date(at)?.to_civil().ok_or(HResult::DISP_E_OVERFLOW)?;
    let weekday = config.weekday(at);
    let [month, day, hour] = [time.month, time.day, time.hour].map(i32::from);
    let [minute, second, milli] = [time.minute.into(), time.second.into(), time.millisecond.into()];
    // the tick wraps as a counter of 32 bits does
    let tick = (at.as_micros() / 1000) as i32;
    Ok([time.year.into(), month, weekday, day, hour, minute, second, milli, tick])
}

/// Reads whether a command answers after its effect.
fn synchronous(param: &Variant<'_>) -> Result<bool, HResult> {
    match numbers(param)?.as_slice() {
        [] | [0.0] => Ok(false),
        [1.0] => Ok(true),
        _ => Err(HResult::E_INVALIDARG),
    }
}

fn element<'v>(param: &Variant<'v>, place: usize) -> Option<Variant<'v>> {
    match param.flatten() {
        Variant::Array(array) => array.get(place).map(|item| item.flatten()),
        _ => None,
    }
}

/// Reads the task, the name and optionally the index of a public variable, from this place of the parameter on.
fn public_value(param: &Variant<'_>, from: usize) -> Result<(String, String, Option<usize>), HResult> {
    let text = |place| match element(param, place) {
        Some(Variant::Bstr(text)) => Ok(text.to_string().trim().to_owned()),
        _ => Err(HResult::E_INVALIDARGTYPE),
    };
    let index =
        element(param, from + 2).map(|index| usize::try_from(one_int(&index)?).map_err(|_| HResult::DISP_E_BADINDEX));
    if element(param, from + 3).is_some() {
        return Err(HResult::E_INVALIDARG);
    }
    Ok((text(from)?, text(from + 1)?, index.transpose()?))
}

/// Returns the program and the line at which an error has occurred; nothing and 0 outside of tasks.
fn place_of(entry: &Occurrence) -> (&str, i32) {
    entry.place.as_ref().map_or(("", 0), |place| (place.program.as_str(), place.line))
}

/// Reads the code of GetErrorDescription: I4, UI4, ERROR, or another integer.
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

fn error_info(config: &Config, entry: &Occurrence) -> Answered {
    let ErrorEntry { code, at } = entry.error;
    let (program, line) = place_of(entry);
    Answer::of((code.0, description(code), code.0, line, program, line, 0, config.date(at)?))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::table::assert_documented;

    #[test]
    fn every_command_is_documented() {
        let sources = [include_str!("controller_execute.rs"), include_str!("../hand.rs")];
        assert_documented(COMMANDS, &sources);
    }
}
