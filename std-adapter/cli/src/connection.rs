//! A b-CAP client over TCP, UDP or a serial line that reports errors as a [`Failure`] with a message and a hint.

use std::io;
use std::net::{SocketAddr, ToSocketAddrs};
use std::sync::mpsc;
use std::thread;
use std::time::Duration;

use bcap_core::bcap::call::{Call, Maybe};
use bcap_core::bcap::client::{ClientError, Timeout};
use bcap_core::bcap::{FrameWriter, FunctionId, Link};
use bcap_core::error::EncodeError;
use bcap_core::hresult::HResult;
use bcap_std::blocking::{self, SerialClient, TcpClient, Transport as Wire, UdpClient};
use bcap_std::{CallError, ConnectError, Options};

use crate::budget::Budget;
use crate::error::Failure;
use crate::value::Value;
use bcap_std::{Address, NetworkAddress, Protocol};

/// The attempts of a call over UDP (S2:1493).
const UDP_ATTEMPTS: u8 = 5;

/// A connection that calls functions by their number.
pub(crate) struct Connection {
    client: Client,
    target: Address,
    /// The time limits of further calls.
    pub(crate) budget: Budget,
}

enum Client {
    Tcp(TcpClient),
    Udp(UdpClient),
    Serial(SerialClient),
}

/// A call whose function and arguments are known only at run time.
struct AnyCall<'a> {
    function: FunctionId,
    arguments: &'a [Value],
}

impl Call for AnyCall<'_> {
    type Reply = Maybe;

    fn function(&self) -> FunctionId {
        self.function
    }

    fn arguments(&self, frame: &mut FrameWriter<'_>) -> Result<(), EncodeError> {
        self.arguments.iter().try_for_each(|argument| frame.argument(argument))
    }
}

impl Connection {
    /// Connects. Over UDP and serial lines nothing is sent before the first call.
    pub(crate) fn open(target: &Address, budget: Budget) -> Result<Self, Failure> {
        let client = match target {
            Address::Network(server) => {
                first(&addresses(server, &budget)?, target, &budget, |address, options| match server.protocol {
                    Protocol::Tcp => blocking::connect_tcp(address, options).map(Client::Tcp),
                    Protocol::Udp => blocking::connect_udp(address, options).map(Client::Udp),
                })
            }
            Address::Serial(line) => blocking::connect_serial(line, &Options::default())
                .map(Client::Serial)
                .map_err(|error| not_connected(&error, target)),
            other => Err(Failure::Input(format!("{other}: this kind of address is not supported"))),
        }?;
        Ok(Self { client, target: target.clone(), budget })
    }

    /// Calls a function; returns the controller's code, and the value if the call succeeded.
    pub(crate) fn call(
        &mut self,
        function: FunctionId,
        arguments: &[Value],
    ) -> Result<(HResult, Option<Value>), Failure> {
        let (call, budget) = (AnyCall { function, arguments }, &self.budget);
        if budget.left().is_some_and(|left| left.is_zero()) {
            return Err(exhausted(&self.target, budget, &function.to_string()));
        }
        let replied = match &mut self.client {
            Client::Tcp(client) => call_over(client, call, budget),
            Client::Udp(client) => call_over(client, call, budget),
            Client::Serial(client) => call_over(client, call, budget),
        };
        match replied {
            Ok(reply) => Ok(reply),
            Err(CallError::Refused(code)) => Ok((code, None)),
            Err(CallError::Client(ClientError::Timeout(Timeout::Deadline | Timeout::KeepAlive)))
                if budget.total().is_some() =>
            {
                Err(exhausted(&self.target, budget, &function.to_string()))
            }
            Err(error) => Err(failed(&error, &self.target, budget.answer(), &function.to_string())),
        }
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

/// Returns what to check if no answer arrives.
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
                Timeout::Deadline | Timeout::KeepAlive => format!("{function} took too long: {error}"),
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

/// Resolves a host name within the time limit of the command.
///
/// IPv4 addresses come first: controllers use IPv4, `localhost` has addresses of both kinds, and over UDP connecting does
/// not show which address is in use.
pub(crate) fn addresses(target: &NetworkAddress, budget: &Budget) -> Result<Vec<SocketAddr>, Failure> {
    let (sender, receiver) = mpsc::channel();
    let (host, port) = (target.host.clone(), target.port);
    // the system's resolver has no time limit, so it runs in its own thread
    thread::Builder::new().name("resolver".into()).spawn(move || {
        let found = (host.as_str(), port).to_socket_addrs().map(Iterator::collect::<Vec<_>>);
        // the receiver is dropped at the time limit
        let _ = sender.send(found);
    })?;
    let found = match budget.left() {
        Some(left) => receiver.recv_timeout(left).ok(),
        None => receiver.recv().ok(),
    };
    let found = found.unwrap_or_else(|| Err(io::ErrorKind::TimedOut.into()));
    let found = found.map_err(|error| not_found(&target.host, &error))?;
    let (mut addresses, others): (Vec<_>, Vec<_>) = found.into_iter().partition(SocketAddr::is_ipv4);
    addresses.extend(others);
    Ok(addresses)
}

/// Connects to the first address that accepts; each attempt gets an equal share of the remaining time.
pub(crate) fn first<T>(
    addresses: &[SocketAddr],
    target: &Address,
    budget: &Budget,
    mut connect: impl FnMut(SocketAddr, &Options) -> Result<T, ConnectError>,
) -> Result<T, Failure> {
    let mut failure = not_found(&target.to_string(), &io::ErrorKind::NotFound.into());
    for (i, address) in addresses.iter().enumerate() {
        let options = Options::default().timeout(budget.share(addresses.len() - i));
        match connect(*address, &options) {
            Ok(connected) => return Ok(connected),
            Err(error) => failure = not_connected(&error, target),
        }
    }
    Err(failure)
}

/// Makes a call within the remaining time, and copies the value of the reply.
fn call_over<X: Wire<Error = io::Error>>(
    client: &mut blocking::Connection<X, Vec<u8>>,
    call: AnyCall<'_>,
    budget: &Budget,
) -> Result<(HResult, Option<Value>), CallError> {
    let (link, mut timing) = (client.client().link(), client.client().timing());
    let share = (budget.answer() / u32::from(UDP_ATTEMPTS)).max(Duration::from_millis(1));
    match link {
        Link::Stream => timing.attempt_timeout = budget.answer(),
        Link::Datagram => (timing.attempts, timing.attempt_timeout) = (UDP_ATTEMPTS, share),
        // not below the time that the line needs at its baud rate
        Link::Serial => timing.attempt_timeout = timing.attempt_timeout.max(share),
    }
    if let Some(left) = budget.left() {
        (timing.deadline, timing.keep_alive) = (left, left);
    }
    let value = client.call_with(call, timing)?;
    let value = value.map(|value| Value::new(&value)).transpose().map_err(ClientError::Encode)?;
    Ok((client.last_result().unwrap_or_default(), value))
}

/// Converts the error of connecting.
pub(crate) fn not_connected(error: &ConnectError, target: &Address) -> Failure {
    match error {
        ConnectError::Resolve { source, .. } => not_found(&target.to_string(), source),
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

fn not_found(host: &str, error: &io::Error) -> Failure {
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
