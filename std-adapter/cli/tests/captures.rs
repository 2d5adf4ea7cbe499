//! `bcap decode FILE`: captures with every fault of a network, of every link type, and one of a real session.

use std::fs;
use std::path::{Path, PathBuf};

use crate::common::capture::{BCAP, Capture, Flow, From, RAC, bstr, fragments, i4, list, numbered, segment, wrapped};
use crate::common::recorded;
use crate::common::{Run, bcap};
use bcap_fuzz::{TARGETS, corpus};
use serde_json::Value;

const GET_VARIABLE: u32 = 9;
const GET_VALUE: u32 = 101;
const EXECUTING: u32 = 0x900;

/// Opens the variable I1 as handle 3 and reads it: the bytes of the client and of the server.
fn reading() -> [Vec<u8>; 2] {
    let client = [numbered(1, 0, GET_VARIABLE, &[i4(2), bstr("I1"), bstr("")]), numbered(2, 0, GET_VALUE, &[i4(3)])];
    let server = [numbered(1, 0, 0, &[i4(3)]), numbered(2, 0, 0, &[i4(77)])];
    [client.concat(), server.concat()]
}

const OPENED: &str = "Controller_GetVariable(controller: I4(2), name: \"I1\", option: \"\") -> S_OK I4(3) = I1";
/// Sent before the handle was known.
const READ: &str = "Variable_GetValue(variable: I4(3)) -> S_OK I4(77)";

fn save(name: &str, capture: &Capture) -> String {
    let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
    capture.save(&path);
    path.to_str().unwrap().to_owned()
}

/// Decodes a capture, and returns the lines without times and without the response time at the end.
#[track_caller]
fn decoded(name: &str, capture: &Capture) -> Vec<String> {
    let run = bcap(&["decode", &save(name, capture)]);
    assert_eq!((run.code, run.err.as_str()), (0, ""), "{run:?}");
    run.out.lines().map(plain).collect()
}

fn plain(line: &str) -> String {
    let text = line.trim_start().split_once(' ').unwrap().1;
    text.split(" [").filter(|part| !part.ends_with(" ms]")).collect::<Vec<_>>().join(" [")
}

/// The lines about calls, without serial numbers, and the notes.
fn calls(lines: &[String]) -> Vec<&str> {
    lines[1..]
        .iter()
        .map(|line| line.split_once("tcp1 #1 ").or(line.split_once("tcp1 #2 ")).map_or(line.as_str(), |l| l.1))
        .collect()
}

#[test]
fn frames_may_share_segments_and_span_them() {
    let [client, server] = reading();
    for size in [1, 7, 16, 31, 1000] {
        let (mut capture, mut flow) = (Capture::new(), Flow::new(1, BCAP));
        for (from, bytes) in [(From::Client, &client), (From::Server, &server)] {
            bytes.chunks(size).for_each(|part| capture.tcp(&mut flow, from, part));
        }
        let lines = decoded("segments.pcap", &capture);
        assert_eq!(lines[0], "tcp1: b-CAP, client 10.0.0.1:40000, server 192.168.0.1:5007");
        assert_eq!(calls(&lines), [OPENED, READ]);
    }
}

#[test]
fn ports_that_are_used_again_begin_a_new_connection() {
    let [client, server] = reading();
    let mut capture = Capture::new();
    for first in [5, 5_000_000] {
        let mut flow = Flow::new(1, 7777);
        flow.skip(From::Client, first);
        // a SYN that is sent twice
        capture.packet(&flow.syn());
        capture.packet(&flow.syn());
        flow.skip(From::Client, 1);
        capture.tcp(&mut flow, From::Client, &client);
        capture.tcp(&mut flow, From::Server, &server);
    }
    let lines = decoded("reused.pcap", &capture);
    let starts: Vec<_> = lines.iter().map(|line| line.split([':', ' ']).next().unwrap()).collect();
    assert_eq!(starts, ["tcp1", "tcp1", "tcp1", "tcp2", "tcp2", "tcp2"], "{lines:?}");
}

#[test]
fn segments_that_come_twice_or_out_of_order_are_said() {
    let [client, server] = reading();
    let (mut capture, mut flow) = (Capture::new(), Flow::new(1, BCAP));
    let first = segment(&flow, From::Client, &client[..20]);
    capture.tcp(&mut flow, From::Client, &client[..20]);
    capture.packet(&first);
    let mut ahead = flow.clone();
    let skipped = segment(&ahead, From::Client, &client[20..50]);
    ahead.skip(From::Client, 30);
    capture.packet(&segment(&ahead, From::Client, &client[50..]));
    capture.packet(&skipped);
    ahead.skip(From::Client, client.len() - 50);
    capture.tcp(&mut ahead, From::Server, &server);
    let lines = decoded("order.pcap", &capture);
    let notes = [
        "tcp1: note: a segment was sent again (retransmission)",
        "tcp1: note: a segment arrived before its predecessor",
    ];
    assert_eq!(calls(&lines), [notes[0], notes[1], OPENED, READ]);
}

#[test]
fn missing_segments_are_said_and_the_next_frames_are_found() {
    let [client, server] = reading();
    let (mut capture, mut flow) = (Capture::new(), Flow::new(1, BCAP));
    capture.tcp(&mut flow, From::Client, &client[..20]);
    flow.skip(From::Client, 10);
    capture.tcp(&mut flow, From::Client, &client[30..]);
    capture.tcp(&mut flow, From::Server, &server);
    let lines = decoded("missing.pcap", &capture);
    assert_eq!(lines[1], "tcp1: note: a segment arrived before its predecessor");
    assert_eq!(lines[2], "tcp1: note: client: the capture lacks 10 bytes, inside a frame of which 20 bytes are there");
    assert!(lines[3].starts_with("tcp1: note: client: ") && lines[3].contains("are not a frame"), "{lines:?}");
    assert!(lines.iter().any(|line| line.ends_with("Variable_GetValue(variable: I4(3)) -> S_OK I4(77)")), "{lines:?}");
    assert!(lines.iter().any(|line| line.contains("a reply without a request: #1")), "{lines:?}");
}

#[test]
fn an_invalid_frame_does_not_hide_the_next_ones() {
    let [client, server] = reading();
    // the length of its argument is wrong; the bytes of its count and length look like the start of a frame of 2816 bytes
    let mut invalid = numbered(7, 0, GET_VALUE, &[i4(1)]);
    invalid[15] = 0x0b;
    let (mut capture, mut flow) = (Capture::new(), Flow::new(1, BCAP));
    capture.tcp(&mut flow, From::Client, &[invalid, client].concat());
    capture.tcp(&mut flow, From::Server, &server);
    let lines = decoded("invalid.pcap", &capture);
    assert!(lines[1].starts_with("tcp1: note: client: 30 bytes are not a frame: "), "{lines:?}");
    assert_eq!(calls(&lines)[1..], [OPENED, READ]);
}

#[test]
fn a_value_that_looks_like_a_header_after_missing_bytes_hides_no_frame() {
    let [client, server] = reading();
    let lost = numbered(7, 0, GET_VARIABLE, &[i4(1), bstr("I1"), bstr("")]);
    for size in [1, 7, 1000] {
        let (mut capture, mut flow) = (Capture::new(), Flow::new(1, BCAP));
        capture.tcp(&mut flow, From::Client, &lost[..16]);
        flow.skip(From::Client, 4);
        // in it 01 00 00 00 01: a count of 1 and the value 1, or the start of a frame of 16 MiB
        let rest = [&lost[20..], &client].concat();
        rest.chunks(size).for_each(|part| capture.tcp(&mut flow, From::Client, part));
        capture.tcp(&mut flow, From::Server, &server);
        let lines = decoded("looks.pcap", &capture);
        let found = calls(&lines);
        assert!(found.contains(&OPENED) && found.contains(&READ), "{size}: {lines:?}");
    }
}

#[test]
fn attempts_over_udp_and_keep_alives_belong_to_one_call() {
    let (mut capture, flow) = (Capture::new(), Flow::new(1, BCAP));
    for (serial, from, code) in [(5, From::Client, GET_VALUE), (6, From::Client, GET_VALUE)] {
        capture.udp(&flow, from, &numbered(serial, 5, code, &[i4(3)]));
    }
    capture.udp(&flow, From::Server, &numbered(6, 0, EXECUTING, &[]));
    capture.udp(&flow, From::Server, &numbered(6, 0, 0x8007_0006, &[]));
    capture.udp(&flow, From::Server, &numbered(5, 0, 0, &[i4(1)]));
    capture.udp(&flow, From::Client, &numbered(7, 7, GET_VALUE, &[i4(4)]));
    capture.udp(&flow, From::Client, b"\x01 not a frame");
    let lines = decoded("udp.pcap", &capture);
    let refused = "udp1 #5 Variable_GetValue(variable: I4(3)) -> 0x80070006 (E_HANDLE): ";
    assert!(lines[1].starts_with(refused), "{lines:?}");
    assert!(lines[1].ends_with(" [2 attempts] [1 x S_EXECUTING]"), "{lines:?}");
    assert_eq!(lines[2], "udp1: note: server: another reply: #5 0x00000000 (S_OK)");
    assert_eq!(lines[3], "udp1 #7 Variable_GetValue(variable: I4(4)) -> no reply");
    assert!(lines[4].starts_with("udp1: note: client: 13 bytes are not a frame: "), "{lines:?}");

    let path = save("udp.pcap", &capture);
    let run = bcap(&["decode", &path, "--json", "--error", "E_HANDLE"]);
    let call: Value = serde_json::from_str(&run.out).unwrap();
    assert_eq!((&call["attempts"], &call["executing"], &call["us"]), (&2.into(), &1.into(), &3000.into()));
    assert_eq!((&call["code"], &call["hresult"]), (&(-2_147_024_890_i64).into(), &"E_HANDLE".into()));
    assert_eq!(bcap(&["decode", &path, "--error", "any"]).out.lines().count(), 2);
    assert_eq!(bcap(&["decode", &path, "--error", "0x80070057"]).out, "");
}

#[test]
fn an_attempt_over_udp_after_the_reply_is_not_a_second_call() {
    let (mut capture, flow) = (Capture::new(), Flow::new(1, BCAP));
    // the reply to #5 is lost after the capture; #7 is another call
    for (serial, reserved) in [(5, 5), (6, 5), (7, 7)] {
        capture.udp(&flow, From::Client, &numbered(serial, reserved, GET_VALUE, &[i4(3)]));
        capture.udp(&flow, From::Server, &numbered(serial, 0, 0, &[i4(1)]));
    }
    let expected = [
        "udp1 #5 Variable_GetValue(variable: I4(3)) -> S_OK I4(1)",
        "udp1: note: client: #6 repeats #5 after its reply",
        "udp1: note: server: another reply: #6 0x00000000 (S_OK)",
        "udp1 #7 Variable_GetValue(variable: I4(3)) -> S_OK I4(1)",
    ];
    assert_eq!(decoded("repeated.pcap", &capture)[1..], expected);
}

#[test]
fn fragments_of_ip_packets_are_reassembled() {
    let (mut capture, flow) = (Capture::new(), Flow::new(1, BCAP));
    let name = "x".repeat(1000);
    let open = numbered(5, 5, GET_VARIABLE, &[i4(2), bstr(&name), bstr("")]);
    let mut packets = fragments(&flow, From::Client, &open, 512);
    assert_eq!(packets.len(), 5);
    packets.reverse();
    packets.iter().for_each(|packet| capture.packet(packet));
    capture.udp(&flow, From::Server, &numbered(5, 0, 0, &[i4(3)]));
    // one fragment of three is missing
    let read = [numbered(6, 6, GET_VALUE, &[i4(3)]), vec![0; 1000]].concat();
    fragments(&flow, From::Client, &read, 512).iter().skip(1).for_each(|packet| capture.packet(packet));
    let lines = decoded("fragments.pcap", &capture);
    // the time of a note is the one of the first fragment
    let note = "capture: note: skipped fragments of IP packets that are incomplete, or of IPv6: 2";
    let opened = "udp1 #5 Controller_GetVariable(controller: I4(2), name: a VT_BSTR of 2010 bytes, option: \"\") -> ";
    assert_eq!((lines.len(), lines[0].as_str()), (3, note));
    assert_eq!(lines[2], format!("{opened}S_OK I4(3) = {name}"));
}

/// Headers of a link layer in front of IP: the link type and the bytes.
fn links() -> Vec<(u32, Vec<u8>)> {
    let ethernet = [&[0; 12][..], &[8, 0]].concat();
    let tagged = [&[0; 12][..], &[0x81, 0, 0, 5, 8, 0]].concat();
    let cooked = [&[0; 14][..], &[8, 0]].concat();
    let cooked2 = [&[8, 0][..], &[0; 18]].concat();
    let families = [vec![2, 0, 0, 0], vec![0, 0, 0, 2]];
    let [null, looped] = families;
    vec![
        // with the length of its check sequence
        (0x2400_0001, ethernet.clone()),
        (1, ethernet),
        (1, tagged),
        (113, cooked),
        (276, cooked2),
        (0, null),
        (108, looped),
        (12, vec![]),
        (101, vec![]),
        (228, vec![]),
    ]
}

#[test]
fn captures_of_every_link_type_are_read() {
    let [client, server] = reading();
    for (link, head) in links() {
        let (mut capture, mut flow) = (Capture::of_link(link), Flow::new(1, BCAP));
        for (from, bytes) in [(From::Client, &client), (From::Server, &server)] {
            capture.packet(&[&head, &segment(&flow, from, bytes)[..]].concat());
            flow.skip(from, bytes.len());
        }
        assert_eq!(calls(&decoded("link.pcap", &capture)), [OPENED, READ], "link type {link}");
    }
    let mut capture = Capture::of_link(9999);
    capture.packet(&[0; 60]);
    let lines = decoded("link.pcap", &capture);
    assert_eq!(lines, ["capture: note: skipped packets of link type 9999, which is not supported: 1"]);
}

/// A capture in pcapng of [`reading`], with raw IP: options of its interface, and the times of request and reply.
fn pcapng_of(is_big_endian: bool, options: &[(u16, &[u8])], ticks: [u32; 2]) -> Vec<u8> {
    let word = |n: u32| if is_big_endian { n.to_be_bytes() } else { n.to_le_bytes() };
    let half = |n: u16| if is_big_endian { n.to_be_bytes() } else { n.to_le_bytes() };
    let padded = |bytes: &[u8]| [bytes, &vec![0; bytes.len().next_multiple_of(4) - bytes.len()]].concat();
    let block = |kind: u32, body: &[u8]| {
        let body = padded(body);
        let length = word(u32::try_from(body.len() + 12).unwrap());
        [&word(kind)[..], &length, &body, &length].concat()
    };
    let section = [&word(0x1a2b_3c4d)[..], &half(1), &half(0), &[0xff; 8]].concat();
    // the link type, the snap length and the options
    let mut interface = [&half(101)[..], &half(0), &word(0)].concat();
    for (code, value) in options {
        interface.extend([&half(*code)[..], &half(u16::try_from(value.len()).unwrap()), &padded(value)].concat());
    }
    interface.extend([0; 4]);
    let mut file = [block(0x0a0d_0d0a, &section), block(1, &interface)].concat();
    let mut flow = Flow::new(1, BCAP);
    for ((from, bytes), ticks) in [From::Client, From::Server].into_iter().zip(reading()).zip(ticks) {
        let packet = segment(&flow, from, &bytes);
        flow.skip(from, bytes.len());
        let length = u32::try_from(packet.len()).unwrap();
        let fields = [0, 0, ticks, length, length].map(word).concat();
        file.extend(block(6, &[fields, packet].concat()));
    }
    file
}

/// A capture with times in nanoseconds, 1.5 ms between request and reply.
fn pcapng() -> Vec<u8> {
    pcapng_of(false, &[(9, &[9])], [1_500_000, 3_000_000])
}

#[test]
fn times_in_pcapng_have_the_resolution_and_the_offset_of_their_interface() {
    let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join("times.pcapng");
    for is_big_endian in [false, true] {
        let offset = if is_big_endian { 3600_i64.to_be_bytes() } else { 3600_i64.to_le_bytes() };
        // microseconds without the option; powers of 10 and of 2
        for (options, ticks) in
            [(&[][..], [2_000_000, 3_500_000]), (&[(9, &[3][..])], [2000, 3500]), (&[(9, &[0x8a][..])], [2048, 3584])]
        {
            let options = [options, &[(14, &offset[..])]].concat();
            fs::write(&path, pcapng_of(is_big_endian, &options, ticks)).unwrap();
            let run = bcap(&["decode", path.to_str().unwrap(), "--json"]);
            let lines: Vec<Value> = run.out.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
            let found: Vec<_> = lines.iter().map(|line| (&line["time"], &line["us"])).collect();
            let (time, us) = (Value::from("3602.000000000"), Value::from(1_500_000));
            assert_eq!(found, [(&time, &Value::Null), (&time, &us), (&time, &us)], "{is_big_endian} {options:?}");
        }
    }
}

#[test]
fn captures_in_pcapng_are_read() {
    let file = pcapng();
    let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join("capture.pcapng");
    fs::write(&path, &file).unwrap();
    let run = bcap(&["decode", path.to_str().unwrap()]);
    let lines: Vec<_> = run.out.lines().map(plain).collect();
    assert_eq!((calls(&lines), run.code), (vec![OPENED, READ], 0));
    assert!(run.out.contains("[1.500 ms]"), "{}", run.out);

    fs::write(&path, &file[..file.len() - 10]).unwrap();
    let run = bcap(&["decode", path.to_str().unwrap()]);
    assert_eq!((run.code, run.out.contains("-> no reply")), (2, true), "{run:?}");
    assert!(run.err.ends_with("capture.pcapng: the file ends inside a packet\n"), "{run:?}");
}

#[test]
fn damaged_files_are_errors_or_have_fewer_calls() {
    let session = fs::read(recorded::committed()).unwrap();
    let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join("damaged.pcap");
    let mut seed = 1_u32;
    // the numbers of a linear congruential generator, whose high bits are good
    let mut below = |limit: usize| {
        seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        usize::try_from(seed >> 8).unwrap() % limit
    };
    for mut file in std::iter::repeat_n([pcapng(), session[..4000].to_vec()], 100).flatten() {
        for _ in 0..=below(4) {
            let at = below(file.len());
            file[at] = [0, 1, 0x7f, 0x80, 0xff][below(5)];
        }
        if below(3) == 0 {
            file.truncate(below(file.len()));
        }
        fs::write(&path, &file).unwrap();
        let run = bcap(&["decode", path.to_str().unwrap()]);
        assert!([0, 2].contains(&run.code) && !run.err.contains("panicked"), "{run:?}");
        assert_eq!(run.code == 2, run.err.starts_with("error: "), "{run:?}");
    }
}

#[test]
fn other_ports_are_recognised_by_their_first_bytes() {
    let [client, server] = reading();
    let (mut capture, mut flow) = (Capture::new(), Flow::new(1, 7777));
    capture.tcp(&mut flow, From::Client, &client);
    capture.tcp(&mut flow, From::Server, &server);
    let mut flow = Flow::new(2, 7778);
    capture.tcp(&mut flow, From::Client, b"GET:RC8:1:I:\r");
    capture.tcp(&mut flow, From::Server, b"0,3,5\r");
    let mut flow = Flow::new(3, 80);
    capture.tcp(&mut flow, From::Client, b"GET / HTTP/1.1\r\n\r\n");
    let lines = decoded("ports.pcap", &capture);
    assert_eq!(lines[0], "tcp1: b-CAP, client 10.0.0.1:40000, server 192.168.0.1:7777");
    assert_eq!(lines[3..], ["tcp2: RAC, client 10.0.0.2:40000, server 192.168.0.1:7778", "tcp2 GET(I1) -> S_OK I4(5)"]);
}

#[test]
fn a_port_is_recognised_by_a_deviation_that_is_accepted() {
    let [client, server] = reading();
    // an unused byte before EOT, in the first frame
    let opening = client.len() - numbered(2, 0, GET_VALUE, &[i4(3)]).len();
    let mut deviating = [&client[..opening - 1], &[0], &client[opening - 1..]].concat();
    deviating[1] += 1;
    let (mut capture, mut flow) = (Capture::new(), Flow::new(1, 7777));
    capture.tcp(&mut flow, From::Client, &deviating);
    capture.tcp(&mut flow, From::Server, &server);
    let path = save("deviation.pcap", &capture);
    assert_eq!(bcap(&["decode", &path]).out, "");
    let run = bcap(&["decode", &path, "--lenient"]);
    let lines: Vec<_> = run.out.lines().map(plain).collect();
    assert_eq!((calls(&lines), run.code), (vec![OPENED, READ], 0));
}

#[test]
fn the_figures_have_one_row_for_all_invalid_lines() {
    let (mut capture, mut flow) = (Capture::new(), Flow::new(1, RAC));
    let lines: String = (0..200).map(|number| format!("X{number}\r")).collect();
    capture.tcp(&mut flow, From::Client, lines.as_bytes());
    let run = bcap(&["decode", &save("lines.pcap", &capture), "--stats"]);
    let rows: Vec<_> = run.out.lines().filter(|line| !line.contains("note:")).collect();
    assert_eq!((rows.len(), rows[1].starts_with("(invalid lines)      200 ")), (2, true), "{rows:?}");
}

#[test]
fn lines_of_rac_are_calls() {
    let (mut capture, mut flow) = (Capture::new(), Flow::new(1, RAC));
    capture.tcp(&mut flow, From::Client, b"PUT:RC8:1:V:8196,1,2,3\r\nGET:RC8:1:");
    capture.tcp(&mut flow, From::Client, b"S:\r\nHELLO\r");
    capture.tcp(&mut flow, From::Server, b"0\r0,8,\x1b[31m\r-2147024809\r7\r");
    let lines = decoded("rac.pcap", &capture);
    assert_eq!(lines[1], "tcp1 PUT(V1, value: R4[1.0, 2.0, 3.0]) -> S_OK");
    assert!(lines[2].starts_with("tcp1: note: client: invalid line \"HELLO\": "), "{lines:?}");
    assert_eq!(lines[3], "tcp1 GET(S1) -> S_OK \"\\u{1b}[31m\"");
    assert!(lines[4].starts_with("tcp1 \"HELLO\"() -> 0x80070057 (E_INVALIDARG): "), "{lines:?}");
    assert_eq!(lines[5], "tcp1: note: server: a response without a request: 0x00000007");
}

#[test]
fn a_missing_response_of_rac_does_not_shift_later_ones() {
    let (mut capture, mut flow) = (Capture::new(), Flow::new(1, RAC));
    for index in 1..=4 {
        capture.tcp(&mut flow, From::Client, format!("GET:RC8:{index}:I:\r").as_bytes());
        let response = format!("0,3,{index}\r");
        if index == 2 {
            flow.skip(From::Server, response.len());
        } else {
            capture.tcp(&mut flow, From::Server, response.as_bytes());
        }
    }
    let expected = [
        "tcp1 GET(I1) -> S_OK I4(1)",
        "tcp1 GET(I2) -> no reply",
        "tcp1 GET(I3) -> no reply",
        "tcp1: note: a segment arrived before its predecessor",
        "tcp1: note: server: the capture lacks 6 bytes",
        "tcp1: note: server: a response without a request: 0x00000000 (S_OK)",
        "tcp1 GET(I4) -> S_OK I4(4)",
    ];
    assert_eq!(decoded("missing-rac.pcap", &capture)[1..], expected);
}

#[test]
fn calls_are_selected_by_time_and_printed_as_csv() {
    let [client, server] = reading();
    let (mut capture, mut flow) = (Capture::new(), Flow::new(1, BCAP));
    let opening = client.len() - numbered(2, 0, GET_VALUE, &[i4(3)]).len();
    // a packet each millisecond; the reply to both is the third
    for (from, bytes) in
        [(From::Client, &client[..opening]), (From::Client, &client[opening..]), (From::Server, &server[..])]
    {
        capture.tcp(&mut flow, from, bytes);
    }
    let path = save("times.pcap", &capture);
    let run = bcap(&["decode", &path, "--csv"]);
    let rows = [
        "time,link,serial,function,command,arguments,attempts,hresult,ms,value",
        "0.000000,tcp1,1,Controller_GetVariable,,\"controller: I4(2), name: \"\"I1\"\", option: \"\"\"\"\",1,S_OK,2.000,I4(3)",
        "0.001000,tcp1,2,Variable_GetValue,,variable: I4(3),1,S_OK,1.000,I4(77)",
    ];
    assert_eq!((run.code, run.out.lines().collect::<Vec<_>>()), (0, rows.to_vec()));
    for (options, kept) in [
        (&["--from", "0.001"][..], &rows[2..]),
        (&["--until", "0.001"], &rows[1..2]),
        (&["--from", "0.0005", "--until", "0.001"], &[]),
    ] {
        let run = bcap(&[&["decode", &path, "--csv"], options].concat());
        assert_eq!(run.out.lines().skip(1).collect::<Vec<_>>(), kept, "{options:?}");
    }
    let run = bcap(&["decode", &path, "--from", "-1"]);
    assert_eq!(run.code, 2, "{run:?}");
}

#[test]
fn the_figures_have_the_gaps_of_slave_mode() {
    let (mut capture, mut flow) = (Capture::new(), Flow::new(1, BCAP));
    let slave_move = |serial| numbered(serial, 0, 64, &[i4(5), bstr("slvMove"), list(&[])]);
    // a packet takes 1 ms; others on another connection pass the time
    let mut other = Flow::new(2, BCAP);
    for (serial, pause) in [(1, 7), (2, 7), (3, 14), (4, 7), (5, 0)] {
        capture.tcp(&mut flow, From::Client, &slave_move(serial));
        (0..pause).for_each(|_| capture.tcp(&mut other, From::Client, b"x"));
    }
    let path = save("gaps.pcap", &capture);
    let run = bcap(&["decode", &path, "--stats"]);
    let line = "tcp1: 4 intervals between slvMove: p50 8.003 ms, p99 15.000 ms, max 15.000 ms; 1 longer than 12 ms";
    assert!(run.out.lines().any(|found| found == line), "{}", run.out);
    let run = bcap(&["decode", &path, "--stats", "--json"]);
    let line: Value = serde_json::from_str(run.out.lines().last().unwrap()).unwrap();
    assert_eq!((&line["slave_mode"], &line["gaps"], &line["intervals"]), (&"tcp1".into(), &1.into(), &4.into()));
}

#[test]
fn wrong_files_and_options_are_errors() {
    let folder = PathBuf::from(env!("CARGO_TARGET_TMPDIR"));
    let error = |args: &[&str]| -> String {
        let Run { err, code, .. } = bcap(&[&["decode"], args].concat());
        assert_eq!(code, 2, "{err}");
        err
    };
    for (name, bytes, words) in [
        ("empty.pcap", &b""[..], "the file is empty"),
        ("text.pcap", b"this is not a capture, but long enough", "the file is neither pcap nor pcapng"),
    ] {
        fs::write(folder.join(name), bytes).unwrap();
        let err = error(&[folder.join(name).to_str().unwrap()]);
        assert!(err.contains(&format!("{name}: {words}\n")), "{err}");
    }
    assert!(error(&["no/such/file.pcapng"]).contains("cannot read no/such/file.pcapng: "));
    assert!(error(&["--stats", "0110"]).contains("need a capture: FILE.pcap, FILE.pcapng or FILE.cap"));
    let capture = save("none.pcap", &Capture::new());
    assert!(error(&[&capture, "--com"]).contains("--variant, --com and --rac do not apply to a capture"));
    assert!(error(&[&capture, "--function", "Jump"]).contains("no function is named \"Jump\""));
    assert!(error(&[&capture, "--error", "E_JUMP"]).contains("no result code is named \"E_JUMP\""));
}

#[test]
fn no_input_of_a_corpus_makes_decode_fail() {
    for (target, _) in TARGETS {
        let capture = wrapped(&corpus::read(target).unwrap());
        let path = save("corpus.pcap", &capture);
        for args in [&["decode", &path, "--json"][..], &["decode", &path, "--lenient"]] {
            let run = bcap(args);
            assert_eq!((run.code, run.err.as_str()), (0, ""), "{target}");
            assert!(run.out.lines().count() > 4);
        }
    }
}

#[test]
fn a_capture_of_tcpdump_has_the_calls_that_the_server_saw() {
    let Some(recorded) = recorded::session() else { return };
    recorded::assert_as_seen(&recorded);
    if std::env::var_os("BLESS").is_some() {
        fs::copy(&recorded.file, recorded::committed()).unwrap();
    }
}
