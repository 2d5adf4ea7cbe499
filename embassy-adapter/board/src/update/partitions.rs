//! The parts of the flash that updates use.

use core::ops::Range;

/// Where the parts of an update are: ranges of offsets in the flash, of whole sectors.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Partitions {
    /// The image that runs.
    pub active: Range<u32>,
    /// The partition of the received image, and after the swap of the previous one; a sector larger than `active`, for
    /// the swap.
    pub other: Range<u32>,
    /// The state of the boot loader, for [`StateFlash`](super::StateFlash).
    pub state: Range<u32>,
    /// The last update and why it was rolled back, for [`Slots`](crate::slots::Slots).
    pub history: Range<u32>,
    /// A sector for the signature of the received image.
    pub signature: Range<u32>,
}
