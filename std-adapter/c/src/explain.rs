//! The text of a status.

use core::ffi::c_char;

use bcap_core::hresult::HResult;

use crate::memory::{TextBuffer, caller};
use crate::status::{CODES, bcap_status};

/// Explains a status: writes its name, its meaning and what to do to `buffer`, shortened to `size` bytes with NUL, and returns the
/// length of the whole text, as `snprintf` does. `buffer` may be null to query the length.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn bcap_status_text(status: bcap_status, buffer: *mut c_char, size: usize) -> usize {
    let mut out = caller!(TextBuffer::new(buffer, size));
    if let Some((_, name, text)) = CODES.iter().find(|(code, ..)| *code == status) {
        [name, ": ", text].into_iter().for_each(|part| out.push(part));
        return out.finish();
    }
    let code = HResult(status);
    out.push("0x");
    for shift in (0..8).rev() {
        let digit = char::from_digit((code.to_u32() >> (4 * shift)) & 0xF, 16).unwrap_or('0');
        out.push(digit.encode_utf8(&mut [0; 4]));
    }
    let name = code.name().unwrap_or("a code that the library does not know");
    for part in [Some(name), code.meaning()].into_iter().flatten() {
        out.push(": ");
        out.push(part);
    }
    out.finish()
}
