//! Blocking and tokio clients against the server, over loopback sockets.

use std::collections::HashMap;
use std::fmt::Debug;
use std::ops::ControlFlow;
use std::time::Duration;

use bcap_core::bcap::call::{self, VariableHandle};
use bcap_core::bcap::client::{ClientError, Timeout};
use bcap_core::bcap::server::{Handler, Request};
use bcap_core::bcap::{FunctionId, Header, Object};
use bcap_core::handler::{Outcome, PeerId, ReplyValue};
use bcap_core::hresult::HResult;
use bcap_core::io::CallError;
use bcap_core::time::Instant;
use bcap_core::variant::{Variant, VariantBuf};
use bcap_std::blocking::{self, Connection, Transport};
use bcap_std::server::{Limits, Server};
use bcap_std::{Options, asynch};

use crate::served::{Served, until};

/// A handler with variables by number. An Execute call waits until a client writes variable 9.
#[derive(Default)]
struct Store {
    values: HashMap<i32, VariantBuf<512>>,
    next_handle: i32,
    names: HashMap<i32, i32>,
    left: Vec<PeerId>,
    released: Vec<i32>,
    executed: usize,
    /// The number of frames that a tap has seen.
    sent: usize,
}

impl Handler for Store {
    fn call(&mut self, _: PeerId, request: &Request<'_>, reply: &mut ReplyValue<'_>, _: Instant) -> Outcome {
        self.executed += 1;
        match request.function {
            FunctionId::CONTROLLER_GET_VARIABLE => {
                self.next_handle += 1;
                let number = request.text(1).to_string().parse().unwrap_or(0);
                self.names.insert(self.next_handle, number);
                let _ = reply.set(&self.next_handle);
            }
            FunctionId::VARIABLE_GET_VALUE => {
                if let Some(value) = self.names.get(&request.handle()).and_then(|n| self.values.get(n)) {
                    let _ = reply.set(value);
                }
            }
            FunctionId::VARIABLE_PUT_VALUE => {
                let Ok(value) = VariantBuf::new(&request.value(1)) else { return HResult::E_OUTOFMEMORY.into() };
                self.values.insert(self.names[&request.handle()], value);
            }
            FunctionId::CONTROLLER_EXECUTE if !self.values.contains_key(&9) => {
                return Outcome::Wait(Instant::FAR_FUTURE);
            }
            FunctionId::CONTROLLER_EXECUTE => {}
            function if function.opens().is_some_and(|object| object != Object::Service) => {
                self.next_handle += 1;
                let _ = reply.set(&self.next_handle);
            }
            function if function.releases().is_some() => self.released.push(request.handle()),
            FunctionId::SERVICE_START => {}
            _ => return HResult::E_NOTIMPL.into(),
        }
        HResult::S_OK.into()
    }

    fn left(&mut self, peer: PeerId, _: Instant) {
        self.left.push(peer);
    }
}

fn start(limits: Limits) -> Served<Store> {
    start_with(limits, |server| server)
}

fn start_with(limits: Limits, set_up: fn(Server<Store>) -> Server<Store>) -> Served<Store> {
    Served::start(Store::default(), async move |server| {
        set_up(server).limits(limits).bcap_tcp("127.0.0.1:0").await?.bcap_udp("127.0.0.1:0").await
    })
}

/// Begins a session and opens a variable.
fn opened<X: Transport<Error: Debug>>(client: &mut Connection<X, Vec<u8>>, name: &str) -> VariableHandle {
    client.call(call::service_start("")).unwrap();
    let controller = client.call(call::controller_connect("", "", "", "")).unwrap();
    client.call(call::controller_get_variable(controller, name, "")).unwrap()
}

/// Connects, writes a variable and reads it back.
macro_rules! session {
    ($client:expr, $name:literal $($wait:tt)*) => {{
        let client = &mut $client;
        client.call(call::service_start("WDT=100"))$($wait)*.unwrap();
        let controller = client.call(call::controller_connect("", "", "", ""))$($wait)*.unwrap();
        let variable = client.call(call::controller_get_variable(controller, $name, ""))$($wait)*.unwrap();
        for n in 0..50 {
            client.call(call::variable_put_value(variable, [n, -n]))$($wait)*.unwrap();
            let value = client.call(call::variable_get_value(variable))$($wait)*.unwrap();
            assert_eq!(value.as_array().and_then(|a| a.items::<i32>()).and_then(|i| i.to_array()), Some([n, -n]));
        }
        let error = client.call(call::controller_get_name(controller))$($wait)*.unwrap_err();
        assert_eq!(error.hresult(), Some(HResult::E_NOTIMPL));
        let error = client.call(call::variable_get_value(VariableHandle(99)))$($wait)*.unwrap_err();
        assert_eq!(error.hresult(), Some(HResult::E_HANDLE));
        client.call(call::service_stop())$($wait)*.unwrap();
    }};
}

#[test]
fn blocking_clients_work_over_both_links_and_by_name() {
    let server = start(Limits::default());
    let options = Options::default();
    session!(blocking::connect_tcp(server.tcp(), &options).unwrap(), "1");
    session!(blocking::connect_udp(server.udp(), &options).unwrap(), "2");
    session!(blocking::connect_tcp(("localhost", server.tcp().port()), &options).unwrap(), "1");
}

#[tokio::test]
async fn tokio_clients_work_over_both_links_and_from_any_task() {
    let server = start(Limits::default());
    let (tcp, udp) = (server.tcp(), server.udp());
    let over_tcp = tokio::spawn(async move {
        session!(asynch::connect_tcp(tcp, &Options::default()).await.unwrap(), "1".await);
    });
    let over_udp = tokio::spawn(async move {
        session!(asynch::connect_udp(udp, &Options::default()).await.unwrap(), "2".await);
    });
    over_tcp.await.unwrap();
    over_udp.await.unwrap();
}

/// Closes the connection instead of sending E_NOTIMPL, and drops every third frame.
fn tap(store: &mut Store, _: PeerId, frame: &mut Vec<u8>) -> ControlFlow<()> {
    store.sent += 1;
    if Header::read(frame).is_some_and(|reply| reply.hresult() == HResult::E_NOTIMPL) {
        return ControlFlow::Break(());
    }
    if store.sent.is_multiple_of(3) {
        frame.clear();
    }
    ControlFlow::Continue(())
}

#[test]
fn a_tap_can_count_drop_and_disconnect() {
    let server = start_with(Limits::default(), |server| server.tap(tap));
    let options = Options::default().timeout(Duration::from_secs(3));
    let mut client = blocking::connect_tcp(server.tcp(), &options).unwrap();
    client.call(call::service_start("")).unwrap();
    let controller = client.call(call::controller_connect("", "", "", "")).unwrap();
    let lost = client.call(call::controller_get_variable(controller, "1", "")).unwrap_err();
    assert!(matches!(lost, CallError::Client(ClientError::Timeout(_))), "{lost}");
    client.call(call::controller_get_variable(controller, "1", "")).unwrap();
    let closed = client.call(call::controller_get_name(controller)).unwrap_err();
    assert!(closed.hresult().is_none(), "{closed}");
    assert!(!matches!(closed, CallError::Client(ClientError::Timeout(_))), "{closed}");
    assert_eq!(server.handler().sent, 5);

    // the sixth frame is dropped, and the UDP client retransmits
    let mut client = blocking::connect_udp(server.udp(), &Options::default().timeout(Duration::from_secs(2))).unwrap();
    client.call(call::service_start("")).unwrap();
    let store = server.handler();
    assert_eq!((store.sent, store.left.len()), (7, 1));
}

#[test]
fn a_waiting_call_is_kept_alive_and_resumed_by_another_client_s_change() {
    let server = start(Limits::default());
    let options = Options::default().timeout(Duration::from_secs(3));
    let address = server.tcp();
    let waiting = std::thread::spawn(move || {
        let mut client = blocking::connect_tcp(address, &options).unwrap();
        client.call(call::service_start("WDT=80")).unwrap();
        let controller = client.call(call::controller_connect("", "", "", "")).unwrap();
        // takes longer than the attempt timeout, so it depends on keep-alives
        client.call(call::controller_execute(controller, "wait", ())).map(|v| v == Variant::Empty)
    });
    server.until(|store| store.executed >= 3);
    std::thread::sleep(Duration::from_millis(4000));
    let mut other = blocking::connect_udp(server.udp(), &Options::default()).unwrap();
    let variable = opened(&mut other, "9");
    other.call(call::variable_put_value(variable, 1)).unwrap();
    assert!(waiting.join().unwrap().unwrap());
}

#[test]
fn a_silent_peer_a_closed_port_and_an_unknown_host_give_different_errors() {
    let silent = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let options = Options::default().timeout(Duration::from_millis(100));
    let mut client = blocking::connect_tcp(silent.local_addr().unwrap(), &options).unwrap();
    let error = client.call(call::service_start("")).unwrap_err();
    assert!(matches!(error, CallError::Client(ClientError::Timeout(Timeout::Attempt))), "{error}");

    let address = silent.local_addr().unwrap();
    drop((client, silent));
    let error = blocking::connect_tcp(address, &options).unwrap_err();
    assert_eq!(error.to_string(), format!("cannot connect to {address}"));
    assert!(!error.is_timeout());
    let error = blocking::connect_tcp("no-such-host.invalid:5007", &options).unwrap_err();
    assert_eq!(error.to_string(), "cannot resolve the address no-such-host.invalid:5007");
}

#[test]
fn one_address_cannot_exceed_its_share_of_the_slots() {
    let server = start(Limits::default().connections_per_address(1).udp_peers_per_address(1));
    let refused = Some(HResult::E_MAX_CONNECT);
    let mut first = blocking::connect_tcp(server.tcp(), &Options::default()).unwrap();
    first.call(call::service_start("")).unwrap();
    let mut second = blocking::connect_tcp(server.tcp(), &Options::default()).unwrap();
    assert_eq!(second.call(call::service_start("")).unwrap_err().hresult(), refused);
    let mut first = blocking::connect_udp(server.udp(), &Options::default()).unwrap();
    first.call(call::service_start("")).unwrap();
    let mut second = blocking::connect_udp(server.udp(), &Options::default()).unwrap();
    assert_eq!(second.call(call::service_start("")).unwrap_err().hresult(), refused);
}

#[test]
fn the_longest_idle_connection_is_evicted_for_a_new_one() {
    let server = start(Limits::default().connections(2).evict_after(Duration::ZERO));
    let mut clients = [(); 2].map(|()| blocking::connect_tcp(server.tcp(), &Options::default()).unwrap());
    // the second is idle longest
    for n in [0, 1, 0] {
        clients[n].call(call::service_start("")).unwrap();
    }
    let mut late = blocking::connect_tcp(server.tcp(), &Options::default()).unwrap();
    late.call(call::service_start("")).unwrap();
    clients[0].call(call::service_start("")).unwrap();
    server.until(|store| store.left.len() == 1);
    assert!(matches!(clients[1].call(call::service_start("")), Err(CallError::Disconnected | CallError::Io(_))));
}

#[test]
fn a_connection_with_a_running_call_is_not_evicted() {
    let server = start(Limits::default().connections(1).evict_after(Duration::ZERO));
    let (address, options) = (server.tcp(), Options::default().timeout(Duration::from_secs(30)));
    let waiting = std::thread::spawn(move || {
        let mut client = blocking::connect_tcp(address, &options).unwrap();
        client.call(call::service_start("")).unwrap();
        let controller = client.call(call::controller_connect("", "", "", "")).unwrap();
        client.call(call::controller_execute(controller, "wait", ())).map(|value| value == Variant::Empty)
    });
    server.until(|store| store.executed >= 3);
    let mut late = blocking::connect_tcp(server.tcp(), &Options::default()).unwrap();
    assert_eq!(late.call(call::service_start("")).unwrap_err().hresult(), Some(HResult::E_MAX_CONNECT));
    let mut other = blocking::connect_udp(server.udp(), &Options::default()).unwrap();
    let variable = opened(&mut other, "9");
    other.call(call::variable_put_value(variable, 1)).unwrap();
    assert!(waiting.join().unwrap().unwrap());
}

#[test]
fn open_objects_of_a_peer_are_released_in_reverse_order() {
    let mut server = start(Limits::default());
    let mut client = blocking::connect_tcp(server.tcp(), &Options::default()).unwrap();
    client.call(call::service_start("")).unwrap();
    let controller = client.call(call::controller_connect("", "", "", "")).unwrap();
    let first = client.call(call::controller_get_variable(controller, "1", "")).unwrap();
    let second = client.call(call::controller_get_variable(controller, "2", "")).unwrap();
    // the connection is still open when the server stops
    server.stop();
    let store = server.handler();
    assert_eq!(store.released, [second.0, first.0, controller.0, 0]);
    assert_eq!(store.left.len(), 1);
    drop(store);
    assert!(matches!(client.call(call::service_stop()), Err(CallError::Disconnected | CallError::Io(_))));
}

#[test]
fn large_requests_and_replies_share_the_memory_pool() {
    let server = start(Limits::default().memory(100 << 10));
    let connect = || {
        let mut client = blocking::connect_tcp(server.tcp(), &Options::default()).unwrap();
        let variable = opened(&mut client, "1");
        (client, variable)
    };
    let large = [0_u8; 60 << 10];
    // the handler refuses the value, which shows that the request arrived
    let arrived = Some(HResult::E_OUTOFMEMORY);
    let refused = Some(HResult::E_PACKETSIZEOVER);

    let (mut first, one) = connect();
    let (mut second, two) = connect();
    assert_eq!(first.call(call::variable_put_value(one, &large[..])).unwrap_err().hresult(), arrived);
    for _ in 0..3 {
        assert_eq!(second.call(call::variable_put_value(two, &large[..])).unwrap_err().hresult(), refused);
        second.call(call::variable_put_value(two, &1)).unwrap();
        // a connection can reuse the memory that it has
        assert_eq!(first.call(call::variable_put_value(one, &large[..])).unwrap_err().hresult(), arrived);
    }

    // a connection returns its memory when it ends, and after 5 s of silence
    drop(first);
    until(|| second.call(call::variable_put_value(two, &large[..])).unwrap_err().hresult() == arrived);
    let (mut third, three) = connect();
    assert_eq!(third.call(call::variable_put_value(three, &large[..])).unwrap_err().hresult(), refused);
    until(|| third.call(call::variable_put_value(three, &large[..])).unwrap_err().hresult() == arrived);
    assert_eq!(second.call(call::variable_put_value(two, &large[..])).unwrap_err().hresult(), refused);
    second.call(call::variable_put_value(two, &2)).unwrap();
}

#[test]
fn invalid_datagrams_create_no_peer() {
    // there is one slot: a peer created by garbage would be evicted for the client, and counted in `left`
    let server = start(Limits::default().udp_peers(1).udp_idle(Duration::ZERO));
    let socket = std::net::UdpSocket::bind("127.0.0.1:0").unwrap();
    for garbage in [&b""[..], b"\x01", b"hello", &[1; 600], &[0xff; 504]] {
        socket.send_to(garbage, server.udp()).unwrap();
    }
    session!(blocking::connect_udp(server.udp(), &Options::default()).unwrap(), "2");
    assert_eq!(server.handler().left.len(), 0, "no peer was evicted");
}
