//! `bcap decode` and `bcap encode`: frames and values between their bytes and JSON.

use std::str;

use bcap_core::bcap::Decoder;
use bcap_core::limits::Strictness;
use bcap_core::variant::Variant;

use crate::args::{Decode, Encode};
use crate::dissect::dissect;
use crate::error::Failure;
use crate::frame;
use crate::hex;
use crate::item::{ItemError, Items, Place};
use crate::json::{self, LIMITS, Part};

/// Runs `bcap decode`.
pub(crate) fn decode(args: &Decode, json: bool) -> Result<(), Failure> {
    let strictness = if args.lenient { Strictness::Lenient } else { Strictness::Strict };
    Items::from_words(&args.hex).convert(json, |text, place| {
        let bytes = hex::parse(text)?;
        if args.form.variant {
            let value = Variant::decode(&bytes, &LIMITS, strictness)?;
            return Ok(if json { value_json(value) } else { format!("{value:?}") });
        }
        let frame = Decoder { limits: LIMITS, strictness, crc: args.form.com }.decode_datagram(&bytes)?;
        Ok(match (json, place, strictness) {
            (true, ..) => frame::to_json(&frame, args.form.role),
            (false, Place::Argument, Strictness::Strict) => dissect(&bytes, &frame, args.form.role, args.form.com),
            // where lengths may lie, there is no saying which byte belongs to what
            _ => frame::to_line(&frame, args.form.role),
        })
    })
}

/// Runs `bcap encode`.
pub(crate) fn encode(args: &Encode, json: bool) -> Result<(), Failure> {
    Items::from_words(&args.line).convert(json, |text, _| {
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
