//! A transport that removes the payload of a broker's message that is too large, before it takes memory.
//!
//! MQTT 3.1.1 has no limit that a client can announce, and a client that refuses a message ends the connection. A retained
//! message would then end every new connection. Without its payload the message is acknowledged, and refused as a command.

use std::io;
use std::pin::Pin;
use std::task::{Context, Poll, ready};

use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};

/// The maximum size of a message after its fixed header in bytes. A command is short.
pub(crate) const LARGEST: usize = 1 << 20;

/// The number of bytes per read.
const CHUNK: usize = 16 << 10;

/// The first four bits of PUBLISH.
const PUBLISH: u8 = 3;

/// Bytes of MQTT, of which large payloads are removed.
#[derive(Debug, Default)]
struct Shortener {
    /// The fixed header of the next packet; for a large PUBLISH followed by the topic and the packet identifier.
    head: Vec<u8>,
    /// The bytes of the current packet that are still to be forwarded, or removed.
    forward: usize,
    remove: usize,
}

impl Shortener {
    /// Takes received bytes, and appends those that remain.
    fn take(&mut self, mut bytes: &[u8], out: &mut Vec<u8>) {
        while !bytes.is_empty() {
            let (forward, rest) = bytes.split_at(self.forward.min(bytes.len()));
            out.extend_from_slice(forward);
            let (removed, rest) = rest.split_at(self.remove.min(rest.len()));
            self.forward -= forward.len();
            self.remove -= removed.len();
            bytes = rest;
            if let Some((byte, rest)) = bytes.split_first() {
                self.head.push(*byte);
                self.begin(out);
                bytes = rest;
            }
        }
    }

    /// Begins a packet when enough of its head has arrived.
    fn begin(&mut self, out: &mut Vec<u8>) {
        let Some((fixed, remaining)) = remaining(&self.head) else { return };
        let kind = self.head.first().copied().unwrap_or_default();
        if kind >> 4 != PUBLISH || remaining <= LARGEST {
            (self.forward, self.remove) = (remaining, 0);
            out.append(&mut self.head);
            return;
        }
        let Some(&[high, low]) = self.head.get(fixed..fixed + 2) else { return };
        // a packet identifier follows the topic unless QoS is 0
        let identifier = if kind & 0b110 == 0 { 0 } else { 2 };
        let variable = 2 + usize::from(u16::from_be_bytes([high, low])) + identifier;
        let Some(header) = self.head.get(fixed..fixed + variable) else { return };
        out.push(kind);
        let mut length = variable;
        while length >= 0x80 {
            out.push((length & 0x7f) as u8 | 0x80);
            length >>= 7;
        }
        out.push(length as u8);
        out.extend_from_slice(header);
        self.head.clear();
        (self.forward, self.remove) = (0, remaining - variable);
    }
}

/// Returns the length of a fixed header, and the number of bytes after it; `None` if it is not complete.
fn remaining(head: &[u8]) -> Option<(usize, usize)> {
    let mut remaining = 0;
    for (index, byte) in head.iter().skip(1).enumerate() {
        remaining |= usize::from(byte & 0x7f) << (7 * index);
        // the client refuses a fifth byte of the length
        if byte & 0x80 == 0 || index == 3 {
            return Some((index + 2, remaining));
        }
    }
    None
}

/// A stream to the broker.
pub(crate) trait Stream: AsyncRead + AsyncWrite + Send + Sync + Unpin {}

impl<S: AsyncRead + AsyncWrite + Send + Sync + Unpin> Stream for S {}

/// A stream whose large messages have no payload.
pub(crate) struct Shortened {
    inner: Box<dyn Stream>,
    shortener: Shortener,
    /// Bytes for the client.
    ready: Vec<u8>,
}

impl Shortened {
    pub(crate) fn new(inner: impl Stream + 'static) -> Self {
        Self { inner: Box::new(inner), shortener: Shortener::default(), ready: Vec::new() }
    }
}

impl AsyncRead for Shortened {
    fn poll_read(mut self: Pin<&mut Self>, context: &mut Context<'_>, out: &mut ReadBuf<'_>) -> Poll<io::Result<()>> {
        let this = &mut *self;
        while this.ready.is_empty() {
            let mut bytes = [0; CHUNK];
            let mut bytes = ReadBuf::new(&mut bytes);
            ready!(Pin::new(&mut this.inner).poll_read(context, &mut bytes))?;
            if bytes.filled().is_empty() {
                return Poll::Ready(Ok(()));
            }
            this.shortener.take(bytes.filled(), &mut this.ready);
        }
        let count = out.remaining().min(this.ready.len());
        out.put_slice(this.ready.get(..count).unwrap_or_default());
        this.ready.drain(..count);
        Poll::Ready(Ok(()))
    }
}

impl AsyncWrite for Shortened {
    fn poll_write(mut self: Pin<&mut Self>, context: &mut Context<'_>, bytes: &[u8]) -> Poll<io::Result<usize>> {
        Pin::new(&mut self.inner).poll_write(context, bytes)
    }

    fn poll_flush(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.inner).poll_flush(context)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.inner).poll_shutdown(context)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A PUBLISH on the topic `a`.
    fn publish(flags: u8, payload: usize) -> Vec<u8> {
        let mut header = vec![0, 1, b'a'];
        header.extend((flags & 0b110 != 0).then_some([0, 7]).into_iter().flatten());
        let mut packet = vec![PUBLISH << 4 | flags];
        let mut length = header.len() + payload;
        while length >= 0x80 {
            packet.push((length & 0x7f) as u8 | 0x80);
            length >>= 7;
        }
        packet.push(length as u8);
        packet.extend(header);
        packet.resize(packet.len() + payload, b'x');
        packet
    }

    #[test]
    fn large_payloads_are_removed_and_all_else_is_forwarded() {
        let acknowledgement = [0x40, 2, 0, 1];
        let sent = [
            publish(0, 3),
            publish(0b0011, LARGEST + 5),
            acknowledgement.to_vec(),
            publish(1, 5 << 20),
            publish(0, LARGEST - 3),
            publish(2, 0),
        ];
        let expected = [
            publish(0, 3),
            publish(0b0011, 0),
            acknowledgement.to_vec(),
            publish(1, 0),
            publish(0, LARGEST - 3),
            publish(2, 0),
        ];
        for size in [1, 2, 7, 1000, usize::MAX] {
            let (mut shortener, mut out) = (Shortener::default(), Vec::new());
            sent.concat().chunks(size).for_each(|chunk| shortener.take(chunk, &mut out));
            assert!(out == expected.concat(), "chunks of {size} bytes");
        }
    }

    #[test]
    fn a_topic_that_is_longer_than_its_packet_waits_for_no_memory() {
        let (mut shortener, mut out) = (Shortener::default(), Vec::new());
        // the length is at least 1 MiB, and a topic has at most 64 KiB
        shortener.take(&[0x30, 0xff, 0xff, 0xff, 0x7f, 0xff, 0xff], &mut out);
        shortener.take(&vec![b'a'; 1 << 16], &mut out);
        assert!(shortener.head.is_empty() && out.len() == 1 + 3 + 2 + 0xffff, "{}", out.len());
    }
}
