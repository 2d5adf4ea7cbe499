//! The comparison of an output with a page, where `...` stands for any text.

/// Returns whether the lines are the expected ones.
pub(crate) fn matches(expected: &[String], actual: &[String]) -> bool {
    match expected.split_first() {
        None => actual.is_empty(),
        Some((line, rest)) if line == "..." => (0..=actual.len()).any(|skipped| matches(rest, &actual[skipped..])),
        Some((line, rest)) => {
            actual.split_first().is_some_and(|(first, others)| line_matches(line, first) && matches(rest, others))
        }
    }
}

fn line_matches(expected: &str, actual: &str) -> bool {
    let Some((head, mut rest)) = expected.split_once("...") else { return expected == actual };
    let Some(mut actual) = actual.strip_prefix(head) else { return false };
    while let Some((part, others)) = rest.split_once("...") {
        let Some(at) = actual.find(part) else { return false };
        actual = &actual[at + part.len()..];
        rest = others;
    }
    actual.ends_with(rest)
}

/// Replaces each address by its counterpart, in one pass; the longest match counts. A match is a whole address: no part of
/// a longer number or name.
pub(crate) fn replace(text: &str, pairs: &[(String, String)]) -> String {
    let mut result = String::with_capacity(text.len());
    let mut rest = text;
    while let Some(next) = rest.chars().next() {
        let is_start = !result.ends_with(|last: char| last.is_ascii_alphanumeric() || last == '.');
        let found = pairs.iter().filter(|(from, _)| is_start && rest.starts_with(from.as_str())).filter(|(from, _)| {
            let after = &rest[from.len()..];
            !after.starts_with(|next: char| next.is_ascii_digit())
        });
        if let Some((from, to)) = found.max_by_key(|(from, _)| from.len()) {
            result.push_str(to);
            rest = &rest[from.len()..];
        } else {
            result.push(next);
            rest = &rest[next.len_utf8()..];
        }
    }
    result
}
