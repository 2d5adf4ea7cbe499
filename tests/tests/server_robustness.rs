//! Tests the server on real sockets with many, waiting and silent peers, and its shutdown: all peers are served, and the
//! server releases all their resources. `tests/hostile` tests hostile peers.

use std::io::{Read, Write};
use std::net::{Shutdown, TcpStream};
use std::time::{Duration, Instant};

use bcap_core::bcap::FrameWriter;
use bcap_core::bcap::call::{self, Call};
use bcap_core::hresult::HResult;
use bcap_core::variant::Variant;
use bcap_std::server::Limits;
use bcap_std::{Options, blocking};
use bcap_tests::served::Served;

/// Connects a client, and returns it with the handle of its controller.
fn client(server: &Served) -> (blocking::TcpClient, call::ControllerHandle) {
    let mut client = blocking::connect_tcp(server.tcp, &Options::default()).unwrap();
    client.call(call::service_start("WDT=100")).unwrap();
    let controller = client.call(call::controller_connect("", "", "", "")).unwrap();
    (client, controller)
}

fn frame(call: &impl Call, buffer: &mut [u8]) -> usize {
    let mut writer = FrameWriter::new(buffer).unwrap();
    call.arguments(&mut writer).unwrap();
    writer.finish(9, 0, call.function().0).unwrap().len()
}

#[test]
fn two_hundred_connections_are_served_at_once() {
    let server = Served::start(Limits::default().connections_per_address(200));
    let mut clients: Vec<_> = (0..200)
        .map(|n| {
            let (mut client, controller) = client(&server);
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
    // all go without a word; their objects are released
    drop(clients);
    server.stop_empty();
}

#[test]
fn idle_connections_are_closed_after_the_configured_limit() {
    let limits = Limits::default().connections(4).idle(Some(Duration::from_secs(1)));
    let server = Served::start(limits);
    let (mut waiting, controller) = client(&server);
    let mut silent: Vec<TcpStream> = (0..3).map(|_| TcpStream::connect(server.tcp).unwrap()).collect();
    // a call that runs longer than the idle limit does not count as silence
    waiting.call(call::controller_execute(controller, "sleep", 2500)).unwrap();
    for stream in &mut silent {
        // only a bound for a test that fails
        stream.set_read_timeout(Some(Duration::from_secs(20))).unwrap();
        assert_eq!(stream.read(&mut [0]).unwrap(), 0, "it is closed");
    }
    let (more, _) = client(&server);
    drop((waiting, more));
    server.stop_empty();
}

/// A call may complete any waiting call, but the server does not poll all waiting calls after each call.
#[test]
fn many_waiting_calls_do_not_slow_other_calls() {
    const WAITING: u64 = 200;
    let server = Served::start(Limits::default().connections_per_address(256));
    let waiting: Vec<_> = (0..WAITING)
        .map(|_| {
            let (mut client, controller) = client(&server);
            let mut buffer = [0; 512];
            let len = frame(&call::controller_execute(controller, "sleep", 3_600_000), &mut buffer);
            client.transport().stream().write_all(&buffer[..len]).unwrap();
            client
        })
        .collect();
    let (mut client, _) = client(&server);
    let (before, begun) = (server.application().asked_again, Instant::now());
    for _ in 0..5000 {
        client.call(call::service_start("")).unwrap();
    }
    let asked = server.application().asked_again - before;
    // each of them at most once in 10 ms, and once more when a call begins to wait
    let most = WAITING * (3 + u64::try_from(begun.elapsed().as_millis()).unwrap() / 10);
    assert!(asked > 0 && asked <= most, "asked {asked} times, {most} at most");
    drop((client, waiting));
    server.stop_empty();
}

/// Bytes that do not fit into the buffer while a call runs hide the end of the stream after them.
#[test]
#[cfg_attr(
    not(any(target_os = "linux", target_os = "android")),
    ignore = "only Linux tells of an end behind unread bytes"
)]
fn a_disconnect_after_unread_requests_is_detected() {
    let server = Served::start(Limits::default());
    for end in [Shutdown::Write, Shutdown::Both] {
        let (mut client, controller) = client(&server);
        let mut buffer = [0; 512];
        let sleep = frame(&call::controller_execute(controller, "sleep", 3_600_000), &mut buffer);
        client.transport().stream().write_all(&buffer[..sleep]).unwrap();
        let more = frame(&call::controller_execute(controller, "echo", [1; 20]), &mut buffer);
        client.transport().stream().write_all(&buffer[..more].repeat(100)).unwrap();
        let until = Instant::now() + Duration::from_secs(30);
        client.transport().stream().shutdown(end).unwrap();
        while !server.application().peers.is_empty() {
            assert!(Instant::now() < until, "its call still runs");
            std::thread::sleep(Duration::from_millis(10));
        }
    }
    server.stop_empty();
}

#[test]
fn a_reply_without_memory_is_reported() {
    // a request of 60 KiB fits, but a reply of the same size does not fit in addition
    let server = Served::start(Limits::default().memory(100 << 10));
    let (mut client, controller) = client(&server);
    let (large, fits) = ([7_u8; 60 << 10], [7_u8; 16 << 10]);
    let value = client.call(call::controller_execute(controller, "echo", &fits[..])).unwrap();
    assert_eq!(value.as_array().map(|array| array.len()), Some(fits.len()));
    for _ in 0..3 {
        let error = client.call(call::controller_execute(controller, "echo", &large[..])).unwrap_err();
        assert_eq!(error.hresult(), Some(HResult::E_TOO_MUCH_DATA));
        assert_eq!(client.call(call::controller_execute(controller, "echo", 7)).unwrap(), Variant::I4(7));
    }
    drop(client);
    server.stop_empty();
}

/// Shutdown does not wait for the timeouts of slow, waiting or unresponsive peers.
#[test]
fn a_server_stops_despite_busy_peers() {
    const TIMEOUT: Duration = Duration::from_secs(300);
    let server = Served::start(Limits::default().send(TIMEOUT).receive(TIMEOUT));
    let (mut deaf, controller) = client(&server);
    let (mut slow, its_own) = client(&server);
    let (mut waiting, another) = client(&server);
    let mut buffer = vec![0; 9 << 20];
    let large = vec![7_u8; 8 << 20];
    for (client, controller) in [(&mut deaf, controller), (&mut slow, its_own)] {
        let len = frame(&call::controller_execute(controller, "echo", &large[..]), &mut buffer);
        client.transport().stream().write_all(&buffer[..len]).unwrap();
        client.transport().stream().write_all(&buffer[..len / 2]).unwrap();
    }
    let len = frame(&call::controller_execute(another, "sleep", 3_600_000), &mut buffer);
    waiting.transport().stream().write_all(&buffer[..len]).unwrap();
    // the replies are being sent
    let mut some = [0; 1000];
    for client in [&mut deaf, &mut slow] {
        client.transport().stream().read_exact(&mut some).unwrap();
    }
    let reader =
        std::thread::spawn(move || while slow.transport().stream().read(&mut some[..100]).is_ok_and(|n| n > 0) {});
    let begun = Instant::now();
    let application = server.stop();
    assert!(begun.elapsed() < TIMEOUT / 2);
    assert_eq!((application.open.len(), application.peers.len()), (0, 0));
    reader.join().unwrap();
}
