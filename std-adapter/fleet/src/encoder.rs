//! The interface of a format: readings and states become messages, and messages of a host become commands.

use std::collections::VecDeque;
use std::sync::atomic::AtomicU64;

use crate::command::{Answer, Command};
use crate::config::Config;
use crate::message::Message;
use crate::queue::State;
use crate::reading::Reading;

/// A format of messages.
pub(crate) trait Encoder: Send {
    /// Returns whether births and deaths say which values are valid. Otherwise the retained state of the node does, and a
    /// reading can be sent at any time.
    fn has_births(&self) -> bool;

    /// Returns the will of the next connection; `None` if the state of the node is the will.
    fn will(&mut self, _: &Config) -> Option<Message> {
        None
    }

    /// Returns the message that announces the end of the node; `None` if the state of the node does that.
    fn death(&self, _: &Config) -> Option<Message> {
        None
    }

    /// Returns the topics of commands; `are_on` is whether a rule allows any command.
    fn topics(&self, config: &Config, are_on: bool) -> Vec<String>;

    /// Adds the messages that a host needs after a new connection.
    fn introduce(&mut self, outbox: &mut Outbox<'_>);

    /// Adds messages with all latest values.
    fn repeat(&mut self, outbox: &mut Outbox<'_>);

    /// Adds messages for the state of a controller, which `outbox` has already.
    fn state(&mut self, outbox: &mut Outbox<'_>, state: &State);

    /// Adds messages for a new reading. Returns an unsent earlier reading that it replaces.
    fn reading(&mut self, outbox: &mut Outbox<'_>, reading: Reading) -> Option<Reading>;

    /// Returns whether a new reading would be in the last message.
    fn joins(&self, _: &Outbox<'_>, _: &Reading) -> bool {
        false
    }

    /// Adds messages for a reading of the backlog; `has_more` is whether a reading of the same controller follows.
    fn historical(&mut self, outbox: &mut Outbox<'_>, reading: Reading, has_more: bool);

    /// Drops the values of a session that ends. Returns the unsent values, as historical readings.
    fn take_unsent(&mut self, _: usize, _: &mut CellCache) -> Vec<Reading> {
        Vec::new()
    }

    /// Decodes a message. Its commands expire `longest` ms after they were sent if they do not say when.
    fn decode(&self, config: &Config, topic: &str, payload: &[u8], longest: u64) -> Decoded;

    /// Returns how far the clock of a host may be ahead, in milliseconds.
    fn lead(&self) -> u64 {
        0
    }

    /// Returns the answer to a command, if the format has answers.
    fn answer(&self, _: &Config, _: usize, _: &Answer<'_>) -> Option<Message> {
        None
    }

    /// Returns the number that joins births and deaths, for the next process of this node.
    fn bd_seq(&self) -> Option<u8> {
        None
    }

    /// Continues the numbers of another process of this node.
    fn follow(&mut self, _: u8) {}

    /// Returns the topic of the node's death, if that is not the topic of its state.
    fn death_topic(&self, _: &Config) -> Option<String> {
        None
    }

    /// Returns whether a payload is the death of the birth whose number was followed last.
    fn is_death(&self, _: &[u8]) -> bool {
        false
    }
}

/// The known state of a controller.
#[derive(Debug)]
pub(crate) struct CellCache {
    pub(crate) state: Option<State>,
    /// The latest reading of each point.
    pub(crate) latest: Vec<Option<Reading>>,
}

impl CellCache {
    pub(crate) fn new(points: usize) -> Self {
        Self { state: None, latest: vec![None; points] }
    }

    pub(crate) fn is_connected(&self) -> bool {
        self.state.as_ref().is_some_and(|state| state.down.is_none())
    }
}

/// The messages of a connection that the link has not taken, and the values that they are made of.
pub(crate) struct Outbox<'a> {
    pub(crate) config: &'a Config,
    pub(crate) cells: &'a mut [CellCache],
    pub(crate) messages: &'a mut VecDeque<Message>,
    /// The id of the next reading.
    pub(crate) next_id: &'a AtomicU64,
}

impl Outbox<'_> {
    pub(crate) fn push(&mut self, message: Message) {
        self.messages.push_back(message);
    }
}

/// A message of a host, decoded.
#[derive(Debug, PartialEq)]
pub(crate) enum Decoded {
    /// It is for another node, or has no request.
    Nothing,
    /// It requests all values.
    Repeat,
    /// Commands for a controller.
    Commands(usize, Vec<Command>),
    /// A message for a controller that is not a command, the id that it has, and why.
    Invalid(usize, String, String),
}
