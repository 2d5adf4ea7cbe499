//! Examining and recovering a robot, and preparing a COBOTTA.

use std::io;
use std::ops::ControlFlow;

use bcap_core::hresult::HResult;
use bcap_core::io::asynch::Transport;
use bcap_core::procedure::{self, Examination, NotRecovered, Recovered, RecoveryConfig, RecoveryStep, StepCause};

use super::arm::ArmState;
use super::{ROBOT, Session};
use crate::RunError;
use crate::error::Error;

impl<X: Transport<Error = io::Error>> Session<X> {
    /// Reads the state of the robot and its controller.
    pub(crate) async fn examine(&mut self) -> Result<Examination, Error> {
        let handles = self.handles().await?;
        self.run(ROBOT, procedure::examine(handles)).await
    }

    /// Recovers the robot, or prepares its motion without a configuration. The arm is taken afterwards.
    pub(crate) async fn make_ready(
        &mut self,
        config: Option<RecoveryConfig>,
        mut observe: impl FnMut(RecoveryStep, Result<(), HResult>) -> ControlFlow<()>,
    ) -> Result<(), Error> {
        let handles = self.handles().await?;
        let before = self.arm;
        self.count_take();
        // recorded before the calls, so that they are undone even if the procedure is abandoned
        self.arm = if before.taken { during(before) } else { ArmState { taken: true, ..before } };
        let arm = &mut self.arm;
        let observe = |step, result: Result<(), HResult>| {
            if step == RecoveryStep::TakeArm && result.is_ok() {
                *arm = during(*arm);
            }
            observe(step, result)
        };
        let ended = match config {
            Some(config) => self.connection.run(procedure::recover(handles, config, observe)).await,
            None => self.connection.run(procedure::prepare(handles, observe)).await,
        };
        self.observe(ended.as_ref().err().and_then(|error| error.call.as_ref()));
        match ended {
            Ok(Recovered { motor_on, .. }) => {
                self.arm = ArmState { taken: true, motor: before.motor || motor_on, ..before };
                Ok(())
            }
            Err(error) => self.not_ready(before, error).await,
        }
    }

    async fn not_ready(&mut self, before: ArmState, mut error: RunError<NotRecovered>) -> Result<(), Error> {
        let NotRecovered { step, error: failed, .. } = error.error;
        if !failed.unsettled || step == RecoveryStep::Examine {
            self.arm = before;
        } else if self.link.lost.is_none() && !before.taken {
            // the procedure could not undo all of it
            error.error.error.unsettled = !self.undo_rest().await;
        }
        match failed.cause {
            StepCause::Failed(_) => self.ended(step.name(), Err(error.map(|error| error.error))),
            _ => Err(Error::NotRecovered(error.error)),
        }
    }
}

/// Returns the possible effects while the procedure has the arm.
const fn during(arm: ArmState) -> ArmState {
    ArmState { taken: true, motor: true, moving: true, ..arm }
}
