//! The findings of `bcap doctor`, one line each.

use std::io::Write as _;

use anstyle::{AnsiColor, Style};
use bcap_terminal::escape;
use serde::Serialize;

use crate::failure::Failure;
use crate::output::print_json;

const GREEN: Style = AnsiColor::Green.on_default();
const RED: Style = AnsiColor::Red.on_default().bold();
const YELLOW: Style = AnsiColor::Yellow.on_default();

/// The result of one check.
#[derive(Debug)]
pub(super) enum Finding {
    /// The check passed; the details.
    Passed(String),
    /// The check failed.
    Failed {
        /// The fault.
        detail: String,
        /// The remedy.
        hint: String,
    },
    /// The check was skipped; the check or condition that it depends on.
    Skipped(String),
    /// The controller's answer is inconclusive; the answer.
    Untested(String),
}

impl Finding {
    pub(super) fn skipped(why: impl Into<String>) -> Self {
        Self::Skipped(why.into())
    }

    pub(super) fn failed(detail: impl Into<String>, hint: impl Into<String>) -> Self {
        Self::Failed { detail: detail.into(), hint: hint.into() }
    }

    pub(super) const fn has_failed(&self) -> bool {
        matches!(self, Self::Failed { .. })
    }
}

const UNTESTED_HINT: &str = "check that the controller's software has the commands of Slave Mode";

/// The findings so far.
pub(super) struct Report {
    json: bool,
    /// The first failure, which determines the exit code.
    first: Option<Failure>,
}

#[derive(Serialize)]
struct FindingLine<'a> {
    check: &'a str,
    result: &'a str,
    detail: &'a str,
    #[serde(skip_serializing_if = "Option::is_none")]
    hint: Option<&'a str>,
}

impl Report {
    pub(super) const fn new(json: bool) -> Self {
        Self { json, first: None }
    }

    /// Prints a finding.
    pub(super) fn note(&mut self, check: &'static str, finding: Finding) -> Result<(), Failure> {
        let (result, detail, hint) = match &finding {
            Finding::Passed(detail) => ("passed", detail.as_str(), None),
            Finding::Failed { detail, hint } => ("failed", detail.as_str(), Some(hint.as_str())),
            Finding::Skipped(why) => ("skipped", why.as_str(), None),
            Finding::Untested(answer) => ("untested", answer.as_str(), Some(UNTESTED_HINT)),
        };
        if let Some(hint) = hint {
            let untested = if matches!(finding, Finding::Untested(_)) { "could not be tested: " } else { "" };
            self.first.get_or_insert(Failure::unfit(format!("{check}: {untested}{detail}"), hint));
        }
        self.print(&FindingLine { check, result, detail, hint })
    }

    /// Prints that the controller cannot be reached over a link.
    pub(super) fn unreachable(&mut self, check: &'static str, failure: Failure) -> Result<(), Failure> {
        let detail = failure.to_string();
        let printed =
            self.print(&FindingLine { check, result: "failed", detail: &detail, hint: failure.hint().as_deref() });
        self.first.get_or_insert(failure);
        printed
    }

    fn print(&self, line: &FindingLine<'_>) -> Result<(), Failure> {
        if self.json {
            return Ok(print_json(&serde_json::to_string(line).unwrap_or_default())?);
        }
        let (style, word) = match line.result {
            "passed" => (GREEN, "ok"),
            "failed" => (RED, "FAILED"),
            "untested" => (YELLOW, "?"),
            _ => (YELLOW, "-"),
        };
        // this stream strips colours if NO_COLOR is set or the output is not a terminal
        let mut out = anstream::stdout().lock();
        writeln!(out, "{style}{word:<6}{style:#} {:<14} {}", line.check, escape::line(line.detail))?;
        if let Some(hint) = line.hint {
            writeln!(out, "{:21} {}", "", escape::line(hint))?;
        }
        Ok(())
    }

    /// Returns the first failure.
    pub(super) fn end(self) -> Result<(), Failure> {
        self.first.map_or(Ok(()), Err)
    }
}
