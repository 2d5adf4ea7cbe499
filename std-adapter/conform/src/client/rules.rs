//! The rules for every request of a client.

use std::collections::{BTreeMap, HashMap};

use bcap_core::bcap::{FunctionId, Kind, Object};
use bcap_core::hresult::HResult;
use bcap_core::limits::UDP_SEND_MAX;
use bcap_testkit::frame::TestFrame;
use bcap_testkit::judge::has_kind;
use bcap_testkit::value::Value;

use crate::report::{CaseResult, Verdict};
use bcap_testkit::wire::Link;

/// The cases: name, source, rule.
const CASES: &[(&str, &str, &str)] = &[
    ("valid-frames", "b-CAP specification, sections 4.1.1 to 4.1.5", "every request is a valid frame"),
    ("serial-not-0", "b-CAP specification, sections 4.1.1 to 4.1.5", "a serial is not 0"),
    (
        "serials-ascend",
        "b-CAP specification, sections 4.1.1 to 4.1.5",
        "each request has the next serial; 1 follows 65535",
    ),
    ("reserved-0", "b-CAP specification, sections 4.1.1 to 4.1.5", "over TCP the reserved field is 0"),
    ("marker", "b-CAP specification, Table 6-1", "over UDP the reserved field is the serial of the first attempt"),
    ("datagram-size", "b-CAP specification, Table 6-1", "a datagram has at most 488 bytes"),
    ("one-at-a-time", "RAC specification, section 3.1", "a request is sent after the reply to the last one"),
    ("start-first", "b-CAP specification, section 4.1", "Service_Start is the first call"),
    ("known-functions", "b-CAP specification, Appendix A", "the functions are 1 to 137"),
    ("argument-count", "b-CAP specification, Appendix A", "a call has the arguments of its function"),
    ("argument-types", "b-CAP specification, Appendix A", "the arguments have the types of the function"),
    ("handles-are-i4", "b-CAP specification, section 4.1.3", "a handle is sent as I4, or UI4 as open drivers do"),
    ("handles-are-open", "RAC specification, Table 2-3", "a call uses a handle that is open"),
    ("handles-of-the-kind", "RAC specification, Table 2-3", "a call uses a handle of its object"),
    ("wdt-option", "b-CAP specification, Table 4-1", "the interval WDT is at least 80 ms"),
    ("objects-released", "b-CAP specification, section 4.1.4", "objects are released before Service_Stop"),
    ("stop-at-the-end", "b-CAP specification, section 4.1.5", "Service_Stop ends a session"),
    ("nothing-after-stop", "b-CAP specification, section 4.1.5", "after Service_Stop no object is used"),
    (
        "waits-while-executing",
        "b-CAP specification, Table 4-1",
        "S_EXECUTING is not the reply: the client waits for it",
    ),
    (
        "other-serial-ignored",
        "b-CAP specification, sections 4.1.1 to 4.1.5",
        "a reply with another serial is not the reply",
    ),
    ("reply-in-pieces", "b-CAP specification, sections 4.1.1 to 4.1.5", "a reply may arrive byte by byte"),
    (
        "two-replies-in-a-segment",
        "b-CAP specification, sections 4.1.1 to 4.1.5",
        "a stale reply and the reply may arrive in one segment",
    ),
    ("reply-twice", "b-CAP specification, sections 4.1.1 to 4.1.5", "a repeated reply is dropped"),
    ("refusal-survived", "RAC specification, Table 2-2", "an error of a call does not end the session"),
    (
        "keep-alive-and-a-part",
        "b-CAP specification, Table 4-1",
        "S_EXECUTING and the first part of the reply may arrive in one segment",
    ),
    (
        "late-reply-dropped",
        "b-CAP specification, sections 4.1.1 to 4.1.5",
        "a reply that arrives after the client's time limit is not the reply to its next call",
    ),
    (
        "close-noticed",
        "b-CAP specification, section 4.1.4",
        "a client whose connection ends during a call ends it too, and sends nothing more on it",
    ),
    ("retry-after-loss", "b-CAP specification, Table 6-1", "a call without a reply is sent again"),
    ("retry-has-a-new-serial", "b-CAP specification, Table 6-1", "a retry has a new serial"),
    (
        "retry-is-the-same-call",
        "b-CAP specification, Table 6-1",
        "a retry has the function and the arguments of the first attempt",
    ),
    ("foreign-datagram-ignored", "b-CAP specification, Table 6-1", "a reply from another port is not the reply"),
];

/// Iterates over the cases for clients: name, source and rule.
pub fn client_cases() -> impl Iterator<Item = (String, &'static str, &'static str)> {
    CASES.iter().map(|(name, source, rule)| (format!("client/{name}"), *source, *rule))
}

/// The current verdicts, and the state of a session that the rules need.
#[derive(Debug)]
pub(super) struct Rules {
    link: Link,
    verdicts: BTreeMap<&'static str, Result<(), (String, String)>>,
    serial: Option<u16>,
    started: bool,
    stopped: bool,
    open: HashMap<i32, Object>,
    pub(super) log: Vec<String>,
}

impl Rules {
    pub(super) fn new(link: Link) -> Self {
        let (verdicts, open, log) = (BTreeMap::new(), HashMap::new(), Vec::new());
        Self { link, verdicts, serial: None, started: false, stopped: false, open, log }
    }

    /// Records the outcome of a rule; the first failure is kept.
    pub(super) fn judge(&mut self, name: &'static str, holds: bool, expected: &str, came: impl Into<String>) {
        if holds {
            self.verdicts.entry(name).or_insert(Ok(()));
        } else if !matches!(self.verdicts.get(name), Some(Err(_))) {
            self.verdicts.insert(name, Err((expected.into(), came.into())));
        }
    }

    /// Forgets the session before.
    pub(super) fn begin(&mut self) {
        (self.serial, self.started, self.stopped) = (None, false, false);
        self.open.clear();
    }

    /// Judges a request that is not a retry.
    pub(super) fn request(&mut self, frame: &TestFrame, length: usize, text: &str) {
        let function = FunctionId(frame.code);
        self.judge("valid-frames", true, "", "");
        self.judge("serial-not-0", frame.serial != 0, "a serial of 1 to 65535", text);
        if self.serial.is_some() {
            let next = self.next_serial();
            self.judge("serials-ascend", frame.serial == next, &format!("the serial {next}"), text);
        }
        self.serial = Some(frame.serial);
        match self.link {
            Link::Tcp => self.judge("reserved-0", frame.reserved == 0, "0", format!("{}: {text}", frame.reserved)),
            Link::Udp | Link::Serial => {
                let marker = frame.reserved == frame.serial;
                self.judge("marker", marker, &frame.serial.to_string(), format!("{}: {text}", frame.reserved));
                self.judge("datagram-size", length <= UDP_SEND_MAX, "at most 488 bytes", format!("{length}: {text}"));
            }
        }
        if !self.started {
            self.judge("start-first", function == FunctionId::SERVICE_START, "Service_Start", text);
            self.started = true;
        }
        if self.stopped {
            let starts = function == FunctionId::SERVICE_START;
            self.judge("nothing-after-stop", starts, "no call, or Service_Start", text);
            if starts {
                // another session on this connection, without objects
                self.stopped = false;
                self.open.clear();
            }
        }
        self.arguments(frame, text);
    }

    fn arguments(&mut self, frame: &TestFrame, text: &str) {
        let function = FunctionId(frame.code);
        let Some(signature) = function.signature() else {
            return self.judge("known-functions", false, "a function of 1 to 137", text);
        };
        self.judge("known-functions", true, "", "");
        let count = signature.arguments.len();
        let optional = function == FunctionId::SERVICE_START && frame.args.is_empty();
        let expected = format!("{count} arguments");
        self.judge("argument-count", frame.args.len() == count || optional, &expected, text);
        for (kind, value) in signature.arguments.iter().zip(&frame.args) {
            match kind {
                Kind::Handle(object) => self.handle(*object, value, text),
                _ => self.judge("argument-types", has_kind(value, *kind), &format!("{kind:?}"), text),
            }
        }
        if function == FunctionId::SERVICE_START
            && let Some(Value::Bstr(option)) = frame.args.first()
            && let Some(interval) = wdt(&String::from_utf16_lossy(option))
        {
            let is_long = number(interval).is_some_and(|interval| interval >= 80);
            self.judge("wdt-option", is_long, "WDT=80 or more", text);
        }
        if function == FunctionId::SERVICE_STOP {
            let left: Vec<_> = self.open.values().map(|object| object.name()).collect();
            self.judge("objects-released", left.is_empty(), "no open objects", format!("open: {}", left.join(", ")));
            self.stopped = true;
            self.judge("nothing-after-stop", true, "", "");
            self.judge("stop-at-the-end", true, "", "");
        }
    }

    fn handle(&mut self, object: Object, value: &Value, text: &str) {
        let handle = match *value {
            Value::I4(handle) => handle,
            Value::Ui4(handle) => handle.cast_signed(),
            _ => return self.judge("handles-are-i4", false, "an I4", text),
        };
        self.judge("handles-are-i4", true, "", "");
        let found = self.open.get(&handle).copied();
        self.judge("handles-are-open", found.is_some(), "a handle that is open", text);
        if let Some(found) = found {
            self.judge("handles-of-the-kind", found == object, &format!("a handle of {}", object.name()), text);
        }
    }

    /// Records the objects that a reply opens or releases.
    pub(super) fn reply(&mut self, request: &TestFrame, reply: &TestFrame) {
        if HResult(reply.code).is_err() {
            return;
        }
        let function = FunctionId(request.code);
        if let (Some(object), Some(Value::I4(handle))) = (function.opens(), reply.args.first()) {
            self.open.insert(*handle, object);
        }
        if function.releases().is_some()
            && let Some(Value::I4(handle)) = request.args.first()
        {
            self.open.remove(handle);
        }
    }

    /// Returns the serial after the last serial.
    pub(super) fn next_serial(&self) -> u16 {
        self.serial.and_then(|serial| serial.checked_add(1)).unwrap_or(1)
    }

    /// Continues the serials after a retry.
    pub(super) fn retried(&mut self, serial: u16) {
        self.serial = Some(serial);
    }

    /// Judges the end of a connection.
    pub(super) fn end(&mut self) {
        if self.started {
            self.judge("stop-at-the-end", self.stopped, "Service_Stop", "the end of the connection");
        }
    }

    /// Returns the results of all cases.
    pub(super) fn results(mut self) -> Vec<CaseResult> {
        let log = std::mem::take(&mut self.log);
        let made = CASES.iter().map(|(name, source, rule)| {
            let outcome = self.verdicts.remove(name);
            let (verdict, reason, expected, came) = match outcome {
                None => (Verdict::Skip, Some("the client gave no occasion for it".into()), None, None),
                Some(Ok(())) => (Verdict::Pass, None, None, None),
                Some(Err((expected, came))) => (Verdict::Fail, None, Some(expected), Some(came)),
            };
            let exchange = if verdict == Verdict::Fail { log.clone() } else { Vec::new() };
            let name = format!("client/{name}");
            let (group, level) = (None, None);
            CaseResult {
                name,
                group,
                level,
                source,
                rule,
                seen_on: None,
                verdict,
                reason,
                expected,
                came,
                exchange,
                milliseconds: 0,
            }
        });
        made.collect()
    }
}

/// Returns the value of the first option WDT without its brackets. Keys are case-insensitive, and blanks around key and value
/// are dropped.
fn wdt(options: &str) -> Option<&str> {
    let mut options = options.split(',').filter_map(|option| option.split_once('='));
    let (_, value) = options.find(|(key, _)| key.trim().eq_ignore_ascii_case("WDT"))?;
    let value = value.trim();
    let brackets = [('(', ')'), ('[', ']'), ('{', '}'), ('<', '>')];
    let inner = brackets.iter().find_map(|(open, close)| value.strip_prefix(*open)?.strip_suffix(*close));
    Some(inner.unwrap_or(value).trim())
}

/// Reads a decimal number, or a hexadecimal one with the prefix `0x`.
fn number(text: &str) -> Option<u32> {
    match text.strip_prefix("0x").or_else(|| text.strip_prefix("0X")) {
        Some(digits) => u32::from_str_radix(digits, 16).ok(),
        None => text.parse().ok(),
    }
}
