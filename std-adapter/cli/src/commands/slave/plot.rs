//! The plot of a stream as SVG: commanded and actual poses, their difference, and the cycle times.
//!
//! The plot shows the elements of the pose with the largest motion, at most three. The difference is between the commanded
//! pose and the pose in its reply, so it includes the poses that wait in the controller's buffer.

use std::path::Path;

use bcap_core::slave::PoseType;
use plotters::coord::Shift;
use plotters::prelude::*;

use super::sample::{CYCLE, Sample};
use crate::failure::Failure;

const SIZE: (u32, u32) = (1000, 1000);
/// The colours of the plotted elements.
const COLOURS: [RGBColor; 3] = [RGBColor(31, 119, 180), RGBColor(214, 39, 40), RGBColor(44, 140, 60)];
const GREY: RGBColor = RGBColor(120, 120, 120);

type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;
type Drawn = Result<(), Box<dyn std::error::Error>>;

/// Draws a plot into a file.
pub(crate) fn plot(path: &Path, kind: PoseType, samples: &[Sample]) -> Result<(), Failure> {
    if samples.len() < 2 {
        return Err(Failure::Input(format!("cannot draw {}: a plot needs at least two cycles", path.display())));
    }
    draw(path, kind, samples).map_err(|error| Failure::Input(format!("cannot draw {}: {error}", path.display())))
}

fn draw(path: &Path, kind: PoseType, samples: &[Sample]) -> Drawn {
    let root = SVGBackend::new(path, SIZE).into_drawing_area();
    root.fill(&WHITE)?;
    let areas = root.split_evenly((3, 1));
    let [poses, errors, times] = areas.as_slice() else { return Ok(()) };
    let shown = moving(kind, samples);
    let unit = if kind == PoseType::J { "deg" } else { "mm, deg" };

    let mut lines = Vec::new();
    for (number, colour) in shown.iter().copied().zip(COLOURS) {
        let name = kind.columns()[number];
        lines.push(Line::of(samples, &format!("{name} commanded"), colour.mix(0.35), 5, |s| s.commanded[number]));
        lines.push(Line::of(samples, &format!("{name} actual"), colour.to_rgba(), 1, |s| s.actual[number]));
    }
    chart(poses, "Pose", unit, SeriesLabelPosition::UpperRight, &lines)?;

    let lines: Vec<Line> = shown
        .iter()
        .copied()
        .zip(COLOURS)
        .map(|(number, colour)| {
            let name = format!("{} commanded - actual", kind.columns()[number]);
            Line::of(samples, &name, colour.to_rgba(), 1, |s| s.commanded[number] - s.actual[number])
        })
        .collect();
    chart(errors, "Difference", unit, SeriesLabelPosition::UpperRight, &lines)?;

    let intervals = samples.windows(2).map(|pair| (pair[1].at, (pair[1].at - pair[0].at) * 1000.0)).collect();
    let last = samples.last().map_or(0.0, |sample| sample.at);
    let cycle = CYCLE * 1000.0;
    let lines = [
        Line { name: "8 ms".into(), colour: GREY.to_rgba(), width: 1, points: vec![(0.0, cycle), (last, cycle)] },
        Line { name: "from answer to answer".into(), colour: COLOURS[0].to_rgba(), width: 1, points: intervals },
    ];
    // the lower right is free: only the poses that fill the buffer at the start have short cycles
    chart(times, "Cycle", "ms", SeriesLabelPosition::LowerRight, &lines)?;
    root.present()?;
    Ok(())
}

/// A line of a chart.
struct Line {
    name: String,
    colour: RGBAColor,
    width: u32,
    points: Vec<(f64, f64)>,
}

impl Line {
    fn of(samples: &[Sample], name: &str, colour: RGBAColor, width: u32, value: impl Fn(&Sample) -> f64) -> Self {
        let points = samples.iter().map(|sample| (sample.at, value(sample))).collect();
        Self { name: name.to_owned(), colour, width, points }
    }
}

fn chart(area: &Area<'_>, title: &str, unit: &str, legend: SeriesLabelPosition, lines: &[Line]) -> Drawn {
    let points = || lines.iter().flat_map(|line| line.points.iter().copied());
    let end = points().map(|(at, _)| at).fold(0.0, f64::max);
    let (low, high) =
        points().fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), (_, y)| (low.min(y), high.max(y)));
    let room = ((high - low) * 0.08).max(0.01);
    let mut chart = ChartBuilder::on(area)
        .caption(title, ("sans-serif", 20))
        .margin(12)
        .margin_right(28)
        .x_label_area_size(36)
        .y_label_area_size(64)
        .build_cartesian_2d(0.0..end.max(CYCLE), low - room..high + room)?;
    chart
        .configure_mesh()
        .light_line_style(WHITE)
        .x_desc("time, s")
        .y_desc(unit)
        .label_style(("sans-serif", 14))
        .draw()?;
    for line in lines {
        let style = line.colour.stroke_width(line.width);
        chart
            .draw_series(LineSeries::new(line.points.iter().copied(), style))?
            .label(line.name.as_str())
            .legend(move |(x, y)| PathElement::new([(x, y), (x + 18, y)], style));
    }
    chart
        .configure_series_labels()
        .position(legend)
        .legend_area_size(36)
        .background_style(WHITE.mix(0.85))
        .border_style(GREY)
        .label_font(("sans-serif", 14))
        .draw()?;
    Ok(())
}

/// Returns the elements with the largest motion; the first element if none moved.
fn moving(kind: PoseType, samples: &[Sample]) -> Vec<usize> {
    /// The smallest range that counts as motion, in degrees or mm.
    const MOVED: f64 = 1e-3;
    let range = |number: usize| {
        let values = samples.iter().map(|sample| sample.commanded[number]);
        let (low, high) = values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| (low.min(v), high.max(v)));
        high - low
    };
    let mut numbers: Vec<(usize, f64)> = (0..kind.len()).map(|number| (number, range(number))).collect();
    numbers.sort_by(|(_, a), (_, b)| b.total_cmp(a));
    let mut out: Vec<usize> =
        numbers.iter().filter(|(_, range)| *range > MOVED).take(COLOURS.len()).map(|(number, _)| *number).collect();
    if out.is_empty() {
        out.push(0);
    }
    out.sort_unstable();
    out
}
