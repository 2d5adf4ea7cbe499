//! The end of a session that has taken the arm: the robot is halted, Slave Mode left, the motor off, and the arm free.
//!
//! ```text
//!  over its connection:         slvChangeMode 0 ─► Robot_Halt ─► Motor 0 ─► GiveArm
//!  over the next connection:    Robot_Halt ─► slvChangeMode 0 ─► TakeArm ─► Motor 0 ─► GiveArm
//!  over a lost UDP link:            └─► Service_Stop, which frees the arm for TakeArm
//! ```
//!
//! Only effects of this session are ended: a session that never took the arm halts and switches nothing.

use std::io;
use std::time::Duration;

use bcap_core::bcap::client::Timing;
use bcap_core::bcap::{Link, Object};
use bcap_core::hresult::HResult;
#[cfg(feature = "tokio")]
use bcap_core::io::asynch::Connection;
use bcap_core::io::asynch::Transport;
use bcap_core::procedure;

use super::arm::{ArmState, Recovery};
use super::{CLOSE, ROBOT, Release, Session};
use crate::CallError;
use crate::error::Error;

/// How long, and how often, a controller is asked that still executes an earlier call.
const BUSY_LIMIT: Duration = Duration::from_secs(5);
const BUSY_PAUSE: Duration = Duration::from_millis(10);

/// Tells whether the controller refused a call because it executes another one of this client, or because the robot brakes.
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
        let Self {
            connection,
            id,
            handle,
            robot,
            robot_name,
            variables,
            objects,
            opened,
            arm,
            motor_switches,
            keep,
            usual_timing,
            lost,
        } = self;
        let (transport, client) = connection.into_parts();
        let connection = Connection::new(change(transport)?, client);
        Some(Session {
            connection,
            id,
            handle,
            robot,
            robot_name,
            variables,
            objects,
            opened,
            arm,
            motor_switches,
            keep,
            usual_timing,
            lost,
        })
    }

    /// Returns, once, the effects that a lost session has left on the robot.
    pub(crate) fn take_left(&mut self) -> Option<ArmState> {
        self.arm.take().filter(|_| !self.keep)
    }

    /// Gives the arm back at the end of its use, unless the settings leave it as it is. Over UDP the controller refuses every
    /// call while it still executes one that was given up, so it is asked again until that one has ended.
    pub(crate) async fn end_arm(&mut self) -> Result<(), Error> {
        let until = self.connection.transport().now() + BUSY_LIMIT;
        while !self.keep {
            let given = self.give_arm().await;
            let again = self.connection.transport().now() + BUSY_PAUSE;
            if !is_busy(&given) || again > until {
                return given;
            }
            self.connection.transport().sleep_until(again).await;
        }
        Ok(())
    }

    pub(super) fn set_streaming(&mut self, streaming: bool) {
        if let Some(arm) = &mut self.arm {
            arm.streaming = streaming;
        }
    }

    /// Leaves Slave Mode, halts the robot if it may move, switches the motor off if it was switched on here, and gives the arm
    /// back. A refused call does not prevent those after it, except while the controller is busy: then the arm is kept. Over a lost connection nothing is sent, and the arm stays
    /// recorded for [`recover`](Self::recover).
    pub(crate) async fn give_arm(&mut self) -> Result<(), Error> {
        let Some(ArmState { motor, moving, streaming }) = self.arm else { return Ok(()) };
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
        if self.lost.is_none() && !is_busy(&given) {
            self.arm = None;
        }
        stopped.and(given)
    }

    /// Tells whether the controller does not notice that this session has ended, unless its service is stopped.
    pub(crate) const fn outlasts_its_link(&mut self) -> bool {
        matches!(self.connection.client().link(), Link::Datagram)
    }

    /// Stops the service of a lost session over UDP, as soon as its call without a reply has ended. Nothing else tells the
    /// controller that the session has ended, and it would keep the arm for it.
    pub(crate) async fn stop_lost_service(&mut self) {
        let timing = Timing { attempt_timeout: CLOSE, deadline: CLOSE, ..self.connection.client().timing() };
        let until = self.connection.transport().now() + BUSY_LIMIT;
        while self.outlasts_its_link() {
            let stopped = self.connection.call_with(Release { object: Object::Service, handle: 0 }, timing).await;
            let again = self.connection.transport().now() + BUSY_PAUSE;
            if !matches!(stopped, Err(CallError::Refused(HResult::E_BUSY_PROC))) || again > until {
                return;
            }
            self.connection.transport().sleep_until(again).await;
        }
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
    /// A motion of the lost session is halted first. Then its service is stopped, so that its arm is free. The motor is switched off if the arm can be taken, or if the robot was
    /// moving: otherwise another client may have begun to use it.
    ///
    /// # Errors
    ///
    /// An [`Error`] if this connection is lost too, or the controller has no robot.
    pub(crate) async fn recover(&mut self, left: ArmState, stop: impl Future<Output = ()>) -> Result<Recovery, Error> {
        let robot = self.robot().await?;
        let mut halted = None;
        if left.moving {
            halted = Some(self.halts().await?);
        }
        stop.await;
        if left.streaming {
            let ended = self.leave_slave_mode().await;
            self.unless_lost(ended)?;
        }
        let taken = self.run(ROBOT, procedure::prepare_robot(robot, [0, 1], false)).await;
        let is_taken = self.unless_lost(taken)?;
        if is_taken && !left.moving {
            halted = Some(self.halts().await?);
        }
        let mut motor_off = left.motor.then_some(is_taken || left.moving);
        if motor_off == Some(true) {
            let off = self.motor(false).await;
            motor_off = Some(self.unless_lost(off)?);
        }
        let mut arm_free = is_taken;
        if is_taken {
            let given = self.run(ROBOT, procedure::give_arm(robot)).await;
            arm_free = self.unless_lost(given)?;
        }
        Ok(Recovery { halted, motor_off, arm_free })
    }

    /// Halts the robot, and returns whether the controller did so.
    async fn halts(&mut self) -> Result<bool, Error> {
        let halted = self.halt().await.map(drop);
        self.unless_lost(halted)
    }

    /// Returns whether a call succeeded; an error only if the connection is lost.
    fn unless_lost(&self, ended: Result<(), Error>) -> Result<bool, Error> {
        match (ended, &self.lost) {
            (Err(error), Some(_)) => Err(error),
            (ended, _) => Ok(ended.is_ok()),
        }
    }
}
