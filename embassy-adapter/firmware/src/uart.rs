//! The serial port: received bytes, and a buffer for bytes to send.
//!
//! ```text
//!  log, text ─► RING, 4 KiB ─► interrupt of the transmitter ─► port
//! ```
//!
//! Writing copies into the buffer and never waits. Bytes that do not fit are dropped together with the rest of their frame,
//! and counted. After a fault, with interrupts disabled, [`flush`] sends the buffer by polling.

use core::fmt;

use bcap_board::ring::Ring;

use crate::board::{self, UART, UART_TX_IRQ};

/// Registers of the CMSDK serial port.
mod register {
    pub(super) const DATA: usize = 0x00;
    pub(super) const STATE: usize = 0x04;
    pub(super) const CONTROL: usize = 0x08;
    pub(super) const INT_CLEAR: usize = 0x0c;
    pub(super) const BAUD_DIVISOR: usize = 0x10;
}

const TX_FULL: u32 = 1 << 0;
const RX_FULL: u32 = 1 << 1;
const ENABLE_TX_RX_TX_INTERRUPT: u32 = 0b111;
const TX_INTERRUPT: u32 = 1 << 0;
const BAUD: u32 = 115_200;
/// The most bytes sent in one interrupt: the port has room for one or two, an emulated port has room for all.
const BURST: usize = 16;
/// How often a port that takes no byte is polled before [`flush`] gives up: more than the time of a character.
const FULL_POLLS: u32 = 100_000;

/// The bytes to send.
static RING: Ring<4096> = Ring::new();

/// Enables the port: 115200 baud, 8 data bits, no parity.
pub fn init() {
    UART.write::<{ register::BAUD_DIVISOR }>(crate::board::CLOCK_HZ / BAUD);
    UART.write::<{ register::CONTROL }>(ENABLE_TX_RX_TX_INTERRUPT);
    board::unmask(UART_TX_IRQ);
}

/// Returns the bytes to send; the writer of the log starts its frames on it.
pub(crate) const fn ring() -> &'static Ring<4096> {
    &RING
}

/// Starts sending the buffered bytes.
pub(crate) fn start() {
    board::pend(UART_TX_IRQ);
}

/// Handles the interrupt of the transmitter: sends some of the buffered bytes.
pub(crate) fn transmit() {
    UART.write::<{ register::INT_CLEAR }>(TX_INTERRUPT);
    for _ in 0..BURST {
        if UART.read::<{ register::STATE }>() & TX_FULL != 0 {
            return;
        }
        let Some(byte) = RING.pop() else { return };
        UART.write::<{ register::DATA }>(u32::from(byte));
    }
    // no interrupt comes if the port took the last byte before its interrupt was cleared
    if !RING.is_empty() {
        start();
    }
}

/// Sends the buffered bytes by polling, for the end of a program; gives up when the port takes no byte.
pub fn flush() {
    critical_section::with(|_| {
        while !RING.is_empty() {
            let is_free = || UART.read::<{ register::STATE }>() & TX_FULL == 0;
            if !(0..FULL_POLLS).any(|_| is_free()) {
                return;
            }
            if let Some(byte) = RING.pop() {
                UART.write::<{ register::DATA }>(u32::from(byte));
            }
        }
    });
}

/// Returns the received byte, if there is one.
#[must_use]
pub fn read() -> Option<u8> {
    let has_come = UART.read::<{ register::STATE }>() & RX_FULL != 0;
    has_come.then(|| UART.read::<{ register::DATA }>().to_le_bytes()[0])
}

/// A text writer to the serial port.
#[derive(Clone, Copy, Debug)]
pub struct Text;

impl fmt::Write for Text {
    fn write_str(&mut self, text: &str) -> fmt::Result {
        critical_section::with(|_| RING.frame(|frame| frame.extend(text.as_bytes())));
        start();
        Ok(())
    }
}
