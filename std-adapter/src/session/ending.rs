//! The end of a session that has taken the arm: the robot is halted, Slave Mode left, the motor off, and the arm free.
//!
//! ```text
//!  over its connection:                      slvChangeMode 0 ─► Robot_Halt ─► Motor 0 ─► GiveArm
//!  over the next connection:
//!   the controller has not noticed the loss  (slvChangeMode 0) ─► Robot_Halt ─► Motor 0
//!   it has, or had the time for it           TakeArm ─► Robot_Halt ─► Motor 0 ─► GiveArm
//!   a lost UDP link                          the first, then Service_Stop, then the second
//! ```
//!
//! Only effects of this session are ended: a session that neither took the arm nor switched the motor on halts and switches
//! nothing. The procedure [`reclaim`](procedure::reclaim) has the calls over the next connection.

use std::io;
use std::time::Duration;

use bcap_core::bcap::{Link, Object};
use bcap_core::hresult::HResult;
#[cfg(feature = "tokio")]
use bcap_core::io::asynch::Connection;
use bcap_core::io::asynch::Transport;
use bcap_core::procedure::{self, ArmOwner, Claim, Effects};
use bcap_core::time::Instant;

#[cfg(feature = "tokio")]
use super::arm::ArmId;
use super::arm::{ArmState, Left};
use super::{ROBOT, Release, Session};
use crate::CallError;
use crate::error::Error;
use crate::recovery::Recovery;

/// The time limit, and the interval, of retries while the controller executes an earlier call.
const BUSY_LIMIT: Duration = Duration::from_secs(5);
const BUSY_PAUSE: Duration = Duration::from_millis(10);
/// The time in which a controller ends the session of a connection that it has closed.
const NOTICE: Duration = Duration::from_millis(500);

/// Returns whether a call has definitely ended: it was executed or refused. E_TIMEOUT means that the controller abandoned the
/// call, which may still run.
const fn is_answered(ended: &Result<(), Error>) -> bool {
    match ended {
        Ok(()) => true,
        Err(Error::Refused { code, .. }) => !matches!(*code, HResult::E_TIMEOUT),
        Err(_) => false,
    }
}

/// Returns whether the controller refused a call because it executes another call of this client, or because the robot brakes.
const fn is_busy(ended: &Result<(), Error>) -> bool {
    matches!(ended, Err(Error::Refused { code: HResult::E_BUSY_PROC | HResult::E_ROBOTISBUSY, .. }))
}

impl<X: Transport<Error = io::Error>> Session<X> {
    /// Returns the session over another transport to the same peer, which `change` makes of this one.
    #[cfg(feature = "tokio")]
    pub(crate) fn over<Y: Transport<Error = io::Error>>(
        mut self,
        change: impl FnOnce(X) -> Option<Y>,
    ) -> Option<Session<Y>> {
        self.set_limit(None);
        let Self { connection, id, handle, robot_name, objects, arm, takes, keep, usual_timing, link } = self;
        let (transport, client) = connection.into_parts();
        let connection = Connection::new(change(transport)?, client);
        Some(Session { connection, id, handle, robot_name, objects, arm, takes, keep, usual_timing, link })
    }

    /// Returns, once, the effects that a lost session has left on the robot.
    pub(crate) fn take_left(&mut self) -> Option<Left> {
        let left = self.left();
        self.arm = ArmState::default();
        left
    }

    /// Returns the effects that this session leaves on the robot if it is lost.
    pub(crate) fn left(&mut self) -> Option<Left> {
        let (arm, is_closed, is_datagram) = (self.arm, self.link.is_closed, self.outlasts_its_link());
        let since = self.link.silent_since.unwrap_or_else(|| self.connection.transport().now());
        (arm.is_used() && !self.keep).then_some(Left { arm, since, is_closed, is_datagram })
    }

    /// Gives the arm back at the end of its use, unless the settings leave it as it is. Over UDP the controller refuses every
    /// call while it still executes an abandoned call, so the call is repeated until that call has ended.
    pub(crate) async fn end_arm(&mut self) -> Result<(), Error> {
        let until = self.busy_limit();
        while !self.keep {
            let given = self.give_arm().await;
            if !self.waits_while_busy(&given, until).await {
                return given;
            }
        }
        Ok(())
    }

    /// Returns until when a call that is made now is repeated while the controller is busy.
    pub(super) fn busy_limit(&mut self) -> Instant {
        self.connection.transport().now() + BUSY_LIMIT
    }

    /// Waits a moment if the controller refused a call because it is busy. Returns whether the call is to be repeated.
    pub(super) async fn waits_while_busy(&mut self, ended: &Result<(), Error>, until: Instant) -> bool {
        let again = self.connection.transport().now() + BUSY_PAUSE;
        let repeats = is_busy(ended) && again <= until;
        if repeats {
            self.connection.transport().sleep_until(again).await;
        }
        repeats
    }

    /// Counts a TakeArm: an earlier [`ArmId`] is no longer valid.
    pub(super) const fn count_take(&mut self) {
        self.takes = self.takes.wrapping_add(1);
    }

    /// Returns the ID of the most recent TakeArm.
    #[cfg(feature = "tokio")]
    pub(crate) const fn arm_id(&self) -> ArmId {
        ArmId { session: self.id, take: self.takes }
    }

    pub(super) fn set_streaming(&mut self, streaming: bool) {
        self.arm.streaming = streaming && self.arm.taken;
    }

    /// Leaves Slave Mode, halts the robot if it may move, switches the motor off if it was switched on here, and gives the arm
    /// back. A refused call does not prevent those after it, except while the controller is busy: then the arm is kept. Over a
    /// lost connection nothing is sent. The arm stays recorded for [`recover`](Self::recover) unless the controller has answered.
    pub(crate) async fn give_arm(&mut self) -> Result<(), Error> {
        let ArmState { taken, motor, moving, streaming, .. } = self.arm;
        if !taken {
            return self.switch_off().await;
        }
        let robot = self.robot().await?;
        let left = if streaming { self.leave_slave_mode().await } else { Ok(()) };
        let halted = if moving { self.halt().await.map(drop) } else { Ok(()) };
        let off = if motor { self.motor(false).await } else { Ok(()) };
        let stopped = left.and(halted).and(off);
        if is_busy(&stopped) {
            // with the arm it can be tried again
            return stopped;
        }
        let given = self.run(ROBOT, procedure::give_arm(robot)).await;
        if !is_answered(&given) {
            self.arm.unanswered = true;
        } else if !is_busy(&given) {
            self.arm = self.arm.without_arm();
        }
        stopped.and(given)
    }

    /// Switches off a motor that was switched on without the arm, unless another client uses the robot.
    async fn switch_off(&mut self) -> Result<(), Error> {
        if !self.arm.motor {
            return Ok(());
        }
        let robot = self.robot().await?;
        let effects = Effects { motor: true, ..Effects::default() };
        let done = self.run(ROBOT, procedure::reclaim(robot, effects)).await?;
        self.arm.motor = done.motor_off.is_none() && done.owner != ArmOwner::Other;
        match done.motor_off {
            Some(true) => Ok(()),
            // again, because the procedure does not report the reason of the refusal
            Some(false) => self.motor(false).await,
            None => {
                tracing::warn!(?done, "the motor was not switched off");
                let mut recovery = Recovery::default();
                recovery.add(done);
                if self.arm.motor { Err(Error::NotEnded(recovery)) } else { Ok(()) }
            }
        }
    }

    /// Returns whether the session lives on in the controller after its link is gone, until its service is stopped.
    pub(crate) const fn outlasts_its_link(&mut self) -> bool {
        matches!(self.connection.client().link(), Link::Datagram)
    }

    /// Stops the service of a lost session over UDP, as soon as its call without a reply has ended. Nothing else ends the
    /// session in the controller, which would keep the arm for it. Returns whether that session has ended.
    pub(crate) async fn stop_lost_service(&mut self) -> bool {
        let timing = self.closing();
        let until = self.busy_limit();
        while self.outlasts_its_link() {
            let stopped = self.connection.call_with(Release { object: Object::Service, handle: 0 }, timing).await;
            let again = self.connection.transport().now() + BUSY_PAUSE;
            match stopped {
                Err(CallError::Refused(HResult::E_BUSY_PROC)) if again <= until => {}
                // any other code means that the session does not exist
                Err(CallError::Refused(code)) => return code != HResult::E_BUSY_PROC,
                ended => return ended.is_ok(),
            }
            self.connection.transport().sleep_until(again).await;
        }
        true
    }

    /// Ends Slave Mode if it is on.
    async fn leave_slave_mode(&mut self) -> Result<(), Error> {
        if self.execute_robot::<i32>("slvGetMode", ()).await? != 0 {
            self.execute_robot::<()>("slvChangeMode", 0).await?;
        }
        self.set_streaming(false);
        Ok(())
    }

    /// Ends the effects that a lost session may have left; `stop` stops its service.
    ///
    /// Shortly after the loss, the controller has probably not detected it, and the lost session still owns the arm, so the
    /// robot is halted first. Later, TakeArm is sent first: a robot that another client uses is left alone. If the lost session
    /// may still own the arm, its motion is halted, unless the robot moves to another destination.
    ///
    /// # Errors
    ///
    /// An [`Error`] if this connection is lost too, or the controller has no robot.
    pub(crate) async fn recover(&mut self, left: Left, stop: impl Future<Output = ()>) -> Result<Recovery, Error> {
        let robot = self.robot().await?;
        let effects = left.effects(self.connection.transport().now());
        let mut recovery = Recovery::default();
        if effects.claim == Claim::Lost {
            recovery.add(self.run(ROBOT, procedure::reclaim(robot, effects)).await?);
        }
        stop.await;
        if effects.claim == Claim::Lost && !left.is_datagram {
            return Ok(recovery);
        }
        let claim = if effects.claim == Claim::Lost { Claim::Unknown } else { effects.claim };
        let reclaimed = self.run(ROBOT, procedure::reclaim(robot, Effects { claim, ..effects })).await?;
        recovery.add(reclaimed);
        if reclaimed.owner == ArmOwner::Other && left.is_closed {
            // the controller may be about to detect the loss
            let again = self.connection.transport().now() + NOTICE;
            self.connection.transport().sleep_until(again).await;
            recovery.add(self.run(ROBOT, procedure::reclaim(robot, Effects { claim: Claim::Other, ..effects })).await?);
        }
        Ok(recovery)
    }
}
