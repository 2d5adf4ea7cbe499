//! Datagrams that are not valid requests, and UDP peers with forged or reused addresses.

use bcap_core::bcap::FunctionId;
use bcap_core::hresult::HResult;
use bcap_testkit::frame::TestFrame;
use bcap_testkit::network::Random;
use bcap_testkit::value::Value;
use bcap_testkit::vectors::frames;

use crate::Case;
use crate::target::{Target, limits};
use crate::wire::{
    Raw, SERIAL, UNKNOWN_TYPES, argument, broken_values, bytes, frame, nested, reply_frame, request, value,
};

pub(crate) const CASES: &[Case] = crate::cases! {
    datagrams:
        datagrams_below_a_header
        datagrams_with_broken_values
        datagrams_with_a_wrong_end_or_length
        datagrams_over_the_limit
        several_frames_in_one_datagram
        replies_in_place_of_requests
        every_beginning_of_every_frame
        random_datagrams
        a_flood_of_datagrams
        one_serial_for_two_functions
        a_serial_of_zero
        a_repeated_request_runs_once
        a_new_client_behind_a_known_address
        a_forged_call_does_not_lock_out_a_client
        a_long_call_does_not_block_other_peers
        a_reply_that_no_datagram_holds
        more_peers_than_slots
        a_peer_that_ends_its_service_leaves_nothing
};

fn datagrams_below_a_header(target: &mut Target) {
    let mut peer = Raw::datagrams(target.udp);
    for length in 0..16 {
        peer.send(&[1; 16][..length]);
        peer.send(&[0; 16][..length]);
        // too short to identify the receiver of an answer, and too short to be worth forging a sender
        peer.hears_nothing();
    }
}

fn datagrams_with_broken_values(target: &mut Target) {
    let mut peer = Raw::datagrams(target.udp);
    let unknown = UNKNOWN_TYPES.iter().map(|vartype| ("unknown type", value(*vartype, 1, &[0; 4])));
    let deep = [9, 16, 17, 70].map(|levels| ("nesting", nested(levels)));
    // only a known peer gets an error; garbage creates no peers
    peer.begin();
    for (name, value) in broken_values().into_iter().chain(unknown).chain(deep) {
        peer.send(&frame(SERIAL, FunctionId::SERVICE_START.0, 1, &argument(&value)));
        let reply = peer.reply();
        assert_eq!((reply.serial, reply.code), (SERIAL, HResult::E_INVALIDRCPACKET.0), "{name}");
        peer.send(&frame(SERIAL, 4, 3, &argument(&Value::I4(1).to_wire())));
        assert_eq!(peer.reply().code, HResult::E_INVALIDRCPACKET.0);
    }
    peer.end();
    // and an unknown one is not
    let mut stranger = Raw::datagrams(target.udp);
    for (_, value) in broken_values() {
        stranger.send(&frame(SERIAL, FunctionId::SERVICE_START.0, 1, &argument(&value)));
    }
    stranger.hears_nothing();
}

fn datagrams_with_a_wrong_end_or_length(target: &mut Target) {
    let mut peer = Raw::datagrams(target.udp);
    let good = bytes(FunctionId::SERVICE_START, vec![]);
    for (at, wrong) in [(0, 2), (15, 5), (1, 15), (1, 17), (1, 0), (4, 0xff), (13, 1), (14, 0xff)] {
        let mut bad = good.clone();
        bad[at] = wrong;
        peer.send(&bad);
    }
    peer.hears_nothing();
}

fn datagrams_over_the_limit(target: &mut Target) {
    let mut peer = Raw::datagrams(target.udp);
    for length in [505, 506, 600, 1000, 1500, 10_000, 60_000, 65_507] {
        let value = Value::Array(17, vec![Value::Ui1(1); length - 16 - 4 - 6]);
        let long = frame(SERIAL, FunctionId::SERVICE_START.0, 1, &argument(&value.to_wire()));
        assert_eq!(long.len(), length);
        peer.send(&long);
        peer.send(&vec![1; length]);
    }
    peer.hears_nothing();
}

fn several_frames_in_one_datagram(target: &mut Target) {
    let mut peer = Raw::datagrams(target.udp);
    peer.send(&bytes(FunctionId::SERVICE_START, vec![]).repeat(2));
    let start = bytes(FunctionId::SERVICE_START, vec![]);
    // nor is a frame put together from two
    peer.send(&start[..9]);
    peer.send(&start[9..]);
    peer.hears_nothing();
}

/// A reply differs from a request only by its code, which is not a function; two servers must not answer each other.
fn replies_in_place_of_requests(target: &mut Target) {
    let mut peer = Raw::datagrams(target.udp);
    for (serial, code) in (100..).zip([HResult::S_OK, HResult::S_EXECUTING, HResult::E_FAIL, HResult::E_INVALIDARG]) {
        peer.send(&reply_frame(serial, code, vec![]));
        assert_eq!(peer.reply().code, HResult::E_INVALIDARG.0);
    }
    peer.serial = 200;
    peer.hears_nothing();
}

fn every_beginning_of_every_frame(target: &mut Target) {
    let mut peer = Raw::datagrams(target.udp);
    peer.serial = 60_000;
    for vector in frames() {
        peer.hears_nothing();
        // once the header is complete, a known peer gets an error
        for cut in 0..vector.bytes.len() {
            peer.send(&vector.bytes[..cut]);
        }
        for _ in 16..vector.bytes.len() {
            assert_eq!(peer.reply().code, HResult::E_INVALIDRCPACKET.0);
        }
    }
}

fn random_datagrams(target: &mut Target) {
    let mut random = Random(11);
    for _ in 0..20 {
        let mut peer = Raw::datagrams(target.udp);
        for _ in 0..100 {
            let mut bytes: Vec<u8> = (0..random.below(600)).map(|_| random.number() as u8).collect();
            if let Some(first) = bytes.first_mut() {
                *first = 1;
            }
            peer.send(&bytes);
        }
    }
}

fn a_flood_of_datagrams(target: &mut Target) {
    let mut peers: Vec<Raw> = (0..8).map(|_| Raw::datagrams(target.udp)).collect();
    for round in 0..2000_u16 {
        for peer in &mut peers {
            peer.send(&[1, 0, 0]);
            peer.send(&frame(round, 138, 0, &[]));
        }
        if round % 500 == 0 {
            target.serves_others();
        }
    }
}

/// The same serial for another function is another call, and not a repetition of the first.
fn one_serial_for_two_functions(target: &mut Target) {
    let mut peer = Raw::datagrams(target.udp);
    let controller = peer.begin();
    for (function, code) in
        [(FunctionId::CONTROLLER_GET_NAME, 0), (FunctionId::CONTROLLER_GET_TAG, HResult::E_NOTIMPL.0)]
    {
        peer.send(&TestFrame { serial: 500, ..request(function, vec![Value::I4(controller)]) }.to_wire(false));
        let reply = peer.reply();
        assert_eq!((reply.serial, reply.code), (500, code));
    }
    peer.serial = 500;
    peer.end();
}

/// A first request of serial 0 is executed, and not treated as a request that was answered before.
fn a_serial_of_zero(target: &mut Target) {
    let mut peer = Raw::datagrams(target.udp);
    let open = target.open();
    peer.send(&frame(0, FunctionId::SERVICE_START.0, 0, &[]));
    let reply = peer.reply();
    assert_eq!((reply.serial, reply.code), (0, 0));
    assert_eq!(target.open(), open + 1, "it was executed");
    peer.end();
}

fn a_repeated_request_runs_once(target: &mut Target) {
    let mut peer = Raw::datagrams(target.udp);
    let controller = peer.begin();
    let open = target.open();
    let args = vec![Value::I4(controller), Value::text("V"), Value::text("")];
    let mut get = TestFrame { reserved: 10, ..request(FunctionId::CONTROLLER_GET_VARIABLE, args) };
    let mut replies = Vec::new();
    for serial in 10..30 {
        get.serial = serial;
        peer.send(&get.to_wire(false));
        let reply = peer.reply();
        assert_eq!((reply.serial, reply.code), (serial, 0));
        replies.push(reply.args);
    }
    replies.dedup();
    assert_eq!(replies.len(), 1, "all got the same handle");
    assert_eq!(target.open(), open + 1);
    peer.serial = 30;
    peer.end();
}

/// A client that restarts on the same port, with the same serials, gets answers to its own calls and inherits nothing.
fn a_new_client_behind_a_known_address(target: &mut Target) {
    let mut peer = Raw::datagrams(target.udp);
    let before = target.open();
    let first = peer.begin();
    let marker = 2;
    // its first attempt may be a copy of the old client's; its second call had the serial of another call
    let start = request(FunctionId::SERVICE_START, vec![Value::text("")]);
    peer.send(&TestFrame { serial: marker, reserved: marker, ..start.clone() }.to_wire(false));
    peer.send(&TestFrame { serial: marker + 1, reserved: marker, ..start }.to_wire(false));
    let reply = peer.reply();
    assert_eq!((reply.serial, reply.code), (marker + 1, 0));
    let connect = peer.ask(FunctionId::CONTROLLER_CONNECT, vec![Value::text(""); 4]);
    assert_ne!(connect.args, [Value::I4(first)], "a handle of its own");
    assert_eq!(target.open(), before + 2, "what the first one had is released");
    assert_eq!(peer.ask(FunctionId::CONTROLLER_GET_NAME, vec![Value::I4(first)]).code, HResult::E_HANDLE.0);
    peer.end();
}

/// A forged call from the address of a client, before its session and in it, costs the client nothing.
fn a_forged_call_does_not_lock_out_a_client(target: &mut Target) {
    let mut peer = Raw::datagrams(target.udp);
    let forged = request(FunctionId::CONTROLLER_GET_NAME, vec![Value::I4(3)]);
    let forged = TestFrame { serial: 57, reserved: 57, ..forged }.to_wire(false);
    peer.send(&forged);
    assert_eq!(peer.reply().code, HResult::E_HANDLE.0);
    peer.serial = 0;
    peer.begin();
    peer.send(&forged);
    assert_eq!(peer.reply().code, HResult::E_HANDLE.0);
    peer.end();
    // without a session there are no copies: every request is answered, under any serial
    for serial in [57, 57, 1, 65_535, 2000, 57] {
        peer.send(&TestFrame { serial, ..request(FunctionId::CONTROLLER_GET_NAME, vec![Value::I4(3)]) }.to_wire(false));
        assert_eq!(peer.reply().serial, serial);
    }
    peer.serial = 0;
    peer.begin();
    peer.end();
}

fn a_long_call_does_not_block_other_peers(target: &mut Target) {
    let mut slow = Raw::datagrams(target.udp);
    assert_eq!(slow.ask(FunctionId::SERVICE_START, vec![Value::text("InvokeTimeout=3000")]).code, 0);
    let connect = slow.ask(FunctionId::CONTROLLER_CONNECT, vec![Value::text(""); 4]);
    let args = vec![connect.args[0].clone(), Value::text("sleep"), Value::I4(3_600_000)];
    let request = TestFrame { serial: 50, ..request(FunctionId::CONTROLLER_EXECUTE, args) };
    slow.send(&request.to_wire(false));
    // garbage and repetitions of the slow one do not disturb it either
    slow.send(&[1; 20]);
    slow.send(&[]);
    target.serves_others();
    let mut other = Raw::datagrams(target.udp);
    other.begin();
    other.end();
    let mut reply = slow.reply();
    while reply.serial != 50 {
        reply = slow.reply();
    }
    assert_eq!(reply.code, HResult::E_TIMEOUT.0);
    slow.serial = 50;
    slow.end();
}

/// The client gets an error reply instead of running into its timeouts.
fn a_reply_that_no_datagram_holds(target: &mut Target) {
    let mut peer = Raw::datagrams(target.udp);
    let controller = peer.begin();
    let text = "x".repeat(190);
    let args = vec![Value::I4(controller), Value::text("echo"), Value::text(&text)];
    assert_eq!(peer.ask(FunctionId::CONTROLLER_EXECUTE, args).code, 0);
    // a string of 229 characters is the longest that a reply of 488 bytes can have
    let (name, put) = (vec![Value::I4(controller), Value::text("V"), Value::text("")], FunctionId::VARIABLE_PUT_VALUE);
    let variable = peer.ask(FunctionId::CONTROLLER_GET_VARIABLE, name).args[0].clone();
    // and a request with 230 is the longest datagram, 504 bytes
    for (length, expected) in [(229, 0), (230, HResult::E_TOO_MUCH_DATA.0)] {
        let put = peer.ask(put, vec![variable.clone(), Value::text(&"x".repeat(length))]);
        assert_eq!(put.code, 0, "{length}");
        let get = peer.ask(FunctionId::VARIABLE_GET_VALUE, vec![variable.clone()]);
        assert_eq!(get.code, expected, "{length}");
    }
    peer.end();
}

/// A peer keeps its slot while it sends requests; other peers get E_MAX_CONNECT.
fn more_peers_than_slots(target: &mut Target) {
    let mut inside = Vec::new();
    let mut turned_away = 0;
    for _ in 0..3 * limits().udp_peers {
        let mut peer = Raw::datagrams(target.udp);
        let code = peer.ask(FunctionId::SERVICE_START, vec![]).code;
        if code == 0 {
            inside.push(peer);
        } else {
            assert_eq!(code, HResult::E_MAX_CONNECT.0);
            turned_away += 1;
        }
    }
    // one place is the bystander's
    assert_eq!((inside.len(), turned_away), (limits().udp_peers - 1, 2 * limits().udp_peers + 1));
    for peer in &mut inside {
        assert_eq!(peer.ask(FunctionId::SERVICE_START, vec![]).code, 0, "who is in stays in");
    }
    // a peer that ends its service makes room for others immediately
    for peer in &mut inside {
        peer.end();
        target.serves_others();
    }
}

fn a_peer_that_ends_its_service_leaves_nothing(target: &mut Target) {
    let mut peer = Raw::datagrams(target.udp);
    let before = target.open();
    let controller = peer.begin();
    for _ in 0..5 {
        let args = vec![Value::I4(controller), Value::text("V"), Value::text("")];
        assert_eq!(peer.ask(FunctionId::CONTROLLER_GET_VARIABLE, args).code, 0);
    }
    assert_eq!(target.open(), before + 7);
    peer.end();
    assert_eq!(target.open(), before);
}
