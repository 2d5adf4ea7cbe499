//! A model of a flash memory for settings.
//!
//! The emulated board has no flash that it can write, so this is memory that a reset does not clear. It loses its contents
//! when QEMU ends.
#![expect(unsafe_code, reason = "the section of a static is an unsafe attribute")]

use core::convert::Infallible;
use core::sync::atomic::{AtomicU32, Ordering};

use bcap_board::slots::{SLOT, SlotError, Slots};
use embedded_storage::nor_flash::{ErrorType, NorFlash, ReadNorFlash};

const WORD: usize = 4;
const CAPACITY: usize = 2 * SLOT;

#[unsafe(link_section = ".uninit.flash")]
static WORDS: [AtomicU32; CAPACITY / WORD] = [const { AtomicU32::new(0) }; CAPACITY / WORD];

/// The flash; there is one.
#[derive(Debug)]
pub struct Flash(());

/// Returns the two slots for settings.
///
/// # Errors
///
/// [`SlotError::Range`] when the flash is too small for them.
pub fn slots() -> Result<Slots<Flash>, SlotError<Infallible>> {
    let end = u32::try_from(CAPACITY).unwrap_or_default();
    Slots::new(Flash(()), 0..end)
}

/// Returns the words from an offset on.
fn words(offset: u32) -> impl Iterator<Item = &'static AtomicU32> {
    WORDS.iter().skip(usize::try_from(offset).unwrap_or(usize::MAX) / WORD)
}

impl ErrorType for Flash {
    type Error = Infallible;
}

impl ReadNorFlash for Flash {
    const READ_SIZE: usize = WORD;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), Infallible> {
        for (to, word) in bytes.chunks_mut(WORD).zip(words(offset)) {
            to.copy_from_slice(&word.load(Ordering::Relaxed).to_le_bytes()[..to.len()]);
        }
        Ok(())
    }

    fn capacity(&self) -> usize {
        CAPACITY
    }
}

impl NorFlash for Flash {
    const WRITE_SIZE: usize = WORD;
    const ERASE_SIZE: usize = SLOT;

    fn erase(&mut self, from: u32, to: u32) -> Result<(), Infallible> {
        let count = usize::try_from(to.saturating_sub(from)).unwrap_or_default() / WORD;
        words(from).take(count).for_each(|word| word.store(u32::MAX, Ordering::Relaxed));
        Ok(())
    }

    /// Clears bits, as writing to a flash does.
    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), Infallible> {
        let (new, _) = bytes.as_chunks::<WORD>();
        for (word, new) in words(offset).zip(new) {
            word.fetch_and(u32::from_le_bytes(*new), Ordering::Relaxed);
        }
        Ok(())
    }
}
