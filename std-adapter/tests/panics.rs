//! Panics in every method of a handler, over every link: the call fails, and the server keeps running.

use std::fmt::Debug;
use std::io::Write as _;
use std::net::TcpStream;
use std::time::Duration;

use bcap_core::bcap::call::{self, ControllerHandle};
use bcap_core::bcap::server::{Handler, Request};
use bcap_core::bcap::{FunctionId, Object};
use bcap_core::handler::{Outcome, PeerId, ReplyValue};
use bcap_core::hresult::HResult;
use bcap_core::rac::{self, VariableKind};
use bcap_core::time::Instant;
use bcap_core::variant::Variant;
use bcap_std::Options;
use bcap_std::blocking::{self, Connection, Transport};

use crate::served::{Served, frame};

/// The payload of a panic that panics when it is dropped.
struct Bomb;

impl Drop for Bomb {
    fn drop(&mut self) {
        panic!("in the destructor of a panic's payload");
    }
}

/// A handler that counts its calls and panics in all of them, except those that open objects.
///
/// Over RAC a read of I0 succeeds, I1 panics, I2 panics when it is resumed, and I3 never completes.
#[derive(Debug, Default)]
struct Panicking {
    next_handle: i32,
    calls: usize,
    waiting: usize,
    resumed: usize,
    abandoned: usize,
    left: usize,
    released: Vec<i32>,
}

impl Handler for Panicking {
    fn call(&mut self, _: PeerId, request: &Request<'_>, reply: &mut ReplyValue<'_>, _: Instant) -> Outcome {
        if request.function.releases().is_some() {
            self.released.push(request.handle());
            panic!("on release");
        }
        match request.function.opens() {
            Some(Object::Service) => return HResult::S_OK.into(),
            Some(_) => {
                self.next_handle += 1;
                return reply.set(&self.next_handle).map_or(HResult::E_FAIL, |()| HResult::S_OK).into();
            }
            None => {}
        }
        let command = (request.function == FunctionId::CONTROLLER_EXECUTE).then(|| request.text(1).to_string());
        match command.as_deref() {
            Some("works") => return HResult::S_OK.into(),
            Some("waits") => {
                self.waiting += 1;
                return Outcome::Wait(Instant::FAR_FUTURE);
            }
            Some("resumed") => return Outcome::Wait(Instant::ZERO),
            Some("payload") => std::panic::panic_any(Bomb),
            _ => self.calls += 1,
        }
        // a value that was set before must not be sent
        let _ = reply.set("a value");
        panic!("in a call");
    }

    fn resume(&mut self, _: PeerId, request: &Request<'_>, reply: &mut ReplyValue<'_>, _: Instant) -> Outcome {
        if request.text(1) == "waits" {
            return Outcome::Wait(Instant::FAR_FUTURE);
        }
        self.resumed += 1;
        let _ = reply.set("a value");
        panic!("on resuming a call");
    }

    fn abandoned(&mut self, _: PeerId, _: Instant) {
        self.abandoned += 1;
        panic!("on abandoning a call");
    }

    fn left(&mut self, _: PeerId, _: Instant) {
        self.left += 1;
        panic!("on a peer's end");
    }
}

impl rac::server::Handler for Panicking {
    fn call(&mut self, _: PeerId, request: &rac::Request<'_>, reply: &mut ReplyValue<'_>, _: Instant) -> Outcome {
        let _ = reply.set(&7_i32);
        match request.variable().index {
            0 => HResult::S_OK.into(),
            2 => Outcome::Wait(Instant::ZERO),
            3 => {
                self.waiting += 1;
                Outcome::Wait(Instant::FAR_FUTURE)
            }
            _ => {
                self.calls += 1;
                panic!("in a call");
            }
        }
    }

    fn resume(&mut self, _: PeerId, request: &rac::Request<'_>, _: &mut ReplyValue<'_>, _: Instant) -> Outcome {
        if request.variable().index == 3 {
            return Outcome::Wait(Instant::FAR_FUTURE);
        }
        self.resumed += 1;
        panic!("on resuming a call");
    }

    fn abandoned(&mut self, peer: PeerId, now: Instant) {
        Handler::abandoned(self, peer, now);
    }

    fn left(&mut self, peer: PeerId, now: Instant) {
        Handler::left(self, peer, now);
    }
}

fn start() -> Served<Panicking> {
    Served::start(Panicking::default(), async |server| {
        server.bcap_tcp("127.0.0.1:0").await?.bcap_udp("127.0.0.1:0").await?.rac_tcp("127.0.0.1:0").await
    })
}

/// Options with a long timeout: printing the first backtrace may take seconds.
fn options() -> Options {
    Options::default().timeout(Duration::from_secs(60))
}

/// Makes every call that panics, and leaves its objects open. Returns the handles in the order of their release.
fn call_all<X: Transport<Error: Debug>>(client: &mut Connection<X, Vec<u8>>) -> [i32; 3] {
    let unexpected = Some(HResult::E_UNEXPECTED);
    client.call(call::service_start("InvokeTimeout=100")).unwrap();
    let controller = client.call(call::controller_connect("", "", "", "")).unwrap();
    let released = client.call(call::controller_get_variable(controller, "I1", "")).unwrap();
    let left = client.call(call::controller_get_variable(controller, "I2", "")).unwrap();
    for _ in 0..2 {
        assert_eq!(client.call(call::controller_get_name(controller)).unwrap_err().hresult(), unexpected);
        let resumed = client.call(call::controller_execute(controller, "resumed", ()));
        assert_eq!(resumed.unwrap_err().hresult(), unexpected);
        let abandoned = client.call(call::controller_execute(controller, "waits", ()));
        assert_eq!(abandoned.unwrap_err().hresult(), Some(HResult::E_TIMEOUT));
        let payload = client.call(call::controller_execute(controller, "payload", ()));
        assert_eq!(payload.unwrap_err().hresult(), unexpected);
    }
    assert_eq!(client.call(call::variable_release(released)).unwrap_err().hresult(), unexpected);
    client.call(call::controller_execute(controller, "works", ())).unwrap();
    [left.0, released.0, controller.0]
}

#[test]
fn panics_over_tcp_fail_only_their_calls() {
    let mut server = start();
    let mut client = blocking::connect_tcp(server.tcp(), &options()).unwrap();
    let handles = call_all(&mut client);
    drop(client);
    server.until(|handler| handler.left == 1);
    let mut next = blocking::connect_tcp(server.tcp(), &options()).unwrap();
    call_all(&mut next);
    drop(next);
    server.until(|handler| handler.left == 2);
    server.stop();
    let handler = server.handler();
    assert_eq!((handler.calls, handler.resumed, handler.abandoned), (4, 4, 4));
    // a failed release leaves the object open; a panic while a peer is closed does not prevent the other releases
    assert_eq!(handler.released[..5], [handles[1], handles[0], handles[1], handles[2], 0]);
    assert_eq!(handler.released.len(), 2 * 5);
}

#[test]
fn panics_over_udp_fail_only_their_calls() {
    let mut server = start();
    let address = server.udp();
    let mut client = blocking::connect_udp(address, &options()).unwrap();
    let handles = call_all(&mut client);
    // Service_Stop releases open objects, and is answered although each release panics
    assert_eq!(client.call(call::service_stop()).unwrap_err().hresult(), Some(HResult::E_UNEXPECTED));
    assert_eq!(server.handler().released[1..4], handles);
    // the same task still serves other peers
    let mut next = blocking::connect_udp(address, &options()).unwrap();
    call_all(&mut next);
    server.stop();
    let handler = server.handler();
    assert_eq!((handler.calls, handler.resumed, handler.abandoned, handler.left), (4, 4, 4, 2));
}

#[test]
fn panics_while_a_peer_with_a_waiting_call_is_closed_do_not_stop_the_server() {
    let mut server = start();
    let calling = {
        let mut stream = TcpStream::connect(server.tcp()).unwrap();
        let mut send = |frame: Vec<u8>| stream.write_all(&frame).unwrap();
        send(frame(call::service_start("")));
        send(frame(call::controller_connect("", "", "", "")));
        send(frame(call::controller_execute(ControllerHandle(1), "waits", ())));
        stream
    };
    server.until(|handler| handler.waiting == 1);
    drop(calling);
    server.until(|handler| handler.left == 1);
    server.stop();
    let handler = server.handler();
    assert_eq!((handler.abandoned, &handler.released[..]), (1, &[1, 0][..]));
}

#[test]
fn panics_over_rac_fail_only_their_requests() {
    let mut server = start();
    let mut client = blocking::connect_rac(server.rac(), &options()).unwrap();
    let variable = |index| rac::Variable::new(VariableKind::I, index);
    for _ in 0..2 {
        for index in [1, 2] {
            assert_eq!(client.get(variable(index)).unwrap_err().hresult(), Some(HResult::E_UNEXPECTED));
        }
        assert_eq!(client.get(variable(0)).unwrap(), Variant::I4(7));
    }
    // a waiting request is abandoned when its client disconnects
    let mut gone = TcpStream::connect(server.rac()).unwrap();
    gone.write_all(b"GET:RC8:3:I:\r").unwrap();
    server.until(|handler| handler.waiting == 1);
    drop((gone, client));
    server.until(|handler| handler.left == 2);
    server.stop();
    let handler = server.handler();
    assert_eq!((handler.calls, handler.resumed, handler.abandoned), (2, 2, 1));
}
