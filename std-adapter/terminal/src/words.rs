//! The words of a line of the shell or of a script.
//!
//! Blanks separate words. Text between `'` or `"` is one word or a part of one. `$x` and `${x}` are replaced by a variable,
//! except between `'`. `#` at the beginning of a word begins a comment. A backslash is an ordinary character, because paths of
//! the controller contain it.

use std::collections::HashMap;

/// Splits a line into words, and replaces variables. The words of `literal` begin with `$` and are not variables.
///
/// # Errors
///
/// The text of the error: an unclosed quote or brace, or an unset variable.
pub fn split(line: &str, variables: &HashMap<String, String>, literal: &[&str]) -> Result<Vec<String>, String> {
    let mut words = Vec::new();
    let mut word: Option<String> = None;
    let mut quote = None;
    let mut rest = line;
    while let Some(c) = rest.chars().next() {
        let after = rest.get(c.len_utf8()..).unwrap_or_default();
        match (c, quote) {
            (c, Some(open)) if c == open => quote = None,
            ('\'' | '"', None) => {
                quote = Some(c);
                word.get_or_insert_default();
            }
            ('$', None | Some('"')) => {
                let (value, after) = variable(rest, variables, literal)?;
                word.get_or_insert_default().push_str(&value);
                rest = after;
                continue;
            }
            ('#', None) if word.is_none() => break,
            (c, None) if c.is_whitespace() => words.extend(word.take()),
            (c, _) => word.get_or_insert_default().push(c),
        }
        rest = after;
    }
    if let Some(quote) = quote {
        return Err(format!("the closing {quote} is missing"));
    }
    words.extend(word);
    Ok(words)
}

/// Returns the value of the variable at the beginning of `text`, and the text after it.
fn variable<'a>(
    text: &'a str,
    variables: &HashMap<String, String>,
    literal: &[&str],
) -> Result<(String, &'a str), String> {
    if let Some((name, rest)) = literal.iter().find_map(|name| Some((name, text.strip_prefix(name)?))) {
        return Ok(((*name).to_owned(), rest));
    }
    let text = text.strip_prefix('$').unwrap_or(text);
    let (name, rest) = if let Some(braced) = text.strip_prefix('{') {
        braced.split_once('}').ok_or("the closing } of a variable is missing")?
    } else {
        let end = text.find(|c: char| !is_name(c)).unwrap_or(text.len());
        text.split_at(end)
    };
    match variables.get(name) {
        Some(value) => Ok((value.clone(), rest)),
        None if name.is_empty() => Err("a name must follow $; write '$' for the character itself".into()),
        None => Err(format!("the variable {name} is not set; `set {name} = VALUE` sets it")),
    }
}

/// Returns whether a character may be in the name of a variable.
#[must_use]
pub fn is_name(c: char) -> bool {
    c.is_alphanumeric() || c == '_'
}

#[cfg(test)]
mod tests {
    use super::*;

    #[track_caller]
    fn words(line: &str) -> Vec<String> {
        let variables = [("x", "3"), ("name", "a b")].map(|(name, value)| (name.to_owned(), value.to_owned()));
        match split(line, &HashMap::from(variables), &["$LAST$"]) {
            Ok(words) => words,
            Err(error) => vec![format!("error: {error}")],
        }
    }

    #[test]
    fn blanks_quotes_and_comments_separate_words() {
        assert_eq!(words("  get I1\tI2  "), ["get", "I1", "I2"]);
        assert_eq!(words("put S1 'hello,  world'"), ["put", "S1", "hello,  world"]);
        assert_eq!(words("put S1 \"it's\"''x"), ["put", "S1", "it'sx"]);
        assert_eq!(words("put S1 ''"), ["put", "S1", ""]);
        assert_eq!(words("get I1 # a comment"), ["get", "I1"]);
        assert_eq!(words("put S1 a#b '#c'"), ["put", "S1", "a#b", "#c"]);
        assert_eq!(words(r"get file:a\b"), ["get", r"file:a\b"]);
        assert_eq!(words("# all"), [""; 0]);
        assert_eq!(words("put S1 'x"), ["error: the closing ' is missing"]);
    }

    #[test]
    fn variables_are_replaced() {
        assert_eq!(words("put I$x ${x}5 '$x' \"<$name>\" $name"), ["put", "I3", "35", "$x", "<a b>", "a b"]);
        assert_eq!(words("get $LAST$"), ["get", "$LAST$"]);
        assert_eq!(words("get $y"), ["error: the variable y is not set; `set y = VALUE` sets it"]);
        assert_eq!(words("get ${x"), ["error: the closing } of a variable is missing"]);
        assert_eq!(words("get $"), ["error: a name must follow $; write '$' for the character itself"]);
    }
}
