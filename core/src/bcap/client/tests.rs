extern crate std;

use std::vec::Vec;

use super::*;
use crate::bcap::call::{self, VariableHandle};
use crate::bcap::{Decoder, FunctionId};
use crate::error::DecodeErrorKind;
use crate::variant::{Encode, Variant};

type Small = Client<[u8; 512]>;

fn at(millis: u64) -> Instant {
    Instant::from_millis(millis)
}

fn get() -> impl Call {
    call::variable_get_value(VariableHandle(3))
}

fn reply(serial: u16, code: HResult, value: Option<&dyn Encode>, crc: bool) -> Vec<u8> {
    let mut buffer = [0; 4096];
    let mut frame = FrameWriter::new(&mut buffer).unwrap().with_crc(crc);
    if let Some(value) = value {
        frame.argument(value).unwrap();
    }
    frame.finish(serial, 0, code.0).unwrap().to_vec()
}

fn ok(serial: u16, value: i32) -> Vec<u8> {
    reply(serial, HResult::S_OK, Some(&value), false)
}

/// Sends everything, and returns the frames as (serial, reserved).
fn sent<B: Storage>(client: &mut Client<B>) -> (u16, u16) {
    let decoder = client.link().decoder();
    let bytes = client.transmit().to_vec();
    client.transmitted(bytes.len());
    let frame = decoder.decode_datagram(&bytes).unwrap();
    assert_eq!(frame.function(), FunctionId::VARIABLE_GET_VALUE);
    (frame.serial, frame.reserved)
}

/// Delivers bytes in pieces that fit the buffer, and returns the events.
fn deliver<T: Storage, R: Storage>(client: &mut Client<T, R>, mut bytes: &[u8], now: Instant) -> Vec<Event> {
    let mut events = Vec::new();
    while !bytes.is_empty() {
        let free = client.receive_buffer();
        let count = free.len().min(bytes.len());
        assert!(count > 0, "no room");
        free[..count].copy_from_slice(&bytes[..count]);
        client.received(count);
        bytes = &bytes[count..];
        events.extend(core::iter::from_fn(|| client.poll_event(now)));
    }
    events
}

fn replied(value: i32, client: &Small) -> bool {
    client.reply().and_then(|f| f.value()) == Some(Variant::I4(value))
}

#[test]
fn calls_go_out_with_serials_from_one_and_wrap_past_zero() {
    let mut client = Small::new(Config::TCP, [0; 512], [0; 512]);
    for n in 1..=65_540_u32 {
        client.start(&get(), client.timing(), at(0)).unwrap();
        let expected = u16::try_from((n - 1) % 65_535 + 1).unwrap();
        assert_eq!(sent(&mut client), (expected, 0));
        assert_eq!(deliver(&mut client, &ok(expected, 7), at(0)), [Event::Replied(HResult::S_OK)]);
    }
    assert!(replied(7, &client));
}

#[test]
fn a_reply_in_any_pieces_is_one_reply() {
    let bytes = ok(1, 42);
    for cut in 1..bytes.len() {
        let mut client = Small::new(Config::TCP, [0; 512], [0; 512]);
        client.start(&get(), client.timing(), at(0)).unwrap();
        sent(&mut client);
        assert_eq!(deliver(&mut client, &bytes[..cut], at(0)), []);
        assert_eq!(deliver(&mut client, &bytes[cut..], at(0)), [Event::Replied(HResult::S_OK)]);
        assert!(replied(42, &client));
    }
}

#[test]
fn a_late_reply_is_stale_and_never_the_answer() {
    let mut client = Small::new(Config::TCP, [0; 512], [0; 512]);
    client.start(&get(), client.timing(), at(0)).unwrap();
    assert_eq!(sent(&mut client), (1, 0));
    assert_eq!(client.poll_timeout(), Some(at(3000)));
    assert_eq!(client.handle_timeout(at(2999)), None);
    assert_eq!(client.handle_timeout(at(3000)), Some(Event::Failed(ClientError::Timeout(Timeout::Attempt))));
    client.start(&get(), client.timing(), at(4000)).unwrap();
    assert_eq!(sent(&mut client), (2, 0));
    let both = [ok(1, 1), ok(2, 2)].concat();
    assert_eq!(deliver(&mut client, &both, at(4000)), [Event::Stale { serial: 1 }, Event::Replied(HResult::S_OK)]);
    assert!(replied(2, &client));
    assert_eq!(deliver(&mut client, &ok(2, 3), at(4000)), [Event::Stale { serial: 2 }]);
}

#[test]
fn a_serial_with_an_outstanding_reply_is_skipped() {
    let mut client = Small::new(Config::TCP, [0; 512], [0; 512]);
    client.start(&get(), client.timing(), at(0)).unwrap();
    sent(&mut client);
    client.abandon();
    client.state.next_serial = 65_535;
    client.start(&get(), client.timing(), at(0)).unwrap();
    assert_eq!(sent(&mut client).0, 65_535);
    let _ = deliver(&mut client, &ok(65_535, 1), at(0));
    client.start(&get(), client.timing(), at(0)).unwrap();
    assert_eq!(sent(&mut client).0, 2, "the reply to 1 may still arrive");
    assert_eq!(deliver(&mut client, &ok(1, 1), at(0)), [Event::Stale { serial: 1 }]);
    let _ = deliver(&mut client, &ok(2, 1), at(0));
    client.state.next_serial = 1;
    client.start(&get(), client.timing(), at(0)).unwrap();
    assert_eq!(sent(&mut client).0, 1, "its reply has arrived");
}

#[test]
fn udp_retransmits_with_the_marker_and_accepts_a_reply_to_any_attempt() {
    let mut client =
        Small::new(Config { timing: Timing { attempts: 3, ..Timing::UDP }, ..Config::UDP }, [0; 512], [0; 512]);
    client.start(&get(), client.timing(), at(0)).unwrap();
    assert_eq!(sent(&mut client), (1, 1));
    assert_eq!(client.handle_timeout(at(500)), Some(Event::Retried { attempt: 2 }));
    assert_eq!(sent(&mut client), (2, 1));
    assert_eq!(client.handle_timeout(at(1000)), Some(Event::Retried { attempt: 3 }));
    assert_eq!(sent(&mut client), (3, 1));
    assert_eq!(deliver(&mut client, &ok(2, 5), at(1001)), [Event::Replied(HResult::S_OK)]);
    client.start(&get(), client.timing(), at(1002)).unwrap();
    assert_eq!(sent(&mut client), (4, 4));
    assert_eq!(deliver(&mut client, &ok(3, 5), at(1003)), [Event::Stale { serial: 3 }]);
    assert_eq!(client.handle_timeout(at(1502)), Some(Event::Retried { attempt: 2 }));
    assert_eq!(client.handle_timeout(at(2002)), Some(Event::Retried { attempt: 3 }));
    assert_eq!(client.handle_timeout(at(2502)), Some(Event::Failed(ClientError::Timeout(Timeout::Attempt))));
    assert_eq!(client.poll_timeout(), None);
}

#[test]
fn stray_datagrams_cost_no_attempt() {
    let mut client = Small::new(Config::UDP, [0; 512], [0; 512]);
    client.start(&get(), client.timing(), at(0)).unwrap();
    sent(&mut client);
    for garbage in [&b"\x01"[..], b"hello", &ok(1, 1)[..20], &[&ok(1, 1)[..], b"x"].concat()] {
        let events = deliver(&mut client, garbage, at(1));
        assert!(matches!(events[..], [Event::Malformed(_)]), "{events:?}");
    }
    assert_eq!(deliver(&mut client, &ok(9, 1), at(1)), [Event::Stale { serial: 9 }]);
    assert_eq!(client.poll_timeout(), Some(at(500)));
    assert_eq!(deliver(&mut client, &ok(1, 1), at(2)), [Event::Replied(HResult::S_OK)]);
}

#[test]
fn executing_restarts_the_attempt_but_not_the_deadline() {
    let timing = Timing { deadline: Duration::from_secs(5), keep_alive: Duration::from_secs(60), ..Timing::TCP };
    let config = Config { timing, ..Config::TCP };
    let mut client = Small::new(config, [0; 512], [0; 512]);
    client.start(&get(), client.timing(), at(0)).unwrap();
    sent(&mut client);
    let executing = reply(1, HResult::S_EXECUTING, None, false);
    assert_eq!(deliver(&mut client, &executing, at(2000)), [Event::Executing]);
    assert_eq!(client.handle_timeout(at(3000)), None);
    assert_eq!(deliver(&mut client, &executing, at(4000)), [Event::Executing]);
    assert_eq!(client.poll_timeout(), Some(at(5000)));
    assert_eq!(client.handle_timeout(at(5000)), Some(Event::Failed(ClientError::Timeout(Timeout::Deadline))));
}

#[test]
fn a_server_cannot_keep_a_call_alive_forever() {
    let config = Config { timing: Timing { keep_alive: Duration::from_secs(4), ..Timing::TCP }, ..Config::TCP };
    let mut client = Small::new(config, [0; 512], [0; 512]);
    client.start(&get(), client.timing(), at(0)).unwrap();
    sent(&mut client);
    let executing = reply(1, HResult::S_EXECUTING, None, false);
    for second in 1..5 {
        assert_eq!(deliver(&mut client, &executing, at(second * 1000)), [Event::Executing]);
        assert_eq!(client.handle_timeout(at(second * 1000)), None);
    }
    assert_eq!(client.handle_timeout(at(5000)), Some(Event::Failed(ClientError::Timeout(Timeout::KeepAlive))));
}

#[test]
fn a_call_can_be_abandoned_at_any_byte_of_its_request() {
    for cut in 0..=30 {
        let mut client = Small::new(Config::TCP, [0; 512], [0; 512]);
        client.start(&get(), client.timing(), at(0)).unwrap();
        let request = client.transmit().to_vec();
        let mut wire = request[..cut].to_vec();
        client.transmitted(cut);
        client.abandon();
        if 0 < cut && cut < request.len() {
            assert_eq!(client.start(&get(), client.timing(), at(1)), Err(ClientError::Busy));
        }
        wire.extend(client.transmit());
        client.transmitted(client.transmit().len());
        client.start(&get(), client.timing(), at(1)).unwrap();
        wire.extend(client.transmit());
        // the peer has received complete frames only
        let mut rest = &wire[..];
        let mut serials = Vec::new();
        while !rest.is_empty() {
            let crate::bcap::Progress::Complete(frame, used) = Decoder::TCP.decode(rest).unwrap() else { panic!() };
            serials.push(frame.serial);
            rest = &rest[used..];
        }
        assert_eq!(serials, if cut == 0 { std::vec![2] } else { std::vec![1, 2] }, "cut at {cut}");
        client.transmitted(30);
        let replies: Vec<u8> = serials.iter().flat_map(|s| ok(*s, i32::from(*s))).collect();
        assert_eq!(deliver(&mut client, &replies, at(2)).last(), Some(&Event::Replied(HResult::S_OK)));
        assert!(replied(2, &client));
    }
}

#[test]
fn a_reply_larger_than_the_buffer_fails_its_call_and_the_stream_continues() {
    let mut client = Small::new(Config::TCP, [0; 512], [0; 512]);
    client.start(&get(), client.timing(), at(0)).unwrap();
    sent(&mut client);
    let huge = reply(1, HResult::S_OK, Some(&[0_u8; 2000]), false);
    let length = u32::try_from(huge.len()).unwrap();
    let failed = Event::Failed(ClientError::ReplyTooLarge { length });
    for chunk in [1, 5, 100, 512] {
        let mut events = Vec::new();
        for part in huge.chunks(chunk) {
            events.extend(deliver(&mut client, part, at(0)));
        }
        assert_eq!(events, [failed]);
        client.start(&get(), client.timing(), at(0)).unwrap();
        let (serial, _) = sent(&mut client);
        assert_eq!(deliver(&mut client, &ok(serial, 5), at(0)), [Event::Replied(HResult::S_OK)]);
        client.state.next_serial = 1;
        client.start(&get(), client.timing(), at(0)).unwrap();
        sent(&mut client);
    }
}

#[cfg(feature = "alloc")]
#[test]
fn growing_memory_holds_large_calls_and_replies() {
    let mut client = Client::new(Config::TCP, Vec::new(), std::vec![0; 16]);
    let big = std::vec![1.5_f64; 1000];
    client.start(&call::variable_put_value(VariableHandle(1), &big[..]), client.timing(), at(0)).unwrap();
    assert_eq!(client.transmit().len(), 16 + 14 + 10 + 8000);
    client.transmitted(usize::MAX);
    let bytes = reply(1, HResult::S_OK, Some(&[7_u8; 3000]), false);
    assert_eq!(deliver(&mut client, &bytes, at(0)), [Event::Replied(HResult::S_OK)]);
    let items = client.value::<call::Any>().unwrap().as_array().unwrap();
    assert_eq!(items.len(), 3000);
}

#[test]
fn a_call_above_the_limit_of_the_link_is_refused_before_anything_is_sent() {
    let mut client = Client::new(Config::UDP, [0; 1024], [0; 512]);
    let put = |n: usize| call::variable_put_value(VariableHandle(1), &*std::vec![0_u8; n].leak());
    assert_eq!(client.start(&put(449), client.timing(), at(0)), Err(ClientError::TooLarge { limit: 488 }));
    assert!(client.transmit().is_empty());
    client.start(&put(448), client.timing(), at(0)).unwrap();
    assert_eq!(client.transmit().len(), 488);
}

#[test]
fn invalid_bytes_on_a_stream_close_the_session() {
    let mut client = Small::new(Config::TCP, [0; 512], [0; 512]);
    client.start(&get(), client.timing(), at(0)).unwrap();
    sent(&mut client);
    let events = deliver(&mut client, b"HTTP/1.1 200 OK", at(0));
    let [Event::Failed(ClientError::Malformed(error))] = events[..] else { panic!("{events:?}") };
    assert_eq!((error.kind, error.offset), (DecodeErrorKind::Soh(b'H'), 0));
    assert!(client.is_closed());
    assert_eq!(client.start(&get(), client.timing(), at(0)), Err(ClientError::Closed));
    client.reset();
    client.start(&get(), client.timing(), at(0)).unwrap();
    assert_eq!(sent(&mut client), (2, 0));
}

#[test]
fn a_serial_line_skips_noise_between_frames() {
    let mut client = Small::new(Config::SERIAL, [0; 512], [0; 512]);
    client.start(&get(), client.timing(), at(0)).unwrap();
    assert_eq!(sent(&mut client), (1, 1));
    let good = reply(1, HResult::S_OK, Some(&9_i32), true);
    let mut garbled = good.clone();
    garbled[20] ^= 0x10;
    let noise = [b"\x00\xff\x01\x02".as_slice(), &garbled, &good].concat();
    let events = deliver(&mut client, &noise, at(1));
    assert!(events.iter().any(|e| matches!(e, Event::Malformed(m) if matches!(m.kind, DecodeErrorKind::Crc { .. }))));
    assert_eq!(events.last(), Some(&Event::Replied(HResult::S_OK)));
    assert!(replied(9, &client));
}

#[test]
fn a_partial_frame_on_a_silent_serial_line_is_dropped_at_the_next_attempt() {
    let mut client = Small::new(Config::SERIAL, [0; 512], [0; 512]);
    client.start(&get(), client.timing(), at(0)).unwrap();
    sent(&mut client);
    let good = reply(1, HResult::S_OK, Some(&9_i32), true);
    assert_eq!(deliver(&mut client, &good[..10], at(1)), []);
    assert_eq!(client.handle_timeout(at(500)), Some(Event::Retried { attempt: 2 }));
    assert_eq!(sent(&mut client), (2, 1));
    assert_eq!(deliver(&mut client, &good, at(501)), [Event::Replied(HResult::S_OK)]);
}

/// The forged early reply of a server that predicts the next serial.
fn forged(serial: u16) -> Vec<u8> {
    ok(serial, 666)
}

#[test]
fn a_reply_that_arrived_before_its_request_was_sent_is_stale() {
    for config in [Config::TCP, Config::UDP] {
        let mut client = Small::new(config, [0; 512], [0; 512]);
        client.start(&get(), client.timing(), at(0)).unwrap();
        // the call is started, and no byte of it is sent
        assert_eq!(deliver(&mut client, &forged(1), at(0)), [Event::Stale { serial: 1 }]);
        let executing = reply(1, HResult::S_EXECUTING, None, false);
        assert_eq!(deliver(&mut client, &executing, at(0)), [Event::Stale { serial: 1 }]);
        sent(&mut client);
        assert_eq!(deliver(&mut client, &ok(1, 7), at(0)), [Event::Replied(HResult::S_OK)]);
        assert!(replied(7, &client));
    }
}

#[test]
fn a_reply_received_together_with_the_previous_one_is_stale() {
    let mut client = Small::new(Config::TCP, [0; 512], [0; 512]);
    for serial in (1..40).step_by(2) {
        client.start(&get(), client.timing(), at(0)).unwrap();
        sent(&mut client);
        let both = [ok(serial, 1), forged(serial + 1)].concat();
        client.receive_buffer()[..both.len()].copy_from_slice(&both);
        client.received(both.len());
        assert_eq!(client.poll_event(at(0)), Some(Event::Replied(HResult::S_OK)));
        // a loop stops reading at its reply
        client.start(&get(), client.timing(), at(0)).unwrap();
        sent(&mut client);
        assert_eq!(client.poll_event(at(0)), Some(Event::Stale { serial: serial + 1 }));
        assert_eq!(deliver(&mut client, &ok(serial + 1, 2), at(0)), [Event::Replied(HResult::S_OK)]);
        assert!(replied(2, &client));
    }
}

#[test]
fn a_reply_that_began_to_arrive_before_its_request_was_sent_is_stale() {
    for cut in 1..30 {
        let mut client = Small::new(Config::TCP, [0; 512], [0; 512]);
        assert_eq!(deliver(&mut client, &forged(1)[..cut], at(0)), []);
        client.start(&get(), client.timing(), at(0)).unwrap();
        sent(&mut client);
        assert_eq!(deliver(&mut client, &forged(1)[cut..], at(0)), [Event::Stale { serial: 1 }], "cut at {cut}");
        assert_eq!(deliver(&mut client, &ok(1, 7), at(0)), [Event::Replied(HResult::S_OK)]);
        assert!(replied(7, &client));
    }
}

#[test]
fn a_large_reply_that_began_to_arrive_before_its_request_was_sent_fails_no_call() {
    let mut client = Small::new(Config::TCP, [0; 512], [0; 512]);
    let huge = reply(1, HResult::S_OK, Some(&[0_u8; 2000]), false);
    assert_eq!(deliver(&mut client, &huge[..100], at(0)), []);
    client.start(&get(), client.timing(), at(0)).unwrap();
    sent(&mut client);
    assert_eq!(deliver(&mut client, &huge[100..], at(0)), [Event::Stale { serial: 1 }]);
    assert_eq!(deliver(&mut client, &ok(1, 7), at(0)), [Event::Replied(HResult::S_OK)]);
}

#[test]
fn a_partly_sent_request_accepts_an_error_but_no_success() {
    for sent in 1..30 {
        let mut client = Small::new(Config::TCP, [0; 512], [0; 512]);
        client.start(&get(), client.timing(), at(0)).unwrap();
        client.transmitted(sent);
        assert_eq!(deliver(&mut client, &forged(1), at(0)), [Event::Stale { serial: 1 }], "{sent}");
        let refused = reply(1, HResult::E_PACKETSIZEOVER, None, false);
        assert_eq!(deliver(&mut client, &refused, at(0)), [Event::Replied(HResult::E_PACKETSIZEOVER)]);
    }
}

#[test]
fn a_reply_to_an_unsent_attempt_is_stale() {
    let mut client = Small::new(Config::UDP, [0; 512], [0; 512]);
    client.start(&get(), client.timing(), at(0)).unwrap();
    assert_eq!(sent(&mut client), (1, 1));
    assert_eq!(client.handle_timeout(at(500)), Some(Event::Retried { attempt: 2 }));
    assert_eq!(deliver(&mut client, &forged(2), at(500)), [Event::Stale { serial: 2 }]);
    // the first attempt was sent, so a reply to it counts
    assert_eq!(deliver(&mut client, &ok(1, 7), at(500)), [Event::Replied(HResult::S_OK)]);
    assert!(replied(7, &client));
}

#[test]
fn a_flood_of_keep_alives_ends_the_session() {
    for config in [Config::TCP, Config::UDP] {
        let mut client = Small::new(config, [0; 512], [0; 512]);
        client.start(&get(), client.timing(), at(0)).unwrap();
        sent(&mut client);
        let executing = reply(1, HResult::S_EXECUTING, None, false);
        for _ in 0..256 {
            assert_eq!(deliver(&mut client, &executing, at(0)), [Event::Executing]);
        }
        assert_eq!(deliver(&mut client, &executing, at(19)), [Event::Failed(ClientError::Flooded)]);
        assert!(client.is_closed() && !client.is_busy());
        assert_eq!(deliver(&mut client, &ok(1, 7), at(20)), []);
        client.reset();
        client.start(&get(), client.timing(), at(20)).unwrap();
        assert_eq!(sent(&mut client).0, 2);
        assert_eq!(deliver(&mut client, &ok(2, 7), at(20)), [Event::Replied(HResult::S_OK)]);
    }
}

#[test]
fn keep_alives_at_the_minimum_interval_do_not_end_the_session() {
    let mut client = Small::new(Config::TCP, [0; 512], [0; 512]);
    let timing = Timing { keep_alive: Duration::MAX, deadline: Duration::MAX, ..Timing::TCP };
    client.start(&get(), timing, at(0)).unwrap();
    sent(&mut client);
    let executing = reply(1, HResult::S_EXECUTING, None, false);
    let mut now = 0;
    for round in 0..5000 {
        now += 80;
        assert_eq!(deliver(&mut client, &executing, at(now)), [Event::Executing]);
        if round % 1000 == 0 {
            // a stalled network: the frames of 10 s arrive at once
            now += 10_000;
            for _ in 0..125 {
                assert_eq!(deliver(&mut client, &executing, at(now)), [Event::Executing]);
            }
        }
    }
}

#[test]
fn a_flood_of_stale_replies_ends_a_stream_but_not_a_datagram_session() {
    let mut client = Small::new(Config::TCP, [0; 512], [0; 512]);
    for _ in 0..256 {
        assert_eq!(deliver(&mut client, &ok(9, 1), at(0)), [Event::Stale { serial: 9 }]);
    }
    assert_eq!(deliver(&mut client, &ok(9, 1), at(0)), [Event::Failed(ClientError::Flooded)]);
    let mut client = Small::new(Config::UDP, [0; 512], [0; 512]);
    for _ in 0..1000 {
        assert_eq!(deliver(&mut client, &ok(9, 1), at(0)), [Event::Stale { serial: 9 }]);
    }
    client.start(&get(), client.timing(), at(0)).unwrap();
    sent(&mut client);
    assert_eq!(deliver(&mut client, &ok(1, 7), at(0)), [Event::Replied(HResult::S_OK)]);
}

#[test]
fn the_first_serial_can_be_chosen_and_is_never_zero() {
    for (chosen, used) in [(0, 1), (1, 1), (40_000, 40_000), (65_535, 65_535)] {
        let mut client = Small::new(Config::UDP, [0; 512], [0; 512]);
        client.set_next_serial(chosen);
        client.start(&get(), client.timing(), at(0)).unwrap();
        assert_eq!(sent(&mut client), (used, used));
    }
}

#[test]
fn a_slow_serial_line_delivers_a_long_reply() {
    // a reply of 500 bytes at 9600 baud, eleven bits a character, one byte at a time
    let character = Duration::from_micros(11_000_000 / 9600);
    for (config, silence, cut) in
        [(Config::SERIAL, 100, None), (Config::serial(9600), 62, None), (Config::serial(9600), 62, Some(300))]
    {
        let mut now = Instant::ZERO;
        let mut client = Client::new(config, [0; 512], [0; 512]);
        client.start(&call::variable_get_value(VariableHandle(1)), client.timing(), now).unwrap();
        client.transmitted(usize::MAX);
        let mut attempts = 1;
        let mut replied = false;
        while !replied {
            let reply = reply(attempts, HResult::S_OK, Some(&[7_u8; 470].as_slice()), true);
            for byte in &reply[..cut.filter(|_| attempts == 1).unwrap_or(reply.len())] {
                now = now + character;
                client.receive_buffer()[0] = *byte;
                client.received(1);
                replied |= matches!(client.poll_event(now), Some(Event::Replied(_)));
                assert_eq!(client.handle_timeout(now), None, "attempt {attempts} at {now:?}");
            }
            if !replied {
                // the rest is lost: the frame ends after the silence, the attempt after its time
                let lost = client.poll_timeout().unwrap();
                assert_eq!(lost, now + Duration::from_millis(silence));
                assert_eq!(client.handle_timeout(lost), None);
                now = client.poll_timeout().unwrap();
                assert_eq!(now, Instant::ZERO + config.timing.attempt_timeout);
                assert_eq!(client.handle_timeout(now), Some(Event::Retried { attempt: 2 }));
                client.transmitted(usize::MAX);
                attempts += 1;
            }
        }
        assert_eq!(attempts, if cut.is_some() { 2 } else { 1 });
    }
    assert_eq!(Config::serial(9600).timing.attempt_timeout.as_millis(), 500 + 1152);
    assert_eq!(Config::serial(0).timing.attempt_timeout, Duration::MAX);
}
