//! Servers that follow a script instead of the protocol, and the outcomes of calls to them.

use std::io::{Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream, UdpSocket};
use std::time::Duration;

use bcap_core::bcap::call::{self, VariableHandle};
use bcap_core::bcap::client::{ClientError, Config, Timing};
use bcap_core::hresult::HResult;
use bcap_core::io::{self, CallError};
use bcap_core::variant::Variant;
use bcap_std::{Options, asynch, blocking};
use bcap_testkit::frame::field;
use bcap_testkit::judge::TCP;
use bcap_testkit::oracle::Verdict;
use bcap_testkit::value::Value;

use crate::target::TIMEOUT;
use crate::wire::reply_frame;

/// How a call has ended.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Outcome {
    Value(Value),
    Refused(HResult),
    Client(ClientError),
    Disconnected,
    Io,
}

impl From<Result<Variant<'_>, CallError<std::io::Error>>> for Outcome {
    fn from(result: Result<Variant<'_>, CallError<std::io::Error>>) -> Self {
        result.map(Value::read).into()
    }
}

impl From<Result<Value, CallError<std::io::Error>>> for Outcome {
    fn from(result: Result<Value, CallError<std::io::Error>>) -> Self {
        match result {
            Ok(value) => Self::Value(value),
            Err(CallError::Refused(code)) => Self::Refused(code),
            Err(CallError::Client(error)) => Self::Client(error),
            Err(CallError::Disconnected) => Self::Disconnected,
            Err(CallError::Io(_)) => Self::Io,
            Err(error) => panic!("{error}"),
        }
    }
}

/// The behaviour of a server on a connection, from its first byte.
pub(crate) type Script = fn(&mut Connection);

/// The server's end of a connection.
pub(crate) struct Connection(pub(crate) TcpStream);

impl Connection {
    /// Reads a request and returns its serial; 0 when the client has gone.
    pub(crate) fn request(&mut self) -> u16 {
        let mut bytes = Vec::new();
        let mut byte = [0];
        loop {
            if let Verdict::Frame(frame, _) = TCP.decode(&bytes) {
                return frame.serial;
            }
            match self.0.read(&mut byte) {
                Ok(1) => bytes.extend(byte),
                _ => return 0,
            }
        }
    }

    /// Sends bytes; `false` when the client has gone.
    pub(crate) fn send(&mut self, bytes: &[u8]) -> bool {
        self.0.write_all(bytes).is_ok()
    }

    /// Reads and drops bytes until the client disconnects.
    pub(crate) fn hold(&mut self) {
        let _ = std::io::copy(&mut self.0, &mut std::io::sink());
    }

    /// Resets the connection.
    pub(crate) fn reset(&mut self) {
        let _ = socket2::SockRef::from(&self.0).set_linger(Some(Duration::ZERO));
    }
}

/// Starts a server for one connection.
pub(crate) fn serve(script: impl FnOnce(&mut Connection) + Send + 'static) -> SocketAddr {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap();
    std::thread::spawn(move || {
        let (stream, _) = listener.accept().unwrap();
        stream.set_nodelay(true).unwrap();
        script(&mut Connection(stream));
    });
    address
}

/// Starts a server that reads a request, sends some bytes and stays.
pub(crate) fn serve_bytes(bytes: Vec<u8>) -> SocketAddr {
    serve(move |connection| {
        connection.request();
        connection.send(&bytes);
        connection.hold();
    })
}

/// The answers of a server to a datagram: none, one or several.
pub(crate) type Answers = fn(&[u8], u32) -> Vec<Vec<u8>>;

/// Starts a server over UDP; `answers` gets the number of datagrams so far. It ends when no datagram has arrived for 5 s.
pub(crate) fn serve_udp(mut answers: impl FnMut(&[u8], u32) -> Vec<Vec<u8>> + Send + 'static) -> SocketAddr {
    let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
    let address = socket.local_addr().unwrap();
    socket.set_read_timeout(Some(Duration::from_secs(5))).unwrap();
    std::thread::spawn(move || {
        let mut buffer = [0; 2048];
        let mut count = 0;
        while let Ok((length, from)) = socket.recv_from(&mut buffer) {
            count += 1;
            for answer in answers(&buffer[..length], count) {
                let _ = socket.send_to(&answer, from);
            }
        }
    });
    address
}

/// Returns the serial in a request.
pub(crate) fn serial_of(datagram: &[u8]) -> u16 {
    field::serial(datagram).unwrap()
}

/// Options of a client with short timeouts.
pub(crate) fn brief() -> Options {
    let timing = Timing {
        attempt_timeout: Duration::from_millis(500),
        attempts: 3,
        deadline: Duration::from_secs(20),
        keep_alive: Duration::from_secs(1),
    };
    let config = |config: Config| Config { timing, ..config };
    let options = Options::default();
    options.tcp(config(options.tcp)).udp(config(options.udp)).connect_timeout(TIMEOUT)
}

/// The variable that clients read.
pub(crate) const VARIABLE: VariableHandle = VariableHandle(1);

/// The reply that is the right one.
pub(crate) fn right(serial: u16) -> Vec<u8> {
    reply_frame(serial, HResult::S_OK, vec![Value::I4(42)])
}

/// How a right reply is read.
pub(crate) const RIGHT: Outcome = Outcome::Value(Value::I4(42));

/// Makes `calls` calls over TCP with the blocking and the tokio client at the same time, each to a separate server. Returns
/// the outcomes, which are the same for both.
pub(crate) fn calls(options: &Options, calls: usize, server: impl FnMut() -> SocketAddr) -> Vec<Outcome> {
    with_both(
        server,
        |address| outcomes(blocking::connect_tcp(address, options).unwrap(), calls),
        async |address| outcomes_async(asynch::connect_tcp(address, options).await.unwrap(), calls).await,
    )
}

/// The same over UDP.
pub(crate) fn calls_udp(options: &Options, calls: usize, server: impl FnMut() -> SocketAddr) -> Vec<Outcome> {
    with_both(
        server,
        |address| outcomes(blocking::connect_udp(address, options).unwrap(), calls),
        async |address| outcomes_async(asynch::connect_udp(address, options).await.unwrap(), calls).await,
    )
}

fn with_both(
    mut server: impl FnMut() -> SocketAddr,
    blocking: impl FnOnce(SocketAddr) -> Vec<Outcome> + Send,
    tokio: impl AsyncFnOnce(SocketAddr) -> Vec<Outcome>,
) -> Vec<Outcome> {
    let [first, second] = [server(), server()];
    let (blocking, tokio) = std::thread::scope(|scope| {
        let blocking = scope.spawn(move || blocking(first));
        let tokio = runtime().block_on(tokio(second));
        (blocking.join().expect("the blocking client does not panic"), tokio)
    });
    assert_eq!(blocking, tokio, "the blocking and the tokio client");
    blocking
}

fn outcomes<X>(mut client: io::blocking::Connection<X, Vec<u8>>, calls: usize) -> Vec<Outcome>
where
    X: io::blocking::Transport<Error = std::io::Error>,
{
    (0..calls).map(|_| client.call(call::variable_get_value(VARIABLE)).into()).collect()
}

async fn outcomes_async<X>(mut client: io::asynch::Connection<X, Vec<u8>>, calls: usize) -> Vec<Outcome>
where
    X: io::asynch::Transport<Error = std::io::Error>,
{
    let mut outcomes = Vec::new();
    for _ in 0..calls {
        outcomes.push(client.call(call::variable_get_value(VARIABLE)).await.into());
    }
    outcomes
}

pub(crate) fn runtime() -> tokio::runtime::Runtime {
    tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap()
}
