//! A gateway without a network: a robot that speaks b-CAP and a PLC that speaks RAC, each at the other end of a serial line.
//!
//! The first serial port has the log. The settings of the robot's session and the rules are the same as in the image
//! `gateway`.
#![no_std]
#![no_main]

use core::pin::pin;

use bcap_board::watchdog::{self, Task, watched};
use bcap_board::{RuleMemory, Settings, report, stack};
use bcap_core::bcap::client;
use bcap_embassy::gateway::{Front, Limits, SerialRobot, SharedGateway, run_robot, serve};
use bcap_embassy::serial::transport;
use bcap_firmware::lines::Line;
use bcap_firmware::{config, executor, fault};
use bcap_gateway::{Config, Gateway, Memory};
use embassy_executor::{SpawnError, Spawner};
use embassy_sync::blocking_mutex::raw::NoopRawMutex;
use embassy_time::Timer;
use static_cell::{ConstStaticCell, StaticCell};

/// The rate of both lines.
const BAUD: u32 = 115_200;

type Board = SharedGateway<'static, NoopRawMutex, 1>;

#[panic_handler]
fn panic(info: &core::panic::PanicInfo<'_>) -> ! {
    fault::panic_logged(info)
}

#[cortex_m_rt::entry]
fn main() -> ! {
    bcap_firmware::watchdog::arm();
    stack::run(program)
}

extern "C" fn program() -> ! {
    executor::start(start)
}

/// Starts the board and all tasks.
#[inline(never)]
fn start(spawner: Spawner) -> Result<(), SpawnError> {
    defmt::info!("last reset: {}", defmt::Display2Format(&fault::last_reset()));
    let board = make(config::load(config::log));
    spawner.spawn(keep_robot(board)?);
    spawner.spawn(serve_plc(board)?);
    spawner.spawn(watch()?);
    Ok(())
}

/// Creates the gateway from the settings.
#[inline(never)]
fn make(settings: &'static Settings<'static>) -> &'static Board {
    static MEMORY: ConstStaticCell<Memory<1, 32>> = ConstStaticCell::new(Memory::new());
    static RULES: StaticCell<RuleMemory<'static>> = StaticCell::new();
    static BOARD: StaticCell<Board> = StaticCell::new();

    let rules = settings.rules(RULES.init(RuleMemory::new()));
    let client = client::Config::serial(BAUD);
    let Settings { provider, machine, option, service, .. } = *settings;
    let config = Config { client, service, provider, machine, option, rules, ..Config::RC8 };
    BOARD.init(SharedGateway::new(Gateway::new(config, MEMORY.take()), report::log))
}

/// Runs the connection to the robot.
#[embassy_executor::task]
async fn keep_robot(board: &'static Board) -> ! {
    static FRAME: ConstStaticCell<[u8; 512]> = ConstStaticCell::new([0; 512]);
    let mut robot = SerialRobot::new(Line::second());
    watched(Task::new(0), pin!(run_robot(&mut robot, FRAME.take(), board))).await
}

/// Serves the PLC in consecutive sessions: a session ends when the PLC sends half a line.
#[embassy_executor::task]
async fn serve_plc(board: &'static Board) -> ! {
    let mut line = transport(Line::third());
    let work = async {
        loop {
            // `None`: the rules allow no client without an address
            if serve(&mut line, Front::Rac, None, board, &Limits::default()).await.is_none() {
                Timer::after_secs(1).await;
            }
        }
    };
    watched(Task::new(1), pin!(work)).await
}

/// Feeds the watchdog while the tasks run.
#[embassy_executor::task]
async fn watch() -> ! {
    watchdog::run(|| None, bcap_firmware::watchdog::feed).await
}
