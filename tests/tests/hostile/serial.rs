//! A serial line with noise, lost bytes and wrong CRCs, client and server of the core end to end, without a device.

use bcap_core::endpoint::{Endpoint, Serve};
use std::time::Duration;

use bcap_core::bcap::FunctionId;
use bcap_core::bcap::call::{self, VariableHandle};
use bcap_core::bcap::client::{self, Client};
use bcap_core::bcap::server::{self, Session};
use bcap_core::handler::PeerId;
use bcap_core::time::Instant;
use bcap_testkit::frame::field;
use bcap_testkit::value::Value;
use bcap_tests::served::Application;

use crate::Case;
use crate::target::Target;
use crate::wire::request;

pub(crate) const CASES: &[Case] = crate::cases! {
    serial:
        a_wrong_crc_is_passed_over
        noise_between_frames_is_passed_over
        a_frame_that_lost_a_byte
        a_reply_with_a_wrong_crc
};

type Line = Session<[u8; 512], [u8; 512], 8>;

fn server() -> (Line, Application) {
    (Session::new(server::Config::SERIAL, [0; 512], [0; 512]), Application::default())
}

/// Gives the server bytes and returns its answer.
fn send(line: &mut (Line, Application), bytes: &[u8]) -> Vec<u8> {
    let mut sent = Vec::new();
    for byte in bytes {
        line.0.receive_buffer()[0] = *byte;
        line.0.received(1);
        while line.0.run(&mut line.1, PeerId(1), Instant::ZERO).is_some() {
            sent.extend(line.0.transmit());
            line.0.transmitted(usize::MAX);
        }
    }
    sent
}

fn good(serial: u16) -> Vec<u8> {
    let mut start = request(FunctionId::SERVICE_START, vec![Value::text("")]);
    (start.serial, start.reserved) = (serial, serial);
    start.to_wire(true)
}

/// The length of an answer to `good`.
const ANSWER: usize = 18;

/// Asserts that the server decodes a repeated request. Earlier bytes may look like the beginning of a frame, and hide
/// repetitions up to the length that it claims, at most 503 bytes.
fn is_heard(line: &mut (Line, Application), serial: u16) {
    let repetitions = 1 + 503 / good(serial).len();
    let answer = (0..=repetitions).map(|_| send(line, &good(serial))).find(|sent| !sent.is_empty());
    assert!(answer.is_some_and(|answer| answer.len().is_multiple_of(ANSWER)), "after {repetitions} repetitions");
}

fn a_wrong_crc_is_passed_over(_: &mut Target) {
    let mut line = server();
    for at in field::SERIAL.start..good(1).len() - 1 {
        let mut bad = good(1);
        bad[at] ^= 0x10;
        assert_eq!(send(&mut line, &bad), [0_u8; 0], "byte {at}");
    }
    // a thousand invalid frames use no more buffer than one
    let mut bad = good(1);
    bad[field::CODE.start] ^= 1;
    assert_eq!(send(&mut line, &bad.repeat(1000)), [0_u8; 0]);
    is_heard(&mut line, 1);
}

fn noise_between_frames_is_passed_over(_: &mut Target) {
    let mut line = server();
    for (serial, noise) in (1..).zip([&[0xff; 100][..], &[1, 1, 1], &[1, 0xff, 0xff, 0xff, 0xff], &[4; 700], &[1, 16]])
    {
        assert_eq!(send(&mut line, noise), [0_u8; 0]);
        is_heard(&mut line, serial);
    }
}

fn a_frame_that_lost_a_byte(_: &mut Target) {
    for at in 0..good(1).len() {
        let mut line = server();
        let mut bad = good(1);
        bad.remove(at);
        send(&mut line, &bad);
        is_heard(&mut line, 2);
    }
}

/// It costs an attempt and not the call.
fn a_reply_with_a_wrong_crc(_: &mut Target) {
    let mut now = Instant::ZERO;
    let mut client = Client::new(client::Config::SERIAL, [0; 512], [0; 512]);
    client.start(&call::variable_get_value(VariableHandle(1)), client.timing(), now).unwrap();
    for attempt in 1..=3 {
        assert!(!client.transmit().is_empty());
        client.transmitted(usize::MAX);
        let mut reply = crate::wire::request(FunctionId(0), vec![Value::I4(42)]);
        reply.serial = attempt;
        let mut bytes = reply.to_wire(true);
        if attempt < 3 {
            bytes[20] ^= 1;
        }
        client.receive_buffer()[..bytes.len()].copy_from_slice(&bytes);
        client.received(bytes.len());
        let mut replied = false;
        while let Some(event) = client.poll_event(now) {
            replied |= matches!(event, client::Event::Replied(_));
        }
        assert_eq!(replied, attempt == 3);
        if !replied {
            now = now + Duration::from_millis(500);
            assert_eq!(client.handle_timeout(now), Some(client::Event::Retried { attempt: attempt as u8 + 1 }));
        }
    }
}
