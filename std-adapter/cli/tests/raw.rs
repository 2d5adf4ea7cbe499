//! `bcap raw`: packets as they are written, and their replies.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpListener;
use std::process::Stdio;
use std::thread;

use crate::common::virtual_robot::Virtual;
use crate::common::{Run, bcap, bcap_with, command};
use bcap_tests::process::{Signal, send};

const START: &str = r#"{"name":"ServiceStart","args":[{"vt":8,"v":""}]}"#;
const STOP: &str = "01 10 00 00 00 02 00 00 00 02 00 00 00 00 00 04";

#[test]
fn all_replies_are_shown_with_their_bytes() {
    let robot = Virtual::start(&[]);
    for address in [&robot.tcp, &robot.udp] {
        let run = bcap(&["raw", START, STOP, "--robot", address]);
        let out = "-> 01 1e 00 00 00 01 00 00 00 01 00 00 00 01 00     #1 Service_Start, 30 bytes\n   \
                   0a 00 00 00 08 00 01 00 00 00 00 00 00 00 04     option: \"\"\n\
                   <- 01 10 00 00 00 01 00 00 00 00 00 00 00 00 00 04  #1 0x00000000 (S_OK), 16 bytes\n\
                   -> 01 10 00 00 00 02 00 00 00 02 00 00 00 00 00 04  #2 Service_Stop, 16 bytes\n\
                   <- 01 10 00 00 00 02 00 00 00 00 00 00 00 00 00 04  #2 0x00000000 (S_OK), 16 bytes\n";
        assert_eq!((run.out.as_str(), run.err.as_str(), run.code), (out, "", 0), "{address}");
    }
}

#[test]
fn several_packets_are_sent_in_rounds() {
    let robot = Virtual::start(&[]);
    let both = format!("{START}\n{STOP}{STOP}\n");
    let robot = ["--robot", robot.tcp.as_str()];
    let run = bcap_with(&[&["raw", "-", "--loop", "3", "--json"], &robot[..]].concat(), both.as_bytes());
    assert_eq!((run.out.lines().count(), run.code), (3 * 3 * 2, 0), "{run:?}");
    let run = bcap(&[&["raw", START, STOP, "--loop", "2", "--last"], &robot[..]].concat());
    assert_eq!((run.out.matches("Service_Start").count(), run.out.matches("Service_Stop").count()), (0, 2), "{run:?}");
}

#[test]
fn a_packet_without_a_reply_is_an_error() {
    let robot = Virtual::start(&[]);
    let run = bcap(&["raw", "00ff", "--robot", &robot.udp, "--timeout", "100"]);
    assert!(run.code == 4 && run.err.contains("no reply to packet 1 within 100 ms"), "{run:?}");
    assert!(run.out.contains("-> 00 ff\n   not a frame"), "{run:?}");
    let run = bcap(&["raw", "01g", "--robot", &robot.tcp]);
    assert!(run.code == 2 && run.err.contains("is not a hexadecimal digit"), "{run:?}");
    assert_eq!(bcap_with(&["raw"], b"\n").code, 2);
}

#[test]
fn keep_alives_without_end_are_limited_by_the_timeout() {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = format!("tcp:{}", listener.local_addr().unwrap());
    let robot = thread::spawn(move || {
        let (mut stream, _) = listener.accept().unwrap();
        stream.read_exact(&mut [0; 16]).unwrap();
        let executing = [1, 16, 0, 0, 0, 2, 0, 0, 0, 0, 9, 0, 0, 0, 0, 4];
        while stream.write_all(&executing).is_ok() {}
    });
    let run = bcap(&["raw", STOP, "--robot", &address, "--timeout", "1000", "--last", "--json"]);
    robot.join().unwrap();
    assert!(run.code == 4 && run.err.contains("no reply to packet 1 within 1000 ms, only keep-alives"), "{}", run.err);
    assert!(run.out.contains("S_EXECUTING"), "{run:?}");
}

#[test]
fn a_listening_end_answers_each_request() {
    for protocol in ["tcp", "udp"] {
        let mut child =
            command(&["raw", "--listen", &format!("{protocol}:127.0.0.1:0"), r#"{"serial":2,"code":1}"#, "--json"])
                .stdout(Stdio::piped())
                .spawn()
                .unwrap();
        let mut out = BufReader::new(child.stdout.take().unwrap());
        let mut line = String::new();
        out.read_line(&mut line).unwrap();
        let address = line.trim_end().strip_prefix("ready ").unwrap();
        let run = bcap(&["raw", STOP, "--robot", address, "--json"]);
        let reply = r#"{"serial":2,"reserved":0,"code":1,"name":"S_FALSE","args":[]}"#;
        assert_eq!((run.out.lines().last(), run.code), (Some(reply), 0), "{run:?}");
        let mut rest = String::new();
        out.read_to_string(&mut rest).unwrap();
        assert_eq!(rest.lines().count(), 2, "{rest}");
        assert!(child.wait().unwrap().success());
    }
}

#[test]
fn ctrl_c_ends_the_loop_and_the_wait_for_a_client() {
    let robot = Virtual::start(&[]);
    let endless = "18446744073709551615";
    for args in
        [&["raw", START, "--loop", endless, "--robot", &robot.tcp][..], &["raw", "--listen", "tcp:127.0.0.1:0", STOP]]
    {
        let mut child = command(args).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
        let mut out = BufReader::new(child.stdout.take().unwrap());
        out.read_line(&mut String::new()).unwrap();
        send(Signal::INT, &child);
        std::io::copy(&mut out, &mut std::io::sink()).unwrap();
        let run: Run = child.wait_with_output().unwrap().into();
        assert!(run.code == 130 && run.err.contains("interrupted"), "{run:?}");
    }
}

/// The Tester's user connects, sends, reads the handle, and sends the next packet with it.
#[test]
fn a_packet_has_the_handle_of_an_earlier_reply() {
    let robot = Virtual::start(&[]);
    assert_eq!(robot.run(&["put", "I1", "42"]).code, 0);
    let mut child = command(&["raw", "--json", "--robot", &robot.tcp])
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let (mut input, mut out) = (child.stdin.take().unwrap(), BufReader::new(child.stdout.take().unwrap()));
    // the bytes of a Variable_GetValue without its handle
    let get = "01 1e 00 00 00 04 00 00 00 65 00 00 00 01 00 0a 00 00 00 03 00 01 00 00 00 $3 04";
    for (line, reply) in [
        (START, r#""name":"S_OK","args":[]"#),
        (
            r#"{"serial":2,"name":"ControllerConnect","args":[{"vt":8,"v":""},{"vt":8,"v":"CaoProv.DENSO.VRC"},{"vt":8,"v":""},{"vt":8,"v":""}]}"#,
            r#""name":"S_OK","args":[{"vt":3,"#,
        ),
        (
            r#"{"serial":3,"name":"ControllerGetVariable","args":[{"vt":3,"v":$2},{"vt":8,"v":"I1"},{"vt":8,"v":""}]}"#,
            r#""name":"S_OK","args":[{"vt":3,"#,
        ),
        (get, r#""name":"S_OK","args":[{"vt":3,"v":42}]"#),
    ] {
        writeln!(input, "{line}").unwrap();
        // each reply arrives before the next line is written
        let [mut request, mut answer] = [String::new(), String::new()];
        out.read_line(&mut request).unwrap();
        out.read_line(&mut answer).unwrap();
        assert!(answer.contains(reply), "{line}: {answer}");
    }
    writeln!(input, r#"{{"serial":5,"name":"VariableGetValue","args":[{{"vt":3,"v":$1}}]}}"#).unwrap();
    drop(input);
    let run: Run = child.wait_with_output().unwrap().into();
    assert!(run.code == 2 && run.err.contains("$1: reply 1 has no value"), "{run:?}");
    let run = bcap(&["raw", START, r#"{"name":"ServiceStop","x":$9}"#, "--robot", &robot.tcp]);
    assert!(run.code == 2 && run.out.is_empty(), "{run:?}");
}
