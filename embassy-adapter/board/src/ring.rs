//! A ring buffer of bytes that are written in frames: a frame is kept completely or dropped completely.
//!
//! ```text
//!  writer ─ begin, extend, end ─► [ frame | frame |        ] ─ pop ─► reader, such as an interrupt handler
//! ```
//!
//! There is one writer and one reader, which may interrupt the writer. Both are lock-free, so the reader works in the
//! handler of a fault, whatever the fault interrupted.

use core::sync::atomic::{AtomicU8, AtomicU32, Ordering};

/// A ring buffer of `N` bytes; `N` is a power of two.
///
/// # Examples
///
/// ```
/// use bcap_board::ring::Ring;
///
/// static RING: Ring<8> = Ring::new();
/// RING.frame(|frame| frame.extend(b"abcde"));
/// RING.frame(|frame| frame.extend(b"fghi")); // there is no room for it
/// RING.frame(|frame| frame.extend(b"fgh"));
/// assert_eq!(RING.dropped(), 1);
/// assert!(std::iter::from_fn(|| RING.pop()).eq(*b"abcdefgh"));
/// ```
#[derive(Debug)]
pub struct Ring<const N: usize> {
    bytes: [AtomicU8; N],
    /// Bytes written and read since the start; both wrap. The next one has this number modulo `N`.
    written: AtomicU32,
    read: AtomicU32,
    dropped: AtomicU32,
    /// The peak number of unread bytes.
    most: AtomicU32,
}

impl<const N: usize> Ring<N> {
    const MASK: u32 = {
        assert!(N.is_power_of_two() && N <= 1 << 31, "the size is a power of two");
        // no `try_from` in a constant
        N as u32 - 1
    };

    /// Creates an empty buffer.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            bytes: [const { AtomicU8::new(0) }; N],
            written: AtomicU32::new(0),
            read: AtomicU32::new(0),
            dropped: AtomicU32::new(0),
            most: AtomicU32::new(0),
        }
    }

    /// Begins a frame, which the reader gets after [`Frame::end`]. There must be one frame at a time.
    pub fn begin(&self) -> Frame<'_, N> {
        Frame { ring: self, next: self.written.load(Ordering::Relaxed), is_cut: false }
    }

    /// Writes a frame. There must be one frame at a time.
    pub fn frame(&self, write: impl FnOnce(&mut Frame<'_, N>)) {
        let mut frame = self.begin();
        write(&mut frame);
        frame.end();
    }

    /// Removes the oldest byte. There must be one reader.
    pub fn pop(&self) -> Option<u8> {
        let read = self.read.load(Ordering::Relaxed);
        if read == self.written.load(Ordering::Acquire) {
            return None;
        }
        let byte = self.slot(read).map(|byte| byte.load(Ordering::Relaxed));
        self.read.store(read.wrapping_add(1), Ordering::Release);
        byte
    }

    /// Returns whether there is nothing to read.
    pub fn is_empty(&self) -> bool {
        self.read.load(Ordering::Relaxed) == self.written.load(Ordering::Acquire)
    }

    /// Returns the number of frames that were dropped for lack of room; it saturates.
    pub fn dropped(&self) -> u32 {
        self.dropped.load(Ordering::Relaxed)
    }

    /// Returns the peak number of bytes in the buffer.
    pub fn most(&self) -> u32 {
        self.most.load(Ordering::Relaxed)
    }

    fn slot(&self, number: u32) -> Option<&AtomicU8> {
        self.bytes.get(usize::try_from(number & Self::MASK).ok()?)
    }
}

impl<const N: usize> Default for Ring<N> {
    fn default() -> Self {
        Self::new()
    }
}

/// A frame that is being written; dropped without [`end`](Self::end), it is discarded.
#[derive(Debug)]
pub struct Frame<'r, const N: usize> {
    ring: &'r Ring<N>,
    next: u32,
    is_cut: bool,
}

impl<const N: usize> Frame<'_, N> {
    /// Appends bytes; without room for them the whole frame is dropped.
    pub fn extend(&mut self, bytes: &[u8]) {
        for byte in bytes {
            let used = self.next.wrapping_sub(self.ring.read.load(Ordering::Acquire));
            if used > Ring::<N>::MASK || self.is_cut {
                self.is_cut = true;
                return;
            }
            if let Some(slot) = self.ring.slot(self.next) {
                slot.store(*byte, Ordering::Relaxed);
            }
            self.next = self.next.wrapping_add(1);
        }
    }

    /// Passes the frame to the reader, or counts it as dropped.
    pub fn end(self) {
        match self.is_cut {
            true => {
                let dropped = self.ring.dropped.load(Ordering::Relaxed);
                self.ring.dropped.store(dropped.saturating_add(1), Ordering::Relaxed);
            }
            false => {
                // the reader can only make it less
                let used = self.next.wrapping_sub(self.ring.read.load(Ordering::Relaxed));
                self.ring.most.store(used.max(self.ring.most()), Ordering::Relaxed);
                self.ring.written.store(self.next, Ordering::Release);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;

    fn read<const N: usize>(ring: &Ring<N>) -> Vec<u8> {
        core::iter::from_fn(|| ring.pop()).collect()
    }

    #[test]
    fn frames_are_kept_or_dropped_completely_at_every_position() {
        let ring = Ring::<16>::new();
        // both counters wrap during the test
        ring.written.store(u32::MAX - 50, Ordering::Relaxed);
        ring.read.store(u32::MAX - 50, Ordering::Relaxed);
        for round in 0..100_u8 {
            ring.frame(|frame| frame.extend(&[round; 9]));
            ring.frame(|frame| {
                frame.extend(&[1; 5]);
                frame.extend(&[2; 3]);
                frame.extend(&[3; 1]);
            });
            ring.frame(|frame| frame.extend(&[4; 7]));
            assert_eq!(read(&ring), [[round; 9].as_slice(), &[4; 7]].concat());
            assert_eq!(ring.dropped(), u32::from(round) + 1);
        }
    }

    #[test]
    fn the_most_bytes_of_complete_frames_are_kept() {
        let ring = Ring::<16>::new();
        ring.frame(|frame| frame.extend(&[1; 9]));
        ring.frame(|frame| frame.extend(&[2; 8]));
        ring.begin().extend(&[3; 7]);
        assert_eq!(
            (ring.most(), ring.dropped()),
            (9, 1),
            "a dropped frame and one that is given up are not in the buffer"
        );
        let _ = read(&ring);
        ring.frame(|frame| frame.extend(&[4; 5]));
        assert_eq!(ring.most(), 9);
        ring.frame(|frame| frame.extend(&[5; 11]));
        assert_eq!(ring.most(), 16);
    }

    #[test]
    fn a_frame_is_invisible_until_its_end() {
        let ring = Ring::<16>::new();
        let mut frame = ring.begin();
        frame.extend(b"abc");
        assert_eq!((ring.pop(), ring.is_empty()), (None, true));
        frame.end();
        ring.begin().extend(b"given up");
        assert_eq!(read(&ring), b"abc");
    }

    #[test]
    fn a_reader_that_interrupts_the_writer_gets_every_frame_in_order() {
        static RING: Ring<64> = Ring::new();
        let frames = 10_000_u32;
        let writer = std::thread::spawn(move || {
            let mut written = 0;
            while written < frames {
                let dropped = RING.dropped();
                RING.frame(|frame| frame.extend(&written.to_le_bytes()));
                written += u32::from(RING.dropped() == dropped);
            }
        });
        let mut bytes = Vec::new();
        while bytes.len() < 40_000 {
            bytes.extend(RING.pop());
        }
        writer.join().unwrap();
        let numbers = bytes.chunks(4).map(|bytes| u32::from_le_bytes(bytes.try_into().unwrap()));
        assert!(numbers.eq(0..frames));
    }
}
