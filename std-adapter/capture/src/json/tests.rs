use super::*;
use proptest::prelude::*;

fn to_json(bytes: &[u8]) -> String {
    let value = Variant::decode(bytes, &LIMITS, Strictness::Strict).unwrap();
    let mut out = String::new();
    put_value(&mut out, value);
    out
}

fn from_json(text: &str) -> Result<Vec<u8>, ConvertError> {
    parse_value(Part::whole(text))
}

/// Encodes a native value, and checks the conversion to JSON and back.
#[track_caller]
fn both_ways<T: Encode + ?Sized>(value: &T, json: &str) {
    let mut buffer = [0xa5; 256];
    let mut out = Writer::new(&mut buffer);
    value.encode(&mut out).unwrap();
    assert_eq!(to_json(out.as_bytes()), json);
    assert_eq!(from_json(json).unwrap(), out.as_bytes());
}

#[test]
fn every_type_has_its_form() {
    both_ways(&(), r#"{"vt":0,"v":null}"#);
    both_ways(&Null, r#"{"vt":1,"v":null}"#);
    both_ways(&-5_i16, r#"{"vt":2,"v":-5}"#);
    both_ways(&i32::MIN, r#"{"vt":3,"v":-2147483648}"#);
    both_ways(&0.1_f32, r#"{"vt":4,"v":0.1}"#);
    both_ways(&0.1_f64, r#"{"vt":5,"v":0.1}"#);
    both_ways(&Currency::from_raw(12_345_678), r#"{"vt":6,"v":12345678}"#);
    both_ways(&OleDate::from_raw(-1.25), r#"{"vt":7,"v":-1.25}"#);
    both_ways("Arm0", r#"{"vt":8,"v":"Arm0"}"#);
    both_ways(&HResult::E_TIMEOUT, r#"{"vt":10,"v":-2147481344}"#);
    both_ways(&true, r#"{"vt":11,"v":-1}"#);
    both_ways(&false, r#"{"vt":11,"v":0}"#);
    both_ways(&255_u8, r#"{"vt":17,"v":255}"#);
    both_ways(&65535_u16, r#"{"vt":18,"v":65535}"#);
    both_ways(&u32::MAX, r#"{"vt":19,"v":4294967295}"#);
    both_ways(&i64::MIN, r#"{"vt":20,"v":-9223372036854775808}"#);
    both_ways(&u64::MAX, r#"{"vt":21,"v":18446744073709551615}"#);
    both_ways(&[1.5_f32, -2.0], r#"{"vt":8196,"v":[1.5,-2.0]}"#);
    both_ways(&["a", "b,c"], r#"{"vt":8200,"v":["a","b,c"]}"#);
    both_ways(&[true, false], r#"{"vt":8203,"v":[-1,0]}"#);
    both_ways(&[0_i32; 0], r#"{"vt":8195,"v":[]}"#);
    both_ways(
        &("Sample", (100_i16, ())),
        r#"{"vt":8204,"v":[{"vt":8,"v":"Sample"},{"vt":8204,"v":[{"vt":2,"v":100},{"vt":0,"v":null}]}]}"#,
    );
}

#[test]
fn a_scalar_variant_holds_a_value() {
    let bytes = [&[12, 0, 1, 0, 0, 0][..], &[2, 0, 1, 0, 0, 0, 100, 0]].concat();
    assert_eq!(to_json(&bytes), r#"{"vt":12,"v":{"vt":2,"v":100}}"#);
    assert_eq!(from_json(r#"{"vt":12,"v":{"vt":2,"v":100}}"#).unwrap(), bytes);
}

#[test]
fn elements_without_data_are_null() {
    let bytes = [1, 0x20, 2, 0, 0, 0];
    assert_eq!(to_json(&bytes), r#"{"vt":8193,"v":[null,null]}"#);
    assert_eq!(from_json(r#"{"vt":8193,"v":[null,null]}"#).unwrap(), bytes);
    let error = from_json(r#"{"vt":8193,"v":[0]}"#).unwrap_err();
    assert_eq!(error.offset, 16);
}

#[test]
fn floats_keep_their_bits() {
    both_ways(&-0.0_f64, r#"{"vt":5,"v":-0.0}"#);
    both_ways(&-0.0_f32, r#"{"vt":4,"v":-0.0}"#);
    both_ways(&16_777_217_f64, r#"{"vt":5,"v":16777217.0}"#);
    both_ways(&5e-324_f64, r#"{"vt":5,"v":5e-324}"#);
    both_ways(&f64::INFINITY, r#"{"vt":5,"v":"inf"}"#);
    both_ways(&f32::NEG_INFINITY, r#"{"vt":4,"v":"-inf"}"#);
    both_ways(&f64::NAN, r#"{"vt":5,"v":"NaN"}"#);
    both_ways(&f32::NAN, r#"{"vt":4,"v":"NaN"}"#);
    both_ways(&f64::from_bits(0xfff8_0000_0000_0000), r#"{"vt":5,"v":"NaN(0xfff8000000000000)"}"#);
    both_ways(&f32::from_bits(0x7f80_0001), r#"{"vt":4,"v":"NaN(0x7f800001)"}"#);
    both_ways(&OleDate::from_raw(f64::NAN), r#"{"vt":7,"v":"NaN"}"#);
    // a number without a decimal point is accepted as a float
    assert_eq!(from_json(r#"{"vt":4,"v":3}"#), from_json(r#"{"vt":4,"v":3.0}"#));
}

#[test]
fn strings_keep_their_units() {
    both_ways(
        "a\"\\/\u{8}\u{c}\n\r\t\0\u{7f}é€😀",
        "{\"vt\":8,\"v\":\"a\\\"\\\\/\\u0008\\u000c\\n\\r\\t\\u0000\\u007fé€😀\"}",
    );
    let lone: Vec<u8> = [0x41_u16, 0xd800, 0x42, 0xdc00].into_iter().flat_map(u16::to_le_bytes).collect();
    both_ways(&Bstr::from_utf16le(&lone).unwrap(), r#"{"vt":8,"v":"A\ud800B\udc00"}"#);
    // all escapes of JSON are accepted, including surrogate pairs
    assert_eq!(from_json(r#"{"vt":8,"v":"\ud83d\ude00\b\f\/"}"#), from_json("{\"vt\":8,\"v\":\"😀\\u0008\\u000C/\"}"));
}

#[test]
fn errors_have_their_offset() {
    for (text, offset, word) in [
        (r#"{"vt":3,"v":3000000000}"#, 12, "i32"),
        (r#"{"vt":17,"v":-1}"#, 13, "u8"),
        (r#"{"vt":3,"v":1.5}"#, 12, "1.5"),
        (r#"{"vt":3,"v":"1"}"#, 12, "\"1\""),
        (r#"{"vt":4,"v":1e39}"#, 12, "f32"),
        (r#"{"vt":5,"v":"nan"}"#, 12, "NaN"),
        (r#"{"vt":4,"v":"NaN(0x00000001)"}"#, 12, "NaN"),
        (r#"{"vt":11,"v":2}"#, 13, "BOOL"),
        (r#"{"vt":8,"v":5}"#, 12, "BSTR"),
        (r#"{"vt":8195,"v":[1,2,"x"]}"#, 20, "\"x\""),
        (r#"{"vt":8204,"v":[{"vt":3,"v":1},{"vt":3,"v":true}]}"#, 43, "true"),
        (r#"{"vt":9,"v":null}"#, 0, "VARTYPE 9"),
        (r#"{"vt":3}"#, 0, "\"v\" is missing"),
        (r#"{"vt":3,"value":3}"#, 14, "unknown field"),
        (r#"{"vt":3,"v":3"#, 12, "EOF"),
        (r#"{"v":3}"#, 6, "missing field `vt`"),
        ("", 0, "EOF"),
    ] {
        let error = from_json(text).unwrap_err();
        assert!(error.message.contains(word), "{text}: {}", error.message);
        assert_eq!(error.offset, offset, "{text}: {}", error.message);
        assert!(!error.message.contains(" at line "), "{}", error.message);
    }
}

#[test]
fn nesting_is_bounded() {
    let nested = |depth: usize| format!("{}{{\"vt\":0}}{}", "{\"vt\":12,\"v\":".repeat(depth), "}".repeat(depth));
    assert!(from_json(&nested(16)).is_ok());
    assert!(from_json(&nested(17)).unwrap_err().message.contains("nested deeper"));
    assert!(from_json(&nested(5000)).unwrap_err().message.contains("nested deeper"));
}

/// Values of every type as their wire bytes.
fn values() -> impl Strategy<Value = Vec<u8>> {
    let leaf = prop_oneof![
        Just(vec![0, 0, 1, 0, 0, 0]),
        Just(vec![1, 0, 1, 0, 0, 0]),
        scalars(VarType::I2, any::<i16>()),
        scalars(VarType::I4, any::<i32>()),
        scalars(VarType::R4, any::<u32>().prop_map(f32::from_bits)),
        scalars(VarType::R8, any::<u64>().prop_map(f64::from_bits)),
        scalars(VarType::CY, any::<i64>().prop_map(Currency::from_raw)),
        scalars(VarType::DATE, any::<f64>().prop_map(OleDate::from_raw)),
        scalars(VarType::ERROR, any::<i32>().prop_map(HResult)),
        scalars(VarType::BOOL, any::<bool>()),
        scalars(VarType::UI1, any::<u8>()),
        scalars(VarType::UI2, any::<u16>()),
        scalars(VarType::UI4, any::<u32>()),
        scalars(VarType::I8, any::<i64>()),
        scalars(VarType::UI8, any::<u64>()),
        data(
            VarType::BSTR,
            prop_oneof![
                proptest::collection::vec(any::<u16>(), 0..9),
                any::<String>().prop_map(|s| s.encode_utf16().collect())
            ]
            .prop_map(|units| {
                let bytes: Vec<u8> = units.into_iter().flat_map(u16::to_le_bytes).collect();
                [&u32::try_from(bytes.len()).unwrap().to_le_bytes()[..], &bytes].concat()
            })
        ),
    ];
    leaf.prop_recursive(4, 32, 4, |inner| data(VarType::VARIANT, inner))
}

fn scalars<T: bcap_core::variant::Element + std::fmt::Debug>(
    vartype: VarType,
    values: impl Strategy<Value = T>,
) -> impl Strategy<Value = Vec<u8>> {
    data(
        vartype,
        values.prop_map(|value| {
            let mut buffer = [0; 8];
            let mut out = Writer::new(&mut buffer);
            value.put(&mut out).unwrap();
            out.as_bytes().to_vec()
        }),
    )
}

/// Scalars and arrays of elements whose data are given.
fn data(vartype: VarType, element: impl Strategy<Value = Vec<u8>>) -> impl Strategy<Value = Vec<u8>> {
    (any::<bool>(), proptest::collection::vec(element, 1..4), any::<bool>()).prop_map(
        move |(array, elements, empty)| {
            let elements = if array && empty {
                vec![]
            } else if array {
                elements
            } else {
                elements[..1].to_vec()
            };
            let vartype = if array { vartype.array_of() } else { vartype };
            let count = if array { u32::try_from(elements.len()).unwrap() } else { 1 };
            [&vartype.0.to_le_bytes()[..], &count.to_le_bytes(), &elements.concat()].concat()
        },
    )
}

proptest! {
    #[test]
    fn json_and_bytes_are_inverse(bytes in values()) {
        let json = to_json(&bytes);
        prop_assert!(serde_json::from_str::<&RawValue>(&json).is_ok(), "{json}");
        prop_assert_eq!(from_json(&json).unwrap(), bytes, "{}", json);
    }

    #[test]
    fn no_text_panics(text in ".*", cut in 0_usize..80) {
        let _ = from_json(&text);
        let json = r#"{"vt":8204,"v":[{"vt":8,"v":"\ud800é"},{"vt":5,"v":-1.5e3},{"vt":8203,"v":[0]}]}"#;
        if let Some(start) = json.get(..cut) {
            prop_assert!(from_json(start).is_err());
            let _ = from_json(&format!("{start}{text}"));
        }
    }
}
