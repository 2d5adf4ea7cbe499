//! The specification's samples both ways, refusals with their columns, and sessions between client and server.
#![expect(clippy::arithmetic_side_effects, reason = "an overflow here fails the test, as it should")]

extern crate std;

use crate::endpoint::{Endpoint, Serve, ServerEndpoint};
use std::collections::BTreeMap;
use std::format;
use std::string::{String, ToString as _};
use std::vec::Vec;

use core::time::Duration;

use super::client::{self, Client, ClientError, Timeout};
use super::server::{self, Handler, Session};
use super::*;
use crate::error::{RequestPart, TextError, TextErrorKind as K};
use crate::handler::{Outcome, PeerId, ReplyValue};
use crate::hresult::HResult;
use crate::time::Instant;
use crate::variant::{Variant, VariantBuf, Writer};

type Buf = VariantBuf<1024>;

const NOW: Instant = Instant::ZERO;

fn at(millis: u64) -> Instant {
    Instant::from_millis(millis)
}

fn value(text: &str) -> Buf {
    Buf::parse_text(text.as_bytes()).unwrap()
}

fn variable(kind: VariableKind, index: u32) -> Variable {
    Variable::new(kind, index)
}

fn line_of(request: &Request<'_>) -> Result<String, TextError> {
    let mut memory = [0xa5; 300];
    let mut out = Writer::new(&mut memory);
    request.write_line(&mut out)?;
    Ok(String::from_utf8(out.as_bytes().to_vec()).unwrap())
}

fn response_line(response: &Response<'_>) -> Result<String, TextError> {
    let mut memory = [0xa5; 300];
    let mut out = Writer::new(&mut memory);
    response.write_line(&mut out)?;
    Ok(String::from_utf8(out.as_bytes().to_vec()).unwrap())
}

/// The lines of the specification's section 4 with their values in text without blanks: kind, the answer to a GET, the
/// text of a PUT, the value.
const SAMPLES: [(VariableKind, &str, &str, &str); 9] = [
    (VariableKind::I, "0, 3, 123", "PUT:RC8:10:I:3, 123", "3,123"),
    (VariableKind::F, "0, 4, 123.01", "PUT:RC8:10:F:4, 123.01", "4,123.01"),
    (VariableKind::D, "0, 5, 123.01", "PUT:RC8:10:D:5, 123.01", "5,123.01"),
    (VariableKind::S, "0, 8, Test", "PUT:RC8:10:S:8, Test", "8,Test"),
    (VariableKind::V, "0, 8196, 1, 2, 3", "PUT:RC8:10:V: 8196, 1, 2, 3", "8196,1,2,3"),
    (
        VariableKind::P,
        "0, 8196, 1, 2, 3, 4, 5, 6, -1",
        "PUT:RC8:10:P:8196, 1, 2, 3, 4, 5, 6, -1",
        "8196,1,2,3,4,5,6,-1",
    ),
    (
        VariableKind::J,
        "0, 8196, 1, 2, 3, 4, 5, 6, 7, 8",
        "PUT:RC8:10:J:8196, 1, 2, 3, 4, 5, 6, 7, 8",
        "8196,1,2,3,4,5,6,7,8",
    ),
    (
        VariableKind::T,
        "0, 8196, 1, 2, 3, 4, 5, 6, 7, 8, 9, -1",
        "PUT:RC8:10:T:8196, 1, 2, 3, 4, 5, 6, 7, 8, 9, -1",
        "8196,1,2,3,4,5,6,7,8,9,-1",
    ),
    (VariableKind::Io, "0, 11, 0", "PUT:RC8:10:IO:11, 0", "11,0"),
];

#[test]
fn the_samples_of_the_specification_are_understood_and_written_without_blanks() {
    for (kind, answer, put, text) in SAMPLES {
        let (mut memory, variable, value) = ([0; 64], variable(kind, 10), value(text));
        assert!(kind.fits(&value.as_variant()), "{kind}");

        let get = format!("GET:RC8:10:{kind}:");
        let request = Request::parse(get.as_bytes(), &mut memory).unwrap();
        assert_eq!(request, Request::Get(variable));
        assert_eq!(line_of(&request).unwrap(), format!("{get}\r"));

        let request = Request::parse(put.as_bytes(), &mut memory).unwrap();
        assert_eq!(request, Request::Put(variable, value.as_variant()));
        assert_eq!(line_of(&request).unwrap(), format!("PUT:RC8:10:{kind}:{text}\r"));

        let response = Response::parse(answer.as_bytes(), &mut memory).unwrap();
        assert_eq!(response, Response { result: HResult::S_OK, value: Some(value.as_variant()) });
        assert_eq!(response_line(&response).unwrap(), format!("0,{text}\r"));
    }
    // the answer to every PUT of the samples
    let response = Response::parse(b"0", &mut []).unwrap();
    assert_eq!(response, Response { result: HResult::S_OK, value: None });
    assert_eq!(response_line(&response).unwrap(), "0\r");
}

#[test]
fn the_part_name_may_be_omitted() {
    let request = Request::parse(b"GET::10:I:", &mut []).unwrap();
    assert_eq!(request, Request::Get(variable(VariableKind::I, 10)));
    assert_eq!(line_of(&request).unwrap(), "GET:RC8:10:I:\r");
    let mut memory = [0; 16];
    let request = Request::parse(b"PUT::10:I:3,-5", &mut memory).unwrap();
    assert_eq!(request, Request::Put(variable(VariableKind::I, 10), Variant::I4(-5)));
}

#[test]
fn a_variable_is_parsed_from_its_name() {
    for (name, kind, index) in [
        ("I1", VariableKind::I, 1),
        ("io128", VariableKind::Io, 128),
        ("P[010]", VariableKind::P, 10),
        ("T4294967295", VariableKind::T, u32::MAX),
    ] {
        assert_eq!(name.parse(), Ok(variable(kind, index)), "{name}");
        let printed = variable(kind, index).to_string();
        assert_eq!(printed.parse(), Ok(variable(kind, index)), "{printed}");
    }
    for (name, column) in [
        ("", 1),
        ("1", 1),
        ("X1", 1),
        (" I1", 1),
        ("I", 2),
        ("I+1", 2),
        ("I 1", 2),
        ("I[1", 2),
        ("I1]", 2),
        ("I[]", 2),
        ("I[[1]]", 2),
        ("IO4294967296", 3),
        ("Ié", 2),
    ] {
        assert_eq!(name.parse::<Variable>().map_err(|error| error.column), Err(column), "{name}");
    }
}

#[test]
fn words_are_read_in_any_case_behind_any_blanks() {
    let request = Request::parse(b" \t get:rc8:010:iO:", &mut []).unwrap();
    assert_eq!(request, Request::Get(variable(VariableKind::Io, 10)));
    let mut memory = [0; 16];
    let request = Request::parse(b"Put:Rc8:4294967295:i: \t3,\t-5", &mut memory).unwrap();
    assert_eq!(request, Request::Put(variable(VariableKind::I, u32::MAX), Variant::I4(-5)));
    assert_eq!(request.variable().to_string(), "I[4294967295]");
    for kind in VariableKind::ALL {
        assert_eq!(VariableKind::from_name(&kind.name().to_ascii_lowercase()), Some(kind));
    }
    assert_eq!(VariableKind::from_name("X"), None);
}

#[test]
fn what_is_wrong_with_a_request_is_named_with_its_column() {
    for (line, kind, column) in [
        ("", K::Verb, 1),
        ("   ", K::Verb, 4),
        ("GOT:RC8:10:I:", K::Verb, 1),
        ("\tSET:RC8:10:I:", K::Verb, 2),
        ("GET", K::Colon(RequestPart::Verb), 4),
        ("GET RC8", K::Verb, 1),
        ("GET:RC9:10:I:", K::PartName, 5),
        ("GET: RC8:10:I:", K::PartName, 5),
        ("GET:RC8", K::Colon(RequestPart::PartName), 8),
        ("GET:RC8:", K::Index, 9),
        ("GET:RC8::I:", K::Index, 9),
        ("GET:RC8:-1:I:", K::Index, 9),
        ("GET:RC8:0x1:I:", K::Index, 9),
        ("GET:RC8:1 :I:", K::Index, 9),
        ("GET:RC8:4294967296:I:", K::Index, 9),
        ("GET:RC8:10", K::Colon(RequestPart::Index), 11),
        ("GET:RC8:10:", K::VariableType, 12),
        ("GET:RC8:10:I", K::Colon(RequestPart::VariableType), 13),
        ("GET:RC8:10:X:", K::VariableType, 12),
        ("GET:RC8:10:I:3,1", K::GetWithData, 14),
        ("GET:RC8:10:I: \t x", K::GetWithData, 17),
        // the damaged sample of the specification
        ("PUT:RC8:10:10:11, 0", K::VariableType, 12),
        ("PUT:RC8:10:I:", K::PutWithoutData, 14),
        ("PUT:RC8:10:I: ", K::PutWithoutData, 15),
        ("PUT:RC8:10:I:3", K::Comma, 15),
        ("PUT:RC8:10:I:3,2147483648", K::OutOfRange, 16),
        ("PUT:RC8:10:I:3,1 ", K::BlankBehind, 17),
        ("  PUT:RC8:10:P: 8196, 1, 2,x", K::Digit, 28),
        ("PUT:RC8:10:S:8,a\nb", K::LineBreak, 17),
    ] {
        let error = Request::parse(line.as_bytes(), &mut [0; 64]).unwrap_err();
        assert_eq!((error.kind, error.column), (kind, column), "{line:?}");
    }
    let error = Request::parse(b"PUT:RC8:10:10:11, 0", &mut [0; 64]).unwrap_err();
    assert_eq!(error.to_string(), "the variable type is one of I F D S V P J T IO at column 12");
    let error = Request::parse(b"GET:RC8:10:I", &mut []).unwrap_err();
    assert_eq!(error.to_string(), "a colon is missing after the variable type at column 13");
    let error = Request::parse(b"PUT:RC8:10:I:3,1", &mut [0; 9]).unwrap_err();
    assert_eq!((error.kind, error.column), (K::Full, 16));
}

#[test]
fn results_are_read_in_every_form_and_written_signed() {
    for text in ["-2147024809", "2147942487", "0x80070057", " \t0X80070057"] {
        let response = Response::parse(text.as_bytes(), &mut []).unwrap();
        assert_eq!(response, Response { result: HResult::E_INVALIDARG, value: None }, "{text}");
        assert_eq!(response_line(&response).unwrap(), "-2147024809\r");
    }
    let mut memory = [0; 16];
    let response = Response::parse(b"1,0,", &mut memory).unwrap();
    assert_eq!(response, Response { result: HResult::S_FALSE, value: Some(Variant::Empty) });
    assert_eq!(response_line(&response).unwrap(), "1,0,\r");
    for (line, kind, column) in [
        ("", K::ResultCode, 1),
        ("  ", K::ResultCode, 3),
        ("OK", K::ResultCode, 1),
        ("4294967296", K::ResultCode, 1),
        ("-2147483649", K::ResultCode, 1),
        ("0 ", K::ResultCode, 2),
        ("0;3,1", K::ResultCode, 2),
        ("0,", K::Type, 3),
        ("0,3,1,2", K::Unexpected, 6),
    ] {
        let error = Response::parse(line.as_bytes(), &mut [0; 64]).unwrap_err();
        assert_eq!((error.kind, error.column), (kind, column), "{line:?}");
    }
}

#[test]
fn a_line_is_written_up_to_256_bytes_and_never_cut() {
    let text = "x".repeat(256 - "PUT:RC8:0:S:8,\r".len());
    for (text, fits) in [(text.clone(), true), (text + "x", false)] {
        let value = Buf::new(text.as_str()).unwrap();
        let line = line_of(&Request::Put(variable(VariableKind::S, 0), value.as_variant()));
        match fits {
            true => assert_eq!(line.unwrap().len(), MAX_LINE),
            false => assert_eq!(line, Err(TextError { kind: K::Full, column: 0 })),
        }
    }
    let value = Buf::new(" x").unwrap();
    let line = line_of(&Request::Put(variable(VariableKind::S, 0), value.as_variant()));
    assert_eq!(line, Err(TextError { kind: K::LeadingBlank, column: 0 }));
}

#[test]
fn the_largest_values_of_a_line_fit_the_memory_that_is_promised() {
    for element in ["8200,", "8212,1", "8213,1", "8204,(0)", "8197,1"] {
        let mut text = String::from(element);
        while text.len() < MAX_LINE - "0,\r".len() {
            text.push_str(&element[4..]);
        }
        text.truncate(MAX_LINE - "0,\r".len());
        while Buf::parse_text(text.as_bytes()).is_err() {
            text.pop();
        }
        assert!(value(&text).as_bytes().len() <= MAX_VALUE);
    }
    let strings = format!("8200{}", ",".repeat(MAX_LINE - "0,8200\r".len()));
    assert_eq!(value(&strings).as_bytes().len(), 6 + 4 * 249);
}

/// A controller that stores values, and answers requests for variable 99 only once `ready` is set.
#[derive(Default)]
struct Store {
    values: BTreeMap<Variable, Buf>,
    ready: bool,
    calls: usize,
    resumed: usize,
    abandoned: usize,
    left: usize,
}

impl Handler for Store {
    fn call(&mut self, _: PeerId, request: &Request<'_>, reply: &mut ReplyValue<'_>, now: Instant) -> Outcome {
        self.calls += 1;
        if request.variable().index == 99 && !self.ready {
            return Outcome::Wait(now + Duration::from_millis(10));
        }
        match *request {
            Request::Get(variable) => match self.values.get(&variable) {
                // whether it fits is the server's business
                Some(value) => {
                    let _ = reply.set(value);
                    HResult::S_OK.into()
                }
                None => HResult::E_INVALIDARG.into(),
            },
            Request::Put(variable, value) => {
                self.values.insert(variable, Buf::new(&value).unwrap());
                let _ = reply.set(&1);
                HResult::S_OK.into()
            }
        }
    }

    fn resume(&mut self, peer: PeerId, request: &Request<'_>, reply: &mut ReplyValue<'_>, now: Instant) -> Outcome {
        self.resumed += 1;
        self.call(peer, request, reply, now)
    }

    fn abandoned(&mut self, _: PeerId, _: Instant) {
        self.abandoned += 1;
    }

    fn left(&mut self, _: PeerId, _: Instant) {
        self.left += 1;
    }
}

/// Gives a session bytes, chunk by chunk, and returns its answers.
fn serve(session: &mut Session<[u8; 256]>, store: &mut Store, bytes: &[u8], chunk: usize) -> String {
    let (mut rest, mut answers) = (bytes, Vec::new());
    loop {
        let room = session.receive_buffer();
        let take = rest.len().min(chunk).min(room.len());
        room[..take].copy_from_slice(&rest[..take]);
        session.received(take);
        rest = &rest[take..];
        let mut done = false;
        while session.run(store, PeerId(1), NOW).is_some() {
            answers.extend_from_slice(session.transmit());
            session.transmitted(session.transmit().len());
            done = true;
        }
        if take == 0 && !done {
            break;
        }
    }
    assert!(rest.is_empty(), "{} bytes were not taken", rest.len());
    String::from_utf8(answers).unwrap()
}

const SESSION: &str = "GET:RC8:1:I:\rPUT:RC8:1:I:3, 7\r\n GET:RC8:1:I:\r\nput:rc8:2:s:8,a(b\rGET:RC8:2:S:\r\
    GET:RC9:1:I:\rGET:RC8:x:I:\rGET:RC8:1:I\rPUT:RC8:1:I:3,x\rPUT:RC8:10:10:11, 0\rNOP\r\rGET:RC8:1:I:\r";
const ANSWERS: &str = "-2147024809\r0\r0,3,7\r0\r0,8,a(b\r\
    -2147418107\r-2147024809\r-2147024809\r-2147418109\r-2147418107\r-2147418107\r-2147418107\r0,3,7\r";

#[test]
fn every_line_is_answered_in_order_however_the_bytes_come() {
    for chunk in 1..SESSION.len() + 1 {
        let mut session = Session::new(server::Config::TCP, [0; 256]);
        assert_eq!(serve(&mut session, &mut Store::default(), SESSION.as_bytes(), chunk), ANSWERS, "{chunk}");
        assert!(!session.is_receiving() && !session.is_running());
    }
}

#[test]
fn an_over_long_line_costs_an_answer_and_not_the_stream() {
    let long = format!("GET:RC8:1:I:\rPUT:RC8:1:S:8,{}\rGET:RC8:1:I:\r", "x".repeat(1000));
    for chunk in [1, 100, 256, 5000] {
        let mut session = Session::new(server::Config::TCP, [0; 256]);
        let answers = serve(&mut session, &mut Store::default(), long.as_bytes(), chunk);
        assert_eq!(answers, "-2147024809\r-2147418095\r-2147024809\r");
    }
    assert_eq!(HResult::from_u32(0x8001_0011), HResult(-2_147_418_095));
}

#[test]
fn hostile_lines_are_refused_and_the_session_goes_on() {
    let nested = format!("PUT:RC8:1:S:{}", "8204,(".repeat(39));
    for (line, result) in [
        ("PUT:RC8:1:I:3,99999999999", HResult::E_INVALIDARGTYPE),
        ("PUT:RC8:1:I:17,300", HResult::E_INVALIDARGTYPE),
        ("PUT:RC8:1:I:6,123.4567", HResult::E_INVALIDARGTYPE),
        ("PUT:RC8:1:I:3,1 ", HResult::E_INVALIDARGTYPE),
        ("PUT:RC8:1:I:8192,1", HResult::E_INVALIDARGTYPE),
        ("PUT:RC8:1:I:8193,", HResult::E_INVALIDARGTYPE),
        ("PUT:RC8:1:I:8195,", HResult::E_INVALIDARGTYPE),
        ("PUT:RC8:1:I:8195,1,,2", HResult::E_INVALIDARGTYPE),
        ("PUT:RC8:1:I:9,1", HResult::E_INVALIDARGTYPE),
        ("PUT:RC8:1:I:16397,1", HResult::E_INVALIDARGTYPE),
        (nested.as_str(), HResult::E_INVALIDARGTYPE),
        ("PUT:RC8:1:I:5,1e999999999999999999", HResult::E_INVALIDARGTYPE),
        ("PUT:RC8:99999999999:I:3,1", HResult::E_INVALIDARG),
        ("\0\x01\x02", HResult::E_INVALIDCOMMAND),
        ("GET:RC8:1:I:\0", HResult::E_INVALIDARG),
        (":::::", HResult::E_INVALIDCOMMAND),
        // these are good, whatever the vendor's library makes of them
        ("PUT:RC8:1:I:3,010", HResult::S_OK),
        ("PUT:RC8:1:I:12,(8,Sample)", HResult::S_OK),
        ("PUT:RC8:1:I:0,", HResult::S_OK),
        ("PUT:RC8:1:I:10,-1", HResult::S_OK),
        ("PUT:RC8:1:I:4,16777217", HResult::S_OK),
    ] {
        let (mut session, mut store) = (Session::new(server::Config::TCP, [0; 256]), Store::default());
        let answers =
            serve(&mut session, &mut store, format!("{line}\rPUT:RC8:2:I:3,5\rGET:RC8:2:I:\r").as_bytes(), 99);
        assert_eq!(answers, format!("{}\r0\r0,3,5\r", result.0), "{line}");
        assert_eq!(store.values.contains_key(&variable(VariableKind::I, 1)), result.is_ok(), "{line}");
    }
    // bytes that are not UTF-8
    let (mut session, mut store) = (Session::new(server::Config::TCP, [0; 256]), Store::default());
    let answers = serve(&mut session, &mut store, b"PUT:RC8:1:S:8,\xff\r\xff\xfe\r", 7);
    assert_eq!(answers, format!("{}\r{}\r", HResult::E_INVALIDARGTYPE.0, HResult::E_INVALIDCOMMAND.0));
}

#[test]
fn a_value_without_text_or_room_is_refused_and_not_cut() {
    let mut store = Store::default();
    let long = "y".repeat(250);
    for (index, stored) in [(1, Buf::new(" x")), (2, Buf::new::<[i32]>(&[])), (3, Buf::new(long.as_str()))] {
        store.values.insert(variable(VariableKind::S, index), stored.unwrap());
    }
    let mut session = Session::new(server::Config::TCP, [0; 256]);
    let answers = serve(&mut session, &mut store, b"GET:RC8:1:S:\rGET:RC8:2:S:\rGET:RC8:3:S:\rPUT:RC8:4:I:3,1\r", 999);
    assert_eq!(answers, "-2147418110\r-2147418110\r-2147418110\r0\r");
    assert_eq!(HResult::E_INVALIDSNDPACKET, HResult(-2_147_418_110));
    // a request that does not fit the session's memory
    let mut session = Session::new(server::Config::TCP, [0; 256]);
    let strings = format!("PUT:RC8:1:S:8200{}\r", ",".repeat(200));
    let answers = serve(&mut session, &mut store, strings.as_bytes(), 999);
    assert_eq!(answers, format!("{}\r", HResult::E_ARGSIZEOVER.0));
}

#[test]
fn a_handler_that_waits_is_asked_again_and_what_comes_behind_waits_too() {
    let mut store = Store::default();
    store.values.insert(variable(VariableKind::I, 99), Buf::new(&5).unwrap());
    let mut session = Session::new(server::Config::TCP, [0; 64]);
    session.receive_buffer()[..26].copy_from_slice(b"GET:RC8:99:I:\rGET:RC8:1:I:");
    session.received(26);
    session.receive_buffer()[..1].copy_from_slice(b"\r");
    session.received(1);
    assert_eq!(session.run(&mut store, PeerId(1), NOW), None);
    assert!(session.is_running());
    assert_eq!(session.poll_timeout(), Some(at(10)));
    assert_eq!(session.run(&mut store, PeerId(1), at(10)), None);
    assert_eq!((store.calls, store.resumed, session.poll_timeout()), (2, 1, Some(at(20))));
    store.ready = true;
    let served = server::Event::Served { variable: variable(VariableKind::I, 99), result: HResult::S_OK };
    assert_eq!(session.run(&mut store, PeerId(1), at(20)), Some(served));
    // the next request is not begun before the answer has left
    assert_eq!(session.run(&mut store, PeerId(1), at(20)), None);
    assert_eq!(session.transmit(), b"0,3,5\r");
    session.transmitted(3);
    assert_eq!(session.run(&mut store, PeerId(1), at(20)), None);
    session.transmitted(3);
    let served = server::Event::Served { variable: variable(VariableKind::I, 1), result: HResult::E_INVALIDARG };
    assert_eq!(session.run(&mut store, PeerId(1), at(20)), Some(served));
    assert_eq!(session.transmit(), b"-2147024809\r");
}

#[test]
fn a_handler_that_never_answers_is_abandoned() {
    let mut store = Store::default();
    let config = server::Config { invoke_timeout: Duration::from_millis(25) };
    let mut session = Session::new(config, [0; 64]);
    session.receive_buffer()[..14].copy_from_slice(b"GET:RC8:99:I:\r");
    session.received(14);
    for millis in [0, 10, 20] {
        assert_eq!(session.run(&mut store, PeerId(1), at(millis)), None);
    }
    assert_eq!(session.poll_timeout(), Some(at(25)));
    let served = server::Event::Served { variable: variable(VariableKind::I, 99), result: HResult::E_TIMEOUT };
    assert_eq!(session.run(&mut store, PeerId(1), at(25)), Some(served));
    assert_eq!((store.abandoned, session.poll_timeout()), (1, None));
    assert_eq!(session.transmit(), format!("{}\r", HResult::E_TIMEOUT.0).as_bytes());

    session.transmitted(99);
    session.receive_buffer()[..14].copy_from_slice(b"GET:RC8:99:I:\r");
    session.received(14);
    assert_eq!(session.run(&mut store, PeerId(1), at(30)), None);
    session.close(&mut store, PeerId(1), at(31));
    assert_eq!((store.abandoned, store.left, session.is_running()), (2, 1, false));
}

#[test]
fn a_gateway_answers_when_it_can() {
    let mut session = Session::new(server::Config::TCP, [0; 64]);
    let lines = b"PUT:RC8:1:P:8196,1,2,3,4,5,6,-1\rNOP\rGET:RC8:1:S:\rGET:RC8:2:I:\r";
    session.receive_buffer()[..lines.len()].copy_from_slice(lines);
    session.received(lines.len());

    let p = variable(VariableKind::P, 1);
    assert_eq!(session.poll(NOW), Some(server::Event::Requested(p)));
    assert_eq!(session.poll(at(1)), None);
    assert_eq!(session.request(), Some(Request::Put(p, value("8196,1,2,3,4,5,6,-1").as_variant())));
    // the reply to a PUT carries no value
    let served = server::Event::Served { variable: p, result: HResult::S_OK };
    assert_eq!(session.respond_with(HResult::S_OK, &1), Some(served));
    assert_eq!(session.transmit(), b"0\r");
    assert_eq!(session.request(), None);
    assert_eq!(session.respond(HResult::S_OK), None);
    session.transmitted(2);

    assert!(matches!(session.poll(NOW), Some(server::Event::Malformed(e)) if (e.kind, e.column) == (K::Verb, 1)));
    session.transmitted(99);
    let s = variable(VariableKind::S, 1);
    assert_eq!(session.poll(NOW), Some(server::Event::Requested(s)));
    let refused = server::Event::Served { variable: s, result: HResult::E_INVALIDSNDPACKET };
    assert_eq!(session.respond_with(HResult::S_OK, &"a\rb"), Some(refused));
    session.transmitted(99);

    let i = variable(VariableKind::I, 2);
    assert_eq!(session.poll(NOW), Some(server::Event::Requested(i)));
    assert_eq!(session.poll_timeout(), Some(at(180_000)));
    let late = server::Event::Served { variable: i, result: HResult::E_TIMEOUT };
    assert_eq!(session.poll(at(180_000)), Some(late));
    assert_eq!(session.respond(HResult::S_OK), None);
}

fn receive(client: &mut Client<[u8; 64]>, bytes: &[u8]) {
    client.receive_buffer()[..bytes.len()].copy_from_slice(bytes);
    client.received(bytes.len());
}

fn sent(client: &mut Client<[u8; 64]>) -> String {
    let text = String::from_utf8(client.transmit().to_vec()).unwrap();
    client.transmitted(text.len());
    text
}

fn get(index: u32) -> Request<'static> {
    Request::Get(variable(VariableKind::I, index))
}

const OK: Option<client::Event> = Some(client::Event::Replied(HResult::S_OK));

fn integer(client: &Client<[u8; 64]>) -> Option<i32> {
    client.reply()?.value?.as_i32()
}

#[test]
fn client_and_server_agree_on_every_kind_of_variable() {
    let (mut store, mut session) = (Store::default(), Session::new(server::Config::TCP, [0; 256]));
    let mut client = Client::new(client::Config::TCP, [0; 64]);
    for (kind, _, _, text) in SAMPLES {
        let (variable, value) = (variable(kind, 7), value(text));
        for request in [Request::Put(variable, value.as_variant()), Request::Get(variable)] {
            client.start(&request, NOW).unwrap();
            let line = sent(&mut client);
            let answer = serve(&mut session, &mut store, line.as_bytes(), 3);
            // byte by byte, and nothing happens before the last
            let (last, head) = answer.as_bytes().split_last().unwrap();
            for byte in head {
                receive(&mut client, &[*byte]);
                assert_eq!(client.poll_event(NOW), None);
            }
            receive(&mut client, &[*last]);
            assert_eq!(client.poll_event(NOW), OK);
        }
        assert_eq!(client.reply().unwrap().value, Some(value.as_variant()), "{kind}");
    }
}

#[test]
fn a_late_reply_is_never_taken_for_that_of_another_request() {
    let mut client = Client::new(client::Config::TCP, [0; 64]);
    client.start(&get(1), NOW).unwrap();
    assert_eq!(sent(&mut client), "GET:RC8:1:I:\r");
    assert_eq!(client.start(&get(2), NOW), Err(ClientError::Busy));
    assert_eq!((client.poll_timeout(), client.handle_timeout(at(2999))), (Some(at(3000)), None));
    let timeout = |which| Some(client::Event::Failed(ClientError::Timeout(which)));
    assert_eq!(client.handle_timeout(at(3000)), timeout(Timeout::Reply));
    assert!(client.is_owed() && !client.is_busy());

    // the next request waits until the line is free
    client.start(&get(2), at(3000)).unwrap();
    assert_eq!(client.transmit(), b"");
    receive(&mut client, b"0,3,1");
    assert_eq!((client.poll_event(at(3001)), client.transmit()), (None, &b""[..]));
    receive(&mut client, b"11\r");
    assert_eq!(client.poll_event(at(3001)), Some(client::Event::Stale));
    assert_eq!((client.reply(), client.is_owed()), (None, false));
    assert_eq!(sent(&mut client), "GET:RC8:2:I:\r");
    receive(&mut client, b"0,3,222\r");
    assert_eq!((client.poll_event(at(3002)), integer(&client)), (OK, Some(222)));
    assert_eq!(client.poll_event(at(3002)), None);

    // and when it does not get free, it says so, and that it was not sent
    client.start(&get(3), at(4000)).unwrap();
    sent(&mut client);
    client.abandon();
    assert_eq!((client.is_busy(), client.poll_timeout(), client.handle_timeout(at(99_000))), (false, None, None));
    client.start(&get(4), at(5000)).unwrap();
    assert_eq!(client.handle_timeout(at(8000)), timeout(Timeout::Outstanding));
    client.start(&get(5), at(9000)).unwrap();
    assert_eq!(client.transmit(), b"");
    receive(&mut client, b"0,3,333\r");
    assert_eq!(client.poll_event(at(9001)), Some(client::Event::Stale));
    assert_eq!(sent(&mut client), "GET:RC8:5:I:\r");
}

#[test]
fn abandoning_is_safe_at_every_byte() {
    let line = "GET:RC8:1:I:\r";
    for cut in 0..=line.len() {
        let mut client = Client::new(client::Config::TCP, [0; 64]);
        client.start(&get(1), NOW).unwrap();
        let mut wire = client.transmit()[..cut].to_vec();
        client.transmitted(cut);
        client.abandon();
        // a partly sent line is finished, an unsent one is not started
        wire.extend_from_slice(client.transmit());
        if (1..line.len()).contains(&cut) {
            assert_eq!(client.start(&get(2), NOW), Err(ClientError::Busy));
        }
        client.transmitted(client.transmit().len());
        assert_eq!(wire, if cut == 0 { b"" } else { line.as_bytes() });
        client.start(&get(2), NOW).unwrap();
        if cut > 0 {
            receive(&mut client, b"0,3,1\r");
            assert_eq!(client.poll_event(NOW), Some(client::Event::Stale), "{cut}");
        }
        assert_eq!(sent(&mut client), "GET:RC8:2:I:\r");
        receive(&mut client, b"0,3,2\r");
        assert_eq!((client.poll_event(NOW), integer(&client)), (OK, Some(2)));
    }
}

#[test]
fn a_client_says_how_it_stands() {
    let short = client::Config { timeout: Duration::from_millis(10) };
    let mut client = Client::new(client::Config::TCP, [0; 64]);
    client.set_config(short);
    assert_eq!(client.config(), &short);
    assert!(!client.is_busy() && !client.is_closed());
    client.start(&get(1), NOW).unwrap();
    assert_eq!((client.is_busy(), client.poll_timeout()), (true, Some(at(10))));
    sent(&mut client);

    // the reply to an abandoned request is stale, even without another request
    client.abandon();
    receive(&mut client, b"0,3,1\r");
    assert_eq!(client.poll_event(NOW), Some(client::Event::Stale));
    assert!(!client.is_owed() && !client.is_closed());

    // half a request has no reply
    client.start(&get(1), NOW).unwrap();
    client.transmitted(5);
    client.abandon();
    receive(&mut client, b"0,3,1\r");
    assert_eq!(client.poll_event(NOW), Some(client::Event::Failed(ClientError::Unsolicited)));
    assert!(client.is_closed());
    client.reset();
    assert!(!client.is_closed());
    assert_eq!(client.config(), &short);
}

#[test]
fn a_session_says_how_it_stands() {
    let mut session = Session::new(server::Config::TCP, [0; 64]);
    assert!(!session.is_receiving() && !session.is_running());
    let line = b"GET:RC8:2:I:\r";
    session.receive_buffer()[..4].copy_from_slice(&line[..4]);
    session.received(4);
    assert_eq!(session.poll(NOW), None);
    assert!(session.is_receiving() && !session.is_running());
    session.receive_buffer()[..9].copy_from_slice(&line[4..]);
    session.received(9);
    assert_eq!(session.poll(NOW), Some(server::Event::Requested(variable(VariableKind::I, 2))));
    assert!(!session.is_receiving() && session.is_running());
    // an error stays that error, whatever becomes of the value
    let served = server::Event::Served { variable: variable(VariableKind::I, 2), result: HResult::E_NOT_CONNECTED };
    assert_eq!(session.respond_with(HResult::E_NOT_CONNECTED, &[7_u8; 100][..]), Some(served));
    assert!(!session.is_receiving() && !session.is_running());
    assert_eq!((Verb::Get.to_string(), Verb::Put.to_string()), ("GET".into(), "PUT".into()));
}

#[test]
fn what_lies_in_memory_behind_the_bytes_that_came_is_nothing() {
    let mut framer = LineFramer::<16>::new();
    framer.receive_buffer()[..3].copy_from_slice(b"\n\n\n");
    framer.received(1);
    assert_eq!((framer.poll(), framer.has_begun()), (None, false));
    framer.receive_buffer()[..4].copy_from_slice(b"0,1\r");
    framer.received(4);
    assert_eq!((framer.poll(), framer.line()), (Some(Framed::Line), &b"0,1"[..]));
}

#[test]
fn replies_that_cannot_be_read_end_their_request_only() {
    let text = |kind, column| TextError { kind, column };
    let long = format!("0,8,{}\r", "x".repeat(400));
    let wide = format!("0,8,{}\r", "x".repeat(100));
    let mut client = Client::new(client::Config::TCP, [0; 64]);
    for (reply, error) in [
        ("OK\r", ClientError::Reply(text(K::ResultCode, 1))),
        ("\r", ClientError::Reply(text(K::ResultCode, 1))),
        ("0,3,1 \r", ClientError::Reply(text(K::BlankBehind, 6))),
        (long.as_str(), ClientError::Reply(text(K::LineTooLong, 256))),
        (wide.as_str(), ClientError::ReplyTooLarge { limit: 64 }),
    ] {
        client.start(&get(1), NOW).unwrap();
        sent(&mut client);
        let mut events = Vec::new();
        for chunk in reply.as_bytes().chunks(32) {
            receive(&mut client, chunk);
            events.extend(client.poll_event(NOW));
        }
        assert_eq!(events, [client::Event::Failed(error)], "{reply:?}");
        assert_eq!(client.reply(), None);
        client.start(&get(2), NOW).unwrap();
        sent(&mut client);
        receive(&mut client, b"-2147024809\r\n");
        assert_eq!(client.poll_event(NOW), Some(client::Event::Replied(HResult::E_INVALIDARG)));
        assert_eq!(client.reply(), Some(Response { result: HResult::E_INVALIDARG, value: None }));
    }
}

#[test]
fn the_rest_of_an_over_long_reply_is_not_an_unsolicited_line() {
    let mut client = Client::new(client::Config::TCP, [0; 64]);
    client.start(&get(1), NOW).unwrap();
    sent(&mut client);
    receive(&mut client, &[b'x'; 256]);
    let long = ClientError::Reply(TextError { kind: K::LineTooLong, column: 256 });
    assert_eq!(client.poll_event(NOW), Some(client::Event::Failed(long)));
    // the next request need not wait for the end of that line
    receive(&mut client, b"xx");
    assert_eq!(client.poll_event(NOW), None);
    assert_eq!(client.start(&get(2), NOW), Ok(()));
    sent(&mut client);
    receive(&mut client, b"xx\r0,3,7\r");
    assert_eq!(client.poll_event(NOW), Some(client::Event::Replied(HResult::S_OK)));
    assert_eq!(integer(&client), Some(7));
}

#[test]
fn an_unsolicited_line_ends_the_session() {
    let unsolicited = Some(client::Event::Failed(ClientError::Unsolicited));
    // without a request in flight
    let mut client = Client::new(client::Config::TCP, [0; 64]);
    receive(&mut client, b"0\r");
    assert_eq!(client.poll_event(NOW), unsolicited);
    assert!(client.is_closed());
    assert_eq!(client.start(&get(1), NOW), Err(ClientError::Closed));
    assert_eq!(client.poll_event(NOW), None);
    client.reset();
    assert_eq!(client.start(&get(1), NOW), Ok(()));

    // before the request has left
    receive(&mut client, b"0,3,1\r");
    client.transmitted(5);
    assert_eq!(client.poll_event(NOW), unsolicited);

    // begun before the request has left, and complete after that
    for sent in [0, 5] {
        for times_out in [false, true] {
            client.reset();
            assert_eq!(client.start(&get(1), NOW), Ok(()));
            client.transmitted(sent);
            receive(&mut client, b"0,3,66");
            assert_eq!(client.poll_event(NOW), None);
            client.transmitted(usize::MAX);
            if times_out {
                client.abandon();
            }
            receive(&mut client, b"6\r");
            assert_eq!(client.poll_event(NOW), unsolicited);
        }
    }

    // the LF after a CR is not a line
    client.reset();
    assert_eq!(client.start(&get(1), NOW), Ok(()));
    receive(&mut client, b"\n");
    client.transmitted(usize::MAX);
    receive(&mut client, b"0,3,7\r");
    assert_eq!(client.poll_event(NOW), Some(client::Event::Replied(HResult::S_OK)));

    // begun before the request was
    client.reset();
    receive(&mut client, b"\n0");
    assert_eq!(client.start(&get(1), NOW), Err(ClientError::Unsolicited));
    assert!(client.is_closed());

    // the line feed of a peer that sends CRLF is not an invalid line
    client.reset();
    receive(&mut client, b"\n");
    assert_eq!(client.start(&get(1), NOW), Ok(()));
}

#[test]
fn a_request_without_a_line_is_the_caller_s_fault() {
    let mut client = Client::new(client::Config::TCP, [0; 64]);
    let value = Buf::new(" x").unwrap();
    let request = Request::Put(variable(VariableKind::S, 1), value.as_variant());
    let error = ClientError::Request(TextError { kind: K::LeadingBlank, column: 0 });
    assert_eq!(client.start(&request, NOW), Err(error));
    assert_eq!((client.transmit(), client.is_busy()), (&b""[..], false));
    assert_eq!(error.to_string(), "the request cannot be sent: a string that begins with a blank has no text");
}
