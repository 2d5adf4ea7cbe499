//! The log of packets: each call with its reply, and each function and object once with its count and rate.

use std::collections::{BTreeMap, HashMap, VecDeque};
use std::hash::{BuildHasher as _, RandomState};
use std::time::Duration;

use bcap_capture::Role;
use bcap_core::hresult::HResult;
use bcap_terminal::escape;

/// The entries that are kept.
const KEPT: usize = 500;

/// The time during which a change is marked.
pub const MARKED: Duration = Duration::from_secs(2);

/// The maximum number of calls whose last reply is stored.
const REMEMBERED: usize = 4096;

/// The last calls. A call with an unchanged reply is omitted, unless all calls are wanted.
#[derive(Debug, Default)]
pub struct CallLog {
    entries: VecDeque<Entry>,
    /// The number of all entries, including entries that are no longer kept.
    total: u64,
    /// The request that has no reply yet.
    pending: Option<String>,
    /// The hash of the last reply of each call, by the hash of the call: values can be large.
    replies: HashMap<u64, u64>,
    /// The calls by function and object or command.
    calls: BTreeMap<String, CallStats>,
    /// The names of the objects, by handle as in the text of a packet.
    names: HashMap<String, String>,
    hasher: RandomState,
    /// Whether calls with an unchanged reply are kept too.
    pub shows_all: bool,
    /// Whether no calls are kept.
    pub is_paused: bool,
}

/// A call and its reply, as text that is truncated to a thousand characters.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Entry {
    /// When the call ended.
    pub at: Duration,
    /// The serial number, such as `#4`.
    pub number: String,
    /// The call, such as `Variable_GetValue(variable: I4(3))`.
    pub call: String,
    /// The reply: the value, or the code.
    pub reply: String,
}

/// The statistics of the calls of a function for an object.
#[derive(Clone, Debug)]
pub struct CallStats {
    /// The number of calls.
    pub count: u64,
    first: Duration,
    /// When the last call ended.
    pub last: Duration,
    /// When the reply last differed from the previous reply.
    pub changed: Option<Duration>,
    /// The last reply.
    pub reply: String,
}

impl CallStats {
    /// Returns the calls per second.
    #[must_use]
    pub fn rate(&self) -> f64 {
        self.count.saturating_sub(1) as f64 / (self.last - self.first).as_secs_f64().max(0.001)
    }
}

impl CallLog {
    /// Adds a packet of a client, formatted as `#4 Variable_GetValue(variable: I4(3))` or `#4 0x00000000 (S_OK): I4(1)`.
    pub fn packet(&mut self, role: Role, text: &str, at: Duration) {
        let (number, reply) = text.split_once(' ').unwrap_or(("", text));
        let pending = match role {
            // the earlier request has no reply, for example because its connection was lost
            Role::Request => self.pending.replace(text.to_owned()),
            // a keep-alive: the reply follows
            Role::Response if reply.starts_with(&HResult::S_EXECUTING.to_string()) => return,
            Role::Response => self.pending.take(),
        };
        match (role, &pending) {
            (Role::Request, None) => {}
            (Role::Request, Some(request)) => {
                let (number, call) = request.split_once(' ').unwrap_or(("", request));
                self.call(number, call, "no reply", at);
            }
            (Role::Response, None) => self.call(number, "a packet without a request", reply, at),
            (Role::Response, Some(request)) => {
                let (_, call) = request.split_once(' ').unwrap_or(("", request));
                self.call(number, call, reply, at);
            }
        }
    }

    /// Adds a call and its reply: `0x00000000 (S_OK): I4(1)`.
    pub fn call(&mut self, number: &str, call: &str, reply: &str, at: Duration) {
        if self.replies.len() >= REMEMBERED || self.calls.len() >= REMEMBERED || self.names.len() >= REMEMBERED {
            self.replies.clear();
            self.calls.clear();
            self.names.clear();
        }
        self.count(call, reply.strip_prefix("0x00000000 (S_OK): ").unwrap_or(reply), at);
        let (key, hash) = (self.hasher.hash_one(call), self.hasher.hash_one(reply));
        let is_same = self.replies.insert(key, hash) == Some(hash);
        if self.is_paused || is_same && !self.shows_all {
            return;
        }
        if self.entries.len() >= KEPT {
            self.entries.pop_front();
        }
        let done = reply.strip_prefix("0x00000000 (S_OK)");
        let reply = done.map_or(reply, |value| value.strip_prefix(": ").unwrap_or("S_OK"));
        let (number, call, reply) = (number.to_owned(), escape::cut(&call), escape::cut(&reply));
        self.entries.push_back(Entry { at, number, call, reply });
        self.total += 1;
    }

    /// Counts a call by its function, and its command or the name of its object.
    fn count(&mut self, call: &str, reply: &str, at: Duration) {
        let (function, arguments) = call.split_once('(').unwrap_or((call, ""));
        let handle = |text: &str| text.split([',', ')']).next().unwrap_or_default().to_owned();
        let text = arguments.split('"').nth(1);
        if let Some(name) = text.filter(|_| function.contains("_Get") && reply.starts_with("I4(")) {
            // the object is shown with its other calls
            self.names.insert(handle(reply), name.to_owned());
            return;
        }
        let object = arguments.split_once(": ").and_then(|(_, value)| self.names.get(&handle(value)));
        let subject = text.or(object.map(String::as_str)).unwrap_or_default();
        let new = || CallStats { count: 0, first: at, last: at, changed: None, reply: reply.to_owned() };
        let call = self.calls.entry(format!("{function} {subject}")).or_insert_with(new);
        (call.count, call.last) = (call.count + 1, at);
        if call.reply != reply {
            (call.changed, call.reply) = (Some(at), reply.to_owned());
        }
    }

    /// Returns each function and object once, with the statistics of its calls.
    pub fn calls(&self) -> impl Iterator<Item = (&str, &CallStats)> {
        self.calls.iter().map(|(name, call)| (name.as_str(), call))
    }

    /// Returns the kept entries in the order of their ends.
    pub fn entries(&self) -> impl DoubleEndedIterator<Item = &Entry> {
        self.entries.iter()
    }

    /// Returns the number of all entries, including entries that are no longer kept.
    #[must_use]
    pub const fn total(&self) -> u64 {
        self.total
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_reply_that_is_the_same_is_omitted() {
        let mut log = CallLog::default();
        let call = |log: &mut CallLog, serial: u32, value: i32| {
            log.packet(Role::Request, &format!("#{serial} Variable_GetValue(variable: I4(3))"), Duration::ZERO);
            log.packet(
                Role::Response,
                &format!("#{serial} 0x00000000 (S_OK): I4({value})"),
                Duration::from_millis(1500),
            );
        };
        call(&mut log, 1, 7);
        call(&mut log, 2, 7);
        log.packet(Role::Request, "#3 Variable_GetValue(variable: I4(3))", Duration::ZERO);
        log.packet(Role::Response, &format!("#3 {}", HResult::S_EXECUTING), Duration::ZERO);
        log.packet(Role::Response, "#3 0x00000000 (S_OK): I4(8)", Duration::from_millis(1500));
        log.is_paused = true;
        call(&mut log, 4, 9);
        log.is_paused = false;
        log.shows_all = true;
        call(&mut log, 5, 9);
        log.packet(Role::Request, "#6 Service_Stop()", Duration::ZERO);
        log.packet(Role::Request, "#7 Service_Stop()", Duration::ZERO);
        let entries: Vec<_> =
            log.entries().map(|entry| (entry.number.as_str(), entry.reply.as_str(), entry.call.as_str())).collect();
        let get = "Variable_GetValue(variable: I4(3))";
        let expected =
            [("#1", "I4(7)", get), ("#3", "I4(8)", get), ("#5", "I4(9)", get), ("#6", "no reply", "Service_Stop()")];
        assert_eq!(entries, expected);
        assert_eq!((log.total(), log.entries().next().unwrap().at), (4, Duration::from_millis(1500)));
    }
}
