//! The interrupts and the clocks of the chip.

use embassy_stm32::gpio::{Level, OutputOpenDrain, Pull, Speed};
use embassy_stm32::peripherals::{PA12, RNG, USART3, USART6};
use embassy_stm32::time::Hertz;
use embassy_stm32::{Config, Peri, bind_interrupts, eth, rcc, rng, usart};

bind_interrupts!(pub(crate) struct Irqs {
    ETH => eth::InterruptHandler;
    HASH_RNG => rng::InterruptHandler<RNG>;
    USART3 => usart::BufferedInterruptHandler<USART3>;
    USART6 => usart::BufferedInterruptHandler<USART6>;
});

/// Holds PA12 low, without which chips before revision 3 read the second bank of their flash wrongly (erratum 2.2.11 of
/// ES0206).
pub(crate) fn steady_flash(pin: Peri<'static, PA12>) {
    // a pin that is dropped is disconnected
    core::mem::forget(OutputOpenDrain::new_pull(pin, Level::Low, Speed::Low, Pull::Down));
}

/// Returns the clocks: 180 MHz from the 8 MHz that the ST-Link supplies, and 45 MHz for the generator of random numbers.
pub(crate) fn clocks() -> Config {
    let mut config = Config::default();
    config.rcc.hse = Some(rcc::Hse { freq: Hertz(8_000_000), mode: rcc::HseMode::Bypass });
    config.rcc.pll_src = rcc::PllSource::HSE;
    config.rcc.pll = Some(rcc::Pll {
        prediv: rcc::PllPreDiv::DIV4,
        mul: rcc::PllMul::MUL180,
        divp: Some(rcc::PllPDiv::DIV2),
        divq: Some(rcc::PllQDiv::DIV8),
        divr: None,
    });
    config.rcc.sys = rcc::Sysclk::PLL1_P;
    config.rcc.ahb_pre = rcc::AHBPrescaler::DIV1;
    config.rcc.apb1_pre = rcc::APBPrescaler::DIV4;
    config.rcc.apb2_pre = rcc::APBPrescaler::DIV2;
    config
}
