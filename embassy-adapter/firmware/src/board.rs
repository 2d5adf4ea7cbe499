//! The addresses and interrupts of the chosen board's peripherals.
//!
//! ```text
//!               CPU   Ethernet     IRQ  UART 0       IRQ  FPGA I/O     watchdog     clock     code         memory       external
//!  mps2-an385   M3    0x4020_0000  13   0x4000_4000  1    0x4002_8000  0x4000_8000  25 MHz    0            0x2000_0000  0x2100_0000
//!  mps2-an386   M4F   0x4020_0000  13   0x4000_4000  1    0x4002_8000  0x4000_8000  25 MHz    0            0x2000_0000  0x2100_0000
//!  mps2-an505   M33   0x5200_0000  48   0x5020_0000  33   0x5030_2000  0x5008_1000  20 MHz    0x1000_0000  0x3800_0000  0x8000_0000
//! ```
//!
//! The external memory, 16 MiB, stands for a flash (`flash`).
#![expect(unsafe_code, reason = "this is where addresses become peripherals")]

use crate::mmio::Block;

#[cfg(not(any(feature = "mps2-an385", feature = "mps2-an386", feature = "mps2-an505")))]
compile_error!("choose a board: one of the features mps2-an385, mps2-an386, mps2-an505");
#[cfg(all(feature = "mps2-an505", any(feature = "mps2-an385", feature = "mps2-an386")))]
compile_error!("choose one board: with mps2-an505, build with --no-default-features");
#[cfg(all(feature = "console", feature = "lines"))]
compile_error!("the console and the robot's line are one port: choose one of the features console and lines");
#[cfg(all(feature = "update", feature = "mps2-an505"))]
compile_error!("the image for updates is linked for the memory of mps2-an385 and mps2-an386");

#[cfg(not(feature = "mps2-an505"))]
mod chosen {
    pub(super) const ETHERNET: usize = 0x4020_0000;
    pub(super) const ETHERNET_IRQ: u16 = 13;
    pub(super) const UART: usize = 0x4000_4000;
    pub(super) const UART_TX_IRQ: u16 = 1;
    #[cfg(any(feature = "console", feature = "lines"))]
    pub(super) const CONSOLE_UART: usize = 0x4000_5000;
    #[cfg(any(feature = "console", feature = "lines"))]
    pub(super) const CONSOLE_RX_IRQ: u16 = 2;
    #[cfg(any(feature = "console", feature = "lines"))]
    pub(super) const CONSOLE_TX_IRQ: u16 = 3;
    #[cfg(feature = "lines")]
    pub(super) const UART_2: usize = 0x4000_6000;
    #[cfg(feature = "lines")]
    pub(super) const UART_2_RX_IRQ: u16 = 4;
    #[cfg(feature = "lines")]
    pub(super) const UART_2_TX_IRQ: u16 = 5;
    pub(super) const FPGA_IO: usize = 0x4002_8000;
    pub(super) const WATCHDOG: usize = 0x4000_8000;
    pub(super) const CLOCK_HZ: u32 = 25_000_000;
    #[cfg(feature = "console")]
    pub(super) const FLASH: usize = 0x2100_0000;
}

#[cfg(feature = "mps2-an505")]
mod chosen {
    pub(super) const ETHERNET: usize = 0x5200_0000;
    pub(super) const ETHERNET_IRQ: u16 = 48;
    pub(super) const UART: usize = 0x5020_0000;
    pub(super) const UART_TX_IRQ: u16 = 33;
    #[cfg(any(feature = "console", feature = "lines"))]
    pub(super) const CONSOLE_UART: usize = 0x5020_1000;
    #[cfg(any(feature = "console", feature = "lines"))]
    pub(super) const CONSOLE_RX_IRQ: u16 = 34;
    #[cfg(any(feature = "console", feature = "lines"))]
    pub(super) const CONSOLE_TX_IRQ: u16 = 35;
    #[cfg(feature = "lines")]
    pub(super) const UART_2: usize = 0x5020_2000;
    #[cfg(feature = "lines")]
    pub(super) const UART_2_RX_IRQ: u16 = 36;
    #[cfg(feature = "lines")]
    pub(super) const UART_2_TX_IRQ: u16 = 37;
    pub(super) const FPGA_IO: usize = 0x5030_2000;
    pub(super) const WATCHDOG: usize = 0x5008_1000;
    pub(super) const CLOCK_HZ: u32 = 20_000_000;
    #[cfg(feature = "console")]
    pub(super) const FLASH: usize = 0x8000_0000;
}

// SAFETY: the LAN9118 moves frames through its registers only; it is not a bus master
pub(crate) const ETHERNET: Block = unsafe { Block::new(chosen::ETHERNET) };
// SAFETY: a serial port without DMA
pub(crate) const UART: Block = unsafe { Block::new(chosen::UART) };
// SAFETY: a serial port without DMA
#[cfg(any(feature = "console", feature = "lines"))]
pub(crate) const CONSOLE_UART: Block = unsafe { Block::new(chosen::CONSOLE_UART) };
// SAFETY: a serial port without DMA
#[cfg(feature = "lines")]
pub(crate) const UART_2: Block = unsafe { Block::new(chosen::UART_2) };
// SAFETY: counters, LEDs and switches
pub(crate) const FPGA_IO: Block = unsafe { Block::new(chosen::FPGA_IO) };
// SAFETY: a counter
pub(crate) const WATCHDOG: Block = unsafe { Block::new(chosen::WATCHDOG) };

/// The interrupt of the Ethernet controller.
pub(crate) const ETHERNET_IRQ: Irq = Irq(chosen::ETHERNET_IRQ);
/// The interrupt of the serial port's transmitter.
pub(crate) const UART_TX_IRQ: Irq = Irq(chosen::UART_TX_IRQ);
/// The interrupts of the second serial port's receiver and transmitter.
#[cfg(any(feature = "console", feature = "lines"))]
pub(crate) const CONSOLE_RX_IRQ: Irq = Irq(chosen::CONSOLE_RX_IRQ);
#[cfg(any(feature = "console", feature = "lines"))]
pub(crate) const CONSOLE_TX_IRQ: Irq = Irq(chosen::CONSOLE_TX_IRQ);
/// The interrupts of the third serial port's receiver and transmitter.
#[cfg(feature = "lines")]
pub(crate) const UART_2_RX_IRQ: Irq = Irq(chosen::UART_2_RX_IRQ);
#[cfg(feature = "lines")]
pub(crate) const UART_2_TX_IRQ: Irq = Irq(chosen::UART_2_TX_IRQ);
/// The memory that stands for a flash.
#[cfg(feature = "console")]
pub(crate) const FLASH: usize = chosen::FLASH;
/// The clock of the core, and of SysTick.
pub const CLOCK_HZ: u32 = chosen::CLOCK_HZ;

/// The number of an interrupt of the board.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Irq(u16);

// SAFETY: the numbers match the board, and never change
unsafe impl cortex_m::interrupt::InterruptNumber for Irq {
    fn number(self) -> u16 {
        self.0
    }
}

/// Unmasks an interrupt.
pub(crate) fn unmask(irq: Irq) {
    // SAFETY: no critical section is made with this mask
    unsafe { cortex_m::peripheral::NVIC::unmask(irq) };
}

/// Clears a pending interrupt, until it is raised again.
pub(crate) fn unpend(irq: Irq) {
    cortex_m::peripheral::NVIC::unpend(irq);
}

/// Pends an interrupt, so its handler runs.
pub(crate) fn pend(irq: Irq) {
    cortex_m::peripheral::NVIC::pend(irq);
}
