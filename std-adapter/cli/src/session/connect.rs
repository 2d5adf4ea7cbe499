//! Connects to a controller, and converts errors to a [`Failure`] with a message and a hint.

use std::io;
use std::net::SocketAddr;
use std::time::Duration;

use bcap_capture::trace::{Packets, Wire};
use bcap_core::bcap::client::{ClientError, Timeout};
use bcap_std::blocking::{self, Controller, Transport};
use bcap_std::{
    Address, CallError, ConnectError, Error, Halt, HaltAnswer, NetworkAddress, NotRecovered, Options, Protocol,
};

use crate::failure::Failure;
use crate::session::budget::Budget;
use crate::session::traffic::{recorder, taped};

/// Connects within the time limits, without starting the service. Over UDP this sends nothing. `packets` receives all bytes.
pub(crate) fn open(target: &Address, budget: &Budget, packets: &Packets) -> Result<Controller, Failure> {
    match target {
        Address::Network(server) => connect(server, budget, |peer, options| match server.protocol {
            Protocol::Tcp => {
                blocking::connect_tcp(peer, options).map(taped).map(|open| tapped(open, packets, Wire::Stream))
            }
            Protocol::Udp => {
                blocking::connect_udp(peer, options).map(taped).map(|open| tapped(open, packets, Wire::Datagrams))
            }
        }),
        Address::Serial(line) => {
            unrecorded(target)?;
            blocking::connect_serial(line, &Options::default())
                .map(|open| tapped(open, packets, Wire::Serial))
                .map_err(|error| not_connected(&error, target))
        }
        other => Err(Failure::Input(format!("{other}: this kind of address is not supported"))),
    }
}

/// Refuses a serial line for a command that is recorded.
pub(crate) fn unrecorded(target: &Address) -> Result<(), Failure> {
    match recorder() {
        None => Ok(()),
        Some(_) => Err(Failure::Input(format!(
            "{target}: a serial line has no packets to record; --write needs tcp:HOST[:PORT] or udp:HOST[:PORT]"
        ))),
    }
}

/// Wraps a connection, so that `packets` receives its bytes.
fn tapped<X>(connection: blocking::Connection<X, Vec<u8>>, packets: &Packets, wire: Wire) -> Controller
where
    X: Transport<Error = io::Error> + Send + 'static,
{
    let (transport, client) = connection.into_parts();
    Controller::unopened(blocking::Connection::new(packets.tap(transport, wire), client))
}

/// Resolves the host, and connects to the first address that accepts. The attempts share the remaining time.
pub(crate) fn connect<T>(
    server: &NetworkAddress,
    budget: &Budget,
    connect: impl FnOnce(&[SocketAddr], &Options) -> Result<T, ConnectError>,
) -> Result<T, Failure> {
    let connected = blocking::resolve(server, budget.left())
        .and_then(|addresses| connect(&addresses, &Options::default().timeout(budget.share(addresses.len()))));
    connected.map_err(|error| not_connected(&error, &Address::Network(server.clone())))
}

/// Converts an error of the library.
pub(crate) fn failure(error: Error, target: &Address, budget: &Budget) -> Failure {
    match error {
        Error::Refused { function, object, code } => {
            let of = if object.is_empty() { String::new() } else { format!("{object}: ") };
            Failure::Refused { doing: format!("{of}{function}"), code }
        }
        Error::NoReply { function, .. } if budget.is_exhausted() => exhausted(target, budget, &function.to_string()),
        Error::NotConnected { .. } if budget.is_exhausted() => exhausted(target, budget, "all calls"),
        Error::NoReply { function, source, .. } => failed(&source, target, budget.answer(), &function.to_string()),
        Error::Reply { function, reason, .. } => Failure::Connection {
            message: format!("{function}: {reason}"),
            hint: "check that the other end is a b-CAP server".into(),
        },
        Error::Argument(error) => error.into(),
        Error::NotHalted(halt) => not_halted(&halt),
        Error::NotRecovered(error) => not_recovered(&error),
        error => {
            Failure::Connection { message: error.to_string(), hint: format!("check that {target} is a controller") }
        }
    }
}

/// Returns the failure of a halt after which the robot may move.
pub(crate) fn not_halted(halt: &Halt) -> Failure {
    let code = if let HaltAnswer::Refused(code) = halt.answer { Some(code) } else { None };
    Failure::Unfit { message: halt.to_string(), code, hint: Some("use the emergency stop".into()) }
}

/// Returns the failure of a recovery or a preparation.
fn not_recovered(error: &NotRecovered) -> Failure {
    let step = error.step;
    match (error.obstacle, error.code()) {
        (Some(obstacle), code) => {
            Failure::Unfit { message: format!("before {step}: {obstacle}"), code, hint: Some("then try again".into()) }
        }
        (None, Some(code)) => Failure::Refused { doing: step.to_string(), code },
        (None, None) => Failure::Unfit { message: error.to_string(), code: None, hint: None },
    }
}

/// Returns the failure of a call that exceeded the time limit of the whole command.
pub(crate) fn exhausted(target: &Address, budget: &Budget, call: &str) -> Failure {
    let limit = budget.total().unwrap_or_default().as_millis();
    Failure::Timeout {
        message: format!("{target} did not answer {call} within the command's time limit of {limit} ms (--timeout)"),
        hint: format!("allow more time with --timeout, or {}", check(target)),
    }
}

/// Returns a hint for a missing answer.
const fn check(target: &Address) -> &'static str {
    match target {
        Address::Network(NetworkAddress { protocol: Protocol::Tcp, .. }) => {
            "check that the controller's b-CAP server listens on this port"
        }
        Address::Serial(_) => {
            "check the cable, the device, and that baud rate, parity and stop bits are the controller's"
        }
        _ => {
            "check the address and the firewalls, that the controller accepts b-CAP over UDP, and that the reply fits a \
             datagram"
        }
    }
}

/// Converts the error of a call to `function`.
pub(crate) fn failed(error: &CallError, target: &Address, timeout: Duration, function: &str) -> Failure {
    match error {
        CallError::Io(error) => broken(error, target),
        CallError::Disconnected => Failure::Connection {
            message: format!("{target} closed the connection during {function}"),
            hint:
                "a controller closes a connection after an invalid packet, or at its limit of connections; read its log"
                    .into(),
        },
        CallError::Client(ClientError::Timeout(which)) => {
            let message = match which {
                Timeout::Attempt => format!("{target} did not answer {function} within {} ms", timeout.as_millis()),
                _ => format!("{function} took too long: {error}"),
            };
            let hint = format!("{}, or allow more time with --timeout", check(target));
            Failure::Timeout { message, hint }
        }
        CallError::Client(ClientError::Encode(_) | ClientError::TooLarge { .. }) => {
            let is_tcp = matches!(target, Address::Network(NetworkAddress { protocol: Protocol::Tcp, .. }));
            let hint = if is_tcp { "" } else { "; use TCP for larger values" };
            Failure::Input(format!("{function}: {error}{hint}"))
        }
        error => Failure::Connection {
            message: format!("{function}: {error}"),
            hint: format!("check that {target} is a b-CAP server"),
        },
    }
}

/// Converts the error of connecting.
pub(crate) fn not_connected(error: &ConnectError, target: &Address) -> Failure {
    match error {
        ConnectError::Resolve { source, .. } => not_found(target, source),
        ConnectError::Connect { address, source } => Failure::Connection {
            message: format!("cannot connect to {target} ({address}): {source}"),
            hint: connect_hint(source.kind()).into(),
        },
        ConnectError::Serial { source, .. } => Failure::Connection {
            message: format!("cannot open {target}: {source}"),
            hint: "check the name and the permissions of the device, and that no other program uses it".into(),
        },
        other => Failure::Connection {
            message: format!("{target}: {other}"),
            hint: "check the limits of this machine, such as the limit of open files".into(),
        },
    }
}

fn not_found(target: &Address, error: &io::Error) -> Failure {
    let text = target.to_string();
    let host = if let Address::Network(server) = target { &server.host } else { &text };
    Failure::Connection {
        message: format!("cannot resolve the host {host}: {error}"),
        hint: "check the spelling, or use an IP address".into(),
    }
}

/// Converts the error of a broken connection.
pub(crate) fn broken(error: &io::Error, target: &Address) -> Failure {
    Failure::Connection {
        message: format!("the connection to {target} failed: {error}"),
        hint: connect_hint(error.kind()).into(),
    }
}

fn connect_hint(kind: io::ErrorKind) -> &'static str {
    match kind {
        io::ErrorKind::ConnectionRefused => {
            "no server listens there: check the port, and that the controller's b-CAP or RAC server is enabled; \
             `bcap sim` starts a virtual controller"
        }
        io::ErrorKind::TimedOut => "check the address, the cable and firewalls, or allow more time with --timeout",
        io::ErrorKind::ConnectionReset | io::ErrorKind::BrokenPipe | io::ErrorKind::ConnectionAborted => {
            "the controller closed the connection: it may have restarted or reached its limit of connections; try again"
        }
        _ => "check the address and the network",
    }
}
