//! The RAC lines of a connection: requests and responses in order become calls.

use std::collections::VecDeque;

use bcap_core::rac::{self, MAX_LINE, Request, Response};

use super::call::{Argument, Call, Reply};
use super::session::Found;
use crate::role::Role;
use bcap_core::variant::OwnedVariant as Value;

/// The lines of a connection.
#[derive(Debug)]
pub(crate) struct RacLines {
    link: String,
    /// Bytes of incomplete lines, from the client and from the server.
    partial: [Vec<u8>; 2],
    /// Requests without a response, in order.
    pending: VecDeque<Call>,
    /// The number of requests until now.
    count: u64,
}

impl RacLines {
    pub(crate) fn new(link: String) -> Self {
        Self { link, partial: Default::default(), pending: VecDeque::new(), count: 0 }
    }

    /// Adds the next bytes of one direction.
    pub(crate) fn bytes(&mut self, role: Role, bytes: &[u8], at: u64, out: &mut Vec<Found>) {
        let mut buffer = std::mem::take(&mut self.partial[role.index()]);
        buffer.extend_from_slice(bytes);
        let mut used = 0;
        while let Some(rest) = buffer.get(used..)
            && let Some(length) = rest.iter().position(|byte| *byte == b'\r')
        {
            // LF at the start of a line belongs to the end of the line before
            let line = rest.get(..length).unwrap_or_default();
            let start = line.iter().take_while(|byte| **byte == b'\n').count();
            self.line(role, line.get(start..).unwrap_or_default(), at, out);
            used += length + 1;
        }
        buffer.drain(..used);
        if buffer.len() > MAX_LINE {
            out.push(Found::Note(at, format!("{}: {} bytes are not a line: no CR", role.sender(), buffer.len())));
            buffer.clear();
        }
        self.partial[role.index()] = buffer;
    }

    /// Records that the capture lacks bytes of one direction.
    pub(crate) fn missing(&mut self, role: Role, count: u64, at: u64, out: &mut Vec<Found>) {
        self.partial[role.index()].clear();
        out.push(Found::Note(at, format!("{}: the capture lacks {count} bytes", role.sender())));
        // lines have no serial numbers, so the next response could belong to any of the pending requests
        self.end(out);
    }

    /// Reports the pending requests as unanswered, at the end of the connection or after missing bytes.
    pub(crate) fn end(&mut self, out: &mut Vec<Found>) {
        out.extend(self.pending.drain(..).map(|call| Found::Call(Box::new(call))));
    }

    fn line(&mut self, role: Role, line: &[u8], at: u64, out: &mut Vec<Found>) {
        // a value takes no more bytes than its text, except headers, and strings with two bytes for each character
        let mut memory = vec![0; 16 * line.len() + 64];
        match role {
            Role::Request => {
                let mut call = match Request::parse(line, &mut memory) {
                    Ok(request) => self.request(&request, at),
                    Err(error) => {
                        out.push(Found::Note(at, format!("client: invalid line {}: {error}", shown(line))));
                        self.call(shown(line), Vec::new(), at)
                    }
                };
                call.number = self.count;
                self.count += 1;
                self.pending.push_back(call);
            }
            Role::Response => match Response::parse(line, &mut memory) {
                Ok(response) => self.response(&response, at, out),
                Err(error) => {
                    out.push(Found::Note(at, format!("server: invalid line {}: {error}", shown(line))));
                    // it replaces the response
                    out.extend(self.pending.pop_front().map(|call| Found::Call(Box::new(call))));
                }
            },
        }
    }

    fn request(&self, request: &Request<'_>, at: u64) -> Call {
        let variable = |variable: rac::Variable| Argument {
            name: None,
            value: None,
            object: Some(format!("{}{}", variable.kind, variable.index)),
        };
        match request {
            Request::Get(name) => self.call("GET".into(), vec![variable(*name)], at),
            Request::Put(name, value) => {
                let value = Argument { name: Some("value"), value: Value::new(value).ok(), object: None };
                self.call("PUT".into(), vec![variable(*name), value], at)
            }
        }
    }

    fn call(&self, function: String, arguments: Vec<Argument>, at: u64) -> Call {
        Call {
            at,
            link: self.link.clone(),
            number: 0,
            serial: None,
            function,
            command: None,
            arguments,
            attempts: 1,
            executing: 0,
            reply: None,
        }
    }

    fn response(&mut self, response: &Response<'_>, at: u64, out: &mut Vec<Found>) {
        let Some(mut call) = self.pending.pop_front() else {
            out.push(Found::Note(at, format!("server: a response without a request: {}", response.result)));
            return;
        };
        let value = response.value.and_then(|value| Value::new(&value).ok());
        let after = at.saturating_sub(call.at);
        call.reply = Some(Reply { after, code: response.result, value, opened: None });
        out.push(Found::Call(Box::new(call)));
    }
}

/// A line as a literal; long ones are cut.
fn shown(line: &[u8]) -> String {
    let head = line.get(..80).unwrap_or(line);
    format!("{:?}", String::from_utf8_lossy(head))
}
