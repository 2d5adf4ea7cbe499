//! The reasons for refused arguments, in GetErrorDescription and for an observer.

use std::sync::{Arc, Mutex};

use bcap_core::bcap::server::{Config as Server, Session};
use bcap_core::bcap::{Decoder, FrameWriter, FunctionId, call};
use bcap_core::endpoint::{Endpoint, Serve};
use bcap_core::handler::PeerId;
use bcap_core::hresult::HResult;
use bcap_core::time::Instant;
use bcap_core::variant::Encode;
use bcap_sim::codes::WRONG_ARGUMENT;
use bcap_sim::explain::Observer;
use bcap_sim::{Config, Controller};

use crate::common::{Client, World, code, ok};

fn description(world: &mut World, client: Client, code: HResult) -> String {
    let (result, text) = world.execute(client, "GetErrorDescription", code.0);
    assert_eq!(result, HResult::S_OK);
    text.as_variant().as_bstr().unwrap().to_string()
}

#[test]
fn a_refused_argument_is_named_with_what_is_accepted() {
    let mut world = World::new();
    let (client, other) = (world.mover(1), world.client(2));
    let plain = description(&mut world, other, HResult::E_INVALIDARG);
    assert!(plain.starts_with("E_INVALIDARG: ") && !plain.contains("Last refused"), "{plain}");

    assert_eq!(world.robot(client, "takearm", [0, 0, 0]), code(HResult::E_INVALIDARG));
    let expected = "Robot_Execute \"takearm\": given [I4(0), I4(0), I4(0)]; accepted nothing, the group, or [group, keep]: \
                    group 0 to 31, keep 0 or 1";
    // even over another session, because drivers query it there
    assert_eq!(description(&mut world, other, HResult::E_INVALIDARG), format!("{plain} Last refused: {expected}"));

    assert_eq!(world.move_to(client, 1, "J1", "FAST"), WRONG_ARGUMENT);
    let text = description(&mut world, client, WRONG_ARGUMENT);
    world.clear(client);
    assert!(
        text.contains("Robot_Move: given I4(1); \"J1\"; \"FAST\"; accepted interpolation I4: 1 joints, 2 line"),
        "{text}"
    );
    assert!(text.contains("option BSTR: NEXT, SPEED="), "{text}");

    assert_eq!(world.robot(client, "slvChangeMode", 4), code(HResult::E_INVALIDARG));
    let text = description(&mut world, client, HResult::E_INVALIDARG);
    assert!(
        text.ends_with("given I4(4); accepted one number: 0, 0x001 to 0x003, 0x101 to 0x103, 0x201 to 0x203"),
        "{text}"
    );

    // each code has its own
    assert_eq!(world.put(client, "P1", "x"), HResult::E_INVALIDARGTYPE);
    let text = description(&mut world, client, HResult::E_INVALIDARGTYPE);
    let end = "Variable_PutValue: given \"x\"; accepted an array of 7 numbers: X Y Z RX RY RZ Fig; 3 or 6 numbers leave the last ones out";
    assert!(text.ends_with(end), "{text}");
    assert!(description(&mut world, client, HResult::E_INVALIDARG).contains("slvChangeMode"));
    let servo = world.robot_variable(client, "@SERVO_ON");
    let put = call::variable_put_value(servo, "on");
    assert_eq!(world.call(client.peer, put), code(HResult::E_INVALIDARGTYPE));
    let text = description(&mut world, client, HResult::E_INVALIDARGTYPE);
    assert!(text.ends_with("given \"on\"; accepted BOOL, or an integer: 0 is off"), "{text}");
    // a refusal for another reason has no such text
    assert_eq!(world.robot(other, "TakeArm", [0, 0]), code(HResult::E_ARM_NOT_TAKEN));
    assert!(!description(&mut world, client, HResult::E_ARM_NOT_TAKEN).contains("Last refused"));
}

#[test]
fn long_values_are_cut_and_control_characters_escaped() {
    let mut world = World::new();
    let client = world.client(1);
    let long = format!("\u{1b}[31m\u{9b}{}", "x".repeat(10_000));
    let pose = call::robot_move(client.robot, 1, long.as_str(), long.as_str());
    assert_eq!(world.run(client.peer, pose).0, WRONG_ARGUMENT);
    let text = description(&mut world, client, WRONG_ARGUMENT);
    assert!(text.len() < 2000 && !text.contains(char::is_control), "{text}");
    assert!(text.contains(r"\u{1b}[31m\u{9b}xxx"), "{text}");
    assert_eq!(world.robot(client, "TakeArm", vec![1.0_f64; 5000].as_slice()), code(HResult::E_INVALIDARG));
    let text = description(&mut world, client, HResult::E_INVALIDARG);
    assert!(text.contains("given VT_R8 of 5000 elements;"), "{text}");
}

#[test]
fn an_argument_of_the_wrong_type_is_named_though_the_server_refuses_it() {
    let seen: Arc<Mutex<Vec<String>>> = Arc::default();
    let tell = Arc::clone(&seen);
    let observer = Observer::new(move |_, text| tell.lock().unwrap().push(text.to_owned()));
    let mut sim = Controller::new(Config { observer, ..Config::default() });
    let mut session: Session<[u8; 1024]> = Session::new(Server::TCP, [0; 1024], [0; 1024]);
    let mut call = |function: FunctionId, arguments: &[&dyn Encode]| {
        let mut buffer = [0; 512];
        let mut frame = FrameWriter::new(&mut buffer).unwrap();
        arguments.iter().for_each(|argument| frame.argument(*argument).unwrap());
        let request = frame.finish(1, 0, function.0).unwrap();
        session.receive_buffer()[..request.len()].copy_from_slice(request);
        session.received(request.len());
        while session.run(&mut sim, PeerId(1), Instant::ZERO).is_some() {}
        let reply = Decoder::TCP.decode_datagram(session.transmit()).unwrap();
        let text = reply.args.get(0).and_then(|value| Some(value.as_bstr()?.to_string()));
        let (code, len) = (reply.hresult(), session.transmit().len());
        session.transmitted(len);
        (code, text)
    };
    call(FunctionId::SERVICE_START, &[&""]);
    call(FunctionId::CONTROLLER_CONNECT, &[&"", &"CaoProv.DENSO.VRC", &"", &""]);
    call(FunctionId::CONTROLLER_GET_ROBOT, &[&2, &"Arm0", &""]);
    let wrong: [(FunctionId, &[&dyn Encode], HResult, &str); 6] = [
        (
            FunctionId::ROBOT_SPEED,
            &[&3, &"x", &10.0_f32],
            HResult::E_INVALIDARGTYPE,
            "Robot_Speed: axis: given \"x\"; accepted I4, or another integer type whose value fits",
        ),
        (
            FunctionId::ROBOT_HALT,
            &[&3, &1],
            HResult::E_INVALIDARGTYPE,
            "Robot_Halt: option: given I4(1); accepted BSTR, or EMPTY",
        ),
        (
            FunctionId::ROBOT_SPEED,
            &[&3, &-1],
            HResult::E_INVALIDARG,
            "Robot_Speed: given 2 arguments; accepted 3: robot, axis, speed",
        ),
        (
            FunctionId::SERVICE_START,
            &[&"WDT=79"],
            HResult::E_INVALIDARG,
            "Service_Start: given \"WDT=79\": WDT is below the minimum of 80 ms",
        ),
        (
            FunctionId::SERVICE_START,
            &[&"", &""],
            HResult::E_INVALIDARG,
            "Service_Start: given 2 arguments; accepted 1: option",
        ),
        (FunctionId(138), &[&3], HResult::E_INVALIDARG, "function 138: unknown; accepted the functions 1 to 137"),
    ];
    for (function, arguments, expected, text) in wrong {
        assert_eq!(call(function, arguments), (expected, None));
        assert_eq!(seen.lock().unwrap().pop().as_deref(), Some(text));
        let (_, description) = call(FunctionId::CONTROLLER_EXECUTE, &[&2, &"GetErrorDescription", &expected.0]);
        assert!(description.is_some_and(|description| description.ends_with(text)), "{text}");
    }
}

#[test]
fn an_observer_is_told() {
    let seen: Arc<Mutex<Vec<(HResult, String)>>> = Arc::default();
    let tell = Arc::clone(&seen);
    let observer = Observer::new(move |code, text| tell.lock().unwrap().push((code, text.to_owned())));
    let mut world = World::new();
    world.sim = Controller::new(Config { observer, ..Config::default() });
    let client = world.client(1);
    assert_eq!(world.execute(client, "ClearError", ()), ok(&()));
    assert_eq!(world.execute(client, "SysInfo", 7), ok(&0));
    assert_eq!(world.execute(client, "SysInfo", "a"), code(HResult::DISP_E_TYPEMISMATCH));
    let text = "Controller_Execute \"SysInfo\": given \"a\"; accepted one number, 0 to 16";
    assert_eq!(*seen.lock().unwrap(), [(HResult::DISP_E_TYPEMISMATCH, text.to_owned())]);
}
