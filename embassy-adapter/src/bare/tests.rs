extern crate std;

use std::vec;
use std::vec::Vec;

use bcap_core::bcap::call::{self, VariableHandle};
use bcap_core::bcap::client::{ClientError, Config, Timeout, Timing};
use bcap_core::bcap::{FunctionId, Header, server};
use bcap_core::handler::{Outcome, ReplyValue};
use bcap_core::hresult::HResult;
use bcap_core::variant::Variant;
use smoltcp::iface::{self, Interface, SocketHandle, SocketSet};
use smoltcp::phy::{Loopback, Medium};
use smoltcp::wire::{EthernetAddress, IpAddress, IpCidr};

use super::*;

const HOST: IpAddress = IpAddress::v4(127, 0, 0, 1);

/// A loopback network with a manual clock.
struct Net {
    device: Loopback,
    interface: Interface,
    sockets: SocketSet<'static>,
    now: Instant,
}

impl Net {
    fn new() -> Self {
        let mut device = Loopback::new(Medium::Ethernet);
        let config = iface::Config::new(EthernetAddress([2, 0, 0, 0, 0, 1]).into());
        let mut interface = Interface::new(config, &mut device, to_smoltcp(Instant::ZERO));
        interface.update_ip_addrs(|addresses| addresses.push(IpCidr::new(HOST, 8)).unwrap());
        Self { device, interface, sockets: SocketSet::new(vec![]), now: Instant::ZERO }
    }

    fn tcp(&mut self) -> SocketHandle {
        let memory = || tcp::SocketBuffer::new(vec![0; 512]);
        self.sockets.add(tcp::Socket::new(memory(), memory()))
    }

    fn udp(&mut self, port: u16) -> SocketHandle {
        let memory = || udp::PacketBuffer::new(vec![udp::PacketMetadata::EMPTY; 4], vec![0; 1024]);
        let mut socket = udp::Socket::new(memory(), memory());
        socket.bind(port).unwrap();
        self.sockets.add(socket)
    }

    fn connect(&mut self, handle: SocketHandle, from: u16) {
        let socket = self.sockets.get_mut::<tcp::Socket<'_>>(handle);
        set_up(socket);
        socket.connect(self.interface.context(), (HOST, 5007), from).unwrap();
    }

    fn step(&mut self) {
        self.now = self.now + core::time::Duration::from_millis(1);
        self.interface.poll(to_smoltcp(self.now), &mut self.device, &mut self.sockets);
    }
}

/// A controller whose variables all have the value 42.
#[derive(Default)]
struct Answer {
    left: usize,
}

impl server::Handler for Answer {
    fn call(&mut self, _: PeerId, request: &server::Request<'_>, reply: &mut ReplyValue<'_>, _: Instant) -> Outcome {
        let set = match request.function {
            FunctionId::CONTROLLER_CONNECT | FunctionId::CONTROLLER_GET_VARIABLE => reply.set(&1),
            FunctionId::VARIABLE_GET_VALUE => reply.set(&42),
            _ => Ok(()),
        };
        set.map_or(HResult::E_FAIL, |()| HResult::S_OK).into()
    }

    fn left(&mut self, _: PeerId, _: Instant) {
        self.left += 1;
    }
}

fn session() -> server::Session<[u8; 512], [u8; 512], 8> {
    server::Session::new(server::Config::TCP, [0; 512], [0; 512])
}

/// A client and its server on a loopback network.
struct Pair {
    net: Net,
    client: Client<[u8; 512]>,
    client_socket: SocketHandle,
    server: TcpServer<server::Session<[u8; 512], [u8; 512], 8>>,
    server_socket: SocketHandle,
    handler: Answer,
}

impl Pair {
    fn new() -> Self {
        let mut net = Net::new();
        let (client_socket, server_socket) = (net.tcp(), net.tcp());
        Self {
            net,
            client: Client::new(Config::TCP, [0; 512], [0; 512]),
            client_socket,
            server: TcpServer::new(5007, 0, 1),
            server_socket,
            handler: Answer::default(),
        }
    }

    fn serve(&mut self) {
        let socket = self.net.sockets.get_mut(self.server_socket);
        self.server.poll(socket, session, &mut self.handler, self.net.now);
    }

    /// Advances the time until the client has an event.
    fn event(&mut self) -> Result<Event, LinkError> {
        for _ in 0..10_000 {
            self.net.step();
            self.serve();
            let socket = self.net.sockets.get_mut(self.client_socket);
            if let Some(event) = poll_tcp(&mut self.client, socket, self.net.now)? {
                return Ok(event);
            }
        }
        panic!("no event within 10 s");
    }

    fn call<C: call::Call>(&mut self, call: C) -> Result<Event, LinkError> {
        self.client.start(&call, self.client.timing(), self.net.now).unwrap();
        self.event()
    }
}

#[test]
fn tcp_server_serves_consecutive_connections() {
    let mut pair = Pair::new();
    for round in 0..3 {
        pair.serve();
        pair.net.connect(pair.client_socket, 40_000 + round);
        assert_eq!(pair.call(call::service_start("")), Ok(Event::Replied(HResult::S_OK)));
        // this session has not issued the handle
        assert_eq!(
            pair.call(call::variable_get_value(VariableHandle(1))),
            Ok(Event::Replied(HResult::E_HANDLE)),
            "round {round}"
        );
        assert_eq!(pair.call(call::controller_connect("", "", "", "")), Ok(Event::Replied(HResult::S_OK)));
        let controller = call::ControllerHandle(1);
        let get = call::controller_get_variable(controller, "I1", "");
        assert_eq!(pair.call(get), Ok(Event::Replied(HResult::S_OK)));
        assert_eq!(pair.call(call::variable_get_value(VariableHandle(1))), Ok(Event::Replied(HResult::S_OK)));
        assert_eq!(pair.client.reply().and_then(|reply| reply.value()), Some(Variant::I4(42)));
        assert!(pair.server.is_connected());

        pair.net.sockets.get_mut::<tcp::Socket<'_>>(pair.client_socket).abort();
        pair.client.reset();
        for _ in 0..10 {
            pair.net.step();
            pair.serve();
        }
        assert_eq!(pair.handler.left, usize::from(round) + 1);
        assert!(!pair.server.is_connected());
    }
}

#[test]
fn closed_and_refused_connections_have_distinct_errors() {
    let mut pair = Pair::new();
    // no socket listens yet
    pair.net.connect(pair.client_socket, 40_000);
    pair.client.start(&call::service_start(""), pair.client.timing(), pair.net.now).unwrap();
    let refused = (0..10).find_map(|_| {
        pair.net.step();
        let socket = pair.net.sockets.get_mut(pair.client_socket);
        poll_tcp(&mut pair.client, socket, pair.net.now).err()
    });
    assert_eq!(refused, Some(LinkError::Reset));

    pair.client.reset();
    pair.serve();
    pair.net.connect(pair.client_socket, 40_001);
    assert_eq!(pair.call(call::service_start("")), Ok(Event::Replied(HResult::S_OK)));
    // after invalid bytes the server sends an error reply and closes
    let socket = pair.net.sockets.get_mut::<tcp::Socket<'_>>(pair.client_socket);
    socket.send_slice(b"no frame at all ").unwrap();
    assert_eq!(pair.event(), Ok(Event::Stale { serial: 0 }));
    assert_eq!(pair.event(), Err(LinkError::Closed));
    assert_eq!(pair.handler.left, 1);
}

#[test]
fn udp_calls_are_retried_and_other_senders_ignored() {
    let mut net = Net::new();
    let (here, there, stranger) = (net.udp(40_000), net.udp(5007), net.udp(5008));
    let mut client =
        Client::new(Config { timing: Timing { attempts: 2, ..Timing::UDP }, ..Config::UDP }, [0; 488], [0; 505]);
    client.start(&call::service_start(""), client.timing(), net.now).unwrap();
    let peer = IpEndpoint::new(HOST, 5007);
    let mut requests = 0;
    let end = (0..2000).find_map(|_| {
        net.step();
        let server = net.sockets.get_mut::<udp::Socket<'_>>(there);
        while let Ok((request, _)) = server.recv() {
            assert_eq!(Header::read(request).unwrap().function(), FunctionId::SERVICE_START);
            requests += 1;
        }
        // a valid reply, but from the wrong address
        let reply = b"\x01\x10\0\0\0\x01\0\0\0\0\0\0\0\0\0\x04";
        let _ = net.sockets.get_mut::<udp::Socket<'_>>(stranger).send_slice(reply, IpEndpoint::new(HOST, 40_000));
        let socket = net.sockets.get_mut(here);
        match poll_udp(&mut client, socket, peer, net.now).unwrap() {
            Some(Event::Retried { attempt: 2 }) | None => None,
            Some(end) => Some(end),
        }
    });
    assert_eq!(end, Some(Event::Failed(ClientError::Timeout(Timeout::Attempt))));
    assert_eq!(requests, 2);
}

/// Clients over UDP and their server on a loopback network.
struct Datagrams {
    net: Net,
    server: UdpServer<2, 8>,
    socket: SocketHandle,
    handler: Answer,
}

impl Datagrams {
    fn new() -> Self {
        let mut net = Net::new();
        let socket = net.udp(5007);
        Self { net, server: UdpServer::new(1, 3), socket, handler: Answer::default() }
    }

    fn client(&mut self, port: u16) -> (Client<[u8; 488], [u8; 505]>, SocketHandle) {
        (Client::new(Config::UDP, [0; 488], [0; 505]), self.net.udp(port))
    }

    fn step(&mut self) {
        self.net.step();
        let socket = self.net.sockets.get_mut(self.socket);
        self.server.poll(socket, &mut self.handler, self.net.now);
    }

    fn call<C: call::Call>(&mut self, peer: &mut (Client<[u8; 488], [u8; 505]>, SocketHandle), call: C) -> Event {
        peer.0.start(&call, peer.0.timing(), self.net.now).unwrap();
        self.event(peer)
    }

    /// Advances the time until the client has an event.
    fn event(&mut self, (client, socket): &mut (Client<[u8; 488], [u8; 505]>, SocketHandle)) -> Event {
        for _ in 0..10_000 {
            self.step();
            let socket = self.net.sockets.get_mut(*socket);
            if let Some(event) = poll_udp(client, socket, IpEndpoint::new(HOST, 5007), self.net.now).unwrap() {
                return event;
            }
        }
        panic!("no event within 10 s");
    }
}

#[test]
fn udp_server_has_a_session_for_each_peer_and_refuses_one_too_many() {
    let mut bench = Datagrams::new();
    let mut clients = [40_000, 40_001, 40_002].map(|port| bench.client(port));
    let [first, second, third] = &mut clients;
    let ok = Event::Replied(HResult::S_OK);
    // not b-CAP: no answer, and no slot
    let stranger = bench.net.udp(40_003);
    let socket = bench.net.sockets.get_mut::<udp::Socket<'_>>(stranger);
    socket.send_slice(b"no frame", IpEndpoint::new(HOST, 5007)).unwrap();
    socket.send_slice(&[1; 600], IpEndpoint::new(HOST, 5007)).unwrap();
    for client in [&mut *first, &mut *second] {
        assert_eq!(bench.call(client, call::service_start("")), ok);
        assert_eq!(bench.call(client, call::controller_connect("", "", "", "")), ok);
    }
    assert!(!bench.net.sockets.get_mut::<udp::Socket<'_>>(stranger).can_recv());
    assert_eq!(bench.call(third, call::service_start("")), Event::Replied(HResult::E_MAX_CONNECT));
    // handles belong to their peer
    let get = call::controller_get_variable(call::ControllerHandle(1), "I1", "");
    assert_eq!(bench.call(first, get), ok);
    assert_eq!(bench.call(first, call::variable_get_value(VariableHandle(1))), ok);
    assert_eq!(first.0.reply().and_then(|reply| reply.value()), Some(Variant::I4(42)));
    assert_eq!(bench.call(second, call::variable_get_value(VariableHandle(1))), Event::Replied(HResult::E_HANDLE));
    assert_eq!(bench.handler.left, 0);
    // a silent peer makes room
    bench.net.now = bench.net.now + UDP_IDLE;
    assert_eq!(bench.call(second, call::variable_get_value(VariableHandle(1))), Event::Replied(HResult::E_HANDLE));
    assert_eq!(bench.call(third, call::service_start("")), ok);
    assert_eq!(bench.handler.left, 1);
    assert_eq!(bench.server.last, 1 + 3 * 3, "the numbers of three peers");
}

#[test]
fn udp_server_leaves_requests_in_the_socket_until_there_is_room_for_replies() {
    let mut bench = Datagrams::new();
    let (mut client, handle) = bench.client(40_000);
    client.start(&call::service_start(""), client.timing(), bench.net.now).unwrap();
    let socket = bench.net.sockets.get_mut(handle);
    assert_eq!(poll_udp(&mut client, socket, IpEndpoint::new(HOST, 5007), bench.net.now), Ok(None));
    for _ in 0..4 {
        bench.net.step();
    }
    let server = bench.net.sockets.get_mut::<udp::Socket<'_>>(bench.socket);
    while server.can_send() {
        server.send_slice(b"x", IpEndpoint::new(HOST, 40_000)).unwrap();
    }
    bench.server.poll(server, &mut bench.handler, bench.net.now);
    assert!(server.can_recv(), "the request waits");
    let mut found = Vec::new();
    for _ in 0..20 {
        bench.step();
        while let Ok((reply, _)) = bench.net.sockets.get_mut::<udp::Socket<'_>>(handle).recv() {
            found.push(reply.to_vec());
        }
    }
    let reply = found.pop().unwrap();
    assert_eq!((found, reply.len()), (vec![b"x".to_vec(); 4], 16));
    assert_eq!(Header::read(&reply).unwrap().hresult(), HResult::S_OK);
}

#[test]
fn udp_server_discards_replies_to_addresses_that_do_not_exist() {
    // no host has the first address, and the second has no route
    for unused in [IpAddress::v4(127, 0, 0, 9), IpAddress::v4(10, 0, 0, 9)] {
        let mut bench = Datagrams::new();
        let mut client = bench.client(40_000);
        assert_eq!(bench.call(&mut client, call::service_start("")), Event::Replied(HResult::S_OK));
        let server = bench.net.sockets.get_mut::<udp::Socket<'_>>(bench.socket);
        server.send_slice(b"x", IpEndpoint::new(unused, 40_000)).unwrap();
        bench.step();
        assert_eq!(bench.server.poll_timeout(), Some(bench.net.now.saturating_add(UNSENT)), "{unused}");
        let mut event = bench.call(&mut client, call::controller_connect("", "", "", ""));
        // smoltcp sends no datagram of a socket for a second after an ARP request
        while let Event::Retried { attempt: 2 | 3 } = event {
            event = bench.event(&mut client);
        }
        assert_eq!(event, Event::Replied(HResult::S_OK), "{unused}");
        assert_eq!(bench.server.poll_timeout(), None);
    }
}
