//! Servers that send S_EXECUTING as fast as they can.

use std::net::UdpSocket;
use std::thread;
use std::time::Duration;

use bcap_core::bcap::call;
use bcap_core::hresult::HResult;
use bcap_std::{asynch, blocking};
use bcap_tests::process::thread_time;
use bcap_tests::tools;

use crate::script::{VARIABLE, brief, runtime, serial_of, serve};
use crate::target::Target;
use crate::wire::reply_frame;

/// The call ends with an error, and until then its client sleeps most of the time.
pub(super) fn a_flood_of_keep_alives_costs_little(_: &mut Target) {
    let flood = || {
        serve(|connection| {
            let keep_alives = reply_frame(connection.request(), HResult::S_EXECUTING, vec![]).repeat(1000);
            while connection.send(&keep_alives) {}
        })
    };
    let flood_udp = || {
        let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
        let address = socket.local_addr().unwrap();
        thread::spawn(move || {
            let mut buffer = [0; 600];
            let (count, client) = socket.recv_from(&mut buffer).unwrap();
            let keep_alive = reply_frame(serial_of(&buffer[..count]), HResult::S_EXECUTING, vec![]);
            // until the client's socket is closed, which a connected socket reports
            socket.connect(client).unwrap();
            while socket.send(&keep_alive).is_ok() {}
        });
        address
    };
    let budget = Duration::from_secs(3);
    let mut options = brief();
    for config in [&mut options.tcp, &mut options.udp] {
        (config.timing.keep_alive, config.timing.attempt_timeout) = (budget, budget);
    }
    let value = || call::variable_get_value(VARIABLE);
    let mut over_tcp = blocking::connect_tcp(flood(), &options).unwrap();
    costs_little(budget, || over_tcp.call(value()).map(|_| ()).is_err());
    let mut over_udp = blocking::connect_udp(flood_udp(), &options).unwrap();
    costs_little(budget, || over_udp.call(value()).map(|_| ()).is_err());
    runtime().block_on(async {
        let mut client = asynch::connect_tcp(flood(), &options).await.unwrap();
        let before = thread_time();
        assert!(client.call(value()).await.is_err(), "a keep-alive was taken for a reply");
        is_little(budget, before);
    });
}

/// Asserts that a call fails, and uses at most a tenth of the time that it may take.
fn costs_little(budget: Duration, call: impl FnOnce() -> bool) {
    let before = thread_time();
    assert!(call(), "a keep-alive was taken for a reply");
    is_little(budget, before);
}

fn is_little(budget: Duration, before: Option<Duration>) {
    let (Some(before), Some(after)) = (before, thread_time()) else {
        return tools::missing("there is no /proc to tell a thread's processor time");
    };
    assert!(after - before < budget / 10, "{:?} of processor time in {budget:?}", after - before);
}
