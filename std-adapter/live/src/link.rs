//! A session with a controller for programs that only show it, and the session that halts its robot.

use std::collections::HashMap;
use std::time::Duration;

use bcap_capture::record::{Ends, HasEnds};
use bcap_capture::trace::{Packets, Wire};
use bcap_core::bcap::client::Timing;
use bcap_core::bcap::{FunctionId, Object};
use bcap_core::error::EncodeError;
use bcap_core::hresult::HResult;
use bcap_core::variant::OwnedVariant;
use bcap_std::blocking::{self, Connection, Controller, Halted};
use bcap_std::{
    Address, AddressError, ConnectError, Examination, Model, ObjectPath, ObjectPathError, Options, Protocol, Settings,
    TaskStart, TaskStatus, TaskStop,
};

use crate::calls::{self, Calls, needs_reconnect, unless_refused};
use crate::stream::StreamCheck;
use crate::tap::Tap;
use crate::variables::get_one;

/// The time limit of each call, and of connecting. A controller that is switched off is detected within this time.
const LIMIT: Duration = Duration::from_secs(3);

/// The time limit of each call of a halt, with its keep-alives: a robot needs time to come to rest.
const HALT_LIMIT: Duration = Duration::from_secs(10);

/// The time limit of each call of any function, with its keep-alives: a motion ends within it.
const CALL_LIMIT: Duration = Duration::from_secs(60);

/// The address of a controller, and the arguments of Controller_Connect.
#[derive(Clone, Debug)]
pub struct Access {
    /// The address. A serial line carries only one session, so there is no second session for a halt.
    pub address: Address,
    /// The provider; `None` for the provider of an RC8, or of an RC9 if the controller refuses that.
    pub provider: Option<String>,
    /// The machine that the provider runs on, seen from the controller; `None` for its default.
    pub machine: Option<String>,
    /// The option of Controller_Connect.
    pub option: String,
    /// Records the connections.
    pub tap: Tap,
}

impl Access {
    /// Returns the machine of Controller_Connect (b-CAP specification for RC9, Table 6-1).
    fn machine(&self, provider: &str) -> &str {
        match (&self.machine, &self.address) {
            (Some(machine), _) => machine,
            (None, Address::Network(server)) if provider == Model::Rc9.provider() => &server.host,
            _ => "localhost",
        }
    }
}

/// Why a call of a [`Link`] failed.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The library's error.
    #[error(transparent)]
    Call(#[from] bcap_std::Error),
    /// The call was not made, because it would end a stream of Slave Mode.
    #[error("{0}")]
    Skipped(String),
    /// The reply does not match the call.
    #[error("{0}")]
    Unexpected(String),
    /// The input of the user is invalid.
    #[error("{0}")]
    Invalid(String),
}

impl From<EncodeError> for Error {
    fn from(error: EncodeError) -> Self {
        Self::Call(error.into())
    }
}

impl From<ObjectPathError> for Error {
    fn from(error: ObjectPathError) -> Self {
        Self::Invalid(error.to_string())
    }
}

impl From<ConnectError> for Error {
    fn from(error: ConnectError) -> Self {
        Self::Call(error.into())
    }
}

impl From<AddressError> for Error {
    fn from(error: AddressError) -> Self {
        Self::Call(error.into())
    }
}

impl calls::Failure for Error {
    fn code(&self) -> Option<HResult> {
        match self {
            Self::Call(bcap_std::Error::Refused { code, .. }) => Some(*code),
            _ => None,
        }
    }

    fn is_lost(&self) -> bool {
        // after a missing reply too: the controller may have ended the session in the meantime
        matches!(self, Self::Call(bcap_std::Error::NoReply { .. } | bcap_std::Error::NotConnected { .. }))
    }

    fn skipped(message: String) -> Self {
        Self::Skipped(message)
    }

    fn is_skipped(&self) -> bool {
        matches!(self, Self::Skipped(_))
    }

    fn unexpected(message: String) -> Self {
        Self::Unexpected(message)
    }

    fn invalid(message: String) -> Self {
        Self::Invalid(message)
    }

    fn unfit(message: String) -> Self {
        Self::Unexpected(message)
    }

    fn with_hint(self, hint: &str) -> Self {
        match self {
            Self::Unexpected(message) => Self::Unexpected(format!("{message}; {hint}")),
            error => error,
        }
    }

    fn omission(&self) -> Option<String> {
        match self {
            Self::Call(bcap_std::Error::Refused { .. }) | Self::Unexpected(_) => Some(self.to_string()),
            _ => None,
        }
    }
}

/// A session with a controller, whose packets are shown.
#[derive(Debug)]
pub struct Link {
    controller: Controller,
    model: Model,
    ends: Option<Ends>,
    /// The objects that stay open for the next use, by path.
    objects: HashMap<String, i32>,
}

impl Link {
    /// Connects to a controller, and starts a session; `packets` sees its bytes.
    ///
    /// # Errors
    ///
    /// An [`Error`] for a failed connection or a refused call; for a serial line.
    pub fn connect(access: &Access, packets: &Packets) -> Result<Self, Error> {
        let (mut controller, ends) = open(access, packets)?;
        let timing = controller.timing();
        controller.set_timing(Timing { deadline: LIMIT, keep_alive: LIMIT, ..timing });
        controller.call_any("", FunctionId::SERVICE_START, &[OwnedVariant::new("WDT=400")?])?;
        let connect = |controller: &mut Controller, provider: &str| {
            let texts = ["", provider, access.machine(provider), &access.option];
            let arguments = texts.into_iter().map(OwnedVariant::new).collect::<Result<Vec<_>, _>>()?;
            controller.call_any("", FunctionId::CONTROLLER_CONNECT, &arguments)
        };
        let rc9 = Model::Rc9.provider();
        let is_rc9 = match &access.provider {
            Some(provider) => connect(&mut controller, provider).map(|_| provider.eq_ignore_ascii_case(rc9))?,
            None => match connect(&mut controller, Model::Rc8.provider()) {
                Err(refused @ bcap_std::Error::Refused { .. }) => {
                    connect(&mut controller, rc9).map_err(|_| refused).map(|_| true)?
                }
                connected => connected.map(|_| false)?,
            },
        };
        if !controller.is_connected() {
            return Err(Error::Unexpected("Controller_Connect: the reply carries no handle".into()));
        }
        let model = if is_rc9 { Model::Rc9 } else { Model::Rc8 };
        Ok(Self { controller, model, ends, objects: HashMap::new() })
    }

    /// Connects for a program that moves the robot. If the connection is lost while the session has the arm, dropping the
    /// controller connects once more, to halt the robot, switch the motor off and give the arm back.
    ///
    /// # Errors
    ///
    /// Same as [`connect`](Self::connect).
    pub fn for_motion(access: &Access) -> Result<Controller, Error> {
        Ok(Self::connect(access, &Packets::new())?.recovering(access, HALT_LIMIT).controller)
    }

    /// Connects for a program whose user makes any calls. Its drop halts and frees the arm as for
    /// [`for_motion`](Self::for_motion).
    ///
    /// # Errors
    ///
    /// Same as [`connect`](Self::connect).
    pub fn for_calls(access: &Access, packets: &Packets) -> Result<Self, Error> {
        Ok(Self::connect(access, packets)?.recovering(access, CALL_LIMIT))
    }

    fn recovering(mut self, access: &Access, limit: Duration) -> Self {
        let timing = self.controller.timing();
        self.controller.set_timing(Timing { deadline: limit, keep_alive: limit, ..timing });
        let settings = Settings::new(self.model).connect_option(&access.option);
        Self { controller: self.controller.recover_at(access.address.clone(), settings), ..self }
    }

    /// Ends the session as a drop does, and reports whether its effects on the robot were ended.
    ///
    /// # Errors
    ///
    /// An [`Error`]: the robot may move, the motor may be on, or the arm may be taken.
    pub fn end(self) -> Result<(), Error> {
        Ok(self.controller.end()?)
    }

    /// Returns the ends of the connection.
    #[must_use]
    pub const fn ends(&self) -> Option<Ends> {
        self.ends
    }

    /// Starts a task, unless that would end a stream of Slave Mode. `may` is called directly before the start.
    ///
    /// # Errors
    ///
    /// The error of `may`, or another [`Error`].
    pub fn start_task(
        &mut self,
        name: &str,
        mode: TaskStart,
        may: impl FnOnce() -> Result<(), Error>,
    ) -> Result<(), Error> {
        StreamCheck::default().require(self, FunctionId::TASK_START, None)?;
        let mut task = self.controller.task(name)?;
        may()?;
        Ok(task.start(mode)?)
    }

    /// Stops a task, unless that would end a stream of Slave Mode: HALT stops such a stream.
    ///
    /// # Errors
    ///
    /// An [`Error`].
    pub fn stop_task(&mut self, name: &str, mode: TaskStop) -> Result<(), Error> {
        StreamCheck::default().require(self, FunctionId::TASK_STOP, None)?;
        Ok(self.controller.task(name)?.stop(mode)?)
    }

    /// Reads the line of a program that a task is at; `None` if the controller does not report it.
    ///
    /// # Errors
    ///
    /// The loss of the session.
    pub fn task_line(&mut self, name: &str) -> Result<Option<f64>, Error> {
        StreamCheck::default().require(self, FunctionId::CONTROLLER_GET_TASK, None)?;
        let path = ObjectPath::controller().join(Object::Task, name).join(Object::Variable, "@LINE_NO");
        Ok(unless_refused(get_one(self, &path))?.and_then(|value| {
            let value = value.as_variant();
            value.as_array().and_then(|array| array.iter().next()).unwrap_or(value).as_f64()
        }))
    }

    /// Reads the state of the robot. It sends nothing that would end a stream of Slave Mode.
    ///
    /// # Errors
    ///
    /// An [`Error`].
    pub fn examine(&mut self) -> Result<Examination, Error> {
        Ok(self.controller.robot()?.examine()?)
    }
}

impl Calls for Link {
    type Error = Error;

    fn object(&mut self, path: &ObjectPath) -> Result<i32, Error> {
        if path.object() == Object::Controller {
            return Ok(self.controller.handle().0);
        }
        let name = path.to_string();
        if let Some(handle) = self.objects.get(&name) {
            return Ok(*handle);
        }
        let handle = self.controller.open(path)?;
        self.objects.insert(name, handle);
        Ok(handle)
    }

    fn is_open(&self, path: &ObjectPath) -> bool {
        self.objects.contains_key(&path.to_string())
    }

    fn call(
        &mut self,
        subject: &str,
        function: FunctionId,
        arguments: &[OwnedVariant],
    ) -> Result<(HResult, Option<OwnedVariant>), Error> {
        let called = self.controller.call_any(subject, function, arguments);
        if function.releases().is_some() {
            // the controller may reuse the number for another object
            self.objects.clear();
        }
        Ok(called?)
    }

    fn release(&mut self, object: Object, handle: i32) -> Result<(), Error> {
        self.objects.retain(|_, open| *open != handle);
        Ok(self.controller.release(object, handle)?)
    }

    fn task_status(&mut self, name: &str) -> Result<TaskStatus, Error> {
        Ok(self.controller.task(name)?.status()?)
    }
}

/// Connects without starting a session.
fn open(access: &Access, packets: &Packets) -> Result<(Controller, Option<Ends>), Error> {
    let options = Options::default().timeout(LIMIT);
    let Address::Network(server) = &access.address else { return Err(bcap_std::Error::NoSecondSession.into()) };
    let peer = (server.host.as_str(), server.port);
    Ok(match server.protocol {
        Protocol::Tcp => tapped(blocking::connect_tcp(peer, &options)?, packets, Wire::Stream, &access.tap),
        Protocol::Udp => tapped(blocking::connect_udp(peer, &options)?, packets, Wire::Datagrams, &access.tap),
    })
}

fn tapped<X>(connection: Connection<X, Vec<u8>>, packets: &Packets, wire: Wire, tap: &Tap) -> (Controller, Option<Ends>)
where
    X: HasEnds + Send + 'static,
{
    let (transport, client) = connection.into_parts();
    let (ends, mut packets) = (transport.ends(), packets.clone());
    if let Some(ends) = ends {
        let line = tap.clone().line(ends);
        packets.watch_bytes(move |role, _, bytes| line.packet(role, bytes));
    }
    (Controller::unopened(Connection::new(packets.tap(transport, wire), client)), ends)
}

/// Halts the robot over a session that is open before it is needed. It is not an emergency stop.
#[derive(Debug)]
pub struct Stopper {
    access: Access,
    link: Option<Link>,
}

impl Stopper {
    /// Returns a stopper without a session.
    #[must_use]
    pub const fn new(access: Access) -> Self {
        Self { access, link: None }
    }

    /// Opens the session and the robot, unless that has been done.
    ///
    /// # Errors
    ///
    /// An [`Error`]; a halt then opens them.
    pub fn prepare(&mut self) -> Result<(), Error> {
        if self.link.is_none() {
            let mut link = Link::connect(&self.access, &Packets::new())?;
            let timing = link.controller.timing();
            link.controller.set_timing(Timing { deadline: HALT_LIMIT, keep_alive: HALT_LIMIT, ..timing });
            link.controller.robot()?;
            self.link = Some(link);
        }
        Ok(())
    }

    /// Halts the robot, and waits until it rests. If the session was lost, it opens a new one once.
    ///
    /// # Errors
    ///
    /// An [`Error`]: the robot may still move.
    pub fn halt(&mut self) -> Result<Halted, Error> {
        match self.attempt() {
            Err(error) if needs_reconnect(&error) => {
                self.link = None;
                self.attempt()
            }
            halted => halted,
        }
    }

    fn attempt(&mut self) -> Result<Halted, Error> {
        self.prepare()?;
        let Some(link) = &mut self.link else { return Err(Error::Unexpected("there is no session".into())) };
        Ok(link.controller.robot()?.halt()?)
    }
}
