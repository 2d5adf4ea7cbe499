//! A simulated network and serial line with a seed, a fake clock and configurable faults.
//!
//! The simulation never sleeps: the clock jumps to the next packet or deadline. The same seed gives the same run.

use bcap_core::endpoint::{Endpoint, Serve};
use std::cmp::Reverse;
use std::collections::{BinaryHeap, HashMap};
use std::time::Duration;

use bcap_core::bcap::call::{self, Call, ControllerHandle, Reply};
use bcap_core::bcap::client::{self, Client, ClientError};
use bcap_core::bcap::server::{self, Handler, Request, Session};
use bcap_core::bcap::{FunctionId, Link, Object};
use bcap_core::handler::{Outcome, PeerId, ReplyValue};
use bcap_core::hresult::HResult;
use bcap_core::time::Instant;

/// A generator of random numbers (SplitMix64): small, seeded, identical on all platforms.
#[derive(Clone, Debug)]
pub struct Random(pub u64);

impl Random {
    /// Returns the next number.
    pub fn number(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut mixed = self.0;
        mixed = (mixed ^ (mixed >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        mixed ^ (mixed >> 31)
    }

    /// Returns a number below `end`, which is not 0.
    pub fn below(&mut self, end: u64) -> u64 {
        self.number() % end
    }

    /// Returns true with this probability, in thousandths.
    pub fn happens(&mut self, per_mille: u64) -> bool {
        self.below(1000) < per_mille
    }
}

/// The faults of the network; probabilities in thousandths.
#[derive(Clone, Copy, Debug, Default)]
pub struct Faults {
    /// A packet is lost. A stream loses nothing.
    pub loss: u64,
    /// A packet arrives twice.
    pub repeat: u64,
    /// The maximum delay of a packet. Each packet has a separate delay, so packets overtake each other, except on a stream.
    pub delay: Duration,
    /// A packet takes up to ten seconds.
    pub straggle: u64,
    /// A byte is changed; useful only where a checksum detects it.
    pub garble: u64,
    /// The maximum run time of a call in the server.
    pub work: Duration,
}

/// The application of the simulated server; it counts the executions of each token.
#[derive(Debug)]
pub struct Counter {
    /// The number of executions of each token.
    pub executed: HashMap<i32, u32>,
    random: Random,
    work: Duration,
    until: Instant,
    next_handle: i32,
    /// The number of calls that the server abandoned.
    pub abandoned: u32,
    /// Handles given out and not released, by their object.
    pub open: Vec<(Object, i32)>,
}

/// The answer of the server to a token.
#[must_use]
pub const fn answer_to(token: i32) -> i32 {
    token.wrapping_mul(3).wrapping_add(1)
}

impl Counter {
    fn new(work: Duration, seed: u64) -> Self {
        Self {
            executed: HashMap::new(),
            random: Random(seed),
            work,
            until: Instant::ZERO,
            next_handle: 0,
            abandoned: 0,
            open: Vec::new(),
        }
    }
}

impl Handler for Counter {
    fn call(&mut self, peer: PeerId, request: &Request<'_>, reply: &mut ReplyValue<'_>, now: Instant) -> Outcome {
        let function = request.function;
        if let Some(object) = function.opens() {
            self.next_handle += 1;
            self.open.push((object, self.next_handle));
            if object != Object::Service {
                reply.set(&self.next_handle).expect("a handle fits");
            }
            return HResult::S_OK.into();
        }
        if let Some(object) = function.releases() {
            self.open.retain(|open| open.0 != object || (object != Object::Service && open.1 != request.handle()));
            return HResult::S_OK.into();
        }
        assert_eq!(function, FunctionId::CONTROLLER_EXECUTE, "the simulated clients call nothing else");
        if !self.work.is_zero() {
            let work = self.random.below(self.work.as_micros() as u64 + 1);
            self.until = now + Duration::from_micros(work);
        }
        self.resume(peer, request, reply, now)
    }

    fn resume(&mut self, _: PeerId, request: &Request<'_>, reply: &mut ReplyValue<'_>, now: Instant) -> Outcome {
        if now < self.until {
            return Outcome::Wait(self.until);
        }
        let token = request.int(2);
        *self.executed.entry(token).or_default() += 1;
        reply.set(&answer_to(token)).expect("a number fits");
        HResult::S_OK.into()
    }

    fn abandoned(&mut self, _: PeerId, _: Instant) {
        self.abandoned += 1;
    }
}

/// Where a packet goes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum To {
    Client,
    Server,
}

/// The arrival time of a packet, its number, its content and its destination.
type Packet = (Instant, u64, To, Vec<u8>);

/// A client, a server, and the network between them.
pub struct Simulation {
    /// The client.
    pub client: Client<[u8; 512]>,
    /// The server's side.
    pub session: Session<[u8; 512]>,
    /// The application behind it.
    pub counter: Counter,
    /// The current time.
    pub now: Instant,
    /// Events of the client, counted by kind: retries, stale replies, malformed replies, keep-alives.
    pub seen: Seen,
    /// The faults of the network; they can be changed at any time.
    pub faults: Faults,
    /// The random number generator of the faults.
    pub random: Random,
    /// Packets in flight, ordered by arrival time; the number breaks ties.
    wire: BinaryHeap<Reverse<Packet>>,
    sent: u64,
    /// When the last packet in each direction arrives; packets of a stream never overtake it.
    last: [Instant; 2],
    controller: ControllerHandle,
}

/// The number of client events of each kind.
#[derive(Clone, Copy, Debug, Default)]
pub struct Seen {
    /// Repeated attempts.
    pub retries: u32,
    /// Replies to calls that had ended.
    pub stale: u32,
    /// Bytes that were not a frame.
    pub malformed: u32,
    /// S_EXECUTING.
    pub executing: u32,
}

impl Simulation {
    /// Creates both ends, not yet connected.
    #[must_use]
    pub fn new(client: client::Config, server: server::Config, faults: Faults, seed: u64) -> Self {
        Self {
            client: Client::new(client, [0; 512], [0; 512]),
            session: Session::new(server, [0; 512], [0; 512]),
            counter: Counter::new(faults.work, seed ^ 0x5555),
            now: Instant::from_millis(1),
            seen: Seen::default(),
            faults,
            random: Random(seed),
            wire: BinaryHeap::new(),
            sent: 0,
            last: [Instant::ZERO; 2],
            controller: ControllerHandle(0),
        }
    }

    /// Starts the service and connects to the controller, with as many retries as necessary.
    pub fn connect(&mut self) {
        while self.run(&call::service_start("WDT=200")).is_err() {}
        loop {
            if self.run(&call::controller_connect("", "", "", "")).is_ok()
                && let Ok(handle) = self.client.value::<ControllerHandle>()
            {
                self.controller = handle;
                return;
            }
        }
    }

    /// Makes the call with `token`, and returns the value of the reply.
    ///
    /// # Errors
    ///
    /// How the call ended otherwise.
    pub fn token(&mut self, token: i32) -> Result<i32, ClientError> {
        let call = call::controller_execute(self.controller, "token", token);
        let code = self.run(&call)?;
        assert_eq!(code, HResult::S_OK, "the counter refuses nothing");
        self.client.value::<call::Int>()
    }

    /// Begins the call with `token`, without waiting for its end.
    ///
    /// # Errors
    ///
    /// When the client cannot begin it.
    pub fn begin(&mut self, token: i32) -> Result<(), ClientError> {
        let call = call::controller_execute(self.controller, "token", token);
        self.client.start(&call, self.client.timing(), self.now)
    }

    /// Makes a call and waits for its end.
    ///
    /// # Errors
    ///
    /// How the call ended otherwise.
    pub fn run<C: Call>(&mut self, call: &C) -> Result<HResult, ClientError>
    where
        C::Reply: Reply,
    {
        self.client.start(call, self.client.timing(), self.now)?;
        self.finish()
    }

    /// Lets time pass until the call in flight has ended.
    ///
    /// # Errors
    ///
    /// How the call ended otherwise.
    pub fn finish(&mut self) -> Result<HResult, ClientError> {
        loop {
            self.send();
            let next = [self.wire.peek().map(|next| next.0.0), self.client.poll_timeout(), self.session.poll_timeout()];
            let next = next.into_iter().flatten().min().expect("a call is in flight, so something must come");
            self.now = self.now.max(next);
            let mut event = self.client.handle_timeout(self.now);
            if event.is_none()
                && let Some((to, packet)) = self.arrived()
            {
                event = self.deliver(to, packet);
            }
            if let Some(result) = self.note(event) {
                return result;
            }
            self.serve();
        }
    }

    /// Delivers the packets in flight, for the duration `more`.
    pub fn settle(&mut self, more: Duration) {
        let end = self.now + more;
        loop {
            self.send();
            let next = [self.wire.peek().map(|next| next.0.0), self.session.poll_timeout()].into_iter().flatten().min();
            let Some(next) = next.filter(|next| *next <= end) else { break };
            self.now = self.now.max(next);
            if let Some((to, packet)) = self.arrived() {
                let event = self.deliver(to, packet);
                assert!(self.note(event).is_none(), "no call is in flight");
            }
            self.serve();
        }
        self.now = end;
    }

    /// Counts an event of the client; returns the outcome of the call if the event ends it.
    fn note(&mut self, event: Option<client::Event>) -> Option<Result<HResult, ClientError>> {
        match event? {
            client::Event::Replied(code) => return Some(Ok(code)),
            client::Event::Failed(error) => return Some(Err(error)),
            client::Event::Retried { .. } => self.seen.retries += 1,
            client::Event::Stale { .. } => self.seen.stale += 1,
            client::Event::Malformed(_) => self.seen.malformed += 1,
            client::Event::Executing => self.seen.executing += 1,
            _ => {}
        }
        None
    }

    fn arrived(&mut self) -> Option<(To, Vec<u8>)> {
        if self.wire.peek()?.0.0 > self.now {
            return None;
        }
        self.wire.pop().map(|Reverse((_, _, to, packet))| (to, packet))
    }

    /// Gives a packet to its end, and returns the client's result if that ends its call.
    fn deliver(&mut self, to: To, packet: Vec<u8>) -> Option<client::Event> {
        let mut rest = &packet[..];
        let mut ended = None;
        while !rest.is_empty() {
            let buffer = match to {
                To::Client => self.client.receive_buffer(),
                To::Server => self.session.receive_buffer(),
            };
            let count = rest.len().min(buffer.len());
            if count == 0 {
                // a busy server has no room for a datagram; one call at a time never fills the buffer of a stream
                assert_eq!(self.client.link(), Link::Datagram, "no room for {} bytes", rest.len());
                break;
            }
            buffer[..count].copy_from_slice(&rest[..count]);
            rest = &rest[count..];
            match to {
                To::Server => {
                    self.session.received(count);
                    self.serve();
                }
                To::Client => {
                    self.client.received(count);
                    while let Some(event) = self.client.poll_event(self.now) {
                        if matches!(event, client::Event::Replied(_) | client::Event::Failed(_)) {
                            assert_eq!(ended, None, "a call ends once");
                            ended = Some(event);
                        } else {
                            assert!(self.note(Some(event)).is_none());
                        }
                        if ended.is_some() {
                            // the reply is read before anything else is received
                            break;
                        }
                    }
                }
            }
            if ended.is_some() && !rest.is_empty() {
                self.wire.push(Reverse((self.now, 0, to, rest.to_vec())));
                break;
            }
        }
        ended
    }

    /// Runs the server until it makes no progress.
    fn serve(&mut self) {
        loop {
            let event = self.session.run(&mut self.counter, PeerId(1), self.now);
            let sent = self.transmit(To::Client);
            if event.is_none() && !sent {
                break;
            }
        }
    }

    /// Puts the pending bytes of both ends on the wire.
    fn send(&mut self) {
        while self.transmit(To::Server) {}
        self.serve();
    }

    /// Puts the pending bytes of one end on the wire: a datagram or a piece of a stream.
    fn transmit(&mut self, to: To) -> bool {
        let bytes = match to {
            To::Client => self.session.transmit(),
            To::Server => self.client.transmit(),
        };
        if bytes.is_empty() {
            return false;
        }
        let datagram = self.client.link() == Link::Datagram;
        let count = if datagram { bytes.len() } else { 1 + self.random.below(bytes.len() as u64) as usize };
        let mut packet = bytes[..count].to_vec();
        match to {
            To::Client => self.session.transmitted(count),
            To::Server => self.client.transmitted(count),
        }
        for byte in &mut packet {
            if self.random.happens(self.faults.garble) {
                *byte ^= 1 << self.random.below(8);
            }
        }
        let copies = 1 + u32::from(datagram && self.random.happens(self.faults.repeat));
        for _ in 0..copies {
            if !self.random.happens(self.faults.loss) {
                self.put(to, packet.clone(), datagram);
            }
        }
        true
    }

    fn put(&mut self, to: To, packet: Vec<u8>, overtakes: bool) {
        let delay = match self.random.happens(self.faults.straggle) {
            true => self.random.below(10_000_000),
            false => self.random.below(self.faults.delay.as_micros() as u64 + 1),
        };
        let mut at = self.now + Duration::from_micros(delay);
        if !overtakes {
            let last = &mut self.last[usize::from(to == To::Client)];
            at = at.max(*last);
            *last = at;
        }
        self.sent += 1;
        self.wire.push(Reverse((at, self.sent, to, packet)));
    }
}
