//! The preparation that a COBOTTA needs before it moves, and the torque that the emergency stop of an RC9 or a COBOTTA
//! removes.
//!
//! ```text
//!   ManualResetPreparation --> ClearError, ManualReset, MotionPreparation     until the next emergency stop
//!                              MotionPreparation --> Motor, on                until the next emergency stop
//! ```
//!
//! | command of the robot      | parameter | answer                                                            |
//! |---------------------------|-----------|-------------------------------------------------------------------|
//! | ManualResetPreparation    | -         | EMPTY; also a command of the controller                           |
//! | MotionPreparation         | -         | EMPTY; torque is back                                             |
//! | GetMotionPreparationState | -         | BOOL                                                              |
//! | AutoCal                   | -         | EMPTY; sets the bit "calibrated" of SysState                      |
//!
//! Without ManualResetPreparation, the three commands after it answer `E_MANUAL_RESET_UNPREPARED`. Without
//! MotionPreparation, Motor answers `E_MOTION_UNPREPARED`. Both need Auto mode and a released emergency stop; AutoCal also
//! needs that no error is present. Public clients show this order and the two codes, and that ClearError may follow
//! MotionPreparation; that an emergency stop ends a preparation is a decision of this model. AutoCal takes no time and moves
//! nothing.
//!
//! Before version 2.8.0, the three commands need no ManualResetPreparation, which answers `E_INVALIDARG`: programs of 2021 and
//! 2022 sent none. A person can also prepare the arm: `prepared` of a [scenario](crate::scenario).
//!
//! Other models do not have these commands and need no preparation.

use bcap_core::hresult::HResult;

use crate::answer::{Answer, Answered};
use crate::codes::{EMERGENCY_STOP, RESET_IN_EMERGENCY_STOP};
use crate::config::Config;
use crate::context::Context;
use crate::model::Functions;
use crate::rules;

/// The steps of the preparation that are done.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Preparation {
    /// The commands that concern safety may be executed.
    manual_reset: bool,
    /// The motor may be switched on.
    motion: bool,
    calibrated: bool,
    /// RC9, COBOTTA: torque is off since an emergency stop.
    torque_off: bool,
}

impl Preparation {
    pub(crate) const fn new(functions: Functions) -> Self {
        let ready = !functions.preparation;
        Self { manual_reset: ready, motion: ready, calibrated: ready, torque_off: false }
    }

    pub(crate) const fn is_calibrated(self) -> bool {
        self.calibrated
    }

    /// Returns whether MotionPreparation is done.
    pub(crate) const fn is_motion_ready(self) -> bool {
        self.motion
    }

    pub(crate) const fn is_torque_off(self) -> bool {
        self.torque_off
    }

    /// Records that the emergency stop was pressed.
    pub(crate) const fn emergency_stop(&mut self, functions: Functions) {
        self.torque_off = functions.safe_torque_off;
        self.motion = !functions.preparation;
        self.manual_reset = !functions.preparation;
    }

    /// Makes the motor ready to be switched on.
    pub(crate) const fn complete(&mut self) {
        (self.motion, self.torque_off) = (true, false);
    }

    /// Does all steps, as a person does at the arm.
    pub(crate) const fn complete_all(&mut self) {
        self.manual_reset = true;
        self.complete();
    }

    /// Executes ManualResetPreparation.
    pub(crate) fn prepare_reset(&mut self, config: &Config) -> Answered {
        if !needs_manual_reset(config) {
            return Err(HResult::E_INVALIDARG);
        }
        self.manual_reset = true;
        Ok(Answer::Done)
    }

    /// Executes MotionPreparation.
    pub(crate) fn prepare_motion(&mut self, ctx: &mut Context<'_>) -> Answered {
        if ctx.panel.emergency_stop {
            return Err(EMERGENCY_STOP);
        }
        ctx.may(&rules::MOTION_PREPARATION)?;
        self.check_manual_reset(ctx)?;
        self.complete();
        ctx.record("motion preparation");
        Ok(Answer::Done)
    }

    /// Executes AutoCal.
    pub(crate) fn calibrate(&mut self, ctx: &mut Context<'_>) -> Answered {
        ctx.may(&rules::CALIBRATION)?;
        self.calibrated = true;
        ctx.record("calibration");
        Ok(Answer::Done)
    }

    /// Executes ManualReset.
    pub(crate) fn manual_reset(&mut self, ctx: &mut Context<'_>) -> Answered {
        if ctx.panel.emergency_stop {
            return Err(RESET_IN_EMERGENCY_STOP);
        }
        self.check_manual_reset(ctx)?;
        self.torque_off = false;
        ctx.record("manual reset");
        Ok(Answer::Done)
    }

    /// Checks that a command that concerns safety may be executed.
    pub(crate) fn check_manual_reset(&self, ctx: &Context<'_>) -> Result<(), HResult> {
        match self.manual_reset || !needs_manual_reset(ctx.config) {
            true => Ok(()),
            false => Err(HResult::E_MANUAL_RESET_UNPREPARED),
        }
    }
}

/// Returns whether the model and its version have ManualResetPreparation.
fn needs_manual_reset(config: &Config) -> bool {
    config.model.functions.preparation && config.version_is_from(&[2, 8, 0])
}
