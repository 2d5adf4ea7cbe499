//! A controller as an object for tokio.

use std::io;
use std::time::{Duration, Instant};

use bcap_core::bcap::call::ControllerHandle;
use bcap_core::bcap::client::ClientError;
use bcap_core::bcap::{FunctionId, Object};
use bcap_core::variant::{Encode, FromVariant, OwnedVariant};
use tokio::sync::oneshot;

use super::SendTransport;
use super::handle::{Handle, owned};
use super::objects::{File, Task};
use super::robot::{Robot, Stopper};
use super::state::{Recoveries, State, States, Statistics};
use super::subscription::Subscription;
use super::task::Request;
use crate::CallError;
use crate::address::{Address, AddressError};
use crate::error::Error;
use crate::settings::Settings;

/// A session with a controller, which a task of its own keeps open.
///
/// The handle can be cloned and sent to other tasks. Their calls are carried out one after another. When the connection is
/// lost, calls fail with [`Error::NotConnected`], and the task connects again until it succeeds. No call is made twice.
/// When the last handle is dropped, the task gives the arm back, releases all objects and stops the service.
///
/// # Cancel safety
///
/// A call whose future is dropped is not made if its turn has not come; otherwise it is completed, and its result is
/// dropped. A motion is different: see [`Arm::move_to`](super::Arm::move_to).
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
/// match arm.move_to(Move::line("P1").speed_percent(10.0), Duration::from_secs(30)).await? {
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
    /// ([`Address`]), and starts a session with a watchdog. Serial lines need the feature `serial`.
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

    /// Begins to connect in the background, and again until it succeeds. It must be called in a runtime of tokio.
    ///
    /// # Errors
    ///
    /// An [`AddressError`].
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
    /// As [`Controller`].
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
    /// As [`Controller`].
    pub async fn read_all<const N: usize>(&self, names: [&str; N]) -> Result<[OwnedVariant; N], Error> {
        let names = names.map(str::to_owned);
        self.handle
            .run(move |session| {
                Box::pin(async move {
                    let mut values = std::array::from_fn(|_| OwnedVariant::default());
                    for (value, name) in values.iter_mut().zip(&names) {
                        *value = session.read(Object::Controller, name).await?;
                    }
                    Ok(values)
                })
            })
            .await
    }

    /// Reads several variables of any type in one turn, and returns for each when its reply arrived, and its value or error.
    /// Other calls wait meanwhile.
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
    /// As [`Controller`].
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
    pub async fn read_each(&self, names: &[&str]) -> Result<Vec<(Instant, Result<OwnedVariant, Error>)>, Error> {
        let names: Vec<_> = names.iter().map(|name| (*name).to_owned()).collect();
        self.handle
            .run(move |session| {
                Box::pin(async move {
                    let mut values = Vec::with_capacity(names.len());
                    for name in &names {
                        let value = match session.lost() {
                            None => session.read(Object::Controller, name).await,
                            Some(error) => Err(error),
                        };
                        let is_last = value.as_ref().is_err_and(|error| is_timeout(error) || session.lost().is_some());
                        values.push((Instant::now(), value));
                        if is_last {
                            break;
                        }
                    }
                    Ok(values)
                })
            })
            .await
    }

    /// Writes a variable of the controller.
    ///
    /// # Errors
    ///
    /// An [`Error`]. After [`Error::NoReply`] the value may have been written.
    ///
    /// # Cancel safety
    ///
    /// As [`Controller`].
    pub async fn write(&self, name: &str, value: impl Encode) -> Result<(), Error> {
        let (name, value) = (name.to_owned(), owned(&value)?);
        self.handle
            .run(move |session| Box::pin(async move { session.write(Object::Controller, &name, value).await }))
            .await
    }

    /// Reads a variable every `interval`, and reports its changes. All subscriptions share one scan of the controller; they
    /// outlast a lost connection.
    ///
    /// # Examples
    ///
    /// ```no_run
    /// # async fn example(cell: bcap_std::asynch::Controller) {
    /// let mut motor = cell.subscribe("robot/@SERVO_ON", std::time::Duration::from_millis(100));
    /// println!("the motor is on: {:?}", motor.next().await);
    ///
    /// let mut counts = cell.subscribe("I1", std::time::Duration::from_millis(50));
    /// while let Some(reading) = counts.next().await {
    ///     match reading {
    ///         Ok(value) => println!("I1 = {value:?}"),
    ///         Err(error) => println!("I1 is unknown: {error}"),
    ///     }
    /// }
    /// # }
    /// ```
    pub fn subscribe(&self, name: &str, interval: Duration) -> Subscription {
        let (subscription, sender) = Subscription::new();
        // when the task has ended, so does the subscription
        let _ = self.handle.send(Request::Subscribe(name.to_owned(), interval, sender));
        subscription
    }

    /// Returns the robot of the settings; without a name it is the first one that the controller lists.
    ///
    /// # Errors
    ///
    /// An [`Error`] if the controller has no such robot.
    ///
    /// # Cancel safety
    ///
    /// As [`Controller`].
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
    /// As [`Controller`].
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
    /// As [`connect`](Self::connect), and [`Error::NoAddress`] for a controller over a stream of the caller, which needs
    /// [`Stopper::over`], and [`Error::NoSecondSession`] for one over a serial line, which carries one session.
    ///
    /// # Cancel safety
    ///
    /// Dropping the future closes the second connection.
    pub async fn stopper(&self) -> Result<Stopper, Error> {
        let Handle { address, settings, .. } = &self.handle;
        match address.clone().ok_or(Error::NoAddress)? {
            Address::Serial(_) => Err(Error::NoSecondSession),
            address => Ok(Stopper::new(Handle::connect(address, settings, true).await?)),
        }
    }

    /// Executes a command of the controller with a parameter, such as `ClearError` with `()`.
    ///
    /// # Errors
    ///
    /// An [`Error`]; [`Error::Value`] if the value of the reply has another type.
    ///
    /// # Cancel safety
    ///
    /// As [`Controller`].
    pub async fn execute<T: for<'a> FromVariant<'a> + Send + 'static>(
        &self,
        command: &str,
        parameter: impl Encode,
    ) -> Result<T, Error> {
        let (command, parameter) = (command.to_owned(), owned(&parameter)?);
        self.handle.run(move |session| Box::pin(async move { session.execute(&command, parameter).await })).await
    }

    /// Returns the handle of the controller in the present session, for [`call`](Self::call).
    ///
    /// # Errors
    ///
    /// An [`Error`] if there is no session.
    ///
    /// # Cancel safety
    ///
    /// As [`Controller`].
    pub async fn handle(&self) -> Result<ControllerHandle, Error> {
        self.handle.run(|session| Box::pin(async { Ok(session.handle) })).await
    }

    /// Calls any function. The first argument of most is the handle of an object, which is valid in the session that opened
    /// it. Objects that the call opens are released with the session, if the caller does not. Dropping the future does not
    /// stop a call that moves the robot; only a [`Stopper`] does.
    ///
    /// # Errors
    ///
    /// An [`Error`].
    ///
    /// # Cancel safety
    ///
    /// As [`Controller`].
    pub async fn call(&self, function: FunctionId, arguments: Vec<OwnedVariant>) -> Result<OwnedVariant, Error> {
        self.handle
            .run(move |session| {
                Box::pin(async move {
                    let (_, value) = session.call_any("the controller", function, &arguments).await?;
                    Ok(value.unwrap_or_default())
                })
            })
            .await
    }

    /// Returns the states of the connection, beginning with the present one.
    pub fn states(&self) -> States {
        States::new(self.handle.state.clone())
    }

    /// Returns what is done for the robot after each further lost connection, if the lost session had taken the arm: the robot
    /// is halted, the motor that was switched on is switched off, and the arm is given back, before any other call.
    pub fn recoveries(&self) -> Recoveries {
        Recoveries::new(self.handle.recovered.clone())
    }

    /// Returns the present state of the connection.
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

    /// Releases all objects, stops the service and ends the task, also for all other handles.
    ///
    /// # Errors
    ///
    /// An [`Error`] if the connection was lost meanwhile; [`Error::Closed`] when the task has ended before.
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

/// Returns whether a call has no reply because its time has passed.
const fn is_timeout(error: &Error) -> bool {
    matches!(error, Error::NoReply { source: CallError::Client(ClientError::Timeout(_)), .. })
}
