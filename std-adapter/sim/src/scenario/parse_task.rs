//! Reads the sections `[[task]]` of a scenario from TOML, and refuses invalid ones.

use std::collections::BTreeMap;
use std::time::Duration;

use serde::Deserialize;

use super::ScenarioError;
use super::parse_setup::read_code;
use crate::program::{Assignment, Constant, Program, PublicValues, Step};
use crate::value::{ValueResult, owned};

/// The largest number of steps of a program.
const STEPS_MAX: usize = 10_000;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct TaskEntry {
    name: String,
    steps: Vec<StepEntry>,
    #[serde(default = "default_line")]
    line_ms: u64,
    start: Option<i32>,
    #[serde(default)]
    public: BTreeMap<String, PublicEntry>,
}

/// A public variable: its type is the type of its value, or the key of a pose.
#[derive(Deserialize)]
#[serde(untagged)]
enum PublicEntry {
    Bool(bool),
    Integer(i32),
    Number(f64),
    Text(String),
    Integers(Vec<i32>),
    Numbers(Vec<f64>),
    Texts(Vec<String>),
    Pose(PoseEntry),
}

#[derive(Deserialize)]
#[serde(rename_all = "lowercase")]
enum PoseEntry {
    V([f32; 3]),
    P([f32; 7]),
    J([f32; 8]),
    T([f32; 10]),
}

impl PublicEntry {
    fn read(self) -> ValueResult {
        match self {
            Self::Bool(on) => owned(on),
            Self::Integer(n) => owned(n),
            Self::Number(n) => owned(n),
            Self::Text(text) => owned(text),
            Self::Integers(items) => owned(items),
            Self::Numbers(items) => owned(items),
            Self::Texts(items) => owned(items),
            Self::Pose(PoseEntry::V(items)) => owned(items),
            Self::Pose(PoseEntry::P(items)) => owned(items),
            Self::Pose(PoseEntry::J(items)) => owned(items),
            Self::Pose(PoseEntry::T(items)) => owned(items),
        }
    }
}

const fn default_line() -> u64 {
    10
}

#[derive(Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
enum StepEntry {
    Set(BTreeMap<String, ConstantEntry>),
    Add(BTreeMap<String, ConstantEntry>),
    Wait(BTreeMap<String, ConstantEntry>),
    WaitMs(u64),
    Move(MoveEntry),
    Error(String),
    Message(String),
}

#[derive(Deserialize)]
#[serde(untagged)]
enum ConstantEntry {
    Bool(bool),
    Number(f64),
    Text(String),
    Numbers(Vec<f64>),
}

#[derive(Deserialize)]
#[serde(untagged)]
enum MoveEntry {
    Pose(String),
    Whole(WholeMove),
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct WholeMove {
    pose: String,
    #[serde(default = "joints")]
    interpolation: i32,
    #[serde(default)]
    option: String,
}

const fn joints() -> i32 {
    1
}

impl TaskEntry {
    pub(super) fn read(self) -> Result<Program, ScenarioError> {
        let name = self.name.trim().to_owned();
        let wrong = |step: usize, problem: String| ScenarioError::Task { name: name.clone(), step, problem };
        let problem = match (name.is_empty(), self.steps.len(), self.line_ms, self.start) {
            (true, ..) => Some("a task has a name".to_owned()),
            (_, 0 | STEPS_MAX.., ..) => Some(format!("a task has 1 to {} steps", STEPS_MAX - 1)),
            (_, _, 0, _) => Some("`line_ms` is 1 or more".to_owned()),
            (.., Some(mode)) if ![1, 2].contains(&mode) => Some(format!("`start` is 1 or 2, not {mode}")),
            _ => None,
        };
        if let Some(problem) = problem {
            return Err(wrong(0, problem));
        }
        let steps = self.steps.into_iter().enumerate();
        let steps = steps.map(|(n, step)| step.read().map_err(|problem| wrong(n + 1, problem)));
        let steps = steps.collect::<Result<Vec<_>, _>>()?.into();
        let public = self.public.into_iter().map(|(variable, value)| match value.read() {
            Ok(value) => Ok((variable, value)),
            Err(_) => Err(wrong(0, format!("the value of {variable:?} is too large"))),
        });
        let public = PublicValues::new(public.collect::<Result<_, _>>()?);
        Ok(Program { steps, line: Duration::from_millis(self.line_ms), start: self.start, public, name })
    }
}

impl StepEntry {
    fn read(self) -> Result<Step, String> {
        Ok(match self {
            Self::Set(list) => Step::Set(assignments(list)?),
            Self::Wait(list) => Step::WaitFor(assignments(list)?),
            Self::Add(list) => {
                let list = assignments(list)?;
                if !list.iter().all(Assignment::is_sum) {
                    return Err("`add` adds numbers to variables I, F and D".to_owned());
                }
                Step::Add(list)
            }
            Self::WaitMs(millis) => Step::Wait(Duration::from_millis(millis)),
            Self::Move(MoveEntry::Pose(pose)) => Step::Move { interpolation: 1, pose, option: String::new() },
            Self::Move(MoveEntry::Whole(WholeMove { pose, interpolation, option })) => match interpolation {
                1..=3 => Step::Move { interpolation, pose, option },
                other => return Err(format!("`interpolation` is 1 (joints), 2 (line) or 3 (arc), not {other}")),
            },
            Self::Error(code) => match read_code(&code)? {
                code if code.is_ok() => return Err("an error is a code that begins with 8".to_owned()),
                code => Step::Error(code),
            },
            Self::Message(text) => Step::Message(text),
        })
    }
}

fn assignments(list: BTreeMap<String, ConstantEntry>) -> Result<Vec<Assignment>, String> {
    if list.is_empty() {
        return Err("a step names at least one variable".to_owned());
    }
    let read = |(name, value): (String, ConstantEntry)| {
        let unknown = || format!("{name:?} is no user variable, as I1 or IO24 is one");
        Assignment::new(&name, value.read()).ok_or_else(unknown)
    };
    list.into_iter().map(read).collect()
}

impl ConstantEntry {
    fn read(self) -> Constant {
        match self {
            Self::Bool(on) => Constant::Bool(on),
            Self::Number(number) => Constant::Number(number),
            Self::Text(text) => Constant::Text(text),
            Self::Numbers(numbers) => Constant::Numbers(numbers),
        }
    }
}
