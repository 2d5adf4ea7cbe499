//! Sparklines: the last values of a variable as a row of bars.

const BARS: [char; 8] = ['▁', '▂', '▃', '▄', '▅', '▆', '▇', '█'];
const PLAIN: [char; 8] = ['_', '.', '-', '~', '=', '+', '*', '#'];

/// Draws the last `width` values, from the smallest of them to the largest. Equal values are the lowest bar.
pub(super) fn sparkline(values: &[f64], width: usize, unicode: bool) -> String {
    let shown = values.get(values.len().saturating_sub(width)..).unwrap_or_default();
    let finite = || shown.iter().copied().filter(|value| value.is_finite());
    let (low, high) = finite().fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| (low.min(v), high.max(v)));
    let bars = if unicode { BARS } else { PLAIN };
    let bar = |value: &f64| match value {
        value if !value.is_finite() => '?',
        _ if high <= low => bars[0],
        // halves first: the difference of two doubles can be infinite
        value => bars[((value / 2.0 - low / 2.0) / (high / 2.0 - low / 2.0) * 7.0).round().clamp(0.0, 7.0) as usize],
    };
    shown.iter().map(bar).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_last_values_span_all_bars() {
        assert_eq!(sparkline(&[9.0, 0.0, 1.0, 2.0, 7.0], 4, true), "▁▂▃█");
        assert_eq!(sparkline(&[0.0, 7.0], 10, false), "_#");
        assert_eq!(sparkline(&[5.0, 5.0], 10, true), "▁▁");
        assert_eq!(sparkline(&[-1e308, f64::NAN, 1e308], 10, true), "▁?█");
        assert_eq!(sparkline(&[], 10, true), "");
    }
}
