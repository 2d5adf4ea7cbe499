//! Settings in flash that survive a power cut while they are written.
//!
//! ```text
//!  range ─► [ header | text | unused ][ header | text | unused ]      two slots, each of whole sectors
//!
//!  header, 32 bytes: "BCAPSLOT", sequence, length of the text, CRC-32 of these two and the text (u32, little-endian), 0xff
//! ```
//!
//! The valid slot with the higher sequence number has the settings. A write erases the other slot, writes the text there and
//! the header last. So at every moment the flash has the old settings or the new ones. Without a valid slot the board uses
//! the settings of its image.
//!
//! It is not `sequential-storage`, because that crate is async, and a board needs its settings before its executor runs.

use core::fmt;
use core::ops::Range;

use embedded_storage::nor_flash::NorFlash;

use crate::BLOCK;
use crate::crc::Crc32;

/// Minimum size of a slot, in bytes.
pub const SLOT: usize = BLOCK;
/// The maximum size of text in a slot in bytes.
pub const TEXT: usize = SLOT - HEADER;
/// The size of the header, and of the parts in which text is moved: a multiple of the units of common flash memories.
const HEADER: usize = 32;
const MAGIC: &[u8; 8] = b"BCAPSLOT";

/// Why settings cannot be read or written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum SlotError<E> {
    /// The range does not fit the flash: it must have two slots of whole sectors, each of at least [`SLOT`] bytes.
    Range,
    /// The settings are longer than [`TEXT`].
    TooLong {
        /// Their length in bytes.
        len: usize,
    },
    /// The flash does not contain the written bytes; the earlier settings are unchanged.
    NotWritten,
    /// The flash failed.
    Flash(E),
}

impl<E: fmt::Debug> fmt::Display for SlotError<E> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Range => write!(f, "the flash needs two slots of whole sectors, each of at least {SLOT} bytes"),
            Self::TooLong { len } => write!(f, "the settings take {len} bytes of {TEXT}"),
            Self::NotWritten => f.write_str("the flash does not have what was written"),
            Self::Flash(error) => write!(f, "the flash failed: {error:?}"),
        }
    }
}

impl<E: fmt::Debug> core::error::Error for SlotError<E> {}

impl<E> From<E> for SlotError<E> {
    fn from(error: E) -> Self {
        Self::Flash(error)
    }
}

/// The two slots in a range of a flash memory.
#[derive(Debug)]
pub struct Slots<F> {
    flash: F,
    /// The offsets of the slots, and the size of one.
    starts: [u32; 2],
    size: u32,
}

/// A valid slot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Valid {
    start: u32,
    sequence: u32,
    len: usize,
}

impl<F: NorFlash> Slots<F> {
    /// Divides a range of the flash into two slots.
    ///
    /// # Errors
    ///
    /// [`SlotError::Range`] when the range has no two slots, or the flash is written in units of more than 32 bytes.
    pub fn new(flash: F, range: Range<u32>) -> Result<Self, SlotError<F::Error>> {
        let size = range.end.checked_sub(range.start).ok_or(SlotError::Range)? / 2;
        let is_aligned = |offset: u32| usize::try_from(offset).is_ok_and(|offset| offset % F::ERASE_SIZE == 0);
        let has_units = HEADER.is_multiple_of(F::WRITE_SIZE) && HEADER.is_multiple_of(F::READ_SIZE);
        let is_inside = usize::try_from(range.end).is_ok_and(|end| end <= flash.capacity());
        let has_room = usize::try_from(size).is_ok_and(|size| size >= SLOT);
        let starts = [range.start, range.start + size];
        let is_valid =
            has_units && is_inside && has_room && starts.iter().chain([&range.end]).all(|at| is_aligned(*at));
        is_valid.then_some(Self { flash, starts, size }).ok_or(SlotError::Range)
    }

    /// Reads the settings; `None` without a valid slot.
    ///
    /// # Errors
    ///
    /// [`SlotError::Flash`] when the flash cannot be read.
    pub fn read<'b>(&mut self, memory: &'b mut [u8; TEXT]) -> Result<Option<&'b [u8]>, SlotError<F::Error>> {
        self.read_start(memory)
    }

    /// Reads the start of the settings, as far as there is memory: a multiple of 32 bytes.
    pub(crate) fn read_start<'b>(&mut self, memory: &'b mut [u8]) -> Result<Option<&'b [u8]>, SlotError<F::Error>> {
        let Some(Valid { start, len, .. }) = self.newest() else { return Ok(None) };
        self.flash.read(start + offset(HEADER), memory)?;
        Ok(memory.get(..len.min(memory.len())))
    }

    /// Replaces the settings; a power cut leaves the earlier ones or these.
    ///
    /// # Errors
    ///
    /// A [`SlotError`]; the earlier settings are then unchanged.
    pub fn write(&mut self, text: &[u8]) -> Result<(), SlotError<F::Error>> {
        let len = text.len();
        if len > TEXT {
            return Err(SlotError::TooLong { len });
        }
        let (start, sequence) = match self.newest() {
            Some(newest) => (self.other(newest.start), newest.sequence.wrapping_add(1)),
            None => (self.starts[0], 0),
        };
        self.erase(start)?;
        for (chunk, at) in text.chunks(HEADER).zip((start + offset(HEADER)..).step_by(HEADER)) {
            self.flash.write(at, &padded(chunk))?;
        }
        self.flash.write(start, &header(sequence, text))?;
        let is_written = self.valid(start) == Some(Valid { start, sequence, len });
        if is_written { Ok(()) } else { Err(SlotError::NotWritten) }
    }

    /// Removes the settings, so that the image's defaults are used; a power cut leaves the earlier ones or none.
    ///
    /// # Errors
    ///
    /// [`SlotError::Flash`] when the flash cannot be erased.
    pub fn clear(&mut self) -> Result<(), SlotError<F::Error>> {
        // the newest one last, so a power cut does not bring back older settings
        let last = self.newest().map_or(self.starts[0], |newest| newest.start);
        self.erase(self.other(last))?;
        self.erase(last)
    }

    /// Returns the flash, for other parts of it.
    pub const fn flash(&mut self) -> &mut F {
        &mut self.flash
    }

    /// Returns the flash.
    #[must_use]
    pub fn release(self) -> F {
        self.flash
    }

    fn other(&self, start: u32) -> u32 {
        let [first, second] = self.starts;
        if start == first { second } else { first }
    }

    fn erase(&mut self, start: u32) -> Result<(), SlotError<F::Error>> {
        Ok(self.flash.erase(start, start + self.size)?)
    }

    fn newest(&mut self) -> Option<Valid> {
        let [first, second] = self.starts;
        match (self.valid(first), self.valid(second)) {
            // sequence numbers wrap
            (Some(a), Some(b)) => Some(if a.sequence.wrapping_sub(b.sequence).cast_signed() > 0 { a } else { b }),
            (a, b) => a.or(b),
        }
    }

    /// Checks the slot at an offset. A slot that cannot be read is invalid: the other slot may be valid.
    fn valid(&mut self, start: u32) -> Option<Valid> {
        let mut chunk = [0; HEADER];
        self.flash.read(start, &mut chunk).ok()?;
        let (sequence, len, crc) = parse(&chunk)?;
        let mut found = start_of_crc(sequence, len);
        for at in (0..len).step_by(HEADER) {
            self.flash.read(start + offset(HEADER + at), &mut chunk).ok()?;
            let count = HEADER.min(len - at);
            found = found.and(chunk.get(..count).unwrap_or_default());
        }
        (found.value() == crc).then_some(Valid { start, sequence, len })
    }
}

/// Converts a length within a slot.
fn offset(len: usize) -> u32 {
    u32::try_from(len).unwrap_or(u32::MAX)
}

/// Pads a part of at most 32 bytes as erased flash is.
fn padded(part: &[u8]) -> [u8; HEADER] {
    let mut chunk = [0xff; HEADER];
    chunk.iter_mut().zip(part).for_each(|(to, from)| *to = *from);
    chunk
}

fn start_of_crc(sequence: u32, len: usize) -> Crc32 {
    Crc32::new().and(&sequence.to_le_bytes()).and(&offset(len).to_le_bytes())
}

fn header(sequence: u32, text: &[u8]) -> [u8; HEADER] {
    let crc = start_of_crc(sequence, text.len()).and(text).value();
    let mut fields = [0xff; HEADER];
    let numbers = [sequence, offset(text.len()), crc];
    let bytes = MAGIC.iter().copied().chain(numbers.into_iter().flat_map(u32::to_le_bytes));
    fields.iter_mut().zip(bytes).for_each(|(to, from)| *to = from);
    fields
}

/// Returns the sequence number, the length of the text and the CRC.
fn parse(header: &[u8; HEADER]) -> Option<(u32, usize, u32)> {
    let (numbers, _) = header.strip_prefix(MAGIC)?.as_chunks::<4>();
    let [sequence, len, crc, ..] = *numbers else { return None };
    let len = usize::try_from(u32::from_le_bytes(len)).ok().filter(|len| *len <= TEXT)?;
    Some((u32::from_le_bytes(sequence), len, u32::from_le_bytes(crc)))
}
