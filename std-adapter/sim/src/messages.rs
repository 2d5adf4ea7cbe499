//! Messages: what the controller tells without being asked, for a client to fetch.
//!
//! Each error of the controller is a message to every client that is connected then. Controller_GetMessage opens the
//! oldest one that this client has not fetched, and answers `S_FALSE` without a handle when there is none. A client
//! that has connected with `@EventDisable=true` gets none. The latest 64 are kept for each; older ones are lost, which
//! the serial numbers show.
//!
//! | function                      | answer                                                      |
//! |-------------------------------|-------------------------------------------------------------|
//! | Message_GetNumber             | I4, the code of the error                                   |
//! | Message_GetValue              | I4, the same                                                |
//! | Message_GetDescription        | BSTR, its text                                              |
//! | Message_GetDateTime           | DATE, when it occurred                                      |
//! | Message_GetSerialNumber       | I4, from 1, for each client                                 |
//! | Message_GetSource, -Destination | BSTR, `@TYPE` of the controller; empty                    |
//! | Message_Reply, Message_Clear  | `S_FALSE`: no message asks for a reply; `S_OK`, it is done with |
//!
//! What a real controller sends is in no public source; that errors are among it is what the maker's own tools show.

use std::collections::{BTreeMap, VecDeque};

use bcap_core::bcap::server::Request;
use bcap_core::bcap::{FunctionId, Object};
use bcap_core::handler::PeerId;
use bcap_core::hresult::HResult;
use bcap_core::time::Instant;

use crate::controller::Controller;
use crate::dispatch::{Answer, Answered};
use crate::errors::description;
use crate::objects::{Contents, Item};
use crate::value::Value;

/// How many messages wait for one client.
const WAITING: usize = 64;

/// A message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Message {
    code: HResult,
    at: Instant,
    serial: i32,
}

/// The messages that clients have not fetched.
#[derive(Clone, Debug, Default)]
pub(crate) struct Messages {
    waiting: BTreeMap<PeerId, VecDeque<Message>>,
    /// The serial of each client's last message.
    serials: BTreeMap<PeerId, i32>,
}

impl Messages {
    /// Begins to keep messages for a client that wants them, unless it does already.
    pub(crate) fn connect(&mut self, peer: PeerId, wanted: bool) {
        if wanted {
            self.waiting.entry(peer).or_default();
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

impl Controller {
    /// Opens the oldest message that a client has not fetched.
    pub(crate) fn open_message(&mut self, peer: PeerId) -> Answered {
        let Some(message) = self.messages.waiting.get(&peer).and_then(|waiting| waiting.front().copied()) else {
            return Ok(Answer::Code(HResult::S_FALSE));
        };
        let opened = self.open_with(peer, Item::Message, String::new(), Contents::Message(message))?;
        if let Some(waiting) = self.messages.waiting.get_mut(&peer) {
            waiting.pop_front();
        }
        Ok(opened)
    }

    pub(crate) fn message_call(&self, peer: PeerId, request: &Request<'_>) -> Answered {
        let entry = self.objects.get(peer, request.handle(), Object::Message)?;
        let Contents::Message(message) = &entry.contents else { return Err(HResult::E_HANDLE) };
        Ok(match request.function {
            FunctionId::MESSAGE_GET_NUMBER | FunctionId::MESSAGE_GET_VALUE => Value::I4(message.code.0).into(),
            FunctionId::MESSAGE_GET_DESCRIPTION => Value::Text(description(message.code)).into(),
            FunctionId::MESSAGE_GET_DATE_TIME => Value::Date(self.date(message.at)?).into(),
            FunctionId::MESSAGE_GET_SERIAL_NUMBER => Value::I4(message.serial).into(),
            FunctionId::MESSAGE_GET_SOURCE => Value::from(self.config().profile.type_name()).into(),
            FunctionId::MESSAGE_GET_DESTINATION => Value::from("").into(),
            FunctionId::MESSAGE_REPLY => Answer::Code(HResult::S_FALSE),
            FunctionId::MESSAGE_CLEAR => Answer::Done,
            _ => return Err(HResult::E_NOTIMPL),
        })
    }
}
