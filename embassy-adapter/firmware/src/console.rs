//! The second serial port, on which a host changes the settings; [`bcap_board::console`] documents the protocol.
//!
//! ```text
//!  port ─► interrupt ─► RECEIVED ─► Console ─► RING ─► interrupt ─► port
//! ```

use core::convert::Infallible;
use core::future::poll_fn;
use core::task::Poll;

use bcap_board::console::{Action, Console};
use bcap_board::memory;
use bcap_board::ring::Ring;
use cortex_m::peripheral::SCB;
use embassy_sync::waitqueue::AtomicWaker;
use static_cell::StaticCell;

use crate::board::{self, CONSOLE_RX_IRQ, CONSOLE_TX_IRQ, CONSOLE_UART};
use crate::flash::{self, Flash};
use crate::uart;

/// Received bytes: more than arrive while the board runs its other tasks.
static RECEIVED: Ring<256> = Ring::new();
/// Answers: more than all settings.
static RING: Ring<4096> = Ring::new();
static WAKER: AtomicWaker = AtomicWaker::new();

/// Serves the console. Call it once.
pub async fn run() -> ! {
    static CONSOLE: StaticCell<Console<'static, Flash>> = StaticCell::new();
    let slots = match flash::slots() {
        Ok(slots) => slots,
        Err(error) => {
            defmt::error!("no console: {}", defmt::Display2Format(&error));
            core::future::pending().await
        }
    };
    let console = CONSOLE.init_with(|| Console::new(slots, memory::image()));
    uart::enable(CONSOLE_UART);
    board::unmask(CONSOLE_RX_IRQ);
    board::unmask(CONSOLE_TX_IRQ);
    loop {
        let Ok(action) = console.receive(next().await, &mut Port);
        if let Some(Action::Restart) = action {
            defmt::info!("restart to use the settings");
            uart::flush_to(CONSOLE_UART, &RING);
            uart::flush();
            SCB::sys_reset();
        }
    }
}

/// Waits for a received byte.
async fn next() -> u8 {
    poll_fn(|context| {
        WAKER.register(context.waker());
        RECEIVED.pop().map_or(Poll::Pending, Poll::Ready)
    })
    .await
}

/// Handles the interrupt of the receiver.
pub(crate) fn receive() {
    while let Some(byte) = uart::receive_from(CONSOLE_UART) {
        RECEIVED.frame(|frame| frame.extend(&[byte]));
    }
    WAKER.wake();
}

/// Handles the interrupt of the transmitter.
pub(crate) fn transmit() {
    uart::transmit_to(CONSOLE_UART, CONSOLE_TX_IRQ, &RING);
}

/// Writes answers to the port.
struct Port;

impl embedded_io::ErrorType for Port {
    type Error = Infallible;
}

impl embedded_io::Write for Port {
    fn write(&mut self, bytes: &[u8]) -> Result<usize, Infallible> {
        RING.frame(|frame| frame.extend(bytes));
        board::pend(CONSOLE_TX_IRQ);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> Result<(), Infallible> {
        Ok(())
    }
}
