//! The log of packets or calls: one call a line, `#4 I4(1) = Variable_GetValue(variable: I4(3))`.
//!
//! The reply comes first, because a narrow terminal cuts the end.

use std::collections::{HashMap, VecDeque};
use std::hash::{BuildHasher as _, RandomState};
use std::time::Duration;

use bcap_capture::Role;
use bcap_core::hresult::HResult;
use bcap_terminal::escape;
use bcap_terminal::screen::{KeyCode, Line, Panel, Part};

/// The lines that are kept.
const KEPT: usize = 500;

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
    hasher: RandomState,
    shows_all: bool,
    is_paused: bool,
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
        if self.replies.len() >= REMEMBERED {
            self.replies.clear();
        }
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
