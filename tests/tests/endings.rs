//! How programs end: with an error, by a panic, without a connection. The robot rests then, with its motor off and its arm
//! free.

use std::collections::HashMap;
use std::io;
use std::net::{SocketAddr, UdpSocket};
use std::panic::AssertUnwindSafe;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

use bcap_core::bcap::{FunctionId, Object};

use bcap_core::rac::VariableKind;
use bcap_core::slave::{AxisLimits, Cycle, Format, Mode, Next, PoseType, ReceiveFormat, ReceivePose, SlaveMode};
use bcap_core::time::Instant;
use bcap_core::variant::OwnedVariant;
use bcap_sim::memory::{Network, Wire};
use bcap_sim::{Config, Controller as Simulated, Profile};
use bcap_std::blocking::Transport;
use bcap_std::{Backoff, Error, Joints, Move, Settings, asynch, blocking};
use bcap_tests::proxy::Relay;
use bcap_tests::served::Served;
use bcap_tests::simulated::simulated;

const LIMIT: Duration = Duration::from_secs(30);

fn settings() -> Settings {
    Settings::rc8().reconnect(Backoff::default().min(Duration::from_millis(1)).max(Duration::from_millis(20)))
}

/// A motion of 20 s, so that it does not reach its end on a busy machine.
fn far() -> Move {
    Move::joint(Joints::new([150.0, 45.0, 90.0, 0.0, 45.0, 0.0])).speed_percent(2.0)
}

/// A motion of some polls.
fn near() -> Move {
    Move::joint(Joints::new([1.0, 45.0, 90.0, 0.0, 45.0, 0.0]))
}

/// Asserts that another client's motion continues, with the motor on.
fn assert_undisturbed(sim: &Served<Simulated>) {
    let mut controller = sim.application();
    controller.advance(bcap_std::now());
    assert!(controller.is_moving() && controller.motor_is_on());
}

/// Asserts that the robot rests, with its motor off, and that no client has the arm. It may brake for some more cycles.
fn assert_safe(sim: &Served<Simulated>) {
    let (owner, motor) = {
        let controller = sim.application();
        (controller.arm_owner(), controller.motor_is_on())
    };
    assert_eq!((owner, motor), (None, false));
    sim.until(|controller| !controller.is_moving() && controller.slave_mode() == 0);
    assert!(sim.application().joints()[0] < 149.0, "it went on to the end");
}

fn runtimes() -> [tokio::runtime::Runtime; 2] {
    let one = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    let many = tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build().unwrap();
    [one, many]
}

/// The `main` of a program with tokio returns an error during a motion, and its runtime ends.
#[test]
fn a_program_that_fails_during_a_motion_leaves_nothing() {
    for runtime in 0..2 {
        for protocol in ["tcp", "udp"] {
            let sim = simulated();
            let peer = if protocol == "tcp" { sim.tcp } else { sim.udp };
            let runtime = runtimes().into_iter().nth(runtime).unwrap();
            let ended: Result<(), Error> = runtime.block_on(async {
                let cell = asynch::Controller::connect(&format!("{protocol}:{peer}"), &settings()).await?;
                let mut arm = cell.robot().await?.take_arm().await?;
                arm.motor_on().await?;
                let _moving = arm.start(&far(), LIMIT).await?;
                cell.read::<i32>("NOPE1").await.map(drop)
            });
            assert!(matches!(ended, Err(Error::Refused { .. })), "{ended:?}");
            drop(runtime);
            assert_safe(&sim);
        }
    }
}

#[test]
fn a_program_that_only_reads_stops_no_other_client() {
    let sim = simulated();
    let mut other = blocking::Controller::connect(&sim.address(), &settings()).unwrap();
    let mut arm = other.robot().unwrap().take_arm().unwrap();
    arm.motor_on().unwrap();
    let moving = arm.start(&far(), LIMIT).unwrap();
    for runtime in runtimes() {
        let cell = runtime.block_on(async {
            let cell = asynch::Controller::connect(&sim.address(), &settings()).await.unwrap();
            cell.robot().await.unwrap().joints().await.unwrap();
            cell
        });
        drop((cell, runtime));
        assert_undisturbed(&sim);
    }
    drop(moving);
    drop(arm);
    assert_safe(&sim);
}

#[test]
fn a_program_may_leave_the_robot_as_it_is() {
    let sim = simulated();
    let [runtime, _] = runtimes();
    runtime.block_on(async {
        let settings = settings().keep(true);
        let cell = asynch::Controller::connect(&sim.address(), &settings).await.unwrap();
        let mut arm = cell.robot().await.unwrap().take_arm().await.unwrap();
        arm.motor_on().await.unwrap();
    });
    drop(runtime);
    assert!(sim.application().motor_is_on());
    let settings = settings().keep(true);
    let mut cell = blocking::Controller::connect(&sim.address(), &settings).unwrap();
    sim.until(|controller| controller.arm_owner().is_none());
    drop(cell.robot().unwrap().take_arm().unwrap());
    drop(cell);
    assert!(sim.application().motor_is_on());
}

/// A trajectory that panics at a cycle, in both kinds of programs.
#[test]
fn a_panic_in_a_trajectory_leaves_nothing() {
    let mode = SlaveMode { mode: Mode::Mode2, pose: PoseType::J };
    let format = Format::new(mode, ReceiveFormat::pose(ReceivePose::J));
    let limits = AxisLimits::uniform(100.0, 800.0);
    let panics_at = |cycle: u32| {
        move |now: &Cycle<'_>| {
            assert!(now.number < cycle, "in the trajectory");
            Next::Pose(*now.start)
        }
    };
    for cycle in [0, 1, 20] {
        for runtime in runtimes() {
            let sim = simulated();
            let ended = std::panic::catch_unwind(AssertUnwindSafe(|| {
                runtime.block_on(async {
                    let cell = asynch::Controller::connect(&sim.address(), &settings()).await.unwrap();
                    let mut arm = cell.robot().await.unwrap().take_arm().await.unwrap();
                    arm.motor_on().await.unwrap();
                    arm.stream(format, limits, panics_at(cycle)).await.unwrap();
                });
            }));
            let panic = ended.unwrap_err();
            assert_eq!(panic.downcast_ref::<&str>(), Some(&"in the trajectory"));
            drop(runtime);
            assert_safe(&sim);
        }
        let sim = simulated();
        let ended = std::panic::catch_unwind(AssertUnwindSafe(|| {
            let mut cell = blocking::Controller::connect(&sim.address(), &settings()).unwrap();
            let mut arm = cell.robot().unwrap().take_arm().unwrap();
            arm.motor_on().unwrap();
            arm.stream(format, limits, &mut panics_at(cycle)).unwrap();
        }));
        assert_eq!(ended.unwrap_err().downcast_ref::<&str>(), Some(&"in the trajectory"));
        assert_safe(&sim);
    }
}

#[test]
fn after_a_lost_connection_the_next_session_stops_the_robot_first() {
    let sim = simulated();
    let relay = Relay::tcp(sim.tcp);
    let [runtime, _] = runtimes();
    runtime.block_on(async {
        let cell = asynch::Controller::connect(&format!("tcp:{}", relay.tcp), &settings()).await.unwrap();
        let mut recoveries = cell.recoveries();
        let mut arm = cell.robot().await.unwrap().take_arm().await.unwrap();
        arm.motor_on().await.unwrap();
        let cut = async {
            tokio::task::yield_now().await;
            while !sim.application().is_moving() {
                tokio::time::sleep(Duration::from_millis(1)).await;
            }
            relay.disconnect();
        };
        let (ended, ()) = tokio::join!(arm.move_to(&far(), LIMIT), cut);
        // it was sent, so it must not be reported as unsent
        assert!(matches!(ended, Err(Error::NoReply { .. })), "{ended:?}");
        let recovery = recoveries.next().await.unwrap();
        assert_eq!((recovery.halted, recovery.motor_off), (Some(true), Some(true)), "{recovery:?}");
        assert!(matches!(arm.motor_on().await, Err(Error::ArmLost)));
        assert_safe(&sim);
        cell.connected().await.unwrap();
    });
}

#[test]
fn after_a_lost_connection_the_drop_stops_the_robot() {
    let sim = simulated();
    let relay = Relay::tcp(sim.tcp);
    let mut cell = blocking::Controller::connect(&format!("tcp:{}", relay.tcp), &settings()).unwrap();
    let mut arm = cell.robot().unwrap().take_arm().unwrap();
    arm.motor_on().unwrap();
    let moving = arm.start(&far(), LIMIT).unwrap();
    relay.disconnect();
    let ended = moving.wait();
    assert!(matches!(ended, Err(Error::NoReply { .. })), "{ended:?}");
    drop(arm);
    drop(cell);
    assert_safe(&sim);
}

/// A program that ends while it is disconnected.
#[test]
fn a_program_that_ends_without_a_connection_stops_the_robot() {
    for runtime in runtimes() {
        let sim = simulated();
        let relay = Relay::tcp(sim.tcp);
        let slow = settings().reconnect(Backoff::default().min(LIMIT).max(LIMIT));
        runtime.block_on(async {
            let cell = asynch::Controller::connect(&format!("tcp:{}", relay.tcp), &slow).await.unwrap();
            let mut arm = cell.robot().await.unwrap().take_arm().await.unwrap();
            arm.motor_on().await.unwrap();
            let moving = arm.start(&far(), LIMIT).await.unwrap();
            relay.disconnect();
            assert!(matches!(moving.wait().await, Err(Error::NoReply { .. })));
        });
        drop(runtime);
        assert_safe(&sim);
    }
}

/// A datagram relay that is unreachable for a while; then another client's port is another session.
struct Datagrams {
    address: SocketAddr,
    to: SocketAddr,
    open: Arc<AtomicBool>,
    thread: Option<JoinHandle<Sessions>>,
}

/// The sockets of the clients that a relay has seen.
type Sessions = HashMap<SocketAddr, UdpSocket>;

impl Datagrams {
    fn new(to: SocketAddr) -> Self {
        let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
        let address = socket.local_addr().unwrap();
        let mut relay = Self { address, to, open: Arc::default(), thread: None };
        relay.start(socket, Sessions::new());
        relay
    }

    fn start(&mut self, front: UdpSocket, mut sessions: Sessions) {
        self.open = Arc::new(AtomicBool::new(true));
        let (open, to) = (Arc::clone(&self.open), self.to);
        self.thread = Some(std::thread::spawn(move || {
            front.set_read_timeout(Some(Duration::from_millis(1))).unwrap();
            let mut buffer = [0; 1500];
            while open.load(Ordering::Relaxed) {
                if let Ok((count, client)) = front.recv_from(&mut buffer) {
                    let session = sessions.entry(client).or_insert_with(|| {
                        let session = UdpSocket::bind("127.0.0.1:0").unwrap();
                        session.connect(to).unwrap();
                        session.set_nonblocking(true).unwrap();
                        session
                    });
                    session.send(&buffer[..count]).unwrap();
                }
                for (client, session) in &sessions {
                    while let Ok(count) = session.recv(&mut buffer) {
                        let _ = front.send_to(&buffer[..count], client);
                    }
                }
            }
            sessions
        }));
    }

    /// Makes the address unreachable, and returns the sessions that the controller still has.
    fn cut(&mut self) -> Sessions {
        self.open.store(false, Ordering::Relaxed);
        self.thread.take().unwrap().join().unwrap()
    }

    fn heal(&mut self, sessions: Sessions) {
        self.start(UdpSocket::bind(self.address).unwrap(), sessions);
    }
}

/// Over UDP the controller does not detect that a session was lost, so it would keep the arm for that session.
#[test]
fn an_unreachable_datagram_link_leaves_nothing() {
    for moves in [false, true] {
        let sim = simulated();
        let mut relay = Datagrams::new(sim.udp);
        let [runtime, _] = runtimes();
        runtime.block_on(async {
            let cell = asynch::Controller::connect(&format!("udp:{}", relay.address), &settings()).await.unwrap();
            let mut recoveries = cell.recoveries();
            let mut arm = cell.robot().await.unwrap().take_arm().await.unwrap();
            arm.motor_on().await.unwrap();
            let moving = if moves { Some(arm.start(&far(), LIMIT).await.unwrap()) } else { None };
            let sessions = relay.cut();
            while cell.state() == asynch::State::Connected {
                let _ = cell.read::<i32>("I1").await;
            }
            relay.heal(sessions);
            let recovery = recoveries.next().await.unwrap();
            // after a halted motion, TakeArm is refused because of its error and does not reveal that the arm is free
            assert_eq!((recovery.halted, recovery.motor_off, recovery.arm_free), (Some(true), Some(true), !moves));
            assert_safe(&sim);
            drop(moving);
            drop(arm);
            cell.execute::<()>("ClearError", ()).await.unwrap();
            drop(cell.robot().await.unwrap().take_arm().await.unwrap());
        });
    }
}

/// The controller has closed the connection, so it has ended the session, and another client may use the robot.
#[test]
fn a_robot_that_another_client_has_taken_meanwhile_is_left_alone() {
    let sim = simulated();
    let relay = Relay::tcp(sim.tcp);
    let [runtime, _] = runtimes();
    runtime.block_on(async {
        let slow = settings().reconnect(Backoff::default().min(LIMIT).max(LIMIT));
        let cell = asynch::Controller::connect(&format!("tcp:{}", relay.tcp), &slow).await.unwrap();
        let mut arm = cell.robot().await.unwrap().take_arm().await.unwrap();
        arm.motor_on().await.unwrap();
        let moving = arm.start(&far(), LIMIT).await.unwrap();
        relay.disconnect();
        assert!(matches!(moving.wait().await, Err(Error::NoReply { .. })));
        sim.until(|controller| controller.arm_owner().is_none() && !controller.is_moving());
        let mut other = blocking::Controller::connect(&sim.address(), &settings()).unwrap();
        other.execute::<()>("ClearError", ()).unwrap();
        let mut theirs = other.robot().unwrap().take_arm().unwrap();
        theirs.motor_on().unwrap();
        let their_motion = theirs.start(&far(), LIMIT).unwrap();
        // the drop of its task recovers over a new connection
        drop(arm);
        drop(cell);
        tokio::time::sleep(Duration::from_secs(1)).await;
        assert_undisturbed(&sim);
        drop(their_motion);
    });
    drop(runtime);
    assert_safe(&sim);
}

/// The caller of a motion is informed that it was sent, although another handle closes the controller.
#[test]
fn a_motion_whose_controller_is_closed_may_have_moved() {
    let sim = simulated();
    let [runtime, _] = runtimes();
    runtime.block_on(async {
        let cell = asynch::Controller::connect(&sim.address(), &settings()).await.unwrap();
        let mut arm = cell.robot().await.unwrap().take_arm().await.unwrap();
        arm.motor_on().await.unwrap();
        let close = async {
            while !sim.application().is_moving() {
                tokio::time::sleep(Duration::from_millis(1)).await;
            }
            cell.close().await
        };
        let (ended, closed) = tokio::join!(arm.move_to(&far(), LIMIT), close);
        assert!(matches!(ended, Err(Error::NoReply { .. })), "{ended:?}");
        closed.unwrap();
        assert_safe(&sim);
    });
}

/// The caller waits in another runtime than the task of the session, which ends.
#[test]
fn a_motion_whose_runtime_ends_may_have_moved() {
    let sim = simulated();
    let [caller, task] = runtimes();
    let cell = task.block_on(asynch::Controller::connect(&sim.address(), &settings())).unwrap();
    let ended = caller.block_on(async {
        let mut arm = cell.robot().await.unwrap().take_arm().await.unwrap();
        arm.motor_on().await.unwrap();
        std::thread::scope(|scope| {
            scope.spawn(|| {
                sim.until(Simulated::is_moving);
                drop(task);
            });
            // it blocks this thread, as a caller without a task may
            scope.spawn(|| runtimes().into_iter().next().unwrap().block_on(arm.move_to(&far(), LIMIT))).join().unwrap()
        })
    });
    assert!(matches!(ended, Err(Error::NoReply { .. })), "{ended:?}");
    assert_safe(&sim);
    // no bytes are sent any more
    assert!(matches!(caller.block_on(cell.read::<i32>("I1")), Err(Error::Closed)));
}

/// A command by name: of the controller or the robot, and its parameter.
type ByName = (Object, &'static str, OwnedVariant);

fn by_name() -> Vec<ByName> {
    let motion = ("@0 (1, 150)", "SPEED=2,NEXT");
    vec![
        (Object::Robot, "mOTOR", OwnedVariant::new(&[1, 0]).unwrap()),
        (Object::Controller, "Motor", OwnedVariant::new(&[1, 0]).unwrap()),
        (Object::Variable, "robot/@servo_on", OwnedVariant::new(&true).unwrap()),
        (Object::Robot, "DriveEx", OwnedVariant::new(&motion).unwrap()),
        (Object::Robot, "slvChangeMode", OwnedVariant::new(&0x102).unwrap()),
    ]
}

/// A motor needs no arm.
#[test]
fn a_motor_that_was_switched_on_without_the_arm_is_switched_off() {
    for (object, name, parameter) in by_name().into_iter().take(3) {
        let sim = simulated();
        let mut cell = blocking::Controller::connect(&sim.address(), &settings()).unwrap();
        match object {
            Object::Robot => cell.robot().unwrap().execute(name, &parameter).unwrap(),
            Object::Controller => cell.execute(name, &parameter).unwrap(),
            _ => cell.write(name, &parameter).unwrap(),
        }
        assert!(sim.application().motor_is_on(), "{name}");
        drop(cell);
        assert_safe(&sim);
        let sim = simulated();
        let [runtime, _] = runtimes();
        runtime.block_on(async {
            let cell = asynch::Controller::connect(&sim.address(), &settings()).await.unwrap();
            match object {
                Object::Robot => cell.robot().await.unwrap().execute(name, &parameter).await.unwrap(),
                Object::Controller => cell.execute(name, &parameter).await.unwrap(),
                _ => cell.write(name, &parameter).await.unwrap(),
            }
        });
        drop(runtime);
        assert_safe(&sim);
    }
}

/// A program may call a command by name; its end undoes that too.
#[test]
fn commands_by_name_leave_nothing() {
    for (object, name, parameter) in by_name() {
        let moves = object == Object::Robot && name != "mOTOR";
        let sim = simulated();
        {
            let mut cell = blocking::Controller::connect(&sim.address(), &settings()).unwrap();
            let mut robot = cell.robot().unwrap();
            robot.execute::<()>("TakeArm", [0, 1]).unwrap();
            if moves {
                robot.execute::<()>("Motor", [1, 0]).unwrap();
            }
            match object {
                Object::Robot => robot.execute(name, &parameter).unwrap(),
                Object::Controller => cell.execute(name, &parameter).unwrap(),
                _ => cell.write(name, &parameter).unwrap(),
            }
            assert!(sim.application().motor_is_on(), "{name}");
        }
        assert_safe(&sim);
        let sim = simulated();
        let [runtime, _] = runtimes();
        runtime.block_on(async {
            let cell = asynch::Controller::connect(&sim.address(), &settings()).await.unwrap();
            let robot = cell.robot().await.unwrap();
            robot.execute::<()>("TakeArm", [0, 1]).await.unwrap();
            if moves {
                robot.execute::<()>("Motor", [1, 0]).await.unwrap();
            }
            match object {
                Object::Robot => robot.execute(name, &parameter).await.unwrap(),
                Object::Controller => cell.execute(name, &parameter).await.unwrap(),
                _ => cell.write(name, &parameter).await.unwrap(),
            }
        });
        drop(runtime);
        assert_safe(&sim);
    }
}

/// As a tool does: with handles that it has opened itself.
#[test]
fn a_motor_that_a_handle_switched_on_is_switched_off() {
    let sim = simulated();
    let mut cell = blocking::Controller::connect(&sim.address(), &settings()).unwrap();
    cell.robot().unwrap().take_arm().unwrap().keep();
    assert!(matches!(cell.robot().unwrap().take_arm(), Err(Error::ArmTaken)));
    let robot = cell.open(&"robot".parse().unwrap()).unwrap();
    let arguments = [OwnedVariant::new(&robot), OwnedVariant::new("@SERVO_ON"), OwnedVariant::new("")];
    let (_, servo) = cell.call_any("", FunctionId::ROBOT_GET_VARIABLE, &arguments.map(Result::unwrap)).unwrap();
    let put = [servo.unwrap(), OwnedVariant::new(&true).unwrap()];
    cell.call_any("", FunctionId::VARIABLE_PUT_VALUE, &put).unwrap();
    assert!(sim.application().motor_is_on());
    drop(cell);
    assert_safe(&sim);
}

/// A link that passes a number of bytes in one direction, and fails then.
struct Failing {
    wire: Wire,
    sends: bool,
    left: Arc<AtomicUsize>,
}

impl Failing {
    /// Returns how many of these bytes pass; `None` if the link has failed.
    fn pass(&self, sends: bool, count: usize) -> Option<usize> {
        let left = self.left.load(Ordering::Relaxed);
        if sends != self.sends || left == usize::MAX {
            return Some(count);
        }
        let passed = left.min(count);
        self.left.store(left - passed, Ordering::Relaxed);
        (passed > 0).then_some(passed)
    }

    fn send_some(&mut self, bytes: &[u8]) -> io::Result<Option<usize>> {
        match self.pass(true, bytes.len()) {
            Some(count) => Transport::send(&mut self.wire, &bytes[..count], Instant::FAR_FUTURE),
            None => Err(io::ErrorKind::BrokenPipe.into()),
        }
    }

    fn receive_some(&mut self, buffer: &mut [u8], until: Instant) -> io::Result<Option<usize>> {
        let received = Transport::receive(&mut self.wire, buffer, until)?;
        Ok(received.map(|count| self.pass(false, count).unwrap_or(0)))
    }
}

impl Transport for Failing {
    type Error = io::Error;

    fn now(&self) -> Instant {
        Transport::now(&self.wire)
    }

    fn send(&mut self, bytes: &[u8], _: Instant) -> io::Result<Option<usize>> {
        self.send_some(bytes)
    }

    fn receive(&mut self, buffer: &mut [u8], until: Instant) -> io::Result<Option<usize>> {
        self.receive_some(buffer, until)
    }

    fn sleep_until(&mut self, at: Instant) {
        Transport::sleep_until(&mut self.wire, at);
    }
}

impl asynch::SendTransport for Failing {
    type Error = io::Error;

    fn now(&self) -> Instant {
        Transport::now(&self.wire)
    }

    async fn send(&mut self, bytes: &[u8], _: Instant) -> io::Result<Option<usize>> {
        self.send_some(bytes)
    }

    async fn receive(&mut self, buffer: &mut [u8], until: Instant) -> io::Result<Option<usize>> {
        self.receive_some(buffer, until)
    }

    async fn sleep_until(&mut self, at: Instant) {
        Transport::sleep_until(&mut self.wire, at);
    }
}

/// The result of a call, as reported to the program.
#[derive(Debug, PartialEq)]
enum Told {
    Done,
    NotSent,
    NoReply,
}

fn told<T>(ended: Result<T, Error>) -> Told {
    match ended {
        Ok(_) => Told::Done,
        Err(Error::NotConnected { .. }) => Told::NotSent,
        Err(Error::NoReply { .. }) => Told::NoReply,
        Err(error) => panic!("{error}"),
    }
}

/// Makes one call over a link that fails after each number of bytes, and compares the reported outcome with the
/// controller's record. `call` calls its second argument before the call, and returns the reported outcome.
fn at_every_byte(call: impl Fn(Failing, &dyn Fn()) -> Told, was_executed: impl Fn(&Simulated) -> bool) {
    for sends in [true, false] {
        let mut outcomes = [0; 3];
        for bytes in 0.. {
            let network = Network::new(Config { motor_on_delay: Duration::ZERO, ..Config::new(Profile::Rc8) });
            let left = Arc::new(AtomicUsize::new(usize::MAX));
            let link = Failing { wire: network.connect(), sends, left: Arc::clone(&left) };
            let told = call(link, &|| left.store(bytes, Ordering::Relaxed));
            let executed = was_executed(&network.controller());
            match told {
                Told::Done => assert!(executed, "{bytes} bytes, sends {sends}"),
                Told::NotSent => assert!(!executed, "{bytes} bytes, sends {sends}: it was not sent, and executed"),
                Told::NoReply => {}
            }
            outcomes[told as usize] += 1;
            if outcomes[0] > 0 {
                break;
            }
        }
        let [_, not_sent, no_reply] = outcomes;
        // a request that lacks a byte is not executed; one whose reply lacks a byte may be
        assert!(if sends { not_sent > 30 } else { no_reply > 15 }, "{outcomes:?}");
    }
}

fn at_every_byte_blocking(
    call: impl Fn(blocking::Controller, &dyn Fn()) -> Told,
    was_executed: impl Fn(&Simulated) -> bool,
) {
    at_every_byte(|link, begin| call(blocking::Controller::over(link, &settings()).unwrap(), begin), was_executed);
}

fn at_every_byte_async(
    call: impl AsyncFn(asynch::Controller, &dyn Fn()) -> Told,
    was_executed: impl Fn(&Simulated) -> bool,
) {
    let [runtime, _] = runtimes();
    let over = |link, begin: &dyn Fn()| {
        runtime.block_on(async { call(asynch::Controller::over(link, &settings()).await.unwrap(), begin).await })
    };
    at_every_byte(over, was_executed);
}

#[test]
fn a_write_that_was_not_sent_is_told_from_one_without_a_reply() {
    let is_written = |controller: &Simulated| {
        controller.variable::<32>(VariableKind::I, 1).is_ok_and(|value| value.as_variant().as_i32() == Some(7))
    };
    at_every_byte_blocking(
        |mut cell, begin| {
            cell.read::<i32>("I1").unwrap();
            begin();
            told(cell.write("I1", 7))
        },
        is_written,
    );
    at_every_byte_async(
        async |cell, begin| {
            cell.read::<i32>("I1").await.unwrap();
            begin();
            told(cell.write("I1", 7).await)
        },
        is_written,
    );
}

/// If a halt that was sent is reported as unsent, the program would assume that the robot still moves.
#[test]
fn a_halt_that_was_not_sent_is_told_from_one_without_a_reply() {
    at_every_byte_blocking(
        |mut cell, begin| {
            let mut arm = cell.robot().unwrap().take_arm().unwrap();
            arm.motor_on().unwrap();
            std::mem::forget(arm.start(&far(), LIMIT).unwrap());
            begin();
            let told = told(arm.robot().halt());
            arm.keep();
            // the end of its connection would halt the robot
            std::mem::forget(cell);
            told
        },
        |controller| !controller.is_moving(),
    );
}

#[test]
fn an_arm_that_was_given_back_unheard_is_told_from_one_that_was_kept() {
    let is_given = |controller: &Simulated| controller.arm_owner().is_none();
    at_every_byte_blocking(
        |mut cell, begin| {
            let arm = cell.robot().unwrap().take_arm().unwrap();
            begin();
            let told = told(arm.give());
            // the end of its connection would free the arm
            std::mem::forget(cell);
            told
        },
        is_given,
    );
    at_every_byte_async(
        async |cell, begin| {
            let arm = cell.robot().await.unwrap().take_arm().await.unwrap();
            begin();
            let told = told(arm.give().await);
            std::mem::forget(cell);
            told
        },
        is_given,
    );
}

#[test]
fn a_motor_call_that_was_not_sent_is_told_from_one_without_a_reply() {
    // the end of the arm would switch the motor off
    at_every_byte_blocking(
        |mut cell, begin| {
            let mut arm = cell.robot().unwrap().take_arm().unwrap();
            begin();
            let told = told(arm.motor_on());
            arm.keep();
            std::mem::forget(cell);
            told
        },
        Simulated::motor_is_on,
    );
    at_every_byte_async(
        async |cell, begin| {
            let mut arm = cell.robot().await.unwrap().take_arm().await.unwrap();
            begin();
            let told = told(arm.motor_on().await);
            std::mem::forget((cell, arm));
            told
        },
        Simulated::motor_is_on,
    );
}

/// Releasing the robot by name would leave the motor on.
#[test]
fn a_robot_that_is_released_by_name_is_left_with_its_motor_off() {
    for function in [FunctionId::ROBOT_RELEASE, FunctionId::CONTROLLER_DISCONNECT, FunctionId::SERVICE_STOP] {
        let sim = simulated();
        let mut cell = blocking::Controller::connect(&sim.address(), &settings()).unwrap();
        let robot = OwnedVariant::new(&cell.open(&"robot".parse().unwrap()).unwrap()).unwrap();
        let execute = |command: &str, parameter: &[i32]| {
            [robot.clone(), OwnedVariant::new(command).unwrap(), OwnedVariant::new(&parameter).unwrap()]
        };
        for (command, parameter) in [("TakeArm", &[0, 1]), ("Motor", &[1, 0])] {
            cell.call_any("", FunctionId::ROBOT_EXECUTE, &execute(command, parameter)).unwrap();
        }
        let motion = [robot.clone(), OwnedVariant::new("DriveEx").unwrap(), by_name()[3].2.clone()];
        cell.call_any("", FunctionId::ROBOT_EXECUTE, &motion).unwrap();
        assert!(sim.application().motor_is_on() && sim.application().is_moving());
        let handle = OwnedVariant::new(&cell.handle().0).unwrap();
        let arguments = match function {
            FunctionId::ROBOT_RELEASE => vec![robot.clone()],
            FunctionId::CONTROLLER_DISCONNECT => vec![handle],
            _ => vec![],
        };
        cell.call_any("", function, &arguments).unwrap();
        assert_safe(&sim);
    }
}

#[test]
fn a_motion_that_was_not_sent_is_told_from_one_that_may_be_under_way() {
    let has_moved = |controller: &Simulated| controller.is_moving() || controller.joints()[0] != 0.0;
    at_every_byte_blocking(
        |mut cell, begin| {
            let mut arm = cell.robot().unwrap().take_arm().unwrap();
            arm.motor_on().unwrap();
            begin();
            told(arm.move_to(&near(), LIMIT))
        },
        has_moved,
    );
    at_every_byte_async(
        async |cell, begin| {
            let mut arm = cell.robot().await.unwrap().take_arm().await.unwrap();
            arm.motor_on().await.unwrap();
            begin();
            told(arm.move_to(&near(), LIMIT).await)
        },
        has_moved,
    );
}
