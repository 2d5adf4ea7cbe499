//! `bcap proxy` and `--write`: recordings, output, and faults.

use std::collections::{HashSet, VecDeque};
use std::io::{ErrorKind, Read, Write};
use std::net::{TcpListener, TcpStream, UdpSocket};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Duration;

use bcap_tests::real_time::repeated;

use crate::common::recorded;
use crate::common::running::Running;
use crate::common::tshark::{has_tshark, tshark};
use crate::common::{Run, bare, bcap};

fn path(name: &str) -> PathBuf {
    Path::new(env!("CARGO_TARGET_TMPDIR")).join(name)
}

/// Runs `bcap decode` on a file.
fn decoded(file: &Path, options: &[&str]) -> String {
    let run = bcap(&[&["decode", file.to_str().unwrap()], options].concat());
    assert_eq!((run.code, run.err.as_str()), (0, ""), "{run:?}");
    run.out
}

/// The lines without times, sorted: the proxy prints a call when its reply arrives.
fn sorted(lines: &str) -> Vec<String> {
    let plain = |line: &str| line.trim_start().split_once(' ').unwrap().1.to_owned();
    let mut lines: Vec<_> = lines.lines().map(plain).collect();
    lines.sort();
    lines
}

#[test]
fn the_file_of_a_proxy_has_the_calls_that_the_server_saw() {
    let (recorded, printed) = recorded::proxied(&[]);
    assert_eq!((printed.code, printed.err.as_str()), (0, ""));
    recorded::assert_as_seen(&recorded);
    assert_eq!(sorted(&printed.out), sorted(&decoded(&recorded.file, &[])), "what is printed is what is recorded");
}

#[test]
fn tcpdump_captures_the_same_calls_as_the_proxy() {
    let folder = tempfile::tempdir().unwrap();
    let Some(files) = recorded::proxied_under_tcpdump(folder.path()) else { return };
    let [mut proxied, mut dumped] = files.each_ref().map(|file| json_calls(file));
    proxied.sort();
    dumped.sort();
    assert!(proxied.len() > 60, "{}", proxied.len());
    assert_eq!(proxied, dumped);
    println!("{} calls in both files", proxied.len());
}

#[test]
fn tshark_links_all_requests_of_the_file_of_a_proxy() {
    if !has_tshark() {
        return;
    }
    let (recorded, _) = recorded::proxied(&["--quiet"]);
    // a packet may have several, with commas between them
    let fields = ["-T", "fields", "-e", "bcap.request", "-e", "rac.request"];
    let requests = tshark(&recorded.file, &[&["-Y", "bcap.request || rac.request"][..], &fields].concat())
        .split([',', '\t', '\n'])
        .filter(|field| !field.is_empty())
        .count();
    assert!(requests >= recorded.seen.len(), "{requests} requests, {} calls", recorded.seen.len());
    for filter in [
        "bcap.malformed || rac.malformed || bcap.cut",
        "bcap.unlinked || rac.unlinked || bcap.again",
        "bcap.request && !bcap.response_in",
        "rac.request && !rac.response_in",
        // the sequence numbers are right: no byte is lost, repeated, or acknowledged before it is sent
        "tcp.analysis.flags",
        "ip.checksum.status == 0 || tcp.checksum.status == 0 || udp.checksum.status == 0",
    ] {
        let check = ["-o", "ip.check_checksum:TRUE", "-o", "tcp.check_checksum:TRUE", "-o", "udp.check_checksum:TRUE"];
        let found = tshark(&recorded.file, &[&["-Y", filter][..], &check].concat());
        assert_eq!(found, "", "{filter}");
    }
    println!("{requests} requests, all linked, none malformed");
}

#[test]
fn client_commands_and_the_virtual_controller_record_the_same_calls() {
    let (server, client) = (path("server.pcapng"), path("client.pcapng"));
    repeated(|| {
        let sim = Running::sim(&["--write", server.to_str().unwrap()]);
        let mut calls = Vec::new();
        for (robot, args) in [
            (format!("tcp:{}", sim.bcap), &["get", "I1", "P1"][..]),
            (format!("udp:{}", sim.udp), &["put", "I1", "5"]),
            (sim.rac.clone(), &["rac", "get", "I1"]),
            (format!("tcp:{}", sim.bcap), &["slave", "cosine", "--seconds", "0.1", "--amplitude", "-1", "--yes"]),
            (format!("tcp:{}", sim.bcap), &["exec", "robot", "Nonsense"]),
        ] {
            let run = bcap(&[args, &["--robot", &robot, "--write", client.to_str().unwrap()]].concat());
            assert_eq!(run.code, i32::from(args.contains(&"Nonsense")), "{run:?}");
            calls.extend(json_calls(&client));
        }
        assert_eq!(sim.interrupt().code, 0);
        let mut seen = json_calls(&server);
        // the connections of Slave Mode have no common order
        calls.sort();
        seen.sort();
        assert!(calls.len() > 60, "{}", calls.len());
        assert_eq!(calls, seen);
    });
}

#[test]
fn a_gateway_records_its_plcs_and_the_robot() {
    let (sim, file) = (Running::sim(&[]), path("gateway.pcapng"));
    for robot in [format!("tcp:{}", sim.bcap), format!("udp:{}", sim.udp)] {
        let gateway = Running::gateway(&robot, &["--allow-put", "I", "--write", file.to_str().unwrap()]);
        for args in [&["rac", "put", "I3", "7"][..], &["rac", "get", "I3"]] {
            let run = bcap(&[args, &["--robot", &gateway.rac]].concat());
            assert_eq!((run.code, run.out.as_str()), (0, "I3 = 7\n"), "{run:?}");
        }
        assert_eq!(gateway.interrupt().code, 0);
        let lines = decoded(&file, &["--object", "I3"]);
        for call in ["PUT(I3, value: I4(7)) -> S_OK", "GET(I3) -> S_OK I4(7)"] {
            assert!(lines.contains(call), "{call}: {lines}");
        }
        for call in
            ["Variable_PutValue(variable: I3, value: I4(7)) -> S_OK", "Variable_GetValue(variable: I3) -> S_OK I4(7)"]
        {
            assert!(lines.contains(call), "{call}: {lines}");
        }
        assert_eq!(decoded(&file, &["--error", "any"]), "");
    }
}

/// The calls of a file without times and names of connections.
fn json_calls(file: &Path) -> Vec<String> {
    let lines = decoded(file, &["--json"]);
    let calls = lines.lines().map(|line| serde_json::from_str::<serde_json::Value>(line).unwrap());
    calls
        .filter(|line| line.get("function").is_some())
        .map(|mut call| {
            for field in ["time", "link", "us"] {
                call.as_object_mut().unwrap().remove(field);
            }
            call.to_string()
        })
        .collect()
}

/// A virtual controller behind a proxy with faults; returns both and the file.
fn faulty(name: &str, faults: &[&str]) -> (Running, Running, PathBuf) {
    let (sim, file) = (Running::sim(&[]), path(name));
    let robot = ["--robot", &sim.bcap, "--robot-udp", &sim.udp, "--robot-rac", &sim.rac];
    let more =
        ["--listen", "127.0.0.1:0", "--listen-rac", "127.0.0.1:0", "--seed", "7", "--write", file.to_str().unwrap()];
    let proxy = Running::start(&[&["proxy"], &robot[..], &more, faults].concat());
    (sim, proxy, file)
}

fn get(robot: &str, args: &[&str]) -> Run {
    bcap(&[args, &["--robot", robot, "--timeout", "6000"]].concat())
}

#[test]
fn dropped_requests_of_one_function_time_out_over_tcp_and_are_sent_again_over_udp() {
    let (_sim, proxy, file) = faulty("dropped.pcapng", &["--drop", "1:Variable_GetValue"]);
    let run = get(&format!("tcp:{}", proxy.bcap), &["get", "I1"]);
    assert_eq!(run.code, 4, "{run:?}");
    let printed = proxy.interrupt();
    assert!(printed.out.contains("note: fault: dropped the request of Variable_GetValue"), "{}", printed.out);
    let unanswered = decoded(&file, &["--error", "any"]);
    assert!(unanswered.contains("Variable_GetValue(variable: I1) -> no reply"), "{unanswered}");
    assert_eq!(unanswered.lines().count(), 1, "{unanswered}");

    let (_sim, proxy, file) = faulty("lost.pcapng", &["--drop", "0.2"]);
    // without --timeout a call has the time for all of its attempts; some may be late in addition
    let attempts = ["--attempts", "7", "--attempt-timeout", "1s"];
    let robot = format!("udp:{}", proxy.udp);
    let run: Run = bare(&[&["get", "I1", "--robot", &robot], &attempts[..]].concat()).output().unwrap().into();
    assert_eq!((run.code, run.out.as_str()), (0, "I1 = 0\n"), "{run:?}");
    let printed = proxy.interrupt();
    assert!(printed.out.contains("note: fault: dropped"), "{}", printed.out);
    assert!(decoded(&file, &[]).contains(" attempts]"));
}

#[test]
fn corrupted_replies_are_recorded_as_the_client_received_them() {
    let (_sim, proxy, file) = faulty("corrupt.pcapng", &["--corrupt", "1:GET"]);
    let run = get(&proxy.rac, &["rac", "get", "I1"]);
    assert_ne!(run.out, "I1 = 0\n", "{run:?}");
    let printed = proxy.interrupt();
    assert!(printed.out.contains("note: fault: flipped bit "), "{}", printed.out);
    if has_tshark() {
        let comments = tshark(&file, &["-T", "fields", "-e", "frame.comment", "-Y", "frame.comment"]);
        assert!(comments.starts_with("fault: flipped bit "), "{comments}");
    }
}

#[test]
fn delayed_calls_are_answered_later() {
    let (_sim, proxy, file) = faulty("delayed.pcapng", &["--delay", "30ms:Variable_GetValue"]);
    for robot in [format!("tcp:{}", proxy.bcap), format!("udp:{}", proxy.udp)] {
        let run = bcap(&["get", "I1", "--robot", &robot]);
        assert_eq!((run.code, run.out.as_str()), (0, "I1 = 0\n"), "{run:?}");
    }
    assert_eq!(proxy.interrupt().code, 0);
    for line in json_lines(&file, "Variable_GetValue") {
        // the request and the reply
        assert!(line["us"].as_u64().unwrap() >= 60_000, "{line}");
    }
}

fn json_lines(file: &Path, function: &str) -> Vec<serde_json::Value> {
    let lines = decoded(file, &["--json", "--function", function]);
    lines.lines().map(|line| serde_json::from_str(line).unwrap()).collect()
}

#[test]
fn many_clients_share_a_proxy() {
    let (_sim, proxy, file) = faulty("many.pcapng", &["--quiet"]);
    let [tcp, udp] = [format!("tcp:{}", proxy.bcap), format!("udp:{}", proxy.udp)];
    std::thread::scope(|scope| {
        for robot in [&tcp, &udp].into_iter().cycle().take(10) {
            scope.spawn(move || {
                let run = bcap(&["get", "I1", "P1", "--robot", robot]);
                assert_eq!(run.code, 0, "{run:?}");
            });
        }
    });
    let printed = proxy.interrupt();
    assert_eq!((printed.code, printed.out.as_str()), (0, ""), "--quiet");
    assert_eq!(json_lines(&file, "Service_Stop").len(), 10);
    assert_eq!(decoded(&file, &["--error", "any"]), "");
}

#[test]
fn a_robot_that_refuses_and_a_file_that_cannot_be_written_are_said() {
    // nothing listens there, and no other test will
    let closed = "127.0.0.1:1";
    let proxy = Running::start(&["proxy", "--listen", "127.0.0.1:0", "--robot", closed]);
    let run = bcap(&["get", "I1", "--robot", &format!("tcp:{}", proxy.bcap)]);
    assert_eq!(run.code, 3, "{run:?}");
    let printed = proxy.interrupt();
    assert!(printed.out.contains("note: cannot connect to the robot at "), "{}", printed.out);

    let run = bcap(&["proxy", "--listen", "127.0.0.1:0", "--robot", closed, "--write", "no/such/folder/x.pcapng"]);
    assert_eq!(run.code, 2, "{run:?}");
    assert!(run.err.contains("cannot write no/such/folder/x.pcapng: "), "{run:?}");
    let run = bcap(&["get", "I1", "--robot", "serial:/dev/null", "--write", path("x.pcapng").to_str().unwrap()]);
    assert!(run.code == 2 && run.err.contains("a serial line has no packets to record"), "{run:?}");
    let run = bcap(&["proxy", "--drop", "2"]);
    assert!(run.code == 2 && run.err.contains("write a share from 0 to 1"), "{run:?}");
}

/// Service_Stop.
const STOP: [u8; 16] = [1, 16, 0, 0, 0, 1, 0, 0, 0, 2, 0, 0, 0, 0, 0, 4];

/// The maximum number of clients of a proxy over UDP, and of connections over TCP.
const CLIENTS: usize = 256;

#[test]
fn a_proxy_over_udp_drops_datagrams_of_more_clients_than_it_serves() {
    let robot = UdpSocket::bind("127.0.0.1:0").unwrap();
    let address = robot.local_addr().unwrap().to_string();
    let proxy = Running::start(&["proxy", "--listen", "127.0.0.1:0", "--robot", &address]);
    let mut buffer = [0; 16];
    let mut sources = HashSet::new();
    let clients: Vec<_> = (0..=CLIENTS).map(|_| UdpSocket::bind("127.0.0.1:0").unwrap()).collect();
    // in sequence, so that no datagram is lost in the buffer of a socket; the last client is not served
    for client in &clients[..CLIENTS] {
        client.send_to(b"x", &proxy.udp).unwrap();
        sources.insert(robot.recv_from(&mut buffer).unwrap().1);
    }
    assert_eq!(sources.len(), CLIENTS);
    clients[CLIENTS].send_to(b"spare", &proxy.udp).unwrap();
    clients[CLIENTS].send_to(b"spare", &proxy.udp).unwrap();
    clients[0].send_to(b"again", &proxy.udp).unwrap();
    let (count, from) = robot.recv_from(&mut buffer).unwrap();
    assert_eq!((&buffer[..count], sources.contains(&from)), (&b"again"[..], true));
    // a client that stops its service frees its slot immediately, and its socket after the reply
    clients[1].send_to(&STOP, &proxy.udp).unwrap();
    let (_, stopped) = robot.recv_from(&mut buffer).unwrap();
    clients[CLIENTS].send_to(b"spare", &proxy.udp).unwrap();
    let (count, from) = robot.recv_from(&mut buffer).unwrap();
    assert_eq!((&buffer[..count], sources.contains(&from)), (&b"spare"[..], false));
    assert!(sources.contains(&stopped));
    let printed = proxy.interrupt();
    let notes: Vec<_> = printed.out.lines().filter(|line| line.contains("256 clients over UDP")).collect();
    assert_eq!(notes.len(), 1, "{}", printed.out);
}

#[cfg(target_os = "linux")]
#[test]
fn a_proxy_closes_the_socket_of_a_client_that_has_stopped_its_service() {
    let sim = Running::sim(&[]);
    let robot = ["--robot", &sim.bcap, "--robot-udp", &sim.udp];
    let proxy = Running::start(&[&["proxy", "--quiet", "--listen", "127.0.0.1:0"], &robot[..]].concat());
    let descriptors = || std::fs::read_dir(format!("/proc/{}/fd", proxy.child.id())).unwrap().count();
    let before = descriptors();
    let clients: Vec<_> = (0..3).map(|_| UdpSocket::bind("127.0.0.1:0").unwrap()).collect();
    for client in &clients {
        client.send_to(&STOP, &proxy.udp).unwrap();
        client.recv_from(&mut [0; 16]).unwrap();
    }
    assert_eq!(descriptors(), before + 3);
    while descriptors() > before {
        std::thread::sleep(Duration::from_millis(50));
    }
}

#[test]
fn a_proxy_over_tcp_gives_a_new_connection_the_slot_of_the_oldest_idle_one() {
    let robot = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = robot.local_addr().unwrap().to_string();
    let proxy = Running::start(&["proxy", "--listen", "127.0.0.1:0", "--robot", &address]);
    let mut connections: VecDeque<_> =
        (0..CLIENTS).map(|_| (TcpStream::connect(&proxy.bcap).unwrap(), robot.accept().unwrap().0)).collect();
    let mut spare = TcpStream::connect(&proxy.bcap).unwrap();
    assert_eq!(spare.read(&mut [0; 16]).unwrap(), 0, "the proxy closes it: all others were active in the last 10 s");
    // the first client waits for a reply, and all clients but the second have sent a part of a request
    for (number, (client, server)) in connections.iter_mut().enumerate() {
        let request: &[u8] = if number == 0 { &STOP } else { b"x" };
        if number != 1 {
            client.write_all(request).unwrap();
            server.read_exact(&mut vec![0; request.len()]).unwrap();
        }
    }
    // after 10 s a new connection is served
    robot.set_nonblocking(true).unwrap();
    let _served = 'served: loop {
        let mut spare = TcpStream::connect(&proxy.bcap).unwrap();
        spare.set_nonblocking(true).unwrap();
        // until the proxy has connected it to the robot, or closed it
        while spare.read(&mut [0; 16]).is_err_and(|error| error.kind() == ErrorKind::WouldBlock) {
            if let Ok(server) = robot.accept() {
                break 'served (spare, server);
            }
            std::thread::sleep(Duration::from_millis(10));
        }
        std::thread::sleep(Duration::from_millis(50));
    };
    let (mut waiting, mut evicted) = (connections.pop_front().unwrap(), connections.pop_front().unwrap());
    assert_eq!(evicted.0.read(&mut [0; 16]).unwrap(), 0, "it was idle for the longest time");
    waiting.1.write_all(b"y").unwrap();
    waiting.0.read_exact(&mut [0; 1]).unwrap();
    for (mut client, mut server) in connections {
        client.write_all(b"x").unwrap();
        server.read_exact(&mut [0; 1]).unwrap();
    }
    let printed = proxy.interrupt();
    let notes = |text: &str| printed.out.lines().filter(|line| line.contains(text)).count();
    assert_eq!((notes("256 connections"), notes("another needs its slot")), (1, 1), "{}", printed.out);
}

#[test]
fn a_gateway_reports_at_once_that_its_recording_has_failed() {
    let (sim, folder) = (Running::sim(&[]), tempfile::tempdir().unwrap());
    let [pipe, audit] = ["recording", "audit"].map(|name| folder.path().join(name).to_str().unwrap().to_owned());
    assert!(Command::new("mkfifo").arg(&pipe).status().unwrap().success());
    // opening a pipe waits for its other end
    let reader = std::thread::spawn({
        let pipe = pipe.clone();
        move || std::fs::File::open(pipe).unwrap()
    });
    let robot = format!("tcp:{}", sim.bcap);
    let args = ["gateway", "--rac", "127.0.0.1:0", "--robot", &robot, "--audit", &audit, "--write", &pipe];
    let mut gateway = Running::start(&args);
    drop(reader.join().unwrap());
    let get = || bcap(&["rac", "get", "I3", "--robot", &gateway.rac]);
    // until the robot is connected
    let served =
        (0..50).map(|_| get()).inspect(|_| std::thread::sleep(Duration::from_millis(50))).find(|run| run.code == 0);
    assert_eq!(served.map(|run| run.out).as_deref(), Some("I3 = 0\n"));
    let line = gateway.error_line();
    assert_eq!(line, format!(" note: the recording has failed, and the gateway goes on without it: {pipe}"));
    assert_eq!(bcap(&["rac", "get", "I3", "--robot", &gateway.rac]).out, "I3 = 0\n");
    let printed = gateway.interrupt();
    assert_eq!(printed.code, 2, "{printed:?}");
    assert_eq!(printed.err.lines().next().map(|line| line.contains("cannot write ")), Some(true), "{printed:?}");
}
