//! A RAC server with the text format of values: it parses lines of every kind and answers them.
#![no_std]
#![no_main]

use core::hint::black_box;

use bcap_core::endpoint::{Endpoint, Serve};
use bcap_core::handler::{Outcome, PeerId, ReplyValue};
use bcap_core::hresult::HResult;
use bcap_core::rac::server::{Config, Handler, Session};
use bcap_core::rac::{Request, Variable, VariableKind};
use bcap_core::time::Instant;
use bcap_core::variant::Variant;
use bcap_sizes::{Memory, Place, copy, entry};

entry!(run);

fn run(memory: &mut Memory) {
    let now = black_box(Instant::ZERO);
    static SESSION: Place<Session<[u8; 256]>> = Place::new();
    let session = SESSION.put(Session::new(black_box(Config::TCP), [0; 256]));
    let mut store = Store { pose: [0.0; 7], number: 0 };
    loop {
        let received = copy(&memory.input, session.receive_buffer());
        session.received(received);
        while let Some(event) = session.run(&mut store, PeerId(1), now) {
            let _ = black_box(event);
        }
        let sent = copy(session.transmit(), &mut memory.output);
        session.transmitted(sent);
        if session.poll_timeout().is_some_and(|at| black_box(at) < now) {
            return session.close(&mut store, PeerId(1), now);
        }
    }
}

/// A position and a number that can be read and written.
struct Store {
    pose: [f32; 7],
    number: i32,
}

impl Handler for Store {
    fn call(&mut self, _: PeerId, request: &Request<'_>, reply: &mut ReplyValue<'_>, now: Instant) -> Outcome {
        let set = match *request {
            Request::Get(Variable { kind: VariableKind::P, .. }) => reply.set(&self.pose),
            Request::Get(Variable { kind: VariableKind::I, .. }) => reply.set(&self.number),
            Request::Get(_) => return Outcome::Wait(now),
            Request::Put(_, Variant::Array(array)) => {
                array.items().and_then(|items| items.to_array()).map_or(Ok(()), |pose| {
                    self.pose = pose;
                    Ok(())
                })
            }
            Request::Put(_, value) => value.as_i32().map_or(Ok(()), |number| {
                self.number = number;
                Ok(())
            }),
        };
        set.map_or(HResult::E_FAIL, |()| HResult::S_OK).into()
    }
}
