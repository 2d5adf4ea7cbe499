//! The parts of the flash, as offsets in bytes. The linker script of the image and the tests on the host also use this file.

use core::ops::Range;

/// The smallest part that can be erased, and the largest part of one write, as on the W25Q16 of an RP2040 board.
pub(crate) const SECTOR: usize = 4096;
pub(crate) const PAGE: usize = 256;

/// The settings, in two slots.
pub(crate) const SETTINGS: Range<u32> = 0x00_0000..0x00_2000;
/// The state of the boot loader, in two banks.
pub(crate) const STATE: Range<u32> = 0x00_2000..0x00_4000;
/// The last update and why it was rolled back, in two slots.
pub(crate) const HISTORY: Range<u32> = 0x00_4000..0x00_6000;
/// The signature of the received image.
pub(crate) const SIGNATURE: Range<u32> = 0x00_6000..0x00_7000;
/// The image that runs.
pub(crate) const ACTIVE: Range<u32> = 0x01_0000..0x05_0000;
/// The image that is received, later the earlier one; a sector larger.
pub(crate) const OTHER: Range<u32> = 0x05_0000..0x09_1000;

/// The size of the memory that stands for the flash. Its last sector is not part of the flash: it has the words below.
pub(crate) const SIZE: usize = 16 * 1024 * 1024;
pub(crate) const CONTROL: usize = SIZE - SECTOR;

/// Words of the last sector, by their number, each little-endian.
pub(crate) mod control {
    /// The number of operations until the power is cut in the middle of one; 0 means never. A host writes it.
    pub(crate) const CUT: usize = 0;
    /// Sectors that were erased.
    pub(crate) const ERASED: usize = 1;
    /// Pages that were written at least in part.
    pub(crate) const WRITTEN: usize = 2;
    /// Writes that were refused, because they would set a bit.
    pub(crate) const REFUSED: usize = 3;
    /// Words that were written again without being erased, which clears further bits.
    pub(crate) const WRITTEN_AGAIN: usize = 4;
    /// Power cuts.
    pub(crate) const CUTS: usize = 5;
    /// Starts of the boot loader.
    pub(crate) const STARTS: usize = 6;
}
