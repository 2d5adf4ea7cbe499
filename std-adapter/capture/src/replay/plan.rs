//! The calls of a capture, sorted for a replay.

use std::collections::{BTreeMap, HashMap};
use std::time::Duration;

use bcap_core::bcap::FunctionId;

use crate::call_name::CallName;
use crate::decode::{Call, Event, Link};
use crate::error::Error;

/// The maximum number of connections of a replay: each has a thread and a socket.
const LINKS: usize = 1024;

/// The kind of a connection: b-CAP over TCP or UDP, or RAC.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum LinkKind {
    Tcp,
    Udp,
    Rac,
}

impl LinkKind {
    fn of(link: &Link) -> Self {
        match link.protocol {
            "RAC" => Self::Rac,
            _ if link.name.starts_with("udp") => Self::Udp,
            _ => Self::Tcp,
        }
    }
}

/// A connection of the capture.
#[derive(Debug)]
pub(super) struct PlannedLink {
    pub(super) kind: LinkKind,
    pub(super) calls: Vec<PlannedCall>,
}

/// A call of the capture.
#[derive(Debug)]
pub(super) struct PlannedCall {
    pub(super) call: Call,
    /// The time since the first call of the capture.
    pub(super) offset: Duration,
    /// The number of calls that were answered before this call was made.
    pub(super) after: usize,
    /// Its rank among the answered calls, by the time of their replies; `None` without a reply.
    pub(super) rank: Option<usize>,
}

/// The connections of a capture.
#[derive(Debug)]
pub struct Plan {
    pub(super) links: Vec<PlannedLink>,
    /// The number of answered calls.
    pub(super) answered: usize,
}

impl Plan {
    /// Sorts the calls of a capture into connections.
    ///
    /// # Errors
    ///
    /// When it has no call, or more connections than a replay may have.
    pub fn new(events: Vec<Event>) -> Result<Self, Error> {
        let mut links = links(events)?;
        let calls = || links.iter().flat_map(|link| &link.calls);
        let Some(began) = calls().map(|planned| planned.call.at).min() else {
            return Err(Error::Replay("the capture has no call of b-CAP and no request of RAC".into()));
        };
        let ended = |(index, planned): (usize, &PlannedCall)| Some((end(&planned.call)?, index));
        let mut ends: Vec<_> = calls().enumerate().filter_map(ended).collect();
        ends.sort_unstable();
        let ranks: HashMap<_, _> = ends.iter().enumerate().map(|(rank, (_, index))| (*index, rank)).collect();
        for (index, planned) in links.iter_mut().flat_map(|link| &mut link.calls).enumerate() {
            let at = planned.call.at;
            planned.offset = Duration::from_nanos(at.saturating_sub(began));
            // A call waits for its predecessor in the connection, whose time is not later, and for calls whose end, and so
            // whose time, is earlier. In a cycle of calls that wait for each other all times would be equal, so all waits would
            // be for predecessors in one connection, which form no cycle. With `<=` a call could wait for its own end.
            planned.after = ends.partition_point(|(end, _)| *end < at);
            planned.rank = ranks.get(&index).copied();
        }
        Ok(Self { links, answered: ends.len() })
    }

    /// Returns whether no call moves or writes.
    #[must_use]
    pub fn is_harmless(&self) -> bool {
        self.links.iter().flat_map(|link| &link.calls).all(|planned| reads(&planned.call))
    }

    /// Refuses calls that may move or write and that are not allowed.
    ///
    /// # Errors
    ///
    /// The names of the refused calls.
    pub fn check(&self, allowed: &[CallName]) -> Result<(), Error> {
        let mut refused: BTreeMap<CallName, usize> = BTreeMap::new();
        for planned in self.links.iter().flat_map(|link| &link.calls) {
            let name = CallName { function: planned.call.function.clone(), command: planned.call.command.clone() };
            if !reads(&planned.call) && !allowed.iter().any(|allowed| allowed.has(&name)) {
                *refused.entry(name).or_default() += 1;
            }
        }
        let Some((first, _)) = refused.first_key_value() else { return Ok(()) };
        let list: Vec<_> = refused.iter().map(|(name, count)| format!("{name} ({count})")).collect();
        Err(Error::Replay(format!(
            "the capture has calls that may move or write: {}; nothing was sent. Allow them by name, such as \
             --allow {first}",
            list.join(", ")
        )))
    }
}

/// Returns the connections that have calls. Their calls are in the order of the requests, and no call is earlier than its
/// predecessor, even if the clock of the capture ran backward.
fn links(events: Vec<Event>) -> Result<Vec<PlannedLink>, Error> {
    let (mut links, mut calls) = (Vec::new(), HashMap::<_, Vec<Call>>::new());
    for event in events {
        match event {
            Event::Link(link) => links.push(link),
            Event::Call(call) => calls.entry(call.link.clone()).or_default().push(call),
            Event::Note(_) => {}
        }
    }
    let planned = |link: Link| {
        let mut calls = calls.remove(&link.name)?;
        calls.sort_by_key(|call| call.number);
        let mut latest = 0;
        let planned = |mut call: Call| {
            latest = call.at.max(latest);
            call.at = latest;
            PlannedCall { call, offset: Duration::ZERO, after: 0, rank: None }
        };
        let calls = calls.into_iter().map(planned).collect();
        Some(PlannedLink { kind: LinkKind::of(&link), calls })
    };
    let links: Vec<_> = links.into_iter().filter_map(planned).collect();
    match links.len() {
        0..=LINKS => Ok(links),
        count => Err(Error::Replay(format!(
            "the capture has calls in {count} connections; at most {LINKS} can be replayed at once"
        ))),
    }
}

/// When the reply to a call was recorded.
fn end(call: &Call) -> Option<u64> {
    Some(call.at.saturating_add(call.reply.as_ref()?.after))
}

/// Returns whether a call neither moves nor writes: GET of RAC, or by the table of functions and commands.
fn reads(call: &Call) -> bool {
    let Some(function) = FunctionId::parse(&call.function) else { return call.function == "GET" };
    let option = call.arguments.get(2).map_or(Some(String::new()), |option| {
        option.value.as_ref()?.as_variant().as_bstr().map(|text| text.to_string())
    });
    function.properties(call.command.as_deref(), option.as_deref()).effect.is_harmless()
}
