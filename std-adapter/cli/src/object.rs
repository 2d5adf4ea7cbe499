//! Names for the objects of a controller, in place of handles: `robot:Arm0`, `task:Pro1/@STATUS`.
//!
//! ```text
//!  path     = "controller" | object { "/" object }
//!  object   = kind [ ":" name ]           kind: robot task file extension variable command
//!  variable = [ object "/" ] name         a variable of the controller, or of the object
//! ```
//!
//! `robot` without a name is the first robot in the controller's list of names.

use std::fmt;

use bcap_core::bcap::{FunctionId, Kind, Object};

/// The kinds of objects that are opened by name.
const NAMED: [(Object, &str); 6] = [
    (Object::Robot, "robot"),
    (Object::Task, "task"),
    (Object::File, "file"),
    (Object::Extension, "extension"),
    (Object::Variable, "variable"),
    (Object::Command, "command"),
];

/// An object and its name; `None` is the first of its kind.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Step {
    pub(crate) object: Object,
    pub(crate) name: Option<String>,
}

/// The path from the controller to an object; an empty path is the controller itself.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Path {
    pub(crate) steps: Vec<Step>,
}

impl Path {
    /// Parses the path of an object; `None` if the text does not begin with a kind of object.
    pub(crate) fn parse(text: &str) -> Option<Result<Self, String>> {
        if text.eq_ignore_ascii_case("controller") {
            return Some(Ok(Self { steps: Vec::new() }));
        }
        let first = step(text.split('/').next().unwrap_or(text))?;
        Some(first.and_then(|_| {
            let steps = text.split('/').map(|part| step(part).unwrap_or_else(|| Err(unknown(text, part))));
            Self { steps: steps.collect::<Result<_, _>>()? }.checked(text)
        }))
    }

    /// Parses the path of a variable: `I1`, `robot/@SERVO_ON`, `task:Pro1/@STATUS`.
    pub(crate) fn variable(text: &str) -> Result<Self, String> {
        let variable = |name: &str| Step { object: Object::Variable, name: Some(name.to_owned()) };
        let owner = text.rsplit_once('/').and_then(|(owner, name)| Some((Self::parse(owner)?, name)));
        match owner {
            Some((owner, name)) if !name.is_empty() => {
                let mut path = owner?;
                path.steps.push(variable(name));
                path.checked(text)
            }
            _ if text.is_empty() => Err("the name of the variable is empty; write a name such as I1".into()),
            _ => Ok(Self { steps: vec![variable(text)] }),
        }
    }

    /// Returns the kind of the object.
    pub(crate) fn object(&self) -> Object {
        self.steps.last().map_or(Object::Controller, |step| step.object)
    }

    /// Checks that each object can be opened on its predecessor.
    fn checked(self, text: &str) -> Result<Self, String> {
        let mut owner = Object::Controller;
        for step in &self.steps {
            if opened_by(owner, step.object).is_none() {
                return Err(format!("{text}: a {} has no {}", word(owner), word(step.object)));
            }
            owner = step.object;
        }
        Ok(self)
    }
}

/// Returns the function that opens an object by name on its owner.
pub(crate) fn opened_by(owner: Object, object: Object) -> Option<FunctionId> {
    let by_name = [Kind::Handle(owner), Kind::Text, Kind::Text];
    FunctionId::all().find(|function| {
        function.opens() == Some(object) && function.signature().is_some_and(|found| found.arguments == by_name)
    })
}

/// Returns the word for a kind of object on the command line.
pub(crate) fn word(object: Object) -> &'static str {
    match NAMED.iter().find(|(kind, _)| *kind == object) {
        Some((_, word)) => word,
        None if object == Object::Controller => "controller",
        None if object == Object::Message => "message",
        None => "service",
    }
}

/// Parses one step; `None` if it does not begin with a kind of object.
fn step(part: &str) -> Option<Result<Step, String>> {
    let (kind, name) = match part.split_once(':') {
        Some((kind, name)) => (kind, Some(name)),
        None => (part, None),
    };
    let (object, kind) = NAMED.iter().find(|(_, word)| word.eq_ignore_ascii_case(kind))?;
    Some(match name {
        None if *object == Object::Robot => Ok(Step { object: *object, name: None }),
        None | Some("") => Err(format!("{part}: the name is missing; write {kind}:NAME")),
        Some(name) => Ok(Step { object: *object, name: Some(name.to_owned()) }),
    })
}

fn unknown(text: &str, part: &str) -> String {
    let kinds = NAMED.map(|(_, word)| word).join(", ");
    format!("{text}: {part:?} is not an object; write KIND:NAME with one of {kinds}")
}

/// Writes the path as on the command line, with the kind of a variable omitted.
impl fmt::Display for Path {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.steps.is_empty() {
            return f.write_str("controller");
        }
        for (i, step) in self.steps.iter().enumerate() {
            if i > 0 {
                f.write_str("/")?;
            }
            match (&step.name, step.object) {
                (Some(name), Object::Variable) => f.write_str(name)?,
                (Some(name), object) => write!(f, "{}:{name}", word(object))?,
                (None, object) => f.write_str(word(object))?,
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn object_paths_are_parsed() {
        assert_eq!(Path::parse("Controller").unwrap().unwrap().steps, []);
        for (text, object) in [
            ("robot", Object::Robot),
            ("robot:Arm0", Object::Robot),
            ("task:Pro1", Object::Task),
            ("file:a\\b.pcs", Object::File),
            ("file:a/file:b", Object::File),
            ("extension:Hand0", Object::Extension),
            ("command:Halt", Object::Command),
        ] {
            let path = Path::parse(text).unwrap().unwrap();
            assert_eq!((path.object(), path.to_string()), (object, text.to_owned()));
        }
        for text in ["3,5", "Arm0", "", "robots:1"] {
            assert_eq!(Path::parse(text), None, "{text}");
        }
        for (text, word) in [
            ("task", "name is missing"),
            ("task:", "name is missing"),
            ("robot/task:Pro1", "a robot has no task"),
            ("robot/x", "\"x\" is not an object"),
        ] {
            let error = Path::parse(text).unwrap().unwrap_err();
            assert!(error.contains(word), "{error}");
        }
    }

    #[test]
    fn variables_belong_to_the_controller_or_to_an_object() {
        for text in ["I1", "@MODE", "robot/@SERVO_ON", "robot:Arm0/@SERVO_ON", "task:Pro1/@STATUS", "a/b"] {
            let path = Path::variable(text).unwrap();
            assert_eq!((path.object(), path.to_string()), (Object::Variable, text.to_owned()));
        }
        assert_eq!(Path::variable("I1").unwrap().steps.len(), 1);
        assert_eq!(Path::variable("a/b").unwrap().steps.len(), 1);
        assert_eq!(Path::variable("task:Pro1/@STATUS").unwrap().steps.len(), 2);
        assert!(Path::variable("").is_err());
        assert!(Path::variable("task/@STATUS").is_err());
    }

    #[test]
    fn objects_are_opened_by_the_function_of_their_owner() {
        assert_eq!(opened_by(Object::Controller, Object::Robot), Some(FunctionId::CONTROLLER_GET_ROBOT));
        assert_eq!(opened_by(Object::Task, Object::Variable), Some(FunctionId::TASK_GET_VARIABLE));
        assert_eq!(opened_by(Object::File, Object::File), Some(FunctionId::FILE_GET_FILE));
        assert_eq!(opened_by(Object::Robot, Object::Task), None);
        assert_eq!(opened_by(Object::Controller, Object::Message), None);
    }
}
