//! A record of the last reset's cause, in memory that a reset does not clear.
#![expect(unsafe_code, reason = "the section of a static is an unsafe attribute")]

use core::sync::atomic::{AtomicU32, Ordering};

/// The letters of a valid record.
const MAGIC: u32 = u32::from_le_bytes(*b"RSET");
const WORDS: usize = 8;

/// The magic word, the kind, the values, and a checksum over them.
#[unsafe(link_section = ".uninit.record")]
static RECORD: [AtomicU32; WORDS] = [const { AtomicU32::new(0) }; WORDS];

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
        /// The address of the instruction; 0 in an exception handler.
        pc: u32,
        /// The return address of its function; 0 in an exception handler.
        lr: u32,
        /// The register CFSR.
        status: u32,
        /// The register HFSR.
        hard: u32,
        /// The register BFAR or MMFAR; 0 if neither is valid.
        address: u32,
    },
    /// The program's stack overflowed.
    StackOverflow {
        /// The register CFSR.
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
}

impl Cause {
    /// Makes the cause of a panic at this place.
    pub(crate) fn panic(name: &str, line: u32) -> Self {
        let mut file = [0; 12];
        for (to, from) in file.iter_mut().rev().zip(name.bytes().rev()) {
            *to = from;
        }
        Self::Panic { file, line }
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
            _ => Self::PowerOn,
        }
    }
}

/// Writes a record.
pub(crate) fn write(cause: Cause) {
    let [kind, a, b, c, d, e] = cause.to_words();
    let words = [MAGIC, kind, a, b, c, d, e];
    for (to, from) in RECORD.iter().zip(words.into_iter().chain([checksum(&words)])) {
        to.store(from, Ordering::Relaxed);
    }
}

/// Reads the record, and marks it as that of a running program.
pub(crate) fn take() -> Cause {
    let mut words = [0; WORDS];
    for (to, from) in words.iter_mut().zip(&RECORD) {
        *to = from.load(Ordering::Relaxed);
    }
    let [content @ .., sum] = words;
    let [magic, kind, a, b, c, d, e] = content;
    let is_valid = magic == MAGIC && sum == checksum(&content);
    write(Cause::Unrecorded);
    if is_valid { Cause::from_words([kind, a, b, c, d, e]) } else { Cause::PowerOn }
}

fn checksum(words: &[u32]) -> u32 {
    words.iter().fold(u32::MAX, |sum, word| sum.rotate_left(5) ^ word)
}
