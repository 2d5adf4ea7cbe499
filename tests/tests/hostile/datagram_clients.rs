//! Attacks on blocking and tokio clients over UDP: the server loses, repeats or corrupts replies, or another host answers.

use std::net::UdpSocket;

use bcap_core::bcap::client::{ClientError, Timeout};
use bcap_core::bcap::{HEADER_LEN, Header};
use bcap_core::hresult::HResult;
use bcap_testkit::value::Value;

use crate::Case;
use crate::script::{Answers, Outcome, RIGHT, brief, calls_udp, right, serial_of, serve_udp};
use crate::target::{Target, long_timeouts};
use crate::wire::{argument, broken_values, frame, nested, reply_frame};

pub(crate) const CASES: &[Case] = crate::cases! {
    datagram_clients:
        a_server_that_does_not_answer
        a_closed_port
        garbage_before_a_reply
        garbage_costs_no_attempt
        replies_over_the_limit
        a_reply_cut_in_two_datagrams
        two_replies_in_one_datagram
        replies_repeated
        a_late_datagram_does_not_end_the_next_call
        a_reply_to_an_earlier_attempt
        endless_wrong_serials_over_udp
        endless_keep_alives_over_udp
        datagrams_from_elsewhere
};

const SILENCE: Outcome = Outcome::Client(ClientError::Timeout(Timeout::Attempt));

fn ends(expected: &[Outcome], answers: Answers) {
    assert_eq!(calls_udp(&brief(), expected.len(), || serve_udp(answers)), expected);
}

fn a_server_that_does_not_answer(_: &mut Target) {
    ends(&[SILENCE, SILENCE], |_, _| vec![]);
}

/// The call ends whether or not the network reports the closed port.
fn a_closed_port(_: &mut Target) {
    let address = UdpSocket::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    let outcomes = calls_udp(&brief(), 1, || address);
    assert!([Outcome::Io, SILENCE].contains(&outcomes[0]), "{outcomes:?}");
}

fn garbage(serial: u16) -> Vec<Vec<u8>> {
    let mut all: Vec<Vec<u8>> =
        broken_values().into_iter().map(|(_, value)| frame(serial, 0, 1, &argument(&value))).collect();
    all.extend((0..30).map(|length| right(serial)[..length].to_vec()));
    all.push(frame(serial, 0, 1, &argument(&nested(17))));
    all.push(frame(serial, 0, 9, &argument(&Value::I4(1).to_wire())));
    all.push(vec![0xff; 504]);
    all
}

fn garbage_before_a_reply(_: &mut Target) {
    let server = || {
        serve_udp(|datagram, _| {
            let serial = serial_of(datagram);
            garbage(serial).into_iter().chain([right(serial)]).collect()
        })
    };
    assert_eq!(calls_udp(&long_timeouts(), 3, server), [RIGHT, RIGHT, RIGHT]);
}

/// There is only one attempt; datagrams from other senders do not end it.
fn garbage_costs_no_attempt(_: &mut Target) {
    let mut options = long_timeouts();
    options.udp.timing.attempts = 1;
    options.udp.timing.attempt_timeout = crate::target::TIMEOUT;
    let server = || {
        serve_udp(|datagram, _| {
            let serial = serial_of(datagram);
            let foreign = (2..50).map(|n| right(serial.wrapping_add(n)));
            garbage(serial).into_iter().chain(foreign).chain([vec![], right(serial)]).collect()
        })
    };
    assert_eq!(calls_udp(&options, 2, server), [RIGHT, RIGHT]);
}

fn replies_over_the_limit(_: &mut Target) {
    ends(&[SILENCE], |datagram, _| {
        let long = Value::Array(17, vec![Value::Ui1(1); 600]);
        vec![reply_frame(serial_of(datagram), HResult::S_OK, vec![long])]
    });
    // the largest datagram that does not exceed it
    let largest = Value::Array(17, vec![Value::Ui1(1); 504 - 26]);
    let expected = Outcome::Value(largest.clone());
    let server = || {
        let largest = largest.clone();
        serve_udp(move |datagram, _| vec![reply_frame(serial_of(datagram), HResult::S_OK, vec![largest.clone()])])
    };
    assert_eq!(calls_udp(&long_timeouts(), 1, server), [expected]);
}

fn a_reply_cut_in_two_datagrams(_: &mut Target) {
    ends(&[SILENCE], |datagram, _| {
        let reply = right(serial_of(datagram));
        let (header, rest) = reply.split_at(HEADER_LEN);
        vec![header.to_vec(), rest.to_vec()]
    });
}

fn two_replies_in_one_datagram(_: &mut Target) {
    ends(&[SILENCE], |datagram, _| vec![right(serial_of(datagram)).repeat(2)]);
}

fn replies_repeated(_: &mut Target) {
    let server = || serve_udp(|datagram, _| vec![right(serial_of(datagram)); 20]);
    assert_eq!(calls_udp(&long_timeouts(), 5, server), [RIGHT, RIGHT, RIGHT, RIGHT, RIGHT]);
}

fn a_late_datagram_does_not_end_the_next_call(_: &mut Target) {
    // the first call's three attempts are answered when the second call has arrived
    ends(&[SILENCE, RIGHT], |datagram, count| {
        let serial = serial_of(datagram);
        let late = (1..=3).map(|ago| reply_frame(serial.wrapping_sub(ago), HResult::S_OK, vec![Value::text("late")]));
        if count < 4 { vec![] } else { late.chain([right(serial)]).collect() }
    });
}

/// The server executes a call once, so a reply to any attempt is valid.
fn a_reply_to_an_earlier_attempt(_: &mut Target) {
    let mut options = brief();
    options.udp.timing.attempt_timeout = std::time::Duration::from_secs(2);
    let server = || serve_udp(|datagram, count| if count < 3 { vec![] } else { vec![right(marker_of(datagram))] });
    assert_eq!(calls_udp(&options, 1, server), [RIGHT]);
}

/// The serial of the first attempt.
fn marker_of(datagram: &[u8]) -> u16 {
    Header::read(datagram).unwrap().reserved
}

fn endless_wrong_serials_over_udp(_: &mut Target) {
    ends(&[SILENCE], |datagram, _| (10..200).map(|n| right(serial_of(datagram).wrapping_add(n))).collect());
}

fn endless_keep_alives_over_udp(_: &mut Target) {
    let server = || {
        let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
        let address = socket.local_addr().unwrap();
        std::thread::spawn(move || {
            let mut buffer = [0; 600];
            let (length, from) = socket.recv_from(&mut buffer).unwrap();
            let serial = serial_of(&buffer[..length]);
            // until the client's socket is closed, which a connected socket reports
            socket.connect(from).unwrap();
            while socket.send(&reply_frame(serial, HResult::S_EXECUTING, vec![])).is_ok() {
                std::thread::sleep(std::time::Duration::from_millis(10));
            }
        });
        address
    };
    let mut options = brief();
    options.udp.timing.attempt_timeout = std::time::Duration::from_secs(20);
    let expected = Outcome::Client(ClientError::Timeout(Timeout::KeepAlive));
    assert_eq!(calls_udp(&options, 1, server), [expected]);
}

/// The socket accepts only its server's datagrams: replies to other clients neither answer a call nor use up an
/// attempt.
fn datagrams_from_elsewhere(_: &mut Target) {
    let server = || {
        let (socket, other) = (UdpSocket::bind("127.0.0.1:0").unwrap(), UdpSocket::bind("127.0.0.1:0").unwrap());
        let address = socket.local_addr().unwrap();
        std::thread::spawn(move || {
            let mut buffer = [0; 600];
            for _ in 0..3 {
                let (length, from) = socket.recv_from(&mut buffer).unwrap();
                let serial = serial_of(&buffer[..length]);
                for _ in 0..50 {
                    other.send_to(&reply_frame(serial, HResult::S_OK, vec![Value::text("forged")]), from).unwrap();
                }
                socket.send_to(&right(serial), from).unwrap();
            }
        });
        address
    };
    let mut options = long_timeouts();
    options.udp.timing.attempts = 1;
    options.udp.timing.attempt_timeout = crate::target::TIMEOUT;
    assert_eq!(calls_udp(&options, 3, server), [RIGHT, RIGHT, RIGHT]);
}
