//! `bcap decode` and `bcap encode`: convert frames and values between their bytes and JSON.

use std::str;

use bcap_core::bcap::{Decoder, Progress};
use bcap_core::error::DecodeError;
use bcap_core::limits::Strictness;
use bcap_core::variant::Variant;

use crate::args::{Decode, Encode};
use crate::capture;
use crate::dissect::dissect;
use crate::error::Failure;
use crate::error::ItemError;
use crate::frame::{self, Role};
use crate::hex;
use crate::item::{Items, Place};
use crate::json::{self, LIMITS, Part};

/// Runs `bcap decode`.
pub(crate) fn decode(args: &Decode, json: bool) -> Result<(), Failure> {
    let strictness = if args.lenient { Strictness::Lenient } else { Strictness::Strict };
    if let Some(file) = capture::file(&args.hex) {
        if args.form.variant || args.form.com {
            return Err(Failure::Input("--variant and --com do not apply to a capture".into()));
        }
        return capture::decode(file, &args.capture, strictness, json);
    }
    if args.capture.is_used() {
        let options = "--function, --object, --error, --from, --until, --csv and --stats";
        return Err(Failure::Input(format!("{options} need a capture: FILE.pcap, FILE.pcapng or FILE.cap")));
    }
    let decoder = Decoder { limits: LIMITS, strictness, crc: args.form.com };
    Items::from_words(&args.hex).convert(json, |text, place| {
        let bytes = hex::parse(text)?;
        match place {
            _ if args.form.variant => {
                let value = Variant::decode(&bytes, &LIMITS, strictness)?;
                Ok(if json { value_json(value) } else { format!("{value:?}") })
            }
            Place::Line => {
                let frame = decoder.decode_datagram(&bytes)?;
                Ok(if json { frame::to_json(&frame, args.form.role) } else { frame::to_line(&frame, args.form.role) })
            }
            Place::Argument => all_frames(&bytes, decoder, args.form.role, json),
        }
    })
}

/// Decodes a sequence of frames, such as the capture of a stream.
fn all_frames(bytes: &[u8], decoder: Decoder, role: Role, json: bool) -> Result<String, ItemError> {
    let mut frames = Vec::new();
    let mut at = 0;
    while at == 0 || at < bytes.len() {
        let rest = bytes.get(at..).unwrap_or_default();
        let shifted = |error: DecodeError| DecodeError { offset: error.offset + at, ..error };
        let (frame, length) = match decoder.decode(rest).map_err(shifted)? {
            Progress::Complete(frame, length) => (frame, length),
            // its error says how many bytes are missing
            Progress::NeedMore(_) => (decoder.decode_datagram(rest).map_err(shifted)?, rest.len()),
        };
        frames.push(match (json, decoder.strictness) {
            (true, _) => frame::to_json(&frame, role),
            (false, Strictness::Strict) => dissect(rest.get(..length).unwrap_or(rest), &frame, role, decoder.crc),
            // lenient decoding accepts wrong lengths, so bytes cannot be assigned to fields
            (false, Strictness::Lenient) => frame::to_line(&frame, role),
        });
        at += length;
    }
    Ok(frames.join(if json || decoder.strictness == Strictness::Lenient { "\n" } else { "\n\n" }))
}

/// Runs `bcap encode`.
pub(crate) fn encode(args: &Encode) -> Result<(), Failure> {
    Items::from_words(&args.line).convert(false, |text, _| {
        let text =
            str::from_utf8(text).map_err(|error| ItemError::new("the text is not UTF-8", error.valid_up_to()))?;
        let bytes = if args.form.variant {
            json::parse_value(Part::whole(text))?
        } else {
            frame::from_json(text, args.form.role, args.form.com)?
        };
        Ok(hex::compact(&bytes))
    })
}

fn value_json(value: Variant<'_>) -> String {
    let mut out = String::new();
    json::put_value(&mut out, value);
    out
}
