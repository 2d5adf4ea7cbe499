//! Reads the state of a controller in rounds.

use std::mem;
use std::time::{Duration, Instant};

use bcap_core::bcap::FunctionId;
use bcap_core::variant::OwnedVariant;
use bcap_std::{ObjectPath, TaskStatus};

use crate::calls::{Calls, Failure, needs_reconnect, unless_refused};
use crate::errors;
use crate::messages::next_message;
use crate::model::{Robot, Update};
use crate::stream::StreamCheck;
use crate::variables::{list, short_type, shown, state_words, value};

/// The interval at which tasks, messages, the tool, the work and the speed are read.
pub const SLOW: Duration = Duration::from_secs(1);

/// The tasks whose states are read.
const TASKS: usize = 64;

/// The maximum number of messages that are read in a row, so that a controller cannot send new messages indefinitely.
pub const MESSAGES: usize = 100;

/// Takes the results of a round, and acts between its calls.
pub trait Rounds<C: Calls> {
    /// Takes a result.
    fn tell(&mut self, update: Update);

    /// Called before each call, so that a user's order over a slow line does not wait for the end of the round.
    ///
    /// # Errors
    ///
    /// The loss of the session, which ends the round.
    fn poll(&mut self, calls: &mut C) -> Result<(), C::Error> {
        let _ = calls;
        Ok(())
    }
}

impl<C: Calls, F: FnMut(Update)> Rounds<C> for F {
    fn tell(&mut self, update: Update) {
        self(update);
    }
}

/// The reads of a session.
#[derive(Debug)]
pub struct Reader {
    variables: Vec<ObjectPath>,
    /// `None` until their names are read.
    tasks: Option<Vec<String>>,
    kind: Option<String>,
    /// Whether the controller has messages.
    messages: bool,
    /// Whether the messages were skipped the last time.
    skipped_messages: bool,
    /// Whether the list of errors is read again: there was an error, it was not empty, or reading it was skipped.
    had_error: bool,
    stream: StreamCheck,
    slow: Instant,
    selection: Selection,
}

/// The selected tool and work coordinates, and the speed.
#[derive(Clone, Debug, Default)]
struct Selection {
    tool: Option<String>,
    work: Option<String>,
    speed: Option<String>,
}

impl Reader {
    /// Determines what to read over a new session.
    ///
    /// # Errors
    ///
    /// An invalid name, or the loss of the session.
    pub fn start<C: Calls>(calls: &mut C, names: &[String]) -> Result<Self, C::Error> {
        let mut stream = StreamCheck::default();
        let kind = unless_refused(value(calls, &mut stream, &ObjectPath::variable("@TYPE")?))?;
        let mut reader = Self {
            variables: Vec::new(),
            tasks: None,
            kind: kind.map(|kind| short_type(&shown(&kind))),
            messages: true,
            skipped_messages: false,
            stream,
            had_error: true,
            slow: Instant::now(),
            selection: Selection::default(),
        };
        reader.variables = paths::<C>(names)?;
        Ok(reader)
    }

    /// Reads other variables from now on.
    ///
    /// # Errors
    ///
    /// An invalid name.
    pub fn select<C: Calls>(&mut self, names: &[String]) -> Result<(), C::Error> {
        self.variables = paths::<C>(names)?;
        Ok(())
    }
}

fn paths<C: Calls>(names: &[String]) -> Result<Vec<ObjectPath>, C::Error> {
    names.iter().map(|name| Ok(ObjectPath::variable(name)?)).collect()
}

/// Reads everything once.
///
/// # Errors
///
/// The loss of the session: it must be opened again.
pub fn round<C: Calls>(reader: &mut Reader, calls: &mut C, rounds: &mut impl Rounds<C>) -> Result<(), C::Error> {
    Round { reader, calls, rounds }.read()
}

/// A round.
struct Round<'a, C, R> {
    reader: &'a mut Reader,
    calls: &'a mut C,
    rounds: &'a mut R,
}

impl<C: Calls, R: Rounds<C>> Round<'_, C, R> {
    fn read(&mut self) -> Result<(), C::Error> {
        for n in 0..self.reader.variables.len() {
            self.poll()?;
            let Some(path) = self.reader.variables.get(n) else { break };
            let read = value(self.calls, &mut self.reader.stream, path);
            let read = read.map(Ok).or_else(|failure| match failure.code() {
                _ if needs_reconnect(&failure) => Err(failure),
                Some(code) => Ok(Err(code.to_string())),
                None => Ok(Err(failure.to_string())),
            });
            self.rounds.tell(Update::Value(n, read?));
        }
        let is_slow = Instant::now() >= self.reader.slow;
        if is_slow {
            self.reader.slow = Instant::now() + SLOW;
            self.reader.selection = Selection {
                tool: self.text("robot/@CURRENT_TOOL")?,
                work: self.text("robot/@CURRENT_WORK")?,
                speed: self.text("robot/@EXTSPEED")?,
            };
        }
        let Selection { tool, work, speed } = self.reader.selection.clone();
        let joints = self.numbers("robot/@CURRENT_ANGLE")?;
        let position = self.numbers("robot/@CURRENT_POSITION")?;
        self.rounds.tell(Update::Robot(Robot { joints, position, tool, work, speed }));
        self.state()?;
        if is_slow {
            self.tasks()?;
            self.messages()?;
        }
        Ok(())
    }

    /// Reads the words of the state: `RC8 auto ok motor moving`; and the errors, if there are any.
    fn state(&mut self) -> Result<(), C::Error> {
        let (mode, code) = (self.text("@MODE")?, self.text("@ERROR_CODE")?);
        let has_error = code.as_ref().is_some_and(|code| code != "0");
        let mut words = state_words(self.reader.kind.clone(), mode, code.as_deref());
        for (name, word) in [("robot/@SERVO_ON", "motor"), ("robot/@BUSY_STATUS", "moving")] {
            if self.text(name)?.as_deref() == Some("true") {
                words.push(word.into());
            }
        }
        self.rounds.tell(Update::State(words, has_error));
        if has_error || self.reader.had_error {
            self.poll()?;
            let errors = match errors::present(self.calls, &mut self.reader.stream) {
                Err(failure) if needs_reconnect(&failure) => return Err(failure),
                errors => errors,
            };
            // an error may appear and vanish between two reads; a refused read is not repeated, because each refusal may be an
            // entry in the controller's log
            self.reader.had_error =
                has_error || errors.as_ref().map_or_else(Failure::is_skipped, |list| !list.is_empty());
            self.rounds.tell(Update::Errors(errors.map_err(|failure| failure.to_string())));
        }
        Ok(())
    }

    /// Reads the names of the tasks once, and their states.
    fn tasks(&mut self) -> Result<(), C::Error> {
        let mut tasks = Vec::new();
        if self.reader.tasks.is_none() {
            let function = FunctionId::CONTROLLER_GET_TASK_NAMES;
            if let Some(why) = self.reader.stream.skip(self.calls, function, None)? {
                self.rounds.tell(Update::Tasks(vec![(why, String::new())]));
                return Ok(());
            }
            let names = unless_refused(list(self.calls, &ObjectPath::controller(), function))?;
            let mut names = names.unwrap_or_default();
            names.truncate(TASKS);
            self.reader.tasks = Some(names);
        }
        for name in self.reader.tasks.clone().unwrap_or_default() {
            self.poll()?;
            self.calls.restart_limit();
            let skipped = self.reader.stream.skip(self.calls, FunctionId::TASK_EXECUTE, Some("GetStatus"))?;
            let status = if skipped.is_some() {
                "skipped: a stream of Slave Mode runs".into()
            } else {
                unless_refused(self.calls.task_status(&name))?.map_or_else(|| "unknown".into(), status_text)
            };
            tasks.push((name, status));
        }
        self.rounds.tell(Update::Tasks(tasks));
        Ok(())
    }

    fn messages(&mut self) -> Result<(), C::Error> {
        let mut left = MESSAGES;
        while self.reader.messages && left > 0 {
            left -= 1;
            self.poll()?;
            self.calls.restart_limit();
            let message = next_message(self.calls, &mut self.reader.stream);
            let is_skipped = message.as_ref().is_err_and(Failure::is_skipped);
            let was_skipped = mem::replace(&mut self.reader.skipped_messages, is_skipped);
            match message {
                Ok(Some(message)) => self.rounds.tell(Update::Message(message.short())),
                Ok(None) => return Ok(()),
                Err(failure) if is_skipped => {
                    if !was_skipped {
                        self.rounds.tell(Update::Message(failure.to_string()));
                    }
                    return Ok(());
                }
                Err(failure) if needs_reconnect(&failure) => return Err(failure),
                Err(_) => self.reader.messages = false,
            }
        }
        Ok(())
    }

    fn poll(&mut self) -> Result<(), C::Error> {
        self.rounds.poll(self.calls)
    }

    /// Reads a variable; `None` if the controller does not have it.
    fn known(&mut self, name: &str) -> Result<Option<OwnedVariant>, C::Error> {
        self.poll()?;
        unless_refused(value(self.calls, &mut self.reader.stream, &ObjectPath::variable(name)?))
    }

    fn text(&mut self, name: &str) -> Result<Option<String>, C::Error> {
        Ok(self.known(name)?.as_ref().map(shown))
    }

    /// Reads an array of numbers; empty if the controller does not have it.
    fn numbers(&mut self, name: &str) -> Result<Vec<f64>, C::Error> {
        let value = self.known(name)?.unwrap_or_default();
        let array = value.as_variant().as_array();
        Ok(array.map(|array| array.iter().filter_map(|number| number.as_f64()).collect()).unwrap_or_default())
    }
}

/// Returns the name of a status.
#[must_use]
pub fn status_text(status: TaskStatus) -> String {
    match status {
        TaskStatus::None => "none".into(),
        TaskStatus::Suspended => "suspended".into(),
        TaskStatus::Ready => "ready".into(),
        TaskStatus::Running => "running".into(),
        TaskStatus::StoppedAtStep => "stopped at a step".into(),
        other => format!("{other:?}"),
    }
}

#[cfg(test)]
mod tests {
    use std::collections::VecDeque;

    use bcap_core::bcap::{Object, StreamState};
    use bcap_core::hresult::HResult;

    use super::*;
    use crate::link::Error;

    const FAULT: HResult = HResult::E_SLVMODE_OFF;

    /// A controller without an error, except one that another client causes and clears between two calls.
    struct Fake {
        /// The answers to `GetCurErrorCount`.
        counts: VecDeque<i32>,
        /// Whether the error is cleared before it is read.
        is_cleared: bool,
        /// The number of messages.
        messages: usize,
    }

    impl Calls for Fake {
        type Error = Error;

        fn object(&mut self, _: &ObjectPath) -> Result<i32, Error> {
            Ok(1)
        }

        fn call(
            &mut self,
            subject: &str,
            function: FunctionId,
            _: &[OwnedVariant],
        ) -> Result<(HResult, Option<OwnedVariant>), Error> {
            let value = match subject {
                "GetCurErrorCount" => OwnedVariant::new(&self.counts.pop_front().expect("the list is read again"))?,
                "GetCurErrorInfo" if self.is_cleared => {
                    let (object, code) = (subject.to_owned(), HResult::DISP_E_BADINDEX);
                    return Err(bcap_std::Error::Refused { function, object, code }.into());
                }
                "GetCurErrorInfo" => OwnedVariant::new(&(FAULT.0, "stream"))?,
                StreamState::COMMAND => OwnedVariant::new(&0)?,
                _ if function == FunctionId::CONTROLLER_GET_TASK_NAMES => OwnedVariant::default(),
                _ if function == FunctionId::CONTROLLER_GET_MESSAGE && self.messages > 0 => {
                    self.messages -= 1;
                    OwnedVariant::new(&7)?
                }
                _ => OwnedVariant::new("0")?,
            };
            Ok((HResult::S_OK, Some(value)))
        }

        fn release(&mut self, _: Object, _: i32) -> Result<(), Error> {
            Ok(())
        }

        fn task_status(&mut self, _: &str) -> Result<TaskStatus, Error> {
            Ok(TaskStatus::Ready)
        }
    }

    /// Returns the lists of errors of three rounds.
    fn lists(counts: &[i32], is_cleared: bool) -> Vec<Result<Vec<HResult>, String>> {
        let mut fake = Fake { counts: counts.iter().copied().collect(), is_cleared, messages: 0 };
        let (mut reader, mut lists) = (Reader::start(&mut fake, &[]).unwrap(), Vec::new());
        reader.messages = false;
        for _ in 0..3 {
            let mut tell = |update| {
                if let Update::Errors(errors) = update {
                    lists.push(errors.map(|list| list.into_iter().map(|(code, _)| code).collect()));
                }
            };
            round(&mut reader, &mut fake, &mut tell).unwrap();
        }
        assert!(fake.counts.is_empty(), "the list was not read again");
        lists
    }

    #[test]
    fn a_round_ends_although_there_are_more_messages() {
        let mut fake = Fake { counts: VecDeque::from([0]), is_cleared: false, messages: 2 * MESSAGES };
        let (mut reader, mut count) = (Reader::start(&mut fake, &[]).unwrap(), 0);
        let mut tell = |update| count += usize::from(matches!(update, Update::Message(_)));
        round(&mut reader, &mut fake, &mut tell).unwrap();
        assert_eq!((count, fake.messages), (MESSAGES, MESSAGES));
    }

    #[test]
    fn an_error_that_another_client_clears_does_not_stay_on_the_screen() {
        assert_eq!(lists(&[0], false), [Ok(vec![])]);
        assert_eq!(lists(&[1, 0], false), [Ok(vec![FAULT]), Ok(vec![])]);
        assert_eq!(lists(&[1, 0], true), [Ok(vec![])]);
        let refused = lists(&[1, 1], true);
        assert!(matches!(refused.as_slice(), [Err(why)] if why.contains("0x8002000b")), "{refused:?}");
    }
}
