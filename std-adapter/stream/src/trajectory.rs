//! A file of the trajectory of an arm, as MCAP if the name ends with `.mcap`, otherwise as CSV.

use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::Path;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use bcap_capture::mcap::{self, Schema};
use bcap_core::time::Instant;
use serde_json::{Value, json};

const HEAD: &str = "time_s,J1,J2,J3,J4,J5,J6,J7,J8,X,Y,Z,RX,RY,RZ,tool,work";

/// The maximum number of lines that are not in the file, about a second of motion.
const LINES: u32 = 125;

/// The schema of a point in an MCAP file, in degrees and mm.
const SCHEMA: Schema = Schema {
    name: "bcap.Arm",
    json: r#"{"type":"object","properties":{
        "joints":{"type":"object","properties":{"J1":{"type":"number"},"J2":{"type":"number"},"J3":{"type":"number"},
            "J4":{"type":"number"},"J5":{"type":"number"},"J6":{"type":"number"},"J7":{"type":"number"},
            "J8":{"type":"number"}}},
        "position":{"type":"object","properties":{"X":{"type":"number"},"Y":{"type":"number"},"Z":{"type":"number"},
            "RX":{"type":"number"},"RY":{"type":"number"},"RZ":{"type":"number"}}},
        "tool":{"type":"integer"},"work":{"type":"integer"}}}"#,
};

/// A point of a trajectory: joints in degrees or mm, and the position of the tool in mm and degrees.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Point {
    /// The controller's time.
    pub at: Instant,
    /// The joints; those that the robot does not have are 0.
    pub axes: [f64; 8],
    /// X, Y, Z, RX, RY and RZ in the work coordinates.
    pub position: [f64; 6],
    /// The tool.
    pub tool: i32,
    /// The work coordinates.
    pub work: i32,
}

/// A file of a trajectory, which several threads may use.
#[derive(Clone, Debug)]
pub struct Trajectory(Arc<Mutex<Output>>);

/// The file, and the first failure, after which nothing is written.
#[derive(Debug)]
struct Output {
    format: Format,
    failed: Option<io::Error>,
}

#[derive(Debug)]
enum Format {
    Csv(CsvFile<File>),
    Mcap(Box<Points<BufWriter<File>>>),
}

/// The messages of an MCAP file.
#[derive(Debug)]
struct Points<W: Write> {
    series: mcap::Log<W>,
    /// The wall clock at the controller's time 0, in microseconds since 1970.
    origin: u64,
}

/// The lines that are written to `out`.
#[derive(Debug)]
struct CsvFile<W: Write> {
    out: BufWriter<W>,
    last: Option<Point>,
    /// The lines that are not in the file yet.
    waiting: u32,
}

impl Trajectory {
    /// Creates the file; an existing file is replaced. `origin_ms` is the wall clock at the controller's time 0.
    ///
    /// # Errors
    ///
    /// When the file cannot be written.
    pub fn create(path: &Path, origin_ms: i64) -> io::Result<Self> {
        let is_mcap = path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("mcap"));
        let format = if is_mcap {
            let out = BufWriter::new(File::create(path)?);
            Format::Mcap(Box::new(Points::new(out, origin_ms)?))
        } else {
            Format::Csv(CsvFile::new(File::create(path)?)?)
        };
        Ok(Self(Arc::new(Mutex::new(Output { format, failed: None }))))
    }

    /// Writes a point, unless an earlier point failed.
    pub fn add(&self, point: &Point) {
        self.lock().add(point);
    }

    /// Writes the rest.
    ///
    /// # Errors
    ///
    /// The first failure since the beginning.
    pub fn end(&self) -> io::Result<()> {
        let Output { format, failed } = &mut *self.lock();
        match (failed.take(), format) {
            (Some(error), _) => Err(error),
            (None, Format::Csv(lines)) => lines.out.flush(),
            (None, Format::Mcap(points)) => points.series.end(),
        }
    }

    fn lock(&self) -> MutexGuard<'_, Output> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Output {
    fn add(&mut self, point: &Point) {
        if self.failed.is_none() {
            self.failed = match &mut self.format {
                Format::Csv(lines) => lines.add(point),
                Format::Mcap(points) => points.add(point),
            }
            .err();
        }
    }
}

impl<W: Write> Points<W> {
    fn new(out: W, origin_ms: i64) -> io::Result<Self> {
        let origin = u64::try_from(origin_ms).unwrap_or(0).saturating_mul(1000);
        Ok(Self { series: mcap::Log::new(out)?, origin })
    }

    fn add(&mut self, point: &Point) -> io::Result<()> {
        let at = self.origin.saturating_add(point.at.as_micros()).saturating_mul(1000);
        let joints: serde_json::Map<String, Value> =
            (1..).zip(point.axes).map(|(n, joint)| (format!("J{n}"), rounded(joint).into())).collect();
        let [x, y, z, rx, ry, rz] = point.position.map(rounded);
        let position = json!({ "X": x, "Y": y, "Z": z, "RX": rx, "RY": ry, "RZ": rz });
        let message = json!({ "joints": joints, "position": position, "tool": point.tool, "work": point.work });
        self.series.push("/arm", SCHEMA, at, &message)
    }
}

/// Rounds to a millionth. + 0.0 makes a negative zero positive.
fn rounded(n: f64) -> f64 {
    (n * 1e6).round() / 1e6 + 0.0
}

impl<W: Write> CsvFile<W> {
    fn new(file: W) -> io::Result<Self> {
        let mut out = BufWriter::new(file);
        writeln!(out, "{HEAD}")?;
        out.flush()?;
        Ok(Self { out, last: None, waiting: 0 })
    }

    fn add(&mut self, point: &Point) -> io::Result<()> {
        write!(self.out, "{:.6}", point.at.as_micros() as f64 / 1e6)?;
        point.axes.iter().chain(&point.position).try_for_each(|n| write!(self.out, ",{}", rounded(*n)))?;
        writeln!(self.out, ",{},{}", point.tool, point.work)?;
        let rests = self.last.replace(*point).is_some_and(|last| last.axes == point.axes);
        self.waiting += 1;
        if !rests && self.waiting < LINES {
            return Ok(());
        }
        self.waiting = 0;
        self.out.flush()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_point_is_a_line_of_numbers() {
        let mut lines = CsvFile::new(Vec::new()).unwrap();
        let axes = [0.1, -0.0, 90.0, 1e-9, 45.0, -30.123_456_7, 0.0, 0.0];
        let position = [364.16, 0.0, 278.5355, 180.0, 0.0, -180.0];
        lines.add(&Point { at: Instant::from_micros(8_500), axes, position, tool: 1, work: 2 }).unwrap();
        lines.out.flush().unwrap();
        let text = String::from_utf8(lines.out.into_inner().unwrap()).unwrap();
        let line = "0.008500,0.1,0,90,0,45,-30.123457,0,0,364.16,0,278.5355,180,0,-180,1,2";
        assert_eq!(text, format!("{HEAD}\n{line}\n"));
    }

    #[test]
    fn a_point_is_a_message_with_its_time() {
        let mut bytes = Vec::new();
        let mut points = Points::new(&mut bytes, 1_700_000_000_123).unwrap();
        let axes = [0.1, -0.0, 90.0, 1e-9, 45.0, -30.123_456_7, 0.0, 0.0];
        let position = [364.16, 0.0, 278.5355, 180.0, 0.0, -180.0];
        points.add(&Point { at: Instant::from_micros(8_500), axes, position, tool: 1, work: 2 }).unwrap();
        points.series.end().unwrap();
        drop(points);
        let messages: Vec<_> = ::mcap::MessageStream::new(&bytes).unwrap().map(Result::unwrap).collect();
        let [message] = messages.as_slice() else { panic!("{} messages", messages.len()) };
        assert_eq!((message.log_time, message.channel.topic.as_str()), (1_700_000_000_131_500_000, "/arm"));
        let value: Value = serde_json::from_slice(&message.data).unwrap();
        assert_eq!([&value["joints"]["J6"], &value["position"]["Z"]], [&json!(-30.123_457), &json!(278.5355)]);
        assert_eq!([&value["tool"], &value["work"]], [&json!(1), &json!(2)]);
        let schema = message.channel.schema.as_ref().unwrap();
        let schema: Value = serde_json::from_slice(&schema.data).unwrap();
        // the schema names each field of the message
        for (part, fields) in value.as_object().unwrap() {
            for field in fields.as_object().into_iter().flat_map(|fields| fields.keys()) {
                assert_eq!(schema["properties"][part]["properties"][field]["type"], "number", "{part} {field}");
            }
        }
    }

    #[test]
    fn the_first_failure_is_told() {
        // a device that is always full
        let Ok(full) = File::options().write(true).open("/dev/full") else { return };
        let lines = CsvFile { out: BufWriter::new(full), last: None, waiting: 0 };
        let format = Format::Csv(lines);
        let trajectory = Trajectory(Arc::new(Mutex::new(Output { format, failed: None })));
        for n in 0..300 {
            let (at, axes) = (Instant::from_millis(n), [n as f64; 8]);
            trajectory.lock().add(&Point { at, axes, position: [0.0; 6], tool: 0, work: 0 });
        }
        assert_eq!(trajectory.end().unwrap_err().kind(), io::ErrorKind::StorageFull);
    }
}
