//! The facts about the processor that RTIC needs; a crate of a chip has them in its `pac`.
//!
//! The image has no task on an interrupt, so no interrupt has a name here.

/// The bits of a priority that the interrupt controller implements.
pub const NVIC_PRIO_BITS: u8 = 3;

/// The interrupts of the board.
pub use Interrupt as interrupt;

/// An interrupt.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Interrupt {}
