//! `bcap explain`: the meaning of a result code, and the remedy; with `--index`, all known codes as a page of the
//! documentation.

use std::fmt::Write as _;

use bcap_core::hresult::HResult;
use clap::Args;

use crate::failure::Failure;
use crate::output::{print_block, print_json, print_raw};

/// Explains result codes: meaning, usual cause, what to do
///
/// CODE is a name, or a number as the manuals write it (0x83500121 or 83500121) or as a program prints it (-2092957407). Needs
/// no connection.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  bcap explain 0x83500121
  bcap explain E_ACCESSDENIED 84204043
  bcap explain --json -2091908831
  bcap explain --index >errors.md")]
pub(crate) struct Explain {
    /// The codes
    #[arg(value_name = "CODE", required_unless_present = "index", allow_negative_numbers = true)]
    pub(crate) codes: Vec<String>,
    /// Print all known codes as Markdown
    #[arg(long, conflicts_with = "codes")]
    pub(crate) index: bool,
}

/// Explains each code of the command line, or prints the index.
pub(crate) fn explain(args: &Explain, json: bool) -> Result<(), Failure> {
    if args.index {
        return Ok(print_raw(&index())?);
    }
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
            u32::from_str_radix(digits.unwrap_or(text), 16).ok().filter(|_| is_hex(text)).map(HResult::from_u32)
        })
        .or_else(|| text.parse().ok().map(HResult))
        .or_else(|| text.parse().ok().map(HResult::from_u32))
        .ok_or_else(|| Failure::Input(unknown(text)))
}

/// Tells whether a number is hexadecimal: it has a prefix, or eight digits as the manuals write codes.
fn is_hex(text: &str) -> bool {
    text.len() == 8 || text.starts_with("0x") || text.starts_with("0X")
}

fn unknown(text: &str) -> String {
    let part = text.to_ascii_uppercase();
    let similar = HResult::known().filter_map(HResult::name).filter(|name| part.len() > 2 && name.contains(&part));
    let similar = similar.collect::<Vec<_>>().join(", ");
    let similar = if similar.is_empty() { String::new() } else { format!("; names with this text: {similar}") };
    format!("{text:?} is no result code: write 0x83500121, 83500121, -2092957407 or E_SLVMODE_OFF{similar}")
}

/// The columns of the table, with the title of each.
fn facts(code: HResult) -> impl Iterator<Item = (&'static str, String)> {
    [
        ("meaning", code.meaning().map(str::to_owned)),
        ("axis", code.axis().map(|axis| axis.to_string())),
        ("level", code.level().map(|level| format!("{level}, of 1 to 5 of the controller's errors"))),
        ("system", code.os_error().map(|number| format!("error {number} of the operating system that answered"))),
        ("cause", code.cause().map(str::to_owned)),
        ("what to do", code.hint().map(str::to_owned)),
        ("returned by", code.functions().map(str::to_owned)),
        ("source", code.source().map(str::to_owned)),
    ]
    .into_iter()
    .filter_map(|(title, text)| Some((title, text?)))
}

fn as_text(code: HResult) -> String {
    let kind = if code.is_ok() { "success" } else { "failure" };
    let mut text = format!("{code}, decimal {}, a {kind}", code.0);
    let mut known = false;
    for (title, fact) in facts(code) {
        let _ = write!(text, "\n  {title:<11}  {fact}");
        known = true;
    }
    if !known {
        text.push_str("\n  no source gives its meaning; ask the controller: bcap exec GetErrorDescription CODE");
    }
    text
}

fn as_json(code: HResult) -> String {
    let mut line = serde_json::json!({
        "code": code.0,
        "hex": format!("{:#010X}", code.to_u32()).replacen("0X", "0x", 1),
        "name": code.name(),
    });
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
    line.to_string()
}

/// The page of the book with all codes.
fn index() -> String {
    let mut page = String::from(INTRODUCTION);
    for code in HResult::known() {
        let _ = write!(page, "\n| [`{:#010X}`](#{}) |", code.to_u32(), anchor(code));
        let _ = write!(page, " {} | {} |", code.name().unwrap_or_default(), code.meaning().unwrap_or_default());
    }
    page.push_str(
        "\n\nCodes without a name have the meaning of their range:\n\n| from | to | meaning |\n|---|---|---|",
    );
    for (first, last, meaning) in HResult::ranges() {
        let _ = write!(page, "\n| `{:#010X}` | `{:#010X}` | {meaning} |", first.to_u32(), last.to_u32());
    }
    for code in HResult::known() {
        let _ =
            write!(page, "\n\n## {}\n\n`{:#010X}`, decimal {}.", anchor(code).to_uppercase(), code.to_u32(), code.0);
        for (title, fact) in facts(code).filter(|(title, _)| *title != "axis") {
            let _ = write!(page, "\n\n**{title}**: {fact}");
        }
    }
    page.replace("`0X", "`0x")
}

/// The link to the section of a code: its name in lower case.
fn anchor(code: HResult) -> String {
    code.name().unwrap_or_default().to_lowercase()
}

const INTRODUCTION: &str = "\
# Result codes

Every reply carries a result code (HRESULT). `bcap explain CODE` prints a section of this page; CODE is a name or a number, and
`bcap explain --index` prints the whole page.

The sources are the RAC specification for RC8, the b-CAP specification for RC9, and others as named. The meaning is the source's; if
a source has only a name, the meaning is derived from it. Usual causes, functions and hints are this project's advice.

| code | name | meaning |
|---|---|---|";
