//! Reads variables and lists of names.

use bcap_capture::value::selection::{Selection, names_of};
use bcap_capture::value::{data, describe};
use bcap_core::bcap::{FunctionId, Object};
use bcap_core::hresult::HResult;
use bcap_core::rac::VariableKind;
use bcap_core::variant::{OwnedVariant, Variant};
use bcap_std::ObjectPath;

use crate::calls::{Calls, Failure};
use crate::stream::StreamCheck;

/// Reads a variable and releases it.
///
/// # Errors
///
/// The error of a call.
pub fn get_one<C: Calls>(calls: &mut C, path: &ObjectPath) -> Result<OwnedVariant, C::Error> {
    let variable = calls.object(path)?;
    let value = read(calls, path, variable);
    if value.as_ref().is_err_and(Failure::is_lost) {
        return value;
    }
    let released = calls.release(Object::Variable, variable);
    // an error of the read is more useful than an error of the release
    let value = value?;
    released.map(|()| value)
}

/// Reads an opened variable.
///
/// # Errors
///
/// The error of the call.
pub fn read<C: Calls>(calls: &mut C, path: &ObjectPath, variable: i32) -> Result<OwnedVariant, C::Error> {
    let arguments = [OwnedVariant::new(&variable)?];
    let (_, value) = calls.call(&path.to_string(), FunctionId::VARIABLE_GET_VALUE, &arguments)?;
    Ok(value.unwrap_or_default())
}

/// Reads a variable whose object stays open.
///
/// # Errors
///
/// [`Failure::skipped`] if opening it would end a stream of Slave Mode, or the error of a call.
pub fn value<C: Calls>(calls: &mut C, check: &mut StreamCheck, path: &ObjectPath) -> Result<OwnedVariant, C::Error> {
    calls.restart_limit();
    check.require_open(calls, path)?;
    let variable = calls.object(path)?;
    read(calls, path, variable)
}

/// The maximum number of variables of a kind: an index has 16 bits.
const LONGEST: u32 = 1 << 16;

/// Returns the names of all selected variables, in order; reads the number of variables of a kind from the controller.
///
/// # Errors
///
/// [`Failure::unexpected`] for an impossible number, or the error of a call.
pub fn expand<C: Calls>(calls: &mut C, selections: &[Selection]) -> Result<Vec<String>, C::Error> {
    names_of(selections, |kind| count(calls, kind))
}

/// Reads the number of variables of a kind, such as `@VAR_I_LEN`.
///
/// # Errors
///
/// Same as [`expand`].
pub fn count<C: Calls>(calls: &mut C, kind: VariableKind) -> Result<u32, C::Error> {
    let name = format!("@VAR_{}_LEN", kind.name());
    let value = get_one(calls, &ObjectPath::variable(&name)?)?;
    value.convert().ok().filter(|count| *count <= LONGEST).ok_or_else(|| {
        let found = describe(Some(&value));
        C::Error::unexpected(format!(
            "{name} is {found}, which is not a number from 0 to {LONGEST}; use a range, such as I1-I50"
        ))
    })
}

/// Returns whether a variable is a system variable, such as `@SERVO_ON` or `@START`, whose write may switch the motor or start
/// a program. A controller may ignore blanks around its name.
#[must_use]
pub fn is_system_variable(path: &ObjectPath) -> bool {
    path.split_last().and_then(|(_, name)| name).is_some_and(|name| name.trim().starts_with('@'))
}

/// The variables that identify a virtual controller, with their values.
const VIRTUAL: [(&str, &str); 2] = [("@FIRMWARE", "bcap-sim"), ("@SERIAL_NO", "VIRTUAL")];

/// Returns whether the controller reports beyond doubt that it is virtual.
///
/// It counts as virtual only with two proofs: the firmware of the simulator, and the serial number that no real controller has.
/// Any other answer means a real controller.
///
/// # Errors
///
/// The loss of the session.
pub fn is_virtual<C: Calls>(calls: &mut C) -> Result<bool, C::Error> {
    for (name, expected) in VIRTUAL {
        match get_one(calls, &ObjectPath::variable(name)?) {
            Ok(value) if value.as_variant().as_bstr().is_some_and(|text| text == *expected) => {}
            Err(failure) if failure.is_lost() => return Err(failure),
            Ok(_) | Err(_) => return Ok(false),
        }
    }
    Ok(true)
}

/// Reads a list of names. A reply that is not a list of strings is an error, so no list is shown partly.
///
/// # Errors
///
/// [`Failure::unexpected`] for such a reply, or the error of a call.
pub fn list<C: Calls>(calls: &mut C, owner: &ObjectPath, function: FunctionId) -> Result<Vec<String>, C::Error> {
    let handle = calls.object(owner)?;
    let names = calls.call(&owner.to_string(), function, &[OwnedVariant::new(&handle)?, OwnedVariant::new("")?]);
    let released = match owner.object() {
        // the robot stays open, because it may have the arm
        Object::Controller | Object::Robot => Ok(()),
        object => calls.release(object, handle),
    };
    // an error of the list is more useful than an error of the release
    let (_, names) = names?;
    released?;
    match names {
        None => Ok(Vec::new()),
        Some(value) => all_strings(value.as_variant()).ok_or_else(|| {
            let found = describe(Some(&value));
            C::Error::unexpected(format!("{function}: the reply carries {found} instead of a list of names"))
        }),
    }
}

/// Returns the strings of a list; `None` if an element is not a string.
#[must_use]
pub fn all_strings(list: Variant<'_>) -> Option<Vec<String>> {
    match list {
        Variant::Empty | Variant::Null => Some(Vec::new()),
        list => list.as_array()?.iter().map(|name| name.as_bstr().map(|name| name.to_string())).collect(),
    }
}

/// Formats the values of `@TYPE`, `@MODE` and `@ERROR_CODE`, as far as the controller has them: `RC8 auto ok`.
#[must_use]
pub fn state_words(kind: Option<String>, mode: Option<String>, code: Option<&str>) -> Vec<String> {
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
#[must_use]
pub fn short_type(kind: &str) -> String {
    kind.trim().strip_suffix(" Controller").unwrap_or(kind.trim()).to_owned()
}

/// Formats a value of a variable.
#[must_use]
pub fn shown(value: &OwnedVariant) -> String {
    data::format(value.as_variant())
}
