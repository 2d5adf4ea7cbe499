//! A controller as an object.

mod any;

use std::io;
use std::time::Duration;

use bcap_core::bcap::Object;
use bcap_core::bcap::call::{Call, ControllerHandle};
use bcap_core::variant::{Encode, FromVariant, OwnedVariant};

use super::Transport;
use super::borrowed::ControllerRef;
use super::ending;
use super::objects::{File, Scan, Task};
use super::robot::Robot;
use super::socket::{self, Blocking, ready};
use super::stopper::Stopper;
use crate::address::Address;
use crate::error::Error;
use crate::reply::OwnedReply;
use crate::session::{Session, TimedReading};
use crate::settings::Settings;

/// A session with a controller.
///
/// It opens objects when they are first used and keeps their handles. When it is dropped it releases all objects in reverse
/// order and stops the service. It stops doing so after one second without a reply, and sends nothing over a lost connection.
/// If the connection was lost while this session had the arm, the drop connects once more, and halts the robot, switches the
/// motor off and gives the arm back ([`Settings::keep`] prevents it).
///
/// # Examples
///
/// ```no_run
/// use std::time::Duration;
///
/// use bcap_std::blocking::Controller;
/// use bcap_std::{Motion, Move, Settings};
///
/// let mut cell = Controller::connect("tcp:192.168.0.1", &Settings::rc9())?;
/// let count: i32 = cell.read("I1")?;
/// cell.write("I1", count + 1)?;
///
/// let mut arm = cell.robot()?.take_arm()?;
/// arm.motor_on()?;
/// match arm.move_to(&Move::line("P1").speed_percent(10.0), Duration::from_secs(30))? {
///     Motion::Arrived => println!("at P1"),
///     other => println!("not at P1: {other:?}"),
/// }
/// # Ok::<(), bcap_std::Error>(())
/// ```
#[derive(Debug)]
pub struct Controller {
    session: Session<Blocking>,
    /// `None` over a stream of the caller.
    address: Option<Address>,
    settings: Settings,
}

impl Controller {
    /// Connects to the controller at `tcp:HOST[:PORT]`, `udp:HOST[:PORT]` or `serial:PATH[?baud=N&parity=P&stop=S]`
    /// ([`Address`]), and starts a session with a watchdog. Serial lines need the feature `serial`.
    ///
    /// # Errors
    ///
    /// An [`Error`] for a wrong address, a failed connection, or a refused call. Nothing stays open then.
    pub fn connect(address: &str, settings: &Settings) -> Result<Self, Error> {
        let address: Address = address.parse()?;
        let connection = socket::connect(&address, settings)?;
        let session = ready(Session::start(connection, settings))?;
        Ok(Self { session, address: Some(address), settings: settings.clone() })
    }

    /// Starts a session over a stream of the caller, such as a `Wire` to the virtual controller in memory.
    ///
    /// # Errors
    ///
    /// An [`Error`] for a refused call, or one without a reply.
    pub fn over(
        stream: impl Transport<Error = io::Error> + Send + 'static,
        settings: &Settings,
    ) -> Result<Self, Error> {
        let session = ready(Session::start(socket::over(stream, settings), settings))?;
        Ok(Self { session, address: None, settings: settings.clone() })
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
    pub fn read<T: for<'a> FromVariant<'a>>(&mut self, name: &str) -> Result<T, Error> {
        ready(self.session.read(Object::Controller, name))
    }

    /// Reads several variables of any type; each is opened once and stays open for the next time.
    ///
    /// ```no_run
    /// # use bcap_std::{Settings, blocking::Controller};
    /// # let mut cell = Controller::connect("tcp:192.168.0.1", &Settings::rc9())?;
    /// let [count, position, door] = cell.read_all(["I1", "P1", "IO128"])?;
    /// println!("{count:?} {position:?} {door:?}");
    /// # Ok::<(), bcap_std::Error>(())
    /// ```
    ///
    /// # Errors
    ///
    /// An [`Error`] for the first variable that cannot be read.
    pub fn read_all<const N: usize>(&mut self, names: [&str; N]) -> Result<[OwnedVariant; N], Error> {
        ready(self.session.read_all(&names))
    }

    /// Reads several variables of any type, and returns for each when its reply arrived, and its value or error.
    ///
    /// After a timeout or a loss of the connection the rest is not read, and the result is shorter than `names`. So a
    /// controller that stops responding costs one timeout, not one for each name.
    ///
    /// # Errors
    ///
    /// [`Error::NotConnected`] if the connection was lost before.
    pub fn read_each(&mut self, names: &[&str]) -> Result<Vec<TimedReading>, Error> {
        self.reference().read_each(names)
    }

    /// Reads a variable every 10 ms until its value meets a condition, at most for `limit`, and returns that value.
    ///
    /// ```no_run
    /// # use std::time::Duration;
    /// # use bcap_std::{Settings, blocking::Controller};
    /// # let mut cell = Controller::connect("tcp:192.168.0.1", &Settings::rc9())?;
    /// cell.read_until("IO129", |closed: &bool| *closed, Duration::from_secs(2))?;
    /// # Ok::<(), bcap_std::Error>(())
    /// ```
    ///
    /// # Errors
    ///
    /// [`Error::NotMet`] after `limit`; the [`Error`] of a reading that fails.
    pub fn read_until<T: for<'a> FromVariant<'a>>(
        &mut self,
        name: &str,
        condition: impl FnMut(&T) -> bool,
        limit: Duration,
    ) -> Result<T, Error> {
        self.reference().read_until(name, condition, limit)
    }

    /// Returns this controller with a time limit for each of its calls.
    ///
    /// ```no_run
    /// # use std::time::Duration;
    /// # use bcap_std::{Settings, blocking::Controller};
    /// # let mut cell = Controller::connect("tcp:192.168.0.1", &Settings::rc9())?;
    /// let count: i32 = cell.within(Duration::from_millis(200)).read("I1")?;
    /// # Ok::<(), bcap_std::Error>(())
    /// ```
    pub const fn within(&mut self, limit: Duration) -> ControllerRef<'_> {
        self.reference().within(limit)
    }

    const fn reference(&mut self) -> ControllerRef<'_> {
        ControllerRef::new(&mut self.session)
    }

    /// Opens variables, to read them often with [`Scan::read`].
    ///
    /// ```no_run
    /// # use bcap_std::{Settings, blocking::Controller};
    /// # let mut cell = Controller::connect("tcp:192.168.0.1", &Settings::rc9())?;
    /// let scan = cell.scan(&["I1", "P1", "IO128"])?;
    /// for value in scan.read(&mut cell)? {
    ///     println!("{value:?}");
    /// }
    /// # Ok::<(), bcap_std::Error>(())
    /// ```
    ///
    /// # Errors
    ///
    /// An [`Error`] for the first variable that does not exist.
    pub fn scan(&mut self, names: &[&str]) -> Result<Scan, Error> {
        self.reference().scan(names)
    }

    /// Writes a variable of the controller.
    ///
    /// # Errors
    ///
    /// An [`Error`]. After [`Error::NoReply`] the value may have been written.
    pub fn write(&mut self, name: &str, value: impl Encode) -> Result<(), Error> {
        ready(self.session.write(Object::Controller, name, value))
    }

    /// Returns the robot of the settings; without a name it is the first robot that the controller lists.
    ///
    /// # Errors
    ///
    /// An [`Error`] if the controller has no such robot.
    pub fn robot(&mut self) -> Result<Robot<'_>, Error> {
        ready(self.session.robot())?;
        Ok(Robot::new(&mut self.session))
    }

    /// Returns a task, such as `Pro1`.
    ///
    /// # Errors
    ///
    /// An [`Error`] if the controller has no such task.
    pub fn task(&mut self, name: &str) -> Result<Task<'_>, Error> {
        self.reference().task(name)
    }

    /// Returns a file, which must exist when it is read or written. A path has `\` between its parts.
    pub fn file(&mut self, name: &str) -> File<'_> {
        self.reference().file(name)
    }

    /// Opens a second connection, over which another thread can halt the robot at any time.
    ///
    /// # Errors
    ///
    /// Same as [`connect`](Self::connect), plus [`Error::NoAddress`] for a controller over a stream of the caller, which needs
    /// [`Stopper::over`], and [`Error::NoSecondSession`] for one over a serial line, which carries one session.
    pub fn stopper(&self) -> Result<Stopper, Error> {
        Stopper::open(self.address.as_ref().ok_or(Error::NoAddress)?, &self.settings)
    }

    /// Executes a command of the controller with a parameter, such as `ClearError` with `()`.
    ///
    /// # Errors
    ///
    /// An [`Error`]; [`Error::Value`] if the value of the reply has another type.
    pub fn execute<T: for<'a> FromVariant<'a>>(&mut self, command: &str, parameter: impl Encode) -> Result<T, Error> {
        ready(self.session.execute(command, parameter))
    }

    /// Returns the handle of the controller, for [`call`](Self::call).
    #[must_use]
    pub const fn handle(&self) -> ControllerHandle {
        self.session.handle
    }

    /// Calls any function, and returns a copy of the value of its reply ([`OwnedReply`]). Objects that the call opens are
    /// released with the session, if the caller does not. A call that moves the robot returns when the motion has ended, or
    /// immediately with `NEXT`; then dropping the controller halts it, if this session has the arm.
    ///
    /// ```no_run
    /// # use bcap_std::{Settings, blocking::Controller, core::bcap::call};
    /// # let mut cell = Controller::connect("tcp:192.168.0.1", &Settings::rc9())?;
    /// let handle = cell.handle();
    /// println!("{:?}", cell.call(call::controller_get_robot_names(handle, ""))?);
    /// # Ok::<(), bcap_std::Error>(())
    /// ```
    ///
    /// # Errors
    ///
    /// An [`Error`].
    pub fn call<C: Call<Reply: OwnedReply>>(&mut self, call: C) -> Result<<C::Reply as OwnedReply>::Owned, Error> {
        self.reference().call(call)
    }

    /// Gives the arm back, releases all objects and stops the service, as a drop does, and reports whether that succeeded. After a lost
    /// connection it connects once more to give the arm back.
    ///
    /// # Errors
    ///
    /// An [`Error`] if the arm was not given back with the motor off, or the session was not closed.
    pub fn close(mut self) -> Result<(), Error> {
        let ended = self.end_now();
        ended.robot.and(ended.objects)
    }

    /// Ends the session, once.
    fn end_now(&mut self) -> ending::EndResult {
        ending::end_now(&mut self.session, self.address.as_ref(), &self.settings)
    }
}

impl<'a> From<&'a mut Controller> for ControllerRef<'a> {
    fn from(controller: &'a mut Controller) -> Self {
        Self::new(&mut controller.session)
    }
}

impl Drop for Controller {
    fn drop(&mut self) {
        // it has logged its error
        let _ = self.end_now();
    }
}
