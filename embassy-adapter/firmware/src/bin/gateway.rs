//! The gateway board: connects PLCs that speak RAC to a robot controller that speaks b-CAP.
//!
//! [`bcap_board::gateway`] has its tasks. The settings define the rules for PLCs and the robot's address. By default PLCs may
//! read every variable and write none. A refusal is logged with its client and its line, at most once a second for each
//! client and reason.
#![no_std]
#![no_main]

use bcap_board::gateway::{self, Board};
use bcap_board::parts::Parts;
use bcap_board::stack;
#[cfg(feature = "echo")]
use bcap_firmware::echo;
use bcap_firmware::net::{self, NetRunner};
use bcap_firmware::{config, executor, fault, lan9118, watchdog};
use embassy_executor::{SpawnError, Spawner};
use embassy_net::StackResources;
use static_cell::StaticCell;

const SOCKETS: usize = gateway::SOCKETS + ECHOES;
#[cfg(feature = "echo")]
const ECHOES: usize = echo::ECHOES;
#[cfg(not(feature = "echo"))]
const ECHOES: usize = 0;

#[panic_handler]
fn panic(info: &core::panic::PanicInfo<'_>) -> ! {
    fault::panic_logged(info)
}

#[cortex_m_rt::entry]
fn main() -> ! {
    watchdog::arm();
    stack::run(program)
}

extern "C" fn program() -> ! {
    executor::start(start)
}

/// Starts the board and all tasks.
///
/// Not inlined: otherwise the temporaries of initialisation would stay on the stack forever.
#[inline(never)]
fn start(spawner: Spawner) -> Result<(), SpawnError> {
    // not a `ConstStaticCell`: with a host name in it, the type is not `Send`
    static RESOURCES: StaticCell<StackResources<SOCKETS>> = StaticCell::new();

    let parts = Parts {
        frames: |f| defmt::write!(f, "{}", lan9118::counters()),
        counters: |show| {
            let lan9118::Counters { received, sent, dropped, restarts } = lan9118::counters();
            show("frames received", received);
            show("frames sent", sent);
            show("frames dropped", dropped);
            show("network restarts", restarts);
        },
        ..Parts::after(fault::last_reset(), env!("CARGO_BIN_NAME"), env!("CARGO_PKG_VERSION"))
    };
    let settings = config::load(config::log);
    let (stack, runner) = net::start(settings, RESOURCES.init_with(StackResources::new));
    spawner.spawn(run_stack(runner)?);
    let board = gateway::start(spawner, stack, settings, parts, net::DHCP_AGAIN)?;
    #[cfg(feature = "console")]
    spawner.spawn(serve_console()?);
    #[cfg(feature = "echo")]
    if let Some(port) = settings.echo {
        echo::start(spawner, stack, port)?;
    }
    spawner.spawn(watch(board)?);
    #[cfg(feature = "faults")]
    spawner.spawn(provoke()?);
    Ok(())
}

#[embassy_executor::task]
async fn run_stack(mut runner: NetRunner) -> ! {
    gateway::run_network(runner.run()).await
}

/// Feeds the watchdog while the tasks run, the gateway meets its deadlines and the network works.
#[embassy_executor::task]
async fn watch(board: &'static Board) -> ! {
    gateway::watch(board, lan9118::SILENCE, watchdog::feed).await
}

/// Serves the host that changes the settings.
#[cfg(feature = "console")]
#[embassy_executor::task]
async fn serve_console() -> ! {
    bcap_firmware::console::run().await
}

/// Provokes the fault that a letter on the serial port selects.
#[cfg(feature = "faults")]
#[embassy_executor::task]
async fn provoke() -> ! {
    loop {
        embassy_time::Timer::after_millis(20).await;
        if let Some(letter) = bcap_firmware::uart::read() {
            bcap_firmware::provoke::provoke(letter);
        }
    }
}
