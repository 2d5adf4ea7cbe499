//! Commands from the broker: to write a variable. They are off unless a rule allows them, and never start a motion or
//! switch a motor.
//!
//! ```json
//! {"id":"7c1f","name":"I10","value":5,"expires":1790000000000,"origin":"mes"}
//! ```
//!
//! The checks, in this order: the message is new (not retained) and valid; it has not expired, and does not expire later than
//! `longest_seconds` from now, for Sparkplug plus the [`lead`](CommandCheck::lead); its id is new; the rate; the rules.
//!
//! A command is executed at most once. A copy that arrives before the expiry has a known id, and a copy that arrives later
//! has expired. A copy of a command that an earlier process has executed expires before the start of this one and
//! `longest_seconds` and the lead; all such commands are refused. This needs a clock that is not set back.

use std::collections::HashMap;
use std::time::Duration;

use bcap_core::bcap::FunctionId;
use bcap_core::rac::{Request, Variable, VariableKind};
use bcap_core::variant::OwnedVariant;
use bcap_gateway::{Allow, Rules};
use bcap_std::asynch::Controller;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use tokio::time::{Instant, timeout_at};

use crate::config;
use crate::event::CommandResult;
use crate::reading::now_ms;
use crate::stream::{ReadError, StreamCheck};

/// The maximum size of a correlation id in bytes.
const LONGEST_ID: usize = 128;

/// A command to write a variable.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Command {
    /// The correlation id.
    pub(crate) id: String,
    /// The variable.
    pub(crate) name: String,
    pub(crate) value: Value,
    /// Milliseconds since 1970.
    pub(crate) expires: u64,
    /// The sender, as claimed in the command.
    pub(crate) origin: Option<String>,
}

/// The answer to a command.
#[derive(Serialize)]
pub(crate) struct Answer<'a> {
    pub(crate) id: &'a str,
    pub(crate) result: CommandResult,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) reason: Option<&'a str>,
}

/// A checked command.
#[derive(Clone, Debug)]
pub(crate) struct Job {
    pub(crate) name: String,
    pub(crate) value: OwnedVariant,
    pub(crate) deadline: Instant,
    /// The expiry in milliseconds since 1970.
    pub(crate) expires: u64,
}

/// A command that has ended.
pub(crate) struct Finished {
    pub(crate) cell: usize,
    pub(crate) topic: String,
    pub(crate) command: Command,
    pub(crate) result: CommandResult,
    pub(crate) reason: Option<String>,
}

/// The rules, and the executed commands.
#[derive(Debug)]
pub(crate) struct CommandCheck {
    config: config::Commands,
    /// Maximum time that the clock of a sender may be ahead of this clock, in milliseconds. A Sparkplug host sends no expiry:
    /// its commands expire `longest_seconds` after the sender's time.
    lead: u64,
    /// The last time at which another process can have accepted a command, in milliseconds since 1970.
    began: u64,
    /// The expiry of each command that was accepted, by controller and id.
    accepted: HashMap<(usize, String), u64>,
    /// The tokens of each controller, and when they were counted, in milliseconds since 1970.
    tokens: HashMap<usize, (f64, u64)>,
}

/// The result of a command that is not sent, and the reason.
pub(crate) type Unsent = (CommandResult, String);

pub(crate) const fn refused(reason: String) -> Unsent {
    (CommandResult::Refused, reason)
}

impl CommandCheck {
    pub(crate) fn new(config: config::Commands, lead: u64, began: u64) -> Self {
        Self { config, lead, began, accepted: HashMap::new(), tokens: HashMap::new() }
    }

    /// Refuses the commands that another process may have accepted until a time.
    pub(crate) const fn begin(&mut self, began: u64) {
        self.began = began;
    }

    /// Returns whether a rule allows any command.
    pub(crate) const fn are_on(&self) -> bool {
        !self.config.allow.is_empty()
    }

    /// Returns the longest time until an expiry, in milliseconds.
    pub(crate) fn longest(&self) -> u64 {
        u64::from(self.config.longest_seconds) * 1000
    }

    /// Checks a command; the error says why it is not sent. `at` was taken before `now`.
    pub(crate) fn check(&mut self, cell: usize, command: &Command, at: Instant, now: u64) -> Result<Job, Unsent> {
        let Command { id, name, value, expires, .. } = command;
        self.check_copy(cell, id, now)?;
        if id.is_empty() || id.len() > LONGEST_ID {
            return Err(refused(format!("the id has {} bytes; expected 1 to {LONGEST_ID}", id.len())));
        }
        if *expires <= now {
            return Err(refused(format!("it expired {} ms ago", now - expires)));
        }
        let longest = self.longest() + self.lead;
        if *expires > now + longest {
            return Err(refused(format!("it expires in {} ms; the longest time is {longest} ms", expires - now)));
        }
        if *expires <= self.began + longest {
            let reason =
                "this node has just started or taken over, and another process may have executed it; send a new one";
            return Err((CommandResult::Unknown, reason.into()));
        }
        self.take_token(cell, now).map_err(refused)?;
        let value = self.permitted(name, value).map_err(refused)?;
        self.accepted.insert((cell, id.clone()), *expires);
        let deadline = at + Duration::from_millis(expires - now);
        Ok(Job { name: canonical(name), value, deadline, expires: *expires })
    }

    /// Refuses the copy of a command that was accepted. Its first copy may be running, so this is not an answer to the command.
    pub(crate) fn check_copy(&mut self, cell: usize, id: &str, now: u64) -> Result<(), Unsent> {
        self.accepted.retain(|_, expires| *expires > now);
        if self.accepted.contains_key(&(cell, id.to_owned())) {
            let reason = "this id was accepted before; a command is executed at most once";
            return Err((CommandResult::Repeated, reason.into()));
        }
        Ok(())
    }

    /// Takes a token from a controller's bucket. The bucket holds the tokens of one second.
    fn take_token(&mut self, cell: usize, now: u64) -> Result<(), String> {
        let most = f64::from(self.config.per_second);
        let (tokens, counted) = self.tokens.entry(cell).or_insert((most, now));
        *tokens = (*tokens + most * now.saturating_sub(*counted) as f64 / 1000.0).min(most);
        *counted = now;
        if *tokens < 1.0 {
            return Err(format!("more commands than {} a second", self.config.per_second));
        }
        *tokens -= 1.0;
        Ok(())
    }

    /// Converts the value to the type of the variable, and checks both against the rules.
    fn permitted(&self, name: &str, value: &Value) -> Result<OwnedVariant, String> {
        let variable: Variable =
            name.parse().map_err(|_| format!("{name:?} is no user variable, such as I1 or IO128"))?;
        let value = typed(variable.kind, value)
            .ok_or_else(|| format!("the value is not of the type of a variable of kind {}", variable.kind))?;
        let put: Vec<Allow<'_>> = self.config.allow.iter().map(|rule| rule.0.as_allow()).collect();
        let rules = Rules { put: &put, ..Rules::READ_ONLY };
        rules.permits(&Request::Put(variable, value.as_variant()), None).map_err(|refusal| refusal.to_string())?;
        Ok(value)
    }
}

/// Returns the name of a user variable as the controller has it, so that `I01` and `I1` are one variable.
pub(crate) fn canonical(name: &str) -> String {
    name.parse().map_or_else(|_| name.to_owned(), |Variable { kind, index }| format!("{kind}{index}"))
}

/// Converts JSON to the value of a variable of this kind, without loss of more than the digits of a float.
fn typed(kind: VariableKind, value: &Value) -> Option<OwnedVariant> {
    let float = |value: &Value| value.as_f64().map(|n| n as f32).filter(|n| n.is_finite());
    let value = match kind {
        VariableKind::I => OwnedVariant::new(&i32::try_from(value.as_i64()?).ok()?),
        VariableKind::F => OwnedVariant::new(&float(value)?),
        VariableKind::D => OwnedVariant::new(&value.as_f64()?),
        VariableKind::S => OwnedVariant::new(value.as_str()?),
        VariableKind::Io => OwnedVariant::new(&value.as_bool()?),
        VariableKind::V | VariableKind::P | VariableKind::J | VariableKind::T => {
            let numbers: Vec<f32> = value.as_array()?.iter().map(float).collect::<Option<_>>()?;
            OwnedVariant::new(&numbers)
        }
    };
    value.ok().filter(|value| kind.fits(&value.as_variant()))
}

/// Executes a command.
pub(crate) async fn execute(controller: Controller, job: Job) -> (CommandResult, Option<String>) {
    // a read opens the variable. The write is then one call, and a task that is busy until the deadline does not begin it.
    match timeout_at(job.deadline, controller.read::<OwnedVariant>(&job.name)).await {
        Ok(Ok(_)) => {}
        Ok(Err(error)) => return (CommandResult::Failed, Some(error.to_string())),
        Err(_) => return (CommandResult::Refused, Some("it expired before it could be sent".into())),
    }
    let stream = StreamCheck::default();
    match timeout_at(job.deadline, stream.require(&controller, FunctionId::VARIABLE_PUT_VALUE, None)).await {
        Ok(Ok(())) => {}
        Ok(Err(ReadError::Skipped(why))) => return (CommandResult::Refused, Some(why)),
        Ok(Err(error)) => return (CommandResult::Failed, Some(error.to_string())),
        Err(_) => return (CommandResult::Refused, Some("it expired before it could be sent".into())),
    }
    // a process or machine that was stopped in between must not write late; a suspended machine may stop one of the clocks
    if Instant::now() >= job.deadline || now_ms() >= job.expires {
        return (CommandResult::Refused, Some("it expired before it could be sent".into()));
    }
    match timeout_at(job.deadline, controller.write(&job.name, job.value)).await {
        Ok(Ok(())) => (CommandResult::Done, None),
        Ok(Err(error)) if error.may_have_run() => (CommandResult::Unknown, Some(error.to_string())),
        Ok(Err(error)) => (CommandResult::Failed, Some(error.to_string())),
        Err(_) => (CommandResult::Unknown, Some("it expired while it was executed".into())),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    const BEGAN: u64 = 1_000_000;

    fn commands(rules: &[&str], per_second: u32) -> CommandCheck {
        let allow = rules.iter().map(|rule| config::Rule::try_from((*rule).to_owned()).unwrap()).collect();
        CommandCheck::new(config::Commands { allow, per_second, longest_seconds: 10 }, 1000, BEGAN)
    }

    fn command(id: &str, name: &str, value: Value, expires: u64) -> Command {
        Command { id: id.into(), name: name.into(), value, expires, origin: None }
    }

    #[test]
    fn a_command_is_accepted_once_and_in_time() {
        let mut commands = commands(&["I/0-9=-10..10"], 1000);
        let now = BEGAN + 20_000;
        let mut check = |id: &str, expires, at| {
            commands
                .check(0, &command(id, "I1", json!(1), expires), Instant::now(), at)
                .map(|job| job.value)
                .map_err(|(_, reason)| reason.split(';').next().unwrap().to_owned())
        };
        let one = OwnedVariant::new(&1_i32).unwrap();
        assert_eq!(check("a", now + 5000, now), Ok(one.clone()));
        assert_eq!(check("a", now + 5000, now + 1), Err("this id was accepted before".into()));
        assert_eq!(check("a", now + 5000, now + 5000), Err("it expired 0 ms ago".into()));
        assert_eq!(check("b", now + 11_001, now), Err("it expires in 11001 ms".into()));
        assert_eq!(check("b", now + 10_005, now), Ok(one.clone()), "a clock that is 5 ms ahead");
        assert_eq!(check("b", now + 10_005, now + 10_004), Err("this id was accepted before".into()));
        assert_eq!(check("", now + 1, now), Err("the id has 0 bytes".into()));
        assert_eq!(check("a", now + 15_000, now + 10_005), Ok(one), "the id is free again after its expiry");
    }

    #[test]
    fn the_job_has_the_canonical_name() {
        let mut commands = commands(&["I", "IO"], 1000);
        let now = BEGAN + 20_000;
        let mut name = |id: &str, name: &str, value| {
            commands.check(0, &command(id, name, value, now + 5000), Instant::now(), now).map(|job| job.name)
        };
        assert_eq!(name("a", "I007", json!(1)), Ok("I7".into()));
        assert_eq!(name("b", "IO0128", json!(true)), Ok("IO128".into()));
        assert_eq!(canonical("@SPEED"), "@SPEED", "what is no variable stays as it is");
    }

    #[test]
    fn a_command_that_an_earlier_process_may_have_executed_is_refused() {
        let mut commands = commands(&["I"], 1000);
        // an earlier process accepts this just before it ends
        let old = command("a", "I1", json!(1), BEGAN + 11_000);
        for now in [BEGAN, BEGAN + 10_999] {
            let (result, reason) = commands.check(0, &old, Instant::now(), now).unwrap_err();
            assert_eq!(result, CommandResult::Unknown);
            assert!(reason.starts_with("this node has just started"), "{reason}");
        }
        assert!(commands.check(0, &command("b", "I1", json!(1), BEGAN + 11_001), Instant::now(), BEGAN + 1).is_ok());
    }

    #[test]
    fn the_rules_of_the_gateway_apply() {
        let mut commands = commands(&["I/0-9=-10..10", "F", "IO/128", "P"], 1000);
        let now = BEGAN + 20_000;
        let mut number = 0;
        let mut check = |name: &str, value: Value| {
            number += 1;
            commands
                .check(0, &command(&number.to_string(), name, value, now + 5000), Instant::now(), now)
                .map(|job| job.value)
                .map_err(|(_, reason)| reason)
        };
        assert!(check("I9", json!(-10)).is_ok());
        assert_eq!(check("I9", json!(11)).unwrap_err(), "the value is out of the range that the rules allow");
        assert_eq!(check("I10", json!(1)).unwrap_err(), "no rule allows this variable");
        assert_eq!(check("D1", json!(1.0)).unwrap_err(), "no rule allows this kind of variable");
        assert_eq!(check("I1", json!(1.5)).unwrap_err(), "the value is not of the type of a variable of kind I");
        assert_eq!(check("IO128", json!(1)).unwrap_err(), "the value is not of the type of a variable of kind IO");
        assert_eq!(check("F1", json!(1)), Ok(OwnedVariant::new(&1.0_f32).unwrap()));
        assert!(check("P1", json!([1, 2, 3, 4, 5, 6, -1])).is_ok() && check("P1", json!([1, 2])).is_err());
        for name in ["@SPEED", "robot/@SERVO_ON", "I-1", "I", "I+1"] {
            assert!(check(name, json!(1)).unwrap_err().contains("no user variable"), "{name}");
        }
    }

    #[test]
    fn the_rate_is_limited_for_each_controller() {
        let mut commands = commands(&["I"], 2);
        let now = BEGAN + 20_000;
        let mut check = |cell, id: &str, at| {
            commands.check(cell, &command(id, "I1", json!(1), at + 5000), Instant::now(), at).is_ok()
        };
        assert_eq!(
            [check(0, "a", now), check(0, "b", now), check(0, "c", now), check(1, "a", now)],
            [true, true, false, true]
        );
        assert_eq!([check(0, "d", now + 500), check(0, "e", now + 500)], [true, false]);
    }
}
