//! Statistics of each function: the number of calls and errors, and their response times.

use std::collections::BTreeMap;

use serde_json::json;

use super::call::Call;
use super::print::Format;
use crate::times::Times;

/// The cycle of Slave Mode is 8 ms; a longer time between two requests is a gap.
const GAP: u64 = 12_000_000;

/// The figures of all functions, by name.
#[derive(Debug, Default)]
pub struct Stats {
    functions: BTreeMap<String, Figures>,
    /// The streams of Slave Mode, by connection.
    streams: BTreeMap<String, Stream>,
}

/// The times between slvMove requests of a connection.
#[derive(Debug)]
struct Stream {
    /// When the last request was sent.
    last: u64,
    intervals: Times,
    gaps: u64,
}

#[derive(Debug)]
struct Figures {
    calls: u64,
    errors: u64,
    unanswered: u64,
    retries: u64,
    times: Times,
}

impl Stats {
    /// Counts a call.
    pub fn add(&mut self, call: &Call) {
        let new = || Figures { calls: 0, errors: 0, unanswered: 0, retries: 0, times: Times::new() };
        // other protocols on the port of RAC would add one function for each distinct line
        let is_line = call.serial.is_none() && !matches!(call.function.as_str(), "GET" | "PUT");
        let name = if is_line { "(invalid lines)".to_owned() } else { call.full_name() };
        let figures = self.functions.entry(name).or_insert_with(new);
        figures.calls += 1;
        figures.errors += u64::from(call.error().is_some());
        figures.unanswered += u64::from(call.reply.is_none());
        figures.retries += u64::from(call.attempts) - 1;
        if let Some(reply) = &call.reply {
            figures.times.record(reply.after / 1000);
        }
        if call.command.as_deref().is_some_and(|command| command.eq_ignore_ascii_case("slvMove")) {
            self.slave_move(call);
        }
    }

    /// Counts the time since the previous slvMove of the connection. After a pause of a second another stream has begun.
    fn slave_move(&mut self, call: &Call) {
        const PAUSE: u64 = 1_000_000_000;
        let new = || Stream { last: call.at, intervals: Times::new(), gaps: 0 };
        let stream = self.streams.entry(call.link.clone()).or_insert_with(new);
        let interval = call.at.saturating_sub(std::mem::replace(&mut stream.last, call.at));
        if (1..PAUSE).contains(&interval) {
            stream.intervals.record(interval / 1000);
            stream.gaps += u64::from(interval > GAP);
        }
    }

    /// Returns one line for each function; text begins with a heading.
    #[must_use]
    pub fn lines(&self, format: Format) -> Vec<String> {
        if format == Format::Json {
            let streams = self.streams.iter().map(|(link, stream)| stream.json(link));
            return self.functions.iter().map(|(name, figures)| figures.json(name)).chain(streams).collect();
        }
        let widest = self.functions.keys().map(|name| name.chars().count()).max().unwrap_or(0).max("function".len());
        let heading = format!(
            "{:widest$} {:>8} {:>7} {:>9} {:>7} {:>10} {:>10} {:>10}",
            "function", "calls", "errors", "no reply", "retries", "p50 ms", "p99 ms", "max ms"
        );
        let rows = self.functions.iter().map(|(name, figures)| figures.row(name, widest));
        let streams = self.streams.iter().map(|(link, stream)| stream.row(link));
        std::iter::once(heading).chain(rows).chain(streams).collect()
    }
}

impl Stream {
    fn row(&self, link: &str) -> String {
        let [p50, p99, max] = quantiles(&self.intervals).map(millis);
        let (count, gaps) = (self.intervals.count_between(0, u64::MAX), self.gaps);
        format!(
            "{link}: {count} intervals between slvMove: p50 {p50} ms, p99 {p99} ms, max {max} ms; {gaps} longer than {} ms",
            GAP / 1_000_000
        )
    }

    fn json(&self, link: &str) -> String {
        let [p50, p99, max] = quantiles(&self.intervals);
        let count = self.intervals.count_between(0, u64::MAX);
        let line = json!({
            "slave_mode": link, "intervals": count, "gaps": self.gaps, "p50_us": p50, "p99_us": p99, "max_us": max,
        });
        line.to_string()
    }
}

/// Formats microseconds as milliseconds.
fn millis(micros: u64) -> String {
    format!("{}.{:03}", micros / 1000, micros % 1000)
}

/// Returns p50, p99 and the maximum in microseconds.
fn quantiles(times: &Times) -> [u64; 3] {
    [times.quantile(500), times.quantile(990), times.max()]
}

impl Figures {
    fn row(&self, name: &str, widest: usize) -> String {
        let [p50, p99, max] = quantiles(&self.times).map(millis);
        let Self { calls, errors, unanswered, retries, .. } = self;
        format!("{name:widest$} {calls:>8} {errors:>7} {unanswered:>9} {retries:>7} {p50:>10} {p99:>10} {max:>10}")
    }

    fn json(&self, name: &str) -> String {
        let [p50, p99, max] = quantiles(&self.times);
        let Self { calls, errors, unanswered, retries, .. } = self;
        let line = json!({
            "function": name, "calls": calls, "errors": errors, "no_reply": unanswered, "retries": retries,
            "p50_us": p50, "p99_us": p99, "max_us": max,
        });
        line.to_string()
    }
}
