//! Blocking and tokio clients against the server, over loopback sockets.

use std::collections::HashMap;
use std::io::{Read as _, Write as _};
use std::net::{SocketAddr, TcpStream};
use std::ops::ControlFlow;
use std::time::Duration;

use bcap_core::bcap::call::{self, VariableHandle};
use bcap_core::bcap::client::{ClientError, Timeout};
use bcap_core::bcap::server::{Handler, Request};
use bcap_core::bcap::{FunctionId, Object};
use bcap_core::handler::{Outcome, PeerId, ReplyValue};
use bcap_core::hresult::HResult;
use bcap_core::io::CallError;
use bcap_core::time::Instant;
use bcap_core::variant::{Variant, VariantBuf};
use bcap_std::server::{Limits, Server};
use bcap_std::{Options, asynch, blocking};
use tokio::sync::oneshot;

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
                let name = request.text(1).to_string();
                assert_ne!(name, "panic", "on request of the test");
                let number = name.parse().unwrap_or(0);
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

/// A server in its own thread; dropping this stops it.
struct Running {
    tcp: SocketAddr,
    udp: SocketAddr,
    store: std::sync::Arc<std::sync::Mutex<Store>>,
    stop: Option<oneshot::Sender<()>>,
    thread: Option<std::thread::JoinHandle<()>>,
}

fn start(limits: Limits) -> Running {
    start_with(limits, |server| server)
}

fn start_with(limits: Limits, set_up: fn(Server<Store>) -> Server<Store>) -> Running {
    let store = std::sync::Arc::default();
    let handler = std::sync::Arc::clone(&store);
    let (stop, stopped) = oneshot::channel();
    let (sender, addresses) = std::sync::mpsc::channel();
    let thread = std::thread::spawn(move || {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
        runtime.block_on(async {
            let server = set_up(Server::with_shared(handler)).limits(limits);
            let server = server.bcap_tcp("127.0.0.1:0").await.unwrap().bcap_udp("127.0.0.1:0").await.unwrap();
            sender.send(server.addresses()).unwrap();
            let shutdown = async {
                let _ = stopped.await;
            };
            server.run(shutdown).await.unwrap();
        });
    });
    let addresses = addresses.recv().unwrap();
    let (tcp, udp) = (addresses.bcap_tcp[0], addresses.bcap_udp[0]);
    Running { tcp, udp, store, stop: Some(stop), thread: Some(thread) }
}

impl Running {
    /// Stops the server and joins its thread.
    fn stop(&mut self) {
        drop(self.stop.take());
        if let Some(thread) = self.thread.take() {
            thread.join().unwrap();
        }
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        self.stop();
    }
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
    session!(blocking::connect_tcp(server.tcp, &options).unwrap(), "1");
    session!(blocking::connect_udp(server.udp, &options).unwrap(), "2");
    session!(blocking::connect_tcp(("localhost", server.tcp.port()), &options).unwrap(), "1");
}

#[tokio::test]
async fn tokio_clients_work_over_both_links_and_from_any_task() {
    let server = start(Limits::default());
    let (tcp, udp) = (server.tcp, server.udp);
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
    if frame[9..13] == HResult::E_NOTIMPL.0.to_le_bytes() {
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
    let options = Options::default().timeout(Duration::from_secs(1));
    let mut client = blocking::connect_tcp(server.tcp, &options).unwrap();
    client.call(call::service_start("")).unwrap();
    let controller = client.call(call::controller_connect("", "", "", "")).unwrap();
    let lost = client.call(call::controller_get_variable(controller, "1", "")).unwrap_err();
    assert!(matches!(lost, CallError::Client(ClientError::Timeout(_))), "{lost}");
    client.call(call::controller_get_variable(controller, "1", "")).unwrap();
    let closed = client.call(call::controller_get_name(controller)).unwrap_err();
    assert!(closed.hresult().is_none(), "{closed}");
    assert!(!matches!(closed, CallError::Client(ClientError::Timeout(_))), "{closed}");
    assert_eq!(server.store.lock().unwrap().sent, 5);

    // the sixth frame is dropped, and the UDP client retransmits
    let mut client = blocking::connect_udp(server.udp, &Options::default().timeout(Duration::from_secs(2))).unwrap();
    client.call(call::service_start("")).unwrap();
    let store = server.store.lock().unwrap();
    assert_eq!((store.sent, store.left.len()), (7, 1));
}

#[test]
fn a_large_value_grows_the_buffers() {
    let server = start(Limits::default());
    let mut client = blocking::connect_tcp(server.tcp, &Options::default()).unwrap();
    client.call(call::service_start("")).unwrap();
    let controller = client.call(call::controller_connect("", "", "", "")).unwrap();
    let variable = client.call(call::controller_get_variable(controller, "1", "")).unwrap();
    // larger than the store holds; the refusal shows that the whole frame arrived
    let error = client.call(call::variable_put_value(variable, &vec![1.0; 200_000][..])).unwrap_err();
    assert_eq!(error.hresult(), Some(HResult::E_OUTOFMEMORY));
}

#[test]
fn a_waiting_call_is_kept_alive_and_resumed_by_another_client_s_change() {
    let server = start(Limits::default());
    let options = Options::default().timeout(Duration::from_secs(1));
    let address = server.tcp;
    let waiting = std::thread::spawn(move || {
        let mut client = blocking::connect_tcp(address, &options).unwrap();
        client.call(call::service_start("WDT=80")).unwrap();
        let controller = client.call(call::controller_connect("", "", "", "")).unwrap();
        // takes longer than the attempt timeout, so it depends on keep-alives
        client.call(call::controller_execute(controller, "wait", ())).map(|v| v == Variant::Empty)
    });
    until(|| server.store.lock().unwrap().executed >= 3);
    std::thread::sleep(Duration::from_millis(1500));
    let mut other = blocking::connect_udp(server.udp, &Options::default()).unwrap();
    other.call(call::service_start("")).unwrap();
    let controller = other.call(call::controller_connect("", "", "", "")).unwrap();
    let variable = other.call(call::controller_get_variable(controller, "9", "")).unwrap();
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
    assert_eq!(error.to_string(), "cannot resolve the address \"no-such-host.invalid:5007\"");
}

#[test]
fn a_connection_over_the_limit_is_answered_e_max_connect() {
    let server = start(Limits::default().connections(1));
    let mut first = blocking::connect_tcp(server.tcp, &Options::default()).unwrap();
    first.call(call::service_start("")).unwrap();
    let mut second = blocking::connect_tcp(server.tcp, &Options::default()).unwrap();
    let error = second.call(call::service_start("")).unwrap_err();
    assert_eq!(error.hresult(), Some(HResult::E_MAX_CONNECT));
    first.call(call::controller_connect("", "", "", "")).unwrap();
}

#[test]
fn one_address_cannot_exceed_its_share_of_the_slots() {
    let server = start(Limits::default().connections_per_address(1).udp_peers_per_address(1));
    let refused = Some(HResult::E_MAX_CONNECT);
    let mut first = blocking::connect_tcp(server.tcp, &Options::default()).unwrap();
    first.call(call::service_start("")).unwrap();
    let mut second = blocking::connect_tcp(server.tcp, &Options::default()).unwrap();
    assert_eq!(second.call(call::service_start("")).unwrap_err().hresult(), refused);
    let mut first = blocking::connect_udp(server.udp, &Options::default()).unwrap();
    first.call(call::service_start("")).unwrap();
    let mut second = blocking::connect_udp(server.udp, &Options::default()).unwrap();
    assert_eq!(second.call(call::service_start("")).unwrap_err().hresult(), refused);
}

#[test]
fn the_longest_idle_connection_is_evicted_for_a_new_one() {
    let server = start(Limits::default().connections(2).evict_after(Duration::ZERO));
    let mut clients = [(); 2].map(|()| blocking::connect_tcp(server.tcp, &Options::default()).unwrap());
    // the second is idle longest
    for n in [0, 1, 0] {
        clients[n].call(call::service_start("")).unwrap();
    }
    let mut late = blocking::connect_tcp(server.tcp, &Options::default()).unwrap();
    late.call(call::service_start("")).unwrap();
    clients[0].call(call::service_start("")).unwrap();
    until(|| server.store.lock().unwrap().left.len() == 1);
    assert!(matches!(clients[1].call(call::service_start("")), Err(CallError::Disconnected | CallError::Io(_))));
}

#[test]
fn a_connection_with_a_running_call_is_not_evicted() {
    let server = start(Limits::default().connections(1).evict_after(Duration::ZERO));
    let (address, options) = (server.tcp, Options::default().timeout(Duration::from_secs(30)));
    let waiting = std::thread::spawn(move || {
        let mut client = blocking::connect_tcp(address, &options).unwrap();
        client.call(call::service_start("")).unwrap();
        let controller = client.call(call::controller_connect("", "", "", "")).unwrap();
        client.call(call::controller_execute(controller, "wait", ())).map(|value| value == Variant::Empty)
    });
    until(|| server.store.lock().unwrap().executed >= 3);
    let mut late = blocking::connect_tcp(server.tcp, &Options::default()).unwrap();
    assert_eq!(late.call(call::service_start("")).unwrap_err().hresult(), Some(HResult::E_MAX_CONNECT));
    let mut other = blocking::connect_udp(server.udp, &Options::default()).unwrap();
    other.call(call::service_start("")).unwrap();
    let controller = other.call(call::controller_connect("", "", "", "")).unwrap();
    let variable = other.call(call::controller_get_variable(controller, "9", "")).unwrap();
    other.call(call::variable_put_value(variable, 1)).unwrap();
    assert!(waiting.join().unwrap().unwrap());
}

#[test]
fn a_udp_peer_over_the_limit_is_answered_e_max_connect() {
    let server = start(Limits::default().udp_peers(1));
    let mut first = blocking::connect_udp(server.udp, &Options::default()).unwrap();
    first.call(call::service_start("")).unwrap();
    let mut second = blocking::connect_udp(server.udp, &Options::default()).unwrap();
    assert_eq!(second.call(call::service_start("")).unwrap_err().hresult(), Some(HResult::E_MAX_CONNECT));
    first.call(call::controller_connect("", "", "", "")).unwrap();
}

#[test]
fn a_udp_peer_frees_its_slot_with_service_stop() {
    let server = start(Limits::default().udp_peers(2));
    let mut first = blocking::connect_udp(server.udp, &Options::default()).unwrap();
    first.call(call::service_start("")).unwrap();
    for _ in 0..5 {
        let mut other = blocking::connect_udp(server.udp, &Options::default()).unwrap();
        other.call(call::service_start("")).unwrap();
        other.call(call::service_stop()).unwrap();
    }
    first.call(call::controller_connect("", "", "", "")).unwrap();
}

#[test]
fn open_objects_of_a_peer_are_released_in_reverse_order() {
    let mut server = start(Limits::default());
    let mut client = blocking::connect_tcp(server.tcp, &Options::default()).unwrap();
    client.call(call::service_start("")).unwrap();
    let controller = client.call(call::controller_connect("", "", "", "")).unwrap();
    let first = client.call(call::controller_get_variable(controller, "1", "")).unwrap();
    let second = client.call(call::controller_get_variable(controller, "2", "")).unwrap();
    // the connection is still open when the server stops
    server.stop();
    let store = server.store.lock().unwrap();
    assert_eq!(store.released, [second.0, first.0, controller.0, 0]);
    assert_eq!(store.left.len(), 1);
    drop(store);
    assert!(matches!(client.call(call::service_stop()), Err(CallError::Disconnected | CallError::Io(_))));
}

#[test]
fn an_invalid_frame_is_answered_and_the_connection_closed() {
    let server = start(Limits::default());
    let mut stream = TcpStream::connect(server.tcp).unwrap();
    stream.set_read_timeout(Some(Duration::from_secs(5))).unwrap();
    stream.write_all(b"GET / HTTP/1.1\r\n\r\n").unwrap();
    let mut answer = Vec::new();
    stream.read_to_end(&mut answer).unwrap();
    assert_eq!(answer, b"\x01\x10\0\0\0\0\0\0\0\x01\0\x01\x80\0\0\x04");
    session!(blocking::connect_tcp(server.tcp, &Options::default()).unwrap(), "1");
}

#[test]
fn a_partly_received_request_times_out() {
    let server = start(Limits::default().receive(Duration::from_millis(150)));
    let mut stream = TcpStream::connect(server.tcp).unwrap();
    stream.set_read_timeout(Some(Duration::from_secs(5))).unwrap();
    stream.write_all(b"\x01").unwrap();
    assert_eq!(stream.read(&mut [0; 16]).unwrap(), 0);
}

#[test]
fn a_panic_of_the_handler_fails_only_its_call() {
    let server = start(Limits::default());
    // printing the first backtrace may take seconds
    let options = Options::default().timeout(Duration::from_secs(30));
    let mut tcp = blocking::connect_tcp(server.tcp, &options).unwrap();
    let mut udp = blocking::connect_udp(server.udp, &options).unwrap();
    tcp.call(call::service_start("")).unwrap();
    udp.call(call::service_start("")).unwrap();
    let controller = tcp.call(call::controller_connect("", "", "", "")).unwrap();
    let its_own = udp.call(call::controller_connect("", "", "", "")).unwrap();
    for _ in 0..3 {
        let error = tcp.call(call::controller_get_variable(controller, "panic", "")).unwrap_err();
        assert_eq!(error.hresult(), Some(HResult::E_UNEXPECTED));
        let error = udp.call(call::controller_get_variable(its_own, "panic", "")).unwrap_err();
        assert_eq!(error.hresult(), Some(HResult::E_UNEXPECTED));
    }
    // two services, two controllers, and six calls that panicked once each
    assert_eq!(server.store.lock().unwrap().executed, 4 + 6);
    let variable = tcp.call(call::controller_get_variable(controller, "5", "")).unwrap();
    tcp.call(call::variable_put_value(variable, &7)).unwrap();
    let variable = udp.call(call::controller_get_variable(its_own, "5", "")).unwrap();
    assert_eq!(udp.call(call::variable_get_value(variable)).unwrap(), Variant::I4(7));
}

#[test]
fn large_requests_and_replies_share_the_memory_pool() {
    let server = start(Limits::default().memory(100 << 10));
    let connect = || {
        let mut client = blocking::connect_tcp(server.tcp, &Options::default()).unwrap();
        client.call(call::service_start("")).unwrap();
        let controller = client.call(call::controller_connect("", "", "", "")).unwrap();
        let variable = client.call(call::controller_get_variable(controller, "1", "")).unwrap();
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

/// Waits until `condition` holds, at most 30 s.
#[track_caller]
fn until(mut condition: impl FnMut() -> bool) {
    let begin = std::time::Instant::now();
    while !condition() {
        assert!(begin.elapsed() < Duration::from_secs(30), "the condition did not hold within 30 s");
        std::thread::sleep(Duration::from_millis(50));
    }
}

#[test]
fn invalid_datagrams_create_no_peer() {
    // there is one slot: a peer created by garbage would be evicted for the client, and counted in `left`
    let server = start(Limits::default().udp_peers(1).udp_idle(Duration::ZERO));
    let socket = std::net::UdpSocket::bind("127.0.0.1:0").unwrap();
    for garbage in [&b""[..], b"\x01", b"hello", &[1; 600], &[0xff; 504]] {
        socket.send_to(garbage, server.udp).unwrap();
    }
    session!(blocking::connect_udp(server.udp, &Options::default()).unwrap(), "2");
    assert_eq!(server.store.lock().unwrap().left.len(), 0, "no peer was evicted");
}
