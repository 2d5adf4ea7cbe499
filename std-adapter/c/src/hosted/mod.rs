//! The hosted client: `bcap-std` behind handles.
//!
//! A failed function leaves its text for `bcap_message`, on its thread. No panic leaves a function.

mod arm;
mod controller;
mod log;
mod stream;
mod table;

use std::cell::{Cell, RefCell};
use std::ffi::c_char;
use std::fmt::Display;
use std::panic::{AssertUnwindSafe, catch_unwind};

use bcap_std::Error;
use bcap_std::blocking::{Arm, Controller};
use bcap_std::core::variant::OwnedVariant;

use crate::explain::bcap_status_text;
use crate::memory::{TextBuffer, caller, copy, put, slice};
use crate::status::{self, *};
use crate::value::{bcap_value, decode};

thread_local! {
    /// The last failure, for `bcap_message`.
    static LAST: RefCell<Failure> = const { RefCell::new(Failure { status: BCAP_OK, message: None }) };
    /// Whether the log callback runs on this thread.
    static IN_CALLBACK: Cell<bool> = const { Cell::new(false) };
}

/// A failed function: its status, and a text if there is more to say than the status does.
#[derive(Clone, Debug)]
pub(crate) struct Failure {
    status: Status,
    message: Option<String>,
}

impl Failure {
    pub(crate) fn new(status: Status, message: impl Display) -> Self {
        Self { status, message: Some(message.to_string()) }
    }
}

impl From<Status> for Failure {
    fn from(status: Status) -> Self {
        Self { status, message: None }
    }
}

impl From<Error> for Failure {
    fn from(error: Error) -> Self {
        let status = match &error {
            Error::Address(_) | Error::NoAddress | Error::NoSecondSession => BCAP_E_ADDRESS,
            Error::Connect(_) => BCAP_E_CONNECT,
            Error::Path(_) => BCAP_E_PATH,
            Error::ArmTaken => BCAP_E_BUSY,
            Error::ArmLost => BCAP_E_ARM,
            Error::NotConnected { .. } | Error::Closed => BCAP_E_CLOSED,
            Error::StreamConfig(_) | Error::Stream(_) => BCAP_E_STREAM,
            Error::NotHalted(_) => BCAP_E_NOT_HALTED,
            Error::NotRecovered(_) => BCAP_E_RECOVERY,
            Error::Argument(error) => status::encode(*error),
            Error::Refused { code, .. } => code.0,
            Error::NoReply { .. } if error.is_lost() => BCAP_E_LOST,
            Error::NoReply { .. } => BCAP_E_TIMEOUT,
            Error::Reply { .. } => BCAP_E_TYPE,
            Error::Value { source, .. } => status::convert(*source),
            _ => BCAP_E_FAILED,
        };
        Self::new(status, error)
    }
}

/// Returns whether the log callback runs on this thread.
fn is_in_callback() -> bool {
    IN_CALLBACK.try_with(Cell::get).unwrap_or(false)
}

/// Runs the body of a hosted function, and returns its status. The log callback must not call it.
fn enter(body: impl FnOnce() -> Result<(), Failure>) -> Status {
    catch(|| if is_in_callback() { Err(BCAP_E_REENTRANT.into()) } else { body() })
}

/// Runs a body, and returns its status. A panic becomes a status.
fn catch(body: impl FnOnce() -> Result<(), Failure>) -> Status {
    let failure = match catch_unwind(AssertUnwindSafe(body)) {
        Ok(Ok(())) => return BCAP_OK,
        Ok(Err(failure)) => failure,
        Err(payload) => {
            let text = payload.downcast_ref::<String>().map(String::as_str);
            let text = text.or_else(|| payload.downcast_ref::<&str>().copied());
            Failure::new(BCAP_E_PANIC, format_args!("the library panicked: {}", text.unwrap_or("without a message")))
        }
    };
    let status = failure.status;
    // a thread that ends has no message any more
    let _ = LAST.try_with(|last| last.replace(failure));
    status
}

/// Writes the text of the last hosted function that failed on this thread: what was wrong, where, and what to do. It is shortened to
/// `size` bytes with NUL. Returns the length of the whole text, as `snprintf` does; 0 if no function has failed.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn bcap_message(buffer: *mut c_char, size: usize) -> usize {
    let last = LAST.try_with(|last| last.borrow().clone()).unwrap_or(BCAP_OK.into());
    if last.message.is_none() && last.status != BCAP_OK {
        return caller!(bcap_status_text(last.status, buffer, size));
    }
    let mut out = caller!(TextBuffer::new(buffer, size));
    out.push(last.message.as_deref().unwrap_or_default());
    out.finish()
}

/// Stores a value in memory of the caller. Does nothing without a pointer for the value.
///
/// # Safety
///
/// As for [`copy`] and [`put`].
unsafe fn store(found: &OwnedVariant, memory: *mut u8, size: usize, value: *mut bcap_value) -> Result<(), Failure> {
    if value.is_null() {
        return Ok(());
    }
    caller!(copy(found.as_bytes(), memory, size))?;
    let bytes = caller!(slice(memory.cast_const(), found.as_bytes().len()))?;
    let view = bcap_value::received(decode(bytes)?, memory, size)?;
    Ok(caller!(put(value, view))?)
}

/// Returns the arm if it is taken.
fn taken(controller: &mut Controller) -> Result<Arm<'_>, Failure> {
    if !controller.has_arm() {
        return Err(BCAP_E_ARM.into());
    }
    Ok(controller.arm()?)
}
