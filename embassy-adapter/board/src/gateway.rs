//! The tasks of a gateway board: RAC for PLCs, b-CAP to the robot, the address, the log and the watchdog.
//!
//! ```text
//!  PLCs ─► port 5006, a slot each ┐
//!                                 ├─► Gateway: rules, handles, counters ─► robot, over TCP or UDP
//!  settings in the flash ─────────┘        │
//!                                          └─► log, a status line every 10 s
//! ```
//!
//! The feature `modbus` adds listeners for Modbus TCP, `health` a page of the state and messages of syslog. The settings
//! switch them on.
//!
//! An image creates an embassy-net [`Stack`] with [`SOCKETS`] sockets, calls [`start`], runs the stack in one task, and
//! [`watch`] in another.

use core::pin::pin;
use core::sync::atomic::{AtomicBool, Ordering};

use bcap_core::bcap::client::{self, Timing};
use bcap_core::rac;
use bcap_embassy::clock::now;
#[cfg(feature = "modbus")]
use bcap_embassy::gateway::ModbusListener;
use bcap_embassy::gateway::{Limits, Listener, SharedGateway, TcpRobot, run_robot};
use bcap_embassy::net::{Backlog, Options, UdpTransport};
use bcap_gateway::{Config, Gateway, Memory};
use embassy_executor::{SpawnError, Spawner};
use embassy_futures::join::join;
use embassy_futures::select::select;
use embassy_net::Stack;
use embassy_net::udp::{PacketMetadata, UdpSocket};
use embassy_time::{Duration, Timer};
use static_cell::{ConstStaticCell, StaticCell};

use crate::led::LedState;
pub use crate::parts::Board;
#[cfg(feature = "modbus")]
use crate::parts::{AFTER_PLCS, MODBUS_BACKLOG, SPARE_TASK};
use crate::parts::{
    LISTENERS, NETWORK, PLC, PLC_BACKLOG, PLC_BUFFER, PLC_BUFFERS, Parts, ROBOT, ROBOT_BUFFER, ROBOT_BUFFERS, STATUS,
};
use crate::record::Cause;
#[cfg(feature = "health")]
use crate::sizes::PAGES;
use crate::sizes::{HANDLES, PLCS};
use crate::watchdog::{self, Task, watched};
use crate::{RuleMemory, Settings, Transport, address, datagrams, network, report};

/// Listeners of Modbus. The last one refuses clients; the clients of the others share the slots with the PLCs.
#[cfg(feature = "modbus")]
const MODBUS: usize = crate::sizes::MODBUS + 1;
#[cfg(not(feature = "modbus"))]
const MODBUS: usize = 0;
/// The size of each buffer of a Modbus socket, in bytes: a frame has 260 at most.
#[cfg(feature = "modbus")]
const MODBUS_BUFFER: usize = 320;
/// The same for the listener that refuses clients.
#[cfg(feature = "modbus")]
const SPARE_BUFFER: usize = 96;
/// How long a frame of Modbus may take from its first byte to its last; clients send it in one piece.
#[cfg(feature = "modbus")]
const MODBUS_RECEIVE: core::time::Duration = core::time::Duration::from_secs(5);
/// The sockets of the page.
#[cfg(feature = "health")]
const HEALTH: usize = PAGES;
#[cfg(not(feature = "health"))]
const HEALTH: usize = 0;
/// The socket of updates.
const UPDATES: usize = if cfg!(feature = "update") { 1 } else { 0 };
/// The sockets of the network stack: the listeners, Modbus, the page, updates, the robot, DHCP, datagrams.
pub const SOCKETS: usize = LISTENERS + MODBUS + HEALTH + UPDATES + 3;

/// Maximum overrun of the gateway's deadline; a longer overrun means that its tasks hang.
const MAX_OVERRUN: core::time::Duration = core::time::Duration::from_secs(2);

/// Whether the settings are invalid or the last reset was a fault.
static HAS_ERROR: AtomicBool = AtomicBool::new(false);

/// Starts the tasks of a gateway, except for the network stack, the watchdog and board-specific tasks. Call it once.
///
/// `dhcp_again` is the pause before the board requests an address again ([`address::DHCP_AGAIN`]).
///
/// # Errors
///
/// A [`SpawnError`] when the pool of a task is full.
pub fn start(
    spawner: Spawner,
    stack: Stack<'static>,
    settings: &'static Settings<'static>,
    parts: Parts,
    dhcp_again: Duration,
) -> Result<&'static Board, SpawnError> {
    static SOCKET_MEMORY: ConstStaticCell<[[[u8; PLC_BUFFER]; 2]; LISTENERS]> =
        ConstStaticCell::new([[[0; PLC_BUFFER]; 2]; LISTENERS]);

    let robot = settings.robot;
    defmt::info!("gateway to {}, provider {=str}", defmt::Debug2Format(&robot), settings.provider);
    let board = make(settings);
    network::describe(&parts);
    spawner.spawn(run_robot_link(stack, settings, board, dhcp_again)?);
    for (number, memory) in (PLC..).zip(SOCKET_MEMORY.take()) {
        spawner.spawn(serve(stack, memory, settings, board, Task::new(number))?);
    }
    #[cfg(feature = "modbus")]
    start_modbus(spawner, stack, settings, board)?;
    datagrams::start(spawner, stack, settings)?;
    #[cfg(feature = "health")]
    crate::messages::start(&parts);
    #[cfg(feature = "health")]
    crate::page::start(spawner, stack, settings, board, parts)?;
    #[cfg(all(feature = "update", feature = "port"))]
    crate::remote::start(spawner, stack, settings)?;
    spawner.spawn(log_status(stack, board, parts)?);
    HAS_ERROR.store(settings.has_invalid_line() || parts.last_reset.is_fault(), Ordering::Relaxed);
    Ok(board)
}

/// Runs the network stack under the watchdog.
pub async fn run_network<F: Future>(runner: F) -> F::Output {
    watched(NETWORK, pin!(runner)).await
}

/// Calls `feed` each second while the tasks run, the gateway meets its deadlines and the Ethernet controller works.
///
/// `silence` is the time without a frame after which the controller counts as dead ([`network::SILENCE`]).
pub async fn watch(board: &'static Board, silence: Duration, feed: impl FnMut()) -> ! {
    let fault = || {
        #[cfg(feature = "update")]
        if board.view(|gateway| gateway.counters().served.count() > 0).unwrap_or_default() {
            crate::trial::has_served();
        }
        let deadline = board.view(Gateway::poll_timeout).flatten();
        let is_late = deadline.is_some_and(|deadline| now() > deadline.saturating_add(MAX_OVERRUN));
        match () {
            () if network::is_dead(silence) => Some(Cause::Network),
            () if is_late => Some(Cause::Watchdog { tasks: 0 }),
            () => None,
        }
    };
    watchdog::run(fault, feed).await
}

/// Returns the pattern of the LED.
#[must_use]
pub fn led_state(board: &Board, stack: Stack<'_>) -> LedState {
    LedState {
        link: stack.is_link_up(),
        address: stack.is_config_up(),
        robot: has_robot(board),
        error: HAS_ERROR.load(Ordering::Relaxed),
    }
}

fn has_robot(board: &Board) -> bool {
    board.view(Gateway::is_up).unwrap_or_default()
}

/// Creates the gateway from the settings.
#[inline(never)]
fn make(settings: &'static Settings<'static>) -> &'static Board {
    static MEMORY: ConstStaticCell<Memory<PLCS, HANDLES>> = ConstStaticCell::new(Memory::new());
    static RULES: StaticCell<RuleMemory<'static>> = StaticCell::new();
    static BOARD: StaticCell<Board> = StaticCell::new();

    let rules = settings.rules(RULES.init(RuleMemory::new()));
    defmt::info!("{=usize} rules for GET, {=usize} for PUT", rules.get.len(), rules.put.len());
    let client = match settings.robot.transport {
        Transport::Tcp => Config::RC8.client,
        // five attempts take 2.5 s; a call that runs longer has sent keep-alives
        Transport::Udp => client::Config {
            timing: Timing {
                deadline: Config::RC8.client.timing.deadline,
                keep_alive: Config::RC8.client.timing.keep_alive,
                ..Timing::UDP
            },
            ..client::Config::UDP
        },
    };
    let Settings { provider, machine, option, service, .. } = *settings;
    let config = Config { client, service, provider, machine, option, rules, ..Config::RC8 };
    BOARD.init(SharedGateway::new(Gateway::new(config, MEMORY.take()), report::log))
}

/// Serves PLCs in sequence.
#[embassy_executor::task(pool_size = LISTENERS)]
async fn serve(
    stack: Stack<'static>,
    memory: &'static mut [[u8; PLC_BUFFER]; 2],
    settings: &'static Settings<'static>,
    board: &'static Board,
    task: Task,
) -> ! {
    let [rx, tx] = memory;
    let mut listener = Listener::with_options(stack, rac::PORT, rx, tx, options(settings, &PLC_BACKLOG));
    watched(task, pin!(listener.run(board, &limits(settings)))).await
}

/// Starts the tasks that serve Modbus, if the settings have a port for it.
#[cfg(feature = "modbus")]
fn start_modbus(
    spawner: Spawner,
    stack: Stack<'static>,
    settings: &'static Settings<'static>,
    board: &'static Board,
) -> Result<(), SpawnError> {
    static MEMORY: ConstStaticCell<[[[u8; MODBUS_BUFFER]; 2]; MODBUS - 1]> =
        ConstStaticCell::new([[[0; MODBUS_BUFFER]; 2]; MODBUS - 1]);
    static SPARE: ConstStaticCell<[[u8; SPARE_BUFFER]; 2]> = ConstStaticCell::new([[0; SPARE_BUFFER]; 2]);
    // not arguments of the tasks, because a task has a second copy of each argument
    static PLACES: [StaticCell<ModbusListener<'static>>; MODBUS] = [const { StaticCell::new() }; MODBUS];
    let Some(port) = settings.modbus else { return Ok(()) };
    let listener = |memory: [&'static mut [u8]; 2]| {
        ModbusListener::new(stack, port, settings.modbus_map(), memory, options(settings, &MODBUS_BACKLOG))
    };
    let [places @ .., spare] = &PLACES;
    // the network passes a connection to the first listener that is free, so the listener that refuses clients is created last
    for ((number, place), [rx, tx]) in (AFTER_PLCS..).zip(places).zip(MEMORY.take()) {
        spawner.spawn(serve_modbus(place.init(listener([rx, tx])), settings, board, Task::new(number))?);
    }
    let [rx, tx] = SPARE.take();
    spawner.spawn(refuse_modbus(spare.init(listener([rx, tx])), board)?);
    Ok(())
}

/// Refuses Modbus clients above the maximum number.
#[cfg(feature = "modbus")]
#[embassy_executor::task]
async fn refuse_modbus(listener: &'static mut ModbusListener<'static>, board: &'static Board) -> ! {
    watched(SPARE_TASK, pin!(listener.refuse(board))).await
}

/// Serves clients of Modbus in sequence.
#[cfg(feature = "modbus")]
#[embassy_executor::task(pool_size = MODBUS - 1)]
async fn serve_modbus(
    listener: &'static mut ModbusListener<'static>,
    settings: &'static Settings<'static>,
    board: &'static Board,
    task: Task,
) -> ! {
    let limits = Limits { receive: MODBUS_RECEIVE, idle: Some(settings.modbus_idle()), ..limits(settings) };
    watched(task, pin!(listener.run(board, &limits))).await
}

/// Returns the time limits of a PLC's session.
fn limits(settings: &Settings<'_>) -> Limits {
    Limits { idle: settings.idle, evict_after: Some(settings.evict), ..Limits::default() }
}

/// Returns the timeouts of a PLC's connection; one that confirms no keep-alive is reset.
fn options(settings: &Settings<'_>, backlog: &'static Backlog) -> Options {
    let keep_alive = Duration::from_secs(settings.keep_alive.as_secs());
    let lost = Options::default().lost.max(keep_alive * 3);
    Options { keep_alive, lost, usage: Some(&PLC_BUFFERS), backlog: Some(backlog), ..Options::default() }
}

/// Waits for an address, then runs the connection to the robot.
#[embassy_executor::task]
async fn run_robot_link(
    stack: Stack<'static>,
    settings: &'static Settings<'static>,
    board: &'static Board,
    dhcp_again: Duration,
) {
    static MEMORY: ConstStaticCell<[[u8; ROBOT_BUFFER]; 2]> = ConstStaticCell::new([[0; ROBOT_BUFFER]; 2]);
    static PART_MEMORY: ConstStaticCell<[u8; 512]> = ConstStaticCell::new([0; 512]);
    // not a `ConstStaticCell`: the values are not all zero, and would lie in the flash as well
    static META: StaticCell<[[PacketMetadata; 2]; 2]> = StaticCell::new();
    let ([rx, tx], frame, [rx_meta, tx_meta]) =
        (MEMORY.take(), PART_MEMORY.take(), META.init_with(|| [[PacketMetadata::EMPTY; 2]; 2]));
    let address = settings.robot.address;
    let run = async {
        match settings.robot.transport {
            Transport::Tcp => {
                let options = Options { usage: Some(&ROBOT_BUFFERS), ..Options::default() };
                let mut robot = TcpRobot::new(stack, rx, tx, options, address);
                run_robot(&mut robot, frame, board).await
            }
            Transport::Udp => {
                let socket = UdpSocket::new(stack, rx_meta, rx, tx_meta, tx);
                match UdpTransport::new(stack, socket, address) {
                    Ok(mut robot) => run_robot(&mut robot, frame, board).await,
                    Err(error) => {
                        // the gateway works without a robot; its PLCs get E_NOT_CONNECTED
                        defmt::error!("cannot open a socket for the robot: {}", error);
                    }
                }
            }
        }
    };
    let work = async {
        address::find(stack, settings).await;
        select(run, address::keep(stack, settings, dhcp_again, || has_robot(board) || board.sessions() > 0)).await;
    };
    watched(ROBOT, pin!(work)).await;
}

/// Logs the state of the board every 10 s, and follows its address: in this task, because it seldom runs.
#[embassy_executor::task]
async fn log_status(stack: Stack<'static>, board: &'static Board, parts: Parts) -> ! {
    let work = async {
        loop {
            Timer::after_secs(10).await;
            board.view(|gateway| report::status(gateway, &parts));
            report::left_out();
            #[cfg(feature = "health")]
            crate::messages::left_out();
        }
    };
    join(watched(STATUS, pin!(work)), network::follow(stack)).await.0
}
