//! A transport that records the frames or lines that pass through it.

use std::io;

use bcap_core::bcap::{Decoder, Progress};
use bcap_core::time::Instant;
use bcap_std::blocking::Transport;

use crate::dissect::outline;
use crate::frame::Role;
use crate::hex;

/// A transport, and a transcript of its traffic.
pub(crate) struct Tap<X> {
    inner: X,
    protocol: Protocol,
    sent: Vec<u8>,
    received: Vec<u8>,
    lines: String,
}

/// The protocol of the traffic.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Protocol {
    Bcap,
    Rac,
}

impl<X> Tap<X> {
    pub(crate) fn new(inner: X, protocol: Protocol) -> Self {
        Self { inner, protocol, sent: Vec::new(), received: Vec::new(), lines: String::new() }
    }

    /// Takes the transcript since the last call: each frame decoded next to its bytes.
    pub(crate) fn take(&mut self) -> String {
        std::mem::take(&mut self.lines)
    }

    fn record(&mut self, role: Role, bytes: &[u8]) {
        let pending = if role == Role::Request { &mut self.sent } else { &mut self.received };
        pending.extend_from_slice(bytes);
        while let Some((text, used)) = next_frame(pending, self.protocol, role) {
            let mut arrow = if role == Role::Request { "->" } else { "<-" };
            for line in text.lines() {
                self.lines.push_str(&format!("  {arrow} {line}\n"));
                arrow = "  ";
            }
            pending.drain(..used);
        }
    }
}

/// Decodes the first frame or line, if it is complete, and returns its length. The client reports invalid bytes.
fn next_frame(bytes: &[u8], protocol: Protocol, role: Role) -> Option<(String, usize)> {
    match protocol {
        Protocol::Bcap => match Decoder::TCP.decode(bytes).ok()? {
            Progress::Complete(frame, used) => Some((outline(bytes.get(..used)?, &frame, role), used)),
            Progress::NeedMore(_) => None,
        },
        Protocol::Rac => {
            let used = bytes.iter().position(|byte| *byte == b'\r')? + 1;
            let line = bytes.get(..used)?;
            let text = String::from_utf8_lossy(line).trim_end().to_owned();
            let mut rows = line.chunks(16).map(hex::spaced);
            let first = format!("{:48} {text}", rows.next().unwrap_or_default());
            Some((std::iter::once(first).chain(rows).collect::<Vec<_>>().join("\n"), used))
        }
    }
}

impl<X: Transport<Error = io::Error>> Transport for Tap<X> {
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
