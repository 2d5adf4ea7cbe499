//! Lines: splits a byte stream at each CR, in at most 256 bytes of memory.
//!
//! ```text
//!  GET:RC8:10:I: CR PUT:RC8:10:I:3,1 CR LF GET:RC8: ...
//!  └── line ───┘    └──── line ────┘    └─ begun ─
//! ```
//!
//! ```text
//!  stream = { line }
//!  line   = { LF } { byte - CR } CR          at most 256 bytes from the first byte after LF to CR
//! ```
//!
//! * LF at the start of a line is dropped, so CRLF works as a line end.
//! * A longer line is reported once, as soon as it exceeds the limit, and dropped up to its CR. The next line is read
//!   normally.
//! * The chunks in which the bytes arrive do not change the lines. This framer keeps its position between chunks, so it is a
//!   scanner and not a nom parser; the grammar of a line is applied to whole lines.

/// Maximum length of a line in bytes, its CR included (RAC specification, section 2.1.1).
pub const MAX_LINE: usize = 256;

/// The end of a line.
pub(super) const CR: u8 = b'\r';

/// A result of [`LineFramer::poll`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[must_use]
#[non_exhaustive]
pub enum Framed {
    /// A line; [`LineFramer::line`] views it.
    Line,
    /// A line over the limit; it is being dropped. [`LineFramer::line`] views its head.
    TooLong,
}

/// Splits bytes into lines of at most `N` bytes with their CR.
///
/// # Examples
///
/// ```
/// use bcap_core::rac::{Framed, LineFramer};
///
/// let mut framer = LineFramer::<16>::new();
/// framer.receive_buffer()[..9].copy_from_slice(b"0,3,7\r\n0,");
/// framer.received(9);
/// assert_eq!(framer.poll(), Some(Framed::Line));
/// assert_eq!(framer.line(), b"0,3,7");
/// assert_eq!(framer.poll(), None);
/// ```
#[derive(Clone, Debug)]
pub struct LineFramer<const N: usize = MAX_LINE> {
    buffer: [u8; N],
    state: State,
}

/// Offsets in the buffer: `line <= start <= scanned <= end`.
#[derive(Clone, Copy, Debug, Default)]
struct State {
    /// The last line without its CR; it ends before `start`.
    line: (usize, usize),
    /// The first byte after the CR of that line.
    start: usize,
    /// There is no CR between `start` and here.
    scanned: usize,
    end: usize,
    /// The bytes up to the next CR belong to an over-long line.
    dropping: bool,
}

impl<const N: usize> Default for LineFramer<N> {
    fn default() -> Self {
        Self::new()
    }
}

impl<const N: usize> LineFramer<N> {
    /// Starts at the beginning of a line.
    #[must_use]
    pub const fn new() -> Self {
        let state = State { line: (0, 0), start: 0, scanned: 0, end: 0, dropping: false };
        Self { buffer: [0; N], state }
    }

    /// Returns memory for received bytes. This invalidates the last line.
    ///
    /// It is empty only if [`poll`](Self::poll) has lines to return.
    #[must_use]
    pub fn receive_buffer(&mut self) -> &mut [u8] {
        self.state.compact(&mut self.buffer);
        self.buffer.get_mut(self.state.end..).unwrap_or_default()
    }

    /// Records that `count` bytes were received into [`receive_buffer`](Self::receive_buffer).
    pub fn received(&mut self, count: usize) {
        self.state.end = self.state.end.saturating_add(count).min(N);
    }

    /// Finds the next line; `None` if more bytes are needed.
    pub fn poll(&mut self) -> Option<Framed> {
        self.state.poll(&self.buffer)
    }

    /// Returns the last line that [`poll`](Self::poll) found, without its CR.
    #[must_use]
    pub fn line(&self) -> &[u8] {
        let (from, to) = self.state.line;
        self.buffer.get(from..to).unwrap_or_default()
    }

    /// Returns whether the buffer ends within a line.
    #[must_use]
    pub const fn is_partial(&self) -> bool {
        self.state.dropping || self.state.start < self.state.end
    }

    /// Returns whether a line has begun that was not reported. The rest of a dropped line does not count, nor an LF after a CR.
    pub(super) fn has_begun(&self) -> bool {
        let begun = self.buffer.get(self.state.start..self.state.end).unwrap_or_default();
        !self.state.dropping && begun.iter().any(|byte| *byte != b'\n')
    }

    /// Discards everything received, for a new connection.
    pub const fn reset(&mut self) {
        self.state = State { line: (0, 0), start: 0, scanned: 0, end: 0, dropping: false };
    }
}

impl State {
    fn poll(&mut self, buffer: &[u8]) -> Option<Framed> {
        self.line = (self.start, self.start);
        loop {
            let new = buffer.get(self.scanned..self.end).unwrap_or_default();
            let Some(at) = new.iter().position(|b| *b == CR) else {
                return self.unfinished(buffer);
            };
            let end = self.scanned.wrapping_add(at);
            let mut from = self.start;
            while from < end && buffer.get(from) == Some(&b'\n') {
                from = from.wrapping_add(1);
            }
            self.start = end.wrapping_add(1);
            self.scanned = self.start;
            if !core::mem::take(&mut self.dropping) {
                self.line = (from, end);
                return Some(Framed::Line);
            }
        }
    }

    /// Handles a buffer without CR.
    fn unfinished(&mut self, buffer: &[u8]) -> Option<Framed> {
        while self.start < self.end && buffer.get(self.start) == Some(&b'\n') {
            self.start = self.start.wrapping_add(1);
        }
        self.scanned = self.end;
        if self.dropping {
            self.start = self.end;
            return None;
        }
        if self.end.wrapping_sub(self.start) < buffer.len() {
            return None;
        }
        self.line = (self.start, self.end);
        self.start = self.end;
        self.dropping = true;
        Some(Framed::TooLong)
    }

    /// Moves unread bytes to the front.
    fn compact(&mut self, buffer: &mut [u8]) {
        if self.start == 0 {
            return;
        }
        if let Some(used) = buffer.get_mut(..self.end) {
            crate::storage::shift_down(used, self.start);
        }
        self.end = self.end.wrapping_sub(self.start);
        self.scanned = self.scanned.wrapping_sub(self.start);
        self.start = 0;
        self.line = (0, 0);
    }
}

#[cfg(test)]
mod tests {
    #![expect(clippy::arithmetic_side_effects, reason = "an overflow here fails the test, as it should")]
    extern crate std;

    use super::*;
    use std::string::String;
    use std::vec::Vec;
    use std::{format, vec};

    /// Feeds `bytes` in chunks of the given sizes, over and over, and lists the results.
    fn lines(bytes: &[u8], chunks: &[usize]) -> Vec<String> {
        let mut framer = LineFramer::<MAX_LINE>::new();
        let mut out = Vec::new();
        let (mut rest, mut turn) = (bytes, 0);
        while !rest.is_empty() {
            let room = framer.receive_buffer();
            assert!(!room.is_empty(), "no room though all lines were taken");
            let take = chunks[turn % chunks.len()].min(rest.len()).min(room.len());
            room[..take].copy_from_slice(&rest[..take]);
            framer.received(take);
            (rest, turn) = (&rest[take..], turn + 1);
            while let Some(found) = framer.poll() {
                out.push(match found {
                    Framed::Line => String::from_utf8(framer.line().to_vec()).unwrap(),
                    Framed::TooLong => "too long".into(),
                });
            }
        }
        out
    }

    #[test]
    fn lines_are_the_same_however_they_are_cut() {
        let long = "x".repeat(700);
        let stream = format!(" GET:RC8:10:I:\r\r\nPUT:RC8:1:S:8,é\r\n\n{long}\r\t0, 3, 123\r\n\r{long}\rlast\rbegun");
        let all = [" GET:RC8:10:I:", "", "PUT:RC8:1:S:8,é", "too long", "\t0, 3, 123", "", "too long", "last"];
        for size in 1..stream.len() {
            assert_eq!(lines(stream.as_bytes(), &[size]), all, "chunks of {size}");
            assert_eq!(lines(stream.as_bytes(), &[size, 10_000]), all, "cut at {size}");
        }
        assert_eq!(lines(stream.as_bytes(), &[1, 7, 256, 3]), all);
    }

    #[test]
    fn a_line_has_256_bytes_with_its_cr_and_no_more() {
        for head in ["", " ", "\t\t"] {
            for (len, fits) in [(254, true), (255, true), (256, false), (257, false), (600, false)] {
                let line = format!("{head}{}", "y".repeat(len - head.len()));
                let expected =
                    if fits { vec![line.clone(), "ok".into()] } else { vec!["too long".into(), "ok".into()] };
                for chunk in [1, 255, 256, 10_000] {
                    assert_eq!(lines(format!("{line}\rok\r").as_bytes(), &[chunk]), expected, "{len} in {chunk}");
                    // the LF of the line before does not count
                    assert_eq!(lines(format!("\n{line}\r\nok\r").as_bytes(), &[chunk]), expected, "{len} in {chunk}");
                }
            }
        }
    }

    #[test]
    fn an_endless_line_is_reported_once_and_line_feeds_never_fill_the_buffer() {
        assert_eq!(lines(&[b' '; 5000], &[100]), ["too long"]);
        assert_eq!(lines(&[b'\n'; 5000], &[100]), Vec::<String>::new());
    }

    #[test]
    fn a_partial_line_shows() {
        let mut framer = LineFramer::<8>::new();
        assert!(!framer.is_partial());
        framer.receive_buffer()[..3].copy_from_slice(b"\rab");
        framer.received(3);
        assert_eq!(framer.poll(), Some(Framed::Line));
        assert_eq!(framer.poll(), None);
        assert!(framer.is_partial());
        framer.reset();
        assert!(!framer.is_partial());
        assert_eq!(framer.receive_buffer().len(), 8);
    }
}
