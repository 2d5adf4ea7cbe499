//! `bcap sim --screen`: the virtual controller, its clients and their last calls, live in the terminal.

use std::collections::{BTreeMap, VecDeque};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use bcap_capture::frame::to_call;
use bcap_core::bcap::server as bcap;
use bcap_core::handler::{Outcome, PeerId, ReplyValue};
use bcap_core::hresult::HResult;
use bcap_core::rac::{Request as RacRequest, server as rac};
use bcap_core::time::Instant;
use bcap_live::errors::described;
use bcap_live::log::CallLog;
use bcap_live::variables::state_words;
use bcap_sim::Controller;
use bcap_sim::explain::Observer;
use bcap_std::server::Server;
use bcap_terminal::escape;
use bcap_terminal::screen::{KeyCode, Line, Panel, Part, Screen};

use super::delivery::deliver;
use crate::commands::screen::{log_key, log_panel, numbered, robot_lines};

/// The refused and tolerated arguments that are kept.
const KEPT: usize = 200;

const KEYS: &str = "q quit  a all calls, or only those whose reply has changed  p pause calls";

/// The arguments that were refused or tolerated, and the events of serial lines, each as a line.
#[derive(Clone, Debug, Default)]
pub(super) struct Refused(Arc<Mutex<VecDeque<String>>>);

/// The list of the screen that gets the events of serial lines; `None` without a screen. The server reports them to a
/// function, which has no state.
static SHOWN: Mutex<Option<Refused>> = Mutex::new(None);

impl Refused {
    /// Returns the list of the screen, which gets the events of serial lines from now on.
    pub(super) fn shown() -> Self {
        SHOWN.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert_default().clone()
    }

    /// Adds an event to the list of the screen; returns it if there is no screen.
    pub(super) fn push_shown(event: String) -> Option<String> {
        match &*SHOWN.lock().unwrap_or_else(PoisonError::into_inner) {
            Some(shown) => shown.push(event),
            None => return Some(event),
        }
        None
    }

    /// Returns the observer that fills this list.
    pub(super) fn observer(&self) -> Observer {
        let list = self.clone();
        Observer::new(move |code, text| {
            list.push(match code {
                HResult::S_OK => format!("tolerated: {text}"),
                code => format!("{code}: {text}"),
            });
        })
    }

    /// Adds a line, in place of the oldest one if there are many.
    fn push(&self, line: String) {
        let mut lines = self.lines();
        if lines.len() >= KEPT {
            lines.pop_front();
        }
        lines.push_back(line);
    }

    fn lines(&self) -> MutexGuard<'_, VecDeque<String>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// A controller whose clients and calls are recorded.
pub(super) struct Watched {
    controller: Controller,
    clients: BTreeMap<PeerId, Client>,
    log: CallLog,
    refused: Refused,
}

/// The controller that the server and the screen share.
pub(super) type SharedController = Arc<Mutex<Watched>>;

/// A client.
struct Client {
    protocol: &'static str,
    calls: u64,
    /// The call that waits for its reply.
    pending: Option<String>,
    /// The last call.
    last: String,
}

impl Watched {
    /// Makes the controller, which the server and the screen share.
    pub(super) fn shared(controller: Controller, refused: Refused) -> SharedController {
        Arc::new(Mutex::new(Self { controller, clients: BTreeMap::new(), log: CallLog::default(), refused }))
    }

    /// Makes the server.
    pub(super) fn server(shared: &SharedController) -> Server<Self> {
        Server::with_shared(Arc::clone(shared))
            .tap(|watched, peer, bytes| deliver(&mut watched.controller, peer, bytes))
            .on_connect(|watched, peer, address| watched.controller.connected(peer, address))
    }

    /// Records the beginning of a call of b-CAP.
    fn begin_request(&mut self, peer: PeerId, request: &bcap::Request<'_>) {
        let call = escape::cut(&to_call(request.function, request.args.iter()));
        self.begin(peer, "b-CAP", request.function.to_string(), call);
    }

    /// Records the beginning of a call.
    fn begin(&mut self, peer: PeerId, protocol: &'static str, name: String, call: String) {
        let new = Client { protocol, calls: 0, pending: None, last: String::new() };
        let client = self.clients.entry(peer).or_insert(new);
        (client.calls, client.pending, client.last) = (client.calls + 1, Some(call), name);
    }

    /// Records the end of a call, if it has ended.
    fn end(&mut self, peer: PeerId, outcome: Outcome, reply: &ReplyValue<'_>, now: Instant) {
        let Outcome::Done(code) = outcome else { return };
        let Some(call) = self.clients.get_mut(&peer).and_then(|client| client.pending.take()) else { return };
        let reply = reply.get().map_or_else(|| code.to_string(), |value| format!("{code}: {value:?}"));
        self.log.call(&format!("client {}:", peer.0), &call, &reply, Duration::from_micros(now.as_micros()));
    }

    /// Returns the content of the screen at this time.
    fn screen(&mut self, addresses: &str, now: Instant) -> Screen {
        self.controller.advance(now);
        let (controller, point) = (&self.controller, self.controller.point());
        let mut robot = robot_lines(&point.axes, &point.position);
        let (tool, work) = (point.tool.to_string(), point.work.to_string());
        let speed = controller.is_moving().then(|| "moving".into());
        robot.push(Line::new(numbered(&[("tool", Some(tool)), ("work", Some(work)), ("arm", speed)])));
        let tasks = controller.tasks().map(|(name, status, cycles)| format!("{name:16} {status:?}, {cycles} cycles"));
        let errors: Vec<Line> = controller.errors().map(|error| Line::new(described(error.code, ""))).collect();
        let none = errors.is_empty().then(|| Line::new("no errors"));
        let client = |(peer, client): (&PeerId, &Client)| {
            let Client { protocol, calls, last, .. } = client;
            Line::new(format!("client {}: {last}, {calls} calls, {protocol}", peer.0))
        };
        Screen {
            title: "bcap sim".into(),
            state: self.state(),
            alarm: controller.errors().next().is_some(),
            values: Panel::new("connections", self.clients.iter().map(client).collect()),
            robot: Panel::new("robot, degrees and mm", robot),
            tasks: Panel::new("tasks", tasks.map(Line::new).collect()),
            errors: Panel::new("errors", errors.into_iter().chain(none).collect()).showing(Part::Wrapped),
            messages: Panel::new(
                "refused arguments, latest first",
                self.refused.lines().iter().rev().map(Line::new).collect(),
            )
            .showing(Part::Wrapped),
            log: log_panel(&self.log, "calls"),
            notice: Line::new(addresses),
            keys: KEYS.into(),
            overlay: None,
        }
    }

    fn state(&self) -> String {
        let controller = &self.controller;
        let (kind, mode) = (controller.config().model.name.clone(), controller.mode() as u8);
        let code = match controller.errors().next() {
            None if controller.emergency_stopped() => None,
            error => Some(error.map_or(0, |error| error.code.0).to_string()),
        };
        let mut words = state_words(Some(kind), Some(mode.to_string()), code.as_deref());
        words.extend(controller.emergency_stopped().then(|| "EMERGENCY STOP".into()));
        words.extend(controller.arm_owner().map(|peer| match self.clients.contains_key(&peer) {
            true => format!("arm: client {}", peer.0),
            // a task, or the client of a scenario
            false => "arm: taken".into(),
        }));
        words.extend(controller.motor_is_on().then(|| "motor".into()));
        words.extend(controller.is_moving().then(|| "moving".into()));
        words.extend((controller.slave_mode() != 0).then(|| format!("Slave Mode {:#x}", controller.slave_mode())));
        words.join(" ")
    }
}

impl bcap::Handler for Watched {
    fn call(&mut self, peer: PeerId, request: &bcap::Request<'_>, reply: &mut ReplyValue<'_>, now: Instant) -> Outcome {
        self.begin_request(peer, request);
        let outcome = bcap::Handler::call(&mut self.controller, peer, request, reply, now);
        self.end(peer, outcome, reply, now);
        outcome
    }

    fn resume(
        &mut self,
        peer: PeerId,
        request: &bcap::Request<'_>,
        reply: &mut ReplyValue<'_>,
        now: Instant,
    ) -> Outcome {
        let outcome = bcap::Handler::resume(&mut self.controller, peer, request, reply, now);
        self.end(peer, outcome, reply, now);
        outcome
    }

    /// No client has made this call, so it is not shown.
    fn release(&mut self, peer: PeerId, request: &bcap::Request<'_>, now: Instant) {
        bcap::Handler::release(&mut self.controller, peer, request, now);
    }

    fn abandoned(&mut self, peer: PeerId, now: Instant) {
        bcap::Handler::abandoned(&mut self.controller, peer, now);
        self.clients.entry(peer).and_modify(|client| client.pending = None);
    }

    fn refused(&mut self, peer: PeerId, request: &bcap::Request<'_>, code: HResult, now: Instant) {
        self.begin_request(peer, request);
        bcap::Handler::refused(&mut self.controller, peer, request, code, now);
        self.end(peer, Outcome::Done(code), &ReplyValue::new(&mut []), now);
    }

    fn left(&mut self, peer: PeerId, now: Instant) {
        bcap::Handler::left(&mut self.controller, peer, now);
        self.clients.remove(&peer);
    }
}

impl rac::Handler for Watched {
    fn call(&mut self, peer: PeerId, request: &RacRequest<'_>, reply: &mut ReplyValue<'_>, now: Instant) -> Outcome {
        let variable = request.variable();
        let name = format!("{:?} {}{}", request.verb(), variable.kind.name(), variable.index);
        let value = request.value().map(|value| format!(" {value:?}")).unwrap_or_default();
        self.begin(peer, "RAC", name.clone(), escape::cut(&format!("{name}{value}")));
        let outcome = rac::Handler::call(&mut self.controller, peer, request, reply, now);
        self.end(peer, outcome, reply, now);
        outcome
    }

    fn left(&mut self, peer: PeerId, now: Instant) {
        rac::Handler::left(&mut self.controller, peer, now);
        self.clients.remove(&peer);
    }
}

/// Returns the function that makes the screen, for [`Live`](bcap_terminal::screen::Live).
pub(super) fn shown(addresses: &str, watched: &SharedController) -> impl FnMut(&[KeyCode]) -> Screen + Send + use<> {
    let (addresses, watched) = (addresses.to_owned(), Arc::clone(watched));
    move |keys| {
        let mut watched = watched.lock().unwrap_or_else(PoisonError::into_inner);
        keys.iter().for_each(|key| log_key(&mut watched.log, *key));
        watched.screen(&addresses, bcap_std::now())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bcap_core::bcap::{Args, FunctionId};
    use bcap_core::rac::{Variable, VariableKind};
    use bcap_core::variant::Variant;
    use bcap_sim::{Config, Profile};

    fn texts(panel: &Panel) -> Vec<&str> {
        panel.lines.iter().map(|line| line.text.as_str()).collect()
    }

    #[test]
    fn the_screen_shows_clients_calls_and_state() {
        let refused = Refused::default();
        let config = Config { observer: refused.observer(), ..Config::new(Profile::Rc8) };
        let shared = Watched::shared(Controller::new(config), refused);
        let mut watched = shared.lock().unwrap();
        let (mut buffer, at) = ([0; 256], Instant::from_millis(1500));
        let mut reply = ReplyValue::new(&mut buffer);
        let put = RacRequest::Put(Variable::new(VariableKind::I, 1), Variant::I4(5));
        let outcome = rac::Handler::call(&mut *watched, PeerId(7), &put, &mut reply, at);
        assert_eq!(outcome, Outcome::Done(HResult::S_OK));
        watched.controller.emergency_stop(true, at);
        assert_eq!(watched.screen("", at).state, "RC8 auto EMERGENCY STOP");
        let error = HResult::from_u32(0x8420_4043);
        watched.controller.inject_error(error, at);
        let screen = watched.screen("bcap=127.0.0.1:5007", at);
        assert_eq!(screen.notice.text, "bcap=127.0.0.1:5007");
        assert_eq!(screen.state, "RC8 auto error 0x84204043 EMERGENCY STOP");
        assert!(screen.alarm);
        assert_eq!(texts(&screen.values), ["client 7: Put I1, 1 calls, RAC"]);
        assert_eq!(texts(&screen.log), ["    1.50 client 7: S_OK = Put I1 I4(5)"]);
        assert_eq!(texts(&screen.tasks)[0], "Pro1             Ready, 0 cycles");
        assert!(texts(&screen.errors)[0].starts_with(&error.to_string()), "{:?}", screen.errors);
        assert_eq!(texts(&screen.robot)[4], "tool 0  work 0");
        rac::Handler::left(&mut *watched, PeerId(7), at);
        assert_eq!(texts(&watched.screen("", at).values), [""; 0]);
    }

    #[test]
    fn the_releases_of_the_server_are_not_shown_as_calls() {
        let refused = Refused::default();
        let shared = Watched::shared(Controller::new(Config::new(Profile::Rc8)), refused);
        let mut watched = shared.lock().unwrap();
        let request = bcap::Request::new(FunctionId::SERVICE_STOP, Args::NONE);
        bcap::Handler::release(&mut *watched, PeerId(7), &request, Instant::ZERO);
        let screen = watched.screen("", Instant::ZERO);
        assert_eq!((texts(&screen.values), texts(&screen.log)), (vec![], vec![]));
    }
}
