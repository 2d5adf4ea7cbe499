//! The gateway on an ESP32-C3 with a W5500. README.md has the wiring and the first test.
#![no_std]
#![no_main]
#![forbid(unsafe_code)]

use core::panic::PanicInfo;

use bcap_board::gateway::{self, Board};
use bcap_board::parts::Parts;
use bcap_board::slots::Slots;
use bcap_board::{address, config, led, mac, memory, network, port, w5500};
use embassy_executor::Spawner;
use embassy_futures::join::join;
use embassy_net::{Stack, StackResources};
use embassy_time::Delay;
use embedded_hal_bus::spi::ExclusiveDevice;
use esp_hal::Async;
use esp_hal::gpio::{Input, InputConfig, Level, Output, OutputConfig, Pull};
use esp_hal::peripherals::Peripherals;
use esp_hal::rng::Rng;
use esp_hal::rtc_cntl::{Rtc, Rwdt, RwdtStage};
use esp_hal::spi::master::{self, Spi};
use esp_hal::system::software_reset;
use esp_hal::time::{Duration, Rate};
use esp_hal::timer::timg::TimerGroup;
use esp_hal::uart::{self, UartTx};
use esp_hal::usb::usb_serial_jtag::UsbSerialJtag;
use esp_hal::{clock::CpuClock, efuse};
use esp_storage::FlashStorage;
use static_cell::StaticCell;

esp_bootloader_esp_idf::esp_app_desc!();

/// The first two sectors of the partition `nvs`, which this image does not use otherwise.
const SETTINGS: core::ops::Range<u32> = 0x9000..0xb000;

type Bus = ExclusiveDevice<Spi<'static, Async>, Output<'static>, Delay>;
type Ethernet = w5500::ChipRunner<'static, Bus, Input<'static>, Output<'static>>;
type Net = network::Runner<w5500::Device<'static>>;

#[panic_handler]
fn panic(info: &PanicInfo<'_>) -> ! {
    memory::record().write_panic(info);
    defmt::error!("panic: {}", defmt::Display2Format(info));
    software_reset()
}

#[esp_rtos::main]
async fn main(spawner: Spawner) {
    let p = esp_hal::init(esp_hal::Config::default().with_cpu_clock(CpuClock::max()));
    if start(spawner, p).await.is_none() {
        defmt::error!("the W5500 does not answer, or a task did not start; the watchdog resets the board");
    }
    core::future::pending().await
}

async fn start(spawner: Spawner, p: Peripherals) -> Option<()> {
    static RESOURCES: StaticCell<StackResources<{ gateway::SOCKETS }>> = StaticCell::new();
    static FRAMES: StaticCell<w5500::State<2, 1>> = StaticCell::new();

    let mut watchdog = Rtc::new(p.RTC_TIMER).rwdt;
    watchdog.set_timeout(RwdtStage::Stage0, Duration::from_secs(8));
    watchdog.enable();
    esp_rtos::start(TimerGroup::new(p.TIMG0).timer0, p.FROM_CPU_INTR0);
    let parts = Parts::after(memory::record().take(), env!("CARGO_PKG_NAME"), env!("CARGO_PKG_VERSION"));
    let mut slots = Slots::new(FlashStorage::new(p.FLASH), SETTINGS).ok()?;
    let settings = config::load(Some(&mut slots), config::log);
    let console = UsbSerialJtag::new(p.USB_DEVICE).into_async();
    let log = UartTx::new(p.UART0, uart::Config::default()).ok()?.with_tx(p.GPIO21).into_async();
    spawner.spawn(serve(slots, console, log).ok()?);

    let frequency = master::Config::default().with_frequency(Rate::from_mhz(20));
    let spi = Spi::new(p.SPI2, frequency).ok()?.with_sck(p.GPIO6).with_mosi(p.GPIO7).with_miso(p.GPIO2).into_async();
    let bus = ExclusiveDevice::new(spi, Output::new(p.GPIO10, Level::High, OutputConfig::default()), Delay).ok()?;
    let interrupt = Input::new(p.GPIO3, InputConfig::default().with_pull(Pull::Up));
    let reset = Output::new(p.GPIO4, Level::High, OutputConfig::default());
    let address = settings.mac.unwrap_or_else(|| mac::from_unique_id(efuse::base_mac_address().as_bytes()));
    let frames = FRAMES.init_with(w5500::State::new);
    let (device, ethernet) = w5500::new(address, frames, bus, interrupt, reset).await.ok()?;
    let (resources, random) = (RESOURCES.init_with(StackResources::new), Rng::new());
    let seed = u64::from(random.random()) << 32 | u64::from(random.random());
    let (net, runner) = network::start(device, settings, resources, seed);

    spawner.spawn(run_network(ethernet, runner).ok()?);
    let board = gateway::start(spawner, net, settings, parts, address::DHCP_AGAIN).ok()?;
    let led = Output::new(p.GPIO5, Level::Low, OutputConfig::default());
    spawner.spawn(watch(board, watchdog, led, net).ok()?);
    Some(())
}

/// The console on the USB port of the chip, the log on its first serial port.
#[embassy_executor::task]
async fn serve(
    slots: Slots<FlashStorage<'static>>,
    console: UsbSerialJtag<'static, Async>,
    log: UartTx<'static, Async>,
) {
    let (receiver, sender) = console.split();
    port::run(slots, receiver, sender, log, || software_reset()).await;
}

#[embassy_executor::task]
async fn run_network(ethernet: Ethernet, mut stack: Net) {
    gateway::run_network(join(ethernet.run(), stack.run())).await;
}

#[embassy_executor::task]
async fn watch(board: &'static Board, mut watchdog: Rwdt, led: Output<'static>, net: Stack<'static>) {
    let watch = gateway::watch(board, network::SILENCE, || watchdog.feed());
    join(watch, led::run(led, || gateway::led_state(board, net))).await;
}
