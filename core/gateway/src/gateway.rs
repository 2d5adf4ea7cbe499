//! The state machine between the PLCs and the robot.

use core::fmt;
use core::net::Ipv4Addr;

use crate::convert::Converted;
use crate::handles::{CachedHandle, Handles, Lookup};
use crate::link::{LinkState, Phase};
use crate::slot::{Slot, Waiting};
use crate::stream::StreamCheck;
use crate::{Asked, Config, Counters, Event, Refusal, RobotError};

use bcap_core::bcap::call::{Any, ControllerHandle, RawCall, RobotHandle, VariableHandle};
use bcap_core::bcap::client::{self, Client, ClientError};
use bcap_core::bcap::{FunctionId, StreamState};
use bcap_core::endpoint::{Endpoint, ServerEndpoint};
use bcap_core::handler::PeerId;
use bcap_core::hresult::HResult;
use bcap_core::rac::{Request, Variable, Verb, server};
use bcap_core::time::Instant;
use bcap_core::variant::{Encode, Variant, Writer, write_integer};

/// Bytes of a frame to or from the robot: the longest string that fits a line of RAC has 251 characters.
const FRAME: usize = 640;

/// The memory of a gateway: slots for `SESSIONS` clients, handles for `HANDLES` variables, two frames.
///
/// A slot takes about 1.2 KiB, a handle 20 bytes.
pub struct Memory<const SESSIONS: usize, const HANDLES: usize> {
    slots: [Slot; SESSIONS],
    handles: [Option<CachedHandle>; HANDLES],
    tx: [u8; FRAME],
    rx: [u8; FRAME],
}

impl<const SESSIONS: usize, const HANDLES: usize> Memory<SESSIONS, HANDLES> {
    /// Creates memory for at least one client and one handle.
    #[must_use]
    pub const fn new() -> Self {
        const { assert!(SESSIONS > 0 && HANDLES > 0, "a gateway needs a session and a handle") };
        Self { slots: [Slot::FREE; SESSIONS], handles: [None; HANDLES], tx: [0; FRAME], rx: [0; FRAME] }
    }
}

impl<const SESSIONS: usize, const HANDLES: usize> Default for Memory<SESSIONS, HANDLES> {
    fn default() -> Self {
        Self::new()
    }
}

impl<const SESSIONS: usize, const HANDLES: usize> fmt::Debug for Memory<SESSIONS, HANDLES> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Memory").field("sessions", &SESSIONS).field("handles", &HANDLES).finish_non_exhaustive()
    }
}

/// A gateway from RAC to b-CAP.
#[derive(Debug)]
pub struct Gateway<'m> {
    config: Config<'m>,
    client: Client<&'m mut [u8]>,
    link: LinkState,
    stream: StreamCheck,
    handles: Handles<'m>,
    slots: &'m mut [Slot],
    /// The purpose of the call that runs at the robot.
    call: Option<InFlight>,
    /// The time of the robot's last reply; while the robot object is closed, of the reply to the call that opens it. The
    /// heartbeat follows it.
    last_seen: Instant,
    next_peer: u32,
    next_ticket: u32,
    /// An event from outside of `poll_event`.
    pending: Option<Event>,
    /// The time until which `poll_event` has nothing to do; zero after bytes were received or a connection has changed. Drivers
    /// poll more often than necessary.
    settled: Instant,
    counters: Counters,
}

/// The purpose of the call that runs at the robot.
#[derive(Clone, Copy, Debug)]
enum InFlight {
    ServiceStart,
    ControllerConnect,
    GetRobot,
    /// Any reply is sufficient, unless it means that the session no longer exists on the robot.
    Heartbeat,
    /// The heartbeat that queries whether a stream of Slave Mode runs.
    GetMode,
    /// The same query before the value is written by this handle.
    GetModeFor(Job, VariableHandle),
    /// Releases the handle of a variable to make room.
    Release(VariableHandle),
    GetVariable(Job),
    /// Reads or writes the value by this handle.
    Value(Job, VariableHandle),
}

/// A request that runs at the robot. Its client may have been answered or may have gone before the robot replies.
#[derive(Clone, Copy, Debug)]
struct Job {
    /// The index of its client; 16 bits keep a gateway within its memory.
    slot: u16,
    ticket: u32,
    variable: Variable,
    /// Whether this is the second attempt, after E_HANDLE.
    again: bool,
}

impl<'m> Gateway<'m> {
    /// Creates a gateway without clients, which requests a connection to its robot.
    #[must_use]
    pub fn new<const S: usize, const H: usize>(config: Config<'m>, memory: &'m mut Memory<S, H>) -> Self {
        let client = Client::new(config.client, memory.tx.as_mut_slice(), memory.rx.as_mut_slice());
        let slots = memory.slots.as_mut_slice();
        slots.iter_mut().for_each(Slot::close);
        Self {
            config,
            client,
            link: LinkState::new(config.first_pause, config.longest_pause),
            stream: StreamCheck::Unopened,
            handles: Handles::new(&mut memory.handles),
            slots,
            call: None,
            last_seen: Instant::ZERO,
            next_peer: 1,
            next_ticket: 0,
            pending: None,
            settled: Instant::ZERO,
            counters: Counters::default(),
        }
    }

    /// Returns the configuration.
    #[must_use]
    pub const fn config(&self) -> &Config<'m> {
        &self.config
    }

    /// Returns the counters.
    #[must_use]
    pub const fn counters(&self) -> &Counters {
        &self.counters
    }

    /// Returns the number of clients that the gateway has memory for.
    #[must_use]
    pub const fn capacity(&self) -> usize {
        self.slots.len()
    }

    /// Returns whether there is a session with the robot, so that requests are passed on.
    #[must_use]
    pub const fn is_up(&self) -> bool {
        matches!(self.link.phase, Phase::Up(_))
    }
}

/// The side of the PLCs. For a client without a slot, there are no bytes to send and no room to receive.
impl Gateway<'_> {
    /// Assigns a slot to a new client without an address, such as one on a serial line; `None` when all slots are taken.
    pub fn open(&mut self) -> Option<PeerId> {
        self.open_from(None)
    }

    /// Assigns a slot to a new client; `None` when all slots are taken.
    ///
    /// The address determines the rules that apply to the client. The caller checks
    /// [`Rules::admits`](crate::rules::Rules::admits) first.
    pub fn open_from(&mut self, address: Option<Ipv4Addr>) -> Option<PeerId> {
        self.settled = Instant::ZERO;
        let slot = self.slots.iter_mut().find(|slot| slot.peer.is_none())?;
        let peer = PeerId(self.next_peer);
        self.next_peer = self.next_peer.wrapping_add(1);
        slot.open(peer, address, self.config.request_timeout);
        Some(peer)
    }

    /// Frees the slot of a client that disconnected. Its request in flight is executed nevertheless.
    pub fn close(&mut self, peer: PeerId) {
        self.settled = Instant::ZERO;
        if let Some(slot) = self.slot_mut(peer) {
            slot.close();
        }
    }

    /// Returns memory for bytes from a client. It is empty while a request of the client runs.
    #[must_use]
    pub fn receive_buffer(&mut self, peer: PeerId) -> &mut [u8] {
        match self.slot_mut(peer) {
            // a running request keeps its line, which its event refers to
            Some(slot) if !slot.session.is_running() => slot.session.receive_buffer(),
            _ => &mut [],
        }
    }

    /// Records that `count` bytes were put into [`receive_buffer`](Self::receive_buffer).
    pub fn received(&mut self, peer: PeerId, count: usize) {
        self.settled = Instant::ZERO;
        if let Some(slot) = self.slot_mut(peer) {
            slot.session.received(count);
        }
    }

    /// Returns the bytes to send to a client.
    #[must_use]
    pub fn transmit(&self, peer: PeerId) -> &[u8] {
        self.slot(peer).map_or(&[], |slot| slot.session.transmit())
    }

    /// Records that the link to a client has taken `count` bytes of [`transmit`](Self::transmit).
    pub fn transmitted(&mut self, peer: PeerId, count: usize) {
        if let Some(slot) = self.slot_mut(peer) {
            slot.session.transmitted(count);
            // the next line may have arrived
            if slot.session.is_receiving() {
                self.settled = Instant::ZERO;
            }
        }
    }

    /// Views the last line of a client, without its CR; of an over-long one the first 256 bytes.
    ///
    /// Directly after [`poll_event`](Self::poll_event) has reported an event of this client, it is the line of the event.
    #[must_use]
    pub fn line(&self, peer: PeerId) -> &[u8] {
        self.slot(peer).map_or(&[], |slot| slot.session.line())
    }

    /// Returns whether a client has a request without a reply.
    #[must_use]
    pub fn is_running(&self, peer: PeerId) -> bool {
        self.slot(peer).is_some_and(|slot| slot.session.is_running())
    }

    /// Returns whether part of a client's line has arrived and its rest has not.
    #[must_use]
    pub fn is_receiving(&self, peer: PeerId) -> bool {
        self.slot(peer).is_some_and(|slot| slot.session.is_receiving())
    }

    fn slot(&self, peer: PeerId) -> Option<&Slot> {
        self.slots.iter().find(|slot| slot.peer == Some(peer))
    }

    fn slot_mut(&mut self, peer: PeerId) -> Option<&mut Slot> {
        self.slots.iter_mut().find(|slot| slot.peer == Some(peer))
    }
}

/// The side of the robot.
impl Gateway<'_> {
    /// Returns whether the gateway requests a connection to the robot.
    ///
    /// While it does, the caller must open a connection and keep it open; otherwise, the caller must close it. The caller
    /// reports each end with [`robot_closed`](Self::robot_closed); before that, the gateway requests no other connection.
    #[must_use]
    pub const fn robot_wanted(&self) -> bool {
        matches!(self.link.phase, Phase::Opening | Phase::Starting | Phase::Up(_))
    }

    /// Records that the connection is open.
    pub fn robot_opened(&mut self, now: Instant) {
        self.settled = Instant::ZERO;
        if self.link.phase == Phase::Opening {
            self.link.phase = Phase::Starting;
            self.client.reset();
            self.last_seen = now;
            let service = self.config.service;
            self.call = Some(InFlight::ServiceStart);
            if let Err(error) = self.start(FunctionId::SERVICE_START, &[&service], now) {
                self.pending = Some(self.fail_link(RobotError::Call(error)));
            }
        }
    }

    /// Records that the connection was closed by either side or could not be opened.
    pub fn robot_closed(&mut self, now: Instant) {
        self.settled = Instant::ZERO;
        if self.robot_wanted() {
            self.pending = Some(self.fail_link(RobotError::Closed));
        }
        self.link.closed(now);
    }

    /// Sets the serial of the next call to the robot, such as a random one over UDP, where replies can be forged.
    pub const fn set_next_serial(&mut self, serial: u16) {
        self.client.set_next_serial(serial);
    }

    /// Returns memory for bytes from the robot; over datagrams, for one datagram.
    #[must_use]
    pub fn robot_receive_buffer(&mut self) -> &mut [u8] {
        self.client.receive_buffer()
    }

    /// Records that `count` bytes were put into [`robot_receive_buffer`](Self::robot_receive_buffer).
    pub fn robot_received(&mut self, count: usize) {
        self.settled = Instant::ZERO;
        self.client.received(count);
    }

    /// Returns the bytes to send to the robot: one datagram, or the rest of a frame for a stream.
    #[must_use]
    pub fn robot_transmit(&self) -> &[u8] {
        self.client.transmit()
    }

    /// Records that the connection has taken `count` bytes of [`robot_transmit`](Self::robot_transmit).
    pub fn robot_transmitted(&mut self, count: usize) {
        self.client.transmitted(count);
        // this moves deadlines, but needs no step
        if self.settled > Instant::ZERO {
            self.settled = self.deadline();
        }
    }
}

/// The state machine between both sides.
impl Gateway<'_> {
    /// Returns when [`poll_event`](Self::poll_event) must be called even if nothing else happens.
    #[must_use]
    pub fn poll_timeout(&self) -> Option<Instant> {
        let until = if self.settled > Instant::ZERO { self.settled } else { self.deadline() };
        Some(until).filter(|until| *until < Instant::FAR_FUTURE)
    }

    fn deadline(&self) -> Instant {
        let link = match self.link.phase {
            Phase::Down { until } => Some(until),
            Phase::Up(_) if self.call.is_none() => Some(self.last_seen.saturating_add(self.config.heartbeat)),
            _ => self.client.poll_timeout(),
        };
        let sessions = self.slots.iter().filter(|slot| slot.peer.is_some()).filter_map(|s| s.session.poll_timeout());
        link.into_iter().chain(sessions).min().unwrap_or(Instant::FAR_FUTURE)
    }

    /// Performs the next step and returns its event; `None` when there is nothing to do.
    ///
    /// Call it until it returns `None`: after bytes were received or sent, after a connection was opened or closed, and
    /// at the time of [`poll_timeout`](Self::poll_timeout).
    pub fn poll_event(&mut self, now: Instant) -> Option<Event> {
        if now < self.settled {
            return None;
        }
        self.settled = Instant::ZERO;
        let event = self.pending.take().or_else(|| self.poll_robot(now)).or_else(|| self.poll_sessions(now));
        let event = event.or_else(|| self.begin(now));
        if event.is_none() {
            self.settled = self.deadline();
        }
        match event? {
            Event::Served { time, .. } => self.counters.served.add(time),
            Event::Failed { time, .. } => self.counters.failed.add(time),
            Event::Refused { .. } => self.counters.refused = self.counters.refused.saturating_add(1),
            Event::RobotUp => self.counters.connected = self.counters.connected.saturating_add(1),
            Event::RobotDown { .. } => {}
        }
        event
    }

    /// Handles received replies and timeouts of the robot.
    fn poll_robot(&mut self, now: Instant) -> Option<Event> {
        self.link.handle_timeout(now);
        loop {
            let event = self.client.poll_event(now).or_else(|| self.client.handle_timeout(now))?;
            let event = match event {
                client::Event::Replied(result) => self.replied(result, now),
                client::Event::Failed(error) => self.failed(error, now),
                // no other event ends a call
                _ => None,
            };
            if event.is_some() {
                return event;
            }
        }
    }

    /// Handles the reply to the running call.
    fn replied(&mut self, result: HResult, now: Instant) -> Option<Event> {
        self.record_reply(now);
        // in reply to a call of the controller: the session no longer exists on the robot
        let is_unknown = matches!(result, HResult::E_HANDLE | HResult::E_NOT_CONNECTED);
        match self.call.take()? {
            InFlight::GetRobot if is_unknown => Some(self.refused(FunctionId::CONTROLLER_GET_ROBOT, result)),
            InFlight::GetVariable(_) if is_unknown => Some(self.refused(FunctionId::CONTROLLER_GET_VARIABLE, result)),
            InFlight::Heartbeat if is_unknown => Some(self.refused(FunctionId::CONTROLLER_GET_NAME, result)),
            InFlight::ServiceStart if result.is_err() => Some(self.refused(FunctionId::SERVICE_START, result)),
            InFlight::ControllerConnect if result.is_err() => {
                Some(self.refused(FunctionId::CONTROLLER_CONNECT, result))
            }
            InFlight::ServiceStart => {
                let Config { name, provider, machine, option, .. } = self.config;
                self.call = Some(InFlight::ControllerConnect);
                let started = self.start(FunctionId::CONTROLLER_CONNECT, &[&name, &provider, &machine, &option], now);
                started.err().map(|error| self.fail_link(RobotError::Call(error)))
            }
            InFlight::ControllerConnect => match self.client.value::<ControllerHandle>() {
                Ok(controller) => {
                    self.stream = StreamCheck::Unopened;
                    self.link.up(controller);
                    Some(Event::RobotUp)
                }
                Err(error) => Some(self.fail_link(RobotError::Call(error))),
            },
            // any other reply shows that the robot is connected
            InFlight::Heartbeat => None,
            InFlight::GetRobot => {
                self.last_seen = now;
                let opened = self.client.value::<RobotHandle>().ok().filter(|_| result.is_ok());
                self.stream = match (opened, StreamState::from_reply(result, None)) {
                    (Some(robot), _) => StreamCheck::Open(robot),
                    (None, StreamState::Absent) => StreamCheck::Absent,
                    (None, _) => StreamCheck::Closed,
                };
                None
            }
            InFlight::GetMode => {
                self.mode_received(result);
                None
            }
            InFlight::GetModeFor(job, handle) => {
                let state = self.mode_received(result);
                if state.allows(FunctionId::VARIABLE_PUT_VALUE.properties(None, None)) {
                    return self.call_value(job, handle, now);
                }
                waiting_slot(self.slots, job)?.refuse(Refusal::SlaveMode)
            }
            // a handle that could not be released is also dropped
            InFlight::Release(handle) => {
                self.handles.remove(handle);
                None
            }
            InFlight::GetVariable(job) if result.is_err() => self.answer(job, result, now),
            InFlight::GetVariable(job) => match self.client.value::<VariableHandle>() {
                Ok(handle) => {
                    self.handles.insert(job.variable, handle);
                    self.begin_value(job, handle, now)
                }
                Err(error) => Some(self.fail_link(RobotError::Call(error))),
            },
            InFlight::Value(job, handle) if result == HResult::E_HANDLE => {
                self.handles.remove(handle);
                if job.again {
                    return self.answer(job, result, now);
                }
                self.begin_job(Job { again: true, ..job }, now)
            }
            InFlight::Value(job, _) => self.answer(job, result, now),
        }
    }

    /// Records the time of a reply.
    fn record_reply(&mut self, now: Instant) {
        if self.stream != StreamCheck::Closed {
            self.last_seen = now;
        }
    }

    /// Handles the reply to slvGetMode.
    fn mode_received(&mut self, result: HResult) -> StreamState {
        let mode = self.client.value::<Any>().ok().and_then(|mode| mode.as_i32());
        let state = StreamState::from_reply(result, mode);
        match (state, result) {
            (StreamState::Absent, _) => self.stream = StreamCheck::Absent,
            (_, HResult::E_HANDLE) => self.stream = StreamCheck::Unopened,
            _ => {}
        }
        state
    }

    /// Handles the end of a call without a reply.
    fn failed(&mut self, error: ClientError, now: Instant) -> Option<Event> {
        if let (ClientError::ReplyTooLarge { .. }, Some(InFlight::Value(job, _))) = (error, self.call) {
            // the client has skipped the reply; a value that does not fit this buffer does not fit a line
            self.call = None;
            self.record_reply(now);
            return self.answer(job, HResult::E_INVALIDSNDPACKET, now);
        }
        Some(self.fail_link(RobotError::Call(error)))
    }

    fn refused(&mut self, function: FunctionId, result: HResult) -> Event {
        self.fail_link(RobotError::Refused { function, result })
    }

    /// Ends the session with the robot. `poll_sessions` replies to the waiting requests.
    fn fail_link(&mut self, error: RobotError) -> Event {
        let was_sent = self.client.was_sent();
        let call = self.call.take();
        if let Some(InFlight::GetVariable(job) | InFlight::Value(job, _) | InFlight::GetModeFor(job, _)) = call
            && let Some(waiting) = waiting_slot(self.slots, job).and_then(|slot| slot.waiting.as_mut())
        {
            let is_put = matches!(call, Some(InFlight::Value(..))) && waiting.asked.verb == Verb::Put;
            // only E_TIMEOUT says that the robot may have executed it
            waiting.if_down = if is_put && was_sent { HResult::E_TIMEOUT } else { error.hresult() };
        }
        self.handles.clear();
        self.client.reset();
        self.link.fail();
        Event::RobotDown { error, pause: self.link.pause() }
    }

    /// Reads the clients' requests, replies to those that need no call to the robot, and queues the others.
    fn poll_sessions(&mut self, now: Instant) -> Option<Event> {
        let is_up = self.is_up();
        for slot in self.slots.iter_mut().filter(|slot| slot.peer.is_some()) {
            let event = match slot.session.poll(now) {
                Some(server::Event::Requested(_)) => {
                    let request = slot.session.request()?;
                    match self.config.rules.check(&request, slot.address, &mut slot.pace, now) {
                        Err(refusal) => slot.refuse(refusal),
                        Ok(()) => {
                            self.next_ticket = self.next_ticket.wrapping_add(1);
                            slot.waiting = Some(Waiting::new(self.next_ticket, Asked::of(&request), now));
                            None
                        }
                    }
                }
                Some(server::Event::Malformed(error)) => {
                    slot.peer.map(|peer| Event::Refused { peer, refusal: Refusal::Line(error) })
                }
                // the session has replied to a request that timed out
                Some(server::Event::Served { result, .. }) => slot.answered(result, now),
                _ => None,
            };
            let event = event.or_else(|| match slot.waiting {
                Some(waiting) if !is_up => slot.answer(waiting.if_down, &Variant::Empty, now),
                _ => None,
            });
            if event.is_some() {
                return event;
            }
        }
        None
    }

    /// Starts the next call, if no call is in flight.
    fn begin(&mut self, now: Instant) -> Option<Event> {
        let controller = self.link.controller()?;
        if self.call.is_some() {
            return None;
        }
        if self.stream == StreamCheck::Unopened {
            return self.open_robot(controller, now);
        }
        let is_heartbeat_due = now >= self.last_seen.saturating_add(self.config.heartbeat);
        if is_heartbeat_due && self.stream == StreamCheck::Closed {
            // before the requests, because PLCs that poll leave no pause after them
            return self.begin_heartbeat(controller, now);
        }
        let next_ticket = self.next_ticket;
        let waiting = self.slots.iter().enumerate().filter_map(|(at, slot)| Some((at, slot.waiting?)));
        // compares differences, because tickets wrap
        if let Some((slot, first)) = waiting.max_by_key(|(_, waiting)| next_ticket.wrapping_sub(waiting.ticket)) {
            let slot = u16::try_from(slot).ok()?;
            let job = Job { slot, ticket: first.ticket, variable: first.asked.variable, again: false };
            return self.begin_job(job, now);
        }
        if is_heartbeat_due { self.begin_heartbeat(controller, now) } else { None }
    }

    /// Starts the heartbeat: a call that does not end a stream of Slave Mode.
    fn begin_heartbeat(&mut self, controller: ControllerHandle, now: Instant) -> Option<Event> {
        let started = match self.stream {
            StreamCheck::Unopened | StreamCheck::Closed => return self.open_robot(controller, now),
            StreamCheck::Open(robot) => {
                self.call = Some(InFlight::GetMode);
                self.get_mode(robot, now)
            }
            // without Slave Mode there is no stream
            StreamCheck::Absent => {
                self.call = Some(InFlight::Heartbeat);
                self.start(FunctionId::CONTROLLER_GET_NAME, &[&controller], now)
            }
        };
        started.err().map(|error| self.fail_link(RobotError::Call(error)))
    }

    /// Starts the call that opens the robot object.
    fn open_robot(&mut self, controller: ControllerHandle, now: Instant) -> Option<Event> {
        self.call = Some(InFlight::GetRobot);
        let started = self.start(FunctionId::CONTROLLER_GET_ROBOT, &[&controller, &ROBOT, &""], now);
        started.err().map(|error| self.fail_link(RobotError::Call(error)))
    }

    /// Starts the first call that a request needs.
    fn begin_job(&mut self, job: Job, now: Instant) -> Option<Event> {
        let controller = self.link.controller()?;
        waiting_slot(self.slots, job)?;
        let started = match self.handles.look_up(job.variable) {
            Lookup::Known(handle) => return self.begin_value(job, handle, now),
            Lookup::Full(oldest) => {
                // the request stays the first in the queue until the handle is released
                self.call = Some(InFlight::Release(oldest));
                self.start(FunctionId::VARIABLE_RELEASE, &[&oldest], now)
            }
            Lookup::Unknown => {
                let mut name = [0; NAME];
                self.call = Some(InFlight::GetVariable(job));
                self.start(
                    FunctionId::CONTROLLER_GET_VARIABLE,
                    &[&controller, &variable_name(job.variable, &mut name), &""],
                    now,
                )
            }
        };
        started.err().map(|error| self.fail_link(RobotError::Call(error)))
    }

    /// Starts the call that reads the value, or the slvGetMode before it is written, if the request still waits.
    fn begin_value(&mut self, job: Job, handle: VariableHandle, now: Instant) -> Option<Event> {
        let slot = waiting_slot(self.slots, job)?;
        if matches!(slot.session.request()?, Request::Get(_)) {
            return self.call_value(job, handle, now);
        }
        match self.stream {
            StreamCheck::Open(robot) => {
                self.call = Some(InFlight::GetModeFor(job, handle));
                self.get_mode(robot, now).err().map(|error| self.fail_link(RobotError::Call(error)))
            }
            StreamCheck::Unopened | StreamCheck::Closed => slot.refuse(Refusal::SlaveMode),
            StreamCheck::Absent => self.call_value(job, handle, now),
        }
    }

    /// Starts the call that queries whether a stream of Slave Mode runs.
    fn get_mode(&mut self, robot: RobotHandle, now: Instant) -> Result<(), ClientError> {
        self.start(FunctionId::ROBOT_EXECUTE, &[&robot, &StreamState::COMMAND, &()], now)
    }

    /// Starts the call that reads or writes the value, if the request still waits.
    fn call_value(&mut self, job: Job, handle: VariableHandle, now: Instant) -> Option<Event> {
        let slot = waiting_slot(self.slots, job)?;
        let started = match slot.session.request()? {
            Request::Get(_) => {
                let arguments: [&dyn Encode; 1] = [&handle];
                self.client.start(
                    &RawCall { function: FunctionId::VARIABLE_GET_VALUE, arguments: &arguments },
                    self.client.timing(),
                    now,
                )
            }
            Request::Put(variable, value) => {
                let converted = Converted { kind: variable.kind, value };
                let arguments: [&dyn Encode; 2] = [&handle, &converted];
                self.client.start(
                    &RawCall { function: FunctionId::VARIABLE_PUT_VALUE, arguments: &arguments },
                    self.client.timing(),
                    now,
                )
            }
        };
        match started {
            Ok(()) => {
                self.call = Some(InFlight::Value(job, handle));
                None
            }
            Err(ClientError::Encode(_) | ClientError::TooLarge { .. }) => self.answer(job, HResult::E_ARGSIZEOVER, now),
            Err(error) => Some(self.fail_link(RobotError::Call(error))),
        }
    }

    /// Starts a call. It is not generic, so an image contains one copy of it.
    fn start(&mut self, function: FunctionId, arguments: &[&dyn Encode], now: Instant) -> Result<(), ClientError> {
        self.client.start(&RawCall { function, arguments }, self.client.timing(), now)
    }

    /// Replies to a request, if it still waits, with the value of the robot's reply if it is a GET.
    fn answer(&mut self, job: Job, result: HResult, now: Instant) -> Option<Event> {
        let slot = waiting_slot(self.slots, job)?;
        let value = self.client.value::<Any>().unwrap_or(Variant::Empty);
        slot.answer(result, &Converted { kind: job.variable.kind, value }, now)
    }
}

/// Returns the slot of a request, if it still waits there.
fn waiting_slot(slots: &mut [Slot], job: Job) -> Option<&mut Slot> {
    slots.get_mut(usize::from(job.slot)).filter(|slot| slot.waiting.is_some_and(|waiting| waiting.ticket == job.ticket))
}

/// The name of the robot object; controllers accept any.
const ROBOT: &str = "Arm";

/// Bytes of the longest name: `IO4294967295`.
const NAME: usize = 12;

/// Writes the name of a variable as Controller_GetVariable takes it.
fn variable_name(variable: Variable, buffer: &mut [u8; NAME]) -> &str {
    let mut out = Writer::new(buffer);
    // it fits: two letters and ten digits
    let _ = out.put_slice(variable.kind.name().as_bytes());
    let _ = write_integer(variable.index.into(), &mut out);
    core::str::from_utf8(out.into_bytes()).unwrap_or_default()
}

#[cfg(test)]
mod tests;
