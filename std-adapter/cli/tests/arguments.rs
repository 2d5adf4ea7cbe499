//! Arguments that could mean two things are refused with a suggestion; plain ones are accepted, and printed as plainly.

use crate::common;
use crate::common::bcap;
use crate::common::fake::{Fake, usual, value};
use bcap_core::bcap::FunctionId;
use bcap_core::variant::{Encode, OwnedVariant};

/// A controller whose variables all hold `current`.
fn holding(current: &impl Encode) -> Fake {
    let current = OwnedVariant::new(current).unwrap();
    Fake::tcp(move |request| match request.function() {
        FunctionId::VARIABLE_GET_VALUE | FunctionId::ROBOT_EXECUTE => value(current.clone()),
        _ => usual(request),
    })
}

/// Runs `put`; returns the output, the written value and the exit code.
#[track_caller]
fn put(fake: &Fake, words: &[&str]) -> (String, Option<String>, i32) {
    let before = fake.seen().len();
    let run = bcap(&[&["put", "X1"], words, &["--robot", &fake.address]].concat());
    let written = fake.seen()[before..].iter().find_map(|call| {
        let value = call.strip_prefix("VariablePutValue(I4(2), ")?;
        Some(value.strip_suffix(')').unwrap().to_owned())
    });
    (run.out + &run.err, written, run.code)
}

#[track_caller]
fn refused(fake: &Fake, text: &str, parts: &[&str]) {
    let (shown, written, code) = put(fake, &[text]);
    assert_eq!((written, code), (None, 2), "{text}: {shown}");
    for part in parts {
        assert!(shown.contains(part), "{text}: {shown}");
    }
}

#[test]
fn a_decimal_comma_is_refused_and_nothing_is_written() {
    let typed = "TYPE,DATA needs --typed";
    let float = holding(&1.0_f32);
    refused(&float, "3,5", &["3,5: ", "VT_R4", "did you mean 3.5? TYPE,DATA needs --typed"]);
    refused(&float, "4,5", &["did you mean 4.5?", typed]);
    let double = holding(&1.0_f64);
    refused(&double, "3,14", &["did you mean 3.14?", typed]);
    refused(&double, "5,25", &["did you mean 5.25?", typed]);
    refused(&double, "-3,14", &["did you mean -3.14?"]);
    refused(&double, "1,234.5", &["VT_R8"]);
    let integer = holding(&1_i32);
    refused(&integer, "2,7", &["2,7: ", "VT_I4", typed]);
    refused(&integer, "3,5", &[typed]);
    refused(&integer, "3,500", &["did you mean 3500?", typed]);
    let door = holding(&true);
    refused(&door, "11,-1", &["VT_BOOL", typed]);
    let text = holding(&"x");
    refused(&text, "8,5", &["VT_BSTR", "write --typed 8,5 or --typed 8,8,5"]);
    assert_eq!(put(&text, &["3,5"]), ("X1 = 3,5\n".into(), Some("\"3,5\"".into()), 0));
}

#[test]
fn typed_values_are_written_with_their_type() {
    for (current, text, written) in [
        (OwnedVariant::new(&1_i32).unwrap(), "3,5", "I4(5)"),
        (OwnedVariant::new(&1_i32).unwrap(), "5,2.5", "R8(2.5)"),
        (OwnedVariant::new(&1.0_f32).unwrap(), "4,5", "R4(5.0)"),
        (OwnedVariant::new("x").unwrap(), "8,8,5", "\"8,5\""),
        (OwnedVariant::new(&[0.0_f32; 3]).unwrap(), "8197,1,2,3", "R8[1.0, 2.0, 3.0]"),
        (OwnedVariant::new(&[0.0_f32; 3]).unwrap(), "8196,1,2", "R4[1.0, 2.0]"),
    ] {
        let fake = holding(&current);
        for words in [&["--typed", text][..], &[text, "--typed"]] {
            let (shown, found, code) = put(&fake, words);
            assert_eq!((found.as_deref(), code), (Some(written), 0), "{text}: {shown}");
        }
    }
    let fake = holding(&1_i32);
    let (shown, written, code) = put(&fake, &["--typed", "5"]);
    assert_eq!((written, code), (None, 2), "{shown}");
    assert!(shown.contains("comma is missing"), "{shown}");
}

#[test]
fn an_array_has_the_length_of_the_variable() {
    let vector = holding(&[0.0_f32; 3]);
    for text in ["1,2,3", "8196,1,2,3"] {
        let written = Some("R4[1.0, 2.0, 3.0]".to_owned());
        assert_eq!(put(&vector, &[text]), ("X1 = 1,2,3\n".into(), written, 0), "{text}");
    }
    let holds = "the variable holds 3 of VT_R4";
    refused(&vector, "1,5,2,0,3,5", &["6 values", holds]);
    refused(&vector, "3,7", &["3,7: ", holds]);
    refused(&vector, "8197,1,2,3", &[holds, "TYPE,DATA needs --typed"]);
    refused(&vector, "8196,1,2,3,4", &[holds]);
    refused(&vector, "1 2 3", &["did you mean 1,2,3?", holds]);
    refused(&vector, "1;2; 3", &["did you mean 1,2,3?"]);
    let switches = holding(&[false; 2]);
    assert_eq!(put(&switches, &["true,off"]), ("X1 = true,false\n".into(), Some("BOOL[true, false]".into()), 0));
}

#[test]
fn values_are_printed_plainly() {
    let get = |current: &dyn Encode| {
        let fake = holding(&OwnedVariant::new(current).unwrap());
        let plain = bcap(&["get", "X1", "--robot", &fake.address]).out;
        let json = bcap(&["get", "X1", "--json", "--robot", &fake.address]).out;
        (plain, json)
    };
    assert_eq!(get(&true), ("X1 = true\n".into(), "{\"name\":\"X1\",\"vt\":11,\"v\":-1}\n".into()));
    assert_eq!(get(&false).0, "X1 = false\n");
    assert_eq!(get(&[true, false]).0, "X1 = true,false\n");
    assert_eq!(get(&[400.1_f32, -0.1, 180.0]).0, "X1 = 400.1,-0.1,180\n");
    let (plain, json) = get(&[400.000_000_000_000_06, 0.1 + 0.2, -1e300, 5e-324, 0.0]);
    assert_eq!(plain, "X1 = 400,0.3,-1e300,5e-324,0\n");
    assert!(json.contains("400.00000000000006,0.30000000000000004"), "{json}");
    // a single number is exact, so that it can be written back
    assert_eq!(get(&0.300_000_000_000_000_04).0, "X1 = 0.30000000000000004\n");
    let fake = holding(&[400.000_000_000_000_06, 1.0]);
    assert_eq!(bcap(&["exec", "robot:Arm0", "CurPos", "--robot", &fake.address]).out, "400,1\n");
}

#[test]
fn an_address_needs_no_protocol() {
    let fake = Fake::tcp(usual);
    let host = fake.address.strip_prefix("tcp:").unwrap();
    for address in [host.to_owned(), format!("tcp://{host}"), format!("TCP://{host}/")] {
        let run = bcap(&["call", "ServiceStop", "--robot", &address]);
        assert_eq!(run.code, 0, "{address}: {run:?}");
    }
    let udp = Fake::udp(usual);
    let address = udp.address.replace("udp:", "udp://");
    assert_eq!(bcap(&["call", "ServiceStop", "--robot", &address]).code, 0, "{address}");
    let run = bcap(&["get", "I1", "--robot", "http://192.168.0.1"]);
    assert!(run.code == 2 && run.err.contains("http://192.168.0.1: write tcp:HOST[:PORT]"), "{run:?}");
}

#[test]
fn trailing_options_have_defaults() {
    let fake = Fake::tcp(usual);
    for (args, sent) in [
        (&["TaskStart", "task:Pro1", "1"][..], r#"TaskStart(I4(4), I4(1), "")"#),
        (&["RobotMove", "robot:Arm0", "2", "8,@E P1"], r#"RobotMove(I4(3), I4(2), "@E P1", "")"#),
        (&["RobotHalt", "robot:Arm0"], r#"RobotHalt(I4(3), "")"#),
        (&["RobotExecute", "robot:Arm0", "CurPos"], r#"RobotExecute(I4(3), "CurPos", EMPTY)"#),
        (&["ServiceStart"], r#"ServiceStart("")"#),
        // a missing argument before the last ones is the user's error
        (&["TaskStart", "task:Pro1"], "TaskStart(I4(4))"),
    ] {
        let run = bcap(&[&["call"], args, &["--robot", &fake.address]].concat());
        assert!(fake.seen().contains(&sent.to_owned()), "{sent}: {:?} {run:?}", fake.seen());
    }
}

#[test]
fn an_empty_environment_variable_counts_as_missing() {
    let names = ["TIMEOUT", "PROVIDER", "MACHINE", "OPTION", "ATTEMPTS", "RAC_PORT", "PROFILE"];
    for name in names {
        let run: common::Run =
            common::command(&["decode", "--help"]).env(format!("BCAP_{name}"), "").output().unwrap().into();
        assert_eq!((run.code, run.err.as_str()), (0, ""), "BCAP_{name}");
        let run: common::Run =
            common::bare(&["explain", "S_OK"]).env(format!("BCAP_{name}"), "").output().unwrap().into();
        assert_eq!((run.code, run.err.as_str()), (0, ""), "BCAP_{name}");
    }
    let run: common::Run = common::bare(&["explain", "S_OK"]).env("BCAP_TIMEOUT", "x").output().unwrap().into();
    assert!(run.code == 2 && run.err.contains("--timeout"), "{run:?}");
}

#[test]
fn a_refused_call_without_all_arguments_says_so() {
    let robot = crate::common::virtual_robot::Virtual::start(&[]);
    let run = robot.run(&["call", "RobotMove", "robot"]);
    assert_eq!(run.code, 1, "{run:?}");
    assert!(run.err.contains("hint: arguments are missing: interpolation, pose, option"), "{}", run.err);
    // with all arguments it is the arm
    let run = robot.run(&["call", "RobotMove", "robot", "1", "8,@P P1"]);
    assert!(run.err.contains("this session has not taken the arm"), "{}", run.err);
}
