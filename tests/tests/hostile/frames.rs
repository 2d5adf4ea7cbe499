//! Invalid frames over TCP, frames whose values claim more bytes than there are, and values that are large but valid.

use bcap_core::bcap::FunctionId;
use bcap_core::hresult::HResult;
use bcap_testkit::frame::{TestFrame, field};
use bcap_testkit::network::Random;
use bcap_testkit::value::Value;

use crate::Case;
use crate::target::Target;
use crate::wire::{Raw, SERIAL, UNKNOWN_TYPES, argument, broken_values, bytes, frame, nested, request, value};

pub(crate) const CASES: &[Case] = crate::cases! {
    frames:
        values_that_claim_more_than_is_there
        unknown_types_of_values
        missing_arguments
        more_arguments_than_any_function_takes
        an_argument_length_that_disagrees
        bytes_after_the_last_argument
        a_wrong_terminator
        a_length_that_is_short_or_long_by_one
        a_length_below_a_header
        a_length_over_the_limit
        the_longest_frame_promised_and_not_sent
        the_longest_frame
        nesting_of_any_depth
        strings_around_sixteen_bits
        every_unit_of_a_string
        empty_arrays
        arrays_of_errors
        bytes_before_a_frame
        another_protocol
        random_garbage
        a_bit_turned_in_any_place
};

/// Asserts that bytes are answered with one code and the end of the connection.
fn refused(target: &Target, name: &str, bytes: &[u8], code: HResult) {
    let mut raw = Raw::connect(target.tcp);
    raw.send(bytes);
    let replies = raw.replies();
    let expected = TestFrame { serial: SERIAL, reserved: 0, code: code.0, args: vec![] };
    assert_eq!(replies, [expected], "{name}");
}

/// A request with one argument, which may be an invalid value.
fn with_value(value: &[u8]) -> Vec<u8> {
    frame(SERIAL, FunctionId::SERVICE_START.0, 1, &argument(value))
}

fn values_that_claim_more_than_is_there(target: &mut Target) {
    for (name, value) in broken_values() {
        refused(target, name, &with_value(&value), HResult::E_INVALIDRCPACKET);
        target.serves_others();
    }
}

fn unknown_types_of_values(target: &mut Target) {
    for vartype in UNKNOWN_TYPES {
        for data in [&[][..], &[0; 4], &[0; 16]] {
            let bytes = with_value(&value(*vartype, 1, data));
            refused(target, &format!("type {vartype:#06x}"), &bytes, HResult::E_INVALIDRCPACKET);
        }
    }
}

fn missing_arguments(target: &mut Target) {
    let one = argument(&Value::I4(1).to_wire());
    for count in [2, 3, 64] {
        let name = format!("{count} arguments, of which one is there");
        refused(target, &name, &frame(SERIAL, 4, count, &one), HResult::E_INVALIDRCPACKET);
        refused(target, &name, &frame(SERIAL, 4, count, &[]), HResult::E_INVALIDRCPACKET);
    }
    refused(target, "none, of which one is there", &frame(SERIAL, 4, 0, &one), HResult::E_INVALIDRCPACKET);
}

fn more_arguments_than_any_function_takes(target: &mut Target) {
    let one = argument(&Value::Empty.to_wire());
    for count in [65, 1000, 65535] {
        let all = one.repeat(usize::from(count));
        refused(target, "all there", &frame(SERIAL, 4, count, &all), HResult::E_INVALIDRCPACKET);
        refused(target, "one there", &frame(SERIAL, 4, count, &one), HResult::E_INVALIDRCPACKET);
    }
    // 64 arguments, the maximum, are a valid frame, but no function has as many
    let mut raw = Raw::connect(target.tcp);
    let reply = raw.call(&request(FunctionId::CONTROLLER_DISCONNECT, vec![Value::Empty; 64]));
    assert_eq!(reply.code, HResult::E_INVALIDARG.0);
    raw.begin();
}

fn an_argument_length_that_disagrees(target: &mut Target) {
    let value = Value::I4(1).to_wire();
    for length in [0, 1, 9, 11, 0x7fff_ffff, 0xffff_fff0, 0xffff_ffff_u32] {
        let mut body = length.to_le_bytes().to_vec();
        body.extend(&value);
        refused(target, &format!("length {length:#x}"), &frame(SERIAL, 4, 1, &body), HResult::E_INVALIDRCPACKET);
    }
}

fn bytes_after_the_last_argument(target: &mut Target) {
    let mut body = argument(&Value::I4(1).to_wire());
    for _ in 0..8 {
        body.push(0);
        refused(target, "slack", &frame(SERIAL, 4, 1, &body), HResult::E_INVALIDRCPACKET);
    }
    refused(target, "slack behind nothing", &frame(SERIAL, 2, 0, &[4]), HResult::E_INVALIDRCPACKET);
}

fn a_wrong_terminator(target: &mut Target) {
    for terminator in [0, 1, 5, 0x84, 0xff] {
        let mut bytes = bytes(FunctionId::SERVICE_START, vec![Value::text("")]);
        *bytes.last_mut().unwrap() = terminator;
        refused(target, "terminator", &bytes, HResult::E_INVALIDRCPACKET);
    }
}

fn a_length_that_is_short_or_long_by_one(target: &mut Target) {
    let right = bytes(FunctionId::SERVICE_START, vec![Value::text("")]);
    let mut short = right.clone();
    short[field::LENGTH.start] -= 1;
    refused(target, "short by one", &short, HResult::E_INVALIDRCPACKET);
    // the first byte of the next frame is taken for the last of this one
    let mut long = [&right[..], &right[..]].concat();
    long[field::LENGTH.start] += 1;
    refused(target, "long by one", &long, HResult::E_INVALIDRCPACKET);
}

fn a_length_below_a_header(target: &mut Target) {
    for length in 0..16_u32 {
        let mut bytes = frame(SERIAL, 1, 0, &[]);
        bytes[field::LENGTH].copy_from_slice(&length.to_le_bytes());
        refused(target, &format!("length {length}"), &bytes, HResult::E_INVALIDRCPACKET);
    }
}

fn a_length_over_the_limit(target: &mut Target) {
    for length in [(16 << 20) + 1, 0x7fff_ffff, 0x8000_0000, 0xffff_fff0, 0xffff_ffff_u32] {
        let mut bytes = frame(SERIAL, 1, 0, &[]);
        bytes[field::LENGTH].copy_from_slice(&length.to_le_bytes());
        refused(target, &format!("length {length:#x}"), &bytes, HResult::E_PACKETSIZEOVER);
    }
}

/// The server does not allocate the claimed length; the connection ends at the timeout of the request.
fn the_longest_frame_promised_and_not_sent(target: &mut Target) {
    let before = target.process().memory();
    let mut promises: Vec<Raw> = (0..20).map(|_| Raw::connect(target.tcp)).collect();
    for raw in &mut promises {
        raw.send(&[1, 0, 0, 0, 1]);
    }
    target.serves_others();
    if let (Some(before), Some(after)) = (before, target.process().memory()) {
        assert!(after.now < before.now + (4 << 20), "20 promises of 16 MiB: {before:?}, then {after:?}");
    }
    for mut raw in promises {
        assert_eq!(raw.rest(), [0_u8; 0]);
    }
}

/// A frame of exactly the limit is read and answered; when its connection ends, its memory is released.
fn the_longest_frame(target: &mut Target) {
    let mut raw = Raw::connect(target.tcp);
    let controller = raw.begin();
    let overhead = bytes(FunctionId::CONTROLLER_EXECUTE, execute(controller, "echo", Value::text(""))).len();
    let units = vec![0x30a2; ((16 << 20) - overhead) / 2];
    let text = Value::Bstr(units);
    let reply = raw.call(&request(FunctionId::CONTROLLER_EXECUTE, execute(controller, "echo", text.clone())));
    assert_eq!(reply.code, 0);
    assert!(reply.args == [text], "every unit came back");
}

fn execute(controller: i32, command: &str, parameter: Value) -> Vec<Value> {
    vec![Value::I4(controller), Value::text(command), parameter]
}

/// Sends values to an application that gives them back.
fn echoes(target: &Target, values: impl IntoIterator<Item = Value>) {
    let mut raw = Raw::connect(target.tcp);
    let controller = raw.begin();
    for value in values {
        let reply = raw.call(&request(FunctionId::CONTROLLER_EXECUTE, execute(controller, "echo", value.clone())));
        assert_eq!(reply.code, 0);
        assert!(reply.args == [value], "the same value came back");
    }
}

fn nesting_of_any_depth(target: &mut Target) {
    let deep = |levels| (0..levels).fold(Value::Empty, |inner, _| Value::Array(12, vec![inner]));
    echoes(target, (0..=8).map(deep));
    for levels in [9, 16, 17, 1000, 58_234, 100_000, 200_000] {
        refused(target, &format!("{levels} levels"), &with_value(&nested(levels)), HResult::E_INVALIDRCPACKET);
    }
    // broad as well as deep: every level promises a thousand more
    let level = [0x0c, 0x20, 0xe8, 3, 0, 0].repeat(20_000);
    refused(target, "levels of a thousand", &with_value(&level), HResult::E_INVALIDRCPACKET);
}

fn strings_around_sixteen_bits(target: &mut Target) {
    let lengths = [0, 1, 16_382, 16_383, 16_384, 32_767, 32_768, 40_000, 65_535, 65_536, 70_000, 200_000];
    echoes(target, lengths.map(|length| Value::Bstr((0..length).map(|n| 1 + n as u16 % 0xd000).collect())));
    // and as names: a server with no room for a value of 1 KiB must not fail
    let mut raw = Raw::connect(target.tcp);
    let controller = raw.begin();
    let long = Value::Bstr(vec![65; 40_000]);
    let args = vec![Value::I4(controller), long.clone(), Value::text("")];
    let reply = raw.call(&request(FunctionId::CONTROLLER_GET_VARIABLE, args));
    let [Value::I4(variable)] = reply.args[..] else { panic!("a handle: {reply:?}") };
    let reply = raw.call(&request(FunctionId::VARIABLE_PUT_VALUE, vec![Value::I4(variable), long]));
    assert_eq!(reply.code, HResult::E_TOO_MUCH_DATA.0);
}

/// NULs, lone surrogates and characters beyond the BMP pass through unchanged.
fn every_unit_of_a_string(target: &mut Target) {
    let all: Vec<u16> = (0..=u16::MAX).collect();
    echoes(
        target,
        [Value::Bstr(all), Value::text("a\0b"), Value::text("\u{1f600}"), Value::Bstr(vec![0xdc00, 0xd800])],
    );
}

fn empty_arrays(target: &mut Target) {
    let types = [0, 1, 2, 3, 4, 5, 6, 7, 8, 10, 11, 12, 17, 18, 19, 20, 21];
    echoes(target, types.map(|element| Value::Array(element, vec![])));
}

fn arrays_of_errors(target: &mut Target) {
    let errors = vec![Value::Error(-1), Value::Error(0)];
    echoes(
        target,
        [Value::Array(10, errors), Value::Array(0, vec![Value::Empty; 9]), Value::Array(1, vec![Value::Null])],
    );
}

fn bytes_before_a_frame(target: &mut Target) {
    let good = bytes(FunctionId::SERVICE_START, vec![Value::text("")]);
    for junk in [&[0][..], &[4; 50], b"\r\n", &[0xff; 3]] {
        let mut raw = Raw::connect(target.tcp);
        raw.send(&[junk, &good].concat());
        let codes: Vec<i32> = raw.replies().into_iter().map(|reply| reply.code).collect();
        assert_eq!(codes, [HResult::E_INVALIDRCPACKET.0], "what follows junk is not trusted");
    }
}

fn another_protocol(target: &mut Target) {
    let hellos: [&[u8]; 4] =
        [b"GET / HTTP/1.1\r\n\r\n", b"GET:RC8:10:I:\r", b"\x16\x03\x01\x02\0\x01\0", b"SSH-2.0-OpenSSH_9.6\r\n"];
    for hello in hellos {
        let mut raw = Raw::connect(target.tcp);
        raw.send(hello);
        let codes: Vec<i32> = raw.replies().into_iter().map(|reply| reply.code).collect();
        assert_eq!(codes, [HResult::E_INVALIDRCPACKET.0]);
    }
}

fn random_garbage(target: &mut Target) {
    let mut random = Random(7);
    for length in (0..100).map(|n| 1 + n * 3).chain([10_000, 100_000]) {
        let mut bytes: Vec<u8> = (0..length).map(|_| random.number() as u8).collect();
        if random.happens(500) {
            bytes[0] = 1;
        }
        let mut raw = Raw::connect(target.tcp);
        raw.send(&bytes);
        raw.finish();
        let codes: Vec<HResult> = raw.replies().into_iter().map(|reply| HResult(reply.code)).collect();
        // bytes after a refusal are not read, and a connection that is closed with bytes unread may lose its answer
        if bytes[0] != 1 && length < 4096 {
            assert_eq!(codes, [HResult::E_INVALIDRCPACKET], "{length} bytes");
        }
        let refusals = [HResult::E_INVALIDRCPACKET, HResult::E_PACKETSIZEOVER];
        assert!(codes.len() <= 1 && codes.iter().all(|code| refusals.contains(code)), "{codes:?}");
    }
}

/// For every flipped bit, the server sends at most one reply, and serves the next connection.
fn a_bit_turned_in_any_place(target: &mut Target) {
    let right = bytes(FunctionId::CONTROLLER_CONNECT, vec![Value::text("a"); 4]);
    for at in 0..right.len() {
        for bit in 0..8 {
            let mut turned = right.clone();
            turned[at] ^= 1 << bit;
            let mut raw = Raw::connect(target.tcp);
            raw.send(&turned);
            raw.finish();
            let replies = raw.replies();
            assert!(replies.len() <= 1, "bit {bit} of byte {at}: {replies:?}");
        }
    }
}
