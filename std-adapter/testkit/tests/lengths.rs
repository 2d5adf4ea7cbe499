//! Every length and count of the wire, at every edge of 32 bits, against sums that cannot overflow.
//!
//! | field                         | edges, against the second decoder | all 2³² values, against a formula |
//! |-------------------------------|-----------------------------------|-----------------------------------|
//! | length of a frame             | yes                               | yes                               |
//! | length of an argument         | yes                               | yes                               |
//! | count of an array, each type  | yes                               | yes, one type of each width       |
//! | bytes of a string             | yes                               | yes                               |
//!
//! The second column takes minutes, so these tests are ignored: `just lengths` runs them, and the first column with
//! 32-bit addresses too, where products of lengths do not fit a `usize`.

use bcap_core::bcap::{Decoder, Progress};
use bcap_core::limits::{Limits, Strictness};
use bcap_core::variant::{MAX_EMPTY_ELEMENTS, Variant};
use bcap_testkit::frame::{TestFrame, bitwise_crc, field};
use bcap_testkit::oracle::{Oracle, Verdict};
use bcap_testkit::value::{ARRAY, VARIANT, Value};

const BOTH: [Strictness; 2] = [Strictness::Strict, Strictness::Lenient];

/// Every VARTYPE that the wire carries, except VARIANT.
const SCALARS: [u16; 16] = [0, 1, 2, 3, 4, 5, 6, 7, 8, 10, 11, 17, 18, 19, 20, 21];

/// The numbers around every power of two, around what overflows with every width of an element, and all small numbers.
fn edges() -> Vec<u32> {
    let around = |n: u64| (n.saturating_sub(2)..=n + 2).filter_map(|n| u32::try_from(n).ok());
    let powers = (0..=32).map(|bit| 1_u64 << bit);
    let quotients = (28..=35).flat_map(|bit| [1, 2, 4, 6, 8].map(|width| (1_u64 << bit) / width));
    let mut edges: Vec<u32> = powers.chain(quotients).flat_map(around).chain(0..300).collect();
    edges.sort_unstable();
    edges.dedup();
    edges
}

/// Checks that the core and the second decoder agree about a frame.
fn same_verdict(decoder: Decoder, bytes: &[u8]) {
    let Decoder { limits, strictness, crc } = decoder;
    let ours = match decoder.decode(bytes) {
        Ok(Progress::Complete(frame, used)) => Verdict::Frame(TestFrame::read(&frame), used),
        Ok(Progress::NeedMore(_)) => Verdict::Incomplete,
        Err(_) => Verdict::Refused,
    };
    assert_eq!(ours, Oracle { limits, strictness, crc }.decode(bytes), "{strictness:?} {bytes:02x?}");
}

fn same_value(strictness: Strictness, bytes: &[u8]) {
    let limits = Limits::STREAM;
    let ours = Variant::decode(bytes, &limits, strictness).ok().map(Value::read);
    assert_eq!(ours, Oracle { limits, strictness, crc: false }.decode_value(bytes), "{strictness:?} {bytes:02x?}");
}

fn with_u32(bytes: &[u8], at: usize, number: u32) -> Vec<u8> {
    let mut bytes = bytes.to_vec();
    bytes[at..at + 4].copy_from_slice(&number.to_le_bytes());
    bytes
}

#[test]
fn the_length_of_a_frame_is_right_at_every_edge() {
    let frame = TestFrame { serial: 7, reserved: 0, code: 3, args: vec![Value::I4(5), Value::text("abc")] };
    for crc in [false, true] {
        let wire = frame.to_wire(crc);
        // limits at the edges too, up to frames larger than any address space
        for limit in edges().into_iter().step_by(5).chain([wire.len() as u32, u32::MAX]) {
            for length in edges().into_iter().chain([wire.len() as u32, limit.wrapping_add(1)]) {
                for strictness in BOTH {
                    let limits = Limits { frame: limit, ..Limits::STREAM };
                    let decoder = Decoder { limits, strictness, crc };
                    let found = decoder.frame_length(&with_u32(&wire, 1, length));
                    let good = (if crc { 18 } else { 16 }..=limit).contains(&length);
                    assert_eq!(found.ok(), good.then_some(Some(length as usize)), "{length} within {limit}");
                    if limit.is_multiple_of(8) {
                        same_verdict(decoder, &with_u32(&wire, 1, length));
                    }
                }
            }
        }
    }
}

#[test]
fn the_length_of_an_argument_is_right_at_every_edge() {
    let args = vec![Value::Array(5, vec![Value::R8(0); 3]), Value::text("abc"), Value::Ui1(1)];
    let frame = TestFrame { serial: 7, reserved: 0, code: 3, args };
    let places = [15, 15 + 4 + 30, 15 + 4 + 30 + 4 + 16];
    for crc in [false, true] {
        let wire = frame.to_wire(crc);
        for place in places {
            for length in edges() {
                let mut bytes = with_u32(&wire, place, length);
                if crc {
                    let end = bytes.len() - 3;
                    let sum = bitwise_crc(&bytes[1..end]);
                    bytes[end..end + 2].copy_from_slice(&sum.to_le_bytes());
                }
                for strictness in BOTH {
                    same_verdict(Decoder { limits: Limits::STREAM, strictness, crc }, &bytes);
                }
            }
        }
    }
}

#[test]
fn the_count_of_arguments_is_right_for_every_value() {
    let frame = TestFrame { serial: 7, reserved: 0, code: 3, args: vec![Value::I4(5), Value::Ui1(1)] };
    let mut wire = frame.to_wire(false);
    for count in 0..=u16::MAX {
        wire[field::COUNT].copy_from_slice(&count.to_le_bytes());
        for strictness in BOTH {
            for arguments in [0, 1, 2, 64, u16::MAX] {
                let limits = Limits { arguments, ..Limits::STREAM };
                same_verdict(Decoder { limits, strictness, crc: false }, &wire);
            }
        }
    }
}

#[test]
fn the_count_of_an_array_is_right_at_every_edge_for_every_type() {
    for element in SCALARS.into_iter().chain([VARIANT]) {
        for data in [0, 1, 5, 6, 8, 24, 100, 255, 1600] {
            let mut bytes = (ARRAY | element).to_le_bytes().to_vec();
            bytes.extend([0; 4]);
            bytes.extend(vec![0; data]);
            for count in edges() {
                for strictness in BOTH {
                    same_value(strictness, &with_u32(&bytes, 2, count));
                }
            }
        }
    }
}

#[test]
fn the_count_of_an_array_inside_of_arrays_is_right_at_every_edge() {
    // two arrays of VARIANTs around an array of doubles, and something behind each
    let inner = Value::Array(5, vec![Value::R8(1), Value::R8(2)]);
    let middle = Value::Array(VARIANT, vec![inner, Value::Ui1(1)]);
    let bytes = Value::Array(VARIANT, vec![middle, Value::text("x")]).to_wire();
    for place in [2, 8, 14] {
        for count in edges() {
            for strictness in BOTH {
                same_value(strictness, &with_u32(&bytes, place, count));
            }
        }
    }
}

#[test]
fn the_bytes_of_a_string_are_right_at_every_edge() {
    let single = Value::text("abcd").to_wire();
    let several = Value::Array(8, vec![Value::text("ab"), Value::text("cd"), Value::text("")]).to_wire();
    for length in edges() {
        for strictness in BOTH {
            same_value(strictness, &with_u32(&single, 6, length));
            for place in [6, 14, 22] {
                same_value(strictness, &with_u32(&several, place, length));
            }
        }
    }
}

#[test]
fn the_count_of_a_scalar_is_right_at_every_edge() {
    for vartype in SCALARS.into_iter().chain([VARIANT]) {
        let mut bytes = vartype.to_le_bytes().to_vec();
        bytes.extend([0; 14]);
        for data in 6..bytes.len() {
            for count in edges() {
                for strictness in BOTH {
                    same_value(strictness, &with_u32(&bytes[..data], 2, count));
                }
            }
        }
    }
}

#[test]
#[ignore = "all 2^32 lengths: a minute of optimised code, see `just lengths`"]
fn every_length_of_a_frame_is_judged_right() {
    for (decoder, least) in [(Decoder::TCP, 16), (Decoder::UDP, 16), (Decoder::SERIAL, 18)] {
        let most = decoder.limits.frame;
        for length in 0..=u32::MAX {
            let [a, b, c, d] = length.to_le_bytes();
            let good = least <= length && length <= most;
            let found = decoder.frame_length(&[1, a, b, c, d]).ok();
            assert!(found == good.then_some(Some(length as usize)), "{length}");
        }
    }
}

#[test]
#[ignore = "all 2^32 lengths: a minute of optimised code, see `just lengths`"]
fn every_length_of_an_argument_is_judged_right() {
    let frame = TestFrame { serial: 7, reserved: 0, code: 3, args: vec![Value::I4(5)] };
    let mut wire = frame.to_wire(false);
    for length in 0..=u32::MAX {
        wire[field::ARGUMENT].copy_from_slice(&length.to_le_bytes());
        assert!(Decoder::TCP.decode(&wire).is_ok() == (length == 10), "{length}");
    }
}

#[test]
#[ignore = "all 2^32 counts of each width: minutes of optimised code, see `just lengths`"]
fn every_count_of_an_array_is_judged_right() {
    const DATA: u64 = 24;
    // type, and the bytes that an element of zeros takes
    for (element, width) in [(0, 0), (17, 1), (2, 2), (3, 4), (5, 8), (8, 4), (VARIANT, 6)] {
        let mut bytes = (ARRAY | element).to_le_bytes().to_vec();
        bytes.extend([0; 4 + DATA as usize]);
        for count in 0..=u32::MAX {
            bytes[2..6].copy_from_slice(&count.to_le_bytes());
            let needed = width * u64::from(count);
            let good = needed <= DATA && (width > 0 || count <= MAX_EMPTY_ELEMENTS);
            let found = Variant::decode(&bytes, &Limits::STREAM, Strictness::Lenient).is_ok();
            assert!(found == good, "{count} elements of type {element}");
        }
    }
}

#[test]
#[ignore = "all 2^32 lengths: a minute of optimised code, see `just lengths`"]
fn every_length_of_a_string_is_judged_right() {
    let mut bytes = Value::text("abcdef").to_wire();
    for length in 0..=u32::MAX {
        bytes[6..10].copy_from_slice(&length.to_le_bytes());
        let strict = Variant::decode(&bytes, &Limits::STREAM, Strictness::Strict).is_ok();
        let lenient = Variant::decode(&bytes, &Limits::STREAM, Strictness::Lenient).is_ok();
        assert!((strict, lenient) == (length == 12, length <= 12), "{length}");
    }
}
