//! Bytes as hexadecimal digits, in the formats of common tools.
//!
//! Digits come in pairs, in either case. Blanks, colons, commas and `0x` prefixes may separate the pairs, so the output of
//! Wireshark, `xxd` or `candump`, or a part of a source file, can be pasted without changes.

use crate::error::ConvertError;

/// Parses bytes from their digits.
///
/// # Errors
///
/// The position of the first character that is not expected.
pub fn parse(text: &[u8]) -> Result<Vec<u8>, ConvertError> {
    let mut bytes = Vec::with_capacity(text.len() / 2);
    let mut at = 0;
    while let Some(&first) = text.get(at) {
        if first.is_ascii_whitespace() || first == b':' || first == b',' {
            at += 1;
        } else if let (b'0', Some(b'x' | b'X')) = (first, text.get(at + 1)) {
            at += 2;
            if !text.get(at).is_some_and(u8::is_ascii_hexdigit) {
                return Err(ConvertError::new(format!("two digits must follow 0x (character {at})"), at));
            }
        } else {
            let high = digit(first).ok_or_else(|| not_a_digit(text, at))?;
            let low = text.get(at + 1).copied().and_then(digit);
            let low = low.ok_or_else(|| half_a_byte(text, at + 1))?;
            bytes.push(high << 4 | low);
            at += 2;
        }
    }
    Ok(bytes)
}

/// Writes bytes as lower-case digits without separators.
#[must_use]
pub fn compact(bytes: &[u8]) -> String {
    joined(bytes, "")
}

/// Writes bytes as lower-case digits with a blank between two bytes.
#[must_use]
pub fn spaced(bytes: &[u8]) -> String {
    joined(bytes, " ")
}

fn joined(bytes: &[u8], separator: &str) -> String {
    let mut text = String::with_capacity(bytes.len() * (2 + separator.len()));
    for (i, byte) in bytes.iter().enumerate() {
        if i > 0 {
            text.push_str(separator);
        }
        for nibble in [byte >> 4, byte & 0xf] {
            text.extend(char::from_digit(u32::from(nibble), 16));
        }
    }
    text
}

fn digit(character: u8) -> Option<u8> {
    char::from(character).to_digit(16).and_then(|value| u8::try_from(value).ok())
}

/// The error at the position of a byte's first digit.
fn not_a_digit(text: &[u8], at: usize) -> ConvertError {
    ConvertError::new(format!("{} is not a hexadecimal digit (character {at} of the text)", character(text, at)), at)
}

/// The error at the position of a byte's second digit.
fn half_a_byte(text: &[u8], at: usize) -> ConvertError {
    let message = match text.get(at) {
        None => format!("the text ends inside a byte, after {at} characters"),
        Some(_) => format!("expected the second digit of a byte, found {} (character {at})", character(text, at)),
    };
    ConvertError::new(message, at)
}

/// Describes the character at an offset of a text that may not be UTF-8, for a message.
fn character(text: &[u8], at: usize) -> String {
    let rest = text.get(at..).unwrap_or_default();
    match rest.utf8_chunks().next().and_then(|chunk| chunk.valid().chars().next()) {
        Some(c) => format!("{c:?}"),
        None => format!("the byte 0x{:02x}", rest.first().copied().unwrap_or(0)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn digits_are_parsed_in_all_formats() {
        for text in ["011004ff", "01 10 04 FF", "01:10:04:ff", "0x01, 0x10,0X04 0xff", " 0x011004 ff\t", "01\n1004ff\r"]
        {
            assert_eq!(parse(text.as_bytes()).unwrap(), [1, 0x10, 4, 0xff], "{text}");
        }
        assert_eq!(parse(b"").unwrap(), [0_u8; 0]);
        // 0x is a prefix only at the start of a byte
        assert!(parse(b"00x1").is_err());
    }

    #[test]
    fn errors_name_the_character_and_its_offset() {
        for (text, offset, word) in [
            ("01g0", 2, "'g'"),
            ("011", 3, "ends"),
            ("0 1", 1, "' '"),
            ("01-02", 2, "'-'"),
            ("0x", 2, "two digits must follow 0x"),
            ("01é1", 2, "'é'"),
        ] {
            let error = parse(text.as_bytes()).unwrap_err();
            assert_eq!(error.offset, offset, "{text}");
            assert!(error.message.contains(word), "{text}: {}", error.message);
        }
        assert!(parse(b"\xff1").unwrap_err().message.contains("0xff"));
    }

    #[test]
    fn bytes_are_written_in_lower_case() {
        assert_eq!(compact(&[0, 0xAB, 0x0f]), "00ab0f");
        assert_eq!(spaced(&[0, 0xAB, 0x0f]), "00 ab 0f");
    }
}
