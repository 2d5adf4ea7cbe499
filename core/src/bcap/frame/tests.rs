//! Edge cases of frames: lengths, CRC, arguments, and the position of errors.

extern crate std;

use std::format;
use std::vec::Vec;

use super::*;
use crate::error::DecodeErrorKind as K;

/// A frame with these arguments.
fn frame(crc: bool, args: &[i32]) -> Vec<u8> {
    let mut buffer = [0xa5; 128];
    let mut writer = FrameWriter::new(&mut buffer).unwrap().with_crc(crc);
    for arg in args {
        writer.argument(arg).unwrap();
    }
    writer.finish(7, 9, -3).unwrap().to_vec()
}

fn kind<T: core::fmt::Debug>(result: Result<T, DecodeError>) -> (K, usize) {
    let error = result.unwrap_err();
    (error.kind, error.offset)
}

#[test]
fn the_length_field_is_accepted_from_the_minimum_to_the_limit() {
    for (decoder, least) in [(Decoder::TCP, 16), (Decoder::UDP, 16), (Decoder::SERIAL, 18)] {
        let limit = decoder.limits.frame;
        for (length, good) in [(0, false), (least - 1, false), (least, true), (least + 1, true), (limit, true)] {
            let [a, b, c, d] = length.to_le_bytes();
            let found = decoder.frame_length(&[SOH, a, b, c, d]);
            assert_eq!(found.ok(), good.then(|| usize::try_from(length).ok()), "{length}");
        }
        let [a, b, c, d] = (limit + 1).to_le_bytes();
        let found = decoder.frame_length(&[SOH, a, b, c, d]);
        assert_eq!(kind(found), (K::FrameTooLong { length: limit + 1, limit }, 1));
        assert_eq!(decoder.frame_length(&[SOH, 0xff, 0xff, 0xff]), Ok(None));
    }
}

#[test]
fn the_crc_has_the_published_check_value() {
    // CRC-16/IBM-3740 of "123456789"
    assert_eq!(crc16(b"123456789"), 0x29b1);
    assert_eq!(crc16(b""), 0xffff);
    let wire = frame(true, &[5]);
    assert!(matches!(Decoder::SERIAL.decode(&wire), Ok(Progress::Complete(_, used)) if used == wire.len()));
    for at in 5..wire.len() - 1 {
        let mut broken = wire.clone();
        broken[at] ^= 0x10;
        assert!(matches!(kind(Decoder::SERIAL.decode(&broken)), (K::Crc { .. }, end) if end == wire.len() - 3), "{at}");
    }
}

#[test]
fn arguments_are_counted_compared_and_shown() {
    let wire = frame(false, &[5, -6, 7]);
    let Ok(Progress::Complete(frame_, used)) = Decoder::TCP.decode(&wire) else { panic!("the frame is complete") };
    let args = frame_.args;
    assert_eq!((used, args.len(), args.is_empty(), Args::NONE.is_empty()), (wire.len(), 3, false, true));
    let mut iter = args.iter();
    for left in (0..3).rev() {
        assert!(iter.next().is_some());
        assert_eq!((iter.len(), iter.size_hint()), (left, (left, Some(left))));
    }
    assert_eq!((iter.next(), args.get(1), args.get(3)), (None, Some(Variant::I4(-6)), None));
    assert_eq!((args, args == Args::NONE), (args, false));
    assert_eq!(format!("{args:?}"), "[I4(5), I4(-6), I4(7)]");
    assert_eq!(format!("{:?}", args.iter()), "[I4(5), I4(-6), I4(7)]");
    assert!(format!("{frame_:?}").contains("I4(-6)"));
    assert_eq!((frame_.serial, frame_.reserved, frame_.code), (7, 9, -3));
    assert_eq!(frame_.value(), Some(Variant::I4(5)));
}

#[test]
fn a_wrong_argument_length_is_an_error_for_strict_decoders_only() {
    let lenient = Decoder::TCP.strictness(Strictness::Lenient);
    // one byte too few: the value is truncated
    let mut wire = frame(false, &[5]);
    wire[15] = 9;
    assert_eq!(kind(Decoder::TCP.decode(&wire)).1, 15 + 4 + 6, "four bytes of data, three of them present");
    assert!(lenient.decode(&wire).is_ok());
    // more bytes than the frame contains
    wire[15] = 11;
    assert_eq!(kind(Decoder::TCP.decode(&wire)), (K::Truncated { needed: 11, left: 10 }, 15));
    assert!(lenient.decode(&wire).is_ok());
    // more bytes than the value uses, none of them missing
    let mut wire = frame(false, &[5, 6]);
    (wire[13], wire[15]) = (1, 24);
    assert_eq!(kind(Decoder::TCP.decode(&wire)), (K::ArgumentLength { declared: 24, used: 10 }, 15));
    // a value of unknown type is as long as its length field says, at least as long as its head
    let mut wire = frame(false, &[5]);
    wire[19] = 99;
    for (length, good) in [(5, false), (6, true), (7, true), (10, true), (11, false)] {
        wire[15] = length;
        assert_eq!(lenient.decode(&wire).is_ok(), good, "{length}");
        assert!(Decoder::TCP.decode(&wire).is_err());
    }
}

#[test]
fn unused_bytes_are_an_error_for_strict_decoders_only() {
    let mut wire = frame(false, &[5, 6]);
    wire[13] = 1;
    assert_eq!(kind(Decoder::TCP.decode(&wire)), (K::Unused(14), 15 + 14));
    let lenient = Decoder::TCP.strictness(Strictness::Lenient);
    assert!(matches!(lenient.decode(&wire), Ok(Progress::Complete(frame, _)) if frame.args.len() == 1));
    // the same for bytes after the frame in a datagram
    let mut wire = frame(false, &[5]);
    assert!(Decoder::UDP.decode_datagram(&wire).is_ok());
    wire.push(0);
    assert_eq!(kind(Decoder::UDP.decode_datagram(&wire)), (K::Unused(1), wire.len() - 1));
    assert!(Decoder::UDP.strictness(Strictness::Lenient).decode_datagram(&wire).is_ok());
    let short = &wire[..wire.len() - 2];
    let needed = K::Incomplete { needed: 30 };
    assert_eq!(kind(Decoder::UDP.decode_datagram(short)), (needed, short.len()));
}

#[test]
fn the_number_of_arguments_is_limited_and_eot_is_checked() {
    let wire = frame(false, &[5, 6]);
    for (arguments, good) in [(1, false), (2, true), (3, true)] {
        let decoder = Decoder { limits: Limits { arguments, ..Limits::STREAM }, ..Decoder::TCP };
        assert_eq!(decoder.decode(&wire).is_ok(), good, "{arguments}");
    }
    let mut wire = wire;
    let last = wire.len() - 1;
    wire[last] = 5;
    assert_eq!(kind(Decoder::TCP.decode(&wire)), (K::Eot(5), last));
}

#[test]
fn resync_drops_bytes_up_to_a_possible_frame() {
    assert_eq!(Decoder::TCP.resync(&[]), 0);
    assert_eq!(Decoder::TCP.resync(&[SOH]), 1);
    assert_eq!(Decoder::TCP.resync(&[2, 3, SOH, 16, 0]), 2);
    assert_eq!(Decoder::TCP.resync(&[SOH, SOH, 0, 0, 0, 0, 9]), 7, "no frame has the length 0");
}

#[test]
fn a_frame_needs_exactly_its_length() {
    for crc in [false, true] {
        let wire = frame(crc, &[5]);
        for room in 0..wire.len() + 2 {
            let mut buffer = std::vec![0; room];
            let written = FrameWriter::new(&mut buffer).and_then(|writer| {
                let mut writer = writer.with_crc(crc);
                writer.argument(&5)?;
                writer.finish(7, 9, -3).map(<[u8]>::to_vec)
            });
            assert_eq!(written.ok(), (room >= wire.len()).then(|| wire.clone()), "{room}");
        }
        let mut again = wire.clone();
        renumber(&mut again, 0x1234, 0x5678, crc);
        assert_eq!(again[5..9], [0x34, 0x12, 0x78, 0x56]);
        let decoder = if crc { Decoder::SERIAL } else { Decoder::TCP };
        let Ok(Progress::Complete(found, _)) = decoder.decode(&again) else { panic!("the frame is still valid") };
        assert_eq!((found.serial, found.reserved, found.value()), (0x1234, 0x5678, Some(Variant::I4(5))));
    }
}

#[test]
fn a_lenient_frame_is_read_to_the_depth_limit_of_its_decoder() {
    let mut value = [12, 0, 1, 0, 0, 0].repeat(10);
    value.extend([17, 0, 1, 0, 0, 0, 7]);
    let mut wire = frame(false, &[]);
    wire.pop();
    wire.extend(u32::try_from(value.len()).unwrap().to_le_bytes());
    wire.extend(value);
    wire.push(EOT);
    (wire[1], wire[13]) = (u8::try_from(wire.len()).unwrap(), 1);
    let limits = Limits { depth: crate::limits::MAX_DEPTH, ..Limits::STREAM };
    let lenient = Decoder { limits, strictness: Strictness::Lenient, crc: false };
    let Ok(Progress::Complete(found, _)) = lenient.decode(&wire) else { panic!("{:?}", lenient.decode(&wire)) };
    assert_eq!(found.args.get(0).map(Variant::flatten), Some(Variant::Ui1(7)));
    assert!(lenient.decode(&wire).is_ok() && Decoder::TCP.strictness(Strictness::Lenient).decode(&wire).is_err());
}
