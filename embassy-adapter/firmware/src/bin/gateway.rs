//! The gateway board: PLCs that speak RAC on one side, a robot controller that speaks b-CAP on the other.
//!
//! ```text
//!  PLCs ─► port 5006, 4 sessions ─┐
//!                                 ├─► Gateway: rules, handles, counters ─► the robot, over TCP or UDP
//!  the settings in the flash ─────┘        │
//!                                          └─► the log on the serial port, a status line every 10 s
//! ```
//!
//! What PLCs may do, and where the robot is, stands in the settings; as long as nothing is set they may read everything
//! and write nothing. Each refusal is logged with its client and its line.
#![no_std]
#![no_main]

use bcap_board::{RuleMemory, Settings, Transport};
use bcap_core::bcap::client::{self, Timing};
use bcap_core::gateway::{Config, Event, Gateway, Memory, Tally};
use bcap_core::rac;
use bcap_core::time::{Instant, micros};
use bcap_embassy::gateway::{Listener, Report, Shared, TcpRobot, run_robot};
use bcap_embassy::net::{Options, UdpTransport};
use bcap_embassy::server::Limits;
use bcap_firmware::net::{self, NetRunner};
use bcap_firmware::watchdog::{self, Task, watched};
use bcap_firmware::{clock, config, echo, executor, fault, lan9118, stack, uart};
use embassy_executor::{SpawnError, Spawner};
use embassy_net::udp::{PacketMetadata, UdpSocket};
use embassy_net::{IpEndpoint, Stack, StackResources};
use embassy_sync::blocking_mutex::raw::NoopRawMutex;
use embassy_time::Timer;
use static_cell::{ConstStaticCell, StaticCell};

const ADDRESS: [u8; 6] = [0x02, 0, 0, 0xbc, 0xa9, 0x03];
/// PLCs at the same time, and handles that are kept at the robot.
const SESSIONS: usize = 4;
const HANDLES: usize = 64;
/// Sockets: the PLCs, the echo, the robot, DHCP.
const SOCKETS: usize = SESSIONS + echo::ECHOES + 2;

/// The tasks that the watchdog looks after; the PLCs' have the numbers from `PLC` on.
const NETWORK: Task = Task::new(0);
const ROBOT: Task = Task::new(1);
const STATUS: Task = Task::new(2);
const PLC: u32 = 3;
/// How late the gateway may be with what is due; more means that its tasks hang.
const LATE: core::time::Duration = core::time::Duration::from_secs(2);

type Board = Shared<'static, NoopRawMutex, SESSIONS>;

#[panic_handler]
fn panic(info: &core::panic::PanicInfo<'_>) -> ! {
    fault::panic_logged(info)
}

#[cortex_m_rt::entry]
fn main() -> ! {
    executor::run(|spawner| {
        if start(spawner).is_err() {
            defmt::error!("there is no room for a task");
            fault::end()
        }
    })
}

/// Starts the board and all tasks.
///
/// Not inlined: what is made here on its way into its place would stay on the stack for ever.
#[inline(never)]
fn start(spawner: Spawner) -> Result<(), SpawnError> {
    static RESOURCES: ConstStaticCell<StackResources<SOCKETS>> = ConstStaticCell::new(StackResources::new());
    static SOCKET_MEMORY: ConstStaticCell<[[[u8; 512]; 2]; SESSIONS]> = ConstStaticCell::new([[[0; 512]; 2]; SESSIONS]);

    uart::init();
    if let Some(peripherals) = cortex_m::Peripherals::take() {
        clock::init(peripherals.SYST);
    }
    let settings = config::load(config::log);
    let robot = settings.robot;
    defmt::info!("gateway to {}, provider {=str}", defmt::Debug2Format(&robot), settings.provider);
    let (stack, runner) = net::start(settings, ADDRESS, RESOURCES.take());
    let board = make(settings);
    spawner.spawn(run_stack(runner)?);
    spawner.spawn(keep_robot(stack, settings, board)?);
    for (number, memory) in (PLC..).zip(SOCKET_MEMORY.take()) {
        spawner.spawn(serve(stack, memory, board, Task::new(number))?);
    }
    if let Some(port) = settings.echo {
        echo::start(spawner, stack, port)?;
    }
    spawner.spawn(report(board)?);
    spawner.spawn(watch(board)?);
    Ok(())
}

/// Makes the gateway as the settings want it.
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
    BOARD.init(Shared::new(Gateway::new(config, MEMORY.take()), log))
}

#[embassy_executor::task]
async fn run_stack(mut runner: NetRunner) -> ! {
    watched(NETWORK, runner.run()).await
}

/// Serves PLCs, one after the other.
#[embassy_executor::task(pool_size = SESSIONS)]
async fn serve(stack: Stack<'static>, memory: &'static mut [[u8; 512]; 2], board: &'static Board, task: Task) -> ! {
    let [rx, tx] = memory;
    let mut listener = Listener::new(stack, rac::PORT, rx, tx);
    watched(task, listener.run(board, &Limits::default())).await
}

/// Finds an address, and then the robot, again and again.
#[embassy_executor::task]
async fn keep_robot(stack: Stack<'static>, settings: &'static Settings<'static>, board: &'static Board) {
    static MEMORY: ConstStaticCell<[[u8; 1024]; 3]> = ConstStaticCell::new([[0; 1024]; 3]);
    static META: ConstStaticCell<[[PacketMetadata; 2]; 2]> = ConstStaticCell::new([[PacketMetadata::EMPTY; 2]; 2]);
    let ([rx, tx, frame], [rx_meta, tx_meta]) = (MEMORY.take(), META.take());
    let address = settings.robot.address;
    let keep = async {
        net::find_address(stack, settings).await;
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
                        defmt::error!("no socket for the robot: {}", error);
                        fault::end()
                    }
                }
            }
        }
    };
    watched(ROBOT, keep).await
}

/// Feeds the watchdog as long as the tasks go on and the gateway does in time what is due.
#[embassy_executor::task]
async fn watch(board: &'static Board) -> ! {
    let is_well = || {
        let due = board.view(Gateway::poll_timeout).flatten();
        due.is_none_or(|due| now() <= due.saturating_add(LATE))
    };
    watchdog::run(is_well).await
}

/// Reports the state of the board now and then.
#[embassy_executor::task]
async fn report(board: &'static Board) -> ! {
    let report = async {
        loop {
            Timer::after_secs(10).await;
            board.view(status);
        }
    };
    watched(STATUS, report).await
}

fn status(gateway: &Gateway<'_>) {
    let counters = gateway.counters();
    defmt::info!(
        "up {=u64} s, robot {=str} ({=u32}), served {}, failed {}, refused {=u32}, {}, stack {=usize} of {=usize}",
        now().as_micros() / 1_000_000,
        if gateway.is_up() { "up" } else { "away" },
        counters.connected,
        Times(&counters.served),
        Times(&counters.failed),
        counters.refused,
        lan9118::counters(),
        stack::high_water(),
        stack::size(),
    );
}

/// A tally as a line shows it: how many, and the times of half, of 99 of 100, and of all of them in microseconds.
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

/// Writes what happens to the log: every refusal, every failure, and when someone comes or goes.
fn log(report: &Report<'_>) {
    match *report {
        Report::Connected { client } => defmt::info!("{}: connected", Client(client)),
        Report::Disconnected { client, ended } => defmt::info!("{}: gone: {}", Client(client), ended),
        Report::Answered { client, line, event: Event::Refused { refusal, .. } } => {
            defmt::warn!("{}: refused {=[u8]:a}: {}", Client(client), line, refusal)
        }
        Report::Answered { client, line, event: Event::Failed { result, .. } } => {
            defmt::debug!("{}: failed {=[u8]:a}: {}", Client(client), line, result)
        }
        Report::Answered { .. } => {}
        Report::Robot { event: Event::RobotDown { error, pause }, cause } => {
            let pause = u32::try_from(pause.as_millis()).unwrap_or(u32::MAX);
            defmt::warn!("robot away: {} {}, again in {=u32} ms", error, cause, pause)
        }
        Report::Robot { .. } => defmt::info!("robot up"),
    }
}

/// A client as a line shows it.
struct Client(Option<IpEndpoint>);

impl defmt::Format for Client {
    fn format(&self, f: defmt::Formatter<'_>) {
        match self.0 {
            Some(endpoint) => defmt::write!(f, "{}", endpoint),
            None => defmt::write!(f, "a client"),
        }
    }
}

fn now() -> Instant {
    bcap_embassy::clock::now()
}
