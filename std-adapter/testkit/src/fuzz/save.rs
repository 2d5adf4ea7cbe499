//! The files of a finding: its steps as a text, and a capture of a run.

use std::fs;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use super::Error;
use super::finding::Finding;
use crate::step::{self, Step};

/// The paths of the files of a finding.
#[derive(Debug)]
pub struct Files {
    /// The steps, as a text.
    pub steps: PathBuf,
    /// The capture of a run; not written if the device no longer answered, or the run was ended earlier.
    pub capture: PathBuf,
}

impl Files {
    /// Creates the folder and the file of the steps, with the first unused number from `number` on.
    pub(super) fn new(folder: &Path, number: usize, finding: &Finding) -> Result<Self, Error> {
        fs::create_dir_all(folder).map_err(|error| not_written(folder, error))?;
        let mut number = number;
        loop {
            let file = |extension| folder.join(format!("{number:02}-{}.{extension}", finding.kind.name()));
            let files = Self { steps: file("steps"), capture: file("pcapng") };
            match fs::File::create_new(&files.steps) {
                Ok(_) => return Ok(files),
                Err(error) if error.kind() == ErrorKind::AlreadyExists => number += 1,
                Err(error) => return Err(not_written(&files.steps, error)),
            }
        }
    }

    /// Writes the steps, with `remarks` before them.
    pub(super) fn write_steps(&self, steps: &[Step], remarks: &[String]) -> Result<(), Error> {
        let remarks = remarks.iter().flat_map(|remark| remark.lines()).map(|line| format!("# {line}\n"));
        let text: String = remarks.chain(steps.iter().map(|step| format!("{step}\n"))).collect();
        fs::write(&self.steps, text).map_err(|error| not_written(&self.steps, error))
    }
}

/// Reads the steps of a file.
///
/// # Errors
///
/// An error without a step, or for an invalid line.
pub fn read(path: &Path) -> Result<Vec<Step>, Error> {
    let text = fs::read_to_string(path).map_err(|error| Error::File(path.into(), error))?;
    let steps = step::parse(&text).map_err(|error| Error::Steps(path.into(), error))?;
    if steps.is_empty() { Err(Error::Steps(path.into(), "the file has no steps".into())) } else { Ok(steps) }
}

fn not_written(path: &Path, error: std::io::Error) -> Error {
    Error::File(path.into(), error)
}
