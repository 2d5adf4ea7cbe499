//! The replay of one connection.

use std::collections::HashMap;
use std::sync::mpsc::Sender;
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};
use std::{error, io};

use bcap_core::bcap::{FunctionId, Kind, Object};
use bcap_core::hresult::HResult;
use bcap_core::rac::{MAX_VALUE, Variable};
use bcap_std::blocking::{self, Connection, Controller, RacConnection, TcpTransport, Transport};
use bcap_std::{Address, Error, Model, NetworkAddress, Options, RacError, Settings};

use super::options::Options as ReplayOptions;
use super::order::Order;
use super::plan::{LinkKind, PlannedCall, PlannedLink};
use crate::decode::{Argument, Call, Reply, is_object};
use crate::proxy::Robot;
use crate::record::{Ends, HasEnds, Taped};
use bcap_core::variant::OwnedVariant as Value;

/// The attempts of a call over UDP, which share the time limit.
const UDP_ATTEMPTS: u8 = 5;

/// The result of a call in a replay.
#[derive(Debug)]
pub enum Came {
    /// A reply, with its value.
    Reply(HResult, Option<Value>),
    /// The reason why there is no reply, for people.
    Nothing(String),
}

/// A call that was replayed, or that could not be made.
#[derive(Debug)]
#[non_exhaustive]
pub struct Outcome<'a> {
    /// The recorded call.
    pub call: &'a Call,
    /// The result of this replay.
    pub came: Came,
    /// Whether the result differs from the recorded reply; false without a recorded one.
    pub is_different: bool,
}

/// The replay of one connection.
pub(super) struct LinkReplay<'a> {
    pub(super) planned: &'a PlannedLink,
    pub(super) robot: &'a Robot,
    pub(super) order: &'a Order,
    /// When the replay began; `None` to make calls as soon as possible.
    pub(super) began: Option<Instant>,
    pub(super) options: &'a ReplayOptions,
    /// The reasons why the effects of connections may not have ended, for people.
    pub(super) failed_ends: &'a Mutex<Vec<String>>,
}

impl<'a> LinkReplay<'a> {
    /// Makes the calls in sequence, and sends the outcome of each, until the replay stops.
    pub(super) fn run(&self, outcomes: &Sender<Outcome<'a>>) {
        let mut opened = None;
        for planned in &self.planned.calls {
            let left = || self.began.map_or(Duration::ZERO, |began| planned.offset.saturating_sub(began.elapsed()));
            if !self.order.wait(planned.after, left) {
                break;
            }
            let link = opened.get_or_insert_with(|| self.open());
            let came = match link {
                Ok(link) => link.make(&planned.call),
                Err(why) => Came::Nothing(why.clone()),
            };
            if matches!(link, Ok(link) if link.is_lost) {
                // the remaining calls of this connection cannot be made
                let lost = std::mem::replace(link, Err("not sent: the connection was lost".into()));
                self.close(lost);
            }
            self.end(planned, came, outcomes);
        }
        opened.into_iter().for_each(|link| self.close(link));
    }

    /// Ends the effects of a connection on the robot.
    fn close(&self, link: Result<OpenLink, String>) {
        if let Ok(OpenLink { socket: Socket::Bcap(controller), .. }) = link
            && let Err(error) = controller.end()
        {
            // the list of texts is valid even after a panic of a thread
            self.failed_ends.lock().unwrap_or_else(PoisonError::into_inner).push(with_causes(&error));
        }
    }

    fn end(&self, planned: &'a PlannedCall, came: Came, outcomes: &Sender<Outcome<'a>>) {
        if let Some(rank) = planned.rank {
            self.order.end(rank);
        }
        let is_volatile = self.options.volatile.iter().any(|name| is_named(&planned.call, name));
        let is_different = planned.call.reply.as_ref().is_some_and(|reply| differs(reply, &came, is_volatile));
        if outcomes.send(Outcome { call: &planned.call, came, is_different }).is_err() {
            // the receiver ends early only if the output is closed
            self.order.stop();
        }
    }

    /// Opens the connection; an error is for people.
    fn open(&self) -> Result<OpenLink, String> {
        let timeout = self.options.timeout;
        let mut options = Options::default().timeout(timeout);
        options.udp.timing.attempts = UDP_ATTEMPTS;
        options.udp.timing.attempt_timeout = (timeout / u32::from(UDP_ATTEMPTS)).max(Duration::from_millis(1));
        let (robot, recorder) = (self.robot, self.options.recorder.as_ref());
        let socket = match self.planned.kind {
            LinkKind::Tcp => {
                blocking::connect_tcp(&robot.tcp[..], &options).map(|open| self.bcap(open, bcap_std::Protocol::Tcp))
            }
            LinkKind::Udp => {
                blocking::connect_udp(robot.udp, &options).map(|open| self.bcap(open, bcap_std::Protocol::Udp))
            }
            LinkKind::Rac => {
                let open = |client| Socket::Rac(Box::new(Taped::rac_connection(client, recorder)));
                blocking::connect_rac(&robot.rac[..], &options).map(open)
            }
        };
        let socket = socket.map_err(|error| with_causes(&error))?;
        Ok(OpenLink { socket, handles: HashMap::new(), is_lost: false })
    }
}

impl LinkReplay<'_> {
    /// Wraps a connection of b-CAP. If it is lost, its end connects once more, to end its effects on the robot.
    fn bcap<X>(&self, mut open: Connection<X, Vec<u8>>, protocol: bcap_std::Protocol) -> Socket
    where
        X: HasEnds + Transport<Error = io::Error> + Send + 'static,
    {
        let ends = open.transport().ends();
        let controller = Controller::unopened(Taped::connection(open, self.options.recorder.as_ref()));
        Socket::Bcap(Box::new(match ends {
            Some(Ends { server, .. }) => {
                let server = NetworkAddress { protocol, host: server.ip().to_string(), port: server.port() };
                controller.recover_at(Address::Network(server), self.settings())
            }
            None => controller,
        }))
    }

    /// Returns the settings of a session with the provider and the option of the capture.
    fn settings(&self) -> Settings {
        let connect = |planned: &&PlannedCall| function(&planned.call) == Some(FunctionId::CONTROLLER_CONNECT);
        let connect = self.planned.calls.iter().find(connect);
        let text = |index: usize| -> Option<String> {
            let value = connect?.call.arguments.get(index)?.value.as_ref()?;
            value.as_variant().as_bstr().map(|text| text.to_string())
        };
        let is_rc9 = text(1).is_some_and(|provider| provider.eq_ignore_ascii_case(Model::Rc9.provider()));
        Settings::new(if is_rc9 { Model::Rc9 } else { Model::Rc8 }).connect_option(text(3).unwrap_or_default())
    }
}

/// Returns whether a call has this function, or function and command, or uses this object.
fn is_named(call: &Call, name: &str) -> bool {
    let full = call.command.as_ref().map(|command| format!("{}/{command}", call.function));
    name.eq_ignore_ascii_case(&call.function)
        || full.is_some_and(|full| name.eq_ignore_ascii_case(&full))
        || call.objects().any(|object| is_object(object, name))
}

/// Returns whether a result differs from the recorded reply. New handles never differ.
fn differs(recorded: &Reply, came: &Came, is_volatile: bool) -> bool {
    let Came::Reply(code, value) = came else { return true };
    if is_volatile {
        return recorded.code.is_ok() != code.is_ok();
    }
    if recorded.code != *code {
        return true;
    }
    let bytes = |value: Option<&Value>| value.map(|value| value.as_bytes().to_vec());
    recorded.opened.is_none() && code.is_ok() && bytes(recorded.value.as_ref()) != bytes(value.as_ref())
}

/// The current handles by the recorded ones; `None` for an object that is not open in this replay.
type Handles = HashMap<i32, Option<i32>>;

const NOT_DECODED: &str = "an argument cannot be decoded";

/// A client of RAC.
type RacClient = RacConnection<Taped<TcpTransport>, [u8; MAX_VALUE]>;

/// An open connection.
struct OpenLink {
    socket: Socket,
    handles: Handles,
    is_lost: bool,
}

enum Socket {
    Bcap(Box<Controller>),
    Rac(Box<RacClient>),
}

impl OpenLink {
    /// Makes a call.
    fn make(&mut self, call: &Call) -> Came {
        let (came, is_lost) = match &mut self.socket {
            Socket::Bcap(controller) => bcap(controller, call, &self.handles),
            Socket::Rac(client) => rac(client, call),
        };
        self.is_lost |= is_lost;
        self.remember(call, &came);
        came
    }

    /// Records the objects that the call has opened or released in this replay.
    ///
    /// The robot may reuse the number of a released object for another object, so the number must no longer be sent.
    fn remember(&mut self, call: &Call, came: &Came) {
        let (is_done, value) = match came {
            Came::Reply(code, value) => (code.is_ok(), value.as_ref().filter(|_| code.is_ok())),
            Came::Nothing(_) => (false, None),
        };
        if is_done && let Some(function) = function(call) {
            if function.opens() == Some(Object::Service) || function.releases() == Some(Object::Service) {
                self.handles.clear();
            } else if function.releases().is_some()
                && let Some(recorded) = call.arguments.first().and_then(handle)
            {
                self.handles.insert(recorded, None);
            }
        }
        let opened = call.reply.as_ref().filter(|reply| reply.opened.is_some());
        if let Some(recorded) = opened.and_then(|reply| reply.value.as_ref()?.as_variant().as_i32()) {
            let present = value.and_then(|value| value.as_variant().as_i32());
            for other in self.handles.values_mut().filter(|other| **other == present) {
                *other = None;
            }
            self.handles.insert(recorded, present);
        }
    }
}

/// Returns the function of a call of b-CAP.
fn function(call: &Call) -> Option<FunctionId> {
    let unknown = || call.function.strip_prefix("function ").and_then(|number| number.parse().ok()).map(FunctionId);
    FunctionId::parse(&call.function).or_else(unknown)
}

/// Makes a call of b-CAP; the flag is whether the connection was lost.
fn bcap(controller: &mut Controller, call: &Call, handles: &Handles) -> (Came, bool) {
    let Some(function) = function(call) else {
        return (Came::Nothing("not sent: the function is unknown".into()), false);
    };
    let arguments = match arguments(call, function, handles) {
        Ok(arguments) => arguments,
        Err(why) => return (Came::Nothing(format!("not sent: {why}")), false),
    };
    match controller.call_any("", function, &arguments) {
        Ok((code, value)) => (Came::Reply(code, value), false),
        Err(Error::Refused { code, .. }) => (Came::Reply(code, None), false),
        Err(error) => (Came::Nothing(with_causes(&error)), true),
    }
}

/// Returns the arguments of a call with the current handles; an error says why the call must not be sent.
fn arguments(call: &Call, function: FunctionId, handles: &Handles) -> Result<Vec<Value>, &'static str> {
    let kinds = function.signature().map_or(&[][..], |signature| signature.arguments);
    let argument = |(i, argument): (usize, &Argument)| match kinds.get(i) {
        Some(Kind::Handle(_)) => present(argument, handles),
        _ => argument.value.clone().ok_or(NOT_DECODED),
    };
    call.arguments.iter().enumerate().map(argument).collect()
}

/// Returns the handle that the object of an argument has in this replay.
///
/// A recorded number that was not replaced could be the handle of another object of the robot.
fn present(argument: &Argument, handles: &Handles) -> Result<Value, &'static str> {
    const NOT_OPEN: &str = "the object is not open in this replay";
    let recorded = handle(argument).ok_or("a handle is not an integer of 32 bits")?;
    match handles.get(&recorded) {
        Some(present) => Value::new(&present.ok_or(NOT_OPEN)?).map_err(|_| NOT_DECODED),
        // 0 is the handle of no object
        None if recorded == 0 => argument.value.clone().ok_or(NOT_DECODED),
        None => Err(NOT_OPEN),
    }
}

fn handle(argument: &Argument) -> Option<i32> {
    argument.value.as_ref()?.as_variant().as_i32()
}

/// Makes a request of RAC; the flag is whether the connection was lost.
fn rac(client: &mut RacClient, call: &Call) -> (Came, bool) {
    match request(client, call) {
        None => (Came::Nothing("not sent: not a request of RAC".into()), false),
        Some(Ok(value)) => (Came::Reply(HResult::S_OK, value), false),
        Some(Err(RacError::Refused(code))) => (Came::Reply(code, None), false),
        Some(Err(error)) => (Came::Nothing(with_causes(&error)), true),
    }
}

/// Sends a request of RAC; `None` if the recorded line is not one.
fn request(client: &mut RacClient, call: &Call) -> Option<Result<Option<Value>, RacError>> {
    let name = call.arguments.first()?.object.as_deref()?;
    let variable: Variable = name.parse().ok()?;
    match call.function.as_str() {
        "GET" => Some(client.get(variable).map(|value| Value::new(&value).ok())),
        "PUT" => {
            let value = call.arguments.get(1)?.value.as_ref()?;
            Some(client.put(variable, value.as_variant()).map(|()| None))
        }
        _ => None,
    }
}

/// An error with its causes, in one line.
fn with_causes(error: &dyn error::Error) -> String {
    let causes = std::iter::successors(Some(error), |error| error.source());
    causes.map(ToString::to_string).collect::<Vec<_>>().join(": ")
}
