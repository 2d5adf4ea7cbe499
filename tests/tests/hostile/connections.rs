//! Misbehaving TCP connections: they stall, hang, flood or disappear.

use std::io::Write;
use std::time::{Duration, Instant};

use bcap_core::bcap::FunctionId;
use bcap_core::hresult::HResult;
use bcap_testkit::value::Value;
use bcap_tests::tools;

use crate::Case;
use crate::target::{Target, limits};
use crate::wire::{Raw, SERIAL, bytes, request};

pub(crate) const CASES: &[Case] = crate::cases! {
    connections:
        one_byte_then_the_end
        half_a_request_then_the_rest
        a_request_cut_at_every_byte
        a_reset_at_every_byte
        a_byte_at_a_time
        many_requests_in_one_piece
        a_repeated_serial_runs_again
        endless_requests_do_not_starve_others
        large_requests_of_many_at_the_same_time
        a_peer_that_never_reads
        a_peer_that_asks_for_much_and_never_reads
        silent_connections_cost_no_processor_time
        connections_to_the_limit_and_past_it
        connections_that_come_and_go
};

/// Cases that last at least as long as the time limit of a request.
pub(crate) const UNFINISHED: &[Case] = crate::cases! {
    connections:
        one_byte_then_silence
        half_a_request_then_silence
        pieces_that_never_end_with_a_request
};

/// Connections enough to occupy a server that gives each of them a thread or a core.
const MANY: usize = 40;

fn many(target: &Target) -> Vec<Raw> {
    (0..MANY).map(|_| Raw::connect(target.tcp)).collect()
}

/// Asserts that the server sleeps.
fn sleeps(target: &Target) {
    match target.load() {
        Some(load) => assert!(load < 0.2, "{:.0} % of a processor for connections that say nothing", load * 100.0),
        None => tools::missing("there is no /proc to tell the server's processor time"),
    }
}

fn one_byte_then_silence(target: &mut Target) {
    let mut all = many(target);
    let parts = [&[1][..], &[1, 0x20, 0, 0]].into_iter().cycle();
    all.iter_mut().zip(parts).for_each(|(raw, part)| raw.send(part));
    target.serves_others();
    sleeps(target);
    // no request has arrived in time, so there is nothing to answer
    for mut raw in all {
        assert_eq!(raw.rest(), [0_u8; 0]);
    }
}

fn one_byte_then_the_end(target: &mut Target) {
    let mut all = many(target);
    all.iter_mut().for_each(|raw| raw.send(&[1]));
    all.iter_mut().for_each(Raw::finish);
    for mut raw in all {
        assert_eq!(raw.rest(), [0_u8; 0]);
    }
    sleeps(target);
}

fn half_a_request_then_silence(target: &mut Target) {
    let request = bytes(FunctionId::CONTROLLER_CONNECT, vec![Value::text("x"); 4]);
    let mut all = many(target);
    for (at, raw) in all.iter_mut().enumerate() {
        raw.send(&request[..5 + at]);
    }
    target.serves_others();
    for mut raw in all {
        assert_eq!(raw.rest(), [0_u8; 0]);
    }
}

/// A pause in the middle of a request, as on a slow network, does no harm.
fn half_a_request_then_the_rest(target: &mut Target) {
    let start = bytes(FunctionId::SERVICE_START, vec![Value::text("")]);
    for at in [1, 4, 5, 15, 16, start.len() - 1] {
        let mut raw = Raw::connect(target.tcp);
        raw.send(&start[..at]);
        std::thread::sleep(Duration::from_millis(100));
        raw.send(&start[at..]);
        let reply = raw.reply();
        assert_eq!((reply.serial, reply.code), (SERIAL, 0));
        raw.begin();
    }
}

fn a_request_cut_at_every_byte(target: &mut Target) {
    let connect = bytes(FunctionId::CONTROLLER_CONNECT, vec![Value::text("x"); 4]);
    for at in 0..connect.len() {
        let mut raw = Raw::connect(target.tcp);
        raw.begin();
        raw.send(&connect[..at]);
        raw.finish();
        assert_eq!(raw.rest(), [0_u8; 0], "the end is the answer to half a request");
    }
}

fn a_reset_at_every_byte(target: &mut Target) {
    let connect = bytes(FunctionId::CONTROLLER_CONNECT, vec![Value::text("x"); 4]);
    for at in 0..=connect.len() {
        let mut raw = Raw::connect(target.tcp);
        raw.begin();
        raw.send(&connect[..at]);
        raw.reset();
    }
}

fn a_byte_at_a_time(target: &mut Target) {
    let mut raw = Raw::connect(target.tcp);
    let mut start = request(FunctionId::SERVICE_START, vec![Value::text("WDT=400")]);
    for serial in 1..20 {
        start.serial = serial;
        for byte in start.to_wire(false) {
            raw.send(&[byte]);
        }
        let reply = raw.reply();
        assert_eq!((reply.serial, reply.code), (serial, 0));
    }
}

fn many_requests_in_one_piece(target: &mut Target) {
    let mut raw = Raw::connect(target.tcp);
    let mut start = request(FunctionId::SERVICE_START, vec![Value::text("")]);
    let mut all = Vec::new();
    for serial in 1..=1000 {
        start.serial = serial;
        all.extend(start.to_wire(false));
    }
    raw.send(&all);
    for serial in 1..=1000 {
        let reply = raw.reply();
        assert_eq!((reply.serial, reply.code), (serial, 0));
    }
}

/// A stream loses no request, so the same serial is another call.
fn a_repeated_serial_runs_again(target: &mut Target) {
    let mut raw = Raw::connect(target.tcp);
    let args = vec![Value::I4(raw.begin()), Value::text("I1"), Value::text("")];
    let open = request(FunctionId::CONTROLLER_GET_VARIABLE, args);
    let handles = [(); 3].map(|()| raw.call(&open).args[0].clone());
    assert!(handles[0] != handles[1] && handles[1] != handles[2], "{handles:?}");
}

/// A client that sends requests without a pause, into an enlarged buffer, does not delay the others.
fn endless_requests_do_not_starve_others(target: &mut Target) {
    let mut raw = Raw::connect(target.tcp);
    let controller = raw.begin();
    let large = vec![Value::I4(controller), Value::text("sleep"), Value::Array(17, vec![Value::Ui1(0); 2 << 20])];
    assert_eq!(raw.call(&request(FunctionId::CONTROLLER_EXECUTE, large)).code, 0);
    let requests = bytes(FunctionId::SERVICE_START, vec![]).repeat(50_000);
    let mut writer = raw.stream().try_clone().unwrap();
    let asking = std::thread::spawn(move || writer.write_all(&requests));
    let reading = std::thread::spawn(move || (0..50_000).map(|_| raw.reply()).filter(|reply| reply.code == 0).count());
    let mut turns = 0;
    while !reading.is_finished() {
        target.serves_others();
        turns += 1;
    }
    asking.join().unwrap().unwrap();
    assert_eq!(reading.join().unwrap(), 50_000);
    assert!(turns > 1, "others had their turn while it asked");
}

/// Requests that are cut so that one is always unfinished are not slow: each arrives in time.
fn pieces_that_never_end_with_a_request(target: &mut Target) {
    let mut raw = Raw::connect(target.tcp);
    raw.begin();
    let start = bytes(FunctionId::SERVICE_START, vec![Value::text("")]);
    raw.send(&start[..7]);
    let until = std::time::Instant::now() + limits().receive * 3 / 2;
    while std::time::Instant::now() < until {
        raw.send(&start[7..]);
        raw.send(&start[..7]);
        assert_eq!(raw.reply().code, 0);
        std::thread::sleep(Duration::from_millis(20));
    }
}

/// A client whose request exceeds the memory gets an error and continues; small requests are always served.
fn large_requests_of_many_at_the_same_time(target: &mut Target) {
    // a busy machine may need longer for all requests than the server waits for the rest of one
    let in_time = (0..5).any(|_| {
        let begun = Instant::now();
        let all_answered = large_requests(target);
        assert!(all_answered || begun.elapsed() >= limits().receive, "a request in time has no reply");
        all_answered
    });
    assert!(in_time, "12 requests of 8 MiB take longer than {:?}, five times in a row", limits().receive);
}

/// Sends 12 requests of 8 MiB, the last byte of each after all others; returns whether the server answered all of them.
fn large_requests(target: &mut Target) -> bool {
    let large = bytes(FunctionId::SERVICE_START, vec![Value::Bstr(vec![0x30a2; 4 << 20])]);
    let (end, large) = large.split_last().unwrap();
    let before = target.process().memory();
    let mut all: Vec<Raw> = (0..12).map(|_| Raw::connect(target.tcp)).collect();
    for raw in &mut all {
        raw.send(large);
    }
    target.serves_others();
    if let (Some(before), Some(after)) = (before, target.process().memory()) {
        let most = before.now + limits().memory as u64 + (4 << 20);
        assert!(after.now < most, "12 requests of 8 MiB: {before:?}, then {after:?}");
    }
    let mut taken = 0;
    for raw in &mut all {
        raw.send(&[*end]);
        let Some(reply) = raw.next_reply() else { return false };
        let code = HResult(reply.code);
        // there is no such option
        assert!([HResult::E_INVALIDARG, HResult::E_PACKETSIZEOVER].contains(&code), "{code}");
        taken += usize::from(code == HResult::E_INVALIDARG);
        raw.send(&request(FunctionId::SERVICE_START, vec![]).to_wire(false));
        let Some(next) = raw.next_reply() else { return false };
        assert_eq!(next.code, 0);
    }
    assert!((1..=limits().memory / (8 << 20)).contains(&taken), "{taken} found memory");
    true
}

fn a_peer_that_never_reads(target: &mut Target) {
    let mut raw = Raw::connect(target.tcp);
    raw.begin();
    raw.stream().set_write_timeout(Some(Duration::from_millis(500))).unwrap();
    let requests = bytes(FunctionId::SERVICE_START, vec![]).repeat(1000);
    // until neither side's buffers take any more
    while raw.stream().write_all(&requests).is_ok() {}
    target.serves_others();
    // when its time to accept a reply is over it is disconnected, although it still does not read
    target.has_released_all();
}

fn a_peer_that_asks_for_much_and_never_reads(target: &mut Target) {
    let mut raw = Raw::connect(target.tcp);
    let controller = raw.begin();
    raw.stream().set_write_timeout(Some(Duration::from_millis(500))).unwrap();
    let much = Value::Array(17, vec![Value::Ui1(7); 1 << 20]);
    let echo = bytes(FunctionId::CONTROLLER_EXECUTE, vec![Value::I4(controller), Value::text("echo"), much]);
    while raw.stream().write_all(&echo).is_ok() {}
    target.serves_others();
    target.has_released_all();
}

fn silent_connections_cost_no_processor_time(target: &mut Target) {
    let all: Vec<Raw> = many(target)
        .into_iter()
        .map(|mut raw| {
            raw.begin();
            raw
        })
        .collect();
    sleeps(target);
    drop(all);
}

/// Above the limit the first request is answered with E_MAX_CONNECT; connected clients keep their slots.
fn connections_to_the_limit_and_past_it(target: &mut Target) {
    target.has_released_all();
    // one slot is the bystander's, and one is left for new clients
    let mut inside: Vec<Raw> = (0..limits().connections_per_address - 2).map(|_| Raw::connect(target.tcp)).collect();
    for raw in &mut inside {
        raw.begin();
    }
    target.serves_others();
    let mut last = last_place(target);
    for _ in 0..10 {
        let mut outside = Raw::connect(target.tcp);
        let reply = outside.call(&request(FunctionId::SERVICE_START, vec![]));
        assert_eq!(reply.code, HResult::E_MAX_CONNECT.0);
        assert_eq!(outside.rest(), [0_u8; 0]);
    }
    // a flood of silent connections takes no slot either
    let flood: Vec<Raw> = (0..200).map(|_| Raw::connect(target.tcp)).collect();
    for raw in inside.iter_mut().chain([&mut last]) {
        assert_eq!(raw.call(&request(FunctionId::SERVICE_START, vec![])).code, 0);
    }
    drop((flood, last));
    drop(inside);
}

/// Connects, retrying while a client that has just disconnected still occupies the slot.
fn last_place(target: &Target) -> Raw {
    loop {
        let mut raw = Raw::connect(target.tcp);
        let code = raw.call(&request(FunctionId::SERVICE_START, vec![])).code;
        if code == 0 {
            return raw;
        }
        assert_eq!(code, HResult::E_MAX_CONNECT.0);
    }
}

fn connections_that_come_and_go(target: &mut Target) {
    for round in 0..500 {
        let mut raw = Raw::connect(target.tcp);
        match round % 4 {
            0 => {}
            1 => raw.send(&[1]),
            2 => assert!(raw.begin() > 0),
            _ => raw.reset(),
        }
    }
}
