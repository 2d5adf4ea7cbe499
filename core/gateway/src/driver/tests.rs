//! Which client gets and keeps a slot.

extern crate std;

use core::cell::{Cell, RefCell};
use core::convert::Infallible;
use core::future::pending;
use core::net::Ipv4Addr;
use core::pin::pin;
use core::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use core::task::{Context, Poll, Waker};
use core::time::Duration;
use std::string::String;
use std::sync::Arc;
use std::task::Wake;
use std::vec::Vec;

use bcap_core::handler::PeerId;
use bcap_core::io::asynch::Transport;
use bcap_core::time::Instant;

use super::{Client, Denial, Front, Limits, Lock, Platform, Report, SharedGateway, serve};
use crate::modbus::{self, Entry};
use crate::{Config, Gateway, Memory, Network, Rules};

/// A platform whose clients have the number of their host and one more as address.
struct Bench;

struct Unlocked<T>(RefCell<T>);

impl<T> Lock<T> for Unlocked<T> {
    fn new(value: T) -> Self {
        Self(RefCell::new(value))
    }

    fn with<R>(&self, work: impl FnOnce(&mut T) -> R) -> Option<R> {
        self.0.try_borrow_mut().ok().map(|mut value| work(&mut value))
    }
}

/// The time in milliseconds; each test runs in a process or thread with its own order, so only differences matter.
static NOW: AtomicU64 = AtomicU64::new(0);

impl Platform for Bench {
    type Address = (u8, u8);
    type Cause = ();
    type Failure = ();
    type Clients = Vec<Client<(u8, u8)>>;
    type Log = fn(&super::Report<'_, (u8, u8), (), ()>);
    type Lock<T> = Unlocked<T>;

    fn now() -> Instant {
        // every reading is later, so that clients differ in the time of their last bytes
        Instant::from_millis(NOW.fetch_add(1, Ordering::Relaxed))
    }

    fn clients(capacity: usize) -> Self::Clients {
        (0..capacity).map(|_| Client::default()).collect()
    }

    fn ipv4(_: (u8, u8)) -> Option<Ipv4Addr> {
        None
    }

    fn is_same_host(client: (u8, u8), other: (u8, u8)) -> bool {
        client.0 == other.0
    }
}

const LIMITS: Limits = Limits {
    connections_per_address: usize::MAX,
    evict_after: Some(Duration::ZERO),
    receive: Duration::MAX,
    send: Duration::MAX,
    idle: None,
};
const LATER: Limits = Limits { evict_after: Some(Duration::from_secs(1_000_000)), ..LIMITS };
const NEVER: Limits = Limits { evict_after: None, ..LIMITS };

fn is_open(shared: &SharedGateway<'_, Bench>, peer: PeerId) -> bool {
    shared.with(|shared| shared.address(peer).is_some()).unwrap()
}

#[test]
fn a_client_keeps_its_slot_until_its_answer_is_sent() {
    let mut memory = Memory::<1, 4>::new();
    let shared = SharedGateway::<Bench>::new(Gateway::new(Config::RC8, &mut memory), |_| {});
    let peer = shared.open((1, 0), &LIMITS).unwrap();
    let mut front = Front::Rac;
    shared.with(|shared| front.received(&mut shared.gateway, peer, None, b"GET:RC8:1:I:\r"));
    shared.poll();
    let answer = shared.view(|gateway| gateway.transmit(peer).len()).unwrap();
    assert_eq!(answer, "-2147481342\r".len());
    assert!(shared.open((1, 1), &LIMITS).is_none(), "the answer is not sent");
    shared.with(|shared| front.transmitted(&mut shared.gateway, peer, None, 4));
    assert!(shared.open((1, 1), &LIMITS).is_none(), "a part of it is not sent");
    shared.with(|shared| front.transmitted(&mut shared.gateway, peer, None, answer - 4));
    assert!(shared.open((1, 1), &LATER).is_none() && shared.open((1, 1), &NEVER).is_none(), "it was active");
    assert!(shared.open((1, 1), &LIMITS).is_some() && !is_open(&shared, peer), "it is idle");
    assert_eq!(shared.sessions(), 1);
}

#[test]
fn a_client_of_modbus_keeps_its_slot_while_its_request_runs_and_until_its_response_is_sent() {
    let mut memory = Memory::<1, 8>::new();
    let shared = SharedGateway::<Bench>::new(Gateway::new(Config::RC8, &mut memory), |_| {});
    let peer = shared.open((1, 0), &LIMITS).unwrap();
    let map = [Entry::registers("0=I/0-1").unwrap()];
    let mut modbus = modbus::Session::new(&map);
    modbus.received(&[0, 1, 0, 0, 0, 6, 1, 3, 0, 0, 0, 4], |_| true);
    shared.with(|shared| shared.moved(peer, &Front::Modbus(&mut modbus)));
    assert!(shared.open((2, 0), &LIMITS).is_none(), "the line for I0 is not in the gateway yet");

    for _ in 0..2 {
        modbus.line_taken(modbus.line().len());
        modbus.replied(b"0,3,7\r", |_| true);
    }
    let response = modbus.transmit().len();
    assert_eq!(response, 17);
    shared.with(|shared| shared.exchanged(peer, &Front::Modbus(&mut modbus)));
    assert!(shared.open((2, 0), &LIMITS).is_none(), "the response is not sent");

    modbus.transmitted(response);
    shared.with(|shared| shared.moved(peer, &Front::Modbus(&mut modbus)));
    assert!(shared.open((2, 0), &LIMITS).is_some() && !is_open(&shared, peer), "it is idle");
}

#[test]
fn a_host_gets_the_slot_of_its_own_idle_client_first_and_after_its_share_no_other() {
    let mut memory = Memory::<3, 4>::new();
    let shared = SharedGateway::<Bench>::new(Gateway::new(Config::RC8, &mut memory), |_| {});
    let open = |address, limits: &Limits| shared.open(address, limits);
    let [first, second, own] = [(1, 0), (1, 1), (2, 0)].map(|address| open(address, &LIMITS).unwrap());
    let third = open((2, 1), &LIMITS).unwrap();
    assert!(
        !is_open(&shared, own) && is_open(&shared, first),
        "its own client is replaced, although others are idle for longer"
    );
    let fourth = open((3, 0), &LIMITS).unwrap();
    assert!(!is_open(&shared, first), "the client that is idle for the longest time is replaced");
    let share = Limits { connections_per_address: 1, ..LIMITS };
    shared.close(second, None);
    assert!(
        open((3, 1), &share).is_some() && !is_open(&shared, fourth),
        "a slot is free, but the host has used its share"
    );
    assert!(is_open(&shared, third));
    assert!(open((3, 2), &Limits { evict_after: None, ..share }).is_none());
}

#[test]
fn a_gateway_that_stops_opens_no_session() {
    let mut memory = Memory::<1, 4>::new();
    let shared = SharedGateway::<Bench>::new(Gateway::new(Config::RC8, &mut memory), |_| {});
    shared.stop();
    assert!(shared.open((1, 0), &LIMITS).is_none());
    assert_eq!(std::format!("{shared:?}"), String::from("SharedGateway { .. }"));
}

/// The listeners check this before; a listener without the check does not serve such a client either.
#[test]
fn a_client_of_no_network_of_the_rules_gets_no_slot() {
    let networks = [Network::parse("10.0.0.0/8").unwrap()];
    let rules = Rules { clients: &networks, ..Rules::READ_ONLY };
    let mut memory = Memory::<1, 4>::new();
    let shared = SharedGateway::<Bench>::new(Gateway::new(Config { rules, ..Config::RC8 }, &mut memory), |report| {
        assert!(matches!(report, Report::Denied { client: (1, 0), reason: Denial::Address }), "{report:?}");
    });
    assert!(shared.open((1, 0), &LIMITS).is_none());
    assert_eq!(shared.sessions(), 0);
}

/// The connection of a client that has sent several lines together, and counts the answers.
struct Lines<'a> {
    lines: &'a [u8],
    answers: &'a Cell<usize>,
}

impl Transport for Lines<'_> {
    type Error = Infallible;

    fn now(&self) -> Instant {
        Bench::now()
    }

    async fn send(&mut self, bytes: &[u8], _: Instant) -> Result<Option<usize>, Infallible> {
        self.answers.set(self.answers.get().checked_add(1).unwrap());
        Ok(Some(bytes.len()))
    }

    async fn receive(&mut self, buffer: &mut [u8], _: Instant) -> Result<Option<usize>, Infallible> {
        if self.lines.is_empty() {
            return pending().await;
        }
        let (now, later) = self.lines.split_at(self.lines.len().min(buffer.len()));
        buffer.get_mut(..now.len()).unwrap().copy_from_slice(now);
        self.lines = later;
        Ok(Some(now.len()))
    }

    async fn sleep_until(&mut self, _: Instant) {
        pending().await
    }
}

#[derive(Default)]
struct Wakes(AtomicUsize);

impl Wake for Wakes {
    fn wake(self: Arc<Self>) {
        self.0.fetch_add(1, Ordering::Relaxed);
    }
}

#[test]
fn a_client_of_several_lines_has_one_answer_a_turn_and_of_one_line_no_second_turn() {
    for (lines, turns) in [(1, [(1, 0), (1, 0), (1, 0)]), (3, [(1, 1), (2, 2), (3, 2)])] {
        let mut memory = Memory::<1, 4>::new();
        let shared = SharedGateway::<Bench>::new(Gateway::new(Config::RC8, &mut memory), |_| {});
        let (sent, answers) = ("GET:RC8:1:I:\r".repeat(lines), Cell::new(0));
        let mut transport = Lines { lines: sent.as_bytes(), answers: &answers };
        let mut session = pin!(serve::<_, _, 64>(&mut transport, Front::Rac, (1, 0), &shared, &LIMITS, |_| ()));
        let wakes = Arc::new(Wakes::default());
        let waker = Waker::from(Arc::clone(&wakes));
        let found = [(); 3].map(|()| {
            assert!(session.as_mut().poll(&mut Context::from_waker(&waker)).is_pending());
            (answers.get(), wakes.0.load(Ordering::Relaxed))
        });
        assert_eq!(found, turns, "answers and wakes after each turn, {lines} lines");
    }
}

/// A task of a line serves it again after that, without another wait.
#[test]
fn a_client_without_a_slot_lets_other_tasks_run() {
    let mut memory = Memory::<1, 4>::new();
    let shared = SharedGateway::<Bench>::new(Gateway::new(Config::RC8, &mut memory), |_| {});
    shared.stop();
    let answers = Cell::new(0);
    let mut transport = Lines { lines: b"", answers: &answers };
    let mut session = pin!(serve::<_, _, 64>(&mut transport, Front::Rac, (1, 0), &shared, &LIMITS, |_| ()));
    let mut poll = || session.as_mut().poll(&mut Context::from_waker(Waker::noop()));
    assert!(poll().is_pending());
    assert!(matches!(poll(), Poll::Ready(None)));
}
