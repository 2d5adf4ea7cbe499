//! Files of poses: CSV with one pose per line, and the interpolation to one pose per cycle.
//!
//! ```text
//!   t,J1,J2,...,MINI       optional column names; `t` in seconds, outputs as numbers
//!   0.000,0,45,...,0x30    a pose
//! ```
//!
//! Poses are interpolated by Catmull-Rom splines with the file's times, so the speed is continuous. Angles of P poses take
//! the shorter direction. Outputs change at the time of their line.

use std::path::Path;

use bcap_core::slave::{Extended, ExtendedAxes, Pose, PoseType, SendFormat};

use crate::outputs::{self, OutputBits, parse_bits};

/// The maximum duration of a stream, in seconds.
const LONGEST: f64 = 24.0 * 3600.0;

/// Returns the columns of the extended joints, which a J pose has among its own.
const fn extended_columns(kind: PoseType, extended: ExtendedAxes) -> &'static [&'static str] {
    match (kind, extended) {
        (PoseType::J, _) | (_, ExtendedAxes::None) => &[],
        (_, ExtendedAxes::Seven) => &["J7"],
        (_, ExtendedAxes::Eight) => &["J8"],
        (_, ExtendedAxes::Both) => &["J7", "J8"],
    }
}

/// Returns the extended joints with these values.
const fn extended_joints(axes: ExtendedAxes, seven: f64, eight: f64) -> Option<Extended> {
    match axes {
        ExtendedAxes::None => None,
        ExtendedAxes::Seven => Some(Extended::Seven(seven)),
        ExtendedAxes::Eight => Some(Extended::Eight(eight)),
        ExtendedAxes::Both => Some(Extended::Both(seven, eight)),
    }
}

/// The poses of a file with their times, in seconds from the first pose.
#[derive(Debug)]
pub struct Poses {
    /// The type of the poses.
    pub kind: PoseType,
    extended: ExtendedAxes,
    rows: Vec<(f64, Vec<f64>)>,
    /// For each row.
    outputs: Vec<OutputBits>,
}

impl Poses {
    /// Reads a file.
    pub fn read(path: &Path, kind: Option<PoseType>, extended: ExtendedAxes, hz: f64) -> Result<Self, String> {
        let text = std::fs::read_to_string(path).map_err(|error| format!("cannot read {}: {error}", path.display()))?;
        Self::parse(&text, kind, extended, hz).map_err(|problem| format!("{}: {problem}", path.display()))
    }

    fn parse(text: &str, kind: Option<PoseType>, extended: ExtendedAxes, hz: f64) -> Result<Self, String> {
        // a spreadsheet may begin its file with a byte order mark, and write quotes around a name or a number
        let text = text.strip_prefix('\u{feff}').unwrap_or(text);
        let mut layout: Option<Layout> = None;
        let mut rows: Vec<(f64, Vec<f64>)> = Vec::new();
        let mut outputs = Vec::new();
        for (text, line) in text.lines().zip(1_u32..).filter(|(text, _)| !text.is_empty() && !text.starts_with('#')) {
            let fields: Vec<&str> = text.split(',').map(|field| field.trim().trim_matches('"').trim()).collect();
            let Some(layout) = &layout else {
                let (found, is_header) =
                    Layout::of(&fields, kind, extended).map_err(|problem| format!("line {line}: {problem}"))?;
                let found = layout.insert(found);
                if !is_header {
                    outputs.push(OutputBits::default());
                    rows.push(found.row(&fields, 0, hz).map_err(|problem| format!("line {line}: {problem}"))?);
                }
                continue;
            };
            let (at, numbers) =
                layout.row(&fields, rows.len(), hz).map_err(|problem| format!("line {line}: {problem}"))?;
            if let Some((before, _)) = rows.last()
                && at <= *before
            {
                return Err(format!("line {line}: the time {at} s is not after the previous time {before} s"));
            }
            rows.push((at, numbers));
            outputs.push(layout.outputs(&fields).map_err(|problem| format!("line {line}: {problem}"))?);
        }
        let (Some(layout), Some((begin, _))) = (layout, rows.first()) else {
            return Err("the file has no pose; write one pose per line, such as 0,45,90".into());
        };
        let (kind, begin) = (layout.kind, *begin);
        rows.iter_mut().for_each(|(at, _)| *at -= begin);
        if let Some((end, _)) = rows.last().filter(|(end, _)| *end > LONGEST) {
            return Err(format!("the poses last {end} s, more than a day; t is in seconds"));
        }
        if kind == PoseType::P {
            unwind(&mut rows);
        }
        Ok(Self { kind, extended, rows, outputs })
    }

    /// Checks that the format of slvMove carries the outputs of the file.
    pub fn check_outputs(&self, send: SendFormat) -> Result<(), String> {
        self.outputs.iter().try_for_each(|OutputBits { mini, user, hand }| {
            outputs::check(send, ["column MINI", "column USER", "column HAND"], [*mini, *user, *hand])
        })
    }

    /// Returns the first pose.
    pub fn first(&self) -> Option<Pose> {
        self.rows.first().and_then(|(_, numbers)| self.pose(numbers))
    }

    /// Returns a pose for each cycle, from the first pose of the file to its last.
    pub fn each_cycle(&self, cycle: f64) -> Vec<Pose> {
        let moments = self.moments(cycle).into_iter();
        moments.filter_map(|(row, at)| self.pose(&self.at(row, at, cycle))).collect()
    }

    /// Returns the outputs for each cycle.
    pub fn each_outputs(&self, cycle: f64) -> Vec<OutputBits> {
        let moments = self.moments(cycle).into_iter();
        moments.map(|(row, _)| self.outputs.get(row).copied().unwrap_or_default()).collect()
    }

    /// Returns the time of each cycle, and the last row before it.
    fn moments(&self, cycle: f64) -> Vec<(usize, f64)> {
        let end = self.rows.last().map_or(0.0, |(at, _)| *at);
        // the tolerance keeps the last cycle despite rounding
        let count = (end / cycle + 1e-6).floor();
        let mut out = Vec::new();
        let (mut index, mut row) = (0.0, 0);
        while index <= count {
            let at = index * cycle;
            while self.rows.get(row + 1).is_some_and(|(next, _)| *next <= at + cycle * 1e-6) {
                row += 1;
            }
            out.push((row, at));
            index += 1.0;
        }
        if end - count * cycle > cycle * 1e-3 {
            // the file ends inside a cycle
            out.push((self.rows.len() - 1, end));
        }
        out
    }

    /// Creates a pose from the numbers of a row.
    fn pose(&self, numbers: &[f64]) -> Option<Pose> {
        let own = numbers.get(..self.kind.len()).unwrap_or(numbers);
        let number = |at: usize| numbers.get(at).copied().unwrap_or(0.0);
        let first = self.kind.len();
        let (seven, eight) = match (self.kind, self.extended) {
            (PoseType::J, _) => (number(6), number(7)),
            (_, ExtendedAxes::Eight) => (0.0, number(first)),
            _ => (number(first), number(first + 1)),
        };
        let pose = Pose::from_numbers(self.kind, own)?;
        Some(extended_joints(self.extended, seven, eight).map_or(pose, |joints| pose.with_extended(joints)))
    }

    /// Returns the interpolated numbers at a time between a row and the next row.
    fn at(&self, row: usize, at: f64, cycle: f64) -> Vec<f64> {
        let (from, numbers) = &self.rows[row];
        let Some((to, next)) = self.rows.get(row + 1).filter(|_| at - from > cycle * 1e-6) else {
            return numbers.clone();
        };
        let (length, part) = (to - from, (at - from) / (to - from));
        let mut out = Vec::with_capacity(numbers.len());
        for column in 0..numbers.len() {
            let (a, b) = (numbers[column], next[column]);
            let is_figure = self.kind != PoseType::J && column + 1 == self.kind.len();
            out.push(if is_figure {
                a
            } else {
                hermite(a, b, self.slope(row, column) * length, self.slope(row + 1, column) * length, part)
            });
        }
        if self.kind == PoseType::T {
            normalize(&mut out, 3);
            normalize(&mut out, 6);
        }
        out
    }

    /// Returns the slope of a column at a row: the slope between its neighbours, and 0 at the ends.
    fn slope(&self, row: usize, column: usize) -> f64 {
        let before = row.checked_sub(1).and_then(|before| self.rows.get(before));
        match (before, self.rows.get(row + 1)) {
            (Some((from, a)), Some((to, b))) => (b[column] - a[column]) / (to - from),
            _ => 0.0,
        }
    }
}

/// Evaluates the cubic Hermite curve from `a` to `b` with these slopes at its ends.
fn hermite(a: f64, b: f64, slope_a: f64, slope_b: f64, x: f64) -> f64 {
    let (x2, x3) = (x * x, x * x * x);
    a * (2.0 * x3 - 3.0 * x2 + 1.0) + b * (3.0 * x2 - 2.0 * x3) + slope_a * (x3 - 2.0 * x2 + x) + slope_b * (x3 - x2)
}

fn normalize(numbers: &mut [f64], from: usize) {
    let length = numbers[from..from + 3].iter().map(|n| n * n).sum::<f64>().sqrt();
    if length > 0.0 {
        numbers[from..from + 3].iter_mut().for_each(|n| *n /= length);
    }
}

/// Unwraps the angles (no steps above 180 degrees), so that they can be interpolated.
fn unwind(rows: &mut [(f64, Vec<f64>)]) {
    for column in 3..6 {
        let mut last: Option<f64> = None;
        for (_, numbers) in rows.iter_mut() {
            if let Some(last) = last {
                numbers[column] -= ((numbers[column] - last) / 360.0_f64).round() * 360.0;
            }
            last = Some(numbers[column]);
        }
    }
}

/// The columns of a file.
struct Layout {
    kind: PoseType,
    time: Option<usize>,
    /// The column of each number.
    numbers: Vec<usize>,
    /// The columns MINI, USER and HAND.
    outputs: [Option<usize>; 3],
    /// The number of fields in a line.
    fields: usize,
}

impl Layout {
    /// Determines the columns from the first line; also returns whether that line is a header.
    fn of(fields: &[&str], kind: Option<PoseType>, extended: ExtendedAxes) -> Result<(Self, bool), String> {
        if fields.iter().all(|field| field.parse::<f64>().is_ok()) {
            let kind = kind.unwrap_or(PoseType::J);
            let expected = kind.columns().len() + extended_columns(kind, extended).len();
            if fields.len() > expected || (kind != PoseType::J && fields.len() < expected) {
                let found = fields.len();
                return Err(format!(
                    "it has {found} numbers, but a pose of type {kind:?} has {expected}; name the columns in the first line"
                ));
            }
            let numbers = (0..fields.len()).collect();
            return Ok((Self { kind, time: None, numbers, outputs: [None; 3], fields: fields.len() }, false));
        }
        let find = |name: &str| fields.iter().position(|field| field.eq_ignore_ascii_case(name));
        let has = |kind: PoseType| kind.columns().iter().all(|name| find(name).is_some());
        let kind = kind.unwrap_or(match () {
            () if find("J1").is_some() => PoseType::J,
            () if has(PoseType::P) => PoseType::P,
            () if has(PoseType::T) => PoseType::T,
            () => PoseType::J,
        });
        // trailing joints may be missing, but no joint in between
        let names = [kind.columns(), extended_columns(kind, extended)].concat();
        let numbers: Vec<usize> = names.iter().map_while(|name| find(name)).collect();
        if numbers.is_empty() || (kind != PoseType::J && numbers.len() < names.len()) {
            return Err(format!("a pose of type {kind:?} needs the columns {}", names.join(",")));
        }
        if let Some(later) = names.iter().skip(numbers.len()).find(|name| find(name).is_some()) {
            return Err(format!("it has the column {later}, but not {}", names[numbers.len()]));
        }
        let outputs = ["MINI", "USER", "HAND"].map(find);
        Ok((Self { kind, time: find("t"), numbers, outputs, fields: fields.len() }, true))
    }

    /// Reads a line.
    fn row(&self, fields: &[&str], index: usize, hz: f64) -> Result<(f64, Vec<f64>), String> {
        if fields.len() != self.fields {
            return Err(format!("it has {} fields, but the first line has {}", fields.len(), self.fields));
        }
        let number = |column: usize| {
            let field = fields[column];
            let number = field.parse::<f64>().ok().filter(|number| number.is_finite());
            number.ok_or_else(|| format!("field {}: {field:?} is not a finite number", column + 1))
        };
        let at = match self.time {
            Some(column) => number(column)?,
            None => index as f64 / hz,
        };
        Ok((at, self.numbers.iter().map(|column| number(*column)).collect::<Result<_, _>>()?))
    }

    /// Reads the outputs of a line, which has as many fields as the first line.
    fn outputs(&self, fields: &[&str]) -> Result<OutputBits, String> {
        let read = |column: Option<usize>| {
            let field = column.and_then(|column| fields.get(column).map(|field| (column + 1, field)));
            let bits = field.map(|(number, field)| {
                parse_bits(field).map_err(|problem| format!("field {number}: {field:?}: {problem}"))
            });
            bits.transpose()
        };
        let [mini, user, hand] = self.outputs;
        Ok(OutputBits { mini: read(mini)?, user: read(user)?, hand: read(hand)? })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(text: &str) -> Result<Poses, String> {
        Poses::parse(text, None, ExtendedAxes::None, 125.0)
    }

    fn first_column(poses: &Poses) -> Vec<f64> {
        poses.each_cycle(0.008).iter().map(|pose| pose.numbers()[0]).collect()
    }

    #[test]
    fn poses_at_the_rate_of_the_cycle_are_not_changed() {
        let poses = parse("1,2,3\n4,5,6\n4.5,0.1,1e-3\n").unwrap();
        assert_eq!(first_column(&poses), [1.0, 4.0, 4.5]);
        assert_eq!(poses.each_cycle(0.008)[2].numbers(), [4.5, 0.1, 1e-3, 0.0, 0.0, 0.0, 0.0, 0.0]);
    }

    #[test]
    fn slower_files_are_interpolated_with_continuous_speed() {
        let text: String = (0..=10).map(|n| format!("{}\n", f64::from(n * n))).collect();
        let poses = Poses::parse(&text, None, ExtendedAxes::None, 25.0).unwrap();
        let each = first_column(&poses);
        assert_eq!(each.len(), 51);
        // the rows are exact; between inner rows the curve is the parabola, and it starts and ends at rest
        assert_eq!((each[0], each[5], each[50]), (0.0, 1.0, 100.0));
        for (n, value) in each.iter().enumerate().take(46).skip(5) {
            let exact = (n as f64 / 5.0).powi(2);
            assert!((value - exact).abs() < 1e-9, "{n}: {value} {exact}");
        }
    }

    #[test]
    fn columns_are_found_by_their_names() {
        let poses =
            parse("FIG,rz,ry,rx,Z,Y,X,note,t\n5,179,0,180,3,2,1,7,2.000\n5,-179,0,-180,3,2,1.5,8,2.016\n").unwrap();
        assert_eq!(poses.kind, PoseType::P);
        let each = poses.each_cycle(0.008);
        assert_eq!(each.len(), 3);
        assert_eq!(each[0].numbers(), [1.0, 2.0, 3.0, 180.0, 0.0, 179.0, 5.0]);
        // the shorter direction, through 180 degrees
        let expected = [1.25, 2.0, 3.0, 180.0, 0.0, 180.0, 5.0];
        for (found, expected) in each[1].numbers().iter().zip(expected) {
            assert!((found - expected).abs() < 1e-9, "{:?}", each[1]);
        }
        assert_eq!(each[2].numbers()[5], 181.0);
        // a byte order mark is not part of a name
        assert_eq!(parse("\u{feff}t,J1\n0,1\n1,2\n").unwrap().each_cycle(0.5).len(), 3);
        assert_eq!(parse("x,y,z,ox,oy,oz,ax,ay,az,fig\n1,2,3,1,0,0,0,1,0,5").unwrap().kind, PoseType::T);
    }

    #[test]
    fn outputs_hold_from_line_to_line() {
        let poses = parse("t,J1,MINI,HAND\n0,0,0x30000,1\n0.016,1,0,2\n").unwrap();
        let set = |mini, hand| OutputBits { mini: Some(mini), user: None, hand: Some(hand) };
        assert_eq!(poses.each_outputs(0.008), [set(0x30000, 1), set(0x30000, 1), set(0, 2)]);
        assert_eq!(parse("1\n2\n").unwrap().each_outputs(0.008), [OutputBits::default(); 2]);
        assert!(parse("J1,MINI\n0,on\n").unwrap_err().contains("line 2: field 2: \"on\": write a number"));
    }

    #[test]
    fn extended_joints_are_columns_or_follow_the_pose() {
        let parse = |text: &str, axes| Poses::parse(text, None, axes, 125.0);
        let last = |poses: Poses| poses.each_cycle(0.008).last().map(|pose| pose.as_slice().to_vec()).unwrap();
        let [option7, option8, both] = [0x40, 0x80, 0xc0].map(|bits| f64::from(0x0040_0000 | bits));
        let named = "X,Y,Z,RX,RY,RZ,FIG,J8,J7\n1,2,3,4,5,6,5,80,70\n";
        let pose = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 5.0];
        for (axes, more) in [
            (ExtendedAxes::Seven, &[option7, 70.0][..]),
            (ExtendedAxes::Eight, &[option8, 80.0]),
            (ExtendedAxes::Both, &[both, 70.0, 80.0]),
        ] {
            assert_eq!(last(parse(named, axes).unwrap()), [&pose[..], more].concat());
        }
        let joints = last(parse("1,2,3,4,5,6,7,8\n", ExtendedAxes::Both).unwrap());
        assert_eq!(joints, [1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, both]);
        let error = parse("X,Y,Z,RX,RY,RZ,FIG,J8\n1,2,3,4,5,6,5,80\n", ExtendedAxes::Seven).unwrap_err();
        assert!(error.contains("needs the columns X,Y,Z,RX,RY,RZ,FIG,J7"), "{error}");
    }

    #[test]
    fn errors_name_the_line_and_the_field() {
        for (text, problem) in [
            ("", "the file has no pose"),
            ("J1,J2\n", "the file has no pose"),
            ("1,2\n3,x\n", "line 2: field 2: \"x\" is not a finite number"),
            ("1,2\n3\n", "line 2: it has 1 fields, but the first line has 2"),
            ("1,2,3,4,5,6,7,8,9\n", "line 1: it has 9 numbers, but a pose of type J has 8"),
            ("t,J1\n0,1\n0,2\n", "line 3: the time 0 s is not after the previous time 0 s"),
            ("a,b\n1,2\n", "line 1: a pose of type J needs the columns J1,J2"),
            ("t,J1,J2,J4\n0,1,2,4\n", "line 1: it has the column J4, but not J3"),
            ("t,J1\n0,1\n10000000000,2\n", "the poses last 10000000000 s, more than a day; t is in seconds"),
            ("J1\nnan\n", "line 2: field 1: \"nan\" is not a finite number"),
        ] {
            let error = parse(text).unwrap_err();
            assert!(error.contains(problem), "{text:?}: {error}");
        }
    }
}
