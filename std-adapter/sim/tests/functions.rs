//! The tables of docs/virtual-controller.md say what the controller answers: each function and each command is called.

use std::collections::BTreeSet;

use bcap_core::bcap::call::{self, Call, Nothing};
use bcap_core::bcap::{FrameWriter, FunctionId, Object};
use bcap_core::error::EncodeError;
use bcap_core::handler::Outcome;
use bcap_core::hresult::HResult;
use bcap_sim::{Config, Profile};

use crate::common::{Client, World};

const PAGE: &str = include_str!("../../../docs/virtual-controller.md");

/// Returns the cells of the rows of the table under a heading, without its head.
fn rows(heading: &str) -> Vec<Vec<&'static str>> {
    let section = PAGE.split("\n## ").find(|section| section.starts_with(heading)).expect("the heading exists");
    let table = section.lines().filter(|line| line.starts_with('|')).skip(2);
    table.map(|line| line.trim_matches('|').split('|').map(str::trim).collect()).collect()
}

/// A call with a handle and no other argument.
struct Bare(FunctionId, Option<i32>);

impl Call for Bare {
    type Reply = Nothing;

    fn function(&self) -> FunctionId {
        self.0
    }

    fn arguments(&self, frame: &mut FrameWriter<'_>) -> Result<(), EncodeError> {
        self.1.map_or(Ok(()), |handle| frame.argument(&handle))
    }
}

/// Opens an object of this kind, and returns its handle.
fn open(world: &mut World, client: Client, object: Object) -> Option<i32> {
    let (peer, controller) = (client.peer, client.controller);
    Some(match object {
        Object::Service => return None,
        Object::Controller => controller.0,
        Object::Robot => client.robot.0,
        Object::Task => world.task(client, "Pro1").0,
        Object::Variable => world.variable(client, "I1").0,
        Object::File => world.handle(peer, call::controller_get_file(controller, "a.pcs", "@Create=1")),
        Object::Extension => world.handle(peer, call::controller_get_extension(controller, "Hand0", "")),
        Object::Command => world.handle(peer, call::controller_get_command(controller, "ClearError", "")),
        Object::Message => {
            world.sim.inject_error(HResult::from_u32(0x8150_0001), world.now);
            world.handle(peer, call::controller_get_message(controller))
        }
    })
}

/// Calls a function of a new controller.
fn answer(function: FunctionId) -> Option<HResult> {
    let folder = tempfile::tempdir().unwrap();
    let mut world = World::with(Config { files: Some(folder.path().to_owned()), ..Config::default() });
    let client = world.client(1);
    let object = function.signature().unwrap().object;
    let handle = open(&mut world, client, object);
    let handle = handle.filter(|_| function != FunctionId::CONTROLLER_CONNECT);
    match world.poll(client.peer, &Bare(function, handle), false).0 {
        Outcome::Done(code) => Some(code),
        Outcome::Wait(_) => None,
    }
}

#[test]
fn the_summary_counts_the_rows() {
    let (functions, commands) = (rows("Functions"), rows("Commands"));
    let summary = rows("# The virtual controller");
    assert_eq!(summary.len(), 5);
    let count = |rows: &[Vec<&str>], is: &str| rows.iter().filter(|row| row[2] == is).count();
    let (no, unknown) = (count(&commands, "no"), count(&commands, "unknown"));
    let counts = [count(&functions, "yes"), count(&functions, "no"), commands.len() - no - unknown, no, unknown];
    for (row, count) in summary.iter().zip(counts) {
        assert_eq!(row[1], count.to_string(), "{}", row[0]);
    }
}

#[test]
fn each_function_answers_as_its_row_says() {
    let rows = rows("Functions");
    let all: Vec<_> = FunctionId::all().collect();
    assert_eq!(rows.len(), all.len());
    for (row, function) in rows.iter().zip(all) {
        let (number, name) = (function.0.to_string(), function.name().unwrap());
        assert_eq!((row[0], row[1].replace('_', "").as_str()), (number.as_str(), name), "in the order of the numbers");
        let exists = answer(function) != Some(HResult::E_NOTIMPL);
        assert_eq!(row[2], if exists { "yes" } else { "no" }, "{name}");
    }
}

#[test]
fn each_command_answers_as_its_row_says() {
    let mut seen = BTreeSet::new();
    for row in rows("Commands") {
        let (object, name, state) = (row[0], row[1], row[2]);
        assert!(seen.insert((object, name)), "{object} {name} is there twice");
        let mut models = Vec::new();
        let mut missing = Vec::new();
        for profile in Profile::ALL {
            let model = profile.model().name.as_str();
            let mut world = World::with(Config::new(profile));
            let client = world.client(1);
            let (peer, task) = (client.peer, world.task(client, "Pro1"));
            let outcome = match object {
                "Controller" => world.poll(peer, &call::controller_execute(client.controller, name, ()), false),
                "Robot" => world.poll(peer, &call::robot_execute(client.robot, name, ()), false),
                "Task" => world.poll(peer, &call::task_execute(task, name, ()), false),
                "Hand0" | "Comm" | "Pallet" => {
                    let open = call::controller_get_extension(client.controller, object, "");
                    let extension = call::ExtensionHandle(world.handle(peer, open));
                    world.poll(peer, &call::extension_execute(extension, name, ()), false)
                }
                other => panic!("{other} has no commands"),
            };
            match outcome.0 {
                Outcome::Done(HResult::E_INVALID_CMD_NAME) => {}
                Outcome::Done(HResult::E_NOTIMPL) => missing.push(model),
                _ => models.push(model),
            }
        }
        let expected = match (models.len(), missing.len()) {
            (5, 0) => "all".to_owned(),
            (0, 5) => "no".to_owned(),
            (0, 0) => "unknown".to_owned(),
            (_, 0) => models.join(", "),
            _ => panic!("{name} is missing on some models only"),
        };
        assert_eq!(state, expected, "{object} {name}");
    }
}
