//! A robot and its arm as objects.

use std::time::Duration;

use bcap_core::bcap::Object;
use bcap_core::bcap::call::{self, RobotHandle};
use bcap_core::position::{Joints, Position};
use bcap_core::procedure::{self, Handles, Motion, MotionConfig};
use bcap_core::variant::{Encode, FromVariant};

use super::session::ControllerSession;
use crate::error::Error;
use crate::moves::Move;

/// A robot of a controller.
///
/// It cannot move; [`take_arm`](Self::take_arm) returns what can.
#[derive(Debug)]
pub struct Robot<'a> {
    session: &'a mut ControllerSession,
    handle: RobotHandle,
}

/// A robot whose arm this client has taken, so that it can move it.
///
/// When it is dropped, also by a panic, it halts the robot if a motion may be under way, switches the motor off if it was
/// switched on here, and gives the arm back. After a lost connection none of this is possible; only the controller
/// itself stops the robot then.
#[derive(Debug)]
pub struct Arm<'a> {
    robot: Robot<'a>,
    /// Whether the motor may have been switched on here.
    motor: bool,
    /// Whether a motion may be under way.
    moving: bool,
    given: bool,
}

impl<'a> Robot<'a> {
    pub(super) const fn new(session: &'a mut ControllerSession, handle: RobotHandle) -> Self {
        Self { session, handle }
    }

    /// Takes the arm, which keeps its speed, tool and work.
    ///
    /// # Errors
    ///
    /// An [`Error`]; the arm is not taken then.
    pub fn take_arm(self) -> Result<Arm<'a>, Error> {
        let prepare = procedure::prepare_robot(self.handle, [0, 1], false);
        self.session.run("the robot", prepare)?;
        Ok(Arm { robot: self, motor: false, moving: false, given: false })
    }

    /// Reads the joints.
    ///
    /// # Errors
    ///
    /// An [`Error`].
    pub fn joints(&mut self) -> Result<Joints, Error> {
        self.execute("CurJnt", ())
    }

    /// Reads the position of the tool.
    ///
    /// # Errors
    ///
    /// An [`Error`].
    pub fn position(&mut self) -> Result<Position, Error> {
        self.execute("CurPos", ())
    }

    /// Reads a variable of the robot, such as `@SERVO_ON`.
    ///
    /// # Errors
    ///
    /// As [`Controller::read`](super::Controller::read).
    pub fn read<T: for<'v> FromVariant<'v>>(&mut self, name: &str) -> Result<T, Error> {
        self.session.read_of(Object::Robot, self.handle.0, name)
    }

    /// Executes a command of the robot with a parameter, and returns its value.
    ///
    /// Some commands move the robot, such as `DriveEx`; they fail without the arm.
    ///
    /// # Errors
    ///
    /// An [`Error`]; [`Error::Value`] if the value of the reply has another type.
    pub fn execute<T: for<'v> FromVariant<'v>>(&mut self, command: &str, parameter: impl Encode) -> Result<T, Error> {
        self.session.value(command, call::robot_execute(self.handle, command, parameter))
    }

    const fn handles(&self) -> Handles {
        Handles { controller: self.session.handle, robot: self.handle }
    }
}

impl<'a> Arm<'a> {
    /// Switches the motor on, and waits until it is.
    ///
    /// # Errors
    ///
    /// An [`Error`].
    pub fn motor_on(&mut self) -> Result<(), Error> {
        self.motor = true;
        self.robot.execute("Motor", [1, 0])
    }

    /// Switches the motor off, and waits until it is.
    ///
    /// # Errors
    ///
    /// An [`Error`].
    pub fn motor_off(&mut self) -> Result<(), Error> {
        self.robot.execute::<()>("Motor", [0, 0])?;
        self.motor = false;
        Ok(())
    }

    /// Sets the external speed, in percent of the maximum.
    ///
    /// # Errors
    ///
    /// An [`Error`].
    pub fn set_speed(&mut self, percent: f64) -> Result<(), Error> {
        self.robot.execute("ExtSpeed", percent)
    }

    /// Moves, and waits until the motion ends, at most for `limit`; the robot is halted then.
    ///
    /// [`Motion::Arrived`] means that the joints rest at the destination, not only that the robot does not move. On
    /// another thread a [`Stopper`](super::Stopper) can halt the motion at any time.
    ///
    /// # Errors
    ///
    /// An [`Error`]. If the motion may have begun, the robot was halted, unless the connection is lost.
    pub fn move_to(&mut self, motion: &Move, limit: Duration) -> Result<Motion, Error> {
        let parameters = procedure::MoveParameters {
            interpolation: motion.interpolation(),
            pose: motion.destination(),
            option: motion.options(),
        };
        self.moving = true;
        let steps = procedure::move_and_wait(self.robot.handles(), parameters, MotionConfig::within(limit));
        let ended = self.robot.session.run("the robot", steps)?;
        self.moving = false;
        Ok(ended)
    }

    /// Returns the robot, to read its position.
    pub const fn robot(&mut self) -> &mut Robot<'a> {
        &mut self.robot
    }

    /// Gives the arm back, as a drop does, and reports whether that succeeded.
    ///
    /// # Errors
    ///
    /// The first [`Error`].
    pub fn give(mut self) -> Result<(), Error> {
        self.end()
    }

    fn end(&mut self) -> Result<(), Error> {
        if std::mem::replace(&mut self.given, true) {
            return Ok(());
        }
        let handle = self.robot.handle;
        let halted = match self.moving {
            true => self.robot.session.call("the robot", call::robot_halt(handle, "")).map(drop),
            false => Ok(()),
        };
        let off = if self.motor { self.motor_off() } else { Ok(()) };
        let given = self.robot.session.run("the robot", procedure::give_arm(handle));
        halted.and(off).and(given)
    }
}

impl Drop for Arm<'_> {
    fn drop(&mut self) {
        if let Err(error) = self.end() {
            tracing::warn!(%error, "the arm was not given back");
        }
    }
}
