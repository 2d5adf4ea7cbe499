//! The file of `bcap sim --record`: the trajectory of the arm as CSV.

use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::Path;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use bcap_sim::trace::{Recorder, TracePoint};

use crate::error::Failure;

const HEAD: &str = "time_s,J1,J2,J3,J4,J5,J6,J7,J8,X,Y,Z,RX,RY,RZ,tool,work";

/// The number of lines after which the file is written at the latest, about a second of motion.
const LINES: u32 = 125;

/// A file of a trajectory.
#[derive(Clone, Debug)]
pub(crate) struct Trajectory(Arc<Mutex<Lines<File>>>);

/// The lines that are written to `out`.
#[derive(Debug)]
struct Lines<W: Write> {
    out: BufWriter<W>,
    last: Option<TracePoint>,
    /// The lines that are not in the file yet.
    waiting: u32,
    /// The first failure; nothing is written after it.
    failed: Option<io::Error>,
}

impl Trajectory {
    /// Creates the file, in place of one that exists.
    pub(crate) fn create(path: &Path) -> Result<Self, Failure> {
        let failed = |error: io::Error| Failure::Input(format!("--record {}: {error}", path.display()));
        let lines = Lines::new(File::create(path).map_err(failed)?).map_err(failed)?;
        Ok(Self(Arc::new(Mutex::new(lines))))
    }

    /// Returns the recorder that writes this file.
    pub(crate) fn recorder(&self) -> Recorder {
        let lines = self.clone();
        Recorder::new(move |point| lines.lock().add(point))
    }

    /// Writes the rest, and tells the first failure.
    pub(crate) fn end(&self) -> io::Result<()> {
        self.lock().end()
    }

    fn lock(&self) -> MutexGuard<'_, Lines<File>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl<W: Write> Lines<W> {
    fn new(file: W) -> io::Result<Self> {
        let mut out = BufWriter::new(file);
        writeln!(out, "{HEAD}")?;
        out.flush()?;
        Ok(Self { out, last: None, waiting: 0, failed: None })
    }

    fn add(&mut self, point: &TracePoint) {
        let rests = self.last.replace(*point).is_some_and(|last| last.axes == point.axes);
        self.waiting += 1;
        let mut result = self.write(point);
        if rests || self.waiting >= LINES {
            result = result.and_then(|()| self.out.flush());
            self.waiting = 0;
        }
        if let (Err(error), None) = (result, &self.failed) {
            self.failed = Some(error);
        }
    }

    fn write(&mut self, point: &TracePoint) -> io::Result<()> {
        if self.failed.is_some() {
            return Ok(());
        }
        write!(self.out, "{:.6}", point.at.as_micros() as f64 / 1e6)?;
        // + 0.0 makes a negative zero positive
        let rounded = |n: f64| (n * 1e6).round() / 1e6 + 0.0;
        point.axes.iter().chain(&point.position).try_for_each(|n| write!(self.out, ",{}", rounded(*n)))?;
        writeln!(self.out, ",{},{}", point.tool, point.work)
    }

    fn end(&mut self) -> io::Result<()> {
        match self.failed.take() {
            Some(error) => Err(error),
            None => self.out.flush(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bcap_core::time::Instant;

    #[test]
    fn a_point_is_a_line_of_numbers() {
        let mut lines = Lines::new(Vec::new()).unwrap();
        let axes = [0.1, -0.0, 90.0, 1e-9, 45.0, -30.123_456_7, 0.0, 0.0];
        let position = [364.16, 0.0, 278.5355, 180.0, 0.0, -180.0];
        lines.add(&TracePoint { at: Instant::from_micros(8_500), axes, position, tool: 1, work: 2 });
        lines.end().unwrap();
        let text = String::from_utf8(lines.out.into_inner().unwrap()).unwrap();
        let line = "0.008500,0.1,0,90,0,45,-30.123457,0,0,364.16,0,278.5355,180,0,-180,1,2";
        assert_eq!(text, format!("{HEAD}\n{line}\n"));
    }

    #[test]
    fn the_first_failure_is_told() {
        struct Full;
        impl Write for Full {
            fn write(&mut self, _: &[u8]) -> io::Result<usize> {
                Err(io::ErrorKind::StorageFull.into())
            }
            fn flush(&mut self) -> io::Result<()> {
                Ok(())
            }
        }
        let mut lines = Lines { out: BufWriter::new(Full), last: None, waiting: 0, failed: None };
        for n in 0..300 {
            let point =
                TracePoint { at: Instant::from_millis(n), axes: [n as f64; 8], position: [0.0; 6], tool: 0, work: 0 };
            lines.add(&point);
        }
        assert_eq!(lines.end().unwrap_err().kind(), io::ErrorKind::StorageFull);
    }
}
