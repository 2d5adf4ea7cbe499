//! A board that moves the robot: it streams a trajectory in Slave Mode, a pose every 8 ms by its own timer.
//!
//! ```text
//!  joint 1   ____----____      10 degrees and back in 16 s, from the robot's present pose; mode 0, 2,000 poses
//!  slave: 2005 cycles, late 0, underflows 0, refused 0, round trip p50 .. p99 .. max .. us, jitter p50 .. p99 .. max .. us
//!  slave: slvMove: refused with ...           and the controller's first error, over a second connection
//!  slave: perhaps left on the robot: ...      if the calls that end the stream fail; halt the robot
//!  slave: does not move the robot (...); ...  after a reset, for example by a panic; switch the board off and on
//! ```
//!
//! It speaks TCP to the configured controller. After the trajectory the program ends; with success if no pose reached the
//! robot too late. A board then stops, and moves the robot again only after power-on.
#![no_std]
#![no_main]

use core::fmt::Write as _;

use bcap_board::record::Cause;
use bcap_board::{Settings, address, stack};
use bcap_core::bcap::Client;
use bcap_core::bcap::client::Config as ClientConfig;
use bcap_core::procedure::{Effects, Provider, open_robot};
use bcap_core::slave::{
    AxisLimits, Config, Cycle, Engine, Format, MOVE_FRAME, Mode, Next, Pose, PoseType, ReceiveFormat, ReceivePose,
    SlaveMode, Stats,
};
use bcap_embassy::net::{Connection, Options, TcpClient, TcpTransport};
use bcap_firmware::net::{self, NetRunner};
use bcap_firmware::uart::Text;
use bcap_firmware::{config, executor, fault};
use embassy_executor::{SpawnError, Spawner};
use embassy_net::{Stack, StackResources};
use embassy_time::Timer;
use static_cell::{ConstStaticCell, StaticCell};

/// Sockets: two connections, DHCP.
const SOCKETS: usize = 3;
const CYCLES: u32 = 2000;
/// The rotation of joint 1, in degrees.
const TURN: f64 = 10.0;

type Link = TcpClient<'static, &'static mut [u8]>;
/// The buffers of a connection: the socket's two, one for a request and one for a reply.
type Memory = [[u8; 512]; 4];

#[panic_handler]
fn panic(info: &core::panic::PanicInfo<'_>) -> ! {
    fault::panic_text(info)
}

#[cortex_m_rt::entry]
fn main() -> ! {
    stack::run(program)
}

extern "C" fn program() -> ! {
    executor::run(|spawner| {
        if start(spawner).is_err() {
            let _ = writeln!(Text, "there is no room for a task");
            fault::end()
        }
    })
}

/// Starts the board and all tasks.
#[inline(never)]
fn start(spawner: Spawner) -> Result<(), SpawnError> {
    // not a `ConstStaticCell`: with a host name in it, the type is not `Send`
    static RESOURCES: StaticCell<StackResources<SOCKETS>> = StaticCell::new();

    let cause = fault::last_reset();
    if cause != Cause::PowerOn {
        let _ = writeln!(Text, "slave: does not move the robot (last reset: {cause}); switch the board off and on");
        fault::fail()
    }
    let settings = config::load(|line| {
        let _ = writeln!(Text, "settings: cannot read \"{}\"", line.escape_ascii());
    });
    let (stack, runner) = net::start(settings, RESOURCES.init_with(StackResources::new));
    spawner.spawn(run_stack(runner)?);
    spawner.spawn(play(stack, settings)?);
    Ok(())
}

#[embassy_executor::task]
async fn run_stack(mut runner: NetRunner) -> ! {
    runner.run().await
}

#[embassy_executor::task]
async fn play(stack: Stack<'static>, settings: &'static Settings<'static>) -> ! {
    static MOTION: ConstStaticCell<Memory> = ConstStaticCell::new([[0; 512]; 4]);
    static WATCH: ConstStaticCell<Memory> = ConstStaticCell::new([[0; 512]; 4]);
    address::find(stack, settings).await;
    let mut motion = link(stack, MOTION.take());
    let mut watch = link(stack, WATCH.take());
    while let Err(error) = connect(&mut motion, &mut watch, settings).await {
        let _ = writeln!(Text, "slave: no connection, again in 1 s: {error}");
        Timer::after_secs(1).await;
    }
    if stream(&mut motion, &mut watch, settings).await { fault::succeed() } else { fault::fail() }
}

fn link(stack: Stack<'static>, memory: &'static mut Memory) -> Link {
    let [rx, tx, request, reply] = memory;
    let transport = TcpTransport::new(stack, rx, tx, Options::default());
    Connection::new(transport, Client::new(ClientConfig::TCP, &mut request[..], &mut reply[..]))
}

async fn connect(
    motion: &mut Link,
    watch: &mut Link,
    settings: &Settings<'_>,
) -> Result<(), bcap_embassy::net::NetError> {
    for link in [motion, watch] {
        link.transport().connect(settings.robot.address).await?;
        link.client().reset();
    }
    Ok(())
}

/// Streams the trajectory and logs its statistics; returns whether it succeeded.
async fn stream(motion: &mut Link, watch: &mut Link, settings: &Settings<'_>) -> bool {
    let provider = Provider::new(settings.provider);
    let handles = motion.run(open_robot(provider, None)).await;
    let watching = watch.run(open_robot(provider, None)).await;
    let (handles, watching) = match (handles, watching) {
        (Ok(handles), Ok(watching)) => (handles, watching),
        (Err(error), _) | (_, Err(error)) => {
            let _ = writeln!(Text, "slave: no session: {error}");
            return false;
        }
    };
    let mode = SlaveMode { mode: Mode::Mode0, pose: PoseType::J };
    let format = Format::new(mode, ReceiveFormat::pose(ReceivePose::J));
    let limits = AxisLimits::uniform(20.0, 100.0);
    let config = Config { watch: Some(watching), limits, ..Config::new(format, handles) };
    let mut engine = match Engine::<MOVE_FRAME>::new(config) {
        Ok(engine) => engine,
        Err(error) => {
            let _ = writeln!(Text, "slave: {error}");
            return false;
        }
    };
    let ended = motion.run_watched(watch, engine.stream(&mut trajectory)).await;
    match (&ended, engine.fault()) {
        (Err(_), Some(fault)) => {
            let _ = writeln!(Text, "slave: {fault}");
            if let Err(error) = motion.run_watched(watch, engine.give_up()).await {
                let _ = writeln!(Text, "slave: the stream was not given up: {error}");
            }
        }
        (Err(error), None) => {
            let _ = writeln!(Text, "slave: {error}");
        }
        (Ok(()), _) => {}
    }
    let Effects { moving, streaming, motor, .. } = engine.effects();
    if moving || streaming || motor {
        let _ =
            writeln!(Text, "slave: perhaps left on the robot: motion {moving}, Slave Mode {streaming}, motor {motor}");
    }
    report(engine.stats());
    ended.is_ok() && engine.stats().underflows == 0
}

/// Turns joint 1 there and back, at rest at both ends and with a continuous acceleration.
fn trajectory(cycle: &Cycle<'_>) -> Next {
    if cycle.number == CYCLES {
        return Next::Finish;
    }
    let part = f64::from(cycle.number + 1) / f64::from(CYCLES / 2);
    let x = if part > 1.0 { 2.0 - part } else { part };
    let by = TURN * x * x * x * (10.0 + x * (6.0 * x - 15.0));
    let mut joints = [0.0; 8];
    for (joint, start) in joints.iter_mut().zip(cycle.start.numbers()) {
        *joint = *start;
    }
    joints[0] += by;
    Next::Pose(Pose::j(joints))
}

fn report(stats: &Stats) {
    let Stats { cycles, late, underflows, refused, rtt, jitter, .. } = stats;
    let _ = writeln!(
        Text,
        "slave: {cycles} cycles, late {late}, underflows {underflows}, refused {refused}, round trip p50 {} p99 {} max {} us, \
         jitter p50 {} p99 {} max {} us",
        rtt.quantile(500),
        rtt.quantile(990),
        rtt.max(),
        jitter.quantile(500),
        jitter.quantile(990),
        jitter.max(),
    );
}
