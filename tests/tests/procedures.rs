//! The procedures against the virtual controller, over real sockets, blocking and under tokio: their results, and the
//! state of the controller's arm, motor and objects afterwards.

use std::time::Duration;

use bcap_core::bcap::call;
use bcap_core::hresult::HResult;
use bcap_core::position::Joints;
use bcap_core::procedure::{
    Motion, MotionConfig, MotionStart, Provider, StepCause, Target, give_arm, move_and_wait, open_robot, prepare_robot,
    read_variable, release_robot, write_variable,
};
use bcap_std::{Options, asynch, blocking};
use bcap_tests::simulated::simulated;

/// Opens, reads, writes, prepares, moves and releases; `$wait` is `.await` or nothing.
macro_rules! visit {
    ($sim:expr, $connection:expr $(, $wait:tt)?) => {{
        let (sim, connection) = (&$sim, &mut $connection);
        let config = MotionConfig::within(Duration::from_secs(30));
        let start = MotionStart::Move { interpolation: 1, pose: "J(5,45,90,0,45,0)", option: "NEXT" };
        let end = Target::joints(Joints::new([5.0, 45.0, 90.0, 0.0, 45.0, 0.0]), 6);
        let handles = connection.run(open_robot(Provider::RC8, None))$(.$wait)?.unwrap();
        connection.run(write_variable(handles.controller, "I1", &5_i32).unwrap())$(.$wait)?.unwrap();
        let read = || read_variable(handles.controller, "I1", |value| value.as_i32()).unwrap();
        assert_eq!(connection.run(read())$(.$wait)?.unwrap(), Some(5));
        let servo = read_variable(handles.robot, "@SERVO_ON", |value| value.as_bool()).unwrap();
        assert_eq!(connection.run(servo)$(.$wait)?.unwrap(), Some(false));

        // without the arm the motion is refused, and no robot is halted and no arm given back
        let refused = connection.run(move_and_wait(handles, start, end, config))$(.$wait)?.unwrap_err().error;
        assert_eq!(refused.cause, StepCause::Refused(HResult::E_ARM_NOT_TAKEN));
        sim.application().clear_errors(bcap_std::now());

        connection.run(prepare_robot(handles.robot, [0, 1], true))$(.$wait)?.unwrap();
        assert!(sim.application().arm_owner().is_some() && sim.application().motor_is_on());
        let motion = connection.run(move_and_wait(handles, start, end, config))$(.$wait)?.unwrap();
        assert_eq!(motion, Motion::Arrived);
        let angle = sim.application().joints()[0];
        assert!((angle - 5.0).abs() <= config.tolerance, "{angle}");
        assert!(!sim.application().is_moving());
        // a motion of no length also arrives
        let motion = connection.run(move_and_wait(handles, start, end, config))$(.$wait)?.unwrap();
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
    let sim = simulated();
    visit!(sim, blocking::connect_tcp(sim.tcp, &Options::default()).unwrap());
    let sim = simulated();
    visit!(sim, blocking::connect_udp(sim.udp, &Options::default()).unwrap());
}

#[tokio::test]
async fn a_visit_under_tokio() {
    let sim = simulated();
    visit!(sim, asynch::connect_tcp(sim.tcp, &Options::default()).await.unwrap(), await);
    let sim = simulated();
    visit!(sim, asynch::connect_udp(sim.udp, &Options::default()).await.unwrap(), await);
}
