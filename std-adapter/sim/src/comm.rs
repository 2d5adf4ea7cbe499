//! The extension `Comm`: lines of data communication, on which other devices send texts to the controller.
//!
//! | Extension_Execute of `Comm` | parameter | answer                                                            |
//! |-----------------------------|-----------|-------------------------------------------------------------------|
//! | open                        | I4 line   | EMPTY; opens the line, which may be open already                  |
//! | State                       | I4 line   | I4: 2 open, 0 closed                                              |
//! | count                       | I4 line   | I4: the bytes of the texts that have arrived; 0 on a closed line  |
//! | input                       | I4 line   | BSTR: the oldest of these texts; `E_TIMEOUT` without one          |
//! | clear                       | I4 line   | EMPTY; drops these texts                                          |
//! | close                       | I4 line   | EMPTY; drops these texts                                          |
//!
//! The commands, and the state 2 of an open line, come from the public sample `CommCommand.py`. Lines 1 to 16, the
//! state 0, the unit of count, and all of input and clear on a closed line, which answer `E_NOT_CONNECTED`, are
//! decisions. A line belongs to the controller, not to the client that opened it, and stays open when the client
//! disconnects: the maker's RC8 manual (ID 370) says that a line stays open when the task that opened it ends.
//!
//! The texts come from a [scenario](crate::scenario). Devices send no texts over a closed line.

use std::collections::{BTreeMap, VecDeque};

use bcap_core::hresult::HResult;
use bcap_core::variant::Variant;

use crate::answer::{Answer, Answered};
use crate::table::Command;
use crate::value::one_int;

/// The name of the extension.
pub(crate) const NAME: &str = "Comm";

/// The numbers of the lines.
pub(crate) const LINES: std::ops::RangeInclusive<i32> = 1..=16;

/// The maximum number of bytes that wait on a line; further texts are lost.
const CAPACITY: usize = 64 << 10;

const OPEN: i32 = 2;
const CLOSED: i32 = 0;

type CommHandler = fn(&mut Comm, i32) -> Answered;

const fn command(name: &'static str, run: CommHandler) -> Command<CommHandler> {
    Command::new(name, run).accepts("one number: the line, 1 to 16")
}

/// The commands of Extension_Execute.
pub(crate) const COMMANDS: &[Command<CommHandler>] = &[
    command("open", |comm, line| {
        comm.open.entry(line).or_default();
        Ok(Answer::Done)
    }),
    command("State", |comm, line| Answer::of(if comm.open.contains_key(&line) { OPEN } else { CLOSED })),
    command("count", |comm, line| {
        let bytes = comm.open.get(&line).map_or(0, waiting);
        Answer::of(i32::try_from(bytes).unwrap_or(i32::MAX))
    }),
    command("input", |comm, line| {
        let text = comm.opened(line)?.pop_front().ok_or(HResult::E_TIMEOUT)?;
        Answer::of(text)
    }),
    command("clear", |comm, line| {
        comm.opened(line)?.clear();
        Ok(Answer::Done)
    }),
    command("close", |comm, line| {
        comm.open.remove(&line);
        Ok(Answer::Done)
    }),
];

/// The lines.
#[derive(Clone, Debug, Default)]
pub(crate) struct Comm {
    /// The texts that have arrived on each open line, the oldest first.
    open: BTreeMap<i32, VecDeque<String>>,
}

impl Comm {
    /// Executes a command with its parameter.
    pub(crate) fn execute(&mut self, run: CommHandler, param: &Variant<'_>) -> Answered {
        let line = one_int(param)?;
        if !LINES.contains(&line) {
            return Err(HResult::E_INVALIDARG);
        }
        run(self, line)
    }

    /// Receives a text from the device of a line.
    pub(crate) fn receive(&mut self, line: i32, text: &str) {
        if let Some(texts) = self.open.get_mut(&line)
            && waiting(texts) + text.len() <= CAPACITY
        {
            texts.push_back(text.to_owned());
        }
    }

    /// # Errors
    ///
    /// `E_NOT_CONNECTED` for a closed line.
    fn opened(&mut self, line: i32) -> Result<&mut VecDeque<String>, HResult> {
        self.open.get_mut(&line).ok_or(HResult::E_NOT_CONNECTED)
    }
}

/// Returns the bytes of the texts.
fn waiting(texts: &VecDeque<String>) -> usize {
    texts.iter().map(String::len).sum()
}
