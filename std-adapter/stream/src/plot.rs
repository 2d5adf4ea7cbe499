//! The plot of a stream as SVG: commanded and actual poses, their difference, and the cycle times.
//!
//! The plot shows the elements of the pose with the largest motion, at most three. The difference is between the commanded
//! pose and the pose in its reply, so it includes the poses that wait in the controller's buffer.

use std::fmt::Write as _;
use std::path::Path;

use bcap_core::slave::PoseType;

use crate::sample::{CYCLE, Sample};

/// The colours of the plotted elements.
const COLOURS: [&str; 3] = ["#1f77b4", "#d62728", "#2c8c3c"];
const GREY: &str = "#787878";

/// The size of a chart, and its margins at the left, at the top, at the right and at the bottom.
const SIZE: (f64, f64) = (1000.0, 333.0);
const MARGINS: [f64; 4] = [76.0, 34.0, 28.0, 48.0];

/// Draws a plot into a file.
pub fn plot(path: &Path, kind: PoseType, samples: &[Sample]) -> Result<(), String> {
    let failed = |error: &dyn std::fmt::Display| format!("cannot draw {}: {error}", path.display());
    if samples.len() < 2 {
        return Err(failed(&"a plot needs at least two cycles"));
    }
    std::fs::write(path, draw(kind, samples)).map_err(|error| failed(&error))
}

fn draw(kind: PoseType, samples: &[Sample]) -> String {
    let unit = if kind == PoseType::J { "deg" } else { "mm, deg" };
    let (mut poses, mut differences) = (Vec::new(), Vec::new());
    for (number, colour) in moving(kind, samples).into_iter().zip(COLOURS) {
        let name = kind.columns()[number];
        poses.push(Curve::of(samples, &format!("{name} commanded"), colour, 5, |s| s.commanded[number]));
        poses.push(Curve::of(samples, &format!("{name} actual"), colour, 1, |s| s.actual[number]));
        let difference = |s: &Sample| s.commanded[number] - s.actual[number];
        differences.push(Curve::of(samples, &format!("{name} commanded - actual"), colour, 1, difference));
    }
    let intervals = samples.windows(2).map(|pair| (pair[1].at, (pair[1].at - pair[0].at) * 1000.0)).collect();
    let (last, cycle) = (samples.last().map_or(0.0, |sample| sample.at), CYCLE * 1000.0);
    let times = [
        Curve { name: "8 ms".into(), colour: GREY, width: 1, points: vec![(0.0, cycle), (last, cycle)] },
        Curve { name: "from answer to answer".into(), colour: COLOURS[0], width: 1, points: intervals },
    ];
    let (width, height) = SIZE;
    let total = height * 3.0;
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width} {total}\" width=\"{width}\" height=\"{total}\" \
         font-family=\"sans-serif\" font-size=\"14\">\n<rect width=\"100%\" height=\"100%\" fill=\"white\"/>\n"
    );
    // the lower right of the cycles is free: only the poses that fill the buffer at the start have short ones
    for (n, (title, unit, legend_below, curves)) in
        [("Pose", unit, false, &poses[..]), ("Difference", unit, false, &differences), ("Cycle", "ms", true, &times)]
            .into_iter()
            .enumerate()
    {
        let _ = writeln!(svg, "<g transform=\"translate(0,{})\">", n as f64 * height);
        chart(&mut svg, title, unit, legend_below, curves);
        svg.push_str("</g>\n");
    }
    svg.push_str("</svg>\n");
    svg
}

/// A curve of a chart.
struct Curve {
    name: String,
    colour: &'static str,
    width: u32,
    points: Vec<(f64, f64)>,
}

impl Curve {
    fn of(samples: &[Sample], name: &str, colour: &'static str, width: u32, value: impl Fn(&Sample) -> f64) -> Self {
        let points = samples.iter().map(|sample| (sample.at, value(sample))).collect();
        Self { name: name.to_owned(), colour, width, points }
    }

    /// Returns the attributes of its line; a wide line is pale, so that a narrow one is visible on it.
    fn stroke(&self) -> String {
        let opacity = if self.width > 1 { 0.35 } else { 1.0 };
        format!("fill=\"none\" stroke=\"{}\" stroke-width=\"{}\" stroke-opacity=\"{opacity}\"", self.colour, self.width)
    }
}

fn chart(svg: &mut String, title: &str, unit: &str, legend_below: bool, curves: &[Curve]) {
    let points = || curves.iter().flat_map(|curve| curve.points.iter().copied());
    let end = points().map(|(at, _)| at).fold(CYCLE, f64::max);
    let (low, high) = range(points().map(|(_, y)| y));
    let room = ((high - low) * 0.08).max(0.01);
    let (low, high) = (low - room, high + room);
    let ([left, top, right, below], (width, height)) = (MARGINS, SIZE);
    let (right, bottom) = (width - right, height - below);
    let x = |at: f64| left + at / end * (right - left);
    let y = |value: f64| bottom - (value - low) / (high - low) * (bottom - top);
    let (times, values) = (ticks(0.0, end), ticks(low, high));
    let vertical = times.iter().map(|at| format!("M{:.1},{top}V{bottom}", x(*at)));
    let horizontal = values.iter().map(|value| format!("M{left},{:.1}H{right}", y(*value)));
    let grid: String = vertical.chain(horizontal).collect();
    let _ = writeln!(svg, "<path d=\"{grid}\" stroke=\"#e4e4e4\"/>");
    let _ = writeln!(svg, "<path d=\"M{left},{top}V{bottom}H{right}\" fill=\"none\" stroke=\"black\"/>");
    let mut text = |x: f64, y: f64, rest: &str, text: &str| {
        let _ = writeln!(svg, "<text x=\"{x:.1}\" y=\"{y:.1}\" {rest}>{text}</text>");
    };
    text(width / 2.0, top - 12.0, "text-anchor=\"middle\" font-size=\"20\"", title);
    text((left + right) / 2.0, height - 10.0, "text-anchor=\"middle\"", "time, s");
    text(14.0, top - 12.0, "", unit);
    times.iter().for_each(|at| text(x(*at), bottom + 18.0, "text-anchor=\"middle\"", &number(*at)));
    values.iter().for_each(|value| text(left - 8.0, y(*value) + 5.0, "text-anchor=\"end\"", &number(*value)));
    let from = if legend_below { bottom - 20.0 * curves.len() as f64 } else { top + 16.0 };
    for (curve, n) in curves.iter().zip(0_u8..) {
        text(right - 200.0, from + 20.0 * f64::from(n) + 5.0, "", &curve.name);
    }
    for (curve, n) in curves.iter().zip(0_u8..) {
        let points: String =
            curve.points.iter().map(|(at, value)| format!("{:.1},{:.1} ", x(*at), y(*value))).collect();
        let _ = writeln!(svg, "<polyline {} points=\"{}\"/>", curve.stroke(), points.trim_end());
        let row = from + 20.0 * f64::from(n);
        let _ = writeln!(svg, "<path {} d=\"M{:.1},{row:.1}h18\"/>", curve.stroke(), right - 226.0);
    }
}

/// Returns round numbers in a range, about eight.
fn ticks(low: f64, high: f64) -> Vec<f64> {
    let rough = (high - low) / 8.0;
    let power = 10.0_f64.powf(rough.log10().floor());
    let step = power * [1.0, 2.0, 5.0, 10.0].into_iter().find(|factor| factor * power >= rough).unwrap_or(10.0);
    let (first, last) = ((low / step).ceil(), (high / step).floor());
    std::iter::successors(Some(first), |n| Some(n + 1.0)).take_while(|n| *n <= last).map(|n| n * step).collect()
}

/// Formats a tick without the rounding errors of its computation; + 0.0 makes a negative zero positive.
fn number(value: f64) -> String {
    ((value * 1e6).round() / 1e6 + 0.0).to_string()
}

/// Returns the lowest and the highest value.
fn range(values: impl Iterator<Item = f64>) -> (f64, f64) {
    values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), value| (low.min(value), high.max(value)))
}

/// Returns the elements with the largest motion; the first element if none moved.
fn moving(kind: PoseType, samples: &[Sample]) -> Vec<usize> {
    /// The smallest range that counts as motion, in degrees or mm.
    const MOVED: f64 = 1e-3;
    let motion = |number: usize| {
        let (low, high) = range(samples.iter().map(|sample| sample.commanded[number]));
        high - low
    };
    let mut numbers: Vec<(usize, f64)> = (0..kind.len()).map(|number| (number, motion(number))).collect();
    numbers.sort_by(|(_, a), (_, b)| b.total_cmp(a));
    let moved = numbers.iter().filter(|(_, motion)| *motion > MOVED).take(COLOURS.len());
    let mut out: Vec<usize> = moved.map(|(number, _)| *number).collect();
    if out.is_empty() {
        out.push(0);
    }
    out.sort_unstable();
    out
}
