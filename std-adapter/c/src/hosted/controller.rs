//! Controllers: connecting, variables, commands and calls.

use std::ffi::c_char;

use bcap_std::blocking::Controller;
use bcap_std::core::bcap::FunctionId;
use bcap_std::core::variant::{FromVariant, OwnedVariant};
use bcap_std::{Model, ObjectPath, Settings};

use super::{Failure, enter, store, table};
use crate::memory::{TextBuffer, caller, copy, put, read_text, slice};
use crate::status::{self, BCAP_E_PATH, BCAP_E_RANGE, Status, bcap_status};
use crate::value::{Integer, bcap_value};

/// The model of a controller, which determines its provider.
pub type bcap_model = i32;
/// RC8 and RC8A.
pub const BCAP_RC8: bcap_model = 8;
/// RC9 and COBOTTA PRO.
pub const BCAP_RC9: bcap_model = 9;
/// COBOTTA.
pub const BCAP_COBOTTA: bcap_model = 1;

/// A controller: a session with its objects. A handle of zeros is invalid. Threads may share it; their calls follow each other.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct bcap_controller {
    /// Private.
    pub id: u64,
}

/// Returns the settings of a model.
fn settings(model: bcap_model) -> Result<Settings, Failure> {
    let invalid = || format!("{model} is no model; pass BCAP_RC8, BCAP_RC9 or BCAP_COBOTTA");
    Ok(Settings::new(match model {
        BCAP_RC8 => Model::Rc8,
        BCAP_RC9 => Model::Rc9,
        BCAP_COBOTTA => Model::Cobotta,
        _ => return Err(Failure::new(BCAP_E_RANGE, invalid())),
    }))
}

/// Connects to the controller at `tcp:HOST[:PORT]`, `udp:HOST[:PORT]` or `serial:PATH`, and starts a session.
///
/// `bcap_close` ends it. The end of the program does too: it halts the robot, switches the motor off and gives the arm back.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn bcap_connect(
    address: *const c_char,
    model: bcap_model,
    controller: *mut bcap_controller,
) -> bcap_status {
    enter(|| {
        // so that a caller that ignores the result has an invalid handle
        caller!(put(controller, bcap_controller { id: 0 }))?;
        let (address, settings) = (caller!(read_text(address))?, settings(model)?);
        let id = table::add_controller(Controller::connect(address, &settings)?, address, settings);
        Ok(caller!(put(controller, bcap_controller { id }))?)
    })
}

/// Halts a motion, gives the arm back, releases all objects and disconnects. The handle is then invalid, even after a failure.
#[unsafe(no_mangle)]
pub extern "C" fn bcap_close(cell: bcap_controller) -> bcap_status {
    enter(|| table::close_controller(cell.id))
}

/// Reads a variable, and stores it.
fn read<T: for<'v> FromVariant<'v>>(
    cell: bcap_controller,
    name: Result<&str, Status>,
    store: impl FnOnce(T) -> Result<(), Failure>,
) -> bcap_status {
    table::on(cell.id, |cell| store(cell.controller()?.read(name?)?))
}

/// Reads a variable, such as `I1`, `IO128`, `robot/@SERVO_ON` or `task:Pro1/@STATUS`, as an integer or a truth value.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn bcap_read_integer(
    cell: bcap_controller,
    name: *const c_char,
    integer: *mut i64,
) -> bcap_status {
    read(cell, caller!(read_text(name)), |Integer(found)| Ok(caller!(put(integer, found))?))
}

/// Reads a variable as a number.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn bcap_read_number(cell: bcap_controller, name: *const c_char, number: *mut f64) -> bcap_status {
    read(cell, caller!(read_text(name)), |found| Ok(caller!(put(number, found))?))
}

/// Reads a variable as text of UTF-8 into `buffer`, with NUL. Text that does not fit is cut, and the result is `BCAP_E_SHORT`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn bcap_read_text(
    cell: bcap_controller,
    name: *const c_char,
    buffer: *mut c_char,
    size: usize,
) -> bcap_status {
    read(cell, caller!(read_text(name)), |found: String| {
        let mut out = caller!(TextBuffer::new(buffer, size));
        out.push(&found);
        Ok(out.finish_whole()?)
    })
}

/// Reads a variable as numbers: P has 7, V 3, J 8, T 10. `numbers` has room for `capacity` of them, and `count` gets their number.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn bcap_read_numbers(
    cell: bcap_controller,
    name: *const c_char,
    numbers: *mut f64,
    capacity: usize,
    count: *mut usize,
) -> bcap_status {
    read(cell, caller!(read_text(name)), |found: Vec<f64>| {
        caller!(copy(&found, numbers, capacity))?;
        Ok(caller!(put(count, found.len()))?)
    })
}

/// Reads a variable of any type into `memory`; `value` points into it.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn bcap_read(
    cell: bcap_controller,
    name: *const c_char,
    memory: *mut u8,
    size: usize,
    value: *mut bcap_value,
) -> bcap_status {
    read(cell, caller!(read_text(name)), |found| caller!(store(&found, memory, size, value)))
}

/// Writes a variable: `bcap_write(cell, "I1", bcap_i4(5))`. After `BCAP_E_TIMEOUT` and `BCAP_E_LOST` it may have been written.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn bcap_write(cell: bcap_controller, name: *const c_char, value: bcap_value) -> bcap_status {
    table::on(cell.id, |cell| {
        let value = OwnedVariant::new(&value).map_err(status::encode)?;
        Ok(cell.controller()?.write(caller!(read_text(name))?, value)?)
    })
}

/// Opens an object, such as `robot`, `task:Pro1` or `file:a.pcs`, and returns its handle for `bcap_call`. It is released with the
/// session, or by a call such as `BCAP_FN_TASK_RELEASE`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn bcap_open(cell: bcap_controller, path: *const c_char, handle: *mut i32) -> bcap_status {
    table::on(cell.id, |cell| {
        let path: ObjectPath = caller!(read_text(path))?.parse().map_err(|error| Failure::new(BCAP_E_PATH, error))?;
        let opened = cell.controller()?.open(&path)?;
        Ok(caller!(put(handle, opened))?)
    })
}

/// Makes any of the 137 calls, and stores the value of the reply in `memory`, unless `value` is null. A call that moves the robot
/// returns when the motion has ended. If the value does not fit (`BCAP_E_SHORT`), the controller has executed the call.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn bcap_call(
    cell: bcap_controller,
    function: i32,
    arguments: *const bcap_value,
    count: usize,
    memory: *mut u8,
    size: usize,
    value: *mut bcap_value,
) -> bcap_status {
    table::on(cell.id, |cell| {
        let arguments = caller!(slice(arguments, count))?;
        let arguments: Result<Vec<_>, _> = arguments.iter().map(OwnedVariant::new).collect();
        let arguments = arguments.map_err(status::encode)?;
        let (_, found) = cell.controller()?.call_any("the call", FunctionId(function), &arguments)?;
        caller!(store(&found.unwrap_or_default(), memory, size, value))
    })
}

/// Executes a command of the controller with a parameter, such as `ClearError` with `bcap_empty()`. As `bcap_call` otherwise.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn bcap_execute(
    cell: bcap_controller,
    command: *const c_char,
    parameter: bcap_value,
    memory: *mut u8,
    size: usize,
    value: *mut bcap_value,
) -> bcap_status {
    table::on(cell.id, |cell| {
        let parameter = OwnedVariant::new(&parameter).map_err(status::encode)?;
        let found: OwnedVariant = cell.controller()?.execute(caller!(read_text(command))?, parameter)?;
        caller!(store(&found, memory, size, value))
    })
}

/// Executes a command of the robot with a parameter, such as `CurJnt` with `bcap_empty()`. As `bcap_call` otherwise.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn bcap_execute_robot(
    cell: bcap_controller,
    command: *const c_char,
    parameter: bcap_value,
    memory: *mut u8,
    size: usize,
    value: *mut bcap_value,
) -> bcap_status {
    table::on(cell.id, |cell| {
        let parameter = OwnedVariant::new(&parameter).map_err(status::encode)?;
        let found: OwnedVariant = cell.controller()?.robot()?.execute(caller!(read_text(command))?, parameter)?;
        caller!(store(&found, memory, size, value))
    })
}
