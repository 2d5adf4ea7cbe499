//! The path from a controller to one of its objects, as text: `robot:Arm0`, `task:Pro1/@STATUS`.

use std::fmt;
use std::str::FromStr;

use bcap_core::bcap::Object;
use bcap_core::procedure::{PATH_MAX, PathStep};

/// The kinds of objects that are opened by name.
const NAMED: [(Object, &str); 6] = [
    (Object::Robot, "robot"),
    (Object::Task, "task"),
    (Object::File, "file"),
    (Object::Extension, "extension"),
    (Object::Variable, "variable"),
    (Object::Command, "command"),
];

/// The path from the controller to an object.
///
/// ```text
///  path     = "controller" | object { "/" object }
///  object   = kind [ ":" name ]           kind: robot task file extension variable command
///  variable = [ object "/" ] name         a variable of the controller, or of the object
/// ```
///
/// `robot` without a name is the first robot in the controller's list of names. The kind may be in any case.
///
/// # Examples
///
/// ```
/// use bcap_std::ObjectPath;
///
/// let task: ObjectPath = "task:Pro1".parse()?;
/// let status = ObjectPath::variable("task:Pro1/@STATUS")?;
/// assert_eq!(task.to_string(), "task:Pro1");
/// assert_eq!(status.to_string(), "task:Pro1/@STATUS");
/// # Ok::<(), bcap_std::ObjectPathError>(())
/// ```
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct ObjectPath {
    /// The objects and their names; no name is the first of its kind.
    steps: Vec<(Object, Option<String>)>,
}

/// A text is not an [`ObjectPath`]. Its message contains the text, the fault, and the expected form.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct ObjectPathError(String);

impl ObjectPath {
    /// Returns the path to the controller itself.
    #[must_use]
    pub const fn controller() -> Self {
        Self { steps: Vec::new() }
    }

    /// Parses the path of a variable: `I1`, `robot/@SERVO_ON`, `task:Pro1/@STATUS`.
    ///
    /// # Errors
    ///
    /// An [`ObjectPathError`].
    pub fn variable(text: &str) -> Result<Self, ObjectPathError> {
        match text.rsplit_once('/') {
            Some((owner, name)) if Self::is_path(owner) && !name.is_empty() => {
                owner.parse::<Self>()?.join(Object::Variable, name).checked(text)
            }
            _ if text.is_empty() => {
                Err(ObjectPathError("the name of the variable is empty; write a name such as I1".into()))
            }
            _ => Ok(Self::controller().join(Object::Variable, text)),
        }
    }

    /// Returns whether the text begins as a path does: with `controller`, or with a kind of object.
    #[must_use]
    pub fn is_path(text: &str) -> bool {
        text.eq_ignore_ascii_case("controller") || kind(text.split('/').next().unwrap_or(text)).is_some()
    }

    /// Returns the path to an object of this object. Opening it fails if there is no such object.
    #[must_use]
    pub fn join(mut self, object: Object, name: impl Into<String>) -> Self {
        self.steps.push((object, Some(name.into())));
        self
    }

    /// Returns the kind of the object.
    #[must_use]
    pub fn object(&self) -> Object {
        self.steps.last().map_or(Object::Controller, |(object, _)| *object)
    }

    /// Returns the path to the owner of the object, and the name of the object there; `None` for the controller.
    #[must_use]
    pub fn split_last(&self) -> Option<(Self, Option<&str>)> {
        let ((_, name), owner) = self.steps.split_last()?;
        Some((Self { steps: owner.to_vec() }, name.as_deref()))
    }

    /// Returns the steps from the controller to the object.
    pub(crate) fn steps(&self) -> Vec<PathStep<'_>> {
        self.steps.iter().map(|(object, name)| PathStep { object: *object, name: name.as_deref() }).collect()
    }

    /// Checks the number of objects, and that each can be opened from its predecessor.
    fn checked(self, text: &str) -> Result<Self, ObjectPathError> {
        if self.steps.len() > PATH_MAX {
            return Err(ObjectPathError(format!("{text}: a path has at most {PATH_MAX} objects")));
        }
        let mut owner = Object::Controller;
        for (object, _) in &self.steps {
            if object.opened_from(owner).is_none() {
                let [owner, object] = [owner, *object].map(|object| object.name().to_ascii_lowercase());
                return Err(ObjectPathError(format!("{text}: a {owner} has no {object}")));
            }
            owner = *object;
        }
        Ok(self)
    }
}

impl FromStr for ObjectPath {
    type Err = ObjectPathError;

    fn from_str(text: &str) -> Result<Self, ObjectPathError> {
        if text.eq_ignore_ascii_case("controller") {
            return Ok(Self::controller());
        }
        let steps = text.split('/').map(|part| step(text, part)).collect::<Result<_, _>>()?;
        Self { steps }.checked(text)
    }
}

/// Returns the kind of an object, its word, and the text after the colon; `None` if it does not begin with a kind.
fn kind(part: &str) -> Option<(Object, &'static str, Option<&str>)> {
    let (kind, name) = part.split_once(':').map_or((part, None), |(kind, name)| (kind, Some(name)));
    let (object, word) = NAMED.iter().find(|(_, word)| word.eq_ignore_ascii_case(kind))?;
    Some((*object, word, name))
}

/// Parses one object; `text` is the whole path, for messages.
fn step(text: &str, part: &str) -> Result<(Object, Option<String>), ObjectPathError> {
    match kind(part) {
        Some((Object::Robot, _, None)) => Ok((Object::Robot, None)),
        Some((_, word, None | Some(""))) => {
            Err(ObjectPathError(format!("{part}: the name is missing; write {word}:NAME")))
        }
        Some((object, _, Some(name))) => Ok((object, Some(name.to_owned()))),
        None => {
            let kinds = NAMED.map(|(_, word)| word).join(", ");
            let error =
                format!("{text}: {part:?} is not an object; write controller, or KIND:NAME with one of {kinds}");
            Err(ObjectPathError(error))
        }
    }
}

/// Writes the path as it is parsed, without the kind of a variable.
impl fmt::Display for ObjectPath {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.steps.is_empty() {
            return f.write_str("controller");
        }
        for (i, (object, name)) in self.steps.iter().enumerate() {
            if i > 0 {
                f.write_str("/")?;
            }
            match name {
                Some(name) if *object == Object::Variable => f.write_str(name)?,
                Some(name) => write!(f, "{}:{name}", object.name().to_ascii_lowercase())?,
                None => f.write_str(&object.name().to_ascii_lowercase())?,
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn paths_of_objects_are_parsed() {
        assert_eq!("Controller".parse(), Ok(ObjectPath::controller()));
        for (text, object) in [
            ("robot", Object::Robot),
            ("robot:Arm0", Object::Robot),
            ("task:Pro1", Object::Task),
            ("file:a\\b.pcs", Object::File),
            ("file:a/file:b", Object::File),
            ("extension:Hand0", Object::Extension),
            ("command:Halt", Object::Command),
        ] {
            let path: ObjectPath = text.parse().unwrap();
            assert!(ObjectPath::is_path(text));
            assert_eq!((path.object(), path.to_string()), (object, text.to_owned()));
        }
        for (text, word) in [
            ("task", "name is missing"),
            ("task:", "name is missing"),
            ("robot/task:Pro1", "a robot has no task"),
            ("robot/x", "\"x\" is not an object"),
            ("file:a/file:a/file:a/file:a/file:a/file:a/file:a", "at most 6 objects"),
        ] {
            let error = text.parse::<ObjectPath>().unwrap_err().to_string();
            assert!(ObjectPath::is_path(text) && error.contains(word), "{error}");
        }
        for text in ["3,5", "Arm0", "", "robots:1"] {
            assert!(!ObjectPath::is_path(text) && text.parse::<ObjectPath>().is_err(), "{text}");
        }
    }

    #[test]
    fn variables_belong_to_the_controller_or_to_an_object() {
        for (text, steps) in [
            ("I1", 1),
            ("@MODE", 1),
            ("a/b", 1),
            ("robot/@SERVO_ON", 2),
            ("robot:Arm0/@SERVO_ON", 2),
            ("task:Pro1/@STATUS", 2),
        ] {
            let path = ObjectPath::variable(text).unwrap();
            assert_eq!((path.object(), path.to_string()), (Object::Variable, text.to_owned()));
            assert_eq!(path.steps().len(), steps);
        }
        for text in ["", "task/@STATUS", "command:Halt/@STATUS"] {
            assert!(ObjectPath::variable(text).is_err(), "{text}");
        }
    }
}
