//! The writes of a restore: the differences between a backup and a controller, if all of them can be written.

use bcap_capture::value::to_json;
use bcap_core::rac::VariableKind;
use serde_json::json;

use crate::compare::{Difference, differences, entry_text, variables};
use crate::contents::{Contents, Part};
use crate::error::Error;
use bcap_capture::value::named::Entry;
use bcap_core::variant::OwnedVariant as Value;

/// A variable that is written.
pub struct Change {
    /// The name of the variable.
    pub name: String,
    /// The value that is replaced.
    pub was: Value,
    /// The value to write.
    pub value: Value,
}

/// A file that is written.
pub struct FileChange {
    /// The path of the file.
    pub path: String,
    /// The content that is replaced; `None` for a new file.
    pub was: Option<Vec<u8>>,
    /// The content to write.
    pub bytes: Vec<u8>,
}

impl FileChange {
    /// Returns the replaced file as JSON; `saved` is the place of its copy.
    pub fn was_json(&self, saved: Option<&str>) -> String {
        match (&self.was, saved) {
            (None, _) => "null".into(),
            (Some(was), None) => json!({ "size": was.len() }).to_string(),
            (Some(was), Some(saved)) => json!({ "size": was.len(), "saved": saved }).to_string(),
        }
    }

    /// Returns the new file as JSON.
    pub fn value_json(&self) -> String {
        json!({ "size": self.bytes.len() }).to_string()
    }
}

/// All writes of a restore.
pub struct Plan {
    /// The variables, in the order of the writes.
    pub variables: Vec<Change>,
    /// The files, which are written after the variables.
    pub files: Vec<FileChange>,
    /// The number of IO variables that differ and stay unchanged, because they switch outputs and
    /// [`Options::io`](crate::restore::Options::io) is not set.
    pub unwritten_io: usize,
    /// The other parts that stay unchanged, with the reason.
    pub notes: Vec<String>,
}

impl Plan {
    /// Compares the backup with the controller. A difference that cannot be written is an error, so that a plan is never
    /// partial.
    pub fn new(backup: &Contents, controller: &Contents, io: bool) -> Result<Self, Error> {
        check_known(backup, controller)?;
        let mut plan = Self { variables: Vec::new(), files: Vec::new(), unwritten_io: 0, notes: Vec::new() };
        let (mut misfits, mut unread, mut extra) = (Vec::new(), 0, 0);
        for Difference { name: variable, a, b } in differences(&backup.variables, &controller.variables) {
            let name = variable.name();
            match (a, b) {
                (Some(Entry::Value(_)), Some(Entry::Value(_))) if variable.kind() == VariableKind::Io && !io => {
                    plan.unwritten_io += 1;
                }
                (Some(Entry::Value(value)), Some(Entry::Value(was))) if same_type(value, was) => {
                    plan.variables.push(Change { name, was: was.clone(), value: value.clone() });
                }
                (Some(Entry::Value(value)), Some(Entry::Value(was))) => {
                    let [value, was] = [value, was].map(|value| value.as_variant().vartype());
                    misfits.push(format!("{name} holds {was}, the backup has {value}"));
                }
                (Some(Entry::Value(_)), other) => misfits.push(format!("{name} {}", entry_text(other))),
                (Some(Entry::Refused(_)), _) => unread += 1,
                (None, _) => extra += 1,
            }
        }
        if let Some(first) = misfits.first() {
            return Err(Error::unfit(format!(
                "{} variables of the backup do not fit the controller: {first}",
                misfits.len()
            )));
        }
        plan.add_files(backup, controller);
        plan.add_notes(backup, controller, [unread, extra]);
        Ok(plan)
    }

    fn add_files(&mut self, backup: &Contents, controller: &Contents) {
        for Difference { name, a, b } in differences(&backup.files, &controller.files) {
            match a {
                Some(bytes) => {
                    self.files.push(FileChange { path: name.clone(), was: b.cloned(), bytes: bytes.clone() })
                }
                None => self.notes.push(format!("file:{name} is not in the backup and stays")),
            }
        }
    }

    fn add_notes(&mut self, backup: &Contents, controller: &Contents, [unread, extra]: [usize; 2]) {
        let system = variables(backup, controller, true).len() - variables(backup, controller, false).len();
        for (count, what) in [
            (unread, "variables could not be read when the backup was made and stay"),
            (extra, "variables are not in the backup and stay"),
            (
                system,
                "system variables differ; they are the state of the controller, or read-only, and are not written",
            ),
        ] {
            if count > 0 {
                self.notes.push(format!("{count} {what}"));
            }
        }
        self.notes.extend(backup.omitted.iter().map(|part| format!("not in the backup: {}", part.reason)));
    }

    /// Returns whether there is nothing to write.
    pub fn is_empty(&self) -> bool {
        self.variables.is_empty() && self.files.is_empty()
    }

    /// Returns the names of all writes, in order, as in the journal.
    pub fn names(&self) -> Vec<String> {
        let files = self.files.iter().map(|file| format!("file:{}", file.path));
        self.variables.iter().map(|change| change.name.clone()).chain(files).collect()
    }

    /// Returns a line of JSON for each write.
    pub fn json_lines(&self) -> Vec<String> {
        let line = |name: String, was: String, value: String| {
            format!("{{\"name\":{},\"was\":{was},\"value\":{value}}}", serde_json::Value::from(name))
        };
        let variables = self.variables.iter().map(|change| {
            line(change.name.clone(), to_json(change.was.as_variant()), to_json(change.value.as_variant()))
        });
        let files =
            self.files.iter().map(|file| line(format!("file:{}", file.path), file.was_json(None), file.value_json()));
        variables.chain(files).collect()
    }

    /// Returns a line for each write.
    pub fn lines(&self) -> Vec<String> {
        let text = |value: &Value| entry_text(Some(&Entry::Value(value.clone())));
        let variables = self
            .variables
            .iter()
            .map(|change| format!("{}: {} -> {}", change.name, text(&change.was), text(&change.value)));
        let files = self.files.iter().map(|file| match &file.was {
            Some(was) => format!("file:{}: replaced, {} bytes -> {} bytes", file.path, was.len(), file.bytes.len()),
            None => format!("file:{}: new, {} bytes", file.path, file.bytes.len()),
        });
        variables.chain(files).collect()
    }
}

/// Refuses a controller if a part of the backup cannot be read from it: a file that could not be read would be overwritten as a
/// new file.
fn check_known(backup: &Contents, controller: &Contents) -> Result<(), Error> {
    let is_needed = |part: &Part| match part {
        Part::Variables(_) => backup.variables.keys().any(|variable| part.has_variable(*variable)),
        Part::Files(_) => backup.files.keys().any(|path| part.has_file(path)),
        // they are not written
        Part::System => false,
    };
    let mut unknown = controller.omitted.iter().filter(|omission| is_needed(&omission.part));
    let Some(first) = unknown.next() else { return Ok(()) };
    let more = match unknown.count() {
        0 => String::new(),
        more => format!(" and {more} more"),
    };
    Err(Error::unfit(format!("the controller could not be read completely: {}{more}; over UDP, use TCP", first.reason)))
}

fn same_type(a: &Value, b: &Value) -> bool {
    let [a, b] =
        [a, b].map(|value| (value.as_variant().vartype(), value.as_variant().as_array().map(|array| array.len())));
    a == b
}
