//! Tests the server's session over UDP against a model, with random peers that start, restart, repeat, reorder and forge
//! requests from one address.
//!
//! The model interprets the table in `docs/udp-sessions.md`. Both receive every request, and must execute and send the same.
//! Mutation tests then plant faults: they change each cell of the table in every possible way, and wrap the session so that
//! it misbehaves. The comparison must detect each fault.

use bcap_core::endpoint::{Endpoint, Serve, ServerEndpoint};
use std::collections::{BTreeMap, BTreeSet};
use std::fmt;

use bcap_core::bcap::server::{Config, Handler, Request, Session};
use bcap_core::bcap::{Decoder, FunctionId};
use bcap_core::handler::{Outcome, PeerId, ReplyValue};
use bcap_core::hresult::HResult;
use bcap_core::time::Instant;
use bcap_testkit::frame::TestFrame;
use bcap_testkit::network::Random;
use bcap_testkit::value::Value;

/// The number of sequences, and the number of requests of each.
const SEQUENCES: u64 = 400;
const STEPS: usize = 150;

// --- the table ---------------------------------------------------------------------------------------------------------

/// The table's rule for a request in a state.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Word {
    Begin,
    Execute,
    Again,
    Executing,
    Busy,
    Drop,
}

const WORDS: [(&str, Word); 6] = [
    ("begin", Word::Begin),
    ("execute", Word::Execute),
    ("again", Word::Again),
    ("executing", Word::Executing),
    ("busy", Word::Busy),
    ("drop", Word::Drop),
];

/// A cell: the state of the peer and the request.
type Cell = (&'static str, &'static str);

/// The table as the document has it.
fn table() -> BTreeMap<Cell, Word> {
    let document = include_str!("../../docs/udp-sessions.md");
    let rows: Vec<Vec<&str>> = document
        .lines()
        .filter(|line| line.starts_with("| "))
        .map(|line| line.trim_matches('|').split(" | ").map(str::trim).collect())
        .collect();
    let states: Vec<&'static str> = rows[0][1..].iter().map(|state| known(&state.replace(['`', ' '], ""))).collect();
    let mut table = BTreeMap::new();
    for row in &rows[1..] {
        let Some(name) = row[0].strip_prefix('`') else { continue };
        let request = known(name.split('`').next().unwrap());
        for (state, word) in states.iter().zip(&row[1..]) {
            let word = word.split(' ').next().unwrap();
            if let Some((_, word)) = WORDS.iter().find(|(name, _)| *name == word) {
                assert_eq!(table.insert((*state, request), *word), None);
            } else {
                assert_eq!(word, "–", "{state}, {request}");
            }
        }
    }
    table
}

const STATES: [&str; 7] =
    ["no_session", "no_session_call_runs", "begun", "gone_on", "gone_on_call_runs", "settled", "settled_call_runs"];
const REQUESTS: [&str; 13] = [
    "start_copy",
    "start_copy_reply_lost",
    "start_attempt_of_another_client",
    "start_other_options",
    "start_newer",
    "start_older",
    "start_much_older",
    "call_copy",
    "call_copy_reply_lost",
    "call_same_marker_other_function",
    "call_newer",
    "call_older",
    "call_much_older",
];

fn known(name: &str) -> &'static str {
    STATES.into_iter().chain(REQUESTS).find(|known| *known == name).unwrap_or_else(|| panic!("the table names {name}"))
}

// --- requests ----------------------------------------------------------------------------------------------------------

/// The kind of a request. Markers of calls count; so do the options of Service_Start.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Ask {
    /// Service_Start with `WDT=` a large number, so that no keep-alive is sent automatically.
    Start {
        options: u16,
    },
    /// Service_Start with options that are refused.
    BadStart,
    Stop,
    Connect,
    /// Controller_Execute on a handle; `runs` leaves it running.
    Execute {
        handle: i32,
        token: i32,
        runs: bool,
    },
}

/// An attempt of a call.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Attempt {
    ask: Ask,
    marker: u16,
    serial: u16,
}

impl Ask {
    fn function(self) -> FunctionId {
        match self {
            Self::Start { .. } | Self::BadStart => FunctionId::SERVICE_START,
            Self::Stop => FunctionId::SERVICE_STOP,
            Self::Connect => FunctionId::CONTROLLER_CONNECT,
            Self::Execute { .. } => FunctionId::CONTROLLER_EXECUTE,
        }
    }

    fn args(self) -> Vec<Value> {
        match self {
            Self::Start { options } => vec![Value::text(&format!("WDT={}", 100_000_000 + u32::from(options)))],
            Self::BadStart => vec![Value::text("WDT=1")],
            Self::Stop => vec![],
            Self::Connect => vec![Value::text(""); 4],
            Self::Execute { handle, token, runs } => {
                vec![Value::I4(handle), Value::text(if runs { "long" } else { "short" }), Value::I4(token)]
            }
        }
    }
}

impl Attempt {
    fn wire(&self) -> Vec<u8> {
        let (code, args) = (self.ask.function().0, self.ask.args());
        TestFrame { serial: self.serial, reserved: self.marker, code, args }.to_wire(false)
    }
}

/// The calls to the application, and the bytes to the peer.
#[derive(Clone, Debug, PartialEq, Eq)]
enum Seen {
    Called(FunctionId, i32),
    Abandoned,
    Sent { serial: u16, code: HResult, args: Vec<Value> },
}

// --- the application ---------------------------------------------------------------------------------------------------

#[derive(Default)]
struct Application {
    seen: Vec<Seen>,
    next_handle: i32,
    /// Whether the long call may end.
    ends: bool,
}

impl Handler for Application {
    fn call(&mut self, _: PeerId, request: &Request<'_>, reply: &mut ReplyValue<'_>, now: Instant) -> Outcome {
        let is_long = request.function == FunctionId::CONTROLLER_EXECUTE && request.text(1) == "long";
        if is_long && !self.ends {
            return Outcome::Wait(now.saturating_add(core::time::Duration::from_secs(1000)));
        }
        let number = match request.function {
            FunctionId::CONTROLLER_EXECUTE => request.int(2),
            FunctionId::CONTROLLER_DISCONNECT => request.handle(),
            _ => 0,
        };
        self.seen.push(Seen::Called(request.function, number));
        match request.function {
            FunctionId::CONTROLLER_CONNECT => {
                self.next_handle += 1;
                reply.set(&self.next_handle).unwrap();
            }
            FunctionId::CONTROLLER_EXECUTE => reply.set(&number).unwrap(),
            _ => {}
        }
        HResult::S_OK.into()
    }

    fn abandoned(&mut self, _: PeerId, _: Instant) {
        self.seen.push(Seen::Abandoned);
    }
}

// --- the model ---------------------------------------------------------------------------------------------------------

/// The state that a server must have of its peer.
struct Model {
    table: BTreeMap<Cell, Word>,
    covered: BTreeSet<Cell>,
    /// The session: when its first call after Service_Start arrived, with its marker.
    session: Option<Option<(Instant, u16)>>,
    /// The last Service_Start that was executed: its marker and its request.
    start: Option<(u16, Ask)>,
    /// The call that was executed last.
    newest: Option<(u16, FunctionId)>,
    /// The call that was answered last, its reply, and whether that is kept.
    last: Option<(u16, FunctionId, Seen, bool)>,
    running: Option<Attempt>,
    /// The handles of the peer, in the order in which they were opened.
    handles: Vec<i32>,
    has_service: bool,
    next_handle: i32,
}

impl Model {
    fn new(table: BTreeMap<Cell, Word>) -> Self {
        Self {
            table,
            covered: BTreeSet::new(),
            session: None,
            start: None,
            newest: None,
            last: None,
            running: None,
            handles: Vec::new(),
            has_service: false,
            next_handle: 0,
        }
    }

    fn state(&self, now: Instant) -> &'static str {
        let runs = self.running.is_some();
        match self.session {
            None if runs => "no_session_call_runs",
            None => "no_session",
            Some(None) => "begun",
            Some(Some((at, _))) => match (now.saturating_since(at).as_millis() < 2000, runs) {
                (true, false) => "gone_on",
                (true, true) => "gone_on_call_runs",
                (false, false) => "settled",
                (false, true) => "settled_call_runs",
            },
        }
    }

    fn request(&self, attempt: &Attempt) -> &'static str {
        let Attempt { ask, marker, serial } = *attempt;
        let function = ask.function();
        let is_kept = self.last.as_ref().is_some_and(|last| last.3);
        if function == FunctionId::SERVICE_START {
            if let Some((start, options)) = self.start.filter(|(start, _)| *start == marker) {
                let next = self.session.flatten().map_or(start.wrapping_add(5), |(_, next)| next);
                let is_attempt = serial.wrapping_sub(start) < next.wrapping_sub(start);
                let is_last = self.last.as_ref().is_some_and(|last| (last.0, last.1) == (marker, function));
                return match () {
                    () if options != ask => "start_other_options",
                    // the number of attempts is unknown, so the stored reply determines the case
                    () if self.session == Some(None) && !(is_last && is_kept) => "start_copy_reply_lost",
                    () if !is_attempt => "start_attempt_of_another_client",
                    () if self.running.is_none() && !is_kept => "start_copy_reply_lost",
                    () => "start_copy",
                };
            }
            return self.age(marker, ["start_newer", "start_older", "start_much_older"]);
        }
        if let Some(running) = self.running {
            if (running.marker, running.ask.function()) == (marker, function) {
                return "call_copy";
            }
        } else if let Some(last) = self.last.as_ref().filter(|last| (last.0, last.1) == (marker, function)) {
            return if last.3 { "call_copy" } else { "call_copy_reply_lost" };
        }
        match self.newest {
            // the reply of a refused call has taken the place of its reply
            Some(newest) if newest == (marker, function) && self.session.is_some() => "call_copy_reply_lost",
            Some((newest, _)) if newest == marker => "call_same_marker_other_function",
            _ => self.age(marker, ["call_newer", "call_older", "call_much_older"]),
        }
    }

    fn age(&self, marker: u16, [newer, older, much_older]: [&'static str; 3]) -> &'static str {
        match self.newest.map_or(0, |(newest, _)| newest.wrapping_sub(marker)) {
            1..=1024 => older,
            1025..0x8000 => much_older,
            _ => newer,
        }
    }

    /// Returns the effect of a request.
    fn take(&mut self, attempt: Attempt, now: Instant) -> Vec<Seen> {
        let cell = (self.state(now), self.request(&attempt));
        self.covered.insert(cell);
        let Some(word) = self.table.get(&cell).copied() else { panic!("{cell:?} is said to be impossible") };
        let Attempt { ask, marker, serial } = attempt;
        let function = ask.function();
        match word {
            Word::Drop => Vec::new(),
            Word::Busy => {
                self.forget_reply();
                vec![reply_to(serial, function, HResult::E_BUSY_PROC, None)]
            }
            Word::Executing => {
                let mut to = serial;
                if let Some(running) = &mut self.running {
                    if serial.wrapping_sub(running.serial) >= 0x8000 {
                        to = running.serial;
                    }
                    running.serial = to;
                }
                self.forget_reply();
                vec![Seen::Sent { serial: to, code: HResult::S_EXECUTING, args: vec![] }]
            }
            Word::Again => match &self.last {
                Some((_, _, Seen::Sent { code, args, .. }, _)) => {
                    vec![Seen::Sent { serial, code: *code, args: args.clone() }]
                }
                _ => Vec::new(),
            },
            Word::Begin | Word::Execute => {
                if let Some(code) = self.refusal(ask) {
                    let sent = reply_to(serial, function, code, None);
                    // a refused Service_Start is answered anew, not again
                    if self.running.is_none() && function != FunctionId::SERVICE_START {
                        self.last = Some((marker, function, sent.clone(), true));
                    } else {
                        self.forget_reply();
                    }
                    return vec![sent];
                }
                let mut seen = if word == Word::Begin { self.end() } else { Vec::new() };
                seen.extend(self.execute(attempt, now));
                seen
            }
        }
    }

    fn refusal(&self, ask: Ask) -> Option<HResult> {
        match ask {
            Ask::BadStart => Some(HResult::E_INVALIDARG),
            Ask::Execute { handle, .. } if !self.handles.contains(&handle) => Some(HResult::E_HANDLE),
            _ => None,
        }
    }

    /// Releases everything and ends the session.
    fn end(&mut self) -> Vec<Seen> {
        let mut seen: Vec<Seen> = self.running.take().map(|_| Seen::Abandoned).into_iter().collect();
        seen.extend(self.handles.drain(..).rev().map(|handle| Seen::Called(FunctionId::CONTROLLER_DISCONNECT, handle)));
        if std::mem::take(&mut self.has_service) {
            seen.push(Seen::Called(FunctionId::SERVICE_STOP, 0));
        }
        self.session = None;
        seen
    }

    fn execute(&mut self, attempt: Attempt, now: Instant) -> Vec<Seen> {
        let Attempt { ask, marker, serial } = attempt;
        let function = ask.function();
        let mut seen = if ask == Ask::Stop { self.end() } else { Vec::new() };
        self.newest = Some((marker, function));
        if function == FunctionId::SERVICE_START {
            self.start = Some((marker, ask));
        } else if let Some(went_on @ None) = &mut self.session {
            *went_on = Some((now, marker));
        }
        if matches!(ask, Ask::Execute { runs: true, .. }) {
            self.running = Some(attempt);
            return seen;
        }
        seen.extend(self.finish(ask, marker, serial));
        seen
    }

    /// Executes a call to its end.
    fn finish(&mut self, ask: Ask, marker: u16, serial: u16) -> Vec<Seen> {
        let function = ask.function();
        let (number, value) = match ask {
            Ask::Start { .. } | Ask::BadStart => {
                (self.session, self.has_service) = (Some(None), true);
                (0, None)
            }
            Ask::Stop => (0, None),
            Ask::Connect => {
                self.next_handle += 1;
                self.handles.push(self.next_handle);
                (0, Some(self.next_handle))
            }
            Ask::Execute { token, .. } => (token, Some(token)),
        };
        let sent = reply_to(serial, function, HResult::S_OK, value);
        self.last = Some((marker, function, sent.clone(), true));
        vec![Seen::Called(function, number), sent]
    }

    /// Returns the effect of the end of the running call.
    fn end_of_call(&mut self) -> Vec<Seen> {
        let Some(Attempt { ask, marker, serial }) = self.running.take() else { return Vec::new() };
        self.finish(ask, marker, serial)
    }

    fn malformed(&mut self, serial: u16) -> Vec<Seen> {
        self.forget_reply();
        vec![Seen::Sent { serial, code: HResult::E_INVALIDRCPACKET, args: vec![] }]
    }

    fn forget_reply(&mut self) {
        if let Some(last) = &mut self.last {
            last.3 = false;
        }
    }
}

/// Creates a reply; a function with a result returns EMPTY if it has no value.
fn reply_to(serial: u16, function: FunctionId, code: HResult, value: Option<i32>) -> Seen {
    let gives = matches!(function, FunctionId::CONTROLLER_CONNECT | FunctionId::CONTROLLER_EXECUTE);
    let args = match value {
        Some(value) => vec![Value::I4(value)],
        None if gives => vec![Value::Empty],
        None => vec![],
    };
    Seen::Sent { serial, code, args }
}

// --- the run -----------------------------------------------------------------------------------------------------------

/// A planted fault of the session.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum PlantedFault {
    /// The marker is not read, so that every attempt is a separate call.
    NoMarkers,
    /// The arguments of Service_Start are not compared.
    OptionsIgnored,
    /// The serials of the attempts of Service_Start are not compared.
    SerialsIgnored,
    /// The time since the first call of a session is not measured.
    ClockStands,
    /// It is measured too long.
    ClockRuns,
    /// A repeated reply keeps its serial.
    OldSerialAgain,
    /// A retransmission of a running call is not answered.
    NoExecuting,
    /// A running call gets its reply under the serial of its first attempt.
    FirstSerialReplied,
    /// The handler does not learn that its call was abandoned.
    NotAbandoned,
    /// Objects are released in the order in which they were opened.
    ReleasedForwards,
    /// No object is released.
    NothingReleased,
    /// Without a session, Service_Start below the newest marker is dropped: the fault of version 0.1.
    WindowWithoutSession,
    /// A Service_Start that arrives while a call runs is refused as busy.
    StartIsBusy,
    /// An old call is answered.
    OldIsAnswered,
}

const FAULTS: [PlantedFault; 14] = [
    PlantedFault::NoMarkers,
    PlantedFault::OptionsIgnored,
    PlantedFault::SerialsIgnored,
    PlantedFault::ClockStands,
    PlantedFault::ClockRuns,
    PlantedFault::OldSerialAgain,
    PlantedFault::NoExecuting,
    PlantedFault::FirstSerialReplied,
    PlantedFault::NotAbandoned,
    PlantedFault::ReleasedForwards,
    PlantedFault::NothingReleased,
    PlantedFault::WindowWithoutSession,
    PlantedFault::StartIsBusy,
    PlantedFault::OldIsAnswered,
];

/// The session, with a fault if one is planted.
struct Server {
    session: Session<[u8; 512], [u8; 1024], 64>,
    application: Application,
    fault: Option<PlantedFault>,
    /// The newest marker, and the first attempt of a running call, for the faults that need them.
    newest: u16,
    running: Option<Attempt>,
}

impl Server {
    fn new(fault: Option<PlantedFault>) -> Self {
        let session = Session::new(Config::UDP, [0; 512], [0; 1024]);
        Self { session, application: Application::default(), fault, newest: 0, running: None }
    }

    fn take(&mut self, attempt: Attempt, now: Instant) -> Vec<Seen> {
        let (was_running, mut given, is_start) =
            (self.session.is_running(), attempt, attempt.ask.function() == FunctionId::SERVICE_START);
        match self.fault {
            Some(PlantedFault::NoMarkers) => given.marker = given.serial,
            Some(PlantedFault::SerialsIgnored) if is_start => given.serial = given.marker,
            Some(PlantedFault::OptionsIgnored) => {
                if let Ask::Start { options } = &mut given.ask {
                    *options = 0;
                }
            }
            Some(PlantedFault::WindowWithoutSession)
                if is_start
                    && self.session.open_objects() == 0
                    && (1..=1024).contains(&self.newest.wrapping_sub(attempt.marker)) =>
            {
                return Vec::new();
            }
            Some(PlantedFault::StartIsBusy) if is_start && was_running => {
                return vec![reply_to(attempt.serial, attempt.ask.function(), HResult::E_BUSY_PROC, None)];
            }
            _ => {}
        }
        self.newest = attempt.marker;
        let mut seen = self.receive(&given.wire(), now);
        if !was_running && self.session.is_running() {
            self.running = Some(attempt);
        }
        match self.fault {
            Some(PlantedFault::OldSerialAgain) if seen.len() == 1 => {
                for seen in &mut seen {
                    if let Seen::Sent { serial, .. } = seen {
                        *serial = attempt.marker;
                    }
                }
            }
            Some(PlantedFault::NoExecuting) => {
                seen.retain(|seen| !matches!(seen, Seen::Sent { code: HResult::S_EXECUTING, .. }));
            }
            Some(PlantedFault::OldIsAnswered) if seen.is_empty() && !self.session.is_running() => {
                seen.push(reply_to(attempt.serial, attempt.ask.function(), HResult::E_INVALIDRCPACKET, None));
            }
            _ => self.garble(&mut seen),
        }
        seen
    }

    /// Falsifies the outcome that the application gets.
    fn garble(&self, seen: &mut Vec<Seen>) {
        match self.fault {
            Some(PlantedFault::NotAbandoned) => seen.retain(|seen| *seen != Seen::Abandoned),
            Some(PlantedFault::NothingReleased) => {
                seen.retain(|seen| !matches!(seen, Seen::Called(FunctionId::CONTROLLER_DISCONNECT, _)));
            }
            Some(PlantedFault::ReleasedForwards) => {
                let released = |seen: &&Seen| matches!(seen, Seen::Called(FunctionId::CONTROLLER_DISCONNECT, handle) if *handle > 0);
                let mut handles: Vec<Seen> = seen.iter().filter(released).cloned().collect();
                for seen in seen.iter_mut().filter(|seen| released(&&**seen)) {
                    *seen = handles.pop().unwrap();
                }
            }
            _ => {}
        }
    }

    fn end_of_call(&mut self, now: Instant) -> Vec<Seen> {
        self.application.ends = true;
        let mut seen = self.run(now);
        self.application.ends = false;
        if let (Some(PlantedFault::FirstSerialReplied), Some(first)) = (self.fault, self.running) {
            for seen in &mut seen {
                if let Seen::Sent { serial, .. } = seen {
                    *serial = first.serial;
                }
            }
        }
        seen
    }

    fn receive(&mut self, bytes: &[u8], now: Instant) -> Vec<Seen> {
        let room = self.session.receive_buffer();
        room[..bytes.len()].copy_from_slice(bytes);
        self.session.received(bytes.len());
        self.run(now)
    }

    fn run(&mut self, now: Instant) -> Vec<Seen> {
        let now = match self.fault {
            Some(PlantedFault::ClockStands) => Instant::ZERO,
            Some(PlantedFault::ClockRuns) => Instant::from_micros(now.as_micros() * 1000),
            _ => now,
        };
        loop {
            let event = self.session.run(&mut self.application, PeerId(1), now);
            let sent = self.session.transmit().to_vec();
            self.session.transmitted(sent.len());
            if !sent.is_empty() {
                let frame = TestFrame::read(&Decoder::UDP.decode_datagram(&sent).expect("a frame is sent"));
                assert_eq!(frame.reserved, 0);
                let TestFrame { serial, code, args, .. } = frame;
                self.application.seen.push(Seen::Sent { serial, code: HResult(code), args });
            }
            if event.is_none() {
                return std::mem::take(&mut self.application.seen);
            }
        }
    }
}

/// Where session and model differ.
#[derive(Debug)]
struct Difference {
    step: usize,
    what: String,
}

impl fmt::Display for Difference {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "step {}: {}", self.step, self.what)
    }
}

/// A sequence of what peers at one address do.
struct Sequence {
    random: Random,
    server: Server,
    model: Model,
    now: Instant,
    step: usize,
    /// The serial of the next attempt of the current client.
    next_serial: u16,
    /// The last attempt of the current client.
    current: Option<Attempt>,
    /// Every request that was ever sent; the network may deliver a copy of any.
    sent: Vec<Attempt>,
    token: i32,
    tally: Tally,
}

/// The counts of events.
#[derive(Clone, Copy, Debug, Default)]
struct Tally {
    requests: u64,
    restarts: u64,
    /// Restarts whose Service_Start was answered at the first attempt.
    at_once: u64,
    forged: u64,
    copies: u64,
}

impl Sequence {
    fn new(seed: u64, table: BTreeMap<Cell, Word>, fault: Option<PlantedFault>) -> Self {
        Self {
            random: Random(seed),
            server: Server::new(fault),
            model: Model::new(table),
            now: Instant::from_millis(1),
            step: 0,
            next_serial: 1,
            current: None,
            sent: Vec::new(),
            token: 0,
            tally: Tally::default(),
        }
    }

    fn run(&mut self) -> Result<(), Difference> {
        while self.step < STEPS {
            self.step += 1;
            let pause = [0, 0, 1, 20, 400, 700, 2500][self.random.below(7) as usize];
            self.now = self.now + core::time::Duration::from_millis(pause);
            match self.random.below(100) {
                0..40 => self.new_call()?,
                40..55 => self.retry()?,
                55..70 => self.copy()?,
                70..78 => self.restart()?,
                78..88 => self.forge()?,
                88..92 => self.malformed()?,
                _ => self.end_of_call()?,
            }
        }
        Ok(())
    }

    fn take_serial(&mut self) -> u16 {
        let serial = self.next_serial;
        self.next_serial = serial.checked_add(1).unwrap_or(1);
        serial
    }

    fn any_ask(&mut self) -> Ask {
        self.token += 1;
        let newest_handle = self.model.next_handle;
        let handle = newest_handle - self.random.below(3) as i32;
        match self.random.below(16) {
            0 => Ask::Start { options: self.random.below(2) as u16 },
            1 => Ask::BadStart,
            2 => Ask::Stop,
            3..6 => Ask::Connect,
            6..9 => Ask::Execute { handle, token: self.token, runs: true },
            _ => Ask::Execute { handle, token: self.token, runs: false },
        }
    }

    /// The client makes another call; some of its calls before were lost altogether.
    fn new_call(&mut self) -> Result<(), Difference> {
        let lost = [0, 0, 0, 0, 1, 5, 40, 1500][self.random.below(8) as usize];
        self.next_serial = self.next_serial.checked_add(lost).unwrap_or(1);
        let (ask, serial) = (self.any_ask(), self.take_serial());
        let attempt = Attempt { ask, marker: serial, serial };
        self.current = Some(attempt);
        self.send(attempt).map(drop)
    }

    fn retry(&mut self) -> Result<(), Difference> {
        let Some(current) = self.current else { return Ok(()) };
        let serial = self.take_serial();
        self.send(Attempt { serial, ..current }).map(drop)
    }

    /// The network delivers a copy of a request, preferably of a recent one.
    fn copy(&mut self) -> Result<(), Difference> {
        let behind = if self.random.happens(700) { 6 } else { 10_000 };
        let behind = 1 + self.random.below(behind.min(self.sent.len().max(1) as u64)) as usize;
        let Some(attempt) = self.sent.len().checked_sub(behind).map(|at| self.sent[at]) else { return Ok(()) };
        self.tally.copies += 1;
        self.exchange(attempt).map(drop)
    }

    /// The client ends and another client begins at the same address. It is answered, at its fifth attempt at the latest.
    fn restart(&mut self) -> Result<(), Difference> {
        self.next_serial = match self.random.below(4) {
            0 => 1 + self.random.below(0xffff) as u16,
            // of the numbers that clients begin with, those that lead to every age
            1 => [1, 900, 3000, 40_000][self.random.below(4) as usize],
            2 => self.model.start.map_or(1, |(marker, _)| marker),
            _ => 1,
        };
        let options = self.random.below(4) as u16 / 3;
        let marker = self.next_serial;
        self.tally.restarts += 1;
        for attempt in 1..=5 {
            let serial = self.take_serial();
            let start = Attempt { ask: Ask::Start { options }, marker, serial };
            self.current = Some(start);
            let seen = self.send(start)?;
            if seen.iter().any(|seen| matches!(seen, Seen::Sent { code: HResult::S_OK, .. })) {
                self.tally.at_once += u64::from(attempt == 1);
                return Ok(());
            }
            self.now = self.now + core::time::Duration::from_millis(500);
        }
        Err(self.difference("a client that starts is locked out".to_owned()))
    }

    /// A forged request arrives from the client's address.
    fn forge(&mut self) -> Result<(), Difference> {
        self.tally.forged += 1;
        if let Some((marker, ask)) = self.model.start.filter(|_| self.random.happens(250)) {
            let serial = marker.wrapping_add(self.random.below(12) as u16);
            return self.exchange(Attempt { ask, marker, serial }).map(drop);
        }
        let ask = self.any_ask();
        let newest = self.model.newest.map_or(0, |(marker, _)| marker);
        let marker = match self.random.below(5) {
            0 => newest,
            1 => newest.wrapping_add(1 + self.random.below(2000) as u16),
            2 => newest.wrapping_sub(1 + self.random.below(3000) as u16),
            3 => self.model.start.map_or(0, |(marker, _)| marker),
            _ => self.random.number() as u16,
        };
        // a marker of 0 stands for the serial
        let marker = marker.max(1);
        let serial = marker.wrapping_add(self.random.below(3) as u16);
        self.exchange(Attempt { ask, marker, serial }).map(drop)
    }

    fn malformed(&mut self) -> Result<(), Difference> {
        let serial = self.random.number() as u16;
        let mut bytes = TestFrame { serial, reserved: 0, code: 1, args: vec![] }.to_wire(false);
        *bytes.last_mut().unwrap() = 5;
        let (expected, seen) = (self.model.malformed(serial), self.server.receive(&bytes, self.now));
        self.compare(&format!("malformed, {serial}"), &expected, &seen)
    }

    fn end_of_call(&mut self) -> Result<(), Difference> {
        let (expected, seen) = (self.model.end_of_call(), self.server.end_of_call(self.now));
        self.compare("the running call ends", &expected, &seen)
    }

    fn send(&mut self, attempt: Attempt) -> Result<Vec<Seen>, Difference> {
        self.sent.push(attempt);
        self.exchange(attempt)
    }

    fn exchange(&mut self, attempt: Attempt) -> Result<Vec<Seen>, Difference> {
        self.tally.requests += 1;
        let had_session = self.model.session.is_some();
        let (expected, seen) = (self.model.take(attempt, self.now), self.server.take(attempt, self.now));
        self.compare(&format!("{attempt:?}"), &expected, &seen)?;
        if !had_session && seen.is_empty() && !self.server.session.is_running() {
            return Err(self.difference(format!("{attempt:?} without a session is neither executed nor answered")));
        }
        Ok(seen)
    }

    fn compare(&self, what: &str, expected: &[Seen], seen: &[Seen]) -> Result<(), Difference> {
        if expected == seen && self.server.session.is_running() == self.model.running.is_some() {
            return Ok(());
        }
        Err(self.difference(format!("{what}: expected {expected:?}, seen {seen:?}")))
    }

    fn difference(&self, what: String) -> Difference {
        Difference { step: self.step, what }
    }
}

/// Runs sequences until one differs; returns the first difference, with its seed.
fn first_difference(table: &BTreeMap<Cell, Word>, fault: Option<PlantedFault>) -> Option<(u64, Difference)> {
    (0..SEQUENCES)
        .find_map(|seed| Sequence::new(seed, table.clone(), fault).run().err().map(|difference| (seed, difference)))
}

#[test]
fn the_session_does_what_the_table_says() {
    let table = table();
    let (mut covered, mut all) = (BTreeSet::new(), Tally::default());
    for seed in 0..SEQUENCES {
        let mut sequence = Sequence::new(seed, table.clone(), None);
        sequence.run().unwrap_or_else(|difference| panic!("seed {seed}, {difference}"));
        covered.extend(sequence.model.covered);
        let tally = sequence.tally;
        all.requests += tally.requests;
        all.restarts += tally.restarts;
        all.at_once += tally.at_once;
        all.forged += tally.forged;
        all.copies += tally.copies;
    }
    println!(
        "{SEQUENCES} sequences, {} requests, of these {} copies and {} forged; {} restarts, {} answered at once; {} of {} cells covered",
        all.requests,
        all.copies,
        all.forged,
        all.restarts,
        all.at_once,
        covered.len(),
        table.len()
    );
    let missed: Vec<_> = table.keys().filter(|cell| !covered.contains(*cell)).collect();
    assert!(missed.is_empty(), "not covered: {missed:?}");
}

/// Returns whether a change of the table has no observable effect.
fn is_equivalent(cell: Cell, right: Word, wrong: Word) -> bool {
    let executes = |word| matches!(word, Word::Begin | Word::Execute);
    // the only call that can be last here is a refused one, and it would be refused again
    cell == ("begun", "call_copy") && executes(wrong) && right == Word::Again
}

#[test]
fn every_change_of_the_table_is_noticed() {
    let table = table();
    let (mut planted, mut missed) = (0, Vec::new());
    for (cell, right) in &table {
        for (_, wrong) in WORDS.iter().filter(|(_, word)| word != right) {
            if is_equivalent(*cell, *right, *wrong) {
                continue;
            }
            planted += 1;
            let mut changed = table.clone();
            changed.insert(*cell, *wrong);
            if first_difference(&changed, None).is_none() {
                missed.push((cell, wrong));
            }
        }
    }
    println!("{planted} changed cells, {} noticed", planted - missed.len());
    assert!(missed.is_empty(), "not noticed: {missed:?}");
}

#[test]
fn every_fault_of_a_session_is_noticed() {
    let table = table();
    let mut found = 0;
    for fault in FAULTS {
        let (seed, difference) =
            first_difference(&table, Some(fault)).unwrap_or_else(|| panic!("{fault:?} is not noticed"));
        println!("{fault:?}: sequence {seed}, {difference}");
        found += 1;
    }
    println!("{} faults planted, {found} noticed", FAULTS.len());
}
