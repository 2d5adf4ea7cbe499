//! `bcap text`: converts values between their bytes and the text form of RAC.

use std::str;

use bcap_capture::ConvertError;
use bcap_core::limits::Strictness;
use bcap_core::variant::Variant;
use bcap_terminal::escape;

use crate::args::{Text, TextCommand};
use crate::error::Failure;
use crate::input::Items;
use crate::value::Value;
use bcap_capture::hex;
use bcap_capture::json::LIMITS;
use bcap_capture::value;
use bcap_capture::value::to_json;

/// Runs `bcap text parse` or `bcap text print`; with `json` the text is `{"text":"3,100"}`.
pub(crate) fn text(args: &Text, json: bool) -> Result<(), Failure> {
    match &args.command {
        TextCommand::Parse { text } => Items::from_word(text.as_deref()).convert(json, |text, _| {
            let text = str::from_utf8(text).map_err(|e| ConvertError::new("the text is not UTF-8", e.valid_up_to()))?;
            let value = Value::parse_text(text.as_bytes())?;
            Ok(if json { to_json(value.as_variant()) } else { hex::compact(value.as_bytes()) })
        }),
        TextCommand::Print { hex } => Items::from_words(hex).convert(json, |text, _| {
            let bytes = hex::parse(text)?;
            let value = Variant::decode(&bytes, &LIMITS, Strictness::Strict)?;
            let text = value::to_text(value)?;
            Ok(if json { serde_json::json!({ "text": text }).to_string() } else { escape::line(&text) })
        }),
    }
}
