//! The gateway on WIZnet's W5500-EVB-Pico2: an RP2350 with a W5500. README.md has the wiring and the first test.
#![no_std]
#![no_main]
#![forbid(unsafe_code)]

use core::panic::PanicInfo;

use bcap_board::gateway::{self, Board};
use bcap_board::parts::Parts;
use bcap_board::slots::Slots;
use bcap_board::{address, config, fault, led, mac, memory, network, stack, usb, w5500};
use cortex_m::peripheral::SCB;
use embassy_executor::{Executor, Spawner};
use embassy_futures::join::join;
use embassy_net::{Stack, StackResources};
use embassy_rp::clocks::RoscRng;
use embassy_rp::flash::{Blocking, Flash};
use embassy_rp::gpio::{Input, Level, Output, Pull};
use embassy_rp::peripherals::{DMA_CH0, DMA_CH1, FLASH, SPI0, USB};
use embassy_rp::spi::{self, Async, Spi};
use embassy_rp::usb::{Driver, InterruptHandler};
use embassy_rp::watchdog::Watchdog;
use embassy_rp::{Peripherals, bind_interrupts, dma, otp};
use embassy_time::{Delay, Duration};
use embedded_hal_bus::spi::ExclusiveDevice;
use static_cell::StaticCell;

bind_interrupts!(struct Irqs {
    USBCTRL_IRQ => InterruptHandler<USB>;
    DMA_IRQ_0 => dma::InterruptHandler<DMA_CH0>, dma::InterruptHandler<DMA_CH1>;
});

const FLASH_SIZE: usize = 2 * 1024 * 1024;
/// The last two sectors; `memory.x` leaves them out.
const SETTINGS: core::ops::Range<u32> = 0x1f_e000..0x20_0000;
const WATCHDOG_TIME: Duration = Duration::from_secs(8);

type BoardFlash = Flash<'static, FLASH, Blocking, FLASH_SIZE>;
type Bus = ExclusiveDevice<Spi<'static, SPI0, Async>, Output<'static>, Delay>;
type Ethernet = w5500::ChipRunner<'static, Bus, Input<'static>, Output<'static>>;
type Net = network::Runner<w5500::Device<'static>>;

#[panic_handler]
fn panic(info: &PanicInfo<'_>) -> ! {
    fault::panicked(info)
}

#[cortex_m_rt::entry]
fn main() -> ! {
    stack::run(program)
}

extern "C" fn program() -> ! {
    static EXECUTOR: StaticCell<Executor> = StaticCell::new();
    let parts = embassy_rp::init(Default::default());
    EXECUTOR.init(Executor::new()).run(|spawner| {
        if let Ok(start) = start(spawner, parts) {
            spawner.spawn(start);
        }
    })
}

/// Starts everything. It is a separate task, because the initialisation of the W5500 waits for SPI and timers.
#[embassy_executor::task]
async fn start(spawner: Spawner, parts: Peripherals) {
    if run(spawner, parts).await.is_none() {
        defmt::error!("the W5500 does not answer, or a task did not start; the watchdog resets the board");
    }
}

async fn run(spawner: Spawner, p: Peripherals) -> Option<()> {
    static RESOURCES: StaticCell<StackResources<{ gateway::SOCKETS }>> = StaticCell::new();
    static FRAMES: StaticCell<w5500::State<2, 1>> = StaticCell::new();

    let mut watchdog = Watchdog::new(p.WATCHDOG);
    watchdog.start(WATCHDOG_TIME);
    let parts = Parts::after(memory::record().take(), env!("CARGO_PKG_NAME"), env!("CARGO_PKG_VERSION"));
    let flash = BoardFlash::new_blocking(p.FLASH);
    let id = otp::get_chipid().ok()?.to_le_bytes();
    let mut slots = Slots::new(flash, SETTINGS).ok()?;
    let settings = config::load(Some(&mut slots), config::log);
    spawner.spawn(serve_usb(Driver::new(p.USB, Irqs), slots).ok()?);

    let mut frequency = spi::Config::default();
    frequency.frequency = 30_000_000;
    let spi = Spi::new(p.SPI0, p.PIN_18, p.PIN_19, p.PIN_16, p.DMA_CH0, p.DMA_CH1, Irqs, frequency);
    let bus = ExclusiveDevice::new(spi, Output::new(p.PIN_17, Level::High), Delay).ok()?;
    let (interrupt, reset) = (Input::new(p.PIN_21, Pull::Up), Output::new(p.PIN_20, Level::High));
    let address = settings.mac.unwrap_or_else(|| mac::from_unique_id(&id));
    let frames = FRAMES.init_with(w5500::State::new);
    let (device, ethernet) = w5500::new(address, frames, bus, interrupt, reset).await.ok()?;
    let resources = RESOURCES.init_with(StackResources::new);
    let (net, runner) = network::start(device, settings, resources, RoscRng.next_u64());

    spawner.spawn(run_network(ethernet, runner).ok()?);
    let board = gateway::start(spawner, net, settings, parts, address::DHCP_AGAIN).ok()?;
    spawner.spawn(watch(board, watchdog, Output::new(p.PIN_25, Level::Low), net).ok()?);
    stack::repaint();
    Some(())
}

#[embassy_executor::task]
async fn serve_usb(driver: Driver<'static, USB>, slots: Slots<BoardFlash>) {
    usb::run(driver, slots, || SCB::sys_reset()).await;
}

#[embassy_executor::task]
async fn run_network(ethernet: Ethernet, mut stack: Net) {
    gateway::run_network(join(ethernet.run(), stack.run())).await;
}

#[embassy_executor::task]
async fn watch(board: &'static Board, mut watchdog: Watchdog, led: Output<'static>, net: Stack<'static>) {
    let watch = gateway::watch(board, network::SILENCE, || watchdog.feed(WATCHDOG_TIME));
    join(watch, led::run(led, || gateway::led_state(board, net))).await;
}
