//! The commands that talk to a controller: their calls, their output, and their failures.

use std::io::Read;
use std::net::{TcpListener, UdpSocket};
use std::thread;

use crate::common;
use crate::common::bcap;
use crate::common::fake::{Fake, usual, value};
use bcap_core::bcap::{Frame, FunctionId};
use bcap_core::hresult::HResult;

#[test]
fn get_runs_a_complete_session_over_both_links() {
    let answer = |request: &Frame<'_>| match request.function() {
        FunctionId::VARIABLE_GET_VALUE => value(42),
        _ => usual(request),
    };
    for fake in [Fake::tcp(answer), Fake::udp(answer)] {
        let run = bcap(&["get", "I1", "--robot", &fake.address]);
        assert_eq!((run.out.as_str(), run.err.as_str(), run.code), ("I1 = 42\n", "", 0));
        assert_eq!(
            fake.seen(),
            [
                r#"ServiceStart("WDT=400")"#,
                r#"ControllerConnect("", "CaoProv.DENSO.VRC", "localhost", "")"#,
                r#"ControllerGetVariable(I4(1), "I1", "")"#,
                "VariableGetValue(I4(2))",
                "VariableRelease(I4(2))",
                "ControllerDisconnect(I4(1))",
                "ServiceStop()",
            ]
        );
    }
}

#[test]
fn values_are_printed_as_json() {
    let fake = Fake::tcp(|request| match request.function() {
        FunctionId::VARIABLE_GET_VALUE => value([1.5_f32, -0.0]),
        _ => usual(request),
    });
    let run = bcap(&["--json", "--robot", &fake.address, "get", "V\"1"]);
    assert_eq!((run.out.as_str(), run.code), ("{\"name\":\"V\\\"1\",\"vt\":8196,\"v\":[1.5,-0.0]}\n", 0));
}

#[test]
fn put_gives_the_value_the_type_of_the_variable() {
    let fake = Fake::tcp(|request| match request.function() {
        FunctionId::VARIABLE_GET_VALUE => value([0.0_f32; 3]),
        _ => usual(request),
    });
    let run = bcap(&["put", "V1", "-1,2,3", "--robot", &fake.address]);
    assert_eq!((run.out.as_str(), run.code), ("V1 = -1,2,3\n", 0), "{run:?}");
    assert!(fake.seen().contains(&"VariablePutValue(I4(2), R4[-1.0, 2.0, 3.0])".to_owned()), "{:?}", fake.seen());
    let run = bcap(&["put", "V1", "1,2,x", "--robot", &fake.address]);
    assert_eq!((run.out.as_str(), run.code), ("", 2));
    assert!(run.err.contains("column 5; the variable holds 3 of VT_R4"), "{}", run.err);
}

#[test]
fn a_write_only_variable_needs_a_type() {
    let fake = Fake::tcp(|request| match request.function() {
        FunctionId::VARIABLE_GET_VALUE => HResult::E_ACCESSDENIED.into(),
        _ => usual(request),
    });
    assert_eq!(bcap(&["put", "@START", "--typed", "3,1", "--robot", &fake.address]).code, 0);
    assert!(fake.seen().contains(&"VariablePutValue(I4(2), I4(1))".to_owned()), "{:?}", fake.seen());
    // without its type, 3,1 could be a decimal comma
    for value in ["1", "3,1"] {
        assert_eq!(bcap(&["put", "@START", value, "--robot", &fake.address]).code, 1);
    }
    assert_eq!(fake.seen().iter().filter(|call| call.starts_with("VariablePutValue")).count(), 1);
}

#[test]
fn a_refusal_has_its_code_and_a_hint() {
    let fake = Fake::tcp(|request| match request.function() {
        FunctionId::CONTROLLER_GET_VARIABLE => HResult::E_NOT_CONNECTED.into(),
        _ => usual(request),
    });
    let run = bcap(&["get", "I1", "--robot", &fake.address]);
    assert_eq!((run.out.as_str(), run.code), ("", 1));
    assert!(run.err.contains("I1: Controller_GetVariable"), "{}", run.err);
    assert!(run.err.contains("0x80000902 (E_NOT_CONNECTED)"), "{}", run.err);
    assert!(
        run.err.contains("hint: ") && run.err.contains(&HResult::E_NOT_CONNECTED.hint().unwrap().to_string()),
        "{}",
        run.err
    );
    // the session is ended after a refusal too
    assert_eq!(fake.seen().last().unwrap(), "ServiceStop()");
}

#[test]
fn get_continues_after_a_refused_name() {
    let fake = Fake::tcp(|request| match request.function() {
        FunctionId::CONTROLLER_GET_VARIABLE if request.args.get(1).is_some_and(|n| n.as_bstr().unwrap() == "I2") => {
            HResult::E_CAO_OBJECT_NOTFOUND.into()
        }
        FunctionId::VARIABLE_GET_VALUE => value(7),
        _ => usual(request),
    });
    let run = bcap(&["get", "I1", "I2", "I3", "--robot", &fake.address]);
    assert_eq!((run.out.as_str(), run.code), ("I1 = 7\nI3 = 7\n", 1));
    assert!(run.err.contains("I2: ") && run.err.contains("1 of 3 were refused"), "{}", run.err);
}

#[test]
fn failures_are_printed_as_json() {
    let fake = Fake::tcp(|request| match request.function() {
        FunctionId::CONTROLLER_GET_VARIABLE => HResult::E_CAO_OBJECT_NOTFOUND.into(),
        _ => usual(request),
    });
    let line = |run: &common::Run| serde_json::from_str::<serde_json::Value>(run.out.lines().next().unwrap()).unwrap();
    let run = bcap(&["get", "I1", "I2", "--json", "--robot", &fake.address]);
    assert_eq!((run.out.lines().count(), run.code), (2, 1));
    let code = HResult::E_CAO_OBJECT_NOTFOUND;
    assert_eq!((&line(&run)["name"], &line(&run)["code"]), (&"I1".into(), &code.0.into()));
    assert_eq!(line(&run)["hresult"], "E_CAO_OBJECT_NOTFOUND");
    assert_eq!(line(&run)["hint"], "check the name against what `bcap names` lists");
    let run = bcap(&["get", "I1", "--json", "--robot", &fake.address]);
    assert_eq!((run.out.lines().count(), run.err.matches("error").count(), run.code), (1, 1, 1), "{run:?}");
    assert_eq!(line(&run)["name"], "I1");
    let run = bcap(&["put", "I1", "1", "--json", "--robot", &fake.address]);
    assert!(line(&run)["error"].as_str().unwrap().contains("E_CAO_OBJECT_NOTFOUND"), "{run:?}");
    let run = bcap(&["get", "I1", "--json", "--robot", "tcp:no-such-host.invalid"]);
    assert!(line(&run)["hint"].is_string() && line(&run).get("code").is_none(), "{run:?}");
}

#[test]
fn call_accepts_names_numbers_objects_and_values() {
    let fake = Fake::tcp(|request| match request.function() {
        FunctionId::ROBOT_SPEED => HResult::S_FALSE.into(),
        FunctionId::CONTROLLER_EXECUTE => value("done"),
        _ => usual(request),
    });
    let robot = ["--robot", &fake.address];
    let call = |args: &[&str]| bcap(&[&["call"], args, &robot[..]].concat());
    let run = call(&["Controller_Execute", "controller", "SysState", "0,"]);
    assert_eq!((run.out.as_str(), run.code), ("done\n", 0), "{run:?}");
    let run = call(&["74", "robot:Arm0", "-1", "4,12.5", "--json"]);
    assert_eq!((run.out.as_str(), run.code), ("{\"code\":1,\"name\":\"S_FALSE\",\"value\":null}\n", 0), "{run:?}");
    let seen = fake.seen();
    for expected in [
        r#"ControllerExecute(I4(1), "SysState", EMPTY)"#,
        r#"ControllerGetRobot(I4(1), "Arm0", "")"#,
        "RobotSpeed(I4(3), I4(-1), R4(12.5))",
        "RobotRelease(I4(3))",
    ] {
        assert!(seen.contains(&expected.to_owned()), "{expected}: {seen:?}");
    }
    for (args, word) in [
        (&["NoSuchFunction"][..], "no function NoSuchFunction"),
        (&["138"], "no function 138"),
        (&["RobotSpeed", "task:Pro1", "1", "1"], "task:Pro1 is not a robot"),
        (&["VariablePutValue", "3,1", "x"], "Variable_PutValue(variable, value)"),
    ] {
        let run = call(args);
        assert!(run.code == 2 && run.err.contains(word), "{run:?}");
    }
}

#[test]
fn service_start_and_stop_are_called_once() {
    let fake = Fake::tcp(usual);
    assert_eq!(bcap(&["call", "ServiceStart", "WDT=100", "--robot", &fake.address]).code, 0);
    assert_eq!(fake.seen(), [r#"ServiceStart("WDT=100")"#, "ServiceStop()"]);
    assert_eq!(bcap(&["call", "ServiceStop", "--robot", &fake.address]).code, 0);
    assert_eq!(fake.seen()[2..], [r#"ServiceStart("WDT=400")"#, "ServiceStop()"]);
    let run = bcap(&["call", "3", "x", "CaoProv.DENSO.VRC9", "localhost", "", "--robot", &fake.address]);
    assert_eq!((run.out.as_str(), run.code), ("1\n", 0));
    assert_eq!(fake.seen()[6..], ["ControllerDisconnect(I4(1))", "ServiceStop()"]);
}

#[test]
fn exec_sends_a_command_with_its_parameter() {
    let fake = Fake::tcp(|request| match request.function() {
        FunctionId::ROBOT_EXECUTE => HResult::E_ROBOTISBUSY.into(),
        FunctionId::CONTROLLER_GET_ROBOT if format!("{:?}", request.args.get(1)).contains("Arm0") => {
            HResult::E_CAO_OBJECT_NOTFOUND.into()
        }
        FunctionId::CONTROLLER_GET_ROBOT_NAMES => value(["Left", "Right"]),
        _ => usual(request),
    });
    let run = bcap(&["exec", "robot", "TakeArm", "8195,0,0", "--robot", &fake.address]);
    assert_eq!(run.code, 1);
    assert!(run.err.contains("robot: TakeArm: the controller refused with 0x80010004 (E_ROBOTISBUSY)"), "{}", run.err);
    for (argument, sent) in [("-5", "I4(-5)"), ("2.5", "R8(2.5)"), ("text", "\"text\""), ("8,5", "\"5\"")] {
        assert_eq!(bcap(&["exec", "controller", "X", argument, "--robot", &fake.address]).code, 0);
        let expected = format!("ControllerExecute(I4(1), \"X\", {sent})");
        assert!(fake.seen().contains(&expected), "{:?}", fake.seen());
    }
    assert!(fake.seen().contains(&r#"ControllerGetRobot(I4(1), "Left", "")"#.to_owned()), "{:?}", fake.seen());
}

#[test]
fn watch_prints_changes() {
    let count = std::sync::atomic::AtomicI32::new(0);
    let fake = Fake::tcp(move |request| match request.function() {
        FunctionId::VARIABLE_GET_VALUE => value(count.fetch_add(1, std::sync::atomic::Ordering::Relaxed) / 2),
        _ => usual(request),
    });
    let run = bcap(&["watch", "I1", "--interval", "1", "--count", "6", "--changed", "--robot", &fake.address]);
    let values: Vec<&str> = run.out.lines().filter_map(|line| line.split_once(" I1 = ")).map(|(_, v)| v).collect();
    assert_eq!((values, run.code), (vec!["0", "1", "2"], 0), "{}", run.out);
    let run = bcap(&["watch", "I1", "--interval", "1", "--count", "2", "--json", "--robot", &fake.address]);
    assert_eq!(run.out.lines().count(), 2);
    for line in run.out.lines() {
        let line: serde_json::Value = serde_json::from_str(line).unwrap();
        assert!(line["ms"].is_u64() && line["name"] == "I1" && line["vt"] == 3 && line["v"] == 3, "{line}");
    }
}

#[test]
fn names_are_listed_in_the_form_of_the_other_commands() {
    let fake = Fake::tcp(|request| match request.function() {
        FunctionId::CONTROLLER_GET_VARIABLE_NAMES => value(["I*", "@MODE"]),
        FunctionId::CONTROLLER_GET_ROBOT_NAMES => value(("Arm0",)),
        FunctionId::ROBOT_GET_VARIABLE_NAMES => value(["@SERVO_ON"]),
        FunctionId::CONTROLLER_GET_TASK_NAMES => HResult::E_NOTIMPL.into(),
        _ => usual(request),
    });
    let run = bcap(&["names", "--robot", &fake.address]);
    assert_eq!((run.out.as_str(), run.code), ("I*\n@MODE\nrobot:Arm0\nrobot:Arm0/@SERVO_ON\n", 0), "{run:?}");
    let run = bcap(&["names", "--json", "--robot", &fake.address]);
    assert_eq!(run.out.lines().nth(3).unwrap(), r#"{"kind":"variable","name":"robot:Arm0/@SERVO_ON"}"#);
}

#[test]
fn an_unreachable_controller_exits_with_3() {
    // another test could take a free port
    let closed = "127.0.0.1:1";
    let run = bcap(&["get", "I1", "--robot", &format!("tcp:{closed}")]);
    assert_eq!((run.out.as_str(), run.code), ("", 3));
    assert!(run.err.contains(closed) && run.err.contains("hint: no server listens there"), "{}", run.err);
    let run = bcap(&["get", "I1", "--robot", "tcp:no-such-host.invalid"]);
    assert!(run.code == 3 && run.err.contains("no-such-host.invalid"), "{run:?}");
}

#[test]
fn a_closed_connection_exits_with_3() {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = format!("tcp:{}", listener.local_addr().unwrap());
    thread::spawn(move || {
        let (mut stream, _) = listener.accept().unwrap();
        stream.read_exact(&mut [0; 16]).unwrap();
    });
    let run = bcap(&["get", "I1", "--robot", &address]);
    assert!(run.code == 3 && run.err.contains("hint: "), "{run:?}");
}

#[test]
fn a_peer_that_is_not_a_controller_exits_with_3() {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = format!("tcp:{}", listener.local_addr().unwrap());
    thread::spawn(move || {
        let (mut stream, _) = listener.accept().unwrap();
        std::io::Write::write_all(&mut stream, b"HTTP/1.1 400 Bad Request\r\n\r\n").unwrap();
        let _ = stream.read_to_end(&mut Vec::new());
    });
    let run = bcap(&["get", "I1", "--robot", &address]);
    assert!(run.code == 3 && run.err.contains("a frame starts with 0x01"), "{run:?}");
}

#[test]
fn a_timeout_exits_with_4() {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
    let tcp = format!("tcp:{}", listener.local_addr().unwrap());
    let udp = format!("udp:{}", socket.local_addr().unwrap());
    for address in [tcp, udp] {
        let run = bcap(&["get", "I1", "--timeout", "2000", "--robot", &address]);
        assert_eq!((run.out.as_str(), run.code), ("", 4), "{run:?}");
        assert!(
            run.err.contains("did not answer Service_Start within the command's time limit of 2000 ms"),
            "{}",
            run.err
        );
        assert!(run.err.contains("hint: "), "{}", run.err);
    }
}

#[test]
fn a_name_with_ipv4_and_ipv6_addresses_is_reached() {
    for fake in [Fake::tcp(usual), Fake::udp(usual)] {
        let address = fake.address.replace("127.0.0.1", "localhost");
        assert_eq!(bcap(&["call", "ServiceStop", "--robot", &address]).code, 0, "{address}");
    }
}

#[test]
fn the_environment_names_the_robot() {
    let fake = Fake::tcp(usual);
    let output = common::command(&["call", "ServiceStop"]).env("BCAP_ROBOT", &fake.address).output().unwrap();
    assert_eq!((output.status.code(), fake.seen().len()), (Some(0), 2));
    for address in ["http://192.168.0.1", "tcp:", "tcp:fe80::1", "tcp:a:0"] {
        assert_eq!(bcap(&["get", "I1", "--robot", address]).code, 2);
    }
}
