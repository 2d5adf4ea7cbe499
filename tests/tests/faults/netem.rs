//! The same over the loopback of this machine. `bash .ci/run netem` runs it in a network namespace, where the kernel's netem
//! loses one datagram in ten, duplicates one in ten, reorders one in four, and delays each by up to 200 ms.

use std::time::Duration;

use bcap_core::bcap::call;
use bcap_std::{Options, blocking};
use bcap_testkit::network::answer_to;
use bcap_tests::served::Served;

use crate::faults::datagrams::{call_over_udp, limits};

#[test]
#[ignore = "`bash .ci/run netem` runs it on a bad link"]
fn the_link_carries_every_call_once() {
    let server = Served::start(limits());
    let mut client = blocking::connect_tcp(server.tcp, &Options::default().timeout(Duration::from_secs(30))).unwrap();
    client.call(call::service_start("")).unwrap();
    let controller = client.call(call::controller_connect("", "", "", "")).unwrap();
    for token in -20..0 {
        let answer = client.call(call::controller_execute(controller, "token", [token, 0])).unwrap();
        assert_eq!(answer.as_i32(), Some(answer_to(token)));
    }
    drop(client);
    let address = server.udp;
    let (done, failed) = call_over_udp(server, address, 1000, Duration::from_millis(400));
    println!("behind netem: {done} calls done and executed once, {failed} given up and executed at most once");
    assert!(done > 900, "{failed} of 1000 given up");
}
