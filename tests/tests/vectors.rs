//! The 108 frames of the two specifications: both ways, cut, truncated, damaged, and delivered in pieces.

use bcap_core::bcap::{Decoder, FrameWriter, Progress};
use bcap_core::error::DecodeErrorKind;
use bcap_core::limits::Strictness;
use bcap_testkit::frame::TestFrame;
use bcap_testkit::oracle::Verdict;
use bcap_testkit::vectors::{FrameVector, frames};

fn whole(decoder: Decoder, bytes: &[u8]) -> TestFrame {
    match decoder.decode(bytes) {
        Ok(Progress::Complete(frame, used)) if used == bytes.len() => TestFrame::read(&frame),
        other => panic!("{other:?}"),
    }
}

/// Encodes a frame from native values, with the core.
fn encode(frame: &TestFrame, crc: bool) -> Vec<u8> {
    let mut buffer = [0xa5; 1024];
    let mut writer = FrameWriter::new(&mut buffer).unwrap().with_crc(crc);
    for arg in &frame.args {
        writer.argument(arg).unwrap();
    }
    writer.finish(frame.serial, frame.reserved, frame.code).unwrap().to_vec()
}

#[test]
fn every_frame_decodes_to_what_the_specification_says_and_encodes_back() {
    let vectors = frames();
    assert_eq!(vectors.len(), 108);
    for FrameVector { name, bytes, serial, reserved, code, count, args } in vectors {
        let frame = whole(Decoder::TCP, &bytes);
        assert_eq!((frame.serial, frame.reserved, frame.code), (serial, reserved, code), "{name}");
        assert_eq!(frame.args.len(), count, "{name}");
        if let Some(args) = args {
            assert_eq!(frame.args, args, "{name}");
        }
        assert_eq!(encode(&frame, false), bytes, "{name}, from native values");
        assert_eq!(frame.to_wire(false), bytes, "{name}, by the tests' own encoder");
        assert_eq!(whole(Decoder::TCP.strictness(Strictness::Lenient), &bytes), frame, "{name}, lenient");
    }
}

#[test]
fn views_encode_back_to_the_same_bytes() {
    for vector in frames() {
        let frame = Decoder::UDP.decode_datagram(&vector.bytes).unwrap();
        let mut buffer = [0xa5; 1024];
        let mut writer = FrameWriter::new(&mut buffer).unwrap();
        frame.args.iter().for_each(|value| writer.argument(&value).unwrap());
        let bytes = writer.finish(frame.serial, frame.reserved, frame.code).unwrap();
        assert_eq!(bytes, vector.bytes, "{}", vector.name);
    }
}

#[test]
fn every_frame_goes_over_a_serial_line() {
    for vector in frames() {
        let frame = whole(Decoder::TCP, &vector.bytes);
        let wire = encode(&frame, true);
        assert_eq!(wire, frame.to_wire(true), "{}", vector.name);
        assert_eq!(whole(Decoder::SERIAL, &wire), frame, "{}", vector.name);
        // each single bit matters: CRC-16 finds them all
        for at in 5..wire.len() - 1 {
            for bit in 0..8 {
                let mut damaged = wire.clone();
                damaged[at] ^= 1 << bit;
                let kind = Decoder::SERIAL.decode(&damaged).unwrap_err().kind;
                assert!(matches!(kind, DecodeErrorKind::Crc { .. }), "{} byte {at}: {kind:?}", vector.name);
            }
        }
    }
}

#[test]
fn a_cut_frame_is_incomplete_and_says_what_it_needs() {
    for FrameVector { name, bytes, .. } in frames() {
        for cut in 0..bytes.len() {
            // before the length field is whole, only the least frame is known
            let needed = if cut < 5 { 16 } else { bytes.len() };
            assert_eq!(Decoder::TCP.decode(&bytes[..cut]), Ok(Progress::NeedMore(needed)), "{name} cut at {cut}");
        }
    }
}

#[test]
fn a_truncated_or_padded_datagram_is_refused() {
    for FrameVector { name, bytes, .. } in frames() {
        for cut in 0..bytes.len() {
            let error = Decoder::UDP.decode_datagram(&bytes[..cut]).unwrap_err();
            let needed = if cut < 5 { 16 } else { bytes.len() as u32 };
            assert_eq!(error.kind, DecodeErrorKind::Incomplete { needed }, "{name} truncated at {cut}");
            assert_eq!(error.offset, cut, "{name}");
        }
        let padded = [&bytes[..], &[0, 0]].concat();
        let error = Decoder::UDP.decode_datagram(&padded).unwrap_err();
        assert_eq!((error.kind, error.offset), (DecodeErrorKind::Unused(2), bytes.len()), "{name}");
        let lenient = Decoder::UDP.strictness(Strictness::Lenient);
        assert_eq!(TestFrame::read(&lenient.decode_datagram(&padded).unwrap()), whole(Decoder::UDP, &bytes), "{name}");
    }
}

/// Sets each byte of every frame to each other value, and compares the core with the oracle.
fn flip_all(strictness: Strictness) {
    let decoder = Decoder::UDP.strictness(strictness);
    let (mut accepted, mut refused) = (0, 0);
    for FrameVector { mut bytes, .. } in frames() {
        for at in 0..bytes.len() {
            let right = bytes[at];
            for wrong in (0..=255).filter(|wrong| *wrong != right) {
                bytes[at] = wrong;
                match bcap_fuzz::judge_frame(decoder, &bytes) {
                    Verdict::Frame(..) => accepted += 1,
                    Verdict::Refused => refused += 1,
                    Verdict::Incomplete => {}
                }
            }
            bytes[at] = right;
        }
    }
    // serials, codes and data take any value; lengths, types and counts do not
    assert!(accepted > 100_000 && refused > 100_000, "{accepted} accepted, {refused} refused");
}

#[test]
fn every_flipped_byte_is_taken_as_the_oracle_takes_it() {
    flip_all(Strictness::Strict);
}

#[test]
fn every_flipped_byte_is_forgiven_as_the_oracle_forgives_it() {
    flip_all(Strictness::Lenient);
}

#[test]
fn a_stream_in_pieces_gives_all_frames_in_order() {
    let vectors = frames();
    let stream: Vec<u8> = vectors.iter().flat_map(|vector| vector.bytes.clone()).collect();
    for size in (1..150).chain([500, 1000, stream.len()]) {
        let mut expected = vectors.iter();
        let mut buffer: Vec<u8> = Vec::new();
        for piece in stream.chunks(size) {
            buffer.extend(piece);
            while let Progress::Complete(frame, used) = Decoder::TCP.decode(&buffer).unwrap() {
                let vector = expected.next().expect("no more frames than there are");
                assert_eq!(TestFrame::read(&frame).to_wire(false), vector.bytes, "{} in {size}s", vector.name);
                buffer.drain(..used);
            }
        }
        assert!(buffer.is_empty() && expected.next().is_none(), "pieces of {size}");
    }
}

#[test]
fn a_stream_resynchronises_after_garbage() {
    // with the bound of a stream, 16 MiB, garbage may be accepted as a long frame; a line's bound leaves little room for that
    let decoder = Decoder { crc: false, ..Decoder::SERIAL };
    let vectors = frames();
    // 0x01 begins frames, so garbage with it is the difficult case: the claimed lengths must be refused
    let garbage: [&[u8]; 4] =
        [b"\x01\x01\x01\x01\x01", b"GET:RC8:10:I:\r", b"\x01\x0f\0\0\0", b"\xff\x01\xff\xff\xff\xff"];
    for (index, vector) in vectors.iter().enumerate() {
        let mut stream = [garbage[index % garbage.len()], &vector.bytes].concat();
        let mut dropped = 0;
        let frame = loop {
            match decoder.decode(&stream) {
                Ok(Progress::Complete(frame, _)) => break TestFrame::read(&frame),
                Ok(Progress::NeedMore(more)) => panic!("{}: waits for {more} bytes", vector.name),
                Err(_) => {
                    let drop = decoder.resync(&stream);
                    assert!(drop > 0);
                    dropped += drop;
                    stream.drain(..drop);
                }
            }
        };
        assert_eq!(frame.to_wire(false), vector.bytes, "{}", vector.name);
        assert_eq!(dropped, garbage[index % garbage.len()].len(), "{}", vector.name);
    }
}
