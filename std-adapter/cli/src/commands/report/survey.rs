//! The calls of a report, and how a controller answers them.

use std::thread;
use std::time::{Duration, Instant};

use bcap_capture::times::Times;
use bcap_core::bcap::{FunctionId, Object};
use bcap_core::hresult::HResult;
use bcap_std::ObjectPath;

use crate::failure::Failure;
use crate::session::Session;
use crate::session::slave_mode::StreamCheck;
use crate::values::{Value, integer, text};

/// A line for each call: `OBJECT CALL [NUMBER]`.
const CALLS: &str = include_str!("calls.txt");

/// The size of a survey.
#[derive(Clone, Copy)]
pub(super) struct Limits {
    pub(super) rounds: u32,
    pub(super) within: Duration,
    pub(super) pause: Duration,
}

/// An answer to a call.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Answer {
    /// The layout of the value, such as `R8[8]`.
    Value(String),
    Refused(HResult),
    /// The call was not made, for this reason.
    Skipped(String),
}

/// A call with its answer.
pub(super) struct Row {
    /// The object and the call, as in the list.
    pub(super) name: String,
    /// The first answer. Later ones may differ, because the controller works meanwhile.
    pub(super) answer: Answer,
    /// The layouts of later answers that differ from the first.
    pub(super) others: Vec<String>,
    /// The first value.
    pub(super) value: Option<Value>,
    /// The round trips.
    pub(super) times: Times,
    /// How often the call was made.
    pub(super) count: u32,
}

impl Row {
    fn new(name: &str) -> Self {
        let answer = Answer::Skipped("not asked".into());
        Self { name: name.into(), answer, others: Vec::new(), value: None, times: Times::new(), count: 0 }
    }

    fn add(&mut self, answer: Answer, value: Option<Value>, time: Duration) {
        self.times.record(u64::try_from(time.as_micros()).unwrap_or(u64::MAX));
        self.count += 1;
        if self.count == 1 {
            (self.answer, self.value) = (answer, value);
            return;
        }
        let other = match answer {
            Answer::Value(layout) => layout,
            Answer::Refused(code) => code.to_string(),
            Answer::Skipped(_) => return,
        };
        let first = matches!(&self.answer, Answer::Value(first) if *first == other);
        if !first && !self.others.contains(&other) {
            self.others.push(other);
        }
    }

    /// Tells whether the call is made again in the next round.
    fn is_open(&self) -> bool {
        !matches!(self.answer, Answer::Refused(_))
    }
}

/// The answers of a controller.
pub(super) struct Survey {
    pub(super) rows: Vec<Row>,
    /// Why not all calls were made in all rounds.
    pub(super) ended: Option<String>,
}

impl Survey {
    /// Makes the calls in rounds. A failure is returned with the answers until then.
    pub(super) fn run(session: &mut Session, limits: Limits) -> Result<(Self, Result<(), Failure>), Failure> {
        session.connect()?;
        session.controller()?;
        let rows = CALLS.lines().filter(|line| !line.is_empty() && !line.starts_with('#')).map(Row::new).collect();
        let mut survey = Self { rows, ended: None };
        let result = survey.rounds(session, limits);
        if let Err(failure) = &result {
            survey.ended = Some(failure.to_string());
        }
        Ok((survey, result))
    }

    fn rounds(&mut self, session: &mut Session, limits: Limits) -> Result<(), Failure> {
        let (began, mut check) = (Instant::now(), StreamCheck::default());
        for round in 0..limits.rounds {
            for index in 0..self.rows.len() {
                if began.elapsed() >= limits.within {
                    self.ended = Some(format!("the time of --within was over in round {}", round + 1));
                    return Ok(());
                }
                let row = &mut self.rows[index];
                if !row.is_open() {
                    continue;
                }
                let call = Call::parse(&row.name)?;
                if let Some(why) = call.skip(session, &mut check)? {
                    if row.count == 0 {
                        row.answer = Answer::Skipped(why);
                    }
                    continue;
                }
                session.restart_budget();
                let (answer, value, time) = call.make(session)?;
                let stays = matches!(answer, Answer::Refused(code) if code.level().is_some_and(|level| level > 0));
                row.add(answer, value, time);
                if stays {
                    self.ended = Some(format!(
                        "the controller refused `{}` and may keep that as an error: look with `bcap errors`",
                        self.rows[index].name
                    ));
                    return Ok(());
                }
                thread::sleep(limits.pause);
            }
        }
        Ok(())
    }

    /// Returns the value of a call, as text.
    pub(super) fn value(&self, name: &str) -> Option<String> {
        let row = self.rows.iter().find(|row| row.name == name)?;
        row.value.as_ref().map(|value| bcap_capture::value::data::format(value.as_variant()))
    }
}

/// A call of the list.
enum Call {
    /// Opens an object and releases it; an object that does not exist is refused.
    Open(ObjectPath),
    Read(ObjectPath),
    Names(ObjectPath, FunctionId),
    Execute {
        path: ObjectPath,
        command: String,
        number: Option<i32>,
    },
}

impl Call {
    fn parse(line: &str) -> Result<Self, Failure> {
        let invalid = || Failure::Input(format!("calls.txt: {line:?} is invalid"));
        let words: Vec<&str> = line.split_whitespace().collect();
        Ok(match words.as_slice() {
            ["unknown", path] => {
                Self::Open(if path.starts_with('@') { ObjectPath::variable(path)? } else { path.parse()? })
            }
            ["variable", path] => Self::Read(ObjectPath::variable(path)?),
            ["names", owner, function] => Self::Names(owner.parse()?, FunctionId::parse(function).ok_or_else(invalid)?),
            [path, command, number @ ..] => Self::Execute {
                path: path.parse()?,
                command: (*command).to_owned(),
                number: number.first().map(|number| number.parse().map_err(|_| invalid())).transpose()?,
            },
            _ => return Err(invalid()),
        })
    }

    /// Returns the function and the command that the call executes.
    fn function(&self) -> (FunctionId, Option<&str>) {
        match self {
            Self::Open(path) if path.object() == Object::Task => (FunctionId::CONTROLLER_GET_TASK, None),
            Self::Open(_) => (FunctionId::CONTROLLER_GET_VARIABLE, None),
            Self::Read(_) => (FunctionId::VARIABLE_GET_VALUE, None),
            Self::Names(_, function) => (*function, None),
            Self::Execute { path, command, .. } if path.object() == Object::Robot => {
                (FunctionId::ROBOT_EXECUTE, Some(command))
            }
            Self::Execute { command, .. } => (FunctionId::CONTROLLER_EXECUTE, Some(command)),
        }
    }

    /// Returns why the call must not be made now; `None` if it may.
    fn skip(&self, session: &mut Session, check: &mut StreamCheck) -> Result<Option<String>, Failure> {
        let (function, command) = self.function();
        check.skip(session, function, command)
    }

    /// Makes the call; returns the answer, the value and the time of the round trip.
    fn make(&self, session: &mut Session) -> Result<(Answer, Option<Value>, Duration), Failure> {
        let (function, command) = self.function();
        let (Self::Open(path) | Self::Read(path) | Self::Names(path, _) | Self::Execute { path, .. }) = self;
        let began = Instant::now();
        // an object stays open for the next round
        let handle = match session.object(path) {
            Ok(handle) => handle,
            Err(Failure::Refused { code, .. }) => return Ok((Answer::Refused(code), None, began.elapsed())),
            Err(failure) => return Err(failure),
        };
        if matches!(self, Self::Open(_)) {
            return Ok((Answer::Value("an object".into()), None, began.elapsed()));
        }
        let mut arguments = vec![integer(handle)?];
        match self {
            Self::Names(..) => arguments.push(text("")?),
            Self::Execute { number, .. } => {
                arguments.push(text(command.unwrap_or_default())?);
                arguments.push(number.map_or_else(|| Ok(Value::default()), integer)?);
            }
            Self::Open(_) | Self::Read(_) => {}
        }
        let began = Instant::now();
        let (code, value) = session.call_for_code(function, &arguments)?;
        let took = began.elapsed();
        if code.is_err() {
            return Ok((Answer::Refused(code), None, took));
        }
        let value = value.unwrap_or_default();
        Ok((Answer::Value(value.as_variant().shape().to_string()), Some(value), took))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn all_calls_only_read() {
        for line in CALLS.lines().filter(|line| !line.is_empty() && !line.starts_with('#')) {
            let call = Call::parse(line).unwrap();
            let (function, command) = call.function();
            assert!(function.properties(command, None).effect.is_harmless(), "{line}");
        }
    }
}
