//! Tests the text format of values: printed text parses back to the same bits, values without a text are errors, and
//! floats are printed as by the standard library.

use bcap_core::error::{TextError, TextErrorKind};
use bcap_core::limits::{Limits, MAX_DEPTH, Strictness};
use bcap_core::variant::{Variant, VariantBuf};
use bcap_testkit::strategies;
use bcap_testkit::value::{VARIANT, Value};
use bcap_testkit::vectors::texts;
use proptest::prelude::*;

type Owned = VariantBuf<4096>;

fn print(value: &Value) -> Result<String, TextError> {
    let wire = value.to_wire();
    let mut buffer = vec![0; 64 * 1024];
    let value = Variant::decode(&wire, &Limits { depth: MAX_DEPTH, ..Limits::STREAM }, Strictness::Strict).unwrap();
    value.to_text(&mut buffer).map(str::to_owned)
}

fn parse(text: &str) -> Result<Value, TextError> {
    Owned::parse_text(text.as_bytes()).map(|value| Value::read(value.as_variant()))
}

/// Values that have a text more often than not.
fn value() -> impl Strategy<Value = Value> {
    let string = "[a-z(),= ]{0,6}".prop_map(|text| Value::text(&text));
    prop_oneof![
        strategies::value(),
        string.clone(),
        prop::collection::vec(string.clone(), 1..4).prop_map(|items| Value::Array(8, items)),
        prop::collection::vec(string, 1..4).prop_map(|items| Value::Array(VARIANT, items)),
    ]
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 1000, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn what_has_a_text_comes_back_to_the_bit_and_the_rest_is_an_error(value in value()) {
        bcap_fuzz::text_there_and_back(&value);
    }

    #[test]
    fn a_text_is_taken_as_the_oracle_takes_it(text in "[0-9]{1,5},?[0-9a-z(),.:/+ -]{0,30}") {
        bcap_fuzz::text(text.as_bytes());
    }

    #[test]
    fn a_damaged_text_is_taken_as_the_oracle_takes_it(
        text in value().prop_filter_map("no text", |v| print(&v).ok()), damage in strategies::damage()
    ) {
        let mut bytes = text.into_bytes();
        damage.apply(&mut bytes);
        bcap_fuzz::text(&bytes);
    }

    /// The oracle parses with the standard library.
    #[test]
    fn floats_are_read_as_the_standard_library_reads_them(
        double in "-?([0-9]{1,25}|[0-9]{0,420}\\.[0-9]{1,70}|[0-9]{1,460})(e[+-]?[0-9]{1,3})?",
        single in "-?[0-9]{1,12}(\\.[0-9]{1,40})?(e[+-]?[0-9]{1,2})?"
    ) {
        for text in [format!("5,{double}"), format!("4,{single}")] {
            bcap_fuzz::text(text.as_bytes());
        }
    }

    #[test]
    fn numbers_near_the_middle_of_two_doubles_are_rounded_right(
        mantissa in 1_u64 << 53..1 << 54, exponent in -31_i32..=70, keep in 17_usize..60,
        tail in prop::sample::select(&["", "0", "1", "49", "500"][..]), zeros in 0_usize..400
    ) {
        // an odd number of 54 bits lies in the middle; the decimals next to it on both sides are the hardest
        let exact = halfway(mantissa | 1, exponent);
        let (all, power) = exact.split_once('e').unwrap();
        let (kept, cut) = all.split_at(keep.min(all.len()));
        let power = power.parse::<i32>().unwrap() + cut.len() as i32;
        let below: u128 = kept.parse().unwrap();
        let texts = [
            format!("{below}e{power}"),
            format!("{}e{power}", below + 1),
            format!("{all}.{}{tail}e{}", "0".repeat(zeros), power - cut.len() as i32),
        ];
        for text in texts {
            bcap_fuzz::text(format!("5,{text}").as_bytes());
            bcap_fuzz::text(format!("4,{text}").as_bytes());
        }
    }

    #[test]
    fn floats_are_printed_in_the_fewest_digits(bits in any::<u64>()) {
        let (double, single) = (f64::from_bits(bits), f32::from_bits(bits as u32));
        let digits = |text: &str| {
            let mantissa = text.split('e').next().unwrap().replace(['-', '.'], "");
            mantissa.trim_matches('0').len()
        };
        if double.is_finite() {
            let text = print(&Value::R8(bits)).unwrap();
            prop_assert_eq!(digits(&text[2..]), digits(&format!("{double:e}")), "{}", text);
        }
        if single.is_finite() {
            let text = print(&Value::R4(bits as u32)).unwrap();
            prop_assert_eq!(digits(&text[2..]), digits(&format!("{single:e}")), "{}", text);
        }
    }
}

/// Returns `mantissa * 2^exponent` in all its digits.
fn halfway(mantissa: u64, exponent: i32) -> String {
    match u32::try_from(exponent) {
        Ok(up) => format!("{}e0", u128::from(mantissa) << up),
        // 2^-n is 5^n * 10^-n
        Err(_) => format!("{}e{exponent}", u128::from(mantissa) * 5_u128.pow(exponent.unsigned_abs())),
    }
}

#[test]
fn the_examples_of_the_specification_are_what_it_says() {
    let strings = |texts: &[&str]| texts.iter().map(|text| Value::text(text)).collect::<Vec<_>>();
    let expected = [
        ("rac_spec_eg1", Value::I2(100)),
        ("rac_spec_eg2", Value::text("Sample")),
        ("rac_spec_eg3", Value::Nested(Box::new(Value::text("Sample")))),
        ("rac_spec_eg4", Value::Array(2, vec![Value::I2(100), Value::I2(200), Value::I2(300)])),
        ("rac_spec_eg5", Value::Array(8, strings(&["Sample", "Test"]))),
        ("rac_spec_eg6", Value::text("Sample,Test")),
        ("rac_spec_eg7", Value::Array(VARIANT, vec![Value::text("Sample"), Value::I2(100)])),
    ];
    let texts = texts();
    assert_eq!(texts.len(), 43);
    for (name, value) in expected {
        let text = &texts.iter().find(|vector| vector.name == name).unwrap().text;
        assert_eq!(parse(text).as_ref(), Ok(&value), "{name}");
        assert_eq!(print(&value).as_ref(), Ok(text), "{name}");
    }
}

#[test]
fn the_hostile_list_is_refused() {
    // what crashed the vendor's library or gave wrong values
    for (text, kind, column) in [
        ("3,99999999999", TextErrorKind::OutOfRange, 3),
        ("17,300", TextErrorKind::OutOfRange, 4),
        ("17,-1", TextErrorKind::OutOfRange, 4),
        ("8192,1", TextErrorKind::ArrayOfNothing, 5),
        ("8193,", TextErrorKind::ArrayOfNothing, 5),
        ("4,1e39", TextErrorKind::OutOfRange, 3),
        ("5,123. 01", TextErrorKind::BlankBehind, 7),
        ("3,1.9", TextErrorKind::Digit, 4),
        ("8196,1 ,2", TextErrorKind::BlankBehind, 7),
        ("3,", TextErrorKind::Missing, 3),
        ("8194,", TextErrorKind::EmptyArray, 6),
    ] {
        assert_eq!(parse(text), Err(TextError::new(kind, column)), "{text}");
    }
    assert_eq!(parse("3,010"), Ok(Value::I4(10)), "no octal");
    for levels in [usize::from(MAX_DEPTH) + 1, 20_000, 100_000] {
        let deep = format!("{}3,1{}", "12,(".repeat(levels), ")".repeat(levels));
        assert_eq!(parse(&deep).unwrap_err().kind, TextErrorKind::TooDeep, "{levels} levels");
    }
    let digits = "9".repeat(501);
    assert_eq!(parse(&format!("5,{digits}")).unwrap_err().kind, TextErrorKind::NumberTooLong);
    let long = format!("8,{}", "x".repeat(100_000));
    assert_eq!(parse(&long).unwrap_err().kind, TextErrorKind::Full, "a fixed buffer is full, no memory is asked for");
}
