//! Tests a client and a server over links that lose, repeat, reorder, delay, truncate and corrupt: every call ends, a call
//! reported as done was executed exactly once, and no call gets the reply of another.

use bcap_core::endpoint::{Endpoint, Serve};
use std::time::Duration;

use bcap_core::bcap::client::{self, ClientError, Event, Timeout};
use bcap_core::bcap::{FrameWriter, OnMalformed, server};
use bcap_core::hresult::HResult;
use bcap_core::limits::Limits;
use bcap_core::time::Instant;
use bcap_testkit::network::{Faults, Simulation, answer_to};

fn millis(count: u64) -> Duration {
    Duration::from_millis(count)
}

/// The outcomes of many calls.
#[derive(Debug, Default)]
struct Tally {
    done: u32,
    failed: u32,
}

/// Makes calls with tokens from 1, and checks the outcome of each.
fn call_many(simulation: &mut Simulation, calls: i32) -> Tally {
    let mut tally = Tally::default();
    for token in 1..=calls {
        let begun = simulation.now;
        match simulation.token(token) {
            Ok(value) => {
                assert_eq!(value, answer_to(token), "the reply is this call's");
                assert_eq!(simulation.counter.executed.get(&token), Some(&1), "token {token} executed once");
                tally.done += 1;
            }
            Err(ClientError::Timeout(_)) => {
                assert!(simulation.counter.executed.get(&token).is_none_or(|count| *count == 1));
                tally.failed += 1;
            }
            Err(other) => panic!("token {token}: {other}"),
        }
        let timing = simulation.client.timing();
        assert!(simulation.now.saturating_since(begun) <= timing.deadline, "token {token} ends in time");
    }
    simulation.settle(millis(20_000));
    for (token, count) in &simulation.counter.executed {
        assert_eq!(*count, 1, "token {token}, whatever came late");
    }
    tally
}

fn udp(faults: Faults, seed: u64) -> Simulation {
    let mut simulation = Simulation::new(client::Config::UDP, server::Config::UDP, faults, seed);
    simulation.connect();
    simulation
}

#[test]
fn without_faults_every_call_is_done_at_the_first_attempt() {
    let mut simulation = udp(Faults { delay: millis(5), ..Faults::default() }, 1);
    let tally = call_many(&mut simulation, 1000);
    assert_eq!((tally.done, tally.failed), (1000, 0));
    let seen = simulation.seen;
    assert_eq!((seen.retries, seen.stale, seen.malformed), (0, 0, 0));
}

#[test]
fn lost_datagrams_execute_calls_once() {
    for seed in 0..20 {
        let mut simulation = udp(Faults { loss: 300, delay: millis(20), ..Faults::default() }, seed);
        let tally = call_many(&mut simulation, 300);
        // both directions lose datagrams: half of the attempts succeed, so one call of thirty fails in all five
        assert!(tally.done > 250 && simulation.seen.retries > 100, "{tally:?} {:?}", simulation.seen);
    }
}

#[test]
fn duplicated_reordered_and_late_datagrams_execute_calls_once() {
    let mut stale = 0;
    for seed in 100..120 {
        let faults = Faults { loss: 200, repeat: 200, delay: millis(800), ..Faults::default() };
        let mut simulation = udp(faults, seed);
        // a Service_Start that is delayed by two seconds counts as a new client's, so only later frames get that delay
        simulation.settle(millis(2000));
        simulation.faults.straggle = 30;
        let tally = call_many(&mut simulation, 300);
        assert!(tally.done > 200, "{tally:?}");
        stale += simulation.seen.stale;
    }
    assert!(stale > 1000, "late replies came: {stale}");
}

#[test]
fn long_calls_are_kept_alive_on_a_lossy_network() {
    let mut executing = 0;
    for seed in 200..210 {
        let faults = Faults { loss: 150, repeat: 100, delay: millis(50), work: millis(3000), ..Faults::default() };
        let mut simulation = udp(faults, seed);
        let tally = call_many(&mut simulation, 100);
        assert!(tally.done > 80, "{tally:?}");
        executing += simulation.seen.executing;
    }
    assert!(executing > 1000, "{executing} keep-alives for calls of 1.5 s on average, one every 200 ms");
}

#[test]
fn a_dead_network_ends_every_call_at_its_timeouts() {
    let mut simulation = udp(Faults::default(), 3);
    simulation.faults.loss = 1000;
    for token in 1..=10 {
        let begun = simulation.now;
        assert_eq!(simulation.token(token), Err(ClientError::Timeout(Timeout::Attempt)));
        assert_eq!(simulation.now.saturating_since(begun), millis(5 * 500));
    }
    simulation.faults.loss = 0;
    assert_eq!(simulation.token(11), Ok(answer_to(11)));
    assert_eq!(simulation.counter.executed.len(), 1);
}

#[test]
fn serials_wrap_under_way() {
    let mut simulation = udp(Faults { loss: 20, repeat: 20, delay: millis(2), ..Faults::default() }, 4);
    let tally = call_many(&mut simulation, 70_000);
    assert!(tally.done > 69_990, "{tally:?}");
}

#[test]
fn a_lossy_serial_line_executes_calls_once() {
    for seed in 300..310 {
        let timing = client::Timing { deadline: Duration::from_secs(30), ..client::Timing::SERIAL };
        let config = client::Config { timing, ..client::Config::SERIAL };
        // a line loses whole pieces of frames, and one byte in two hundred is wrong
        let faults = Faults { loss: 10, garble: 2, delay: millis(3), ..Faults::default() };
        let mut simulation = Simulation::new(config, server::Config::SERIAL, faults, seed);
        simulation.connect();
        let tally = call_many(&mut simulation, 300);
        assert!(tally.done > 270 && simulation.seen.retries > 5, "{tally:?} {:?}", simulation.seen);
    }
}

#[test]
fn a_stream_in_any_pieces_carries_every_call() {
    for seed in 400..420 {
        let faults = Faults { delay: millis(30), work: millis(400), ..Faults::default() };
        let mut simulation = Simulation::new(client::Config::TCP, server::Config::TCP, faults, seed);
        simulation.connect();
        let tally = call_many(&mut simulation, 200);
        assert_eq!((tally.done, tally.failed), (200, 0));
        assert_eq!((simulation.seen.stale, simulation.seen.retries, simulation.seen.malformed), (0, 0, 0));
    }
}

#[test]
fn a_call_on_a_stream_can_be_cancelled_at_every_byte_of_request_and_reply() {
    // lengths of the frames of the simulated call and its reply
    let (request, reply) = (68, 30);
    for sent in 0..=request {
        for received in if sent == request { 0..=reply } else { 0..=0 } {
            let mut s = Simulation::new(client::Config::TCP, server::Config::TCP, Faults::default(), 5);
            s.connect();
            s.begin(1).unwrap();
            assert_eq!(s.client.transmit().len(), request);
            // a part of the request is sent, a part of the reply arrives, and the caller drops the call
            let part = s.client.transmit()[..sent].to_vec();
            s.client.transmitted(sent);
            s.session.receive_buffer()[..sent].copy_from_slice(&part);
            s.session.received(sent);
            while s.session.run(&mut s.counter, bcap_core::handler::PeerId(1), s.now).is_some() {}
            assert_eq!(s.session.transmit().len(), if sent == request { reply } else { 0 });
            let part = s.session.transmit()[..received].to_vec();
            s.session.transmitted(received);
            s.client.receive_buffer()[..received].copy_from_slice(&part);
            s.client.received(received);
            let replied = s.client.poll_event(s.now) == Some(Event::Replied(HResult::S_OK));
            assert_eq!(replied, received == reply);
            s.client.abandon();
            // the rest of a begun request must go out before another can begin
            while s.begin(2) == Err(ClientError::Busy) {
                let rest = s.client.transmit().to_vec();
                assert_eq!(rest.len(), request - sent);
                s.session.receive_buffer()[..rest.len()].copy_from_slice(&rest);
                s.session.received(rest.len());
                s.client.transmitted(rest.len());
            }
            assert_eq!(s.finish(), Ok(HResult::S_OK), "sent {sent}, received {received}");
            assert_eq!(s.client.value::<bcap_core::bcap::call::Int>(), Ok(answer_to(2)));
            assert_eq!(s.counter.executed.get(&1).copied(), (sent > 0).then_some(1), "sent {sent}");
            assert_eq!(s.counter.executed.get(&2), Some(&1));
            assert_eq!(s.seen.stale, u32::from(sent > 0 && !replied), "sent {sent}, received {received}");
            s.session.close(&mut s.counter, bcap_core::handler::PeerId(1), s.now);
            assert!(s.counter.open.is_empty(), "{:?}", s.counter.open);
        }
    }
}

/// Creates a frame that a server might send.
fn reply(serial: u16, code: HResult, value: Option<i32>) -> Vec<u8> {
    let mut buffer = [0; 64];
    let mut writer = FrameWriter::new(&mut buffer).unwrap();
    if let Some(value) = value {
        writer.argument(&value).unwrap();
    }
    writer.finish(serial, 0, code.0).unwrap().to_vec()
}

/// Gives the client bytes; returns its results.
fn give(simulation: &mut Simulation, bytes: &[u8]) -> Vec<Event> {
    let now = simulation.now;
    simulation.client.receive_buffer()[..bytes.len()].copy_from_slice(bytes);
    simulation.client.received(bytes.len());
    std::iter::from_fn(|| simulation.client.poll_event(now)).collect()
}

#[test]
fn no_reply_with_a_wrong_serial_ends_or_prolongs_a_call() {
    for config in [client::Config::TCP, client::Config::UDP] {
        let mut s = Simulation::new(config, server::Config::TCP, Faults::default(), 6);
        for token in 1..50_u16 {
            // on a stream, too many of these in a short time end the session
            s.now = s.now + millis(500);
            s.begin(i32::from(token)).unwrap();
            let deadline = s.client.poll_timeout();
            let length = s.client.transmit().len();
            s.client.transmitted(length);
            s.now = s.now + millis(10);
            for wrong in [0, token.wrapping_sub(1), token + 1, token + 256, token.swap_bytes(), u16::MAX] {
                if wrong == token {
                    continue;
                }
                assert_eq!(give(&mut s, &reply(wrong, HResult::S_OK, Some(-1))), [Event::Stale { serial: wrong }]);
                assert_eq!(give(&mut s, &reply(wrong, HResult::S_EXECUTING, None)), [Event::Stale { serial: wrong }]);
            }
            assert_eq!(s.client.poll_timeout(), deadline, "strangers win no time");
            assert_eq!(give(&mut s, &reply(token, HResult::S_EXECUTING, None)), [Event::Executing]);
            assert!(s.client.poll_timeout() > deadline);
            let value = i32::from(token);
            assert_eq!(give(&mut s, &reply(token, HResult::S_OK, Some(value))), [Event::Replied(HResult::S_OK)]);
            assert_eq!(s.client.value::<bcap_core::bcap::call::Int>(), Ok(value));
        }
    }
}

#[test]
fn endless_keep_alives_end_a_call() {
    let timing = client::Timing { keep_alive: Duration::from_secs(60), ..client::Timing::TCP };
    let config = client::Config { timing, ..client::Config::TCP };
    let mut s = Simulation::new(config, server::Config::TCP, Faults::default(), 7);
    s.begin(1).unwrap();
    let length = s.client.transmit().len();
    s.client.transmitted(length);
    let mut keep_alives = 0;
    let end = loop {
        s.now = s.now + millis(400);
        if let Some(event) = s.client.handle_timeout(s.now) {
            break event;
        }
        assert_eq!(give(&mut s, &reply(1, HResult::S_EXECUTING, None)), [Event::Executing]);
        keep_alives += 1;
    };
    assert_eq!(end, Event::Failed(ClientError::Timeout(Timeout::KeepAlive)));
    // the budget runs from the first keep-alive, at 400 ms
    assert_eq!((keep_alives, s.now), (150, Instant::from_millis(1 + 60_400)));
}

#[test]
fn a_stream_with_noise_resynchronises_if_configured() {
    // noise can look like the length of a long frame, so the bound equals the longest expected frame
    let limits = Limits { frame: 1024, ..Limits::STREAM };
    let config = client::Config { on_malformed: OnMalformed::Resync, limits, ..client::Config::TCP };
    let mut s = Simulation::new(config, server::Config::TCP, Faults::default(), 8);
    s.begin(1).unwrap();
    let length = s.client.transmit().len();
    s.client.transmitted(length);
    let noisy = [&b"\x02noise\x01\x00"[..], &reply(1, HResult::S_OK, Some(9))].concat();
    let events = give(&mut s, &noisy);
    assert_eq!(events.last(), Some(&Event::Replied(HResult::S_OK)), "{events:?}");
    // and where it is not, the session ends and says why
    let mut s = Simulation::new(client::Config::TCP, server::Config::TCP, Faults::default(), 8);
    s.begin(1).unwrap();
    assert!(matches!(give(&mut s, &noisy)[..], [Event::Failed(ClientError::Malformed(_))]));
    assert!(s.client.is_closed());
    s.client.abandon();
    assert_eq!(s.begin(2), Err(ClientError::Closed));
}
