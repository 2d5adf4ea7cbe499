//! `bcap encode`: converts JSON to the bytes of frames and values.

use std::str;

use bcap_capture::json::{self, Part};
use bcap_capture::{ConvertError, frame, hex};
use clap::Args;

use super::decode::Form;
use crate::commands::packets::items::Items;
use crate::failure::Failure;

/// Encodes frames or values from the JSON that `bcap decode --json` prints
///
/// A frame is {"serial":4,"reserved":0,"code":101,"args":[{"vt":3,"v":3}]}. The defaults are 1 for `serial`, 0 for
/// `reserved` and no `args`; `name` may replace `code`. Unknown fields are errors. With --variant a value is
/// {"vt":3,"v":100}. The output is lower-case hexadecimal digits.
///
/// `v` is a number for numbers, CY (ten-thousandths), DATE (days since 1899-12-30) and ERROR; -1 or 0 for BOOL; a string
/// for BSTR; null for EMPTY and NULL; a list for arrays. Elements of VARIANT arrays are again {"vt":..,"v":..}. Floats that
/// are not finite are "NaN", "inf" and "-inf"; a NaN with other bits is "NaN(0x7ff8000000000001)". An unpaired surrogate is
/// \ud800.
#[derive(Debug, Args)]
#[command(after_help = r#"Examples:
  bcap encode '{"serial":4,"code":101,"args":[{"vt":3,"v":3}]}'
  bcap encode '{"name":"ServiceStart","args":[{"vt":8,"v":"WDT=400"}]}'
  bcap encode --variant '{"vt":8204,"v":[{"vt":8,"v":"Sample"},{"vt":2,"v":100}]}'
  bcap encode - <frames.jsonl >frames.hex"#)]
pub(crate) struct Encode {
    #[command(flatten)]
    pub(crate) form: Form,

    /// The JSON; without it, or with `-`, the lines of the standard input
    #[arg(value_name = "JSON")]
    pub(crate) line: Vec<String>,
}

/// Runs `bcap encode`.
pub(crate) fn encode(args: &Encode) -> Result<(), Failure> {
    Items::from_words(&args.line).convert(false, |text, _| {
        let text =
            str::from_utf8(text).map_err(|error| ConvertError::new("the text is not UTF-8", error.valid_up_to()))?;
        let bytes = if args.form.variant {
            json::parse_value(Part::whole(text))?
        } else {
            frame::from_json(text, args.form.role, args.form.com)?
        };
        Ok(hex::compact(&bytes))
    })
}
