//! A board on embassy-net that is a small controller and a client of the robot's controller.
//!
//! ```text
//!  RAC clients    ─► port 5006, 4 sessions ─┐
//!  b-CAP clients  ─► port 5007, TCP and UDP ┴─► Node: uptime, counters, memory
//!  robot          ◄─ a b-CAP client that reads one variable each second
//! ```
#![no_std]
#![no_main]

use bcap_board::{Settings, address, stack};
use bcap_core::bcap::client::Config as ClientConfig;
use bcap_core::bcap::{Client, call, server as bcap_server};
use bcap_core::io::CallError;
use bcap_core::rac::{self, server as rac_server};
use bcap_embassy::net::{Backlog, Connection, NetError, Options, TcpClient, TcpTransport};
use bcap_embassy::server::{Limits, Listener, SharedHandler, UdpPeer, UdpServer};
use bcap_firmware::net::{self, NetRunner};
use bcap_firmware::node::Node;
use bcap_firmware::{config, executor, fault, lan9118};
use embassy_executor::{SpawnError, Spawner};
use embassy_net::udp::{PacketMetadata, UdpSocket};
use embassy_net::{Stack, StackResources};
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_time::{Instant, Timer};
use static_cell::{ConstStaticCell, StaticCell};

const RAC_SESSIONS: usize = 4;
const BCAP_PORT: u16 = 5007;
/// Sockets: RAC, b-CAP over TCP and UDP, the robot, DHCP.
const SOCKETS: usize = RAC_SESSIONS + 4;

type RacSession = rac_server::Session<[u8; 512]>;
type BcapSession = bcap_server::Session<[u8; 512], [u8; 512], 16>;

static NODE: SharedHandler<CriticalSectionRawMutex, Node, SOCKETS> = SharedHandler::new(Node::new());

/// The listeners of RAC.
static BACKLOG: Backlog = Backlog::new();

#[panic_handler]
fn panic(info: &core::panic::PanicInfo<'_>) -> ! {
    fault::panic_logged(info)
}

#[cortex_m_rt::entry]
fn main() -> ! {
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
    static RAC: ConstStaticCell<[[[u8; 512]; 2]; RAC_SESSIONS]> = ConstStaticCell::new([[[0; 512]; 2]; RAC_SESSIONS]);
    // apart from their memory, which would lie in the flash as well if it were part of a value that is not all zero
    static SESSIONS: [StaticCell<Option<RacSession>>; RAC_SESSIONS] = [const { StaticCell::new() }; RAC_SESSIONS];

    let settings = config::load(config::log);
    let robot = settings.robot.address;
    defmt::info!("robot {}, provider {=str}", defmt::Debug2Format(&robot), settings.provider);
    let (stack, runner) = net::start(settings, RESOURCES.init_with(StackResources::new));
    spawner.spawn(run_stack(runner)?);
    spawner.spawn(find_address(stack, settings)?);
    for (memory, session) in RAC.take().iter_mut().zip(&SESSIONS) {
        spawner.spawn(serve_rac(stack, memory, session.init_with(|| None))?);
    }
    spawner.spawn(serve_bcap(stack)?);
    spawner.spawn(serve_udp(stack)?);
    spawner.spawn(watch_robot(stack, settings)?);
    spawner.spawn(report()?);
    Ok(())
}

#[embassy_executor::task]
async fn run_stack(mut runner: NetRunner) -> ! {
    runner.run().await
}

#[embassy_executor::task]
async fn find_address(stack: Stack<'static>, settings: &'static Settings<'static>) {
    address::find(stack, settings).await;
}

#[embassy_executor::task(pool_size = RAC_SESSIONS)]
async fn serve_rac(
    stack: Stack<'static>,
    memory: &'static mut [[u8; 512]; 2],
    session: &'static mut Option<RacSession>,
) -> ! {
    let [rx, tx] = memory;
    let make = || RacSession::new(rac_server::Config::TCP, [0; 512]);
    let options = Options { backlog: Some(&BACKLOG), ..Options::default() };
    Listener::with_options(stack, rac::PORT, rx, tx, options).run(session, make, &NODE, &Limits::default()).await
}

#[embassy_executor::task]
async fn serve_bcap(stack: Stack<'static>) -> ! {
    static MEMORY: ConstStaticCell<[[u8; 512]; 2]> = ConstStaticCell::new([[0; 512]; 2]);
    static SESSION: StaticCell<Option<BcapSession>> = StaticCell::new();
    let [rx, tx] = MEMORY.take();
    let make = || BcapSession::new(bcap_server::Config::TCP, [0; 512], [0; 512]);
    Listener::new(stack, BCAP_PORT, rx, tx).run(SESSION.init_with(|| None), make, &NODE, &Limits::default()).await
}

#[embassy_executor::task]
async fn serve_udp(stack: Stack<'static>) {
    static META: StaticCell<[[PacketMetadata; 2]; 2]> = StaticCell::new();
    static MEMORY: ConstStaticCell<[[u8; 1024]; 2]> = ConstStaticCell::new([[0; 1024]; 2]);
    static PEERS: StaticCell<[Option<UdpPeer<16>>; 2]> = StaticCell::new();
    let ([rx_meta, tx_meta], [rx, tx]) = (META.init_with(|| [[PacketMetadata::EMPTY; 2]; 2]), MEMORY.take());
    let mut socket = UdpSocket::new(stack, rx_meta, rx, tx_meta, tx);
    match socket.bind(BCAP_PORT) {
        Ok(()) => UdpServer::new(&mut socket, PEERS.init_with(|| [None, None]), &NODE, Limits::default()).run().await,
        Err(error) => defmt::error!("UDP port {=u16}: {}", BCAP_PORT, error),
    }
}

/// Reads a variable of the robot each second; reconnects after a failure.
#[embassy_executor::task]
async fn watch_robot(stack: Stack<'static>, settings: &'static Settings<'static>) -> ! {
    static MEMORY: ConstStaticCell<[[u8; 512]; 4]> = ConstStaticCell::new([[0; 512]; 4]);
    let [rx, tx, request, reply] = MEMORY.take();
    let transport = TcpTransport::new(stack, rx, tx, Options::default());
    let mut robot = Connection::new(transport, Client::new(ClientConfig::TCP, &mut request[..], &mut reply[..]));
    let mut pause = 1;
    loop {
        let error = match connect(&mut robot, settings).await {
            Ok(()) => {
                pause = 1;
                read(&mut robot, settings).await
            }
            Err(error) => CallError::Io(error),
        };
        NODE.update(|node| node.robot_is_up = false);
        defmt::warn!("robot: {}, retry in {=u64} s", error, pause);
        Timer::after_secs(pause).await;
        pause = (pause * 2).min(30);
    }
}

async fn connect(robot: &mut TcpClient<'_, &mut [u8]>, settings: &Settings<'_>) -> Result<(), NetError> {
    robot.transport().connect(settings.robot.address).await?;
    robot.client().reset();
    Ok(())
}

/// Reads the variable until a call fails.
async fn read(robot: &mut TcpClient<'_, &mut [u8]>, settings: &Settings<'_>) -> CallError<NetError> {
    let read = async {
        robot.call(call::service_start("WDT=400")).await?;
        let controller = robot.call(call::controller_connect("", settings.provider, "localhost", "")).await?;
        let variable = robot.call(call::controller_get_variable(controller, settings.variable, "")).await?;
        NODE.update(|node| node.robot_is_up = true);
        loop {
            let value = robot.call(call::variable_get_value(variable)).await?;
            defmt::info!("robot: {=str} = {}", settings.variable, value);
            Timer::after_secs(1).await;
        }
    };
    let ended: Result<core::convert::Infallible, _> = read.await;
    match ended {
        Err(error) => error,
        Ok(never) => match never {},
    }
}

/// Logs the state of the board periodically.
#[embassy_executor::task]
async fn report() -> ! {
    loop {
        Timer::after_secs(10).await;
        let (answered, refused) = NODE.view(Node::counters).unwrap_or_default();
        defmt::info!(
            "up {=u64} s, answered {=u32}, refused {=u32}, {}, stack {=usize} of {=usize}",
            Instant::now().as_secs(),
            answered,
            refused,
            lan9118::counters(),
            stack::high_water(),
            stack::size(),
        );
    }
}
