//! Messages: what the controller sends without a request, for a client to fetch.
//!
//! Each error of the controller is a message to every client that is connected then. Controller_GetMessage opens the
//! oldest message that this client has not fetched, and answers `S_FALSE` without a handle if it has fetched all. A client
//! that has connected with `@EventDisable=true` gets no messages. The controller keeps the latest 64 for each client; a
//! gap in the serial numbers shows that older ones are lost.
//!
//! | function                      | answer                                                      |
//! |-------------------------------|-------------------------------------------------------------|
//! | Message_GetNumber             | I4, the code of the error                                   |
//! | Message_GetValue              | I4, the same                                                |
//! | Message_GetDescription        | BSTR, its text                                              |
//! | Message_GetDateTime           | DATE, when it occurred                                      |
//! | Message_GetSerialNumber       | I4, from 1, for each client                                 |
//! | Message_GetSource, -Destination | BSTR, `@TYPE` of the controller; empty                    |
//! | Message_Reply, Message_Clear  | `S_FALSE`: no message asks for a reply; `S_OK`              |
//!
//! No public source says which messages a real controller sends. The maker's own tools show that errors are among them.

use std::collections::{BTreeMap, VecDeque};

use bcap_core::bcap::FunctionId;
use bcap_core::handler::PeerId;
use bcap_core::hresult::HResult;
use bcap_core::time::Instant;

use crate::answer::{Answer, Answered};
use crate::config::Config;
use crate::errors::description;
use crate::value::Value;

/// The largest number of messages that the controller keeps for a client.
const WAITING: usize = 64;

/// A message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Message {
    code: HResult,
    at: Instant,
    serial: i32,
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
        self.waiting.get(&peer)?.front().copied()
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

    pub(crate) fn post(&mut self, code: HResult, at: Instant) {
        for (peer, waiting) in &mut self.waiting {
            let serial = self.serials.entry(*peer).or_insert(0);
            *serial = serial.checked_add(1).unwrap_or(1);
            if waiting.len() >= WAITING {
                waiting.pop_front();
            }
            waiting.push_back(Message { code, at, serial: *serial });
        }
    }
}

impl Message {
    /// Executes a function of the message object.
    pub(crate) fn call(&self, config: &Config, function: FunctionId) -> Answered {
        Ok(match function {
            FunctionId::MESSAGE_GET_NUMBER | FunctionId::MESSAGE_GET_VALUE => Value::I4(self.code.0).into(),
            FunctionId::MESSAGE_GET_DESCRIPTION => Value::Text(description(self.code)).into(),
            FunctionId::MESSAGE_GET_DATE_TIME => Value::Date(config.date(self.at)?).into(),
            FunctionId::MESSAGE_GET_SERIAL_NUMBER => Value::I4(self.serial).into(),
            FunctionId::MESSAGE_GET_SOURCE => Value::from(config.profile.type_name()).into(),
            FunctionId::MESSAGE_GET_DESTINATION => Value::from("").into(),
            FunctionId::MESSAGE_REPLY => Answer::Code(HResult::S_FALSE),
            FunctionId::MESSAGE_CLEAR => Answer::Done,
            _ => return Err(HResult::E_NOTIMPL),
        })
    }
}
