//! The text of a report.

use std::fmt::Write as _;

use serde_json::json;

use super::{Answer, Row, Survey};

/// The version of this format, for the programs that read it.
const FORMAT: u32 = 1;

/// The values that each report has.
const SHOWN: [(&str, &str); 3] =
    [("model", "variable @TYPE"), ("version", "variable @VERSION"), ("robot type", "variable robot/@TYPE_NAME")];

const INTRODUCTION: &str = "\
# Read this file before you send it. It has no host name, address or serial number; values are in it only with --values,
# except the three below. The last column is the answer of the virtual controller, where it differs.";

/// Returns the report as a table: the answers of a controller whose provider is `provider`, next to the answers of a virtual
/// controller.
#[must_use]
pub fn table(survey: &Survey, other: &Survey, provider: &str, values: bool) -> String {
    let mut out = format!("bcap report, format {FORMAT}\n{INTRODUCTION}\n\n");
    let mut head = |name: &str, value: &str| {
        // writing to a string cannot fail
        let _ = writeln!(out, "{name:<12} {value}");
    };
    head("bcap", env!("CARGO_PKG_VERSION"));
    head("provider", provider);
    for (name, call) in SHOWN {
        head(name, survey.value(call).as_deref().unwrap_or("not answered"));
    }
    head("compared to", &format!("bcap sim, model {}", other.value("variable @TYPE").unwrap_or_default()));
    head("ended", survey.ended.as_deref().unwrap_or("after all rounds"));
    let header = ["call", "answer", "times", "p50 ms", "p99 ms", "virtual controller"].map(str::to_owned);
    let lines: Vec<_> = [header].into_iter().chain(rows(survey, other).map(|(row, other)| cells(row, other))).collect();
    let widths: Vec<usize> =
        (0..6).map(|column| lines.iter().map(|line| line[column].len()).max().unwrap_or(0)).collect();
    out.push('\n');
    let shown = [None].into_iter().chain(survey.rows.iter().map(|row| row.value.as_ref()));
    for (line, value) in lines.iter().zip(shown) {
        let mut text = String::new();
        for (cell, width) in line.iter().zip(&widths) {
            let _ = write!(text, "{cell:<width$}  ");
        }
        if let Some(value) = value.filter(|_| values) {
            let _ = write!(text, "  {}", bcap_capture::value::data::format(value.as_variant()));
        }
        out.push_str(text.trim_end());
        out.push('\n');
    }
    out
}

/// Returns the report as a line of JSON for each call.
#[must_use]
pub fn json(survey: &Survey, other: &Survey, values: bool) -> String {
    let mut out = String::new();
    for (row, other) in rows(survey, other) {
        let [call, answer, _, _, _, virtual_one] = cells(row, other);
        let value = row.value.as_ref().filter(|_| values || SHOWN.iter().any(|(_, call)| *call == row.name));
        let line = json!({
            "call": call, "answer": answer, "count": row.count, "p50_us": row.times.quantile(500),
            "p99_us": row.times.quantile(990), "virtual": virtual_one,
            "value": value.map(|value| bcap_capture::value::data::format(value.as_variant())),
        });
        let _ = writeln!(out, "{line}");
    }
    if let Some(ended) = &survey.ended {
        let _ = writeln!(out, "{}", json!({ "ended": ended }));
    }
    out
}

fn rows<'a>(survey: &'a Survey, other: &'a Survey) -> impl Iterator<Item = (&'a Row, &'a Row)> {
    survey.rows.iter().zip(&other.rows)
}

/// Returns the columns of a call.
fn cells(row: &Row, other: &Row) -> [String; 6] {
    let times = |permille| match row.count {
        0 => String::new(),
        _ => format!("{}.{:03}", row.times.quantile(permille) / 1000, row.times.quantile(permille) % 1000),
    };
    let mut answer = answer(&row.answer);
    for later in &row.others {
        let _ = write!(answer, ", later {later}");
    }
    let is_compared = row.count > 0 && row.answer != other.answer;
    let virtual_one = if is_compared { self::answer(&other.answer) } else { String::new() };
    [row.name.clone(), answer, row.count.to_string(), times(500), times(990), virtual_one]
}

fn answer(answer: &Answer) -> String {
    match answer {
        Answer::Value(layout) => layout.clone(),
        Answer::Refused(code) => match code.name() {
            Some(name) => format!("{:08X} {name}", code.to_u32()),
            None => format!("{:08X}", code.to_u32()),
        },
        Answer::Skipped(why) => why.clone(),
    }
}
