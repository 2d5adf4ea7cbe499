//! How well a stream ran: as JSON for programs, as text with histograms for people.

use std::fmt::Write as _;

use bcap_core::slave::{Histogram, Stats};
use serde::Serialize;

/// The figures of a stream; times in microseconds.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub(crate) struct Report {
    cycles: u32,
    late: u32,
    underflows: u32,
    refused: u32,
    rtt_us: Quantiles,
    jitter_us: Quantiles,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
struct Quantiles {
    p50: u32,
    p99: u32,
    p999: u32,
    max: u32,
}

impl Quantiles {
    fn of(times: &Histogram) -> Self {
        Self { p50: times.quantile(500), p99: times.quantile(990), p999: times.quantile(999), max: times.max() }
    }
}

impl Report {
    pub(crate) fn of(stats: &Stats) -> Self {
        Self {
            cycles: stats.cycles,
            late: stats.late,
            underflows: stats.underflows,
            refused: stats.refused,
            rtt_us: Quantiles::of(&stats.rtt),
            jitter_us: Quantiles::of(&stats.jitter),
        }
    }

    pub(crate) fn to_json(self) -> String {
        serde_json::to_string(&self).unwrap_or_default()
    }
}

/// Tells the figures to a person.
pub(crate) fn text(stats: &Stats) -> String {
    let report = Report::of(stats);
    let mut out = String::new();
    let seconds = f64::from(stats.cycles) * 0.008;
    let _ = writeln!(out, "cycles      {:>8}   {seconds:.1} s of 8 ms each", report.cycles);
    let _ = writeln!(out, "late        {:>8}   sent more than 4 ms after their time", report.late);
    let _ = writeln!(out, "underflows  {:>8}   the controller's buffer was empty in motion", report.underflows);
    let _ = writeln!(out, "refused     {:>8}   the buffer was full, sent again", report.refused);
    if let Some(margin) = stats.least_margin {
        let _ = writeln!(out, "margin      {:>8.1}   ms left in the buffer at least", margin.as_secs_f64() * 1000.0);
    }
    let _ = writeln!(out, "us               p50      p99    p99.9      max");
    for (name, Quantiles { p50, p99, p999, max }) in [("round trip", report.rtt_us), ("jitter", report.jitter_us)] {
        let _ = writeln!(out, "{name:<11} {p50:>8} {p99:>8} {p999:>8} {max:>8}");
    }
    for (name, times) in [("round trip", &stats.rtt), ("jitter", &stats.jitter)] {
        let _ = writeln!(out, "{name}, us");
        bars(&mut out, times);
    }
    out.truncate(out.trim_end().len());
    out
}

/// Draws a histogram: a line for each power of two from the first to the last that has something in it.
fn bars(out: &mut String, times: &Histogram) {
    const WIDTH: u64 = 50;
    let mut powers = [0_u64; 33];
    for (upper, count) in times.iter() {
        powers[upper.checked_ilog2().map_or(0, |log| log as usize + 1)] += u64::from(count);
    }
    let (Some(first), Some(last)) = (powers.iter().position(|n| *n > 0), powers.iter().rposition(|n| *n > 0)) else {
        return;
    };
    let most = powers.iter().copied().max().unwrap_or(1).max(1);
    for (power, count) in powers.iter().enumerate().take(last + 1).skip(first) {
        let end = (1_u64 << power) - 1;
        // one is shown, too
        let bar = "█".repeat((count * WIDTH).div_ceil(most) as usize);
        let _ = writeln!(out, "  up to {end:>8} {count:>8} {bar}");
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn stats() -> Stats {
        let mut stats = Stats { cycles: 1000, late: 2, refused: 3, underflows: 1, ..Stats::default() };
        (0..1000).for_each(|n| stats.rtt.record(if n < 990 { 103 } else { 200 + n - 990 }));
        stats.jitter.record(5);
        stats.jitter.record(70);
        stats
    }

    #[test]
    fn json_has_exactly_these_keys() {
        let json = Report::of(&stats()).to_json();
        let expected = r#"{"cycles":1000,"late":2,"underflows":1,"refused":3,"rtt_us":{"p50":103,"p99":103,"p999":209,"max":209},"jitter_us":{"p50":5,"p99":70,"p999":70,"max":70}}"#;
        assert_eq!(json, expected);
    }

    #[test]
    fn people_see_figures_and_bars() {
        let text = text(&stats());
        assert!(text.contains("late               2"), "{text}");
        assert!(text.contains("round trip       103      103      209      209"), "{text}");
        let bars: Vec<&str> = text.lines().filter(|line| line.contains("up to")).collect();
        assert_eq!(bars.len(), 2 + 5, "{text}");
        assert!(bars[0].ends_with(&format!(" 127      990 {}", "█".repeat(50))), "{text}");
        assert!(bars[1].ends_with(" 255       10 █") && bars[3].ends_with("       0 "), "{text}");
    }
}
