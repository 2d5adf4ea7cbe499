//! A survey of a controller's answers to some 100 calls that only read, and its report.

pub mod report;

use std::thread;
use std::time::{Duration, Instant};

use bcap_capture::times::Times;
use bcap_core::bcap::{FunctionId, Object};
use bcap_core::hresult::HResult;
use bcap_core::variant::OwnedVariant;
use bcap_std::ObjectPath;

use crate::calls::{Calls, Failure};
use crate::stream::StreamCheck;

/// A line for each call: `OBJECT CALL [NUMBER]`.
const CALLS: &str = include_str!("survey/calls.txt");

/// The size of a survey.
#[derive(Clone, Copy, Debug)]
pub struct Limits {
    /// The number of times that each call is made.
    pub rounds: u32,
    /// The maximum time for all calls together.
    pub within: Duration,
    /// The time between two calls.
    pub pause: Duration,
}

/// An answer to a call.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Answer {
    /// The layout of the value, such as `R8[8]`.
    Value(String),
    /// The controller refused the call.
    Refused(HResult),
    /// The call was not made, for this reason.
    Skipped(String),
}

/// A call with its answer.
#[derive(Debug)]
#[non_exhaustive]
pub struct Row {
    /// The object and the call, as in the list.
    pub name: String,
    /// The first answer. Later answers may differ, because the controller's state changes.
    pub answer: Answer,
    /// The layouts of later answers that differ from the first.
    pub others: Vec<String>,
    /// The first value.
    pub value: Option<OwnedVariant>,
    /// The round trips.
    pub times: Times,
    /// The number of times that the call was made.
    pub count: u32,
}

impl Row {
    fn new(name: &str) -> Self {
        let answer = Answer::Skipped("not asked".into());
        Self { name: name.into(), answer, others: Vec::new(), value: None, times: Times::new(), count: 0 }
    }

    fn add(&mut self, answer: Answer, value: Option<OwnedVariant>, time: Duration) {
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

    /// Returns whether the call is made again in the next round.
    fn is_open(&self) -> bool {
        !matches!(self.answer, Answer::Refused(_))
    }
}

/// The answers of a controller.
#[derive(Debug)]
#[non_exhaustive]
pub struct Survey {
    /// The calls, in the order in which they are made.
    pub rows: Vec<Row>,
    /// The reason if not all calls were made in all rounds.
    pub ended: Option<String>,
}

impl Default for Survey {
    /// Returns the calls without answers.
    fn default() -> Self {
        let rows = CALLS.lines().filter(|line| !line.is_empty() && !line.starts_with('#')).map(Row::new).collect();
        Self { rows, ended: None }
    }
}

impl Survey {
    /// Makes the calls in rounds; while a stream of Slave Mode runs, those that could end it are skipped. A controller keeps a refusal
    /// as an error that stops the commands of other clients, so the first such refusal ends the survey.
    ///
    /// # Errors
    ///
    /// The loss of the session. The answers until then remain.
    pub fn run<C: Calls>(&mut self, session: &mut C, limits: Limits) -> Result<(), C::Error> {
        let result = self.rounds(session, limits);
        if let Err(failure) = &result {
            self.ended = Some(failure.to_string());
        }
        result
    }

    fn rounds<C: Calls>(&mut self, session: &mut C, limits: Limits) -> Result<(), C::Error> {
        let (began, mut check) = (Instant::now(), StreamCheck::default());
        for round in 0..limits.rounds {
            for index in 0..self.rows.len() {
                if began.elapsed() >= limits.within {
                    self.ended = Some(format!("the time was over in round {}", round + 1));
                    return Ok(());
                }
                let row = &mut self.rows[index];
                if !row.is_open() {
                    continue;
                }
                let call = Call::parse(&row.name).map_err(C::Error::invalid)?;
                if let Some(why) = call.skip(session, &mut check)? {
                    if row.count == 0 {
                        row.answer = Answer::Skipped(why);
                    }
                    continue;
                }
                session.restart_limit();
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
    pub fn value(&self, name: &str) -> Option<String> {
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
    fn parse(line: &str) -> Result<Self, String> {
        let invalid = || format!("calls.txt: {line:?} is invalid");
        let path = |text: &str| text.parse::<ObjectPath>().map_err(|_| invalid());
        let variable = |text: &str| ObjectPath::variable(text).map_err(|_| invalid());
        let words: Vec<&str> = line.split_whitespace().collect();
        Ok(match words.as_slice() {
            ["unknown", name] => Self::Open(if name.starts_with('@') { variable(name)? } else { path(name)? }),
            ["variable", name] => Self::Read(variable(name)?),
            ["names", owner, function] => Self::Names(path(owner)?, FunctionId::parse(function).ok_or_else(invalid)?),
            [owner, command, number @ ..] => Self::Execute {
                path: path(owner)?,
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
    fn skip<C: Calls>(&self, session: &mut C, check: &mut StreamCheck) -> Result<Option<String>, C::Error> {
        let (function, command) = self.function();
        check.skip(session, function, command)
    }

    /// Makes the call; returns the answer, the value and the time of the round trip.
    fn make<C: Calls>(&self, session: &mut C) -> Result<(Answer, Option<OwnedVariant>, Duration), C::Error> {
        let (function, command) = self.function();
        let (Self::Open(path) | Self::Read(path) | Self::Names(path, _) | Self::Execute { path, .. }) = self;
        let began = Instant::now();
        // an object stays open for the next round
        let handle = match answered(session.object(path))? {
            Ok(handle) => handle,
            Err(code) => return Ok((Answer::Refused(code), None, began.elapsed())),
        };
        if matches!(self, Self::Open(_)) {
            return Ok((Answer::Value("an object".into()), None, began.elapsed()));
        }
        let mut arguments = vec![OwnedVariant::new(&handle)?];
        match self {
            Self::Names(..) => arguments.push(OwnedVariant::new("")?),
            Self::Execute { number, .. } => {
                arguments.push(OwnedVariant::new(command.unwrap_or_default())?);
                arguments
                    .push(number.map_or_else(|| Ok(OwnedVariant::default()), |number| OwnedVariant::new(&number))?);
            }
            Self::Open(_) | Self::Read(_) => {}
        }
        let began = Instant::now();
        let answer = answered(session.call("", function, &arguments))?;
        let took = began.elapsed();
        Ok(match answer {
            Ok((_, value)) => {
                let value = value.unwrap_or_default();
                (Answer::Value(value.as_variant().shape().to_string()), Some(value), took)
            }
            Err(code) => (Answer::Refused(code), None, took),
        })
    }
}

/// Returns the reply or the code of a refusal; fails for other errors.
fn answered<T, F: Failure>(reply: Result<T, F>) -> Result<Result<T, HResult>, F> {
    match reply {
        Ok(reply) => Ok(Ok(reply)),
        Err(failure) => failure.code().filter(|_| !failure.is_lost()).map(Err).ok_or(failure),
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
