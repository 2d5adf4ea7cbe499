//! Rare orders of events: the final state of the robot matches the result that the caller got.

use std::thread;
use std::time::Duration;

use bcap_core::bcap::call::{self, VariableHandle};
use bcap_core::hresult::HResult;
use bcap_core::procedure::RecoveryConfig;
use bcap_sim::{Config, Controller as Simulated, Profile, Scenario};
use bcap_std::asynch::{Controller, Halted, Stopper};
use bcap_std::server::Limits;
use bcap_std::{Backoff, Error, Motion, Options, ServiceOptions, Settings, blocking};
use bcap_tests::proxy::{Cut, Relay};
use bcap_tests::served::Served;
use bcap_tests::simulated::{quick, simulated, to};

const LIMIT: Duration = Duration::from_secs(30);

/// A controller whose motor is on after a time.
fn slow_motor(delay: Duration) -> Served<Simulated> {
    Served::of(Simulated::new(Config { motor_on_delay: delay, ..Config::new(Profile::Rc8) }), Limits::default())
}

/// Settings that connect again after a minute.
fn patient() -> Settings {
    let minute = Duration::from_secs(60);
    Settings::rc8().reconnect(Backoff::default().min(minute).max(minute))
}

fn udp(sim: &Served<Simulated>) -> String {
    format!("udp:{}", sim.udp)
}

async fn until(sim: &Served<Simulated>, state: impl Fn(&Simulated) -> bool) {
    for _ in 0..30_000 {
        if sim.is(&state) {
            return;
        }
        tokio::time::sleep(Duration::from_millis(1)).await;
    }
    panic!("the controller did not get there");
}

fn is_left(sim: &Simulated) -> bool {
    (sim.arm_owner(), sim.motor_is_on(), sim.is_moving()) == (None, false, false)
}

#[tokio::test]
async fn an_arm_that_was_given_back_is_not_taken_from_its_next_owner() {
    let sim = simulated();
    let cell = Controller::connect(&sim.address(), &Settings::rc8()).await.unwrap();
    let (first, robot) = (cell.robot().await.unwrap().take_arm().await.unwrap(), cell.robot().await.unwrap());
    let (given, second) = tokio::join!(first.give(), robot.take_arm());
    given.unwrap();
    let mut second = second.unwrap();
    // after what the drop of the first arm has sent
    cell.read::<i32>("I1").await.unwrap();
    assert!(sim.application().arm_owner().is_some());
    second.motor_on().await.unwrap();
    assert_eq!(second.move_to(&to(5.0), LIMIT).await.unwrap(), Motion::Arrived);
}

#[tokio::test]
async fn an_arm_of_a_lost_session_halts_no_motion_of_the_next_one() {
    let sim = simulated();
    let relay = Relay::tcp(sim.tcp);
    let soon = Backoff::default().min(Duration::from_millis(1)).max(Duration::from_millis(20));
    let cell = Controller::connect(&format!("tcp:{}", relay.tcp), &Settings::rc8().reconnect(soon)).await.unwrap();
    let mut stale = cell.robot().await.unwrap().take_arm().await.unwrap();
    relay.cut(Cut::Fin);
    relay.heal();
    while cell.statistics().connections < 2 {
        tokio::time::sleep(Duration::from_millis(1)).await;
    }
    let mut arm = cell.robot().await.unwrap().take_arm().await.unwrap();
    arm.motor_on().await.unwrap();
    let far = to(20.0).speed_percent(20.0);
    let late = async {
        until(&sim, Simulated::is_moving).await;
        stale.move_to(&to(1.0), LIMIT).await
    };
    let (moved, refused) = tokio::join!(arm.move_to(&far, LIMIT), late);
    assert_eq!(moved.unwrap(), Motion::Arrived);
    assert!(matches!(refused, Err(Error::ArmLost)), "{refused:?}");
}

#[tokio::test]
async fn a_halt_over_a_lost_or_silent_connection_is_made_over_a_new_one_at_once() {
    for cut in [Cut::Fin, Cut::Silent] {
        let sim = simulated();
        let relay = Relay::tcp(sim.tcp);
        let stopper = Stopper::connect(&format!("tcp:{}", relay.tcp), &patient()).await.unwrap();
        relay.cut(cut);
        relay.heal();
        assert_eq!(stopper.halt().await.unwrap(), Halted::NothingMoved, "{cut:?}");
    }
}

#[test]
fn a_blocking_halt_without_a_reply_is_made_over_a_new_connection() {
    let sim = simulated();
    let relay = Relay::tcp(sim.tcp);
    let stopper = blocking::Stopper::connect(&format!("tcp:{}", relay.tcp), &patient()).unwrap();
    relay.cut(Cut::Silent);
    relay.heal();
    assert_eq!(stopper.halt().unwrap(), Halted::NothingMoved);
}

/// A controller whose idle peer over UDP loses its session to the second of two others.
fn crowded() -> Served<Simulated> {
    let limits = Limits::default().udp_peers_per_address(2).udp_idle(Duration::ZERO);
    Served::of(Simulated::new(quick(Profile::Rc8)), limits)
}

fn crowd(sim: &Served<Simulated>) {
    let _others = [(); 2].map(|()| blocking::Controller::connect(&udp(sim), &Settings::rc8()).unwrap());
}

#[tokio::test]
async fn a_halt_over_a_session_that_the_controller_has_evicted_is_made_over_a_new_one() {
    let sim = crowded();
    let stopper = Stopper::connect(&udp(&sim), &patient()).await.unwrap();
    crowd(&sim);
    assert_eq!(stopper.halt().await.unwrap(), Halted::NothingMoved);
}

#[test]
fn a_blocking_halt_over_a_session_that_the_controller_has_evicted_is_made_over_a_new_one() {
    let sim = crowded();
    let stopper = blocking::Stopper::connect(&udp(&sim), &patient()).unwrap();
    crowd(&sim);
    assert_eq!(stopper.halt().unwrap(), Halted::NothingMoved);
}

#[tokio::test]
async fn a_session_that_the_controller_has_evicted_is_replaced() {
    let sim = crowded();
    let soon = Backoff::default().min(Duration::from_millis(1)).max(Duration::from_millis(20));
    let cell = Controller::connect(&udp(&sim), &Settings::rc8().reconnect(soon)).await.unwrap();
    let mut changes = cell.subscribe(&["I1"], Duration::from_millis(2));
    assert_eq!(changes.next().await.unwrap().value.unwrap().convert(), Ok(0));
    // a refusal for a handle of the caller does not end the session
    let unknown = call::variable_get_value(VariableHandle(123_456));
    assert_eq!(cell.call(unknown).await.unwrap_err().code(), Some(HResult::E_HANDLE));
    assert_eq!((cell.read::<i32>("I2").await.unwrap(), cell.statistics().connections), (0, 1));
    crowd(&sim);
    while cell.statistics().connections < 2 {
        tokio::time::sleep(Duration::from_millis(1)).await;
    }
    assert_eq!(cell.read::<i32>("I1").await.unwrap(), 0);
    while changes.next().await.unwrap().value.is_err() {}
}

#[test]
fn a_session_over_datagrams_ends_with_its_runtime() {
    let sim = simulated();
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    let cell = runtime.block_on(Controller::connect(&udp(&sim), &Settings::rc8())).unwrap();
    assert_eq!(runtime.block_on(cell.read::<i32>("I1")).unwrap(), 0);
    assert_ne!(sim.application().open_objects(), 0);
    drop(runtime);
    assert_eq!(sim.application().open_objects(), 0);
}

#[test]
fn a_motor_that_others_have_switched_on_stays_on() {
    let sim = simulated();
    let mut other = blocking::Controller::connect(&sim.address(), &Settings::rc8()).unwrap();
    other.write("robot/@SERVO_ON", true).unwrap();
    let mut cell = blocking::Controller::connect(&sim.address(), &Settings::rc8()).unwrap();
    let refuse = "[[fault]]\nwhen = { call = 1, of = \"Variable_PutValue\" }\nthen = { refuse = \"E_FAIL\" }\n";
    sim.application().play(Scenario::parse(refuse).unwrap());
    cell.write("robot/@SERVO_ON", true).unwrap_err();
    cell.close().unwrap();
    assert!(sim.application().motor_is_on());
    // one that was switched off again is not this session's either
    let mut cell = blocking::Controller::connect(&sim.address(), &Settings::rc8()).unwrap();
    cell.write("robot/@SERVO_ON", true).unwrap();
    cell.write("robot/@SERVO_ON", false).unwrap();
    other.write("robot/@SERVO_ON", true).unwrap();
    cell.close().unwrap();
    assert!(sim.application().motor_is_on());
    other.close().unwrap();
    assert!(!sim.application().motor_is_on());
}

/// Over UDP the controller refuses every call while it executes an abandoned call.
#[tokio::test]
async fn a_dropped_motion_is_halted_once_a_busy_controller_accepts_it() {
    let sim = simulated();
    let cell = Controller::connect(&udp(&sim), &Settings::rc8()).await.unwrap();
    let mut arm = cell.robot().await.unwrap().take_arm().await.unwrap();
    arm.motor_on().await.unwrap();
    let slow = "[[fault]]\nwhen = { every = 1, of = \"SysState\" }\nthen = { delay_ms = 300 }\n";
    sim.application().play(Scenario::parse(slow).unwrap());
    let far = to(150.0).speed_percent(1.0);
    tokio::select! {
        moved = arm.move_to(&far, LIMIT) => panic!("{moved:?}"),
        () = async {
            until(&sim, Simulated::is_moving).await;
            tokio::time::sleep(Duration::from_millis(50)).await;
        } => {}
    }
    until(&sim, |sim| !sim.is_moving()).await;
    assert!(sim.application().arm_owner().is_some());
}

#[tokio::test]
async fn a_recovery_that_is_given_up_leaves_no_motor_on() {
    let sim = slow_motor(Duration::from_secs(1));
    let cell = Controller::connect(&udp(&sim), &Settings::rc8()).await.unwrap();
    // opened first, so that only the recovery has the time limit
    cell.robot().await.unwrap();
    let robot = cell.within(Duration::from_millis(200)).robot().await.unwrap();
    let failed = robot.recover(RecoveryConfig::default()).await;
    assert!(matches!(failed, Err(Error::NoReply { .. })), "{failed:?}");
    // the motor was on in the meantime
    until(&sim, is_left).await;
    tokio::time::sleep(Duration::from_millis(100)).await;
    assert!(sim.is(is_left));
    cell.robot().await.unwrap().take_arm().await.unwrap().give().await.unwrap();
}

#[test]
fn a_call_that_the_controller_has_given_up_may_have_an_effect() {
    let sim = slow_motor(Duration::from_millis(500));
    let service = ServiceOptions::default().invoke_timeout(Duration::from_millis(80));
    let mut cell = blocking::Controller::connect(&sim.address(), &Settings::rc8().service(service)).unwrap();
    let error = cell.robot().unwrap().execute::<()>("Motor", [1, 0]).unwrap_err();
    assert!(error.code() == Some(HResult::E_TIMEOUT) && error.may_have_run(), "{error}");
    drop(cell);
    thread::sleep(Duration::from_millis(600));
    assert!(sim.is(is_left));
}

/// A motor that the controller leaves on once is switched off by a second attempt.
#[tokio::test]
async fn a_close_that_leaves_the_motor_on_says_so() {
    for last in [2, 99] {
        let refusal =
            format!("[[fault]]\nwhen = {{ call = 2, to = {last}, of = 'Motor' }}\nthen = {{ refuse = 'E_FAIL' }}");
        let refusal = Scenario::parse(&refusal).unwrap();
        let assert_told = |closed: Result<(), Error>, sim: &Served<Simulated>| {
            assert_eq!(sim.is(Simulated::motor_is_on), last == 99);
            match closed {
                Err(Error::NotEnded(recovery)) => assert_eq!((recovery.motor_off, last), (Some(false), 99)),
                closed => assert!(closed.is_ok() && last == 2, "{closed:?}"),
            }
        };
        let sim = simulated();
        sim.application().play(refusal.clone());
        let cell = Controller::connect(&sim.address(), &Settings::rc8()).await.unwrap();
        let mut arm = cell.robot().await.unwrap().take_arm().await.unwrap();
        arm.motor_on().await.unwrap();
        assert_told(cell.close().await, &sim);
        let sim = simulated();
        sim.application().play(refusal);
        let (sim, closed) = tokio::task::spawn_blocking(move || {
            let mut cell = blocking::Controller::connect(&sim.address(), &Settings::rc8()).unwrap();
            let mut arm = cell.robot().unwrap().take_arm().unwrap();
            arm.motor_on().unwrap();
            arm.keep();
            let closed = cell.close();
            (sim, closed)
        })
        .await
        .unwrap();
        assert_told(closed, &sim);
    }
}

/// The link is lost, and stays away.
#[test]
fn a_close_that_cannot_give_the_arm_back_is_an_error() {
    let sim = simulated();
    let relay = Relay::tcp(sim.tcp);
    let address = format!("tcp:{}", relay.tcp);
    let mut cell = blocking::Controller::connect(&address, &patient()).unwrap();
    let mut arm = cell.robot().unwrap().take_arm().unwrap();
    arm.motor_on().unwrap();
    relay.cut(Cut::Fin);
    assert!(arm.motor_on().is_err());
    drop(arm);
    assert!(cell.close().is_err());
    assert!(sim.is(Simulated::motor_is_on));
    relay.heal();
    tokio::runtime::Runtime::new().unwrap().block_on(async {
        let cell = Controller::connect(&address, &patient()).await.unwrap();
        let mut arm = cell.robot().await.unwrap().take_arm().await.unwrap();
        arm.motor_on().await.unwrap();
        relay.cut(Cut::Fin);
        assert!(arm.motor_on().await.is_err());
        assert!(cell.close().await.is_err());
    });
}

/// With the link back, the same close ends everything, and is a success.
#[test]
fn a_close_after_a_lost_connection_gives_the_arm_back_over_another_one() {
    let sim = simulated();
    let relay = Relay::tcp(sim.tcp);
    let address = format!("tcp:{}", relay.tcp);
    let lose = || {
        relay.cut(Cut::Fin);
        relay.heal();
    };
    let mut cell = blocking::Controller::connect(&address, &patient()).unwrap();
    let mut arm = cell.robot().unwrap().take_arm().unwrap();
    arm.motor_on().unwrap();
    lose();
    assert!(arm.motor_on().is_err());
    drop(arm);
    cell.close().unwrap();
    assert!(sim.is(is_left));
    tokio::runtime::Runtime::new().unwrap().block_on(async {
        let cell = Controller::connect(&address, &patient()).await.unwrap();
        let mut arm = cell.robot().await.unwrap().take_arm().await.unwrap();
        arm.motor_on().await.unwrap();
        lose();
        assert!(arm.motor_on().await.is_err());
        cell.close().await.unwrap();
    });
    assert!(sim.is(is_left));
}

/// The calls that give the arm back have no reply. The motor is another client's, so only the halt stops the robot.
#[tokio::test]
async fn a_motion_whose_arm_was_given_back_without_an_answer_is_halted_by_the_close() {
    let sim = simulated();
    let relay = Relay::tcp(sim.tcp);
    let motor_on = |address: String| {
        let mut other = blocking::Controller::connect(&address, &Settings::rc8().keep(true)).unwrap();
        other.robot().unwrap().execute::<()>("Motor", [1, 0]).unwrap();
    };
    let address = sim.address();
    tokio::task::spawn_blocking(move || motor_on(address)).await.unwrap();
    let mut options = Options::default();
    options.tcp.timing.attempt_timeout = Duration::from_secs(1);
    let cell = Controller::connect(&format!("tcp:{}", relay.tcp), &patient().options(options)).await.unwrap();
    let mut arm = cell.robot().await.unwrap().take_arm().await.unwrap();
    let motion = arm.start(&to(150.0).speed_percent(1.0), LIMIT).await.unwrap();
    until(&sim, Simulated::is_moving).await;
    relay.cut(Cut::Silent);
    drop(motion);
    assert!(arm.give().await.is_err());
    relay.heal();
    assert!(sim.is(Simulated::is_moving));
    // the controller still gives the arm to the silent connection
    assert!(matches!(cell.close().await, Err(Error::NotEnded(_))));
    until(&sim, |sim| !sim.is_moving()).await;
    assert!(sim.is(Simulated::motor_is_on));
}
