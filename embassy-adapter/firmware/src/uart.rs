//! The serial port, for plain text or for defmt frames.
//!
//! Sending blocks until each byte is sent. That is acceptable for the log of a demonstration; a production image would
//! use a buffer and an interrupt.
#![expect(unsafe_code, reason = "defmt's logger is an unsafe trait")]

use core::cell::RefCell;
use core::fmt;

use critical_section::{Mutex, RestoreState};

use crate::board::UART;

/// Registers of the CMSDK serial port.
mod register {
    pub(super) const DATA: usize = 0x00;
    pub(super) const STATE: usize = 0x04;
    pub(super) const CONTROL: usize = 0x08;
    pub(super) const BAUD_DIVISOR: usize = 0x10;
}

const TX_FULL: u32 = 1 << 0;
const RX_FULL: u32 = 1 << 1;
const ENABLE_TX_RX: u32 = 0b11;
const BAUD: u32 = 115_200;

/// Enables the port: 115200 baud, 8 data bits, no parity.
pub fn init() {
    UART.write::<{ register::BAUD_DIVISOR }>(crate::board::CLOCK_HZ / BAUD);
    UART.write::<{ register::CONTROL }>(ENABLE_TX_RX);
}

/// Sends bytes, blocking.
pub fn write(bytes: &[u8]) {
    for byte in bytes {
        while UART.read::<{ register::STATE }>() & TX_FULL != 0 {}
        UART.write::<{ register::DATA }>(u32::from(*byte));
    }
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
        write(text.as_bytes());
        Ok(())
    }
}

/// defmt's logger on the port; the state is `None` while no frame is being written.
static FRAMES: Mutex<RefCell<Frames>> =
    Mutex::new(RefCell::new(Frames { encoder: defmt::Encoder::new(), restore: None }));

struct Frames {
    encoder: defmt::Encoder,
    /// The critical section around a frame.
    restore: Option<RestoreState>,
}

#[defmt::global_logger]
struct Logger;

// SAFETY: each frame is written inside one critical section, so frames do not interleave
unsafe impl defmt::Logger for Logger {
    fn acquire() {
        // SAFETY: `release` ends the section
        let restore = unsafe { critical_section::acquire() };
        with(|frames| {
            frames.restore = Some(restore);
            frames.encoder.start_frame(write);
        });
    }

    unsafe fn flush() {}

    unsafe fn release() {
        let restore = with(|frames| {
            frames.encoder.end_frame(write);
            frames.restore.take()
        });
        if let Some(Some(restore)) = restore {
            // SAFETY: this is the state that `acquire` returned
            unsafe { critical_section::release(restore) };
        }
    }

    unsafe fn write(bytes: &[u8]) {
        with(|frames| frames.encoder.write(bytes, write));
    }
}

/// Returns the encoder; `None` when a log statement is nested in another, whose bytes are then lost.
fn with<T>(work: impl FnOnce(&mut Frames) -> T) -> Option<T> {
    critical_section::with(|cs| FRAMES.borrow(cs).try_borrow_mut().ok().map(|mut frames| work(&mut frames)))
}

defmt::timestamp!("{=u64:us}", embassy_time::Instant::now().as_micros());
