//! One test for each cell of the table in `docs/udp-sessions.md`: the module is the state, the function is the request.

use super::*;

/// The reaction of a session to a request.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Done {
    /// Executed; nothing was released.
    Executed,
    /// Executed as the start of a session, after all objects of the peer were released.
    Began,
    /// Answered with the last reply.
    Repeated,
    /// Answered with S_EXECUTING.
    Executing,
    /// Answered with E_BUSY_PROC.
    Busy,
    /// Not answered.
    Dropped,
}
use self::Done::{Began, Busy, Dropped, Executed, Executing, Repeated};

/// The marker of Service_Start, high enough for much older markers below it.
const START: u16 = 5000;
/// The marker of the newest call, in states that have one.
const NEWEST: u16 = START + 3;
const OLDER: u16 = START - 50;
const MUCH_OLDER: u16 = START - 2000;

/// A peer in one of the states of the table.
struct Peer {
    bench: Bench,
    now: Instant,
}

impl Peer {
    fn new(config: Config) -> Self {
        Self { bench: Bench::new(config), now: at(0) }
    }

    fn start(mut self) -> Self {
        assert_eq!(self.bench.call(call::service_start("WDT=3000"), START, at(0)), [(START, HResult::S_OK)]);
        self
    }

    /// Opens a controller and a robot.
    fn open(mut self) -> Self {
        let connect = call::controller_connect("", "", "", "");
        assert_eq!(self.bench.call(connect, START + 1, at(0)), [(START + 1, HResult::S_OK)]);
        let robot = call::controller_get_robot(ControllerHandle(1), "", "");
        assert_eq!(self.bench.call(robot, START + 2, at(0)), [(START + 2, HResult::S_OK)]);
        self
    }

    /// Sends the newest call, which runs or is answered.
    fn newest(mut self, runs: bool) -> Self {
        self.bench.handler.wait_until = runs.then_some(Instant::FAR_FUTURE);
        assert_eq!(self.bench.call(halt(), NEWEST, at(0)).len(), usize::from(!runs));
        self
    }

    fn stop(mut self) -> Self {
        assert_eq!(self.bench.call(call::service_stop(), NEWEST, at(0)), [(NEWEST, HResult::S_OK)]);
        self
    }

    fn after(mut self, millis: u64) -> Self {
        self.now = at(millis);
        self
    }

    /// Sends an attempt of a call.
    fn send(mut self, call: &impl Call, marker: u16, serial: u16) -> Done {
        let (function, before) = (call.function().0, self.bench.session.open_objects());
        self.bench.handler.calls.clear();
        let replies = self.bench.attempt(call, serial, marker, self.now);
        let calls = self.bench.handler.calls.iter().map(|(function, _)| *function).collect::<Vec<_>>();
        match (replies.as_slice(), calls.as_slice()) {
            ([], []) => Dropped,
            ([(to, HResult::S_EXECUTING)], []) if *to == serial => Executing,
            ([(to, HResult::E_BUSY_PROC)], []) if *to == serial => Busy,
            ([(to, _)], []) if *to == serial => Repeated,
            ([(to, HResult::S_OK)], [released @ .., last]) if (*to, *last) == (serial, function) => {
                if function != FunctionId::SERVICE_START.0 {
                    assert_eq!(released, []);
                    return Executed;
                }
                assert_eq!(
                    (released.len(), self.bench.session.open_objects()),
                    (before, 1),
                    "all objects are released"
                );
                assert!(!self.bench.session.is_running());
                Began
            }
            other => panic!("{other:?}"),
        }
    }

    /// Makes the session drop the stored last reply: its reply to an invalid datagram replaces it.
    fn lose_the_reply(mut self) -> Self {
        let mut bad = frame(&call::service_stop(), 9, 9, self.bench.decoder.crc);
        if self.bench.decoder.crc {
            // a serial line does not reply to invalid bytes; releasing memory also drops the reply
            self.bench.session.state.serials.forget_reply();
            return self;
        }
        *bad.last_mut().unwrap() = 5;
        assert_eq!(self.bench.bytes(&bad, self.now).len(), 1);
        self
    }
}

// --- the states ---

fn no_session(config: Config) -> Peer {
    Peer::new(config).start().open().stop()
}

fn no_session_call_runs(config: Config) -> Peer {
    Peer::new(config).open().newest(true)
}

fn begun(config: Config) -> Peer {
    Peer::new(config).start()
}

fn gone_on(config: Config) -> Peer {
    Peer::new(config).start().open().newest(false).after(1999)
}

fn gone_on_call_runs(config: Config) -> Peer {
    Peer::new(config).start().open().newest(true).after(1999)
}

fn settled(config: Config) -> Peer {
    Peer::new(config).start().open().newest(false).after(2000)
}

fn settled_call_runs(config: Config) -> Peer {
    Peer::new(config).start().open().newest(true).after(2000)
}

// --- the requests ---

fn start_copy(peer: Peer) -> Done {
    peer.send(&call::service_start("WDT=3000"), START, START)
}

fn start_copy_reply_lost(peer: Peer) -> Done {
    start_copy(peer.lose_the_reply())
}

/// The serial belongs to the next call, so this is not a copy.
fn start_attempt_of_another_client(peer: Peer) -> Done {
    peer.send(&call::service_start("WDT=3000"), START, START + 1)
}

fn start_other_options(peer: Peer) -> Done {
    peer.send(&call::service_start("WDT=4000"), START, START)
}

fn start_newer(peer: Peer) -> Done {
    peer.send(&call::service_start("WDT=3000"), NEWEST + 1, NEWEST + 1)
}

fn start_older(peer: Peer) -> Done {
    peer.send(&call::service_start("WDT=3000"), OLDER, OLDER)
}

fn start_much_older(peer: Peer) -> Done {
    peer.send(&call::service_start("WDT=3000"), MUCH_OLDER, MUCH_OLDER)
}

fn call_copy(peer: Peer) -> Done {
    copy(peer, |peer| peer)
}

fn call_copy_reply_lost(peer: Peer) -> Done {
    copy(peer, Peer::lose_the_reply)
}

fn copy(mut peer: Peer, between: fn(Peer) -> Peer) -> Done {
    match peer.bench.session.open_objects() {
        0 => between(peer).send(&call::service_stop(), NEWEST, NEWEST + 1),
        // only Service_Start was executed, so the last call is a refused one
        1 => {
            let refused = call::robot_halt(RobotHandle(9), "");
            assert_eq!(peer.bench.call(&refused, NEWEST, peer.now), [(NEWEST, HResult::E_HANDLE)]);
            between(peer).send(&refused, NEWEST, NEWEST + 1)
        }
        _ => between(peer).send(&halt(), NEWEST, NEWEST + 1),
    }
}

fn call_same_marker_other_function(peer: Peer) -> Done {
    let marker = if peer.bench.session.open_objects() == 1 { START } else { NEWEST };
    peer.send(&call::controller_connect("", "", "", ""), marker, marker)
}

fn call_newer(peer: Peer) -> Done {
    peer.send(&call::controller_connect("", "", "", ""), NEWEST + 1, NEWEST + 1)
}

fn call_older(peer: Peer) -> Done {
    peer.send(&call::controller_connect("", "", "", ""), OLDER, OLDER)
}

fn call_much_older(peer: Peer) -> Done {
    peer.send(&call::controller_connect("", "", "", ""), MUCH_OLDER, MUCH_OLDER)
}

/// Creates a test of each cell: over datagrams, and over a serial line if its outcome is given.
macro_rules! cells {
    ($($state:ident { $($request:ident => $datagram:ident $(, serial $serial:ident)?;)+ })+) => {$(
        mod $state {
            use super::*;
            $(#[test]
            fn $request() {
                assert_eq!(super::$request(super::$state(Config::UDP)), $datagram, "over UDP");
                let serial = [$datagram $(, $serial)?];
                assert_eq!(super::$request(super::$state(Config::SERIAL)), serial[serial.len() - 1], "over a serial line");
            })+
        }
    )+};
}

cells! {
    no_session {
        start_copy => Began;
        start_copy_reply_lost => Began;
        start_attempt_of_another_client => Began;
        start_other_options => Began;
        start_newer => Began;
        start_older => Began;
        start_much_older => Began;
        call_copy => Repeated;
        call_copy_reply_lost => Executed;
        call_same_marker_other_function => Executed;
        call_newer => Executed;
        call_older => Executed;
        call_much_older => Executed;
    }
    no_session_call_runs {
        start_copy => Began;
        start_attempt_of_another_client => Began;
        start_other_options => Began;
        start_newer => Began;
        start_older => Began;
        start_much_older => Began;
        call_copy => Executing;
        call_same_marker_other_function => Busy;
        call_newer => Busy;
        call_older => Busy;
        call_much_older => Busy;
    }
    begun {
        start_copy => Repeated;
        start_copy_reply_lost => Began;
        // the number of attempts is not known yet, so this may be one of them
        start_attempt_of_another_client => Repeated;
        start_other_options => Began;
        start_newer => Began;
        start_older => Began;
        start_much_older => Began;
        call_copy => Repeated;
        call_copy_reply_lost => Dropped;
        call_same_marker_other_function => Executed;
        call_newer => Executed;
        call_older => Dropped;
        call_much_older => Executed;
    }
    gone_on {
        start_copy => Dropped, serial Began;
        start_copy_reply_lost => Dropped, serial Began;
        start_attempt_of_another_client => Began;
        start_other_options => Began;
        start_newer => Began;
        start_older => Began;
        start_much_older => Began;
        call_copy => Repeated;
        call_copy_reply_lost => Dropped;
        call_same_marker_other_function => Executed;
        call_newer => Executed;
        call_older => Dropped;
        call_much_older => Executed;
    }
    gone_on_call_runs {
        start_copy => Dropped, serial Began;
        start_attempt_of_another_client => Began;
        start_other_options => Began;
        start_newer => Began;
        start_older => Began;
        start_much_older => Began;
        call_copy => Executing;
        call_same_marker_other_function => Busy;
        call_newer => Busy;
        call_older => Dropped;
        call_much_older => Busy;
    }
    settled {
        start_copy => Began;
        start_copy_reply_lost => Began;
        start_attempt_of_another_client => Began;
        start_other_options => Began;
        start_newer => Began;
        start_older => Began;
        start_much_older => Began;
        call_copy => Repeated;
        call_copy_reply_lost => Dropped;
        call_same_marker_other_function => Executed;
        call_newer => Executed;
        call_older => Dropped;
        call_much_older => Executed;
    }
    settled_call_runs {
        start_copy => Began;
        start_attempt_of_another_client => Began;
        start_other_options => Began;
        start_newer => Began;
        start_older => Began;
        start_much_older => Began;
        call_copy => Executing;
        call_same_marker_other_function => Busy;
        call_newer => Busy;
        call_older => Dropped;
        call_much_older => Busy;
    }
}

#[test]
fn one_forged_call_does_not_lock_a_client_out() {
    let mut bench = Bench::new(Config::UDP);
    // the handle is guessed: nothing is executed, and no session begins
    let forged = b"\x01\x1e\0\0\0\x39\0\x39\0\x65\0\0\0\x01\0\x0a\0\0\0\x03\0\x01\0\0\0\x03\0\0\0\x04";
    assert_eq!(bench.bytes(forged, at(0))[0].1, HResult::E_HANDLE);
    assert_eq!(bench.call(call::service_start(""), 1, at(0)), [(1, HResult::S_OK)]);
    // the same within a session
    assert_eq!(bench.bytes(forged, at(0))[0].1, HResult::E_HANDLE);
    assert_eq!(bench.call(call::controller_connect("", "", "", ""), 2, at(0)), [(2, HResult::S_OK)]);
}

#[test]
fn a_client_that_restarts_while_the_old_one_is_starting_is_answered_from_its_second_attempt_on() {
    let mut bench = Bench::new(Config::UDP);
    let start = call::service_start("");
    assert_eq!(bench.attempt(&start, 1, 1, at(0)), [(1, HResult::S_OK)]);
    assert_eq!(bench.call(call::controller_connect("", "", "", ""), 2, at(1)), [(2, HResult::S_OK)]);
    assert_eq!(bench.attempt(&start, 1, 1, at(100)), [], "may be a copy");
    assert_eq!(bench.attempt(&start, 2, 1, at(600)), [(2, HResult::S_OK)], "2 was the serial of another call");
    assert_eq!(bench.session.open_objects(), 1);
}

#[test]
fn service_start_is_received_while_a_call_runs_and_ends_it() {
    let mut bench = Bench::connected(Config::UDP, "");
    bench.handler.wait_until = Some(Instant::FAR_FUTURE);
    assert_eq!(bench.call(halt(), 4, at(0)), []);
    let room = bench.session.receive_buffer().len();
    assert_eq!(bench.call(call::service_start("WDT=100"), 100, at(1)), [(100, HResult::S_OK)]);
    assert_eq!(bench.handler.abandoned, 1);
    assert!(bench.session.receive_buffer().len() > room);
}

#[test]
fn a_refused_service_start_ends_neither_call_nor_session() {
    for runs in [false, true] {
        let mut bench = Bench::connected(Config::UDP, "");
        bench.handler.wait_until = runs.then_some(at(50));
        bench.call(halt(), 4, at(0));
        assert_eq!(bench.call(call::service_start("WDT=1"), 100, at(1)), [(100, HResult::E_INVALIDARG)]);
        assert_eq!((bench.session.open_objects(), bench.handler.abandoned), (3, 0));
        assert_eq!(bench.run(at(50)).len(), usize::from(runs));
    }
}

#[test]
fn the_reply_to_a_refused_service_start_is_not_sent_for_one_with_other_options() {
    let mut bench = Bench::new(Config::UDP);
    assert_eq!(bench.call(call::service_start("WDT=100"), 7, at(0)), [(7, HResult::S_OK)]);
    assert_eq!(bench.call(call::service_start("WDT=1"), 7, at(0)), [(7, HResult::E_INVALIDARG)]);
    assert_eq!(bench.attempt(&call::service_start("WDT=100"), 8, 7, at(0)), [(8, HResult::S_OK)]);
}

/// A handler that delays Service_Start; the other handlers here complete it immediately.
#[derive(Default)]
struct SlowToStart(usize);

impl Handler for SlowToStart {
    fn call(&mut self, _: PeerId, request: &Request<'_>, _: &mut ReplyValue<'_>, _: Instant) -> Outcome {
        assert!(request.args.len() < 2, "the arguments of this request");
        self.0 += 1;
        match request.function {
            FunctionId::SERVICE_START => Outcome::Wait(Instant::FAR_FUTURE),
            _ => HResult::S_OK.into(),
        }
    }
}

#[test]
fn a_waiting_service_start_can_replace_another() {
    let mut session = Session::<[u8; 512], [u8; 1024], 4>::new(Config::UDP, [0; 512], [0; 1024]);
    let mut handler = SlowToStart::default();
    for (calls, options) in (1..).zip(["WDT=100", "WDT=200, and more", ""]) {
        let bytes = frame(&call::service_start(options), 7, 7, false);
        session.receive_buffer()[..bytes.len()].copy_from_slice(&bytes);
        session.received(bytes.len());
        while session.run(&mut handler, PeerId(1), at(0)).is_some() {}
        assert!(session.is_running() && handler.0 >= calls);
        assert_eq!(session.receive_buffer().len(), 1024 - bytes.len(), "the request is at the front");
    }
}
