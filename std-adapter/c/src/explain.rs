//! The text of a status.

use core::ffi::c_char;

use bcap_core::hresult::HResult;

use crate::memory::{TextBuffer, caller};
use crate::status::{CODES, bcap_status};

/// Explains a status: writes its name, its meaning and what to do to `buffer`, shortened to `size` bytes with NUL, and returns the
/// length of the whole text, as `snprintf` does. `buffer` may be null to ask for the length.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn bcap_status_text(status: bcap_status, buffer: *mut c_char, size: usize) -> usize {
    let mut out = caller!(TextBuffer::new(buffer, size));
    if let Some((_, name, text)) = CODES.iter().find(|(code, ..)| *code == status) {
        for part in [name, ": ", text] {
            out.push(part);
        }
        return out.finish();
    }
    let code = HResult(status);
    push_hex(code.to_u32(), &mut out);
    for part in [code.name(), code.meaning()].into_iter().flatten() {
        out.push(": ");
        out.push(part);
    }
    if code.name().is_none() {
        out.push(": a code that the library does not know");
    }
    out.finish()
}

fn push_hex(number: u32, out: &mut TextBuffer) {
    out.push("0x");
    for shift in (0..8).rev() {
        let digit = char::from_digit((number >> (4 * shift)) & 0xF, 16).unwrap_or('0');
        out.push(digit.encode_utf8(&mut [0; 4]));
    }
}
