//! The end of a case: leaves the device as it was before.

use std::time::{Duration, Instant};

use bcap_core::bcap::FunctionId;
use bcap_core::hresult::HResult;
use bcap_testkit::frame::TestFrame;
use bcap_testkit::value::Value;

use crate::bench::{Bench, Stop, fail};
use crate::language::{Arg, Level, Setup, Slot, Want};
use crate::reply::{Came, request_text};

/// The maximum duration of a turn of an axis at the slow speed of cases.
const TURN: Duration = Duration::from_secs(60);

/// The parameter of TakeArm without a group, and of Motor to switch it off.
fn zeros() -> Value {
    Value::Array(3, vec![Value::I4(0); 2])
}

impl<'a> Bench<'a> {
    /// Leaves the device as it was: halts, ends Slave Mode, turns the axis back, gives the arm back, stops the task, restores
    /// variables. Every part is done even if another part fails.
    pub(crate) fn clean_up(&mut self) -> Result<(), Stop> {
        let armed = if self.armed { self.disarm() } else { Ok(()) };
        if self.wire.is_some() {
            // the connection may have ended as part of the case
            self.attempt(FunctionId::SERVICE_STOP, Vec::new(), self.options.timeout);
        }
        self.close();
        let stopped = if self.task_started { self.stop_task() } else { Ok(()) };
        let mut restored = Ok(());
        for (name, value) in std::mem::take(&mut self.saved) {
            restored = restored.and(self.restore(&name, value));
        }
        self.clear_own_errors();
        armed.and(stopped).and(restored)
    }

    /// Clears the errors of the controller, if calls of this case have caused all of them. Below level `motion` nothing is
    /// cleared, because the necessary commands change the state of the controller and the robot.
    fn clear_own_errors(&mut self) {
        let caused = std::mem::take(&mut self.caused);
        if caused.is_empty() || self.options.level < Level::Motion {
            return;
        }
        // a device without errors, or that does not answer, is left as it is
        let _ = self.another_connection().setup_and(Setup::Robot, |other| {
            let count = other.controller_command("GetCurErrorCount", Value::Empty)?;
            let count = if let Some(Value::I4(count)) = count.value() { *count } else { 0 };
            for index in 0..count {
                let info = other.controller_command("GetCurErrorInfo", Value::I4(index))?;
                let is_own = match info.value() {
                    Some(Value::Array(_, places)) => {
                        matches!(places.first(), Some(Value::I4(code)) if caused.contains(&HResult(*code)))
                    }
                    _ => false,
                };
                if !is_own {
                    return Ok(());
                }
            }
            if count > 0 {
                // a COBOTTA needs it; other models do not have it
                other.robot_command_at_end("ManualResetPreparation", Value::Empty);
                other.controller_command("ClearError", Value::Empty)?;
            }
            Ok(())
        });
    }

    fn controller_command(&mut self, command: &str, value: Value) -> Result<TestFrame, Stop> {
        let handle = self.argument(&Arg::H(Slot::Controller))?;
        self.exchange(FunctionId::CONTROLLER_EXECUTE, vec![handle, Value::text(command), value])
    }

    /// Halts the robot and gives the arm back.
    fn disarm(&mut self) -> Result<(), Stop> {
        self.armed = false;
        // the session of the case may wait for the reply of a motion
        let halted = self.another_connection().setup_and(Setup::Robot, |other| {
            let handle = other.argument(&Arg::H(Slot::Robot))?;
            Ok(other.attempt(FunctionId::ROBOT_HALT, vec![handle, Value::text("")], other.options.timeout))
        });
        if !matches!(halted, Ok(Some(_))) {
            self.robot(FunctionId::ROBOT_HALT, vec![Value::text("")]);
        }
        if self.robot_command_at_end("slvChangeMode", Value::I4(0)).is_none() {
            self.take_arm_again();
        }
        // the halt of a motion is an error too
        self.caused.push(HResult::E_MOTION_STOPPED);
        self.clear_own_errors();
        let turned = self.turn_back();
        self.restore_speed();
        self.robot_command_at_end("Motor", zeros());
        self.robot_command_at_end("GiveArm", Value::Empty);
        turned.and(match self.speed {
            Some(speed) => fail(format!("the external speed is restored to {speed:?}"), "ExtSpeed fails"),
            None => Ok(()),
        })
    }

    /// Opens a session for the rest, if the session of the case has ended. The controller has released the arm then.
    fn take_arm_again(&mut self) {
        if self.setup(Setup::Robot).is_ok() {
            self.robot_command_at_end("TakeArm", zeros());
        }
    }

    /// Turns back the axis that the case has turned, but not after an interruption.
    fn turn_back(&mut self) -> Result<(), Stop> {
        let Some(back) = self.way_back.take() else { return Ok(()) };
        if self.was_interrupted() {
            return Ok(());
        }
        let handle = self.argument(&Arg::H(Slot::Robot))?;
        match self.attempt(FunctionId::ROBOT_EXECUTE, vec![handle, Value::text("DriveAEx"), back], TURN) {
            Some(code) if code.is_ok() => Ok(()),
            Some(code) => fail("axis 6 is turned back", format!("axis 6 is not turned back: {code}")),
            None => fail("axis 6 is turned back", "axis 6 is not turned back: no reply"),
        }
    }

    /// Restores the external speed.
    fn restore_speed(&mut self) {
        let Some(speed) = self.speed else { return };
        let speed = Value::Array(5, speed.map(|percent| Value::R8(percent.to_bits())).into());
        let code = self.robot_command_at_end("ExtSpeed", speed);
        if code.is_some_and(HResult::is_ok) {
            self.speed = None;
        }
    }

    /// Stops the task over a separate session.
    fn stop_task(&mut self) -> Result<(), Stop> {
        self.task_started = false;
        let stopped = self.another_connection().setup_and(Setup::Task, |other| {
            let args = [Arg::H(Slot::Task), Arg::I(1), Arg::S("")];
            let args = args.iter().map(|arg| other.argument(arg)).collect::<Result<Vec<_>, _>>()?;
            Ok(other.attempt(FunctionId::TASK_STOP, args, other.options.timeout))
        });
        match stopped {
            // a device without the task has not started it
            Ok(Some(_)) | Err(Stop::Skip(_)) => Ok(()),
            _ => fail(format!("the task {} is stopped", self.options.task), "Task_Stop is not answered"),
        }
    }

    /// Returns another connection to the device.
    fn another_connection(&self) -> Self {
        Self::new(self.options, self.link)
    }

    fn setup_and<T>(mut self, setup: Setup, then: impl FnOnce(&mut Self) -> Result<T, Stop>) -> Result<T, Stop> {
        self.setup(setup)?;
        let result = then(&mut self);
        self.attempt(FunctionId::SERVICE_STOP, Vec::new(), self.options.timeout);
        result
    }

    /// Calls a function of the robot as part of the end; returns its code.
    fn robot(&mut self, function: FunctionId, args: Vec<Value>) -> Option<HResult> {
        let handle = self.argument(&Arg::H(Slot::Robot)).ok()?;
        self.attempt(function, std::iter::once(handle).chain(args).collect(), self.options.timeout)
    }

    fn robot_command_at_end(&mut self, command: &str, value: Value) -> Option<HResult> {
        self.robot(FunctionId::ROBOT_EXECUTE, vec![Value::text(command), value])
    }

    /// Makes a call, skips replies to other calls, and returns the code; `None` without a reply.
    pub(crate) fn attempt(&mut self, function: FunctionId, args: Vec<Value>, limit: Duration) -> Option<HResult> {
        let (serial, bytes) = self.request(function, &args);
        self.send(&bytes, &request_text(serial, function, &args)).ok()?;
        let until = Instant::now() + limit;
        loop {
            let left = until.saturating_duration_since(Instant::now());
            match self.receive_within(left) {
                Came::Reply(reply) if reply.serial == serial && reply.result() != HResult::S_EXECUTING => {
                    return Some(reply.result());
                }
                Came::Closed | Came::Nothing => return None,
                _ if left.is_zero() => return None,
                Came::Reply(_) | Came::Invalid(_) => {}
            }
        }
    }

    fn restore(&mut self, name: &str, value: Value) -> Result<(), Stop> {
        self.setup(Setup::Controller)?;
        let variable = self.variable(name)?;
        let reply = self.exchange(FunctionId::VARIABLE_PUT_VALUE, vec![variable, value])?;
        self.check(FunctionId::VARIABLE_PUT_VALUE, &reply, Want::Ok, crate::device::Refusals::Fail)?;
        self.attempt(FunctionId::SERVICE_STOP, Vec::new(), self.options.timeout);
        self.close();
        Ok(())
    }
}
