//! The table of `bcap watch --csv`: a row for each round.

use std::fs::File;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::Duration;

use bcap_capture::decode::csv;
use bcap_core::variant::{OwnedVariant as Value, Variant};

use crate::failure::{Failure, of_file};
use crate::output::print_line;
use bcap_capture::value::data;

/// A partly written table; the first row determines its columns.
pub(crate) struct Table {
    /// The file, unless it is the standard output.
    file: Option<File>,
    path: PathBuf,
    /// The number of cells of each variable.
    widths: Vec<usize>,
}

impl Table {
    /// Makes the file, or uses the standard output for `-`.
    pub(crate) fn create(path: &Path) -> Result<Self, Failure> {
        let is_file = path != Path::new("-");
        let file = is_file.then(|| File::create(path).map_err(of_file(path))).transpose()?;
        Ok(Self { file, path: path.to_owned(), widths: Vec::new() })
    }

    /// Adds a row.
    pub(crate) fn push<'a>(
        &mut self,
        time: Duration,
        names: &[String],
        values: impl Iterator<Item = &'a Value>,
    ) -> Result<(), Failure> {
        let (mut header, mut row) = (vec!["t".to_owned()], vec![format!("{:.6}", time.as_secs_f64())]);
        let mut widths = Vec::new();
        for (name, value) in names.iter().zip(values) {
            let before = row.len();
            match value.as_variant() {
                Variant::Array(array) => {
                    header.extend((1..=array.len()).map(|element| format!("{name}.{element}")));
                    row.extend(array.iter().map(data::format));
                }
                scalar => {
                    header.push(name.clone());
                    row.push(data::format(scalar));
                }
            }
            widths.push(row.len() - before);
        }
        if self.widths.is_empty() {
            self.write(&header)?;
            self.widths.clone_from(&widths);
        }
        let lengths = widths.iter().zip(&self.widths);
        if let Some((name, (now, then))) = names.iter().zip(lengths).find(|(_, (now, then))| now != then) {
            return Err(Failure::Input(format!(
                "{name} has {now} values now and had {then} in the first row, so the table ends here"
            )));
        }
        self.write(&row)
    }

    fn write(&mut self, row: &[String]) -> Result<(), Failure> {
        let row = csv::row(row);
        match &mut self.file {
            Some(file) => writeln!(file, "{row}").map_err(of_file(&self.path)),
            None => Ok(print_line(&row)?),
        }
    }
}
