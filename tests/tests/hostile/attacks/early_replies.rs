//! Servers that reply before they are asked.

use std::net::UdpSocket;
use std::sync::mpsc;
use std::thread;

use bcap_core::bcap::call;
use bcap_core::hresult::HResult;
use bcap_std::{asynch, blocking};
use bcap_testkit::value::Value;

use crate::script::{Outcome, RIGHT, VARIABLE, brief, right, runtime, serial_of, serve};
use crate::target::Target;
use crate::wire::reply_frame;

/// The reply that a server sends before the request that it seems to answer.
fn early(serial: u16) -> Vec<u8> {
    reply_frame(serial, HResult::S_OK, vec![Value::I4(666)])
}

/// Early replies arrive before the first call, and together with the replies of the calls before the others.
pub(super) fn a_reply_before_its_request_is_not_its_reply(_: &mut Target) {
    let server = || {
        let (tell, told) = mpsc::channel();
        let address = serve(move |connection| {
            connection.send(&early(1));
            _ = tell.send(());
            for _ in 0..3 {
                let serial = connection.request();
                connection.send(&[right(serial), early(serial.wrapping_add(1))].concat());
                _ = tell.send(());
            }
            connection.hold();
        });
        (address, told)
    };
    let (address, told) = server();
    let mut client = blocking::connect_tcp(address, &brief()).unwrap();
    for _ in 0..3 {
        told.recv().unwrap();
        assert_eq!(Outcome::from(client.call(call::variable_get_value(VARIABLE))), RIGHT);
    }
    let (address, told) = server();
    runtime().block_on(async {
        let mut client = asynch::connect_tcp(address, &brief()).await.unwrap();
        for _ in 0..3 {
            told.recv().unwrap();
            assert_eq!(Outcome::from(client.call(call::variable_get_value(VARIABLE)).await), RIGHT);
        }
    });
}

pub(super) fn a_datagram_before_its_request_is_not_its_reply(_: &mut Target) {
    let server = || {
        let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
        let address = socket.local_addr().unwrap();
        let (tell, told) = mpsc::channel();
        thread::spawn(move || {
            let mut buffer = [0; 600];
            while let Ok((count, peer)) = socket.recv_from(&mut buffer) {
                let serial = serial_of(&buffer[..count]);
                for reply in [right(serial), early(serial.wrapping_add(1))] {
                    _ = socket.send_to(&reply, peer);
                }
                if tell.send(()).is_err() {
                    return;
                }
            }
        });
        (address, told)
    };
    let (address, told) = server();
    let mut client = blocking::connect_udp(address, &brief()).unwrap();
    for _ in 0..3 {
        assert_eq!(Outcome::from(client.call(call::variable_get_value(VARIABLE))), RIGHT);
        told.recv().unwrap();
    }
    let (address, told) = server();
    runtime().block_on(async {
        let mut client = asynch::connect_udp(address, &brief()).await.unwrap();
        for _ in 0..3 {
            assert_eq!(Outcome::from(client.call(call::variable_get_value(VARIABLE)).await), RIGHT);
            told.recv().unwrap();
        }
    });
}
