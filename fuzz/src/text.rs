//! The text of values against the oracle.

use bcap_core::error::{TextError, TextErrorKind};
use bcap_core::variant::VariantBuf;
use bcap_testkit::text;
use bcap_testkit::value::Value;

/// The longest text that is tried; what it says then fits [`Owned`].
const LONGEST: usize = 1500;

pub(crate) type Owned = VariantBuf<8192>;

/// Reads bytes as the text of a value.
///
/// # Panics
///
/// When the core is wrong.
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

/// What was read and has a text, reads back as the same bits.
pub(crate) fn print_again(value: &Owned) {
    let mut buffer = vec![0; 64 * 1024];
    match value.as_variant().to_text(&mut buffer) {
        Ok(text) => assert_eq!(&Owned::parse_text(text.as_bytes()).expect("what is written can be read"), value),
        Err(error) => {
            assert_eq!(error.column, 0);
            assert!(!text::has_text(&Value::read(value.as_variant())), "{error}");
        }
    }
}
