//! Option strings: `KEY=VALUE, KEY` between commas, whatever the case of the keys.

/// Iterates over the options, as key and value; commas inside brackets belong to the value.
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

/// Returns the value of an option; the first one wins.
pub(crate) fn option<'t>(text: &'t str, key: &str) -> Option<&'t str> {
    options(text).find(|(k, _)| k.eq_ignore_ascii_case(key)).and_then(|(_, value)| value)
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
