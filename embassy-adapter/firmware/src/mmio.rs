//! Volatile access to registers.
#![expect(unsafe_code, reason = "registers are reached through their addresses")]

/// A block of 32-bit registers at a fixed address.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Block {
    base: usize,
}

impl Block {
    /// Creates a handle to the block of registers at `base`.
    ///
    /// # Safety
    ///
    /// The address must be the address of a peripheral. Accesses to its registers must not change memory that Rust
    /// uses, as a DMA controller would.
    pub(crate) const unsafe fn new(base: usize) -> Self {
        Self { base }
    }

    /// Reads the register `offset` bytes into the block.
    pub(crate) fn read<const OFFSET: usize>(self) -> u32 {
        const { assert!(OFFSET.is_multiple_of(4) && OFFSET < 0x1000) };
        // SAFETY: the address is aligned and inside the peripheral's page, by `new` and the assertion
        unsafe { core::ptr::with_exposed_provenance::<u32>(self.base + OFFSET).read_volatile() }
    }

    /// Writes the register `offset` bytes into the block.
    pub(crate) fn write<const OFFSET: usize>(self, value: u32) {
        const { assert!(OFFSET.is_multiple_of(4) && OFFSET < 0x1000) };
        // SAFETY: as for `read`
        unsafe { core::ptr::with_exposed_provenance_mut::<u32>(self.base + OFFSET).write_volatile(value) };
    }
}
