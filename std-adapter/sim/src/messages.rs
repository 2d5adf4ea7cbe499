//! Messages: reports that the controller makes without a request, for a client to fetch.
//!
//! Each error of the controller is a message to every client that is connected then, and so is each text that a task or
//! a scenario posts. Controller_GetMessage opens the oldest message that this client has not fetched, and answers
//! `S_FALSE` without a handle if it has fetched all. A client that has connected with `@EventDisable=true` gets no
//! messages. The controller keeps the latest 64 for each client; a gap in the serial numbers shows that older ones are
//! lost.
//!
//! | function                      | an error                             | a text                                 |
//! |-------------------------------|--------------------------------------|----------------------------------------|
//! | Message_GetNumber             | I4, the code                         | I4, 0                                  |
//! | Message_GetValue              | I4, the same                         | BSTR, the text                         |
//! | Message_GetDescription        | BSTR, its description                | BSTR, the text                         |
//! | Message_GetDateTime           | DATE, when it occurred               | DATE, when it was posted               |
//! | Message_GetSerialNumber       | I4, from 1, for each client          | likewise                               |
//! | Message_GetSource             | BSTR, the task, or `@TYPE`           | likewise                               |
//! | Message_GetDestination        | BSTR, empty                          | likewise                               |
//! | Message_Reply                 | `S_FALSE`: no message needs a reply  | likewise                               |
//! | Message_Clear                 | `S_OK`                               | likewise                               |
//!
//! A real controller sends errors and changes of state (RC8 provider guide, table 3-1); the guide has no numbers of messages.

use std::collections::{BTreeMap, VecDeque};

use bcap_core::bcap::FunctionId;
use bcap_core::handler::PeerId;
use bcap_core::hresult::HResult;
use bcap_core::time::Instant;

use crate::answer::{Answer, Answered};
use crate::config::Config;
use crate::errors::description;

/// The largest number of messages that the controller keeps for a client.
const WAITING: usize = 64;

/// A message.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Message {
    content: Content,
    /// The task; empty for the controller itself.
    source: String,
    at: Instant,
    serial: i32,
}

#[derive(Clone, Debug, PartialEq, Eq)]
enum Content {
    Error(HResult),
    Text(String),
}

/// The messages that the clients have not fetched.
#[derive(Clone, Debug, Default)]
pub(crate) struct Messages {
    waiting: BTreeMap<PeerId, VecDeque<Message>>,
    /// The serial number of each client's last message.
    serials: BTreeMap<PeerId, i32>,
}

impl Messages {
    /// Starts to keep messages for a client that wants them.
    pub(crate) fn connect(&mut self, peer: PeerId, wanted: bool) {
        if wanted {
            self.waiting.entry(peer).or_default();
        }
    }

    /// Returns the oldest message that a client has not fetched.
    pub(crate) fn oldest(&self, peer: PeerId) -> Option<Message> {
        self.waiting.get(&peer)?.front().cloned()
    }

    /// Drops the oldest message of a client, which has fetched it.
    pub(crate) fn fetched(&mut self, peer: PeerId) {
        if let Some(waiting) = self.waiting.get_mut(&peer) {
            waiting.pop_front();
        }
    }

    pub(crate) fn forget(&mut self, peer: PeerId) {
        self.waiting.remove(&peer);
        self.serials.remove(&peer);
    }

    /// Posts an error; `source` is the task in which it occurred.
    pub(crate) fn post_error(&mut self, code: HResult, source: &str, at: Instant) {
        self.post(&Content::Error(code), source, at);
    }

    /// Posts a text.
    pub(crate) fn post_text(&mut self, text: &str, source: &str, at: Instant) {
        self.post(&Content::Text(text.to_owned()), source, at);
    }

    fn post(&mut self, content: &Content, source: &str, at: Instant) {
        for (peer, waiting) in &mut self.waiting {
            let serial = self.serials.entry(*peer).or_insert(0);
            *serial = serial.checked_add(1).unwrap_or(1);
            if waiting.len() >= WAITING {
                waiting.pop_front();
            }
            waiting.push_back(Message { content: content.clone(), source: source.to_owned(), at, serial: *serial });
        }
    }
}

impl Message {
    /// Describes it.
    pub(crate) fn help(&self) -> &'static str {
        match self.content {
            Content::Error(_) => "An error of the controller.",
            Content::Text(_) => "A text of a task or of the controller.",
        }
    }

    /// Executes a function of the message object.
    pub(crate) fn call(&self, config: &Config, function: FunctionId) -> Answered {
        match (function, &self.content) {
            (FunctionId::MESSAGE_GET_NUMBER | FunctionId::MESSAGE_GET_VALUE, Content::Error(code)) => {
                Answer::of(code.0)
            }
            (FunctionId::MESSAGE_GET_NUMBER, Content::Text(_)) => Answer::of(0),
            (FunctionId::MESSAGE_GET_DESCRIPTION, Content::Error(code)) => Answer::of(description(*code)),
            (FunctionId::MESSAGE_GET_VALUE | FunctionId::MESSAGE_GET_DESCRIPTION, Content::Text(text)) => {
                Answer::of(text)
            }
            (FunctionId::MESSAGE_GET_DATE_TIME, _) => Answer::of(config.date(self.at)?),
            (FunctionId::MESSAGE_GET_SERIAL_NUMBER, _) => Answer::of(self.serial),
            (FunctionId::MESSAGE_GET_SOURCE, _) if !self.source.is_empty() => Answer::of(&self.source),
            (FunctionId::MESSAGE_GET_SOURCE, _) => Answer::of(&config.model.name),
            (FunctionId::MESSAGE_GET_DESTINATION, _) => Answer::of(""),
            (FunctionId::MESSAGE_REPLY, _) => Ok(Answer::Code(HResult::S_FALSE)),
            (FunctionId::MESSAGE_CLEAR, _) => Ok(Answer::Done),
            _ => Err(HResult::E_NOTIMPL),
        }
    }
}
