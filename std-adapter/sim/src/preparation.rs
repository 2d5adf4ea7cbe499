//! What a COBOTTA needs before it moves; other models are always ready.
//!
//! ```text
//!   ManualResetPreparation ──► ClearError, ManualReset or MotionPreparation      one of them, then it is used up
//!                              MotionPreparation ──► Motor, on                   until the next emergency stop
//! ```
//!
//! | command of the robot      | parameter | answer                                                            |
//! |---------------------------|-----------|-------------------------------------------------------------------|
//! | ManualResetPreparation    | -         | EMPTY; the controller has it as well                              |
//! | MotionPreparation         | -         | EMPTY; torque is back; `E_ACCESSDENIED` in emergency stop         |
//! | GetMotionPreparationState | -         | BOOL                                                              |
//! | AutoCal                   | -         | EMPTY; the bit of SysState is set, which is clear before          |
//!
//! Without the first, the three commands behind it answer `E_MANUAL_RESET_UNPREPARED`; without the second, the motor is
//! refused with `E_MOTION_UNPREPARED`. MotionPreparation and AutoCal need what every motion needs, but for the arm and
//! the motor. That order and those two codes are seen in public clients; how long a preparation lasts is this model's
//! own. AutoCal takes no time and moves nothing: this arm always knows where it is.

use bcap_core::handler::PeerId;
use bcap_core::hresult::HResult;

use crate::config::Profile;
use crate::controller::Controller;
use crate::dispatch::Answered;
use crate::value::Value;

/// How far the preparation has come.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Preparation {
    /// The next command that concerns safety may come.
    manual_reset: bool,
    /// The motor may be switched on.
    pub(crate) motion: bool,
    pub(crate) calibrated: bool,
}

impl Preparation {
    pub(crate) const fn new(profile: Profile) -> Self {
        let ready = !profile.wants_preparation();
        Self { manual_reset: ready, motion: ready, calibrated: ready }
    }
}

impl Controller {
    /// Executes a command of the preparation; `None` for another one, or when this model has none.
    pub(crate) fn preparation_command(&mut self, peer: PeerId, command: &str) -> Option<Answered> {
        if !self.config().profile.wants_preparation() {
            return None;
        }
        Some(match command.to_ascii_lowercase().as_str() {
            "manualresetpreparation" => {
                self.preparation.manual_reset = true;
                Ok(Value::Empty.into())
            }
            "motionpreparation" => self.prepare_motion(peer),
            "getmotionpreparationstate" => Ok(Value::Bool(self.preparation.motion).into()),
            "autocal" => self.may_execute(peer).map(|()| {
                self.preparation.calibrated = true;
                Value::Empty.into()
            }),
            _ => return None,
        })
    }

    fn prepare_motion(&mut self, peer: PeerId) -> Answered {
        self.may_execute(peer)?;
        if self.emergency_stopped() {
            return Err(HResult::E_ACCESSDENIED);
        }
        self.use_manual_reset()?;
        self.preparation.motion = true;
        self.torque_off = false;
        Ok(Value::Empty.into())
    }

    /// Checks that a command may come that concerns safety, and uses the preparation for it up.
    pub(crate) fn use_manual_reset(&mut self) -> Result<(), HResult> {
        if !self.config().profile.wants_preparation() {
            return Ok(());
        }
        match std::mem::take(&mut self.preparation.manual_reset) {
            true => Ok(()),
            false => Err(self.refuse(HResult::E_MANUAL_RESET_UNPREPARED)),
        }
    }

    /// Forgets that the motion was prepared.
    pub(crate) fn unprepare(&mut self) {
        self.preparation.motion = !self.config().profile.wants_preparation();
    }
}
