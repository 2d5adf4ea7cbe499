//! A record of the last reset's cause, in memory that a reset does not clear.

use core::fmt;
use core::panic::PanicInfo;
use core::sync::atomic::{AtomicU32, Ordering};

/// The letters of a valid record.
const MAGIC: u32 = u32::from_le_bytes(*b"RSET");

/// The words of a record: the magic word, the kind, the values, and a checksum over them.
pub const WORDS: usize = 8;

/// The memory of a record.
pub type Memory = [AtomicU32; WORDS];

/// Why a board was reset.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cause {
    /// The memory has no record.
    PowerOn,
    /// The program ran, and was reset without a record: by the watchdog itself or from outside.
    Unrecorded,
    /// A panic.
    Panic {
        /// The end of the file's name.
        file: [u8; 12],
        /// The line.
        line: u32,
    },
    /// A fault.
    Fault {
        /// The address of the instruction; 0 in an exception handler, except on ARMv6-M.
        pc: u32,
        /// The return address of its function; 0 in an exception handler, except on ARMv6-M.
        lr: u32,
        /// The register CFSR; 0 on a processor without it.
        status: u32,
        /// The register HFSR; 0 on a processor without it.
        hard: u32,
        /// The register BFAR or MMFAR; 0 if neither is valid.
        address: u32,
    },
    /// The program's stack overflowed.
    StackOverflow {
        /// The register CFSR; 0 on a processor without it.
        status: u32,
        /// The register BFAR or MMFAR; 0 if neither is valid.
        address: u32,
    },
    /// Tasks made no progress.
    Watchdog {
        /// A bit for each of them.
        tasks: u32,
    },
    /// The Ethernet controller did not respond.
    Network,
    /// An exception or interrupt without a handler.
    Unexpected {
        /// Its number.
        number: u32,
    },
    /// An update on trial served no request in time.
    Unconfirmed,
}

impl Cause {
    /// Returns the cause of a panic at a line of a file.
    #[must_use]
    pub fn panic(name: &str, line: u32) -> Self {
        let mut file = [0; 12];
        for (to, from) in file.iter_mut().rev().zip(name.bytes().rev()) {
            *to = from;
        }
        Self::Panic { file, line }
    }

    /// Returns whether the board has failed: a panic, a fault, tasks or a network that hang.
    #[must_use]
    pub const fn is_fault(&self) -> bool {
        !matches!(self, Self::PowerOn | Self::Unrecorded)
    }

    /// Returns the kind and the values.
    fn to_words(self) -> [u32; 6] {
        match self {
            Self::PowerOn => [0; 6],
            Self::Unrecorded => [1, 0, 0, 0, 0, 0],
            Self::Panic { file: [a, b, c, d, e, f, g, h, i, j, k, l], line } => {
                let word = u32::from_le_bytes;
                [2, line, word([a, b, c, d]), word([e, f, g, h]), word([i, j, k, l]), 0]
            }
            Self::Fault { pc, lr, status, hard, address } => [3, pc, lr, status, hard, address],
            Self::StackOverflow { status, address } => [4, status, address, 0, 0, 0],
            Self::Watchdog { tasks } => [5, tasks, 0, 0, 0, 0],
            Self::Network => [6, 0, 0, 0, 0, 0],
            Self::Unexpected { number } => [7, number, 0, 0, 0, 0],
            Self::Unconfirmed => [8, 0, 0, 0, 0, 0],
        }
    }

    fn from_words(words: [u32; 6]) -> Self {
        match words {
            [1, ..] => Self::Unrecorded,
            [2, line, first, second, third, _] => {
                let mut file = [0; 12];
                let bytes = [first, second, third].into_iter().flat_map(u32::to_le_bytes);
                for (to, from) in file.iter_mut().zip(bytes) {
                    *to = from;
                }
                Self::Panic { file, line }
            }
            [3, pc, lr, status, hard, address] => Self::Fault { pc, lr, status, hard, address },
            [4, status, address, ..] => Self::StackOverflow { status, address },
            [5, tasks, ..] => Self::Watchdog { tasks },
            [6, ..] => Self::Network,
            [7, number, ..] => Self::Unexpected { number },
            [8, ..] => Self::Unconfirmed,
            _ => Self::PowerOn,
        }
    }
}

impl fmt::Display for Cause {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::PowerOn => f.write_str("power-on"),
            Self::Unrecorded => f.write_str("the watchdog or the reset input, without a record"),
            Self::Panic { file, line } => {
                let start = file.iter().position(|byte| *byte != 0).unwrap_or(file.len());
                write!(f, "panic at ..{}:{line}", file.get(start..).unwrap_or_default().escape_ascii())
            }
            Self::Fault { pc, lr, status, hard, address } => write!(
                f,
                "hard fault at {pc:#010x}, called from {lr:#010x}: CFSR {status:#010x}, HFSR {hard:#010x}, address \
                 {address:#010x}"
            ),
            Self::StackOverflow { status, address } => {
                write!(f, "stack overflow: CFSR {status:#010x}, address {address:#010x}")
            }
            Self::Watchdog { tasks: 0 } => f.write_str("watchdog: no task runs, or the gateway overruns its deadline"),
            Self::Watchdog { tasks } => write!(f, "watchdog: stalled tasks {tasks:#b}"),
            Self::Network => f.write_str("watchdog: the Ethernet controller does not respond"),
            Self::Unconfirmed => f.write_str("the update served no request in time"),
            Self::Unexpected { number } => write!(f, "unexpected exception or interrupt {}", number.cast_signed()),
        }
    }
}

/// A record in memory that a reset does not clear.
///
/// # Examples
///
/// ```
/// use core::sync::atomic::AtomicU32;
/// use bcap_board::record::{Cause, Memory, Record};
///
/// // on a board this lies in a section that the start-up code leaves alone
/// static MEMORY: Memory = [const { AtomicU32::new(0) }; 8];
/// let record = Record::new(&MEMORY);
/// assert_eq!(record.take(), Cause::PowerOn);
/// record.write(Cause::Network);
/// assert_eq!(record.take(), Cause::Network);
/// assert_eq!(record.take(), Cause::Unrecorded, "the program runs, and writes no other cause");
/// ```
#[derive(Clone, Copy, Debug)]
pub struct Record<'m>(&'m Memory);

impl<'m> Record<'m> {
    /// Uses this memory.
    #[must_use]
    pub const fn new(memory: &'m Memory) -> Self {
        Self(memory)
    }

    /// Writes a cause.
    pub fn write(self, cause: Cause) {
        let [kind, a, b, c, d, e] = cause.to_words();
        let words = [MAGIC, kind, a, b, c, d, e];
        for (to, from) in self.0.iter().zip(words.into_iter().chain([checksum(&words)])) {
            to.store(from, Ordering::Relaxed);
        }
        // a reset drops the last write to a memory with error correction, such as the RAM of the STM32H7; this write
        // changes nothing
        if let Some(first) = self.0.first() {
            first.store(MAGIC, Ordering::Relaxed);
        }
    }

    /// Writes the cause of a panic, if its place is known.
    pub fn write_panic(self, info: &PanicInfo<'_>) {
        if let Some(at) = info.location() {
            self.write(Cause::panic(at.file(), at.line()));
        }
    }

    /// Reads the cause of the last reset, and replaces it by [`Cause::Unrecorded`]. Call it once at the start.
    #[must_use]
    pub fn take(self) -> Cause {
        let mut words = [0; WORDS];
        for (to, from) in words.iter_mut().zip(self.0) {
            *to = from.load(Ordering::Relaxed);
        }
        let [content @ .., sum] = words;
        let [magic, kind, a, b, c, d, e] = content;
        let is_valid = magic == MAGIC && sum == checksum(&content);
        self.write(Cause::Unrecorded);
        if is_valid { Cause::from_words([kind, a, b, c, d, e]) } else { Cause::PowerOn }
    }
}

fn checksum(words: &[u32]) -> u32 {
    words.iter().fold(u32::MAX, |sum, word| sum.rotate_left(5) ^ word)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::string::ToString;

    const CAUSES: [Cause; 7] = [
        Cause::Fault { pc: 0x1000_0001, lr: 2, status: 3, hard: 4, address: 5 },
        Cause::StackOverflow { status: 1 << 20, address: 7 },
        Cause::Watchdog { tasks: 0b101 },
        Cause::Network,
        Cause::Unexpected { number: u32::MAX },
        Cause::Unconfirmed,
        Cause::Unrecorded,
    ];

    #[test]
    fn every_cause_is_read_once() {
        let memory = Memory::default();
        let record = Record::new(&memory);
        assert_eq!(record.take(), Cause::PowerOn);
        for cause in CAUSES.into_iter().chain([Cause::panic("src/a/long/path.rs", 77), Cause::panic("a.rs", 1)]) {
            record.write(cause);
            assert_eq!((record.take(), record.take()), (cause, Cause::Unrecorded));
        }
    }

    #[test]
    fn a_changed_bit_makes_the_record_invalid() {
        for word in 0..WORDS {
            for bit in 0..32 {
                let memory = Memory::default();
                Record::new(&memory).write(CAUSES[0]);
                memory[word].fetch_xor(1 << bit, Ordering::Relaxed);
                assert_eq!(Record::new(&memory).take(), Cause::PowerOn, "bit {bit} of word {word}");
            }
        }
    }

    #[test]
    fn a_panic_keeps_the_end_of_the_file_name() {
        assert_eq!(Cause::panic("board/src/bin/gateway.rs", 12).to_string(), "panic at ..n/gateway.rs:12");
        assert_eq!(Cause::panic("a.rs", 1).to_string(), "panic at ..a.rs:1");
    }
}
