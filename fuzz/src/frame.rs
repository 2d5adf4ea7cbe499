//! Fuzzes the frame decoder against the oracle.

use bcap_core::bcap::{Decoder, Progress};
use bcap_core::limits::{Limits, Strictness};
use bcap_testkit::frame::{TestFrame, bitwise_crc, field};
use bcap_testkit::oracle::{Oracle, Verdict};

use crate::input::BOTH;

/// Decodes bytes as the start of a stream and as a datagram, and compares with the oracle.
///
/// The first byte holds options: CRC, small limits, and a fixed header, so that the decoder reaches the body.
///
/// # Panics
///
/// When an assertion about the core fails.
pub fn frame(data: &[u8]) {
    let Some((options, rest)) = data.split_first() else { return };
    let (crc, small, mend) = (options & 1 != 0, options & 2 != 0, options & 4 != 0);
    let limits = if small { Limits { frame: 64, arguments: 2, depth: 1 } } else { Limits::STREAM };
    let mut bytes = rest.to_vec();
    if mend {
        fix_frame(&mut bytes, crc);
    }
    let [strict, lenient] = BOTH.map(|strictness| check(Decoder { limits, strictness, crc }, &bytes));
    if matches!(strict, Verdict::Frame(..)) {
        assert_eq!(strict, lenient, "a strictly valid frame decodes leniently to the same");
    }
    let decoder = Decoder { limits, strictness: Strictness::Strict, crc };
    let drop = decoder.resync(&bytes);
    assert!(drop <= bytes.len() && (drop > 0 || bytes.is_empty()));
    assert!(decoder.frame_length(&bytes[drop..]).is_ok(), "resynchronisation stops where a frame may begin");
    assert!(
        (1..drop).all(|at| decoder.frame_length(&bytes[at..]).is_err()),
        "resynchronisation skips no possible frame"
    );
}

/// Writes a valid header, CRC and end into bytes that are long enough.
pub(crate) fn fix_frame(bytes: &mut [u8], crc: bool) {
    let length = bytes.len();
    if length < if crc { 18 } else { 16 } {
        return;
    }
    bytes[0] = 1;
    bytes[field::LENGTH].copy_from_slice(&(length as u32).to_le_bytes());
    // few arguments, so that the decoder reaches them
    let count = bytes[field::COUNT.start] & 7;
    bytes[field::COUNT].copy_from_slice(&[count, 0]);
    if crc {
        let sum = bitwise_crc(&bytes[1..length - 3]);
        bytes[length - 3..length - 1].copy_from_slice(&sum.to_le_bytes());
    }
    bytes[length - 1] = 4;
}

/// Decodes a frame with the core and with the oracle; returns their verdict.
///
/// # Panics
///
/// When they differ, or an error is outside the bytes.
pub fn judge_frame(decoder: Decoder, bytes: &[u8]) -> Verdict {
    let Decoder { limits, strictness, crc } = decoder;
    let ours = match decoder.decode(bytes) {
        Ok(Progress::Complete(frame, used)) => Verdict::Frame(TestFrame::read(&frame), used),
        Ok(Progress::NeedMore(more)) => {
            assert!(more > bytes.len());
            Verdict::Incomplete
        }
        Err(error) => {
            assert!(error.offset <= bytes.len(), "{error:?} in {} bytes", bytes.len());
            Verdict::Refused
        }
    };
    assert_eq!(ours, Oracle { limits, strictness, crc }.decode(bytes), "{strictness:?} {bytes:02x?}");
    ours
}

/// Checks the views of a frame too, and the same bytes as a datagram.
fn check(decoder: Decoder, bytes: &[u8]) -> Verdict {
    let ours = judge_frame(decoder, bytes);
    match decoder.decode(bytes) {
        Ok(Progress::Complete(frame, _)) => {
            let read = TestFrame::read(&frame);
            assert_eq!(frame.args.len(), read.args.len());
            for (index, value) in frame.args.iter().enumerate() {
                assert_eq!(frame.args.get(index), Some(value));
            }
            assert_eq!(frame.args.get(read.args.len()), None);
            assert!(!format!("{frame:?}").is_empty());
        }
        Ok(Progress::NeedMore(_)) => {}
        Err(error) => assert!(!error.to_string().is_empty() && error.hresult().is_err()),
    }
    let datagram = decoder.decode_datagram(bytes).map(|frame| TestFrame::read(&frame));
    let whole = match ours {
        Verdict::Frame(ref frame, used) if used == bytes.len() || decoder.strictness == Strictness::Lenient => {
            Some(frame)
        }
        _ => None,
    };
    assert_eq!(datagram.as_ref().ok(), whole);
    ours
}
