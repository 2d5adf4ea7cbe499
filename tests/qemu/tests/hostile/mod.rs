//! Tests the gateway board in QEMU on a hostile network: invalid leases, half-open connections, slow clients of the page,
//! random frames. At the same time the robot is killed, the link is cut, the serial port gets random bytes, and the clock
//! wraps.
//!
//! ```text
//!  4 PLCs, one of which connects for each request ─┐
//!                                           robot ─┼─ Ethernet, cut ─ gateway image ─ serial port ─ random bytes
//!  20 DHCP servers, floods, slow HTTP, pings ──────┘
//! ```
//!
//! The board must not be reset, every answer must be right, and the PLC that connects anew must be served during the attack.
//! The clock is set so that its 32 bits of microseconds wrap in the middle of the attack. `-icount` cannot do this: peers in
//! real time cannot follow a clock that runs faster.
//!
//! An attack of more than ten minutes has rounds of five minutes. Before each round the PLCs are calm for a while, so that both
//! phases meet the same load of this machine.
//!
//! `HOSTILE_SECONDS` and `HOSTILE_SEED` are the length of the attack, 10 s, and the seed, 1. `HOSTILE_BARS` makes the test fail
//! when the PLCs with an open connection have a p99 above twice the calm one, without the times of failures, or when a PLC is
//! not served 10 s after a failure.

mod failures;

use std::io::{self, Write};
use std::net::{Ipv4Addr, UdpSocket};
use std::time::{Duration, Instant};

use bcap_embassy::bare;
use bcap_qemu::Board;
use bcap_test_support::dhcp::{Answer, GOOD};
use bcap_test_support::frames::{arp_reply, packet, syn};
use fastrand::Rng;
use smoltcp::iface::SocketHandle;
use smoltcp::phy::ChecksumCapabilities;
use smoltcp::socket::tcp;
use smoltcp::wire::{
    ArpOperation, ArpPacket, DhcpMessageType, DhcpPacket, DhcpRepr, Icmpv4Packet, Icmpv4Repr, IpProtocol,
};

use self::failures::{Failures, Sockets};
use crate::wire::{BOARD, HOST, Phase, Wire, World};

const MAC: [u8; 6] = [2, 0, 0, 0, 0, 0x15];
/// The last bytes of the addresses that answer ARP requests, and never finish a handshake.
const ATTACKERS: std::ops::Range<u8> = 3..7;
/// The header of Ethernet, and those up to a message of ICMP and of DHCP.
const ETHERNET: usize = 14;
const ICMP: usize = ETHERNET + 20;
const DHCP: usize = ICMP + 8;
/// The pauses between half-open connections, random frames, pings, requests of slow clients, and random bytes, in milliseconds.
const PAUSES: [u64; 5] = [25, 5, 100, 50, 20];
/// The random frames of an hour.
const FRAMES: u32 = 100_000;
const PING: u16 = 0x1234;
/// How long the board may need to serve all PLCs after the attack; usually it takes a few seconds.
const RECOVERY: Duration = Duration::from_secs(60);
/// The same, with bars.
const SERVED_AGAIN: Duration = Duration::from_secs(10);
const HOUR: Duration = Duration::from_secs(3600);
/// The length of a round.
const ROUND: u64 = 300;

#[test]
fn a_hostile_network_resets_nothing_and_keeps_no_plc_out() {
    let setting = |name: &str, usual: u64| std::env::var(name).map_or(usual, |text| text.parse().unwrap());
    let length = Duration::from_secs(setting("HOSTILE_SECONDS", 10));
    let seed = setting("HOSTILE_SEED", 1);
    let plan = Plan::of(length);
    let (wire, netdev) = Wire::open(seed);
    let limit = (2 * length.as_secs() + 900).to_string();
    let sockets = Sockets::new();
    // the forwarded port belongs to user networking, which is not used
    let options = [&["--netdev", &netdev, "--health", "1", "--time", &limit], &sockets.options()[..]].concat();
    let settings = ["provider=CaoProv.DENSO.VRC", "put=I", "mac=02:00:00:00:00:15"];
    let mut board = Board::start("10.0.2.2:5007", &options, &settings);
    let mut world = World::new(wire, 4, seed);
    world.plcs[3].reconnects = true;
    let mut attack = Attack::new(&mut world, seed);

    // the board may have to be built first
    let is_up = |world: &World| world.plcs.iter().all(|plc| plc.answers > 0);
    attack.run(&mut world, &mut board, Duration::from_secs(600), is_up).unwrap();
    attack.failures = Some(sockets.connect(&mut board, plan.wrap(), Rng::with_seed(seed)));
    let ended = attack.rounds(&mut world, &mut board, &plan);
    let mut missed = attack.missed(&world, length);
    if std::env::var_os("HOSTILE_BARS").is_some() {
        missed.extend(attack.missed_bars(&world));
    }
    say(&attack.summary(&world, ended.is_ok()));
    assert!(ended.is_ok() && missed.is_empty(), "{ended:?}; {missed:?}");
}

/// The rounds of an attack.
struct Plan {
    rounds: u32,
    /// The duration of the calm phase before each round, and of the round.
    calm: Duration,
    round: Duration,
}

impl Plan {
    fn of(length: Duration) -> Self {
        let rounds = u32::try_from(length.as_secs() / ROUND).unwrap().max(1);
        let round = length / rounds;
        Self { rounds, calm: (round / 10).max(Duration::from_secs(3)), round }
    }

    /// Returns when the clock of the board wraps: in the middle of the attack. A jump of the clock ends leases and connections.
    fn wrap(&self) -> Duration {
        (self.calm + self.round) * (self.rounds / 2) + self.round / 2
    }
}

/// Prints a line; not with `eprintln`, which the tests of cargo show of failures only.
fn say(line: &str) {
    let _ = writeln!(io::stderr(), "hostile network: {line}");
}

/// The traffic to and from the board during the attack.
#[derive(Clone, Copy, Debug, Default)]
struct Found {
    /// Requests of DHCP, and invalid leases.
    requests: u32,
    leases: u32,
    half_open: u32,
    frames: u32,
    pings: u32,
    pongs: u32,
    /// Requests of slow clients, pages, and requests without a page.
    slow: u32,
    pages: u32,
    no_page: u32,
}

struct Attack {
    link: UdpSocket,
    rng: Rng,
    is_on: bool,
    next: [Instant; PAUSES.len()],
    /// The slow clients of the page, and after them one that reads it.
    browsers: Vec<(SocketHandle, Vec<u8>)>,
    next_port: u16,
    /// After the board is up.
    failures: Option<Failures>,
    /// The uptime on the page that was read last, in seconds.
    uptime: u64,
    /// Maximum time until all PLCs were served after a round.
    served_again: Duration,
    found: Found,
}

impl Attack {
    fn new(world: &mut World, seed: u64) -> Self {
        let buffer = || tcp::SocketBuffer::new(vec![0; 4096]);
        let mut socket = || world.sockets.add(tcp::Socket::new(buffer(), buffer()));
        Self {
            browsers: (0..4).map(|_| (socket(), Vec::new())).collect(),
            link: world.wire.link.try_clone().unwrap(),
            rng: Rng::with_seed(seed),
            is_on: false,
            next: [Instant::now(); PAUSES.len()],
            next_port: 30_000,
            failures: None,
            uptime: 0,
            served_again: Duration::ZERO,
            found: Found::default(),
        }
    }

    /// Runs until `done`, at most for `limit`; the board must run throughout.
    fn run(
        &mut self,
        world: &mut World,
        board: &mut Board,
        limit: Duration,
        done: impl Fn(&World) -> bool,
    ) -> Result<(), String> {
        let since = Instant::now();
        while !done(world) {
            if !board.is_running() {
                return Err(format!("the board has ended or was reset: {}", board.log()));
            }
            if since.elapsed() >= limit {
                return Err(format!("nothing goes on: {}; {}", world.report(), board.log()));
            }
            world.wire.receive();
            for frame in &world.wire.arrived {
                self.answer(frame);
            }
            if self.is_on {
                self.attack(world);
            }
            world.poll();
        }
        Ok(())
    }

    fn run_for(&mut self, world: &mut World, board: &mut Board, length: Duration) -> Result<(), String> {
        let end = Instant::now() + length;
        self.run(world, board, 2 * length + RECOVERY, |_| Instant::now() >= end)
    }

    /// Attacks in rounds, and lets the PLCs be calm before each.
    fn rounds(&mut self, world: &mut World, board: &mut Board, plan: &Plan) -> Result<(), String> {
        self.until_served(world, board)?;
        world.forget();
        (self.found, self.served_again) = (Found::default(), Duration::ZERO);
        for number in 1..=plan.rounds {
            world.enter(Some(Phase::Calm));
            self.run_for(world, board, plan.calm)?;
            self.is_on = true;
            self.run_for(world, board, plan.round)?;
            self.stop(world);
            say(&format!("{:?}: {}", plan.round * number, self.report(world)));
            self.until_served(world, board)?;
        }
        self.failures.as_mut().map_or(Ok(()), Failures::console_answers)
    }

    /// Returns what the attack must not show on any machine.
    fn missed(&self, world: &World, length: Duration) -> Vec<String> {
        let Self { found, uptime, .. } = self;
        // a renewal every 10 s, what follows the attack, and some for each cut of the link
        let cut = self.failures.as_ref().map_or(0, |failures| failures.cut);
        let requests = length.as_secs() / 4 + 10 + 8 * u64::from(cut);
        let checks = [
            (world.robot.wrong == 0, "values at the robot that no PLC wrote".to_owned()),
            (world.plcs.iter().all(|plc| plc.answers > 0), format!("a PLC without answers: {}", world.report())),
            (found.pongs > 0 && found.pages > 0, format!("{found:?}")),
            (*uptime > u64::from(u32::MAX) / 1_000_000, format!("the clock did not wrap: {uptime} s")),
            (u64::from(found.requests) <= requests, format!("too many requests of DHCP: {found:?}")),
            (length < HOUR || found.frames >= FRAMES, format!("too few frames: {found:?}")),
        ];
        checks.into_iter().filter_map(|(is_met, what)| (!is_met).then_some(what)).collect()
    }

    /// Returns the bars that are missed; a busy machine also misses them.
    fn missed_bars(&self, world: &World) -> Vec<String> {
        let [calm, attacked] = [Phase::Calm, Phase::Attack].map(|phase| world.percentile(phase, 99));
        let late = self.longest();
        let p99 = (attacked > 2 * calm).then(|| format!("p99 {attacked:?} under attack, {calm:?} without"));
        p99.into_iter().chain((late > SERVED_AGAIN).then(|| format!("all PLCs served again after {late:?}"))).collect()
    }

    /// Returns the longest time until all PLCs were served after a failure or a round.
    fn longest(&self) -> Duration {
        self.failures.as_ref().map_or(Duration::ZERO, |failures| failures.longest).max(self.served_again)
    }

    fn summary(&self, world: &World, has_ended: bool) -> String {
        let answers: u32 = world.plcs.iter().map(|plc| plc.answers).sum();
        let [calm, attacked] = [Phase::Calm, Phase::Attack].map(|phase| world.percentile(phase, 99));
        // a PLC ends the test when it gets a wrong answer
        let resets = if has_ended { "0 resets" } else { "ended early" };
        format!(
            "{resets}, {} wrong of {answers} answers, p99 {calm:.1?} calm and {attacked:.1?} attacked, served again after at most {:.1?}; \
             the clock of the board is at {} s",
            world.robot.wrong,
            self.longest(),
            self.uptime
        )
    }

    /// Ends the attack and its failure.
    fn stop(&mut self, world: &mut World) {
        self.is_on = false;
        if let Some(failures) = &mut self.failures {
            failures.stop(world);
        }
    }

    /// Runs until each PLC has 20 more answers.
    fn until_served(&mut self, world: &mut World, board: &mut Board) -> Result<(), String> {
        let before: Vec<u32> = world.plcs.iter().map(|plc| plc.answers).collect();
        let since = Instant::now();
        self.run(world, board, RECOVERY, |world| {
            world.plcs.iter().zip(&before).all(|(plc, before)| plc.answers >= before + 20)
        })?;
        self.served_again = self.served_again.max(since.elapsed());
        Ok(())
    }

    fn report(&self, world: &World) -> String {
        let failures = self.failures.as_ref().map(Failures::to_string).unwrap_or_default();
        let answers: Vec<u32> = world.plcs.iter().map(|plc| plc.answers).collect();
        let [calm, attacked] = [Phase::Calm, Phase::Attack].map(|phase| {
            let [p50, p99] = [50, 99].map(|percent| world.percentile(phase, percent));
            format!("p50 {p50:.1?}, p99 {p99:.1?}")
        });
        format!("{:?}; {failures}; {attacked}, calm {calm}; {}; answers {answers:?}", self.found, world.report())
    }

    fn send(&self, frame: &[u8]) {
        // until QEMU is up no process receives the frames
        let _ = self.link.send(frame);
    }

    /// Answers a request of DHCP with invalid leases and a valid one, and ARP requests for attackers; counts pongs.
    fn answer(&mut self, frame: &[u8]) {
        if let Some(asked) = asked_for(frame) {
            self.send(&arp_reply(MAC, BOARD, asked));
        }
        let protocol = frame.get(ETHERNET + 9).map(|protocol| IpProtocol::from(*protocol));
        if protocol == Some(IpProtocol::Icmp) {
            let reply = Icmpv4Packet::new_checked(&frame[ICMP..]).unwrap();
            let reply = Icmpv4Repr::parse(&reply, &ChecksumCapabilities::default());
            self.found.pongs += u32::from(matches!(reply, Ok(Icmpv4Repr::EchoReply { ident: PING, .. })));
        }
        let message = frame.get(DHCP..).filter(|_| protocol == Some(IpProtocol::Udp));
        let Some(Ok(message)) = message.map(DhcpPacket::new_checked) else { return };
        let Ok(request) = DhcpRepr::parse(&message) else { return };
        self.found.requests += 1;
        let kind = match request.message_type {
            DhcpMessageType::Discover => DhcpMessageType::Offer,
            _ => DhcpMessageType::Ack,
        };
        for lease in invalid_leases() {
            self.send(&Answer { kind, transaction: request.transaction_id, ..lease }.frame(MAC));
            self.found.leases += 1;
        }
        // a valid lease whose router is not one
        let router = [[0, 0, 0, 0], [255, 255, 255, 255], [224, 0, 0, 1]][self.rng.usize(..3)];
        let times = [Some(20), None, None];
        let lease = Answer { kind, transaction: request.transaction_id, router: Some(router.into()), times, ..GOOD };
        self.send(&lease.frame(MAC));
    }

    fn attack(&mut self, world: &mut World) {
        let now = Instant::now();
        let starts = self.next.map(|next| next <= now);
        for ((next, pause), _) in self.next.iter_mut().zip(PAUSES).zip(starts).filter(|(_, starts)| *starts) {
            *next = now + Duration::from_millis(pause);
        }
        let [half_open, random, ping, slow, garbage] = starts;
        if let Some(failures) = &mut self.failures {
            failures.go_on(world);
            if garbage {
                failures.send_garbage();
            }
        }
        if half_open {
            // from unused addresses of the board's network and of another network, and from machines
            let host = self.rng.u8(20..250);
            let [unused, far] = [[10, 0, 2, host], [172, 16, 0, host]].map(Ipv4Addr::from);
            let from = [unused, far, Ipv4Addr::new(10, 0, 2, self.rng.u8(ATTACKERS))][self.rng.usize(..3)];
            let ports = [self.rng.u16(1024..), 5006];
            self.send(&syn(MAC, from, BOARD, ports));
            self.found.half_open += 1;
        }
        if random {
            let frame = random_frame(&mut self.rng);
            self.send(&frame);
            self.found.frames += 1;
        }
        if ping {
            self.ping();
        }
        self.browse(world, slow);
    }

    fn ping(&mut self) {
        let data = &[0x55; 56];
        let echo = Icmpv4Repr::EchoRequest { ident: PING, seq_no: 1, data };
        let write = |bytes: &mut [u8]| {
            echo.emit(&mut Icmpv4Packet::new_unchecked(bytes), &ChecksumCapabilities::default());
        };
        self.send(&packet((MAC, HOST, BOARD, IpProtocol::Icmp), echo.buffer_len(), write));
        self.found.pings += 1;
    }

    /// Begins requests for the page without their end, if `slow`, and reads the page with another client.
    fn browse(&mut self, world: &mut World, slow: bool) {
        let count = self.browsers.len();
        for (index, (handle, page)) in self.browsers.iter_mut().enumerate() {
            let reads = index + 1 == count;
            let socket = world.sockets.get_mut::<tcp::Socket<'_>>(*handle);
            if socket.can_recv() {
                socket.recv(|bytes| (bytes.len(), page.extend_from_slice(bytes))).unwrap();
            }
            if socket.can_send() && socket.send_queue() == 0 && page.is_empty() && socket.may_recv() {
                // once: its answer, or a byte that was never received, follows
                page.push(0);
                let request: &[u8] = if reads { b"GET /health.json HTTP/1.1\r\n\r\n" } else { b"GET / HT" };
                socket.send_slice(request).unwrap();
            }
            let has_ended = !matches!(socket.state(), tcp::State::SynSent) && !socket.may_recv();
            if !has_ended || !(slow || reads) {
                continue;
            }
            match (reads, page.get(1..).unwrap_or_default().starts_with(b"HTTP/1.1 200 OK")) {
                (true, true) => {
                    self.found.pages += 1;
                    self.uptime = uptime(page).unwrap_or_default();
                }
                (true, false) => self.found.no_page += 1,
                (false, _) => self.found.slow += 1,
            }
            page.clear();
            socket.abort();
            // a connection that a cut of the link has ended at the board only
            bare::set_up(socket);
            self.next_port = 30_000 + (self.next_port + 1) % 10_000;
            socket.connect(world.interface.context(), (BOARD, 80), self.next_port).unwrap();
        }
    }
}

/// Returns the attacker that an ARP request is for.
fn asked_for(frame: &[u8]) -> Option<Ipv4Addr> {
    let message = frame.get(ETHERNET..).filter(|_| frame.get(12..14) == Some(&[8, 6]))?;
    let message =
        ArpPacket::new_checked(message).ok().filter(|message| message.operation() == ArpOperation::Request)?;
    let asked = Ipv4Addr::from(*message.target_protocol_addr().first_chunk()?);
    let [network @ .., host] = asked.octets();
    (network == [10, 0, 2] && ATTACKERS.contains(&host)).then_some(asked)
}

/// Reads the uptime on a page.
fn uptime(page: &[u8]) -> Option<u64> {
    let page = str::from_utf8(page).ok()?;
    let (_, after) = page.split_once("\"uptime_s\":")?;
    after.split(',').next()?.parse().ok()
}

/// Creates a frame that is random, apart from the head of an IPv4, ARP, TCP, UDP or ICMP packet to the board.
fn random_frame(rng: &mut Rng) -> Vec<u8> {
    let mut bytes: Vec<u8> = (0..rng.usize(1..1400)).map(|_| rng.u8(..)).collect();
    let protocol = [IpProtocol::Tcp, IpProtocol::Udp, IpProtocol::Icmp, IpProtocol::Igmp][rng.usize(..4)];
    let from = Ipv4Addr::from_bits(rng.u32(..));
    // to a port that is open
    let ports = [[0_u16, 5006], [67, 68], [514, 80]][rng.usize(..3)].map(u16::to_be_bytes);
    for (to, byte) in bytes.iter_mut().zip(ports.as_flattened()).skip(2 * rng.usize(..2)) {
        *to = *byte;
    }
    let mut frame = packet((MAC, from, BOARD, protocol), bytes.len(), |payload| payload.copy_from_slice(&bytes));
    if rng.u8(..3) == 0 {
        // ARP, IPv6 or another protocol
        let kind = [[8, 6], [0x86, 0xdd], [rng.u8(..), rng.u8(..)]][rng.usize(..3)];
        frame[ETHERNET - 2..ETHERNET].copy_from_slice(&kind);
    }
    frame
}

/// Returns leases that the board must not use.
fn invalid_leases() -> impl Iterator<Item = Answer> {
    let address = |address: [u8; 4]| Answer { address: address.into(), ..GOOD };
    let mask = |mask: [u8; 4]| Answer { mask: mask.into(), ..GOOD };
    let server = |server: [u8; 4]| Answer { server: server.into(), ..GOOD };
    let time = |seconds| Answer { times: [Some(seconds), None, None], ..GOOD };
    // the last address is the robot's
    let addresses =
        [[0; 4], [10, 0, 2, 0], [10, 0, 2, 255], [224, 0, 0, 1], [255; 4], [127, 0, 0, 1], [10, 0, 2, 2]].map(address);
    let masks = [[0; 4], [255, 0, 255, 0], [0, 255, 255, 0], [255, 255, 255, 1], [0, 0, 0, 1]].map(mask);
    let servers = [[0; 4], [127, 0, 0, 1], [224, 0, 0, 1], [255; 4]].map(server);
    let times = [0, 1, 5, 9].map(time);
    addresses.into_iter().chain(masks).chain(servers).chain(times)
}
