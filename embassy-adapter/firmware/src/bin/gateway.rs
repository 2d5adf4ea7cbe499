//! The gateway board: connects PLCs that speak RAC to a robot controller that speaks b-CAP.
//!
//! ```text
//!  PLCs ─► port 5006, 4 slots ────┐
//!                                 ├─► Gateway: rules, handles, counters ─► robot, over TCP or UDP
//!  settings in the flash ─────────┘        │
//!                                          └─► log on the serial port, a status line every 10 s
//! ```
//!
//! The settings define the rules for PLCs and the robot's address. By default PLCs may read every variable and write
//! none. A refusal is logged with its client and its line, at most once a second for each client and reason.
#![no_std]
#![no_main]

use core::cell::RefCell;
use core::net::Ipv4Addr;

use bcap_board::limiter::Limiter;
use bcap_board::{RuleMemory, Settings, Transport};
use bcap_core::bcap::client::{self, Timing};
use bcap_core::gateway::{Config, Event, Gateway, Memory, Refusal, Tally};
use bcap_core::rac;
use bcap_core::time::{Instant, micros};
#[cfg(feature = "modbus")]
use bcap_embassy::gateway::ModbusListener;
use bcap_embassy::gateway::{Denial, Listener, Report, SharedGateway, TcpRobot, run_robot};
#[cfg(feature = "health")]
use bcap_embassy::http::HttpListener;
use bcap_embassy::net::{Options, UdpTransport};
use bcap_embassy::server::Limits;
#[cfg(feature = "echo")]
use bcap_firmware::echo;
#[cfg(feature = "health")]
use bcap_firmware::health;
use bcap_firmware::net::{self, NetRunner};
#[cfg(feature = "health")]
use bcap_firmware::record::Cause;
use bcap_firmware::watchdog::{self, Task, watched};
use bcap_firmware::{clock, config, executor, fault, lan9118, log, stack, uart};
use embassy_executor::{SpawnError, Spawner};
use embassy_futures::select::select;
use embassy_net::udp::{PacketMetadata, UdpSocket};
use embassy_net::{IpAddress, IpEndpoint, Stack, StackResources};
use embassy_sync::blocking_mutex::Mutex;
use embassy_sync::blocking_mutex::raw::{CriticalSectionRawMutex, NoopRawMutex};
use embassy_time::{Duration, Timer};
use static_cell::{ConstStaticCell, StaticCell};

/// Concurrent PLCs, listeners, of which one answers PLCs without a slot, and the capacity of the LRU cache of handles.
const SESSIONS: usize = 4;
const LISTENERS: usize = SESSIONS + 1;
const HANDLES: usize = 64;
/// Sockets: the listeners, the echo, Modbus, the page and syslog, the robot, DHCP.
const SOCKETS: usize = LISTENERS + ECHOES + MODBUS + HEALTH + 2;
#[cfg(feature = "echo")]
const ECHOES: usize = echo::ECHOES;
#[cfg(not(feature = "echo"))]
const ECHOES: usize = 0;

/// Concurrent clients of Modbus; they share the slots with the PLCs.
#[cfg(feature = "modbus")]
const MODBUS: usize = 2;
#[cfg(not(feature = "modbus"))]
const MODBUS: usize = 0;

/// Listeners of the page, so that one can close while the other answers.
#[cfg(feature = "health")]
const PAGES: usize = 2;
#[cfg(feature = "health")]
const HEALTH: usize = PAGES + 1;
#[cfg(not(feature = "health"))]
const HEALTH: usize = 0;

/// The tasks that the watchdog watches; the PLCs' tasks have the numbers from `PLC` on.
const NETWORK: Task = Task::new(0);
const ROBOT: Task = Task::new(1);
const STATUS: Task = Task::new(2);
const PLC: u32 = 3;
// after the numbers of the listeners
#[cfg(feature = "modbus")]
const MODBUS_TASK: u32 = PLC + 5;
#[cfg(feature = "health")]
const SYSLOG: Task = Task::new(PLC + 7);
#[cfg(feature = "health")]
const PAGE_TASK: u32 = PLC + 8;
/// How far the gateway may overrun its deadline; a longer overrun means that its tasks hang.
const MAX_OVERRUN: core::time::Duration = core::time::Duration::from_secs(2);

type Board = SharedGateway<'static, NoopRawMutex, SESSIONS>;

/// Limits the lines of the log about clients.
static LIMITER: Mutex<CriticalSectionRawMutex, RefCell<Limiter<16>>> = Mutex::new(RefCell::new(Limiter::new()));

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
    executor::run(|spawner| {
        if start(spawner).is_err() {
            defmt::error!("cannot start a task: its pool is full");
            fault::end()
        }
    })
}

/// Starts the board and all tasks.
///
/// Not inlined: otherwise the temporaries of initialisation would stay on the stack forever.
#[inline(never)]
fn start(spawner: Spawner) -> Result<(), SpawnError> {
    // not a `ConstStaticCell`: with a host name in it, the type is not `Send`
    static RESOURCES: StaticCell<StackResources<SOCKETS>> = StaticCell::new();
    static SOCKET_MEMORY: ConstStaticCell<[[[u8; 512]; 2]; LISTENERS]> =
        ConstStaticCell::new([[[0; 512]; 2]; LISTENERS]);

    uart::init();
    if let Some(peripherals) = cortex_m::Peripherals::take() {
        clock::init(peripherals.SYST);
    }
    let last_reset = fault::last_reset();
    defmt::info!("last reset: {}", defmt::Display2Format(&last_reset));
    let settings = config::load(config::log);
    let robot = settings.robot;
    defmt::info!("gateway to {}, provider {=str}", defmt::Debug2Format(&robot), settings.provider);
    let (stack, runner) = net::start(settings, RESOURCES.init_with(StackResources::new));
    let board = make(settings);
    spawner.spawn(run_stack(runner)?);
    spawner.spawn(run_robot_link(stack, settings, board)?);
    for (number, memory) in (PLC..).zip(SOCKET_MEMORY.take()) {
        spawner.spawn(serve(stack, memory, settings, board, Task::new(number))?);
    }
    #[cfg(feature = "health")]
    start_health(spawner, stack, settings, board, last_reset)?;
    #[cfg(feature = "modbus")]
    start_modbus(spawner, stack, settings, board)?;
    #[cfg(feature = "console")]
    spawner.spawn(serve_console()?);
    #[cfg(feature = "echo")]
    if let Some(port) = settings.echo {
        echo::start(spawner, stack, port)?;
    }
    spawner.spawn(report(board)?);
    spawner.spawn(watch(board)?);
    #[cfg(feature = "faults")]
    spawner.spawn(provoke()?);
    Ok(())
}

/// Creates the gateway from the settings.
#[inline(never)]
fn make(settings: &'static Settings<'static>) -> &'static Board {
    static MEMORY: ConstStaticCell<Memory<SESSIONS, HANDLES>> = ConstStaticCell::new(Memory::new());
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
    BOARD.init(SharedGateway::new(Gateway::new(config, MEMORY.take()), log_report))
}

#[embassy_executor::task]
async fn run_stack(mut runner: NetRunner) -> ! {
    watched(NETWORK, runner.run()).await
}

/// Serves PLCs, one after another.
#[embassy_executor::task(pool_size = LISTENERS)]
async fn serve(
    stack: Stack<'static>,
    memory: &'static mut [[u8; 512]; 2],
    settings: &'static Settings<'static>,
    board: &'static Board,
    task: Task,
) -> ! {
    let [rx, tx] = memory;
    let mut listener = Listener::with_options(stack, rac::PORT, rx, tx, options(settings));
    watched(task, listener.run(board, &limits(settings))).await
}

/// Starts the page of the board's state and the messages of syslog, if the settings ask for them.
#[cfg(feature = "health")]
fn start_health(
    spawner: Spawner,
    stack: Stack<'static>,
    settings: &'static Settings<'static>,
    board: &'static Board,
    last_reset: Cause,
) -> Result<(), SpawnError> {
    static MEMORY: ConstStaticCell<[health::Buffers; PAGES]> =
        ConstStaticCell::new([([[0; 1024]; 2], [0; health::PAGE]); PAGES]);
    if let Some(port) = settings.health {
        for (number, ([rx, tx], page)) in (PAGE_TASK..).zip(MEMORY.take()) {
            let listener = HttpListener::new(stack, port, [rx, tx], page, Options::default());
            spawner.spawn(serve_page(listener, board, last_reset, Task::new(number))?);
        }
    }
    if let Some(collector) = settings.syslog {
        health::start(&last_reset);
        spawner.spawn(send_messages(stack, collector, settings)?);
    }
    Ok(())
}

/// Shows the board's state to the clients that the rules admit.
#[cfg(feature = "health")]
#[embassy_executor::task(pool_size = PAGES)]
async fn serve_page(mut listener: HttpListener<'static>, board: &'static Board, last_reset: Cause, task: Task) -> ! {
    let admits = |client: Option<IpEndpoint>| {
        let address = client.map(|IpEndpoint { addr: IpAddress::Ipv4(address), .. }| address);
        board.view(|gateway| gateway.config().rules.admits(address)).unwrap_or_default()
    };
    let answer = |path: &str, page: &mut dyn core::fmt::Write| health::answer(board, &last_reset, path, page);
    watched(task, listener.run(admits, answer)).await
}

/// Sends messages of syslog.
#[cfg(feature = "health")]
#[embassy_executor::task]
async fn send_messages(
    stack: Stack<'static>,
    collector: core::net::SocketAddrV4,
    settings: &'static Settings<'static>,
) -> ! {
    watched(SYSLOG, health::send_messages(stack, collector, settings.hostname)).await
}

/// Starts the tasks that serve Modbus, if the settings have a port for it.
#[cfg(feature = "modbus")]
fn start_modbus(
    spawner: Spawner,
    stack: Stack<'static>,
    settings: &'static Settings<'static>,
    board: &'static Board,
) -> Result<(), SpawnError> {
    static MEMORY: ConstStaticCell<[[[u8; 512]; 2]; MODBUS]> = ConstStaticCell::new([[[0; 512]; 2]; MODBUS]);
    let Some(port) = settings.modbus else { return Ok(()) };
    for (number, [rx, tx]) in (MODBUS_TASK..).zip(MEMORY.take()) {
        let map = settings.modbus_map();
        let listener = ModbusListener::new(stack, port, map, [rx, tx], options(settings));
        spawner.spawn(serve_modbus(listener, settings, board, Task::new(number))?);
    }
    Ok(())
}

/// Serves clients of Modbus, one after another.
#[cfg(feature = "modbus")]
#[embassy_executor::task(pool_size = MODBUS)]
async fn serve_modbus(
    mut listener: ModbusListener<'static>,
    settings: &'static Settings<'static>,
    board: &'static Board,
    task: Task,
) -> ! {
    watched(task, listener.run(board, &limits(settings))).await
}

/// Returns the time limits of a PLC's session.
fn limits(settings: &Settings<'_>) -> Limits {
    Limits { idle: settings.idle, evict_after: Some(settings.evict), ..Limits::default() }
}

/// Returns the timeouts of a PLC's connection; one that confirms no keep-alive is reset.
fn options(settings: &Settings<'_>) -> Options {
    let keep_alive = Duration::from_secs(settings.keep_alive.as_secs());
    let lost = Options::default().lost.max(keep_alive * 3);
    Options { keep_alive, lost, ..Options::default() }
}

/// Waits for an address, then runs the connection to the robot.
#[embassy_executor::task]
async fn run_robot_link(stack: Stack<'static>, settings: &'static Settings<'static>, board: &'static Board) {
    static MEMORY: ConstStaticCell<[[u8; 1024]; 3]> = ConstStaticCell::new([[0; 1024]; 3]);
    static META: ConstStaticCell<[[PacketMetadata; 2]; 2]> = ConstStaticCell::new([[PacketMetadata::EMPTY; 2]; 2]);
    let ([rx, tx, frame], [rx_meta, tx_meta]) = (MEMORY.take(), META.take());
    let address = settings.robot.address;
    let run = async {
        match settings.robot.transport {
            Transport::Tcp => {
                let mut robot = TcpRobot::new(stack, rx, tx, Options::default(), address);
                run_robot(&mut robot, frame, board).await
            }
            Transport::Udp => {
                let socket = UdpSocket::new(stack, rx_meta, rx, tx_meta, tx);
                match UdpTransport::new(stack, socket, address) {
                    Ok(mut robot) => run_robot(&mut robot, frame, board).await,
                    Err(error) => {
                        defmt::error!("cannot open a socket for the robot: {}", error);
                        fault::end()
                    }
                }
            }
        }
    };
    let work = async {
        net::find_address(stack, settings).await;
        let has_robot = || board.view(Gateway::is_up).unwrap_or_default();
        select(run, net::improve_address(stack, settings, has_robot)).await;
    };
    watched(ROBOT, work).await
}

/// Serves the host that changes the settings.
#[cfg(feature = "console")]
#[embassy_executor::task]
async fn serve_console() -> ! {
    bcap_firmware::console::run().await
}

/// Provokes the fault that a letter on the serial port asks for.
#[cfg(feature = "faults")]
#[embassy_executor::task]
async fn provoke() -> ! {
    loop {
        Timer::after_millis(20).await;
        if let Some(letter) = uart::read() {
            bcap_firmware::provoke::provoke(letter);
        }
    }
}

/// Feeds the watchdog while the tasks run, the gateway meets its deadlines and the network works.
#[embassy_executor::task]
async fn watch(board: &'static Board) -> ! {
    let is_healthy = || {
        let due = board.view(Gateway::poll_timeout).flatten();
        !lan9118::is_dead() && due.is_none_or(|due| now() <= due.saturating_add(MAX_OVERRUN))
    };
    watchdog::run(is_healthy).await
}

/// Logs the state of the board every 10 s.
#[embassy_executor::task]
async fn report(board: &'static Board) -> ! {
    let report = async {
        loop {
            Timer::after_secs(10).await;
            board.view(status);
            with_limiter(|limiter| {
                limiter.drain(|client, reason, count| {
                    defmt::info!("{}: {=u32} more of: {=str}", Address(client), count, reason)
                })
            });
        }
    };
    watched(STATUS, report).await
}

fn status(gateway: &Gateway<'_>) {
    let counters = gateway.counters();
    defmt::info!(
        "up {=u64} s, robot {=str} ({=u32}), served {}, failed {}, refused {=u32}, {}, stack {=usize} of {=usize}, \
         log dropped {=u32}",
        now().as_micros() / 1_000_000,
        if gateway.is_up() { "up" } else { "down" },
        counters.connected,
        Times(&counters.served),
        Times(&counters.failed),
        counters.refused,
        lan9118::counters(),
        stack::high_water(),
        stack::size(),
        log::dropped(),
    );
}

/// Formats a tally: the count, the median, the 99th percentile and the maximum, in microseconds.
struct Times<'a>(&'a Tally);

impl defmt::Format for Times<'_> {
    fn format(&self, f: defmt::Formatter<'_>) {
        let Self(tally) = self;
        defmt::write!(
            f,
            "{=u32} (p50 {=u64} us, p99 {=u64} us, longest {=u64} us)",
            tally.count(),
            micros(tally.percentile(50)),
            micros(tally.percentile(99)),
            micros(tally.max())
        );
    }
}

/// Logs refusals, failures, and the connections of clients and of the robot.
fn log_report(report: &Report<'_>) {
    #[cfg(feature = "health")]
    health::report(report);
    match *report {
        Report::Connected { client } => limited(client, "connected", |left_out| {
            defmt::info!("{}: connected{}", Client(client), left_out);
        }),
        Report::Disconnected { client, ended } => limited(client, "disconnected", |left_out| {
            defmt::info!("{}: disconnected: {}{}", Client(client), ended, left_out);
        }),
        Report::Denied { client, reason } => {
            let name = if reason == Denial::Full { "not served: full" } else { "not served: address" };
            limited(client, name, |left_out| {
                defmt::warn!("{}: not served: {}{}", Client(client), reason, left_out);
            })
        }
        Report::Answered { client, line, event: Event::Refused { refusal, .. } } => {
            limited(client, name(&refusal), |left_out| {
                defmt::warn!("{}: refused {=[u8]:a}: {}{}", Client(client), line, refusal, left_out);
            })
        }
        Report::Answered { client, line, event: Event::Failed { result, .. } } => {
            defmt::debug!("{}: failed {=[u8]:a}: {}", Client(client), line, result)
        }
        Report::Answered { .. } => {}
        Report::Robot { event: Event::RobotDown { error, pause }, cause } => {
            let pause = u32::try_from(pause.as_millis()).unwrap_or(u32::MAX);
            defmt::warn!("robot down: {} {}, retry in {=u32} ms", error, cause, pause)
        }
        Report::Robot { .. } => defmt::info!("robot up"),
    }
}

/// Returns the name of a refusal's reason, for the limits of the log.
fn name(refusal: &Refusal) -> &'static str {
    match refusal {
        Refusal::Line(_) => "refused: invalid line",
        Refusal::Rate => "refused: rate",
        Refusal::ReadOnly => "refused: read-only",
        Refusal::Kind => "refused: kind",
        Refusal::Index => "refused: index",
        Refusal::Type => "refused: type",
        Refusal::Value => "refused: value",
        _ => "refused",
    }
}

/// Writes a line about a client, at most one a second for each client and reason.
fn limited(client: Option<IpEndpoint>, reason: &'static str, write: impl FnOnce(LeftOut)) {
    let address = client.map(|IpEndpoint { addr: IpAddress::Ipv4(address), .. }| address);
    if let Some(left_out) = with_limiter(|limiter| limiter.admit(address, reason, now())).flatten() {
        write(LeftOut(left_out));
    }
}

fn with_limiter<T>(work: impl FnOnce(&mut Limiter<16>) -> T) -> Option<T> {
    LIMITER.lock(|limiter| limiter.try_borrow_mut().ok().map(|mut limiter| work(&mut limiter)))
}

/// Formats the number of lines that the log leaves out.
struct LeftOut(u32);

impl defmt::Format for LeftOut {
    fn format(&self, f: defmt::Formatter<'_>) {
        if self.0 > 0 {
            defmt::write!(f, " ({=u32} more since the last line)", self.0);
        }
    }
}

/// Formats a client.
struct Client(Option<IpEndpoint>);

impl defmt::Format for Client {
    fn format(&self, f: defmt::Formatter<'_>) {
        match self.0 {
            Some(endpoint) => defmt::write!(f, "{}", endpoint),
            None => defmt::write!(f, "a client"),
        }
    }
}

/// Formats the address of a client.
struct Address(Option<Ipv4Addr>);

impl defmt::Format for Address {
    fn format(&self, f: defmt::Formatter<'_>) {
        match self.0 {
            Some(address) => {
                let [a, b, c, d] = address.octets();
                defmt::write!(f, "{=u8}.{=u8}.{=u8}.{=u8}", a, b, c, d);
            }
            None => defmt::write!(f, "other clients"),
        }
    }
}

fn now() -> Instant {
    bcap_embassy::clock::now()
}
