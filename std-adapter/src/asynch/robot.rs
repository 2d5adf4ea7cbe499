//! A robot, its arm and its stopper as objects for tokio.

use std::any::Any;
use std::io;
use std::ops::ControlFlow;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::{Arc, Weak};
use std::time::Duration;

use bcap_core::bcap::Object;
use bcap_core::position::{Joints, Position};
use bcap_core::procedure::{Examination, Motion, MotionConfig, MotionQueue, RecoveryConfig, Until};
use bcap_core::slave::{AxisLimits, Cycle, Format, MoveReply, Next, Outputs, Stats, Trajectory};
use bcap_core::time::Instant;
use bcap_core::variant::{Encode, FromVariant};

use super::SendTransport;
use super::actor::Request;
use super::handle::{Handle, owned};
use super::moving::{Moving, run_queue};
use super::socket::{BoxFuture, Socket};
use crate::address::Address;
use crate::error::Error;
use crate::moves::Move;
use crate::session::{ArmId, Halted, Session};
use crate::settings::Settings;

/// A robot of a controller.
///
/// It cannot move; [`take_arm`](Self::take_arm) returns an [`Arm`], which can.
///
/// # Examples
///
/// ```no_run
/// # async fn example(cell: bcap_std::asynch::Controller) -> Result<(), bcap_std::Error> {
/// let robot = cell.robot().await?;
/// println!("{:?} {:?}", robot.joints().await?, robot.position().await?);
/// # Ok(())
/// # }
/// ```
#[derive(Clone, Debug)]
pub struct Robot {
    handle: Handle,
}

/// A robot whose arm this client has taken, so that it can move it.
///
/// When it is dropped, the task leaves Slave Mode, halts the robot if a motion may be in progress, switches the motor off if it
/// was switched on here, and gives the arm back. The same happens when the runtime ends. After a lost connection the task does
/// this over the next connection, before any other call ([`Controller::recoveries`](super::Controller::recoveries) reports it).
/// The arm is lost with the connection: its functions fail with [`Error::ArmLost`].
#[derive(Debug)]
pub struct Arm {
    robot: Robot,
    id: ArmId,
}

/// Halts the robot from any task, even while another call of the [`Controller`](super::Controller) waits.
///
/// It has a separate connection and session, which are open before they are needed, and are opened again when they are lost. It
/// is not an emergency stop: it needs the network, this computer and the controller.
///
/// # Examples
///
/// ```no_run
/// # async fn example() -> Result<(), bcap_std::Error> {
/// use bcap_std::Settings;
/// use bcap_std::asynch::Stopper;
///
/// let stopper = Stopper::connect("tcp:192.168.0.1", &Settings::rc9()).await?;
/// println!("{:?}", stopper.halt().await?);
/// # Ok(())
/// # }
/// ```
#[derive(Clone, Debug)]
pub struct Stopper {
    handle: Handle,
}

impl Robot {
    pub(super) const fn new(handle: Handle) -> Self {
        Self { handle }
    }

    /// Takes the arm, which keeps its speed, tool and work.
    ///
    /// # Errors
    ///
    /// An [`Error`]; the arm is not taken then. [`Error::ArmTaken`] if another [`Arm`] of this controller exists.
    ///
    /// # Cancel safety
    ///
    /// If the future is dropped, the arm is given back.
    pub async fn take_arm(self) -> Result<Arm, Error> {
        let handle = self.handle.clone();
        handle
            .run(move |session| {
                Box::pin(async move {
                    session.take_arm().await?;
                    // from here on a drop gives it back, even when the caller has gone
                    Ok(Arm { robot: self, id: session.arm_id() })
                })
            })
            .await
    }

    /// Reads the state of a faulty robot: the current errors, mode, stops, motor, torque and Slave Mode. It changes nothing,
    /// and interrupts no stream.
    ///
    /// # Errors
    ///
    /// An [`Error`]; a refused call only leaves a part unknown.
    ///
    /// # Cancel safety
    ///
    /// Same as [`Controller`](super::Controller).
    ///
    /// # Examples
    ///
    /// ```no_run
    /// # async fn example(robot: bcap_std::asynch::Robot) -> Result<(), bcap_std::Error> {
    /// let state = robot.examine().await?;
    /// for code in state.errors() {
    ///     println!("{code}: {}", code.hint().map(|hint| hint.to_string()).unwrap_or_default());
    /// }
    /// state.obstacles().for_each(|obstacle| println!("first of all: {obstacle}"));
    /// # Ok(())
    /// # }
    /// ```
    pub async fn examine(&self) -> Result<Examination, Error> {
        self.handle.run(|session| Box::pin(session.examine())).await
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
    ///
    /// # Cancel safety
    ///
    /// If the future is dropped, the task makes the remaining steps, and then undoes them: the motor is switched off, and the arm
    /// given back.
    pub async fn recover(self, config: RecoveryConfig) -> Result<Arm, Error> {
        self.make_ready(Some(config)).await
    }

    /// Takes the arm, and prepares the motion of a COBOTTA, without which its motor cannot be switched on. For other models it
    /// only takes the arm.
    ///
    /// **The arm can move.** Nothing else makes this preparation, except [`recover`](Self::recover).
    ///
    /// # Errors
    ///
    /// Same as [`recover`](Self::recover); it fails while the controller has errors.
    ///
    /// # Cancel safety
    ///
    /// If the future is dropped, the task makes the remaining steps, and then undoes them: the motor is switched off, and the arm
    /// given back.
    pub async fn prepare(self) -> Result<Arm, Error> {
        self.make_ready(None).await
    }

    async fn make_ready(self, config: Option<RecoveryConfig>) -> Result<Arm, Error> {
        let handle = self.handle.clone();
        handle
            .run(move |session| {
                Box::pin(async move {
                    session.expect_no_arm().await?;
                    session.make_ready(config, |_, _| ControlFlow::Continue(())).await?;
                    // from here on a drop undoes it, even when the caller has gone
                    Ok(Arm { robot: self, id: session.arm_id() })
                })
            })
            .await
    }

    /// Reads the joints, in degrees, or mm for a linear axis.
    ///
    /// # Errors
    ///
    /// An [`Error`].
    ///
    /// # Cancel safety
    ///
    /// Same as [`Controller`](super::Controller).
    pub async fn joints(&self) -> Result<Joints, Error> {
        self.handle.run(|session| Box::pin(session.execute_robot("CurJnt", ()))).await
    }

    /// Reads the position of the tool in mm and degrees: of the selected tool in the selected work coordinates.
    ///
    /// # Errors
    ///
    /// An [`Error`].
    ///
    /// # Cancel safety
    ///
    /// Same as [`Controller`](super::Controller).
    pub async fn position(&self) -> Result<Position, Error> {
        self.handle.run(|session| Box::pin(session.execute_robot("CurPos", ()))).await
    }

    /// Reads a variable of the robot, such as `@SERVO_ON`.
    ///
    /// # Errors
    ///
    /// Same as [`Controller::read`](super::Controller::read).
    ///
    /// # Cancel safety
    ///
    /// Same as [`Controller`](super::Controller).
    pub async fn read<T: for<'v> FromVariant<'v> + Send + 'static>(&self, name: &str) -> Result<T, Error> {
        let name = name.to_owned();
        self.handle.run(move |session| Box::pin(async move { session.read(Object::Robot, &name).await })).await
    }

    /// Halts the robot, even without the arm, and waits until it rests. Unlike [`Stopper::halt`], it waits for earlier calls.
    ///
    /// # Errors
    ///
    /// An [`Error`]; the robot may still move. [`Error::NotHalted`] if the robot did not stop, or the controller kept refusing
    /// the halt.
    ///
    /// # Cancel safety
    ///
    /// The robot is halted even if the future is dropped after its first poll.
    pub async fn halt(&self) -> Result<Halted, Error> {
        self.handle.run_always(|session| Box::pin(session.halt_and_verify())).await
    }

    /// Executes a command of the robot with a parameter, and returns its value.
    ///
    /// Some commands move the robot, such as `DriveEx`; they fail without the arm. Other calls of the controller wait until
    /// the command has ended, and **dropping the future does not stop it**: only a [`Stopper`] does. A motion with `NEXT` is
    /// halted when the [`Arm`] is dropped, and a motor that a command has switched on is switched off. Use [`Arm::move_to`] for
    /// motions.
    ///
    /// # Errors
    ///
    /// An [`Error`]; [`Error::Value`] if the value of the reply has another type.
    ///
    /// # Cancel safety
    ///
    /// Same as [`Controller`](super::Controller).
    pub async fn execute<T: for<'v> FromVariant<'v> + Send + 'static>(
        &self,
        command: &str,
        parameter: impl Encode,
    ) -> Result<T, Error> {
        let (command, parameter) = (command.to_owned(), owned(&parameter)?);
        self.handle
            .run(move |session| Box::pin(async move { session.execute_any_of_robot(&command, parameter).await }))
            .await
    }
}

impl Arm {
    /// Switches the motor on, and waits until it is on.
    ///
    /// # Errors
    ///
    /// An [`Error`].
    ///
    /// # Cancel safety
    ///
    /// Same as [`Controller`](super::Controller); dropping the arm switches the motor off.
    pub async fn motor_on(&mut self) -> Result<(), Error> {
        self.run(|session| Box::pin(session.motor(true))).await
    }

    /// Switches the motor off, and waits until it is off.
    ///
    /// # Errors
    ///
    /// An [`Error`].
    ///
    /// # Cancel safety
    ///
    /// Same as [`Controller`](super::Controller).
    pub async fn motor_off(&mut self) -> Result<(), Error> {
        self.run(|session| Box::pin(session.motor(false))).await
    }

    /// Sets the external speed, in percent of the maximum.
    ///
    /// # Errors
    ///
    /// An [`Error`].
    ///
    /// # Cancel safety
    ///
    /// Same as [`Controller`](super::Controller).
    pub async fn set_speed(&mut self, percent: f64) -> Result<(), Error> {
        self.run(move |session| Box::pin(session.execute_robot("ExtSpeed", percent))).await
    }

    /// Selects the tool whose position later calls use; 0 is the flange.
    ///
    /// # Errors
    ///
    /// An [`Error`].
    ///
    /// # Cancel safety
    ///
    /// Same as [`Controller`](super::Controller).
    pub async fn select_tool(&mut self, number: u8) -> Result<(), Error> {
        self.run(move |session| Box::pin(session.change("Tool", number))).await
    }

    /// Selects the work coordinates of later positions; 0 is the base of the robot.
    ///
    /// # Errors
    ///
    /// An [`Error`].
    ///
    /// # Cancel safety
    ///
    /// Same as [`Controller`](super::Controller).
    pub async fn select_work(&mut self, number: u8) -> Result<(), Error> {
        self.run(move |session| Box::pin(session.change("Work", number))).await
    }

    /// Moves, and waits until the motion ends, at most for `limit`; the robot is halted then.
    ///
    /// [`Motion::Arrived`] means that the robot rests at the destination, not only that it does not move. Other calls of the
    /// controller run during the motion. While one runs, `limit` is not checked, so limit a long call by
    /// [`Controller::within`](super::Controller::within).
    ///
    /// # Errors
    ///
    /// An [`Error`]. If the motion may have begun, the robot was halted, unless the connection is lost.
    ///
    /// # Cancel safety
    ///
    /// **Dropping the future halts the robot**: the task abandons the pending call and sends the halt. To let the robot
    /// move on, keep the future. The halt uses the same connection, so it is executed after a call that the controller
    /// still executes; a [`Stopper`] has its own.
    pub fn move_to<'a>(
        &'a mut self,
        motion: &Move,
        limit: Duration,
    ) -> impl Future<Output = Result<Motion, Error>> + Send + use<'a> {
        let motion = motion.clone();
        async move {
            let queue = MotionQueue::new(MotionConfig::within(limit));
            let queue = run_queue(&self.robot.handle, self.id, queue, Some(motion), Until::Ended).await?;
            Ok(queue.ended().unwrap_or(Motion::Unknown))
        }
    }

    /// Starts a motion and returns when it has begun, so that [`Moving::then`] can add motions without a stop.
    /// `limit` is the time limit of all of them; after it the robot is halted. It is checked only while a call of the
    /// [`Moving`] runs: a program that keeps the value without calling it never halts the robot.
    ///
    /// **Dropping the [`Moving`] halts the robot.** [`Moving::wait`] waits for the end.
    ///
    /// # Errors
    ///
    /// An [`Error`]. If the motion may have begun, the robot was halted, unless the connection is lost.
    ///
    /// # Cancel safety
    ///
    /// **Dropping the future halts the robot**, as with [`move_to`](Self::move_to).
    ///
    /// # Examples
    ///
    /// ```no_run
    /// # use std::time::Duration;
    /// # use bcap_std::{Error, Motion, Move, Pass, asynch::Arm};
    /// # async fn example(mut arm: Arm) -> Result<(), Error> {
    /// let slowly = |to| Move::line(to).speed_percent(10.0);
    /// let mut moving = arm.start(&slowly("P1").pass(Pass::Near), Duration::from_secs(30)).await?;
    /// moving = moving.then(&slowly("P2").pass(Pass::Near)).await?; // round the corner at P1
    /// match moving.then(&slowly("P3")).await?.wait().await? {
    ///     Motion::Arrived => println!("at P3, by way of P1 and P2"),
    ///     other => println!("stopped: {other:?}"),
    /// }
    /// # Ok(())
    /// # }
    /// ```
    pub async fn start(&mut self, motion: &Move, limit: Duration) -> Result<Moving<'_>, Error> {
        let queue = MotionQueue::new(MotionConfig::within(limit));
        Moving { handle: &self.robot.handle, arm: self.id, queue }.run(Some(motion.clone()), Until::Begun).await
    }

    /// Streams poses in Slave Mode, one every 8 ms, until the trajectory ends, and waits until the robot rests.
    ///
    /// Same as [`blocking::Arm::stream`](crate::blocking::Arm::stream), with a trajectory that the task owns. It is called in
    /// the task, so it must return immediately; if it panics, the robot stops and the panic continues here. Other calls and
    /// subscriptions of the controller wait until the stream ends, because the controller refuses them in Slave Mode. A
    /// [`Stopper`] can send Robot_Halt at any time, but no source says whether a controller accepts it in Slave Mode: have the
    /// emergency stop at hand. Timers of tokio are late by one to two milliseconds, see [`slave`](crate::slave).
    ///
    /// # Errors
    ///
    /// An [`Error`]. After [`Error::Stream`] for a failed call, a working controller has ended Slave Mode and stopped the
    /// robot, but this may be unverified: the drop of the [`Arm`] leaves Slave Mode and halts the robot.
    ///
    /// # Cancel safety
    ///
    /// **Dropping the future stops the robot** in an orderly way, as [`Next::Stop`] does: from the next pose on it slows down
    /// along its current direction.
    pub async fn stream(
        &mut self,
        format: Format,
        limits: AxisLimits,
        trajectory: impl Trajectory + Send + 'static,
    ) -> Result<Stats, Error> {
        let here = Arc::new(());
        let mut trajectory = WhileWanted { trajectory, caller: Arc::downgrade(&here), panic: None };
        self.run(move |session| {
            Box::pin(async move {
                let ended = session.stream(format, limits, &mut trajectory).await;
                match trajectory.panic {
                    // in the caller
                    Some(panic) => resume_unwind(panic),
                    None => ended,
                }
            })
        })
        .await
    }

    /// Returns the robot, to read its position.
    #[must_use]
    pub const fn robot(&self) -> &Robot {
        &self.robot
    }

    /// Gives the arm back, as a drop does, and reports whether that succeeded.
    ///
    /// # Errors
    ///
    /// The first [`Error`].
    ///
    /// # Cancel safety
    ///
    /// The arm is given back even if the future is dropped.
    pub async fn give(self) -> Result<(), Error> {
        self.run(|session| Box::pin(session.give_arm())).await
    }

    /// Runs a function in the session in which the arm was taken.
    async fn run<T, F>(&self, work: F) -> Result<T, Error>
    where
        F: for<'a> FnOnce(&'a mut Session<Socket>) -> BoxFuture<'a, Result<T, Error>> + Send + 'static,
        T: Send + 'static,
    {
        let id = self.id;
        self.robot
            .handle
            .run(
                move |session| {
                    if session.arm_id() == id { work(session) } else { Box::pin(async { Err(Error::ArmLost) }) }
                },
            )
            .await
    }
}

impl Moving<'_> {
    /// Returns the robot, to read its position.
    #[must_use]
    pub fn robot(&self) -> Robot {
        Robot::new(self.handle.clone())
    }
}

/// A trajectory that stops when its caller drops the stream, and when it panics.
struct WhileWanted<T> {
    trajectory: T,
    caller: Weak<()>,
    panic: Option<Box<dyn Any + Send>>,
}

impl<T: Trajectory> WhileWanted<T> {
    /// Calls the trajectory, unless it has panicked.
    fn call<R>(&mut self, call: impl FnOnce(&mut T) -> R) -> Option<R> {
        let Self { trajectory, panic, .. } = self;
        caught(panic, || call(trajectory))
    }
}

/// Calls a function, unless an earlier call has panicked.
fn caught<R>(panic: &mut Option<Box<dyn Any + Send>>, call: impl FnOnce() -> R) -> Option<R> {
    if panic.is_some() {
        return None;
    }
    catch_unwind(AssertUnwindSafe(call)).map_err(|payload| *panic = Some(payload)).ok()
}

impl<T: Trajectory> Trajectory for WhileWanted<T> {
    fn next(&mut self, cycle: &Cycle<'_>) -> Next {
        let wanted = self.caller.strong_count() > 0;
        let next = if wanted { self.call(|trajectory| trajectory.next(cycle)) } else { None };
        next.unwrap_or(Next::Stop)
    }

    fn moved(&mut self, reply: &MoveReply<'_>, now: Instant) {
        self.call(|trajectory| trajectory.moved(reply, now));
    }

    fn outputs(&mut self) -> Option<Outputs<'_>> {
        let Self { trajectory, panic, .. } = self;
        caught(panic, || trajectory.outputs()).flatten()
    }
}

impl Drop for Arm {
    fn drop(&mut self) {
        // when the task has ended, it has given the arm back
        let _ = self.robot.handle.send(Request::GiveArm(self.id));
    }
}

impl Stopper {
    pub(super) const fn new(handle: Handle) -> Self {
        Self { handle }
    }

    /// Connects to the controller at an [`Address`], and opens the robot of the settings. A program that moves the robot
    /// itself calls [`Controller::stopper`](super::Controller::stopper).
    ///
    /// # Errors
    ///
    /// An [`Error`] for a wrong address, a failed connection, or a refused call.
    ///
    /// # Cancel safety
    ///
    /// Dropping the future closes the connection.
    pub async fn connect(address: &str, settings: &Settings) -> Result<Self, Error> {
        Self::open(address.parse()?, settings).await
    }

    pub(super) async fn open(address: Address, settings: &Settings) -> Result<Self, Error> {
        match address {
            Address::Serial(_) => Err(Error::NoSecondSession),
            address => Ok(Self::new(Handle::connect(address, settings, true).await?)),
        }
    }

    /// Starts the session of a stopper over a stream of the caller. It does not connect again.
    ///
    /// # Errors
    ///
    /// An [`Error`] for a refused call, or one without a reply.
    ///
    /// # Cancel safety
    ///
    /// Dropping the future drops the stream.
    pub async fn over(
        stream: impl SendTransport<Error = io::Error> + Send + Sync + 'static,
        settings: &Settings,
    ) -> Result<Self, Error> {
        Ok(Self::new(Handle::over(stream, settings, true).await?))
    }

    /// Halts the robot, and waits until it rests. If the connection is lost, the halt has no reply, or the controller has
    /// ended the session, it connects again once.
    ///
    /// A controller refuses a halt while one of its tasks owns the arm. Then all tasks are stopped (KillAll, or Task_Stop of
    /// each task if KillAll is refused or has no effect), and the robot is halted again: [`Halted::TasksStopped`]. The next
    /// start of such a task begins at its first line. After each of these steps the robot is polled until it rests, at most for
    /// one second.
    ///
    /// # Errors
    ///
    /// An [`Error`]; the robot may still move. [`Error::NotHalted`] if the robot did not stop, or the controller kept refusing
    /// the halt.
    ///
    /// # Cancel safety
    ///
    /// The robot is halted even if the future is dropped after its first poll, but then it does not connect again after a halt
    /// without a reply.
    pub async fn halt(&self) -> Result<Halted, Error> {
        let reconnects = self.handle.address.is_some();
        let halt = || {
            self.handle.run_always(move |session| {
                Box::pin(async move {
                    let halted = session.halt_and_verify().await;
                    if reconnects && halted.as_ref().is_err_and(Error::ends_session) {
                        session.abandon();
                    }
                    halted
                })
            })
        };
        match halt().await {
            Err(error) if reconnects && error.ends_session() => halt().await,
            ended => ended,
        }
    }
}
