//! `--stats`: how long calls took, and how many failed, for each function.

use std::collections::BTreeMap;

use serde_json::json;

use super::call::Call;
use crate::times::Times;

/// The figures of all functions, by name.
#[derive(Default)]
pub(crate) struct Stats {
    functions: BTreeMap<String, Figures>,
}

struct Figures {
    calls: u64,
    errors: u64,
    unanswered: u64,
    retries: u64,
    times: Times,
}

impl Stats {
    pub(crate) fn add(&mut self, call: &Call) {
        let new = || Figures { calls: 0, errors: 0, unanswered: 0, retries: 0, times: Times::new() };
        let figures = self.functions.entry(call.title()).or_insert_with(new);
        figures.calls += 1;
        figures.errors += u64::from(call.error().is_some());
        figures.unanswered += u64::from(call.reply.is_none());
        figures.retries += u64::from(call.attempts) - 1;
        if let Some(reply) = &call.reply {
            figures.times.record(reply.after / 1000);
        }
    }

    /// Returns one line for each function; as text, also a heading.
    pub(crate) fn lines(&self, json: bool) -> Vec<String> {
        if json {
            return self.functions.iter().map(|(name, figures)| figures.json(name)).collect();
        }
        let widest = self.functions.keys().map(|name| name.chars().count()).max().unwrap_or(0).max("function".len());
        let heading = format!(
            "{:widest$} {:>8} {:>7} {:>9} {:>7} {:>10} {:>10} {:>10}",
            "function", "calls", "errors", "no reply", "retries", "p50 ms", "p99 ms", "max ms"
        );
        let rows = self.functions.iter().map(|(name, figures)| figures.row(name, widest));
        std::iter::once(heading).chain(rows).collect()
    }
}

impl Figures {
    fn row(&self, name: &str, widest: usize) -> String {
        let millis = |micros: u64| format!("{}.{:03}", micros / 1000, micros % 1000);
        let [p50, p99, max] = self.quantiles().map(millis);
        let Self { calls, errors, unanswered, retries, .. } = self;
        format!("{name:widest$} {calls:>8} {errors:>7} {unanswered:>9} {retries:>7} {p50:>10} {p99:>10} {max:>10}")
    }

    fn json(&self, name: &str) -> String {
        let [p50, p99, max] = self.quantiles();
        let Self { calls, errors, unanswered, retries, .. } = self;
        let line = json!({
            "function": name, "calls": calls, "errors": errors, "no_reply": unanswered, "retries": retries,
            "p50_us": p50, "p99_us": p99, "max_us": max,
        });
        line.to_string()
    }

    /// Returns p50, p99 and the maximum in microseconds.
    fn quantiles(&self) -> [u64; 3] {
        [self.times.quantile(0.5), self.times.quantile(0.99), self.times.max()]
    }
}
