//! A b-CAP client over TCP or UDP, its failures told in words.

use std::io;
use std::net::{SocketAddr, ToSocketAddrs};
use std::time::Duration;

use bcap_core::bcap::call::{Call, Maybe};
use bcap_core::bcap::client::{ClientError, Timeout};
use bcap_core::bcap::{FrameWriter, FunctionId};
use bcap_core::error::EncodeError;
use bcap_core::hresult::HResult;
use bcap_std::blocking::{self, TcpClient, Transport as Wire, UdpClient};
use bcap_std::{CallError, ConnectError, Options};

use crate::error::Failure;
use crate::target::{Target, Transport};
use crate::value::Value;

/// Attempts of a call over UDP (S2:1493).
const UDP_ATTEMPTS: u8 = 5;

/// A connection over which functions are called by their number.
pub(crate) struct Connection {
    client: Client,
    target: Target,
    timeout: Duration,
}

enum Client {
    Tcp(TcpClient),
    Udp(UdpClient),
}

/// A call whose function and arguments are known at run time only.
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
    /// Connects; over UDP nothing is sent before the first call.
    pub(crate) fn open(target: &Target, timeout: Duration) -> Result<Self, Failure> {
        let mut options = Options::default().timeout(timeout);
        options.udp.timing.attempts = UDP_ATTEMPTS;
        options.udp.timing.attempt_timeout = (timeout / u32::from(UDP_ATTEMPTS)).max(Duration::from_millis(1));
        let peer = (target.host.as_str(), target.port);
        let client = match target.transport {
            Transport::Tcp => blocking::connect_tcp(peer, &options).map(Client::Tcp),
            Transport::Udp => blocking::connect_udp(&addresses(peer)?[..], &options).map(Client::Udp),
        };
        match client {
            Ok(client) => Ok(Self { client, target: target.clone(), timeout }),
            Err(error) => Err(not_connected(&error, target)),
        }
    }

    /// Calls a function and returns the controller's code, and the value of a success.
    pub(crate) fn call(
        &mut self,
        function: FunctionId,
        arguments: &[Value],
    ) -> Result<(HResult, Option<Value>), Failure> {
        let call = AnyCall { function, arguments };
        let replied = match &mut self.client {
            Client::Tcp(client) => call_over(client, call),
            Client::Udp(client) => call_over(client, call),
        };
        match replied {
            Ok(reply) => Ok(reply),
            Err(CallError::Refused(code)) => Ok((code, None)),
            Err(error) => Err(failed(&error, &self.target, self.timeout, &function.to_string())),
        }
    }
}

/// Tells a failed call in words; `function` is what was called.
pub(crate) fn failed(error: &CallError, target: &Target, timeout: Duration, function: &str) -> Failure {
    match error {
        CallError::Io(error) => broken(error, target),
        CallError::Disconnected => Failure::Connection {
            message: format!("{target} has closed the connection during {function}"),
            hint: "a controller does so when it dislikes a packet or runs out of connections; read its log".into(),
        },
        CallError::Client(ClientError::Timeout(which)) => {
            let message = match which {
                Timeout::Attempt => format!("{target} did not answer {function} within {} ms", timeout.as_millis()),
                Timeout::Deadline | Timeout::KeepAlive => format!("{function} took too long: {error}"),
            };
            let hint = match target.transport {
                Transport::Tcp => "check that a b-CAP server listens there, or allow more time with --timeout",
                Transport::Udp => {
                    "check the address, that the controller's b-CAP accepts UDP, and firewalls, or allow more time \
                     with --timeout"
                }
            };
            Failure::Timeout { message, hint: hint.into() }
        }
        CallError::Client(ClientError::Encode(_) | ClientError::TooLarge { .. }) => {
            let hint = match target.transport {
                Transport::Tcp => "",
                Transport::Udp => "; TCP carries more than UDP",
            };
            Failure::Input(format!("{function}: {error}{hint}"))
        }
        error => Failure::Connection {
            message: format!("{function}: {error}"),
            hint: format!("check that {target} is a b-CAP server"),
        },
    }
}

/// Looks a host up for UDP, where nothing tells beforehand which of several addresses is heard.
///
/// IPv4 goes first: controllers speak it, and `localhost` has both.
fn addresses((host, port): (&str, u16)) -> Result<Vec<SocketAddr>, Failure> {
    let found = (host, port).to_socket_addrs().map_err(|error| not_found(host, &error))?;
    let (mut addresses, others): (Vec<_>, Vec<_>) = found.partition(SocketAddr::is_ipv4);
    addresses.extend(others);
    Ok(addresses)
}

/// Calls, and copies what the reply carries.
fn call_over<X: Wire<Error = io::Error>>(
    client: &mut blocking::Connection<X, Vec<u8>>,
    call: AnyCall<'_>,
) -> Result<(HResult, Option<Value>), CallError> {
    let value = client.call(call)?;
    let value = value.map(|value| Value::new(&value)).transpose().map_err(ClientError::Encode)?;
    Ok((client.last_result().unwrap_or_default(), value))
}

/// Tells in words why there is no connection.
pub(crate) fn not_connected(error: &ConnectError, target: &Target) -> Failure {
    match error {
        ConnectError::Resolve { source, .. } => not_found(&target.host, source),
        ConnectError::Connect { address, source } => Failure::Connection {
            message: format!("{target} ({address}) cannot be connected to: {source}"),
            hint: connect_hint(source.kind()).into(),
        },
        other => Failure::Connection {
            message: format!("{target}: {other}"),
            hint: "check the limits of this machine, such as that of open files".into(),
        },
    }
}

fn not_found(host: &str, error: &io::Error) -> Failure {
    Failure::Connection {
        message: format!("the host {host} cannot be found: {error}"),
        hint: "check the spelling, or give the IP address".into(),
    }
}

/// Tells in words why a connection broke.
pub(crate) fn broken(error: &io::Error, target: &Target) -> Failure {
    Failure::Connection {
        message: format!("the connection to {target} failed: {error}"),
        hint: connect_hint(error.kind()).into(),
    }
}

fn connect_hint(kind: io::ErrorKind) -> &'static str {
    match kind {
        io::ErrorKind::ConnectionRefused => {
            "nothing listens there: check the port, and that the controller's b-CAP or RAC server is enabled; \
             `bcap sim` starts a virtual controller"
        }
        io::ErrorKind::TimedOut => "check the address, the cable and firewalls, or allow more time with --timeout",
        io::ErrorKind::ConnectionReset | io::ErrorKind::BrokenPipe | io::ErrorKind::ConnectionAborted => {
            "the controller ended the connection: it may have restarted, or run out of connections; try again"
        }
        _ => "check the address and the network",
    }
}
