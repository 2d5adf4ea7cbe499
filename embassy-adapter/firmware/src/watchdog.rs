//! The watchdog of the board (CMSDK).
//!
//! ```text
//!  arm, first in `main` ─► fed ── 4 s without feeding ──► NMI: reported, reset ── 4 s more ──► reset by the watchdog itself
//! ```
//!
//! [`bcap_board::watchdog`] feeds it while all tasks run.

use crate::board::{CLOCK_HZ, WATCHDOG};

/// Registers of the watchdog.
mod register {
    pub(super) const LOAD: usize = 0x000;
    pub(super) const CONTROL: usize = 0x008;
    pub(super) const INT_CLEAR: usize = 0x00c;
    pub(super) const LOCK: usize = 0xc00;
}

const UNLOCK: u32 = 0x1acc_e551;
const INTERRUPT_AND_RESET: u32 = 0b11;
/// Seconds without feeding until the NMI.
const TIMEOUT_SECONDS: u32 = 4;

/// Starts the watchdog; call it first in `main`, so that it also resets a start that hangs.
pub fn arm() {
    WATCHDOG.write::<{ register::LOCK }>(UNLOCK);
    WATCHDOG.write::<{ register::LOAD }>(CLOCK_HZ * TIMEOUT_SECONDS);
    WATCHDOG.write::<{ register::CONTROL }>(INTERRUPT_AND_RESET);
}

/// Feeds the watchdog.
pub fn feed() {
    WATCHDOG.write::<{ register::INT_CLEAR }>(1);
}
