//! The b-CAP codec and client: a session that opens a controller, a variable and a robot, reads, writes and executes. It
//! reads numbers, poses and strings from the replies.
#![no_std]
#![no_main]

use core::hint::black_box;

use bcap_core::bcap::call::{self, Call, ControllerHandle, Int, RobotHandle, VariableHandle};
use bcap_core::bcap::client::{Client, Config, Event};
use bcap_core::endpoint::Endpoint;
use bcap_core::time::Instant;
use bcap_sizes::{Memory, Place, copy, entry};

entry!(run);

type Board = Client<[u8; 512]>;

fn run(memory: &mut Memory) {
    static CLIENT: Place<Board> = Place::new();
    let client = CLIENT.put(Client::new(black_box(Config::TCP), [0; 512], [0; 512]));
    // all handles are 1; that is enough, because the image is not run
    let handle = black_box(1);
    converse(client, memory, &call::service_start("WDT=400"));
    converse(client, memory, &call::controller_connect("", black_box("CaoProv.DENSO.VRC9"), "localhost", ""));
    black_box(client.value::<ControllerHandle>().is_ok());
    converse(client, memory, &call::controller_get_variable(ControllerHandle(handle), black_box("I1"), ""));
    black_box(client.value::<VariableHandle>().is_ok());
    converse(client, memory, &call::variable_get_value(VariableHandle(handle)));
    black_box(client.value::<Int>().is_ok());
    converse(client, memory, &call::variable_put_value(VariableHandle(handle), black_box([1.0_f32; 7])));
    converse(client, memory, &call::controller_get_robot(ControllerHandle(handle), black_box("Arm"), ""));
    black_box(client.value::<RobotHandle>().is_ok());
    converse(client, memory, &call::robot_execute(RobotHandle(handle), "slvMove", black_box(&[1.0_f64; 8])));
    converse(client, memory, &call::service_stop());
}

/// Starts a call and polls the client until the call ends.
fn converse<C: Call>(client: &mut Board, memory: &mut Memory, call: &C) {
    let now = black_box(Instant::ZERO);
    black_box(client.start(call, client.timing(), now).is_ok());
    carry(client, memory, now);
}

/// Moves bytes in both directions, as a link would.
#[inline(never)]
fn carry(client: &mut Board, memory: &mut Memory, now: Instant) {
    loop {
        let sent = copy(client.transmit(), &mut memory.output);
        client.transmitted(sent);
        let received = copy(&memory.input, client.receive_buffer());
        client.received(received);
        while let Some(event) = client.poll_event(now) {
            if let Event::Replied(result) = black_box(event) {
                black_box(result);
                if let Some(value) = client.reply().and_then(|reply| reply.value()) {
                    black_box(value.as_array().and_then(|array| array.items::<f64>()?.to_array::<8>()));
                    black_box(value.as_bstr().and_then(|text| text.to_str(&mut memory.output)).is_some());
                    black_box(value.as_f64());
                }
                return;
            }
        }
        if let Some(event) = client.handle_timeout(now) {
            let _ = black_box(event);
            client.abandon();
            client.reset();
            return;
        }
        black_box((client.poll_timeout(), client.is_closed()));
    }
}
