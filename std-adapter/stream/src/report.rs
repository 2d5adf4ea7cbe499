//! The statistics of a stream: as JSON for programs, as text with histograms for people.

use std::fmt::Write as _;

use bcap_capture::times::Times;
use bcap_core::slave::Stats;
use serde::Serialize;

/// The round trips and the jitter of a stream.
#[derive(Clone, Debug, Default)]
pub struct StreamTimes {
    rtt: Times,
    jitter: Times,
}

impl StreamTimes {
    /// Records the times of the last cycle.
    pub fn follow(&mut self, stats: &Stats) {
        self.rtt.follow(&stats.rtt);
        self.jitter.follow(&stats.jitter);
    }
}

/// The statistics of a stream; times in microseconds.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Report {
    cycles: u32,
    late: u32,
    underflows: u32,
    refused: u32,
    rtt_us: Quantiles,
    jitter_us: Quantiles,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
struct Quantiles {
    p50: u64,
    p99: u64,
    p999: u64,
    max: u64,
}

impl Quantiles {
    fn of(times: &Times) -> Self {
        Self { p50: times.quantile(500), p99: times.quantile(990), p999: times.quantile(999), max: times.max() }
    }
}

impl Report {
    /// Creates the report of a stream that has ended.
    pub fn of(stats: &Stats, times: &StreamTimes) -> Self {
        Self {
            cycles: stats.cycles,
            late: stats.late,
            underflows: stats.underflows,
            refused: stats.refused,
            rtt_us: Quantiles::of(&times.rtt),
            jitter_us: Quantiles::of(&times.jitter),
        }
    }

    /// Formats the report as a line of JSON.
    pub fn to_json(self) -> String {
        serde_json::to_string(&self).unwrap_or_default()
    }
}

/// Formats the statistics as text.
pub fn text(stats: &Stats, times: &StreamTimes) -> String {
    let report = Report::of(stats, times);
    let mut out = String::new();
    let seconds = f64::from(stats.cycles) * 0.008;
    let _ = writeln!(out, "cycles      {:>8}   {seconds:.1} s of 8 ms each", report.cycles);
    let _ = writeln!(out, "late        {:>8}   sent more than 4 ms after their deadline", report.late);
    let _ = writeln!(out, "underflows  {:>8}   the controller's buffer ran empty during motion", report.underflows);
    let _ = writeln!(out, "refused     {:>8}   poses sent again because the buffer was full", report.refused);
    if let Some(margin) = stats.least_margin {
        let _ = writeln!(out, "margin      {:>8.1}   ms, the lowest buffer level", margin.as_secs_f64() * 1000.0);
    }
    let _ = writeln!(out, "us               p50      p99    p99.9      max");
    for (name, Quantiles { p50, p99, p999, max }) in [("round trip", report.rtt_us), ("jitter", report.jitter_us)] {
        let _ = writeln!(out, "{name:<11} {p50:>8} {p99:>8} {p999:>8} {max:>8}");
    }
    for (name, times) in [("round trip", &times.rtt), ("jitter", &times.jitter)] {
        let _ = writeln!(out, "{name}, us");
        bars(&mut out, times);
    }
    out.truncate(out.trim_end().len());
    out
}

/// Draws a histogram with one line per power of two, from the first to the last that is not empty.
fn bars(out: &mut String, times: &Times) {
    const WIDTH: u64 = 50;
    let powers: Vec<u64> = (0..=32).map(|power| times.count_between(1 << power >> 1, (1 << power) - 1)).collect();
    let (Some(first), Some(last)) = (powers.iter().position(|n| *n > 0), powers.iter().rposition(|n| *n > 0)) else {
        return;
    };
    let most = powers.iter().copied().max().unwrap_or(1).max(1);
    for (power, count) in powers.iter().enumerate().take(last + 1).skip(first) {
        let end = (1_u64 << power) - 1;
        // rounds up, so that a single count is visible
        let bar = "█".repeat((count * WIDTH).div_ceil(most) as usize);
        let _ = writeln!(out, "  up to {end:>8} {count:>8} {bar}");
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn stream() -> (Stats, StreamTimes) {
        let mut stats = Stats::default();
        (stats.cycles, stats.late, stats.refused, stats.underflows) = (1000, 2, 3, 1);
        let mut times = StreamTimes::default();
        (0..1000).for_each(|n| times.rtt.record(if n < 990 { 100 + n / 200 } else { 200 + n - 990 }));
        times.jitter.record(5);
        times.jitter.record(70);
        (stats, times)
    }

    #[test]
    fn json_has_exactly_these_keys() {
        let (stats, times) = stream();
        let json = Report::of(&stats, &times).to_json();
        let expected = r#"{"cycles":1000,"late":2,"underflows":1,"refused":3,"rtt_us":{"p50":102,"p99":104,"p999":208,"max":209},"jitter_us":{"p50":5,"p99":70,"p999":70,"max":70}}"#;
        assert_eq!(json, expected);
    }

    #[test]
    fn text_has_statistics_and_histograms() {
        let (stats, times) = stream();
        let text = text(&stats, &times);
        assert!(text.contains("late               2"), "{text}");
        assert!(text.contains("round trip       102      104      208      209"), "{text}");
        let bars: Vec<&str> = text.lines().filter(|line| line.contains("up to")).collect();
        assert_eq!(bars.len(), 2 + 5, "{text}");
        assert!(bars[0].ends_with(&format!(" 127      990 {}", "█".repeat(50))), "{text}");
        assert!(bars[1].ends_with(" 255       10 █") && bars[3].ends_with("       0 "), "{text}");
    }
}
