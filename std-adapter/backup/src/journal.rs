//! The journal of `bcap restore`: planned and completed writes.
//!
//! ```text
//!  {"begin":{"planned":["I5","file:Pro1.pcs"],"robot":"tcp:192.168.0.1:5007","unix_time":1700000000}}
//!  {"writing":"I5","was":{"vt":3,"v":3},"value":{"vt":3,"v":7}}
//!  {"written":"I5"}
//!  {"end":"complete"}
//! ```
//!
//! A line is in the file before the next call is made, so it survives a crash of the process. `writing` without `written` means
//! that the controller may have the old value or the new one.

use std::collections::BTreeSet;
use std::fs::{self, File, OpenOptions};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

use serde::Deserialize;
use serde_json::json;

use crate::error::{Error, failed};

/// The name of the journal in the folder of a backup.
const NAME: &str = "restore.jsonl";

/// The journal while a restore runs.
pub struct Journal {
    path: PathBuf,
    file: File,
}

impl Journal {
    /// Begins a new restore after the restores in the journal.
    pub fn begin(folder: &Path, robot: &str, planned: &[String]) -> Result<Self, Error> {
        let path = folder.join(NAME);
        let file = OpenOptions::new().create(true).append(true).open(&path).map_err(failed(&path))?;
        let mut journal = Self { path, file };
        if !journal.ends_with_a_line()? {
            // the last line of a killed restore may be cut off
            journal.push("")?;
        }
        let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default().as_secs();
        journal.push(&json!({ "begin": { "robot": robot, "unix_time": now, "planned": planned } }).to_string())?;
        journal.sync()?;
        Ok(journal)
    }

    /// Records that a write is about to be sent; `was` and `value` are JSON.
    pub fn writing(&mut self, name: &str, was: &str, value: &str) -> Result<(), Error> {
        let name = serde_json::Value::from(name);
        self.push(&format!("{{\"writing\":{name},\"was\":{was},\"value\":{value}}}"))
    }

    /// Records that the controller has the new value.
    pub fn written(&mut self, name: &str) -> Result<(), Error> {
        self.push(&json!({ "written": name }).to_string())
    }

    /// Records the end: "complete", or why the restore stopped.
    pub fn end(&mut self, how: &str) -> Result<(), Error> {
        self.push(&json!({ "end": how }).to_string())?;
        self.sync()
    }

    fn push(&mut self, line: &str) -> Result<(), Error> {
        // one call, so that a line is never written partly
        self.file.write_all(format!("{line}\n").as_bytes()).map_err(failed(&self.path))
    }

    fn sync(&self) -> Result<(), Error> {
        self.file.sync_all().map_err(failed(&self.path))
    }

    fn ends_with_a_line(&self) -> Result<bool, Error> {
        let bytes = fs::read(&self.path).map_err(failed(&self.path))?;
        Ok(bytes.last().is_none_or(|last| *last == b'\n'))
    }
}

/// A restore as recorded in its journal.
#[derive(Debug, Default, PartialEq, Eq)]
pub struct Past {
    /// The address of the controller.
    pub robot: String,
    /// The names that are known to have the new value, in order.
    pub written: Vec<String>,
    /// The name that may have the old value or the new one.
    pub uncertain: Option<String>,
    /// The names that were not written.
    pub rest: Vec<String>,
    /// How it ended; `None` if it was killed.
    pub end: Option<String>,
}

#[derive(Deserialize)]
#[serde(rename_all = "lowercase")]
enum Event {
    Begin(Begin),
    Written(String),
    End(String),
}

#[derive(Deserialize)]
struct Begin {
    robot: String,
    planned: Vec<String>,
}

#[derive(Deserialize)]
struct Writing {
    writing: String,
}

impl Past {
    /// Reads the last restore of a folder; `None` without a restore.
    pub fn read(folder: &Path) -> Result<Option<Self>, Error> {
        let path = folder.join(NAME);
        if !path.exists() {
            return Ok(None);
        }
        let text = fs::read(&path).map_err(failed(&path))?;
        Ok(Self::parse(&String::from_utf8_lossy(&text)))
    }

    fn parse(text: &str) -> Option<Self> {
        let mut past: Option<(Self, Vec<String>)> = None;
        for line in text.lines() {
            if let Ok(Event::Begin(Begin { robot, planned })) = serde_json::from_str(line) {
                past = Some((Self { robot, ..Self::default() }, planned));
            } else if let Some((past, _)) = &mut past {
                past.add(line);
            }
        }
        let (mut past, planned) = past?;
        let done: BTreeSet<&String> = past.written.iter().chain(&past.uncertain).collect();
        past.rest = planned.iter().filter(|name| !done.contains(name)).cloned().collect();
        Some(past)
    }

    /// Adds a line; a line that was cut off is ignored.
    fn add(&mut self, line: &str) {
        if let Ok(Writing { writing }) = serde_json::from_str(line) {
            self.uncertain = Some(writing);
            return;
        }
        match serde_json::from_str(line) {
            Ok(Event::Written(name)) => {
                self.uncertain = None;
                self.written.push(name);
            }
            Ok(Event::End(how)) => self.end = Some(how),
            Ok(Event::Begin(_)) | Err(_) => {}
        }
    }

    /// Returns whether everything was written.
    pub fn is_complete(&self) -> bool {
        self.rest.is_empty() && self.uncertain.is_none()
    }

    /// Describes the writes in one sentence.
    pub fn summary(&self) -> String {
        let total = self.written.len() + self.rest.len() + usize::from(self.uncertain.is_some());
        let end = match self.end.as_deref() {
            Some("complete") => "is complete".to_owned(),
            Some(how) => format!("stopped: {how}"),
            None => "was interrupted or is running".into(),
        };
        let uncertain = self.uncertain.as_ref().map(|name| format!(", {name} may be written")).unwrap_or_default();
        let rest = if self.rest.is_empty() { String::new() } else { format!(", {} are not written", self.rest.len()) };
        format!(
            "the last restore, to {}, {end}; {} of {total} are written{uncertain}{rest}",
            self.robot,
            self.written.len()
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const BEGIN: &str = r#"{"begin":{"robot":"tcp:x","unix_time":1,"planned":["I1","I2","I3"]}}"#;

    #[test]
    fn the_journal_of_a_killed_restore_tells_what_is_written() {
        let killed = format!("{BEGIN}\n{{\"writing\":\"I1\",\"was\":{{}},\"value\":{{}}}}\n{{\"written\":\"I1\"}}\n");
        let past = Past::parse(&killed).unwrap();
        assert_eq!((past.written.len(), &past.uncertain, past.rest.len()), (1, &None, 2));
        let cut = format!("{killed}{{\"writing\":\"I2\",\"was\":{{}},\"value\":{{}}}}\n{{\"writ");
        let past = Past::parse(&cut).unwrap();
        assert_eq!((past.uncertain.as_deref(), past.rest), (Some("I2"), vec!["I3".to_owned()]));
        // the next restore counts alone
        let again = format!("{cut}\n{BEGIN}\n{{\"end\":\"complete\"}}\n");
        let past = Past::parse(&again).unwrap();
        assert_eq!((past.written.len(), past.rest.len(), past.end.as_deref()), (0, 3, Some("complete")));
        assert_eq!(Past::parse(""), None);
    }
}
