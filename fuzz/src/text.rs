//! Fuzzes the text format of values against the oracle.

use bcap_core::error::{TextError, TextErrorKind};
use bcap_core::variant::VariantBuf;
use bcap_testkit::text;
use bcap_testkit::value::Value;

/// Maximum length of a tested text; its value fits into [`Owned`].
const LONGEST: usize = 1500;

pub(crate) type Owned = VariantBuf<8192>;

/// Parses bytes as the text of a value.
///
/// # Panics
///
/// When an assertion about the core fails.
pub fn text(data: &[u8]) {
    let data = &data[..data.len().min(LONGEST)];
    let ours = Owned::parse_text(data);
    match &ours {
        Ok(value) => print_again(value),
        Err(error) => check_error(error, data.len()),
    }
    assert_eq!(ours.ok().map(|value| Value::read(value.as_variant())), text::parse(data));
}

pub(crate) fn check_error(error: &TextError, len: usize) {
    assert!((1..=len as u32 + 1).contains(&error.column), "{error:?} in {len} bytes");
    assert!(!error.to_string().is_empty() && error.hresult().is_err());
    assert_ne!(error.kind, TextErrorKind::Full);
}

/// Checks that a parsed value that has a text parses back to the same bits.
pub(crate) fn print_again(value: &Owned) {
    let mut buffer = vec![0; 64 * 1024];
    match value.as_variant().to_text(&mut buffer) {
        Ok(text) => assert_eq!(&Owned::parse_text(text.as_bytes()).expect("written text can be parsed"), value),
        Err(error) => {
            assert_eq!(error.column, 0);
            assert!(!text::has_text(&Value::read(value.as_variant())), "{error}");
        }
    }
}
