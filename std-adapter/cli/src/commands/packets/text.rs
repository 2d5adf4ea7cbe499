//! `bcap text`: converts values between their bytes and the text form of RAC.

use std::str;

use bcap_capture::json::LIMITS;
use bcap_capture::value::to_json;
use bcap_capture::{ConvertError, hex, value};
use bcap_core::limits::Strictness;
use bcap_core::variant::Variant;
use bcap_terminal::escape;
use clap::{Args, Subcommand};

use crate::commands::packets::items::Items;
use crate::failure::Failure;
use crate::values::Value;

/// Converts values to the text form of RAC, and back
///
/// The text is TYPE,DATA: the VARTYPE as a number, then the data. Parsing the output gives the same bits, except that control
/// characters are printed as \u{1b}; with --json the text is {"text":"8,\u001b"}, which is exact. A value without a text
/// form, such as an empty array, is an error. With `-` each line of the standard input is one item and gives one line of
/// output. An invalid line gives {"error":...,"offset":...}, and the exit code is then 2.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  bcap text parse '8204,(8,Sample),(2,100)'
  bcap text parse --json '8196,1,2.5,-3e9'
  bcap text print 0300010000007b000000
  bcap text parse - <values.txt | bcap text print -")]
pub(crate) struct Text {
    #[command(subcommand)]
    pub(crate) command: TextCommand,
}

#[derive(Debug, Subcommand)]
pub(crate) enum TextCommand {
    /// Prints the bytes of a value, as hexadecimal digits, or as JSON with --json
    Parse {
        /// The text; without it, or with `-`, the lines of the standard input
        text: Option<String>,
    },
    /// Prints the text of a value
    Print {
        /// The bytes; without it, or with `-`, the lines of the standard input
        #[arg(value_name = "HEX")]
        hex: Vec<String>,
    },
}

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
