//! The session of a controller: its connection, the objects that are open, and the arm.
//!
//! It is written once, as asynchronous functions. The objects of [`blocking`](crate::blocking) run them over a transport
//! whose futures are always ready; those of `asynch` run them in a task.

mod any;
mod arm;
mod ending;
mod halt;
mod limit;
mod names;
mod paths;
mod recovery;
#[cfg(feature = "tokio")]
mod steps;
mod variables;

use std::io;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use bcap_core::bcap::call::{
    self, Any, Call, ControllerHandle, ExtensionHandle, FileHandle, Reply, RobotHandle, TaskHandle, VariableHandle,
};
use bcap_core::bcap::client::{ClientError, Timing};
use bcap_core::bcap::{FrameWriter, FunctionId, Object};
use bcap_core::error::EncodeError;
use bcap_core::hresult::HResult;
use bcap_core::io::asynch::{Connection, Transport};
use bcap_core::procedure::{
    self, Handles, MotionQueue, MotionStart, Owner, PathError, PathStep, Procedure, Provider, StepCause, StepError,
    StoppedTasks, Target, Until,
};
use bcap_core::slave::{AxisLimits, Config, Engine, Format, MOVE_FRAME, Stats, StreamError, Trajectory};
use bcap_core::time::Instant;
use bcap_core::variant::{Encode, FromVariant, OwnedVariant};
// the hasher of the standard library takes a seventh of the instructions of a read, against names that the caller chooses
use foldhash::HashMap;

use crate::error::Error;
use crate::moves::Move;
use crate::settings::Settings;
use crate::task::{TaskStart, TaskStatus, TaskStop};
use crate::{CallError, RunError};

pub(crate) use self::any::RuntimeCall;
#[cfg(feature = "tokio")]
pub(crate) use self::arm::ArmId;
pub(crate) use self::arm::Left;
use self::arm::{ArmEffect, ArmState, UNNOTICED};
use self::paths::Paths;
pub use self::variables::TimedReading;
#[cfg(feature = "tokio")]
pub(crate) use self::variables::{POLL, meets};

/// A started session.
#[derive(Debug)]
pub(crate) struct Session<X> {
    connection: Connection<X, Vec<u8>>,
    /// The session ID, unique within the process.
    pub(crate) id: u64,
    pub(crate) handle: ControllerHandle,
    robot_name: Option<String>,
    objects: Objects,
    arm: ArmState,
    /// The number of times that the arm was taken.
    takes: u64,
    /// Whether the end of the session leaves the arm as it is.
    keep: bool,
    /// The timing of the client without the limit that applies now.
    usual_timing: Option<Timing>,
    link: LinkState,
}

/// The open objects of a session.
#[derive(Debug, Default)]
struct Objects {
    robot: Option<RobotHandle>,
    /// The handles of variables, by their owner and by name.
    variables: HashMap<(Object, i32), HashMap<String, VariableHandle>>,
    /// The handles of the controller's variables by their paths, which repeated reads use. Cleared whenever a handle is
    /// dropped.
    paths: Paths,
    /// The handles of other objects, by the handle of their owner and by name.
    others: HashMap<(Object, i32, String), i32>,
    /// All open objects, in the order in which they were opened, from the service on.
    opened: Vec<(Object, i32)>,
    /// The open variables that switch the motor.
    motor_switches: Vec<VariableHandle>,
}

impl Objects {
    /// Returns the handle of a variable that was used before by this path.
    fn known(&mut self, owner: Object, path: &str) -> Option<VariableHandle> {
        if owner == Object::Controller { self.paths.get(path) } else { None }
    }
}

/// Whether the link of a session works.
#[derive(Debug, Default)]
struct LinkState {
    /// Why the connection can no longer be used.
    lost: Option<String>,
    /// Since when no call had a reply.
    silent_since: Option<Instant>,
    /// Whether the controller has closed the connection, or otherwise ended the session.
    is_closed: bool,
    /// Whether a call was refused as in a session that has ended.
    is_doubtful: bool,
}

/// The effect of a halt.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
#[must_use]
pub enum Halted {
    /// The robot was moving, and has been halted.
    Halted,
    /// The robot was not moving.
    NothingMoved,
    /// The controller refused the halt or the robot moved on, so tasks were stopped. Then the robot was halted.
    TasksStopped(StoppedTasks),
}

/// The object that errors name when a session starts or ends.
pub(crate) const SESSION: &str = "the session";
/// The object that errors name for a typed call.
pub(crate) const CONTROLLER: &str = "the controller";
/// The object that errors name for a robot.
pub(crate) const ROBOT: &str = "the robot";
/// The time limit of a call at the end of a session.
const CLOSE: Duration = Duration::from_secs(1);

impl<X: Transport<Error = io::Error>> Session<X> {
    /// Starts the service and connects to the controller.
    pub(crate) async fn start(mut connection: Connection<X, Vec<u8>>, settings: &Settings) -> Result<Self, Error> {
        let service = settings.service.to_text();
        let option = &settings.connect_option;
        let provider = Provider { service: &service, option, ..Provider::new(settings.model.provider()) };
        let opened = connection.run(procedure::open(provider)).await;
        let handle = opened.map_err(|error| Error::run(SESSION, error))?;
        let opened = vec![(Object::Service, 0), (Object::Controller, handle.0)];
        let objects = Objects { opened, ..Objects::default() };
        let robot_name = settings.robot.clone();
        Ok(Self { handle, robot_name, objects, keep: settings.keep, ..Self::unopened(connection) })
    }

    /// Wraps a connection over which nothing is open.
    pub(crate) fn unopened(connection: Connection<X, Vec<u8>>) -> Self {
        static NEXT: AtomicU64 = AtomicU64::new(1);
        Self {
            connection,
            id: NEXT.fetch_add(1, Ordering::Relaxed),
            handle: ControllerHandle(0),
            robot_name: None,
            objects: Objects::default(),
            arm: ArmState::default(),
            takes: 0,
            keep: false,
            usual_timing: None,
            link: LinkState::default(),
        }
    }

    /// Returns the handle of the robot, and opens it when it is first used.
    pub(crate) async fn robot(&mut self) -> Result<RobotHandle, Error> {
        if let Some(handle) = self.objects.robot {
            return Ok(handle);
        }
        let name = self.robot_name.take();
        let step = PathStep { object: Object::Robot, name: name.as_deref() };
        let opened = self.open(Object::Controller, self.handle.0, step).await;
        self.robot_name = name;
        let handle = RobotHandle(opened?);
        self.objects.robot = Some(handle);
        Ok(handle)
    }

    async fn handles(&mut self) -> Result<Handles, Error> {
        Ok(Handles { robot: self.robot().await?, controller: self.handle })
    }

    /// Makes a call; `object` is named in errors.
    pub(crate) async fn call<C: Call>(
        &mut self,
        object: &str,
        call: C,
    ) -> Result<<C::Reply as Reply>::Value<'_>, Error> {
        let function = call.function();
        let connection = &mut self.connection;
        let began = tracing::enabled!(tracing::Level::DEBUG).then(|| (connection.client().next_serial(), crate::now()));
        let result = connection.exchange(call).await;
        if let Some((serial, began)) = began {
            let duration = crate::now().saturating_since(began);
            let error = result.as_ref().err().map(tracing::field::display);
            tracing::debug!(%function, object, serial, ?duration, error, "call");
        }
        self.observe(result.as_ref().err());
        if let Err(error) = result {
            let (is_lost, was_sent) = (!error.is_recoverable(), self.connection.client().was_sent());
            return Err(match self.lost() {
                Some(not_sent) if is_lost && !was_sent => not_sent,
                _ => Error::call(function, object, error),
            });
        }
        let value = self.connection.client().value::<C::Reply>();
        value.map_err(|error| Error::call(function, object, error.into()))
    }

    /// Records whether the link works, after a call with this error.
    #[inline]
    fn observe(&mut self, error: Option<&CallError>) {
        match error {
            None => self.link.silent_since = None,
            Some(CallError::Refused(code)) => self.observe_refusal(*code),
            Some(error) => self.observe_failure(error),
        }
    }

    fn observe_refusal(&mut self, code: HResult) {
        self.link.silent_since = None;
        self.link.is_doubtful |= matches!(code, HResult::E_HANDLE | HResult::E_NOT_CONNECTED);
    }

    #[cold]
    fn observe_failure(&mut self, error: &CallError) {
        let timing = self.connection.client().timing();
        let waited = timing.attempt_timeout.saturating_mul(timing.attempts.into()).min(timing.deadline);
        // the silence of the link: an upper bound, or a lower bound if the operating system abandoned the connection
        let waited = match error {
            CallError::Client(ClientError::Timeout(_)) => waited,
            CallError::Io(error) if error.kind() == io::ErrorKind::TimedOut => UNNOTICED,
            _ => Duration::ZERO,
        };
        let now = self.connection.transport().now();
        self.link.silent_since.get_or_insert(now.saturating_sub(waited));
        if !error.is_recoverable() {
            self.link.lost.get_or_insert_with(|| error.to_string());
            self.link.is_closed |= is_closed(error);
        }
    }

    /// Records that the connection was lost while no call ran. Returns the error of a call that is not sent.
    #[cfg(feature = "tokio")]
    pub(crate) fn lose(&mut self, error: &CallError) -> Error {
        self.observe_failure(error);
        Error::NotConnected { reason: error.to_string() }
    }

    /// Abandons the connection, because the controller does not answer over it or has ended its session.
    #[cfg(feature = "tokio")]
    pub(crate) fn abandon(&mut self) {
        self.link.lost.get_or_insert_with(|| "the controller did not answer, or has ended the session".to_owned());
    }

    /// Checks whether the controller has ended this session, after a refusal that suggests it. Over UDP a controller can end a
    /// session without notice, such as when it evicts a peer or restarts; then the session counts as lost.
    #[cfg(feature = "tokio")]
    pub(crate) async fn verify(&mut self) {
        if !self.link.is_doubtful || !self.outlasts_its_link() || self.link.lost.is_some() {
            return;
        }
        // Slave Mode allows this call; the session exists unless the answer is the end of a session
        match self.open(Object::Controller, self.handle.0, PathStep::variable("@ERROR_CODE")).await {
            Ok(handle) => drop(self.release_object(Object::Variable, handle).await),
            Err(error) if error.ends_session() && error.code().is_some() => {
                self.link.lost = Some("the controller has ended the session".to_owned());
                self.link.is_closed = true;
            }
            Err(_) => {}
        }
        self.link.is_doubtful = false;
    }

    /// Returns the error of a call that is not sent, if the connection can no longer be used.
    pub(crate) fn lost(&self) -> Option<Error> {
        self.link.lost.clone().map(|reason| Error::NotConnected { reason })
    }

    /// Makes a call and converts its value.
    pub(crate) async fn value<T, C>(&mut self, object: &str, call: C) -> Result<T, Error>
    where
        T: for<'a> FromVariant<'a>,
        C: Call<Reply = Any>,
    {
        let value = self.call(object, call).await?;
        T::from_variant(value).map_err(|source| Error::Value { object: object.to_owned(), source })
    }

    /// Executes a command of the controller for the caller.
    pub(crate) async fn execute<T: for<'a> FromVariant<'a>>(
        &mut self,
        command: &str,
        parameter: impl Encode,
    ) -> Result<T, Error> {
        self.execute_recorded((FunctionId::CONTROLLER_EXECUTE, self.handle.0), command, parameter).await
    }

    /// Executes a command of the robot for the caller, which may also be one that takes the arm or moves.
    pub(crate) async fn execute_any_of_robot<T: for<'a> FromVariant<'a>>(
        &mut self,
        command: &str,
        parameter: impl Encode,
    ) -> Result<T, Error> {
        let robot = self.robot().await?;
        self.execute_recorded((FunctionId::ROBOT_EXECUTE, robot.0), command, parameter).await
    }

    /// Executes a command of the robot that changes nothing, or whose effect the session records itself.
    pub(crate) async fn execute_robot<T: for<'a> FromVariant<'a>>(
        &mut self,
        command: &str,
        parameter: impl Encode,
    ) -> Result<T, Error> {
        let robot = self.robot().await?;
        self.value(command, call::robot_execute(robot, command, parameter)).await
    }

    /// Runs a procedure; `object` is named in errors.
    async fn run<P: Procedure<Error = StepError>>(&mut self, object: &str, procedure: P) -> Result<P::Output, Error> {
        let ended = self.connection.run(procedure).await;
        self.ended(object, ended)
    }

    fn ended<T>(&mut self, object: &str, ended: Result<T, RunError>) -> Result<T, Error> {
        match ended.as_ref().err().map(|error| (&error.call, error.error.cause)) {
            Some((None, StepCause::Refused(code))) => self.observe_refusal(code),
            error => self.observe(error.and_then(|(call, _)| call.as_ref())),
        }
        ended.map_err(|error| {
            let lost = error.call.as_ref().filter(|call| !call.is_recoverable()).map(ToString::to_string);
            match lost {
                Some(reason) if error.error.had_no_effect() => Error::NotConnected { reason },
                _ => Error::run(object, error),
            }
        })
    }

    /// Reads a variable of the controller, or of one of its objects by a path, or of the robot.
    pub(crate) async fn read<T: for<'a> FromVariant<'a>>(&mut self, owner: Object, name: &str) -> Result<T, Error> {
        let variable = match self.objects.known(owner, name) {
            Some(known) => known,
            None => self.variable(owner, name).await?,
        };
        self.value(name, call::variable_get_value(variable)).await
    }

    /// Writes a variable of the controller, or of one of its objects by a path, or of the robot.
    pub(crate) async fn write(&mut self, owner: Object, name: &str, value: impl Encode) -> Result<(), Error> {
        let variable = match self.objects.known(owner, name) {
            Some(known) => known,
            None => self.variable(owner, name).await?,
        };
        if !is_motor_switch(name) {
            return self.call(name, call::variable_put_value(variable, value)).await;
        }
        let on = OwnedVariant::new(&value)?.as_variant().as_bool() != Some(false);
        let before = self.arm;
        self.arm.begin(ArmEffect::Motor(on));
        let written = self.call(name, call::variable_put_value(variable, value)).await;
        self.arm_ended(ArmEffect::Motor(on), before, written.as_ref().copied());
        written
    }

    /// Returns the handle of a variable, and opens it when it is first used.
    pub(crate) async fn variable(&mut self, owner: Object, path: &str) -> Result<VariableHandle, Error> {
        if let Some(known) = self.objects.known(owner, path) {
            return Ok(known);
        }
        let is_path = owner == Object::Controller;
        let (owner, handle, name) = self.owner_of(owner, path).await?;
        let known = self.objects.variables.get(&(owner, handle)).and_then(|names| names.get(&*name));
        let variable = match known {
            Some(known) => *known,
            None => {
                let variable = VariableHandle(self.open(owner, handle, PathStep::variable(&name)).await?);
                self.objects.variables.entry((owner, handle)).or_default().insert(name.into_owned(), variable);
                variable
            }
        };
        if is_path {
            self.objects.paths.add(path, variable);
        }
        Ok(variable)
    }

    /// Returns the handle of a task or a file, and opens it when it is first used.
    async fn object(&mut self, object: Object, name: &str) -> Result<i32, Error> {
        self.object_of((Object::Controller, self.handle.0), PathStep { object, name: Some(name) }).await
    }

    /// Returns the handle of an object with this owner, and opens it when it is first used.
    async fn object_of(&mut self, owner: (Object, i32), step: PathStep<'_>) -> Result<i32, Error> {
        let key = (step.object, owner.1, step.name.unwrap_or_default().to_owned());
        if let Some(known) = self.objects.others.get(&key) {
            return Ok(*known);
        }
        let handle = self.open(owner.0, owner.1, step).await?;
        self.objects.others.insert(key, handle);
        Ok(handle)
    }

    /// Returns the handle of a task.
    pub(crate) async fn task(&mut self, name: &str) -> Result<TaskHandle, Error> {
        self.object(Object::Task, name).await.map(TaskHandle)
    }

    /// Starts a task.
    pub(crate) async fn start_task(&mut self, name: &str, mode: TaskStart) -> Result<(), Error> {
        let task = self.task(name).await?;
        self.call(name, call::task_start(task, mode.number(), "")).await
    }

    /// Stops a task.
    pub(crate) async fn stop_task(&mut self, name: &str, mode: TaskStop) -> Result<(), Error> {
        let task = self.task(name).await?;
        self.call(name, call::task_stop(task, mode.number(), "")).await
    }

    /// Reads the status of a task.
    pub(crate) async fn task_status(&mut self, name: &str) -> Result<TaskStatus, Error> {
        let task = self.task(name).await?;
        self.value(name, call::task_execute(task, "GetStatus", ())).await.map(TaskStatus::of)
    }

    /// Reads the content of a file.
    pub(crate) async fn read_file(&mut self, name: &str) -> Result<OwnedVariant, Error> {
        let file = FileHandle(self.object(Object::File, name).await?);
        self.value(name, call::file_get_value(file)).await
    }

    /// Replaces the content of a file.
    pub(crate) async fn write_file(&mut self, name: &str, content: impl Encode) -> Result<(), Error> {
        let file = FileHandle(self.object(Object::File, name).await?);
        self.call(name, call::file_put_value(file, content)).await
    }

    /// Opens an object.
    async fn open(&mut self, object: Object, owner: i32, step: PathStep<'_>) -> Result<i32, Error> {
        let name = step.name.unwrap_or("the first robot");
        let owner: Owner = match object {
            Object::Robot => RobotHandle(owner).into(),
            Object::Task => TaskHandle(owner).into(),
            Object::File => FileHandle(owner).into(),
            Object::Extension => ExtensionHandle(owner).into(),
            _ => ControllerHandle(owner).into(),
        };
        let function = step.object.opened_from(object).unwrap_or(FunctionId::CONTROLLER_GET_VARIABLE);
        let wrong = |error: PathError| Error::Reply { function, object: name.to_owned(), reason: error.to_string() };
        let opened = self.run(name, procedure::open_path(owner, &[step]).map_err(wrong)?).await?;
        let handle = opened.handle().unwrap_or_default();
        self.objects.opened.extend_from_slice(&opened);
        Ok(handle)
    }

    /// Fails if this session has taken the arm. An arm whose GiveArm had no answer is given back first.
    pub(crate) async fn expect_no_arm(&mut self) -> Result<(), Error> {
        if self.arm.unanswered {
            self.end_arm().await?;
        }
        if self.arm.taken { Err(Error::ArmTaken) } else { Ok(()) }
    }

    /// Takes the arm, which keeps its speed, tool and work.
    pub(crate) async fn take_arm(&mut self) -> Result<(), Error> {
        self.expect_no_arm().await?;
        let robot = self.robot().await?;
        // before the call, so that the arm is given back even if the call is abandoned
        self.arm.taken = true;
        self.count_take();
        let taken = self.connection.run(procedure::prepare_robot(robot, [0, 1], false)).await;
        let unsettled = taken.as_ref().err().map(|error| error.error.unsettled);
        let taken = self.ended(ROBOT, taken);
        match unsettled {
            None => {}
            Some(false) => self.arm.taken = false,
            Some(true) if self.link.lost.is_none() => drop(self.undo_rest().await),
            Some(true) => {}
        }
        taken
    }

    /// Ends the effects that a procedure could not undo itself. Returns whether all of them were ended.
    async fn undo_rest(&mut self) -> bool {
        let ended = self.end_arm().await;
        if let Err(error) = &ended {
            tracing::warn!(%error, "the arm was not given back");
        }
        ended.is_ok() && !self.keep
    }

    /// Switches the motor on or off, and waits for completion.
    pub(crate) async fn motor(&mut self, on: bool) -> Result<(), Error> {
        let before = self.arm;
        self.arm.begin(ArmEffect::Motor(on));
        let switched = self.execute_robot::<()>("Motor", [i32::from(on), 0]).await;
        self.arm_ended(ArmEffect::Motor(on), before, switched.as_ref().copied());
        switched
    }

    /// Selects a tool or a work coordinate system.
    pub(crate) async fn change(&mut self, kind: &str, number: u8) -> Result<(), Error> {
        let robot = self.robot().await?;
        let name = format!("{kind}{number}");
        self.call(&name, call::robot_change(robot, &name)).await
    }

    /// Runs the motions of a queue, with one more if there is one.
    pub(crate) async fn run_queue(
        &mut self,
        queue: MotionQueue,
        motion: Option<Move>,
        until: Until,
    ) -> Result<MotionQueue, Error> {
        let running = self.begin_queue(queue, motion, until).await?;
        let queue = self.run(ROBOT, running).await?;
        self.set_moving(queue.ended().is_none());
        Ok(queue)
    }

    /// Returns the procedure that runs the motions of a queue, with one more if there is one.
    async fn begin_queue(
        &mut self,
        queue: MotionQueue,
        motion: Option<Move>,
        until: Until,
    ) -> Result<impl Procedure<Output = MotionQueue, Error = StepError> + Send + use<X>, Error> {
        if queue.is_new() {
            self.clear_way().await?;
        }
        let handles = self.handles().await?;
        let motion = self.aimed(motion).await?;
        self.set_moving(true);
        self.set_destination(queue.is_new(), motion.as_ref().map(|(_, target)| *target));
        Ok(procedure::run_queue(handles, queue, motion, until))
    }

    /// Returns the call that starts a motion, and where the motion ends; opens the variable of the destination.
    async fn aimed(&mut self, motion: Option<Move>) -> Result<Option<(MotionStart<Move, String>, Target)>, Error> {
        let Some(motion) = motion else { return Ok(None) };
        let variable = match motion.variable() {
            Some(name) => match self.variable(Object::Controller, &name).await {
                Ok(variable) => Some(variable),
                // the controller judges the destination itself
                Err(Error::Refused { .. }) => None,
                Err(error) => return Err(error),
            },
            None => None,
        };
        let target = motion.target(variable);
        Ok(Some((motion.start(), target)))
    }

    /// Halts a motion left over from an earlier call, before a new motion starts from rest.
    pub(crate) async fn clear_way(&mut self) -> Result<(), Error> {
        if self.is_moving() { self.halt().await.map(drop) } else { Ok(()) }
    }

    /// Streams poses in Slave Mode with the arm that is taken.
    pub(crate) async fn stream<T: Trajectory + ?Sized>(
        &mut self,
        format: Format,
        limits: AxisLimits,
        trajectory: &mut T,
    ) -> Result<Stats, Error> {
        let handles = self.handles().await?;
        let config = Config { arm: None, motor: false, limits, ..Config::new(format, handles) };
        let mut engine = Engine::<MOVE_FRAME>::new(config).map_err(Error::StreamConfig)?;
        self.set_moving(true);
        self.set_streaming(true);
        let ended = self.connection.run(engine.stream(trajectory)).await;
        self.observe(ended.as_ref().err().and_then(|error: &RunError<StreamError>| error.call.as_ref()));
        ended.map_err(|error| Error::Stream(error.error))?;
        self.set_moving(false);
        self.set_streaming(false);
        Ok(engine.stats().clone())
    }

    /// Returns whether a motion may be in progress.
    pub(crate) fn is_moving(&self) -> bool {
        self.arm.moving
    }

    fn set_moving(&mut self, moving: bool) {
        self.arm.moving = moving && self.arm.taken;
    }

    /// Records where a new motion ends. With several motions it is unknown which of them the robot executes.
    fn set_destination(&mut self, is_first: bool, target: Option<Target>) {
        self.arm.destination = match target {
            Some(target) => Some(target).filter(|_| is_first),
            None => self.arm.destination,
        };
    }

    /// Halts the robot by one call; [`halt_and_verify`](Self::halt_and_verify) waits until it rests. The call is repeated while
    /// the controller still executes an abandoned call.
    pub(crate) async fn halt(&mut self) -> Result<Halted, Error> {
        let robot = self.robot().await?;
        let until = self.busy_limit();
        loop {
            let halted = self.call(ROBOT, call::robot_halt(robot, "")).await.map(drop);
            if !self.waits_while_busy(&halted, until).await {
                break halted?;
            }
        }
        self.set_moving(false);
        Ok(match self.connection.last_result() {
            Some(HResult::S_FALSE) => Halted::NothingMoved,
            _ => Halted::Halted,
        })
    }

    /// Gives the arm back, releases all objects in reverse order and stops the service, once. It ends at the first call
    /// without a reply. Returns the first error: the motor may be on.
    pub(crate) async fn release(&mut self) -> Result<(), Error> {
        let ended = if self.link.lost.is_none() { self.end_arm().await } else { Ok(()) };
        let released = self.release_objects().await;
        ended.and(released)
    }

    /// Returns the timing of a call at the end of the session, with all attempts within [`CLOSE`].
    fn closing(&mut self) -> Timing {
        let timing = self.connection.client().timing();
        let attempt_timeout = timing.attempt_timeout.min(CLOSE / u32::from(timing.attempts).max(1));
        Timing { attempt_timeout, deadline: CLOSE, ..timing }
    }

    /// Releases all objects in reverse order and stops the service, once.
    pub(crate) async fn release_objects(&mut self) -> Result<(), Error> {
        if self.link.lost.is_some() {
            return Ok(());
        }
        let timing = self.closing();
        let mut released = Ok(());
        // each is removed after its call, so that the others can still be released if the runtime ends in between
        while let (Ok(()), Some(&(object, handle))) = (&released, self.objects.opened.last()) {
            match self.connection.call_with(Release { object, handle }, timing).await {
                // an object that cannot be released does not exist
                Ok(()) | Err(CallError::Refused(_)) => drop(self.objects.opened.pop()),
                Err(error) => released = Err(Error::call(object.released_by(), SESSION, error)),
            }
        }
        self.link.lost = Some("it was closed".to_owned());
        released
    }
}

/// Returns whether an error means that the controller has closed the connection, and so has ended its session.
fn is_closed(error: &CallError) -> bool {
    use io::ErrorKind::{BrokenPipe, ConnectionAborted, ConnectionReset, UnexpectedEof};
    match error {
        CallError::Disconnected => true,
        CallError::Io(error) => {
            matches!(error.kind(), BrokenPipe | ConnectionAborted | ConnectionReset | UnexpectedEof)
        }
        _ => false,
    }
}

/// Returns whether writing a variable may switch the motor on, so that giving the arm back switches it off.
fn is_motor_switch(name: &str) -> bool {
    name.rsplit(['/', ':']).next().is_some_and(|name| name.trim().eq_ignore_ascii_case("@SERVO_ON"))
}

/// The call that releases an object.
struct Release {
    object: Object,
    handle: i32,
}

impl Call for Release {
    type Reply = call::Nothing;

    fn function(&self) -> FunctionId {
        self.object.released_by()
    }

    fn arguments(&self, frame: &mut FrameWriter<'_>) -> Result<(), EncodeError> {
        if self.object == Object::Service { Ok(()) } else { frame.argument(&self.handle) }
    }
}
