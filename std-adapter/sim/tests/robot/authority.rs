//! Arm authority, motor and speeds: the preconditions of a motion, and the clients that may set them.

use std::net::IpAddr;
use std::time::Duration;

use bcap_core::bcap::call::{self, VariableHandle};
use bcap_core::bcap::server::Handler as _;
use bcap_core::handler::Outcome;
use bcap_core::hresult::HResult;
use bcap_core::time::Instant;
use bcap_sim::codes::{EMERGENCY_STOP, MANUAL_MODE, OTHER_GROUP, UNDEFINED_GROUP, WRONG_KEEP};
use bcap_sim::{Config, Mode, Token, VariableKind};

use crate::common::{World, code, ok, value};

#[test]
fn each_missing_condition_has_its_code_in_this_order() {
    let mut world = World::with(Config { mode: Mode::Manual, token: Token::TeachPendant, ..Config::default() });
    let (client, other) = (world.client(1), world.client(2));
    let other_peer = other.peer;
    world.sim.inject_error(HResult::from_u32(0x8150_0001), world.now);
    let try_move = |world: &mut World| world.move_to(client, 1, "J(0,40,90,0,45,0)", "");

    world.sim.emergency_stop(true, world.now);
    assert_eq!(try_move(&mut world), EMERGENCY_STOP);
    world.sim.emergency_stop(false, world.now);
    assert_eq!(try_move(&mut world), MANUAL_MODE);
    world.sim.set_mode(Mode::Auto, world.now);
    assert_eq!(try_move(&mut world), HResult::E_TOKEN_NOT_ETHERNET);
    world.sim.set_token(Token::Client(other_peer));
    assert_eq!(try_move(&mut world), HResult::E_TOKEN_ADDRESS);
    world.sim.set_token(Token::Client(client.peer));
    assert_eq!(try_move(&mut world), HResult::E_ERROR_PRESENT);
    // each refusal is an error
    let present = [
        HResult::E_ERROR_PRESENT,
        HResult::E_TOKEN_ADDRESS,
        HResult::E_TOKEN_NOT_ETHERNET,
        MANUAL_MODE,
        EMERGENCY_STOP,
        HResult::from_u32(0x8150_0001),
    ];
    assert_eq!(world.errors(), present);
    assert_eq!(world.get(client, "@ERROR_CODE"), ok(&HResult::E_ERROR_PRESENT.0));
    let cleared = |world: &mut World, code| {
        assert_eq!(world.errors(), [code]);
        world.clear(client);
    };
    world.clear(client);
    assert_eq!(try_move(&mut world), HResult::E_ARM_NOT_TAKEN);
    cleared(&mut world, HResult::E_ARM_NOT_TAKEN);
    assert_eq!(world.robot(client, "TakeArm", [0, 0]), ok(&()));
    assert_eq!(try_move(&mut world), HResult::E_MOTOR_OFF);
    assert_eq!(world.robot(client, "Motor", [1, 1]), code(HResult::E_ERROR_PRESENT));
    assert_eq!(world.errors(), [HResult::E_ERROR_PRESENT, HResult::E_MOTOR_OFF]);
    world.clear(client);
    // switched on with "no wait", it is not on yet
    assert_eq!(world.call(client.peer, call::robot_execute(client.robot, "Motor", [1, 1])), ok(&()));
    assert_eq!(try_move(&mut world), HResult::E_MOTOR_OFF);
    assert_eq!(world.robot_get(client, "@SERVO_ON"), ok(&false));
    world.pass(300);
    assert_eq!(world.robot_get(client, "@SERVO_ON"), ok(&true));
    cleared(&mut world, HResult::E_MOTOR_OFF);
    assert_eq!(try_move(&mut world), HResult::S_OK);

    let log: Vec<_> = world.sim.error_log().map(|e| e.code).collect();
    let later = [HResult::E_MOTOR_OFF, HResult::E_ERROR_PRESENT, HResult::E_MOTOR_OFF, HResult::E_ARM_NOT_TAKEN];
    let expected = [&later[..], &present[..]].concat();
    assert_eq!(log, expected);
}

#[test]
fn the_token_of_an_address_is_for_its_clients() {
    let address = |text: &str| text.parse::<IpAddr>().unwrap();
    let mut world = World::with(Config { token: Token::Address(address("192.168.0.5")), ..Config::default() });
    let clients = [1, 2, 3].map(|peer| world.client(peer));
    world.sim.connected(clients[0].peer, address("::ffff:192.168.0.5"));
    world.sim.connected(clients[1].peer, address("192.168.0.6"));
    let take = |world: &mut World, n: usize| world.robot(clients[n], "TakeArm", [0, 0]);
    // the third client is at a serial line and has no address
    assert_eq!(take(&mut world, 1), code(HResult::E_TOKEN_ADDRESS));
    assert_eq!(take(&mut world, 2), code(HResult::E_TOKEN_ADDRESS));
    world.clear(clients[0]);
    assert_eq!(take(&mut world, 0), ok(&()));
    // its address belongs to the connection, not to the session
    assert_eq!(world.call(clients[0].peer, call::service_stop()), code(HResult::S_OK));
    let again = world.client(1);
    assert_eq!(world.robot(again, "TakeArm", [0, 0]), ok(&()));
    world.sim.left(again.peer, world.now);
    let unknown = world.client(1);
    assert_eq!(world.robot(unknown, "TakeArm", [0, 0]), code(HResult::E_TOKEN_ADDRESS));
}

#[test]
fn the_arm_belongs_to_one_client_until_it_goes() {
    let mut world = World::new();
    let (one, two) = (world.client(1), world.client(2));
    assert_eq!(world.robot(one, "TakeArmState", -1), ok(&0));
    assert_eq!(world.robot(one, "TakeArmState", "x"), code(HResult::DISP_E_TYPEMISMATCH));
    assert_eq!(world.robot(one, "TakeArm", ()), ok(&()));
    assert_eq!(world.robot(one, "takearm", [0, 1]), ok(&()));
    assert_eq!(world.robot(one, "TakeArmState", -1), ok(&1));
    assert_eq!(world.robot(one, "TakeArmState", ()), ok(&1));
    assert_eq!(world.robot(one, "TakeArmState", 1), ok(&0));
    assert_eq!(world.robot(two, "TakeArmState", -1), ok(&0));
    assert_eq!(world.robot(two, "TakeArm", [0, 0]), code(HResult::E_ARM_NOT_TAKEN));
    assert_eq!(world.robot(two, "GiveArm", ()).0, HResult::S_FALSE);
    assert_eq!(world.call(two.peer, call::robot_speed(two.robot, -1, 5.0)), code(HResult::E_ARM_NOT_TAKEN));
    assert_eq!(world.robot(one, "TakeArm", [32, 0]), code(UNDEFINED_GROUP));
    assert_eq!(world.robot(one, "TakeArm", [0, 2]), code(WRONG_KEEP));
    world.clear(one);
    assert_eq!(world.robot(one, "TakeArm", [1, 0]), code(OTHER_GROUP));
    world.clear(one);

    world.sim.left(one.peer, world.now);
    assert_eq!(world.robot(two, "TakeArm", [0, 0]), ok(&()));
    assert_eq!(world.sim.arm_owner(), Some(two.peer));
    assert_eq!(world.call(two.peer, call::service_stop()), code(HResult::S_OK));
    assert_eq!(world.sim.arm_owner(), None);
}

#[test]
fn take_arm_keeps_or_resets_speed_tool_and_work() {
    let mut world = World::new();
    let client = world.client(1);
    world.robot(client, "TakeArm", [0, 0]);
    assert_eq!(world.call(client.peer, call::robot_speed(client.robot, -1, 40.0)), code(HResult::S_OK));
    assert_eq!(world.call(client.peer, call::robot_speed(client.robot, 0, 30.0)), code(HResult::S_OK));
    assert_eq!(world.call(client.peer, call::robot_accelerate(client.robot, -1, 50.0, 60.0)), code(HResult::S_OK));
    assert_eq!(world.call(client.peer, call::robot_change(client.robot, "Tool3")), code(HResult::S_OK));
    assert_eq!(world.call(client.peer, call::robot_change(client.robot, "work2")), code(HResult::S_OK));
    let all =
        |world: &mut World| ["@SPEED", "@JSPEED", "@ACCEL", "@JDECEL"].map(|name| world.robot_get(client, name).1);
    world.robot(client, "TakeArm", [0, 1]);
    assert_eq!(all(&mut world), [40.0_f32, 30.0, 50.0, 60.0].map(|n| value(&n)));
    assert_eq!(world.robot(client, "CurTool", ()), ok(&3));
    assert_eq!(world.robot_get(client, "@CURRENT_WORK"), ok(&2));
    world.robot(client, "TakeArm", [0, 0]);
    assert_eq!(all(&mut world), [100.0_f32; 4].map(|n| value(&n)));
    assert_eq!(world.robot_get(client, "@CURRENT_TOOL"), ok(&0));

    for bad in [0.0, 1e-6, -1.0, 100.5, f32::NAN] {
        assert_eq!(world.call(client.peer, call::robot_speed(client.robot, -1, bad)), code(HResult::E_INVALIDARG));
    }
    assert_eq!(world.call(client.peer, call::robot_speed(client.robot, 7, 1.0)), code(HResult::E_INVALIDARG));
    for bad in ["Tool64", "Tool-1", "Hand1", ""] {
        assert_eq!(
            world.call(client.peer, call::robot_change(client.robot, bad)),
            code(HResult::E_INVALIDARG),
            "{bad}"
        );
    }
}

#[test]
fn external_speed_sets_its_accelerations_unless_told() {
    let mut world = World::new();
    let client = world.client(1);
    let read = |world: &mut World| {
        let [a, b, c] = ["@EXTSPEED", "@EXTACCEL", "@EXTDECEL"].map(|name| world.robot_get(client, name).1);
        (a, b, c)
    };
    assert_eq!(world.robot(client, "ExtSpeed", 50), ok(&()));
    assert_eq!(read(&mut world), (value(&50.0_f32), value(&25.0_f32), value(&25.0_f32)));
    assert_eq!(world.robot(client, "ExtSpeed", [80.0, 70.0, 60.0]), ok(&()));
    assert_eq!(read(&mut world), (value(&80.0_f32), value(&70.0_f32), value(&60.0_f32)));
    let handle = world.robot_variable(client, "@EXTSPEED");
    assert_eq!(world.call(client.peer, call::variable_put_value(handle, 20.0_f32)), code(HResult::S_OK));
    assert_eq!(world.robot(client, "CurExtSpd", ()), ok(&20.0_f32));
    assert_eq!(world.robot(client, "CurExtAcc", ()), ok(&4.0_f32));
    // as a public client for COBOTTA PRO sets them: -1 keeps a value, -2 derives it from the speed
    assert_eq!(world.robot(client, "ExtSpeed", [40.0, -2.0, -1.0]), ok(&()));
    assert_eq!(read(&mut world), (value(&40.0_f32), value(&16.0_f32), value(&4.0_f32)));
    assert_eq!(world.call(client.peer, call::robot_accelerate(client.robot, -1, -1.0, 30.0)), code(HResult::S_OK));
    assert_eq!(world.robot(client, "CurAcc", ()), ok(&100.0_f32));
    assert_eq!(world.robot(client, "CurDec", ()), ok(&30.0_f32));
    assert_eq!(world.robot(client, "ExtSpeed", 0), code(HResult::E_INVALIDARG));
    assert_eq!(world.robot(client, "ExtSpeed", ()), code(HResult::E_INVALIDARG));
    assert_eq!(world.robot(client, "ExtSpeed", (1, "x")), code(HResult::E_INVALIDARGTYPE));
}

#[test]
fn a_written_servo_on_is_answered_when_the_motor_is_on() {
    let mut world = World::new();
    let client = world.client(1);
    let servo = world.robot_variable(client, "@SERVO_ON");
    let on = call::variable_put_value(servo, true);
    assert_eq!(world.run(client.peer, &on), code(HResult::S_OK));
    assert_eq!(world.now, Instant::from_millis(300));
    // as the public ROS 2 driver does it: the next calls are these
    assert_eq!(world.robot(client, "TakeArm", [0, 1]), ok(&()));
    assert_eq!(world.robot(client, "slvChangeMode", 514), ok(&()));
    assert_eq!(world.robot(client, "slvChangeMode", 0), ok(&()));
    // it is already on, so the call does not wait
    assert_eq!(world.call(client.peer, &on), code(HResult::S_OK));
    assert_eq!(world.call(client.peer, call::variable_put_value(servo, false)), code(HResult::S_OK));
    // an error of level 3 ends the wait with its code
    world.begin(client.peer, &on);
    world.sim.inject_error(HResult::from_u32(0x8320_0001), world.now);
    assert_eq!(world.again(client.peer, &on).0, Outcome::Done(HResult::from_u32(0x8320_0001)));
    assert!(!world.sim.motor_is_on());
}

#[test]
fn a_written_servo_on_is_answered_at_once_where_the_settings_say_so() {
    let mut world = World::with(Config { servo_on_waits: false, ..Config::default() });
    let client = world.client(1);
    let servo = world.robot_variable(client, "@SERVO_ON");
    assert_eq!(world.call(client.peer, call::variable_put_value(servo, true)), code(HResult::S_OK));
    assert_eq!(world.call(client.peer, call::variable_get_value(servo)), ok(&false));
    world.pass(300);
    assert_eq!(world.call(client.peer, call::variable_get_value(servo)), ok(&true));
}

#[test]
fn the_motor_takes_its_time() {
    let mut world = World::with(Config { motor_on_delay: Duration::from_millis(500), ..Config::default() });
    let client = world.client(1);
    assert_eq!(world.robot(client, "Motor", [1, 0]), ok(&()));
    assert_eq!(world.now, Instant::from_millis(500));
    assert!(world.sim.motor_is_on());
    assert_eq!(world.call(client.peer, call::robot_execute(client.robot, "Motor", 1_i16)), ok(&()));
    let servo = world.robot_variable(client, "@SERVO_ON");
    assert_eq!(world.call(client.peer, call::variable_put_value(servo, false)), code(HResult::S_OK));
    assert!(!world.sim.motor_is_on());

    // switched off while somebody waits for it
    world.robot(client, "Motor", 0);
    let on = call::robot_execute(client.robot, "Motor", [1, 0]);
    world.begin(client.peer, &on);
    let other = world.client(2);
    assert_eq!(world.robot(other, "Motor", 0), ok(&()));
    assert_eq!(world.again(client.peer, &on).0, Outcome::Done(HResult::E_MOTOR_OFF));
    assert_eq!(world.robot(client, "Motor", ()), code(HResult::E_INVALIDARG));

    // as a command of the controller
    let start = world.now;
    assert_eq!(world.run(client.peer, call::controller_execute(client.controller, "Motor", true)), ok(&()));
    assert_eq!(world.now.saturating_since(start), Duration::from_millis(500));
    assert!(world.sim.motor_is_on());
}

#[test]
fn values_that_cannot_be_written_stay() {
    let mut world = World::new();
    let client = world.client(1);
    for name in ["@CURRENT_POSITION", "@BUSY_STATUS", "@TYPE_NAME"] {
        let handle = world.robot_variable(client, name);
        let refused = call::variable_put_value(handle, 1);
        assert_eq!(world.call(client.peer, refused), code(HResult::E_CAO_NOT_WRITABLE), "{name}");
    }
    let tool: VariableHandle = world.robot_variable(client, "@CURRENT_TOOL");
    assert_eq!(world.call(client.peer, call::variable_put_value(tool, 64)), code(HResult::E_INVALIDARG));
    assert_eq!(world.call(client.peer, call::variable_put_value(tool, 63)), code(HResult::S_OK));
    assert_eq!(world.call(client.peer, call::variable_get_value(tool)), ok(&63));
    world.sim.set_variable(VariableKind::J, 0, &value(&[0.0_f32; 8]).as_variant()).unwrap();
}
