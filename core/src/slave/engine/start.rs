//! The start of a stream: from the query of the mode to Slave Mode, with the position of the robot; and a restart.

use super::{EMERGENCY_STOP, Engine, Phase};
use crate::bcap::{Properties, StreamState};
use crate::hresult::HResult;
use crate::slave::call::Step;
use crate::slave::fault::Cause;
use crate::slave::mode::PoseType;
use crate::slave::pacer::Pacer;
use crate::slave::pose::{Delta, ExtendedAxes, Pose, half_turn};
use crate::time::Instant;
use crate::variant::Variant;

impl<const N: usize> Engine<N> {
    pub(super) fn handle_start(&mut self, code: HResult, value: Variant<'_>, now: Instant) {
        if self.step == Step::GetMode {
            let state = StreamState::from_reply(code, value.as_i32());
            if !state.allows(Properties::UNKNOWN) {
                return self.fail(Cause::Occupied(state));
            }
        } else if code.is_err() {
            if code == HResult::E_TIMEOUT {
                // the controller has abandoned the call, which may still run
                self.record_unsure();
            }
            return self.fail(Cause::Refused(code));
        }
        let done = match self.step {
            Step::TakeArm => {
                self.has_arm = true;
                Ok(())
            }
            Step::Motor => {
                self.has_motor = true;
                Ok(())
            }
            Step::Position => self.take_position(value),
            Step::Joints => self.take_joints(value),
            _ => Ok(()),
        };
        if let Err(cause) = done {
            return self.fail(cause);
        }
        if self.step == Step::Enter {
            return self.begin_stream(now);
        }
        if self.stop_wanted {
            return self.release(None);
        }
        self.step = self.next_start();
        if self.step == Step::Enter
            && let Err(cause) = self.check_start()
        {
            self.fail(cause);
        }
    }

    fn next_start(&self) -> Step {
        let config = &self.config;
        let extended = config.format.extended != ExtendedAxes::None && config.format.mode.pose != PoseType::J;
        match self.step {
            Step::GetMode => Step::SendFormat,
            Step::SendFormat => Step::ReceiveFormat,
            Step::ReceiveFormat if config.arm.is_some() => Step::TakeArm,
            Step::ReceiveFormat | Step::TakeArm if config.motor => Step::Motor,
            Step::ReceiveFormat | Step::TakeArm | Step::Motor => Step::Position,
            Step::Position if extended => Step::Joints,
            _ => Step::Enter,
        }
    }

    /// Reads the position of the robot.
    fn take_position(&mut self, value: Variant<'_>) -> Result<(), Cause> {
        let pose = self.config.format.mode.pose;
        let mut numbers = [0.0; 10];
        let count = read_numbers(value, numbers.get_mut(..pose.len()).unwrap_or_default()).ok_or(Cause::NoValue)?;
        if pose == PoseType::J {
            // controllers may send any value for joints that the robot does not have
            let absent = numbers.iter_mut().skip(usize::from(self.config.joints));
            absent.filter(|number| !number.is_finite()).for_each(|number| *number = 0.0);
        }
        let at = Pose::from_numbers(pose, numbers.get(..count).unwrap_or_default()).ok_or(Cause::NoValue)?;
        let [.., j7, j8] = at.axes();
        self.set_position(at.with_axes(self.config.format.extended, j7, j8))
    }

    /// Reads the position of the extended joints.
    fn take_joints(&mut self, value: Variant<'_>) -> Result<(), Cause> {
        let mut numbers = [0.0; 8];
        read_numbers(value, &mut numbers).filter(|count| *count == numbers.len()).ok_or(Cause::NoValue)?;
        let [.., j7, j8] = numbers;
        self.set_position(self.last.with_axes(self.config.format.extended, j7, j8))
    }

    /// Records the position of the robot. Rejects NaN, which would pass every limit check.
    fn set_position(&mut self, pose: Pose) -> Result<(), Cause> {
        if !pose.is_finite() {
            return Err(Cause::NoValue);
        }
        self.last = pose;
        Ok(())
    }

    /// Compares the position of the robot with the start of the stream.
    fn check_start(&mut self) -> Result<(), Cause> {
        if let Some(start) = self.config.start.filter(|_| !self.restarted) {
            if let Some((number, actual, expected)) = self.off_start(&start) {
                return Err(Cause::NotAtStart { number, actual, expected });
            }
            self.last = start;
        }
        self.start = Some(self.last);
        Ok(())
    }

    /// Finds the first number of the start that differs from the robot's by more than the tolerance.
    fn off_start(&self, start: &Pose) -> Option<(u8, f64, f64)> {
        /// One degree in radians, the tolerance of a component of a unit vector per degree.
        const PER_DEGREE: f64 = core::f64::consts::PI / 180.0;
        let (pose, tolerance) = (self.config.format.mode.pose, self.config.tolerance);
        let joints = usize::from(self.config.joints);
        let own =
            start.numbers().iter().zip(self.last.numbers()).zip(1_u8..).find_map(|((expected, actual), number)| {
                let off = actual - expected;
                let missed = match (pose, number) {
                    (PoseType::P, 4..=6) => half_turn(off).abs() > tolerance,
                    // a negative Fig stands for any figure
                    (PoseType::P, 7) | (PoseType::T, 10) => off != 0.0 && *expected >= 0.0 && *actual >= 0.0,
                    (PoseType::T, 4..=9) => off.abs() > tolerance * PER_DEGREE,
                    (PoseType::J, _) if usize::from(number) > joints => false,
                    _ => off.abs() > tolerance,
                };
                missed.then_some((number, *actual, *expected))
            });
        let extended = || {
            let axes = start.axes().into_iter().zip(self.last.axes()).zip(1_u8..).skip(6);
            let (seven, eight) = self.config.format.extended.has();
            let wanted = |number: u8| (number == 7 && seven) || (number == 8 && eight);
            axes.filter(|(_, number)| wanted(*number))
                .find(|((expected, actual), _)| (actual - expected).abs() > tolerance)
                .map(|((expected, actual), number)| (number, actual, expected))
        };
        own.or_else(extended)
    }

    fn begin_stream(&mut self, now: Instant) {
        self.phase = Phase::Streaming;
        self.may_be_in_mode = true;
        self.may_move = true;
        self.step = Step::Move;
        self.pacer = Pacer::new(now);
        self.delta = Delta::ZERO;
        self.velocity = [0.0; 8];
        self.received = None;
        if self.stop_wanted {
            self.leave();
        }
    }

    pub(super) fn handle_recovery(&mut self, code: HResult, value: Variant<'_>) {
        if self.step == Step::GetMode {
            let state = StreamState::from_reply(code, value.as_i32());
            // a stream that this engine could not leave is not another client's
            if !self.may_be_in_mode && !state.allows(Properties::UNKNOWN) {
                return self.fail(Cause::Occupied(state));
            }
            self.step = Step::SystemState;
            return;
        }
        if code.is_err() {
            return self.fail(Cause::Refused(code));
        }
        if self.step == Step::SystemState {
            return match value.as_i32() {
                Some(bits) if bits & EMERGENCY_STOP != 0 => self.fail(Cause::EmergencyStop),
                Some(_) => self.step = Step::ClearError,
                None => self.fail(Cause::NoValue),
            };
        }
        self.fault = None;
        self.restarted = true;
        self.phase = Phase::Starting;
        self.step = Step::GetMode;
    }
}

/// Reads an array of numbers into `target`, up to the shorter length, and returns their count.
fn read_numbers(value: Variant<'_>, target: &mut [f64]) -> Option<usize> {
    let array = value.as_array()?;
    for (slot, element) in target.iter_mut().zip(array) {
        *slot = element.as_f64()?;
    }
    Some(array.len().min(target.len()))
}
