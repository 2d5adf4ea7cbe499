//! Slave Mode over real sockets: the engine on the blocking clients, the virtual controller on the server.
//!
//! The tests of the virtual controller combine every format with every other, over a wire without time. A selection
//! here shows that sockets carry the same.

use std::fmt::Debug;
use std::net::SocketAddr;
use std::sync::{Arc, Mutex, PoisonError, mpsc};
use std::thread::{self, JoinHandle};
use std::time::Duration;

use bcap_core::bcap::call;
use bcap_core::bcap::client::Timing;
use bcap_core::hresult::HResult;
use bcap_core::io::CallError;
use bcap_core::io::blocking::{Connection, Transport};
use bcap_core::slave::{
    Action, Config, Engine, Extended, ExtendedAxes, Format, Handles, Mode, Pose, PoseType, ReceiveFormat, ReceivePose,
    SendFormat, SendIo, SlaveMode, TimeUnit, UserIo,
};
use bcap_core::storage::Storage;
use bcap_sim::{Controller, Profile, VariableKind};
use bcap_std::server::Server;
use bcap_std::{Options, blocking, now};
use tokio::sync::oneshot;

/// A virtual controller on free ports of the loopback, until this is dropped.
struct Served {
    controller: Arc<Mutex<Controller>>,
    tcp: SocketAddr,
    udp: SocketAddr,
    stop: Option<oneshot::Sender<()>>,
    thread: Option<JoinHandle<()>>,
}

impl Served {
    fn start() -> Self {
        let config = bcap_sim::Config {
            extended_axes: 2,
            motor_on_delay: Duration::ZERO,
            ..bcap_sim::Config::new(Profile::Rc8)
        };
        let controller = Arc::new(Mutex::new(Controller::new(config)));
        let shared = Arc::clone(&controller);
        let (stop, stopped) = oneshot::channel();
        let (tell, told) = mpsc::channel();
        let thread = thread::spawn(move || {
            let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().expect("a runtime");
            runtime.block_on(async {
                let server = Server::with_shared(shared).bcap_tcp("127.0.0.1:0").await.expect("a port for TCP");
                let server = server.bcap_udp("127.0.0.1:0").await.expect("a port for UDP");
                tell.send(server.addresses()).expect("the test waits");
                server.run(async { _ = stopped.await }).await.expect("the listeners last");
            });
        });
        let addresses = told.recv().expect("the server starts");
        let (tcp, udp) = (addresses.bcap_tcp[0], addresses.bcap_udp[0]);
        Self { controller, tcp, udp, stop: Some(stop), thread: Some(thread) }
    }

    fn look<T>(&self, at: impl FnOnce(&Controller) -> T) -> T {
        at(&self.controller.lock().unwrap_or_else(PoisonError::into_inner))
    }
}

impl Drop for Served {
    fn drop(&mut self) {
        drop(self.stop.take());
        if let Some(thread) = self.thread.take()
            && thread.join().is_err()
            && !thread::panicking()
        {
            panic!("the server has panicked");
        }
    }
}

/// Streams over one connection; returns how many poses were answered, and how many refused.
fn stream<X: Transport<Error: Debug>, T: Storage, R: Storage>(
    mut connection: Connection<X, T, R>,
    format: Format,
) -> (u32, u32) {
    // a machine that is busy may keep an answer for long; this test does not check times
    let usual = connection.client().timing();
    connection.client().set_timing(Timing { attempts: 250, ..usual });
    connection.call(call::service_start("")).unwrap();
    let provider = Profile::Rc8.provider();
    let controller = connection.call(call::controller_connect("", provider, "localhost", "")).unwrap();
    let robot = connection.call(call::controller_get_robot(controller, "Arm", "")).unwrap();
    let mut engine = Engine::<512>::new(Config::new(format, Handles { controller, robot })).unwrap();
    let (mut count, mut answers) = (0, 0);
    let end = loop {
        match engine.poll(now()) {
            Action::Call(..) => {
                let client = connection.client();
                let timing = engine.timing(client.link(), client.timing());
                let replied = connection.call_with(engine.request().unwrap(), timing).map(drop);
                assert!(matches!(replied, Ok(()) | Err(CallError::Refused(_))), "{format:?}: {replied:?}");
                let reply = connection.client().reply().unwrap();
                answers += u32::from(engine.handle_reply(&reply, now()).is_some());
            }
            Action::Wait(until) => thread::sleep(until.saturating_since(now())),
            Action::Pose { .. } if count == POSES => engine.finish(),
            Action::Pose { .. } => {
                count += 1;
                set_outputs(&mut engine);
                engine.push(&pose(&engine, count)).unwrap();
            }
            end => break end,
        }
    };
    assert_eq!(end, Action::Finished, "{format:?}: {:?}", engine.fault());
    connection.call(call::controller_disconnect(controller)).unwrap();
    connection.call(call::service_stop()).unwrap();
    (answers, engine.stats().refused)
}

const POSES: u32 = 10;

/// The change of a pose's first number in each cycle: so slow that the robot counts as standing, and a late pose from a
/// busy machine makes no underflow.
const STEP: f64 = 5e-5;

fn pose(engine: &Engine<512>, count: u32) -> Pose {
    let start = engine.start_pose().unwrap();
    let mut numbers = start.numbers().to_vec();
    numbers[0] += STEP * f64::from(count);
    let pose = Pose::from_numbers(start.shape().pose, &numbers).unwrap();
    if start.shape().extended == ExtendedAxes::Both { pose.with_extended(Extended::Both(0.0, 0.0)) } else { pose }
}

fn set_outputs(engine: &mut Engine<512>) {
    let send = engine.config().format.send;
    if send.io == SendIo::Mini {
        engine.set_mini_io(0x0005_0000).unwrap();
    }
    if matches!(send.io, SendIo::User(_)) {
        engine.set_user_io(&[0xa5, 0x3c]).unwrap();
    }
    if send.hand_io {
        engine.set_hand_io(0x0003_0000).unwrap();
    }
}

/// Each mode with each type of pose; the formats go from the smallest to the largest.
fn formats() -> impl Iterator<Item = (Format, &'static [u32])> {
    let (in_user, out_user) = (UserIo::new(128, 4).unwrap(), UserIo::new(136, 2).unwrap());
    let receive = ReceiveFormat::pose;
    let formats = [
        (ExtendedAxes::None, SendFormat::POSE, receive(ReceivePose::J), &[][..]),
        (
            ExtendedAxes::None,
            SendFormat { io: SendIo::Mini, hand_io: true },
            ReceiveFormat { time: Some(TimeUnit::Millis), mini_io: true, hand_io: true, ..receive(ReceivePose::PJ) },
            &[16, 18, 64, 65],
        ),
        (
            ExtendedAxes::Both,
            SendFormat { io: SendIo::User(out_user), hand_io: true },
            ReceiveFormat {
                time: Some(TimeUnit::Micros),
                mini_io: true,
                user_io: Some(in_user),
                hand_io: true,
                current: true,
                ..receive(ReceivePose::TJ)
            },
            &[64, 65, 136, 138, 141, 143, 146, 147, 148, 149],
        ),
    ];
    [Mode::Mode0, Mode::Mode1, Mode::Mode2].into_iter().enumerate().flat_map(move |(m, mode)| {
        [PoseType::P, PoseType::J, PoseType::T].into_iter().enumerate().map(move |(p, pose)| {
            let (extended, send, receive, ports) = formats[(m + p) % 3];
            (Format { extended, send, ..Format::new(SlaveMode { mode, pose }, receive) }, ports)
        })
    })
}

fn check(served: &Served, format: &Format, ports: &[u32], answers: u32, refused: u32) {
    let taken = served.look(Controller::slave_counters).taken;
    assert_eq!(served.look(|c| c.errors().map(|e| e.code).collect::<Vec<HResult>>()), [], "{format:?}");
    assert_eq!(served.look(|c| (c.slave_mode(), c.arm_owner())), (0, None), "{format:?}");
    assert!(answers > POSES, "{format:?}: {answers} answers");
    // mode 1 takes the newest of a cycle, and a busy machine may bring two in one
    let all = format.mode.mode == Mode::Mode1 || taken == u64::from(answers);
    assert!(all, "{format:?}: {taken} poses of {answers} were taken, {refused} refused");
    let on =
        |n: &u32| served.look(|c| c.variable::<16>(VariableKind::Io, *n)).unwrap().as_variant().as_bool() == Some(true);
    assert_eq!((0..160).filter(on).collect::<Vec<_>>(), ports, "{format:?}");
}

#[test]
fn formats_of_slave_mode_go_over_tcp() {
    for (format, ports) in formats() {
        let served = Served::start();
        let (answers, refused) = stream(blocking::connect_tcp(served.tcp, &Options::default()).unwrap(), format);
        check(&served, &format, ports, answers, refused);
    }
}

#[test]
fn formats_of_slave_mode_go_over_udp() {
    for (format, ports) in formats() {
        let served = Served::start();
        let (answers, refused) = stream(blocking::connect_udp(served.udp, &Options::default()).unwrap(), format);
        check(&served, &format, ports, answers, refused);
    }
}
