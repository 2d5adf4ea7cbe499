//! The procedures against the virtual controller, over real sockets, blocking and under tokio: their results, and the
//! state of the controller's arm, motor and objects afterwards.

use std::time::Duration;

use bcap_core::bcap::call;
use bcap_core::hresult::HResult;
use bcap_core::position::Joints;
use bcap_core::procedure::{
    Failure, Handles, Motion, MotionConfig, MotionStart, Provider, StepCause, Target, give_arm, move_and_wait,
    open_robot, prepare_robot, read_variable, release_robot, write_variable,
};
use bcap_core::variant::Encode;
use bcap_sim::codes::EMERGENCY_STOP;
use bcap_sim::{Config, Controller, Profile};
use bcap_std::server::Limits;
use bcap_std::{Options, asynch, blocking};
use bcap_tests::served::Served;

fn controller(change: impl FnOnce(&mut Config)) -> Served<Controller> {
    let mut config = Config { motor_on_delay: Duration::from_millis(1), ..Config::new(Profile::Rc8) };
    change(&mut config);
    Served::of(Controller::new(config), Limits::default())
}

/// Turns the first joint.
fn to(degrees: f64) -> MotionStart<&'static dyn Encode, &'static str> {
    let pose: &dyn Encode = match degrees {
        0.2 => &"J(0.2,45,90,0,45,0)",
        5.0 => &"J(5,45,90,0,45,0)",
        _ => &"J(150,45,90,0,45,0)",
    };
    MotionStart::Move { interpolation: 1, pose, option: "NEXT" }
}

fn end(degrees: f64) -> Target {
    Target::joints(Joints::new([degrees, 45.0, 90.0, 0.0, 45.0, 0.0]), 6)
}

fn config() -> MotionConfig {
    MotionConfig::within(Duration::from_secs(30))
}

fn assert_near(sim: &Served<Controller>, degrees: f64) {
    let angle = sim.application().joints()[0];
    assert!((angle - degrees).abs() <= config().tolerance, "{angle}");
}

/// Opens, reads, writes, prepares, moves and releases; `$wait` is `.await` or nothing.
macro_rules! visit {
    ($sim:expr, $connection:expr $(, $wait:tt)?) => {{
        let (sim, connection) = (&$sim, &mut $connection);
        let handles = connection.run(open_robot(Provider::RC8, None))$(.$wait)?.unwrap();
        connection.run(write_variable(handles.controller, "I1", &5_i32).unwrap())$(.$wait)?.unwrap();
        let read = || read_variable(handles.controller, "I1", |value| value.as_i32()).unwrap();
        assert_eq!(connection.run(read())$(.$wait)?.unwrap(), Some(5));
        let servo = read_variable(handles.robot, "@SERVO_ON", |value| value.as_bool()).unwrap();
        assert_eq!(connection.run(servo)$(.$wait)?.unwrap(), Some(false));

        // without the arm the motion is refused, and nothing is halted or given back
        let refused = connection.run(move_and_wait(handles, to(5.0), end(5.0), config()))$(.$wait)?.unwrap_err().error;
        assert_eq!(refused.cause, StepCause::Refused(HResult::E_ARM_NOT_TAKEN));
        sim.application().clear_errors(bcap_std::now());

        connection.run(prepare_robot(handles.robot, [0, 1], true))$(.$wait)?.unwrap();
        assert!(sim.application().arm_owner().is_some() && sim.application().motor_is_on());
        let motion = connection.run(move_and_wait(handles, to(5.0), end(5.0), config()))$(.$wait)?.unwrap();
        assert_eq!(motion, Motion::Arrived);
        assert_near(sim, 5.0);
        assert!(!sim.application().is_moving());
        // a motion of no length has arrived, too
        let motion = connection.run(move_and_wait(handles, to(5.0), end(5.0), config()))$(.$wait)?.unwrap();
        assert_eq!(motion, Motion::Arrived);
        assert!(sim.application().arm_owner().is_some() && sim.application().motor_is_on(), "still prepared");
        connection.run(give_arm(handles.robot))$(.$wait)?.unwrap();
        assert!(sim.application().arm_owner().is_none() && sim.application().motor_is_on());
        assert_eq!(sim.application().errors().count(), 0);
        connection.run(release_robot(handles))$(.$wait)?.unwrap();
        let gone = connection.call(call::robot_get_name(handles.robot))$(.$wait)?.unwrap_err();
        assert_eq!(gone.hresult(), Some(HResult::E_HANDLE), "the robot is released");
    }};
}

#[test]
fn a_visit_blocking() {
    let sim = controller(|_| {});
    visit!(sim, blocking::connect_tcp(sim.tcp, &Options::default()).unwrap());
    let sim = controller(|_| {});
    visit!(sim, blocking::connect_udp(sim.udp, &Options::default()).unwrap());
}

#[tokio::test]
async fn a_visit_under_tokio() {
    let sim = controller(|_| {});
    visit!(sim, asynch::connect_tcp(sim.tcp, &Options::default()).await.unwrap(), await);
    let sim = controller(|_| {});
    visit!(sim, asynch::connect_udp(sim.udp, &Options::default()).await.unwrap(), await);
}

fn prepared(sim: &Served<Controller>) -> (blocking::TcpClient, Handles) {
    let mut connection = blocking::connect_tcp(sim.tcp, &Options::default()).unwrap();
    let handles = connection.run(open_robot(Provider::RC8, None)).unwrap();
    connection.run(prepare_robot(handles.robot, [0, 1], true)).unwrap();
    (connection, handles)
}

/// Starts a motion of 150 degrees, does something in the middle of it, and returns how it ended.
fn disturbed(sim: &Served<Controller>, disturb: impl FnOnce() + Send) -> Motion {
    let (mut connection, handles) = prepared(sim);
    std::thread::scope(|scope| {
        let mover =
            scope.spawn(move || connection.run(move_and_wait(handles, to(150.0), end(150.0), config())).unwrap());
        while sim.application().joints()[0] < 5.0 {
            sim.application().advance(bcap_std::now());
            std::thread::yield_now();
        }
        disturb();
        mover.join().unwrap()
    })
}

#[test]
fn a_motion_that_another_client_halts_is_halted() {
    let sim = controller(|config| config.ext_speed = 50.0);
    let motion = disturbed(&sim, || {
        let mut other = blocking::connect_tcp(sim.tcp, &Options::default()).unwrap();
        let handles = other.run(open_robot(Provider::RC8, None)).unwrap();
        other.call(call::robot_halt(handles.robot, "")).unwrap();
    });
    assert_eq!(motion, Motion::Halted);
    let controller = sim.application();
    assert!(controller.joints()[0] < 149.0, "{:?}", controller.joints());
    assert!(!controller.is_moving() && controller.motor_is_on());
    assert_eq!(controller.errors().map(|error| error.code).collect::<Vec<_>>(), [HResult::E_MOTION_STOPPED]);
}

#[test]
fn a_motion_that_an_error_stops_has_failed_with_the_first_error() {
    let codes = [0x8420_4043, 0x8420_4073].map(HResult::from_u32);
    let sim = controller(|config| config.ext_speed = 50.0);
    let motion = disturbed(&sim, || {
        let mut controller = sim.application();
        for code in codes {
            controller.inject_error(code, bcap_std::now());
        }
    });
    assert_eq!(motion, Motion::Failed(codes[0]));
    assert!(!sim.application().is_moving());

    let sim = controller(|config| config.ext_speed = 50.0);
    let motion = disturbed(&sim, || sim.application().emergency_stop(true, bcap_std::now()));
    assert_eq!(motion, Motion::Failed(EMERGENCY_STOP));
    assert!(!sim.application().motor_is_on());
}

#[test]
fn a_motion_that_takes_too_long_is_halted() {
    let sim = controller(|config| config.ext_speed = 10.0);
    let (mut connection, handles) = prepared(&sim);
    let limit = MotionConfig::within(Duration::from_millis(200));
    assert_eq!(connection.run(move_and_wait(handles, to(150.0), end(150.0), limit)).unwrap(), Motion::TimedOut);
    while sim.application().is_moving() {
        sim.application().advance(bcap_std::now());
        std::thread::yield_now();
    }
    assert!(sim.application().joints()[0] < 149.0);
    assert!(sim.application().arm_owner().is_some() && sim.application().motor_is_on(), "still prepared");
}

#[test]
fn a_motion_that_begins_very_slowly_arrives() {
    // a thousandth of a degree in the first 100 ms
    let sim = controller(|config| config.ext_speed = 1.0);
    let (mut connection, handles) = prepared(&sim);
    assert_eq!(connection.run(move_and_wait(handles, to(0.2), end(0.2), config())).unwrap(), Motion::Arrived);
    assert_near(&sim, 0.2);
}

#[test]
fn a_refused_motor_gives_the_arm_back() {
    let sim = controller(|_| {});
    let mut connection = blocking::connect_tcp(sim.tcp, &Options::default()).unwrap();
    let handles = connection.run(open_robot(Provider::RC8, None)).unwrap();
    sim.application().emergency_stop(true, bcap_std::now());
    let refused = connection.run(prepare_robot(handles.robot, [0, 1], true)).unwrap_err();
    assert!(refused.error.hresult().is_some() && refused.call.is_none(), "{refused}");
    assert_eq!(sim.application().arm_owner(), None);
}

#[test]
fn a_controller_that_goes_away_is_a_lost_connection() {
    let sim = controller(|config| config.ext_speed = 50.0);
    let (mut connection, handles) = prepared(&sim);
    let mover = std::thread::spawn(move || connection.run(move_and_wait(handles, to(150.0), end(150.0), config())));
    while sim.application().joints()[0] < 5.0 {
        sim.application().advance(bcap_std::now());
        std::thread::yield_now();
    }
    drop(sim);
    let error = mover.join().unwrap().unwrap_err();
    // between two calls, or during one
    assert!(matches!(error.error.cause, StepCause::Failed(Failure::Lost | Failure::Closed)), "{error}");
    assert!(!error.error.undone, "the robot may be moving");
    assert!(error.call.is_some(), "the transport's error is told");
}
