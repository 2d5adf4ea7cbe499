//! Fuzzes RAC lines: splitting, requests, responses.

use bcap_core::endpoint::{Endpoint, Serve};
use std::collections::BTreeMap;

use bcap_core::handler::{Outcome, PeerId, ReplyValue};
use bcap_core::hresult::HResult;
use bcap_core::rac::server::{Config, Handler, Session};
use bcap_core::rac::{Framed, LineFramer, MAX_LINE, MAX_VALUE, Request, Response, Variable};
use bcap_core::time::Instant;
use bcap_core::variant::{VariantBuf, Writer};
use bcap_testkit::value::Value;

use crate::text::check_error;
use bcap_testkit::duplex::chunks;

/// Splits bytes into lines and parses each as a request and as a response.
///
/// The bytes arrive in chunks; the first four bytes are their sizes. A server must answer each line once, and the answers
/// must not depend on the chunks.
///
/// # Panics
///
/// When an assertion about the core fails.
pub fn rac_line(data: &[u8]) {
    let Some((sizes, bytes)) = data.split_at_checked(4) else { return };
    let mut framer = LineFramer::<MAX_LINE>::new();
    let mut lines = Vec::new();
    for mut chunk in chunks(bytes, sizes) {
        while !chunk.is_empty() {
            let room = framer.receive_buffer();
            let count = chunk.len().min(room.len());
            assert!(count > 0, "all lines were taken, but the buffer is full");
            room[..count].copy_from_slice(&chunk[..count]);
            framer.received(count);
            chunk = &chunk[count..];
            while let Some(framed) = framer.poll() {
                lines.push((framed == Framed::Line).then(|| framer.line().to_vec()));
            }
        }
    }
    assert_eq!(lines, split(bytes));
    for line in lines.iter().flatten() {
        request(line);
        response(line);
    }
    let answers = serve(bytes, sizes);
    assert_eq!(answers, serve(bytes, &[]));
    let answers: Vec<&[u8]> = answers.split_inclusive(|b| *b == b'\r').collect();
    assert_eq!(answers.len(), lines.len());
    for (answer, line) in answers.iter().zip(lines) {
        let (cr, text) = answer.split_last().expect("the answer ends with a CR");
        let mut memory = [0; MAX_VALUE];
        let response = Response::parse(text, &mut memory).expect("the server sends valid responses");
        assert!(*cr == b'\r' && answer.len() <= MAX_LINE);
        let mut memory = [0; MAX_VALUE];
        let good = line.is_some_and(|line| Request::parse(&line, &mut memory).is_ok());
        assert!(good || response.result.is_err());
    }
}

/// A handler that stores the values of PUTs.
#[derive(Default)]
struct Store(BTreeMap<Variable, VariantBuf<MAX_VALUE>>);

impl Handler for Store {
    fn call(&mut self, _: PeerId, request: &Request<'_>, reply: &mut ReplyValue<'_>, _: Instant) -> Outcome {
        match *request {
            Request::Get(variable) => {
                let Some(kept) = self.0.get(&variable) else { return HResult::E_INVALIDARG.into() };
                // the server answers for a value that does not fit
                let _ = reply.set(kept);
            }
            Request::Put(variable, value) => {
                self.0.insert(variable, VariantBuf::new(&value).expect("a line holds no larger value"));
            }
        }
        HResult::S_OK.into()
    }
}

/// Returns a server's answers to `bytes`.
fn serve(bytes: &[u8], sizes: &[u8]) -> Vec<u8> {
    let mut session = Session::new(Config::TCP, [0; MAX_VALUE]);
    let mut store = Store::default();
    let mut answers = Vec::new();
    for mut chunk in chunks(bytes, sizes) {
        while !chunk.is_empty() {
            let room = session.receive_buffer();
            let count = chunk.len().min(room.len());
            assert!(count > 0, "all lines were answered, but the buffer is full");
            room[..count].copy_from_slice(&chunk[..count]);
            session.received(count);
            chunk = &chunk[count..];
            loop {
                let event = session.run(&mut store, PeerId(0), Instant::ZERO);
                answers.extend_from_slice(session.transmit());
                session.transmitted(session.transmit().len());
                if event.is_none() {
                    break;
                }
            }
        }
    }
    answers
}

/// Splits bytes into lines in the simplest way; `None` is an over-long line.
pub(crate) fn split(bytes: &[u8]) -> Vec<Option<Vec<u8>>> {
    let mut pieces: Vec<&[u8]> = bytes.split(|b| *b == b'\r').collect();
    let trimmed = |mut line: &[u8]| {
        while let [b'\n', rest @ ..] = line {
            line = rest;
        }
        (line.len() < MAX_LINE).then(|| line.to_vec())
    };
    let begun = pieces.pop().map(trimmed);
    let mut lines: Vec<_> = pieces.into_iter().map(trimmed).collect();
    // an over-long line is reported before its end arrives
    if begun == Some(None) {
        lines.push(None);
    }
    lines
}

fn request(line: &[u8]) {
    let mut memory = [0; MAX_VALUE];
    let request = match Request::parse(line, &mut memory) {
        Ok(request) => request,
        Err(error) => return check_error(&error, line.len()),
    };
    let mut buffer = [0; 2 * MAX_LINE];
    let mut out = Writer::new(&mut buffer);
    if request.write_line(&mut out).is_ok() {
        let written = out.as_bytes();
        assert!(written.len() <= MAX_LINE && written.ends_with(b"\r"));
        let mut memory = [0; MAX_VALUE];
        assert_eq!(Request::parse(&written[..written.len() - 1], &mut memory), Ok(request));
    }
    let value = request.value().map(Value::read);
    assert_eq!(value, line_value(line, 5));
}

fn response(line: &[u8]) {
    let mut memory = [0; MAX_VALUE];
    let response = match Response::parse(line, &mut memory) {
        Ok(response) => response,
        Err(error) => return check_error(&error, line.len()),
    };
    let mut buffer = [0; 2 * MAX_LINE];
    let mut out = Writer::new(&mut buffer);
    if response.write_line(&mut out).is_ok() {
        let written = out.as_bytes();
        assert!(written.len() <= MAX_LINE && written.ends_with(b"\r"));
        let mut memory = [0; MAX_VALUE];
        assert_eq!(Response::parse(&written[..written.len() - 1], &mut memory), Ok(response));
    }
    let text = line.iter().position(|b| *b == b',').map(|at| &line[at + 1..]);
    assert_eq!(
        response.value.map(Value::read),
        text.map(|text| bcap_testkit::text::parse(text).expect("the oracle parses it too"))
    );
}

/// Returns the value after the last colon of a request, by the oracle.
fn line_value(line: &[u8], fields: usize) -> Option<Value> {
    let text = line.splitn(fields, |b| *b == b':').nth(fields - 1)?;
    bcap_testkit::text::parse(text)
}
