//! Property tests: encoded values decode to the same values, and the core agrees with the oracle on arbitrary bytes.

use bcap_core::bcap::{Decoder, FrameWriter, Progress};
use bcap_core::error::{DecodeErrorKind, EncodeError};
use bcap_core::limits::{Limits, MAX_DEPTH, Strictness};
use bcap_core::variant::{Encode, Variant, Writer};
use bcap_testkit::strategies;
use bcap_testkit::value::{VARIANT, Value};
use proptest::prelude::*;

const BOTH: [Strictness; 2] = [Strictness::Strict, Strictness::Lenient];

fn encoded(value: &(impl Encode + ?Sized)) -> Vec<u8> {
    let mut buffer = vec![0xa5; 64 * 1024];
    let mut out = Writer::new(&mut buffer);
    value.encode(&mut out).unwrap();
    out.as_bytes().to_vec()
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 1000, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn a_frame_survives_both_ways(frame in strategies::frame(), crc in any::<bool>()) {
        bcap_fuzz::frame_there_and_back(&frame, crc);
    }

    #[test]
    fn a_value_is_the_same_for_the_oracle(value in prop_oneof![strategies::value(), strategies::plain_array()], depth in any::<u8>()) {
        let bytes = [vec![depth], value.to_wire()].concat();
        bcap_fuzz::variant(&bytes);
        for cut in 1..bytes.len() {
            prop_assert_eq!(bcap_fuzz::judge_value(&Limits::STREAM, Strictness::Strict, &bytes[1..cut]), None);
        }
    }

    #[test]
    fn damaged_frames_are_taken_as_the_oracle_takes_them(wire in strategies::damaged_frame()) {
        // with and without a CRC, small limits, corrected lengths and sums
        for options in 0..8 {
            bcap_fuzz::frame(&[vec![options], wire.clone()].concat());
        }
    }

    #[test]
    fn random_bytes_are_taken_as_the_oracle_takes_them(bytes in prop::collection::vec(prop_oneof![Just(1_u8), any::<u8>()], 0..80)) {
        for options in 0..8 {
            bcap_fuzz::frame(&[vec![options], bytes.clone()].concat());
        }
        bcap_fuzz::variant(&bytes);
    }

    #[test]
    fn a_frame_that_does_not_fit_is_refused_and_nothing_lies_behind(frame in strategies::frame(), room in 0_usize..200) {
        let wire = frame.to_wire(false);
        let mut buffer = [0xa5; 256];
        let written = FrameWriter::new(&mut buffer[..room]).and_then(|mut writer| {
            frame.args.iter().try_for_each(|arg| writer.argument(arg))?;
            writer.finish(frame.serial, frame.reserved, frame.code).map(<[u8]>::to_vec)
        });
        if room >= wire.len() {
            prop_assert_eq!(written, Ok(wire));
        } else {
            prop_assert_eq!(written, Err(EncodeError::Full));
        }
        prop_assert!(buffer[room..].iter().all(|byte| *byte == 0xa5));
    }

    #[test]
    fn what_a_lenient_decoder_takes_is_sent_canonically(wire in strategies::damaged_frame()) {
        let decoder = Decoder::TCP.strictness(Strictness::Lenient);
        let Ok(Progress::Complete(frame, _)) = decoder.decode(&wire) else { return Ok(()) };
        for value in frame.args {
            if let Variant::Opaque(opaque) = value {
                let mut out = [0; 512];
                prop_assert_eq!(value.encode(&mut Writer::new(&mut out)), Err(EncodeError::Unsendable(opaque.vartype.0)));
                continue;
            }
            let (wire, read) = (encoded(&value), Value::read(value));
            prop_assert_eq!(&wire, &read.to_wire());
            let strict = Variant::decode(&wire, &Limits::STREAM, Strictness::Strict).unwrap();
            prop_assert_eq!(Value::read(strict), read);
        }
    }

    #[test]
    fn the_limits_hold(value in strategies::value(), depth in 0_u8..=MAX_DEPTH) {
        let wire = value.to_wire();
        let limits = Limits { depth, ..Limits::STREAM };
        let decoded = Variant::decode(&wire, &limits, Strictness::Strict);
        if value.depth() <= usize::from(depth) {
            prop_assert_eq!(Value::read(decoded.unwrap()), value);
        } else {
            prop_assert_eq!(decoded.unwrap_err().kind, DecodeErrorKind::TooDeep(depth));
        }
    }
}

/// Wraps a number in `levels` VARIANTs.
fn nested(levels: usize) -> Value {
    (0..levels).fold(Value::I4(1), |value, level| {
        if level % 2 == 0 { Value::Array(VARIANT, vec![value]) } else { Value::Nested(Box::new(value)) }
    })
}

#[test]
fn nesting_is_limited_before_the_stack_overflows() {
    let deepest = Limits { depth: u8::MAX, ..Limits::STREAM };
    for levels in 0..=usize::from(MAX_DEPTH) {
        let wire = nested(levels).to_wire();
        let value = Variant::decode(&wire, &deepest, Strictness::Strict).unwrap();
        assert_eq!(Value::read(value), nested(levels));
        assert_eq!(encoded(&value), wire);
    }
    // built flat: the tests' own encoder recurses
    for levels in [18, 100, 100_000, 2_000_000] {
        let wire: Vec<u8> = [0x0c, 0x20, 1, 0, 0, 0].into_iter().cycle().take(6 * levels).collect();
        for strictness in BOTH {
            let error = Variant::decode(&wire, &deepest, strictness).unwrap_err();
            assert_eq!((error.kind, error.offset), (DecodeErrorKind::TooDeep(MAX_DEPTH), 96));
        }
    }
}

#[test]
fn claims_cost_nothing() {
    // each claims elements by the billion in a few bytes, as the hostile list of the vendor's server has them
    for vartype in [2_u16, 3, 4, 5, 6, 7, 8, 10, 11, 12, 17, 18, 19, 20, 21, 0, 1] {
        for count in [u32::MAX, 0x2000_0001, 0x1000_0000, 0x0aaa_aaab, 0x8000_0000] {
            let mut wire = (0x2000 | vartype).to_le_bytes().to_vec();
            wire.extend(count.to_le_bytes());
            wire.extend([0; 64]);
            for strictness in BOTH {
                let error = Variant::decode(&wire, &Limits::STREAM, strictness).unwrap_err();
                assert_eq!(error.kind, DecodeErrorKind::ArrayCount(count), "{vartype}");
            }
        }
    }
    let string = [&[8, 0, 1, 0, 0, 0][..], &0xffff_fffe_u32.to_le_bytes(), &[0; 64]].concat();
    let error = Variant::decode(&string, &Limits::STREAM, Strictness::Strict).unwrap_err();
    assert_eq!(error.kind, DecodeErrorKind::Truncated { needed: 0xffff_fffe, left: 64 });
}
