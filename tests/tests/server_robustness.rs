//! The server on real sockets under peers that are broken, slow, hostile or many: whatever one does, the others are
//! served, and nothing of it is left behind.

use std::io::{Read, Write};
use std::net::{Shutdown, SocketAddr, TcpStream, UdpSocket};
use std::time::Duration;

use bcap_core::bcap::call::{self, Call};
use bcap_core::bcap::{Decoder, FrameWriter, Progress};
use bcap_core::hresult::HResult;
use bcap_std::server::Limits;
use bcap_std::{Options, blocking};
use bcap_tests::frame::TestFrame;
use bcap_tests::network::Random;
use bcap_tests::served::Served;
use bcap_tests::vectors::frames;

/// A session from beginning to end: writes a variable and reads it back.
fn session(mut client: blocking::TcpClient, name: &str) {
    client.call(call::service_start("")).unwrap();
    let controller = client.call(call::controller_connect("", "", "", "")).unwrap();
    let variable = client.call(call::controller_get_variable(controller, name, "")).unwrap();
    for n in 0..3 {
        client.call(call::variable_put_value(variable, [n, -n])).unwrap();
        let value = client.call(call::variable_get_value(variable)).unwrap();
        assert_eq!(value.as_array().and_then(|a| a.items::<i32>()?.to_array()), Some([n, -n]));
    }
    client.call(call::variable_release(variable)).unwrap();
    client.call(call::controller_disconnect(controller)).unwrap();
    client.call(call::service_stop()).unwrap();
}

fn good_client(server: &Served, name: &str) {
    session(blocking::connect_tcp(server.tcp, &Options::default()).unwrap(), name);
}

/// Stops the server, which must have nobody and nothing any more.
fn nothing_left(server: Served) {
    let application = server.stop();
    assert_eq!((application.open.len(), application.peers.len()), (0, 0));
}

/// A connection that does with bytes as it likes.
fn raw(address: SocketAddr) -> TcpStream {
    let stream = TcpStream::connect(address).unwrap();
    stream.set_nodelay(true).unwrap();
    // only a bound for a test that fails: nothing here waits so long
    stream.set_read_timeout(Some(Duration::from_secs(20))).unwrap();
    stream
}

/// Reads a reply.
fn reply(stream: &mut TcpStream) -> TestFrame {
    let mut bytes = Vec::new();
    loop {
        if let Progress::Complete(frame, _) = Decoder::TCP.decode(&bytes).unwrap() {
            return TestFrame::read(&frame);
        }
        let mut byte = [0];
        stream.read_exact(&mut byte).unwrap();
        bytes.extend(byte);
    }
}

/// Reads until the server closes; a reset is an end as well.
fn rest(stream: &mut TcpStream) -> Vec<u8> {
    let mut bytes = Vec::new();
    match stream.read_to_end(&mut bytes) {
        Err(error) if error.kind() != std::io::ErrorKind::ConnectionReset => panic!("{error}"),
        _ => bytes,
    }
}

fn frame(call: &impl Call, serial: u16) -> Vec<u8> {
    let mut buffer = [0; 512];
    let mut writer = FrameWriter::new(&mut buffer).unwrap();
    call.arguments(&mut writer).unwrap();
    writer.finish(serial, 0, call.function().0).unwrap().to_vec()
}

/// Frames with one hostile value each; the whole list is in `tests/hostile`.
fn hostile_frames() -> Vec<(&'static str, Vec<u8>)> {
    let with = |value: &[u8]| {
        let mut bytes = vec![1, 0, 0, 0, 0, 9, 0, 0, 0, 1, 0, 0, 0, 1, 0];
        bytes.extend((value.len() as u32).to_le_bytes());
        bytes.extend(value);
        bytes.push(4);
        let length = bytes.len() as u32;
        bytes[1..5].copy_from_slice(&length.to_le_bytes());
        bytes
    };
    let array = |vartype: u16, count: u32| {
        let mut value = vartype.to_le_bytes().to_vec();
        value.extend(count.to_le_bytes());
        value.extend([0; 64]);
        with(&value)
    };
    let nested: Vec<u8> = [0x0c, 0x20, 1, 0, 0, 0].into_iter().cycle().take(600_000).collect();
    vec![
        ("100 000 levels", with(&nested)),
        ("R8 array whose size wraps", array(0x2005, 0x2000_0001)),
        ("UI1 array whose end wraps", array(0x2011, 0xffff_fff0)),
        ("VARIANT array without end", array(0x200c, 0x0aaa_aaab)),
        ("BSTR array without end", array(0x2008, 0x2000_0001)),
        ("a billion EMPTYs", array(0x2000, 1 << 30)),
        ("BSTR without end", with(&[8, 0, 1, 0, 0, 0, 0xfe, 0xff, 0xff, 0xff])),
        ("odd BSTR", with(&[8, 0, 1, 0, 0, 0, 1, 0, 0, 0, 65])),
        ("unknown type", with(&[0x18, 0, 1, 0, 0, 0])),
        ("scalar count", with(&[3, 0, 2, 0, 0, 0, 1, 0, 0, 0])),
        ("more arguments than there are", {
            let mut bytes = with(&[3, 0, 1, 0, 0, 0, 1, 0, 0, 0]);
            bytes[13] = 3;
            bytes
        }),
        ("wrong terminator", {
            let mut bytes = with(&[3, 0, 1, 0, 0, 0, 1, 0, 0, 0]);
            *bytes.last_mut().unwrap() = 5;
            bytes
        }),
        ("length 15", b"\x01\x0f\0\0\0\x09\0\0\0\x01\0\0\0\0\0".to_vec()),
        ("a frame of 4 GiB", b"\x01\xff\xff\xff\xff\x09\0\0\0\x01\0\0\0\0\0".to_vec()),
        ("another protocol", b"GET / HTTP/1.1\r\n\r\n".to_vec()),
    ]
}

#[test]
fn hostile_frames_are_answered_and_their_connection_closed() {
    let server = Served::start(Limits::default());
    for (name, bytes) in hostile_frames() {
        let mut stream = raw(server.tcp);
        // the server may have closed before it has read all of it
        let _ = stream.write_all(&bytes);
        let _ = stream.shutdown(Shutdown::Write);
        let answer = rest(&mut stream);
        if let Ok(Progress::Complete(frame, used)) = Decoder::TCP.decode(&answer) {
            let code = frame.hresult();
            assert!([HResult::E_INVALIDRCPACKET, HResult::E_PACKETSIZEOVER].contains(&code), "{name}: {code}");
            assert_eq!(used, answer.len(), "{name}");
        } else {
            assert_eq!(name, "100 000 levels", "only a reset of unread bytes may cost the answer: {answer:?}");
        }
        good_client(&server, name);
    }
    nothing_left(server);
}

#[test]
fn random_garbage_costs_nobody_else_anything() {
    let server = Served::start(Limits { receive: Duration::from_secs(1), ..Limits::default() });
    let mut random = Random(7);
    for _ in 0..100 {
        let length = 1 + random.below(300) as usize;
        let mut bytes: Vec<u8> = (0..length).map(|_| random.number() as u8).collect();
        if random.happens(500) {
            bytes[0] = 1;
        }
        let mut stream = raw(server.tcp);
        stream.write_all(&bytes).unwrap();
        stream.shutdown(Shutdown::Write).unwrap();
        let answer = rest(&mut stream);
        assert!(answer.is_empty() || Decoder::TCP.decode_datagram(&answer).is_ok(), "{bytes:x?}");
    }
    good_client(&server, "behind the garbage");
    nothing_left(server);
}

#[test]
fn connections_that_end_in_the_middle_of_a_request_leave_nothing() {
    let server = Served::start(Limits::default());
    let start = frame(&call::service_start(""), 1);
    let connect = frame(&call::controller_connect("", "", "", ""), 2);
    for cut in 0..connect.len() {
        let mut stream = raw(server.tcp);
        stream.write_all(&[&start[..], &connect[..cut]].concat()).unwrap();
        assert_eq!(reply(&mut stream).code, 0);
        // half of them close in order, half are simply gone
        if cut % 2 == 0 {
            stream.shutdown(Shutdown::Write).unwrap();
            assert_eq!(rest(&mut stream), [0_u8; 0]);
        }
    }
    good_client(&server, "behind the halves");
    nothing_left(server);
}

#[test]
fn requests_that_come_a_byte_at_a_time_are_answered() {
    let server = Served::start(Limits::default());
    let mut stream = raw(server.tcp);
    let requests = [frame(&call::service_start(""), 1), frame(&call::controller_connect("a", "b", "c", "d"), 2)];
    for (serial, request) in (1..).zip(requests) {
        for byte in request {
            stream.write_all(&[byte]).unwrap();
        }
        let reply = reply(&mut stream);
        assert_eq!((reply.serial, reply.code), (serial, 0));
    }
    // and in one piece: many requests at once are answered in order
    let many: Vec<u8> = (3..103).flat_map(|serial| frame(&call::service_start(""), serial)).collect();
    stream.write_all(&many).unwrap();
    for serial in 3..103 {
        assert_eq!(reply(&mut stream).serial, serial);
    }
}

#[test]
fn a_peer_that_never_reads_holds_nobody_up() {
    let server = Served::start(Limits::default());
    let mut stream = raw(server.tcp);
    stream.set_write_timeout(Some(Duration::from_millis(200))).unwrap();
    let requests: Vec<u8> = (1..1000).flat_map(|serial| frame(&call::service_start(""), serial)).collect();
    // until neither side's buffers take any more
    while stream.write_all(&requests).is_ok() {}
    good_client(&server, "beside the deaf one");
    drop(stream);
    nothing_left(server);
}

#[test]
fn two_hundred_connections_are_served_at_once() {
    let server = Served::start(Limits::default());
    let mut clients: Vec<_> = (0..200)
        .map(|n| {
            let mut client = blocking::connect_tcp(server.tcp, &Options::default()).unwrap();
            client.call(call::service_start("")).unwrap();
            let controller = client.call(call::controller_connect("", "", "", "")).unwrap();
            let name = format!("V{n}");
            let variable = client.call(call::controller_get_variable(controller, &name, "")).unwrap();
            (client, variable)
        })
        .collect();
    assert_eq!(server.application().peers.len(), 200);
    assert_eq!(server.application().open.len(), 600);
    for round in 0..3 {
        for (n, (client, variable)) in (0..).zip(&mut clients) {
            client.call(call::variable_put_value(*variable, n * 10 + round)).unwrap();
        }
        for (n, (client, variable)) in (0..).zip(&mut clients) {
            assert_eq!(client.call(call::variable_get_value(*variable)).unwrap().as_i32(), Some(n * 10 + round));
        }
    }
    // all go without a word; what they had is released
    drop(clients);
    nothing_left(server);
}

#[test]
fn silent_connections_make_room_where_that_is_wished() {
    let limits = Limits { connections: 4, idle: Some(Duration::from_secs(1)), ..Limits::default() };
    let server = Served::start(limits);
    let mut waiting = blocking::connect_tcp(server.tcp, &Options::default()).unwrap();
    waiting.call(call::service_start("WDT=100")).unwrap();
    let controller = waiting.call(call::controller_connect("", "", "", "")).unwrap();
    let mut silent: Vec<TcpStream> = (0..3).map(|_| raw(server.tcp)).collect();
    // a call that takes longer than anybody may be silent is no silence
    waiting.call(call::controller_execute(controller, "sleep", 2500)).unwrap();
    for stream in &mut silent {
        assert_eq!(rest(stream), [0_u8; 0]);
    }
    good_client(&server, "in a place of theirs");
    drop(waiting);
    nothing_left(server);
}

/// Every call of one may concern every call that waits, but those who wait are not asked after each of them.
#[test]
fn many_calls_that_wait_cost_the_others_little() {
    const WAITING: u64 = 200;
    let server = Served::start(Limits::default());
    let waiting: Vec<_> = (0..WAITING)
        .map(|_| {
            let mut client = blocking::connect_tcp(server.tcp, &Options::default()).unwrap();
            client.call(call::service_start("")).unwrap();
            let controller = client.call(call::controller_connect("", "", "", "")).unwrap();
            let sleep = frame(&call::controller_execute(controller, "sleep", 3_600_000), 9);
            client.transport().stream().write_all(&sleep).unwrap();
            client
        })
        .collect();
    let mut client = blocking::connect_tcp(server.tcp, &Options::default()).unwrap();
    let (before, begun) = (server.application().asked_again, std::time::Instant::now());
    for _ in 0..5000 {
        client.call(call::service_start("")).unwrap();
    }
    let asked = server.application().asked_again - before;
    // each of them at most once in 10 ms, and once more when a call begins to wait
    let most = WAITING * (3 + u64::try_from(begun.elapsed().as_millis()).unwrap() / 10);
    assert!(asked > 0 && asked <= most, "asked {asked} times, {most} at most");
    drop((client, waiting));
    nothing_left(server);
}

#[test]
fn connections_over_the_limit_are_told_so_and_take_no_place() {
    let server = Served::start(Limits { connections: 20, ..Limits::default() });
    let mut clients: Vec<_> =
        (0..20).map(|_| blocking::connect_tcp(server.tcp, &Options::default()).unwrap()).collect();
    for client in &mut clients {
        client.call(call::service_start("")).unwrap();
    }
    for _ in 0..5 {
        let mut more = blocking::connect_tcp(server.tcp, &Options::default()).unwrap();
        let error = more.call(call::service_start("")).unwrap_err();
        assert_eq!(error.hresult(), Some(HResult::E_MAX_CONNECT));
    }
    for client in &mut clients {
        client.call(call::controller_connect("", "", "", "")).unwrap();
    }
}

#[test]
fn datagrams_of_every_sort_stop_neither_the_service_nor_each_other() {
    let server = Served::start(Limits::default());
    let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
    for (_, bytes) in hostile_frames() {
        // larger ones do not even leave
        let _ = socket.send_to(&bytes, server.udp);
    }
    for vector in frames() {
        for cut in 0..vector.bytes.len() {
            socket.send_to(&vector.bytes[..cut], server.udp).unwrap();
        }
        let mut flipped = vector.bytes.clone();
        flipped[1] ^= 0x40;
        socket.send_to(&flipped, server.udp).unwrap();
    }
    let mut client = blocking::connect_udp(server.udp, &Options::default()).unwrap();
    client.call(call::service_start("")).unwrap();
    let controller = client.call(call::controller_connect("", "", "", "")).unwrap();
    client.call(call::controller_disconnect(controller)).unwrap();
    client.call(call::service_stop()).unwrap();
}

#[test]
fn lines_of_every_sort_leave_rac_in_step() {
    let server = Served::start(Limits::default());
    let mut stream = raw(server.rac);
    let mut line = |bytes: &[u8]| {
        stream.write_all(bytes).unwrap();
        let mut answer = Vec::new();
        while answer.last() != Some(&b'\r') {
            let mut byte = [0];
            stream.read_exact(&mut byte).unwrap();
            answer.extend(byte);
        }
        String::from_utf8(answer).unwrap()
    };
    assert_eq!(line(b"PUT:RC8:10:I:3, 123\r"), "0\r");
    for garbage in [
        &b"PUT:RC8:10:10:\r"[..],
        b"GET:RC8:10:I\r",
        b"GET:RC9:10:I:\r",
        b"\xff\xfe\x00\r",
        b"PUT:RC8:10:I:3,99999999999\r",
        b"PUT:RC8:10:S:8,\xff\xff\r",
        &[&vec![b'x'; 5000][..], b"\r"].concat(),
        &[&b"PUT:RC8:10:S:8,"[..], &vec![b'('; 300], b"\r"].concat(),
    ] {
        let answer = line(garbage);
        assert!(answer.starts_with('-'), "{answer:?} to {:?}", String::from_utf8_lossy(garbage));
        assert_eq!(line(b" \tGET:RC8:10:I:\r"), "0,3,123\r");
    }
    // many lines in one piece, and one in single bytes
    stream.write_all(&b"GET:RC8:10:I:\r".repeat(50)).unwrap();
    for byte in b"GET:RC8:10:I:\r" {
        stream.write_all(&[*byte]).unwrap();
    }
    let mut answers = vec![0; 51 * 8];
    stream.read_exact(&mut answers).unwrap();
    assert_eq!(answers, b"0,3,123\r".repeat(51));
}
