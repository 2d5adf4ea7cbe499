//! Prints all known result codes as a page of the book, in Markdown.

use std::fmt::Write as _;

use bcap_capture::facts;
use bcap_core::hresult::{HResult, Pattern, Row};

fn main() {
    println!("{}", page());
}

/// Formats a code as the manuals write it.
fn hex(code: HResult) -> String {
    format!("0x{:08X}", code.to_u32())
}

fn page() -> String {
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

Every reply carries a result code (HRESULT). `bcap explain CODE` prints all that is known about a code; CODE is a name or a number.

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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_page_has_every_code() {
        let page = page();
        assert!(page.starts_with("# Result codes\n"), "the page of the book has the title of docs/errors.md");
        // the eight codes of an axis are one pattern
        let row =
            "| `8320407n` | An axis would have left its range on the way to its goal. | ClearError, correct the goal";
        assert!(page.contains(row), "{page}");
        for code in HResult::known() {
            let name = code.name().unwrap();
            let section = page.split(&format!("\n## {name}\n")).nth(1).unwrap_or_default();
            let section = section.split("\n## ").next().unwrap_or_default();
            for part in ["**meaning**: ", "**cause**: ", "**what to do**: ", "**returned by**: ", "**source**: "] {
                assert!(section.contains(part), "{name}: {part}");
            }
            let row = format!("| [`{}`](#{}) | {name} |", hex(code), name.to_lowercase());
            assert!(page.contains(&row), "{name}");
        }
    }
}
