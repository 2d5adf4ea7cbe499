//! Attacks on blocking and tokio clients over TCP by broken, slow, silent or lying servers: every call ends with a specific
//! error, and the client still reads a valid reply after the invalid ones.

use std::time::Duration;

use bcap_core::bcap::call::{self, ReplyError};
use bcap_core::bcap::client::{ClientError, Timeout};
use bcap_core::error::DecodeErrorKind;
use bcap_core::hresult::HResult;
use bcap_core::io::CallError;
use bcap_core::variant::VarType;
use bcap_std::{ConnectError, Options, asynch, blocking};
use bcap_testkit::frame::field;
use bcap_testkit::value::Value;
use bcap_tests::tools;

use crate::Case;
use crate::script::{Connection, Outcome, RIGHT, Script, brief, calls, right, runtime, serve, serve_bytes};
use crate::target::{Target, long_timeouts};
use crate::wire::{UNKNOWN_TYPES, argument, broken_values, frame, nested, reply_frame, value};

pub(crate) const CASES: &[Case] = crate::cases! {
    clients:
        a_server_that_accepts_and_does_not_answer
        a_server_that_closes_at_once
        a_server_that_resets
        one_byte_then_silence_from_the_server
        a_reply_cut_at_every_byte
        a_reply_that_stops_at_every_byte
        a_reply_at_a_byte_a_time
        a_keep_alive_and_a_reply_in_pieces
        endless_keep_alives
        keep_alives_and_then_silence
        endless_replies_with_wrong_serials
        a_late_reply_does_not_end_the_next_call
        foreign_replies_leave_no_value_behind
        replies_with_broken_values
        replies_with_unknown_types
        replies_nested_without_end
        replies_with_an_invalid_length
        replies_with_a_large_string
        a_reply_that_is_too_large
        replies_with_two_values_or_another
        handles_of_an_invalid_type
        every_code_of_failure_and_success
        a_server_that_floods
        a_server_that_never_reads
        a_port_without_a_listener
        names_that_do_not_resolve
        more_files_than_a_bitmap_holds
        many_clients_that_connect_at_once
};

const SILENCE: Outcome = Outcome::Client(ClientError::Timeout(Timeout::Attempt));
const FLOODED: Outcome = Outcome::Client(ClientError::Flooded);

/// The serial of a client's first call.
const FIRST: u16 = 1;

fn malformed(outcome: &Outcome) -> Option<DecodeErrorKind> {
    match outcome {
        Outcome::Client(ClientError::Malformed(error)) => Some(error.kind),
        _ => None,
    }
}

/// Asserts how the calls to a server with a script end.
fn ends(options: &Options, expected: &[Outcome], script: Script) {
    assert_eq!(calls(options, expected.len(), || serve(script)), expected);
}

fn a_server_that_accepts_and_does_not_answer(_: &mut Target) {
    ends(&brief(), &[SILENCE, SILENCE], Connection::hold);
}

fn a_server_that_closes_at_once(_: &mut Target) {
    ends(&long_timeouts(), &[Outcome::Disconnected], |connection| {
        connection.request();
    });
}

fn a_server_that_resets(_: &mut Target) {
    ends(&long_timeouts(), &[Outcome::Io], |connection| {
        connection.request();
        connection.reset();
    });
}

fn one_byte_then_silence_from_the_server(_: &mut Target) {
    ends(&brief(), &[SILENCE], |connection| {
        connection.request();
        connection.send(&[1]);
        connection.hold();
    });
    // and without any request
    ends(&brief(), &[SILENCE, SILENCE], |connection| {
        connection.send(&[1, 0x1e, 0, 0]);
        connection.hold();
    });
}

fn a_reply_cut_at_every_byte(_: &mut Target) {
    for at in 0..right(FIRST).len() {
        let server = || {
            serve(move |connection| {
                connection.request();
                connection.send(&right(FIRST)[..at]);
            })
        };
        assert_eq!(calls(&long_timeouts(), 1, server), [Outcome::Disconnected], "{at}");
    }
}

/// The late rest of the reply is dropped as stale, and the next call gets its own reply.
fn a_reply_that_stops_at_every_byte(_: &mut Target) {
    for at in [1, 4, 5, 14, 15, 29] {
        let server = || {
            serve(move |connection| {
                connection.request();
                connection.send(&right(FIRST)[..at]);
                let second = connection.request();
                connection.send(&right(FIRST)[at..]);
                connection.send(&right(second));
                connection.hold();
            })
        };
        let mut options = brief();
        options.tcp.timing.attempt_timeout = Duration::from_secs(1);
        assert_eq!(calls(&options, 2, server), [SILENCE, RIGHT], "{at}");
    }
}

fn a_reply_at_a_byte_a_time(_: &mut Target) {
    ends(&long_timeouts(), &[RIGHT, RIGHT, RIGHT], |connection| {
        for _ in 0..3 {
            let serial = connection.request();
            for byte in right(serial) {
                connection.send(&[byte]);
            }
        }
        connection.hold();
    });
}

/// The client finds a reply after keep-alives wherever the bytes are split.
fn a_keep_alive_and_a_reply_in_pieces(_: &mut Target) {
    let both = [reply_frame(FIRST, HResult::S_EXECUTING, vec![]), right(FIRST)].concat();
    for at in 0..both.len() {
        let both = both.clone();
        let server = || {
            let both = both.clone();
            serve(move |connection| {
                connection.request();
                connection.send(&both[..at]);
                connection.send(&both[at..]);
                connection.hold();
            })
        };
        assert_eq!(calls(&long_timeouts(), 1, server), [RIGHT], "{at}");
    }
}

fn endless_keep_alives(_: &mut Target) {
    let mut options = brief();
    options.tcp.timing.attempt_timeout = Duration::from_secs(20);
    ends(&options, &[Outcome::Client(ClientError::Timeout(Timeout::KeepAlive))], |connection| {
        let serial = connection.request();
        while connection.send(&reply_frame(serial, HResult::S_EXECUTING, vec![])) {
            std::thread::sleep(Duration::from_millis(10));
        }
    });
    // the deadline of the whole call holds as well
    options.tcp.timing.keep_alive = Duration::from_secs(30);
    options.tcp.timing.deadline = Duration::from_millis(500);
    ends(&options, &[Outcome::Client(ClientError::Timeout(Timeout::Deadline))], |connection| {
        let serial = connection.request();
        while connection.send(&reply_frame(serial, HResult::S_EXECUTING, vec![])) {
            std::thread::sleep(Duration::from_millis(10));
        }
    });
    // a flood ends the session immediately
    options.tcp.timing.deadline = Duration::from_secs(20);
    ends(&options, &[FLOODED, Outcome::Client(ClientError::Closed)], |connection| {
        let serial = connection.request();
        while connection.send(&reply_frame(serial, HResult::S_EXECUTING, vec![])) {}
    });
}

fn keep_alives_and_then_silence(_: &mut Target) {
    ends(&brief(), &[SILENCE], |connection| {
        let serial = connection.request();
        for _ in 0..3 {
            connection.send(&reply_frame(serial, HResult::S_EXECUTING, vec![]));
        }
        connection.hold();
    });
}

fn endless_replies_with_wrong_serials(_: &mut Target) {
    ends(&long_timeouts(), &[FLOODED, Outcome::Client(ClientError::Closed)], |connection| {
        let serial = connection.request();
        let mut wrong = serial;
        loop {
            wrong = wrong.wrapping_add(1);
            if wrong != serial && !connection.send(&right(wrong)) {
                break;
            }
        }
    });
    // keep-alives of other calls prolong nothing
    ends(&brief(), &[SILENCE], |connection| {
        let serial = connection.request();
        while connection.send(&reply_frame(serial + 1, HResult::S_EXECUTING, vec![])) {
            std::thread::sleep(Duration::from_millis(10));
        }
    });
}

fn a_late_reply_does_not_end_the_next_call(_: &mut Target) {
    let mut options = brief();
    options.tcp.timing.attempt_timeout = Duration::from_secs(2);
    ends(&options, &[SILENCE, RIGHT], |connection| {
        let first = connection.request();
        let second = connection.request();
        connection.send(&reply_frame(first, HResult::S_OK, vec![Value::text("the first one's")]));
        connection.send(&right(second));
        connection.hold();
    });
}

fn foreign_replies_leave_no_value_behind(_: &mut Target) {
    ends(&long_timeouts(), &[RIGHT, Outcome::Refused(HResult::E_FAIL)], |connection| {
        let first = connection.request();
        for foreign in 2..200 {
            connection.send(&reply_frame(first + foreign, HResult::S_OK, vec![Value::text(&"x".repeat(1000))]));
        }
        connection.send(&right(first));
        let second = connection.request();
        connection.send(&reply_frame(second + 1, HResult::S_OK, vec![Value::text("x")]));
        connection.send(&reply_frame(second, HResult::E_FAIL, vec![]));
        connection.hold();
    });
}

fn replies_with_broken_values(_: &mut Target) {
    for (name, value) in broken_values() {
        let bytes = frame(FIRST, 0, 1, &argument(&value));
        let outcomes = calls(&long_timeouts(), 2, || serve_bytes(bytes.clone()));
        assert!(malformed(&outcomes[0]).is_some(), "{name}: {outcomes:?}");
        // what such a server says next is not read
        assert_eq!(outcomes[1], Outcome::Client(ClientError::Closed), "{name}");
    }
    let fewer = frame(FIRST, 0, 9, &argument(&Value::I4(1).to_wire()));
    let outcomes = calls(&long_timeouts(), 1, || serve_bytes(fewer.clone()));
    assert!(malformed(&outcomes[0]).is_some(), "nine values of which one is there: {outcomes:?}");
}

fn replies_with_unknown_types(_: &mut Target) {
    for vartype in UNKNOWN_TYPES {
        let bytes = frame(FIRST, 0, 1, &argument(&value(*vartype, 1, &[0; 4])));
        let outcomes = calls(&long_timeouts(), 1, || serve_bytes(bytes.clone()));
        assert_eq!(malformed(&outcomes[0]), Some(DecodeErrorKind::UnknownType(*vartype)));
    }
}

fn replies_nested_without_end(_: &mut Target) {
    for levels in [9, 17, 1000, 100_000] {
        let bytes = frame(FIRST, 0, 1, &argument(&nested(levels)));
        let outcomes = calls(&long_timeouts(), 1, || serve_bytes(bytes.clone()));
        assert_eq!(malformed(&outcomes[0]), Some(DecodeErrorKind::TooDeep(8)), "{levels}");
    }
}

fn replies_with_an_invalid_length(_: &mut Target) {
    for length in [0, 3, 15, (16 << 20) + 1, 0x7fff_ffff, 0x8000_0000, 0xffff_ffff_u32] {
        let mut bytes = right(FIRST);
        bytes[field::LENGTH].copy_from_slice(&length.to_le_bytes());
        let outcomes = calls(&long_timeouts(), 1, || serve_bytes(bytes.clone()));
        let expected = match length {
            0..16 => DecodeErrorKind::FrameTooShort(length),
            _ => DecodeErrorKind::FrameTooLong { length, limit: 16 << 20 },
        };
        assert_eq!(malformed(&outcomes[0]), Some(expected));
    }
    for (at, wrong) in [(0, 0), (0, 2), (1, 29), (29, 5)] {
        let mut bytes = right(FIRST);
        bytes[at] = wrong;
        let outcomes = calls(&long_timeouts(), 1, || serve_bytes(bytes.clone()));
        assert!(malformed(&outcomes[0]).is_some(), "byte {at}: {outcomes:?}");
    }
    // for a length within the limit the client waits as long as for any reply, not longer
    let mut bytes = right(FIRST);
    bytes[field::LENGTH].copy_from_slice(&(16_u32 << 20).to_le_bytes());
    assert_eq!(calls(&brief(), 1, || serve_bytes(bytes.clone())), [SILENCE]);
}

fn replies_with_a_large_string(_: &mut Target) {
    for length in [16_383, 16_384, 70_000] {
        let text = Value::Bstr(vec![0x3042; length]);
        let bytes = reply_frame(FIRST, HResult::S_OK, vec![text.clone()]);
        assert!(calls(&long_timeouts(), 1, || serve_bytes(bytes.clone())) == [Outcome::Value(text)]);
    }
}

/// A client may have a smaller buffer; it skips a reply that does not fit, and reads the next reply.
fn a_reply_that_is_too_large(_: &mut Target) {
    use bcap_core::bcap::Client;
    use bcap_core::io::blocking::Connection;

    let address = serve(|connection| {
        let first = connection.request();
        connection.send(&reply_frame(first, HResult::S_OK, vec![Value::Bstr(vec![65; 100_000])]));
        let second = connection.request();
        connection.send(&right(second));
        connection.hold();
    });
    let stream = std::net::TcpStream::connect(address).unwrap();
    let client = Client::new(long_timeouts().tcp, [0; 512], [0; 512]);
    let mut client = Connection::new(blocking::TcpTransport::new(stream), client);
    let first = client.call(call::variable_get_value(crate::script::VARIABLE)).unwrap_err();
    assert!(matches!(first, CallError::Client(ClientError::ReplyTooLarge { length: 200_030 })), "{first}");
    assert_eq!(Outcome::from(client.call(call::variable_get_value(crate::script::VARIABLE))), RIGHT);
}

fn replies_with_two_values_or_another(_: &mut Target) {
    // the first of two is the value; peers differ in how many they send
    let two = reply_frame(FIRST, HResult::S_OK, vec![Value::I4(42), Value::text("x")]);
    assert_eq!(calls(&long_timeouts(), 1, || serve_bytes(two.clone())), [RIGHT]);
    // a reply without a value is equivalent to EMPTY where any value is permitted
    let none = reply_frame(FIRST, HResult::S_OK, vec![]);
    assert_eq!(calls(&long_timeouts(), 1, || serve_bytes(none.clone())), [Outcome::Value(Value::Empty)]);
}

/// A handle of an invalid type is an error, and does not leave an earlier handle in its place.
fn handles_of_an_invalid_type(_: &mut Target) {
    let wrong = [Value::text("7"), Value::R8(0), Value::Empty, Value::Array(3, vec![Value::I4(7)])];
    for wrong in wrong {
        let found = VarType(wrong.vartype());
        let address = serve_bytes(reply_frame(FIRST, HResult::S_OK, vec![wrong]));
        let mut client = blocking::connect_tcp(address, &long_timeouts()).unwrap();
        let error = client.call(call::controller_connect("", "", "", "")).unwrap_err();
        let CallError::Client(ClientError::Reply(ReplyError { found: Some(it), .. })) = error else {
            panic!("{error}")
        };
        assert_eq!(it, found);
    }
    let mut client =
        blocking::connect_tcp(serve_bytes(reply_frame(FIRST, HResult::S_OK, vec![])), &long_timeouts()).unwrap();
    let error = client.call(call::controller_connect("", "", "", "")).unwrap_err();
    assert!(matches!(error, CallError::Client(ClientError::Reply(ReplyError { found: None, .. }))), "{error}");
    // unsigned is as good
    let address = serve_bytes(reply_frame(FIRST, HResult::S_OK, vec![Value::Ui4(7)]));
    let mut client = blocking::connect_tcp(address, &long_timeouts()).unwrap();
    assert_eq!(client.call(call::controller_connect("", "", "", "")).unwrap().0, 7);
}

fn every_code_of_failure_and_success(_: &mut Target) {
    for code in [0x8000_0000, 0x8001_0001, 0x8320_1483, 0xffff_ffff_u32] {
        let code = HResult::from_u32(code);
        let bytes = reply_frame(FIRST, code, vec![Value::I4(42)]);
        assert_eq!(calls(&long_timeouts(), 1, || serve_bytes(bytes.clone())), [Outcome::Refused(code)]);
    }
    for code in [0, 1, 0x0f20_0501, 0x7fff_ffff_u32] {
        let bytes = reply_frame(FIRST, HResult::from_u32(code), vec![Value::I4(42)]);
        assert_eq!(calls(&long_timeouts(), 1, || serve_bytes(bytes.clone())), [RIGHT]);
    }
}

fn a_server_that_floods(_: &mut Target) {
    for garbage in [&[0; 4096][..], &[1; 4096], &[0xff; 4096]] {
        let garbage = garbage.to_vec();
        let server = || {
            let garbage = garbage.clone();
            serve(move |connection| while connection.send(&garbage) {})
        };
        let outcomes = calls(&long_timeouts(), 1, server);
        assert!(malformed(&outcomes[0]).is_some(), "{outcomes:?}");
    }
}

/// A request that the server never reads ends at its timeout.
fn a_server_that_never_reads(_: &mut Target) {
    let much = vec![7_u8; 12 << 20];
    let address = serve(|connection| {
        std::thread::sleep(Duration::from_secs(1));
        connection.hold();
    });
    let mut client = blocking::connect_tcp(address, &brief()).unwrap();
    let error = client.call(call::variable_put_value(crate::script::VARIABLE, &much[..])).unwrap_err();
    assert!(matches!(error, CallError::Client(ClientError::Timeout(Timeout::Attempt))), "{error}");
    let address = serve(|connection| {
        std::thread::sleep(Duration::from_secs(1));
        connection.hold();
    });
    let error = runtime().block_on(async {
        let mut client = asynch::connect_tcp(address, &brief()).await.unwrap();
        client.call(call::variable_put_value(crate::script::VARIABLE, &much[..])).await.unwrap_err()
    });
    assert!(matches!(error, CallError::Client(ClientError::Timeout(Timeout::Attempt))), "{error}");
}

/// Connecting reports that there is no listener; the first call would be too late.
fn a_port_without_a_listener(_: &mut Target) {
    let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap();
    drop(listener);
    let refused = |error: &ConnectError| {
        matches!(error, ConnectError::Connect { address: at, source }
        if *at == address && source.kind() == std::io::ErrorKind::ConnectionRefused)
    };
    let error = blocking::connect_tcp(address, &long_timeouts()).unwrap_err();
    assert!(refused(&error), "{error:?}");
    let error = runtime().block_on(asynch::connect_tcp(address, &long_timeouts())).unwrap_err();
    assert!(refused(&error), "{error:?}");
    let error = blocking::connect_rac(address, &long_timeouts()).unwrap_err();
    assert!(refused(&error), "{error:?}");
}

fn names_that_do_not_resolve(_: &mut Target) {
    // none of them reaches a name server: an invalid name is not resolved
    for name in ["no such name:5007", "..:5007", "-:5007", "[::1:5007", "127.0.0.1:65536", "127.0.0.1", ""] {
        let is_unresolved = |error: ConnectError| matches!(error, ConnectError::Resolve { .. });
        assert!(is_unresolved(blocking::connect_tcp(name, &long_timeouts()).unwrap_err()), "{name:?}");
        assert!(is_unresolved(blocking::connect_udp(name, &long_timeouts()).unwrap_err()), "{name:?}");
        assert!(is_unresolved(blocking::connect_rac(name, &long_timeouts()).unwrap_err()), "{name:?}");
        runtime().block_on(async {
            assert!(is_unresolved(asynch::connect_tcp(name, &long_timeouts()).await.unwrap_err()), "{name:?}");
            assert!(is_unresolved(asynch::connect_udp(name, &long_timeouts()).await.unwrap_err()), "{name:?}");
        });
    }
}

/// Sockets whose numbers exceed the limit of `select` work like others.
fn more_files_than_a_bitmap_holds(target: &mut Target) {
    let mut files = Vec::new();
    while files.len() < 1100 {
        match std::fs::File::open("/dev/null") {
            Ok(file) => files.push(file),
            Err(error) => return tools::missing(&format!("this process may not have 1100 files open: {error}")),
        }
    }
    target.serves_others();
    drop(files);
}

fn many_clients_that_connect_at_once(target: &mut Target) {
    let address = target.tcp;
    let clients: Vec<_> = (0..32)
        .map(|_| {
            std::thread::spawn(move || {
                let mut client = blocking::connect_tcp(address, &long_timeouts()).unwrap();
                client.call(call::service_start("")).unwrap();
                let controller = client.call(call::controller_connect("", "", "", "")).unwrap();
                client.call(call::controller_disconnect(controller)).unwrap();
                client.call(call::service_stop()).unwrap();
            })
        })
        .collect();
    for client in clients {
        client.join().unwrap();
    }
}
