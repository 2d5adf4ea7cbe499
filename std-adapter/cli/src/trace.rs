//! The packets of a session: the last ones, and with `--trace` all of them on the standard error.
//!
//! The transport of every connection is wrapped, so a packet is exactly the sent or received bytes, also for retries
//! and keep-alives.

use std::io::{self, Write as _};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::Sender;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use bcap_core::bcap::{Decoder, Frame, Progress};
use bcap_core::limits::Strictness;
use bcap_core::time::Instant;
use bcap_std::blocking::Transport;
use bcap_terminal::escape;

use crate::dissect::{dissect, outline};
use crate::frame::{self, Role};
use crate::hex;
use crate::json::LIMITS;

/// How much of each packet `--trace` prints.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub(crate) enum Level {
    /// Serial number, function or result code, and size
    Headers,
    /// The decoded values too
    Values,
    /// The values next to their bytes
    Bytes,
}

/// How frames are on the wire.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Wire {
    /// TCP.
    Stream,
    /// UDP: a datagram is a frame.
    Datagrams,
    /// A serial line: frames have a CRC.
    Serial,
    /// RAC: a line ends with CR.
    Lines,
}

/// The packets of the connections of one session.
#[derive(Clone, Debug)]
pub(crate) struct Packets {
    level: Option<Level>,
    /// Receives each packet as text.
    watcher: Option<(Level, Sender<(Role, String)>)>,
    last: Arc<Mutex<Last>>,
    /// Whether packets are neither recorded nor printed.
    paused: Arc<AtomicBool>,
}

#[derive(Debug, Default)]
struct Last {
    sent: Vec<u8>,
    received: Vec<u8>,
    /// The first packet that was sent after the last one that was received.
    unanswered: Option<std::time::Instant>,
}

impl Packets {
    pub(crate) fn new(level: Option<Level>) -> Self {
        Self { level, watcher: None, last: Arc::default(), paused: Arc::default() }
    }

    /// Sends each packet of later connections as text to `watcher`.
    pub(crate) fn watch(&mut self, level: Level, watcher: Sender<(Role, String)>) {
        self.watcher = Some((level, watcher));
    }

    /// Wraps a transport.
    pub(crate) fn tap<X>(&self, inner: X, wire: Wire) -> Traced<X> {
        Traced { inner, wire, packets: self.clone(), sent: Vec::new(), received: Vec::new() }
    }

    /// Returns the bytes of the last packet that was sent.
    pub(crate) fn last_sent(&self) -> Vec<u8> {
        self.last().sent.clone()
    }

    /// Returns the bytes of the last packet that was received.
    pub(crate) fn last_received(&self) -> Vec<u8> {
        self.last().received.clone()
    }

    fn last(&self) -> MutexGuard<'_, Last> {
        self.last.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Sets whether packets are ignored, such as those that the prompt of the shell needs.
    pub(crate) fn set_paused(&self, paused: bool) {
        self.paused.store(paused, Ordering::SeqCst);
    }

    /// Returns when the first packet was sent that has no reply and no keep-alive yet.
    pub(crate) fn unanswered(&self) -> Option<std::time::Instant> {
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
        if let Some((level, watcher)) = &self.watcher {
            // without a receiver the command is ending
            let _ = watcher.send((role, shown(role, wire, bytes, *level)));
        }
        if let Some(level) = self.level {
            let text = with_arrow(arrow(role), &shown(role, wire, bytes, level));
            // an error of the standard error cannot be reported
            let _ = writeln!(io::stderr().lock(), "{}", escape::block(&text));
        }
    }
}

/// A transport that shows its bytes to [`Packets`].
#[derive(Debug)]
pub(crate) struct Traced<X> {
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

/// Returns the arrow of a direction.
pub(crate) const fn arrow(role: Role) -> &'static str {
    match role {
        Role::Request => "->",
        Role::Response => "<-",
    }
}

/// Puts an arrow before the first line, and blanks before the others.
pub(crate) fn with_arrow(arrow: &str, lines: &str) -> String {
    format!("{arrow} {}", lines.replace('\n', "\n   "))
}

/// Returns the length of the first packet, if it is complete. Bytes that cannot be a frame are a packet.
pub(crate) fn packet_length(bytes: &[u8], wire: Wire) -> Option<usize> {
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
pub(crate) fn shown(role: Role, wire: Wire, bytes: &[u8], level: Level) -> String {
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
