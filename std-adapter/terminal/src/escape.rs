//! Escapes untrusted text before it is printed.
//!
//! Names, values and error texts can come from a controller, a file or a caller. Control characters in them could move the
//! cursor, reorder the text around them, or start a new line. [`acts`] is the only list of these characters. Every line that
//! the programs print passes through [`line()`], [`block`], [`json`] or [`failure`].

use std::fmt::{self, Write as _};

/// The maximum length of an error or hint, in characters.
const LONGEST: usize = 1000;

/// Returns whether a character acts on a terminal or on the text around it.
///
/// These are the control characters of ASCII and Latin-1, the bidirectional controls of Unicode (UAX #9), and the
/// separators of lines and paragraphs.
pub fn acts(c: char) -> bool {
    c.is_control()
        || matches!(c, '\u{061c}' | '\u{200e}' | '\u{200f}' | '\u{2028}'..='\u{202e}' | '\u{2066}'..='\u{2069}')
}

/// Escapes one line as Rust does: `\n`, `\u{9b}`.
pub fn line(text: &str) -> String {
    escaped(text, acts)
}

/// Escapes text that the program has laid out in lines, and keeps its line breaks.
///
/// Text from outside that is part of the layout must have been escaped with [`line()`] or as a `Debug` literal.
pub fn block(text: &str) -> String {
    escaped(text, |c| acts(c) && c != '\n')
}

fn escaped(text: &str, is_escaped: impl Fn(char) -> bool) -> String {
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        if is_escaped(c) { out.extend(c.escape_default()) } else { out.push(c) }
    }
    out
}

/// Escapes lines of JSON as JSON does: `\u009b`. The value of the JSON stays the same.
///
/// The serializer has escaped line breaks inside strings, so every line break is between two lines of JSON.
pub fn json(lines: &str) -> String {
    let mut out = String::with_capacity(lines.len());
    for c in lines.chars() {
        if acts(c) && c != '\n' {
            // writing to a string cannot fail; all of these characters have 16 bits
            let _ = write!(out, "\\u{:04x}", u32::from(c));
        } else {
            out.push(c);
        }
    }
    out
}

/// Escapes an error or a hint. Further lines are indented, so they cannot be mistaken for another error.
pub fn failure(text: &impl fmt::Display) -> String {
    block(&cut(text)).replace('\n', "\n       ")
}

/// Truncates a text to 1,000 characters, and adds the number of omitted characters.
pub fn cut(text: &impl fmt::Display) -> String {
    let mut cut = Cut { text: String::new(), room: LONGEST, more: 0 };
    // `Cut` accepts all text
    let _ = write!(cut, "{text}");
    match cut.more {
        0 => cut.text,
        more => format!("{}... ({more} more characters)", cut.text),
    }
}

struct Cut {
    text: String,
    room: usize,
    more: usize,
}

impl fmt::Write for Cut {
    fn write_str(&mut self, part: &str) -> fmt::Result {
        for c in part.chars() {
            if self.room > 0 {
                self.text.push(c);
                self.room -= 1;
            } else {
                self.more += 1;
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// The list of [`acts`] as ranges.
    const ACTING: [(u32, u32); 7] = [
        (0, 0x1f),
        (0x7f, 0x9f),
        (0x61c, 0x61c),
        (0x200e, 0x200f),
        (0x2028, 0x2029),
        (0x202a, 0x202e),
        (0x2066, 0x2069),
    ];

    #[test]
    fn acts_is_true_for_exactly_the_listed_characters() {
        for c in '\0'..=char::MAX {
            let listed = ACTING.iter().any(|(first, last)| (*first..=*last).contains(&u32::from(c)));
            assert_eq!(acts(c), listed, "{c:?}");
        }
    }

    #[test]
    fn lines_are_escaped() {
        assert_eq!(line("\u{1b}]0;x\u{7}\u{9b}31m, Grün\n"), "\\u{1b}]0;x\\u{7}\\u{9b}31m, Grün\\n");
        assert_eq!(block("a\u{202e}\nb"), "a\\u{202e}\nb");
        assert_eq!(json("\"\u{7f}\u{2028}\"\n\"x\""), "\"\\u007f\\u2028\"\n\"x\"");
        assert_eq!(failure(&"a\nerror: b"), "a\n       error: b");
    }

    #[test]
    fn a_truncated_error_has_the_number_of_omitted_characters() {
        assert_eq!(cut(&"é".repeat(LONGEST)), "é".repeat(LONGEST));
        let long = cut(&"é".repeat(LONGEST + 23));
        assert_eq!(long, format!("{}... (23 more characters)", "é".repeat(LONGEST)));
    }

    fn text() -> impl Strategy<Value = String> {
        let acting = proptest::sample::select(ACTING.to_vec()).prop_flat_map(|(first, last)| first..=last);
        let acting = acting.prop_map(|code| char::from_u32(code).unwrap());
        proptest::collection::vec(prop_oneof![acting, any::<char>()], 0..40).prop_map(String::from_iter)
    }

    proptest! {
        #[test]
        fn escaped_text_has_no_acting_character(text in text()) {
            prop_assert!(!line(&text).chars().any(acts));
            prop_assert!(!block(&text).chars().any(|c| acts(c) && c != '\n'));
            prop_assert!(!failure(&text).chars().any(|c| acts(c) && c != '\n'));
            prop_assert_eq!(failure(&text).replace("\n       ", ""), block(&text).replace('\n', ""));
        }

        #[test]
        fn json_is_one_line_of_the_same_value(text in text()) {
            let value = serde_json::json!({ "name": text });
            let line = json(&value.to_string());
            prop_assert!(!line.chars().any(acts));
            prop_assert_eq!(serde_json::from_str::<serde_json::Value>(&line).unwrap(), value);
        }
    }
}
