//! Tests the virtual controller, in each model and over real sockets, with the call sequences of public drivers.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::PathBuf;
use std::sync::mpsc;
use std::thread;
use std::time::Duration;

use bcap_core::bcap::call::{Reply, ReplyError};
use bcap_core::bcap::{Args, Call as CoreCall, FrameWriter, FunctionId};
use bcap_core::error::EncodeError;
use bcap_core::hresult::HResult;
use bcap_core::limits::Strictness;
use bcap_core::rac::Variable;
use bcap_core::variant::Variant;
use bcap_sim::{Config, Controller, Scenario};
use bcap_std::blocking::{TcpClient, UdpClient};
use bcap_std::server::Limits;
use bcap_std::{Options, blocking};
use bcap_testkit::value::Value;
use bcap_tests::drivers::{
    Call, Event, Link, Model, Names, Sequence, Step, Stream, sequence, sequences, type_name, value,
};
use bcap_tests::served::Served;
use bcap_tests::stepped::Stepped;

/// The maximum number of rounds of a loop that waits for a value.
const ROUNDS: u32 = 10_000;

/// The buffer of Slave Mode is full: the pose was stored, or must be sent again.
const BUFFER_FULL: [HResult; 2] = [HResult::S_BUF_FULL, HResult::E_BUF_FULL];

/// The pause of a client when that buffer is full.
const CYCLE: Duration = Duration::from_millis(8);

/// A call of any function with any arguments.
struct Raw<'a> {
    function: FunctionId,
    args: &'a [Value],
}

/// The first value of a reply, or EMPTY.
struct Any;

impl Reply for Any {
    type Value<'a> = Value;

    fn read(args: Args<'_>) -> Result<Value, ReplyError> {
        Ok(args.get(0).map_or(Value::Empty, Value::read))
    }
}

impl CoreCall for Raw<'_> {
    type Reply = Any;

    fn function(&self) -> FunctionId {
        self.function
    }

    fn arguments(&self, frame: &mut FrameWriter<'_>) -> Result<(), EncodeError> {
        self.args.iter().try_for_each(|arg| frame.argument(arg))
    }
}

/// A session of a client.
enum Session {
    Tcp(TcpClient),
    Udp(UdpClient),
}

impl Session {
    fn open(link: Link, sim: &Served<Stepped>) -> Self {
        let options = Options::default();
        match link {
            Link::Tcp => Self::Tcp(blocking::connect_tcp(sim.tcp, &options).expect("a connection")),
            Link::Udp => Self::Udp(blocking::connect_udp(sim.udp, &options).expect("a socket")),
        }
    }

    /// Makes a call; returns its code and value.
    fn call(&mut self, function: FunctionId, args: &[Value]) -> (HResult, Value) {
        macro_rules! call {
            ($client:expr) => {
                match $client.call(Raw { function, args }) {
                    Ok(value) => ($client.last_result().expect("a reply"), value),
                    Err(error) => (error.hresult().unwrap_or_else(|| panic!("{function:?}: {error}")), Value::Empty),
                }
            };
        }
        match self {
            Self::Tcp(client) => call!(client),
            Self::Udp(client) => call!(client),
        }
    }
}

/// A deviation from a sequence.
#[derive(Debug, PartialEq, Eq)]
struct Departure {
    at: String,
    code: HResult,
    why: String,
}

/// A sequence that is being played.
struct Player<'a> {
    sim: &'a Served<Stepped>,
    model: Model,
    sessions: BTreeMap<String, Session>,
    names: Names,
    calls: usize,
}

impl Player<'_> {
    fn steps(&mut self, steps: &[Step]) -> Result<(), Departure> {
        steps.iter().try_for_each(|step| match step {
            Step::Call(call) => self.call(call),
            Step::Stream(stream) => self.stream(stream),
            Step::Repeat(repeat) => (0..repeat.repeat).try_for_each(|round| {
                self.names.insert("#".into(), Value::I4(round as i32));
                self.steps(&repeat.steps)
            }),
            Step::Pause(pause) => {
                self.pass(Duration::from_millis(pause.pause_ms));
                Ok(())
            }
            Step::Event(event) => {
                self.event(event);
                Ok(())
            }
        })
    }

    fn pass(&self, time: Duration) {
        self.sim.application().pass(time);
    }

    fn event(&self, event: &Event) {
        let mut sim = self.sim.application();
        let now = sim.now();
        if let Some(pressed) = event.emergency_stop {
            sim.controller.emergency_stop(pressed, now);
        }
        if let Some(code) = event.error {
            sim.controller.inject_error(code.0, now);
        }
    }

    fn session(&mut self, name: &str) -> &mut Session {
        self.sessions.get_mut(name).unwrap_or_else(|| panic!("no session is called {name}"))
    }

    fn call(&mut self, call: &Call) -> Result<(), Departure> {
        if call.only.as_ref().is_some_and(|models| !models.contains(&self.model.like())) {
            return Ok(());
        }
        let until = call.until.as_ref().map(|json| value(json, &self.names));
        let rounds = if until.is_some() { ROUNDS } else { call.times.unwrap_or(1) };
        for _ in 0..rounds {
            let (code, answer) = self.call_once(call);
            self.check(call, code, &answer)?;
            let found = until.as_ref() == Some(&answer);
            if let Some(name) = &call.name {
                self.names.insert(name.clone(), answer);
            }
            if found {
                return Ok(());
            }
        }
        match until {
            Some(until) => Err(depart(&call.title(), HResult::S_OK, format!("never gives {until:?}"))),
            None => Ok(()),
        }
    }

    fn call_once(&mut self, call: &Call) -> (HResult, Value) {
        let args: Vec<Value> = call.args.iter().map(|json| value(json, &self.names)).collect();
        self.calls += 1;
        if call.during.is_empty() {
            return self.session(&call.on).call(call.call, &args);
        }
        let mut session = self.sessions.remove(&call.on).expect("the session");
        let (waits, waiting) = mpsc::channel();
        let ended = waits.clone();
        self.sim.application().hold_next(waits);
        let (answer, session) = thread::scope(|scope| {
            let caller = scope.spawn(move || {
                let answer = session.call(call.call, &args);
                // a call that does not wait ends the wait for it
                let _ = ended.send(());
                (answer, session)
            });
            waiting.recv().expect("the call waits or ends");
            let during = self.steps(&call.during);
            self.sim.application().release();
            let ended = caller.join().expect("the call ends");
            during.unwrap_or_else(|departure| panic!("while {} waits: {departure:?}", call.title()));
            ended
        });
        self.sessions.insert(call.on.clone(), session);
        answer
    }

    fn check(&self, call: &Call, code: HResult, answer: &Value) -> Result<(), Departure> {
        let expected = call.code.as_ref().map_or(HResult::S_OK, |code| code.of(self.model.like()));
        let fail = |why: String| Err(depart(&call.title(), code, why));
        if code != expected {
            return fail(format!("answers {code} instead of {expected}"));
        }
        if code.is_err() {
            return Ok(());
        }
        if let Some(gives) = &call.gives
            && !is_of_type(answer, gives)
        {
            return fail(format!("gives {} instead of {gives}", type_name(answer)));
        }
        match call.is.as_ref().map(|json| value(json, &self.names)) {
            Some(is) if is != *answer => fail(format!("gives {answer:?} instead of {is:?}")),
            _ => Ok(()),
        }
    }

    fn stream(&mut self, stream: &Stream) -> Result<(), Departure> {
        let ends = stream.ends.as_ref().map(|code| code.of(self.model.like())).filter(|code| code.is_err());
        let robot = value(&stream.stream.clone().into(), &self.names);
        for cycle in 0..stream.cycles {
            let args = [robot.clone(), Value::text("slvMove"), stream.parameter(cycle, &self.names)];
            loop {
                self.calls += 1;
                let (code, answer) = self.session(&stream.on).call(FunctionId::ROBOT_EXECUTE, &args);
                self.pass(Duration::from_millis(stream.pace_ms));
                if BUFFER_FULL.contains(&code) {
                    self.pass(CYCLE);
                }
                if code == HResult::E_BUF_FULL {
                    continue;
                }
                if Some(code) == ends {
                    return Ok(());
                }
                if code.is_err() {
                    return Err(depart("slvMove", code, format!("answers {code} in cycle {cycle}")));
                }
                let gives = stream.gives.as_deref().unwrap_or("R8[8]");
                if !is_of_type(&answer, gives) {
                    let why = format!("gives {} instead of {gives} in cycle {cycle}", type_name(&answer));
                    return Err(depart("slvMove", code, why));
                }
                break;
            }
        }
        match ends {
            Some(code) => Err(depart("slvMove", HResult::S_OK, format!("never answers {code}"))),
            None => Ok(()),
        }
    }
}

fn depart(at: &str, code: HResult, why: String) -> Departure {
    Departure { at: at.to_owned(), code, why }
}

/// Returns whether a value is of a type; `[]` stands for any length.
fn is_of_type(value: &Value, gives: &str) -> bool {
    let found = type_name(value);
    match gives.strip_suffix("[]") {
        Some(element) => found.split_once('[').is_some_and(|(name, _)| name == element),
        None => found == gives,
    }
}

/// The links of a sequence's sessions: as in the real program, all TCP, all UDP.
fn links(sequence: &Sequence) -> BTreeSet<BTreeMap<String, Link>> {
    let own = &sequence.head.sessions;
    let all = |link: Link| own.keys().map(|name| (name.clone(), link)).collect();
    BTreeSet::from([own.clone(), all(Link::Tcp), all(Link::Udp)])
}

/// Sets a user variable by its name, as `P1`.
fn set_variable(controller: &mut Controller, name: &str, value: &Value) {
    let Variable { kind, index } = name.parse().expect("a user variable");
    let wire = value.to_wire();
    let value = Variant::decode(&wire, &bcap_core::limits::Limits::STREAM, Strictness::Strict).expect("a value");
    controller.set_variable(kind, index, &value).expect("such a variable");
}

/// Plays a sequence; returns the number of calls and how it ended.
fn play(sequence: &Sequence, model: Model, links: &BTreeMap<String, Link>) -> (usize, Result<(), Departure>) {
    let Sequence { head, steps } = sequence;
    let config = Config { files: Some(files(model)), ..Config::new(model.profile()) };
    let mut controller = Controller::new(config);
    if !head.scenario.is_empty() {
        controller.play(Scenario::parse(&head.scenario).unwrap_or_else(|e| panic!("{}: {e}", head.name)));
    }
    for (name, json) in &head.variables {
        set_variable(&mut controller, name, &value(json, &Names::new()));
    }
    let sim = Served::of(Stepped::new(controller), Limits::default());
    let sessions = links.iter().map(|(name, link)| (name.clone(), Session::open(*link, &sim))).collect();
    let provider = Value::text(model.profile().provider());
    let names = Names::from([("provider".into(), provider)]);
    let mut player = Player { sim: &sim, model, sessions, names, calls: 0 };
    let end = player.steps(steps);
    let Player { calls, sessions, .. } = player;
    drop(sessions);
    if end.is_ok() {
        assert_eq!(sim.application().controller.open_objects(), 0, "{} leaves objects in {model:?}", head.name);
    }
    (calls, end)
}

/// Returns the folder for the controller's files.
fn files(model: Model) -> PathBuf {
    std::env::temp_dir().join(format!("bcap-drivers-{}-{model:?}", std::process::id()))
}

/// The sequences that were played.
#[derive(Debug, Default)]
struct Total {
    runs: usize,
    refused: usize,
    calls: usize,
    links: BTreeSet<Link>,
}

/// Plays all sequences in one model.
fn play_all(sequences: &[Sequence], model: Model) -> (Total, Vec<String>) {
    let (mut total, mut faults) = (Total::default(), Vec::new());
    fs::create_dir_all(files(model)).expect("a folder for files");
    for sequence in sequences {
        let Sequence { head, .. } = sequence;
        let elsewhere = head.failure(model);
        let is_for = elsewhere.is_none();
        assert!(!is_for || head.models.contains(&model.like()), "{}: it has no failure on {model:?}", head.name);
        for links in &links(sequence) {
            let (calls, end) = play(sequence, model, links);
            total.calls += calls;
            total.links.extend(links.values());
            *(if is_for { &mut total.runs } else { &mut total.refused }) += 1;
            let wanted = elsewhere.map(|failure| (failure.at.clone(), failure.code.0));
            let found = end.as_ref().err().map(|departure| (departure.at.clone(), departure.code));
            if found != wanted {
                faults.push(format!("{} on {model:?} over {links:?}: {end:?}, wanted {wanted:?}", head.name));
            }
        }
    }
    fs::remove_dir_all(files(model)).expect("the folder is there");
    (total, faults)
}

/// Returns the sequence with this name.
fn named(name: &str) -> Sequence {
    sequences().into_iter().find(|sequence| sequence.head.name == name).expect("a sequence")
}

#[test]
fn the_ros_2_driver_fails_where_the_motor_comes_after_the_answer() {
    let mut sequence = named("ros2-control-rc8");
    sequence.head.scenario = "[controller]\nservo_on_waits = false".into();
    let (_, end) = play(&sequence, Model::Rc8, &sequence.head.sessions);
    let departure = end.expect_err("the motor is not on yet");
    assert_eq!((departure.at.as_str(), departure.code), ("slvChangeMode", HResult::E_MOTOR_OFF));
}

#[test]
fn a_differing_answer_is_detected() {
    let head = r#"{"name": "x", "source": "x", "models": ["rc8"]}"#;
    let start = r#"{"call": "ServiceStart", "args": [""]}"#;
    let connect = r#"{"call": "ControllerConnect", "args": ["", "$provider", "", ""], "as": "c""#;
    let ask = r#"{"call": "ControllerExecute", "args": ["$c", "GetCurErrorCount", null]"#;
    for (wrong, at) in [
        (format!(r#"{connect}, "code": "E_FAIL"}}"#), "ControllerConnect"),
        (format!("{connect}}}\n{ask}, \"is\": 1}}"), "GetCurErrorCount"),
        (format!("{connect}}}\n{ask}, \"gives\": \"R8\"}}"), "GetCurErrorCount"),
        (format!("{connect}}}\n{ask}, \"until\": 1}}"), "GetCurErrorCount"),
    ] {
        let sequence = sequence(&format!("{head}\n{start}\n{wrong}"), "a test");
        let (_, end) = play(&sequence, Model::Rc8, &sequence.head.sessions);
        assert_eq!(end.map_err(|departure| departure.at), Err(at.into()), "{wrong}");
    }
}

#[test]
fn words_without_a_meaning_are_refused() {
    let head = r#"{"name": "x", "source": "x", "models": ["rc8"], "elsewhere": {"rc9": {"at": "ServiceStart", "code": "E_FAIL"}}}"#;
    let start = r#"{"call": "ServiceStart", "args": [""]}"#;
    let _ = sequence(&format!("{head}\n{start}"), "a test");
    for wrong in [
        r#"{}"#,
        r#"{"paus_ms": 5}"#,
        r#"{"call": "ServiceStart", "argz": [""]}"#,
        r#"{"call": "ServiceStart", "on": "nowhere"}"#,
        r#"{"call": "ServiceStart", "only": ["rc8a"]}"#,
        r#"{"call": "ServiceStart", "only": ["cobotta"]}"#,
        r#"{"call": "ServiceStart", "code": {"rc8a": "E_FAIL"}}"#,
        r#"{"call": "ServiceStart", "code": "E_NO_SUCH"}"#,
        r#"{"call": "ServiceStart", "args": ["$c"]}"#,
        r##"{"call": "ServiceStart", "args": ["#"]}"##,
        r#"{"call": "ServiceStart", "args": [{"R9": 1}]}"#,
        r#"{"call": "ServiceStart", "args": [{"R4": 1, "R8": 2}]}"#,
        r#"{"call": "ServiceStart", "gives": "R8[8"}"#,
        r#"{"call": "ServiceStart", "gives": "I5"}"#,
        r#"{"call": "ServiceStart", "until": 1, "times": 2}"#,
        r#"{"stream": "$provider", "cycles": 1, "from": [0], "numbers": "I4"}"#,
        r#"{"repeat": 2, "steps": [{"no_such_step": true}]}"#,
    ] {
        let read = std::panic::catch_unwind(|| sequence(&format!("{head}\n{start}\n{wrong}"), "a test"));
        assert!(read.is_err(), "{wrong}");
    }
    let never = std::panic::catch_unwind(|| sequence(&format!("{head}\n{{\"pause_ms\": 1}}"), "a test"));
    assert!(never.is_err(), "no step can be the one that fails elsewhere");
}

#[test]
fn every_sequence_runs_in_its_models_over_both_links() {
    let sequences = sequences();
    let only = std::env::var("SEQUENCE").unwrap_or_default();
    let chosen: Vec<Sequence> = sequences.iter().filter(|s| s.head.name.contains(&only)).cloned().collect();
    let ended: Vec<(Model, (Total, Vec<String>))> = thread::scope(|scope| {
        let play = |model| {
            (
                model,
                scope.spawn({
                    let chosen = &chosen;
                    move || play_all(chosen, model)
                }),
            )
        };
        let threads: Vec<_> = Model::ALL.map(play).into_iter().collect();
        threads.into_iter().map(|(model, thread)| (model, thread.join().expect("the model is played"))).collect()
    });
    for (model, (total, _)) in &ended {
        println!("{model:?}: {} runs, {} refused, {} calls", total.runs, total.refused, total.calls);
    }
    let faults: Vec<&String> = ended.iter().flat_map(|(_, (_, faults))| faults).collect();
    assert!(faults.is_empty(), "{faults:#?}");
    let calls: usize = ended.iter().map(|(_, (total, _))| total.calls).sum();
    let played: BTreeSet<Link> = ended.iter().flat_map(|(_, (total, _))| total.links.clone()).collect();
    println!("{} sequences, {calls} calls, {} models, {} links", chosen.len(), ended.len(), played.len());
    if only.is_empty() {
        assert!(chosen.len() >= 69 && calls >= 60_000, "sequences or calls are missing");
        assert_eq!(played, BTreeSet::from([Link::Tcp, Link::Udp]));
    }
    for (model, (total, _)) in &ended {
        let of = |models: &dyn Fn(&Sequence) -> bool| {
            chosen.iter().filter(|s| models(s)).map(|s| links(s).len()).sum::<usize>()
        };
        assert_eq!(total.runs, of(&|s| s.head.failure(*model).is_none()), "{model:?}");
        assert_eq!(total.refused, of(&|s| s.head.failure(*model).is_some()), "{model:?}");
    }
}
