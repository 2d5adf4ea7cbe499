//! The text of values, RAC, and the gateway: reads lines from standard input, and writes those again that were understood.
#![no_std]
#![no_main]

use bcap_core::endpoint::{Endpoint, Serve};
use bcap_core::handler::{Outcome, PeerId, ReplyValue};
use bcap_core::hresult::HResult;
use bcap_core::rac::client::{self, Client};
use bcap_core::rac::server::{self, Handler, Session};
use bcap_core::rac::{Framed, LineFramer, MAX_VALUE, Request, Response};
use bcap_core::time::Instant;
use bcap_core::variant::{VariantBuf, Writer};
use no_panic_image::{carry, entry, gateway, loops, read_all, write_all};

entry!(main);

fn main() -> i32 {
    let mut input = [0; 16 * 1024];
    let input = read_all(&mut input);
    for line in input.split(|byte| *byte == b'\n') {
        values(line);
    }
    let mut rest = input;
    let mut framer = LineFramer::<256>::new();
    let mut wire = Wire {
        client: Client::new(client::Config::default(), [0; MAX_VALUE]),
        session: Session::new(server::Config::default(), [0; MAX_VALUE]),
    };
    let mut now = Instant::ZERO;
    while !rest.is_empty() {
        let count = carry(rest, framer.receive_buffer());
        framer.received(count);
        rest = rest.get(count..).unwrap_or_default();
        while let Some(framed) = framer.poll() {
            if framed == Framed::Line {
                lines(framer.line(), &mut wire, now);
            }
            now = Instant::from_micros(now.as_micros().wrapping_add(1_000_000));
        }
        if count == 0 {
            break;
        }
    }
    // not every one of these few lines can have been served by the robot
    i32::from(gateway::serve(input).wrapping_add(loops::text(input)) > 1_000_000)
}

/// Parses a line as a value and prints it again.
fn values(line: &[u8]) {
    let mut buffer = [0; 1024];
    let value = VariantBuf::<512>::parse_text(line);
    if let Ok(value) = value
        && let Ok(text) = value.as_variant().to_text(&mut buffer)
    {
        write_all(text.as_bytes());
        write_all(b"\n");
    }
}

/// Parses a line of RAC as a request and as a response, and sends it.
fn lines(line: &[u8], wire: &mut Wire, now: Instant) {
    let (mut memory, mut buffer) = ([0; MAX_VALUE], [0; 256]);
    if let Ok(request) = Request::parse(line, &mut memory) {
        let mut out = Writer::new(&mut buffer);
        if request.write_line(&mut out).is_ok() {
            write_all(out.as_bytes());
        }
        wire.send(&request, now);
    } else if let Ok(response) = Response::parse(line, &mut memory) {
        let mut out = Writer::new(&mut buffer);
        if response.write_line(&mut out).is_ok() {
            write_all(out.as_bytes());
        }
    }
}

/// A client and a server of RAC.
struct Wire {
    client: Client<[u8; MAX_VALUE]>,
    session: Session<[u8; MAX_VALUE]>,
}

/// Answers a request with its own value, the index of its variable, or nothing.
struct Echo;

impl Handler for Echo {
    fn call(&mut self, _: PeerId, request: &Request<'_>, reply: &mut ReplyValue<'_>, now: Instant) -> Outcome {
        let set = match (request.value(), request.variable().index) {
            (Some(value), _) => reply.set(&value),
            (None, 1) => return Outcome::Wait(now),
            (None, index) => reply.set(&f64::from(index)),
        };
        set.map_or(HResult::E_TOO_MUCH_DATA, |()| HResult::S_OK).into()
    }

    fn resume(&mut self, _: PeerId, _: &Request<'_>, _: &mut ReplyValue<'_>, _: Instant) -> Outcome {
        HResult::E_TIMEOUT.into()
    }
}

impl Wire {
    fn send(&mut self, request: &Request<'_>, now: Instant) {
        if self.client.start(request, now).is_err() {
            self.client.reset();
        }
        let count = carry(self.client.transmit(), self.session.receive_buffer());
        self.client.transmitted(count);
        self.session.received(count);
        while self.session.run(&mut Echo, PeerId(1), now).is_some() {
            let count = carry(self.session.transmit(), self.client.receive_buffer());
            self.session.transmitted(count);
            self.client.received(count);
        }
        let mut buffer = [0; 256];
        while self.client.poll_event(now).is_some() {
            let text = self.client.reply().and_then(|reply| reply.value);
            if text.is_some_and(|value| value.to_text(&mut buffer).is_err()) {
                self.session.close(&mut Echo, PeerId(1), now);
            }
        }
        if self.client.poll_timeout().is_some_and(|at| at <= now) && self.client.handle_timeout(now).is_some() {
            self.client.abandon();
        }
    }
}
