//! A file of labels for variables, with lines such as `IO130 = gripper is open`.

use std::collections::HashMap;
use std::fs;
use std::io;
use std::path::Path;

use bcap_backup::local_files;

use crate::failure::{Failure, of_file};

/// Reads the labels by the names of their variables, in upper case.
pub(crate) fn read(path: &Path) -> Result<HashMap<String, String>, Failure> {
    let text = fs::read_to_string(path).map_err(of_file(path))?;
    let lines = (1..).zip(text.lines()).filter(|(_, line)| !line.trim().is_empty());
    let label = |(number, line): (u32, &str)| match line.split_once('=') {
        Some((name, label)) => Ok((name.trim().to_uppercase(), label.trim().to_owned())),
        None => Err(Failure::Input(format!("{}, line {number}: write IO130 = LABEL", path.display()))),
    };
    lines.map(label).collect()
}

/// Sets the label of a variable. The other lines stay as they are; the file is made if it does not exist.
pub(crate) fn write(path: &Path, name: &str, label: &str) -> Result<(), Failure> {
    let text = match fs::read_to_string(path) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => String::new(),
        text => text.map_err(of_file(path))?,
    };
    let is_of = |line: &&str| line.split_once('=').is_some_and(|(of, _)| of.trim().eq_ignore_ascii_case(name));
    let new = format!("{name} = {label}");
    let mut lines: Vec<&str> = text.lines().collect();
    match lines.iter_mut().find(|line| is_of(line)) {
        Some(line) => *line = &new,
        None => lines.push(&new),
    }
    Ok(local_files::write(path, (lines.join("\n") + "\n").as_bytes(), true)?)
}
