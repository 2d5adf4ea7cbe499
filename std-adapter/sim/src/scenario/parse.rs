//! Reads a scenario from TOML, and refuses invalid ones.

use std::time::Duration;

use bcap_core::time::Instant;
use serde::Deserialize;

use super::parse_setup::{PermissionName, SetupEntry, TokenName, read_code};
use super::parse_task::TaskEntry;
use super::{CallFilter, Effect, Scenario, ScenarioError, ScenarioFault, Trigger, WireFault};
use crate::comm;
use crate::config::{Config, Mode};

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct ScenarioFile {
    #[serde(default)]
    seed: u64,
    #[serde(default)]
    controller: SetupEntry,
    #[serde(default)]
    task: Vec<TaskEntry>,
    #[serde(default)]
    fault: Vec<FaultEntry>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct FaultEntry {
    when: WhenEntry,
    then: ThenEntry,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct WhenEntry {
    call: Option<u64>,
    to: Option<u64>,
    every: Option<u64>,
    chance: Option<f64>,
    cycle: Option<u64>,
    at_ms: Option<u64>,
    of: Option<String>,
}

#[derive(Deserialize)]
#[serde(rename_all = "snake_case")]
enum ThenEntry {
    Refuse(String),
    DelayMs(u64),
    Drop,
    WrongSerial,
    Corrupt,
    Disconnect,
    Error(String),
    EmergencyStop(bool),
    LinkLossMs(u64),
    Mode(Mode),
    Token(TokenName),
    Permission(PermissionName),
    Motor(bool),
    Message(String),
    Comm(CommEntry),
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct CommEntry {
    line: i32,
    text: String,
}

impl Scenario {
    /// Checks a scenario against a controller: an arm of four axes has no extended axes, and a model without StoState has no
    /// safe torque off.
    ///
    /// # Errors
    ///
    /// A [`ScenarioError`]. [`Controller::play`](crate::Controller::play) ignores `axes` and `torque_off` then.
    pub fn check(&self, config: &Config) -> Result<(), ScenarioError> {
        if self.controller.extended_axes.is_some() && config.geometry.joints() != 6 {
            return Err(ScenarioError::Controller("`axes` is for an arm of six joints; this arm has four"));
        }
        if self.controller.torque_off && !config.model.functions.safe_torque_off {
            return Err(ScenarioError::Controller(
                "`torque_off` is for a model that has StoState; this model lacks it",
            ));
        }
        Ok(())
    }

    /// Reads a scenario from TOML.
    ///
    /// # Errors
    ///
    /// A [`ScenarioError`] that says where the text is wrong.
    pub fn parse(text: &str) -> Result<Self, ScenarioError> {
        let file: ScenarioFile = toml::from_str(text)?;
        let faults = file
            .fault
            .into_iter()
            .enumerate()
            .map(|(n, entry)| entry.read().map_err(|problem| ScenarioError::Fault { number: n + 1, problem }));
        let controller = file.controller.read().map_err(ScenarioError::Controller)?;
        let tasks = file.task.into_iter().map(TaskEntry::read).collect::<Result<_, _>>()?;
        Ok(Self { seed: file.seed, controller, tasks, faults: faults.collect::<Result<_, _>>()? })
    }
}

impl FaultEntry {
    fn read(self) -> Result<ScenarioFault, &'static str> {
        let (when, then) = (self.when.read()?, self.then.read()?);
        let of_calls = matches!(then, Effect::Refuse(_) | Effect::Delay(_) | Effect::Wire(_));
        if of_calls && !matches!(when, Trigger::Call { .. }) {
            return Err("what concerns the answer of a call needs `when` to be call, every or chance");
        }
        Ok(ScenarioFault { when, then })
    }
}

impl WhenEntry {
    fn read(self) -> Result<Trigger, &'static str> {
        if self.to.is_some() && self.call.is_none() {
            return Err("`to` is the end of a range that `call` begins");
        }
        let filter = match (self.call, self.every, self.chance, self.cycle, self.at_ms) {
            (Some(call), None, None, None, None) => CallFilter::Range(call, self.to.unwrap_or(call)),
            (None, Some(every), None, None, None) => CallFilter::Every(every),
            (None, None, Some(chance), None, None) => CallFilter::Chance(chance),
            (None, None, None, Some(_), None) | (None, None, None, None, Some(_)) if self.of.is_some() => {
                return Err("`of` says what calls are counted; it goes with call, every or chance");
            }
            (None, None, None, Some(0), None) => return Err("cycles are counted from 1"),
            (None, None, None, Some(cycle), None) => return Ok(Trigger::Cycle(cycle)),
            (None, None, None, None, Some(at)) => {
                return Ok(Trigger::At(Instant::ZERO.saturating_add(Duration::from_millis(at))));
            }
            _ => return Err("`when` needs exactly one of call, every, chance, cycle and at_ms"),
        };
        match filter {
            CallFilter::Range(from, to) if from == 0 || to < from => {
                Err("calls are counted from 1, and `to` is not before")
            }
            CallFilter::Every(0) => Err("`every` is 1 or more"),
            CallFilter::Chance(p) if !(0.0..=1.0).contains(&p) => Err("`chance` is 0 to 1"),
            filter => Ok(Trigger::Call { filter, of: self.of }),
        }
    }
}

impl ThenEntry {
    fn read(self) -> Result<Effect, &'static str> {
        Ok(match self {
            Self::Refuse(code) => Effect::Refuse(read_code(&code)?),
            Self::Error(code) => match read_code(&code)? {
                code if code.is_ok() => return Err("an error is a code that begins with 8"),
                code => Effect::Error(code),
            },
            Self::DelayMs(millis) => Effect::Delay(Duration::from_millis(millis)),
            Self::Drop => Effect::Wire(WireFault::Drop),
            Self::WrongSerial => Effect::Wire(WireFault::WrongSerial),
            Self::Corrupt => Effect::Wire(WireFault::Corrupt),
            Self::Disconnect => Effect::Wire(WireFault::Disconnect),
            Self::EmergencyStop(pressed) => Effect::EmergencyStop(pressed),
            Self::LinkLossMs(0) => Effect::LinkLoss(None),
            Self::Mode(mode) => Effect::Mode(mode),
            Self::Token(token) => Effect::Token(token.into()),
            Self::Permission(permission) => Effect::Permission(permission.into()),
            Self::Motor(on) => Effect::Motor(on),
            Self::Message(text) => Effect::Message(text),
            Self::Comm(CommEntry { line, text }) if comm::LINES.contains(&line) => Effect::Comm { line, text },
            Self::Comm(_) => return Err("`line` is 1 to 16"),
            Self::LinkLossMs(millis) => Effect::LinkLoss(Some(Duration::from_millis(millis))),
        })
    }
}
