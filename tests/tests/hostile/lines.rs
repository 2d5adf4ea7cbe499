//! Invalid lines of RAC, and lines whose values do not fit their type: the server answers every line and reads the next.

use std::io::Write;

use bcap_core::hresult::HResult;
use bcap_core::variant::VariantBuf;
use bcap_testkit::network::Random;
use bcap_testkit::wire::{Received, Wire};

use crate::Case;
use crate::target::{Target, limits};
use crate::wire::LIMIT;

pub(crate) const CASES: &[Case] = crate::cases! {
    lines:
        lines_over_256_bytes
        a_line_that_never_ends
        a_line_that_stops
        a_line_at_a_byte_a_time
        lines_in_one_piece
        arrays_of_nothing
        nesting_of_any_depth_in_text
        strings_of_any_length_in_text
        numbers_out_of_their_range
        numbers_that_are_none
        a_leading_zero_is_not_octal
        blanks_where_there_should_be_none
        parentheses_that_do_not_pair
        bytes_that_are_no_text
        types_that_text_does_not_have
        unknown_verbs_fields_and_variables
        numbers_come_back_as_they_were
        text_and_random_bytes
        rac_connections_past_the_limit
        a_line_to_the_wrong_port
};

/// A connection that sends lines.
struct Lines(Wire);

impl Lines {
    fn connect(target: &Target) -> Self {
        Self(Wire::connect_rac(target.rac, LIMIT).unwrap())
    }

    fn send(&mut self, bytes: &[u8]) {
        // the server may have closed before it has read all
        let _ = self.0.send(bytes);
    }

    /// Receives an answer; `None` when the server has closed.
    fn answer(&mut self) -> Option<String> {
        match self.0.receive(LIMIT) {
            Received::Packet(line) => Some(String::from_utf8(line.strip_suffix(b"\r")?.to_vec()).unwrap()),
            Received::Closed => None,
            Received::Silence => panic!("every line is answered"),
        }
    }

    fn line(&mut self, line: impl AsRef<[u8]>) -> String {
        self.send(&[line.as_ref(), b"\r"].concat());
        self.answer().expect("every line is answered")
    }

    /// Asserts that a line is refused with a code, and that the next is served.
    fn refuses(&mut self, line: impl AsRef<[u8]>, code: HResult) {
        let shown = String::from_utf8_lossy(line.as_ref()).chars().take(60).collect::<String>();
        let answer = self.line(line);
        let found = answer.parse().map(HResult).unwrap_or_default();
        assert_eq!(found, code, "{shown:?} is answered with {answer:?}");
        assert_eq!(self.line("PUT:RC8:9:I:3,5"), "0");
        assert_eq!(self.line("GET:RC8:9:I:"), "0,3,5", "after {shown:?}");
    }

    /// Writes a value to a variable and reads it back.
    fn through(&mut self, kind: &str, value: &str) -> String {
        assert_eq!(self.line(format!("PUT:RC8:1:{kind}:{value}")), "0", "{value}");
        self.line(format!("GET:RC8:1:{kind}:"))
    }
}

/// Asserts that the parser of values refuses a text, however much memory it has.
fn has_no_value(text: &[u8]) {
    let shown: String = String::from_utf8_lossy(text).chars().take(60).collect();
    assert!(VariantBuf::<100_000>::parse_text(text).is_err(), "{shown:?}");
}

fn lines_over_256_bytes(target: &mut Target) {
    let mut lines = Lines::connect(target);
    for length in [256, 257, 300, 5000, 16_383, 16_384, 70_000, 1_000_000] {
        lines.refuses(vec![b'x'; length], HResult::E_PACKETSIZEOVER);
        let string = [&b"PUT:RC8:1:S:8,"[..], &vec![b'x'; length]].concat();
        lines.refuses(string, HResult::E_PACKETSIZEOVER);
    }
    // the longest line that there is, its CR included
    let longest = format!("PUT:RC8:1:S:8,{}", "x".repeat(255 - 14));
    assert_eq!(lines.line(&longest), "0");
}

/// A line that never ends is answered once, and costs a line of memory; its connection ends when its time is over.
fn a_line_that_never_ends(target: &mut Target) {
    let mut lines = Lines::connect(target);
    let mut writer = lines.0.stream().unwrap().try_clone().unwrap();
    let sending = std::thread::spawn(move || {
        let mut sent = 0_u64;
        while sent < 64 << 20 && writer.write_all(&[b'x'; 4096]).is_ok() {
            sent += 4096;
        }
        sent
    });
    assert_eq!(lines.answer(), Some(HResult::E_PACKETSIZEOVER.0.to_string()));
    target.serves_others();
    if sending.join().unwrap() >= 64 << 20 {
        // all of it fitted into the time for a line
        lines.send(b"\r");
        assert_eq!(lines.line(""), HResult::E_INVALIDCOMMAND.0.to_string());
    } else {
        assert_eq!(lines.answer(), None);
    }
}

fn a_line_that_stops(target: &mut Target) {
    let mut all: Vec<Lines> = (0..40).map(|_| Lines::connect(target)).collect();
    all.iter_mut().for_each(|lines| lines.send(b"GET:RC8:1"));
    target.serves_others();
    std::thread::sleep(limits().receive / 2);
    for mut lines in all {
        assert_eq!(lines.answer(), None);
    }
}

fn a_line_at_a_byte_a_time(target: &mut Target) {
    let mut lines = Lines::connect(target);
    lines.line("PUT:RC8:9:I:3,5");
    for _ in 0..5 {
        for byte in b" \tGET:RC8:9:I:\r" {
            lines.send(&[*byte]);
        }
        assert_eq!(lines.answer().as_deref(), Some("0,3,5"));
    }
}

fn lines_in_one_piece(target: &mut Target) {
    let mut lines = Lines::connect(target);
    lines.line("PUT:RC8:9:I:3,5");
    lines.send(&b"GET:RC8:9:I:\rnothing\r\r\n\xff\r".repeat(200));
    for _ in 0..200 {
        assert_eq!(lines.answer().as_deref(), Some("0,3,5"));
        for _ in 0..3 {
            assert!(lines.answer().unwrap().starts_with('-'));
        }
    }
}

fn arrays_of_nothing(target: &mut Target) {
    let mut lines = Lines::connect(target);
    for value in ["8192,", "8193,", "8192,1", "8193,1,2", "8195,", "8197,", "8204,", "8195,1,,2", "8204,(3,1),,(3,2)"] {
        lines.refuses(format!("PUT:RC8:1:P:{value}"), HResult::E_INVALIDARGTYPE);
        has_no_value(value.as_bytes());
    }
}

fn nesting_of_any_depth_in_text(target: &mut Target) {
    let mut lines = Lines::connect(target);
    lines.refuses(format!("PUT:RC8:1:P:{}", "8204,(".repeat(40)), HResult::E_INVALIDARGTYPE);
    lines.refuses(format!("PUT:RC8:1:P:8204,{}", "(".repeat(200)), HResult::E_INVALIDARGTYPE);
    for levels in [17, 1000, 20_000, 100_000] {
        let text = format!("{}3,1{}", "8204,(".repeat(levels), ")".repeat(levels));
        has_no_value(text.as_bytes());
        has_no_value(&b"12,(".repeat(levels));
        has_no_value(&b"(".repeat(levels));
    }
    let deepest = format!("{}3,1{}", "8204,(".repeat(16), ")".repeat(16));
    assert!(VariantBuf::<1000>::parse_text(deepest.as_bytes()).is_ok());
}

fn strings_of_any_length_in_text(_: &mut Target) {
    for length in [0, 1, 16_382, 16_383, 16_384, 40_000] {
        let text = format!("8,{}", "x".repeat(length));
        let value = VariantBuf::<100_000>::parse_text(text.as_bytes()).unwrap();
        assert_eq!(value.as_variant().as_bstr().unwrap().len(), length);
    }
    // where the memory ends, so does the value, and it is said
    assert!(VariantBuf::<1000>::parse_text(format!("8,{}", "x".repeat(16_384)).as_bytes()).is_err());
}

fn numbers_out_of_their_range(target: &mut Target) {
    let mut lines = Lines::connect(target);
    let out_of_range = [
        "3,99999999999",
        "3,2147483648",
        "3,-2147483649",
        "2,32768",
        "17,256",
        "17,300",
        "17,65535",
        "17,-1",
        "18,65536",
        "19,-1",
        "20,9223372036854775808",
        "21,18446744073709551616",
        "4,1e39",
        "4,1e-50",
        "5,1e400",
        "5,1e-400",
        "3,0x100000000",
        &format!("3,{}", "9".repeat(200)),
        &format!("4,0.{}1", "0".repeat(200)),
    ];
    for value in out_of_range {
        lines.refuses(format!("PUT:RC8:1:I:{value}"), HResult::E_INVALIDARGTYPE);
    }
    has_no_value(format!("5,1{}", "0".repeat(100_000)).as_bytes());
    has_no_value(format!("3,{}", "9".repeat(100_000)).as_bytes());
}

fn numbers_that_are_none(target: &mut Target) {
    let mut lines = Lines::connect(target);
    let none = [
        "3,",
        "3,TRUE",
        "3,1.9",
        "3,1.xyz",
        "3,--1",
        "3,0x",
        "3,1,2",
        "4,123. 01",
        "4,.",
        "4,1e",
        "5,1,5",
        "6,123.4567",
        "7,tomorrow",
        "7,2026/02/30 00:00:00",
        "7,2026/01/01",
        "11,TRUE",
        "0,1",
        "1,x",
    ];
    for value in none {
        lines.refuses(format!("PUT:RC8:1:I:{value}"), HResult::E_INVALIDARGTYPE);
    }
}

fn a_leading_zero_is_not_octal(target: &mut Target) {
    let mut lines = Lines::connect(target);
    assert_eq!(lines.through("I", "3,010"), "0,3,10");
    assert_eq!(lines.through("I", "3,-0099"), "0,3,-99");
    assert_eq!(lines.through("I", "3,0x10"), "0,3,16");
}

fn blanks_where_there_should_be_none(target: &mut Target) {
    let mut lines = Lines::connect(target);
    for value in ["3,1 ", "8195,1 ,2", "3,1 2", "3 ,1", "8204,(3,1 )"] {
        lines.refuses(format!("PUT:RC8:1:I:{value}"), HResult::E_INVALIDARGTYPE);
    }
    assert_eq!(lines.through("I", " 3,  1"), "0,3,1");
    assert_eq!(lines.through("P", "8196, 1, 2,3"), "0,8196,1,2,3");
}

fn parentheses_that_do_not_pair(target: &mut Target) {
    let mut lines = Lines::connect(target);
    for value in
        ["8200,a(b", "8200,a)b", "8204,(8,a", "8204,8,a)", "8204,((8,a)", "12,(8,Sample", "12,8,Sample)", "12,()"]
    {
        lines.refuses(format!("PUT:RC8:1:S:{value}"), HResult::E_INVALIDARGTYPE);
    }
    // at the top level a string is taken literally
    assert_eq!(lines.through("S", "8,a)(b,c("), "0,8,a)(b,c(");
    assert_eq!(lines.through("S", "12,(8,Sample)"), "0,12,(8,Sample)");
    assert_eq!(lines.through("S", "8204,(0),(1),(8,a,b)"), "0,8204,(0,),(1,),(8,a,b)");
}

fn bytes_that_are_no_text(target: &mut Target) {
    let mut lines = Lines::connect(target);
    for bytes in [&b"\xff\xfe"[..], b"\xc3", b"\xed\xa0\x80", b"\x80", b"\xf5\x80\x80\x80"] {
        lines.refuses([b"PUT:RC8:1:S:8,", bytes].concat(), HResult::E_INVALIDARGTYPE);
    }
    // text in any language is valid
    assert_eq!(lines.through("S", "8,\u{65e5}\u{672c} \u{1f600}"), "0,8,\u{65e5}\u{672c} \u{1f600}");
    assert_eq!(lines.through("S", "8,a\0b"), "0,8,a\0b");
}

fn types_that_text_does_not_have(target: &mut Target) {
    let mut lines = Lines::connect(target);
    for vartype in
        ["9", "13", "14", "16", "22", "23", "8201", "16387", "65535", "65536", "99999999999", "-3", "0x3", "", "x"]
    {
        lines.refuses(format!("PUT:RC8:1:I:{vartype},1"), HResult::E_INVALIDARGTYPE);
    }
}

fn unknown_verbs_fields_and_variables(target: &mut Target) {
    let mut lines = Lines::connect(target);
    for line in ["", "x", "\0", "DEL:RC8:1:I:", "GET:RC9:1:I:", "GET:RC8:1:X:", "PUT:RC8:10:10:"] {
        lines.refuses(line, HResult::E_INVALIDCOMMAND);
    }
    for line in
        ["GET:RC8:1:I", "GET:RC8:-1:I:", "GET:RC8::I:", "GET:RC8:4294967296:I:", "GET:RC8:1:I:3,1", "GET:RC8:1e1:I:"]
    {
        lines.refuses(line, HResult::E_INVALIDARG);
    }
}

/// Digits and signs are preserved, independent of the locale.
fn numbers_come_back_as_they_were(target: &mut Target) {
    let mut lines = Lines::connect(target);
    let same = [
        "3,-5",
        "3,-2147483648",
        "19,4294967295",
        "21,18446744073709551615",
        "4,16777216",
        "4,0.1",
        "4,-0",
        "5,0.30000000000000004",
        "5,3.141592653589793",
        "5,5e-324",
        "5,1.7976931348623157e308",
        "6,-12345678",
        "7,2026/11/21 08:05:00",
        "10,-2147467259",
        "8196,1,2.5,-3000000000",
        "8204,(3,-2),(5,1.5)",
    ];
    for value in same {
        assert_eq!(lines.through("D", value), format!("0,{value}"));
    }
    for value in ["5,inf", "5,-inf", "5,nan"] {
        let back = lines.through("D", value);
        assert_eq!(back.to_ascii_lowercase(), format!("0,{value}"));
    }
}

fn text_and_random_bytes(target: &mut Target) {
    let mut random = Random(3);
    let mut lines = Lines::connect(target);
    for _ in 0..300 {
        let alphabet = b"GETPUT:RC8IFDSVPJO0123456789,()-+.ex \t\n\xff\0";
        let length = random.below(300);
        let line: Vec<u8> = (0..length).map(|_| alphabet[random.below(alphabet.len() as u64) as usize]).collect();
        assert!(lines.line(line).starts_with('-'));
    }
    assert_eq!(lines.line("PUT:RC8:9:I:3,5"), "0");
}

fn rac_connections_past_the_limit(target: &mut Target) {
    // one slot is the bystander's, and one is left for new clients
    let mut inside: Vec<Lines> = (0..limits().connections_per_address - 2).map(|_| Lines::connect(target)).collect();
    for lines in &mut inside {
        assert_eq!(lines.line("PUT:RC8:9:I:3,5"), "0");
    }
    target.serves_others();
    let mut outside: Vec<Lines> = (0..10).map(|_| Lines::connect(target)).collect();
    let answers: Vec<String> = outside.iter_mut().map(|lines| lines.line("GET:RC8:9:I:")).collect();
    let refusal = HResult::E_MAX_CONNECT.0.to_string();
    // at most one place was free
    assert!(answers.iter().filter(|answer| **answer == refusal).count() >= 9, "{answers:?}");
    for lines in &mut inside {
        assert_eq!(lines.line("GET:RC8:9:I:"), "0,3,5");
    }
}

fn a_line_to_the_wrong_port(target: &mut Target) {
    let mut lines = Lines::connect(target);
    lines.send(&crate::wire::bytes(bcap_core::bcap::FunctionId::SERVICE_START, vec![]));
    lines.refuses("", HResult::E_INVALIDCOMMAND);
}
