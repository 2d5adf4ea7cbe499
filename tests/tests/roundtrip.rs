//! Property tests: encoded values decode to the same values, and the core agrees with the oracle on arbitrary bytes.

use bcap_core::bcap::{Decoder, FrameWriter, Progress};
use bcap_core::error::{DecodeErrorKind, EncodeError};
use bcap_core::limits::{Limits, MAX_DEPTH, Strictness};
use bcap_core::variant::{Encode, Variant, VariantBuf, Writer};
use bcap_testkit::frame::{TestFrame, bitwise_crc};
use bcap_testkit::oracle::{Oracle, Verdict};
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

fn verdict(decoder: Decoder, bytes: &[u8]) -> Verdict {
    match decoder.decode(bytes) {
        Ok(Progress::Complete(frame, used)) => Verdict::Frame(TestFrame::read(&frame), used),
        Ok(Progress::NeedMore(more)) => {
            assert!(more > bytes.len());
            Verdict::Incomplete
        }
        Err(error) => {
            assert!(error.offset <= bytes.len(), "{error:?} in {} bytes", bytes.len());
            Verdict::Refused
        }
    }
}

/// Compares the core with the oracle, and strict with lenient.
fn agree(decoder: Decoder, bytes: &[u8]) -> Verdict {
    let [strict, lenient] = BOTH.map(|strictness| {
        let ours = verdict(decoder.strictness(strictness), bytes);
        let oracle = Oracle { limits: decoder.limits, strictness, crc: decoder.crc };
        assert_eq!(ours, oracle.decode(bytes), "{strictness:?}");
        ours
    });
    if matches!(strict, Verdict::Frame(..)) {
        assert_eq!(strict, lenient, "what is strictly right is leniently the same");
    }
    lenient
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 1000, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn a_value_survives_both_ways(value in strategies::value()) {
        let wire = encoded(&value);
        prop_assert_eq!(&wire, &value.to_wire());
        for strictness in BOTH {
            let decoded = Variant::decode(&wire, &Limits::STREAM, strictness).unwrap();
            prop_assert_eq!(&Value::read(decoded), &value);
            prop_assert_eq!(decoded.vartype().0, value.vartype());
            prop_assert_eq!(&encoded(&decoded), &wire);
            prop_assert_eq!(decoded, Variant::decode(&wire, &Limits::STREAM, strictness).unwrap());
        }
        for cut in 0..wire.len() {
            prop_assert!(Variant::decode(&wire[..cut], &Limits::STREAM, Strictness::Strict).is_err());
        }
    }

    #[test]
    fn an_owned_value_is_the_same_value(value in strategies::value()) {
        let wire = value.to_wire();
        match VariantBuf::<256>::new(&value) {
            Ok(owned) => {
                prop_assert_eq!(owned.as_bytes(), &wire);
                prop_assert_eq!(&Value::read(owned.as_variant()), &value);
                let copy = VariantBuf::<256>::decode(&wire, &Limits::STREAM, Strictness::Strict).unwrap();
                prop_assert_eq!(copy, owned);
            }
            Err(error) => prop_assert!(error == EncodeError::Full && wire.len() > 256),
        }
    }

    #[test]
    fn arrays_give_their_elements_by_index_as_in_order(value in strategies::plain_array()) {
        let wire = value.to_wire();
        let array = Variant::decode(&wire, &Limits::STREAM, Strictness::Strict).unwrap().as_array().unwrap();
        prop_assert_eq!(array.iter().len(), array.len());
        for (index, element) in array.iter().enumerate() {
            prop_assert_eq!(array.get(index), Some(element));
        }
        prop_assert_eq!(array.get(array.len()), None);
    }

    #[test]
    fn a_frame_survives_both_ways(frame in strategies::frame(), crc in any::<bool>()) {
        let mut buffer = vec![0xa5; 64 * 1024];
        let mut writer = FrameWriter::new(&mut buffer).unwrap().with_crc(crc);
        for arg in &frame.args {
            writer.argument(arg).unwrap();
        }
        let wire = writer.finish(frame.serial, frame.reserved, frame.code).unwrap();
        prop_assert_eq!(wire, frame.to_wire(crc));
        let decoder = Decoder { crc, ..Decoder::TCP };
        prop_assert_eq!(agree(decoder, wire), Verdict::Frame(frame, wire.len()));
        for cut in 0..wire.len() {
            prop_assert_eq!(verdict(decoder, &wire[..cut]), Verdict::Incomplete);
        }
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
    fn damaged_frames_are_taken_as_the_oracle_takes_them(wire in strategies::damaged_frame()) {
        agree(Decoder::TCP, &wire);
    }

    #[test]
    fn damaged_frames_with_a_corrected_crc(wire in strategies::damaged_frame()) {
        let mut wire = wire;
        let Some(covered) = wire.len().checked_sub(3).filter(|end| *end >= 15) else { return Ok(()) };
        let crc = bitwise_crc(&wire[1..covered]);
        wire[covered..covered + 2].copy_from_slice(&crc.to_le_bytes());
        agree(Decoder { limits: Limits::STREAM, ..Decoder::SERIAL }, &wire);
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
    fn random_bytes_are_taken_as_the_oracle_takes_them(mut bytes in prop::collection::vec(any::<u8>(), 0..80)) {
        agree(Decoder::TCP, &bytes);
        for strictness in BOTH {
            let oracle = Oracle { limits: Limits::STREAM, strictness, crc: false };
            let ours = Variant::decode(&bytes, &Limits::STREAM, strictness).ok().map(Value::read);
            prop_assert_eq!(ours, oracle.decode_value(&bytes));
        }
        // the same behind a header that is right
        if bytes.len() >= 16 {
            let length = (bytes.len() as u32).to_le_bytes();
            bytes[0] = 1;
            bytes[1..5].copy_from_slice(&length);
            bytes[13..15].copy_from_slice(&[1, 0]);
            *bytes.last_mut().unwrap() = 4;
            agree(Decoder::TCP, &bytes);
        }
    }

    #[test]
    fn resynchronising_always_gets_on(bytes in prop::collection::vec(prop_oneof![Just(1_u8), Just(0), any::<u8>()], 0..80)) {
        let drop = Decoder::UDP.resync(&bytes);
        prop_assert!(drop <= bytes.len() && (drop > 0 || bytes.is_empty()));
        prop_assert!(Decoder::UDP.decode(&bytes[drop..]).is_ok() || Decoder::UDP.frame_length(&bytes[drop..]).is_ok());
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
