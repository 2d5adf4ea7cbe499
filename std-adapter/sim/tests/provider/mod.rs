//! The commands and system variables of the RC8 provider guide, and [observations](evidence) of real controllers, each played
//! against the controller.
//!
//! `commands.toml` and `variables.toml` have a line for each: its section, the calls to make, and the documented answers. The
//! test prints the table and asserts its counts: `cargo test -p bcap-sim --test all provider:: -- --nocapture`.

mod evidence;

use std::collections::BTreeMap;
use std::fmt;

use bcap_core::bcap::call::{self, Call};
use bcap_core::error::EncodeError;
use bcap_core::handler::{Outcome, PeerId};
use bcap_core::hresult::HResult;
use bcap_core::variant::{Encode, Variant, Writer};
use bcap_sim::{Config, Scenario};
use toml::Value;

use crate::common::{Client, Reply, World};

const COMMANDS: &str = include_str!("commands.toml");
const VARIABLES: &str = include_str!("variables.toml");

/// The programs on the controller of the test.
const SCENARIO: &str = include_str!("scenario.toml");

/// How a command or a variable behaves, compared with the guide.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Status {
    AsDocumented,
    EffectDiffers,
    OtherLayout,
    PartRefused,
    Missing,
    /// Only hardware could answer it; it is refused with `E_NOTIMPL`.
    NeedsHardware,
}

/// An argument of a call: an integer is an I4, a float an R8, `{}` EMPTY, an array one of VARIANT, `{ r4 = [...] }` one of R4.
struct Argument<'a>(&'a Value);

impl Encode for Argument<'_> {
    fn encode(&self, out: &mut Writer<'_>) -> Result<(), EncodeError> {
        match self.0 {
            Value::Integer(n) => i32::try_from(*n).unwrap().encode(out),
            Value::Float(n) => n.encode(out),
            Value::Boolean(on) => on.encode(out),
            Value::String(text) => text.as_str().encode(out),
            Value::Array(items) => {
                let items: Vec<_> = items.iter().map(Argument).collect();
                items.iter().map(|item| item as &dyn Encode).collect::<Vec<_>>().as_slice().encode(out)
            }
            Value::Table(table) => match (numbers(table, "r4"), numbers(table, "r8"), numbers(table, "i4")) {
                (Some(r4), ..) => r4.iter().map(|n| *n as f32).collect::<Vec<_>>().as_slice().encode(out),
                (_, Some(r8), _) => r8.as_slice().encode(out),
                (.., Some(i4)) => i4.iter().map(|n| *n as i32).collect::<Vec<_>>().as_slice().encode(out),
                _ => ().encode(out),
            },
            Value::Datetime(_) => panic!("an argument is no date"),
        }
    }
}

fn numbers(table: &toml::Table, element: &str) -> Option<Vec<f64>> {
    table.get(element)?.as_array().map(|items| items.iter().map(number).collect())
}

fn number(value: &Value) -> f64 {
    value.as_float().or_else(|| value.as_integer().map(|n| n as f64)).expect("a number")
}

/// Names the layout of a value: `I4`, `R8[7]`, `I4 BSTR`; EMPTY is nothing.
fn layout(value: &Variant<'_>) -> String {
    match value.shape().to_string().as_str() {
        "EMPTY" => String::new(),
        shape => shape.strip_prefix('(').and_then(|rest| rest.strip_suffix(')')).unwrap_or(shape).to_owned(),
    }
}

/// Returns whether a value has these numbers, or is this text.
fn is(value: &Variant<'_>, expected: &Value) -> bool {
    match (value, expected) {
        (Variant::Array(array), Value::Array(items)) => {
            array.len() == items.len() && array.iter().zip(items).all(|(item, expected)| is(&item.flatten(), expected))
        }
        (Variant::Bstr(text), Value::String(expected)) => text.to_string() == *expected,
        (Variant::Bool(on), Value::Boolean(expected)) => on == expected,
        // any value
        (_, Value::Table(_)) => true,
        (value, expected) => {
            let found = value.as_f64().or_else(|| value.as_i64().map(|n| n as f64));
            found.is_some_and(|found| (found - number(expected)).abs() < 1e-3)
        }
    }
}

/// A controller with a client that owns the arm, and a task.
struct Rig {
    world: World,
    client: Client,
    hand: call::ExtensionHandle,
    task: call::TaskHandle,
}

/// The part of a call that a step makes: all of it, or its start, or its end.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Turn {
    Whole,
    Begin,
    End,
}

/// Makes a call, or a part of it.
fn make(world: &mut World, peer: PeerId, call: &impl Call, turn: Turn) -> Reply {
    match turn {
        Turn::Whole => world.run(peer, call),
        Turn::End => world.run_again(peer, call),
        Turn::Begin => match world.poll(peer, call, false) {
            (Outcome::Done(code), value) => (code, value),
            (Outcome::Wait(_), _) => crate::common::code(HResult::S_OK),
        },
    }
}

impl Rig {
    fn new() -> Self {
        let files = tempfile::tempdir().unwrap();
        std::fs::write(files.path().join("Pro1.pcs"), "123456789").unwrap();
        // the folder lasts as long as the test
        let mut world = World::with(Config { files: Some(files.keep()), extended_axes: 2, ..Config::default() });
        world.sim.play(Scenario::parse(SCENARIO).unwrap());
        let client = world.mover(1);
        let hand = world.handle(client.peer, call::controller_get_extension(client.controller, "Hand0", ""));
        let task = world.task(client, "Pro1");
        Self { hand: call::ExtensionHandle(hand), task, world, client }
    }

    /// Makes a call of a step: `object.Name`, or a name of this list.
    fn call(&mut self, object: &str, name: &str, argument: &Value, turn: Turn) -> Reply {
        let Client { peer, controller, robot } = self.client;
        let world = &mut self.world;
        let item = |n: usize| argument.get(n).cloned().unwrap_or_else(|| Value::Table(toml::Table::new()));
        let text = |n: usize| item(n).as_str().unwrap_or_default().to_owned();
        let whole = |n: usize| i32::try_from(item(n).as_integer().unwrap_or_default()).unwrap();
        match (object, name) {
            ("", "pass") => {
                world.pass(argument.as_integer().unwrap().unsigned_abs());
                crate::common::code(HResult::S_OK)
            }
            ("", "Robot_Move") => {
                make(world, peer, &call::robot_move(robot, whole(0), Argument(&item(1)), &text(2)), turn)
            }
            ("", "Robot_Rotate") => {
                let (plane, degrees, centre, option) = (item(0), number(&item(1)), item(2), text(3));
                let (plane, centre) = (Argument(&plane), Argument(&centre));
                make(world, peer, &call::robot_rotate(robot, plane, degrees as f32, centre, &option), turn)
            }
            ("", "Task_Start") => make(world, peer, &call::task_start(self.task, whole(0), ""), turn),
            ("", "Task_Stop") => make(world, peer, &call::task_stop(self.task, whole(0), ""), turn),
            ("controller", _) => {
                make(world, peer, &call::controller_execute(controller, name, Argument(argument)), turn)
            }
            ("robot", _) => make(world, peer, &call::robot_execute(robot, name, Argument(argument)), turn),
            ("hand", _) => make(world, peer, &call::extension_execute(self.hand, name, Argument(argument)), turn),
            ("task", _) => make(world, peer, &call::task_execute(self.task, name, Argument(argument)), turn),
            _ => panic!("{object}.{name} is unknown"),
        }
    }

    /// Plays the steps of a command: each is the name of a call, its argument, the layout of its answer or `!` for a refusal,
    /// and optionally the answer itself.
    fn play(&mut self, object: &str, name: &str, steps: &[Value]) -> (Status, String) {
        let mut answered = false;
        for step in steps {
            let step = step.as_array().unwrap();
            let target = step[0].as_str().unwrap();
            let is_function = ["pass", "Robot_Move", "Robot_Rotate", "Task_Start", "Task_Stop"].contains(&target);
            let (of, command) = target.rsplit_once('.').unwrap_or((if is_function { "" } else { object }, target));
            let (code, value) = self.call(of, command, &step[1], Turn::Whole);
            let value = value.as_variant();
            let seen = format!("{target} {:?}: {code} {value:?}", step[1]);
            let own = (of, command) == (object, name);
            let expected = step[2].as_str().unwrap();
            if let Some(refusal) = expected.strip_prefix('!') {
                match code {
                    HResult::E_NOTIMPL if refusal == "hardware" => return (Status::NeedsHardware, String::new()),
                    HResult::E_NOTIMPL | HResult::E_INVALID_CMD_NAME => return (Status::Missing, seen),
                    code if code.is_err() => continue,
                    _ => return (Status::EffectDiffers, seen),
                }
            }
            if code.is_err() {
                let unknown = matches!(code, HResult::E_NOTIMPL | HResult::E_INVALID_CMD_NAME);
                let status = if own && unknown && !answered { Status::Missing } else { Status::PartRefused };
                return (if own { status } else { Status::EffectDiffers }, seen);
            }
            answered |= own;
            if layout(&value) != expected {
                return (if own { Status::OtherLayout } else { Status::EffectDiffers }, seen);
            }
            if step.get(3).is_some_and(|expected| !is(&value, expected)) {
                return (Status::EffectDiffers, seen);
            }
        }
        (Status::AsDocumented, String::new())
    }
}

/// The lines of a table with their status.
struct Table(Vec<(String, String, Status, String)>);

impl fmt::Display for Table {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (name, section, status, seen) in &self.0 {
            writeln!(f, "{name:32} {section:10} {status:?} {seen}")?;
        }
        write!(f, "{:?}", self.counts())
    }
}

impl Table {
    fn counts(&self) -> BTreeMap<Status, usize> {
        self.0.iter().fold(BTreeMap::new(), |mut counts, (_, _, status, _)| {
            *counts.entry(*status).or_default() += 1;
            counts
        })
    }

    fn of(lines: &str, judge: impl Fn(&str, &str, &[Value]) -> (Status, String)) -> Self {
        let objects: BTreeMap<String, BTreeMap<String, Vec<Value>>> = toml::from_str(lines).unwrap();
        let lines = objects.iter().flat_map(|(object, lines)| lines.iter().map(move |line| (object, line)));
        Self(
            lines
                .map(|(object, (name, line))| {
                    let (status, seen) = judge(object, name, &line[1..]);
                    (format!("{object}.{name}"), line[0].as_str().unwrap().to_owned(), status, seen)
                })
                .collect(),
        )
    }
}

#[test]
fn the_commands_of_the_guide() {
    let table = Table::of(COMMANDS, |object, name, steps| Rig::new().play(object, name, steps));
    println!("{table}");
    let expected = [(Status::AsDocumented, 142), (Status::NeedsHardware, 11)];
    assert_eq!(table.counts(), BTreeMap::from(expected));
}

/// Reads and writes a variable: `[access, layout, value to write, value then read]`.
fn judge_variable(object: &str, name: &str, line: &[Value]) -> (Status, String) {
    let Rig { mut world, client, task, .. } = Rig::new();
    let peer = client.peer;
    let opened = match object {
        "controller" => world.run(peer, call::controller_get_variable(client.controller, name, "")),
        "robot" => world.run(peer, call::robot_get_variable(client.robot, name, "")),
        "task" => world.run(peer, call::task_get_variable(task, name, "")),
        _ => {
            let file = world.handle(peer, call::controller_get_file(client.controller, "Pro1.pcs", ""));
            world.run(peer, call::file_get_variable(call::FileHandle(file), name, ""))
        }
    };
    let Variant::I4(handle) = opened.1.as_variant() else { return (Status::Missing, opened.0.to_string()) };
    let handle = call::VariableHandle(handle);
    let (access, expected) = (line[0].as_str().unwrap(), line[1].as_str().unwrap());
    if let Some(value) = line.get(2) {
        let (code, _) = world.run(peer, call::variable_put_value(handle, Argument(value)));
        if code.is_ok() != access.contains('w') {
            return (Status::EffectDiffers, format!("written: {code}"));
        }
    }
    let (code, value) = world.run(peer, call::variable_get_value(handle));
    if code.is_ok() != access.contains('r') {
        return (Status::EffectDiffers, format!("read: {code}"));
    }
    let seen = format!("{:?}", value.as_variant());
    match layout(&value.as_variant()) {
        _ if code.is_err() => (Status::AsDocumented, String::new()),
        found if found != expected => (Status::OtherLayout, seen),
        _ if line.get(3).is_some_and(|expected| !is(&value.as_variant(), expected)) => (Status::EffectDiffers, seen),
        _ => (Status::AsDocumented, String::new()),
    }
}

#[test]
fn the_variables_of_the_guide() {
    let table = Table::of(VARIABLES, judge_variable);
    println!("{table}");
    let expected = [(Status::AsDocumented, 76)];
    assert_eq!(table.counts(), BTreeMap::from(expected));
}
