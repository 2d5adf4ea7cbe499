//! The interrupts and the clocks of the chip.

use embassy_stm32::peripherals::{RNG, USART1, USART3};
use embassy_stm32::{Config, bind_interrupts, eth, rcc, rng, usart};

bind_interrupts!(pub(crate) struct Irqs {
    ETH => eth::InterruptHandler;
    RNG => rng::InterruptHandler<RNG>;
    USART1 => usart::BufferedInterruptHandler<USART1>;
    USART3 => usart::BufferedInterruptHandler<USART3>;
});

/// Returns the clocks: 250 MHz from the internal oscillator.
pub(crate) fn clocks() -> Config {
    let mut config = Config::default();
    config.rcc.hsi = Some(rcc::HSIPrescaler::DIV1);
    config.rcc.hsi48 = Some(Default::default());
    config.rcc.pll1 = Some(rcc::Pll {
        source: rcc::PllSource::HSI,
        prediv: rcc::PllPreDiv::DIV16,
        mul: rcc::PllMul::MUL125,
        divp: Some(rcc::PllDiv::DIV2),
        divq: None,
        divr: None,
    });
    config.rcc.sys = rcc::Sysclk::PLL1_P;
    config.rcc.voltage_scale = rcc::VoltageScale::Scale0;
    config
}
