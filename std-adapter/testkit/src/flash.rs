//! A model of a NOR flash whose power can be cut at every byte.

use embedded_storage::nor_flash::{ErrorType, NorFlash, NorFlashError, NorFlashErrorKind, ReadNorFlash};

/// A flash that is written in units of `WRITE` bytes and erased in sectors of `ERASE` bytes.
///
/// Writing can only clear bits. Writing a byte and erasing a byte are one step each. After the last step the power is cut: the
/// byte of that step gets an arbitrary value between the old and the new one, and all later operations fail. A sector is erased
/// as a whole, so a power cut also changes its other bytes.
#[derive(Clone, Debug)]
pub struct Flash<const WRITE: usize, const ERASE: usize> {
    bytes: Vec<u8>,
    /// The steps until the power cut, and the completed steps.
    left: Option<u32>,
    done: u32,
    /// Selects the bits that a power cut changes.
    noise: u32,
    /// The bytes that a step of erasing erases.
    erased_at_once: usize,
}

/// Why an operation failed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FlashError {
    /// The power was cut during this operation or before it.
    PowerCut,
    /// A misaligned operation, or one out of bounds.
    Misuse,
    /// A bit to be set, which only erasing does.
    NotErased,
}

impl NorFlashError for FlashError {
    fn kind(&self) -> NorFlashErrorKind {
        NorFlashErrorKind::Other
    }
}

impl<const WRITE: usize, const ERASE: usize> Flash<WRITE, ERASE> {
    /// Creates a flash with random contents.
    ///
    /// # Panics
    ///
    /// Never: the contents are bytes.
    #[must_use]
    pub fn new(len: usize) -> Self {
        let noise = (0..len).map(|at| u8::try_from(at.wrapping_mul(2_654_435_761) >> 11 & 0xff).unwrap());
        Self { bytes: noise.collect(), left: None, done: 0, noise: 0, erased_at_once: 1 }
    }

    /// Cuts the power at this step from now on; `None` means never.
    #[must_use]
    pub fn with_cut_at(self, step: Option<u32>) -> Self {
        Self { left: step, ..self }
    }

    /// Returns the number of completed steps.
    #[must_use]
    pub const fn done(&self) -> u32 {
        self.done
    }

    /// Changes other bits at a power cut.
    #[must_use]
    pub fn with_noise(self, noise: u32) -> Self {
        Self { noise, ..self }
    }

    /// Erases `count` bytes in a step: power cuts during an erase differ only in which bits they leave.
    ///
    /// # Panics
    ///
    /// When a sector is not a multiple of `count`.
    #[must_use]
    pub fn with_erased_at_once(self, count: usize) -> Self {
        assert!(ERASE.is_multiple_of(count));
        Self { erased_at_once: count, ..self }
    }

    /// Returns the contents.
    #[must_use]
    pub fn bytes(&self) -> &[u8] {
        &self.bytes
    }

    /// Does a step on a byte.
    fn step(&mut self, at: usize, new: u8) -> Result<(), FlashError> {
        if let Some(left) = &mut self.left {
            if *left == 0 {
                return Err(FlashError::PowerCut);
            }
            *left -= 1;
            if *left == 0 {
                self.change_some_bits(at, new);
                return Err(FlashError::PowerCut);
            }
        }
        self.done += 1;
        self.bytes[at] = new;
        Ok(())
    }

    /// Completes these steps together if the power is not cut within them.
    fn skip(&mut self, steps: usize) -> bool {
        let steps = u32::try_from(steps).unwrap();
        if self.left.is_some_and(|left| left <= steps) {
            return false;
        }
        self.left = self.left.map(|left| left - steps);
        self.done += steps;
        true
    }

    fn change_some_bits(&mut self, at: usize, new: u8) {
        let seed = self.done.wrapping_add(u32::try_from(at).unwrap()).wrapping_add(self.noise);
        let some = u8::try_from(seed.wrapping_mul(0x9e37_79b1) >> 24).unwrap();
        self.bytes[at] ^= (self.bytes[at] ^ new) & some;
    }

    fn range(&self, from: u32, to: u32, unit: usize) -> Result<std::ops::Range<usize>, FlashError> {
        let range = usize::try_from(from).unwrap()..usize::try_from(to).unwrap();
        let is_valid =
            range.start.is_multiple_of(unit) && range.end.is_multiple_of(unit) && range.end <= self.bytes.len();
        is_valid.then_some(range).ok_or(FlashError::Misuse)
    }
}

impl<const WRITE: usize, const ERASE: usize> ErrorType for Flash<WRITE, ERASE> {
    type Error = FlashError;
}

impl<const WRITE: usize, const ERASE: usize> ReadNorFlash for Flash<WRITE, ERASE> {
    const READ_SIZE: usize = if WRITE > 4 { 4 } else { WRITE };

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), FlashError> {
        let range = self.range(offset, offset + u32::try_from(bytes.len()).unwrap(), Self::READ_SIZE)?;
        bytes.copy_from_slice(&self.bytes[range]);
        Ok(())
    }

    fn capacity(&self) -> usize {
        self.bytes.len()
    }
}

impl<const WRITE: usize, const ERASE: usize> NorFlash for Flash<WRITE, ERASE> {
    const WRITE_SIZE: usize = WRITE;
    const ERASE_SIZE: usize = ERASE;

    fn erase(&mut self, from: u32, to: u32) -> Result<(), FlashError> {
        let range = self.range(from, to, ERASE)?;
        if self.skip(range.len() / self.erased_at_once) {
            self.bytes[range].fill(0xff);
            return Ok(());
        }
        for at in range.step_by(self.erased_at_once) {
            let was_on = self.left != Some(0);
            let step = self.step(at, 0xff);
            if step.is_err() && was_on {
                (at + 1..(at + 1).next_multiple_of(ERASE)).for_each(|at| self.change_some_bits(at, 0xff));
            }
            step?;
            self.bytes[at..at + self.erased_at_once].fill(0xff);
        }
        Ok(())
    }

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), FlashError> {
        let range = self.range(offset, offset + u32::try_from(bytes.len()).unwrap(), WRITE)?;
        if self.bytes[range.clone()].iter().zip(bytes).any(|(old, new)| old & new != *new) {
            return Err(FlashError::NotErased);
        }
        if self.skip(bytes.len()) {
            self.bytes[range].copy_from_slice(bytes);
            return Ok(());
        }
        for (at, new) in range.zip(bytes) {
            self.step(at, *new)?;
        }
        Ok(())
    }
}
