//! The file of `bcap watch --mcap`: a topic for each variable.

use std::fs::File;
use std::io::BufWriter;
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use bcap_capture::mcap;
use bcap_core::variant::OwnedVariant as Value;
use serde_json::json;

use crate::failure::{Failure, of_file};

/// A file of samples that is being written.
pub(crate) struct Samples {
    series: mcap::Log<BufWriter<File>>,
    path: PathBuf,
    /// The wall clock at the start, since 1970.
    start: Duration,
}

impl Samples {
    /// Creates the file, in place of one that exists.
    pub(crate) fn create(path: &Path) -> Result<Self, Failure> {
        let start = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        Ok(Self { series: mcap::Log::create(path).map_err(of_file(path))?, path: path.to_owned(), start })
    }

    /// Adds a value that was read `elapsed` after the start, as `{"value":5}` of the topic `/I1`.
    pub(crate) fn push(&mut self, name: &str, elapsed: Duration, value: &Value) -> Result<(), Failure> {
        let (schema, value) = mcap::sample(value.as_variant());
        let at = self.time(elapsed);
        self.series.push(&format!("/{name}"), schema, at, &json!({ "value": value })).map_err(of_file(&self.path))
    }

    /// Writes values that were read a second ago, even if they have not changed.
    pub(crate) fn end_round(&mut self, elapsed: Duration) -> Result<(), Failure> {
        self.series.write_older(self.time(elapsed)).map_err(of_file(&self.path))
    }

    /// Returns a time in nanoseconds since 1970.
    fn time(&self, elapsed: Duration) -> u64 {
        u64::try_from((self.start + elapsed).as_nanos()).unwrap_or(u64::MAX)
    }

    /// Completes the file.
    pub(crate) fn end(&mut self) -> Result<(), Failure> {
        self.series.end().map_err(of_file(&self.path))
    }
}
