//! A RAC client with the text format of values: it writes requests and parses replies of every kind.
#![no_std]
#![no_main]

use core::hint::black_box;

use bcap_core::endpoint::Endpoint;
use bcap_core::rac::client::{Client, Config};
use bcap_core::rac::{Request, Variable, VariableKind};
use bcap_core::time::Instant;
use bcap_core::variant::Variant;
use bcap_sizes::{Memory, Place, copy, entry};

entry!(run);

fn run(memory: &mut Memory) {
    let now = black_box(Instant::ZERO);
    static CLIENT: Place<Client<[u8; 256]>> = Place::new();
    let client = CLIENT.put(Client::new(black_box(Config::TCP), [0; 256]));
    let variable = black_box(Variable::new(VariableKind::P, 1));
    // the next request writes the last value read, of any type
    let value = black_box(Variant::I4(1));
    for request in [Request::Get(variable), Request::Put(variable, value)] {
        black_box(client.start(&request, now).is_ok());
        while client.is_busy() {
            let sent = copy(client.transmit(), &mut memory.output);
            client.transmitted(sent);
            let received = copy(&memory.input, client.receive_buffer());
            client.received(received);
            while let Some(event) = client.poll_event(now) {
                let _ = black_box(event);
                let pose = client.reply().and_then(|reply| reply.value?.as_array()?.items::<f32>()?.to_array::<7>());
                black_box(pose.is_some());
            }
            if client.poll_timeout().is_some_and(|at| black_box(at) < now) {
                let _ = black_box(client.handle_timeout(now));
                client.reset();
            }
        }
    }
}
