//! Attacks on the command that succeeded against an earlier version: a flood of lines and idle connections at the gateway,
//! a flood of keep-alives from its robot, names and values that act on a terminal.
//!
//! Attacks on servers and clients without the command are in `tests/tests/hostile/attacks.rs`.

use std::fs;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream};

use std::thread;
use std::time::{Duration, Instant};

use crate::common::bcap;
use crate::common::running::Running;
use bcap_core::bcap::{Decoder, FrameWriter, FunctionId, Progress};
use bcap_core::hresult::HResult;
use bcap_tests::process::Process;
use socket2::{Domain, Socket, Type};

/// A connection from another address of the loopback.
fn connect_from(source: [u8; 4], server: SocketAddr) -> TcpStream {
    let socket = Socket::new(Domain::IPV4, Type::STREAM, None).unwrap();
    socket.bind(&SocketAddr::from((source, 0)).into()).unwrap();
    socket.connect(&server.into()).unwrap();
    socket.into()
}

/// Sends a line and reads its response; empty when the connection was closed.
fn ask(stream: &TcpStream, line: &str) -> String {
    stream.set_read_timeout(Some(Duration::from_secs(30))).unwrap();
    let (mut writer, mut response) = (stream, Vec::new());
    _ = writer.write_all(line.as_bytes());
    _ = BufReader::new(stream).read_until(b'\r', &mut response);
    String::from_utf8(response).unwrap()
}

fn folder(name: &str) -> std::path::PathBuf {
    let folder = std::env::temp_dir().join(format!("bcap-{name}-{}", std::process::id()));
    fs::create_dir_all(&folder).unwrap();
    folder
}

/// Sends 200,000 invalid lines of two bytes; the log and its rotated files stay small.
#[test]
fn a_flood_of_wrong_lines_does_not_fill_the_audit_log() {
    let folder = folder("flood");
    let log = folder.join("audit.jsonl");
    let sim = Running::quiet_sim(&[]);
    let gateway = Running::gateway_to(&format!("tcp:{}", sim.bcap), &["--audit", log.to_str().unwrap()]);
    let plc = TcpStream::connect(&gateway.rac).unwrap();
    thread::scope(|scope| {
        let mut reader = &plc;
        scope.spawn(move || std::io::copy(&mut reader, &mut std::io::sink()));
        let mut writer = &plc;
        for _ in 0..200 {
            // the gateway may close the connection of such a client
            if writer.write_all(&b"x\r".repeat(1000)).is_err() {
                break;
            }
        }
        _ = plc.shutdown(std::net::Shutdown::Write);
    });
    // the gateway still answers
    ask(&TcpStream::connect(&gateway.rac).unwrap(), "GET:RC8:1:I:\r");
    drop(gateway);
    let written: u64 = fs::read_dir(&folder).unwrap().map(|file| file.unwrap().metadata().unwrap().len()).sum();
    fs::remove_dir_all(folder).unwrap();
    assert!(written < 1 << 20, "{written} bytes of log for 200,000 wrong lines");
}

/// Idle connections of one address; a client of another address gets a slot.
#[test]
fn idle_connections_of_one_address_leave_slots_at_the_gateway() {
    let sim = Running::quiet_sim(&[]);
    let gateway = Running::gateway_to(&format!("tcp:{}", sim.bcap), &["--audit", "/dev/null"]);
    let rac: SocketAddr = gateway.rac.parse().unwrap();
    let idle: Vec<_> = (0..80).map(|_| connect_from([127, 0, 0, 2], rac)).collect();
    // the gateway accepts in order, so it has accepted all of them when it answers this
    let response = ask(&connect_from([127, 0, 0, 3], rac), "GET:RC8:1:I:\r");
    drop(idle);
    // the robot may not be connected yet; a client without a slot gets E_MAX_CONNECT or no response
    assert!(!response.is_empty() && response != "-2147481333\r", "{response:?}");
}

/// A robot that answers the first calls, then sends only S_EXECUTING, as fast as it can.
#[test]
fn a_flood_of_keep_alives_costs_the_gateway_little() {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let robot = listener.local_addr().unwrap();
    thread::spawn(move || {
        for stream in listener.incoming() {
            thread::spawn(move || flood(stream.unwrap()));
        }
    });
    let gateway = Running::gateway(&format!("tcp:{robot}"), &[]);
    // the flood begins with the gateway's first call
    let plc = TcpStream::connect(&gateway.rac).unwrap();
    (&plc).write_all(b"GET:RC8:1:I:\r").unwrap();
    let process = Process::new(gateway.child.id());
    let (began, before) = (Instant::now(), process.processor_time().unwrap());
    // measure for a fixed time, which is longer on a busy machine
    thread::sleep(Duration::from_secs(3));
    let used = process.processor_time().unwrap() - before;
    let took = began.elapsed();
    assert!(used < took / 10, "{used:?} of processor time in {took:?}");
}

fn flood(mut stream: TcpStream) {
    let (mut bytes, mut part) = (Vec::new(), [0; 4096]);
    while let Ok(count @ 1..) = stream.read(&mut part) {
        bytes.extend_from_slice(&part[..count]);
        while let Progress::Complete(frame, used) = Decoder::TCP.decode(&bytes).unwrap() {
            let mut buffer = [0; 64];
            let mut writer = FrameWriter::new(&mut buffer).unwrap();
            let mut code = HResult::S_OK;
            match frame.function() {
                FunctionId::SERVICE_START => {}
                FunctionId::CONTROLLER_CONNECT => writer.argument(&1).unwrap(),
                _ => code = HResult::S_EXECUTING,
            }
            let reply = writer.finish(frame.serial, 0, code.0).unwrap().to_vec();
            let times = if code == HResult::S_EXECUTING { usize::MAX } else { 1 };
            let packet = if times == 1 { reply } else { reply.repeat(1000) };
            for _ in 0..times {
                if stream.write_all(&packet).is_err() {
                    return;
                }
            }
            bytes.drain(..used);
        }
    }
}

/// Names of files and values of variables with CSI, a bidirectional override and a line separator.
#[test]
fn names_and_values_of_a_controller_do_not_act_on_the_terminal() {
    let hostile = "a\u{9b}31mb\u{202e}c\u{2028}d\u{85}e";
    let folder = folder("names");
    fs::write(folder.join(format!("{hostile}.txt")), "x").unwrap();
    let sim = Running::quiet_sim(&["--files", folder.to_str().unwrap()]);
    let robot = format!("tcp:{}", sim.bcap);
    let robot = ["--robot", robot.as_str()];
    let put = bcap(&[&["put", "S1", hostile], &robot[..]].concat());
    assert_eq!(put.code, 0, "{put:?}");
    for args in [&["get", "S1"][..], &["names"], &["get", hostile], &["put", "I1", hostile]] {
        for json in [&[][..], &["--json"]] {
            let run = bcap(&[args, &robot[..], json].concat());
            let text = run.out + &run.err;
            let acts = |c: char| (c.is_control() && c != '\n') || "\u{202e}\u{2028}".contains(c);
            assert!(!text.chars().any(acts), "{args:?} {json:?}: {text:?}");
            assert!(text.contains('e'), "{args:?} {json:?}: {text:?}");
        }
    }
    fs::remove_dir_all(folder).unwrap();
}
