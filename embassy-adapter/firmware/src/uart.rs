//! The serial port: received bytes, and a buffer for bytes to send.
//!
//! ```text
//!  log, text ─► ring of the log, 4 KiB ─► interrupt of the transmitter ─► port
//! ```
//!
//! Writing copies into the buffer and never waits. Bytes that do not fit are dropped together with the rest of their frame,
//! and counted. After a fault, with interrupts disabled, [`flush`] sends the buffer by polling.

use core::fmt;

use bcap_board::log;
use bcap_board::ring::Ring;

use crate::board::{self, Irq, UART, UART_TX_IRQ};
use crate::mmio::Block;

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
#[cfg(any(feature = "console", feature = "lines"))]
const RX_INTERRUPT_ENABLE: u32 = 1 << 3;
const TX_INTERRUPT: u32 = 1 << 0;
#[cfg(any(feature = "console", feature = "lines"))]
const RX_INTERRUPT: u32 = 1 << 1;
const BAUD: u32 = 115_200;
/// The maximum number of bytes sent in one interrupt: the port has room for one or two, an emulated port has room for all.
const BURST: usize = 16;
/// Number of polls of a port that takes no byte, before [`flush`] ends: more than the time of a character.
const FULL_POLLS: u32 = 100_000;

/// Enables the port: 115200 baud, 8 data bits, no parity.
pub fn init() {
    UART.write::<{ register::BAUD_DIVISOR }>(crate::board::CLOCK_HZ / BAUD);
    UART.write::<{ register::CONTROL }>(ENABLE_TX_RX_TX_INTERRUPT);
    board::unmask(UART_TX_IRQ);
    log::on_frame(start);
}

/// Starts sending the buffered bytes.
fn start() {
    board::pend(UART_TX_IRQ);
}

/// Handles the interrupt of the transmitter.
pub(crate) fn transmit() {
    transmit_to(UART, UART_TX_IRQ, log::ring());
}

/// Sends some of the buffered bytes to a port, in the interrupt of its transmitter.
pub(crate) fn transmit_to<const SIZE: usize>(port: Block, irq: Irq, ring: &Ring<SIZE>) {
    port.write::<{ register::INT_CLEAR }>(TX_INTERRUPT);
    for _ in 0..BURST {
        if port.read::<{ register::STATE }>() & TX_FULL != 0 {
            return;
        }
        let Some(byte) = ring.pop() else { return };
        port.write::<{ register::DATA }>(u32::from(byte));
    }
    // no interrupt follows if the port took the last byte before its interrupt was cleared
    if !ring.is_empty() {
        board::pend(irq);
    }
}

/// Sends the buffered bytes by polling, for the end of a program; ends early if the port takes no byte.
pub fn flush() {
    flush_to(UART, log::ring());
}

/// Sends the buffered bytes to a port by polling.
pub(crate) fn flush_to<const SIZE: usize>(port: Block, ring: &Ring<SIZE>) {
    critical_section::with(|_| {
        while !ring.is_empty() {
            let is_free = || port.read::<{ register::STATE }>() & TX_FULL == 0;
            if !(0..FULL_POLLS).any(|_| is_free()) {
                return;
            }
            if let Some(byte) = ring.pop() {
                port.write::<{ register::DATA }>(u32::from(byte));
            }
        }
    });
}

/// Enables another port in the same way, with an interrupt for each received byte.
#[cfg(any(feature = "console", feature = "lines"))]
pub(crate) fn enable(port: Block) {
    port.write::<{ register::BAUD_DIVISOR }>(crate::board::CLOCK_HZ / BAUD);
    port.write::<{ register::CONTROL }>(ENABLE_TX_RX_TX_INTERRUPT | RX_INTERRUPT_ENABLE);
}

/// Returns the received byte, if there is one.
#[must_use]
pub fn read() -> Option<u8> {
    received(UART)
}

/// Returns the received byte of another port, in the interrupt of its receiver.
#[cfg(any(feature = "console", feature = "lines"))]
pub(crate) fn receive_from(port: Block) -> Option<u8> {
    port.write::<{ register::INT_CLEAR }>(RX_INTERRUPT);
    received(port)
}

fn received(port: Block) -> Option<u8> {
    let has_come = port.read::<{ register::STATE }>() & RX_FULL != 0;
    has_come.then(|| port.read::<{ register::DATA }>().to_le_bytes()[0])
}

/// A text writer to the serial port.
#[derive(Clone, Copy, Debug)]
pub struct Text;

impl fmt::Write for Text {
    fn write_str(&mut self, text: &str) -> fmt::Result {
        critical_section::with(|_| log::ring().frame(|frame| frame.extend(text.as_bytes())));
        start();
        Ok(())
    }
}
