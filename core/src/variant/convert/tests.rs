extern crate std;

use std::string::{String, ToString};

use super::*;
use crate::variant::{Encode, Null, VariantBuf};

fn sent(value: impl Encode) -> VariantBuf<256> {
    VariantBuf::new(&value).unwrap()
}

/// Returns the text of the error of a conversion to `T`.
fn refused<T: for<'a> FromVariant<'a> + fmt::Debug>(value: impl Encode) -> String {
    sent(value).as_variant().convert::<T>().unwrap_err().to_string()
}

fn converted<T: for<'a> FromVariant<'a>>(value: impl Encode) -> T {
    sent(value).as_variant().convert().unwrap()
}

#[test]
fn every_integer_type_converts_to_every_other_that_holds_it() {
    macro_rules! from {
        ($($to:ty),*) => {$(
            assert_eq!(converted::<$to>(100_i16), 100);
            assert_eq!(converted::<$to>(100_i32), 100);
            assert_eq!(converted::<$to>(100_i64), 100);
            assert_eq!(converted::<$to>(100_u8), 100);
            assert_eq!(converted::<$to>(100_u16), 100);
            assert_eq!(converted::<$to>(100_u32), 100);
            assert_eq!(converted::<$to>(100_u64), 100);
            assert_eq!(converted::<$to>(100_f32), 100);
            assert_eq!(converted::<$to>(100_f64), 100);
            assert_eq!(converted::<$to>(<$to>::MAX), <$to>::MAX);
            assert_eq!(converted::<$to>(<$to>::MIN), <$to>::MIN);
        )*};
    }
    from!(i16, i32, i64, u8, u16, u32, u64);
}

#[test]
fn an_integer_out_of_range_is_refused_with_its_value() {
    assert_eq!(refused::<u8>(300_i32), "expected u8 (0 to 255), found VT_I4 with the value 300, which is out of range");
    assert_eq!(
        refused::<i16>(-32_769_i64),
        "expected i16 (-32768 to 32767), found VT_I8 with the value -32769, which is out of range"
    );
    assert_eq!(
        refused::<i64>(1_u64 << 63),
        "expected i64 (-2^63 to 2^63 - 1), found VT_UI8 with the value 9223372036854775808, which is out of range"
    );
    assert_eq!(
        refused::<u64>(-1_i16),
        "expected u64 (0 to 2^64 - 1), found VT_I2 with the value -1, which is out of range"
    );
}

#[test]
fn floats_convert_to_integers_only_when_they_equal_one() {
    assert_eq!(
        refused::<i32>(2.5_f64),
        "expected i32 (-2147483648 to 2147483647), found VT_R8 with the value 2.5, which is not exact in this type"
    );
    let kind = |value: f64| Variant::R8(value).convert::<i64>().map_err(|e| e.kind);
    assert_eq!(kind(-9_223_372_036_854_775_808.0), Ok(i64::MIN));
    assert_eq!(kind(-0.0), Ok(0));
    let too_large = Number::Float(9_223_372_036_854_775_808.0);
    assert_eq!(kind(9_223_372_036_854_775_808.0), Err(ConvertErrorKind::OutOfRange(too_large)));
    assert_eq!(Variant::R8(9_223_372_036_854_775_808.0).convert::<u64>(), Ok(1 << 63));
    assert_eq!(kind(f64::INFINITY), Err(ConvertErrorKind::OutOfRange(Number::Float(f64::INFINITY))));
    assert!(matches!(kind(f64::NAN), Err(ConvertErrorKind::Inexact(Number::Float(n))) if n.is_nan()));
    assert_eq!(Variant::R4(-1.0).convert::<i32>(), Ok(-1));
}

#[test]
fn floats_widen_exactly_and_r8_rounds_to_f32() {
    assert_eq!(converted::<f64>(0.1_f32), f64::from(0.1_f32));
    assert_eq!(converted::<f32>(0.1_f64), 0.1_f32);
    assert_eq!(converted::<f32>(f64::NEG_INFINITY), f32::NEG_INFINITY);
    assert!(converted::<f32>(f64::NAN).is_nan());
    assert_eq!(refused::<f32>(1e39_f64), "expected f32, found VT_R8 with the value 1e39, which is out of range");
    assert_eq!(converted::<f64>(1_i64 << 53), 9_007_199_254_740_992.0);
    assert_eq!(converted::<f64>(u64::MAX - 2047), 18_446_744_073_709_549_568.0);
    assert_eq!(
        refused::<f64>((1_i64 << 53) + 1),
        "expected f64, found VT_I8 with the value 9007199254740993, which is not exact in this type"
    );
    assert_eq!(
        refused::<f32>(16_777_217_i32),
        "expected f32, found VT_I4 with the value 16777217, which is not exact in this type"
    );
    assert!(Variant::I8(i64::MAX).convert::<f64>().is_err());
    assert!(Variant::Ui8(u64::MAX).convert::<f64>().is_err());
}

#[test]
fn truth_values() {
    for (value, expected) in [(0, false), (1, true), (-1, true)] {
        assert_eq!(converted::<bool>(value), expected);
    }
    assert!(converted::<bool>(true));
    assert_eq!(
        refused::<bool>(2),
        "expected a truth value (BOOL, 0, 1 or -1), found VT_I4 with the value 2, which is out of range"
    );
    assert_eq!(refused::<bool>(1.0_f64), "expected a truth value (BOOL, 0, 1 or -1), found VT_R8");
    assert_eq!(refused::<i32>(true), "expected i32 (-2147483648 to 2147483647), found VT_BOOL");
}

#[test]
fn other_scalars_convert_from_their_own_type() {
    let noon = CivilTime::date(2026, 11, 22).at(12, 0, 0);
    let date = OleDate::from_civil(noon).unwrap();
    assert_eq!(converted::<OleDate>(date), date);
    assert_eq!(converted::<CivilTime>(date), noon);
    assert_eq!(converted::<CivilTime>(noon), noon);
    assert_eq!(
        refused::<CivilTime>(OleDate::from_raw(3e6)),
        "expected a date of the years 100 to 9999, found VT_DATE with the value 3000000.0, which is out of range"
    );
    assert_eq!(refused::<CivilTime>(3e6_f64), "expected a date, found VT_R8");
    assert_eq!(converted::<Currency>(Currency::from_raw(5)), Currency::from_raw(5));
    assert_eq!(converted::<HResult>(HResult::E_FAIL), HResult::E_FAIL);
    assert_eq!(converted::<HResult>(7), HResult(7));
    let name = sent("P1");
    assert_eq!(name.as_variant().convert::<Bstr<'_>>().unwrap(), "P1");
    assert_eq!(name.as_variant().convert::<Variant<'_>>(), Ok(name.as_variant()));
    assert_eq!(refused::<f64>("1.5"), "expected f64, found VT_BSTR");
}

#[test]
fn absent_values_are_none() {
    assert_eq!(converted::<Option<i32>>(()), None);
    assert_eq!(converted::<Option<i32>>(Null), None);
    assert_eq!(converted::<Option<i32>>(5_u8), Some(5));
    converted::<()>(Null);
    assert_eq!(refused::<()>(1), "expected no value, found VT_I4");
    assert_eq!(refused::<i32>(()), "expected i32 (-2147483648 to 2147483647), found VT_EMPTY");
    assert_eq!(sent(Some(5)).as_variant(), Variant::I4(5));
    assert_eq!(sent(None::<i32>).as_variant(), Variant::Empty);
}

#[test]
fn arrays_of_any_number_type_widen() {
    assert_eq!(converted::<[f64; 3]>([400.5_f32, 0.0, -1.0]), [400.5, 0.0, -1.0]);
    assert_eq!(converted::<[f64; 2]>([1_u8, 255]), [1.0, 255.0]);
    assert_eq!(converted::<[i32; 2]>((1_i16, 2.0_f64)), [1, 2]);
    assert_eq!(converted::<[f64; 0]>([0.0_f32; 0]), [0.0; 0]);
    assert_eq!(converted::<[[u8; 2]; 2]>(([1, 2], [3, 4])), [[1, 2], [3, 4]]);
}

#[test]
fn a_wrong_number_of_elements_is_refused() {
    assert_eq!(
        refused::<[f64; 7]>([1.0_f32, 2.0, 3.0]),
        "expected an array of 7 elements, found VT_ARRAY|VT_R4 of 3 elements"
    );
    assert_eq!(refused::<(i32, i32)>([1, 2, 3]), "expected an array of 2 elements, found VT_ARRAY|VT_I4 of 3 elements");
    assert_eq!(refused::<[f64; 1]>(1.0_f64), "expected an array, found VT_R8");
    assert_eq!(refused::<f64>([1.0_f64]), "expected f64, found VT_ARRAY|VT_R8 of 1 element");
}

#[test]
fn the_element_that_does_not_convert_is_named() {
    assert_eq!(
        refused::<[i32; 3]>([1.0_f32, 2.0, 2.5]),
        "element 2: expected i32 (-2147483648 to 2147483647), found VT_R4 with the value 2.5, \
         which is not exact in this type"
    );
    // the index counts the elements of the outermost array
    let error = sent((0, [1, 300])).as_variant().convert::<(u8, [u8; 2])>().unwrap_err();
    assert_eq!((error.element, error.found, error.count), (Some(1), VarType::I4, 1));
    let error = sent((0, [1, 2])).as_variant().convert::<(u8, [u8; 3])>().unwrap_err();
    assert_eq!((error.element, error.count, error.kind), (Some(1), 2, ConvertErrorKind::Count { least: 3, most: 3 }));
}

#[test]
fn tuples_take_mixed_and_plain_arrays() {
    assert_eq!(converted::<(i32, f64, bool)>((1_i16, 2.5_f32, 1)), (1, 2.5, true));
    assert_eq!(converted::<(f64, i32)>([1.5_f64, 2.0]), (1.5, 2));
    assert_eq!(converted::<(i32,)>([5]), (5,));
    let eight = (1, 2, 3, 4, 5, 6, 7, (8, ()));
    assert_eq!(converted::<(u8, u8, u8, u8, u8, u8, u8, (u8, Option<u8>))>(eight), (1, 2, 3, 4, 5, 6, 7, (8, None)));
}

#[test]
fn a_scalar_variant_converts_as_the_value_inside() {
    let wire = [12, 0, 1, 0, 0, 0, 12, 0, 1, 0, 0, 0, 2, 0, 1, 0, 0, 0, 100, 0];
    let limits = crate::limits::Limits::STREAM;
    let value = Variant::decode(&wire, &limits, crate::limits::Strictness::Strict).unwrap();
    assert_eq!(value.convert(), Ok(100_u64));
    assert_eq!(value.convert::<[i32; 1]>().unwrap_err().found, VarType::I2);
    let empty = [12, 0, 1, 0, 0, 0, 0, 0, 1, 0, 0, 0];
    let value = Variant::decode(&empty, &limits, crate::limits::Strictness::Strict).unwrap();
    assert_eq!(value.convert::<Option<i32>>(), Ok(None));
}

#[test]
fn an_impossible_civil_time_is_not_sent() {
    let error = VariantBuf::<64>::new(&CivilTime::date(2026, 2, 30)).unwrap_err();
    assert_eq!(error.to_string(), "a number is not finite, or a value is out of the range of VARTYPE 0x0007");
}

#[cfg(feature = "alloc")]
mod allocated {
    use super::*;
    use std::string::ToString;
    use std::vec;
    use std::vec::Vec;

    #[test]
    fn strings_and_lists() {
        assert_eq!(converted::<String>("Sämple 😀"), "Sämple 😀");
        assert_eq!(converted::<Vec<String>>(["P1", ""]), ["P1", ""]);
        assert_eq!(converted::<Vec<f64>>([1.5_f32, 2.0]), [1.5, 2.0]);
        assert_eq!(converted::<Vec<i32>>([0_i32; 0]), []);
        assert_eq!(
            converted::<Vec<(String, Option<i32>)>>((("I1", 7), ("I2", ()))),
            [("I1".to_string(), Some(7)), ("I2".to_string(), None)]
        );
        assert_eq!(refused::<Vec<u8>>((1, "x")), "element 1: expected u8 (0 to 255), found VT_BSTR");
        assert_eq!(refused::<Vec<u8>>(1_u8), "expected an array, found VT_UI1");
    }

    #[test]
    fn a_lone_surrogate_is_no_string() {
        let lone = sent(Bstr::from_utf16le(&[0x00, 0xd8]).unwrap());
        let error = lone.as_variant().convert::<String>().unwrap_err();
        assert_eq!(error.to_string(), "expected a Unicode string, found VT_BSTR with an unpaired surrogate");
    }

    #[test]
    fn owned_rust_values_are_sent() {
        assert_eq!(sent("P1".to_string()), sent("P1"));
        assert_eq!(sent(vec![1.5_f64, 2.0]), sent([1.5_f64, 2.0]));
        assert_eq!(sent(vec!["a".to_string(), "b".to_string()]), sent(["a", "b"]));
        assert_eq!(sent((1, Some("x".to_string()), None::<i32>)), sent((1, "x", ())));
    }
}
