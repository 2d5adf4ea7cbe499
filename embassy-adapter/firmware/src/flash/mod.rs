//! A model of a flash memory, in the board's external memory.
//!
//! ```text
//!  SETTINGS, STATE, HISTORY, ACTIVE, OTHER, unused │ counters, power cut      16 MiB: sectors of 4 KiB, pages of 256 bytes
//! ```
//!
//! The emulated board has no flash that it can write. Its external memory keeps its contents over a reset, can have code, and
//! QEMU can map it to a file, which outlives QEMU (`run --flash`).
//!
//! Erasing a sector or writing a page is an operation. Writing only clears bits; a write that would set one is refused. The
//! power can be cut in the middle of an operation: a word in the last sector has the number of operations until then. An
//! interrupted write leaves the first half of the page, and a word with some of the bits. An interrupted erase sets arbitrary
//! bits of the sector. Then the board is reset, and has no record of the cause, as after power-on.
#![expect(unsafe_code, reason = "the flash is reached through its address")]

#[cfg_attr(not(feature = "update"), expect(dead_code, reason = "an image without updates has settings only"))]
pub(crate) mod layout;

use core::fmt;
use core::sync::atomic::{AtomicU32, Ordering};

use bcap_board::memory;
use bcap_board::record::Cause;
use bcap_board::slots::{SlotError, Slots};
use cortex_m::peripheral::SCB;
use embedded_storage::nor_flash::{ErrorType, NorFlash, NorFlashError, NorFlashErrorKind, ReadNorFlash};

use self::layout::{CONTROL, PAGE, SECTOR, SETTINGS, SIZE, control};
use crate::board::FLASH;

const WORD: usize = 4;

/// The flash; there is one.
#[derive(Debug)]
pub struct Flash(());

/// Why the flash refuses an operation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FlashError {
    /// A misaligned operation.
    Misaligned,
    /// The end of the operation is outside of the flash.
    OutOfBounds,
    /// A write that would set a bit, which only erasing does.
    NotErased,
}

impl fmt::Display for FlashError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Misaligned => "a misaligned operation",
            Self::OutOfBounds => "an operation outside of the flash",
            Self::NotErased => "a write to flash that is not erased",
        })
    }
}

impl core::error::Error for FlashError {}

impl NorFlashError for FlashError {
    fn kind(&self) -> NorFlashErrorKind {
        match self {
            Self::Misaligned => NorFlashErrorKind::NotAligned,
            Self::OutOfBounds => NorFlashErrorKind::OutOfBounds,
            Self::NotErased => NorFlashErrorKind::Other,
        }
    }
}

/// Returns the two slots for settings.
///
/// # Errors
///
/// [`SlotError::Range`] when the flash is too small for them.
pub fn slots() -> Result<Slots<Flash>, SlotError<FlashError>> {
    Slots::new(Flash(()), SETTINGS)
}

/// Returns the whole flash to the boot loader, and counts its start.
#[cfg(feature = "update")]
#[must_use]
pub fn start_of_loader() -> Flash {
    count(control::STARTS);
    Flash(())
}

/// Returns the words of the memory, including the last sector.
fn memory() -> &'static [AtomicU32] {
    // SAFETY: the board has this memory, and it is aligned. The only other references to it are from the running image
    // to itself, in the active partition, and the image never writes that partition
    unsafe { core::slice::from_raw_parts(core::ptr::with_exposed_provenance(FLASH), SIZE / WORD) }
}

/// Returns words of the flash, if both offsets are multiples of a unit.
fn words(from: u32, to: usize, unit: usize) -> Result<&'static [AtomicU32], FlashError> {
    let from = usize::try_from(from).unwrap_or(usize::MAX);
    if !from.is_multiple_of(unit) || !to.is_multiple_of(unit) {
        return Err(FlashError::Misaligned);
    }
    memory().get(..CONTROL / WORD).and_then(|flash| flash.get(from / WORD..to / WORD)).ok_or(FlashError::OutOfBounds)
}

/// Returns the end of an operation.
fn end(offset: u32, len: usize) -> usize {
    usize::try_from(offset).unwrap_or(usize::MAX).saturating_add(len)
}

/// Adds to a counter and returns its value.
fn count(number: usize) -> u32 {
    let counter = memory().get(CONTROL / WORD + number);
    counter.map_or(0, |counter| counter.fetch_add(1, Ordering::Relaxed).wrapping_add(1))
}

/// Counts an operation. If the power is cut in it, returns a source of arbitrary bits.
fn operation(number: usize) -> Option<Noise> {
    let seed = count(number);
    let left = memory().get(CONTROL / WORD + control::CUT)?;
    let is_cut = left.load(Ordering::Relaxed) == 1;
    if left.load(Ordering::Relaxed) > 0 {
        left.fetch_sub(1, Ordering::Relaxed);
    }
    is_cut.then_some(Noise(seed.wrapping_mul(0x9e37_79b1) | 1))
}

/// Ends an operation in which the power is cut: the contents of the RAM are void, and the board starts again.
fn cut_power() -> ! {
    count(control::CUTS);
    memory::record().write(Cause::PowerOn);
    SCB::sys_reset()
}

/// Arbitrary bits (xorshift).
struct Noise(u32);

impl Noise {
    fn next(&mut self) -> u32 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 17;
        self.0 ^= self.0 << 5;
        self.0
    }
}

fn erase_sector(words: &[AtomicU32]) {
    let cut = operation(control::ERASED);
    let Some(mut noise) = cut else { return words.iter().for_each(|word| word.store(u32::MAX, Ordering::Relaxed)) };
    for word in words {
        word.fetch_or(noise.next(), Ordering::Relaxed);
    }
    cut_power()
}

/// Writes a page, or a part of it.
fn write_page(words: &[AtomicU32], new: &[[u8; WORD]]) {
    let cut = operation(control::WRITTEN);
    let done = if cut.is_some() { new.len() / 2 } else { new.len() };
    let mut pairs = words.iter().zip(new.iter().map(|bytes| u32::from_le_bytes(*bytes)));
    for (word, new) in pairs.by_ref().take(done) {
        let old = word.fetch_and(new, Ordering::Relaxed);
        if old != u32::MAX && old != new {
            count(control::WRITTEN_AGAIN);
        }
    }
    let Some(mut noise) = cut else { return };
    if let Some((word, new)) = pairs.next() {
        word.fetch_and(new | noise.next(), Ordering::Relaxed);
    }
    cut_power()
}

impl ErrorType for Flash {
    type Error = FlashError;
}

impl ReadNorFlash for Flash {
    const READ_SIZE: usize = WORD;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), FlashError> {
        let words = words(offset, end(offset, bytes.len()), WORD)?;
        for (to, word) in bytes.chunks_mut(WORD).zip(words) {
            to.copy_from_slice(&word.load(Ordering::Relaxed).to_le_bytes());
        }
        Ok(())
    }

    fn capacity(&self) -> usize {
        CONTROL
    }
}

impl NorFlash for Flash {
    const WRITE_SIZE: usize = WORD;
    const ERASE_SIZE: usize = SECTOR;

    fn erase(&mut self, from: u32, to: u32) -> Result<(), FlashError> {
        let words = words(from, end(to, 0), SECTOR)?;
        words.chunks(SECTOR / WORD).for_each(erase_sector);
        Ok(())
    }

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), FlashError> {
        let mut words = words(offset, end(offset, bytes.len()), WORD)?;
        let (mut new, _) = bytes.as_chunks::<WORD>();
        let is_erased = |(word, new): (&AtomicU32, &[u8; WORD])| {
            let new = u32::from_le_bytes(*new);
            word.load(Ordering::Relaxed) & new == new
        };
        if !words.iter().zip(new).all(is_erased) {
            count(control::REFUSED);
            return Err(FlashError::NotErased);
        }
        // up to the end of the first page, then page by page
        let mut room = (PAGE - end(offset, 0) % PAGE) / WORD;
        while !new.is_empty() {
            let (page, rest) = new.split_at(room.min(new.len()));
            let (first, others) = words.split_at(page.len());
            write_page(first, page);
            (words, new, room) = (others, rest, PAGE / WORD);
        }
        Ok(())
    }
}
