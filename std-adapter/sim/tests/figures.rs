//! The figures of `docs/motion.md`: this test draws them from the virtual controller, and compares them with the files.
//! `just figures` writes the files.

use std::ops::Range;
use std::path::PathBuf;

use bcap_core::bcap::call;
use bcap_core::hresult::HResult;
use bcap_sim::{ArmProfile, Config, Profile};
use plotters::prelude::*;

use crate::common::{World, code, doubles};

const COLOURS: [RGBColor; 4] =
    [RGBColor(31, 119, 180), RGBColor(214, 39, 40), RGBColor(44, 140, 60), RGBColor(148, 103, 189)];

/// The ends of the first motion that are drawn.
const PASSES: [&str; 4] = ["@0", "@P", "@50", "@E"];

/// A point of a record: the time in s, and the tool centre point in mm.
type Point = (f64, [f64; 3]);
/// The points of a line of a chart.
type Line = Vec<(f64, f64)>;
/// The lines of a chart with their names.
type Lines = Vec<(String, Line)>;

/// Draws a corner of two lines, 200 mm each, and returns the tool centre point every 8 ms.
fn corner(pass: &str) -> Vec<Point> {
    let mut world = World::with(Config::new(Profile::Rc8).with_arm(ArmProfile::Vs060.arm()));
    let client = world.mover(1);
    let robot = client.robot;
    let to = |x: f64, y: f64| format!("P({x},{y},400,180,0,180,-1)");
    let start = to(300.0, -100.0);
    assert_eq!(world.run(client.peer, call::robot_move(robot, 1, start.as_str(), "")), code(HResult::S_OK));
    let began = world.now;
    for pose in [format!("{pass} {}", to(300.0, 100.0)), format!("@E {}", to(500.0, 100.0))] {
        let line = call::robot_move(robot, 2, pose.as_str(), "SPEED=80,ACCEL=15,DECEL=15,NEXT");
        assert_eq!(world.call(client.peer, line), code(HResult::S_OK));
    }
    let mut points = Vec::new();
    loop {
        let position = doubles(&world.robot(client, "CurPos", ()).1);
        points.push((world.now.saturating_since(began).as_secs_f64(), [position[0], position[1], position[2]]));
        if !world.sim.is_moving() {
            return points;
        }
        world.pass(8);
    }
}

/// Returns the speed between the points of a record.
fn speeds(points: &[Point]) -> Vec<(f64, f64)> {
    let between = |pair: &[Point]| {
        let ((from, a), (to, b)) = (pair[0], pair[1]);
        let length = a.iter().zip(b).map(|(a, b)| (b - a).powi(2)).sum::<f64>().sqrt();
        ((from + to) / 2.0, length / (to - from))
    };
    points.windows(2).filter(|pair| pair[1].0 > pair[0].0).map(between).collect()
}

/// The content of a chart.
struct Chart<'a> {
    title: &'a str,
    /// The names of the axes.
    axes: (&'a str, &'a str),
    /// The digits after the point of their labels.
    digits: (usize, usize),
    /// The size of the figure, without [`SCALE`].
    size: (u32, u32),
    /// The part that is shown; `None` shows everything.
    part: Option<(Range<f64>, Range<f64>)>,
}

/// The backend rounds to whole units, so a figure is drawn larger than it is shown.
const SCALE: u32 = 4;

fn chart(Chart { title, axes, digits, size, part }: &Chart<'_>, lines: &Lines) -> String {
    let mut svg = String::new();
    let (width, height) = (size.0 * SCALE, size.1 * SCALE);
    {
        let root = SVGBackend::with_string(&mut svg, (width, height)).into_drawing_area();
        root.fill(&WHITE).unwrap();
        let (x, y) = part.clone().unwrap_or_else(|| (bounds(lines, |point| point.0), bounds(lines, |point| point.1)));
        let scaled = |n: u32| n * SCALE;
        let mut chart = ChartBuilder::on(&root)
            .caption(title, ("sans-serif", scaled(20)))
            .margin(scaled(12))
            .x_label_area_size(scaled(36))
            .y_label_area_size(scaled(64))
            .build_cartesian_2d(x, y)
            .unwrap();
        let style = ("sans-serif", scaled(14));
        let (x_label, y_label) = (|n: &f64| format!("{n:.0$}", digits.0), |n: &f64| format!("{n:.0$}", digits.1));
        let mut mesh = chart.configure_mesh();
        mesh.bold_line_style(BLACK.mix(0.15).stroke_width(SCALE)).max_light_lines(0);
        mesh.axis_style(BLACK.stroke_width(SCALE)).set_all_tick_mark_size(scaled(4));
        mesh.x_label_formatter(&x_label).y_label_formatter(&y_label);
        mesh.x_desc(axes.0).y_desc(axes.1).label_style(style).draw().unwrap();
        for (n, ((name, points), colour)) in lines.iter().zip(COLOURS).enumerate() {
            let stroke = colour.stroke_width(scaled(2));
            let shown = |(x, y): &&(f64, f64)| part.as_ref().is_none_or(|(xs, ys)| xs.contains(x) && ys.contains(y));
            let points = points.iter().filter(shown).copied();
            // the last line covers the first line, so it has gaps
            let drawn = match n + 1 == lines.len() {
                true => chart.draw_series(DashedLineSeries::new(points, scaled(8), scaled(8), stroke)),
                false => chart.draw_series(LineSeries::new(points, stroke)),
            };
            let key = move |(x, y): (i32, i32)| PathElement::new([(x, y), (x + 18 * SCALE as i32, y)], stroke);
            drawn.unwrap().label(name).legend(key);
        }
        let mut labels = chart.configure_series_labels();
        labels.legend_area_size(scaled(30)).margin(scaled(10)).label_font(style);
        labels.background_style(WHITE).border_style(BLACK.stroke_width(SCALE)).draw().unwrap();
        root.present().unwrap();
    }
    let drawn = format!("width=\"{width}\" height=\"{height}\"");
    svg.replacen(&drawn, &format!("width=\"{}\" height=\"{}\"", size.0, size.1), 1)
}

/// Returns the range of the values of all lines, with some room.
fn bounds(lines: &Lines, of: fn(&(f64, f64)) -> f64) -> Range<f64> {
    let values = lines.iter().flat_map(|(_, points)| points.iter().map(of));
    let (low, high) = values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), n| (low.min(n), high.max(n)));
    let room = (high - low) * 0.05;
    low - room..high + room
}

/// Compares a figure with its file, or writes the file.
fn figure(name: &str, svg: &str) {
    let path = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../docs/motion").join(name);
    assert!(svg.len() < 60_000, "{name} has {} bytes", svg.len());
    if std::env::var_os("FIGURES").is_some_and(|what| what == "write") {
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        return std::fs::write(&path, svg).unwrap();
    }
    let file = std::fs::read_to_string(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    assert!(file == svg, "{name} is not what the virtual controller does; `just figures` draws it again");
}

#[test]
fn the_figures_are_those_of_the_virtual_controller() {
    let records = PASSES.map(|pass| (pass, corner(pass)));
    let lines = |of: &dyn Fn(&[Point]) -> Line| -> Lines {
        records.iter().map(|(pass, points)| ((*pass).to_owned(), of(points))).collect()
    };
    let path = lines(&|points| points.iter().map(|(_, place)| (place[0], place[1])).collect());
    let position = lines(&|points| points.iter().map(|(at, place)| (*at, place[0] + place[1])).collect());
    let corner = Chart {
        title: "Path of the tool at the corner",
        axes: ("X, mm", "Y, mm"),
        digits: (0, 0),
        size: (560, 540),
        part: Some((294.0..414.0, -12.0..108.0)),
    };
    figure("path.svg", &chart(&corner, &path));
    let over_time = |title, y| Chart { title, axes: ("time, s", y), digits: (1, 0), size: (900, 420), part: None };
    figure("position.svg", &chart(&over_time("Position along the corner: X + Y", "mm"), &position));
    figure("speed.svg", &chart(&over_time("Speed of the tool", "mm/s"), &lines(&speeds)));
    // what the page says: @0 and @E come to rest at the corner, @P does not, @50 slows down more, and a pass takes less time
    let least = |pass: usize| {
        let speeds = speeds(&records[pass].1);
        let middle = &speeds[speeds.len() / 4..speeds.len() * 3 / 4];
        middle.iter().map(|(_, speed)| *speed).fold(f64::INFINITY, f64::min)
    };
    let [stop, pass, near, exact] = [least(0), least(1), least(2), least(3)];
    assert!(
        stop < pass / 10.0 && exact < pass / 10.0 && stop < near / 2.0 && near < pass,
        "{stop} {pass} {near} {exact}"
    );
    let [stop, pass, near, exact] = [0, 1, 2, 3].map(|pass| records[pass].1.last().unwrap().0);
    assert!(pass < near && near < stop && (exact - stop).abs() < 0.01, "{stop} {pass} {near} {exact}");
}
