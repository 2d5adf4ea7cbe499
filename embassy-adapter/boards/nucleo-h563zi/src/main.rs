//! The gateway on ST's Nucleo-H563ZI with its own Ethernet. README.md has the first test.
#![no_std]
#![no_main]
#![forbid(unsafe_code)]

mod chip;

use core::panic::PanicInfo;

use bcap_board::gateway::{self, Board};
use bcap_board::parts::Parts;
use bcap_board::slots::Slots;
use bcap_board::{address, config, fault, led, mac, memory, network, port, stack};
use cortex_m::peripheral::SCB;
use embassy_executor::{Executor, Spawner};
use embassy_futures::join::join;
use embassy_net::{Stack, StackResources};
use embassy_stm32::eth::{Ethernet, GenericPhy, PacketQueue, Sma};
use embassy_stm32::flash::{Bank2Region, Blocking, Flash};
use embassy_stm32::gpio::{Level, Output, Speed};
use embassy_stm32::peripherals::{ETH, ETH_SMA, IWDG};
use embassy_stm32::rng::Rng;
use embassy_stm32::usart::{BufferedUart, BufferedUartTx};
use embassy_stm32::wdg::IndependentWatchdog;
use embassy_stm32::{Peripherals, uid, usart};
use static_cell::{ConstStaticCell, StaticCell};

use self::chip::Irqs;

/// The last two sectors of the second bank; `memory.x` leaves them out.
const SETTINGS: core::ops::Range<u32> = 0xf_c000..0x10_0000;
/// Longer than the flash takes to erase both sectors.
const WATCHDOG_MICROS: u32 = 8_000_000;

type BoardFlash = Bank2Region<'static, Blocking>;
type Device = Ethernet<'static, ETH, GenericPhy<Sma<'static, ETH_SMA>>>;
type Watchdog = IndependentWatchdog<'static, IWDG>;

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
    let p = embassy_stm32::init(chip::clocks());
    EXECUTOR.init(Executor::new()).run(|spawner| {
        if start(spawner, p).is_none() {
            defmt::error!("a part of the board did not start; the watchdog resets it");
        }
    })
}

#[inline(never)]
fn start(spawner: Spawner, p: Peripherals) -> Option<()> {
    static RESOURCES: StaticCell<StackResources<{ gateway::SOCKETS }>> = StaticCell::new();
    static PACKETS: ConstStaticCell<PacketQueue<2, 4>> = ConstStaticCell::new(PacketQueue::new());
    static UARTS: ConstStaticCell<[[u8; 256]; 4]> = ConstStaticCell::new([[0; 256]; 4]);

    let mut watchdog = IndependentWatchdog::new(p.IWDG, WATCHDOG_MICROS);
    watchdog.unleash();
    let parts = Parts::after(memory::record().take(), env!("CARGO_PKG_NAME"), env!("CARGO_PKG_VERSION"));
    let flash = Flash::new_blocking(p.FLASH).into_blocking_regions().bank2_region;
    let mut slots = Slots::new(flash, SETTINGS).ok()?;
    let settings = config::load(Some(&mut slots), config::log);
    let [console_tx, console_rx, log_tx, log_rx] = UARTS.take();
    let baud = usart::Config::default();
    let console = BufferedUart::new(p.USART3, p.PD9, p.PD8, console_tx, console_rx, Irqs, baud).ok()?;
    let log = BufferedUart::new(p.USART1, p.PB7, p.PB6, log_tx, log_rx, Irqs, baud).ok()?;
    spawner.spawn(serve(slots, console, log.split().0).ok()?);

    let address = settings.mac.unwrap_or_else(|| mac::from_unique_id(&uid::uid()));
    let device = Ethernet::new(
        PACKETS.take(),
        p.ETH,
        Irqs,
        p.PA1,
        p.PA7,
        p.PC4,
        p.PC5,
        p.PG13,
        p.PB15,
        p.PG11,
        address,
        p.ETH_SMA,
        p.PA2,
        p.PC1,
    );
    let (resources, seed) = (RESOURCES.init_with(StackResources::new), Rng::new(p.RNG, Irqs).next_u64());
    let (net, runner) = network::start(device, settings, resources, seed);
    spawner.spawn(run_network(runner).ok()?);
    let board = gateway::start(spawner, net, settings, parts, address::DHCP_AGAIN).ok()?;
    spawner.spawn(watch(board, watchdog, Output::new(p.PB0, Level::Low, Speed::Low), net).ok()?);
    stack::repaint();
    Some(())
}

/// The console on the serial port of the ST-Link, the log on D1.
#[embassy_executor::task]
async fn serve(slots: Slots<BoardFlash>, console: BufferedUart<'static>, log: BufferedUartTx<'static>) {
    let (sender, receiver) = console.split();
    port::run(slots, receiver, sender, log, || SCB::sys_reset()).await;
}

#[embassy_executor::task]
async fn run_network(mut stack: network::Runner<Device>) {
    gateway::run_network(stack.run()).await;
}

#[embassy_executor::task]
async fn watch(board: &'static Board, mut watchdog: Watchdog, led: Output<'static>, net: Stack<'static>) {
    let watch = gateway::watch(board, network::SILENCE, || watchdog.pet());
    join(watch, led::run(led, || gateway::led_state(board, net))).await;
}
