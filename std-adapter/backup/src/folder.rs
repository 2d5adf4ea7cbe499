//! A backup in a folder.
//!
//! ```text
//!  DIR/backup.json          the controller, counts, what is missing; "complete": false while the dump runs
//!      variables/I.jsonl    {"name":"I0","vt":3,"v":5}, one line for each variable, in order; so for F D V P J T S IO
//!      system.jsonl         the same for system variables
//!      files/Pro1.pcs       the files, as they are
//!      restore.jsonl        the journal of `bcap restore`
//!      replaced/            the files that `bcap restore` has replaced
//! ```
//!
//! A file appears under its name when it is complete. While a kind is being read, its lines are in `I.jsonl.part`, where the
//! next dump continues.

use std::collections::BTreeMap;
use std::fs::{self, DirEntry, File, OpenOptions};
use std::io::{BufReader, BufWriter, Write};
use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

use bcap_core::rac::VariableKind;
use serde::{Deserialize, Serialize};

use crate::compare::{Difference, differences};
use crate::contents::{About, Contents, Omission, UserVariable};
use crate::error::{Error, failed};
use crate::local_files;
use bcap_capture::value::named::{self, Entry, Named};

/// The version of this format.
const FORMAT: u32 = 1;

/// The lines that a killed dump may lose and reads again.
const UNWRITTEN: u32 = 100;

/// `backup.json`.
#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Manifest {
    format: u32,
    complete: bool,
    controller: About,
    /// The end of the dump, in seconds since 1970.
    unix_time: u64,
    /// The number of variables of each kind.
    variables: BTreeMap<String, usize>,
    system: usize,
    /// The number of files.
    files: usize,
    /// The size of each file in bytes, by path.
    file_sizes: BTreeMap<String, usize>,
    /// The number of user variables that could not be read.
    refused: usize,
    /// Other parts that could not be read.
    omitted: Vec<Omission>,
}

/// The folder of a backup.
#[derive(Debug)]
pub struct Folder {
    path: PathBuf,
    about: About,
    /// Whether an earlier dump was interrupted.
    pub is_resumed: bool,
}

impl Folder {
    /// Creates the folder, or opens the folder of an interrupted dump of the same controller.
    pub fn begin(path: &Path, about: About) -> Result<Self, Error> {
        let wrong = |what: &str| Err(Error::at(path, format!("{what}; choose another folder")));
        let is_resumed = match read_manifest(path)? {
            Some(manifest) if manifest.complete => return wrong("the folder has a complete backup"),
            Some(manifest) if !manifest.controller.is_same_controller(&about) => {
                return wrong(&format!(
                    "the folder has an interrupted dump of another controller, or of an unknown one: {}",
                    manifest.controller.describe()
                ));
            }
            Some(_) => true,
            None if !is_empty(path)? => return wrong("the folder is not empty and has no backup"),
            None => false,
        };
        remove_temporary(path)?;
        let folder = Self { path: path.to_owned(), about, is_resumed };
        folder.write_manifest(false, &Contents::default())?;
        Ok(folder)
    }

    /// Opens the lines of a kind; `None` if they are complete. The second value is the number of lines that exist.
    pub fn partial_file(&self, kind: VariableKind) -> Result<Option<(PartialFile, u32)>, Error> {
        let complete = variables(&self.path, kind);
        if complete.exists() {
            return Ok(None);
        }
        let path = complete.with_extension("jsonl.part");
        let done = whole_lines(&path, kind)?;
        self.write(&path, done.join("").as_bytes())?;
        let file = OpenOptions::new().append(true).open(&path).map_err(failed(&path))?;
        let count = u32::try_from(done.len()).unwrap_or(u32::MAX);
        Ok(Some((PartialFile { path, complete, file: BufWriter::new(file), unwritten: 0 }, count)))
    }

    /// Writes the system variables.
    pub fn write_system(&self, system: &BTreeMap<String, Entry>) -> Result<(), Error> {
        let line =
            |(name, entry): (&String, &Entry)| Named { name: name.clone(), entry: entry.clone() }.to_json() + "\n";
        let lines: String = system.iter().map(line).collect();
        self.write(&self.path.join("system.jsonl"), lines.as_bytes())
    }

    /// Returns whether an earlier dump has saved a file.
    pub fn has_file(&self, path: &str) -> bool {
        self.path.join("files").join(path).is_file()
    }

    /// Writes a file of the controller.
    pub fn write_file(&self, path: &str, bytes: &[u8]) -> Result<(), Error> {
        self.write(&self.path.join("files").join(path), bytes)
    }

    /// Reads everything back, and marks the backup as complete.
    pub fn finish(&self, omitted: Vec<Omission>) -> Result<Contents, Error> {
        let contents = Contents { about: self.about.clone(), omitted, ..read_all(&self.path)? };
        self.write_manifest(true, &contents)?;
        Ok(contents)
    }

    /// Writes a file in one step. The temporary file is outside `files`, where it would become a part of the backup.
    fn write(&self, path: &Path, bytes: &[u8]) -> Result<(), Error> {
        local_files::write_by(&self.path, path, bytes, true)
    }

    fn write_manifest(&self, complete: bool, contents: &Contents) -> Result<(), Error> {
        let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        let manifest = Manifest {
            format: FORMAT,
            complete,
            controller: self.about.clone(),
            unix_time: now.as_secs(),
            variables: counts(contents),
            system: contents.system.len(),
            files: contents.files.len(),
            file_sizes: sizes(contents),
            refused: contents.refused(),
            omitted: contents.omitted.clone(),
        };
        // texts and numbers always serialize
        let text = serde_json::to_string_pretty(&manifest).unwrap_or_default() + "\n";
        self.write(&self.path.join("backup.json"), text.as_bytes())
    }
}

/// Returns whether a folder does not exist, or contains only files of a dump that was killed at its start.
fn is_empty(path: &Path) -> Result<bool, Error> {
    if !path.exists() {
        return Ok(true);
    }
    let mut entries = fs::read_dir(path).map_err(failed(path))?;
    Ok(entries.all(|entry| entry.is_ok_and(|entry| is_temporary(&entry))))
}

/// Removes the temporary files of a killed dump.
fn remove_temporary(path: &Path) -> Result<(), Error> {
    if !path.exists() {
        return Ok(());
    }
    for entry in fs::read_dir(path).map_err(failed(path))?.filter_map(Result::ok).filter(is_temporary) {
        fs::remove_file(entry.path()).map_err(failed(&entry.path()))?;
    }
    Ok(())
}

fn is_temporary(entry: &DirEntry) -> bool {
    entry.file_name().to_string_lossy().starts_with(local_files::TEMPORARY)
}

/// The lines of a kind while they are read.
pub struct PartialFile {
    path: PathBuf,
    complete: PathBuf,
    file: BufWriter<File>,
    unwritten: u32,
}

impl PartialFile {
    /// Adds a line.
    pub fn push(&mut self, name: String, entry: Entry) -> Result<(), Error> {
        writeln!(self.file, "{}", Named { name, entry }.to_json()).map_err(failed(&self.path))?;
        self.unwritten += 1;
        if self.unwritten < UNWRITTEN {
            return Ok(());
        }
        self.unwritten = 0;
        self.file.flush().map_err(failed(&self.path))
    }

    /// Gives the file its name.
    pub fn finish(mut self) -> Result<(), Error> {
        self.file.flush().map_err(failed(&self.path))?;
        self.file.get_ref().sync_all().map_err(failed(&self.path))?;
        fs::rename(&self.path, &self.complete).map_err(failed(&self.complete))
    }
}

/// Returns the complete lines at the beginning of a partly written file.
fn whole_lines(path: &Path, kind: VariableKind) -> Result<Vec<String>, Error> {
    let bytes = if path.exists() { fs::read(path).map_err(failed(path))? } else { Vec::new() };
    let text = String::from_utf8_lossy(&bytes);
    let is_next = |(line, index): &(&str, u32)| {
        let name = UserVariable::new(kind, *index).name();
        line.ends_with('\n') && Named::parse(line.trim_end()).is_ok_and(|named| named.name == name)
    };
    Ok(text.split_inclusive('\n').zip(0..).take_while(is_next).map(|(line, _)| line.to_owned()).collect())
}

/// Reads a complete backup.
pub fn load(path: &Path) -> Result<Contents, Error> {
    let wrong = |what: String| Error::at(path, what);
    let Some(manifest) = read_manifest(path)? else {
        return Err(wrong("there is no backup: backup.json is missing".into()));
    };
    if !manifest.complete {
        return Err(wrong("the dump was interrupted; dump into this folder again to complete it".into()));
    }
    let (about, omitted) = (manifest.controller, manifest.omitted);
    let contents = Contents { about, omitted, ..read_all(path)? };
    let (found, written) = (counts(&contents), manifest.variables);
    if found != written || contents.system.len() != manifest.system {
        return Err(wrong(format!(
            "the backup is damaged: it has {found:?} variables and {} system variables; backup.json says {written:?} and {}",
            contents.system.len(),
            manifest.system
        )));
    }
    let (found, written) = (sizes(&contents), manifest.file_sizes);
    let Some(Difference { name, a, b }) = differences(&found, &written).into_iter().next() else { return Ok(contents) };
    let what = match (a, b) {
        (Some(found), Some(written)) => format!("files/{name} has {found} bytes, backup.json says {written}"),
        (None, _) => format!("files/{name} is missing"),
        (_, None) => format!("files/{name} is not in backup.json"),
    };
    Err(wrong(format!(
        "the backup is damaged: {what}; after an intended change, correct \"file_sizes\" in backup.json"
    )))
}

fn sizes(contents: &Contents) -> BTreeMap<String, usize> {
    contents.files.iter().map(|(path, bytes)| (path.clone(), bytes.len())).collect()
}

fn read_manifest(path: &Path) -> Result<Option<Manifest>, Error> {
    let path = path.join("backup.json");
    if !path.exists() {
        return Ok(None);
    }
    let text = fs::read_to_string(&path).map_err(failed(&path))?;
    let wrong = |what: String| Error::at(&path, what);
    let manifest: Manifest = serde_json::from_str(&text).map_err(|error| wrong(error.to_string()))?;
    if manifest.format != FORMAT {
        return Err(wrong(format!("this is format {}; this version of bcap reads format {FORMAT}", manifest.format)));
    }
    Ok(Some(manifest))
}

/// Reads the variables and files.
fn read_all(path: &Path) -> Result<Contents, Error> {
    let mut contents = Contents::default();
    for kind in VariableKind::ALL {
        let file = variables(path, kind);
        if !file.exists() {
            continue;
        }
        for (named, index) in lines(&file)?.into_iter().zip(0..) {
            let variable = UserVariable::new(kind, index);
            if named.name != variable.name() {
                let (found, name) = (named.name, variable.name());
                return Err(Error::at(&file, format!("{found} follows where {name} is expected")));
            }
            contents.variables.insert(variable, named.entry);
        }
    }
    let system = path.join("system.jsonl");
    if system.exists() {
        contents.system = lines(&system)?.into_iter().map(|named| (named.name, named.entry)).collect();
    }
    let files = path.join("files");
    for file in if files.is_dir() { local_files::all_below(&files)? } else { Vec::new() } {
        let below = file.strip_prefix(&files).unwrap_or(&file);
        let parts: Vec<_> = below.components().map(|part| part.as_os_str().to_string_lossy()).collect();
        contents.files.insert(parts.join("/"), fs::read(&file).map_err(failed(&file))?);
    }
    Ok(contents)
}

fn lines(path: &Path) -> Result<Vec<Named>, Error> {
    let file = File::open(path).map_err(failed(path))?;
    named::read_lines(BufReader::new(file), &path.display().to_string()).map_err(Error::Invalid)
}

fn variables(path: &Path, kind: VariableKind) -> PathBuf {
    path.join("variables").join(format!("{}.jsonl", kind.name()))
}

fn counts(contents: &Contents) -> BTreeMap<String, usize> {
    let mut counts = BTreeMap::new();
    for variable in contents.variables.keys() {
        *counts.entry(variable.kind().name().to_owned()).or_default() += 1;
    }
    counts
}
