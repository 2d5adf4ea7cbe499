//! Reads variables and lists of names over a session.

use bcap_capture::value::describe;
use bcap_core::bcap::{FunctionId, Object};
use bcap_core::hresult::HResult;
use bcap_core::variant::Variant;
use bcap_std::ObjectPath;

use crate::failure::Failure;
use crate::session::Session;
use crate::values::{Value, integer, text};

/// Parses the names of variables.
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
pub(crate) fn all_strings(list: Variant<'_>) -> Option<Vec<String>> {
    match list {
        Variant::Empty | Variant::Null => Some(Vec::new()),
        list => list.as_array()?.iter().map(|name| name.as_bstr().map(|name| name.to_string())).collect(),
    }
}

/// Formats the values of `@TYPE`, `@MODE` and `@ERROR_CODE`, as far as the controller has them: `RC8 auto ok`.
pub(crate) fn state_words(kind: Option<String>, mode: Option<String>, code: Option<&str>) -> Vec<String> {
    let mode = mode.map(|mode| match mode.as_str() {
        "1" => "manual".into(),
        "2" => "teach-check".into(),
        "3" => "auto".into(),
        mode => format!("mode {mode}"),
    });
    let code = code.map(|code| match code.parse() {
        Ok(0) => "ok".into(),
        Ok(number) => format!("error {:#010X}", HResult(number).to_u32()),
        Err(_) => code.into(),
    });
    kind.into_iter().chain(mode).chain(code).collect()
}

/// Shortens the text of `@TYPE`: an RC8 answers "RC8 Controller".
pub(crate) fn short_type(kind: &str) -> String {
    kind.trim().strip_suffix(" Controller").unwrap_or(kind.trim()).to_owned()
}
