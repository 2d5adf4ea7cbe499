//! Invalid frames, and a connection that sends them.

use std::io::ErrorKind;
use std::net::{SocketAddr, TcpStream};
use std::time::Duration;

use bcap_core::bcap::FunctionId;
use bcap_core::hresult::HResult;
use bcap_testkit::frame::TestFrame;
use bcap_testkit::judge::TCP;
use bcap_testkit::value::Value;
use bcap_testkit::wire::{Link, Received, Wire};

/// The serial of requests that are made here.
pub(crate) const SERIAL: u16 = 9;

/// A request.
pub(crate) fn request(function: FunctionId, args: Vec<Value>) -> TestFrame {
    TestFrame { serial: SERIAL, reserved: 0, code: function.0, args }
}

/// The bytes of a request.
pub(crate) fn bytes(function: FunctionId, args: Vec<Value>) -> Vec<u8> {
    request(function, args).to_wire(false)
}

/// A reply.
pub(crate) fn reply_frame(serial: u16, code: HResult, args: Vec<Value>) -> Vec<u8> {
    TestFrame { serial, reserved: 0, code: code.0, args }.to_wire(false)
}

/// A whole frame around a body that may be anything; `count` is its number of arguments.
pub(crate) fn frame(serial: u16, code: i32, count: u16, body: &[u8]) -> Vec<u8> {
    let length = u32::try_from(16 + body.len()).unwrap();
    let mut bytes = vec![1];
    bytes.extend(length.to_le_bytes());
    bytes.extend(serial.to_le_bytes());
    bytes.extend([0, 0]);
    bytes.extend(code.to_le_bytes());
    bytes.extend(count.to_le_bytes());
    bytes.extend(body);
    bytes.push(4);
    bytes
}

/// An argument with its length, around bytes that may be an invalid value.
pub(crate) fn argument(value: &[u8]) -> Vec<u8> {
    let mut bytes = u32::try_from(value.len()).unwrap().to_le_bytes().to_vec();
    bytes.extend(value);
    bytes
}

/// A value: its VARTYPE, its count and its data, which need not fit each other.
pub(crate) fn value(vartype: u16, count: u32, data: &[u8]) -> Vec<u8> {
    let mut bytes = vartype.to_le_bytes().to_vec();
    bytes.extend(count.to_le_bytes());
    bytes.extend(data);
    bytes
}

/// VARIANTs in VARIANTs, `levels` deep, with EMPTY at the bottom.
pub(crate) fn nested(levels: usize) -> Vec<u8> {
    let mut bytes: Vec<u8> = [0x0c, 0x20, 1, 0, 0, 0].repeat(levels);
    bytes.extend([0, 0, 1, 0, 0, 0]);
    bytes
}

/// Invalid values, by their error; each claims more bytes than there are.
pub(crate) fn broken_values() -> Vec<(&'static str, Vec<u8>)> {
    let some = [0x5a; 64];
    vec![
        ("a BSTR of 4 GiB", value(8, 1, &0xffff_fffe_u32.to_le_bytes())),
        ("a BSTR of 65536 bytes that are not there", value(8, 1, &65536_u32.to_le_bytes())),
        ("an odd BSTR", value(8, 1, &[1, 0, 0, 0, 65])),
        ("R8 whose size wraps", value(0x2005, 0x2000_0001, &some)),
        ("VARIANTs whose size wraps", value(0x200c, 0x0aaa_aaab, &some)),
        ("BSTRs whose size wraps", value(0x2008, 0x2000_0001, &some)),
        ("I4 of a gibibyte", value(0x2003, 0x1000_0000, &some)),
        ("UI1 whose end wraps", value(0x2011, 0xffff_fff0, &some)),
        ("UI1 of 4 GiB", value(0x2011, 0xffff_ffff, &some)),
        ("a billion EMPTYs", value(0x2000, 1 << 30, &[])),
        ("a billion NULLs", value(0x2001, 1 << 30, &[])),
        ("ERROR without end", value(0x200a, 0x4000_0001, &some)),
        ("a scalar of count 0", value(3, 0, &[1, 0, 0, 0])),
        ("a scalar of count 5", value(3, 5, &[1, 0, 0, 0])),
        ("a scalar of count 99", value(3, 99, &[1, 0, 0, 0])),
        ("half a scalar", value(5, 1, &[0, 0, 0, 0])),
        ("only a type", vec![3, 0]),
        ("nothing", vec![]),
    ]
}

/// VARTYPEs that no value on the wire can have.
pub(crate) const UNKNOWN_TYPES: &[u16] =
    &[9, 13, 14, 16, 22, 23, 24, 36, 0x1003, 0x2009, 0x200d, 0x200e, 0x2010, 0x2018, 0x4003, 0x400c, 0x6003, 0xffff];

/// Time limit of a failing case: a passing case never waits this long.
pub(crate) const LIMIT: Duration = Duration::from_secs(30);

/// A client that sends and receives raw bytes.
#[derive(Debug)]
pub(crate) struct Raw {
    wire: Wire,
    link: Link,
    /// The serial of the last request of [`Raw::ask`].
    pub(crate) serial: u16,
}

impl Raw {
    /// Connects over TCP.
    pub(crate) fn connect(address: SocketAddr) -> Self {
        Self { wire: Wire::connect(Link::Tcp, address, LIMIT).unwrap(), link: Link::Tcp, serial: 1 }
    }

    /// Opens a port for datagrams.
    pub(crate) fn datagrams(address: SocketAddr) -> Self {
        Self { wire: Wire::connect(Link::Udp, address, LIMIT).unwrap(), link: Link::Udp, serial: 1 }
    }

    /// Takes a connected stream.
    pub(crate) fn new(stream: TcpStream) -> Self {
        Self { wire: Wire::of_stream(stream, LIMIT).unwrap(), link: Link::Tcp, serial: 1 }
    }

    pub(crate) const fn stream(&self) -> &TcpStream {
        self.wire.stream().expect("a connection over TCP")
    }

    /// Sends bytes; the server may have closed before it has read all of them. A frame that is larger than a datagram is not
    /// sent.
    pub(crate) fn send(&mut self, bytes: &[u8]) {
        match self.wire.send(bytes) {
            Err(error) if self.link == Link::Tcp && !is_closed(error.kind()) => panic!("{error}"),
            _ => {}
        }
    }

    /// Shuts down the sending direction.
    pub(crate) fn finish(&mut self) {
        let _ = self.wire.finish();
    }

    /// Goes away with a reset, so that the server cannot send any more either.
    pub(crate) fn reset(self) {
        socket2::SockRef::from(self.stream()).set_linger(Some(Duration::ZERO)).unwrap();
    }

    /// Receives the next reply; `None` when the server has closed.
    pub(crate) fn next_reply(&mut self) -> Option<TestFrame> {
        match self.wire.receive(LIMIT) {
            Received::Packet(bytes) => {
                Some(TCP.decode_packet(&bytes).unwrap_or_else(|| panic!("{bytes:02x?} is no reply")))
            }
            Received::Closed => None,
            Received::Silence => panic!("the server answers"),
        }
    }

    /// Receives the next reply.
    pub(crate) fn reply(&mut self) -> TestFrame {
        self.next_reply().expect("the server answers")
    }

    /// Sends a request and receives its reply.
    pub(crate) fn call(&mut self, request: &TestFrame) -> TestFrame {
        self.send(&request.to_wire(false));
        let reply = self.reply();
        assert_eq!((reply.serial, reply.reserved), (request.serial, 0));
        reply
    }

    /// Sends a call with the next serial.
    pub(crate) fn ask(&mut self, function: FunctionId, args: Vec<Value>) -> TestFrame {
        self.serial += 1;
        let reserved = if self.link.repeats() { self.serial } else { 0 };
        self.call(&TestFrame { serial: self.serial, reserved, ..request(function, args) })
    }

    /// Receives all replies until the server closes.
    pub(crate) fn replies(&mut self) -> Vec<TestFrame> {
        std::iter::from_fn(|| self.next_reply()).collect()
    }

    /// Receives bytes until the server closes.
    pub(crate) fn rest(&mut self) -> Vec<u8> {
        let mut rest = Vec::new();
        while let Received::Packet(bytes) = self.wire.receive(LIMIT) {
            rest.extend(bytes);
        }
        rest
    }

    /// Begins a session and returns the handle of the controller.
    pub(crate) fn begin(&mut self) -> i32 {
        assert_eq!(self.ask(FunctionId::SERVICE_START, vec![Value::text("")]).code, 0);
        let connect = self.ask(FunctionId::CONTROLLER_CONNECT, vec![Value::text(""); 4]);
        let [Value::I4(handle)] = connect.args[..] else { panic!("a handle: {connect:?}") };
        handle
    }

    /// Ends a session.
    pub(crate) fn end(&mut self) {
        assert_eq!(self.ask(FunctionId::SERVICE_STOP, vec![]).code, 0);
    }

    /// Asserts that the bytes sent before get no answer: the answer to a call arrives first.
    pub(crate) fn hears_nothing(&mut self) {
        assert_eq!(self.ask(FunctionId(138), vec![]).code, HResult::E_INVALIDARG.0);
    }
}

fn is_closed(kind: ErrorKind) -> bool {
    matches!(kind, ErrorKind::ConnectionReset | ErrorKind::ConnectionAborted | ErrorKind::BrokenPipe)
}
