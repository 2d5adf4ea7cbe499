//! Option strings, `KEY=VALUE, KEY`, whose keys ignore case; and the pass of a motion.

use bcap_core::hresult::HResult;
use bcap_core::variant::Variant;

/// Iterates over the keys and values; a comma inside brackets belongs to the value.
pub(crate) fn options(text: &str) -> impl Iterator<Item = (&str, Option<&str>)> {
    let mut depth = 0_i32;
    let parts = text.split(move |c| {
        match c {
            '(' | '[' | '{' | '<' => depth += 1,
            ')' | ']' | '}' | '>' => depth -= 1,
            _ => {}
        }
        c == ',' && depth <= 0
    });
    parts.map(str::trim).filter(|part| !part.is_empty()).map(|part| match part.split_once('=') {
        Some((key, value)) => (key.trim(), Some(value.trim())),
        None => (part, None),
    })
}

/// Returns the value of an option; of several, that of the first.
pub(crate) fn option<'t>(text: &'t str, key: &str) -> Option<&'t str> {
    options(text).find(|(k, _)| k.eq_ignore_ascii_case(key)).and_then(|(_, value)| value)
}

/// Checks and removes the pass at the beginning of a text, if it has one.
pub(crate) fn split_pass(text: &str) -> Result<&str, HResult> {
    let text = text.trim();
    if !text.starts_with('@') {
        return Ok(text);
    }
    let (pass, rest) = text.split_once(char::is_whitespace).ok_or(HResult::E_INVALIDARG)?;
    check_pass(pass)?;
    Ok(rest.trim_start())
}

/// Checks a pass in an array: EMPTY, its text, or its number (`@P` -1, `@E` -2, `@0`, `@n`).
pub(crate) fn check_pass_item(item: &Variant<'_>) -> Result<(), HResult> {
    match item.flatten() {
        Variant::Empty | Variant::Null => Ok(()),
        Variant::Bstr(pass) => check_pass(&pass.to_string()),
        pass if pass.as_i32().is_some_and(|n| n >= -2) => Ok(()),
        _ => Err(HResult::E_INVALIDARG),
    }
}

fn check_pass(pass: &str) -> Result<(), HResult> {
    let rest = pass.trim().strip_prefix('@').unwrap_or(pass.trim());
    match rest {
        "P" | "p" | "E" | "e" => Ok(()),
        digits if !digits.is_empty() && digits.bytes().all(|b| b.is_ascii_digit()) => Ok(()),
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
}
