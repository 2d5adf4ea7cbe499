//! The raw connection to a device: bytes and frames, valid or not, with a time limit for every wait.

use std::fmt::Write as _;
use std::io::{self, Read, Write};
use std::net::{Shutdown, SocketAddr, TcpStream, UdpSocket};
use std::time::{Duration, Instant};

use bcap_core::bcap::{Decoder, FrameWriter, FunctionId, Progress};
use bcap_core::hresult::HResult;
use bcap_core::limits::{Strictness, UDP_RECEIVE_MAX};
use bcap_core::variant::{OwnedVariant, Variant};

/// The transport of b-CAP.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Link {
    /// A TCP connection.
    Tcp,
    /// UDP datagrams.
    Udp,
}

/// A received reply.
#[derive(Clone, Debug)]
pub(crate) struct Reply {
    pub(crate) serial: u16,
    pub(crate) reserved: u16,
    pub(crate) code: HResult,
    pub(crate) args: Vec<OwnedVariant>,
}

impl Reply {
    pub(crate) fn value(&self) -> Option<Variant<'_>> {
        self.args.first().map(OwnedVariant::as_variant)
    }

    /// Returns the reply in one line, such as `#4 0x00000000 (S_OK): I4(3)`.
    pub(crate) fn text(&self) -> String {
        let mut out = format!("#{} {}", self.serial, self.code);
        for (index, value) in self.args.iter().enumerate() {
            // writing to a string cannot fail
            let _ = write!(out, "{} {}", if index == 0 { ":" } else { "," }, short(&value.as_variant()));
        }
        if self.reserved != 0 {
            let _ = write!(out, " (reserved field {})", self.reserved);
        }
        out
    }
}

/// What arrived within a time limit.
#[derive(Clone, Debug)]
pub(crate) enum Came {
    Reply(Reply),
    /// Bytes that are not a frame.
    Invalid(String),
    Closed,
    Nothing,
}

impl Came {
    pub(crate) fn text(&self) -> String {
        match self {
            Self::Reply(reply) => reply.text(),
            Self::Invalid(why) => format!("an invalid frame: {why}"),
            Self::Closed => "the device closed the connection".into(),
            Self::Nothing => "no reply within the time limit".into(),
        }
    }
}

/// Shortens the text of a large value.
pub(crate) fn short(value: &Variant<'_>) -> String {
    let text = format!("{value:?}");
    match text.char_indices().nth(160) {
        Some((at, _)) => format!("{}... ({} characters)", &text[..at], text.chars().count()),
        None => text,
    }
}

/// Returns bytes as hexadecimal digits, at most 64 of them.
pub(crate) fn hex(bytes: &[u8]) -> String {
    let mut out: String = bytes.iter().take(64).map(|byte| format!("{byte:02x}")).collect();
    if bytes.len() > 64 {
        let _ = write!(out, "... ({} bytes)", bytes.len());
    }
    out
}

/// Encodes a request.
pub(crate) fn encode(serial: u16, marker: u16, code: i32, args: &[OwnedVariant]) -> Vec<u8> {
    let room = args.iter().map(|value| value.as_bytes().len() + 16).sum::<usize>() + 64;
    let mut buffer = vec![0; room];
    let written = FrameWriter::new(&mut buffer).and_then(|mut frame| {
        args.iter().try_for_each(|value| frame.argument(&value.as_variant()))?;
        frame.finish(serial, marker, code).map(<[u8]>::to_vec)
    });
    // `room` is above the sum of all parts
    written.unwrap_or_default()
}

/// Returns a request in one line, such as `#4 Variable_GetValue(variable: I4(3))`.
pub(crate) fn request_text(serial: u16, function: FunctionId, args: &[OwnedVariant]) -> String {
    let mut out = format!("#{serial} {function}(");
    for (index, value) in args.iter().enumerate() {
        let separator = if index > 0 { ", " } else { "" };
        let name = function.argument_names().get(index).map(|name| format!("{name}: ")).unwrap_or_default();
        let _ = write!(out, "{separator}{name}{}", short(&value.as_variant()));
    }
    out.push(')');
    out
}

/// A connection, or a socket that sends datagrams to the device.
#[derive(Debug)]
pub(crate) enum Wire {
    Tcp { stream: TcpStream, received: Vec<u8> },
    Udp(UdpSocket),
}

impl Wire {
    pub(crate) fn connect(link: Link, address: SocketAddr, limit: Duration) -> io::Result<Self> {
        match link {
            Link::Tcp => {
                let stream = TcpStream::connect_timeout(&address, limit)?;
                stream.set_nodelay(true)?;
                stream.set_write_timeout(Some(limit))?;
                Ok(Self::Tcp { stream, received: Vec::new() })
            }
            Link::Udp => {
                let any: SocketAddr = if address.is_ipv4() { ([0, 0, 0, 0], 0).into() } else { ([0_u16; 8], 0).into() };
                let socket = UdpSocket::bind(any)?;
                socket.connect(address)?;
                Ok(Self::Udp(socket))
            }
        }
    }

    /// Ends the connection, and waits until the device has ended it too: a small device then has room for the next one.
    pub(crate) fn close(self, limit: Duration) {
        let Self::Tcp { mut stream, .. } = self else { return };
        let until = Instant::now() + limit;
        let mut buffer = [0; 4096];
        // a device that has ended the connection already is no error
        let mut open = stream.shutdown(Shutdown::Write).is_ok();
        while open {
            open = matches!(read_until(&mut stream, &mut buffer, until), Ok(Some(1..)));
        }
    }

    pub(crate) fn send(&mut self, bytes: &[u8]) -> io::Result<()> {
        match self {
            Self::Tcp { stream, .. } => stream.write_all(bytes),
            Self::Udp(socket) => socket.send(bytes).map(drop),
        }
    }

    /// Receives a frame within `limit`.
    pub(crate) fn receive(&mut self, limit: Duration) -> Came {
        let until = Instant::now() + limit;
        match self {
            Self::Tcp { stream, received } => receive_stream(stream, received, until),
            Self::Udp(socket) => receive_datagram(socket, until),
        }
    }
}

fn receive_stream(stream: &mut TcpStream, received: &mut Vec<u8>, until: Instant) -> Came {
    loop {
        match Decoder::TCP.decode(received) {
            Ok(Progress::Complete(frame, used)) => {
                let reply = reply_of(&frame);
                received.drain(..used);
                return Came::Reply(reply);
            }
            Ok(Progress::NeedMore(_)) => {}
            Err(error) => return Came::Invalid(format!("{error} ({})", hex(received))),
        }
        let mut buffer = [0; 4096];
        match read_until(stream, &mut buffer, until) {
            Ok(Some(0)) | Err(_) if received.is_empty() => return Came::Closed,
            Ok(Some(0)) | Err(_) => return Came::Invalid(format!("the connection ends after {}", hex(received))),
            Ok(Some(count)) => received.extend_from_slice(&buffer[..count]),
            Ok(None) if received.is_empty() => return Came::Nothing,
            Ok(None) => return Came::Invalid(format!("the rest of the frame is missing after {}", hex(received))),
        }
    }
}

/// Reads once; `None` at the time limit.
pub(crate) fn read_until(stream: &mut TcpStream, buffer: &mut [u8], until: Instant) -> io::Result<Option<usize>> {
    loop {
        let left = until.saturating_duration_since(Instant::now());
        if left.is_zero() {
            return Ok(None);
        }
        stream.set_read_timeout(Some(left))?;
        match stream.read(buffer) {
            Ok(count) => return Ok(Some(count)),
            Err(error) if is_timeout(&error) => {}
            Err(error) => return Err(error),
        }
    }
}

fn receive_datagram(socket: &UdpSocket, until: Instant) -> Came {
    let mut buffer = [0; 65536];
    loop {
        let left = until.saturating_duration_since(Instant::now());
        if left.is_zero() {
            return Came::Nothing;
        }
        if socket.set_read_timeout(Some(left)).is_err() {
            return Came::Nothing;
        }
        match socket.recv(&mut buffer) {
            Ok(count) if count > UDP_RECEIVE_MAX => {
                return Came::Invalid(format!("a datagram of {count} bytes; the maximum is {UDP_RECEIVE_MAX}"));
            }
            Ok(count) => {
                return match Decoder::UDP.decode_datagram(&buffer[..count]) {
                    Ok(frame) => Came::Reply(reply_of(&frame)),
                    Err(error) => Came::Invalid(format!("{error} ({})", hex(&buffer[..count]))),
                };
            }
            Err(error) if is_timeout(&error) => {}
            // the host has no such port
            Err(_) => return Came::Closed,
        }
    }
}

fn is_timeout(error: &io::Error) -> bool {
    matches!(error.kind(), io::ErrorKind::WouldBlock | io::ErrorKind::TimedOut | io::ErrorKind::Interrupted)
}

fn reply_of(frame: &bcap_core::bcap::Frame<'_>) -> Reply {
    // a decoded value can be encoded again
    let args = frame.args.iter().map(|value| OwnedVariant::new(&value).unwrap_or_default()).collect();
    Reply { serial: frame.serial, reserved: frame.reserved, code: frame.hresult(), args }
}

/// Decodes the frame at the front of `bytes` as a request: serial, marker, function and arguments.
pub(crate) fn describe(bytes: &[u8]) -> String {
    match Decoder::TCP.strictness(Strictness::Lenient).decode(bytes) {
        Ok(Progress::Complete(frame, _)) => {
            let args: Vec<_> = frame.args.iter().map(|value| OwnedVariant::new(&value).unwrap_or_default()).collect();
            request_text(frame.serial, frame.function(), &args)
        }
        _ => "not a valid request".into(),
    }
}
