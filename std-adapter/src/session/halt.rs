//! Halting the robot even while a task owns the arm.

use std::io;
use std::time::Duration;

use bcap_core::io::asynch::Transport;
use bcap_core::procedure::{self, HaltAnswer, HaltConfig};

use super::{Halted, ROBOT, Session};
use crate::error::Error;

/// The maximum time until the robot is at rest after a stop was answered.
const REST: Duration = Duration::from_secs(1);

impl<X: Transport<Error = io::Error>> Session<X> {
    /// Halts the robot, stops the tasks if the controller refuses that, and verifies that the robot rests.
    ///
    /// [`halt`](Self::halt) makes one call only, for motions of this session.
    pub(crate) async fn halt_and_verify(&mut self) -> Result<Halted, Error> {
        let handles = self.handles().await?;
        let halt = self.run(ROBOT, procedure::halt(handles, HaltConfig::within(REST))).await?;
        if !halt.is_halted() {
            return Err(Error::NotHalted(halt));
        }
        self.set_moving(false);
        Ok(match (halt.tasks, halt.answer) {
            (Some(tasks), _) => Halted::TasksStopped(tasks),
            (None, HaltAnswer::NothingMoved) => Halted::NothingMoved,
            (None, _) => Halted::Halted,
        })
    }
}
