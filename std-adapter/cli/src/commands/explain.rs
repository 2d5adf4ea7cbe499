//! `bcap explain`: the meaning of a result code, and the remedy; with `--index`, all known codes as a page of the
//! documentation.

use std::fmt::Write as _;

use bcap_core::hresult::{HResult, Pattern, Row};
use clap::Args;

use crate::failure::Failure;
use crate::output::{print_block, print_json, print_raw};

/// Explains result codes: meaning, usual cause, what to do
///
/// CODE is a name, or a number as the manuals write it (0x83500121 or 83500121) or as a program prints it (-2091908831). Needs
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
    format!("{text:?} is no result code: write 0x83500121, 83500121, -2091908831 or E_SLVMODE_OFF{similar}")
}

/// The facts about a code, with the title of each.
fn facts(code: HResult) -> impl Iterator<Item = (&'static str, String)> {
    let same = code.listed();
    let level = code.level().zip(code.effect());
    [
        ("same as", (same != code).then(|| format!("{same}: the bit that makes 8 to C has no meaning"))),
        ("meaning", code.meaning().map(str::to_owned)),
        ("axis", code.axis().map(|axis| axis.to_string())),
        ("level", level.map(|(level, effect)| format!("{level} of 0 to 5: {effect}"))),
        ("part", code.part().map(str::to_owned)),
        ("system", code.os_error().map(|number| format!("error {number} of the operating system that answered"))),
        ("cause", code.cause().map(str::to_owned)),
        ("what to do", code.hint().map(|hint| hint.to_string())),
        ("returned by", code.functions().map(str::to_owned)),
        ("source", code.source().map(str::to_owned)),
    ]
    .into_iter()
    .filter_map(|(title, text)| Some((title, text?)))
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

/// The page of the book with all codes.
fn index() -> String {
    let mut page = String::from(INTRODUCTION);
    for level in 0..=5 {
        let code = HResult::from_u32(0x8020_0000 | level << 24);
        let _ = write!(page, "\n| {level} | {} |", code.effect().unwrap_or_default());
    }
    page.push_str("\n\n## Codes with a name\n\n| code | name | meaning |\n|---|---|---|");
    for code in HResult::known() {
        let _ = write!(page, "\n| [`{}`](#{}) |", hex(code), anchor(code));
        let _ = write!(page, " {} | {} |", code.name().unwrap_or_default(), code.meaning().unwrap_or_default());
    }
    page.push_str(PATTERNS);
    for row in Row::all().filter(|row| !row.meaning.is_empty()) {
        let codes: Vec<String> = row.patterns().map(pattern).collect();
        let hint = row.patterns().next().and_then(|pattern| HResult::from_u32(pattern.first).hint());
        let hint = hint.map(|hint| hint.to_string()).unwrap_or_default();
        let _ = write!(page, "\n| {} | {} | {hint} |", codes.join(" "), row.meaning);
    }
    for code in HResult::known() {
        let _ = write!(page, "\n\n## {}\n\n`{}`, decimal {}.", anchor(code).to_uppercase(), hex(code), code.0);
        for (title, fact) in facts(code) {
            let _ = write!(page, "\n\n**{title}**: {fact}");
        }
    }
    page
}

/// Formats a pattern for the page: `8320407n`, or the first and the last code.
fn pattern(pattern: Pattern) -> String {
    let code = |code: u32| {
        let digits = format!("{code:08X}");
        if pattern.has_axis { format!("{}n", digits.split_at(7).0) } else { digits }
    };
    match (code(pattern.first), code(pattern.last)) {
        (first, last) if first == last => format!("`{first}`"),
        (first, last) => format!("`{first}` to `{last}`"),
    }
}

/// The link to the section of a code: its name in lower case.
fn anchor(code: HResult) -> String {
    code.name().unwrap_or_default().to_lowercase()
}

const INTRODUCTION: &str = "\
# Result codes

Every reply carries a result code (HRESULT). `bcap explain CODE` prints all that is known about a code; CODE is a name or a number,
and `bcap explain --index` prints this page.

The sources are the RAC specification for RC8, the b-CAP specification for RC9, and others as named. The meaning is the source's; if
a source has only a name, the meaning is derived from it. Usual causes, functions and hints are this project's advice.

The second digit of an error of the controller is its level. An error that begins with 0xC is the same as with 0x8.

| level | effect |
|---|---|";

const PATTERNS: &str = "

## Errors of the controller

Codes without a name. A last digit n is an axis, 1 to 8. If two rows contain a code, the narrower one applies. The texts are this
project's; the facts come from public lists of codes and the log of an RC8A. The controller has its own text for each code:
`bcap exec controller GetErrorDescription CODE`.

| codes | meaning | what to do |
|---|---|---|";
