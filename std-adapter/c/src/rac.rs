//! Lines of RAC: a request has one line, and so has its reply.

use core::ffi::c_char;

use bcap_core::rac::{Request, Response, Variable};
use bcap_core::storage::Storage;
use bcap_core::variant::{Encode, Writer};

use crate::entry::guard;
use crate::memory::{Memory, caller, copy, get, put, read_text, slice};
use crate::status::{self, BCAP_E_PATH, BCAP_E_TEXT, Status, bcap_status};
use crate::value::{bcap_value, decode};

/// The largest line, with its CR.
const LINE: usize = bcap_core::rac::MAX_LINE;

/// Writes the line that reads a variable, such as `I10`: `GET:RC8:10:I:` and CR. 256 bytes hold any line. `length` gets its length; it
/// does not end with NUL.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn bcap_rac_get(
    name: *const c_char,
    line: *mut c_char,
    size: usize,
    length: *mut usize,
) -> bcap_status {
    guard(|| {
        let request = Request::Get(caller!(variable(name))?);
        caller!(write(&request, line, size, length))
    })
}

/// Writes the line that sets a variable: `PUT:RC8:10:I:3,123` and CR.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn bcap_rac_put(
    name: *const c_char,
    value: *const bcap_value,
    line: *mut c_char,
    size: usize,
    length: *mut usize,
) -> bcap_status {
    guard(|| {
        let mut memory = [0; 2 * LINE];
        let mut out = Writer::new(&mut memory);
        caller!(get(value))?.encode(&mut out).map_err(status::encode)?;
        let request = Request::Put(caller!(variable(name))?, decode(out.as_bytes())?);
        caller!(write(&request, line, size, length))
    })
}

/// Reads the line of a reply, without its CR. `memory` gets the value's text or array, and must not overlap the line; 1024 bytes hold
/// any value. The result is the controller's if it refused.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn bcap_rac_reply(
    line: *const c_char,
    length: usize,
    memory: *mut u8,
    size: usize,
    value: *mut bcap_value,
) -> bcap_status {
    guard(|| {
        let line = caller!(slice(line.cast::<u8>(), length))?;
        let mut storage = caller!(Memory::new(memory, size))?;
        let response = Response::parse(line, storage.bytes_mut()).map_err(|_| BCAP_E_TEXT)?;
        let view = |found| bcap_value::received(found, memory, size);
        caller!(put(value, response.value.map_or(Ok(bcap_value::EMPTY), view)?))?;
        if response.result.is_err() { Err(response.result.0) } else { Ok(()) }
    })
}

/// Reads the name of a variable.
///
/// # Safety
///
/// As for [`read_text`].
unsafe fn variable(name: *const c_char) -> Result<Variable, Status> {
    caller!(read_text(name))?.parse().map_err(|_| BCAP_E_PATH)
}

/// Writes the line of a request.
///
/// # Safety
///
/// As for [`copy`] and [`put`].
unsafe fn write(request: &Request<'_>, line: *mut c_char, size: usize, length: *mut usize) -> Result<(), Status> {
    let mut memory = [0; LINE];
    let mut out = Writer::new(&mut memory);
    request.write_line(&mut out).map_err(|_| BCAP_E_TEXT)?;
    caller!(copy(out.as_bytes(), line.cast(), size))?;
    caller!(put(length, out.len()))
}
