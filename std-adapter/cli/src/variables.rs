//! `bcap get`, `bcap put` and `bcap names`.

use bcap_core::bcap::{FunctionId, Object};
use bcap_core::variant::Variant;

use crate::args::{Get, LinkArgs, Put};
use crate::error::Failure;
use crate::item::print_line;
use crate::object::{Path, Step, word};
use crate::plain;
use crate::session::{Session, integer, strings, text, with_session};
use crate::value::Value;

/// Runs `bcap get`.
pub(crate) fn get(args: &Get, link: &LinkArgs, json: bool) -> Result<(), Failure> {
    let paths = parse_all(&args.names)?;
    with_session(link, |session| print_each(&args.names, &paths, json, |path| get_one(session, path)))
}

/// Reads variables one after the other and prints what they hold; one that is refused does not cost the others.
pub(crate) fn print_each<V>(
    names: &[String],
    variables: &[V],
    json: bool,
    mut read: impl FnMut(&V) -> Result<Value, Failure>,
) -> Result<(), Failure> {
    let mut refused = 0;
    for (name, variable) in names.iter().zip(variables) {
        match read(variable) {
            Ok(value) => print_line(&shown(name, &value, json))?,
            Err(failure @ Failure::Refused { .. }) => {
                failure.print(json, Some(name));
                refused += 1;
            }
            Err(failure) => return Err(failure),
        }
    }
    if refused > 0 { Err(Failure::SomeRefused { refused, asked: names.len() }) } else { Ok(()) }
}

/// Runs `bcap put`.
pub(crate) fn put(args: &Put, link: &LinkArgs, json: bool) -> Result<(), Failure> {
    let path = Path::variable(&args.name).map_err(Failure::Input)?;
    with_session(link, |session| {
        let variable = session.object(&path)?;
        let current = match session.call_on(&path, FunctionId::VARIABLE_GET_VALUE, &[integer(variable)?]) {
            // a variable that can only be written tells no type, but one may stand in front of the data
            Err(Failure::Refused { .. }) if plain::from_typed(&args.value).is_ok() => None,
            current => current?,
        };
        let current = current.as_ref().map_or(Variant::Empty, Value::as_variant);
        let value = plain::from_input(&args.value, current)
            .map_err(|error| Failure::Input(format!("{}: {error}{}", args.value, expected(current))))?;
        session.call_on(&path, FunctionId::VARIABLE_PUT_VALUE, &[integer(variable)?, value.clone()])?;
        print_line(&shown(&args.name, &value, json))
    })
}

/// Says which data a variable takes.
pub(crate) fn expected(current: Variant<'_>) -> String {
    match current {
        Variant::Empty | Variant::Null => "; write TYPE,DATA, as the variable does not tell its type".into(),
        Variant::Array(array) => format!("; the variable holds {} of {}", array.len(), array.element()),
        scalar => format!("; the variable holds {}", scalar.vartype()),
    }
}

pub(crate) fn parse_all(names: &[String]) -> Result<Vec<Path>, Failure> {
    names.iter().map(|name| Path::variable(name).map_err(Failure::Input)).collect()
}

fn get_one(session: &mut Session, path: &Path) -> Result<Value, Failure> {
    let variable = session.object(path)?;
    let value = read(session, path, variable);
    let released = session.release(variable);
    // why it cannot be read says more than why it cannot be released
    let value = value?;
    released.map(|()| value)
}

/// Reads an opened variable.
pub(crate) fn read(session: &mut Session, path: &Path, variable: i32) -> Result<Value, Failure> {
    let value = session.call_on(path, FunctionId::VARIABLE_GET_VALUE, &[integer(variable)?])?;
    Ok(value.map_or_else(|| Value::new(&()), Ok)?)
}

/// Writes a value with its name: `I1 = 5`, or `{"name":"I1","vt":3,"v":5}`.
pub(crate) fn shown(name: &str, value: &Value, json: bool) -> String {
    if json {
        let name = serde_json::Value::from(name);
        format!("{{\"name\":{name},{}", &value.to_json()[1..])
    } else {
        format!("{name} = {}", visible(&plain::to_plain(value.as_variant())))
    }
}

/// Writes control characters as Rust does, not to let a peer's text command the terminal.
fn visible(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        if c.is_control() { out.extend(c.escape_default()) } else { out.push(c) }
    }
    out
}

/// The functions that list names, and the objects that the names are of.
const LISTS: [(Object, FunctionId); 6] = [
    (Object::Variable, FunctionId::CONTROLLER_GET_VARIABLE_NAMES),
    (Object::Robot, FunctionId::CONTROLLER_GET_ROBOT_NAMES),
    (Object::Task, FunctionId::CONTROLLER_GET_TASK_NAMES),
    (Object::File, FunctionId::CONTROLLER_GET_FILE_NAMES),
    (Object::Extension, FunctionId::CONTROLLER_GET_EXTENSION_NAMES),
    (Object::Command, FunctionId::CONTROLLER_GET_COMMAND_NAMES),
];

/// Runs `bcap names`.
pub(crate) fn names(link: &LinkArgs, json: bool) -> Result<(), Failure> {
    with_session(link, |session| {
        let controller = Path { steps: Vec::new() };
        let mut refusals = Vec::new();
        for (object, function) in LISTS {
            let names = match list(session, &controller, function) {
                Err(failure @ Failure::Refused { .. }) => {
                    refusals.push(failure);
                    continue;
                }
                names => names?,
            };
            for name in names {
                let path = Path { steps: vec![Step { object, name: Some(name) }] };
                print_name(&path, json)?;
                let inner = match object {
                    Object::Robot => FunctionId::ROBOT_GET_VARIABLE_NAMES,
                    Object::Task => FunctionId::TASK_GET_VARIABLE_NAMES,
                    _ => continue,
                };
                match list(session, &path, inner) {
                    Err(Failure::Refused { .. }) => {}
                    variables => {
                        for variable in variables? {
                            let mut path = path.clone();
                            path.steps.push(Step { object: Object::Variable, name: Some(variable) });
                            print_name(&path, json)?;
                        }
                    }
                }
            }
        }
        // not every controller has lists of everything; one without any is worth an error
        match refusals.pop() {
            Some(failure) if refusals.len() + 1 == LISTS.len() => Err(failure),
            _ => Ok(()),
        }
    })
}

fn list(session: &mut Session, owner: &Path, function: FunctionId) -> Result<Vec<String>, Failure> {
    let handle = session.object(owner)?;
    let names = session.call_on(owner, function, &[integer(handle)?, text("")?]);
    if !owner.steps.is_empty() {
        session.release(handle)?;
    }
    Ok(names?.as_ref().map(strings).unwrap_or_default())
}

fn print_name(path: &Path, json: bool) -> Result<(), Failure> {
    if json {
        let kind = word(path.object());
        print_line(&serde_json::json!({ "kind": kind, "name": path.to_string() }).to_string())
    } else {
        print_line(&visible(&path.to_string()))
    }
}

#[cfg(test)]
mod tests {
    use super::visible;

    #[test]
    fn control_characters_do_not_reach_the_terminal() {
        assert_eq!(visible("\u{1b}]0;x\u{7}\u{9b}31m, Grün\n"), "\\u{1b}]0;x\\u{7}\\u{9b}31m, Grün\\n");
    }
}
