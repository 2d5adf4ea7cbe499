//! The three kinds of links, and the reassembly of received bytes into frames.
//!
//! ```text
//!            framing                resend   CRC   an invalid frame
//!  Stream    length field (TCP)     no       no    ends the session, or is skipped
//!  Datagram  one per datagram (UDP) yes      no    is dropped
//!  Serial    length field           yes      yes   is skipped
//! ```

use crate::bcap::frame::{Args, Decoded, Decoder, Frame, MIN_FRAME};
use crate::bcap::header::{HEADER_LEN, Header, LENGTH_AT, SOH};
use crate::error::{DecodeError, DecodeErrorKind};
use crate::limits::{Limits, SERIAL_MAX, Strictness, UDP_SEND_MAX};
use crate::num::{to_u32, to_usize};
use crate::storage::{Storage, shift_down};

/// The kind of link that carries the frames.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Link {
    /// A reliable stream: TCP.
    Stream,
    /// Datagrams of one frame each, which may be lost or duplicated: UDP.
    Datagram,
    /// A serial line: a stream that may lose and corrupt bytes; its frames have a CRC.
    Serial,
}

impl Link {
    /// Returns the strict decoder for this link.
    #[must_use]
    pub const fn decoder(self) -> Decoder {
        match self {
            Self::Stream => Decoder::TCP,
            Self::Datagram => Decoder::UDP,
            Self::Serial => Decoder::SERIAL,
        }
    }

    /// Returns the largest frame that may be sent, in bytes.
    #[must_use]
    pub fn send_max(self) -> usize {
        match self {
            Self::Stream => to_usize(Limits::STREAM.frame),
            Self::Datagram => UDP_SEND_MAX,
            Self::Serial => SERIAL_MAX,
        }
    }

    /// Returns whether frames can get lost, so that calls are sent again.
    #[must_use]
    pub const fn is_lossy(self) -> bool {
        !matches!(self, Self::Stream)
    }
}

/// The reaction to bytes of a stream that are not a valid frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum OnMalformed {
    /// End the session, because the position of the next frame is unknown.
    Close,
    /// Report the error, and search for the next byte that may begin a frame.
    Resync,
}

/// The receiving side of a link: collects bytes until a frame is complete.
///
/// ```text
///  buffer  [ frames read | received, incomplete  | free ............ ]
///            0         `next`^              `len`^      buffer.len()^
///            └ the last frame that was read stays valid until the next call of `free`
/// ```
#[derive(Clone, Copy, Debug)]
pub(crate) struct Inbox {
    decoder: Decoder,
    link: Link,
    on_malformed: OnMalformed,
    /// Received bytes in the buffer.
    len: usize,
    /// Where the next frame begins; never above `len`.
    next: usize,
    /// Remaining bytes of a frame that is too large for the buffer.
    skip: usize,
    /// Start of the last invalid bytes.
    malformed: usize,
    /// Bytes at the start of the buffer that arrived before `mark`.
    early: usize,
    /// Whether bytes were received since the last `take_received`.
    has_received: bool,
}

/// A result of [`Inbox::poll`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum InboxEvent {
    /// A frame; `Inbox::frame` views it.
    Frame(Located),
    /// A frame that is larger than the buffer; the stream continues after it.
    TooLarge(Located),
    /// Invalid bytes, which were dropped.
    Malformed(DecodeError),
    /// Invalid bytes; nothing more will be read.
    Broken(DecodeError),
}

/// A validated frame: its header and its position in the buffer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Located {
    /// 32 bits suffice, because no buffer is larger than the longest frame, and save memory in each session.
    start: u32,
    pub(crate) header: Header,
}

impl Located {
    fn new(start: usize, header: Header) -> Self {
        Self { start: to_u32(start), header }
    }

    fn start(self) -> usize {
        to_usize(self.start)
    }

    fn end(self) -> usize {
        self.start().saturating_add(to_usize(self.header.length))
    }
}

impl Inbox {
    pub(crate) const fn new(link: Link, limits: Limits, strictness: Strictness, on_malformed: OnMalformed) -> Self {
        let decoder = Decoder { limits, strictness, ..link.decoder() };
        Self { decoder, link, on_malformed, len: 0, next: 0, skip: 0, malformed: 0, early: 0, has_received: false }
    }

    /// Returns the free part of the buffer, and drops the frames that were read.
    pub(crate) fn free<'b>(&mut self, buffer: &'b mut impl Storage) -> &'b mut [u8] {
        if self.link == Link::Datagram {
            self.next = self.len;
        }
        let memory = buffer.bytes_mut();
        if self.next > 0 {
            if let Some(received) = memory.get_mut(..self.len) {
                shift_down(received, self.next);
            }
            self.len = self.len.saturating_sub(self.next);
            self.early = self.early.saturating_sub(self.next);
            self.next = 0;
        }
        memory.get_mut(self.len..).unwrap_or_default()
    }

    /// Returns the free part of the buffer, and drops the frames that were read, except this one.
    pub(crate) fn free_after<'b>(&mut self, buffer: &'b mut [u8], frame: Located) -> &'b mut [u8] {
        let end = frame.end();
        let read = self.next.saturating_sub(end);
        if read > 0
            && let Some(after) = buffer.get_mut(end..self.len)
        {
            shift_down(after, read);
            self.next = end;
            self.len = self.len.saturating_sub(read);
        }
        buffer.get_mut(self.len..).unwrap_or_default()
    }

    /// Drops the bytes before a frame to make room after it; returns the frame's new position.
    pub(crate) fn move_to_front(&mut self, buffer: &mut [u8], frame: Located) -> Located {
        if let Some(received) = buffer.get_mut(..self.len) {
            shift_down(received, frame.start());
        }
        self.len = self.len.saturating_sub(frame.start());
        self.next = self.next.saturating_sub(frame.start());
        Located { start: 0, ..frame }
    }

    /// Returns the header of the last invalid bytes, if they are at least as long as the shortest frame.
    pub(crate) fn malformed_header(&self, buffer: &[u8]) -> Option<Header> {
        let bytes = buffer.get(self.malformed..self.len)?;
        let has_header = bytes.len() >= MIN_FRAME && bytes.first() == Some(&SOH);
        has_header.then(|| Header::read(bytes)).flatten()
    }

    /// Records `count` bytes that were put into the free part.
    pub(crate) fn received(&mut self, buffer: &[u8], count: usize) {
        self.has_received |= count > 0;
        self.len = self.len.saturating_add(count).min(buffer.len());
        let skipped = self.skip.min(self.len.saturating_sub(self.next));
        self.skip = self.skip.wrapping_sub(skipped);
        self.next = self.next.wrapping_add(skipped);
    }

    /// Returns whether bytes were received since the last call.
    pub(crate) const fn take_received(&mut self) -> bool {
        core::mem::replace(&mut self.has_received, false)
    }

    /// Returns the length in bytes of the frame that `poll` reads next; 0 until all of it has arrived.
    pub(crate) fn next_frame(&self, buffer: &[u8]) -> usize {
        let bytes = buffer.get(self.next..self.len).unwrap_or_default();
        match self.decoder.frame_length(bytes) {
            Ok(Some(length)) if length <= bytes.len() => length,
            _ => 0,
        }
    }

    /// Reads the next frame of the received bytes.
    pub(crate) fn poll(&mut self, buffer: &mut impl Storage) -> Option<InboxEvent> {
        let bytes = buffer.bytes().get(self.next..self.len)?;
        if bytes.is_empty() {
            return None;
        }
        let decoded = self.decoder.decode_with_header(bytes);
        if self.link == Link::Datagram {
            let start = self.next;
            self.malformed = self.next;
            self.next = self.len;
            return Some(match decoded.and_then(|decoded| self.decoder.check_datagram(decoded, bytes.len())) {
                Ok((header, _)) => InboxEvent::Frame(Located::new(start, header)),
                Err(error) => InboxEvent::Malformed(error),
            });
        }
        match decoded {
            Ok(Decoded::Complete(header, _)) => {
                let frame = Located::new(self.next, header);
                self.next = frame.end().min(self.len);
                Some(InboxEvent::Frame(frame))
            }
            Ok(Decoded::NeedMore(needed)) => {
                let room = buffer.bytes().len();
                // the frame is too large when it fills the buffer and is incomplete
                let full = self.next == 0 && self.len >= room && needed > room;
                if full && !buffer.grow(room.saturating_mul(2).clamp(MIN_FRAME, needed.max(MIN_FRAME))) {
                    return Some(self.too_large(buffer.bytes(), needed));
                }
                None
            }
            Err(error) if self.on_malformed == OnMalformed::Close => {
                self.malformed = self.next;
                self.next = self.len;
                Some(InboxEvent::Broken(error))
            }
            Err(error) => {
                self.next = self.next.saturating_add(self.decoder.resync(bytes)).min(self.len);
                Some(InboxEvent::Malformed(error))
            }
        }
    }

    /// Starts to skip a frame that does not fit the buffer.
    fn too_large(&mut self, bytes: &[u8], length: usize) -> InboxEvent {
        self.skip = length.saturating_sub(self.len);
        self.next = self.len;
        match Header::read(bytes) {
            Some(header) => InboxEvent::TooLarge(Located::new(0, header)),
            // the buffer is shorter than a header, so there is no serial to report
            None => {
                let kind = DecodeErrorKind::FrameTooLong { length: to_u32(length), limit: to_u32(bytes.len()) };
                InboxEvent::Broken(DecodeError::frame(kind, LENGTH_AT))
            }
        }
    }

    /// Views a frame that `poll` returned, until the next call of `free`.
    pub(crate) fn frame<'b>(&self, buffer: &'b [u8], frame: Located) -> Option<Frame<'b>> {
        let tail = if self.decoder.crc { 3 } else { 1 };
        let body = frame.start().saturating_add(HEADER_LEN)..frame.end().checked_sub(tail)?;
        let args = Args::from_checked(frame.header.count, buffer.get(body)?, self.decoder.strictness);
        Some(Frame::new(frame.header, args))
    }

    /// Returns whether an incomplete frame was received.
    pub(crate) const fn is_partial(&self) -> bool {
        self.len > self.next || self.skip > 0
    }

    /// Drops an incomplete frame whose rest will not arrive.
    pub(crate) fn forget_partial(&mut self) {
        self.len = self.next;
        self.early = self.early.min(self.len);
        self.skip = 0;
    }

    /// Marks the bytes that have arrived so far.
    pub(crate) const fn mark(&mut self) {
        self.early = self.len;
    }

    /// Returns whether the first byte of a frame arrived before `mark`.
    pub(crate) fn is_early(&self, frame: Located) -> bool {
        frame.start() < self.early
    }

    /// Drops all bytes, for a new connection.
    pub(crate) const fn reset(&mut self) {
        self.len = 0;
        self.next = 0;
        self.skip = 0;
        self.early = 0;
    }
}
