//! A server that answers as the server of a capture did.
//!
//! Each connection of a client replays the next connection of the capture that contains its first request: a capture may begin
//! in the middle of a connection. A request gets the reply of the next call of its connection with the same function and
//! arguments; after the last call the search restarts at the first. Handles are the recorded ones.

use std::collections::HashMap;
use std::fmt;
use std::path::Path;

use bcap_core::bcap::FunctionId;
use bcap_core::bcap::server::{Handler, Request};
use bcap_core::handler::{Outcome, PeerId, ReplyValue};
use bcap_core::hresult::HResult;
use bcap_core::limits::Strictness;
use bcap_core::rac;
use bcap_core::time::Instant;

use crate::decode::{self, Call, Event, Reply};
use crate::error::Error;
use bcap_core::variant::OwnedVariant as Value;

/// The answered calls of the connections of one protocol, and the connection of each peer.
#[derive(Debug, Default)]
struct Links {
    calls: Vec<Vec<Call>>,
    /// The connection of each peer, and the position after its last answer.
    peers: HashMap<PeerId, (usize, usize)>,
    /// The connection that the next peer gets.
    next: usize,
}

/// A server that plays a capture back.
pub struct Playback {
    bcap: Links,
    rac: Links,
    unknown: Box<dyn FnMut(&str) + Send>,
}

impl fmt::Debug for Playback {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Playback").field("bcap", &self.bcap).field("rac", &self.rac).finish_non_exhaustive()
    }
}

impl Playback {
    /// Reads a capture. `unknown` gets each request that the capture does not have; such a request is refused with E_FAIL. It
    /// also gets the reason if the end of the file cannot be read, such as after a recording whose program was killed.
    ///
    /// # Errors
    ///
    /// When the file cannot be read, or has no connection of b-CAP or RAC.
    pub fn read(file: &Path, unknown: impl FnMut(&str) + Send + 'static) -> Result<Self, Error> {
        let (events, read) = decode::events(file, Strictness::Lenient);
        let mut indices: HashMap<String, (bool, usize)> = HashMap::new();
        let mut playback = Self { bcap: Links::default(), rac: Links::default(), unknown: Box::new(unknown) };
        for event in events {
            match event {
                Event::Link(link) => {
                    let is_rac = link.protocol == "RAC";
                    let links = playback.links(is_rac);
                    indices.insert(link.name, (is_rac, links.calls.len()));
                    links.calls.push(Vec::new());
                }
                Event::Call(call) if call.reply.is_some() => {
                    let Some((is_rac, index)) = indices.get(&call.link).copied() else { continue };
                    playback.links(is_rac).calls.get_mut(index).into_iter().for_each(|calls| calls.push(call.clone()));
                }
                Event::Call(_) | Event::Note(_) => {}
            }
        }
        if indices.is_empty() {
            read?;
            return Err(Error::invalid(file, "no call of b-CAP and no request of RAC"));
        }
        if let Err(error) = read {
            (playback.unknown)(&format!("the rest of {error}"));
        }
        Ok(playback)
    }

    /// Returns the provider, the machine and the option of the first session of b-CAP, with which a client can open it again.
    #[must_use]
    pub fn session(&self) -> Option<[String; 3]> {
        let opens = |call: &&Call| {
            call.function == FunctionId::CONTROLLER_CONNECT.to_string()
                && call.reply.as_ref().is_some_and(|reply| reply.code.is_ok())
        };
        let call = self.bcap.calls.iter().flatten().find(opens)?;
        let text = |i: usize| Some(call.arguments.get(i)?.value.as_ref()?.as_variant().as_bstr()?.to_string());
        Some([text(1)?, text(2)?, text(3)?])
    }

    const fn links(&mut self, is_rac: bool) -> &mut Links {
        if is_rac { &mut self.rac } else { &mut self.bcap }
    }
}

impl Links {
    /// Returns the reply to the next call of a peer for which `is_same` returns true.
    fn next(&mut self, peer: PeerId, is_same: impl Fn(&Call) -> bool) -> Option<&Reply> {
        let connections = self.calls.len();
        let (link, at) = self.peers.entry(peer).or_insert_with(|| {
            let mut links = (self.next..connections).chain(0..self.next.min(connections));
            let has = |link: &usize| self.calls.get(*link).is_some_and(|calls| calls.iter().any(&is_same));
            let link = links.clone().find(has).or_else(|| links.next()).unwrap_or(0);
            self.next = link + 1;
            (link, 0)
        });
        let calls = self.calls.get(*link)?;
        let later = calls.iter().enumerate().skip(*at);
        let (found, call) = later.chain(calls.iter().enumerate()).find(|(_, call)| is_same(call))?;
        *at = found + 1;
        call.reply.as_ref()
    }
}

/// Sets the value of a recorded reply.
fn answer(found: &Reply, reply: &mut ReplyValue<'_>) -> Outcome {
    match found.value.as_ref().map(|value| reply.set(value)) {
        Some(Err(_)) => HResult::E_UNEXPECTED.into(),
        Some(Ok(())) | None => found.code.into(),
    }
}

fn is_same_value(recorded: Option<&Value>, value: &Value) -> bool {
    recorded.is_some_and(|recorded| recorded.as_bytes() == value.as_bytes())
}

impl Handler for Playback {
    fn call(&mut self, peer: PeerId, request: &Request<'_>, reply: &mut ReplyValue<'_>, _: Instant) -> Outcome {
        let function = request.function.to_string();
        let values: Vec<_> = request.args.iter().filter_map(|value| Value::new(&value).ok()).collect();
        let is_same = |call: &Call| {
            let arguments = call.arguments.iter().zip(&values);
            call.function == function
                && call.arguments.len() == values.len()
                && arguments.into_iter().all(|(recorded, value)| is_same_value(recorded.value.as_ref(), value))
        };
        match self.bcap.next(peer, is_same) {
            Some(found) => answer(found, reply),
            // the server itself releases the objects that a client leaves
            None if request.function.releases().is_some() => HResult::S_OK.into(),
            None => {
                let values: Vec<_> = values.iter().map(|value| format!("{:?}", value.as_variant())).collect();
                (self.unknown)(&format!("{function}({})", values.join(", ")));
                HResult::E_FAIL.into()
            }
        }
    }

    fn left(&mut self, peer: PeerId, _: Instant) {
        self.bcap.peers.remove(&peer);
    }
}

impl rac::server::Handler for Playback {
    fn call(&mut self, peer: PeerId, request: &rac::Request<'_>, reply: &mut ReplyValue<'_>, _: Instant) -> Outcome {
        let (verb, variable) = match request {
            rac::Request::Get(variable) => ("GET", variable),
            rac::Request::Put(variable, _) => ("PUT", variable),
        };
        let name = format!("{}{}", variable.kind, variable.index);
        let value = request.value().and_then(|value| Value::new(&value).ok());
        let is_same = |call: &Call| {
            let object = call.arguments.first().and_then(|argument| argument.object.as_deref());
            let recorded = call.arguments.get(1).and_then(|argument| argument.value.as_ref());
            call.function == verb
                && object == Some(&*name)
                && value.as_ref().is_none_or(|value| is_same_value(recorded, value))
        };
        match self.rac.next(peer, is_same) {
            Some(found) => answer(found, reply),
            None => {
                (self.unknown)(&format!("{verb}({name})"));
                HResult::E_FAIL.into()
            }
        }
    }

    fn left(&mut self, peer: PeerId, _: Instant) {
        self.rac.peers.remove(&peer);
    }
}
