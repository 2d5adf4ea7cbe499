//! Fuzzes round trips of generated values.

use std::fmt::Write as _;

use arbitrary::Unstructured;
use bcap_core::bcap::{Decoder, FrameWriter, Progress};
use bcap_core::error::EncodeError;
use bcap_core::limits::{Limits, MAX_DEPTH, Strictness};
use bcap_core::variant::{Encode as _, Variant, VariantBuf, Writer};
use bcap_testkit::frame::TestFrame;
use bcap_testkit::text;
use bcap_testkit::value::Value;

use crate::input::BOTH;
use crate::text::Owned;

const DEEPEST: Limits = Limits { depth: MAX_DEPTH, ..Limits::STREAM };

/// Generates a frame of values, encodes it and decodes it.
///
/// # Panics
///
/// When an assertion about the core fails.
pub fn roundtrip_binary(data: &[u8]) {
    let mut u = Unstructured::new(data);
    let Ok((crc, serial, reserved, code)) = u.arbitrary::<(bool, u16, u16, i32)>() else { return };
    let mut args = Vec::new();
    while let (true, Ok(value)) = (args.len() < 8 && !u.is_empty(), u.arbitrary()) {
        args.push(value);
    }
    frame_there_and_back(&TestFrame { serial, reserved, code, args }, crc);
}

/// Encodes a frame and its values with the core and with the oracle, and decodes them.
///
/// # Panics
///
/// When an assertion about the core fails.
pub fn frame_there_and_back(frame: &TestFrame, crc: bool) {
    let TestFrame { serial, reserved, code, .. } = *frame;
    frame.args.iter().for_each(value_there_and_back);
    let expected = frame.to_wire(crc);
    let mut buffer = vec![0xa5; expected.len()];
    let mut writer = FrameWriter::new(&mut buffer).expect("room for a frame").with_crc(crc);
    for arg in &frame.args {
        writer.argument(arg).expect("the frame fits");
    }
    let wire = writer.finish(serial, reserved, code).expect("the frame fits");
    assert_eq!(wire, expected);
    for strictness in BOTH {
        let decoder = Decoder { limits: DEEPEST, strictness, crc };
        let Ok(Progress::Complete(decoded, used)) = decoder.decode(wire) else { panic!("{:?}", decoder.decode(wire)) };
        assert_eq!((TestFrame::read(&decoded), used), (frame.clone(), wire.len()));
        let cut = usize::from(serial) % wire.len();
        assert!(matches!(decoder.decode(&wire[..cut]), Ok(Progress::NeedMore(_))));
    }
    // with one byte less the frame does not fit
    let less = buffer.len() - 1;
    let refused = FrameWriter::new(&mut buffer[..less]).and_then(|writer| {
        let mut writer = writer.with_crc(crc);
        frame.args.iter().try_for_each(|arg| writer.argument(arg))?;
        writer.finish(serial, reserved, code).map(<[u8]>::len)
    });
    assert!(refused.is_err());
}

fn value_there_and_back(value: &Value) {
    let wire = value.to_wire();
    let mut buffer = vec![0xa5; wire.len()];
    let mut out = Writer::new(&mut buffer);
    value.encode(&mut out).expect("it fits");
    assert_eq!(out.as_bytes(), wire);
    for strictness in BOTH {
        let decoded = Variant::decode(&wire, &DEEPEST, strictness).expect("the encoding is canonical");
        assert_eq!(&Value::read(decoded), value);
        assert_eq!(decoded.vartype().0, value.vartype());
    }
    match VariantBuf::<256>::new(value) {
        Ok(owned) => assert_eq!(owned.as_bytes(), wire),
        Err(error) => assert!(error == EncodeError::Full && wire.len() > 256),
    }
}

/// Generates a value and checks that its text parses to the same; or generates the text of a float and checks that it
/// parses as in the standard library.
///
/// # Panics
///
/// When an assertion about the core fails.
pub fn roundtrip_text(data: &[u8]) {
    let mut u = Unstructured::new(data);
    match u.arbitrary::<u8>() {
        Ok(0..128) => {
            while let (false, Ok(value)) = (u.is_empty(), u.arbitrary()) {
                text_there_and_back(&value);
            }
        }
        Ok(kind) => while let (false, Ok(())) = (u.is_empty(), float_text(kind, &mut u)) {},
        Err(_) => {}
    }
}

/// Prints a value as text and parses the text with the core and with the oracle.
///
/// # Panics
///
/// When an assertion about the core fails.
pub fn text_there_and_back(value: &Value) {
    let wire = value.to_wire();
    if wire.len() > 4096 {
        return;
    }
    let variant = Variant::decode(&wire, &DEEPEST, Strictness::Strict).expect("the encoding is canonical");
    let mut buffer = vec![0; 64 * 1024];
    match variant.to_text(&mut buffer) {
        Ok(text) => {
            assert!(text::has_text(value), "{text}");
            let again = Owned::parse_text(text.as_bytes()).unwrap_or_else(|e| panic!("{e} in {text}"));
            assert_eq!(&Value::read(again.as_variant()), value, "{text}");
            assert_eq!(text::parse(text.as_bytes()).as_ref(), Some(value), "{text}");
            let less = text.len() - 1;
            assert!(variant.to_text(&mut buffer[..less]).is_err());
        }
        Err(error) => {
            assert!(!text::has_text(value), "{value:?}: {error}");
            assert_eq!(error.column, 0);
        }
    }
}

/// Generates the text of a number: a float's digits, or the midpoint to its neighbour, cut or extended; or any digits.
fn float_text(kind: u8, u: &mut Unstructured<'_>) -> arbitrary::Result<()> {
    let mut text = String::new();
    match kind % 4 {
        0 => {
            let (mantissa, exponent): (u64, i16) = (u.arbitrary()?, u.arbitrary()?);
            let _ = write!(text, "{mantissa}e{}", exponent % 400);
        }
        1 => {
            let number = f64::from_bits(u.arbitrary()?).abs();
            let digits = usize::from(u.arbitrary::<u8>()? % 40);
            let _ = write!(text, "{number:.digits$e}");
        }
        2 => {
            // the midpoint of two singles or doubles is exact in the next wider type
            let bits: u32 = u.arbitrary()?;
            let (low, high) = (f64::from(f32::from_bits(bits)), f64::from(f32::from_bits(bits.wrapping_add(1))));
            let middle = (low + high).abs() / 2.0;
            let digits = usize::from(u.arbitrary::<u8>()?);
            let _ = write!(text, "{middle:.digits$e}");
        }
        _ => {
            let (front, back, exponent): (u16, u16, i16) = (u.arbitrary()?, u.arbitrary()?, u.arbitrary()?);
            for (index, count) in [front % 500, back % 500].into_iter().enumerate() {
                let pattern: u32 = u.arbitrary()?;
                let digits = format!("{pattern}{}", u.arbitrary::<u32>()?);
                text.extend(digits.chars().cycle().take(usize::from(count)));
                if index == 0 {
                    text.push('.');
                }
            }
            let _ = write!(text, "e{}", exponent % 1200);
        }
    }
    for vartype in [4, 5] {
        let text = format!("{vartype},{text}");
        let ours = Owned::parse_text(text.as_bytes()).ok().map(|value| Value::read(value.as_variant()));
        assert_eq!(ours, text::parse(text.as_bytes()), "{text}");
    }
    Ok(())
}
