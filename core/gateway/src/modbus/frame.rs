//! Frames of Modbus TCP: the header, the functions, the exceptions.
//!
//! ```text
//!  frame = transaction u16, protocol 0 u16, length u16, unit u8, function u8, data
//!
//!  function  data of the request                     data of the response
//!   1  2     first u16, count u16 (1 to 2000)        bytes u8, coils from bit 0 on
//!   3  4     first u16, count u16 (1 to 125)         bytes u8, registers u16
//!   5        address u16, 0xff00 or 0                the same
//!   6        address u16, value u16                  the same
//!  15        first u16, count u16, bytes u8, coils   first u16, count u16
//!  16        first u16, count u16, bytes u8, registers  first u16, count u16
//!  22        address u16, and u16, or u16           the same
//!  23        first u16, count u16 to read (1 to 125), as 16 to write (1 to 121)  as 3
//!  43        14 u8, code u8 (1 to 4), object u8     14 u8, code u8, level u8, 0 u8, 0 u8, count u8, objects
//!  + 0x80                                            exception u8
//! ```
//!
//! Numbers are big-endian. `length` counts the bytes after it.

use super::map::Table;
use bcap_core::hresult::HResult;

/// Maximum length of a frame in bytes.
pub(super) const FRAME: usize = 260;

/// The bytes before the function: transaction, protocol, length, unit.
pub(super) const HEADER: usize = 7;

/// The bytes before those that `length` counts.
const UNCOUNTED: usize = 6;

/// Why a request is refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum Exception {
    /// The function is not supported.
    IllegalFunction,
    /// An address has no variable, only a part of a variable would be written, or no rule allows the access.
    IllegalDataAddress,
    /// The count or a value is invalid or out of the range that the rules allow.
    IllegalDataValue,
    /// The robot refused the access, or its value does not fit the registers.
    ServerDeviceFailure,
    /// The client exceeds its rate, the gateway has no slot for it, or writing may end a stream of Slave Mode.
    ServerDeviceBusy,
    /// The robot is disconnected.
    GatewayPathUnavailable,
    /// The robot did not answer in time.
    GatewayTargetDeviceFailedToRespond,
}

impl Exception {
    /// Returns its number in a response.
    #[must_use]
    pub const fn code(self) -> u8 {
        match self {
            Self::IllegalFunction => 0x01,
            Self::IllegalDataAddress => 0x02,
            Self::IllegalDataValue => 0x03,
            Self::ServerDeviceFailure => 0x04,
            Self::ServerDeviceBusy => 0x06,
            Self::GatewayPathUnavailable => 0x0a,
            Self::GatewayTargetDeviceFailedToRespond => 0x0b,
        }
    }
}

impl From<HResult> for Exception {
    /// Translates the error with which a gateway answers a line.
    fn from(error: HResult) -> Self {
        match error {
            HResult::E_ACCESSDENIED => Self::IllegalDataAddress,
            HResult::E_INVALIDARG | HResult::E_INVALIDARGTYPE => Self::IllegalDataValue,
            HResult::E_BUSY_PROC | HResult::E_MAX_CONNECT | HResult::E_SLVMODE_ON => Self::ServerDeviceBusy,
            HResult::E_NOT_CONNECTED => Self::GatewayPathUnavailable,
            HResult::E_TIMEOUT => Self::GatewayTargetDeviceFailedToRespond,
            _ => Self::ServerDeviceFailure,
        }
    }
}

/// A valid request.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Command {
    pub(super) table: Table,
    pub(super) is_write: bool,
    pub(super) first: u16,
    pub(super) count: u16,
}

impl Command {
    /// Returns the number of bytes of its coils or registers.
    pub(super) fn bytes(self) -> usize {
        let count = usize::from(self.count);
        match self.table {
            Table::Coils => count.div_ceil(8),
            Table::Registers => count.saturating_mul(2),
        }
    }
}

/// A valid request: one command, or two commands in sequence.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Work<'a> {
    pub(super) command: Command,
    /// The coils or registers that the command writes.
    pub(super) bytes: &'a [u8],
    pub(super) then: Option<Command>,
}

/// Returns the length of the frame at the start of `bytes`, if it is known; `Err` if the bytes are not Modbus TCP.
pub(super) fn length(bytes: &[u8]) -> Result<Option<usize>, ()> {
    let [_, _, protocol @ .., high, low] = bytes.first_chunk::<UNCOUNTED>().map_or(&[0; UNCOUNTED], |head| head);
    if *protocol != [0, 0] {
        return Err(());
    }
    if bytes.len() < UNCOUNTED {
        return Ok(None);
    }
    let length = usize::from(u16::from_be_bytes([*high, *low])).saturating_add(UNCOUNTED);
    // a unit and a function at least
    if (HEADER.saturating_add(1)..=FRAME).contains(&length) { Ok(Some(length)) } else { Err(()) }
}

/// Parses a function with its data.
pub(super) fn parse(function: &[u8]) -> Result<Work<'_>, Exception> {
    use Table::{Coils, Registers};
    let mut then = None;
    let (command, bytes, most) = match function {
        [1 | 2, a, b, c, d] => (command(Coils, false, [*a, *b], [*c, *d]), &[][..], 2000),
        [3 | 4, a, b, c, d] => (command(Registers, false, [*a, *b], [*c, *d]), &[][..], 125),
        [5, a, b, value @ (0 | 0xff), 0] => (command(Coils, true, [*a, *b], [0, 1]), core::slice::from_ref(value), 1),
        [6, a, b, value @ ..] if value.len() == 2 => (command(Registers, true, [*a, *b], [0, 1]), value, 1),
        [15, a, b, c, d, count, bytes @ ..] if usize::from(*count) == bytes.len() => {
            (command(Coils, true, [*a, *b], [*c, *d]), bytes, 1968)
        }
        [16, write @ ..] => registers(write, 123).ok_or(Exception::IllegalDataValue)?,
        [22, a, b, masks @ ..] if masks.len() == 4 => {
            then = Some(command(Registers, true, [*a, *b], [0, 1]));
            (command(Registers, false, [*a, *b], [0, 1]), &[][..], 1)
        }
        [23, a, b, c, d, write @ ..] => {
            then = Some(command(Registers, false, [*a, *b], [*c, *d])).filter(|read| (1..=125).contains(&read.count));
            then.and(registers(write, 121)).ok_or(Exception::IllegalDataValue)?
        }
        [1..=6 | 15 | 22 | 23, ..] => return Err(Exception::IllegalDataValue),
        _ => return Err(Exception::IllegalFunction),
    };
    if !(1..=most).contains(&command.count) || command.is_write && command.bytes() != bytes.len() {
        return Err(Exception::IllegalDataValue);
    }
    Ok(Work { command, bytes, then })
}

/// Parses registers to write, of which there may be `most`.
fn registers(data: &[u8], most: u16) -> Option<(Command, &[u8], u16)> {
    let [a, b, c, d, count, bytes @ ..] = data else { return None };
    (usize::from(*count) == bytes.len()).then(|| (command(Table::Registers, true, [*a, *b], [*c, *d]), bytes, most))
}

/// Returns the objects of the device identification that a request reads, each with its number; `None` for another function.
pub(super) fn identification(
    function: &[u8],
) -> Result<Option<impl Iterator<Item = (u8, &'static str)> + Clone + use<>>, Exception> {
    const OBJECTS: [&str; 3] = ["bcap", env!("CARGO_PKG_NAME"), env!("CARGO_PKG_VERSION")];
    let [43, rest @ ..] = function else { return Ok(None) };
    let (first, most) = match rest {
        // a stream begins at the first object if there is no object with this number
        [14, 1..=3, object] => (if *object < 3 { *object } else { 0 }, 3),
        [14, 4, object @ 0..3] => (*object, 1),
        [14, 4, _] => return Err(Exception::IllegalDataAddress),
        [14, ..] => return Err(Exception::IllegalDataValue),
        _ => return Err(Exception::IllegalFunction),
    };
    Ok(Some((0..).zip(OBJECTS).skip(first.into()).take(most)))
}

const fn command(table: Table, is_write: bool, first: [u8; 2], count: [u8; 2]) -> Command {
    Command { table, is_write, first: u16::from_be_bytes(first), count: u16::from_be_bytes(count) }
}

/// Returns a coil of the packed bytes.
pub(super) fn coil(bytes: &[u8], at: u16) -> bool {
    let byte = bytes.get(usize::from(at >> 3)).copied().unwrap_or_default();
    byte & bit(at) != 0
}

/// Sets a coil in the packed bytes.
pub(super) fn set_coil(bytes: &mut [u8], at: u16) {
    if let Some(byte) = bytes.get_mut(usize::from(at >> 3)) {
        *byte |= bit(at);
    }
}

fn bit(at: u16) -> u8 {
    1_u8.rotate_left(u32::from(at & 7))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_length_is_known_after_six_bytes_and_refused_if_it_cannot_be() {
        let header = [0, 1, 0, 0, 0, 6, 1, 3];
        for count in 0..6 {
            assert_eq!(length(&header[..count]), Ok(None), "{count}");
        }
        assert_eq!(length(&header[..6]), Ok(Some(12)));
        assert_eq!(length(&[0, 1, 0, 0, 0, 254]), Ok(Some(FRAME)));
        for invalid in
            [[0, 1, 0, 0, 0, 255], [0, 1, 0, 0, 0, 1], [0, 1, 0, 0, 1, 0], [0, 1, 0, 1, 0, 6], [0, 1, 1, 0, 0, 6]]
        {
            assert_eq!(length(&invalid), Err(()), "{invalid:?}");
        }
        assert_eq!(length(b"GET:RC8:1:I:\r"), Err(()), "a client of RAC");
    }

    #[test]
    fn counts_and_sizes_are_checked() {
        let read = |function, count: u16| {
            let [a, b] = count.to_be_bytes();
            parse(&[function, 0, 7, a, b]).map(|work| work.command.count)
        };
        for (function, most) in [(1, 2000), (2, 2000), (3, 125), (4, 125)] {
            assert_eq!(read(function, most), Ok(most));
            assert_eq!(read(function, most + 1), Err(Exception::IllegalDataValue));
            assert_eq!(read(function, 0), Err(Exception::IllegalDataValue));
        }
        let registers = [[16, 0, 7, 0, 123, 246].as_slice(), &[0; 246]].concat();
        assert_eq!(parse(&registers).map(|work| (work.command.count, work.bytes.len())), Ok((123, 246)));
        let coils = [[15, 0, 7, 0x07, 0xb0, 246].as_slice(), &[0; 246]].concat();
        assert_eq!(parse(&coils).map(|work| (work.command.count, work.bytes.len())), Ok((1968, 246)));
    }

    #[test]
    fn requests_that_contradict_themselves_are_refused() {
        let invalid: [&[u8]; 12] = [
            &[3],
            &[3, 0, 7, 0],
            &[3, 0, 7, 0, 1, 0],
            &[5, 0, 7, 1, 0],
            &[5, 0, 7, 0xff, 1],
            &[6, 0, 7, 0],
            // 13 bytes of a frame that say 246 bytes follow
            &[16, 0, 0, 0, 1, 246],
            &[16, 0, 0, 0, 2, 2, 0, 0],
            &[15, 0, 0, 0, 9, 1, 0],
            &[15, 0, 0, 0, 0, 0],
            &[22, 0, 0],
            &[23],
        ];
        for function in invalid {
            assert_eq!(parse(function), Err(Exception::IllegalDataValue), "{function:?}");
        }
        for function in [&[][..], &[0, 0], &[7], &[24, 0, 0], &[43, 14], &[0x83, 2]] {
            assert_eq!(parse(function), Err(Exception::IllegalFunction), "{function:?}");
        }
    }
}
