//! RAC over loopback sockets: the server, the blocking client and the tokio client.

use std::io::{Read as _, Write as _};
use std::net::TcpStream;
use std::time::Duration;

use bcap_core::bcap;
use bcap_core::handler::{Outcome, PeerId, ReplyValue};
use bcap_core::hresult::HResult;
use bcap_core::io::CallError;
use bcap_core::rac::client::{ClientError, Timeout};
use bcap_core::rac::{Request, Variable, VariableKind, server};
use bcap_core::time::Instant;
use bcap_core::variant::Variant;
use bcap_std::{Options, asynch, blocking};

use crate::served::Served;

/// A handler with one integer, I0. A read of I1 waits until I0 is 0.
#[derive(Default)]
struct Counter {
    count: i32,
    left: usize,
}

impl server::Handler for Counter {
    fn call(&mut self, _: PeerId, request: &Request<'_>, reply: &mut ReplyValue<'_>, _: Instant) -> Outcome {
        let variable = request.variable();
        match (variable.kind, variable.index, request.value()) {
            (VariableKind::I, 0, Some(Variant::I4(count))) => self.count = count,
            (VariableKind::I, 1, None) if self.count != 0 => return Outcome::Wait(Instant::FAR_FUTURE),
            (VariableKind::I, 0 | 1, None) => {
                let _ = reply.set(&self.count);
            }
            _ => return HResult::E_INVALIDARG.into(),
        }
        HResult::S_OK.into()
    }

    fn left(&mut self, _: PeerId, _: Instant) {
        self.left += 1;
    }
}

impl bcap::server::Handler for Counter {
    fn call(&mut self, _: PeerId, _: &bcap::server::Request<'_>, _: &mut ReplyValue<'_>, _: Instant) -> Outcome {
        HResult::E_NOTIMPL.into()
    }
}

fn start() -> Served<Counter> {
    Served::start(Counter { count: 41, left: 0 }, async |server| server.rac_tcp("127.0.0.1:0").await)
}

/// Reads one line without its CR.
fn line(stream: &mut TcpStream) -> String {
    let mut text = Vec::new();
    let mut byte = [0];
    loop {
        stream.read_exact(&mut byte).unwrap();
        if byte == *b"\r" {
            return String::from_utf8(text).unwrap();
        }
        text.push(byte[0]);
    }
}

#[test]
fn a_waiting_request_is_resumed_by_another_connection() {
    let server = start();
    let mut waiting = TcpStream::connect(server.rac()).unwrap();
    waiting.write_all(b"GET:RC8:1:I:\r").unwrap();
    let mut other = TcpStream::connect(server.rac()).unwrap();
    other.write_all(b"PUT:RC8:0:I:3,0\r").unwrap();
    assert_eq!(line(&mut other), "0");
    assert_eq!(line(&mut waiting), "0,3,0");
}

#[test]
fn a_stop_closes_connections_and_reports_them_to_the_handler() {
    let mut server = start();
    let mut stream = TcpStream::connect(server.rac()).unwrap();
    stream.write_all(b"GET:RC8:0:I:\r").unwrap();
    assert_eq!(line(&mut stream), "0,3,41");
    server.stop();
    assert_eq!(stream.read(&mut [0; 8]).unwrap(), 0);
    assert_eq!(server.handler().left, 1);
}

/// Reads and writes a variable, and keeps the connection after refused requests.
macro_rules! session {
    ($client:expr $(, $wait:tt)?) => {{
        let client = &mut $client;
        let (first, other) = (Variable::new(VariableKind::I, 0), Variable::new(VariableKind::D, 0));
        assert_eq!(client.get(first)$(.$wait)?.unwrap(), Variant::I4(41));
        client.put(first, Variant::I4(-7))$(.$wait)?.unwrap();
        assert_eq!(client.get(other)$(.$wait)?.unwrap_err().hresult(), Some(HResult::E_INVALIDARG));
        assert_eq!(client.get(first)$(.$wait)?.unwrap(), Variant::I4(-7));
        // a value that has no text is an error of the caller, and nothing is sent
        let error = client.put(first, Variant::R8(f64::from_bits(0x7ff8_0000_0000_0001)))$(.$wait)?.unwrap_err();
        assert!(matches!(error, CallError::Client(ClientError::Request(_))), "{error}");
        assert_eq!(client.get(first)$(.$wait)?.unwrap(), Variant::I4(-7));
    }};
}

#[test]
fn a_blocking_client_reads_writes_and_is_refused() {
    let server = start();
    session!(blocking::connect_rac(server.rac(), &Options::default()).unwrap());
}

#[tokio::test]
async fn a_tokio_client_reads_writes_and_is_refused() {
    let server = start();
    session!(asynch::connect_rac(server.rac(), &Options::default()).await.unwrap(), await);
}

#[test]
fn a_late_reply_is_never_matched_to_a_later_request() {
    let server = start();
    let options = Options::default().timeout(Duration::from_secs(2));
    let mut client = blocking::connect_rac(server.rac(), &options).unwrap();
    let (count, zero) = (Variable::new(VariableKind::I, 0), Variable::new(VariableKind::I, 1));
    // the server delays this reply until the count is 0
    let error = client.get(zero).unwrap_err();
    assert!(matches!(error, CallError::Client(ClientError::Timeout(Timeout::Reply))), "{error}");
    assert!(error.is_recoverable());
    let error = client.put(count, Variant::I4(5)).unwrap_err();
    assert!(matches!(error, CallError::Client(ClientError::Timeout(Timeout::Outstanding))), "{error}");
    let mut other = blocking::connect_rac(server.rac(), &Options::default()).unwrap();
    other.put(count, Variant::I4(0)).unwrap();
    other.put(count, Variant::I4(9)).unwrap();
    assert_eq!(client.get(count).unwrap(), Variant::I4(9));
}
