//! The state partition of embassy-boot, in which a power cut leaves the earlier state or the new one.
//!
//! embassy-boot erases its state and then writes a word of equal bytes, such as `f0`: swap the images. A power cut in
//! the middle can leave bytes that mean something else: an interrupted `d0`, confirmed, can read as `f0`. The boot
//! loader would then swap images although one of them is overwritten. So this flash has two banks with a checked
//! header, and a state is complete with its header:
//!
//! ```text
//!  range ─► [ header | progress of the swap ][ header | progress of the swap ]      two banks, each of whole sectors
//!
//!  header, 32 bytes: "BCAPBOOT", sequence, state (4 equal bytes), CRC-32 of these two (u32, little-endian), 0xff
//! ```

use core::fmt;
use core::ops::Range;

use embedded_storage::nor_flash::{ErrorType, NorFlash, NorFlashError, NorFlashErrorKind, ReadNorFlash};

use crate::crc::Crc32;

/// The header's size: a multiple of the units of common flash memories.
const HEADER: usize = 32;
const MAGIC: &[u8; 8] = b"BCAPBOOT";
/// embassy-boot's state of an update that waits for its swap.
const SWAP: u8 = 0xf0;
/// A state that embassy-boot treats as "start the image": the boot loader has refused an update.
const REFUSED: u8 = 0x3c;

/// Why the state cannot be read or changed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum StateError<E> {
    /// The range has no two banks of whole sectors, or the flash is written in units of more than 32 bytes.
    Range,
    /// An operation that embassy-boot 0.7 does not perform.
    Unsupported,
    /// The flash does not contain the written bytes.
    NotWritten,
    /// The flash failed.
    Flash(E),
}

impl<E: fmt::Debug> fmt::Display for StateError<E> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Range => f.write_str("the state of the boot loader needs two banks of whole sectors"),
            Self::Unsupported => f.write_str("the state of the boot loader cannot be changed this way"),
            Self::NotWritten => f.write_str("the flash does not have what was written"),
            Self::Flash(error) => write!(f, "the flash failed: {error:?}"),
        }
    }
}

impl<E: fmt::Debug> core::error::Error for StateError<E> {}

impl<E: NorFlashError> NorFlashError for StateError<E> {
    fn kind(&self) -> NorFlashErrorKind {
        match self {
            Self::Flash(error) => error.kind(),
            Self::Range | Self::Unsupported | Self::NotWritten => NorFlashErrorKind::Other,
        }
    }
}

/// A state partition for embassy-boot, in two banks of a flash.
#[derive(Debug)]
pub struct StateFlash<F> {
    flash: F,
    /// The offsets of the banks, and the size of one.
    starts: [u32; 2],
    size: u32,
    bank: Option<Bank>,
    /// The state reads as erased until the next state is written; a power cut restores the earlier state.
    is_erased: bool,
}

/// A bank with a valid header.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Bank {
    start: u32,
    sequence: u32,
    state: u8,
}

impl<F: NorFlash> StateFlash<F> {
    /// Divides a range of the flash into two banks, and finds the state.
    ///
    /// # Errors
    ///
    /// [`StateError::Range`] when the range has no two banks; [`StateError::Flash`] when the flash cannot be read.
    pub fn new(mut flash: F, range: Range<u32>) -> Result<Self, StateError<F::Error>> {
        let size = range.end.checked_sub(range.start).ok_or(StateError::Range)? / 2;
        let starts = [range.start, range.start + size];
        let sector = u32::try_from(F::ERASE_SIZE).unwrap_or(u32::MAX);
        let is_aligned = starts.iter().chain([&range.end]).all(|offset| offset.is_multiple_of(sector));
        let has_units = HEADER.is_multiple_of(F::WRITE_SIZE) && HEADER.is_multiple_of(F::READ_SIZE);
        let is_inside = usize::try_from(range.end).is_ok_and(|end| end <= flash.capacity());
        if size == 0 || !is_aligned || !has_units || !is_inside {
            return Err(StateError::Range);
        }
        let mut banks = [None; 2];
        for (bank, start) in banks.iter_mut().zip(starts) {
            *bank = read_header(&mut flash, start).map_err(StateError::Flash)?;
        }
        let bank = match banks {
            // sequence numbers wrap
            [Some(a), Some(b)] => Some(if a.sequence.wrapping_sub(b.sequence).cast_signed() > 0 { a } else { b }),
            [a, b] => a.or(b),
        };
        Ok(Self { flash, starts, size, bank, is_erased: false })
    }

    /// Returns the number of the state, which each change increments, and which wraps; `None` before the first change.
    pub(super) fn sequence(&self) -> Option<u32> {
        self.bank.map(|bank| bank.sequence)
    }

    /// Returns whether an update waits whose swap has not begun.
    pub(super) fn is_pending(&mut self) -> Result<bool, StateError<F::Error>> {
        let Some(bank) = self.bank.filter(|bank| bank.state == SWAP) else { return Ok(false) };
        let mut words = [0; HEADER];
        let word = words.get_mut(..F::WRITE_SIZE.max(F::READ_SIZE)).ok_or(StateError::Range)?;
        // the first two words are the state, and the validity of the progress
        let first = bank.start + length(HEADER) + 2 * length(F::WRITE_SIZE);
        self.flash.read(first, word).map_err(StateError::Flash)?;
        Ok(word.iter().take(F::WRITE_SIZE).any(|byte| *byte == 0xff))
    }

    /// Cancels the pending update.
    pub(super) fn refuse(&mut self) -> Result<(), StateError<F::Error>> {
        self.commit(REFUSED)
    }

    /// Returns whether the boot loader has refused the last update.
    pub(super) fn is_refused(&self) -> bool {
        self.bank.is_some_and(|bank| bank.state == REFUSED)
    }

    /// Starts a new state: writes it with its header into the bank that is not in use.
    fn commit(&mut self, state: u8) -> Result<(), StateError<F::Error>> {
        let [first, second] = self.starts;
        let (start, sequence) = match self.bank {
            Some(bank) => (if bank.start == first { second } else { first }, bank.sequence.wrapping_add(1)),
            None => (first, 0),
        };
        self.flash.erase(start, start + self.size).map_err(StateError::Flash)?;
        let bank = Bank { start, sequence, state };
        self.flash.write(start, &header(&bank)).map_err(StateError::Flash)?;
        if read_header(&mut self.flash, start).map_err(StateError::Flash)? != Some(bank) {
            return Err(StateError::NotWritten);
        }
        self.bank = Some(bank);
        self.is_erased = false;
        Ok(())
    }
}

impl<F: NorFlash> ErrorType for StateFlash<F> {
    type Error = StateError<F::Error>;
}

impl<F: NorFlash> ReadNorFlash for StateFlash<F> {
    const READ_SIZE: usize = F::READ_SIZE;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), Self::Error> {
        let Some(bank) = self.bank.filter(|_| !self.is_erased) else {
            bytes.fill(0xff);
            return Ok(());
        };
        self.flash.read(bank.start + length(HEADER) + offset, bytes).map_err(StateError::Flash)?;
        // the first word is the state, which the header has
        let from = usize::try_from(offset).unwrap_or(usize::MAX);
        bytes.iter_mut().take(F::WRITE_SIZE.saturating_sub(from)).for_each(|byte| *byte = bank.state);
        Ok(())
    }

    fn capacity(&self) -> usize {
        usize::try_from(self.size).unwrap_or_default().saturating_sub(HEADER)
    }
}

impl<F: NorFlash> NorFlash for StateFlash<F> {
    const WRITE_SIZE: usize = F::WRITE_SIZE;
    const ERASE_SIZE: usize = F::ERASE_SIZE;

    fn erase(&mut self, from: u32, to: u32) -> Result<(), Self::Error> {
        if from != 0 || usize::try_from(to) != Ok(self.capacity()) {
            return Err(StateError::Unsupported);
        }
        self.is_erased = true;
        Ok(())
    }

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), Self::Error> {
        let word = length(Self::WRITE_SIZE);
        match (offset, bytes, self.bank) {
            (0, [state, rest @ ..], _) if self.is_erased && rest.iter().all(|byte| byte == state) => {
                self.commit(*state)
            }
            (0, ..) => Err(StateError::Unsupported),
            // "the progress is invalid", which protects a slow erase; a bank becomes invalid immediately
            (offset, ..) if offset == word => Ok(()),
            (_, _, Some(bank)) if !self.is_erased => {
                self.flash.write(bank.start + length(HEADER) + offset, bytes).map_err(StateError::Flash)
            }
            _ => Err(StateError::Unsupported),
        }
    }
}

/// Converts a length within a bank.
fn length(len: usize) -> u32 {
    u32::try_from(len).unwrap_or(u32::MAX)
}

/// Returns the numbers of a header and their CRC.
fn numbers(bank: &Bank) -> [[u8; 4]; 3] {
    let (sequence, state) = (bank.sequence.to_le_bytes(), [bank.state; 4]);
    [sequence, state, Crc32::new().and(&sequence).and(&state).value().to_le_bytes()]
}

fn header(bank: &Bank) -> [u8; HEADER] {
    let mut header = [0xff; HEADER];
    let bytes = MAGIC.iter().chain(numbers(bank).as_flattened()).copied().collect::<heapless::Vec<u8, HEADER>>();
    header.iter_mut().zip(bytes).for_each(|(to, from)| *to = from);
    header
}

fn read_header<F: NorFlash>(flash: &mut F, start: u32) -> Result<Option<Bank>, F::Error> {
    let mut bytes = [0; HEADER];
    flash.read(start, &mut bytes)?;
    let Some((words, _)) = bytes.strip_prefix(MAGIC).map(<[u8]>::as_chunks::<4>) else { return Ok(None) };
    let &[sequence, [state, ..], _, ..] = words else { return Ok(None) };
    let bank = Bank { start, sequence: u32::from_le_bytes(sequence), state };
    Ok((bytes == header(&bank)).then_some(bank))
}
