//! The core never allocates: each operation runs under an allocator that counts, and must count 0.

use bcap_core::bcap::call::{self, Call, ControllerHandle, Reply, RobotHandle, VariableHandle};
use bcap_core::bcap::{Decoder, FrameWriter, FunctionId};
use bcap_core::error::EncodeError;
use bcap_core::limits::{Limits, Strictness};
use bcap_core::variant::{Variant, VariantBuf};
use bcap_tests::allocation::{Counting, allocations};
use bcap_tests::vectors::frames;

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// Runs `body` and fails when it allocates.
#[track_caller]
fn without<T>(body: impl FnOnce() -> T) -> T {
    let (result, count) = allocations(body);
    assert_eq!(count, 0, "allocations");
    result
}

#[test]
fn the_counter_counts() {
    let (text, count) = allocations(|| String::from("counted"));
    assert_eq!((text.as_str(), count), ("counted", 1));
    let (_, count) = allocations(|| {
        let mut grown = Vec::with_capacity(1);
        grown.extend([1_u8, 2]);
        grown
    });
    assert_eq!(count, 2, "a Vec that grows asks twice");
}

/// Reads every value and every value inside it; returns how many there were.
fn walk(value: Variant<'_>) -> usize {
    match value {
        Variant::Array(array) => 1 + array.iter().map(walk).sum::<usize>(),
        Variant::Nested(inner) => 1 + walk(inner.value()),
        Variant::Bstr(text) => text.to_str(&mut [0; 256]).map_or(0, |_| 1),
        _ => 1,
    }
}

#[test]
fn decoding_and_reading_frames() {
    for vector in frames() {
        for strictness in [Strictness::Strict, Strictness::Lenient] {
            let read = without(|| {
                let frame = Decoder::TCP.strictness(strictness).decode_datagram(&vector.bytes).ok()?;
                Some(frame.args.iter().map(walk).sum::<usize>())
            });
            assert!(read.is_some_and(|count| count >= vector.count), "{}", vector.name);
        }
        for cut in 0..vector.bytes.len() {
            assert!(without(|| Decoder::UDP.decode_datagram(&vector.bytes[..cut]).is_err()), "{}", vector.name);
        }
    }
}

#[test]
fn encoding_frames() {
    let mut buffer = [0; 512];
    for vector in frames() {
        let bytes = without(|| -> Result<&[u8], EncodeError> {
            let frame = Decoder::TCP.decode_datagram(&vector.bytes).map_err(|_| EncodeError::Full)?;
            let mut writer = FrameWriter::new(&mut buffer)?;
            frame.args.iter().try_for_each(|value| writer.argument(&value))?;
            writer.finish(frame.serial, frame.reserved, frame.code)
        });
        assert_eq!(bytes, Ok(&vector.bytes[..]), "{}", vector.name);
    }
}

#[test]
fn owned_values() {
    let pose = [1.5_f64; 8];
    let owned = without(|| VariantBuf::<256>::new(&(pose, "text", true, ())));
    let owned = owned.unwrap();
    assert_eq!(without(|| walk(owned.as_variant())), 13);
    let copy = without(|| VariantBuf::<256>::decode(owned.as_bytes(), &Limits::STREAM, Strictness::Strict));
    assert_eq!(copy.unwrap(), owned);
    without(|| VariantBuf::<16>::new(&"this is too long for it")).unwrap_err();
}

/// Writes a call and reads a reply to it.
fn exchange<C: Call>(call: &C, reply: &Variant<'_>, check: impl FnOnce(<C::Reply as Reply>::Value<'_>) -> bool) {
    let mut buffer = [0; 512];
    let right = without(|| -> Option<bool> {
        let mut frame = FrameWriter::new(&mut buffer).ok()?;
        call.arguments(&mut frame).ok()?;
        let request = frame.finish(1, 0, call.function().0).ok()?;
        let sent = Decoder::TCP.decode_datagram(request).ok()?.function();
        let mut frame = FrameWriter::new(&mut buffer).ok()?;
        frame.argument(reply).ok()?;
        let bytes = frame.finish(1, 0, 0).ok()?;
        let frame = Decoder::TCP.decode_datagram(bytes).ok()?;
        Some(sent == call.function() && check(C::Reply::read(frame.args).ok()?))
    });
    assert_eq!(right, Some(true), "{}", call.function());
}

#[test]
fn typed_calls_and_their_replies() {
    exchange(&call::variable_get_value(VariableHandle(3)), &Variant::R8(2.5), |v| v == Variant::R8(2.5));
    exchange(&call::robot_execute(RobotHandle(3), "slvMove", [1.0_f64; 8]), &Variant::Empty, |v| v == Variant::Empty);
    exchange(&call::controller_get_robot(ControllerHandle(2), "Arm", ""), &Variant::I4(7), |h| h == RobotHandle(7));
    let raw = call::RawCall { function: FunctionId(137), arguments: &[&3_i32, &"text", &[1_i16, 2]] };
    exchange(&raw, &Variant::Bool(true), |v| v == Some(Variant::Bool(true)));
}
