//! Clients that open as many objects as they may.

use bcap_core::bcap::FunctionId;
use bcap_core::bcap::server::{Config, Session};
use bcap_core::endpoint::{Endpoint, Serve};
use bcap_core::handler::PeerId;
use bcap_core::time::Instant;
use bcap_sim::{Controller, Profile};
use bcap_testkit::judge::TCP;
use bcap_testkit::value::Value;
use bcap_tests::process::thread_time;
use bcap_tests::tools;

use crate::target::Target;
use crate::wire::bytes;

/// Clients of the virtual controller, in sequence, each with the maximum number of objects.
pub(super) fn objects_of_others_do_not_slow_opening(_: &mut Target) {
    const CLIENTS: u32 = 24;
    const OBJECTS: u16 = 500;
    let mut controller = Controller::new(bcap_sim::Config::new(Profile::Rc8));
    let mut costs = Vec::new();
    for peer in (1..=CLIENTS).map(PeerId) {
        let mut line = Session::<Vec<u8>, Vec<u8>, 512>::new(Config::TCP, vec![0; 1024], vec![0; 1024]);
        let mut ask = |function, args| {
            let bytes = bytes(function, args);
            line.receive_buffer()[..bytes.len()].copy_from_slice(&bytes);
            line.received(bytes.len());
            while line.run(&mut controller, peer, Instant::ZERO).is_some() {}
            let reply = TCP.decode_packet(line.transmit()).unwrap();
            line.transmitted(usize::MAX);
            assert_eq!(reply.code, 0, "{function:?}");
            reply
        };
        ask(FunctionId::SERVICE_START, vec![]);
        let names = ["", Profile::Rc8.provider(), "localhost", ""].map(Value::text).to_vec();
        let handle = ask(FunctionId::CONTROLLER_CONNECT, names).args.remove(0);
        let before = thread_time();
        for _ in 0..OBJECTS - 2 {
            let variable = vec![handle.clone(), Value::text("I1"), Value::text("")];
            ask(FunctionId::CONTROLLER_GET_VARIABLE, variable);
        }
        let (Some(before), Some(after)) = (before, thread_time()) else {
            return tools::missing("there is no /proc to tell a thread's processor time");
        };
        costs.push(after - before);
    }
    let (first, last) = (costs[0].min(costs[1]), costs[costs.len() - 1].min(costs[costs.len() - 2]));
    assert!(last < 3 * first, "{OBJECTS} objects cost {first:?}, and {last:?} with {} others", costs.len() * 500);
}
