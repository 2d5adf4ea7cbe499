//! Fuzzes the splitting of a stream into chunks, for a client and for a server's session.

use arbitrary::{Arbitrary, Unstructured};
use bcap_core::bcap::client::{self, Client};
use bcap_core::bcap::server::{self, Handler, Request, Session};
use bcap_core::bcap::{Link, OnMalformed};
use bcap_core::endpoint::{Endpoint, Serve, ServerEndpoint};
use bcap_core::handler::{Outcome, PeerId, ReplyValue};
use bcap_core::hresult::HResult;
use bcap_core::limits::{Limits, Strictness};
use bcap_core::storage::Storage;
use bcap_core::time::Instant;
use bcap_testkit::duplex::chunks;
use bcap_testkit::frame::{TestFrame, field};
use bcap_testkit::oracle::{Oracle, Verdict};
use bcap_testkit::value::Value;

/// Bytes of the fixed memory; a longer frame does not fit.
const ROOM: usize = 96;

/// The configuration of a run.
#[derive(Clone, Copy, Debug)]
struct Setup {
    link: Link,
    strictness: Strictness,
    on_malformed: OnMalformed,
    /// Memory that grows, or [`ROOM`] bytes.
    grows: bool,
}

/// A part of a generated stream.
#[derive(Arbitrary, Debug)]
enum Piece {
    Frame {
        serial: u16,
        reserved: u16,
        code: u8,
        args: Vec<Value>,
    },
    /// A complete frame of this many bytes, which may be larger than the memory.
    Long(u8, u16),
    Junk(Vec<u8>),
    Noise(u8),
}

/// Feeds bytes in chunks, and compares with the frames that the oracle finds in the unsplit stream.
///
/// The first byte chooses the link, the strictness, the handling of malformed frames and the memory, and whether the rest
/// is the stream or encodes a generated one. The next four bytes are the sizes of the chunks.
///
/// # Panics
///
/// When an assertion about the core fails.
pub fn stream(data: &[u8]) {
    let Some((&[options, ref sizes @ ..], rest)) = data.split_first_chunk::<5>() else { return };
    let setup = Setup {
        link: [Link::Stream, Link::Stream, Link::Serial, Link::Datagram][usize::from(options & 3)],
        strictness: if options & 4 == 0 { Strictness::Strict } else { Strictness::Lenient },
        on_malformed: if options & 8 == 0 { OnMalformed::Close } else { OnMalformed::Resync },
        grows: options & 16 != 0,
    };
    let bytes = if options & 32 == 0 { rest.to_vec() } else { made_up(rest, setup.link == Link::Serial) };
    let expected = by_oracle(setup, &bytes, sizes);
    let (whole, cut) = if setup.grows {
        let memory = || vec![0; 32];
        (
            [client_log(setup, memory(), &bytes, &[]), server_log(setup, memory(), memory(), &bytes, &[])],
            [client_log(setup, memory(), &bytes, sizes), server_log(setup, memory(), memory(), &bytes, sizes)],
        )
    } else {
        let (tx, rx) = ([0; ROOM], [0; ROOM]);
        (
            [client_log(setup, rx, &bytes, &[]), server_log(setup, tx, rx, &bytes, &[])],
            [client_log(setup, rx, &bytes, sizes), server_log(setup, tx, rx, &bytes, sizes)],
        )
    };
    assert_eq!(cut[0], expected);
    if setup.link != Link::Datagram {
        assert_eq!(whole[0], expected);
        assert_eq!(whole[1], cut[1]);
    }
}

fn made_up(rest: &[u8], crc: bool) -> Vec<u8> {
    let mut u = Unstructured::new(rest);
    let mut bytes = Vec::new();
    while let (true, Ok(piece)) = (!u.is_empty() && bytes.len() < 4096, Piece::arbitrary(&mut u)) {
        match piece {
            Piece::Frame { serial, reserved, code, args } => {
                let args = args.into_iter().take(3).collect();
                bytes.extend(TestFrame { serial, reserved, code: i32::from(code), args }.to_wire(crc));
            }
            Piece::Long(fill, len) => {
                let mut frame = vec![fill; usize::from(len % 600) + 18];
                crate::frame::fix_frame(&mut frame, crc);
                bytes.extend(frame);
            }
            Piece::Junk(junk) => bytes.extend(junk),
            Piece::Noise(byte) => bytes.push(byte),
        }
    }
    bytes
}

/// A result of a client or a server, found or expected.
#[derive(Debug, PartialEq, Eq)]
enum Found {
    /// A frame, or a too large frame, with this serial.
    Serial(u16),
    /// The end of the session.
    Broken,
}

/// Returns the expected results.
fn by_oracle(setup: Setup, bytes: &[u8], sizes: &[u8]) -> Vec<Found> {
    let limits = limits(setup.link);
    let oracle = Oracle { limits, strictness: setup.strictness, crc: setup.link == Link::Serial };
    let room = if setup.grows { usize::MAX } else { ROOM };
    let mut found = Vec::new();
    if setup.link == Link::Datagram {
        let memory = if setup.grows { 32 } else { ROOM };
        for datagram in chunks(bytes, sizes).map(|chunk| &chunk[..chunk.len().min(memory)]) {
            if let Verdict::Frame(frame, used) = oracle.decode(datagram)
                && (used == datagram.len() || setup.strictness == Strictness::Lenient)
            {
                found.push(Found::Serial(frame.serial));
            }
        }
        return found;
    }
    let mut rest = bytes;
    loop {
        let claimed = match *rest {
            [1, a, b, c, d, ..] => u32::from_le_bytes([a, b, c, d]) as usize,
            _ => 0,
        };
        if claimed > room && claimed <= limits.frame as usize {
            if rest.len() < room {
                return found;
            }
            found.push(Found::Serial(field::serial(rest).expect("a header")));
            rest = &rest[claimed.min(rest.len())..];
            continue;
        }
        match oracle.decode(rest) {
            Verdict::Frame(frame, used) => {
                found.push(Found::Serial(frame.serial));
                rest = &rest[used..];
            }
            Verdict::Incomplete => return found,
            Verdict::Refused if setup.on_malformed == OnMalformed::Close => {
                found.push(Found::Broken);
                return found;
            }
            Verdict::Refused => rest = &rest[1..],
        }
    }
}

fn limits(link: Link) -> Limits {
    match link {
        Link::Stream => Limits::STREAM,
        Link::Datagram => Limits::DATAGRAM,
        Link::Serial => Limits::SERIAL,
    }
}

/// Feeds a client without a call in flight, so that every reply is stale.
fn client_log<R: Storage>(setup: Setup, rx: R, bytes: &[u8], sizes: &[u8]) -> Vec<Found> {
    let Setup { link, strictness, on_malformed, .. } = setup;
    let config = client::Config { link, limits: limits(link), strictness, on_malformed, ..client::Config::TCP };
    let mut client = Client::new(config, [0; 64], rx);
    let mut found = Vec::new();
    for mut chunk in chunks(bytes, sizes) {
        while !chunk.is_empty() && !client.is_closed() {
            let room = client.receive_buffer();
            let count = chunk.len().min(room.len());
            assert!(count > 0, "everything was read, but the buffer is full");
            room[..count].copy_from_slice(&chunk[..count]);
            client.received(count);
            // a datagram is truncated to the buffer, as by a socket
            chunk = if link == Link::Datagram { &[] } else { &chunk[count..] };
            while let Some(event) = client.poll_event(Instant::ZERO) {
                match event {
                    client::Event::Stale { serial } => found.push(Found::Serial(serial)),
                    client::Event::Failed(_) => found.push(Found::Broken),
                    client::Event::Malformed(_) => {}
                    other => panic!("no call is in flight: {other:?}"),
                }
            }
        }
    }
    assert!(client.poll_event(Instant::ZERO).is_none());
    found
}

/// A handler that refuses every call except session calls.
struct Quiet;

impl Handler for Quiet {
    fn call(&mut self, _: PeerId, request: &Request<'_>, reply: &mut ReplyValue<'_>, _: Instant) -> Outcome {
        if let Some(value) = request.args.get(1) {
            // sometimes too large for the memory
            let _ = reply.set(&value);
        }
        HResult::S_OK.into()
    }
}

/// Feeds a server and returns its answers.
fn server_log<T: Storage, R: Storage>(setup: Setup, tx: T, rx: R, bytes: &[u8], sizes: &[u8]) -> Vec<Found> {
    let Setup { link, strictness, on_malformed, .. } = setup;
    let config = server::Config { link, limits: limits(link), strictness, on_malformed, ..server::Config::TCP };
    let mut session = Session::<T, R, 4>::new(config, tx, rx);
    let mut answers = Vec::new();
    for mut chunk in chunks(bytes, sizes) {
        while !chunk.is_empty() && !session.is_finished() {
            let room = session.receive_buffer();
            let count = chunk.len().min(room.len());
            assert!(count > 0, "everything was read, but the buffer is full");
            room[..count].copy_from_slice(&chunk[..count]);
            session.received(count);
            chunk = if link == Link::Datagram { &[] } else { &chunk[count..] };
            loop {
                let event = session.run(&mut Quiet, PeerId(1), Instant::ZERO);
                match event {
                    // the answer has the request's serial only if that arrived before the error was detected
                    Some(server::Event::Malformed(_)) => drop(read_answers(session.transmit(), link)),
                    _ => answers.extend(read_answers(session.transmit(), link)),
                }
                session.transmitted(session.transmit().len());
                if event.is_none() {
                    break;
                }
            }
        }
    }
    assert!(!session.is_running());
    answers
}

/// Decodes a server's answers with the oracle.
fn read_answers(answers: &[u8], link: Link) -> Vec<Found> {
    let oracle = Oracle { limits: Limits::STREAM, strictness: Strictness::Strict, crc: link == Link::Serial };
    let mut found = Vec::new();
    let mut rest = answers;
    while !rest.is_empty() {
        let Verdict::Frame(frame, used) = oracle.decode(rest) else {
            panic!("the server sends an invalid frame: {rest:02x?}")
        };
        assert_eq!(frame.reserved, 0);
        found.push(Found::Serial(frame.serial));
        rest = &rest[used..];
    }
    found
}
