//! Shows the packets of connections as text.
//!
//! The transport of a connection is wrapped, so a packet is shown as it was sent and received, including retries and
//! keep-alives.
//!
//! # Examples
//!
//! ```no_run
//! use bcap_capture::trace::{Level, Packets, Wire, with_arrow};
//! use bcap_std::blocking::{Connection, Controller, connect_tcp};
//! use bcap_std::Options;
//!
//! let mut packets = Packets::new();
//! packets.watch(Level::Values, |role, text| eprintln!("{}", with_arrow(role.arrow(), text)));
//! let (transport, client) = connect_tcp("192.168.0.1:5007", &Options::default())?.into_parts();
//! let robot = Controller::unopened(Connection::new(packets.tap(transport, Wire::Stream), client));
//! # Ok::<(), bcap_std::ConnectError>(())
//! ```

use std::fmt;
use std::io;
use std::str::FromStr;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use bcap_core::bcap::{Decoder, Frame, Progress};
use bcap_core::limits::Strictness;
use bcap_core::time::Instant;
use bcap_std::blocking::Transport;

use crate::dissect::{dissect, outline};
use crate::frame;
use crate::hex;
use crate::json::LIMITS;
use crate::role::Role;

/// How much of each packet is shown.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Level {
    /// Serial number, function or result code, and size.
    Headers,
    /// The decoded values too.
    Values,
    /// The values next to their bytes.
    Bytes,
}

/// `headers`, `values` or `bytes`.
impl FromStr for Level {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "headers" => Ok(Self::Headers),
            "values" => Ok(Self::Values),
            "bytes" => Ok(Self::Bytes),
            _ => Err("it is headers, values or bytes".into()),
        }
    }
}

/// The form of frames on a link.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Wire {
    /// TCP.
    Stream,
    /// UDP: a datagram is a frame.
    Datagrams,
    /// A serial line: frames have a CRC.
    Serial,
    /// RAC: a line ends with CR.
    Lines,
}

/// A function that receives packets as text.
type Show = dyn Fn(Role, &str) + Send + Sync;

/// A function that receives the bytes of packets.
type Take = dyn Fn(Role, Wire, &[u8]) + Send + Sync;

/// Receives packets.
#[derive(Clone)]
enum Watcher {
    Text(Level, Arc<Show>),
    Bytes(Arc<Take>),
}

impl fmt::Debug for Watcher {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Text(level, _) => f.debug_tuple("Text").field(level).finish_non_exhaustive(),
            Self::Bytes(_) => f.write_str("Bytes"),
        }
    }
}

/// The packets of the connections of one session: the last ones, and all of them for watchers.
#[derive(Clone, Debug, Default)]
pub struct Packets {
    watchers: Vec<Watcher>,
    last: Arc<Mutex<Last>>,
    /// Whether packets are neither recorded nor shown.
    paused: Arc<AtomicBool>,
}

#[derive(Debug, Default)]
struct Last {
    sent: Vec<u8>,
    received: Vec<u8>,
    /// The first packet that was sent after the last received packet.
    unanswered: Option<std::time::Instant>,
}

impl Packets {
    /// No packets, and no watchers.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Shows each packet of later connections to `show`, on the thread that sends or receives it.
    pub fn watch(&mut self, level: Level, show: impl Fn(Role, &str) + Send + Sync + 'static) {
        self.watchers.push(Watcher::Text(level, Arc::new(show)));
    }

    /// Passes the bytes of each packet of later connections to `take`, on the thread that sends or receives it.
    pub fn watch_bytes(&mut self, take: impl Fn(Role, Wire, &[u8]) + Send + Sync + 'static) {
        self.watchers.push(Watcher::Bytes(Arc::new(take)));
    }

    /// Wraps a transport.
    #[must_use]
    pub fn tap<X>(&self, inner: X, wire: Wire) -> Traced<X> {
        Traced { inner, wire, packets: self.clone(), sent: Vec::new(), received: Vec::new() }
    }

    /// Returns the bytes of the last packet that was sent.
    #[must_use]
    pub fn last_sent(&self) -> Vec<u8> {
        self.last().sent.clone()
    }

    /// Returns the bytes of the last packet that was received.
    #[must_use]
    pub fn last_received(&self) -> Vec<u8> {
        self.last().received.clone()
    }

    fn last(&self) -> MutexGuard<'_, Last> {
        self.last.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Sets whether packets are ignored, such as those that the prompt of the shell needs.
    pub fn set_paused(&self, paused: bool) {
        self.paused.store(paused, Ordering::SeqCst);
    }

    /// Returns when the first packet was sent that has no reply and no keep-alive yet.
    #[must_use]
    pub fn unanswered(&self) -> Option<std::time::Instant> {
        self.last().unanswered
    }

    /// Records a packet.
    fn packet(&self, role: Role, wire: Wire, bytes: &[u8]) {
        match role {
            Role::Request => drop(self.last().unanswered.get_or_insert_with(std::time::Instant::now)),
            Role::Response => self.last().unanswered = None,
        }
        if self.paused.load(Ordering::SeqCst) {
            return;
        }
        let mut last = self.last();
        let slot = if role == Role::Request { &mut last.sent } else { &mut last.received };
        slot.clear();
        slot.extend_from_slice(bytes);
        drop(last);
        for watcher in &self.watchers {
            match watcher {
                Watcher::Text(level, show) => show(role, &shown(role, wire, bytes, *level)),
                Watcher::Bytes(take) => take(role, wire, bytes),
            }
        }
    }
}

/// A transport that shows its bytes to [`Packets`].
#[derive(Debug)]
pub struct Traced<X> {
    inner: X,
    wire: Wire,
    packets: Packets,
    /// The bytes of incomplete packets.
    sent: Vec<u8>,
    received: Vec<u8>,
}

impl<X> Traced<X> {
    fn record(&mut self, role: Role, bytes: &[u8]) {
        if bytes.is_empty() {
            return;
        }
        let pending = if role == Role::Request { &mut self.sent } else { &mut self.received };
        pending.extend_from_slice(bytes);
        while let Some(length) = packet_length(pending, self.wire) {
            let rest = pending.split_off(length);
            self.packets.packet(role, self.wire, pending);
            *pending = rest;
        }
    }
}

/// Puts an arrow before the first line, and blanks before the others.
#[must_use]
pub fn with_arrow(arrow: &str, lines: &str) -> String {
    format!("{arrow} {}", lines.replace('\n', "\n   "))
}

/// Returns the length of the first packet, if it is complete. Bytes that cannot be a frame are a packet.
#[must_use]
pub fn packet_length(bytes: &[u8], wire: Wire) -> Option<usize> {
    match wire {
        _ if bytes.is_empty() => None,
        Wire::Datagrams => Some(bytes.len()),
        Wire::Lines => bytes.iter().position(|byte| *byte == b'\r').map(|end| end + 1),
        Wire::Stream | Wire::Serial => match decoder(wire).decode(bytes) {
            Ok(Progress::Complete(_, length)) => Some(length),
            Ok(Progress::NeedMore(_)) => None,
            Err(_) => Some(bytes.len()),
        },
    }
}

const fn decoder(wire: Wire) -> Decoder {
    Decoder { limits: LIMITS, strictness: Strictness::Lenient, crc: matches!(wire, Wire::Serial) }
}

/// Formats a packet.
#[must_use]
pub fn shown(role: Role, wire: Wire, bytes: &[u8], level: Level) -> String {
    if wire == Wire::Lines {
        let text = String::from_utf8_lossy(bytes).trim_end().to_owned();
        return if level == Level::Bytes { next_to_bytes(&text, bytes) } else { text };
    }
    let lenient = decoder(wire).decode_datagram(bytes);
    let strict = Decoder { strictness: Strictness::Strict, ..decoder(wire) }.decode_datagram(bytes);
    match (&lenient, &strict) {
        (Ok(frame), Ok(_)) if level == Level::Bytes && wire == Wire::Serial => dissect(bytes, frame, role, true),
        (Ok(frame), Ok(_)) if level == Level::Bytes => outline(bytes, frame, role),
        (Ok(frame), _) if level == Level::Headers => header(frame, role, bytes.len()),
        (Ok(frame), _) if level == Level::Values => frame::to_line(frame, role),
        (Ok(frame), Err(error)) => {
            format!("{}\n{}\n{error}", frame::to_line(frame, role), hex::spaced(bytes))
        }
        (Err(error), _) => format!("{}\nnot a frame: {error}", hex::spaced(bytes)),
        (Ok(frame), Ok(_)) => frame::to_line(frame, role),
    }
}

/// Formats a line of RAC after its bytes, 16 in a row.
fn next_to_bytes(text: &str, bytes: &[u8]) -> String {
    let mut rows = bytes.chunks(16).map(hex::spaced);
    let first = format!("{:48} {text}", rows.next().unwrap_or_default());
    std::iter::once(first).chain(rows).collect::<Vec<_>>().join("\n")
}

/// Writes the header of a frame: `#4 Variable_GetValue, 30 bytes`.
fn header(frame: &Frame<'_>, role: Role, length: usize) -> String {
    let code = match role {
        Role::Request => frame.function().to_string(),
        Role::Response => frame.hresult().to_string(),
    };
    format!("#{} {code}, {length} bytes", frame.serial)
}

impl<X: Transport<Error = io::Error>> Transport for Traced<X> {
    type Error = io::Error;

    fn now(&self) -> Instant {
        self.inner.now()
    }

    fn send(&mut self, bytes: &[u8], until: Instant) -> io::Result<Option<usize>> {
        let sent = self.inner.send(bytes, until)?;
        self.record(Role::Request, bytes.get(..sent.unwrap_or(0)).unwrap_or_default());
        Ok(sent)
    }

    fn receive(&mut self, buffer: &mut [u8], until: Instant) -> io::Result<Option<usize>> {
        let received = self.inner.receive(buffer, until)?;
        self.record(Role::Response, buffer.get(..received.unwrap_or(0)).unwrap_or_default());
        Ok(received)
    }

    fn sleep_until(&mut self, at: Instant) {
        self.inner.sleep_until(at);
    }
}
