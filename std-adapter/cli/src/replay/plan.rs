//! What a capture contains for a replay.

use std::collections::BTreeMap;
use std::time::Duration;

use crate::capture::{Call, Event};
use crate::error::Failure;
use crate::title::Title;
use crate::value::Value;

/// The protocol of a connection.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Protocol {
    Tcp,
    Udp,
    Rac,
}

/// A connection of the capture.
#[derive(Debug)]
pub(super) struct PlannedLink {
    name: String,
    pub(super) protocol: Protocol,
    pub(super) calls: Vec<PlannedCall>,
}

/// A call of the capture.
#[derive(Debug)]
pub(super) struct PlannedCall {
    pub(super) call: Call,
    /// The time since the first call of the capture.
    pub(super) offset: Duration,
    /// How many calls were answered before this one was made.
    pub(super) after: usize,
    /// Its place among the answered calls; `None` without a reply.
    pub(super) rank: Option<usize>,
}

/// The connections of a capture.
#[derive(Debug)]
pub(super) struct Plan {
    pub(super) links: Vec<PlannedLink>,
    /// The number of answered calls.
    pub(super) answered: usize,
}

impl Plan {
    /// Sorts the calls of a capture, which are in the order of their requests, into connections.
    pub(super) fn new(events: Vec<Event>) -> Result<Self, Failure> {
        let (mut links, mut calls) = (Vec::new(), Vec::new());
        for event in events {
            match event {
                Event::Link(link) => {
                    let protocol = match link.protocol {
                        "RAC" => Protocol::Rac,
                        _ if link.name.starts_with("udp") => Protocol::Udp,
                        _ => Protocol::Tcp,
                    };
                    links.push(PlannedLink { name: link.name, protocol, calls: Vec::new() });
                }
                Event::Call(call) => calls.push(call),
                Event::Note(_) => {}
            }
        }
        let Some(began) = calls.first().map(|call| call.at) else {
            return Err(Failure::Input("the capture has no call of b-CAP and no request of RAC".into()));
        };
        let mut ends: Vec<_> = calls.iter().enumerate().filter_map(|(index, call)| Some((end(call)?, index))).collect();
        ends.sort_unstable();
        let ranks: BTreeMap<_, _> = ends.iter().enumerate().map(|(rank, (_, index))| (*index, rank)).collect();
        for (index, call) in calls.into_iter().enumerate() {
            let Some(link) = links.iter_mut().find(|link| link.name == call.link) else { continue };
            let offset = Duration::from_nanos(call.at.saturating_sub(began));
            let after = ends.partition_point(|(end, _)| *end <= call.at);
            link.calls.push(PlannedCall { call, offset, after, rank: ranks.get(&index).copied() });
        }
        links.retain(|link| !link.calls.is_empty());
        Ok(Self { links, answered: ends.len() })
    }

    /// Refuses calls that may move or write and that are not allowed.
    pub(super) fn check(&self, allowed: &[Title]) -> Result<(), Failure> {
        let mut refused: BTreeMap<Title, usize> = BTreeMap::new();
        for planned in self.links.iter().flat_map(|link| &link.calls) {
            let title = Title { function: planned.call.function.clone(), command: planned.call.command.clone() };
            if !reads(&planned.call) && !allowed.iter().any(|allowed| allowed.has(&title)) {
                *refused.entry(title).or_default() += 1;
            }
        }
        let Some((first, _)) = refused.first_key_value() else { return Ok(()) };
        let list: Vec<_> = refused.iter().map(|(title, count)| format!("{title} ({count})")).collect();
        Err(Failure::Input(format!(
            "the capture has calls that may move or write: {}; nothing was sent. Allow them by name, such as \
             --allow {first}",
            list.join(", ")
        )))
    }
}

/// When the reply to a call was recorded.
fn end(call: &Call) -> Option<u64> {
    Some(call.at.saturating_add(call.reply.as_ref()?.after))
}

/// Returns whether a call neither moves nor writes: it opens, reads or releases.
fn reads(call: &Call) -> bool {
    let name = call.function.as_str();
    let is_session = ["Service_Start", "Service_Stop", "Controller_Connect", "Controller_Disconnect"].contains(&name);
    let is_read = name == "GET" || name.contains("_Get") || name.ends_with("_Release");
    // opening a file with an option may create it
    let creates =
        name.ends_with("_GetFile") && call.arguments.get(2).is_some_and(|option| !is_empty_text(option.value.as_ref()));
    is_session || (is_read && !creates)
}

fn is_empty_text(value: Option<&Value>) -> bool {
    value.and_then(|value| value.as_variant().as_bstr()).is_some_and(|text| text.to_string().is_empty())
}
