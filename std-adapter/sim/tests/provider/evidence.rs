//! Observations of real controllers, each played against the controller of its model.
//!
//! `observations.toml` has a table for each: the source, the model, the call, the answer of the real controller, and `play`, the
//! calls of the test with the real answers. One that is not played has a reason: `not_modelled` for a part that the virtual
//! controller lacks, `unsaid` where the source does not settle the answer, `elsewhere` for another test. One that is answered
//! otherwise has the reason in `differs`. `sequences.toml` has sequences of codes in the log of a real RC8A, in the same form.
//!
//! The test prints the table and fails where an answer and the record disagree. To change a record, add or delete the line
//! `differs`. `OBSERVATION=E0 cargo test -p bcap-sim --test all provider::evidence -- --nocapture` plays some of them.
//!
//! A step is a call, its argument, the layout of its answer (`*` any, `!` a refusal, `!83501032` this code), and optionally the
//! answer or a [condition](meets). `2:` before a call is the second client, `begin` starts a call that waits, and `end`
//! receives its answer. `again` starts the next steps with a new controller.

use std::collections::BTreeMap;

use bcap_core::bcap::call::{self, ControllerHandle, ExtensionHandle, RawCall, RobotHandle, TaskHandle};
use bcap_core::bcap::server::Handler as _;
use bcap_core::bcap::{FunctionId, Object};
use bcap_core::handler::PeerId;
use bcap_core::hresult::HResult;
use bcap_core::variant::{Encode, Variant};
use bcap_sim::model::ArmProfile;
use bcap_sim::{Config, Profile, Scenario};
use serde::Deserialize;
use toml::Value;

use super::{Argument, Rig, SCENARIO, Turn, is, layout, make, number};
use crate::common::{Client, Reply, World, code, value};

const OBSERVATIONS: &str = include_str!("observations.toml");
const SEQUENCES: &str = include_str!("sequences.toml");

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Observation {
    source: String,
    model: String,
    sent: String,
    real: String,
    #[serde(default)]
    play: Vec<Vec<Value>>,
    /// The state of the client at the start.
    #[serde(default)]
    start: Start,
    /// The initial state of the controller: a scenario without the heading `[controller]`.
    #[serde(default)]
    scenario: String,
    arm: Option<String>,
    elsewhere: Option<String>,
    differs: Option<String>,
    not_modelled: Option<String>,
    unsaid: Option<String>,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
enum Start {
    /// It owns the arm, and the motor is on.
    #[default]
    Ready,
    /// It has opened a controller and a robot.
    Connected,
    /// As ready, but the arm is free.
    Released,
    /// It has made no call.
    Absent,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Verdict {
    Agree,
    Disagree,
    NotModelled,
    CannotBeSaid,
}

impl Observation {
    fn recorded(&self) -> Verdict {
        let Self { not_modelled, unsaid, differs, elsewhere, play, .. } = self;
        match (not_modelled, unsaid, elsewhere, differs, play.is_empty()) {
            (Some(_), None, None, None, true) => Verdict::NotModelled,
            (None, Some(_), None, None, true) => Verdict::CannotBeSaid,
            (None, None, Some(_), None, true) | (None, None, None, None, false) => Verdict::Agree,
            (None, None, None, Some(_), _) => Verdict::Disagree,
            _ => panic!("{self:?}: a play, perhaps with `differs`, or one of the reasons"),
        }
    }

    fn reason(&self) -> &str {
        [&self.differs, &self.not_modelled, &self.unsaid, &self.elsewhere]
            .into_iter()
            .flatten()
            .next()
            .map_or("", String::as_str)
    }

    fn config(&self) -> Config {
        let profile = Profile::ALL.into_iter().find(|profile| key_of(*profile) == self.model);
        let mut config = Config::new(profile.unwrap_or_else(|| panic!("no model is {}", self.model)));
        config.files = Some(tempfile::tempdir().unwrap().keep());
        let Some(name) = self.arm.as_deref() else { return config };
        let arm =
            ArmProfile::ALL.into_iter().find(|arm| arm.name() == name).unwrap_or_else(|| panic!("no arm is {name}"));
        config.with_arm(arm.arm())
    }

    /// Plays the steps.
    ///
    /// # Errors
    ///
    /// The first step whose answer is another, and this answer.
    fn play(&self) -> Result<(), String> {
        let is_break = |step: &Vec<Value>| step.first().and_then(Value::as_str) == Some("again");
        self.play.split(is_break).try_for_each(|steps| Player::new(self).play(steps))
    }
}

fn key_of(profile: Profile) -> &'static str {
    match profile {
        Profile::Rc8 => "rc8",
        Profile::Rc8a => "rc8a",
        Profile::Rc9 => "rc9",
        Profile::Cobotta => "cobotta",
        Profile::CobottaPro => "cobotta-pro",
        _ => panic!("a model without a key"),
    }
}

struct Player {
    rig: Rig,
    /// The clients, from 1.
    clients: BTreeMap<u32, Client>,
    /// The handle that the last call returned.
    handle: i32,
}

impl Player {
    fn new(observation: &Observation) -> Self {
        let config = observation.config();
        std::fs::write(config.files.as_ref().unwrap().join("Pro1.pcs"), "123456789").unwrap();
        let mut world = World::with(config);
        world.sim.play(Scenario::parse(SCENARIO).unwrap());
        world.sim.play(Scenario::parse(&format!("[controller]\n{}", observation.scenario)).unwrap());
        let client = match observation.start {
            Start::Ready => world.mover(1),
            Start::Connected => world.client(1),
            Start::Released => {
                let client = world.mover(1);
                assert_eq!(world.robot(client, "GiveArm", ()), crate::common::ok(&()));
                client
            }
            Start::Absent => return Self { rig: Rig::of(world, None), clients: BTreeMap::new(), handle: 0 },
        };
        Self { rig: Rig::of(world, Some(client)), clients: BTreeMap::from([(1, client)]), handle: 0 }
    }

    fn play(&mut self, steps: &[Vec<Value>]) -> Result<(), String> {
        for step in steps {
            let [target, argument, rest @ ..] = step.as_slice() else { panic!("{step:?} is no step") };
            let target = target.as_str().expect("the name of a call");
            let (code, answer) = self.step(target, argument);
            let answer = answer.as_variant();
            let expected = rest.first().map_or("", |expected| expected.as_str().expect("a layout"));
            let agrees = match expected.strip_prefix('!') {
                Some("") => code.is_err(),
                Some(refusal) => code == parse_code(refusal),
                None => code.is_ok() && (expected == "*" || layout(&answer) == expected),
            };
            if !agrees || rest.get(1).is_some_and(|expected| !meets(&answer, expected)) {
                return Err(format!("{target} {argument:?}: {code} {answer:?}"));
            }
        }
        Ok(())
    }

    /// Creates a step.
    fn step(&mut self, target: &str, argument: &Value) -> Reply {
        match target {
            "pass" => self.rig.call("", "pass", argument, Turn::Whole),
            "set" => {
                let setup = format!("[controller]\n{}", argument.as_str().expect("the state"));
                self.rig.world.sim.play(Scenario::parse(&setup).unwrap());
                code(HResult::S_OK)
            }
            "errors" | "log" => self.codes(target == "log", argument),
            "left" => {
                let now = self.rig.world.now;
                self.rig.world.sim.left(self.rig.client.peer, now);
                code(HResult::S_OK)
            }
            "clock" => (HResult::S_OK, value(&((self.rig.world.now.as_micros() / 1000) as i32))),
            "raise" => {
                let now = self.rig.world.now;
                for _ in 0..argument.as_integer().unwrap() {
                    self.rig.world.sim.inject_error(HResult::from_u32(0x8420_4043), now);
                }
                code(HResult::S_OK)
            }
            "stream" => self.stream(argument),
            "explain" => explain(argument),
            _ => self.call(target, argument),
        }
    }

    /// Compares the codes of the current errors, or the latest of the log, in reverse order.
    fn codes(&self, log: bool, expected: &Value) -> Reply {
        let expected: Vec<_> =
            expected.as_array().expect("codes").iter().map(|item| parse_code(item.as_str().unwrap())).collect();
        let sim = &self.rig.world.sim;
        let found: Vec<_> = match log {
            true => sim.error_log().take(expected.len()).map(|error| error.code).collect(),
            false => sim.errors().map(|error| error.code).collect(),
        };
        if found == expected {
            return code(HResult::S_OK);
        }
        let text = found.iter().map(|code| format!("{:08X}", code.to_u32())).collect::<Vec<_>>().join(" ");
        (HResult::E_FAIL, value(text.as_str()))
    }

    /// Opens a session, and a controller with a name, a provider, a machine and an option.
    fn connect(&mut self, number: u32, argument: &Value) -> Reply {
        let (world, peer) = (&mut self.rig.world, PeerId(number));
        assert_eq!(world.call(peer, call::service_start("")).0, HResult::S_OK);
        let text: Vec<_> = argument.as_array().expect("four texts").iter().map(|item| item.as_str().unwrap()).collect();
        let reply = world.call(peer, call::controller_connect(text[0], text[1], text[2], text[3]));
        if let Variant::I4(handle) = reply.1.as_variant() {
            self.clients.insert(number, Client { peer, controller: ControllerHandle(handle), robot: RobotHandle(0) });
        }
        reply
    }

    /// Sends poses in Slave Mode: `[cycles, degrees of J1 a cycle, cycles of acceleration]`, the last 20 unless given. Answers
    /// as the last slvMove.
    fn stream(&mut self, argument: &Value) -> Reply {
        let cycles = argument.get(0).and_then(Value::as_integer).expect("a number of cycles");
        let step = number(argument.get(1).expect("degrees a cycle"));
        let rise = argument.get(2).and_then(Value::as_integer).map_or(20.0, |n| n as f64);
        let mut joints = self.rig.world.sim.axes();
        let mut reply = code(HResult::S_OK);
        for cycle in 1..=cycles {
            // starts at rest
            joints[0] += step * (cycle as f64 / rise).min(1.0);
            let pose = Value::Table(toml::Table::from_iter([("r8".to_owned(), Value::from(joints.to_vec()))]));
            reply = self.call("robot.slvMove", &pose);
            if reply.0.is_err() {
                break;
            }
            // mode 1 takes the newest pose, so the client has the clock
            if reply.0 == HResult::S_BUF_FULL || self.rig.world.sim.slave_mode() >> 8 == 1 {
                self.rig.world.pass(8);
            }
        }
        reply
    }

    /// Makes a call: `object.Command`, a variable, or any function.
    fn call(&mut self, target: &str, argument: &Value) -> Reply {
        let (turn, target) = match target.split_once(' ') {
            Some(("begin", target)) => (Turn::Begin, target),
            Some(("end", target)) => (Turn::End, target),
            _ => (Turn::Whole, target),
        };
        let (number, target) = target.split_once(':').map_or((1, target), |(n, target)| (n.parse().unwrap(), target));
        if target == "connect" {
            return self.connect(number, argument);
        }
        let client = *self.clients.entry(number).or_insert_with(|| self.rig.world.client(number));
        self.rig.client = client;
        let reply = match target.rsplit_once('.').unwrap_or(("", target)) {
            (object, "get" | "put") => self.variable(object, argument),
            ("", "Robot_Move" | "Robot_Rotate" | "Task_Start" | "Task_Stop") => {
                self.rig.call("", target, argument, turn)
            }
            ("", function) => self.function(function, argument, turn),
            (object, command) => self.rig.call(object, command, argument, turn),
        };
        if let Variant::I4(handle) = reply.1.as_variant() {
            self.handle = handle;
            if target == "Controller_GetRobot" {
                self.clients.insert(number, Client { robot: RobotHandle(handle), ..client });
            }
        }
        reply
    }

    /// Calls a function of the client's controller or robot, or of the object that the last call opened.
    fn function(&mut self, name: &str, arguments: &Value, turn: Turn) -> Reply {
        let (raw, name) = name.strip_prefix("raw ").map_or((false, name), |name| (true, name));
        let function = FunctionId::parse(name).unwrap_or_else(|| panic!("{name} is no function"));
        let Client { peer, controller, robot } = self.rig.client;
        let handle = match function.signature().unwrap().object {
            Object::Service => None,
            Object::Controller => Some(controller.0),
            Object::Robot => Some(robot.0),
            Object::Task => Some(self.rig.task.0),
            _ => Some(self.handle),
        };
        let handle = handle.filter(|_| !raw && function != FunctionId::CONTROLLER_CONNECT);
        let items: Vec<_> = arguments.as_array().expect("arguments").iter().map(Argument).collect();
        let handle = handle.as_ref().map(|handle| handle as &dyn Encode);
        let arguments: Vec<_> = handle.into_iter().chain(items.iter().map(|item| item as &dyn Encode)).collect();
        make(&mut self.rig.world, peer, &RawCall { function, arguments: &arguments }, turn)
    }

    /// Reads a variable, or writes `[name, value]`, through a handle that is released.
    fn variable(&mut self, object: &str, argument: &Value) -> Reply {
        let name = argument.as_str().or_else(|| argument.get(0)?.as_str()).expect("the name of a variable");
        let arguments = Value::from(vec![name.to_owned(), String::new()]);
        let (code, opened) = match object {
            "" | "controller" => self.function("Controller_GetVariable", &arguments, Turn::Whole),
            "robot" => self.function("Robot_GetVariable", &arguments, Turn::Whole),
            "task" => self.function("Task_GetVariable", &arguments, Turn::Whole),
            _ => self.function("File_GetVariable", &arguments, Turn::Whole),
        };
        let Variant::I4(handle) = opened.as_variant() else { return (code, opened) };
        self.handle = handle;
        let reply = match argument.as_array() {
            Some(items) => self.function("Variable_PutValue", &Value::from(vec![items[1].clone()]), Turn::Whole),
            None => self.function("Variable_GetValue", &Value::Array(Vec::new()), Turn::Whole),
        };
        self.function("Variable_Release", &Value::Array(Vec::new()), Turn::Whole);
        reply
    }
}

/// Answers the level of a code, if the table of codes has a meaning for it.
fn explain(argument: &Value) -> Reply {
    let explained = parse_code(argument.as_str().expect("a code"));
    match (explained.meaning(), explained.level()) {
        (Some(_), Some(level)) => (HResult::S_OK, value(&i32::from(level))),
        _ => code(HResult::E_FAIL),
    }
}

fn parse_code(digits: &str) -> HResult {
    HResult::from_u32(u32::from_str_radix(digits, 16).unwrap_or_else(|_| panic!("{digits} is no code")))
}

/// Returns whether an answer is a value, or meets a condition: `{ bits = n }` all set, `{ without = n }` none set,
/// `{ from = n, to = m }`, `{ nonzero = true }` no element is 0 or empty text, `{ count = n }` the number of elements, and for
/// one element `{ at = n, is = value }` or `{ at = n, type = "DATE" }`.
fn meets(answer: &Variant<'_>, expected: &Value) -> bool {
    let Value::Table(table) = expected else { return is(answer, expected) };
    let whole = |key: &str| table.get(key).and_then(Value::as_integer);
    let number = answer.as_i64();
    let place = || {
        let place = answer.as_array()?.iter().nth(usize::try_from(whole("at")?).ok()?)?;
        Some(match (table.get("is"), table.get("type").and_then(Value::as_str)) {
            (Some(value), _) => is(&place.flatten(), value),
            (None, Some("ARRAY")) => place.flatten().as_array().is_some(),
            (None, Some(vartype)) => layout(&place.flatten()) == vartype,
            (None, None) => false,
        })
    };
    let is_nonzero = || match answer {
        Variant::Array(array) => array.iter().any(|item| item.flatten().as_f64().is_some_and(|n| n != 0.0)),
        Variant::Bstr(text) => !text.to_string().is_empty(),
        _ => number.is_some_and(|n| n != 0),
    };
    whole("bits").is_none_or(|bits| number.is_some_and(|n| n & bits == bits))
        && whole("without").is_none_or(|bits| number.is_some_and(|n| n & bits == 0))
        && whole("from").is_none_or(|from| number.is_some_and(|n| n >= from))
        && whole("to").is_none_or(|to| number.is_some_and(|n| n <= to))
        && whole("count").is_none_or(|count| answer.as_array().is_some_and(|array| array.len() as i64 == count))
        && (!table.contains_key("nonzero") || is_nonzero())
        && (!table.contains_key("at") || place() == Some(true))
}

impl Rig {
    /// Plays with clients that the steps open.
    fn of(mut world: World, client: Option<Client>) -> Self {
        let Some(client) = client else {
            let client = Client { peer: PeerId(1), controller: ControllerHandle(0), robot: RobotHandle(0) };
            return Self { world, client, hand: ExtensionHandle(0), task: TaskHandle(0) };
        };
        let hand = world.handle(client.peer, call::controller_get_extension(client.controller, "Hand0", ""));
        let task = world.task(client, "Pro1");
        Self { hand: ExtensionHandle(hand), task, world, client }
    }
}

/// Plays all observations of a file; prints them with their verdicts, and returns the counts and what departs from the record.
fn judge(text: &str) -> (BTreeMap<Verdict, usize>, Vec<String>) {
    let observations: BTreeMap<String, Observation> = toml::from_str(text).unwrap();
    let only = std::env::var("OBSERVATION").unwrap_or_default();
    let (mut counts, mut wrong) = (BTreeMap::new(), Vec::new());
    for (id, observation) in observations.iter().filter(|(id, _)| id.starts_with(&only)) {
        let recorded = observation.recorded();
        let (verdict, seen) = match observation.play.is_empty() {
            true => (recorded, String::new()),
            false => match observation.play() {
                Ok(()) => (Verdict::Agree, String::new()),
                Err(seen) => (Verdict::Disagree, seen),
            },
        };
        let Observation { source, model, sent, real, .. } = observation;
        println!("{id} {verdict:?} [{source}; {model}] {sent}: {real}. {seen} {}", observation.reason());
        *counts.entry(verdict).or_default() += 1;
        if verdict != recorded {
            wrong.push(format!("{id} is recorded as {recorded:?} and played as {verdict:?}: {seen}"));
        }
    }
    println!("{counts:?}");
    (counts, wrong)
}

#[test]
fn the_observations_of_real_controllers() {
    let (_, wrong) = judge(OBSERVATIONS);
    assert!(wrong.is_empty(), "{wrong:#?}");
}

#[test]
fn the_sequences_of_the_log_of_a_real_controller() {
    let (_, wrong) = judge(SEQUENCES);
    assert!(wrong.is_empty(), "{wrong:#?}");
}
