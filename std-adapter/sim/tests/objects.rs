//! Extensions, command objects and messages over the handler of b-CAP.

use bcap_core::bcap::call::{self, CommandHandle, ExtensionHandle, MessageHandle};
use bcap_core::bcap::server::Handler as _;
use bcap_core::handler::{Outcome, PeerId};
use bcap_core::hresult::HResult;
use bcap_core::time::Instant;
use bcap_core::variant::OleDate;
use bcap_sim::{Config, Profile, Scenario, Token};

use crate::common;
use crate::common::{Client, Reply, World, code, ok, value};

fn cobotta() -> (World, Client) {
    let mut world = World::with(Config::new(Profile::Cobotta));
    let client = world.client(1);
    (world, client)
}

// --- data communication

#[test]
fn a_line_gives_the_texts_of_its_device_in_their_order() {
    let mut world = World::new();
    let client = world.client(1);
    let send = |at: u32, line: u32, text: &str| {
        format!("[[fault]]\nwhen = {{ at_ms = {at} }}\nthen = {{ comm = {{ line = {line}, text = {text:?} }} }}\n")
    };
    let text = [send(10, 4, "lost"), send(20, 4, "a"), send(20, 5, "other"), send(30, 4, "\u{e9}b"), send(50, 4, "c")];
    world.sim.play(Scenario::parse(&text.concat()).unwrap());
    let opened = call::controller_get_extension(client.controller, " comm ", "");
    let comm = ExtensionHandle(world.handle(client.peer, opened));
    let run = |world: &mut World, command: &str, line: i32| {
        world.call(client.peer, call::extension_execute(comm, command, line))
    };
    world.pass(15);
    assert_eq!(run(&mut world, "State", 4), ok(&0));
    assert_eq!(run(&mut world, "count", 4), ok(&0));
    assert_eq!(run(&mut world, "input", 4), code(HResult::E_NOT_CONNECTED));
    assert_eq!(run(&mut world, "clear", 4), code(HResult::E_NOT_CONNECTED));
    assert_eq!(run(&mut world, "open", 4), ok(&()));
    assert_eq!(run(&mut world, "STATE", 4), ok(&2));
    assert_eq!(run(&mut world, "input", 4), code(HResult::E_TIMEOUT), "what came to the closed line is lost");
    world.pass(20);
    assert_eq!(run(&mut world, "count", 4), ok(&4));
    assert_eq!(run(&mut world, "input", 4), ok("a"));
    assert_eq!(run(&mut world, "open", 4), ok(&()), "it is open already, and keeps its texts");
    assert_eq!(run(&mut world, "input", 4), ok("\u{e9}b"));
    world.pass(20);
    assert_eq!(run(&mut world, "clear", 4), ok(&()));
    assert_eq!(run(&mut world, "count", 4), ok(&0));
    assert_eq!(run(&mut world, "close", 4), ok(&()));
    assert_eq!(run(&mut world, "State", 4), ok(&0));
    for line in [0, 17, -1] {
        assert_eq!(run(&mut world, "open", line), code(HResult::E_INVALIDARG), "{line}");
    }
    assert_eq!(run(&mut world, "output", 4), code(HResult::E_INVALID_CMD_NAME));
}

// --- the hand

fn hand(world: &mut World, client: Client) -> ExtensionHandle {
    ExtensionHandle(world.handle(client.peer, call::controller_get_extension(client.controller, "hand0", "")))
}

#[test]
fn the_hand_opens_and_closes_in_its_time() {
    let mut world = World::new();
    let client = world.client(1);
    let names = call::controller_get_extension_names(client.controller, "");
    assert_eq!(world.call(client.peer, names), ok(&["Hand0", "Comm", "Pallet"][..]));
    let other = call::controller_get_extension(client.controller, "Hand1", "");
    assert_eq!(world.call(client.peer, other), code(HResult::E_CAO_OBJECT_NOTFOUND));

    let hand = hand(&mut world, client);
    let execute = |command| call::extension_execute(hand, command, ());
    assert_eq!(world.call(client.peer, call::extension_get_name(hand)), ok("Hand0"));
    assert_eq!(world.call(client.peer, execute("CurPos")), ok(&0.0_f32));
    let at_rest =
        |world: &mut World, command, param: i32| world.run(client.peer, call::extension_execute(hand, command, param));
    assert_eq!(at_rest(&mut world, "UnChuck", 1).0, HResult::from_u32(0x8358_5200), "before Org");
    world.clear(client);
    for command in ["Motor", "Org"] {
        assert_eq!(at_rest(&mut world, command, 1), ok(&()));
    }
    let execute = |command: &'static str| call::extension_execute(hand, command, 1);
    world.begin(client.peer, &execute("UnChuck"));
    // 30 mm at 80 mm per second
    world.pass(100);
    assert!((world.sim.hand_position() - 8.0).abs() < 1e-3);
    assert_eq!(world.run_again(client.peer, &execute("UnChuck")), ok(&()));
    assert_eq!((world.now, world.sim.hand_position()), (Instant::from_millis(375), 30.0));
    assert_eq!(world.call(client.peer, execute("unchuck")), ok(&()), "open already");
    assert_eq!(world.run(client.peer, call::robot_chuck(client.robot, "")), code(HResult::S_OK));
    assert_eq!((world.now, world.call(client.peer, execute("CurPos"))), (Instant::from_millis(750), ok(&0.0_f32)));
    assert_eq!(world.run(client.peer, call::robot_unchuck(client.robot, "")), code(HResult::S_OK));
    assert_eq!(world.sim.hand_position(), 30.0);
    assert_eq!(world.call(client.peer, call::robot_chuck(client.robot, "x")), code(HResult::E_INVALIDARG));
    assert_eq!(world.call(client.peer, execute("Wave")), code(HResult::E_INVALID_CMD_NAME));
    assert_eq!(world.call(client.peer, call::extension_get_variable_names(hand, "")), ok(&[""; 0][..]));
    assert_eq!(world.call(client.peer, call::extension_release(hand)), code(HResult::S_OK));
    assert_eq!(world.call(client.peer, execute("CurPos")), code(HResult::E_HANDLE));
}

#[test]
fn a_cobotta_moves_its_hand_by_its_controller() {
    let (mut world, client) = cobotta();
    let run = |world: &mut World, command, first: f64, second: f64| {
        let before = world.now;
        let reply = world.run(client.peer, call::controller_execute(client.controller, command, [first, second]));
        (reply, world.now.saturating_since(before).as_millis(), world.sim.hand_position())
    };
    assert_eq!(run(&mut world, "HandMoveA", 20.0, 50.0), (ok(&()), 500, 20.0));
    assert_eq!(run(&mut world, "HandMoveR", -4.0, 100.0), (ok(&()), 50, 16.0));
    assert_eq!(run(&mut world, "HandMoveH", 10.0, 1.0), (ok(&()), 800, 0.0));
    assert_eq!(run(&mut world, "HandMoveH", 10.0, 0.0), (ok(&()), 1500, 30.0));
    let close = call::controller_execute(client.controller, "HandMoveH", (10, true));
    assert_eq!(world.run(client.peer, close), ok(&()));
    assert_eq!(world.sim.hand_position(), 0.0);
    let open = call::controller_execute(client.controller, "HandMoveH", (10.0_f32, false));
    assert_eq!(world.run(client.peer, open), ok(&()));
    assert_eq!(world.sim.hand_position(), 30.0);
    assert_eq!(world.execute(client, "HandCurPos", ()), ok(&30.0));
    assert_eq!(world.execute(client, "HandCurLoad", ()), ok(&0.0));
    for (command, first, second) in [
        ("HandMoveA", 30.1, 50.0),
        ("HandMoveA", -0.1, 50.0),
        ("HandMoveA", f64::NAN, 50.0),
        ("HandMoveA", 10.0, 0.0),
        ("HandMoveA", 10.0, 101.0),
        ("HandMoveR", 1.0, 50.0),
        ("HandMoveH", 5.0, 1.0),
        ("HandMoveH", 21.0, 1.0),
    ] {
        assert_eq!(run(&mut world, command, first, second), (code(HResult::E_INVALIDARG), 0, 30.0), "{command}");
    }
    assert_eq!(world.execute(client, "HandMoveA", 10), code(HResult::E_INVALIDARG));
}

#[test]
fn the_hand_is_stopped_by_a_command_an_error_or_the_end_of_its_client() {
    let (mut world, client) = cobotta();
    let other = world.client(2);
    let open = call::controller_execute(client.controller, "HandMoveA", [30, 10]);
    world.begin(client.peer, &open);
    let second = world.execute(other, "HandMoveA", [0, 10]);
    assert_eq!(second, code(HResult::E_ROBOTISBUSY));
    world.pass(1000);
    assert_eq!(world.execute(other, "HandStop", ()), ok(&()));
    assert_eq!(world.again(client.peer, &open), (Outcome::Done(HResult::E_ABORT), common::Value::EMPTY));
    assert!((world.sim.hand_position() - 8.0).abs() < 1e-9);
    assert_eq!(world.execute(other, "HandStop", ()), code(HResult::S_FALSE));

    world.begin(client.peer, &open);
    world.pass(500);
    let error = HResult::from_u32(0x8220_0001);
    world.sim.inject_error(error, world.now);
    assert_eq!(world.again(client.peer, &open).0, Outcome::Done(error));
    world.pass(500);
    assert!((world.sim.hand_position() - 12.0).abs() < 1e-9);
    assert_eq!(world.execute(client, "HandMoveA", [30, 10]), code(HResult::E_ERROR_PRESENT));

    world.execute(client, "ManualResetPreparation", ());
    world.execute(client, "ClearError", ());
    world.sim.set_token(Token::TeachPendant);
    assert_eq!(world.execute(client, "HandMoveA", [30, 10]), code(HResult::E_TOKEN_NOT_ETHERNET));
    world.sim.set_token(Token::Any);
    world.clear(client);
    world.begin(client.peer, &open);
    world.pass(500);
    world.sim.left(client.peer, world.now);
    world.pass(500);
    assert!((world.sim.hand_position() - 16.0).abs() < 1e-9);
}

// --- command objects

fn command(world: &mut World, client: Client, name: &str) -> CommandHandle {
    CommandHandle(world.handle(client.peer, call::controller_get_command(client.controller, name, "")))
}

fn state(world: &mut World, client: Client, command: CommandHandle) -> Reply {
    world.call(client.peer, call::command_get_state(command))
}

#[test]
fn a_command_object_keeps_parameters_and_result() {
    let mut world = World::new();
    let client = world.client(1);
    let description = command(&mut world, client, "geterrordescription");
    assert_eq!(world.call(client.peer, call::command_get_name(description)), ok("GetErrorDescription"));
    assert_eq!(state(&mut world, client, description), ok(&0));
    assert_eq!(world.call(client.peer, call::command_get_parameters(description)), ok(&()));
    assert_eq!(world.call(client.peer, call::command_get_result(description)), ok(&()));

    let unknown = HResult::E_MOTOR_OFF.0;
    let put = call::command_put_parameters(description, unknown);
    assert_eq!(world.call(client.peer, put), code(HResult::S_OK));
    assert_eq!(world.call(client.peer, call::command_get_parameters(description)), ok(&unknown));
    let expected = world.execute(client, "GetErrorDescription", unknown);
    assert_eq!(world.call(client.peer, call::command_execute(description, 0)), expected);
    assert_eq!(world.call(client.peer, call::command_get_result(description)), expected);
    assert_eq!(state(&mut world, client, description), ok(&2));

    let put = call::command_put_parameters(description, "nothing");
    assert_eq!(world.call(client.peer, put), code(HResult::S_OK));
    let failed = code(HResult::DISP_E_TYPEMISMATCH);
    assert_eq!(world.call(client.peer, call::command_execute(description, 1)), failed);
    assert_eq!(world.call(client.peer, call::command_get_result(description)), failed);
    assert_eq!(state(&mut world, client, description), ok(&3));
    assert_eq!(world.call(client.peer, call::command_execute(description, 2)), code(HResult::E_INVALIDARG));
    assert_eq!(world.call(client.peer, call::command_cancel(description)), code(HResult::S_FALSE));
    assert_eq!(world.call(client.peer, call::command_release(description)), code(HResult::S_OK));
    assert_eq!(state(&mut world, client, description), code(HResult::E_HANDLE));
}

#[test]
fn the_names_of_commands_are_those_that_can_be_opened_and_executed() {
    for (profile, count) in [(Profile::Rc8, 19), (Profile::Rc9, 22), (Profile::Cobotta, 32)] {
        let mut world = World::with(Config::new(profile));
        let client = world.client(1);
        let (_, names) = world.call(client.peer, call::controller_get_command_names(client.controller, ""));
        let names: Vec<String> =
            names.as_variant().as_array().unwrap().iter().map(|name| name.as_bstr().unwrap().to_string()).collect();
        assert_eq!(names.len(), count, "{profile:?}: {names:?}");
        for name in names {
            let opened = command(&mut world, client, &name);
            let reply = world.run(client.peer, call::command_execute(opened, 0)).0;
            let unknown = [HResult::E_NOTIMPL, HResult::E_INVALID_CMD_NAME].contains(&reply);
            assert!(!unknown, "{profile:?}: {name} answers {reply}");
        }
        let other = call::controller_get_command(client.controller, "SetAutoMode", "");
        assert_eq!(world.call(client.peer, other), code(HResult::E_CAO_OBJECT_NOTFOUND));
    }
}

#[test]
fn a_command_that_takes_time_is_waited_for_or_not() {
    let mut world = World::new();
    let client = world.client(1);
    let motor = command(&mut world, client, "Motor");
    world.call(client.peer, call::command_put_parameters(motor, 1));
    assert_eq!(world.run(client.peer, call::command_execute(motor, 0)), ok(&()));
    assert_eq!((world.now, state(&mut world, client, motor)), (Instant::from_millis(300), ok(&2)));

    world.robot(client, "Motor", 0);
    assert_eq!(world.call(client.peer, call::command_execute(motor, 1)), code(HResult::S_OK));
    assert_eq!(state(&mut world, client, motor), ok(&1));
    assert_eq!(world.call(client.peer, call::command_execute(motor, 1)), code(HResult::E_CAO_CMD_EXECUTE));
    world.pass(299);
    assert_eq!((state(&mut world, client, motor), world.sim.motor_is_on()), (ok(&1), false));
    world.pass(1);
    assert_eq!((state(&mut world, client, motor), world.sim.motor_is_on()), (ok(&2), true));

    world.robot(client, "Motor", 0);
    world.call(client.peer, call::command_execute(motor, 1));
    assert_eq!(world.call(client.peer, call::command_cancel(motor)), code(HResult::S_OK));
    world.pass(1000);
    assert_eq!((state(&mut world, client, motor), world.sim.motor_is_on()), (ok(&3), false));
    assert_eq!(world.call(client.peer, call::command_get_result(motor)), code(HResult::E_CANCEL));

    world.call(client.peer, call::command_execute(motor, 1));
    world.sim.emergency_stop(true, world.now);
    assert_eq!(state(&mut world, client, motor), ok(&3));
}

#[test]
fn the_timeout_of_a_command_ends_the_waiting_but_not_the_command() {
    let mut world = World::new();
    let client = world.client(1);
    let motor = command(&mut world, client, "Motor");
    world.call(client.peer, call::command_put_parameters(motor, 1));
    assert_eq!(world.call(client.peer, call::command_get_timeout(motor)), ok(&0));
    assert_eq!(world.call(client.peer, call::command_put_timeout(motor, -1)), code(HResult::E_INVALIDARG));
    assert_eq!(world.call(client.peer, call::command_put_timeout(motor, 120)), code(HResult::S_OK));
    assert_eq!(world.call(client.peer, call::command_get_timeout(motor)), ok(&120));
    assert_eq!(world.run(client.peer, call::command_execute(motor, 0)), code(HResult::E_TIMEOUT));
    assert_eq!((world.now, world.sim.motor_is_on()), (Instant::from_millis(120), false));
    assert_eq!(state(&mut world, client, motor), ok(&1));
    world.pass(180);
    assert_eq!((state(&mut world, client, motor), world.sim.motor_is_on()), (ok(&2), true));
}

#[test]
fn a_command_that_stops_all_tasks_ends_when_tasks_and_robot_rest() {
    let mut world = World::new();
    let (client, other) = (world.mover(1), world.client(2));
    let start = |world: &mut World, name: &str, pose: &str| {
        let stop = command(world, client, name);
        world.call(client.peer, call::command_put_parameters(stop, 1));
        let task = world.task(client, "Pro1");
        assert_eq!(world.call(client.peer, call::task_start(task, 2, "")), code(HResult::S_OK));
        assert_eq!(world.call(client.peer, call::robot_move(client.robot, 1, pose, "NEXT")), code(HResult::S_OK));
        assert_eq!(world.call(client.peer, call::command_execute(stop, 1)), code(HResult::S_OK));
        assert_eq!(state(world, client, stop), ok(&1), "{name}");
        stop
    };
    for (name, pose) in [("KillAll", "J(30,45,90,0,45,0)"), ("StepStopAll", "J(0,45,90,0,45,0)")] {
        let stop = start(&mut world, name, pose);
        world.pass(5000);
        assert_eq!(state(&mut world, client, stop), ok(&2), "{name}");
    }
    // Cancel of such a command does not stop the hand
    let open = call::robot_unchuck(other.robot, "");
    world.begin(other.peer, &open);
    let stop = start(&mut world, "SuspendAll", "J(30,45,90,0,45,0)");
    assert_eq!(world.call(client.peer, call::command_cancel(stop)), code(HResult::S_OK));
    assert_eq!(state(&mut world, client, stop), ok(&3));
    assert_eq!(world.run_again(other.peer, &open), code(HResult::S_OK));
    assert_eq!(world.sim.hand_position(), 30.0);
}

// --- messages

fn fetch(world: &mut World, client: Client) -> MessageHandle {
    MessageHandle(world.handle(client.peer, call::controller_get_message(client.controller)))
}

#[test]
fn each_error_is_a_message_to_each_client() {
    let mut world = World::with(Config { wall_clock_origin_ms: 1_700_000_000_000, ..Config::default() });
    let clients = [world.client(1), world.client(2)];
    for client in clients {
        assert_eq!(world.call(client.peer, call::controller_get_message(client.controller)), code(HResult::S_FALSE));
    }
    let errors = [HResult::from_u32(0x8420_4043), HResult::E_COMMAND_BUFFER_EMPTY];
    for (n, error) in (1..).zip(errors) {
        world.sim.inject_error(error, Instant::from_millis(n * 1000));
    }
    world.now = Instant::from_millis(5000);
    for client in clients {
        for (n, error) in (1..).zip(errors) {
            let message = fetch(&mut world, client);
            let (_, text) = world.execute(client, "GetErrorDescription", error);
            assert_eq!(world.call(client.peer, call::message_get_number(message)), ok(&error.0));
            assert_eq!(world.call(client.peer, call::message_get_value(message)), ok(&error.0));
            assert_eq!(world.call(client.peer, call::message_get_description(message)), (HResult::S_OK, text));
            let date = OleDate::from_unix_millis(1_700_000_000_000 + i64::from(n) * 1000).unwrap();
            assert_eq!(world.call(client.peer, call::message_get_date_time(message)), ok(&date));
            assert_eq!(world.call(client.peer, call::message_get_serial_number(message)), ok(&n));
            assert_eq!(world.call(client.peer, call::message_get_source(message)), ok("RC8"));
            assert_eq!(world.call(client.peer, call::message_get_destination(message)), ok(""));
            assert_eq!(world.call(client.peer, call::message_reply(message, 1)), code(HResult::S_FALSE));
            assert_eq!(world.call(client.peer, call::message_clear(message)), code(HResult::S_OK));
            assert_eq!(world.call(client.peer, call::message_release(message)), code(HResult::S_OK));
        }
        assert_eq!(world.call(client.peer, call::controller_get_message(client.controller)), code(HResult::S_FALSE));
    }
}

#[test]
fn messages_are_bounded_and_only_for_those_that_want_them() {
    let mut world = World::new();
    let client = world.client(1);
    let silent = PeerId(2);
    world.call(silent, call::service_start(""));
    let connect = call::controller_connect("", "CaoProv.DENSO.VRC", "localhost", "@EventDisable=True,Wpj=*");
    let controller = call::ControllerHandle(world.handle(silent, connect));
    for n in 0..100 {
        world.sim.inject_error(HResult::from_u32(0x8150_0000 + n), world.now);
    }
    assert_eq!(world.call(silent, call::controller_get_message(controller)), code(HResult::S_FALSE));
    for n in 36..100_i32 {
        let message = fetch(&mut world, client);
        assert_eq!(world.call(client.peer, call::message_get_serial_number(message)), ok(&(n + 1)));
        world.call(client.peer, call::message_release(message));
    }
    assert_eq!(world.call(client.peer, call::controller_get_message(client.controller)).1, value(&()));
    let late = world.client(3);
    assert_eq!(world.call(late.peer, call::controller_get_message(late.controller)), code(HResult::S_FALSE));
}
