//! Every async function is dropped at every await point, over two stacks of embassy-net that are joined by a cable in
//! memory: the next call must find transports, servers and the gateway in order.
//!
//! The functions are listed at the end, and the list is compared with the sources. `tests/tests/cancellation` does the
//! same for the core and bcap-std.

use std::cell::RefCell;
use std::collections::BTreeMap;
use std::future::poll_fn;
use std::path::Path;
use std::pin::pin;
use std::task::Poll;

use crate::common::{address, between};
use bcap_core::bcap::call::{self, ControllerHandle};
use bcap_core::bcap::client::{Config, Timing};
use bcap_core::bcap::server::{Handler, Request, Session};
use bcap_core::bcap::{Client, FunctionId, server};
use bcap_core::handler::{Outcome, PeerId, ReplyValue};
use bcap_core::hresult::HResult;
use bcap_core::io::CallError;
use bcap_core::io::asynch::Timer as _;
use bcap_core::rac::{self, VariableKind};
use bcap_core::time::Instant;
use bcap_embassy::clock::{EmbassyClock, now};
use bcap_embassy::gateway::{self, RobotLink as _, TcpRobot, run_robot};
use bcap_embassy::http::{self, Content, Decision, HttpListener, Site, Status};
use bcap_embassy::net::{Connection, NetError, Options, TcpTransport, Transport, UdpTransport};
use bcap_embassy::server::{Limits, Listener, SharedHandler, UdpPeer, UdpServer};
use bcap_gateway::modbus::{self, Entry};
use bcap_gateway::{Allow, Gateway, Memory, Rules};
use bcap_test_support::async_functions::Coverage::{self, Exempt, Swept, Through};
use embassy_futures::join::join;
use embassy_futures::select::{Either, Either3, select, select3};
use embassy_net::tcp::TcpSocket;
use embassy_net::udp::{PacketMetadata, UdpSocket};
use embassy_net::{IpEndpoint, Stack};
use embassy_sync::blocking_mutex::raw::NoopRawMutex;
use embassy_time::{Timer, with_timeout};

const LATER: core::time::Duration = core::time::Duration::from_secs(60);
/// The time limits of the clients: not the defaults; short on UDP, where the tests let them pass.
const TCP: Timing = Timing { attempt_timeout: core::time::Duration::from_millis(2900), ..Timing::TCP };
const UDP: Timing = Timing { attempt_timeout: core::time::Duration::from_millis(40), attempts: 50, ..Timing::UDP };

thread_local! {
    /// At how many await points each function was dropped.
    static POINTS: RefCell<BTreeMap<&'static str, usize>> = const { RefCell::new(BTreeMap::new()) };
}

/// Drops `make`'s future after 1, 2, ... polls, until it ends, with a check after each; counts the await points.
async fn sweep<T>(name: &'static str, mut work: impl AsyncFnMut(usize) -> Option<T>) {
    for polls in 1.. {
        let ended = work(polls).await.is_some();
        POINTS.with_borrow_mut(|points| *points.entry(name).or_default() += usize::from(!ended));
        if ended {
            return;
        }
    }
}

/// Drops a future after `polls` polls, and returns its output if it ended before.
async fn dropped_after<T>(polls: usize, future: impl Future<Output = T>) -> Option<T> {
    let (mut future, mut left) = (pin!(future), polls);
    poll_fn(|context| match future.as_mut().poll(context) {
        Poll::Ready(output) => Poll::Ready(Some(output)),
        Poll::Pending => {
            left -= 1;
            if left == 0 { Poll::Ready(None) } else { Poll::Pending }
        }
    })
    .await
}

/// Runs a test with a background future that never ends. A test that hangs fails.
async fn alongside(background: impl Future, test: impl Future<Output = ()>) {
    let test = with_timeout(embassy_time::Duration::from_secs(120), test);
    let Either::Second(Ok(())) = select(background, test).await else { panic!("it hangs") };
}

/// A controller that counts the executions of each token.
#[derive(Default)]
struct Tokens {
    executed: BTreeMap<i32, u32>,
    left: usize,
    /// A command waits forever.
    waits: bool,
}

/// The answer of the controller to a token.
const fn answer_to(token: i32) -> i32 {
    token.wrapping_mul(3).wrapping_add(1)
}

impl Handler for Tokens {
    fn call(&mut self, _: PeerId, request: &Request<'_>, reply: &mut ReplyValue<'_>, _: Instant) -> Outcome {
        let mut count = |token| *self.executed.entry(token).or_default() += 1;
        let value = match request.function {
            FunctionId::CONTROLLER_CONNECT => 1,
            FunctionId::CONTROLLER_GET_VARIABLE => 7,
            FunctionId::CONTROLLER_GET_ROBOT => 8,
            // slvGetMode: no stream runs
            FunctionId::ROBOT_EXECUTE => 0,
            FunctionId::CONTROLLER_EXECUTE if request.text(1) == "wait" => {
                self.waits = true;
                return Outcome::Wait(Instant::FAR_FUTURE);
            }
            FunctionId::CONTROLLER_EXECUTE => {
                count(request.int(2));
                answer_to(request.int(2))
            }
            FunctionId::VARIABLE_PUT_VALUE => {
                count(request.int(1));
                return HResult::S_OK.into();
            }
            FunctionId::VARIABLE_GET_VALUE => self.executed.len().try_into().unwrap(),
            _ => return HResult::S_OK.into(),
        };
        reply.set(&value).map_or(HResult::E_FAIL, |()| HResult::S_OK).into()
    }

    fn left(&mut self, _: PeerId, _: Instant) {
        self.left += 1;
    }
}

type Controller = SharedHandler<NoopRawMutex, Tokens, 4>;

fn executed(controller: &Controller, token: i32) -> u32 {
    controller.view(|tokens| tokens.executed.get(&token).copied().unwrap_or(0)).unwrap()
}

/// Returns whether no token was executed more than once.
fn ran_once(controller: &Controller) -> bool {
    controller.view(|tokens| tokens.executed.values().all(|count| *count == 1)).unwrap()
}

/// A transport that records until when its client was ready to wait. It does not record the reads before a call, which do
/// not wait.
struct Recorded<X>(X, Vec<Instant>);

impl<X: Transport> Transport for Recorded<X> {
    type Error = X::Error;

    fn now(&self) -> Instant {
        self.0.now()
    }

    async fn send(&mut self, bytes: &[u8], until: Instant) -> Result<Option<usize>, X::Error> {
        self.1.push(until);
        self.0.send(bytes, until).await
    }

    async fn receive(&mut self, buffer: &mut [u8], until: Instant) -> Result<Option<usize>, X::Error> {
        if until > self.0.now() {
            self.1.push(until);
        }
        self.0.receive(buffer, until).await
    }

    async fn sleep_until(&mut self, at: Instant) {
        self.0.sleep_until(at).await;
    }
}

type Robot<X> = Connection<Recorded<X>, [u8; 488], [u8; 505]>;

fn robot<X: Transport>(transport: X, config: Config) -> Robot<X> {
    Connection::new(Recorded(transport, Vec::new()), Client::new(config, [0; 488], [0; 505]))
}

async fn open<X: Transport<Error = NetError>>(robot: &mut Robot<X>) -> ControllerHandle {
    robot.call(call::service_start("")).await.unwrap();
    robot.call(call::controller_connect("", "P", "", "")).await.unwrap()
}

async fn token<X: Transport<Error = NetError>>(
    robot: &mut Robot<X>,
    handle: ControllerHandle,
    token: i32,
) -> Option<i32> {
    let reply = robot.call(call::controller_execute(handle, "token", token)).await;
    reply.ok().and_then(|value| value.as_i32())
}

/// Sends an ordinary call and checks its reply, its time limits and that it was executed once.
async fn check<X: Transport<Error = NetError>>(
    robot: &mut Robot<X>,
    handle: ControllerHandle,
    controller: &Controller,
    number: i32,
) {
    robot.transport().1.clear();
    let timing = robot.client().timing();
    assert!(timing == TCP || timing == UDP, "{timing:?}");
    let before = now();
    assert_eq!(token(robot, handle, number).await, Some(answer_to(number)));
    let first = robot.transport().1[0];
    let range = before.saturating_add(timing.attempt_timeout)..=now().saturating_add(timing.attempt_timeout);
    assert!(range.contains(&first), "{first} is not in {range:?}");
    assert_eq!(executed(controller, number), 1, "token {number}");
    assert!(ran_once(controller));
}

fn session() -> Session<[u8; 512], [u8; 512], 8> {
    Session::new(server::Config::TCP, [0; 512], [0; 512])
}

/// Serves b-CAP on port 5007 forever.
async fn serve(stack: Stack<'_>, controller: &Controller) {
    let (mut rx, mut tx) = ([0; 512], [0; 512]);
    let mut slot = None;
    Listener::new(stack, 5007, &mut rx, &mut tx).run(&mut slot, session, controller, &Limits::default()).await
}

/// Connects; a listener that is just closing the connection before refuses.
async fn connect(transport: &mut TcpTransport<'_>) {
    while transport.connect((address(1), 5007)).await.is_err() {
        Timer::after_millis(1).await;
    }
}

fn number(polls: usize) -> i32 {
    i32::try_from(polls).unwrap() * 10
}

fn tcp_client() {
    between(|_, client, server| async move {
        let controller = Controller::new(Tokens::default());
        let test = async {
            let mut memory = [[0; 512]; 2];
            let [rx, tx] = &mut memory;
            let mut transport = TcpTransport::new(client, rx, tx, Options::default());
            connect(&mut transport).await;
            let mut robot = robot(transport, Config { timing: TCP, ..Config::TCP });
            let handle = open(&mut robot).await;
            sweep("TcpTransport::receive", async |polls| {
                let ended = dropped_after(polls, token(&mut robot, handle, number(polls))).await;
                check(&mut robot, handle, &controller, number(polls) + 1).await;
                ended
            })
            .await;
            for (name, closes) in [("TcpTransport::connect", false), ("TcpTransport::close", true)] {
                sweep(name, async |polls| {
                    let transport = &mut robot.transport().0;
                    let ended = match closes {
                        true => dropped_after(polls, transport.close()).await,
                        false => dropped_after(polls, transport.connect((address(1), 5007))).await.map(drop),
                    };
                    connect(transport).await;
                    robot.client().reset();
                    let handle = open(&mut robot).await;
                    let number = 100_000 + number(polls) + i32::from(closes);
                    check(&mut robot, handle, &controller, number).await;
                    ended
                })
                .await;
            }
            sweep("sleep_until", async |polls| {
                let at = now().saturating_add(core::time::Duration::from_micros(500));
                let ended = dropped_after(polls, robot.transport().sleep_until(at)).await;
                robot.transport().sleep_until(at).await;
                assert!(now() >= at);
                ended
            })
            .await;
        };
        alongside(serve(server, &controller), test).await;
    });
}

/// `send` to a peer that does not read, and `receive` of bytes that arrive one at a time.
fn tcp_bytes() {
    between(|_, client, server| async move {
        let bytes: Vec<u8> = (0..4000_u32).map(|n| u8::try_from(n % 251).unwrap()).collect();
        let (mut rx, mut tx) = ([0; 512], [0; 512]);
        let mut peer = TcpSocket::new(server, &mut rx, &mut tx);
        let mut memory = [[0; 512]; 2];
        let [rx, tx] = &mut memory;
        let mut transport = TcpTransport::new(client, rx, tx, Options::default());
        join(async { peer.accept(5007).await.unwrap() }, connect(&mut transport)).await;
        let until = now().saturating_add(LATER);
        // each send is dropped at its first await point; then the peer reads a little
        let (mut sent, mut read, mut points) = (0, Vec::<u8>::new(), 0);
        let mut buffer = [0; 64];
        while read.len() < bytes.len() {
            if sent < bytes.len() {
                match dropped_after(1, transport.send(&bytes[sent..], until)).await {
                    Some(count) => sent += count.unwrap().unwrap(),
                    None => points += 1,
                }
            }
            if sent == bytes.len() || points % 2 == 1 {
                let count = peer.read(&mut buffer).await.unwrap();
                read.extend(&buffer[..count]);
            } else {
                embassy_futures::yield_now().await;
            }
        }
        assert!(read == bytes, "bytes were lost or sent twice");
        POINTS.with_borrow_mut(|all| all.insert("TcpTransport::send", points));

        let mut received = Vec::<u8>::new();
        for byte in &bytes[..100] {
            let empty = dropped_after(1, transport.receive(&mut buffer, until)).await;
            assert!(empty.is_none());
            peer.write(&[*byte]).await.unwrap();
            peer.flush().await.unwrap();
            let count = transport.receive(&mut buffer, until).await.unwrap().unwrap();
            received.extend(&buffer[..count]);
        }
        assert_eq!(received, bytes[..100]);
        POINTS.with_borrow_mut(|all| *all.entry("TcpTransport::receive").or_default() += 100);
    });
}

fn udp() {
    between(|cable, client, server| async move {
        let controller = Controller::new(Tokens::default());
        let (mut rx_meta, mut tx_meta) = ([PacketMetadata::EMPTY; 4], [PacketMetadata::EMPTY; 4]);
        let (mut rx, mut tx) = ([0; 2048], [0; 2048]);
        let mut socket = UdpSocket::new(server, &mut rx_meta, &mut rx, &mut tx_meta, &mut tx);
        socket.bind(5007).unwrap();
        let mut peers: Vec<Option<UdpPeer<8>>> = [None, None].into_iter().collect();

        let (mut rx_meta, mut tx_meta) = ([PacketMetadata::EMPTY; 2], [PacketMetadata::EMPTY; 2]);
        let (mut rx, mut tx) = ([0; 1024], [0; 1024]);
        let near = UdpSocket::new(client, &mut rx_meta, &mut rx, &mut tx_meta, &mut tx);
        let transport = UdpTransport::new(client, near, (address(1), 5007)).unwrap();
        let mut robot = robot(transport, Config { timing: UDP, ..Config::UDP });
        let mut handle = ControllerHandle(0);
        {
            let serving = async { UdpServer::new(&mut socket, &mut peers, &controller, Limits::default()).run().await };
            let test = async {
                handle = open(&mut robot).await;
                sweep("UdpTransport::receive", async |polls| {
                    let number = number(polls);
                    let ended = dropped_after(polls, token(&mut robot, handle, number)).await;
                    check(&mut robot, handle, &controller, number + 1).await;
                    ended
                })
                .await;
                cable.lose(3);
                for polls in 1..=30 {
                    let number = number(polls) + 3000;
                    let ended = dropped_after(polls, token(&mut robot, handle, number)).await;
                    check(&mut robot, handle, &controller, number + 1).await;
                    let points = usize::from(ended.is_none());
                    POINTS.with_borrow_mut(|all| *all.entry("UdpTransport::receive").or_default() += points);
                }
                cable.lose(0);
            };
            alongside(serving, test).await;
        }
        // a server that is dropped in the middle, and another that continues with its peers
        for polls in 1..=20 {
            let number = 50_000 + number(polls);
            let mut first = UdpServer::new(&mut socket, &mut peers, &controller, Limits::default());
            let answered = select(token(&mut robot, handle, number), dropped_after(polls, first.run())).await;
            let ended = matches!(answered, Either::First(Some(answer)) if answer == answer_to(number));
            let mut second = UdpServer::new(&mut socket, &mut peers, &controller, Limits::default());
            alongside(second.run(), check(&mut robot, handle, &controller, number + 1)).await;
            POINTS.with_borrow_mut(|all| *all.entry("UdpServer::run").or_default() += usize::from(!ended));
        }
        let at = now().saturating_add(core::time::Duration::from_micros(500));
        assert!(dropped_after(1, robot.transport().sleep_until(at)).await.is_none());
        robot.transport().sleep_until(at).await;
        assert!(now() >= at);
    });
}

/// Datagrams of a socket whose memory is full for `send`.
fn udp_bytes() {
    between(|_, client, server| async move {
        let (mut rx_meta, mut tx_meta) = ([PacketMetadata::EMPTY; 64], [PacketMetadata::EMPTY; 64]);
        let (mut rx, mut tx) = ([0; 4096], [0; 4096]);
        let mut peer = UdpSocket::new(server, &mut rx_meta, &mut rx, &mut tx_meta, &mut tx);
        peer.bind(5007).unwrap();
        let (mut rx_meta, mut tx_meta) = ([PacketMetadata::EMPTY; 2], [PacketMetadata::EMPTY; 2]);
        let (mut rx, mut tx) = ([0; 1024], [0; 1024]);
        let near = UdpSocket::new(client, &mut rx_meta, &mut rx, &mut tx_meta, &mut tx);
        let mut transport = UdpTransport::new(client, near, (address(1), 5007)).unwrap();
        let (until, mut points, mut sent) = (now().saturating_add(LATER), 0, 0_u8);
        while sent < 40 {
            match dropped_after(1, transport.send(&[sent; 8], until)).await {
                Some(count) => {
                    assert_eq!(count, Ok(Some(8)));
                    sent += 1;
                }
                None => {
                    points += 1;
                    embassy_futures::yield_now().await;
                }
            }
        }
        let mut buffer = [0; 16];
        for number in 0..sent {
            assert_eq!(peer.recv_from(&mut buffer).await.unwrap().0, 8);
            assert_eq!(buffer[..8], [number; 8], "a datagram was lost or sent twice");
        }
        assert!(!peer.may_recv());
        POINTS.with_borrow_mut(|all| all.insert("UdpTransport::send", points));
    });
}

/// Servers that are dropped while a client calls.
fn servers() {
    between(|_, client, server| async move {
        let controller = Controller::new(Tokens::default());
        let mut memory = [[0; 512]; 4];
        let [rx, tx, near_rx, near_tx] = &mut memory;
        let mut listener = Listener::new(server, 5007, rx, tx);
        let transport = TcpTransport::new(client, near_rx, near_tx, Options::default());
        let mut robot = robot(transport, Config { timing: TCP, ..Config::TCP });
        let limits = Limits::default();
        for polls in 1..=40 {
            for serves_one in [true, false] {
                let number = number(polls) + i32::from(serves_one) * 2;
                let calls = async {
                    connect(&mut robot.transport().0).await;
                    robot.client().reset();
                    let Ok(()) = robot.call(call::service_start("")).await else { return };
                    let Ok(handle) = robot.call(call::controller_connect("", "P", "", "")).await else { return };
                    let answer = token(&mut robot, handle, number).await;
                    assert!(answer.is_none_or(|answer| answer == answer_to(number)));
                };
                let mut slot = None;
                let ended = match serves_one {
                    true => {
                        let mut session = session();
                        let serving = listener.serve_one(&mut session, &controller, &limits);
                        select(calls, dropped_after(polls, serving)).await
                    }
                    false => {
                        let serving = listener.run(&mut slot, session, &controller, &limits);
                        match select(calls, dropped_after(polls, serving)).await {
                            Either::First(()) => Either::First(()),
                            Either::Second(_) => Either::Second(None),
                        }
                    }
                };
                let name = if serves_one { "Listener::serve_one" } else { "Listener::run" };
                let dropped = usize::from(matches!(ended, Either::Second(_)));
                POINTS.with_borrow_mut(|all| *all.entry(name).or_default() += dropped);
                // the listener serves the next connection
                let mut slot = None;
                let next = async {
                    connect(&mut robot.transport().0).await;
                    robot.client().reset();
                    let handle = open(&mut robot).await;
                    check(&mut robot, handle, &controller, number + 1).await;
                };
                alongside(listener.run(&mut slot, session, &controller, &limits), next).await;
            }
        }
    });
}

#[test]
fn a_connection_of_a_dropped_server_is_reset_with_its_next_use() {
    between(|_, client, server| async move {
        let controller = Controller::new(Tokens::default());
        let mut memory = [[0; 512]; 4];
        let [rx, tx, near_rx, near_tx] = &mut memory;
        let mut listener = Listener::new(server, 5007, rx, tx);
        let transport = TcpTransport::new(client, near_rx, near_tx, Options::default());
        let mut robot = robot(transport, Config { timing: TCP, ..Config::TCP });
        let (mut session, limits) = (session(), Limits::default());
        {
            let mut call = pin!(async {
                connect(&mut robot.transport().0).await;
                let handle = open(&mut robot).await;
                robot.call(call::controller_execute(handle, "wait", ())).await.map(|_| ())
            });
            let executes = async {
                while controller.view(|tokens| tokens.waits) != Some(true) {
                    Timer::after_millis(1).await;
                }
                // the request is acknowledged, so the client has nothing to send again
                Timer::after_millis(50).await;
            };
            let served = select3(call.as_mut(), listener.serve_one(&mut session, &controller, &limits), executes).await;
            assert!(matches!(served, Either3::Third(())));
            assert_eq!(controller.view(|tokens| tokens.left), Some(1), "the handler learns it");
            let reset = async {
                // and not a timeout, although there are no bytes to send
                assert_eq!(call.await, Err(CallError::Io(NetError::Reset)));
            };
            let mut next = self::session();
            alongside(listener.serve_one(&mut next, &controller, &limits), reset).await;
        }
    });
}

const PUT: [Allow<'static>; 1] = [Allow::all(VariableKind::I)];
const GATEWAY: bcap_gateway::Config<'static> = bcap_gateway::Config {
    rules: Rules { put: &PUT, ..Rules::READ_ONLY },
    first_pause: core::time::Duration::from_millis(2),
    longest_pause: core::time::Duration::from_millis(10),
    heartbeat: core::time::Duration::from_secs(3600),
    ..bcap_gateway::Config::RC8
};

/// Sends a line and returns the answer; `None` if the connection ends first.
async fn ask(socket: &mut TcpSocket<'_>, line: &str) -> Option<String> {
    let mut sent = 0;
    while sent < line.len() {
        sent += socket.write(&line.as_bytes()[sent..]).await.ok()?;
    }
    let mut reply = Vec::new();
    while reply.last() != Some(&b'\r') {
        let mut byte = [0];
        if socket.read(&mut byte).await != Ok(1) {
            return None;
        }
        reply.extend(byte);
    }
    String::from_utf8(reply).ok()
}

/// Ends the connection of a PLC and makes another; `false` when the gateway does not listen.
async fn connect_plc(plc: &mut TcpSocket<'_>) -> bool {
    plc.abort();
    let _ = plc.flush().await;
    plc.connect((address(1), rac::PORT)).await.is_ok()
}

/// The gateway's loops, dropped while a PLC writes, and begun again.
fn gateway() {
    between(|_, plcs, board| async move {
        let controller = Controller::new(Tokens::default());
        let mut memory = Memory::<2, 4>::new();
        let plant = gateway::SharedGateway::<NoopRawMutex, 2>::new(Gateway::new(GATEWAY, &mut memory), |_| {});
        let mut buffers = [[0; 1024]; 4];
        let [rx, tx, plc_rx, plc_tx] = &mut buffers;
        let mut link = TcpRobot::new(board, rx, tx, Options::default(), (address(0), 5007));
        let mut listener = gateway::Listener::new(board, rac::PORT, plc_rx, plc_tx);
        let mut socket_memory = [[0; 512]; 2];
        let [rx, tx] = &mut socket_memory;
        let mut plc = TcpSocket::new(plcs, rx, tx);
        let limits = gateway::Limits::default();
        let mut frame = [0; 512];
        let test = async {
            for polls in 1..=60 {
                for robot_is_dropped in [true, false] {
                    let number = number(polls) + i32::from(robot_is_dropped) * 2;
                    {
                        let put = async {
                            while !connect_plc(&mut plc).await {
                                Timer::after_millis(1).await;
                            }
                            // until the robot is connected there is another answer
                            let line = format!("PUT:RC8:1:I:3,{number}\r");
                            while ask(&mut plc, &line).await.is_some_and(|answer| answer != "0\r") {}
                        };
                        let robot = run_robot(&mut link, &mut frame, &plant);
                        let clients = listener.run(&plant, &limits);
                        let dropped = match robot_is_dropped {
                            true => select(put, select(dropped_after(polls, robot), clients)).await,
                            false => match select(put, select(robot, dropped_after(polls, clients))).await {
                                Either::First(()) => Either::First(()),
                                Either::Second(_) => Either::Second(Either::First(None)),
                            },
                        };
                        let name = if robot_is_dropped { "run_robot" } else { "gateway::Listener::run" };
                        let dropped = usize::from(matches!(dropped, Either::Second(_)));
                        POINTS.with_borrow_mut(|all| *all.entry(name).or_default() += dropped);
                    }
                    // both continue, and another line gets its own answer
                    let number = number + 1;
                    let next = async {
                        loop {
                            let connected = connect_plc(&mut plc).await;
                            let line = format!("PUT:RC8:1:I:3,{number}\r");
                            if connected && executed(&controller, number) == 0 {
                                match ask(&mut plc, &line).await.as_deref() {
                                    Some("0\r") => return,
                                    // no connection to the robot yet, so it was not executed
                                    Some(_) => assert_eq!(executed(&controller, number), 0, "{number}"),
                                    None => {}
                                }
                            }
                            Timer::after_millis(100).await;
                        }
                    };
                    let robot = run_robot(&mut link, &mut frame, &plant);
                    alongside(join(robot, listener.run(&plant, &limits)), next).await;
                    assert_eq!(executed(&controller, number), 1);
                    assert!(ran_once(&controller), "after {polls} polls");
                }
            }
            sweep("TcpRobot::open", async |polls| {
                let ended = dropped_after(polls, link.open()).await.map(drop);
                link.close();
                while link.open().await.is_err() {
                    Timer::after_millis(1).await;
                }
                link.close();
                ended
            })
            .await;
        };
        alongside(serve(plcs, &controller), test).await;
    });
}

/// A site that returns the length of a body.
struct Length;

impl<'s> Site<'s> for Length {
    type Page = usize;

    fn admits(&self, _: Option<IpEndpoint>) -> bool {
        true
    }

    fn decide(&self, _: &http::Request<'_>) -> Decision<usize> {
        Decision::Receive
    }

    async fn take(&self, memory: &'s mut [u8], len: usize) -> (&'s mut [u8], usize) {
        (memory, len)
    }

    fn write(&self, len: usize, out: &mut http::Body<'_>) -> Option<(Status, Content)> {
        use std::fmt::Write as _;
        write!(out, "{len} bytes").ok().map(|()| (Status::Ok, Content::Text))
    }
}

/// The listeners of Modbus and HTTP, dropped during a client's request, and started again.
fn fronts() {
    between(|_, clients, board| async move {
        let mut memory = Memory::<2, 4>::new();
        let plant = gateway::SharedGateway::<NoopRawMutex, 2>::new(Gateway::new(GATEWAY, &mut memory), |_| {});
        let map = [Entry::registers("100=I/1").unwrap()];
        let mut buffers = [[0; 512]; 5];
        let [modbus_rx, modbus_tx, http_rx, http_tx, page] = &mut buffers;
        let mut modbus =
            gateway::ModbusListener::new(board, modbus::PORT, &map, [modbus_rx, modbus_tx], Options::default());
        let mut pages = HttpListener::new(board, 80, [http_rx, http_tx], page, Options::default());
        let limits = gateway::Limits::default();
        let answer = |path: &str, page: &mut dyn std::fmt::Write| page.write_str(path).ok().map(|()| Content::Text);
        for polls in 1..=30_u8 {
            // there is no robot, so the response is the exception 0x0a
            let read = [0, polls, 0, 0, 0, 6, 1, 3, 0, 100, 0, 2];
            let exception = [0, polls, 0, 0, 0, 3, 1, 0x83, 0x0a];
            let dropped = dropped_after(polls.into(), modbus.run(&plant, &limits));
            let dropped = select(asked(clients, modbus::PORT, &read, &exception), dropped).await;
            count("ModbusListener::run", &dropped);
            alongside(modbus.run(&plant, &limits), asked(clients, modbus::PORT, &read, &exception)).await;

            let get = format!("GET /{polls} HTTP/1.1\r\n\r\n");
            let end = format!("\r\n\r\n/{polls}");
            let dropped = dropped_after(polls.into(), pages.run(|_| true, answer));
            let dropped = select(asked(clients, 80, get.as_bytes(), end.as_bytes()), dropped).await;
            count("HttpListener::run", &dropped);
            alongside(pages.run(|_| true, answer), asked(clients, 80, get.as_bytes(), end.as_bytes())).await;

            let post = format!("POST / HTTP/1.1\r\nContent-Length: {polls}\r\n\r\n{}", "x".repeat(polls.into()));
            let end = format!("\r\n\r\n{polls} bytes");
            let dropped = dropped_after(polls.into(), pages.run_site(&Length));
            let dropped = select(asked(clients, 80, post.as_bytes(), end.as_bytes()), dropped).await;
            count("HttpListener::run_site", &dropped);
            alongside(pages.run_site(&Length), asked(clients, 80, post.as_bytes(), end.as_bytes())).await;
        }
    });
}

/// Counts an await point if the second future was dropped before the first was ready.
fn count<T>(name: &'static str, dropped: &Either<(), T>) {
    let dropped = usize::from(matches!(dropped, Either::Second(_)));
    POINTS.with_borrow_mut(|all| *all.entry(name).or_default() += dropped);
}

/// Sends a request on new connections until its response ends with `end`.
async fn asked(stack: Stack<'_>, port: u16, request: &[u8], end: &[u8]) {
    let [mut rx, mut tx] = [[0; 512]; 2];
    let mut socket = TcpSocket::new(stack, &mut rx, &mut tx);
    loop {
        socket.abort();
        let _ = socket.flush().await;
        if socket.connect((address(1), port)).await.is_ok() && socket.write(request).await == Ok(request.len()) {
            let mut response = Vec::new();
            let mut byte = [0];
            while with_timeout(embassy_time::Duration::from_secs(1), socket.read(&mut byte)).await == Ok(Ok(1)) {
                response.extend(byte);
                if response.ends_with(end) {
                    return;
                }
            }
        }
        Timer::after_millis(1).await;
    }
}

/// The timer of serial lines; the transport over it is the core's.
fn serial() {
    embassy_futures::block_on(sweep("EmbassyClock::sleep_until", async |polls| {
        let at = now().saturating_add(core::time::Duration::from_micros(500));
        let ended = dropped_after(polls, EmbassyClock.sleep_until(at)).await;
        EmbassyClock.sleep_until(at).await;
        assert!(now() >= at);
        ended
    }));
}

const DECLARED: Coverage = Exempt("a declaration; its implementations are covered");

const FUNCTIONS: &[(&str, Coverage)] = &[
    ("clock.rs: EmbassyClock::sleep_until", Swept("EmbassyClock::sleep_until")),
    ("gateway/listener.rs: Listener::run", Swept("gateway::Listener::run")),
    ("gateway/listener.rs: accept", Through("gateway/listener.rs: Listener::run")),
    ("gateway/listener.rs: end", Through("gateway/listener.rs: Listener::run")),
    ("gateway/clients.rs: serve", Through("gateway/listener.rs: Listener::run")),
    (
        "gateway/modbus_listener.rs: ModbusListener::refuse",
        Exempt("it has no slot, and otherwise awaits what ModbusListener::run awaits"),
    ),
    (
        "gateway/modbus_listener.rs: ModbusListener::refuse_client",
        Through("gateway/modbus_listener.rs: ModbusListener::run"),
    ),
    ("gateway/modbus_listener.rs: ModbusListener::run", Swept("ModbusListener::run")),
    ("gateway/tcp.rs: TcpRobot::open", Swept("TcpRobot::open")),
    ("gateway/tcp.rs: UdpTransport::open", Exempt("it awaits nothing")),
    ("gateway/serial.rs: SerialRobot::open", Exempt("it awaits nothing")),
    ("http.rs: HttpListener::run", Swept("HttpListener::run")),
    ("http.rs: HttpListener::run_site", Swept("HttpListener::run_site")),
    ("http.rs: ReadOnly::take", Exempt("it awaits nothing")),
    ("http.rs: Site::take", DECLARED),
    ("http.rs: receive", Through("http.rs: HttpListener::run_site")),
    ("http.rs: receive_until", Through("http.rs: receive")),
    ("http.rs: respond", Through("http.rs: HttpListener::run_site")),
    ("http.rs: send", Through("http.rs: respond")),
    ("net/backlog.rs: evicted", Through("http.rs: HttpListener::run_site")),
    ("net/link.rs: wait", Through("net/tcp.rs: TcpTransport::receive")),
    ("net/tcp.rs: TcpTransport::accept", Through("server/tcp.rs: Listener::serve_one")),
    ("net/tcp.rs: TcpTransport::close", Swept("TcpTransport::close")),
    ("net/tcp.rs: TcpTransport::connect", Swept("TcpTransport::connect")),
    ("net/tcp.rs: TcpTransport::reset", Through("net/tcp.rs: TcpTransport::connect")),
    ("net/tcp.rs: TcpTransport::leaves", Through("net/tcp.rs: TcpTransport::accept")),
    ("net/tcp.rs: TcpTransport::receive", Swept("TcpTransport::receive")),
    ("net/tcp.rs: TcpTransport::send", Swept("TcpTransport::send")),
    ("net/tcp.rs: TcpTransport::sleep_until", Swept("sleep_until")),
    ("net/udp.rs: UdpTransport::receive", Swept("UdpTransport::receive")),
    ("net/udp.rs: UdpTransport::send", Swept("UdpTransport::send")),
    ("net/udp.rs: UdpTransport::sleep_until", Swept("sleep_until")),
    ("server/mod.rs: send", Through("server/mod.rs: serve")),
    ("server/mod.rs: serve", Through("server/tcp.rs: Listener::serve_one")),
    ("server/mod.rs: wait", Through("server/mod.rs: serve")),
    ("server/shared.rs: SharedHandler::changed", Through("server/mod.rs: serve")),
    ("server/tcp.rs: Listener::run", Swept("Listener::run")),
    ("server/tcp.rs: Listener::serve_one", Swept("Listener::serve_one")),
    ("server/udp.rs: UdpServer::receive", Through("server/udp.rs: UdpServer::run")),
    ("server/udp.rs: UdpServer::run", Swept("UdpServer::run")),
    ("server/udp.rs: UdpServer::run_all", Through("server/udp.rs: UdpServer::run")),
    ("server/udp.rs: send", Through("server/udp.rs: UdpServer::run")),
];

/// The driver of bcap-gateway.
const DRIVER: &[(&str, Coverage)] = &[
    ("driver/clients.rs: refuse", Exempt("it has no slot, and otherwise awaits what serve awaits")),
    ("driver/clients.rs: run_session", Through("driver/clients.rs: serve")),
    ("driver/clients.rs: serve", Swept("gateway::Listener::run")),
    ("driver/notify.rs: first", Through("driver/clients.rs: serve")),
    ("driver/notify.rs: unless", Through("driver/robot.rs: run_robot")),
    ("driver/notify.rs: yield_now", Through("driver/clients.rs: serve")),
    ("driver/robot.rs: RobotLink::open", DECLARED),
    ("driver/robot.rs: run_robot", Swept("run_robot")),
    ("driver/robot.rs: transfer", Through("driver/robot.rs: run_robot")),
    ("driver/shared.rs: SharedGateway::wait_for_client", Through("driver/clients.rs: serve")),
    ("driver/shared.rs: SharedGateway::wait_for_robot", Through("driver/robot.rs: run_robot")),
];

#[test]
fn bcap_embassy_and_the_driver_of_a_gateway_survive_a_drop_at_every_await_point() {
    tcp_client();
    tcp_bytes();
    udp();
    udp_bytes();
    servers();
    gateway();
    fronts();
    serial();
    let points = POINTS.take();
    for (sources, functions) in [("src", FUNCTIONS), ("../core/gateway/src", DRIVER)] {
        let sources = Path::new(env!("CARGO_MANIFEST_DIR")).join(sources);
        if let Err(wrong) = bcap_test_support::async_functions::check(&sources, functions, &points) {
            panic!("{wrong}\n{points:?}");
        }
    }
    let total: usize = points.values().sum();
    println!(
        "bcap-embassy: {} async functions, {} of them dropped at {total} await points: {points:?}",
        FUNCTIONS.len(),
        points.len()
    );
}
