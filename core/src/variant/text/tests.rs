//! Known answers both ways, every error with its column, and round trips over generated values and damaged texts.
#![expect(clippy::arithmetic_side_effects, reason = "an overflow here fails the test, as it should")]

extern crate std;

use std::format;
use std::string::{String, ToString as _};
use std::vec;
use std::vec::Vec;

use super::string::character;
use super::*;
use crate::error::EncodeError;
use crate::hresult::HResult;
use crate::limits::{Limits, MAX_DEPTH, Strictness};
use crate::num::to_u32;
use crate::variant::{Bstr, CivilTime, Currency, Encode, Null, OleDate, VarType};
use TextErrorKind as K;

type Buf = VariantBuf<512>;

fn parsed(text: &str) -> Buf {
    Buf::parse_text(text.as_bytes()).unwrap_or_else(|e| panic!("{text}: {e}"))
}

fn refused(text: &str) -> (K, u32) {
    let error = Buf::parse_text(text.as_bytes()).expect_err(text);
    (error.kind, error.column)
}

fn printed(value: Variant<'_>) -> Result<String, K> {
    let mut buffer = [0; 1024];
    match value.to_text(&mut buffer) {
        Ok(text) => Ok(text.to_string()),
        Err(error) => {
            assert_eq!(error.column, 0);
            Err(error.kind)
        }
    }
}

fn print_of<T: Encode + ?Sized>(value: &T) -> Result<String, K> {
    printed(Buf::new(value).unwrap().as_variant())
}

/// Checks text and value against each other, both ways.
fn same<T: Encode + ?Sized>(text: &str, value: &T) {
    let value = Buf::new(value).unwrap();
    assert_eq!(parsed(text), value, "{text}");
    assert_eq!(parsed(text).as_bytes(), value.as_bytes(), "{text}");
    assert_eq!(printed(value.as_variant()).as_deref(), Ok(text));
}

/// Checks the value of a text, and the text of that value.
fn reads<T: Encode + ?Sized>(text: &str, value: &T, canonical: &str) {
    assert_eq!(parsed(text), Buf::new(value).unwrap(), "{text}");
    same(canonical, value);
}

#[test]
fn the_specification_s_examples_read_both_ways() {
    same("2,100", &100_i16);
    same("8,Sample", &"Sample");
    same("8194,100,200,300", &[100_i16, 200, 300]);
    same("8200,Sample,Test", &["Sample", "Test"]);
    same("8,Sample,Test", &"Sample,Test");
    same("8204,(8,Sample),(2,100)", &("Sample", 100_i16));

    let nested = parsed("12,(8,Sample)");
    assert_eq!(nested.as_bytes()[..12], [12, 0, 1, 0, 0, 0, 8, 0, 1, 0, 0, 0]);
    assert!(matches!(nested.as_variant(), Variant::Nested(n) if n.value().as_bstr().unwrap() == "Sample"));
    assert_eq!(printed(nested.as_variant()).unwrap(), "12,(8,Sample)");
}

#[test]
fn every_type_has_its_text() {
    same("0,", &());
    same("1,", &Null);
    same("2,-32768", &i16::MIN);
    same("3,-2147483648", &i32::MIN);
    same("4,123.01", &123.01_f32);
    same("5,1e300", &1e300_f64);
    same("6,-9223372036854775808", &Currency::from_raw(i64::MIN));
    same("8,", &"");
    same("10,-2147418111", &HResult::E_INVALIDRCPACKET);
    same("11,-1", &true);
    same("11,0", &false);
    same("17,255", &u8::MAX);
    same("18,65535", &u16::MAX);
    same("19,4294967295", &u32::MAX);
    same("20,-9223372036854775808", &i64::MIN);
    same("21,18446744073709551615", &u64::MAX);
    same("8196,1,2,3,4,5,6,-1", &[1.0_f32, 2.0, 3.0, 4.0, 5.0, 6.0, -1.0]);
    same("8197,0.1,-0,1e-7", &[0.1, -0.0, 1e-7]);
    same("8198,5,-5", &[Currency::from_raw(5), Currency::from_raw(-5)]);
    same("8202,0,-2147024809", &[HResult::S_OK, HResult::E_INVALIDARG]);
    same("8203,-1,0", &[true, false]);
    same("8209,1,2,255", &[1_u8, 2, 255]);
    same("8212,-1,9223372036854775807", &[-1, i64::MAX]);
    same("8213,0,18446744073709551615", &[0, u64::MAX]);
}

#[test]
fn numbers_are_read_in_all_their_forms() {
    reads("3,010", &10, "3,10");
    reads("3,+7", &7, "3,7");
    reads("3,-0", &0, "3,0");
    reads("3,0x10", &16, "3,16");
    reads("3,0XfF", &255, "3,255");
    reads("3,-0x80000000", &i32::MIN, "3,-2147483648");
    reads("3,0x7FFFFFFF", &i32::MAX, "3,2147483647");
    reads("17,-0", &0_u8, "17,0");
    reads("10,0x80070057", &HResult::E_INVALIDARG, "10,-2147024809");
    reads("10,0xFFFFFFFF", &HResult(-1), "10,-1");
    reads("11,7", &true, "11,-1");
    reads("11,0x0", &false, "11,0");
    reads("4,1.", &1.0_f32, "4,1");
    reads("4,.5", &0.5_f32, "4,0.5");
    reads("4,000123.0100", &123.01_f32, "4,123.01");
    reads("5,1E+02", &100.0_f64, "5,100");
    reads("5,-1e-1", &-0.1_f64, "5,-0.1");
    reads("5,0.30000000000000004", &(0.1 + 0.2), "5,0.30000000000000004");
    reads("5,0e99999999999999999999", &0.0_f64, "5,0");
    reads("4,16777217", &16_777_216.0_f32, "4,16777216");
    reads("4,INF", &f32::INFINITY, "4,inf");
    reads("5,+inf", &f64::INFINITY, "5,inf");
    reads("5,-Inf", &f64::NEG_INFINITY, "5,-inf");
    reads("4,nan", &f32::from_bits(0x7fc0_0000), "4,NaN");
    reads("4,-NAN", &f32::from_bits(0xffc0_0000), "4,-NaN");
    reads("5,NaN", &f64::from_bits(0x7ff8 << 48), "5,NaN");
    reads("5,-NaN", &f64::from_bits(0xfff8 << 48), "5,-NaN");
    // one digit determines how a number between two neighbours is rounded
    let half = "5,9007199254740993";
    reads(half, &9_007_199_254_740_992.0_f64, "5,9007199254740992");
    let above = format!("{half}.{}1", "0".repeat(300));
    reads(&above, &9_007_199_254_740_994.0_f64, "5,9007199254740994");
}

#[test]
fn numbers_outside_of_their_type_are_refused() {
    for (text, column) in [
        ("2,32768", 3),
        ("2,-32769", 3),
        ("3,2147483648", 3),
        ("3,0xFFFFFFFF", 3),
        ("3,99999999999", 3),
        ("3,99999999999999999999999", 3),
        ("17,256", 4),
        ("17,300", 4),
        ("17,-1", 4),
        ("18,65536", 4),
        ("19,-1", 4),
        ("19,0x100000000", 4),
        ("20,9223372036854775808", 4),
        ("21,18446744073709551616", 4),
        ("6,9223372036854775808", 3),
        ("10,0x100000000", 4),
        ("10,-0x80000001", 4),
        ("10,4294967295", 4),
        ("11,32768", 4),
        ("4,1e39", 3),
        ("4,-1e-50", 3),
        ("5,1e309", 3),
        ("5,1e-400", 3),
        ("8195,1,2147483648", 8),
    ] {
        assert_eq!(refused(text), (K::OutOfRange, column), "{text}");
    }
}

#[test]
fn true_is_minus_one_on_the_wire_whatever_was_written() {
    for (text, data) in
        [("11,1", &[0xff, 0xff][..]), ("11,-7", &[0xff, 0xff]), ("11,0", &[0, 0]), ("8203,2,0", &[0xff, 0xff, 0, 0])]
    {
        assert_eq!(&parsed(text).as_bytes()[6..], data, "{text}");
    }
}

#[test]
fn what_is_wrong_is_named_with_its_column() {
    for (text, kind, column) in [
        ("", K::Type, 1),
        ("x", K::Type, 1),
        ("-3,1", K::Type, 1),
        ("  ,1", K::Type, 3),
        ("9,1", K::UnknownType(9), 1),
        ("13,1", K::UnknownType(13), 1),
        ("14,1", K::UnknownType(14), 1),
        ("16,1", K::UnknownType(16), 1),
        ("22,1", K::UnknownType(22), 1),
        ("16387,1", K::UnknownType(16387), 1),
        ("8201,1", K::UnknownType(8201), 1),
        ("99999999999,1", K::UnknownType(u16::MAX), 1),
        ("3", K::Comma, 2),
        ("3 ,1", K::Comma, 2),
        ("3,", K::Missing, 3),
        ("3, ", K::Missing, 4),
        ("3,-", K::Missing, 4),
        ("3,0x", K::Missing, 5),
        ("3,0xg", K::Digit, 5),
        ("3,abc", K::Digit, 3),
        ("3,1a", K::Digit, 4),
        ("3,1.9", K::Digit, 4),
        ("3,1 ", K::BlankBehind, 4),
        ("3,1\t", K::BlankBehind, 4),
        ("8194,1 ,2", K::BlankBehind, 7),
        ("3,1,2", K::Unexpected, 4),
        ("3,1)", K::Unexpected, 4),
        ("3,1\r", K::Digit, 4),
        ("4,123. 01", K::BlankBehind, 7),
        ("4,.", K::Digit, 3),
        ("4,e5", K::Digit, 3),
        ("4,1.2.3", K::Digit, 6),
        ("5,1..", K::Digit, 5),
        ("4,1e", K::Digit, 5),
        ("4,1e+", K::Digit, 6),
        ("4,0x10", K::Digit, 4),
        ("4,1,5", K::Unexpected, 4),
        ("4,infinity", K::Digit, 6),
        ("4,TRUE", K::Digit, 3),
        ("11,TRUE", K::Digit, 4),
        ("6,1234.5678", K::CurrencyPoint, 7),
        ("8198,1,2.5", K::CurrencyPoint, 9),
        ("0,x", K::NoData, 3),
        ("0x", K::NoData, 2),
        ("1,(", K::NoData, 3),
        ("8192,", K::ArrayOfNothing, 5),
        ("8193,1", K::ArrayOfNothing, 5),
        ("8195,", K::EmptyArray, 6),
        ("8196, ", K::EmptyArray, 7),
        ("8195,1,", K::Missing, 8),
        ("8195,,1", K::Missing, 6),
        ("8204,", K::OpenParen, 6),
        ("8204,8,x", K::OpenParen, 6),
        ("8204,(3,1),", K::OpenParen, 12),
        ("8204,()", K::Type, 7),
        ("8204,(3,1", K::Unbalanced, 10),
        ("8204,(8,a(b)", K::Unbalanced, 13),
        ("8204,(8,a)b)", K::Unexpected, 11),
        ("8204,(3,1))", K::Unexpected, 11),
        ("8204,(3,1)x", K::Unexpected, 11),
        ("8204,(8195,)", K::EmptyArray, 12),
        ("12,8,x", K::OpenParen, 4),
        ("12", K::Comma, 3),
        ("12,(3,1),(3,2)", K::Unexpected, 9),
        ("8200,a)b", K::Unbalanced, 7),
        ("8200,a(b", K::Unbalanced, 9),
        ("8200,a(b,c)d", K::CommaInString, 9),
        ("8,a\rb", K::LineBreak, 4),
        ("8200,a,b\nc", K::LineBreak, 9),
        ("7,2026/11/21", K::DateLayout, 13),
        ("7,2026/11/21 08:05", K::DateLayout, 19),
        ("7,2026/11 21:00:00", K::DateLayout, 10),
        ("7,20261/1/1 1:1:1", K::DateLayout, 3),
        ("7,2026/11/21T08:05:00", K::DateLayout, 13),
        ("7,2026/02/30 00:00:00", K::NoSuchDate, 3),
        ("7,2026/01/01 24:00:00", K::NoSuchDate, 3),
        ("7,2026/01/999 00:00:00", K::NoSuchDate, 3),
        ("7,99/01/01 00:00:00", K::NoSuchDate, 3),
        ("7,2026/01/01 00:00:00x", K::Digit, 22),
        ("7,2026-01-01", K::Digit, 7),
    ] {
        assert_eq!(refused(text), (kind, column), "{text}");
    }
    let error = Buf::parse_text(b"8,a\xffb").unwrap_err();
    assert_eq!((error.kind, error.column), (K::Utf8, 4));
    let error = Buf::parse_text(b"8200,a,\xe3\x81").unwrap_err();
    assert_eq!((error.kind, error.column), (K::Utf8, 8));
    let long = format!("5,0.{}1", "0".repeat(600));
    assert_eq!(refused(&long), (K::NumberTooLong, 3));
    // the exponent counts
    let number = |zeros| format!("5,1.{}e165", "0".repeat(zeros));
    reads(&number(494), &1e165, "5,1e165");
    assert_eq!(refused(&number(495)), (K::NumberTooLong, 3));
}

#[test]
fn blanks_are_dropped_where_the_samples_show_them_and_nowhere_else() {
    reads(" 8196, 1, 2,\t3", &[1.0_f32, 2.0, 3.0], "8196,1,2,3");
    reads("8, Test", &"Test", "8,Test");
    reads("8, \t Test ", &"Test ", "8,Test ");
    reads("8200, a , b", &["a ", "b"], "8200,a ,b");
    reads("8204, ( 8, a ) , ( 2, 1)", &("a ", 1_i16), "8204,(8,a ),(2,1)");
    reads("0, ", &(), "0,");
    reads("0", &(), "0,");
    reads("1", &Null, "1,");
    reads("8204,(0),(1)", &((), Null), "8204,(0,),(1,)");
    assert_eq!(print_of(&" a"), Err(K::LeadingBlank));
    assert_eq!(print_of(&"\ta"), Err(K::LeadingBlank));
    assert_eq!(print_of(&["a", " b"]), Err(K::LeadingBlank));
}

#[test]
fn strings_keep_what_their_place_can_carry() {
    same("8,a)b(,\"c\"", &"a)b(,\"c\"");
    same("8,\0\u{1}\u{7f}é€😀", &"\0\u{1}\u{7f}é€😀");
    same("8200,a,,b(x)", &["a", "", "b(x)"]);
    same("8200,", &[""]);
    same("8200,,", &["", ""]);
    same("8204,(8,a,b(c)),(8,)", &("a,b(c)", ""));
    same("8204,(8200,a,b(c),),(3,1)", &(["a", "b(c)", ""], 1));

    assert_eq!(print_of(&["a,b"]), Err(K::CommaInString));
    assert_eq!(print_of(&["(a,b)"]), Err(K::CommaInString));
    assert_eq!(print_of(&["a)b"]), Err(K::Unbalanced));
    assert_eq!(print_of(&["a(b"]), Err(K::Unbalanced));
    assert_eq!(print_of(&("a)(b",)), Err(K::Unbalanced));
    assert_eq!(print_of(&(["a,b"],)), Err(K::CommaInString));
    assert_eq!(print_of(&"a\rb"), Err(K::LineBreak));
    assert_eq!(print_of(&"a\nb"), Err(K::LineBreak));
    let lone = [0x41, 0, 0x00, 0xd8];
    assert_eq!(print_of(&Bstr::from_utf16le(&lone).unwrap()), Err(K::LoneSurrogate));
}

#[test]
fn characters_are_split_off_as_the_standard_library_does() {
    const BYTES: [u8; 24] = [
        0, 0x41, 0x7f, 0x80, 0x8f, 0x90, 0x9f, 0xa0, 0xbf, 0xc0, 0xc1, 0xc2, 0xdf, 0xe0, 0xe1, 0xec, 0xed, 0xee, 0xef,
        0xf0, 0xf3, 0xf4, 0xf5, 0xff,
    ];
    let compare = |text: &[u8]| {
        let theirs = match core::str::from_utf8(text) {
            Ok(text) => text.chars().next(),
            Err(error) => core::str::from_utf8(&text[..error.valid_up_to()]).unwrap().chars().next(),
        };
        assert_eq!(character(text).map(|(c, rest)| (c, text.len() - rest.len())), theirs.map(|c| (c, c.len_utf8())));
    };
    compare(&[]);
    for first in 0..=0xff {
        compare(&[first]);
        for second in BYTES {
            compare(&[first, second]);
            for third in BYTES {
                compare(&[first, second, third]);
                for fourth in BYTES {
                    compare(&[first, second, third, fourth]);
                }
            }
        }
    }
    for c in (0..=0x10_ffff).filter_map(char::from_u32) {
        compare(c.encode_utf8(&mut [0; 4]).as_bytes());
    }
}

#[test]
fn what_has_no_text_is_an_error() {
    assert_eq!(print_of::<[i32; 0]>(&[]), Err(K::EmptyArray));
    assert_eq!(print_of::<[&str; 0]>(&[]), Err(K::EmptyArray));
    assert_eq!(print_of::<[Variant<'_>; 0]>(&[]), Err(K::EmptyArray));
    assert_eq!(print_of(&(1, [Variant::Null; 0])), Err(K::EmptyArray));
    assert_eq!(print_of(&(1, [0.5_f64; 0])), Err(K::EmptyArray));
    for bytes in [[0, 0x20, 2, 0, 0, 0], [1, 0x20, 0, 0, 0, 0]] {
        let nothings = Variant::decode(&bytes, &Limits::STREAM, Strictness::Strict).unwrap();
        assert_eq!(printed(nothings), Err(K::ArrayOfNothing));
    }
    assert_eq!(print_of(&f32::from_bits(0x7fc0_0001)), Err(K::NanPayload));
    assert_eq!(print_of(&f32::from_bits(0x7f80_0001)), Err(K::NanPayload));
    assert_eq!(print_of(&[f64::from_bits(0xfff8_0000_0000_0001)]), Err(K::NanPayload));
    let opaque = Variant::Opaque(crate::variant::Opaque { vartype: VarType(13), bytes: &[] });
    assert_eq!(printed(opaque), Err(K::Unsendable(13)));
}

#[test]
fn floats_are_written_without_what_says_nothing() {
    for (number, text) in [
        (1.0, "5,1"),
        (-1.0, "5,-1"),
        (-0.0, "5,-0"),
        (123.01, "5,123.01"),
        (1e15, "5,1000000000000000"),
        (1e23, "5,1e23"),
        (1.5e300, "5,1.5e300"),
        (1e-5, "5,0.00001"),
        (1.5e-300, "5,1.5e-300"),
        (f64::MIN_POSITIVE, "5,2.2250738585072014e-308"),
        (5e-324, "5,5e-324"),
        (f64::MAX, "5,1.7976931348623157e308"),
    ] {
        same(text, &number);
    }
    same("4,3.4028235e38", &f32::MAX);
    same("4,1e-45", &f32::from_bits(1));
    same("4,16777216", &16_777_216.0_f32);
}

#[test]
fn dates_are_written_as_dates_when_nothing_is_lost() {
    let date = |civil| OleDate::from_civil(civil).unwrap();
    same("7,2026/11/21 08:05:09", &date(CivilTime::date(2026, 11, 21).at(8, 5, 9)));
    same("7,1899/12/30 00:00:00", &OleDate::from_raw(0.0));
    same("7,0100/01/01 00:00:00", &date(CivilTime::date(100, 1, 1)));
    same("7,1899/12/29 06:00:00", &OleDate::from_raw(-1.25));
    same("7,9999/12/31 23:59:59", &date(CivilTime::date(9999, 12, 31).at(23, 59, 59)));
    same("7,-0", &OleDate::from_raw(-0.0));
    same("7,1e300", &OleDate::from_raw(1e300));
    same("7,NaN", &OleDate::from_raw(f64::from_bits(0x7ff8 << 48)));
    same("7,45000.00000001", &OleDate::from_raw(45_000.000_000_01));
    same("7,45000.123456", &OleDate::from_raw(45_000.123_456));
    let two = [OleDate::from_raw(1.5), OleDate::from_raw(0.123_456_789)];
    same("8199,1899/12/31 12:00:00,0.123456789", &two);
    reads("8199, 1899/12/31 \t 12:00:00, 0.123456789", &two, "8199,1899/12/31 12:00:00,0.123456789");
    reads("7,2026/1/2 3:4:5", &date(CivilTime::date(2026, 1, 2).at(3, 4, 5)), "7,2026/01/02 03:04:05");
    reads("7,45000", &OleDate::from_raw(45_000.0), "7,2023/03/15 00:00:00");
    same("8204,(7,2026/11/21 08:05:09),(3,1)", &(date(CivilTime::date(2026, 11, 21).at(8, 5, 9)), 1));
}

#[test]
fn times_of_a_day_are_written_as_dates() {
    for day in [-400_i16, 0, 32_000] {
        for second in (0..86_400_u32).step_by(29) {
            let (h, m, s) = (second / 3600, second / 60 % 60, second % 60);
            let small = |n: u32| u8::try_from(n).unwrap();
            let civil = OleDate::from_raw(f64::from(day)).to_civil().unwrap().at(small(h), small(m), small(s));
            let text = print_of(&OleDate::from_civil(civil).unwrap()).unwrap();
            assert!(text.ends_with(&format!(" {h:02}:{m:02}:{s:02}")), "{text}");
        }
    }
}

#[test]
fn nesting_goes_as_deep_as_the_limit() {
    for (open, leaf) in [("8204,(", "3,1"), ("12,(", "8,a(b)c")] {
        let deep = |levels: usize| format!("{}{leaf}{}", open.repeat(levels), ")".repeat(levels));
        let max = usize::from(MAX_DEPTH);
        let value = parsed(&deep(max));
        assert_eq!(printed(value.as_variant()), Ok(deep(max)));
        let at = to_u32(open.len() * max + 1);
        assert_eq!(refused(&deep(max + 1)), (K::TooDeep, at));
        assert_eq!(refused(&open.repeat(100_000)), (K::TooDeep, at));
    }
    let tree = "8204,(8204,(3,1),(8204,(8,x),(12,(2,5)))),(8196,1,2),(12,(8204,(3,4)))";
    assert_eq!(printed(parsed(tree).as_variant()).as_deref(), Ok(tree));
}

#[test]
fn what_does_not_fit_is_refused() {
    let error = VariantBuf::<15>::parse_text(b"8195,1,2,3").unwrap_err();
    assert_eq!((error.kind, error.column), (K::Full, 10));
    assert!(VariantBuf::<18>::parse_text(b"8195,1,2,3").is_ok());
    assert_eq!(VariantBuf::<4>::parse_text(b"0").unwrap_err().kind, K::Full);
    assert_eq!(VariantBuf::<13>::parse_text(b"8,ab").unwrap_err().kind, K::Full);
    let value = parsed("8204,(8,Sample),(5,0.5)");
    let text = "8204,(8,Sample),(5,0.5)";
    for room in 0..text.len() {
        assert_eq!(value.as_variant().to_text(&mut vec![0; room]), Err(TextError::from(EncodeError::Full)), "{room}");
    }
    assert_eq!(value.as_variant().to_text(&mut vec![0; text.len()]), Ok(text));
}

/// A small generator with a fixed seed: the same numbers on every run.
struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        self.0.wrapping_mul(0x2545_f491_4f6c_dd1d)
    }

    fn below(&mut self, bound: u64) -> usize {
        usize::try_from(self.next() % bound).unwrap()
    }

    /// Bits in which small numbers, limits and special floats are as frequent as any.
    fn bits(&mut self) -> u64 {
        match self.below(6) {
            0 => self.next(),
            1 => self.next() % 100,
            2 => (self.next() % 100).wrapping_neg(),
            3 => u64::MAX << self.below(64),
            4 => 1_u64 << self.below(64),
            _ => (f64::from(u32::try_from(self.next() >> 40).unwrap()) / 100.0).to_bits(),
        }
    }

    fn string(&mut self, out: &mut Vec<u8>) {
        let units = "aZ09 ,()\t:é€😀\0\u{d7ff}".encode_utf16().collect::<Vec<u16>>();
        let len = self.below(8);
        let text: Vec<u16> = (0..len).map(|_| units[self.below(to_u32(units.len()).into())]).collect();
        out.extend(to_u32(len * 2).to_le_bytes());
        out.extend(text.iter().flat_map(|u| u.to_le_bytes()));
    }

    fn value(&mut self, depth: usize, out: &mut Vec<u8>) {
        const TYPES: [u16; 17] = [0, 1, 2, 3, 4, 5, 6, 7, 8, 10, 11, 12, 17, 18, 19, 20, 21];
        let mut vartype = TYPES[self.below(17)];
        if vartype == 12 && depth == 0 {
            vartype = 8;
        }
        let array = self.below(2) == 1 && vartype > 1;
        let count = if array { self.below(5) } else { 1 };
        out.extend((vartype | if array { 0x2000 } else { 0 }).to_le_bytes());
        out.extend(to_u32(count).to_le_bytes());
        for _ in 0..count {
            let bits = self.bits().to_le_bytes();
            match vartype {
                8 => self.string(out),
                12 => self.value(depth - 1, out),
                11 => out.extend(if bits[0] & 1 == 0 { [0, 0] } else { [0xff, 0xff] }),
                4 if self.below(2) == 0 => {
                    out.extend((f32::from(u16::try_from(self.below(65_536)).unwrap()) / 1000.0).to_le_bytes())
                }
                _ => {
                    let width = match vartype {
                        0 | 1 => 0,
                        17 => 1,
                        2 | 18 => 2,
                        3 | 4 | 10 | 19 => 4,
                        _ => 8,
                    };
                    out.extend(&bits[..width]);
                }
            }
        }
    }
}

#[test]
fn whatever_is_printed_parses_back_to_the_same_bits() {
    let mut random = Random(0x9e37_79b9_7f4a_7c15);
    let (mut written, mut refused) = (0, 0);
    for _ in 0..10_000 {
        let mut bytes = Vec::new();
        let depth = random.below(3);
        random.value(depth, &mut bytes);
        let Ok(value) = Variant::decode(&bytes, &Limits::STREAM, Strictness::Strict) else { panic!("{bytes:?}") };
        match printed(value) {
            Ok(text) => {
                let back = VariantBuf::<8192>::parse_text(text.as_bytes()).unwrap_or_else(|e| panic!("{text}: {e}"));
                assert_eq!(back.as_bytes(), bytes, "{text}");
                written += 1;
            }
            Err(_) => refused += 1,
        }
    }
    assert!(written > 5000 && refused > 500, "{written} written, {refused} refused");
}

#[test]
fn whatever_parses_is_printed_and_parsed_to_the_same_value() {
    const SEEDS: [&str; 8] = [
        "8204,(8,Sample),(2,100),(12,(8200,a,b(c)))",
        "8196,1,2.5,-3e9,NaN,-inf",
        "7,2026/11/21 08:05:09",
        "8199,2026/1/2 3:4:5, 45000.25",
        "8, a(b),c",
        "10,0x80070057",
        "8200, a,,b",
        "8197,1e-300,0.30000000000000004,16777217",
    ];
    const ALPHABET: &[u8] = b"0123456789,,,(()).-+eExX/: \taNnifZ\r\n\0\xc3\xa9";
    let mut random = Random(42);
    let mut good = 0;
    for _ in 0..20_000 {
        let mut text = SEEDS[random.below(8)].as_bytes().to_vec();
        for _ in 0..=random.below(3) {
            let at = random.below(to_u32(text.len()).into());
            let byte = ALPHABET[random.below(to_u32(ALPHABET.len()).into())];
            match random.below(4) {
                0 => text[at] = byte,
                1 => text.insert(at, byte),
                2 if text.len() > 1 => _ = text.remove(at),
                _ => text.truncate(at + 1),
            }
        }
        let value = match Buf::parse_text(&text) {
            Ok(value) => value,
            Err(error) => {
                assert!((1..=to_u32(text.len()) + 1).contains(&error.column), "{error:?}");
                continue;
            }
        };
        good += 1;
        let printed = printed(value.as_variant()).unwrap_or_else(|e| panic!("{text:?}: {e}"));
        assert_eq!(parsed(&printed), value, "{printed}");
    }
    assert!(good > 1500, "{good}");
}

#[test]
fn floats_are_read_as_the_standard_library_reads_them() {
    let mut random = Random(7);
    for _ in 0..20_000 {
        let whole = random.next() >> random.below(64);
        let mut text = whole.to_string();
        for _ in 0..random.below(4) {
            text.push_str(&(random.next() >> random.below(64)).to_string());
        }
        if random.below(2) == 0 {
            text.insert(random.below(to_u32(text.len()).into()), '.');
        }
        if random.below(2) == 0 {
            let size = if random.below(2) == 0 { 40 } else { 330 };
            text.push_str(&format!("e{}", i64::try_from(random.next() % 660).unwrap() % (2 * size) - size));
        }
        let (single, double) = (text.parse::<f32>().unwrap(), text.parse::<f64>().unwrap());
        let zero = text.bytes().take_while(|b| *b != b'e').all(|b| matches!(b, b'0' | b'.'));
        for (vartype, plain, encoded) in [
            (4, (single != 0.0 || zero) && single.is_finite(), Buf::new(&single)),
            (5, (double != 0.0 || zero) && double.is_finite(), Buf::new(&double)),
        ] {
            let line = format!("{vartype},{text}");
            if plain {
                assert_eq!(parsed(&line), encoded.unwrap(), "{line}");
            } else {
                assert_eq!(refused(&line), (K::OutOfRange, 3), "{line}");
            }
        }
    }
}

#[test]
fn every_float_of_a_sweep_is_written_as_short_as_the_standard_library_writes_it() {
    for bits in (0..=u32::MAX).step_by(160_009) {
        let number = f32::from_bits(bits);
        if number.is_nan() {
            continue;
        }
        let text = print_of(&number).unwrap();
        assert_eq!(text[2..].parse::<f32>().unwrap().to_bits(), bits, "{text}");
        let digits = |text: &str| text.bytes().take_while(|b| *b != b'e').filter(u8::is_ascii_digit).count();
        let theirs = format!("{number:e}");
        if number.is_finite() && text.contains('e') {
            assert_eq!(digits(&text[2..]), digits(&theirs), "{text} {theirs}");
        }
    }
}
