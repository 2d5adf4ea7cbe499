//! The calls of an engine.

use super::command::MoveCall;
use super::config::Config;
use super::mode::{PoseType, SlaveMode};
use crate::bcap::call::{Any, Call};
use crate::bcap::{FrameWriter, FunctionId};
use crate::error::EncodeError;
use crate::procedure::{Channel, Handles};
use crate::variant::Encode;

/// A step of the engine: the purpose of a call.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum Step {
    /// slvSendFormat.
    SendFormat,
    /// slvRecvFormat.
    ReceiveFormat,
    /// TakeArm.
    TakeArm,
    /// Motor, on.
    Motor,
    /// CurPos, CurJnt or CurTrn: the position of the robot.
    Position,
    /// CurJnt, for the extended joints of a P or T pose.
    Joints,
    /// slvChangeMode with the mode.
    Enter,
    /// slvMove.
    Move,
    /// slvChangeMode 0.
    Leave,
    /// Robot_Halt.
    Halt,
    /// Motor, off.
    MotorOff,
    /// GiveArm.
    GiveArm,
    /// slvGetMode.
    GetMode,
    /// GetCurErrorCount.
    ErrorCount,
    /// GetCurErrorInfo.
    ErrorInfo,
    /// SysState.
    SystemState,
    /// ClearError.
    ClearError,
}

impl Step {
    /// Returns the name of the command in the specification; for [`Position`](Self::Position), which has three, `CurPos`.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::SendFormat => "slvSendFormat",
            Self::ReceiveFormat => "slvRecvFormat",
            Self::TakeArm => "TakeArm",
            Self::Motor | Self::MotorOff => "Motor",
            Self::Halt => "Halt",
            Self::Position => "CurPos",
            Self::Joints => "CurJnt",
            Self::Enter | Self::Leave => "slvChangeMode",
            Self::Move => "slvMove",
            Self::GiveArm => "GiveArm",
            Self::GetMode => "slvGetMode",
            Self::ErrorCount => "GetCurErrorCount",
            Self::ErrorInfo => "GetCurErrorInfo",
            Self::SystemState => "SysState",
            Self::ClearError => "ClearError",
        }
    }

    /// Returns whether it is a command of the controller, not of the robot.
    const fn is_of_controller(self) -> bool {
        matches!(self, Self::ErrorCount | Self::ErrorInfo | Self::SystemState | Self::ClearError)
    }
}

/// A call of the engine, for a client or a connection.
#[derive(Clone, Copy, Debug)]
pub struct EngineCall<'a> {
    pub(super) step: Step,
    pub(super) channel: Channel,
    pub(super) handles: Handles,
    pub(super) config: &'a Config,
    pub(super) slv_move: MoveCall<'a>,
    /// For GetCurErrorInfo.
    pub(super) index: i32,
}

#[cfg(feature = "defmt")]
impl defmt::Format for EngineCall<'_> {
    fn format(&self, f: defmt::Formatter<'_>) {
        defmt::write!(f, "{} over {}", self.step, self.channel);
    }
}

impl EngineCall<'_> {
    /// Returns its purpose.
    #[must_use]
    pub const fn step(&self) -> Step {
        self.step
    }

    /// Returns the connection to use.
    #[must_use]
    pub const fn channel(&self) -> Channel {
        self.channel
    }

    fn name(&self) -> &'static str {
        match (self.step, self.config.format.mode.pose) {
            (Step::Position, PoseType::J) => "CurJnt",
            (Step::Position, PoseType::T) => "CurTrn",
            (step, _) => step.name(),
        }
    }

    fn parameter(&self, put: &mut dyn FnMut(&dyn Encode) -> Result<(), EncodeError>) -> Result<(), EncodeError> {
        let format = &self.config.format;
        match self.step {
            Step::SendFormat => put(&format.send.code()),
            Step::ReceiveFormat => put(&format.receive),
            Step::TakeArm => put(&self.config.arm.unwrap_or_default()),
            // on; the reply arrives when the motor is on
            Step::Motor => put(&[1, 0]),
            Step::MotorOff => put(&[0, 0]),
            Step::Enter => put(&format.mode.code()),
            Step::Leave => put(&SlaveMode::OFF),
            Step::ErrorInfo => put(&self.index),
            _ => put(&()),
        }
    }
}

impl Call for EngineCall<'_> {
    type Reply = Any;

    fn function(&self) -> FunctionId {
        match self.step {
            Step::Halt => FunctionId::ROBOT_HALT,
            step if step.is_of_controller() => FunctionId::CONTROLLER_EXECUTE,
            _ => FunctionId::ROBOT_EXECUTE,
        }
    }

    fn arguments(&self, frame: &mut FrameWriter<'_>) -> Result<(), EncodeError> {
        if self.step == Step::Move {
            return self.slv_move.arguments(frame);
        }
        if self.step == Step::Halt {
            frame.argument(&self.handles.robot)?;
            return frame.argument("");
        }
        if self.step.is_of_controller() {
            frame.argument(&self.handles.controller)?;
        } else {
            frame.argument(&self.handles.robot)?;
        }
        frame.argument(self.name())?;
        self.parameter(&mut |value| frame.argument(value))
    }

    #[inline]
    fn prepared(&self) -> Option<&[u8]> {
        (self.step == Step::Move).then_some(self.slv_move.frame)
    }
}
