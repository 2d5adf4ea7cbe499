//! Values as JSON, through the feature `serde`.
//!
//! This is a separate crate because the impls of `serde_json` make some comparisons of the unit tests ambiguous.
#![cfg(all(feature = "alloc", feature = "serde"))]

use bcap_core::hresult::HResult;
use bcap_core::limits::{Limits, Strictness};
use bcap_core::position::{Joints, Position};
use bcap_core::variant::{Bstr, CivilTime, Currency, Encode, Null, OleDate, Opaque, OwnedVariant, VarType, Variant};

fn decoded(bytes: &[u8]) -> Option<OwnedVariant> {
    OwnedVariant::decode(bytes, &Limits::STREAM, Strictness::Strict).ok()
}

fn round_trip(value: impl Encode, json: &str) {
    let value = OwnedVariant::new(&value).ok();
    assert!(value.is_some(), "{json}");
    assert_eq!(serde_json::to_string(&value).ok().as_deref(), Some(json));
    assert_eq!(serde_json::from_str(json).ok(), value);
}

#[test]
fn every_scalar_comes_back_with_its_type() {
    round_trip((), r#""EMPTY""#);
    round_trip(Null, r#""NULL""#);
    round_trip(-2_i16, r#"{"I2":-2}"#);
    round_trip(7, r#"{"I4":7}"#);
    round_trip(0.1_f32, r#"{"R4":0.1}"#);
    round_trip(-0.0_f64, r#"{"R8":-0.0}"#);
    round_trip(Currency::from_raw(-12_500), r#"{"CY":-12500}"#);
    round_trip(OleDate::from_raw(2.5), r#"{"DATE":2.5}"#);
    round_trip("Sä\"", r#"{"BSTR":"Sä\""}"#);
    round_trip(HResult::E_FAIL, r#"{"ERROR":-2147467259}"#);
    round_trip(true, r#"{"BOOL":true}"#);
    round_trip(255_u8, r#"{"UI1":255}"#);
    round_trip(65_535_u16, r#"{"UI2":65535}"#);
    round_trip(u32::MAX, r#"{"UI4":4294967295}"#);
    round_trip(i64::MIN, r#"{"I8":-9223372036854775808}"#);
    round_trip(u64::MAX, r#"{"UI8":18446744073709551615}"#);
    round_trip(decoded(&[12, 0, 1, 0, 0, 0, 3, 0, 1, 0, 0, 0, 7, 0, 0, 0]), r#"{"VARIANT":{"I4":7}}"#);
}

#[test]
fn every_array_comes_back_with_its_type() {
    round_trip(decoded(&[0, 0x20, 3, 0, 0, 0]), r#"{"ARRAY":{"EMPTY":3}}"#);
    round_trip(decoded(&[1, 0x20, 0, 0, 0, 0]), r#"{"ARRAY":{"NULL":0}}"#);
    round_trip([1_i16], r#"{"ARRAY":{"I2":[1]}}"#);
    round_trip([1, 2], r#"{"ARRAY":{"I4":[1,2]}}"#);
    round_trip([1.5_f32, 2.0], r#"{"ARRAY":{"R4":[1.5,2.0]}}"#);
    round_trip([0.0_f64; 0], r#"{"ARRAY":{"R8":[]}}"#);
    round_trip([Currency::from_raw(1)], r#"{"ARRAY":{"CY":[1]}}"#);
    round_trip([OleDate::from_raw(1.0)], r#"{"ARRAY":{"DATE":[1.0]}}"#);
    round_trip(["P1", ""], r#"{"ARRAY":{"BSTR":["P1",""]}}"#);
    round_trip([HResult(1)], r#"{"ARRAY":{"ERROR":[1]}}"#);
    round_trip([true, false], r#"{"ARRAY":{"BOOL":[true,false]}}"#);
    round_trip((1, ("x", ())), r#"{"ARRAY":{"VARIANT":[{"I4":1},{"ARRAY":{"VARIANT":[{"BSTR":"x"},"EMPTY"]}}]}}"#);
    round_trip([1_u8], r#"{"ARRAY":{"UI1":[1]}}"#);
    round_trip([1_u16], r#"{"ARRAY":{"UI2":[1]}}"#);
    round_trip([1_u32], r#"{"ARRAY":{"UI4":[1]}}"#);
    round_trip([1_i64], r#"{"ARRAY":{"I8":[1]}}"#);
    round_trip([1_u64], r#"{"ARRAY":{"UI8":[1]}}"#);
}

#[test]
fn values_without_a_form_are_refused() {
    let lone = OwnedVariant::new(&Bstr::from_utf16le(&[0, 0xd8]).unwrap()).unwrap();
    assert_eq!(
        serde_json::to_string(&lone).unwrap_err().to_string(),
        "a BSTR with an unpaired surrogate cannot be serialised"
    );
    let opaque = OwnedVariant::from(Variant::Opaque(Opaque { vartype: VarType(16), bytes: &[1, 0, 0, 0, 127] }));
    let error = serde_json::to_string(&vec![opaque]).unwrap_err();
    assert_eq!(error.to_string(), "a value of unknown VARTYPE cannot be serialised");
    let error = serde_json::from_str::<OwnedVariant>(r#"{"I2":40000}"#).unwrap_err();
    assert_eq!(error.to_string(), "invalid value: integer `40000`, expected i16 at line 1 column 11");
    assert!(serde_json::from_str::<OwnedVariant>(r#"{"I1":1}"#).is_err());
}

#[test]
fn values_of_variables_are_structs() {
    let position = Position::new([400.0, 0.0, 300.0], [180.0, 0.0, 180.0]).figure(5);
    let json = r#"{"xyz_mm":[400.0,0.0,300.0],"rotation_degrees":[180.0,0.0,180.0],"figure":5}"#;
    assert_eq!(serde_json::to_string(&position).unwrap(), json);
    assert_eq!(serde_json::from_str::<Position>(json).unwrap(), position);
    let joints: Joints = serde_json::from_str(r#"{"degrees":[1,2,3,4,5,6,7,8]}"#).unwrap();
    assert_eq!(joints, Joints::new([1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0]));
    let day = CivilTime::date(2026, 11, 22);
    assert_eq!(serde_json::from_str::<CivilTime>(&serde_json::to_string(&day).unwrap()).unwrap(), day);
}
