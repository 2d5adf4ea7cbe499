extern crate std;

use std::format;
use std::string::ToString;
use std::vec::Vec;

use super::*;
use crate::error::EncodeError;

fn bytes(value: &(impl Encode + ?Sized)) -> Vec<u8> {
    let mut buffer = [0xa5; 512];
    let mut out = Writer::new(&mut buffer);
    value.encode(&mut out).unwrap();
    out.as_bytes().to_vec()
}

fn strict(bytes: &[u8]) -> Result<Variant<'_>, DecodeError> {
    Variant::decode(bytes, &Limits::STREAM, Strictness::Strict)
}

fn lenient(bytes: &[u8]) -> Result<Variant<'_>, DecodeError> {
    Variant::decode(bytes, &Limits::STREAM, Strictness::Lenient)
}

fn refused(bytes: &[u8]) -> (DecodeErrorKind, usize) {
    let error = strict(bytes).unwrap_err();
    assert_eq!(error.layer, Layer::Value);
    (error.kind, error.offset)
}

#[test]
fn every_scalar_is_its_bytes_both_ways() {
    let text = "Sämple".encode_utf16().flat_map(u16::to_le_bytes).collect::<Vec<_>>();
    let cases: &[(Variant<'_>, &[u8])] = &[
        (Variant::Empty, &[0, 0, 1, 0, 0, 0]),
        (Variant::Null, &[1, 0, 1, 0, 0, 0]),
        (Variant::I2(-2), &[2, 0, 1, 0, 0, 0, 0xfe, 0xff]),
        (Variant::I4(0x0102_0304), &[3, 0, 1, 0, 0, 0, 4, 3, 2, 1]),
        (Variant::R4(1.0), &[4, 0, 1, 0, 0, 0, 0, 0, 0x80, 0x3f]),
        (Variant::R8(-2.0), &[5, 0, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0xc0]),
        (Variant::Cy(Currency::from_raw(10_000)), &[6, 0, 1, 0, 0, 0, 0x10, 0x27, 0, 0, 0, 0, 0, 0]),
        (Variant::Date(OleDate::from_raw(2.0)), &[7, 0, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0x40]),
        (
            Variant::Bstr(Bstr::from_utf16le(&text).unwrap()),
            &[8, 0, 1, 0, 0, 0, 12, 0, 0, 0, b'S', 0, 0xe4, 0, b'm', 0, b'p', 0, b'l', 0, b'e', 0],
        ),
        (Variant::Error(HResult::E_FAIL), &[10, 0, 1, 0, 0, 0, 5, 0x40, 0, 0x80]),
        (Variant::Bool(true), &[11, 0, 1, 0, 0, 0, 0xff, 0xff]),
        (Variant::Ui1(200), &[17, 0, 1, 0, 0, 0, 200]),
        (Variant::Ui2(0xfffe), &[18, 0, 1, 0, 0, 0, 0xfe, 0xff]),
        (Variant::Ui4(0xffff_fffe), &[19, 0, 1, 0, 0, 0, 0xfe, 0xff, 0xff, 0xff]),
        (Variant::I8(-1), &[20, 0, 1, 0, 0, 0, 255, 255, 255, 255, 255, 255, 255, 255]),
        (Variant::Ui8(1), &[21, 0, 1, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0, 0]),
    ];
    for (value, wire) in cases {
        assert_eq!(bytes(value), *wire, "{value:?}");
        assert_eq!(strict(wire).unwrap(), *value);
        for cut in 0..wire.len() {
            assert!(
                matches!(strict(&wire[..cut]).unwrap_err().kind, DecodeErrorKind::Truncated { .. }),
                "{value:?} {cut}"
            );
        }
    }
}

#[test]
fn arrays_of_every_type_come_back() {
    fn check<T: Element + Scalar + PartialEq + core::fmt::Debug>(values: [T; 3]) {
        let wire = bytes(&values);
        let array = strict(&wire).unwrap().as_array().unwrap();
        assert_eq!((array.element(), array.len()), (<T as Scalar>::TYPE, 3));
        assert_eq!(array.items::<T>().unwrap().to_array(), Some(values));
        assert_eq!(array.iter().count(), 3);
        assert_eq!(array.get(2), array.iter().last());
        assert_eq!(array.get(3), None);
        assert_eq!(bytes(&array), wire);
    }
    check([1_i16, -2, 3]);
    check([1_i32, -2, 3]);
    check([1_i64, -2, 3]);
    check([1_u8, 2, 255]);
    check([1_u16, 2, 3]);
    check([1_u32, 2, 3]);
    check([1_u64, 2, 3]);
    check([1.0_f32, f32::MIN, 3.5]);
    check([1.0_f64, f64::MAX, -0.0]);
    check([true, false, true]);
    check([Currency::from_raw(-1); 3]);
    check([OleDate::from_raw(-1.5); 3]);
    check([HResult::S_OK, HResult::E_FAIL, HResult(7)]);
}

#[test]
fn strings_and_mixed_arrays_nest() {
    let names = ["a", "", "naïve 😀"];
    let wire = bytes(&(1_i32, names, (true, ()), "x"));
    let outer = strict(&wire).unwrap().as_array().unwrap();
    assert_eq!(outer.element(), VarType::VARIANT);
    assert_eq!(outer.get(0), Some(Variant::I4(1)));
    let inner = outer.get(1).and_then(|v| v.as_array()).unwrap();
    assert!(inner.strings().unwrap().zip(names).all(|(ours, theirs)| ours == theirs));
    assert_eq!(
        format!("{outer:?}"),
        "VARIANT[I4(1), BSTR[\"a\", \"\", \"naïve 😀\"], VARIANT[BOOL(true), EMPTY], \"x\"]"
    );
    assert_eq!(bytes(&outer), wire);
    assert_eq!(outer.get(4), None);
}

#[test]
fn a_scalar_variant_holds_one_value() {
    let wire = [12, 0, 1, 0, 0, 0, 12, 0, 1, 0, 0, 0, 2, 0, 1, 0, 0, 0, 100, 0];
    let value = strict(&wire).unwrap();
    assert_eq!(value.vartype(), VarType::VARIANT);
    assert_eq!(value.flatten(), Variant::I2(100));
    assert_eq!(bytes(&value), wire);
    assert_eq!(format!("{value:?}"), "VARIANT(VARIANT(I2(100)))");
}

#[test]
fn what_comes_behind_a_scalar_variant_in_an_array_is_found() {
    let seven = [3, 0, 1, 0, 0, 0, 7, 0, 0, 0];
    let wire = [&[12, 0x20, 2, 0, 0, 0, 12, 0, 1, 0, 0, 0][..], &seven, &[2, 0, 1, 0, 0, 0, 8, 0]].concat();
    let mut elements = strict(&wire).unwrap().as_array().unwrap().iter();
    let Some(Variant::Nested(inner)) = elements.next() else { panic!("a VARIANT comes first") };
    assert_eq!((inner.value(), elements.next(), elements.next()), (Variant::I4(7), Some(Variant::I2(8)), None));
}

#[test]
fn depth_is_counted_and_limited() {
    // eight arrays of one VARIANT around an EMPTY
    let mut wire = Vec::new();
    for _ in 0..8 {
        wire.extend([12, 0x20, 1, 0, 0, 0]);
    }
    wire.extend([0, 0, 1, 0, 0, 0]);
    assert!(strict(&wire).is_ok());
    let mut deeper = [12, 0x20, 1, 0, 0, 0].to_vec();
    deeper.extend(&wire);
    assert_eq!(refused(&deeper), (DecodeErrorKind::TooDeep(8), 48));
    let deepest = Limits { depth: 200, ..Limits::STREAM };
    let mut over = [12, 0x20, 1, 0, 0, 0].repeat(usize::from(MAX_DEPTH) + 1);
    over.extend([0, 0, 1, 0, 0, 0]);
    let error = Variant::decode(&over, &deepest, Strictness::Strict).unwrap_err();
    assert_eq!(error.kind, DecodeErrorKind::TooDeep(MAX_DEPTH));
    assert!(Variant::decode(&over[6..], &deepest, Strictness::Strict).is_ok());
    let none = Limits { depth: 0, ..Limits::STREAM };
    assert_eq!(Variant::decode(&wire, &none, Strictness::Strict).unwrap_err().kind, DecodeErrorKind::TooDeep(0));
}

#[test]
fn siblings_after_a_deep_element_are_still_checked() {
    let value = bytes(&(((1_i32,), (2_i32, 3_i32)), 4_i32));
    let array = strict(&value).unwrap().as_array().unwrap();
    assert_eq!(array.get(1), Some(Variant::I4(4)));
    let mut broken = value.clone();
    let at = broken.len() - 10;
    broken[at] = 99;
    assert_eq!(refused(&broken), (DecodeErrorKind::UnknownType(99), at));
}

#[test]
fn claims_beyond_the_bytes_are_refused_at_once() {
    let cases: &[(&[u8], DecodeErrorKind, usize)] = &[
        (&[5, 0x20, 1, 0, 0, 0x20, 0, 0], DecodeErrorKind::ArrayCount(0x2000_0001), 2),
        (&[17, 0x20, 0xff, 0xff, 0xff, 0xff], DecodeErrorKind::ArrayCount(u32::MAX), 2),
        (&[8, 0x20, 2, 0, 0, 0, 0, 0, 0, 0], DecodeErrorKind::ArrayCount(2), 2),
        (&[12, 0x20, 0xab, 0xaa, 0xaa, 0x0a, 0, 0], DecodeErrorKind::ArrayCount(0x0aaa_aaab), 2),
        (&[0, 0x20, 1, 1, 0, 0], DecodeErrorKind::ArrayCount(257), 2),
        (
            &[8, 0, 1, 0, 0, 0, 0xfe, 0xff, 0xff, 0xff, 0, 0],
            DecodeErrorKind::Truncated { needed: 0xffff_fffe, left: 2 },
            10,
        ),
        (&[8, 0, 1, 0, 0, 0, 3, 0, 0, 0, 65, 0, 66], DecodeErrorKind::OddBstr(3), 6),
        (&[3, 0, 2, 0, 0, 0, 1, 0, 0, 0], DecodeErrorKind::ScalarCount(2), 2),
        (&[0, 0, 0, 0, 0, 0], DecodeErrorKind::ScalarCount(0), 2),
        (&[16, 0, 1, 0, 0, 0, 1], DecodeErrorKind::UnknownType(16), 0),
        (&[3, 0x40, 1, 0, 0, 0, 1, 0, 0, 0], DecodeErrorKind::UnknownType(0x4003), 0),
        (&[2, 0, 1, 0, 0, 0, 1, 0, 9], DecodeErrorKind::Unused(1), 8),
    ];
    for (wire, kind, offset) in cases {
        assert_eq!(refused(wire), (*kind, *offset), "{wire:?}");
    }
    assert!(strict(&[0, 0x20, 0, 1, 0, 0]).is_ok());
}

#[test]
fn lenient_takes_what_peers_leave_and_sends_it_canonical() {
    let cases: &[(&[u8], &[u8])] = &[
        (&[3, 0, 5, 0, 0, 0, 1, 0, 0, 0], &[3, 0, 1, 0, 0, 0, 1, 0, 0, 0]),
        (&[3, 0, 0, 0, 0, 0, 1, 0, 0, 0, 9, 9], &[3, 0, 1, 0, 0, 0, 1, 0, 0, 0]),
        (&[8, 0, 1, 0, 0, 0, 3, 0, 0, 0, 65, 0, 66], &[8, 0, 1, 0, 0, 0, 2, 0, 0, 0, 65, 0]),
        (&[11, 0x20, 2, 0, 0, 0, 1, 0, 0, 0], &[11, 0x20, 2, 0, 0, 0, 0xff, 0xff, 0, 0]),
        (
            &[12, 0x20, 2, 0, 0, 0, 2, 0, 7, 0, 0, 0, 1, 0, 0, 0, 9, 0, 0, 0],
            &[12, 0x20, 2, 0, 0, 0, 2, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0],
        ),
    ];
    for (wire, canonical) in cases {
        let value = lenient(wire).unwrap();
        assert_eq!(bytes(&value), *canonical, "{wire:?}");
        assert_eq!(strict(canonical).unwrap(), value);
    }
}

#[test]
fn a_buffer_too_short_is_an_error_and_no_panic() {
    let value = (1_i32, "abc", [1.0_f64, 2.0]);
    let whole = bytes(&value).len();
    for room in 0..whole {
        let mut buffer = std::vec![0; room];
        assert_eq!(value.encode(&mut Writer::new(&mut buffer)), Err(EncodeError::Full));
    }
}

#[test]
fn owned_values_keep_their_encoding() {
    let mut value = VariantBuf::<32>::default();
    assert_eq!(value.as_variant(), Variant::Empty);
    assert_eq!(bytes(&value), [0, 0, 1, 0, 0, 0]);
    value.set(&[1_i16, 2]).unwrap();
    assert_eq!(value.set("a string of more than the room"), Err(EncodeError::Full));
    assert_eq!(value.as_variant().as_array().unwrap().len(), 2);
    assert_eq!(value, VariantBuf::<10>::new(&[1_i16, 2]).unwrap());
    assert_ne!(value, VariantBuf::<10>::new(&[1_i16, 3]).unwrap());
    assert_eq!(format!("{value:?}"), "I2[1, 2]");
    let decoded =
        VariantBuf::<16>::decode(&[3, 0, 9, 0, 0, 0, 1, 0, 0, 0], &Limits::STREAM, Strictness::Lenient).unwrap();
    assert_eq!(decoded.as_bytes(), [3, 0, 1, 0, 0, 0, 1, 0, 0, 0]);
}

#[test]
fn values_deeper_than_any_decoder_takes_are_not_built() {
    struct Deep(u8);
    impl Encode for Deep {
        fn encode(&self, out: &mut Writer<'_>) -> Result<(), EncodeError> {
            for _ in 0..self.0 {
                out.put([12, 0x20, 1, 0, 0, 0])?;
            }
            ().encode(out)
        }
    }
    assert!(VariantBuf::<128>::new(&Deep(MAX_DEPTH)).is_ok());
    assert_eq!(VariantBuf::<128>::new(&Deep(MAX_DEPTH + 1)), Err(EncodeError::TooDeep));
}

#[test]
fn types_have_names() {
    assert_eq!(VarType(0x2005).to_string(), "VT_ARRAY|VT_R8");
    assert_eq!(VarType(8).to_string(), "VT_BSTR");
    assert_eq!(VarType(9).to_string(), "VarType(0x0009)");
    assert_eq!(VarType(0x4003).to_string(), "VarType(0x4003)");
}

#[test]
fn views_are_sent_on_as_elements() {
    let wire = bytes(&[Variant::I2(7), Variant::Bool(true)]);
    assert_eq!(wire, [12, 0x20, 2, 0, 0, 0, 2, 0, 1, 0, 0, 0, 7, 0, 11, 0, 1, 0, 0, 0, 0xff, 0xff]);
}

#[test]
fn a_type_and_that_of_its_arrays_belong_together() {
    for (scalar, array) in [(VarType(3), VarType(0x2003)), (VarType::VARIANT, VarType(0x200c))] {
        assert_eq!((scalar.array_of(), array.array_of()), (array, array));
        assert_eq!((scalar.element(), array.element()), (scalar, scalar));
        assert_eq!((scalar.is_array(), array.is_array()), (false, true));
    }
}

#[test]
fn views_of_arrays_say_what_is_in_them() {
    let numbers = bytes(&[1_i32, 2, 3]);
    let Some(array) = strict(&numbers).unwrap().as_array() else { panic!("no array") };
    let items = array.items::<i32>().unwrap();
    let mut target = [9; 4];
    assert_eq!((items.copy_to(&mut target), target), (Some(3), [1, 2, 3, 9]));
    assert_eq!(items.copy_to(&mut target[..2]), None);
    assert_eq!((items.get(0), items.get(2), items.get(3)), (Some(1), Some(3), None));
    assert_eq!((array.get(2), array.get(3)), (Some(Variant::I4(3)), None));
    assert!(!items.is_empty());
    let none = bytes(&[0_i32; 0]);
    assert!(strict(&none).unwrap().as_array().unwrap().items::<i32>().unwrap().is_empty());

    // equal are arrays of the same type and length with the same elements
    let others = [bytes(&[1_i32, 2]), bytes(&[1_i32, 2, 4]), bytes(&[1_i16, 2, 3]), none];
    for other in &others {
        assert_ne!(array, strict(other).unwrap().as_array().unwrap(), "{other:?}");
    }
    assert_eq!(array, strict(&numbers).unwrap().as_array().unwrap());

    assert_eq!(format!("{array:?}"), "I4[1, 2, 3]");
    assert_eq!(format!("{items:?}"), "[1, 2, 3]");
    let mixed = bytes(&(1_i32, "a", 2.5_f64));
    assert_eq!(format!("{:?}", strict(&mixed).unwrap().as_array().unwrap()), "VARIANT[I4(1), \"a\", R8(2.5)]");
}

#[test]
fn why_there_is_no_owned_value_is_told() {
    let encode = VariantBufError::Encode(EncodeError::Full);
    assert_eq!(encode.to_string(), EncodeError::Full.to_string());
    let decode = VariantBuf::<8>::decode(&[99, 0, 1, 0, 0, 0], &Limits::STREAM, Strictness::Strict).unwrap_err();
    let VariantBufError::Decode(error) = decode else { panic!("{decode}") };
    assert_eq!(decode.to_string(), error.to_string());
    assert!(!encode.to_string().is_empty() && !decode.to_string().is_empty());
}

#[test]
fn a_value_equals_itself_and_no_other() {
    let encoded: [Vec<u8>; 28] = [
        bytes(&()),
        bytes(&Null),
        bytes(&1_i16),
        bytes(&2_i16),
        bytes(&1_i32),
        bytes(&1_i64),
        bytes(&1_u8),
        bytes(&1_u16),
        bytes(&1_u32),
        bytes(&1_u64),
        bytes(&u64::MAX),
        bytes(&(u64::MAX - 1)),
        bytes(&0.0_f32),
        bytes(&-0.0_f32),
        bytes(&0.0_f64),
        bytes(&f64::NAN),
        bytes(&Currency::from_raw(1)),
        bytes(&Currency::from_raw(2)),
        bytes(&OleDate::from_raw(1.0)),
        bytes(&OleDate::from_raw(2.0)),
        bytes("1"),
        bytes("2"),
        bytes(&HResult(1)),
        bytes(&HResult(2)),
        bytes(&true),
        bytes(&false),
        bytes(&[1_i16][..]),
        bytes(&(1_i16, 1_i32)),
    ];
    let nested = |value: &[u8]| [&[12, 0, 1, 0, 0, 0], value].concat();
    let unknown = |last| Variant::Opaque(Opaque { vartype: VarType(99), bytes: if last { &[1] } else { &[0] } });
    let nested: Vec<_> = encoded[2..4].iter().map(|value| nested(value)).collect();
    let mut values: Vec<_> = encoded.iter().chain(&nested).map(|value| strict(value).unwrap()).collect();
    values.extend([unknown(true), unknown(false)]);
    for (i, one) in values.iter().enumerate() {
        for (j, other) in values.iter().enumerate() {
            assert_eq!(one == other, i == j, "{one:?} and {other:?}");
        }
    }
}

#[test]
fn numbers_convert_where_nothing_is_lost() {
    let whole = [
        Variant::I2(7),
        Variant::I4(7),
        Variant::I8(7),
        Variant::Ui1(7),
        Variant::Ui2(7),
        Variant::Ui4(7),
        Variant::Ui8(7),
    ];
    for value in whole {
        assert_eq!((value.as_i64(), value.as_i32(), value.as_bool()), (Some(7), Some(7), Some(true)), "{value:?}");
        assert_eq!(value.as_f64(), Some(7.0), "{value:?}");
        assert!(!value.is_empty());
    }
    assert_eq!(Variant::I4(-1).as_i32(), Some(-1));
    assert_eq!(Variant::Ui4(u32::MAX).as_f64(), Some(4_294_967_295.0));
    assert_eq!((Variant::Ui4(u32::MAX).as_i32(), Variant::Ui4(u32::MAX).as_i64()), (None, Some(4_294_967_295)));
    assert_eq!((Variant::Ui8(u64::MAX).as_i64(), Variant::Ui8(u64::MAX).as_bool()), (None, Some(true)));
    assert_eq!((Variant::Ui8(0).as_bool(), Variant::I2(0).as_bool()), (Some(false), Some(false)));
    assert_eq!((Variant::R4(2.5).as_f64(), Variant::R8(-2.5).as_f64()), (Some(2.5), Some(-2.5)));
    assert_eq!((Variant::R8(2.0).as_i32(), Variant::R8(2.0).as_i64(), Variant::R8(2.0).as_bool()), (None, None, None));
    assert_eq!((Variant::Bool(true).as_bool(), Variant::Bool(true).as_i32()), (Some(true), None));
    assert_eq!((Variant::Bool(false).as_bool(), Variant::Bool(true).as_f64()), (Some(false), None));
    assert!(Variant::Empty.is_empty() && Variant::Null.is_empty());
    assert_eq!(Variant::Empty.as_bool(), None);
}

#[test]
fn an_array_knows_how_much_of_it_is_left() {
    let wire = bytes(&(1_i32, "a", [2.5_f64]));
    let array = strict(&wire).unwrap().as_array().unwrap();
    assert_eq!((array.len(), array.is_empty(), array.element()), (3, false, VarType::VARIANT));
    let mut elements = array.iter();
    assert_eq!(format!("{elements:?}"), "Elements { element: VT_VARIANT, left: 3, .. }");
    for left in (0..3).rev() {
        assert_eq!(elements.size_hint(), (left + 1, Some(left + 1)));
        assert!(elements.next().is_some());
        assert_eq!(elements.len(), left);
    }
    assert_eq!(elements.next(), None);
    let none = bytes(&[0_i32; 0]);
    assert!(strict(&none).unwrap().as_array().unwrap().is_empty());
}

#[test]
fn the_scalars_are_the_types_with_a_name_and_their_elements_have_the_length_on_the_wire() {
    let scalars: std::vec::Vec<u16> = VarType::scalars().map(|vartype| vartype.0).collect();
    assert_eq!(scalars, [0, 1, 2, 3, 4, 5, 6, 7, 8, 10, 11, 12, 17, 18, 19, 20, 21]);
    assert!(VarType::scalars().all(|vartype| vartype.name().is_some() && !vartype.is_array()));
    let bytes = |vartype: VarType| vartype.element_bytes();
    assert_eq!([bytes(VarType::EMPTY), bytes(VarType::UI1), bytes(VarType::R8)], [Some(0), Some(1), Some(8)]);
    assert_eq!(bytes(VarType::R4.array_of()), Some(4));
    assert_eq!([bytes(VarType::BSTR), bytes(VarType::VARIANT), bytes(VarType(9))], [None; 3]);
}
