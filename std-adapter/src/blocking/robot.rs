//! A robot and its arm as objects.

use std::ops::ControlFlow;
use std::time::Duration;

use bcap_core::bcap::Object;
use bcap_core::position::{Joints, Position};
use bcap_core::procedure::{Examination, Motion, MotionConfig, MotionQueue, RecoveryConfig, Until};
use bcap_core::slave::{AxisLimits, Format, Stats, Trajectory};
use bcap_core::variant::{Encode, FromVariant};

use super::ending;
use super::limited::Limited;
use super::moving::Moving;
use super::socket::{Blocking, ready};
use crate::error::Error;
use crate::moves::Move;
use crate::session::{Halted, Session};

/// A robot of a controller.
///
/// It cannot move; [`take_arm`](Self::take_arm) returns an [`Arm`], which can.
///
/// # Examples
///
/// ```no_run
/// # use bcap_std::{Settings, blocking::Controller};
/// # let mut cell = Controller::connect("tcp:192.168.0.1", &Settings::rc9())?;
/// let mut robot = cell.robot()?;
/// println!("{:?} {:?}", robot.joints()?, robot.position()?);
/// println!("the motor is on: {}", robot.read::<bool>("@SERVO_ON")?);
/// # Ok::<(), bcap_std::Error>(())
/// ```
#[derive(Debug)]
pub struct Robot<'a> {
    calls: Limited<'a>,
}

/// A robot whose arm this client has taken, so that it can move it.
///
/// When it is dropped, even while a panic unwinds, it leaves Slave Mode, halts the robot if a motion may be in progress,
/// switches the motor off if it was switched on here, and gives the arm back, within five seconds. After a lost connection the
/// drop of the [`Controller`](super::Controller) does this over a new connection.
#[derive(Debug)]
pub struct Arm<'a> {
    robot: Robot<'a>,
}

impl<'a> Robot<'a> {
    pub(super) const fn new(session: &'a mut Session<Blocking>) -> Self {
        Self { calls: Limited::new(session) }
    }

    /// Returns this robot with a time limit for each reading, command and examination. Taking the arm and recovering have none,
    /// nor has a halt or the [`Arm`], whose motions have their own limit.
    ///
    /// A call without a reply in this time fails with [`Error::NoReply`]; the controller may have executed it. The connection
    /// stays usable.
    ///
    /// ```no_run
    /// # use std::time::Duration;
    /// # use bcap_std::{Settings, blocking::Controller};
    /// # let mut cell = Controller::connect("tcp:192.168.0.1", &Settings::rc9())?;
    /// let joints = cell.robot()?.within(Duration::from_millis(200)).joints()?;
    /// # Ok::<(), bcap_std::Error>(())
    /// ```
    pub fn within(&mut self, limit: Duration) -> Robot<'_> {
        Robot { calls: Limited::new(self.calls.session()).within(limit) }
    }

    /// Takes the arm, which keeps its speed, tool and work.
    ///
    /// # Errors
    ///
    /// An [`Error`]; the arm is not taken then.
    pub fn take_arm(mut self) -> Result<Arm<'a>, Error> {
        ready(self.calls.session().take_arm())?;
        Ok(Arm { robot: self.unlimited() })
    }

    /// Reads the state of a faulty robot: the current errors, mode, stops, motor, torque and Slave Mode. It changes nothing,
    /// and interrupts no stream.
    ///
    /// # Errors
    ///
    /// An [`Error`]; a refused call only leaves a part unknown.
    ///
    /// # Examples
    ///
    /// ```no_run
    /// # use bcap_std::{Settings, blocking::Controller};
    /// # let mut cell = Controller::connect("tcp:192.168.0.1", &Settings::rc9())?;
    /// let state = cell.robot()?.examine()?;
    /// for code in state.errors() {
    ///     println!("{code}: {}", code.hint().map(|hint| hint.to_string()).unwrap_or_default());
    /// }
    /// state.obstacles().for_each(|obstacle| println!("first of all: {obstacle}"));
    /// # Ok::<(), bcap_std::Error>(())
    /// ```
    pub fn examine(&mut self) -> Result<Examination, Error> {
        self.calls.run(async |session| session.examine().await)
    }

    /// Recovers the robot after an error: clears the errors, takes the arm, resets the safe torque off, prepares the motion of a
    /// COBOTTA, and switches the motor on. Steps that the state does not need are left out.
    ///
    /// **The arm of a COBOTTA can move**, so a person must have looked at the robot. Nothing is cleared unless it is certain
    /// that no other client uses the robot: a controller with errors may refuse to report the owner of the arm, and then
    /// [`RecoveryConfig::is_alone`] decides. Dropping the [`Arm`] switches the motor off, and gives the arm back.
    ///
    /// # Errors
    ///
    /// [`Error::NotRecovered`] with the step, the code and what to do; the arm is not taken then, and the motor is as it was.
    /// [`Error::ArmTaken`] if the arm is taken over this session.
    pub fn recover(self, config: RecoveryConfig) -> Result<Arm<'a>, Error> {
        self.make_ready(Some(config))
    }

    /// Takes the arm, and prepares the motion of a COBOTTA, without which its motor cannot be switched on. Of another model it
    /// takes only the arm.
    ///
    /// **The arm can move.** Nothing else makes this preparation, except [`recover`](Self::recover).
    ///
    /// # Errors
    ///
    /// Same as [`recover`](Self::recover); it fails while the controller has errors.
    pub fn prepare(self) -> Result<Arm<'a>, Error> {
        self.make_ready(None)
    }

    fn make_ready(mut self, config: Option<RecoveryConfig>) -> Result<Arm<'a>, Error> {
        let session = self.calls.session();
        ready(session.expect_no_arm())?;
        ready(session.make_ready(config, |_, _| ControlFlow::Continue(())))?;
        Ok(Arm { robot: self.unlimited() })
    }

    fn unlimited(self) -> Self {
        Self { calls: self.calls.unlimited() }
    }

    /// Reads the joints, in degrees, or mm for a linear axis.
    ///
    /// # Errors
    ///
    /// An [`Error`].
    pub fn joints(&mut self) -> Result<Joints, Error> {
        self.calls.run(async |session| session.execute_robot("CurJnt", ()).await)
    }

    /// Reads the position of the tool in mm and degrees: of the selected tool in the selected work coordinates.
    ///
    /// # Errors
    ///
    /// An [`Error`].
    pub fn position(&mut self) -> Result<Position, Error> {
        self.calls.run(async |session| session.execute_robot("CurPos", ()).await)
    }

    /// Reads a variable of the robot, such as `@SERVO_ON`.
    ///
    /// # Errors
    ///
    /// Same as [`Controller::read`](super::Controller::read).
    pub fn read<T: for<'v> FromVariant<'v>>(&mut self, name: &str) -> Result<T, Error> {
        self.calls.run(async |session| session.read(Object::Robot, name).await)
    }

    /// Executes a command of the robot with a parameter, and returns its value.
    ///
    /// Some commands move the robot, such as `DriveEx`; they fail without the arm. Such a call returns when the motion has
    /// ended; only a [`Stopper`](super::Stopper) halts it before. One with `NEXT` is halted when the [`Arm`] is dropped, and a
    /// motor that a command has switched on is switched off. Use [`Arm::move_to`] for motions.
    ///
    /// # Errors
    ///
    /// An [`Error`]; [`Error::Value`] if the value of the reply has another type.
    pub fn execute<T: for<'v> FromVariant<'v>>(&mut self, command: &str, parameter: impl Encode) -> Result<T, Error> {
        self.calls.run(async |session| session.execute_any_of_robot(command, parameter).await)
    }

    /// Halts the robot, even without the arm, and waits until it rests.
    ///
    /// A controller refuses a halt while one of its tasks owns the arm. Then all tasks are stopped (KillAll, or Task_Stop of each
    /// task if KillAll is refused or has no effect), and the robot is halted again: [`Halted::TasksStopped`]. Each starts at its first
    /// line when it is started again. Rest is not assumed: the robot is polled until it rests, at most for one second after each means.
    ///
    /// A [`Stopper`](super::Stopper) can do this while another call of this controller waits.
    ///
    /// # Errors
    ///
    /// An [`Error`]; the robot may still move. [`Error::NotHalted`] if the robot still moved, or the halt stays
    /// refused.
    pub fn halt(&mut self) -> Result<Halted, Error> {
        ready(self.calls.session().halt_and_verify())
    }
}

impl<'a> Arm<'a> {
    pub(super) const fn new(robot: Robot<'a>) -> Self {
        Self { robot }
    }

    /// Returns the session, for objects of this session that exist while the arm is taken.
    pub(super) fn session(&mut self) -> &mut Session<Blocking> {
        self.robot.calls.session()
    }

    /// Ends the use of this object without giving the arm back. The session keeps the arm:
    /// [`Controller::arm`](super::Controller::arm) returns it again, and the end of the session gives it back.
    pub fn keep(self) {
        std::mem::forget(self);
    }

    /// Switches the motor on, and waits until it is.
    ///
    /// # Errors
    ///
    /// An [`Error`].
    pub fn motor_on(&mut self) -> Result<(), Error> {
        ready(self.session().motor(true))
    }

    /// Switches the motor off, and waits until it is.
    ///
    /// # Errors
    ///
    /// An [`Error`].
    pub fn motor_off(&mut self) -> Result<(), Error> {
        ready(self.session().motor(false))
    }

    /// Sets the external speed, in percent of the maximum.
    ///
    /// # Errors
    ///
    /// An [`Error`].
    pub fn set_speed(&mut self, percent: f64) -> Result<(), Error> {
        ready(self.session().execute_robot("ExtSpeed", percent))
    }

    /// Selects a tool, which is the point that later positions are about; 0 is the flange.
    ///
    /// # Errors
    ///
    /// An [`Error`].
    pub fn select_tool(&mut self, number: u8) -> Result<(), Error> {
        ready(self.session().change("Tool", number))
    }

    /// Selects work coordinates, in which later positions are; 0 is the base of the robot.
    ///
    /// # Errors
    ///
    /// An [`Error`].
    pub fn select_work(&mut self, number: u8) -> Result<(), Error> {
        ready(self.session().change("Work", number))
    }

    /// Moves, and waits until the motion ends, at most for `limit`; the robot is halted then.
    ///
    /// [`Motion::Arrived`] means that the robot rests at the destination, not only that it does not move. On another thread a
    /// [`Stopper`](super::Stopper) can halt the motion at any time. When the call returns, even with an error, the robot is at
    /// rest or a halt was sent, so there is nothing to drop.
    ///
    /// # Errors
    ///
    /// An [`Error`]. If the motion may have begun, the robot was halted, unless the connection is lost.
    pub fn move_to(&mut self, motion: &Move, limit: Duration) -> Result<Motion, Error> {
        let queue = MotionQueue::new(MotionConfig::within(limit));
        let queue = ready(self.session().run_queue(queue, Some(motion.clone()), Until::Ended))?;
        Ok(queue.ended().unwrap_or(Motion::Unknown))
    }

    /// Starts a motion and returns when it has begun, so that [`Moving::then`] can add motions without a stop.
    /// `limit` is the time limit of all of them; after it the robot is halted. It is checked only while a call of the
    /// [`Moving`] runs: a program that keeps the value without calling it never halts the robot.
    ///
    /// **Dropping the [`Moving`] halts the robot**, even by an error or a panic. [`Moving::wait`] waits for the end.
    ///
    /// # Errors
    ///
    /// An [`Error`]. If the motion may have begun, the robot was halted, unless the connection is lost.
    ///
    /// # Examples
    ///
    /// ```no_run
    /// # use std::time::Duration;
    /// # use bcap_std::{Motion, Move, Pass, Settings, blocking::Controller};
    /// # let mut cell = Controller::connect("tcp:192.168.0.1", &Settings::rc9())?;
    /// # let mut arm = cell.robot()?.take_arm()?;
    /// let slowly = |to| Move::line(to).speed_percent(10.0);
    /// let mut moving = arm.start(&slowly("P1").pass(Pass::Near), Duration::from_secs(30))?;
    /// moving = moving.then(&slowly("P2").pass(Pass::Near))?; // round the corner at P1
    /// match moving.then(&slowly("P3"))?.wait()? {
    ///     Motion::Arrived => println!("at P3, by way of P1 and P2"),
    ///     other => println!("stopped: {other:?}"),
    /// }
    /// # Ok::<(), bcap_std::Error>(())
    /// ```
    pub fn start(&mut self, motion: &Move, limit: Duration) -> Result<Moving<'_>, Error> {
        let queue = MotionQueue::new(MotionConfig::within(limit));
        Moving { session: self.session(), queue }.run(Some(motion), Until::Begun)
    }

    /// Streams poses in Slave Mode, one every 8 ms, until the trajectory ends, and waits until the robot rests.
    ///
    /// The motor must be on. A pose beyond `limits` is not sent: the robot stops in an orderly way. To stop early, the
    /// trajectory returns [`Next::Stop`](bcap_core::slave::Next::Stop). A panic in the trajectory drops the [`Arm`],
    /// which halts the robot. Slave Mode needs its licence (b-CAP specification, section 1.3). Streams with IO, or with
    /// a second connection for the controller's errors, are made by the [`Engine`](bcap_core::slave::Engine), see
    /// [`slave`](crate::slave).
    ///
    /// # Errors
    ///
    /// An [`Error`]. After [`Error::Stream`] for a failed call, a working controller has ended Slave Mode and stopped the
    /// robot, but this may be unverified: the drop of the [`Arm`] leaves Slave Mode and halts the robot.
    pub fn stream<T: Trajectory + ?Sized>(
        &mut self,
        format: Format,
        limits: AxisLimits,
        trajectory: &mut T,
    ) -> Result<Stats, Error> {
        ready(self.session().stream(format, limits, trajectory))
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
        ready(self.session().give_arm())
    }
}

impl Moving<'_> {
    /// Returns the robot, to read its position.
    pub const fn robot(&mut self) -> Robot<'_> {
        Robot::new(self.session)
    }
}

impl Drop for Arm<'_> {
    fn drop(&mut self) {
        if let Err(error) = ending::within_limit(self.session(), |session| ready(session.end_arm())) {
            tracing::warn!(%error, "the arm was not given back");
        }
    }
}
