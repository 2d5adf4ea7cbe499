//! Results, and their reports.

use std::fmt::Write as _;

use serde::Serialize;

use crate::language::{Group, Level};

/// The outcome of a case.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Verdict {
    /// The device follows the rule.
    Pass,
    /// The device breaks the rule.
    Fail,
    /// The device answers differently from a real controller of its model.
    Differs,
    /// The case did not run, or does not apply to the device.
    Skip,
}

/// The result of a case.
#[derive(Clone, Debug, Serialize)]
pub struct CaseResult {
    /// The case, with its group.
    pub name: String,
    /// The group; none for a case of a client.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub group: Option<Group>,
    /// The level; none for a case of a client.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub level: Option<Level>,
    /// The lines of the specification, or where the answer was observed.
    pub source: &'static str,
    /// The rule in one sentence.
    pub rule: &'static str,
    /// The model on which the answer was observed; none for a case of the specification.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub seen_on: Option<String>,
    /// The outcome.
    pub verdict: Verdict,
    /// Why the case was skipped.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub reason: Option<String>,
    /// The expected reaction.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub expected: Option<String>,
    /// The actual reaction.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub came: Option<String>,
    /// The sent (`->`) and received (`<-`) frames, decoded.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub exchange: Vec<String>,
    /// The time that the case took, in ms.
    pub milliseconds: u64,
}

impl CaseResult {
    /// Returns the result as lines of text; only a failure or a difference has the exchange.
    #[must_use]
    pub fn text(&self) -> String {
        let Self { name, source, rule, .. } = self;
        match self.verdict {
            Verdict::Pass => format!("pass {name}"),
            Verdict::Skip => format!("skip {name}: {}", self.reason.as_deref().unwrap_or_default()),
            Verdict::Fail => self.exchanged(format!("FAIL {name}\n  rule:     {rule} ({source})")),
            Verdict::Differs => {
                let model = self.seen_on.as_deref().unwrap_or_default();
                let first = format!("DIFF {name}: differs from what was seen on {model} ({source})");
                self.exchanged(format!("{first}\n  seen:     {rule}"))
            }
        }
    }

    /// Appends the exchange, the expected reply and the actual one.
    fn exchanged(&self, mut out: String) -> String {
        for line in &self.exchange {
            // writing to a string cannot fail, here and below
            let _ = write!(out, "\n  {line}");
        }
        let (expected, came) = (self.expected.as_deref(), self.came.as_deref());
        let _ = write!(out, "\n  expected: {}", expected.unwrap_or_default());
        let _ = write!(out, "\n  came:     {}", came.unwrap_or_default());
        out
    }
}

/// The results of a run.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Report {
    /// The results, in the order in which the cases ran.
    pub results: Vec<CaseResult>,
    /// The cases after which the device accepted no connection for some time: they may have crashed it.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub crashes: Vec<String>,
    /// Whether the run ended because the device accepted no more connections.
    pub unreachable: bool,
}

impl Report {
    /// Returns the number of cases with this verdict.
    #[must_use]
    pub fn count(&self, verdict: Verdict) -> usize {
        self.results.iter().filter(|result| result.verdict == verdict).count()
    }

    /// Returns the names of the failed cases.
    pub fn failures(&self) -> impl Iterator<Item = &str> {
        self.results.iter().filter(|result| result.verdict == Verdict::Fail).map(|result| result.name.as_str())
    }

    /// Returns the counts of the results in one line: first for the specification, then for observed answers, if any such case
    /// ran.
    #[must_use]
    pub fn summary(&self) -> String {
        let (seen, specified): (Vec<_>, Vec<_>) =
            self.results.iter().partition(|result| result.group == Some(Group::Seen));
        let count =
            |results: &[&CaseResult], verdict| results.iter().filter(|result| result.verdict == verdict).count();
        let [passed, failed, skipped] =
            [Verdict::Pass, Verdict::Fail, Verdict::Skip].map(|verdict| count(&specified, verdict));
        let mut out = format!("{} cases: {passed} passed, {failed} failed, {skipped} skipped", specified.len());
        let [same, differ] = [Verdict::Pass, Verdict::Differs].map(|verdict| count(&seen, verdict));
        if same + differ > 0 {
            // writing to a string cannot fail
            let _ =
                write!(out, "; {} answers seen on a controller: {same} the same, {differ} different", same + differ);
        }
        out
    }

    /// Returns the report as a file of JUnit.
    #[must_use]
    pub fn junit(&self) -> String {
        let seconds = |milliseconds: u64| format!("{}.{:03}", milliseconds / 1000, milliseconds % 1000);
        let total = self.results.iter().map(|result| result.milliseconds).sum();
        let mut out = format!(
            "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n<testsuite name=\"bcap conform\" tests=\"{}\" failures=\"{}\" skipped=\"{}\" time=\"{}\">\n",
            self.results.len(),
            self.count(Verdict::Fail),
            self.count(Verdict::Skip) + self.count(Verdict::Differs),
            seconds(total)
        );
        for result in &self.results {
            let (class, name) = result.name.split_once('/').unwrap_or(("", &result.name));
            let _ = write!(
                out,
                "  <testcase classname=\"{}\" name=\"{}\" time=\"{}\"",
                xml(class),
                xml(name),
                seconds(result.milliseconds)
            );
            out.push_str(&match result.verdict {
                Verdict::Pass => "/>\n".into(),
                Verdict::Skip | Verdict::Differs => {
                    let reason = result.reason.clone().unwrap_or_else(|| result.text());
                    let reason = xml(&reason);
                    format!("><skipped message=\"{reason}\"/></testcase>\n")
                }
                Verdict::Fail => {
                    let message = xml(&format!("{} ({})", result.rule, result.source));
                    format!("><failure message=\"{message}\">{}</failure></testcase>\n", xml(&result.text()))
                }
            });
        }
        out.push_str("</testsuite>\n");
        out
    }
}

/// Escapes text for XML, and replaces control characters, which XML cannot have.
fn xml(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for letter in text.chars() {
        match letter {
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '&' => out.push_str("&amp;"),
            '"' => out.push_str("&quot;"),
            '\n' | '\t' => out.push(letter),
            letter if letter.is_control() || matches!(letter, '\u{fffe}' | '\u{ffff}') => out.push('\u{fffd}'),
            letter => out.push(letter),
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn junit_escapes_what_a_device_sends() {
        let result = CaseResult {
            name: "frames/a<b".into(),
            group: Some(Group::Frames),
            level: Some(Level::Read),
            source: "b-CAP specification, section title",
            rule: "a & b",
            seen_on: None,
            verdict: Verdict::Fail,
            reason: None,
            expected: Some("\"x\"".into()),
            came: Some("\u{1b}[0m<script>\u{ffff}".into()),
            exchange: vec!["-> y".into()],
            milliseconds: 1234,
        };
        let junit = Report { results: vec![result], ..Report::default() }.junit();
        assert!(junit.contains("tests=\"1\" failures=\"1\" skipped=\"0\" time=\"1.234\""), "{junit}");
        assert!(junit.contains("classname=\"frames\" name=\"a&lt;b\""), "{junit}");
        assert!(junit.contains("came:     \u{fffd}[0m&lt;script&gt;\u{fffd}"), "{junit}");
        assert!(!junit.contains('\u{1b}') && junit.ends_with("</testsuite>\n"));
    }
}
