//! The files of a finding: its steps as a text, and a capture of a run.

use std::fs;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use bcap_testkit::step::{self, Step};

use super::finding::Finding;
use crate::error::Failure;

/// Where the files of a finding are.
#[derive(Debug)]
pub(super) struct Files {
    pub(super) steps: PathBuf,
    pub(super) capture: PathBuf,
}

impl Files {
    /// Makes the folder and the file of the steps, with the first number from `number` on that has no file of this kind.
    pub(super) fn new(folder: &Path, number: usize, finding: &Finding) -> Result<Self, Failure> {
        fs::create_dir_all(folder).map_err(|error| not_written(folder, &error))?;
        let mut number = number;
        loop {
            let file = |extension| folder.join(format!("{number:02}-{}.{extension}", finding.kind.name()));
            let files = Self { steps: file("steps"), capture: file("pcapng") };
            match fs::File::create_new(&files.steps) {
                Ok(_) => return Ok(files),
                Err(error) if error.kind() == ErrorKind::AlreadyExists => number += 1,
                Err(error) => return Err(not_written(&files.steps, &error)),
            }
        }
    }

    /// Writes the steps, with `remarks` before them.
    pub(super) fn write_steps(&self, steps: &[Step], remarks: &[String]) -> Result<(), Failure> {
        let remarks = remarks.iter().flat_map(|remark| remark.lines()).map(|line| format!("# {line}\n"));
        let text: String = remarks.chain(steps.iter().map(|step| format!("{step}\n"))).collect();
        fs::write(&self.steps, text).map_err(|error| not_written(&self.steps, &error))
    }
}

/// Reads the steps of a file.
pub(super) fn read(path: &Path) -> Result<Vec<Step>, Failure> {
    let text = fs::read_to_string(path)
        .map_err(|error| Failure::Input(format!("cannot read the steps in {}: {error}", path.display())))?;
    let steps = step::parse(&text).map_err(|error| Failure::Input(format!("{}, {error}", path.display())))?;
    if steps.is_empty() { Err(Failure::Input(format!("{} has no steps", path.display()))) } else { Ok(steps) }
}

fn not_written(path: &Path, error: &std::io::Error) -> Failure {
    Failure::Input(format!("cannot write {}: {error}", path.display()))
}
