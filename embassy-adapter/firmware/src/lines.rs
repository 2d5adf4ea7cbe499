//! The second and the third serial port: lines to a robot and to a PLC, or the console.
//!
//! ```text
//!  port ─► interrupt ─► ring ─► Line::read     Line::write ─► ring ─► interrupt ─► port
//! ```

use core::convert::Infallible;
use core::future::poll_fn;
use core::task::Poll;

use bcap_board::ring::Ring;
use cortex_m::interrupt::InterruptNumber as _;
use embassy_sync::waitqueue::AtomicWaker;
use embedded_io_async::{ErrorType, Read, Write};

use crate::board::{self, CONSOLE_RX_IRQ, CONSOLE_TX_IRQ, CONSOLE_UART, Irq};
#[cfg(feature = "lines")]
use crate::board::{UART_2, UART_2_RX_IRQ, UART_2_TX_IRQ};
use crate::mmio::Block;
use crate::uart;

/// The console, or the line to the robot.
static SECOND: Port = {
    static RECEIVED: Ring<1024> = Ring::new();
    static TO_SEND: Ring<4096> = Ring::new();
    Port::new(CONSOLE_UART, [CONSOLE_RX_IRQ, CONSOLE_TX_IRQ], &RECEIVED, &TO_SEND)
};
#[cfg(feature = "lines")]
static THIRD: Port = {
    static RECEIVED: Ring<1024> = Ring::new();
    static TO_SEND: Ring<4096> = Ring::new();
    Port::new(UART_2, [UART_2_RX_IRQ, UART_2_TX_IRQ], &RECEIVED, &TO_SEND)
};
#[cfg(feature = "lines")]
static PORTS: [&Port; 2] = [&SECOND, &THIRD];
#[cfg(not(feature = "lines"))]
static PORTS: [&Port; 1] = [&SECOND];

/// A serial port with its buffers, which are zero at the start and so take no flash.
struct Port {
    uart: Block,
    receiver: Irq,
    transmitter: Irq,
    /// More than a frame, which arrives while the board runs its other tasks.
    received: &'static Ring<1024>,
    /// More than the answers to the pending requests, and more than all settings.
    to_send: &'static Ring<4096>,
    waker: AtomicWaker,
}

impl Port {
    const fn new(
        uart: Block,
        [receiver, transmitter]: [Irq; 2],
        received: &'static Ring<1024>,
        to_send: &'static Ring<4096>,
    ) -> Self {
        Self { uart, receiver, transmitter, received, to_send, waker: AtomicWaker::new() }
    }
}

/// A line. Its `read` is cancel-safe.
#[derive(Clone, Copy)]
pub struct Line(&'static Port);

impl Line {
    /// Starts the second port, of 115,200 baud: the console, or the line to the robot. Call it once.
    #[must_use]
    pub fn second() -> Self {
        Self::start(&SECOND)
    }

    /// Starts the third port, of 115,200 baud: the line to the PLC. Call it once.
    #[cfg(feature = "lines")]
    #[must_use]
    pub fn third() -> Self {
        Self::start(&THIRD)
    }

    /// Sends the buffered bytes by polling, for the end of a program.
    #[cfg(feature = "console")]
    pub(crate) fn flush_second() {
        uart::flush_to(SECOND.uart, SECOND.to_send);
    }

    fn start(port: &'static Port) -> Self {
        uart::enable(port.uart);
        board::unmask(port.receiver);
        board::unmask(port.transmitter);
        Self(port)
    }
}

impl core::fmt::Debug for Line {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str("Line")
    }
}

impl ErrorType for Line {
    type Error = Infallible;
}

impl Read for Line {
    async fn read(&mut self, buffer: &mut [u8]) -> Result<usize, Infallible> {
        poll_fn(|context| {
            self.0.waker.register(context.waker());
            let mut count = 0;
            for (to, from) in buffer.iter_mut().zip(core::iter::from_fn(|| self.0.received.pop())) {
                *to = from;
                count += 1;
            }
            if count > 0 { Poll::Ready(Ok(count)) } else { Poll::Pending }
        })
        .await
    }
}

impl Write for Line {
    /// Never waits; bytes without room are lost, as on a line whose other end is gone.
    async fn write(&mut self, bytes: &[u8]) -> Result<usize, Infallible> {
        self.0.to_send.frame(|frame| frame.extend(bytes));
        board::pend(self.0.transmitter);
        Ok(bytes.len())
    }

    async fn flush(&mut self) -> Result<(), Infallible> {
        Ok(())
    }
}

/// Handles an interrupt; `false` if it is not one of these ports.
pub(crate) fn handle(number: i16) -> bool {
    let is = |irq: Irq| number == irq.number().cast_signed();
    for port in PORTS {
        if is(port.receiver) {
            while let Some(byte) = uart::receive_from(port.uart) {
                port.received.frame(|frame| frame.extend(&[byte]));
            }
            port.waker.wake();
            return true;
        }
        if is(port.transmitter) {
            uart::transmit_to(port.uart, port.transmitter, port.to_send);
            return true;
        }
    }
    false
}
