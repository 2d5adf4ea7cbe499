//! Why an update fails.

use core::fmt;

use super::state::StateError;
use crate::slots::SlotError;

/// Why an update is refused, or has failed.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum UpdateError<E> {
    /// The image is for another board.
    OtherBoard {
        /// The name of this board.
        board: &'static str,
    },
    /// The image is empty, or larger than the active partition.
    Size {
        /// The maximum size of an image in bytes.
        most: u32,
    },
    /// An update waits for a restart, or is on trial.
    Busy,
    /// No update was begun.
    NotBegun,
    /// A block is damaged: its CRC or its length is wrong.
    Damaged,
    /// Another block is expected.
    Sequence {
        /// Its number.
        expected: u32,
    },
    /// Blocks are missing.
    Incomplete {
        /// The number of the first missing block.
        expected: u32,
    },
    /// The flash does not contain the image: the CRC-32 differs.
    Crc,
    /// The image is older than the running image.
    Older {
        /// The version that runs.
        running: &'static str,
    },
    /// The board takes signed images only.
    Unsigned,
    /// The signature does not belong to the image, or was not made with the key of this board.
    Signature,
    /// The image that runs has no key.
    NoKey,
    /// The image does not start with a vector table.
    NoVectors,
    /// The flash does not contain the written bytes.
    NotWritten,
    /// The partitions do not fit the flash.
    Partitions,
    /// The flash failed.
    Flash(E),
}

impl<E: fmt::Debug> fmt::Display for UpdateError<E> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::OtherBoard { board } => write!(f, "the image is for another board: this is a {board}"),
            Self::Size { most } => write!(f, "an image has 1 to {most} bytes on this board"),
            Self::Busy => f.write_str(
                "an update waits for a restart or is on trial; try again when it is confirmed or rolled back",
            ),
            Self::NotBegun => f.write_str("no update was begun"),
            Self::Damaged => f.write_str("the block is damaged"),
            Self::Sequence { expected } => write!(f, "expected block {expected}"),
            Self::Incomplete { expected } => write!(f, "the image is incomplete: block {expected} is missing"),
            Self::Crc => f.write_str("the CRC-32 of the image in the flash is another one"),
            Self::Older { running } => write!(f, "the image is older than {running}, which runs"),
            Self::Unsigned => f.write_str("this board takes signed images only"),
            Self::Signature => f.write_str("the signature is not by the key of this board, or is for another image"),
            Self::NoKey => f.write_str("this board was built without a key, so it cannot check a signature"),
            Self::NoVectors => f.write_str("the image does not start with a vector table"),
            Self::NotWritten => f.write_str("the flash does not have what was written"),
            Self::Partitions => f.write_str("the partitions for updates do not fit the flash"),
            Self::Flash(error) => write!(f, "the flash failed: {error:?}"),
        }
    }
}

impl<E: fmt::Debug> core::error::Error for UpdateError<E> {}

impl<E> From<StateError<E>> for UpdateError<E> {
    fn from(error: StateError<E>) -> Self {
        match error {
            StateError::Range | StateError::Unsupported => Self::Partitions,
            StateError::NotWritten => Self::NotWritten,
            StateError::Flash(error) => Self::Flash(error),
        }
    }
}

impl<E> From<SlotError<E>> for UpdateError<E> {
    fn from(error: SlotError<E>) -> Self {
        match error {
            SlotError::Range | SlotError::TooLong { .. } => Self::Partitions,
            SlotError::NotWritten => Self::NotWritten,
            SlotError::Flash(error) => Self::Flash(error),
        }
    }
}
