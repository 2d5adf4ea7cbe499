//! Requests and replies, by the encoder and the decoder of `bcap-testkit`. The core only formats them for reports.

use std::fmt::Write as _;

use bcap_core::bcap::{Decoder, FunctionId};
use bcap_core::limits::{Strictness, UDP_RECEIVE_MAX};
use bcap_testkit::frame::TestFrame;
use bcap_testkit::judge::TCP;
use bcap_testkit::oracle::Oracle;
use bcap_testkit::value::Value;
use bcap_testkit::wire::{Link, Received};

/// The result of a receive with a time limit.
#[derive(Clone, Debug)]
pub(crate) enum Came {
    Reply(TestFrame),
    /// Bytes that are not a frame.
    Invalid(String),
    Closed,
    Nothing,
}

impl Came {
    /// Judges what arrived.
    pub(crate) fn of(link: Link, received: Received) -> Self {
        let bytes = match received {
            Received::Closed => return Self::Closed,
            Received::Silence => return Self::Nothing,
            Received::Packet(bytes) => bytes,
        };
        if link == Link::Udp && bytes.len() > UDP_RECEIVE_MAX {
            return Self::Invalid(format!("a datagram of {} bytes; the maximum is {UDP_RECEIVE_MAX}", bytes.len()));
        }
        match oracle(link).decode_packet(&bytes) {
            Some(reply) => Self::Reply(reply),
            None => Self::Invalid(format!("{} ({})", reason(&bytes), hex(&bytes))),
        }
    }

    pub(crate) fn text(&self) -> String {
        match self {
            Self::Reply(reply) => reply.text(),
            Self::Invalid(why) => format!("an invalid frame: {why}"),
            Self::Closed => "the device closed the connection".into(),
            Self::Nothing => "no reply within the time limit".into(),
        }
    }
}

/// The rules of a link.
pub(crate) fn oracle(link: Link) -> Oracle {
    Oracle { crc: link == Link::Serial, ..TCP }
}

/// Describes why bytes are invalid, if the core has a reason.
pub(crate) fn reason(bytes: &[u8]) -> String {
    match Decoder::TCP.decode_datagram(bytes) {
        Err(error) => error.to_string(),
        Ok(_) => "malformed".into(),
    }
}

/// Returns bytes as hexadecimal digits, at most 64 of them.
pub(crate) fn hex(bytes: &[u8]) -> String {
    let mut out: String = bytes.iter().take(64).map(|byte| format!("{byte:02x}")).collect();
    if bytes.len() > 64 {
        let _ = write!(out, "... ({} bytes)", bytes.len());
    }
    out
}

/// Returns a request in one line, such as `#4 Variable_GetValue(variable: I4(3))`.
pub(crate) fn request_text(serial: u16, function: FunctionId, args: &[Value]) -> String {
    let mut out = format!("#{serial} {function}(");
    for (index, value) in args.iter().enumerate() {
        let separator = if index > 0 { ", " } else { "" };
        let name = function.argument_names().get(index).map(|name| format!("{name}: ")).unwrap_or_default();
        let _ = write!(out, "{separator}{name}{}", value.short());
    }
    out.push(')');
    out
}

/// Formats bytes as a request: serial, function and arguments.
pub(crate) fn describe(bytes: &[u8]) -> String {
    match (Oracle { strictness: Strictness::Lenient, ..TCP }).decode_packet(bytes) {
        Some(frame) => request_text(frame.serial, FunctionId(frame.code), &frame.args),
        None => "not a valid request".into(),
    }
}
