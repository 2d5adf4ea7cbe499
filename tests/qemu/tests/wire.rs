//! Tests the gateway board in QEMU over a wire that drops, repeats and delays frames, with PLCs and a robot at the other
//! end.
//!
//! ```text
//!  4 PLCs ─┐                                     ┌─ gateway image
//!          ├─ smoltcp ─ faults, both ways ─ UDP ─┤
//!   robot ─┘            2 % of each kind         └─ QEMU, a datagram for each frame
//! ```
//!
//! Every request has a unique number that determines its value. So the test detects an answer with the value of another
//! request, and a value at the robot that was not put there. An answer may be an error and a connection may end, but no
//! request may hang.
//!
//! `WIRE_SECONDS` and `WIRE_SEED` are the length, 15 s, and the seed of the faults, 1.

use std::collections::VecDeque;
use std::io::{self, Write};
use std::net::UdpSocket;
use std::str::FromStr;
use std::time::{Duration, Instant};

use bcap_core::bcap::FunctionId;
use bcap_core::bcap::server::{Config, Handler, Request, Session};
use bcap_core::handler::{Outcome, PeerId, ReplyValue};
use bcap_core::hresult::HResult;
use bcap_core::time::Instant as CoreInstant;
use bcap_embassy::bare::{self, TcpServer};
use bcap_qemu::Board;
use fastrand::Rng;
use smoltcp::iface::{self, Interface, SocketHandle, SocketSet};
use smoltcp::phy::{self, Device, DeviceCapabilities, Medium};
use smoltcp::socket::tcp;
use smoltcp::wire::{EthernetAddress, IpCidr, Ipv4Address};

pub(crate) const BOARD: Ipv4Address = Ipv4Address::new(10, 0, 2, 15);
pub(crate) const HOST: Ipv4Address = Ipv4Address::new(10, 0, 2, 2);
const PLCS: usize = 4;
/// More variables than the board's handle cache holds.
const VARIABLES: i32 = 200;
/// In percent, of each kind and in each direction.
const FAULTS: u8 = 2;
const DELAY_MS: std::ops::Range<u64> = 5..150;
/// The time limit of a request: 10 s at the gateway, plus retransmissions of lost frames.
const BOUND: Duration = Duration::from_secs(45);

#[test]
fn no_answer_is_wrong_and_every_request_ends_on_a_lossy_wire() {
    let setting = |name: &str, usual: u64| std::env::var(name).map_or(usual, |text| text.parse().unwrap());
    let length = Duration::from_secs(setting("WIRE_SECONDS", 15));
    let seed = setting("WIRE_SEED", 1);
    let (wire, netdev) = Wire::open(seed);
    let settings = ["provider=CaoProv.DENSO.VRC", "dhcp=no", "put=I"];
    let mut board = Board::start("10.0.2.2:5007", &["--netdev", &netdev], &settings);
    let mut world = World::new(wire, PLCS, seed);

    // the board may have to be built first
    world.run_until(&mut board, Duration::from_secs(600), |world| world.plcs.iter().all(|plc| plc.answers > 0));
    world.forget();
    world.wire.faulty = true;
    let end = Instant::now() + length;
    world.run_until(&mut board, 2 * length + BOUND, |_| Instant::now() >= end);
    let under_faults = world.report();
    world.wire.faulty = false;
    let before: Vec<u32> = world.plcs.iter().map(|plc| plc.answers).collect();
    world.run_until(&mut board, 2 * BOUND, |world| {
        world.plcs.iter().zip(&before).all(|(plc, before)| plc.answers >= before + 20)
    });

    // not `eprintln`, which the tests of cargo show of failures only
    let _ = writeln!(io::stderr(), "lossy wire, seed {seed}, {} s: {under_faults}", length.as_secs());
    assert_eq!(world.robot.wrong, 0, "values at the robot that no PLC wrote");
    for way in &world.wire.ways {
        assert!(way.dropped > 0 && way.repeated > 0 && way.delayed > 0, "too few frames for a test: {under_faults}");
    }
}

/// The value of a variable.
fn value_of(number: i32) -> i32 {
    number * 7919 + 12_345
}

/// Everything at this end of the wire.
pub(crate) struct World {
    begin: Instant,
    pub(crate) wire: Wire,
    pub(crate) interface: Interface,
    pub(crate) sockets: SocketSet<'static>,
    pub(crate) robot: Robot,
    servers: Vec<(SocketHandle, TcpServer<RobotSession>)>,
    /// Whether the program of the robot has been killed: its connections are reset, and new ones are refused.
    pub(crate) robot_is_down: bool,
    pub(crate) plcs: Vec<Plc>,
    rng: Rng,
}

type RobotSession = Session<[u8; 1024], [u8; 1024], 256>;

impl World {
    pub(crate) fn new(mut wire: Wire, plcs: usize, seed: u64) -> Self {
        let address = EthernetAddress([0x02, 0, 0, 0, 0, 0x02]);
        let mut config = iface::Config::new(address.into());
        config.random_seed = seed;
        let mut interface = Interface::new(config, &mut wire, smoltcp::time::Instant::ZERO);
        interface.update_ip_addrs(|addresses| addresses.push(IpCidr::new(HOST.into(), 24)).unwrap());
        let mut sockets = SocketSet::new(Vec::new());
        let mut socket = || {
            let buffer = || tcp::SocketBuffer::new(vec![0; 2048]);
            sockets.add(tcp::Socket::new(buffer(), buffer()))
        };
        let plcs = (0..plcs).map(|index| Plc::new(socket(), index)).collect();
        // a connection that the board has dropped may not have ended here yet
        let servers = (0..3).map(|index| (socket(), TcpServer::new(5007, index, 3))).collect();
        let robot = Robot { wrong: 0, requests: 0 };
        Self {
            begin: Instant::now(),
            wire,
            interface,
            sockets,
            robot,
            servers,
            robot_is_down: false,
            plcs,
            rng: Rng::with_seed(seed),
        }
    }

    /// Runs until `done`, at most for `limit`; the board must run throughout.
    pub(crate) fn run_until(&mut self, board: &mut Board, limit: Duration, done: impl Fn(&Self) -> bool) {
        let since = Instant::now();
        while !done(self) {
            assert!(board.is_running(), "the board has ended or was reset: {}", board.log());
            assert!(since.elapsed() < limit, "nothing goes on: {}; {}", self.report(), board.log());
            self.wire.receive();
            self.poll();
        }
    }

    /// Lets everything here process the frames that have arrived.
    pub(crate) fn poll(&mut self) {
        let now = CoreInstant::from_micros(u64::try_from(self.begin.elapsed().as_micros()).unwrap());
        self.interface.poll(bare::to_smoltcp(now), &mut self.wire, &mut self.sockets);
        for (handle, server) in &mut self.servers {
            let make = || Session::new(Config::TCP, [0; 1024], [0; 1024]);
            let socket = self.sockets.get_mut::<tcp::Socket<'_>>(*handle);
            if self.robot_is_down {
                socket.abort();
            }
            if !self.robot_is_down || server.is_connected() {
                server.poll(socket, make, &mut self.robot, now);
            }
        }
        for plc in &mut self.plcs {
            plc.go_on(self.sockets.get_mut(plc.socket), &mut self.interface, &mut self.rng);
        }
        self.interface.poll(bare::to_smoltcp(now), &mut self.wire, &mut self.sockets);
    }

    pub(crate) fn forget(&mut self) {
        self.wire.ways = Default::default();
        self.robot.requests = 0;
        for plc in &mut self.plcs {
            (plc.requests, plc.answers, plc.errors, plc.lost, plc.longest) = (0, 0, 0, 0, Duration::ZERO);
            plc.times = Default::default();
        }
    }

    /// Describes the PLCs without an answer since they had these.
    pub(crate) fn unserved(&self, answers: &[u32]) -> String {
        let unserved = self.plcs.iter().zip(answers).filter(|(plc, before)| plc.answers <= **before);
        let describe = |plc: &Plc| {
            let socket = self.sockets.get::<tcp::Socket<'_>>(plc.socket);
            let Plc { requests, errors, lost, .. } = plc;
            let port = socket.local_endpoint().map_or(0, |endpoint| endpoint.port);
            format!("{:?} at {port}, {requests} requests, {errors} errors, {lost} lost; ", socket.state())
        };
        unserved.map(|(plc, _)| describe(plc)).collect()
    }

    /// Keeps the times of answers for a phase from now on, or does not keep them.
    pub(crate) fn enter(&mut self, phase: Option<Phase>) {
        self.plcs.iter_mut().for_each(|plc| plc.phase = phase);
    }

    /// Returns a percentile of the times of right answers to the PLCs that keep their connection.
    pub(crate) fn percentile(&self, phase: Phase, percent: usize) -> Duration {
        let steady = self.plcs.iter().filter(|plc| !plc.reconnects);
        let mut micros: Vec<u32> = steady.flat_map(|plc| &plc.times[phase as usize]).copied().collect();
        micros.sort_unstable();
        Duration::from_micros(micros.get(micros.len() * percent / 100).copied().unwrap_or_default().into())
    }

    pub(crate) fn report(&self) -> String {
        let sum = |of: fn(&Plc) -> u32| self.plcs.iter().map(of).sum::<u32>();
        let [to, from] = &self.wire.ways;
        let longest = self.plcs.iter().map(|plc| plc.longest).max().unwrap_or_default();
        format!(
            "to the board {to}; from it {from}; {} requests: {} answers, {} errors, {} connections lost; the longest \
             took {longest:.1?}; the robot carried out {}",
            sum(|plc| plc.requests),
            sum(|plc| plc.answers),
            sum(|plc| plc.errors),
            sum(|plc| plc.lost),
            self.robot.requests,
        )
    }
}

/// A phase of a test whose times are compared with another phase.
#[derive(Clone, Copy)]
pub(crate) enum Phase {
    Calm,
    Attack,
}

/// A PLC: requests in sequence, over connections in sequence.
pub(crate) struct Plc {
    socket: SocketHandle,
    /// Whether it connects anew for each request.
    pub(crate) reconnects: bool,
    next_port: u16,
    received: Vec<u8>,
    /// The number of the requested variable, whether it is put, and since when.
    waiting: Option<(i32, bool, Instant)>,
    requests: u32,
    pub(crate) answers: u32,
    pub(crate) errors: u32,
    pub(crate) lost: u32,
    longest: Duration,
    /// The times of right answers, in microseconds, in each phase.
    times: [Vec<u32>; 2],
    /// The phase whose times are kept, if any.
    pub(crate) phase: Option<Phase>,
}

impl Plc {
    fn new(socket: SocketHandle, index: usize) -> Self {
        let next_port = 48_000 + 4000 * u16::try_from(index).unwrap();
        Self {
            socket,
            reconnects: false,
            next_port,
            received: Vec::new(),
            waiting: None,
            requests: 0,
            answers: 0,
            errors: 0,
            lost: 0,
            longest: Duration::ZERO,
            times: Default::default(),
            phase: None,
        }
    }

    fn go_on(&mut self, socket: &mut tcp::Socket<'_>, interface: &mut Interface, rng: &mut Rng) {
        if let Some((number, _, since)) = self.waiting {
            assert!(since.elapsed() < BOUND, "the request for I{number} has not ended");
        }
        if socket.can_recv() {
            socket.recv(|bytes| (bytes.len(), self.received.extend_from_slice(bytes))).unwrap();
            while let Some(end) = self.received.iter().position(|byte| *byte == b'\r') {
                let line: Vec<u8> = self.received.drain(..=end).collect();
                self.check(str::from_utf8(&line[..end]).unwrap());
                if self.reconnects {
                    socket.close();
                }
            }
        }
        if !socket.is_open() || !matches!(socket.state(), tcp::State::SynSent) && !socket.may_recv() {
            self.connect(socket, interface);
        }
        if self.waiting.is_none() && socket.can_send() {
            let (number, put) = (rng.i32(0..VARIABLES), rng.bool());
            let line = match put {
                true => format!("PUT:RC8:{number}:I:3,{}\r", value_of(number)),
                false => format!("GET:RC8:{number}:I:\r"),
            };
            // the buffer is empty, as the request before has been answered
            assert_eq!(socket.send_slice(line.as_bytes()), Ok(line.len()));
            self.waiting = Some((number, put, Instant::now()));
            self.requests += 1;
        }
    }

    fn check(&mut self, answer: &str) {
        let Some((number, put, since)) = self.waiting.take() else { panic!("an answer without a request: {answer:?}") };
        let time = since.elapsed();
        self.longest = self.longest.max(time);
        let right = if put { "0".to_owned() } else { format!("0,3,{}", value_of(number)) };
        match i32::from_str(answer) {
            _ if answer == right => {
                self.answers += 1;
                if let Some(phase) = self.phase {
                    self.times[phase as usize].push(u32::try_from(time.as_micros()).unwrap());
                }
            }
            Ok(code) if HResult(code).is_err() => self.errors += 1,
            _ => panic!("the answer for I{number}, {right:?}, is {answer:?}"),
        }
    }

    fn connect(&mut self, socket: &mut tcp::Socket<'_>, interface: &mut Interface) {
        if let Some((_, _, since)) = self.waiting.take() {
            self.lost += 1;
            self.longest = self.longest.max(since.elapsed());
        }
        self.received.clear();
        socket.abort();
        bare::set_up(socket);
        // a range for each of them
        self.next_port = if self.next_port % 4000 == 3999 { self.next_port - 3999 } else { self.next_port + 1 };
        socket.connect(interface.context(), (BOARD, 5006), self.next_port).unwrap();
    }
}

/// A robot controller whose variables have their values.
pub(crate) struct Robot {
    /// Values that do not belong to their variable.
    pub(crate) wrong: u32,
    requests: u32,
}

impl Handler for Robot {
    fn call(&mut self, _: PeerId, request: &Request<'_>, reply: &mut ReplyValue<'_>, _: CoreInstant) -> Outcome {
        const FIRST: i32 = 1000;
        let number = request.handle() - FIRST;
        let set = match request.function {
            FunctionId::CONTROLLER_CONNECT => reply.set(&1),
            FunctionId::CONTROLLER_GET_ROBOT => reply.set(&2),
            // slvGetMode: no stream runs
            FunctionId::ROBOT_EXECUTE => reply.set(&0),
            FunctionId::CONTROLLER_GET_VARIABLE => {
                let mut memory = [0; 16];
                let name = request.text(1).to_str(&mut memory);
                match name.and_then(|name| name.strip_prefix('I')?.parse::<i32>().ok()) {
                    Some(number) => reply.set(&(FIRST + number)),
                    None => return HResult::E_INVALIDARG.into(),
                }
            }
            FunctionId::VARIABLE_GET_VALUE => {
                self.requests += 1;
                reply.set(&value_of(number))
            }
            FunctionId::VARIABLE_PUT_VALUE => {
                self.requests += 1;
                self.wrong += u32::from(request.value(1).as_i32() != Some(value_of(number)));
                Ok(())
            }
            _ => Ok(()),
        };
        set.map_or(HResult::E_FAIL, |()| HResult::S_OK).into()
    }
}

/// The counts of the frames of a direction.
#[derive(Default)]
struct Way {
    frames: u32,
    dropped: u32,
    repeated: u32,
    delayed: u32,
}

impl std::fmt::Display for Way {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { frames, dropped, repeated, delayed } = self;
        write!(f, "{frames} frames, {dropped} dropped, {repeated} repeated, {delayed} delayed")
    }
}

/// The wire: a datagram for each frame, and the injected faults.
pub(crate) struct Wire {
    pub(crate) link: UdpSocket,
    rng: Rng,
    faulty: bool,
    /// To the board and from it.
    ways: [Way; 2],
    pub(crate) arrived: VecDeque<Vec<u8>>,
    /// Frames on their way: when they arrive, and whether at the board.
    delayed: Vec<(Instant, bool, Vec<u8>)>,
}

impl Wire {
    /// Creates a wire, and the back-end of QEMU's that is its other end.
    pub(crate) fn open(seed: u64) -> (Self, String) {
        let link = UdpSocket::bind("127.0.0.1:0").unwrap();
        let other = UdpSocket::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
        link.connect(other).unwrap();
        link.set_read_timeout(Some(Duration::from_millis(1))).unwrap();
        let netdev = format!("socket,id=n0,udp={},localaddr={other}", link.local_addr().unwrap());
        let wire = Self {
            link,
            rng: Rng::with_seed(seed),
            faulty: false,
            ways: Default::default(),
            arrived: VecDeque::new(),
            delayed: Vec::new(),
        };
        (wire, netdev)
    }

    /// Receives frames, and delivers delayed frames whose time has come; without any, waits for a millisecond.
    pub(crate) fn receive(&mut self) {
        let now = Instant::now();
        while let Some(at) = self.delayed.iter().position(|(deadline, _, _)| *deadline <= now) {
            let (_, to_board, frame) = self.delayed.remove(at);
            self.arrive(to_board, frame);
        }
        let mut buffer = [0; 2048];
        // until QEMU is up no process receives the frames, and the next call reports that as an error
        while let Ok(count) = self.link.recv(&mut buffer) {
            self.carry(false, buffer[..count].to_vec());
            if self.arrived.len() >= 16 {
                break;
            }
            // waits only for the first frame: the timeout of a socket may take two ticks of the kernel
            self.link.set_nonblocking(true).unwrap();
        }
        self.link.set_nonblocking(false).unwrap();
    }

    fn carry(&mut self, to_board: bool, frame: Vec<u8>) {
        let way = &mut self.ways[usize::from(!to_board)];
        way.frames += 1;
        let chance = if self.faulty { self.rng.u8(0..100) / FAULTS } else { u8::MAX };
        match chance {
            0 => way.dropped += 1,
            1 => {
                way.repeated += 1;
                self.arrive(to_board, frame.clone());
                self.arrive(to_board, frame);
            }
            2 => {
                way.delayed += 1;
                let deadline = Instant::now() + Duration::from_millis(self.rng.u64(DELAY_MS));
                self.delayed.push((deadline, to_board, frame));
            }
            _ => self.arrive(to_board, frame),
        }
    }

    fn arrive(&mut self, to_board: bool, frame: Vec<u8>) {
        match to_board {
            true => drop(self.link.send(&frame)),
            false => self.arrived.push_back(frame),
        }
    }
}

impl Device for Wire {
    type RxToken<'a> = Frame;
    type TxToken<'a> = Room<'a>;

    fn receive(&mut self, _: smoltcp::time::Instant) -> Option<(Frame, Room<'_>)> {
        let frame = self.arrived.pop_front()?;
        Some((Frame(frame), Room(self)))
    }

    fn transmit(&mut self, _: smoltcp::time::Instant) -> Option<Room<'_>> {
        Some(Room(self))
    }

    fn capabilities(&self) -> DeviceCapabilities {
        let mut capabilities = DeviceCapabilities::default();
        capabilities.medium = Medium::Ethernet;
        capabilities.max_transmission_unit = 1514;
        capabilities
    }
}

/// A frame that has arrived.
pub(crate) struct Frame(Vec<u8>);

impl phy::RxToken for Frame {
    fn consume<R, F: FnOnce(&[u8]) -> R>(self, f: F) -> R {
        f(&self.0)
    }
}

/// Room for a frame to the board.
pub(crate) struct Room<'a>(&'a mut Wire);

impl phy::TxToken for Room<'_> {
    fn consume<R, F: FnOnce(&mut [u8]) -> R>(self, len: usize, f: F) -> R {
        let mut frame = vec![0; len];
        let result = f(&mut frame);
        self.0.carry(true, frame);
        result
    }
}
