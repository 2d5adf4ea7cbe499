//! `bcap get` and `bcap names`.

use bcap_core::bcap::{FunctionId, Object};
use bcap_core::hresult::HResult;
use bcap_core::variant::Variant;
use bcap_std::ObjectPath;

use crate::error::Failure;
use crate::output::{print_json, print_line};
use crate::plain;
use crate::session::Session;
use crate::stream::spare;
use crate::value::{Value, integer, text};
use crate::words::LAST_PACKETS;
use bcap_capture::value::{describe, to_json};

/// Returns the packet of a variable of the b-CAP Tester's debug mode (b-CAP specification, Table 6-1); `None` for
/// another name.
pub(crate) fn last_packet(session: &Session, name: &str) -> Option<Vec<u8>> {
    match LAST_PACKETS.iter().position(|known| name.strip_prefix("variable:").unwrap_or(name) == *known)? {
        0 => Some(session.packets.last_sent()),
        _ => Some(session.packets.last_received()),
    }
}

/// Reads variables in order and prints their values; continues after a refusal.
pub(crate) fn print_each<V>(
    names: &[String],
    variables: &[V],
    json: bool,
    mut read: impl FnMut(&V) -> Result<Value, Failure>,
) -> Result<(), Failure> {
    let mut refused = 0;
    for (name, variable) in names.iter().zip(variables) {
        match read(variable) {
            Ok(value) => print(&shown(name, &value, json), json)?,
            Err(failure @ Failure::Refused { .. }) => {
                failure.print(json, Some(name));
                refused += 1;
            }
            Err(failure) => return Err(failure),
        }
    }
    if refused > 0 { Err(Failure::SomeRefused { refused, total: names.len() }) } else { Ok(()) }
}

pub(crate) fn paths(names: &[String]) -> Result<Vec<ObjectPath>, Failure> {
    names.iter().map(|name| Ok(ObjectPath::variable(name)?)).collect()
}

/// Reads a variable and releases it.
pub(crate) fn get_one(session: &mut Session, path: &ObjectPath) -> Result<Value, Failure> {
    let variable = session.object(path)?;
    let value = read(session, path, variable);
    if value.as_ref().is_err_and(|failure| !failure.leaves_the_session_alive()) {
        return value;
    }
    let released = session.release(Object::Variable, variable);
    // an error of the read is more useful than an error of the release
    let value = value?;
    released.map(|()| value)
}

/// Reads an opened variable.
pub(crate) fn read(session: &mut Session, path: &ObjectPath, variable: i32) -> Result<Value, Failure> {
    let (_, value) = session.call(&path.to_string(), FunctionId::VARIABLE_GET_VALUE, &[integer(variable)?])?;
    Ok(value.unwrap_or_default())
}

/// Formats a value with its name: `I1 = 5`, or `{"name":"I1","vt":3,"v":5}`.
pub(crate) fn shown(name: &str, value: &Value, json: bool) -> String {
    if json {
        let name = serde_json::Value::from(name);
        format!("{{\"name\":{name},{}", &to_json(value.as_variant())[1..])
    } else {
        format!("{name} = {}", plain::to_plain(value.as_variant()))
    }
}

/// Prints a line of text, or of JSON.
pub(crate) fn print(line: &str, json: bool) -> Result<(), Failure> {
    Ok(if json { print_json(line) } else { print_line(line) }?)
}

/// The functions that list names, with the kind of the listed objects.
const LISTS: [(Object, FunctionId); 6] = [
    (Object::Variable, FunctionId::CONTROLLER_GET_VARIABLE_NAMES),
    (Object::Robot, FunctionId::CONTROLLER_GET_ROBOT_NAMES),
    (Object::Task, FunctionId::CONTROLLER_GET_TASK_NAMES),
    (Object::File, FunctionId::CONTROLLER_GET_FILE_NAMES),
    (Object::Extension, FunctionId::CONTROLLER_GET_EXTENSION_NAMES),
    (Object::Command, FunctionId::CONTROLLER_GET_COMMAND_NAMES),
];

/// Runs `bcap names`.
pub(crate) fn names(session: &mut Session, json: bool) -> Result<(), Failure> {
    spare(session, FunctionId::CONTROLLER_GET_VARIABLE_NAMES, None)?;
    let mut lists = Lists { session, json, total: 0, missing: 0, refused: 0 };
    let controller = ObjectPath::controller();
    for (object, function) in LISTS {
        for path in lists.print(&controller, object, function)? {
            let inner = match object {
                Object::Robot => FunctionId::ROBOT_GET_VARIABLE_NAMES,
                Object::Task => FunctionId::TASK_GET_VARIABLE_NAMES,
                _ => continue,
            };
            lists.print(&path, Object::Variable, inner)?;
        }
    }
    lists.end()
}

/// Returns the names of all lists that the controller has, for completion; `None` while they cannot be read.
pub(crate) fn all_names(session: &mut Session) -> Option<Vec<String>> {
    spare(session, FunctionId::CONTROLLER_GET_VARIABLE_NAMES, None).ok()?;
    let mut all = Vec::new();
    let controller = ObjectPath::controller();
    for (object, function) in LISTS {
        for name in list(session, &controller, function).unwrap_or_default() {
            let path = controller.clone().join(object, name);
            if object == Object::Robot {
                let inner = list(session, &path, FunctionId::ROBOT_GET_VARIABLE_NAMES).unwrap_or_default();
                all.extend(inner.into_iter().map(|name| format!("robot/{name}")));
            }
            all.push(path.to_string());
        }
    }
    Some(all)
}

/// Prints the lists of `bcap names`: each completely, or not at all. A refused list is reported, except one that the
/// controller does not implement.
struct Lists<'a> {
    session: &'a mut Session,
    json: bool,
    total: usize,
    /// The number of lists that the controller does not implement.
    missing: usize,
    refused: usize,
}

impl Lists<'_> {
    /// Prints a list of the names of `owner`'s objects, and returns the paths to them.
    fn print(&mut self, owner: &ObjectPath, object: Object, function: FunctionId) -> Result<Vec<ObjectPath>, Failure> {
        self.total += 1;
        let names = match list(self.session, owner, function) {
            Err(Failure::Refused { code: HResult::E_NOTIMPL, .. }) => {
                self.missing += 1;
                return Ok(Vec::new());
            }
            Err(failure @ Failure::Refused { .. }) => {
                // for example E_TOO_MUCH_DATA for a list that does not fit a datagram
                failure.print(self.json, None);
                self.refused += 1;
                return Ok(Vec::new());
            }
            names => names?,
        };
        let paths: Vec<ObjectPath> = names.into_iter().map(|name| owner.clone().join(object, name)).collect();
        paths.iter().try_for_each(|path| print_name(path, self.json))?;
        Ok(paths)
    }

    /// Returns an error if a list was refused, or if the controller implements no list.
    fn end(self) -> Result<(), Failure> {
        match self {
            Self { refused: 0, missing, total, .. } if missing < total => Ok(()),
            Self { refused: 0, .. } => {
                Err(Failure::Refused { doing: "the lists of names".into(), code: HResult::E_NOTIMPL })
            }
            Self { refused, total, .. } => Err(Failure::ListsRefused { refused, total }),
        }
    }
}

/// Reads a list of names. A reply that is not a list of strings is an error, so no list is printed in part.
pub(crate) fn list(session: &mut Session, owner: &ObjectPath, function: FunctionId) -> Result<Vec<String>, Failure> {
    let handle = session.object(owner)?;
    let names = session.call(&owner.to_string(), function, &[integer(handle)?, text("")?]);
    let released = match owner.object() {
        // the robot stays open, because it may have the arm
        Object::Controller | Object::Robot => Ok(()),
        object => session.release(object, handle),
    };
    // an error of the list is more useful than an error of the release
    let (_, names) = names?;
    released?;
    match names {
        None => Ok(Vec::new()),
        Some(value) => all_strings(value.as_variant()).ok_or_else(|| Failure::Unexpected {
            message: format!("{function}: the reply carries {} instead of a list of names", describe(Some(&value))),
            hint: "use `bcap call` to see the reply: it prints any value".into(),
        }),
    }
}

/// Returns the strings of a list; `None` if an element is not a string.
fn all_strings(list: Variant<'_>) -> Option<Vec<String>> {
    match list {
        Variant::Empty | Variant::Null => Some(Vec::new()),
        list => list.as_array()?.iter().map(|name| name.as_bstr().map(|name| name.to_string())).collect(),
    }
}

fn print_name(path: &ObjectPath, json: bool) -> Result<(), Failure> {
    if json {
        let kind = path.object().name().to_ascii_lowercase();
        print_json(&serde_json::json!({ "kind": kind, "name": path.to_string() }).to_string())?;
    } else {
        print_line(&path.to_string())?;
    }
    Ok(())
}
