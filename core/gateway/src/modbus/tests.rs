//! Requests of a client against a server of RAC with a table of variables.
#![expect(clippy::arithmetic_side_effects, reason = "an overflow here fails the test, as it should")]

extern crate std;

use super::*;
use bcap_core::hresult::HResult;
use bcap_core::rac::Variable;
use std::collections::BTreeMap;
use std::string::String;
use std::vec::Vec;

/// A server of RAC, and a session before it.
struct Bench {
    session: Session<'static>,
    /// The values, in the text of a line.
    values: BTreeMap<Variable, String>,
    /// The lines that arrived.
    lines: Vec<String>,
    /// The variables that may not be written.
    protected: Vec<Variable>,
    /// The variables that may not be read.
    hidden: Vec<Variable>,
    /// The result of the robot for every line, if it is not S_OK.
    result: HResult,
}

fn bench(registers: &[&str], coils: &[&str]) -> Bench {
    let registers = registers.iter().map(|text| Entry::registers(text).unwrap());
    let map: Vec<_> = registers.chain(coils.iter().map(|text| Entry::coils(text).unwrap())).collect();
    Bench {
        session: Session::new(map.leak()),
        values: BTreeMap::new(),
        lines: Vec::new(),
        protected: Vec::new(),
        hidden: Vec::new(),
        result: HResult::S_OK,
    }
}

impl Bench {
    fn answer(&mut self, line: &str) -> String {
        let mut memory = [0; 512];
        let result = |code: HResult| std::format!("{}\r", code.0);
        match Request::parse(line.as_bytes(), &mut memory) {
            Err(error) => result(error.hresult()),
            Ok(_) if self.result.is_err() => result(self.result),
            Ok(Request::Get(variable)) if self.hidden.contains(&variable) => result(HResult::E_ACCESSDENIED),
            Ok(Request::Get(variable)) => match self.values.get(&variable) {
                Some(value) => std::format!("0,{value}\r"),
                None => result(HResult::E_FAIL),
            },
            Ok(Request::Put(variable, _)) if self.protected.contains(&variable) => result(HResult::E_ACCESSDENIED),
            Ok(Request::Put(variable, value)) => {
                let mut text = [0; 256];
                let text = value.to_text(&mut text).unwrap();
                self.values.insert(variable, text.into());
                result(HResult::S_OK)
            }
        }
    }

    /// Moves bytes until nothing more moves, in chunks of a size; returns the responses.
    fn exchange(&mut self, mut bytes: &[u8], chunk: usize) -> Vec<u8> {
        let mut responses = Vec::new();
        let mut begun = String::new();
        loop {
            let (protected, hidden) = (self.protected.clone(), self.hidden.clone());
            let permits = |request: &Request<'_>| match request {
                Request::Get(variable) => !hidden.contains(variable),
                Request::Put(variable, _) => !protected.contains(variable),
            };
            let count = chunk.min(bytes.len()).min(self.session.room());
            let (now, rest) = bytes.split_at(count);
            bytes = rest;
            self.session.received(now, permits);
            let line = self.session.line();
            let taken = chunk.min(line.len());
            begun.push_str(core::str::from_utf8(&line[..taken]).unwrap());
            self.session.line_taken(taken);
            if let Some(line) = begun.strip_suffix('\r') {
                self.lines.push(line.into());
                let reply = self.answer(&core::mem::take(&mut begun).replace('\r', ""));
                for part in reply.as_bytes().chunks(chunk) {
                    self.session.replied(part, permits);
                }
            }
            let response = self.session.transmit();
            let sent = chunk.min(response.len());
            responses.extend_from_slice(&response[..sent]);
            self.session.transmitted(sent);
            if count == 0 && taken == 0 && sent == 0 {
                return responses;
            }
        }
    }

    /// Sends one request and returns the function and the data of its response.
    fn ask(&mut self, function: &[u8]) -> Vec<u8> {
        let response = self.exchange(&framed(0xabcd, 7, function), usize::MAX);
        let length = u16::try_from(response.len() - 6).unwrap().to_be_bytes();
        assert_eq!(response[..7], [0xab, 0xcd, 0, 0, length[0], length[1], 7]);
        response[7..].to_vec()
    }

    fn set(&mut self, kind: &str, index: u32, value: &str) {
        let kind = bcap_core::rac::VariableKind::from_name(kind).unwrap();
        self.values.insert(Variable::new(kind, index), value.into());
    }
}

fn framed(transaction: u16, unit: u8, function: &[u8]) -> Vec<u8> {
    let length = u16::try_from(function.len() + 1).unwrap();
    [&transaction.to_be_bytes(), &[0, 0][..], &length.to_be_bytes(), &[unit], function].concat()
}

#[test]
fn registers_of_several_kinds_are_read_in_one_request() {
    let mut bench = bench(&["100=I/10-11:i16", "102=F/5", "104=D/1:low"], &[]);
    bench.set("I", 10, "3,7");
    bench.set("I", 11, "3,-1");
    bench.set("F", 5, "4,1.5");
    bench.set("D", 1, "5,-2");
    for function in [3, 4] {
        let data = [[0, 7].as_slice(), &[0xff, 0xff], &[0x3f, 0xc0, 0, 0], &[0, 0, 0, 0, 0, 0, 0xc0, 0]].concat();
        assert_eq!(bench.ask(&[function, 0, 100, 0, 8]), [[function, 16].as_slice(), &data].concat());
    }
    assert_eq!(bench.lines[..4], ["GET:RC8:10:I:", "GET:RC8:11:I:", "GET:RC8:5:F:", "GET:RC8:1:D:"]);
}

#[test]
fn a_read_may_begin_and_end_within_a_variable() {
    let mut bench = bench(&["0=P/0-1"], &[]);
    bench.set("P", 0, "8196,1,2,3,4,5,6,-1");
    bench.set("P", 1, "8196,10,20,30,40,50,60,5");
    // the low half of rz and the figure of P0, and the high half of x of P1
    assert_eq!(bench.ask(&[3, 0, 11, 0, 4]), [3, 8, 0, 0, 0xbf, 0x80, 0, 0, 0x41, 0x20]);
}

#[test]
fn writes_become_puts_of_the_type_of_the_variable() {
    let mut bench = bench(&["100=I/10-11:i16", "200=I/20:low", "300=V/1", "400=D/2:f32"], &["0=IO/128-143"]);
    assert_eq!(bench.ask(&[6, 0, 101, 0xff, 0xfe]), [6, 0, 101, 0xff, 0xfe]);
    assert_eq!(bench.ask(&[16, 0, 100, 0, 2, 4, 0, 1, 0, 2]), [16, 0, 100, 0, 2]);
    assert_eq!(bench.ask(&[16, 0, 200, 0, 2, 4, 0, 1, 0, 2]), [16, 0, 200, 0, 2]);
    let vector = [16, 1, 44, 0, 6, 12, 0x3f, 0x80, 0, 0, 0x40, 0, 0, 0, 0xc0, 0x40, 0, 0];
    assert_eq!(bench.ask(&vector), [16, 1, 44, 0, 6]);
    assert_eq!(bench.ask(&[16, 1, 144, 0, 2, 4, 0x3f, 0, 0, 0]), [16, 1, 144, 0, 2]);
    assert_eq!(bench.ask(&[5, 0, 1, 0xff, 0]), [5, 0, 1, 0xff, 0]);
    assert_eq!(bench.ask(&[5, 0, 2, 0, 0]), [5, 0, 2, 0, 0]);
    assert_eq!(bench.ask(&[15, 0, 7, 0, 9, 2, 0b1000_0001, 1]), [15, 0, 7, 0, 9]);
    let expected = [
        "PUT:RC8:11:I:3,-2",
        "PUT:RC8:10:I:3,1",
        "PUT:RC8:11:I:3,2",
        "PUT:RC8:20:I:3,131073",
        "PUT:RC8:1:V:8196,1,2,-3",
        "PUT:RC8:2:D:5,0.5",
        "PUT:RC8:129:IO:11,-1",
        "PUT:RC8:130:IO:11,0",
    ];
    assert_eq!(bench.lines[..8], expected);
    // the nine coils from 7 on, and one of them that was not written
    for at in 128..135 {
        bench.set("IO", at, "11,0");
    }
    assert_eq!(bench.ask(&[1, 0, 6, 0, 10]), [1, 2, 0b0000_0010, 0b11]);
    assert_eq!(bench.ask(&[2, 0, 15, 0, 1]), [2, 1, 1]);
}

#[test]
fn requests_without_variables_are_refused_and_become_a_line_for_the_log() {
    let mut bench = bench(&["100=I/10", "102=I/11"], &["0=IO/1"]);
    for (function, exception) in [
        (&[3_u8, 0, 99, 0, 2][..], Exception::IllegalDataAddress),
        (&[3, 0, 102, 0, 3], Exception::IllegalDataAddress),
        (&[3, 255, 255, 0, 2], Exception::IllegalDataAddress),
        (&[1, 0, 100, 0, 1], Exception::IllegalDataAddress),
        (&[6, 0, 100, 0, 1], Exception::IllegalDataAddress),
        (&[16, 0, 101, 0, 2, 4, 0, 0, 0, 0], Exception::IllegalDataAddress),
        (&[3, 0, 100, 0, 126], Exception::IllegalDataValue),
        (&[24, 0, 100, 0, 0, 0, 0], Exception::IllegalFunction),
        (&[43], Exception::IllegalFunction),
    ] {
        assert_eq!(bench.ask(function), [function[0] | 0x80, exception.code()], "{function:?}");
    }
    assert_eq!(bench.lines[0], "MODBUS:3:99:2");
    assert_eq!(bench.lines[2], "MODBUS:3:65535:2");
    assert_eq!(bench.lines[8], "MODBUS:43:0:0");
    assert_eq!(bench.lines.len(), 9, "none of them reached a variable");
}

#[test]
fn a_write_that_the_rules_refuse_in_part_writes_nothing() {
    let mut bench = bench(&["100=I/10-12:i16"], &[]);
    bench.protected = std::vec![Variable::new(bcap_core::rac::VariableKind::I, 11)];
    assert_eq!(bench.ask(&[16, 0, 100, 0, 3, 6, 0, 1, 0, 2, 0, 3]), [0x90, 2]);
    assert_eq!(bench.lines, ["PUT:RC8:11:I:3,2"], "the refused line, for the log");
    assert!(bench.values.is_empty());
    assert_eq!(bench.ask(&[6, 0, 102, 0, 3]), [6, 0, 102, 0, 3]);
}

#[test]
fn errors_of_the_gateway_are_exceptions() {
    let mut bench = bench(&["0=I/0"], &[]);
    for (result, exception) in [
        (HResult::E_NOT_CONNECTED, 0x0a),
        (HResult::E_TIMEOUT, 0x0b),
        (HResult::E_BUSY_PROC, 6),
        (HResult::E_SLVMODE_ON, 6),
        (HResult::E_MAX_CONNECT, 6),
        (HResult::E_ACCESSDENIED, 2),
        (HResult::E_INVALIDARG, 3),
        (HResult::E_INVALIDARGTYPE, 3),
        (HResult::E_FAIL, 4),
    ] {
        bench.result = result;
        assert_eq!(bench.ask(&[3, 0, 0, 0, 2]), [0x83, exception], "{result}");
    }
    bench.result = HResult::S_OK;
    for value in ["8,seven", "3,70000,1", "4,1.5", "nonsense"] {
        bench.set("I", 0, value);
        assert_eq!(bench.ask(&[3, 0, 0, 0, 2]), [0x83, 4], "{value}");
    }
    bench.set("I", 0, "3,7");
    assert_eq!(bench.ask(&[3, 0, 0, 0, 2]), [3, 4, 0, 0, 0, 7], "the next request is served");
}

#[test]
fn a_permitted_write_that_the_robot_refuses_is_a_failure_of_the_device() {
    let mut bench = bench(&["100=I/10-11:i16"], &[]);
    for result in [HResult::E_ACCESSDENIED, HResult::E_INVALIDARG, HResult::E_INVALIDARGTYPE] {
        bench.result = result;
        assert_eq!(bench.ask(&[6, 0, 100, 0, 1]), [0x86, 4], "{result}");
        assert_eq!(bench.ask(&[16, 0, 100, 0, 2, 4, 0, 1, 0, 2]), [0x90, 4], "{result}");
        assert_eq!(bench.ask(&[23, 0, 100, 0, 1, 0, 100, 0, 1, 2, 0, 9]), [23 | 0x80, 4], "{result}");
    }
    bench.result = HResult::E_BUSY_PROC;
    assert_eq!(bench.ask(&[6, 0, 100, 0, 1]), [0x86, 6]);
}

#[test]
fn the_chunks_of_the_bytes_do_not_matter() {
    let mut all = Vec::new();
    for index in 0..4 {
        all.extend(framed(index, 1, &[16, 0, 0, 0, 2, 4, 0, 0, 0, 9]));
        all.extend(framed(index + 100, 255, &[3, 0, 0, 0, 2]));
        all.extend(framed(index + 200, 0, &[99]));
    }
    let expected = bench(&["0=I/0"], &[]).exchange(&all, usize::MAX);
    assert_eq!(expected.len(), 4 * (12 + 13 + 9));
    for chunk in 1..40 {
        assert_eq!(bench(&["0=I/0"], &[]).exchange(&all, chunk), expected, "chunks of {chunk}");
    }
}

#[test]
fn the_longest_requests_fit() {
    let mut bench = bench(&["0=I/0-124:u16"], &["0=IO/0-1999"]);
    let registers: Vec<u8> = (0..246).collect();
    assert_eq!(bench.ask(&[&[16, 0, 0, 0, 123, 246], &registers[..]].concat()), [16, 0, 0, 0, 123]);
    assert_eq!(bench.ask(&[3, 0, 0, 0, 123]), [&[3, 246], &registers[..]].concat());
    assert_eq!(bench.ask(&[&[15, 0, 0, 7, 0xb0, 246], &[0xaa; 246][..]].concat()), [15, 0, 0, 7, 0xb0]);
    for at in 1968..2000 {
        bench.set("IO", at, "11,-1");
    }
    assert_eq!(bench.ask(&[1, 0, 0, 7, 0xd0]), [&[1, 250], &[0xaa; 246][..], &[0xff; 4]].concat());
}

#[test]
fn bytes_that_are_not_modbus_break_the_connection() {
    for bytes in [&b"GET:RC8:1:I:\r"[..], &[0, 1, 0, 0, 0, 0], &[0, 1, 0, 0, 1, 1]] {
        let mut bench = bench(&["0=I/0"], &[]);
        assert_eq!(bench.exchange(bytes, 1), [], "{bytes:?}");
        assert!(bench.session.is_broken());
    }
}

#[test]
fn any_bytes_are_safe() {
    // a generator with a fixed seed, so that a failure repeats
    let mut state = 1_u32;
    let mut random = || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        state.to_be_bytes()[0]
    };
    for _ in 0..20_000 {
        let mut bench = bench(&["0=I/0-9:i16", "10=P/1"], &["0=IO/0-9"]);
        let function: Vec<u8> = (0..1 + random() % 24).map(|_| random() >> (random() % 8)).collect();
        let response = bench.exchange(&framed(1, 1, &function), usize::MAX);
        assert!((9..=260).contains(&response.len()), "{function:?}");
    }
}

#[test]
fn a_mask_changes_bits_of_a_register() {
    let mut bench = bench(&["100=I/10:i16", "101=I/11"], &[]);
    bench.set("I", 10, "3,18");
    // the example of the specification: 0x12 with the masks 0xf2 and 0x25
    let request = [22, 0, 100, 0x00, 0xf2, 0x00, 0x25];
    assert_eq!(bench.ask(&request), request);
    assert_eq!(bench.lines, ["GET:RC8:10:I:", "PUT:RC8:10:I:3,23"]);
    assert_eq!(bench.ask(&[22, 0, 101, 0, 0, 0, 0]), [22 | 0x80, 2], "a half of a variable");
    assert_eq!(bench.ask(&[22, 0, 100, 0, 0, 0]), [22 | 0x80, 3]);
    bench.protected.push(Variable::new(bcap_core::rac::VariableKind::I, 10));
    assert_eq!(bench.ask(&request), [22 | 0x80, 2]);
    assert_eq!(bench.values.values().next().unwrap(), "3,23", "nothing was written");
}

#[test]
fn registers_are_written_and_then_read_in_one_request() {
    let mut bench = bench(&["100=I/10-11:i16", "102=I/12-13:i16"], &[]);
    for index in 10..14 {
        bench.set("I", index, "3,7");
    }
    let request = [23, 0, 101, 0, 2, 0, 100, 0, 2, 4, 0, 1, 0, 2];
    assert_eq!(bench.ask(&request), [23, 4, 0, 2, 0, 7]);
    let puts = ["PUT:RC8:10:I:3,1", "PUT:RC8:11:I:3,2"];
    assert_eq!(bench.lines, [&puts[..], &["GET:RC8:11:I:", "GET:RC8:12:I:"]].concat());
    bench.lines.clear();
    for (request, exception) in [
        ([23, 0, 103, 0, 2, 0, 100, 0, 1, 2, 0, 9, 0, 0], 3),
        ([23, 0, 103, 0, 2, 0, 100, 0, 2, 4, 0, 9, 0, 9], 2),
        ([23, 0, 103, 0, 0, 0, 100, 0, 2, 4, 0, 9, 0, 9], 3),
    ] {
        assert_eq!(bench.ask(&request), [23 | 0x80, exception], "{request:?}");
    }
    assert!(bench.lines.iter().all(|line| line.starts_with("MODBUS:23:")), "{:?}", bench.lines);
}

#[test]
fn a_write_with_a_read_that_the_rules_refuse_writes_nothing() {
    let mut bench = bench(&["100=I/10-12:i16"], &[]);
    bench.hidden = std::vec![Variable::new(bcap_core::rac::VariableKind::I, 11)];
    bench.set("I", 10, "3,7");
    assert_eq!(bench.ask(&[23, 0, 100, 0, 3, 0, 102, 0, 1, 2, 0, 9]), [23 | 0x80, 2]);
    assert_eq!(bench.lines, ["GET:RC8:11:I:"], "the refused line, for the log");
    assert_eq!(bench.values.len(), 1, "I12 was not written");
    // a read alone stops at the refused variable
    assert_eq!(bench.ask(&[3, 0, 100, 0, 3]), [0x83, 2]);
    assert_eq!(bench.lines[1..], ["GET:RC8:10:I:", "GET:RC8:11:I:"]);
}

#[test]
fn the_device_identifies_itself() {
    let mut bench = bench(&[], &[]);
    let version = env!("CARGO_PKG_VERSION");
    let object = |number: u8, text: &str| [&[number, u8::try_from(text.len()).unwrap()], text.as_bytes()].concat();
    let all = [object(0, "bcap"), object(1, "bcap-gateway"), object(2, version)];
    for code in [1, 2, 3] {
        let head = [43, 14, code, 0x81, 0, 0, 3];
        assert_eq!(bench.ask(&[43, 14, code, 0]), [&head[..], &all.concat()].concat());
    }
    assert_eq!(bench.ask(&[43, 14, 4, 1]), [&[43, 14, 4, 0x81, 0, 0, 1], &all[1][..]].concat());
    assert_eq!(bench.ask(&[43, 14, 1, 9])[6], 3, "a stream begins at the first object");
    for (request, exception) in [(&[43, 14, 4, 3][..], 2), (&[43, 14, 5, 0], 3), (&[43, 14], 3), (&[43, 13, 0], 1)] {
        assert_eq!(bench.ask(request), [43 | 0x80, exception], "{request:?}");
    }
    assert_eq!(bench.lines.len(), 4, "the refused ones, for the log: {:?}", bench.lines);
}
