//! The gateway's driver between PLCs and a robot over TCP and UDP, on sockets of the loopback.

use std::collections::HashMap;
use std::net::{Ipv4Addr, SocketAddr};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use bcap_core::bcap::client::{self, ClientError};
use bcap_core::bcap::server::{Handler, Request};
use bcap_core::bcap::{Decoder, FrameWriter, FunctionId, Link, Object, Progress};
use bcap_core::handler::{Outcome, PeerId, ReplyValue};
use bcap_core::hresult::HResult;
use bcap_core::rac::VariableKind;
use bcap_core::time::Instant;
use bcap_core::variant::VariantBuf;
use bcap_gateway::modbus::Entry;
use bcap_gateway::{Allow, Config, Counters, Event, Gateway, Memory, RobotError, Rules};
use bcap_std::gateway::{Denial, Driver, Ended, Limits, Report};
use bcap_std::server::Server;
use tokio::io::{AsyncBufReadExt as _, AsyncReadExt as _, AsyncWriteExt as _, BufReader};
use tokio::net::{TcpListener, TcpStream, UdpSocket};
use tokio::sync::{mpsc, oneshot};
use tokio::task::JoinHandle;

const NOT_CONNECTED: &str = "-2147481342\r";
const TIMEOUT: &str = "-2147481344\r";
const MAX_CONNECT: &str = "-2147481333\r";
const LINKS: [Link; 2] = [Link::Stream, Link::Datagram];

/// A robot with variables by name; reading I99 waits until `released`.
#[derive(Default)]
struct Robot {
    values: HashMap<String, VariantBuf<64>>,
    names: Vec<String>,
    released: bool,
}

impl Handler for Robot {
    fn call(&mut self, _: PeerId, request: &Request<'_>, reply: &mut ReplyValue<'_>, now: Instant) -> Outcome {
        let name = usize::try_from(request.handle() - 1).ok().and_then(|at| self.names.get(at)).cloned();
        match request.function {
            FunctionId::CONTROLLER_GET_VARIABLE => {
                self.names.push(request.text(1).to_string());
                reply.set(&(self.names.len() as i32)).unwrap();
            }
            FunctionId::VARIABLE_GET_VALUE => match name.as_deref() {
                Some("I99") if !self.released => return Outcome::Wait(now.saturating_add(Duration::from_millis(1))),
                Some(name) if self.values.contains_key(name) => reply.set(&self.values[name]).unwrap(),
                _ => reply.set(&0_i32).unwrap(),
            },
            FunctionId::VARIABLE_PUT_VALUE => {
                self.values.insert(name.unwrap(), VariantBuf::new(&request.value(1)).unwrap());
            }
            function if function.opens().is_some_and(|object| object != Object::Service) => {
                reply.set(&1000_i32).unwrap();
            }
            // slvGetMode: no stream runs
            FunctionId::ROBOT_EXECUTE => reply.set(&0_i32).unwrap(),
            _ => {}
        }
        HResult::S_OK.into()
    }
}

/// A robot that runs until it is stopped.
struct Running {
    address: SocketAddr,
    robot: Arc<Mutex<Robot>>,
    stop: oneshot::Sender<()>,
    task: JoinHandle<std::io::Result<()>>,
}

impl Running {
    async fn start(link: Link, port: u16) -> Self {
        let robot = Arc::new(Mutex::new(Robot::default()));
        let (server, address) = (Server::with_shared(Arc::clone(&robot)), (Ipv4Addr::LOCALHOST, port));
        let server = match link {
            Link::Datagram => server.bcap_udp(address).await.unwrap(),
            _ => server.bcap_tcp(address).await.unwrap(),
        };
        let addresses = server.addresses();
        let address = [addresses.bcap_tcp, addresses.bcap_udp].concat()[0];
        let (stop, stopped) = oneshot::channel();
        let task = tokio::spawn(server.run(async { drop(stopped.await) }));
        Self { address, robot, stop, task }
    }

    async fn stop(self) {
        drop(self.stop);
        self.task.await.unwrap().unwrap();
    }
}

/// A report that can be kept.
#[derive(Debug, PartialEq)]
enum Seen {
    Connected(SocketAddr),
    Denied(SocketAddr, Denial),
    Disconnected(SocketAddr, Option<Ended>),
    Answered(SocketAddr, String, HResult),
    Up,
    Down(RobotError, Option<std::io::ErrorKind>),
}

impl Seen {
    fn of(report: &Report<'_>) -> Self {
        match *report {
            Report::Connected { client } => Self::Connected(client),
            Report::Denied { client, reason } => Self::Denied(client, reason),
            Report::Disconnected { client, ended } => Self::Disconnected(client, ended),
            Report::Answered { client, line, event } => {
                let result = match event {
                    Event::Served { result, .. } | Event::Failed { result, .. } => result,
                    Event::Refused { refusal, .. } => refusal.hresult(),
                    other => panic!("{other:?}"),
                };
                Self::Answered(client, String::from_utf8(line.to_vec()).unwrap(), result)
            }
            Report::Robot { event: Event::RobotUp, .. } => Self::Up,
            Report::Robot { event: Event::RobotDown { error, .. }, cause } => {
                Self::Down(error, cause.map(std::io::Error::kind))
            }
            ref other => panic!("{other:?}"),
        }
    }
}

/// A gateway that runs until it is stopped.
struct Driven {
    address: SocketAddr,
    /// The address of Modbus: I0 to I9 in the registers 0 to 19, I90 to I99 in the registers 100 to 109.
    modbus: SocketAddr,
    reports: mpsc::UnboundedReceiver<Seen>,
    stop: oneshot::Sender<()>,
    task: JoinHandle<Counters>,
}

impl Driven {
    /// Starts a gateway with two slots, on which all I variables may be written.
    async fn start(link: Link, robot: SocketAddr, limits: Limits) -> Self {
        let attempt_timeout = Duration::from_millis(if link == Link::Datagram { 50 } else { 5000 });
        Self::start_with(link, attempt_timeout, robot, limits).await
    }

    async fn start_with(link: Link, attempt_timeout: Duration, robot: SocketAddr, limits: Limits) -> Self {
        let client = if link == Link::Datagram { client::Config::UDP } else { client::Config::TCP };
        let timing = client::Timing {
            attempt_timeout,
            deadline: Duration::from_secs(20),
            keep_alive: Duration::from_secs(20),
            ..client.timing
        };
        let config = Config {
            client: client::Config { timing, ..client },
            rules: Rules { put: const { &[Allow::all(VariableKind::I)] }, ..Rules::READ_ONLY },
            request_timeout: Duration::from_secs(60),
            heartbeat: Duration::from_millis(20),
            first_pause: Duration::from_millis(10),
            longest_pause: Duration::from_millis(10),
            ..Config::RC8
        };
        let gateway = Gateway::new(config, Box::leak(Box::new(Memory::<2, 4>::new())));
        let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).await.unwrap();
        let address = listener.local_addr().unwrap();
        let entries = ["0=I/0-9", "100=I/90-99:i16"].map(|entry| Entry::registers(entry).unwrap());
        let modbus_listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).await.unwrap();
        let modbus = modbus_listener.local_addr().unwrap();
        let (log, reports) = mpsc::unbounded_channel();
        let robot = (robot.ip().to_string(), robot.port());
        let driver = Driver::new(gateway, robot, move |report| drop(log.send(Seen::of(report)))).limits(limits);
        let driver = driver.modbus(modbus_listener, Box::leak(Box::new(entries)));
        let (stop, stopped) = oneshot::channel();
        let task = tokio::spawn(driver.run(listener, async { drop(stopped.await) }));
        Self { address, modbus, reports, stop, task }
    }

    /// Waits for the next report of a kind.
    async fn report<T>(&mut self, wanted: impl Fn(&Seen) -> Option<T>) -> T {
        loop {
            let seen = self.reports.recv().await.expect("more reports");
            if let Some(found) = wanted(&seen) {
                return found;
            }
        }
    }

    async fn up(&mut self) {
        self.report(|seen| (*seen == Seen::Up).then_some(())).await;
    }

    async fn down(&mut self) -> (RobotError, Option<std::io::ErrorKind>) {
        self.report(|seen| if let Seen::Down(error, cause) = seen { Some((*error, *cause)) } else { None }).await
    }

    /// Waits for the end of a client's connection, and returns its reason.
    async fn ended(&mut self, plc: &Plc) -> Option<Ended> {
        self.ended_at(plc.address).await
    }

    async fn ended_at(&mut self, client: SocketAddr) -> Option<Ended> {
        self.report(|seen| match seen {
            Seen::Disconnected(address, ended) if *address == client => Some(*ended),
            _ => None,
        })
        .await
    }

    async fn stop(self) -> Counters {
        drop(self.stop);
        self.task.await.unwrap()
    }
}

struct Plc {
    address: SocketAddr,
    stream: BufReader<TcpStream>,
}

impl Plc {
    async fn connect(gateway: &Driven) -> Self {
        let stream = TcpStream::connect(gateway.address).await.unwrap();
        Self { address: stream.local_addr().unwrap(), stream: BufReader::new(stream) }
    }

    async fn send(&mut self, line: &str) {
        self.stream.get_mut().write_all(line.as_bytes()).await.unwrap();
    }

    /// Returns the next line; it is empty when the connection is closed.
    async fn line(&mut self) -> String {
        let mut line = Vec::new();
        self.stream.read_until(b'\r', &mut line).await.unwrap();
        String::from_utf8(line).unwrap()
    }

    async fn ask(&mut self, line: &str) -> String {
        self.send(line).await;
        self.line().await
    }
}

#[tokio::test]
async fn requests_reach_the_robot_over_both_links() {
    for link in LINKS {
        let robot = Running::start(link, 0).await;
        let mut gateway = Driven::start(link, robot.address, Limits::default()).await;
        gateway.up().await;
        let mut plc = Plc::connect(&gateway).await;
        assert_eq!(plc.ask("PUT:RC8:7:I:3,-5\r").await, "0\r");
        assert_eq!(plc.ask("GET:RC8:7:I:\r").await, "0,3,-5\r");
        assert_eq!(plc.ask("PUT:RC8:7:F:4,1\r").await, "-2147024891\r");
        assert_eq!(robot.robot.lock().unwrap().values["I7"].as_variant().as_i64(), Some(-5));
        for (line, result) in [
            ("PUT:RC8:7:I:3,-5", HResult::S_OK),
            ("GET:RC8:7:I:", HResult::S_OK),
            ("PUT:RC8:7:F:4,1", HResult::E_ACCESSDENIED),
        ] {
            let answered = gateway.report(|seen| matches!(seen, Seen::Answered(..)).then(|| format!("{seen:?}"))).await;
            assert_eq!(answered, format!("{:?}", Seen::Answered(plc.address, line.into(), result)));
        }
        let counters = gateway.stop().await;
        assert_eq!((counters.served.count(), counters.refused, counters.connected), (2, 1, 1), "{link:?}");
        robot.stop().await;
    }
}

#[tokio::test]
async fn a_robot_that_dies_is_reported_and_used_again_when_it_is_back() {
    for link in LINKS {
        let robot = Running::start(link, 0).await;
        let address = robot.address;
        let mut gateway = Driven::start(link, address, Limits::default()).await;
        let mut plc = Plc::connect(&gateway).await;
        let mut robot = Some(robot);
        for value in 1..=3 {
            let robot = match robot.take() {
                Some(robot) => robot,
                None => Running::start(link, address.port()).await,
            };
            gateway.up().await;
            assert_eq!(plc.ask(&format!("PUT:RC8:1:I:3,{value}\r")).await, "0\r");
            assert_eq!(plc.ask("GET:RC8:1:I:\r").await, format!("0,3,{value}\r"));
            robot.stop().await;
            let (error, cause) = gateway.down().await;
            assert!(error == RobotError::Closed && cause.is_some(), "{link:?}: {error:?} {cause:?}");
            assert_eq!(plc.ask("GET:RC8:1:I:\r").await, NOT_CONNECTED);
        }
        gateway.stop().await;
    }
}

#[tokio::test]
async fn a_robot_that_stops_responding_over_udp_is_noticed_without_a_request() {
    let robot = Running::start(Link::Datagram, 0).await;
    let address = robot.address;
    let mut gateway = Driven::start(Link::Datagram, address, Limits::default()).await;
    gateway.up().await;
    robot.stop().await;
    // its port is open, but nothing is answered
    let silent = UdpSocket::bind(address).await.unwrap();
    loop {
        match gateway.down().await {
            // between the robot and the silent socket the port was closed
            (RobotError::Closed, Some(_)) => {}
            (error, cause) => {
                assert!(matches!(error, RobotError::Call(ClientError::Timeout(_))) && cause.is_none(), "{error:?}");
                break;
            }
        }
    }
    drop(silent);
    let robot = Running::start(Link::Datagram, address.port()).await;
    gateway.up().await;
    gateway.stop().await;
    robot.stop().await;
}

/// Answers the calls of a gateway until a PUT, which gets no answer. Returns the next read after it.
async fn answer_until_put(mut stream: TcpStream) -> std::io::Result<usize> {
    let (mut received, mut room) = (Vec::new(), [0; 512]);
    loop {
        let count = stream.read(&mut room).await?;
        assert!(count > 0, "the gateway has closed the connection before the PUT");
        received.extend_from_slice(&room[..count]);
        let Progress::Complete(frame, _) = Decoder::TCP.decode(&received).unwrap() else { continue };
        let value = match frame.function() {
            FunctionId::VARIABLE_PUT_VALUE => return stream.read(&mut room).await,
            // slvGetMode: no stream runs
            FunctionId::ROBOT_EXECUTE => 0_i32,
            _ => 1,
        };
        let mut reply = FrameWriter::new(&mut room).unwrap();
        reply.argument(&value).unwrap();
        let reply = reply.finish(frame.serial, 0, HResult::S_OK.0).unwrap();
        stream.write_all(reply).await.unwrap();
        received.clear();
    }
}

/// With a normal close, the operating system would still send the PUT, and a robot could execute it after a newer one.
#[tokio::test]
async fn the_connection_of_a_put_that_times_out_is_reset() {
    let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).await.unwrap();
    let robot = listener.local_addr().unwrap();
    let mut gateway = Driven::start_with(Link::Stream, Duration::from_secs(1), robot, Limits::default()).await;
    let after_put = tokio::spawn(answer_until_put(listener.accept().await.unwrap().0));
    gateway.up().await;
    let mut plc = Plc::connect(&gateway).await;
    assert_eq!(plc.ask("PUT:RC8:1:I:3,5\r").await, TIMEOUT);
    let read = after_put.await.unwrap().map_err(|error| error.kind());
    assert_eq!(read, Err(std::io::ErrorKind::ConnectionReset));
    gateway.stop().await;
}

/// Lines without a pause whose answers are read as fast. A refused line needs no robot, so its client never waits.
#[tokio::test]
async fn a_flood_of_lines_delays_neither_another_plc_nor_the_end() {
    let robot = Running::start(Link::Stream, 0).await;
    let mut gateway = Driven::start(Link::Stream, robot.address, Limits::default()).await;
    gateway.up().await;
    let (mut from, mut to) = TcpStream::connect(gateway.address).await.unwrap().into_split();
    let writer = tokio::spawn(async move { while to.write_all(&[b'\r'; 500]).await.is_ok() {} });
    let (count, mut counted) = tokio::sync::watch::channel(0);
    let reader = tokio::spawn(async move {
        let mut buffer = [0; 1 << 16];
        while let Ok(bytes @ 1..) = from.read(&mut buffer).await {
            count.send_modify(|count| *count += bytes);
        }
    });
    counted.wait_for(|bytes| *bytes > 10_000).await.unwrap();
    let mut plc = Plc::connect(&gateway).await;
    for value in 0..50 {
        assert_eq!(plc.ask(&format!("PUT:RC8:1:I:3,{value}\r")).await, "0\r");
        assert_eq!(plc.ask("GET:RC8:1:I:\r").await, format!("0,3,{value}\r"));
    }
    let before = *counted.borrow();
    counted.wait_for(|bytes| *bytes > before).await.unwrap();
    let counters = gateway.stop().await;
    assert_eq!(counters.served.count(), 100);
    reader.await.unwrap();
    writer.await.unwrap();
    robot.stop().await;
}

#[tokio::test]
async fn clients_get_slots_within_their_limits() {
    let nowhere = SocketAddr::from((Ipv4Addr::LOCALHOST, 9));
    let keeping = Limits { evict_after: Some(Duration::from_secs(600)), ..Limits::default() };
    let mut gateway = Driven::start(Link::Stream, nowhere, keeping).await;
    gateway.down().await;
    let mut plcs = [Plc::connect(&gateway).await, Plc::connect(&gateway).await];
    for plc in &mut plcs {
        assert_eq!(plc.ask("GET:RC8:1:I:\r").await, NOT_CONNECTED);
    }
    let mut late = Plc::connect(&gateway).await;
    assert_eq!(late.ask("GET:RC8:1:I:\r").await, MAX_CONNECT);
    assert_eq!(late.line().await, "", "the connection is closed");
    let denied =
        gateway.report(|seen| if let Seen::Denied(client, Denial::Full) = seen { Some(*client) } else { None }).await;
    assert_eq!(denied, late.address);
    // a slot is free again when its connection has ended
    let [gone, _kept] = &mut plcs;
    gone.stream.get_mut().shutdown().await.unwrap();
    assert_eq!(gateway.ended(gone).await, Some(Ended::Closed));
    assert_eq!(Plc::connect(&gateway).await.ask("GET:RC8:1:I:\r").await, NOT_CONNECTED);
    gateway.stop().await;

    let evicting = Limits { evict_after: Some(Duration::ZERO), connections_per_address: 1, ..Limits::default() };
    let mut gateway = Driven::start(Link::Stream, nowhere, evicting).await;
    gateway.down().await;
    let mut idle = Plc::connect(&gateway).await;
    assert_eq!(idle.ask("GET:RC8:1:I:\r").await, NOT_CONNECTED);
    assert_eq!(Plc::connect(&gateway).await.ask("GET:RC8:1:I:\r").await, NOT_CONNECTED);
    assert_eq!(gateway.ended(&idle).await, Some(Ended::Evicted));
    assert_eq!(idle.line().await, "", "it is closed");
    gateway.stop().await;
}

#[tokio::test]
async fn slow_and_silent_clients_are_disconnected() {
    let nowhere = SocketAddr::from((Ipv4Addr::LOCALHOST, 9));
    let short = Duration::from_millis(20);
    let limits = Limits { receive: short, ..Limits::default() };
    let mut gateway = Driven::start(Link::Stream, nowhere, limits).await;
    let mut plc = Plc::connect(&gateway).await;
    plc.send("GET:").await;
    assert_eq!(plc.line().await, "");
    assert_eq!(gateway.ended(&plc).await, Some(Ended::RequestTooSlow));
    gateway.stop().await;

    let mut gateway = Driven::start(Link::Stream, nowhere, Limits { idle: Some(short), ..Limits::default() }).await;
    let mut plc = Plc::connect(&gateway).await;
    assert_eq!(plc.line().await, "");
    assert_eq!(gateway.ended(&plc).await, Some(Ended::Idle));
    gateway.stop().await;

    let mut gateway = Driven::start(Link::Stream, nowhere, Limits { send: short, ..Limits::default() }).await;
    let mut plc = Plc::connect(&gateway).await;
    // until the answers fill the sockets' buffers, and the gateway reads no more
    let lines = [b'\r'; 1 << 16];
    while plc.stream.get_mut().write_all(&lines).await.is_ok() {}
    assert_eq!(gateway.ended(&plc).await, Some(Ended::ReplyNotRead));
    gateway.stop().await;
}

#[tokio::test]
async fn a_running_request_is_answered_before_the_end() {
    for link in LINKS {
        let robot = Running::start(link, 0).await;
        let mut gateway = Driven::start(link, robot.address, Limits::default()).await;
        gateway.up().await;
        let (mut plc, mut idle) = (Plc::connect(&gateway).await, Plc::connect(&gateway).await);
        assert_eq!(plc.ask("GET:RC8:1:I:\r").await, "0,3,0\r");
        assert_eq!(idle.ask("GET:RC8:1:I:\r").await, "0,3,0\r");
        plc.send("GET:RC8:99:I:\r").await;
        let stopping = tokio::spawn(gateway.task);
        // the robot executes the read: the idle client sees the end, the other client waits
        while robot.robot.lock().unwrap().names.iter().all(|name| name != "I99") {
            tokio::task::yield_now().await;
        }
        drop(gateway.stop);
        assert_eq!(idle.line().await, "");
        robot.robot.lock().unwrap().released = true;
        assert_eq!(plc.line().await, "0,3,0\r");
        assert_eq!(plc.line().await, "");
        let counters = stopping.await.unwrap().unwrap();
        assert_eq!((counters.served.count(), counters.failed.count()), (3, 0), "{link:?}");
        assert!(TcpStream::connect(gateway.address).await.is_err(), "nothing listens");
        robot.stop().await;
    }
}

/// A client of Modbus TCP.
struct Modbus {
    address: SocketAddr,
    stream: TcpStream,
}

impl Modbus {
    async fn connect(gateway: &Driven) -> Self {
        let stream = TcpStream::connect(gateway.modbus).await.unwrap();
        Self { address: stream.local_addr().unwrap(), stream }
    }

    /// Sends a request: function and data.
    async fn send(&mut self, function: &[u8]) {
        let length = u8::try_from(function.len() + 1).unwrap();
        self.stream.write_all(&[&[0x12, 0x34, 0, 0, 0, length, 7], function].concat()).await.unwrap();
    }

    /// Returns the function and the data of a response; nothing after the end of the connection.
    async fn response(&mut self) -> Vec<u8> {
        let mut header = [0; 7];
        if self.stream.read_exact(&mut header).await.is_err() {
            return Vec::new();
        }
        let [head @ .., length, unit] = header;
        assert_eq!((head, unit), ([0x12, 0x34, 0, 0, 0], 7));
        let mut response = vec![0; usize::from(length) - 1];
        self.stream.read_exact(&mut response).await.unwrap();
        response
    }

    async fn ask(&mut self, function: &[u8]) -> Vec<u8> {
        self.send(function).await;
        self.response().await
    }
}

#[tokio::test]
async fn clients_of_modbus_share_the_rules_and_the_variables() {
    let robot = Running::start(Link::Stream, 0).await;
    let mut gateway = Driven::start(Link::Stream, robot.address, Limits::default()).await;
    gateway.up().await;
    let (mut client, mut plc) = (Modbus::connect(&gateway).await, Plc::connect(&gateway).await);
    assert_eq!(client.ask(&[16, 0, 2, 0, 4, 8, 0, 1, 0x11, 0x70, 0xff, 0xff, 0xff, 0xfe]).await, [16, 0, 2, 0, 4]);
    assert_eq!(plc.ask("GET:RC8:1:I:\r").await, "0,3,70000\r");
    assert_eq!(plc.ask("PUT:RC8:95:I:3,9\r").await, "0\r");
    // two requests at once; the second waits for the response to the first
    client.send(&[3, 0, 4, 0, 2]).await;
    client.send(&[4, 0, 105, 0, 1]).await;
    assert_eq!(client.response().await, [3, 4, 0xff, 0xff, 0xff, 0xfe]);
    assert_eq!(client.response().await, [4, 2, 0, 9]);
    assert_eq!(client.ask(&[3, 0, 99, 0, 1]).await, [0x83, 2], "an address without a variable");
    assert_eq!(client.ask(&[24, 0, 0]).await, [0x98, 1], "a function that is not supported");
    let lines = ["PUT:RC8:1:I:3,70000", "PUT:RC8:2:I:3,-2", "GET:RC8:2:I:", "GET:RC8:95:I:", "MODBUS:3:99:1"];
    let address = client.address;
    for expected in lines {
        let line = gateway.report(|seen| match seen {
            Seen::Answered(client, line, _) if *client == address => Some(line.clone()),
            _ => None,
        });
        assert_eq!(line.await, expected);
    }
    let counters = gateway.stop().await;
    assert_eq!((counters.refused, client.response().await), (2, Vec::new()));
    robot.stop().await;
}

#[tokio::test]
async fn a_client_of_modbus_that_sends_no_more_gets_its_response_and_its_report() {
    let robot = Running::start(Link::Stream, 0).await;
    let mut gateway = Driven::start(Link::Stream, robot.address, Limits::default()).await;
    gateway.up().await;
    for (request, response, lines) in [
        (&[6, 0, 105, 0, 9][..], &[6, 0, 105, 0, 9][..], &["PUT:RC8:95:I:3,9"][..]),
        (&[16, 0, 100, 0, 2, 4, 0, 1, 0, 2], &[16, 0, 100, 0, 2], &["PUT:RC8:90:I:3,1", "PUT:RC8:91:I:3,2"]),
    ] {
        let mut client = Modbus::connect(&gateway).await;
        client.send(request).await;
        client.stream.shutdown().await.unwrap();
        assert_eq!(client.response().await, response);
        for line in lines {
            let answered = gateway.report(|seen| matches!(seen, Seen::Answered(..)).then(|| format!("{seen:?}"))).await;
            assert_eq!(answered, format!("{:?}", Seen::Answered(client.address, (*line).into(), HResult::S_OK)));
        }
        assert_eq!(gateway.ended_at(client.address).await, Some(Ended::Closed));
    }
    assert_eq!(gateway.stop().await.served.count(), 3);
    robot.stop().await;
}

#[tokio::test]
async fn clients_of_modbus_share_the_slots_and_the_limits() {
    let nowhere = SocketAddr::from((Ipv4Addr::LOCALHOST, 9));
    let limits = Limits { receive: Duration::from_millis(50), ..Limits::default() };
    let mut gateway = Driven::start(Link::Stream, nowhere, limits).await;
    gateway.down().await;
    let mut plc = Plc::connect(&gateway).await;
    assert_eq!(plc.ask("GET:RC8:1:I:\r").await, NOT_CONNECTED);
    let mut client = Modbus::connect(&gateway).await;
    assert_eq!(client.ask(&[3, 0, 0, 0, 2]).await, [0x83, 0x0a], "no path to the robot");
    let mut late = Modbus::connect(&gateway).await;
    assert_eq!(late.ask(&[3, 0, 0, 0, 2]).await, [0x83, 6], "the gateway has no slot");
    assert!(late.response().await.is_empty(), "the connection is closed");
    // bytes that are not Modbus free the slot
    client.stream.write_all(b"GET:RC8:1:I:\r").await.unwrap();
    assert!(client.response().await.is_empty(), "the connection is closed");
    assert_eq!(gateway.ended_at(client.address).await, Some(Ended::NotModbus));
    // a request must be complete in time
    let mut slow = Modbus::connect(&gateway).await;
    slow.stream.write_all(&[0, 1, 0, 0, 0, 6, 1]).await.unwrap();
    assert_eq!(gateway.ended_at(slow.address).await, Some(Ended::RequestTooSlow));
    gateway.stop().await;
}
