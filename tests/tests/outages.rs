//! A link that stops forwarding during a motion without closing, and then resumes: what the motion reports, and how the robot is
//! left.

use std::io::{Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::Duration;

use bcap_core::procedure::Motion;
use bcap_sim::{Config, Controller as Simulated, Profile};
use bcap_std::server::Limits;
use bcap_std::{Backoff, Error, Joints, Move, Options, Settings, asynch, blocking};
use bcap_tests::served::Served;

const LIMIT: Duration = Duration::from_secs(30);
/// The time without a reply after which a call fails.
const ANSWER: Duration = Duration::from_millis(800);

/// A relay that keeps the bytes while it is silent.
struct Relay {
    address: SocketAddr,
    is_silent: Arc<AtomicBool>,
}

impl Relay {
    fn start(to: SocketAddr) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let (address, is_silent) = (listener.local_addr().unwrap(), Arc::new(AtomicBool::new(false)));
        let silent = Arc::clone(&is_silent);
        thread::spawn(move || {
            for client in listener.incoming() {
                let (client, server) = (client.unwrap(), TcpStream::connect(to).unwrap());
                for (from, to) in [(client.try_clone().unwrap(), server.try_clone().unwrap()), (server, client)] {
                    let silent = Arc::clone(&silent);
                    thread::spawn(move || pump(from, to, &silent));
                }
            }
        });
        Self { address, is_silent }
    }

    fn settings() -> Settings {
        let mut options = Options::default();
        options.tcp.timing.attempt_timeout = ANSWER;
        let reconnect = Backoff::default().min(Duration::from_millis(1)).max(Duration::from_millis(20));
        Settings::rc8().options(options).reconnect(reconnect)
    }

    fn silence(&self, is_silent: bool) {
        self.is_silent.store(is_silent, Ordering::SeqCst);
    }
}

fn pump(mut from: TcpStream, mut to: TcpStream, silent: &AtomicBool) {
    let mut part = [0; 4096];
    while let Ok(count @ 1..) = from.read(&mut part) {
        while silent.load(Ordering::SeqCst) {
            thread::sleep(Duration::from_millis(2));
        }
        if to.write_all(&part[..count]).is_err() {
            break;
        }
    }
    let _ = to.shutdown(std::net::Shutdown::Both);
    let _ = from.shutdown(std::net::Shutdown::Both);
}

/// A motion that outlasts a short outage, or one that ends a minute after a long one.
fn far(is_short: bool) -> Move {
    let target = Move::joint(Joints::new([if is_short { 60.0 } else { 150.0 }, 45.0, 90.0, 0.0, 45.0, 0.0]));
    target.speed_percent(if is_short { 50.0 } else { 1.0 })
}

fn until(sim: &Served<Simulated>, reached: impl Fn(&Simulated) -> bool) {
    for _ in 0..10_000 {
        let mut controller = sim.application();
        controller.advance(bcap_std::now());
        if reached(&controller) {
            return;
        }
        drop(controller);
        thread::sleep(Duration::from_millis(2));
    }
    panic!("the state was not reached");
}

/// Silences the link when the robot moves, for a time, or until `ended` says that the motion failed.
fn interrupt(sim: &Served<Simulated>, relay: &Relay, is_short: bool, ended: &AtomicBool) {
    until(sim, Simulated::is_moving);
    relay.silence(true);
    if is_short {
        thread::sleep(ANSWER / 4);
    } else {
        until(sim, |_| ended.load(Ordering::SeqCst));
    }
    relay.silence(false);
}

/// Asserts that a short outage does not change the outcome, and that a motion whose link was lost is of unknown outcome.
fn assert_told(outcome: &Result<Motion, Error>, is_short: bool) {
    match outcome {
        Ok(motion) => assert_eq!((motion, is_short), (&Motion::Arrived, true)),
        Err(error) => assert!(matches!(error, Error::NoReply { .. }) && !is_short, "{error:?} {is_short}"),
    }
}

fn is_left(sim: &Simulated) -> bool {
    (sim.arm_owner(), sim.motor_is_on(), sim.is_moving()) == (None, false, false)
}

fn move_blocking(relay: &Relay, (is_short, waits): (bool, bool), ended: &AtomicBool) -> Result<Motion, Error> {
    let mut cell = blocking::Controller::connect(&format!("tcp:{}", relay.address), &Relay::settings()).unwrap();
    let mut arm = cell.robot().unwrap().take_arm().unwrap();
    arm.motor_on().unwrap();
    let outcome = if waits {
        match arm.start(&far(is_short), LIMIT) {
            Ok(motion) => motion.wait(),
            Err(error) => Err(error),
        }
    } else {
        arm.move_to(&far(is_short), LIMIT)
    };
    ended.store(true, Ordering::SeqCst);
    outcome
}

async fn move_async(relay: &Relay, (is_short, waits): (bool, bool), ended: &AtomicBool) -> Result<Motion, Error> {
    let cell = asynch::Controller::connect(&format!("tcp:{}", relay.address), &Relay::settings()).await.unwrap();
    let mut arm = cell.robot().await.unwrap().take_arm().await.unwrap();
    arm.motor_on().await.unwrap();
    let outcome = if waits {
        match arm.start(&far(is_short), LIMIT).await {
            Ok(motion) => motion.wait().await,
            Err(error) => Err(error),
        }
    } else {
        arm.move_to(&far(is_short), LIMIT).await
    };
    ended.store(true, Ordering::SeqCst);
    drop(arm);
    let _ = cell.close().await;
    outcome
}

#[test]
fn a_motion_is_told_truly_and_the_robot_is_left_safe_after_a_silent_link() {
    for (is_short, waits, is_async) in [true, false]
        .into_iter()
        .flat_map(|s| [true, false].into_iter().flat_map(move |w| [(s, w, true), (s, w, false)]))
    {
        let config = Config { motor_on_delay: Duration::from_millis(1), ..Config::new(Profile::Rc8) };
        let sim = Served::of(Simulated::new(config), Limits::default());
        let (relay, ended) = (Relay::start(sim.tcp), AtomicBool::new(false));
        let outcome = thread::scope(|scope| {
            let moves = scope.spawn(|| {
                if is_async {
                    let runtime = tokio::runtime::Runtime::new().unwrap();
                    runtime.block_on(move_async(&relay, (is_short, waits), &ended))
                } else {
                    move_blocking(&relay, (is_short, waits), &ended)
                }
            });
            interrupt(&sim, &relay, is_short, &ended);
            moves.join().unwrap()
        });
        assert_told(&outcome, is_short);
        until(&sim, is_left);
    }
}
