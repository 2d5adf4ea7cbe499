//! The b-CAP session of a connection: requests and replies become calls, handles become names.

use std::collections::HashMap;

use bcap_core::bcap::{Decoder, EOT, Frame, FunctionId, Header, Kind, MIN_FRAME, Object, Progress};
use bcap_core::hresult::HResult;
use bcap_core::limits::Strictness;
use bcap_core::variant::Variant;

use super::call::{Argument, Call, Reply};
use crate::json::LIMITS;
use crate::role::Role;
use bcap_core::variant::OwnedVariant as Value;

/// The number of most recent calls that a retransmission may repeat, because serial numbers wrap.
const LATEST_CALLS: u64 = 1 << 15;

/// The finding of a session in received bytes.
#[derive(Debug)]
pub(crate) enum Found {
    Call(Box<Call>),
    /// A remark, at nanoseconds since 1970.
    Note(u64, String),
}

/// A call whose reply has not arrived, or that may be sent or answered again.
#[derive(Debug)]
struct Pending {
    call: Call,
    function: FunctionId,
    /// The first argument, if it is a handle.
    handle: Option<i32>,
    /// The name of the object that it opens.
    opens: Option<String>,
}

/// The session of a connection or of a pair of UDP ports.
#[derive(Debug)]
pub(crate) struct Session {
    link: String,
    decoder: Decoder,
    /// Bytes of incomplete frames, from the client and from the server.
    partial: [Vec<u8>; 2],
    /// Whether the next bytes of each direction may be in the middle of a frame.
    is_lost: [bool; 2],
    /// Calls without a reply, by an index that counts calls.
    pending: HashMap<u64, Pending>,
    count: u64,
    /// The call of each serial number, and of each serial number of a first attempt.
    serials: HashMap<u16, u64>,
    firsts: HashMap<u16, (u64, FunctionId)>,
    objects: HashMap<i32, String>,
}

impl Session {
    pub(crate) fn new(link: String, strictness: Strictness) -> Self {
        Self {
            link,
            decoder: Decoder { limits: LIMITS, strictness, crc: false },
            partial: Default::default(),
            is_lost: [false; 2],
            pending: HashMap::new(),
            count: 0,
            serials: HashMap::new(),
            firsts: HashMap::new(),
            objects: HashMap::new(),
        }
    }

    /// Adds the next bytes of one direction of a stream.
    pub(crate) fn bytes(&mut self, role: Role, bytes: &[u8], at: u64, out: &mut Vec<Found>) {
        let mut buffer = std::mem::take(&mut self.partial[role.index()]);
        buffer.extend_from_slice(bytes);
        let mut used = 0;
        while let Some(rest) = buffer.get(used..).filter(|rest| !rest.is_empty()) {
            let error = match self.decoder.decode(rest) {
                Ok(Progress::Complete(frame, length)) => {
                    self.frame(role, &frame, at, false, out);
                    self.is_lost[role.index()] = false;
                    used += length;
                    continue;
                }
                Ok(Progress::NeedMore(_)) if !self.is_lost[role.index()] || is_plausible(role, rest) => break,
                Ok(Progress::NeedMore(_)) => "they are in the middle of one".to_owned(),
                Err(error) => error.to_string(),
            };
            let skipped = self.skipped(role, rest);
            self.is_lost[role.index()] = true;
            out.push(Found::Note(at, format!("{}: {skipped} bytes are not a frame: {error}", role.sender())));
            used += skipped;
        }
        buffer.drain(..used);
        self.partial[role.index()] = buffer;
    }

    /// Returns how many bytes are not a frame: a whole one if only its values are invalid, otherwise those before the next header.
    fn skipped(&self, role: Role, bytes: &[u8]) -> usize {
        let ends = |length: &usize| bytes.get(..*length).is_some_and(|frame| frame.ends_with(&[EOT]));
        if let Some(length) = self.decoder.frame_length(bytes).ok().flatten().filter(ends) {
            return length;
        }
        let mut skipped = 0;
        while let Some(rest) = bytes.get(skipped..).filter(|rest| !rest.is_empty()) {
            if skipped > 0 && is_plausible(role, rest) {
                break;
            }
            skipped += self.decoder.resync(rest).max(1);
        }
        skipped
    }

    /// Records that the capture lacks bytes of one direction.
    pub(crate) fn missing(&mut self, role: Role, count: u64, at: u64, out: &mut Vec<Found>) {
        self.is_lost[role.index()] = true;
        let lost = std::mem::take(&mut self.partial[role.index()]).len();
        let cut = if lost > 0 { format!(", inside a frame of which {lost} bytes are there") } else { String::new() };
        out.push(Found::Note(at, format!("{}: the capture lacks {count} bytes{cut}", role.sender())));
    }

    /// Adds a datagram.
    pub(crate) fn datagram(&mut self, role: Role, bytes: &[u8], at: u64, out: &mut Vec<Found>) {
        match self.decoder.decode_datagram(bytes) {
            Ok(frame) => self.frame(role, &frame, at, true, out),
            Err(error) => {
                let length = bytes.len();
                out.push(Found::Note(at, format!("{}: {length} bytes are not a frame: {error}", role.sender())));
            }
        }
    }

    /// Ends the session: calls without a reply are reported as such.
    pub(crate) fn end(&mut self, at: u64, out: &mut Vec<Found>) {
        for role in [Role::Request, Role::Response] {
            let left = std::mem::take(&mut self.partial[role.index()]).len();
            if left > 0 {
                out.push(Found::Note(at, format!("{}: the last {left} bytes are a part of a frame", role.sender())));
            }
        }
        let mut pending: Vec<_> = self.pending.drain().collect();
        pending.sort_by_key(|(number, _)| *number);
        out.extend(pending.into_iter().map(|(_, pending)| Found::Call(Box::new(pending.call))));
    }

    fn frame(&mut self, role: Role, frame: &Frame<'_>, at: u64, is_lossy: bool, out: &mut Vec<Found>) {
        match role {
            Role::Request => self.request(frame, at, is_lossy, out),
            Role::Response => self.reply(frame, at, out),
        }
    }

    fn request(&mut self, frame: &Frame<'_>, at: u64, is_lossy: bool, out: &mut Vec<Found>) {
        let first = if frame.reserved == 0 { frame.serial } else { frame.reserved };
        let function = frame.function();
        if is_lossy && self.retransmission(frame, first, at, out) {
            return;
        }
        if is_lossy && function == FunctionId::SERVICE_START {
            self.objects.clear();
        }
        let pending = self.pending(frame, at);
        self.count += 1;
        self.pending.insert(self.count, pending);
        let earlier = self.serials.insert(frame.serial, self.count);
        // a reply with this serial number can no longer belong to an earlier call
        let unanswered = earlier.and_then(|number| self.pending.remove(&number));
        out.extend(unanswered.map(|pending| Found::Call(Box::new(pending.call))));
        self.firsts.insert(first, (self.count, function));
    }

    /// Adds a request to the call of its first attempt, and returns whether there is one.
    fn retransmission(&mut self, frame: &Frame<'_>, first: u16, at: u64, out: &mut Vec<Found>) -> bool {
        let Some((number, of)) = self.firsts.get(&first).copied() else { return false };
        if of != frame.function() {
            return false;
        }
        if let Some(earlier) = self.pending.get_mut(&number) {
            earlier.call.attempts += 1;
        } else if first != frame.serial && self.count - number < LATEST_CALLS {
            // the reply was lost or late; the server repeats it and does not execute the call again
            out.push(Found::Note(at, format!("client: #{} repeats #{first} after its reply", frame.serial)));
        } else {
            return false;
        }
        self.serials.insert(frame.serial, number);
        true
    }

    fn pending(&self, frame: &Frame<'_>, at: u64) -> Pending {
        let function = frame.function();
        let signature = function.signature();
        let kinds = signature.map_or(&[][..], |signature| signature.arguments);
        let names = function.argument_names();
        let argument = |(i, value): (usize, Variant<'_>)| Argument {
            name: names.get(i).copied(),
            object: matches!(kinds.get(i), Some(Kind::Handle(_)))
                .then(|| self.objects.get(&value.as_i32()?).cloned())
                .flatten(),
            value: Value::new(&value).ok(),
        };
        let arguments: Vec<_> = frame.args.iter().enumerate().map(argument).collect();
        let text = |i: usize| frame.args.get(i).and_then(|value| value.as_bstr()).map(|text| text.to_string());
        let executes = names.get(1) == Some(&"command");
        let owner = arguments.first().and_then(|argument| argument.object.as_deref());
        let opens = function.opens().filter(|object| *object != Object::Service).map(|object| {
            let name = names.iter().position(|name| *name == "name").and_then(text).unwrap_or_default();
            object_name(object, &name, owner)
        });
        let handle = matches!(kinds.first(), Some(Kind::Handle(_))).then(|| frame.args.get(0)?.as_i32()).flatten();
        let command = if executes { text(1) } else { None };
        let call = Call {
            at,
            link: self.link.clone(),
            number: self.count,
            serial: Some(frame.serial),
            function: function.to_string(),
            command,
            arguments,
            attempts: 1,
            executing: 0,
            reply: None,
        };
        Pending { call, function, handle, opens }
    }

    fn reply(&mut self, frame: &Frame<'_>, at: u64, out: &mut Vec<Found>) {
        let code = frame.hresult();
        let number = self.serials.get(&frame.serial).copied();
        let Some(pending) = number.and_then(|number| self.pending.get_mut(&number)) else {
            let what = if number.is_some() { "another reply" } else { "a reply without a request" };
            out.push(Found::Note(at, format!("server: {what}: #{} {code}", frame.serial)));
            return;
        };
        if code == HResult::S_EXECUTING {
            pending.call.executing += 1;
            return;
        }
        let Some(mut pending) = number.and_then(|number| self.pending.remove(&number)) else { return };
        let value = frame.value();
        let mut opened = None;
        if code.is_ok() {
            if let (Some(name), Some(handle)) = (pending.opens, value.and_then(|value| value.as_i32())) {
                self.objects.insert(handle, name.clone());
                opened = Some(name);
            } else if pending.function.releases().is_some()
                && let Some(handle) = pending.handle
            {
                self.objects.remove(&handle);
            }
        }
        let value = value.and_then(|value| Value::new(&value).ok());
        pending.call.reply = Some(Reply { after: at.saturating_sub(pending.call.at), code, value, opened });
        out.push(Found::Call(Box::new(pending.call)));
    }
}

/// Names an object: `I1`, `robot:Arm0`, `robot:Arm0/@SERVO_ON`.
fn object_name(object: Object, name: &str, owner: Option<&str>) -> String {
    let kind = object.name().to_lowercase();
    let own = match object {
        _ if name.is_empty() => kind,
        Object::Variable => name.to_owned(),
        _ => format!("{kind}:{name}"),
    };
    match owner.filter(|owner| !owner.starts_with("controller")) {
        Some(owner) => format!("{owner}/{own}"),
        None => own,
    }
}

/// Returns whether bytes that have SOH and a length can be a header, or the start of one. Values have many such bytes.
fn is_plausible(role: Role, bytes: &[u8]) -> bool {
    const MOST_ARGUMENTS: u16 = 64;
    /// The bytes of an argument without data.
    const ARGUMENT: usize = 10;
    const LONGEST: usize = 1 << 20;
    let Some(header) = Header::read(bytes) else { return true };
    let is_known = match role {
        Role::Request => header.function().name().is_some(),
        // few results without an error are in use
        Role::Response => header.code < 0x1000,
    };
    let shortest = MIN_FRAME + usize::from(header.count) * ARGUMENT;
    is_known
        && header.count <= MOST_ARGUMENTS
        && usize::try_from(header.length).is_ok_and(|length| (shortest..LONGEST).contains(&length))
}
