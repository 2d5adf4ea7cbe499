//! A link that stops forwarding during a motion without closing, and then resumes: the result of the motion, and the final
//! state of the robot.

use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::Duration;

use bcap_core::procedure::Motion;
use bcap_sim::Controller as Simulated;
use bcap_std::{Backoff, Error, Joints, Move, Options, Settings, asynch, blocking};
use bcap_tests::proxy::Relay;
use bcap_tests::served::Served;
use bcap_tests::simulated::simulated;

const LIMIT: Duration = Duration::from_secs(30);
/// The time without a reply after which a call fails.
const ANSWER: Duration = Duration::from_secs(3);
/// A time that is much shorter, even if a busy machine makes it longer.
const SHORT: Duration = Duration::from_millis(200);

fn settings() -> Settings {
    let mut options = Options::default();
    options.tcp.timing.attempt_timeout = ANSWER;
    let reconnect = Backoff::default().min(Duration::from_millis(1)).max(Duration::from_millis(20));
    Settings::rc8().options(options).reconnect(reconnect)
}

/// A motion that outlasts a short outage, or one that ends a minute after a long one.
fn far(is_short: bool) -> Move {
    let target = Move::joint(Joints::new([if is_short { 60.0 } else { 150.0 }, 45.0, 90.0, 0.0, 45.0, 0.0]));
    target.speed_percent(if is_short { 10.0 } else { 1.0 })
}

/// Silences the link when the robot moves, for a time, or until `ended` says that the motion failed.
fn interrupt(sim: &Served<Simulated>, relay: &Relay, is_short: bool, ended: &AtomicBool) {
    sim.until(Simulated::is_moving);
    relay.hold(true);
    if is_short {
        thread::sleep(SHORT);
    } else {
        sim.until(|_| ended.load(Ordering::SeqCst));
    }
    relay.hold(false);
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
    let mut cell = blocking::Controller::connect(&format!("tcp:{}", relay.tcp), &settings()).unwrap();
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
    let cell = asynch::Controller::connect(&format!("tcp:{}", relay.tcp), &settings()).await.unwrap();
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
    thread::scope(|scope| {
        for is_short in [true, false] {
            for waits in [true, false] {
                for is_async in [true, false] {
                    scope.spawn(move || lose_the_link(is_short, waits, is_async));
                }
            }
        }
    });
}

fn lose_the_link(is_short: bool, waits: bool, is_async: bool) {
    let sim = simulated();
    let (relay, ended) = (Relay::tcp(sim.tcp), AtomicBool::new(false));
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
    sim.until(is_left);
}
