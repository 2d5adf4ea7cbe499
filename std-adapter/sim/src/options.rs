//! Option strings, `KEY=VALUE, KEY`, whose keys ignore case; and the pass of a motion.
//!
//! | function                         | options that public programs send                         |
//! |----------------------------------|-----------------------------------------------------------|
//! | Service_Start                    | `WDT=`, `InvokeTimeout=`                                  |
//! | Controller_Connect               | `@IfNotMember`, `@EventDisable=`, `WPJ=`, `Interval=`, `Server=` |
//! | Controller_GetRobot              | `ID=`, `@IfNotMember`                                     |
//! | Controller_GetFile, File_GetFile | `@Create=`, `@IfNotMember`                                |
//! | the other functions that open an object | `@IfNotMember`                                     |
//! | Task_Start, Task_Stop            | none                                                      |
//! | motions                          | see [`arm`](crate::arm)                                   |
//!
//! Any other option is refused with `E_INVALIDARG`, so that a misspelt option does not pass unnoticed; no source names a code.
//! A [lenient](crate::Config::lenient) controller ignores it, as the vendor's server library does in Service_Start, and
//! notifies the [observer](crate::explain::Observer).

use bcap_core::bcap::FunctionId;
use bcap_core::bcap::server::Request;
use bcap_core::hresult::HResult;
use bcap_core::variant::Variant;

use crate::config::Config;

/// Iterates over the keys and values; a comma inside brackets belongs to the value.
pub(crate) fn options(text: &str) -> impl Iterator<Item = (&str, Option<&str>)> {
    split_outside_brackets(text).map(str::trim).filter(|part| !part.is_empty()).map(|part| match part.split_once('=') {
        Some((key, value)) => (key.trim(), Some(value.trim())),
        None => (part, None),
    })
}

/// The functions whose options are checked: the place of the option among the arguments, and the known keys.
const KNOWN: &[(FunctionId, usize, &[&str])] = &[
    (FunctionId::SERVICE_START, 0, &["WDT", "InvokeTimeout"]),
    (FunctionId::CONTROLLER_CONNECT, 3, &["@IfNotMember", "@EventDisable", "WPJ", "Interval", "Server"]),
    (FunctionId::CONTROLLER_GET_ROBOT, 2, &["ID", "@IfNotMember"]),
    (FunctionId::CONTROLLER_GET_FILE, 2, &["@Create", "@IfNotMember"]),
    (FunctionId::FILE_GET_FILE, 2, &["@Create", "@IfNotMember"]),
    (FunctionId::CONTROLLER_GET_VARIABLE, 2, IF_NOT_MEMBER),
    (FunctionId::ROBOT_GET_VARIABLE, 2, IF_NOT_MEMBER),
    (FunctionId::TASK_GET_VARIABLE, 2, IF_NOT_MEMBER),
    (FunctionId::CONTROLLER_GET_TASK, 2, IF_NOT_MEMBER),
    (FunctionId::CONTROLLER_GET_EXTENSION, 2, IF_NOT_MEMBER),
    (FunctionId::CONTROLLER_GET_COMMAND, 2, IF_NOT_MEMBER),
    (FunctionId::TASK_START, 2, &[]),
    (FunctionId::TASK_STOP, 2, &[]),
];

const IF_NOT_MEMBER: &[&str] = &["@IfNotMember"];

/// Checks the options of a request that are not motion options.
///
/// # Errors
///
/// `E_INVALIDARG` for an unknown option, unless the controller is lenient.
pub(crate) fn check(config: &Config, request: &Request<'_>) -> Result<(), HResult> {
    let Some((function, place, known)) = KNOWN.iter().find(|(function, ..)| *function == request.function) else {
        return Ok(());
    };
    let text = request.text(*place).to_string();
    for (key, _) in options(&text).filter(|(key, _)| !known.iter().any(|known| known.eq_ignore_ascii_case(key))) {
        config.unknown_option(&function.to_string(), key)?;
    }
    Ok(())
}

/// Splits a text at its commas, except those inside brackets.
pub(crate) fn split_outside_brackets(text: &str) -> impl Iterator<Item = &str> {
    let mut depth = 0_i32;
    text.split(move |c| {
        match c {
            '(' | '[' | '{' | '<' => depth += 1,
            ')' | ']' | '}' | '>' => depth -= 1,
            _ => {}
        }
        c == ',' && depth <= 0
    })
}

/// Returns the value of the first option with this key.
pub(crate) fn option<'t>(text: &'t str, key: &str) -> Option<&'t str> {
    options(text).find(|(k, _)| k.eq_ignore_ascii_case(key)).and_then(|(_, value)| value)
}

/// Returns whether a text has an option with this key.
pub(crate) fn has_option(text: &str, key: &str) -> bool {
    options(text).any(|(k, _)| k.eq_ignore_ascii_case(key))
}

/// The transition from a motion to the next motion.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) enum Pass {
    /// `@0`, `@E`, `@C`: it comes to rest first.
    #[default]
    Stop,
    /// `@P`, `@n`: the next motion begins while it brakes; with a number, within this distance of its end in mm.
    Near(Option<f64>),
}

/// Reads and removes the pass at the beginning of a text; without one, it is [`Pass::Stop`].
pub(crate) fn split_pass(text: &str) -> Result<(Pass, &str), HResult> {
    let text = text.trim();
    if !text.starts_with('@') {
        return Ok((Pass::Stop, text));
    }
    let (pass, rest) = text.split_once(char::is_whitespace).ok_or(HResult::E_INVALIDARG)?;
    Ok((pass_of_text(pass)?, rest.trim_start()))
}

/// Reads a pass in an array: EMPTY or "" for no pass, its text, or its number (`@P` -1, `@E` -2, `@0`, `@n`).
pub(crate) fn pass_item(item: &Variant<'_>) -> Result<Pass, HResult> {
    match item.flatten() {
        Variant::Empty | Variant::Null => Ok(Pass::Stop),
        Variant::Bstr(pass) if pass.to_string().trim().is_empty() => Ok(Pass::Stop),
        Variant::Bstr(pass) => pass_of_text(&pass.to_string()),
        pass => match pass.as_i32() {
            Some(-1) => Ok(Pass::Near(None)),
            Some(-2 | 0) => Ok(Pass::Stop),
            Some(n) if n > 0 => Ok(Pass::Near(Some(n.into()))),
            _ => Err(HResult::E_INVALIDARG),
        },
    }
}

/// Reads the text of a pass, with or without its `@`.
pub(crate) fn pass_of_text(pass: &str) -> Result<Pass, HResult> {
    let rest = pass.trim().strip_prefix('@').unwrap_or(pass.trim());
    match rest {
        "P" | "p" => Ok(Pass::Near(None)),
        "E" | "e" | "C" | "c" => Ok(Pass::Stop),
        _ if !rest.is_empty() && rest.bytes().all(|b| b.is_ascii_digit()) => match rest.parse::<f64>() {
            Ok(distance) if distance > 0.0 => Ok(Pass::Near(Some(distance))),
            Ok(_) => Ok(Pass::Stop),
            Err(_) => Err(HResult::E_INVALIDARG),
        },
        _ => Err(HResult::E_INVALIDARG),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_values_blanks_and_brackets() {
        let parsed: Vec<_> = options(",Speed = 10 , NEXT,x=(1,2),").collect();
        assert_eq!(parsed, [("Speed", Some("10")), ("NEXT", None), ("x", Some("(1,2)"))]);
        assert_eq!(option("id=1,ID=2", "ID"), Some("1"));
        assert_eq!(option("@IfNotMember", "ID"), None);
    }

    #[test]
    fn a_pass_stops_or_has_a_distance() {
        assert_eq!(split_pass("@P  P1"), Ok((Pass::Near(None), "P1")));
        assert_eq!(split_pass("@50 P1"), Ok((Pass::Near(Some(50.0)), "P1")));
        assert_eq!(split_pass("@0 P1"), Ok((Pass::Stop, "P1")));
        assert_eq!(split_pass("@e P1"), Ok((Pass::Stop, "P1")));
        assert_eq!(split_pass("P1"), Ok((Pass::Stop, "P1")));
        for text in ["@", "@X P1", "@-1 P1", "@1.5 P1"] {
            assert_eq!(split_pass(text), Err(HResult::E_INVALIDARG), "{text}");
        }
        assert_eq!(pass_item(&Variant::I4(-1)), Ok(Pass::Near(None)));
        assert_eq!(pass_item(&Variant::I4(20)), Ok(Pass::Near(Some(20.0))));
        assert_eq!(pass_item(&Variant::I4(-3)), Err(HResult::E_INVALIDARG));
    }
}
