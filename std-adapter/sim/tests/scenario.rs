//! Scenarios: each fault at its place, in the controller and on the wire, the same in every run.

use bcap_core::bcap::call::{self, Call};
use bcap_core::bcap::server::{Config as Server, Handler, Session};
use bcap_core::bcap::{Decoder, FrameWriter};
use bcap_core::endpoint::{Endpoint, Serve};
use bcap_core::handler::{Outcome, PeerId};
use bcap_core::hresult::HResult;
use bcap_core::time::Instant;
use bcap_sim::codes::{EMERGENCY_STOP, MANUAL_MODE};
use bcap_sim::model::ArmProfile;
use bcap_sim::pace::Paced;
use bcap_sim::scenario::Delivery;
use bcap_sim::{Config, Controller, Profile, Scenario};

use crate::common;
use crate::common::{Client, World, code, ok};

const START: [f64; 8] = [0.0, 45.0, 90.0, 0.0, 45.0, 0.0, 0.0, 0.0];

fn j1(angle: f64) -> [f64; 8] {
    let mut joints = START;
    joints[0] = angle;
    joints
}

fn scenario(text: &str) -> Scenario {
    Scenario::parse(text).unwrap_or_else(|error| panic!("{error}"))
}

/// A client in slave mode, with a scenario that begins now.
fn slave(mode: i32, text: &str) -> (World, Client) {
    let mut world = World::new();
    let client = world.mover(1);
    assert_eq!(world.robot(client, "slvChangeMode", mode), ok(&()));
    world.sim.play(scenario(text));
    (world, client)
}

fn slv_move(world: &mut World, client: Client, angle: f64) -> HResult {
    world.call(client.peer, call::robot_execute(client.robot, "slvMove", j1(angle))).0
}

fn errors(world: &World) -> Vec<HResult> {
    world.sim.errors().map(|e| e.code).collect()
}

#[test]
fn the_third_call_of_a_command_is_refused_and_not_carried_out() {
    let text = "[[fault]]\nwhen = { call = 3, of = 'slvmove' }\nthen = { refuse = '0x83501032' }";
    let (mut world, client) = slave(0x102, text);
    assert_eq!(world.robot(client, "slvGetMode", ()), ok(&0x102), "another command is not counted");
    let codes: Vec<_> = (1..=4).map(|n| slv_move(&mut world, client, f64::from(n) * 0.1)).collect();
    assert_eq!(codes, [HResult::S_OK, HResult::S_OK, HResult::E_SLVMODE_ON, HResult::E_SLVMODE_OFF]);
    assert_eq!(world.sim.slave_counters().overwritten, 1, "two poses came");
}

#[test]
fn a_storm_of_full_buffers_has_a_beginning_and_an_end() {
    let text = "[[fault]]\nwhen = { call = 2, to = 4, of = 'Robot_Execute' }\nthen = { refuse = 'E_BUF_FULL' }";
    let (mut world, client) = slave(0x102, text);
    let codes: Vec<_> = (1..=5).map(|_| slv_move(&mut world, client, 0.0)).collect();
    let full = HResult::E_BUF_FULL;
    assert_eq!(codes, [HResult::S_OK, full, full, full, HResult::S_OK]);
}

#[test]
fn an_error_strikes_at_its_cycle() {
    for step in [1, 8, 1000] {
        let text = "[[fault]]\nwhen = { cycle = 50 }\nthen = { error = '0x84204043' }";
        let (mut world, _) = slave(0x202, text);
        let entered = world.now;
        while errors(&world).is_empty() {
            world.pass(step);
        }
        assert_eq!(errors(&world), [HResult::from_u32(0x8420_4043)]);
        assert_eq!(world.sim.slave_mode(), 0);
        let at = world.sim.errors().next().unwrap().at;
        assert_eq!(at.saturating_since(entered).as_millis(), 50 * 8, "in steps of {step} ms");
    }
}

#[test]
fn a_moving_robot_stands_where_the_fault_met_it() {
    let text = "[[fault]]\nwhen = { cycle = 3 }\nthen = { emergency_stop = true }";
    let (mut world, client) = slave(0x002, text);
    for angle in [0.2, 0.4, 0.6] {
        assert!(slv_move(&mut world, client, angle).is_ok());
    }
    world.pass(1000);
    assert_eq!((errors(&world), world.sim.axes()[0]), (vec![HResult::E_COMMAND_POSITION_GEN_STOPPED], 0.4));
    assert!(world.sim.emergency_stopped() && !world.sim.is_moving());
    let last = world.sim.slave_record().last().unwrap();
    assert_eq!((last.cycle, last.axes[0]), (2, 0.4), "nothing was commanded afterwards");
}

#[test]
fn the_emergency_stop_is_pressed_and_released_by_the_clock() {
    let text = "[[fault]]\nwhen = { at_ms = 900 }\nthen = { emergency_stop = false }
                [[fault]]\nwhen = { at_ms = 500 }\nthen = { emergency_stop = true }";
    let mut world = World::new();
    world.sim.play(scenario(text));
    world.pass(499);
    assert!(!world.sim.emergency_stopped());
    world.pass(1);
    assert!(world.sim.emergency_stopped());
    world.pass(399);
    assert!(world.sim.emergency_stopped());
    world.pass(5000);
    assert!(!world.sim.emergency_stopped());
    assert_eq!(errors(&world), []);
}

#[test]
fn an_error_at_a_call_comes_before_it() {
    let text = "[[fault]]\nwhen = { call = 2, of = 'slvMove' }\nthen = { error = 'E_COMMAND_POSITION_GEN_STOPPED' }";
    let (mut world, client) = slave(0x102, text);
    assert_eq!(slv_move(&mut world, client, 0.0), HResult::S_OK);
    assert_eq!(slv_move(&mut world, client, 0.0), HResult::E_SLVMODE_OFF);
    assert_eq!(errors(&world), [HResult::E_SLVMODE_OFF, HResult::E_COMMAND_POSITION_GEN_STOPPED]);
}

#[test]
fn an_answer_that_is_delayed_is_the_answer_of_its_time() {
    let text = "[[fault]]\nwhen = { every = 2, of = 'slvMove' }\nthen = { delay_ms = 20 }";
    let (mut world, client) = slave(0x102, text);
    let call = call::robot_execute(client.robot, "slvMove", START);
    assert_eq!(world.call(client.peer, &call), ok(&START));
    let deadline = Instant::from_micros(world.now.as_micros() + 20_000);
    let moved = call::robot_execute(client.robot, "slvMove", j1(0.4));
    assert_eq!(world.poll(client.peer, &moved, false).0, Outcome::Wait(deadline));
    world.pass(19);
    assert_eq!(world.again(client.peer, &moved).0, Outcome::Wait(deadline));
    assert_eq!(world.sim.axes(), j1(0.4), "it was carried out at once");
    world.pass(1);
    assert_eq!(world.again(client.peer, &moved), (Outcome::Done(HResult::S_OK), common::value(&START)));
    assert_eq!(world.call(client.peer, &call), ok(&j1(0.4)), "the third is not delayed");
}

#[test]
fn the_delays_of_a_call_add_up_from_its_end() {
    let millis = |text: &str| {
        let mut world = World::new();
        let client = world.mover(1);
        world.sim.play(scenario(text));
        let start = world.now;
        assert_eq!(world.move_to(client, 1, "J(90,45,90,0,45,0)", ""), HResult::S_OK);
        world.now.saturating_since(start).as_millis()
    };
    let delay = "[[fault]]\nwhen = { call = 1, of = 'Robot_Move' }\nthen = { delay_ms = 300 }\n";
    let plain = millis("");
    assert!(plain > 300, "{plain}");
    assert_eq!([millis(delay), millis(&delay.repeat(2))], [plain + 300, plain + 600]);
}

#[test]
fn a_lost_link_carries_nothing_and_the_buffer_runs_empty() {
    let text = "[[fault]]\nwhen = { cycle = 2 }\nthen = { link_loss_ms = 100 }";
    let (mut world, client) = slave(0x002, text);
    for angle in [0.2, 0.4, 0.6] {
        assert!(slv_move(&mut world, client, angle).is_ok());
    }
    let (mut entered, mut frame) = (world.now, [0_u8; 16]);
    world.pass(15);
    assert_eq!(world.sim.deliver(client.peer, &mut frame), Delivery::Send);
    world.pass(1);
    entered = entered + bcap_sim::slave::CYCLE * 2;
    assert_eq!(entered, world.now);
    assert_eq!(world.sim.deliver(client.peer, &mut frame), Delivery::Drop, "not even S_EXECUTING");
    let late = call::robot_execute(client.robot, "slvMove", j1(0.8));
    let restored = entered + std::time::Duration::from_millis(100);
    assert_eq!(world.poll(client.peer, &late, false).0, Outcome::Wait(restored));
    world.pass(50);
    assert_eq!((errors(&world), world.sim.axes()[0]), (vec![HResult::E_COMMAND_BUFFER_EMPTY], 0.6));
    // a call that arrived during the loss is never answered
    world.pass(50);
    assert!(matches!(world.again(client.peer, &late).0, Outcome::Done(_)));
    assert_eq!(world.sim.deliver(client.peer, &mut frame), Delivery::Drop);
    assert_eq!(slv_move(&mut world, client, 0.0), HResult::E_SLVMODE_OFF);
    assert_eq!(world.sim.deliver(client.peer, &mut frame), Delivery::Send);
}

/// Sends Service_Start through a server's session, and returns the treatment of the reply's bytes.
fn wire(text: &str) -> (Delivery, Vec<u8>) {
    let mut sim = Controller::new(Config::default());
    sim.play(scenario(text));
    let mut session = Session::<_, _, 8>::new(Server::TCP, [0; 128], [0; 128]);
    let mut memory = [0; 64];
    let mut request = FrameWriter::new(&mut memory).unwrap();
    request.argument(&"").unwrap();
    let request = request.finish(0x0102, 0, 1).unwrap();
    session.receive_buffer()[..request.len()].copy_from_slice(request);
    session.received(request.len());
    while session.run(&mut sim, PeerId(1), Instant::ZERO).is_some() {}
    let mut bytes = session.transmit().to_vec();
    (sim.deliver(PeerId(1), &mut bytes), bytes)
}

#[test]
fn answers_suffer_on_the_wire() {
    let fault = |then: &str| wire(&format!("[[fault]]\nwhen = {{ call = 1 }}\nthen = '{then}'"));
    let (delivery, intact) = wire("");
    assert_eq!((delivery, intact.len()), (Delivery::Send, 16));
    assert_eq!(fault("drop").0, Delivery::Drop);
    assert_eq!(fault("disconnect").0, Delivery::Disconnect);
    let (delivery, bytes) = fault("wrong_serial");
    let frame = Decoder::TCP.decode_datagram(&bytes).unwrap();
    assert_eq!((delivery, frame.serial, frame.code), (Delivery::Send, 0x4102, 0));
    let (delivery, bytes) = fault("corrupt");
    assert_eq!(delivery, Delivery::Send);
    let wrong: u32 = bytes.iter().zip(&intact).map(|(a, b)| (a ^ b).count_ones()).sum();
    assert_eq!(wrong, 1);
    assert_eq!(fault("corrupt").1, bytes, "the same seed, the same bit");
}

/// A server's side of a connection.
type Connection = Session<[u8; 128], [u8; 128], 8>;

fn connection() -> Connection {
    Session::new(Server::TCP, [0; 128], [0; 128])
}

/// Makes a call through a server's session, and returns the code of the reply.
fn through(session: &mut Connection, handler: &mut impl Handler, peer: u32, call: &impl Call) -> HResult {
    let mut memory = [0; 128];
    let mut request = FrameWriter::new(&mut memory).unwrap();
    call.arguments(&mut request).unwrap();
    let request = request.finish(1, 0, call.function().0).unwrap();
    session.receive_buffer()[..request.len()].copy_from_slice(request);
    session.received(request.len());
    while session.run(handler, PeerId(peer), Instant::ZERO).is_some() {}
    let reply = Decoder::TCP.decode_datagram(session.transmit()).unwrap();
    let (code, len) = (reply.hresult(), session.transmit().len());
    session.transmitted(len);
    code
}

#[test]
fn a_fault_of_service_stop_meets_the_call_of_the_client() {
    let at_stop =
        |then: &str| scenario(&format!("[[fault]]\nwhen = {{ call = 1, of = 'Service_Stop' }}\nthen = {then}"));
    let mut paced = Paced::new(Controller::new(Config::default()));
    paced.controller().play(at_stop("{ refuse = 'E_FAIL' }"));
    let mut session = connection();
    assert_eq!(through(&mut session, &mut paced, 1, &call::service_start("")), HResult::S_OK);
    assert_eq!(through(&mut session, &mut paced, 1, &call::service_stop()), HResult::E_FAIL);

    let mut sim = Controller::new(Config::default());
    sim.play(at_stop("'drop'"));
    let mut session = connection();
    assert_eq!(through(&mut session, &mut sim, 1, &call::service_start("")), HResult::S_OK);
    assert_eq!(through(&mut session, &mut sim, 1, &call::service_stop()), HResult::S_OK);
    assert_eq!(sim.deliver(PeerId(1), &mut [0; 16]), Delivery::Drop);
}

#[test]
fn the_releases_at_the_end_of_a_connection_are_not_counted() {
    let mut sim = Controller::new(Config::default());
    sim.play(scenario("[[fault]]\nwhen = { call = 3 }\nthen = { emergency_stop = true }"));
    let mut sessions = [connection(), connection()];
    for (peer, session) in (1..).zip(&mut sessions) {
        assert_eq!(through(session, &mut sim, peer, &call::service_start("")), HResult::S_OK);
    }
    let [mut stays, mut leaves] = sessions;
    leaves.close(&mut sim, PeerId(2), Instant::ZERO);
    assert!(!sim.emergency_stopped(), "the third call");
    assert_eq!(through(&mut stays, &mut sim, 1, &call::service_stop()), HResult::S_OK);
    assert!(sim.emergency_stopped());
}

#[test]
fn chance_is_the_same_for_the_same_seed() {
    let run = |seed: u32| {
        let text = format!(
            "seed = {seed}\n[[fault]]\nwhen = {{ chance = 0.25, of = 'slvMove' }}\nthen = {{ refuse = 'E_FAIL' }}"
        );
        let (mut world, client) = slave(0x102, &text);
        (0..400).map(|_| slv_move(&mut world, client, 0.0).is_err()).collect::<Vec<_>>()
    };
    let refused = run(7).iter().filter(|refused| **refused).count();
    assert!((60..140).contains(&refused), "{refused} of 400");
    assert_eq!(run(7), run(7));
    assert_ne!(run(7), run(8));
}

#[test]
fn several_faults_of_one_call_all_happen() {
    let text = "[[fault]]\nwhen = { call = 1 }\nthen = { refuse = 'E_FAIL' }
                [[fault]]\nwhen = { call = 1 }\nthen = { delay_ms = 5 }
                [[fault]]\nwhen = { call = 1 }\nthen = 'drop'";
    let (mut world, client) = slave(0x102, text);
    let call = call::robot_execute(client.robot, "slvMove", START);
    world.begin(client.peer, &call);
    assert_eq!(
        world.sim.deliver(client.peer, &mut [0; 16]),
        Delivery::Send,
        "what is sent meanwhile is not the answer"
    );
    assert_eq!(world.run_again(client.peer, &call), code(HResult::E_FAIL));
    assert_eq!(world.sim.deliver(client.peer, &mut [0; 16]), Delivery::Drop);
}

/// A controller that begins as the section says, and a client of it.
fn begun(section: &str) -> (World, Client) {
    let mut world = World::new();
    world.sim.play(scenario(&format!("[controller]\n{section}")));
    let client = world.client(1);
    (world, client)
}

#[test]
fn each_thing_that_slave_mode_needs_can_be_missing_at_the_beginning() {
    for (section, missing) in [
        ("mode = 'manual'", MANUAL_MODE),
        ("mode = 'teach_check'", MANUAL_MODE),
        ("token = 'pendant'", HResult::E_TOKEN_NOT_ETHERNET),
        ("token = 'other'", HResult::E_TOKEN_ADDRESS),
        ("token = '192.168.0.5'", HResult::E_TOKEN_ADDRESS),
        ("emergency_stop = true", EMERGENCY_STOP),
        ("errors = ['0x84201482']", HResult::E_ERROR_PRESENT),
        ("arm = 'taken'", HResult::E_ARM_NOT_TAKEN),
        ("motor = false", HResult::E_MOTOR_OFF),
        ("licence = false", HResult::E_NO_LICENSE),
    ] {
        // only this condition is violated: the motor is on where possible, the arm is taken where it is free
        let can_be_on = ![HResult::E_ERROR_PRESENT, HResult::E_MOTOR_OFF, EMERGENCY_STOP].contains(&missing);
        let (mut world, client) = begun(&format!("{section}\n{}", if can_be_on { "motor = true" } else { "" }));
        if world.robot(client, "TakeArm", [0, 1]).0.is_err() && missing != HResult::E_ERROR_PRESENT {
            world.clear(client);
        }
        assert_eq!(world.robot(client, "slvChangeMode", 0x102), code(missing), "{section}");
        assert_eq!((world.sim.slave_mode(), world.sim.motor_is_on()), (0, can_be_on), "{section}");
    }
    let (mut world, client) = begun("mode = 'auto'\ntoken = 'any'\nmotor = true\narm = 'free'\nlicence = true");
    assert_eq!(world.robot(client, "TakeArm", [0, 1]), ok(&()));
    assert_eq!(world.robot(client, "slvChangeMode", 0x102), ok(&()));
}

#[test]
fn the_errors_of_the_beginning_are_listed_with_the_first_cause_last() {
    let (mut world, client) = begun("errors = ['0x84201482', 'E_SLVMODE_OFF']\nversion = '1.2.3'");
    assert_eq!(errors(&world), [HResult::E_SLVMODE_OFF, HResult::E_COMMAND_BUFFER_EMPTY]);
    assert_eq!(world.execute(client, "GetCurErrorCount", ()), ok(&2));
    assert_eq!(world.get(client, "@VERSION"), ok("1.2.3"));
    assert_eq!(world.execute(client, "ClearError", ()), ok(&()));

    let (mut world, client) = begun("emergency_stop = true");
    assert_eq!(world.execute(client, "ClearError", ()), ok(&()), "the stop is no error");
    assert_eq!(world.robot(client, "Motor", 1), code(EMERGENCY_STOP));
}

#[test]
fn the_motor_does_not_begin_on_in_emergency_stop_or_with_an_error() {
    let stop: fn(&mut World, bool) = |world, on| world.sim.emergency_stop(on, world.now);
    let error: fn(&mut World, bool) = |world, on| match on {
        true => world.sim.inject_error(HResult::from_u32(0x8420_4043), world.now),
        false => world.sim.clear_errors(world.now),
    };
    for prevents in [stop, error] {
        let mut world = World::new();
        prevents(&mut world, true);
        world.sim.play(scenario("[controller]\nmotor = true"));
        assert!(!world.sim.motor_is_on());
        prevents(&mut world, false);
        world.sim.play(scenario("[controller]\nmotor = true"));
        assert!(world.sim.motor_is_on());
    }
}

#[test]
fn the_formats_of_the_beginning_are_the_only_ones() {
    for (list, there) in [("", 0), ("'mini_io'", 0x100), ("'hand_io'", 0x20), ("'user_io'", 0x200), ("'current'", 0x40)]
    {
        let (mut world, client) = begun(&format!("formats = [{list}]"));
        for bit in [0x20, 0x40, 0x100, 0x200] {
            let expected = if bit == there { ok(&()) } else { code(HResult::E_INVALIDARG) };
            assert_eq!(world.robot(client, "slvRecvFormat", bit | 2), expected, "{list}: {bit:#x}");
        }
    }
    let (mut world, client) = begun("permission = 'read_only'");
    assert_eq!(world.put(client, "I1", 1), HResult::E_CAO_NOT_WRITABLE);
}

#[test]
fn a_service_that_refuses_everybody_is_a_fault_of_every_call() {
    let mut world = World::new();
    let text = "[[fault]]\nwhen = { every = 1, of = 'Service_Start' }\nthen = { refuse = 'E_MAX_CONNECT' }";
    world.sim.play(scenario(text));
    for peer in 1..4 {
        let start = call::service_start("");
        assert_eq!(world.call(PeerId(peer), start), code(HResult::E_MAX_CONNECT));
        let connect = call::controller_connect("", "CaoProv.DENSO.VRC", "", "");
        assert_eq!(world.call(PeerId(peer), connect), code(HResult::E_NOT_CONNECTED));
    }
}

#[test]
fn switches_are_turned_by_the_clock() {
    let text = "[[fault]]\nwhen = { at_ms = 1500 }\nthen = { motor = false }
                [[fault]]\nwhen = { at_ms = 2000 }\nthen = { mode = 'manual' }
                [[fault]]\nwhen = { at_ms = 3000 }\nthen = { mode = 'auto' }
                [[fault]]\nwhen = { at_ms = 3000 }\nthen = { token = 'other' }
                [[fault]]\nwhen = { at_ms = 4000 }\nthen = { token = 'any' }
                [[fault]]\nwhen = { at_ms = 4000 }\nthen = { motor = true }";
    let (mut world, client) = slave(0x102, text);
    let mut seen = Vec::new();
    for at in [1499, 1500, 2000, 3000, 4000, 4300] {
        let left = at - world.now.as_micros() / 1000;
        world.pass(left);
        seen.push((world.sim.motor_is_on(), world.robot(client, "slvChangeMode", 0x002).0));
        if at != 4300 {
            world.clear(client);
        }
    }
    let expected = [
        (true, HResult::E_SLVMODE_ON),
        (false, HResult::E_MOTOR_OFF),
        (false, MANUAL_MODE),
        (false, HResult::E_TOKEN_ADDRESS),
        (false, HResult::E_MOTOR_OFF),
        (true, HResult::S_OK),
    ];
    assert_eq!(seen, expected);
}

#[test]
fn what_is_no_scenario_says_where_and_why() {
    for (text, problem) in [
        ("seed = -1", "line 1"),
        ("[controller]\nmode = 'automatic'", "unknown variant `automatic`"),
        ("[controller]\nmoder = 'auto'", "unknown field `moder`"),
        ("[controller]\nerrors = ['S_FALSE']", "controller: an error is a code that begins with 8"),
        ("[controller]\nerrors = ['OOPS']", "controller: a code is a known name"),
        ("[controller]\nmotor = true\nemergency_stop = true", "controller: the motor is off while"),
        ("[controller]\nmotor = true\ntorque_off = true", "controller: the motor is off while the torque is off"),
        ("[controller]\ntoken = '192.168.0'", "any, pendant, other or an IP address, not \"192.168.0\""),
        ("[controller]\nslave_speed_setting = 4", "controller: `slave_speed_setting` is 0 to 3"),
        ("[[fault]]\nwhen = { call = 1 }", "missing field `then`"),
        ("[[fault]]\nwhen = { cal = 1 }\nthen = 'drop'", "unknown field `cal`"),
        ("[[fault]]\nwhen = { call = 1 }\nthen = 'dorp'", "unknown variant `dorp`"),
        ("[[fault]]\nwhen = { call = 1, every = 2 }\nthen = 'drop'", "fault 1: `when` needs exactly one of"),
        ("[[fault]]\nwhen = {}\nthen = 'drop'", "fault 1: `when` needs exactly one of"),
        ("[[fault]]\nwhen = { call = 0 }\nthen = 'drop'", "fault 1: calls are counted from 1"),
        ("[[fault]]\nwhen = { call = 3, to = 2 }\nthen = 'drop'", "fault 1: calls are counted from 1"),
        ("[[fault]]\nwhen = { every = 2, to = 2 }\nthen = 'drop'", "fault 1: `to` is the end of a range"),
        ("[[fault]]\nwhen = { every = 0 }\nthen = 'drop'", "fault 1: `every` is 1 or more"),
        ("[[fault]]\nwhen = { chance = 1.5 }\nthen = 'drop'", "fault 1: `chance` is 0 to 1"),
        ("[[fault]]\nwhen = { cycle = 0 }\nthen = { error = 'E_FAIL' }", "fault 1: cycles are counted from 1"),
        ("[[fault]]\nwhen = { cycle = 1 }\nthen = 'drop'", "fault 1: what concerns the answer of a call"),
        ("[[fault]]\nwhen = { at_ms = 1, of = 'x' }\nthen = { error = 'E_FAIL' }", "fault 1: `of` says what calls"),
        ("[[fault]]\nwhen = { call = 1 }\nthen = { error = 'S_FALSE' }", "fault 1: an error is a code that begins"),
        ("[[fault]]\nwhen = { call = 1 }\nthen = { error = '0x00000001' }", "fault 1: an error is a code that begins"),
        ("[[fault]]\nwhen = { call = 1 }\nthen = { error = '0x8420404' }", "fault 1: a code is a known name or"),
        ("[[fault]]\nwhen = { call = 1 }\nthen = { refuse = '0x+8420404' }", "fault 1: a code is a known name or"),
        (
            "[[fault]]\nwhen = { call = 1 }\nthen = 'drop'\n[[fault]]\nwhen = { call = 1 }\nthen = { refuse = 'E_FOO' }",
            "fault 2: a code is a known name",
        ),
    ] {
        let error = Scenario::parse(text).unwrap_err().to_string();
        assert!(error.contains(problem), "{text:?}: {error}");
    }
}

#[test]
fn each_model_has_a_type_of_robot_and_a_version_that_drivers_accept() {
    for (profile, robot_type, version) in [
        (Profile::Rc8, "VS060A3", "2.8.0"),
        (Profile::Rc9, "VS060A3", "1.4.0"),
        (Profile::Cobotta, "CVR038A1", "2.8.0"),
    ] {
        let mut world = World::with(Config::new(profile));
        let client = world.client(1);
        assert_eq!(world.robot_get(client, "@TYPE_NAME"), ok(robot_type), "{profile:?}");
        assert_eq!(world.get(client, "@VERSION"), ok(version), "{profile:?}");
        let names = call::controller_get_robot_names(client.controller, "");
        assert_eq!(world.call(client.peer, names), ok(&["Arm0"]), "{profile:?}");
    }
}

#[test]
fn a_scenario_sets_type_name_and_axes_of_the_robot() {
    let (mut world, client) =
        begun("robot_type = 'CVR038A1-NV6'\narm_name = 'Left'\naxes = 7\nversion = '3.0.1'\nservo_on_waits = false");
    assert_eq!(world.robot_get(client, "@TYPE_NAME"), ok("CVR038A1-NV6"));
    assert_eq!(world.get(client, "@VERSION"), ok("3.0.1"));
    let names = call::controller_get_robot_names(client.controller, "");
    assert_eq!(world.call(client.peer, names), ok(&["Left"]));
    assert_eq!((world.sim.config().extended_axes, world.sim.config().servo_on_waits), (1, false));
    for axes in [5, 9] {
        let error = Scenario::parse(&format!("[controller]\naxes = {axes}")).unwrap_err();
        assert_eq!(error.to_string(), "controller: `axes` is 6, 7 or 8");
    }
    let scenario = Scenario::parse("[controller]\naxes = 7").unwrap();
    let six = Config::new(Profile::Rc8);
    assert!(scenario.check(&six).is_ok());
    let four = six.with_arm(ArmProfile::Hsr065.arm());
    let error = scenario.check(&four).unwrap_err();
    assert_eq!(error.to_string(), "controller: `axes` is for an arm of six joints; this arm has four");
    let mut sim = Controller::new(four);
    sim.play(scenario);
    assert_eq!(sim.config().extended_axes, 0);
}

#[test]
fn a_controller_begins_in_safe_torque_off() {
    let start = scenario("[controller]\ntorque_off = true");
    for profile in Profile::ALL {
        let config = Config::new(profile);
        let functions = config.model.functions;
        assert_eq!(start.check(&config).is_ok(), functions.safe_torque_off, "{profile:?}");
        let mut world = World::with(config);
        world.sim.play(start.clone());
        let client = world.client(1);
        if !functions.safe_torque_off {
            assert_eq!(world.robot(client, "Motor", 1), code(HResult::S_OK), "{profile:?} ignores it");
            continue;
        }
        assert_eq!(world.execute(client, "StoState", ()), ok(&true), "{profile:?}");
        let refused = if functions.preparation { HResult::E_MOTION_UNPREPARED } else { HResult::E_ACCESSDENIED };
        assert_eq!(world.robot(client, "Motor", 1), code(refused), "{profile:?}");
        world.clear(client);
        if functions.preparation {
            assert_eq!(world.robot(client, "ManualResetPreparation", ()), ok(&()));
            assert_eq!(world.robot(client, "MotionPreparation", ()), ok(&()));
        } else {
            assert_eq!(world.execute(client, "ManualReset", ()), ok(&()));
        }
        assert_eq!(world.execute(client, "StoState", ()), ok(&false), "{profile:?}");
        assert_eq!(world.robot(client, "Motor", 1), ok(&()), "{profile:?}");
    }
}

#[test]
fn parameter_153_sets_the_limits_of_slave_mode() {
    let limits = |setting: u8| {
        let (mut world, client) = begun(&format!("slave_speed_setting = {setting}"));
        assert_eq!(world.robot(client, "ExtSpeed", 50), ok(&()));
        let limits = world.sim.slave_limits();
        (limits.speed[0], limits.acceleration[0])
    };
    let [(servo, servo_acceleration), by_ext_speed, (command, command_acceleration), command_by_ext_speed] =
        [0, 1, 2, 3].map(limits);
    assert_eq!((servo, servo_acceleration), (1.2 * command, 4.0 * command_acceleration));
    assert_eq!(by_ext_speed, (servo * 0.5, servo_acceleration * 0.25));
    assert_eq!(command_by_ext_speed, (command * 0.5, command_acceleration * 0.25));
}
