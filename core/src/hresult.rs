//! HRESULT: the 32-bit result code of every b-CAP and RAC reply, and of a VARIANT of type ERROR.
//!
//! ```text
//!   31    30  29  28  27    26 .. 16     15 .. 0
//! +-----+----------------+------------+----------+
//! |  S  |  R   C   N   X |  facility  |   code   |      S = 1: the call failed; no other bit matters
//! +-----+----------------+------------+----------+
//!
//!  0x00000000 .. 0x7FFFFFFF   success: S_OK, S_FALSE, S_EXECUTING, S_BUF_FULL 0x0F200501
//!  0x80000000 .. 0x8000FFFF   reserved: E_CAO_* 0x02nn, E_CAOP_* 0x04nn, session 0x09nn, COM 0x40nn
//!  0x80010000 .. 0x800101FF   reserved: faults of a packet or an argument
//!  0x8002nnnn                 DISP_E_*: conversions between VARIANTs and text
//!  0x80040200 .. 0x8004FFFF   defined by the user or by a provider
//!  0x8007nnnn                 Windows error nnnn: E_HANDLE, E_INVALIDARG, ...
//!  0x8091nnnn                 error nnnn of the operating system (errno or WSA code)
//!  0x80FFnnnn .. 0x85FFnnnn   errors of the robot controller; bits 27..24 are their level, 0 to 5; FF from 20 on is the part
//!  0xC0FFnnnn .. 0xC5FFnnnn   the same errors with the reserved bit R: read 0xC as 0x8
//! ```
//!
//! Guarantees:
//!
//! * An [`HResult`] holds any code unchanged; output shows the number of an unknown code.
//! * Bit 31 alone determines success, even of unknown codes. Comparing with `S_OK` is wrong: `S_BUF_FULL` means stored.
//! * The constants are plain numbers. An image contains the names (2 KiB) only if it calls [`name`](HResult::name), `Debug` or
//!   `Display`, and the texts (90 KiB, `hresult/codes.tsv`) only if it calls a method that returns one, such as
//!   [`meaning`](HResult::meaning) or [`hint`](HResult::hint).
//!
//! The sources are the RAC specification for RC8 and the b-CAP specification for RC9. Codes in neither of them are from the
//! vendor's open libraries or from public client programs, and say so. If such a source has only a name, the meaning is derived
//! from the name. Errors of the controller without a constant are from public lists and the log of a real RC8A.

mod table;

use core::fmt;
use core::fmt::Write as _;

pub use self::table::{Pattern, Row};

/// A result code. Any value is valid; known codes are constants.
///
/// # Examples
///
/// ```
/// use bcap_core::hresult::HResult;
///
/// let code = HResult::from_u32(0x83201483);
/// assert_eq!(code, HResult::E_BUF_FULL);
/// assert!(code.is_err());
/// assert_eq!(code.to_string(), "0x83201483 (E_BUF_FULL)");
/// let hint = code.hint().map(|hint| hint.to_string());
/// assert!(hint.is_some_and(|hint| hint.starts_with("wait one control cycle (8 ms) and send the same pose again")));
///
/// // the third axis was commanded to accelerate too hard: a code without a name
/// let code = HResult::from_u32(0x84204043);
/// assert_eq!((code.name(), code.level(), code.axis()), (None, Some(4), Some(3)));
/// ```
#[derive(Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(transparent))]
pub struct HResult(
    /// The code as the wire carries it; negative is a failure.
    pub i32,
);

impl HResult {
    /// Creates the code that is written `0x83201483` in the manuals.
    #[must_use]
    pub const fn from_u32(code: u32) -> Self {
        Self(code.cast_signed())
    }

    /// Returns the code as the manuals write it, unsigned.
    #[must_use]
    pub const fn to_u32(self) -> u32 {
        self.0.cast_unsigned()
    }

    /// Returns whether the call succeeded: bit 31 is clear.
    #[must_use]
    pub const fn is_ok(self) -> bool {
        self.0 >= 0
    }

    /// Returns whether the call failed: bit 31 is set.
    #[must_use]
    pub const fn is_err(self) -> bool {
        self.0 < 0
    }

    /// Returns the code as lists of codes have it: without the reserved bit that some controllers and tools set in an error
    /// of the controller, so 0xC4201486 becomes 0x84201486.
    #[must_use]
    pub const fn listed(self) -> Self {
        const RESERVED: u32 = 0x4000_0000;
        let cleared = Self::from_u32(self.to_u32() & !RESERVED);
        if self.is_err() && cleared.listed_part().is_some() { cleared } else { self }
    }

    /// Returns the name of the constant, such as `E_TIMEOUT`.
    #[must_use]
    pub fn name(self) -> Option<&'static str> {
        self.look_up(NAMES)
    }

    /// Returns the code with this name, ignoring case.
    #[must_use]
    pub fn from_name(name: &str) -> Option<Self> {
        CODES.iter().zip(NAMES).find(|(_, known)| known.eq_ignore_ascii_case(name)).map(|(code, _)| *code)
    }

    /// Returns the meaning of the code, as one sentence.
    #[must_use]
    pub fn meaning(self) -> Option<&'static str> {
        self.listed().look_up(MEANINGS).or_else(|| Some(self.row()?.meaning))
    }

    /// Returns the instruction for the operator.
    ///
    /// It is `None` for a failure outside of every known range.
    #[must_use]
    pub fn hint(self) -> Option<Hint> {
        Some(Hint { remedy: self.row()?.remedy, level: self.level() })
    }

    /// Returns the usual cause of the code, as one sentence; `None` if the meaning says it.
    #[must_use]
    pub fn cause(self) -> Option<&'static str> {
        self.row()?.cause
    }

    /// Returns the functions that usually return the code, as text.
    #[must_use]
    pub fn functions(self) -> Option<&'static str> {
        self.row()?.functions
    }

    /// Returns where the code is published: a part of the two specifications, or another source in words.
    #[must_use]
    pub fn source(self) -> Option<&'static str> {
        let row = self.row()?;
        row.source.or_else(|| self.level().map(|_| "public lists of the controller's codes"))
    }

    /// Returns the axis, 1 to 8, of a code that reports one axis.
    #[must_use]
    pub fn axis(self) -> Option<u8> {
        let code = self.listed().to_u32();
        Row::find(code)?.1.axis(code)
    }

    /// Returns the errno or WSA code nnnn of 0x8091nnnn, as the operating system of the answering program counts it.
    ///
    /// [`E_BUSY_PROC`](Self::E_BUSY_PROC) and [`E_WINSOCK_MASK`](Self::E_WINSOCK_MASK) lie in that range but are not codes of
    /// an operating system.
    #[must_use]
    pub const fn os_error(self) -> Option<u16> {
        match self {
            Self::E_BUSY_PROC | Self::E_WINSOCK_MASK => None,
            _ => match self.to_u32().to_be_bytes() {
                [0x80, 0x91, high, low] => Some(u16::from_be_bytes([high, low])),
                _ => None,
            },
        }
    }

    /// Returns the level, 0 to 5, of an error of the robot controller itself: how much it stops.
    ///
    /// That the second digit is the level is how the vendor numbers its errors; neither specification promises it.
    /// [`effect`](Self::effect) has the meaning of each level.
    #[must_use]
    pub const fn level(self) -> Option<u8> {
        let code = self.listed();
        match (code.listed_part(), code.to_u32().to_be_bytes()) {
            (Some(_), [first, ..]) => Some(first & 0x0F),
            _ => None,
        }
    }

    /// Returns what an error of this level stops, and whether it must be cleared.
    #[must_use]
    pub const fn effect(self) -> Option<&'static str> {
        Some(match self.level() {
            Some(0) => "a notice: nothing stops, nothing has to be cleared",
            Some(1) => "a refused call: motions go on, the motor stays on; the refusal must be cleared",
            Some(2) => "all axes stop at once, the motor stays on",
            Some(3) => "motions stop and the motor goes off, unless the error only refuses a call",
            Some(4) => "all axes stop hard, the motor goes off",
            Some(5) => "a fault of the controller: the motor goes off, and most of these last until a restart",
            _ => return None,
        })
    }

    /// Returns the part of the controller that reports the error, such as the servo.
    #[must_use]
    pub const fn part(self) -> Option<&'static str> {
        self.listed().listed_part()
    }

    /// Returns the part of an error that has no reserved bit.
    const fn listed_part(self) -> Option<&'static str> {
        let [0x80..=0x85, part, ..] = self.to_u32().to_be_bytes() else { return None };
        Some(match part {
            0x20 => "motion: path, limits, areas, force",
            0x40 => "servo, encoders and I/O hardware",
            0x48 => "power unit",
            0x49 => "safety I/O",
            0x4A => "safety monitor",
            0x50 => "controller software",
            0x58 => "options: vision, hands, TwinCAT",
            0x60 => "programs",
            0x80 => "teach pendant",
            // the low level belongs to b-CAP there
            _ if matches!(self.to_u32().to_be_bytes(), [0x80, ..]) => return None,
            _ => "another part",
        })
    }

    /// Finds the code's text in one of the tables that run parallel to [`CODES`].
    ///
    /// It scans, because texts are not time-critical and zipped iterators need no indexing.
    fn look_up(self, texts: &'static [&'static str]) -> Option<&'static str> {
        CODES.iter().zip(texts).find(|(code, _)| **code == self).map(|(_, text)| *text)
    }

    fn row(self) -> Option<Row> {
        Row::find(self.listed().to_u32()).map(|(row, _)| row)
    }

    /// Iterates over the codes that have a name, ascending as unsigned numbers.
    pub fn known() -> impl ExactSizeIterator<Item = Self> + Clone {
        CODES.iter().copied()
    }
}

/// An instruction for the operator, in lower case and without a full stop; `Display` writes it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Hint {
    remedy: &'static str,
    level: Option<u8>,
}

impl Hint {
    /// Returns whether only a restart of the controller helps.
    pub(crate) fn needs_restart(self) -> bool {
        self.remedy.contains("restart the controller")
    }

    /// Returns what the level of an error needs after its remedy; `None` if the remedy has all steps.
    const fn clearing(self) -> Option<&'static str> {
        match self.level {
            Some(1 | 2) => Some("; then ClearError"),
            Some(3) => Some("; then ClearError, and motor on if it is off"),
            Some(4) => Some("; then ClearError and motor on"),
            Some(5) => Some("; then ClearError, or restart the controller if the error stays"),
            _ => None,
        }
    }
}

impl fmt::Display for Hint {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.remedy)?;
        if self.remedy.contains("ClearError") || self.remedy.contains("restart the controller") {
            return Ok(());
        }
        self.clearing().map_or(Ok(()), |clearing| f.write_str(clearing))
    }
}

impl fmt::Debug for HResult {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.name() {
            Some(name) => f.write_str(name),
            None => {
                f.write_str("HResult(")?;
                write_hex(f, self.to_u32())?;
                f.write_char(')')
            }
        }
    }
}

impl fmt::Display for HResult {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write_hex(f, self.to_u32())?;
        match self.name() {
            Some(name) => {
                f.write_str(" (")?;
                f.write_str(name)?;
                f.write_char(')')
            }
            None => Ok(()),
        }
    }
}

/// Writes `0x` and eight digits, without the padding machinery that `{:#010x}` would link.
fn write_hex(f: &mut fmt::Formatter<'_>, code: u32) -> fmt::Result {
    f.write_str("0x")?;
    let mut rest = code;
    for _ in 0..8 {
        rest = rest.rotate_left(4);
        f.write_char(char::from_digit(rest & 0x0F, 16).unwrap_or_default())?;
    }
    Ok(())
}

/// Generates the constants and the parallel tables from one list of rows.
macro_rules! codes {
    ($($value:literal $name:ident, $meaning:literal;)*) => {
        impl HResult {$(
            #[doc = $meaning]
            #[doc = ""]
            #[doc = concat!("`", stringify!($value), "`.")]
            pub const $name: Self = Self::from_u32($value);
        )*}

        /// The codes with a constant, ascending as unsigned numbers.
        static CODES: &[HResult] = &[$(HResult::$name),*];
        static NAMES: &[&str] = &[$(stringify!($name)),*];
        static MEANINGS: &[&str] = &[$($meaning),*];
    };
}

// value, name, meaning (also the constant's doc); `codes.tsv` has the other texts
codes! {
    0x00000000 S_OK, "The call succeeded.";
    0x00000001 S_FALSE, "The call succeeded, and its answer is no, or there was nothing to do.";
    0x00000900 S_EXECUTING, "The call is still running; its answer follows under the same serial.";
    0x0F200501 S_BUF_FULL, "The pose was stored, and the slave-mode buffer is full now.";
    0x80000200 E_CAO_SEM_CREATE, "The CAO engine could not create a semaphore.";
    0x80000201 E_CAO_PROV_INVALID, "The provider's name is not known here.";
    0x80000202 E_CAO_COMPUTER_NAME, "The computer's name is invalid.";
    0x80000203 E_CAO_VARIANT_TYPE_NOSUPPORT, "The VARTYPE is not supported.";
    0x80000204 E_CAO_OBJECT_NOTFOUND, "There is no such object.";
    0x80000205 E_CAO_COLLECTION_REGISTERED, "An object of this name is registered already.";
    0x80000207 E_CAO_THREAD_CREATE, "The CAO engine could not create a thread.";
    0x80000208 E_CAO_REMOTE_ENGINE, "The CAO engine of another computer could not be reached.";
    0x80000209 E_CAO_REMOTE_PROVIDER, "A provider on another computer could not be started.";
    0x8000020A E_CAO_NOT_WRITABLE, "The object cannot be written.";
    0x8000020B E_CAO_CMD_EXECUTE, "The command is being executed already.";
    0x8000020C E_CAO_PROV_NO_LICENSE, "The provider has no licence.";
    0x8000020D E_CAO_PRELOAD, "A provider could not be loaded in advance.";
    0x80000400 E_CRDIMPL, "A provider failed in the part that its CRD file defines.";
    0x80000401 E_CAOP_SYSTEMNAME_INVALID, "The name of the system variable is invalid.";
    0x80000402 E_CAOP_SYSTEMTYPE_INVALID, "The type of the system variable is invalid.";
    0x80000403 E_CANCEL, "The call was cancelled.";
    0x80000404 E_CAOP_NOT_WRITABLE, "The provider's variable cannot be written.";
    0x80000900 E_TIMEOUT, "The answer did not come in time.";
    0x80000901 E_NO_LICENSE, "The function has no licence.";
    0x80000902 E_NOT_CONNECTED, "There is no connection.";
    0x80000903 E_NOT_USE, "The function is not available.";
    0x80000904 E_INVALID_CMD_NAME, "The command's name is invalid.";
    0x80000905 E_MAX_OBJECT, "The table of objects or connections is full.";
    0x80000906 E_ALREADY_REGISTER, "It is registered already.";
    0x80000909 E_TOO_MUCH_DATA, "The packet is larger than the link carries.";
    0x8000090B E_MAX_CONNECT, "The server already knows as many UDP clients as it can.";
    0x80004001 E_NOTIMPL, "The function is not implemented.";
    0x80004003 E_POINTER, "A pointer is invalid, as when an argument is missing.";
    0x80004004 E_ABORT, "The function was aborted.";
    0x80004005 E_FAIL, "The function failed.";
    0x8000FFFF E_UNEXPECTED, "A fatal error occurred.";
    0x80010000 E_INVALIDPACKET, "A packet could not be decoded.";
    0x80010001 E_INVALIDRCPACKET, "The controller received an invalid packet and cuts the connection.";
    0x80010002 E_INVALIDSNDPACKET, "The packet to be sent is invalid.";
    0x80010003 E_INVALIDARGTYPE, "An argument has the wrong type.";
    0x80010004 E_ROBOTISBUSY, "A motion command came while the robot was moving.";
    0x80010005 E_INVALIDCOMMAND, "The command string is invalid.";
    0x80010011 E_PACKETSIZEOVER, "The received packet is over 16 MiB.";
    0x80010012 E_ARGSIZEOVER, "An argument of the received packet is over 16 MiB.";
    0x80020005 DISP_E_TYPEMISMATCH, "The value cannot be converted to this type.";
    0x80020008 DISP_E_BADVARTYPE, "The VARTYPE cannot be converted.";
    0x8002000A DISP_E_OVERFLOW, "The value is out of the range of its type.";
    0x8002000B DISP_E_BADINDEX, "The index is outside of the array.";
    0x80070005 E_ACCESSDENIED, "Access is denied.";
    0x80070006 E_HANDLE, "The handle is invalid.";
    0x8007000E E_OUTOFMEMORY, "The memory does not suffice.";
    0x80070057 E_INVALIDARG, "An argument is invalid.";
    0x8007FFFF E_WINDOWS_MASK, "The mask that Windows errors are combined with, not an error by itself.";
    0x809100AA E_BUSY_PROC, "The previous call of this connection is still running.";
    0x8091FFFF E_WINSOCK_MASK, "The mask that errors of the operating system are combined with, not an error by itself.";
    0x81501003 E_MOTOR_OFF, "The command needs the motor on.";
    0x81501025 E_ERROR_PRESENT, "The command is refused while the controller has an error.";
    0x81501069 E_MOTION_UNPREPARED, "A COBOTTA has not made its motion preparation.";
    0x83201483 E_BUF_FULL, "The slave-mode buffer is full, and the pose was not stored.";
    0x83500076 E_MOTION_STOPPED, "A motion of a client was stopped.";
    0x83500121 E_SLVMODE_OFF, "slvMove was sent while slave mode was not selected.";
    0x83500372 E_MANUAL_RESET_UNPREPARED, "A COBOTTA wants ManualResetPreparation before a command that concerns safety.";
    0x83501024 E_ARM_NOT_TAKEN, "The client does not have the arm, or cannot take it.";
    0x83501028 E_TOKEN_NOT_ETHERNET, "The executable token is not with Ethernet.";
    0x83501029 E_TOKEN_ADDRESS, "The executable token is not with this client's address.";
    0x83501032 E_SLVMODE_ON, "The command is refused in slave mode.";
    0x8350106E E_MOTOR_TURNING_OFF, "The motor was to be turned on while it was being turned off.";
    0x84201482 E_COMMAND_BUFFER_EMPTY, "The slave-mode buffer ran empty while the robot was moving, and slave mode was released.";
    0x84201486 E_COMMAND_POSITION_GEN_STOPPED, "The controller has stopped generating command positions.";
}

#[cfg(test)]
mod tests;
