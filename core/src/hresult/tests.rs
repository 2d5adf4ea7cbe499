extern crate std;

use std::format;
use std::string::ToString as _;
use std::vec::Vec;

use super::*;

#[test]
fn the_constants_ascend_and_their_columns_are_parallel() {
    let codes: Vec<u32> = CODES.iter().map(|code| code.to_u32()).collect();
    assert!(codes.is_sorted_by(|a, b| a < b), "{codes:x?}");
    assert_eq!([NAMES.len(), MEANINGS.len()], [codes.len(); 2]);
    for text in MEANINGS {
        assert!(text.ends_with('.') && !text.contains('\n'), "{text}");
    }
}

#[test]
fn every_line_of_the_table_is_a_row_and_every_text_keeps_to_its_form() {
    let lines = include_str!("codes.tsv").lines().filter(|line| !line.is_empty() && !line.starts_with('#'));
    assert_eq!(Row::all().count(), lines.clone().count());
    for line in lines {
        let columns: Vec<&str> = line.split('\t').collect();
        assert!([3, 6].contains(&columns.len()) && line.is_ascii() && !line.contains("  "), "{line}");
        let row = Row::parse(line).unwrap();
        assert_eq!(row.patterns().count(), columns[0].split(' ').count(), "{line}");
        for text in [Some(row.meaning), row.cause].into_iter().flatten().filter(|text| !text.is_empty()) {
            assert!(text.ends_with('.') && !text.contains(". "), "{line}");
        }
        let starts = row.remedy.starts_with(|first: char| first.is_ascii_lowercase());
        assert!((starts || row.remedy.starts_with("ClearError")) && !row.remedy.ends_with('.'), "{line}");
    }
}

#[test]
fn a_constant_has_a_row_without_a_meaning_and_no_other_code_has() {
    let unnamed = |row: &Row| row.meaning.is_empty();
    for row in Row::all() {
        for pattern in row.patterns() {
            assert_eq!(
                unnamed(&row),
                pattern.first == pattern.last && HResult::from_u32(pattern.first).name().is_some(),
                "{row:?}"
            );
        }
    }
    assert_eq!(Row::all().filter(unnamed).count(), CODES.len());
    for code in CODES {
        assert!(code.cause().is_some() && code.functions().is_some() && code.source().is_some(), "{code}");
    }
}

#[test]
fn no_pattern_hides_a_narrower_one() {
    let patterns: Vec<(Row, Pattern)> =
        Row::all().flat_map(|row| row.patterns().map(move |pattern| (row, pattern))).collect();
    for (n, (row, pattern)) in patterns.iter().enumerate() {
        assert!(pattern.first <= pattern.last, "{row:?}");
        for code in [pattern.first, pattern.last] {
            let (_, found) = Row::find(code).unwrap();
            assert!(found.width() <= pattern.width(), "{code:x}: {found:?} hides {pattern:?}");
        }
        for (other, same) in patterns.iter().skip(n.saturating_add(1)) {
            assert!(pattern.width() != same.width() || !pattern.contains(same.first), "{row:?} and {other:?}");
        }
    }
}

#[test]
fn an_axis_is_the_last_digit_of_its_patterns_only() {
    for family in [0x8420_4040, 0x8420_4050, 0x8440_4530, 0x8440_4540, 0x8320_4070, 0x854A_5120_u32] {
        for axis in 1..=8_u8 {
            let code = HResult::from_u32(family | u32::from(axis));
            assert_eq!((code.axis(), code.name()), (Some(axis), None), "{code}");
            assert_eq!(HResult::from_u32(code.to_u32() | 0x4000_0000).axis(), Some(axis), "{code}");
        }
        for no_axis in [0, 9, 0xF] {
            assert_eq!(HResult::from_u32(family | no_axis).axis(), None);
        }
    }
    assert_eq!(HResult::E_COMMAND_BUFFER_EMPTY.axis(), None);
    assert_eq!(HResult::from_u32(0x8150_0021).axis(), None, "the fourth argument");
    // the path generator and the servo report other faults
    assert_ne!(HResult::from_u32(0x8420_4053).meaning(), HResult::from_u32(0x8440_4533).meaning());
}

#[test]
fn a_level_is_the_second_digit_of_a_controller_error() {
    assert_eq!(HResult::E_MOTOR_OFF.level(), Some(1));
    assert_eq!(HResult::E_SLVMODE_OFF.level(), Some(3));
    assert_eq!(HResult::E_COMMAND_BUFFER_EMPTY.level(), Some(4));
    assert_eq!(HResult::from_u32(0x8540_0001).level(), Some(5));
    assert_eq!(HResult::from_u32(0x8020_1418).level(), Some(0));
    assert_eq!(HResult::from_u32(0xC420_1486).level(), Some(4));
    for code in [HResult::S_BUF_FULL, HResult::E_TIMEOUT, HResult::E_BUSY_PROC, HResult::from_u32(0x8640_0001)] {
        assert_eq!((code.level(), code.effect(), code.part()), (None, None, None), "{code}");
    }
    let effects: Vec<_> = (0..=5).map(|level| HResult::from_u32(0x8020_1418 | level << 24).effect().unwrap()).collect();
    assert!(effects[0].contains("nothing stops") && effects[2].contains("motor stays on"), "{effects:?}");
    assert!(effects[4].contains("motor goes off") && effects[5].contains("restart"), "{effects:?}");
}

#[test]
fn the_reserved_bit_is_cleared_in_errors_of_the_controller_only() {
    let listed = |code| HResult::from_u32(code).listed().to_u32();
    assert_eq!(listed(0xC420_1486), 0x8420_1486);
    assert_eq!(listed(0x8420_1486), 0x8420_1486);
    assert_eq!(listed(0xC050_0019), 0x8050_0019);
    for other in [0xC000_0005, 0xC007_0057, 0xC600_0000, 0x4420_1486, 0xFFFF_FFFF, 0] {
        assert_eq!(listed(other), other);
    }
    let (folded, code) = (HResult::from_u32(0xC420_1486), HResult::E_COMMAND_POSITION_GEN_STOPPED);
    assert_eq!((folded.meaning(), folded.hint(), folded.cause()), (code.meaning(), code.hint(), code.cause()));
    assert_eq!(folded.name(), None);
}

#[test]
fn a_hint_has_every_step_in_order() {
    let hint = |code| HResult::from_u32(code).hint().unwrap().to_string();
    assert!(hint(0x8150_1003).starts_with("ClearError, turn the motor on"), "{}", hint(0x8150_1003));
    assert_eq!(hint(0x8150_1012), "turn the mode switch to Auto; then ClearError");
    assert_eq!(hint(0x8050_1046), "switch the motor off", "a notice needs no ClearError");
    assert_eq!(hint(0x8150_1001), "switch the motor off; then ClearError");
    assert!(hint(0x8440_4571).ends_with("; then ClearError and motor on"));
    assert!(hint(0x8350_0042).ends_with("; then ClearError, and motor on if it is off"));
    assert!(hint(0x8250_1009).ends_with("restart the controller"));
}

#[test]
fn a_row_goes_before_its_range_and_a_range_before_nothing() {
    let hint = |code| HResult::from_u32(code).hint().unwrap();
    assert_ne!(HResult::E_HANDLE.hint(), Some(hint(0x8007_06BE)));
    assert!(hint(0x8007_06BE).to_string().contains("Windows"));
    assert!(hint(0x8091_006F).to_string().contains("errno"));
    assert_eq!(hint(0x8004_0200), hint(0x8004_FFFF));
    assert_eq!(hint(0x8000_0206), hint(0x8001_01FF));
    // an error of the controller that no list has
    let unknown = HResult::from_u32(0x8550_F001);
    assert!(unknown.hint().unwrap().to_string().contains("GetErrorDescription"), "{:?}", unknown.hint());
    assert_eq!((unknown.level(), unknown.part()), (Some(5), Some("controller software")));
    for outside in [2, 0x0F20_0502, 0x8004_01FF, 0x8001_0200, 0x8002_0001, 0x8600_0000, 0xFFFF_FFFF] {
        let code = HResult::from_u32(outside);
        assert_eq!((code.meaning(), code.hint(), code.axis()), (None, None, None), "{code}");
    }
}

/// The codes of the log of a real RC8A, 1,000 entries; 8 codes for each that has an axis.
const LOGGED: &str = "81501003 81501005 82501009 8150100A 83501035 81501012 81501013 81501019 8150101A 81501025 8350102F \
     83501038 83501039 81400013 82500005 83501026 83501028 83501029 8420404n 8220401n 8320423n 83201501 82201502 83201504 \
     83500076 83201382 81500006 83501024 83500042 8150001B 85400339 82509030 8440451n 8440457n 832040En 844046Dn 8540467n \
     83201699 8150501n 85480003 83400041 83400046 83400047 83400049 8340004C 834A130B 834A130E 854A1384 854A1385 834A2402";

/// Codes of the public lists: `FIRST-LAST:COUNT` has gaps.
const LISTED: &str = include_str!("listed.txt");

/// Returns whether the table has more than the number for a code.
fn is_listed(code: HResult) -> bool {
    code.meaning().is_some_and(|meaning| !meaning.contains("without a published meaning"))
}

#[test]
fn every_code_of_a_real_log_has_its_meaning_and_remedy() {
    for text in LOGGED.split_whitespace() {
        for axis in 1..=8_u8 {
            let digits = text.replace('n', &axis.to_string());
            let code = HResult::from_u32(u32::from_str_radix(&digits, 16).unwrap());
            assert!(is_listed(code) && code.hint().is_some() && code.level().is_some(), "{text}");
            assert_eq!(code.axis(), text.ends_with('n').then_some(axis), "{text}");
        }
    }
}

#[test]
fn nine_of_ten_listed_codes_have_a_row() {
    let (mut covered, mut all) = (0_u32, 0_u32);
    for text in LISTED.split_whitespace() {
        let (range, count) = text.split_once(':').map_or((text, None), |(range, count)| (range, Some(count)));
        let (first, last) = range.split_once('-').unwrap_or((range, range));
        let [first, last] = [first, last].map(|digits| u32::from_str_radix(digits, 16).unwrap());
        if let Some(count) = count {
            let count: u32 = count.parse().unwrap();
            all += count;
            covered += if [first, last].into_iter().all(|code| is_listed(HResult::from_u32(code))) { count } else { 0 };
            continue;
        }
        for code in first..=last {
            all += 1;
            covered += u32::from(is_listed(HResult::from_u32(code)));
        }
    }
    assert!(all == 7_611 && covered >= 7_450, "{covered} of {all}");
}

#[test]
fn the_specified_codes_have_the_specified_values() {
    for (code, value) in [
        (HResult::S_OK, 0x0000_0000),
        (HResult::S_EXECUTING, 0x0000_0900),
        (HResult::S_BUF_FULL, 0x0F20_0501),
        (HResult::E_CAO_PRELOAD, 0x8000_020D),
        (HResult::E_CAOP_NOT_WRITABLE, 0x8000_0404),
        (HResult::E_TIMEOUT, 0x8000_0900),
        (HResult::E_NOT_CONNECTED, 0x8000_0902),
        (HResult::E_UNEXPECTED, 0x8000_FFFF),
        (HResult::E_INVALIDRCPACKET, 0x8001_0001),
        (HResult::E_PACKETSIZEOVER, 0x8001_0011),
        (HResult::DISP_E_TYPEMISMATCH, 0x8002_0005),
        (HResult::E_HANDLE, 0x8007_0006),
        (HResult::E_INVALIDARG, 0x8007_0057),
        (HResult::E_BUSY_PROC, 0x8091_00AA),
        (HResult::E_BUF_FULL, 0x8320_1483),
        (HResult::E_MOTION_STOPPED, 0x8350_0076),
        (HResult::E_SLVMODE_OFF, 0x8350_0121),
        (HResult::E_COMMAND_BUFFER_EMPTY, 0x8420_1482),
    ] {
        assert_eq!(code.to_u32(), value, "{code:?}");
        assert_eq!(HResult::from_u32(value), code);
    }
    assert_eq!(HResult::default(), HResult::S_OK);
    assert_eq!(HResult::E_TIMEOUT.0, -2_147_481_344);
}

#[test]
fn names_round_trip_in_any_case() {
    for code in CODES {
        let name = code.name().unwrap();
        assert_eq!(HResult::from_name(name), Some(*code));
        assert_eq!(HResult::from_name(&name.to_ascii_lowercase()), Some(*code));
    }
    assert_eq!(HResult::from_name("e_Timeout"), Some(HResult::E_TIMEOUT));
    for unknown in ["", "E_", "E_TIMEOUT ", "0x80000900", "É_TIMEOUT"] {
        assert_eq!(HResult::from_name(unknown), None, "{unknown:?}");
    }
}

#[test]
fn names_have_the_prefix_of_their_severity() {
    for code in CODES {
        let name = code.name().unwrap();
        assert_eq!(name.starts_with("S_"), code.is_ok(), "{name}");
        assert_eq!(name.starts_with("E_") || name.starts_with("DISP_E_"), code.is_err(), "{name}");
    }
}

#[test]
fn only_bit_31_decides_success() {
    for code in [0, 1, 0x900, 0x0F20_0501, 0x7FFF_FFFF] {
        let code = HResult::from_u32(code);
        assert!(code.is_ok() && !code.is_err(), "{code}");
    }
    for code in [0x8000_0000, 0x8000_0900, 0x8320_1483, 0xFFFF_FFFF] {
        let code = HResult::from_u32(code);
        assert!(code.is_err() && !code.is_ok(), "{code}");
    }
}

#[test]
fn an_os_error_is_the_low_half_of_0x8091() {
    assert_eq!(HResult::from_u32(0x8091_006F).os_error(), Some(111));
    assert_eq!(HResult::from_u32(0x8091_274C).os_error(), Some(10060));
    assert_eq!(HResult::from_u32(0x8091_0000).os_error(), Some(0));
    assert_eq!(HResult::E_BUSY_PROC.os_error(), None);
    assert_eq!(HResult::E_WINSOCK_MASK.os_error(), None);
    assert_eq!(HResult::from_u32(0x8090_006F).os_error(), None);
    assert_eq!(HResult::from_u32(0x0091_006F).os_error(), None);
}

#[test]
fn known_codes_print_their_name_and_unknown_ones_their_number() {
    assert_eq!(format!("{:?}", HResult::E_TIMEOUT), "E_TIMEOUT");
    assert_eq!(format!("{:?}", HResult::from_u32(0x8420_404F)), "HResult(0x8420404f)");
    assert_eq!(format!("{:?}", HResult(2)), "HResult(0x00000002)");
    assert_eq!(HResult::E_TIMEOUT.to_string(), "0x80000900 (E_TIMEOUT)");
    assert_eq!(HResult::S_OK.to_string(), "0x00000000 (S_OK)");
    assert_eq!(HResult::from_u32(0x8420_404F).to_string(), "0x8420404f");
    assert_eq!(HResult(-1).to_string(), "0xffffffff");
}
