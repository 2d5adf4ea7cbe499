//! `bcap explain`: the meaning of a result code, and the remedy.

use std::fmt::Write as _;

use bcap_capture::facts;
use bcap_core::hresult::HResult;
use clap::Args;

use crate::failure::Failure;
use crate::output::{print_block, print_json};

/// Explains result codes: meaning, usual cause, what to do
///
/// CODE is a name, or a number as the manuals write it (0x83500121 or 83500121) or as a program prints it (-2091908831). Needs
/// no connection.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  bcap explain 0x83500121
  bcap explain E_ACCESSDENIED 84204043
  bcap explain --json -2091908831")]
pub(crate) struct Explain {
    /// The codes
    #[arg(value_name = "CODE", required = true, allow_negative_numbers = true)]
    pub(crate) codes: Vec<String>,
}

/// Explains each code of the command line.
pub(crate) fn explain(args: &Explain, json: bool) -> Result<(), Failure> {
    for (number, text) in args.codes.iter().enumerate() {
        let code = read(text)?;
        if json {
            print_json(&as_json(code))?;
        } else {
            let gap = if number == 0 { "" } else { "\n" };
            print_block(&format!("{gap}{}", as_text(code)))?;
        }
    }
    Ok(())
}

/// Reads a code: its name, or its number as the manuals, a program or a log write it.
fn read(text: &str) -> Result<HResult, Failure> {
    let digits = text.strip_prefix("0x").or_else(|| text.strip_prefix("0X"));
    HResult::from_name(text)
        .or_else(|| {
            // eight digits, as the manuals write codes, need no prefix
            let is_hex = digits.is_some() || text.len() == 8;
            u32::from_str_radix(digits.unwrap_or(text), 16).ok().filter(|_| is_hex).map(HResult::from_u32)
        })
        .or_else(|| text.parse().ok().map(HResult))
        .or_else(|| text.parse().ok().map(HResult::from_u32))
        .ok_or_else(|| Failure::Input(unknown(text)))
}

fn unknown(text: &str) -> String {
    let part = text.to_ascii_uppercase();
    let similar = HResult::known().filter_map(HResult::name).filter(|name| part.len() > 2 && name.contains(&part));
    let similar = similar.collect::<Vec<_>>().join(", ");
    let similar = if similar.is_empty() { String::new() } else { format!("; names with this text: {similar}") };
    format!("{text:?} is no result code: write 0x83500121, 83500121, -2091908831 or E_SLVMODE_OFF{similar}")
}

fn as_text(code: HResult) -> String {
    let kind = if code.is_ok() { "success" } else { "failure" };
    let mut text = format!("{code}, decimal {}, a {kind}", code.0);
    for (title, fact) in facts(code) {
        let _ = write!(text, "\n  {title:<11}  {fact}");
    }
    if code.meaning().is_none() {
        let _ = write!(
            text,
            "\n  no source gives its meaning; ask the controller: bcap exec controller GetErrorDescription {}",
            code.0
        );
    }
    text
}

fn as_json(code: HResult) -> String {
    let mut line = serde_json::json!({ "code": code.0, "hex": hex(code), "name": code.name() });
    for (title, fact) in facts(code) {
        line[title.replace(' ', "_")] = fact.into();
    }
    // numbers, where the text has words
    for (title, number) in
        [("axis", code.axis().map(u16::from)), ("level", code.level().map(u16::from)), ("system", code.os_error())]
    {
        if let Some(number) = number {
            line[title] = number.into();
        }
    }
    if code.listed() != code {
        line["same_as"] = hex(code.listed()).into();
    }
    line["effect"] = code.effect().into();
    line.to_string()
}

/// Formats a code as the manuals write it.
fn hex(code: HResult) -> String {
    format!("0x{:08X}", code.to_u32())
}
