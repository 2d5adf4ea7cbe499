//! The log of packets or calls: one call a line, `#4 I4(1) = Variable_GetValue(variable: I4(3))`.
//!
//! The reply comes first, because a narrow terminal cuts the end.

use std::collections::{BTreeMap, HashMap, VecDeque};
use std::hash::{BuildHasher as _, RandomState};
use std::time::Duration;

use bcap_capture::Role;
use bcap_core::hresult::HResult;
use bcap_terminal::escape;
use bcap_terminal::screen::{KeyCode, Line, Mark, Panel, Part};

/// The lines that are kept.
const KEPT: usize = 500;

/// How long a change is marked.
pub(crate) const MARKED: Duration = Duration::from_secs(2);

/// The calls whose last reply is remembered.
const REMEMBERED: usize = 4096;

/// The last calls. A call whose reply is the same as before is omitted, unless all are wanted.
#[derive(Debug, Default)]
pub(crate) struct CallLog {
    lines: VecDeque<String>,
    /// The request that has no reply yet.
    pending: Option<String>,
    /// The hash of the last reply of each call, by the hash of the call: values can be large.
    replies: HashMap<u64, u64>,
    /// The calls by function and object or command.
    calls: BTreeMap<String, Call>,
    /// The names of the objects, by handle as in the text of a packet.
    names: HashMap<String, String>,
    hasher: RandomState,
    shows_all: bool,
    is_paused: bool,
}

/// The calls of a function for an object.
#[derive(Debug)]
struct Call {
    count: u64,
    first: Duration,
    last: Duration,
    changed: Option<Duration>,
    reply: String,
}

impl CallLog {
    /// Adds a packet of a client, formatted as `#4 Variable_GetValue(variable: I4(3))` or `#4 0x00000000 (S_OK): I4(1)`.
    pub(crate) fn packet(&mut self, role: Role, text: &str, at: Duration) {
        let (number, reply) = text.split_once(' ').unwrap_or(("", text));
        let pending = match role {
            // the earlier request has no reply, such as one whose connection was lost
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
    pub(crate) fn call(&mut self, number: &str, call: &str, reply: &str, at: Duration) {
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
        if self.lines.len() >= KEPT {
            self.lines.pop_front();
        }
        let done = reply.strip_prefix("0x00000000 (S_OK)");
        let reply = done.map_or(reply, |value| value.strip_prefix(": ").unwrap_or("S_OK"));
        self.lines.push_back(format!(
            "{:8.2} {number} {} = {}",
            at.as_secs_f64(),
            escape::cut(&reply),
            escape::cut(&call)
        ));
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
        let new = || Call { count: 0, first: at, last: at, changed: None, reply: reply.to_owned() };
        let call = self.calls.entry(format!("{function} {subject}")).or_insert_with(new);
        (call.count, call.last) = (call.count + 1, at);
        if call.reply != reply {
            (call.changed, call.reply) = (Some(at), reply.to_owned());
        }
    }

    /// Returns each function and object once, with the count, the rate, the time since the last call, and its reply.
    pub(crate) fn table(&self, now: Duration) -> Panel {
        let line = |(name, call): (&String, &Call)| {
            let age = now.saturating_sub(call.last).as_secs_f64();
            let rate = call.count.saturating_sub(1) as f64 / (call.last - call.first).as_secs_f64().max(0.001);
            let is_marked = call.changed.is_some_and(|at| now < at + MARKED);
            let text = format!("{:6} {rate:6.1}/s {age:5.1} s  {}", call.count, escape::cut(&call.reply));
            Line { mark: if is_marked { Mark::Changed } else { Mark::Plain }, ..Line::named(name, text) }
        };
        Panel::new("calls: count, rate, time since, reply", self.calls.iter().map(line).collect())
    }

    fn lines(&self) -> Vec<Line> {
        self.lines.iter().map(Line::new).collect()
    }

    /// Returns the lines as a panel.
    pub(crate) fn panel(&self, what: &str) -> Panel {
        let which = match (self.is_paused, self.shows_all) {
            (true, _) => "paused",
            (false, true) => "all",
            (false, false) => "changes only",
        };
        Panel::new(format!("{what}, {which}"), self.lines()).showing(Part::Last)
    }

    /// Handles the keys of a log.
    pub(crate) fn key(&mut self, key: KeyCode) {
        match key {
            KeyCode::Char('a') => self.shows_all = !self.shows_all,
            KeyCode::Char('p') => self.is_paused = !self.is_paused,
            _ => {}
        }
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
        let lines: Vec<String> = log.lines().into_iter().map(|line| line.text).collect();
        let call =
            |serial: u32, value: i32| format!("    1.50 #{serial} I4({value}) = Variable_GetValue(variable: I4(3))");
        assert_eq!(lines, [call(1, 7), call(3, 8), call(5, 9), "    0.00 #6 no reply = Service_Stop()".into()]);
    }
}
