//! A controller as an object for tokio.

use std::io;
use std::time::Duration;

use bcap_core::bcap::Object;
use bcap_core::bcap::call::{Call, ControllerHandle};
use bcap_core::variant::{Encode, FromVariant, OwnedVariant};
use tokio::sync::oneshot;

use super::SendTransport;
use super::actor::Request;
use super::handle::{Handle, owned};
use super::objects::{File, Task};
use super::robot::{Robot, Stopper};
use super::state::{Recoveries, State, States, Statistics};
use super::subscription::Subscription;
use crate::address::AddressError;
use crate::error::Error;
use crate::reply::OwnedReply;
use crate::session::{CONTROLLER, POLL, RuntimeCall, TimedReading, meets};
use crate::settings::Settings;

/// A session with a controller, which a background task keeps open.
///
/// The handle can be cloned and sent to other tasks. All calls are carried out sequentially. When the connection is lost, calls
/// fail with [`Error::NotConnected`], and the task connects again until it succeeds. No call is made twice. Over UDP a
/// controller can end the session without notice; the first call that it then refuses counts as the loss. When the last handle
/// is dropped, the task gives the arm back, releases all objects and stops the service.
///
/// # Cancel safety
///
/// If the future of a call is dropped before the call's turn, the call is not made. Otherwise it is completed, and its result
/// is dropped. A motion is different: see [`Arm::move_to`](super::Arm::move_to).
///
/// # Examples
///
/// ```no_run
/// # async fn example() -> Result<(), bcap_std::Error> {
/// use std::time::Duration;
///
/// use bcap_std::asynch::Controller;
/// use bcap_std::{Motion, Move, Settings};
///
/// let cell = Controller::connect("tcp:192.168.0.1", &Settings::rc9()).await?;
/// let count: i32 = cell.read("I1").await?;
/// cell.write("I1", count + 1).await?;
///
/// let mut arm = cell.robot().await?.take_arm().await?;
/// arm.motor_on().await?;
/// match arm.move_to(&Move::line("P1").speed_percent(10.0), Duration::from_secs(30)).await? {
///     Motion::Arrived => println!("at P1"),
///     other => println!("not at P1: {other:?}"),
/// }
/// # Ok(())
/// # }
/// ```
#[derive(Clone, Debug)]
pub struct Controller {
    handle: Handle,
}

impl Controller {
    /// Connects to the controller at `tcp:HOST[:PORT]`, `udp:HOST[:PORT]` or `serial:PATH[?baud=N&parity=P&stop=S]`
    /// ([`Address`](crate::Address)), and starts a session with a watchdog. Serial lines need the feature `serial`.
    ///
    /// # Errors
    ///
    /// An [`Error`] for a wrong address, a failed connection, or a refused call. Nothing stays open then.
    ///
    /// # Cancel safety
    ///
    /// Dropping the future closes the connection.
    pub async fn connect(address: &str, settings: &Settings) -> Result<Self, Error> {
        Ok(Self { handle: Handle::connect(address.parse()?, settings, false).await? })
    }

    /// Connects in the background, and retries until it succeeds.
    ///
    /// # Errors
    ///
    /// An [`AddressError`].
    ///
    /// # Panics
    ///
    /// Outside of a runtime of tokio.
    pub fn spawn(address: &str, settings: &Settings) -> Result<Self, AddressError> {
        Ok(Self { handle: Handle::start(Some(address.parse()?), settings, false, None) })
    }

    /// Starts a session over a stream of the caller, such as a `Wire` to the virtual controller in memory. The session is
    /// not opened again.
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
        Ok(Self { handle: Handle::over(stream, settings, false).await? })
    }

    /// Reads a variable of the controller, such as `I1`, `P5`, `IO128` or `@CURRENT_TIME`, or of one of its objects, such as
    /// `robot/@SERVO_ON` or `task:Pro1/@STATUS` ([`ObjectPath::variable`](crate::ObjectPath::variable)). All functions that take
    /// names of variables take such paths.
    ///
    /// The value is converted without loss: `i64` and `f64` take any number, `[f64; 7]` a position of R4 numbers.
    ///
    /// # Errors
    ///
    /// An [`Error`]; [`Error::Value`] if the value has another type, [`Error::Path`] for an invalid path.
    ///
    /// # Cancel safety
    ///
    /// Same as [`Controller`].
    pub async fn read<T: for<'a> FromVariant<'a> + Send + 'static>(&self, name: &str) -> Result<T, Error> {
        let name = name.to_owned();
        self.handle.run(move |session| Box::pin(async move { session.read(Object::Controller, &name).await })).await
    }

    /// Reads several variables of any type; each is opened once and stays open for the next time.
    ///
    /// # Errors
    ///
    /// An [`Error`] for the first variable that cannot be read.
    ///
    /// # Cancel safety
    ///
    /// Same as [`Controller`].
    pub async fn read_all<const N: usize>(&self, names: [&str; N]) -> Result<[OwnedVariant; N], Error> {
        let names = names.map(str::to_owned);
        self.handle.run(move |session| Box::pin(async move { session.read_all(&names).await })).await
    }

    /// Reads several variables of any type in one turn. Returns for each the arrival time of its reply, and its value or error.
    /// Other calls wait until the turn ends.
    ///
    /// After a timeout or a loss of the connection the rest is not read, and the result is shorter than `names`. So a
    /// controller that stops responding costs one timeout, not one for each name.
    ///
    /// # Errors
    ///
    /// An [`Error`] if there is no session.
    ///
    /// # Cancel safety
    ///
    /// Same as [`Controller`].
    ///
    /// # Examples
    ///
    /// ```no_run
    /// # async fn example(cell: bcap_std::asynch::Controller) -> Result<(), bcap_std::Error> {
    /// for (arrived, value) in cell.read_each(&["I1", "P1", "@MODE"]).await? {
    ///     println!("{value:?}, {} ms ago", arrived.elapsed().as_millis());
    /// }
    /// # Ok(())
    /// # }
    /// ```
    pub async fn read_each(&self, names: &[&str]) -> Result<Vec<TimedReading>, Error> {
        let names: Vec<_> = names.iter().map(|name| (*name).to_owned()).collect();
        self.handle.run(move |session| Box::pin(async move { Ok(session.read_each(&names).await) })).await
    }

    /// Reads a variable every 10 ms until its value meets a condition, at most for `limit`, and returns that value. Other calls
    /// run between the readings.
    ///
    /// # Errors
    ///
    /// [`Error::NotMet`] after `limit`; the [`Error`] of a reading that fails.
    ///
    /// # Cancel safety
    ///
    /// Same as [`Controller`].
    ///
    /// # Examples
    ///
    /// ```no_run
    /// # async fn example(cell: bcap_std::asynch::Controller) -> Result<(), bcap_std::Error> {
    /// # use std::time::Duration;
    /// cell.read_until("IO129", |closed: &bool| *closed, Duration::from_secs(2)).await?;
    /// # Ok(())
    /// # }
    /// ```
    pub async fn read_until<T: for<'a> FromVariant<'a>>(
        &self,
        name: &str,
        mut condition: impl FnMut(&T) -> bool,
        limit: Duration,
    ) -> Result<T, Error> {
        // no end if the clock cannot represent it
        let end = tokio::time::Instant::now().checked_add(limit);
        loop {
            let value: OwnedVariant = self.read(name).await?;
            if let Some(met) = meets(name, &value, &mut condition)? {
                return Ok(met);
            }
            let now = tokio::time::Instant::now();
            if end.is_some_and(|end| now >= end) {
                return Err(Error::NotMet { object: name.to_owned(), limit, last: value });
            }
            let next = now + POLL;
            tokio::time::sleep_until(end.map_or(next, |end| end.min(next))).await;
        }
    }

    /// Returns this controller with a time limit for each of its calls. Motions have their own limit, and a halt has none.
    ///
    /// The limit starts when the call is sent, after earlier calls have ended. A call without a reply in this time fails with
    /// [`Error::NoReply`]; the controller may have executed it. The connection stays usable.
    ///
    /// # Examples
    ///
    /// ```no_run
    /// # async fn example(cell: bcap_std::asynch::Controller) -> Result<(), bcap_std::Error> {
    /// # use std::time::Duration;
    /// let count: i32 = cell.within(Duration::from_millis(200)).read("I1").await?;
    /// # Ok(())
    /// # }
    /// ```
    #[must_use]
    pub fn within(&self, limit: Duration) -> Self {
        Self { handle: self.handle.within(limit) }
    }

    /// Writes a variable of the controller.
    ///
    /// # Errors
    ///
    /// An [`Error`]. After [`Error::NoReply`] the value may have been written.
    ///
    /// # Cancel safety
    ///
    /// Same as [`Controller`].
    pub async fn write(&self, name: &str, value: impl Encode) -> Result<(), Error> {
        let (name, value) = (name.to_owned(), owned(&value)?);
        self.handle
            .run(move |session| Box::pin(async move { session.write(Object::Controller, &name, value).await }))
            .await
    }

    /// Reads variables every `interval`, and reports their changes, each with its name and the time of its reply. All
    /// subscriptions share one scan of the controller; they outlast a lost connection.
    ///
    /// # Examples
    ///
    /// ```no_run
    /// # async fn example(cell: bcap_std::asynch::Controller) {
    /// let mut changes = cell.subscribe(&["I1", "robot/@SERVO_ON"], std::time::Duration::from_millis(100));
    /// while let Some(reading) = changes.next().await {
    ///     match reading.value {
    ///         Ok(value) => println!("{} = {value:?}, {} ms ago", reading.name, reading.at.elapsed().as_millis()),
    ///         Err(error) => println!("{} is unknown: {error}", reading.name),
    ///     }
    /// }
    /// # }
    /// ```
    pub fn subscribe(&self, names: &[&str], interval: Duration) -> Subscription {
        let (subscription, subscribers) = Subscription::new(names);
        // the subscription ends with the task
        let _ = self.handle.send(Request::Subscribe(subscribers, interval));
        subscription
    }

    /// Returns the robot of the settings; without a name it is the first robot that the controller lists.
    ///
    /// # Errors
    ///
    /// An [`Error`] if the controller has no such robot.
    ///
    /// # Cancel safety
    ///
    /// Same as [`Controller`].
    pub async fn robot(&self) -> Result<Robot, Error> {
        self.handle.run(|session| Box::pin(async { session.robot().await.map(drop) })).await?;
        Ok(Robot::new(self.handle.clone()))
    }

    /// Returns a task, such as `Pro1`.
    ///
    /// # Errors
    ///
    /// An [`Error`] if the controller has no such task.
    ///
    /// # Cancel safety
    ///
    /// Same as [`Controller`].
    pub async fn task(&self, name: &str) -> Result<Task, Error> {
        let name = name.to_owned();
        let task = Task::new(self.handle.clone(), name.clone());
        self.handle.run(move |session| Box::pin(async move { session.task(&name).await.map(drop) })).await?;
        Ok(task)
    }

    /// Returns a file, which must exist when it is read or written. A path has `\` between its parts.
    #[must_use]
    pub fn file(&self, name: &str) -> File {
        File::new(self.handle.clone(), name.to_owned())
    }

    /// Opens a second connection, over which the robot can be halted at any time.
    ///
    /// # Errors
    ///
    /// Same as [`connect`](Self::connect), plus [`Error::NoAddress`] for a controller over a stream of the caller, which needs
    /// [`Stopper::over`], and [`Error::NoSecondSession`] for one over a serial line, which carries one session.
    ///
    /// # Cancel safety
    ///
    /// Dropping the future closes the second connection.
    pub async fn stopper(&self) -> Result<Stopper, Error> {
        let Handle { address, settings, .. } = &self.handle;
        Stopper::open(address.clone().ok_or(Error::NoAddress)?, settings).await
    }

    /// Executes a command of the controller with a parameter, such as `ClearError` with `()`.
    ///
    /// # Errors
    ///
    /// An [`Error`]; [`Error::Value`] if the value of the reply has another type.
    ///
    /// # Cancel safety
    ///
    /// Same as [`Controller`].
    pub async fn execute<T: for<'a> FromVariant<'a> + Send + 'static>(
        &self,
        command: &str,
        parameter: impl Encode,
    ) -> Result<T, Error> {
        let (command, parameter) = (command.to_owned(), owned(&parameter)?);
        self.handle.run(move |session| Box::pin(async move { session.execute(&command, parameter).await })).await
    }

    /// Returns the handle of the controller in the current session, for [`call`](Self::call).
    ///
    /// # Errors
    ///
    /// An [`Error`] if there is no session.
    ///
    /// # Cancel safety
    ///
    /// Same as [`Controller`].
    pub async fn handle(&self) -> Result<ControllerHandle, Error> {
        self.handle.run(|session| Box::pin(async { Ok(session.handle) })).await
    }

    /// Calls any function, and returns a copy of the value of its reply ([`OwnedReply`]).
    ///
    /// The handle of an object is valid in the session that opened it. Objects that the call opens are released with the
    /// session, if the caller does not. Dropping the future does not stop a call that moves the robot; only a [`Stopper`] does.
    ///
    /// # Errors
    ///
    /// An [`Error`].
    ///
    /// # Cancel safety
    ///
    /// Same as [`Controller`].
    ///
    /// # Examples
    ///
    /// ```no_run
    /// # async fn example(cell: bcap_std::asynch::Controller) -> Result<(), bcap_std::Error> {
    /// # use bcap_std::core::bcap::call;
    /// let handle = cell.handle().await?;
    /// println!("{:?}", cell.call(call::controller_get_robot_names(handle, "")).await?);
    /// # Ok(())
    /// # }
    /// ```
    pub async fn call<C: Call<Reply: OwnedReply>>(&self, call: C) -> Result<<C::Reply as OwnedReply>::Owned, Error> {
        let call = RuntimeCall::of(&call)?;
        self.handle.run(move |session| Box::pin(async move { session.call_recorded(CONTROLLER, call).await })).await
    }

    /// Returns the states of the connection, beginning with the current state.
    pub fn states(&self) -> States {
        States::new(self.handle.state.clone())
    }

    /// Returns the recoveries of the robot after lost connections whose session had taken the arm: the robot is halted,
    /// the motor that was switched on is switched off, and the arm is given back, before any other call.
    pub fn recoveries(&self) -> Recoveries {
        Recoveries::new(self.handle.recovered.clone())
    }

    /// Returns the current state of the connection.
    #[must_use]
    pub fn state(&self) -> State {
        self.handle.state.borrow().clone()
    }

    /// Waits until there is a session.
    ///
    /// # Errors
    ///
    /// [`Error::Closed`] when the task has ended.
    ///
    /// # Cancel safety
    ///
    /// Dropping the future has no effect.
    pub async fn connected(&self) -> Result<(), Error> {
        let mut state = self.handle.state.clone();
        match state.wait_for(|state| matches!(state, State::Connected | State::Closed)).await {
            Ok(state) if *state == State::Connected => Ok(()),
            _ => Err(Error::Closed),
        }
    }

    /// Returns the counters, such as for an exporter of metrics.
    #[must_use]
    pub fn statistics(&self) -> Statistics {
        self.handle.counters.read()
    }

    /// Gives the arm back, releases all objects, stops the service and ends the task, for all other handles too. After a lost
    /// connection it connects once more to give the arm back, with calls that block the thread for some seconds.
    ///
    /// # Errors
    ///
    /// An [`Error`] if the arm was not given back with the motor off, or the session was not closed; [`Error::Closed`] when the task
    /// has ended before.
    ///
    /// # Cancel safety
    ///
    /// The controller is closed even if the future is dropped.
    pub async fn close(self) -> Result<(), Error> {
        let (reply, closed) = oneshot::channel();
        self.handle.send(Request::Close(reply))?;
        closed.await.map_err(|_| Error::Closed)?
    }
}
