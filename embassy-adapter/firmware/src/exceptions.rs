//! The exception handlers: the interrupts of the Ethernet controller and the serial port, and the watchdog's NMI.
//!
//! The linker finds the handlers by name, so no other file refers to this one. SysTick is in [`clock`](crate::clock), and the
//! handler of faults in `bcap_board`.
#![expect(unsafe_code, reason = "handlers of exceptions are unsafe functions")]

use cortex_m::interrupt::InterruptNumber as _;
use cortex_m::peripheral::NVIC;
use cortex_m_rt::exception;

use crate::board::{ETHERNET_IRQ, UART_TX_IRQ};
use crate::{fault, lan9118, uart};

#[exception]
unsafe fn DefaultHandler(number: i16) {
    if number == ETHERNET_IRQ.number().cast_signed() {
        // the line stays active until the driver has read the frame; the driver then unmasks the interrupt
        NVIC::mask(ETHERNET_IRQ);
        lan9118::wake();
    } else if number == UART_TX_IRQ.number().cast_signed() {
        uart::transmit();
    } else if !is_of_line(number) {
        fault::unexpected(number);
    }
}

/// Handles an interrupt of the console or of a line to a robot or a PLC; `false` for other interrupts.
fn is_of_line(number: i16) -> bool {
    #[cfg(any(feature = "console", feature = "lines"))]
    return crate::lines::handle(number);
    #[cfg(not(any(feature = "console", feature = "lines")))]
    {
        let _ = number;
        false
    }
}

/// The NMI, to which only the watchdog is connected.
#[exception]
unsafe fn NonMaskableInt() -> ! {
    fault::hung()
}
