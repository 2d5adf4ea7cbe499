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
//!  0x81nnnnnn .. 0x85nnnnnn   errors of the robot controller; bits 27..24 are their level, 1 to 5
//! ```
//!
//! Guarantees:
//!
//! * An [`HResult`] holds any code unchanged; output shows the number of an unknown code.
//! * Bit 31 alone decides success, for unknown codes too. Comparing with `S_OK` is wrong: `S_BUF_FULL` means stored.
//! * The constants are plain numbers. Names, meanings, functions, causes, sources and hints are separate tables; an image
//!   contains the table of a method such as [`name`](HResult::name) (or `Debug`, `Display`) only if it calls it.
//!
//! The sources are the RAC specification for RC8 and the b-CAP specification for RC9. Codes that neither of them names
//! come from the vendor's open libraries or from public client programs, and say so. If such a source has only a name,
//! the meaning is derived from the name.

use core::fmt;
use core::fmt::Write as _;

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
/// assert_eq!(code.hint(), Some("wait one control cycle (8 ms) and send the same pose again"));
///
/// // the third axis was commanded to accelerate too hard: one of a family without names
/// let code = HResult::from_u32(0x84204043);
/// assert_eq!((code.name(), code.axis()), (None, Some(3)));
/// ```
#[derive(Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(transparent))]
pub struct HResult(
    /// The code as the wire carries it; negative is a failure.
    pub i32,
);

impl HResult {
    /// Makes the code that is written `0x83201483` in the manuals.
    #[must_use]
    pub const fn from_u32(code: u32) -> Self {
        Self(code.cast_signed())
    }

    /// Returns the code as the manuals write it, unsigned.
    #[must_use]
    pub const fn to_u32(self) -> u32 {
        self.0.cast_unsigned()
    }

    /// Tells whether the call succeeded: bit 31 is clear.
    #[must_use]
    pub const fn is_ok(self) -> bool {
        self.0 >= 0
    }

    /// Tells whether the call failed: bit 31 is set.
    #[must_use]
    pub const fn is_err(self) -> bool {
        self.0 < 0
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

    /// Returns the meaning of the code or of its family, as one sentence.
    #[must_use]
    pub fn meaning(self) -> Option<&'static str> {
        self.look_up(MEANINGS).or_else(|| self.family().map(Family::meaning))
    }

    /// Returns the functions that usually return the code, as text.
    #[must_use]
    pub fn functions(self) -> Option<&'static str> {
        self.look_up(FUNCTIONS)
    }

    /// Returns the usual cause of the code, as one sentence.
    #[must_use]
    pub fn cause(self) -> Option<&'static str> {
        self.look_up(CAUSES)
    }

    /// Returns where the code is published: lines of the two specifications, or another source in words.
    #[must_use]
    pub fn source(self) -> Option<&'static str> {
        self.look_up(SOURCES)
    }

    /// Returns an instruction for the operator, in lower case and without a full stop.
    ///
    /// It is `None` for a failure outside of every known range.
    #[must_use]
    pub fn hint(self) -> Option<&'static str> {
        self.look_up(HINTS).or_else(|| self.family().map(|family| family.hint(self.level())))
    }

    /// Returns the axis, 1 to 8, of the codes that report a limit of one axis.
    ///
    /// These are the limits of commanded acceleration 0x8420404n and commanded speed 0x8420405n (b-CAP specification,
    /// sections 5.5 and 5.8), the same two as the servo reports them, 0x8440454n and 0x8440453n (the vendor's open
    /// COBOTTA driver), and the software limit of the position 0x8320407n (a public client).
    #[must_use]
    pub const fn axis(self) -> Option<u8> {
        match self.family() {
            Some(Family::Acceleration | Family::Speed | Family::Position) => {
                let [.., last] = self.to_u32().to_be_bytes();
                Some(last & 0x0F)
            }
            _ => None,
        }
    }

    /// Returns the errno or WSA code nnnn of 0x8091nnnn, as the operating system of the answering program counts it.
    ///
    /// [`E_BUSY_PROC`](Self::E_BUSY_PROC) and [`E_WINSOCK_MASK`](Self::E_WINSOCK_MASK) lie in that range but come
    /// from no operating system.
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

    /// Returns the level, 1 to 5, of an error of the robot controller itself.
    ///
    /// Levels 1 and 2 pause the robot; from level 3 on the tasks are reset and the motor is switched off. That the
    /// second digit is the level is how the vendor numbers its errors; neither specification promises it.
    #[must_use]
    pub const fn level(self) -> Option<u8> {
        match self.to_u32().to_be_bytes() {
            [first @ 0x81..=0x85, ..] => Some(first & 0x0F),
            _ => None,
        }
    }

    /// Finds the code's text in one of the tables that run parallel to [`CODES`].
    ///
    /// It scans, because texts are not time-critical and zipped iterators need no indexing.
    fn look_up(self, texts: &'static [&'static str]) -> Option<&'static str> {
        CODES.iter().zip(texts).find(|(code, _)| **code == self).map(|(_, text)| *text)
    }

    /// Iterates over the codes that have a name, ascending as unsigned numbers.
    pub fn known() -> impl ExactSizeIterator<Item = Self> + Clone {
        CODES.iter().copied()
    }

    /// Iterates over the ranges of codes that share a meaning: the first code, the last code, the meaning.
    ///
    /// If ranges overlap, the first one applies. A code with a [`name`](Self::name) has its own meaning.
    pub fn ranges() -> impl Iterator<Item = (Self, Self, &'static str)> + Clone {
        FAMILIES.iter().map(|(first, last, family)| (Self::from_u32(*first), Self::from_u32(*last), family.meaning()))
    }

    const fn family(self) -> Option<Family> {
        let code = self.to_u32();
        let mut rows = FAMILIES;
        while let [(first, last, family), rest @ ..] = rows {
            if *first <= code && code <= *last {
                return Some(*family);
            }
            rows = rest;
        }
        None
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

/// Codes that come in ranges, so that a table cannot list them.
#[derive(Clone, Copy)]
enum Family {
    UserDefined,
    Windows,
    Reserved,
    OperatingSystem,
    Acceleration,
    Speed,
    Position,
    Controller,
}

/// The ranges of the families; of several that contain a code the first one applies.
const FAMILIES: &[(u32, u32, Family)] = &[
    (0x80040200, 0x8004FFFF, Family::UserDefined),
    (0x80070000, 0x8007FFFF, Family::Windows),
    (0x80000000, 0x800101FF, Family::Reserved),
    (0x80910000, 0x8091FFFF, Family::OperatingSystem),
    (0x84204041, 0x84204048, Family::Acceleration),
    (0x84404541, 0x84404548, Family::Acceleration),
    (0x84204051, 0x84204058, Family::Speed),
    (0x84404531, 0x84404538, Family::Speed),
    (0x83204071, 0x83204078, Family::Position),
    (0x81000000, 0x85FFFFFF, Family::Controller),
];

impl Family {
    const fn meaning(self) -> &'static str {
        match self {
            Self::UserDefined => "An error that a user's program or a provider has defined.",
            Self::Windows => "A Windows error; its number is in the low 16 bits.",
            Self::Reserved => "A code of the reserved ranges, without a published meaning.",
            Self::OperatingSystem => "An operating system call failed; its errno or WSA code is in the low 16 bits.",
            Self::Acceleration => "The commanded acceleration of an axis is over its limit.",
            Self::Speed => "The commanded speed of an axis is over its limit.",
            Self::Position => "The position of an axis is over its software limit.",
            Self::Controller => "An error of the robot controller.",
        }
    }

    const fn hint(self, level: Option<u8>) -> &'static str {
        match self {
            Self::UserDefined => "look the code up in the manual of the program or provider that answered",
            Self::Windows => "look the low 16 bits up in the list of Windows system error codes",
            Self::Reserved => "ask the controller for its text with GetErrorDescription",
            Self::OperatingSystem => {
                "look the low 16 bits up as an errno or WSA code, and check the network of the program that answered"
            }
            Self::Acceleration => {
                "let the poses change speed more gently, slow down before stopping, and check parameter 153 on the \
                 teach pendant"
            }
            Self::Speed => {
                "put the poses closer together, never jump to catch up after a gap, and check parameter 153 on the \
                 teach pendant"
            }
            Self::Position => "jog the axis back into its range in manual mode, then correct the pose",
            Self::Controller => match level {
                Some(1 | 2) => "read the text with GetErrorDescription, remove the cause, then send ClearError",
                Some(5) => {
                    "read the text with GetErrorDescription, remove the cause, then send ClearError, or restart the \
                     controller if that is refused"
                }
                _ => {
                    "read the text with GetErrorDescription, remove the cause, then send ClearError and turn the \
                     motor on again"
                }
            },
        }
    }
}

/// Makes the constants and the parallel tables from one list of rows.
macro_rules! codes {
    ($($value:literal $name:ident, $source:literal, $meaning:literal, $functions:literal, $cause:literal, $hint:literal;)*) => {
        impl HResult {$(
            #[doc = $meaning]
            #[doc = ""]
            #[doc = concat!("`", stringify!($value), "`, ", $source, ".")]
            pub const $name: Self = Self::from_u32($value);
        )*}

        /// The known codes, ascending as unsigned numbers.
        static CODES: &[HResult] = &[$(HResult::$name),*];
        static NAMES: &[&str] = &[$(stringify!($name)),*];
        static MEANINGS: &[&str] = &[$($meaning),*];
        static FUNCTIONS: &[&str] = &[$($functions),*];
        static CAUSES: &[&str] = &[$($cause),*];
        static SOURCES: &[&str] = &[$($source),*];
        static HINTS: &[&str] = &[$($hint),*];
    };
}

// value, name, source, meaning (also the constant's doc), functions that return it, usual cause, what to do
codes! {
    0x00000000 S_OK, "b-CAP specification, section 5.3.1; RAC specification, Table 2-3",
        "The call succeeded.",
        "every function",
        "The controller did what was asked.",
        "go on";
    0x00000001 S_FALSE, "the vendor's libraries",
        "The call succeeded, and its answer is no, or there was nothing to do.",
        "Robot_Halt, Controller_Execute and functions with a yes-or-no result",
        "There was no motion to halt, or nothing to change.",
        "go on, after checking that the result is the one you want";
    0x00000900 S_EXECUTING, "the vendor's libraries; b-CAP specification, Table 4-1, describes the packet",
        "The call is still running; its answer follows under the same serial.",
        "every function, when Service_Start has set WDT",
        "A call takes longer than the watchdog interval, as a motion without NEXT does.",
        "wait for the answer, up to an overall deadline of your own";
    0x0F200501 S_BUF_FULL, "b-CAP specification, section 5.3.1",
        "The pose was stored, and the slave-mode buffer is full now.",
        "Robot_Execute slvMove",
        "Poses arrive faster than one in each control cycle of 8 ms.",
        "wait one control cycle (8 ms) before the next slvMove";

    0x80000200 E_CAO_SEM_CREATE, "the vendor's libraries (name only)",
        "The CAO engine could not create a semaphore.",
        "Service_Start, Controller_Connect",
        "The answering computer has no resources left.",
        "close sessions that are no longer used, then restart the controller";
    0x80000201 E_CAO_PROV_INVALID, "the vendor's libraries (name only)",
        "The provider's name is not known here.",
        "Controller_Connect",
        "The provider of another model, such as CaoProv.DENSO.VRC on an RC9, or a typing error.",
        "pass CaoProv.DENSO.VRC to an RC8 or COBOTTA, CaoProv.DENSO.VRC9 to an RC9";
    0x80000202 E_CAO_COMPUTER_NAME, "the vendor's libraries (name only)",
        "The computer's name is invalid.",
        "Controller_Connect",
        "The machine argument is not localhost and names no computer.",
        "pass localhost as the machine in Controller_Connect";
    0x80000203 E_CAO_VARIANT_TYPE_NOSUPPORT, "the vendor's libraries (name only)",
        "The VARTYPE is not supported.",
        "Variable_PutValue, and the Execute functions",
        "A value of an unsigned or 64-bit type, which few variables accept.",
        "send the type that the variable or command is documented with";
    0x80000204 E_CAO_OBJECT_NOTFOUND, "the vendor's libraries (name only)",
        "There is no such object.",
        "Controller_GetVariable and the other Get functions",
        "A typing error in the name, or an object of another model.",
        "check the name against what the matching Get...Names function lists";
    0x80000205 E_CAO_COLLECTION_REGISTERED, "the vendor's libraries (name only)",
        "An object of this name is registered already.",
        "Controller_Connect, and the Get functions",
        "An earlier connection with the same name has not been released.",
        "release the older object or choose another name, wait a few seconds, then try again";
    0x80000207 E_CAO_THREAD_CREATE, "the vendor's libraries (name only)",
        "The CAO engine could not create a thread.",
        "Controller_Connect",
        "The answering computer has no resources left.",
        "close sessions that are no longer used, then restart the controller";
    0x80000208 E_CAO_REMOTE_ENGINE, "the vendor's libraries (name only)",
        "The CAO engine of another computer could not be reached.",
        "Controller_Connect",
        "The machine argument names a computer that is off or not reachable.",
        "pass localhost as the machine, or check that the other computer is on and runs the CAO engine";
    0x80000209 E_CAO_REMOTE_PROVIDER, "the vendor's libraries (name only)",
        "A provider on another computer could not be started.",
        "Controller_Connect",
        "The other computer does not have the provider installed.",
        "pass localhost as the machine, or check that the provider is installed on the other computer";
    0x8000020A E_CAO_NOT_WRITABLE, "the vendor's libraries (name only)",
        "The object cannot be written.",
        "Variable_PutValue",
        "A read-only variable such as @CURRENT_POSITION.",
        "check that the variable is not read-only, and that the communication permission is Read/Write";
    0x8000020B E_CAO_CMD_EXECUTE, "the vendor's libraries (name only)",
        "The command is being executed already.",
        "Command_Execute",
        "The command was started a second time before it ended.",
        "wait until the command has ended, or cancel it";
    0x8000020C E_CAO_PROV_NO_LICENSE, "the vendor's libraries (name only)",
        "The provider has no licence.",
        "Controller_Connect",
        "The licence key of the provider is not registered.",
        "enter the provider's licence key on the answering computer or controller";
    0x8000020D E_CAO_PRELOAD, "the vendor's libraries (name only)",
        "A provider could not be loaded in advance.",
        "Service_Start",
        "A provider in the list of preloaded providers is not installed.",
        "check the list of preloaded providers, then restart the CAO engine";
    0x80000400 E_CRDIMPL, "the vendor's libraries (name only)",
        "A provider failed in the part that its CRD file defines.",
        "functions of an object that a CRD file describes",
        "The CRD file has an error.",
        "check the CRD file of the provider";
    0x80000401 E_CAOP_SYSTEMNAME_INVALID, "the vendor's libraries (name only)",
        "The name of the system variable is invalid.",
        "the GetVariable functions",
        "A system variable of another object: @SPEED of a controller, for example.",
        "check the spelling after the @, and whether the object is a controller, a robot or a task";
    0x80000402 E_CAOP_SYSTEMTYPE_INVALID, "the vendor's libraries (name only)",
        "The type of the system variable is invalid.",
        "Variable_PutValue",
        "A system variable was written with a value of another type.",
        "send the type that the system variable is documented with";
    0x80000403 E_CANCEL, "the vendor's libraries (name only)",
        "The call was cancelled.",
        "every function that takes long",
        "Another client or an operator cancelled the call.",
        "call again if the cancellation was not yours";
    0x80000404 E_CAOP_NOT_WRITABLE, "the vendor's libraries (name only)",
        "The provider's variable cannot be written.",
        "Variable_PutValue",
        "A read-only system variable.",
        "write another variable; this one is read-only";
    0x80000900 E_TIMEOUT, "the vendor's libraries",
        "The answer did not come in time.",
        "every function; clients report it as well",
        "The cable, the address or the port is wrong, or a call takes longer than the timeout.",
        "check cable, address and port, then raise the timeout, or set WDT in Service_Start for slow commands";
    0x80000901 E_NO_LICENSE, "the vendor's libraries (name only)",
        "The function has no licence.",
        "Robot_Execute slvChangeMode, and optional functions",
        "The licence of the option, such as b-CAP Slave, is not entered.",
        "enter the licence key on the teach pendant; slave mode needs the one for b-CAP Slave";
    0x80000902 E_NOT_CONNECTED, "the vendor's libraries",
        "There is no connection.",
        "every function",
        "The controller has ended the session: after 10 s of silence over UDP, or at a restart.",
        "check that the controller is on and reachable, then connect again";
    0x80000903 E_NOT_USE, "the vendor's libraries (name only)",
        "The function is not available.",
        "functions that depend on a setting",
        "The function is switched off, or another model has it.",
        "check that this controller, provider and setting offer the function";
    0x80000904 E_INVALID_CMD_NAME, "the vendor's libraries (name only)",
        "The command's name is invalid.",
        "Controller_Execute, Robot_Execute",
        "A typing error, or a command of the robot that was sent to the controller.",
        "check the spelling of the command, and whether the controller or the robot takes it";
    0x80000905 E_MAX_OBJECT, "the vendor's libraries",
        "The table of objects or connections is full.",
        "the Get functions, Service_Start",
        "Handles are opened in a loop and not released, or too many clients are connected.",
        "release handles and close connections that are no longer used";
    0x80000906 E_ALREADY_REGISTER, "the vendor's libraries (name only), which never return it",
        "It is registered already.",
        "no known function",
        "Something is registered twice.",
        "remove the older registration first";
    0x80000909 E_TOO_MUCH_DATA, "the vendor's libraries",
        "The packet is larger than the link carries.",
        "Variable_PutValue, File_PutValue over UDP",
        "An array or a file was sent in one datagram.",
        "send less in one call (at most 488 bytes over UDP), or use TCP";
    0x8000090B E_MAX_CONNECT, "the vendor's libraries",
        "The server already knows as many UDP clients as it can.",
        "Service_Start over UDP",
        "Clients end without Service_Stop, so the server remembers them for 10 s.",
        "end unused clients with Service_Stop, or wait 10 s until idle ones are forgotten";

    0x80004001 E_NOTIMPL, "RAC specification, Table 2-3",
        "The function is not implemented.",
        "every function that a model lacks",
        "The function belongs to another model or to a later software version.",
        "check that this controller and its software version have the function";
    0x80004003 E_POINTER, "the vendor's libraries",
        "A pointer is invalid, as when an argument is missing.",
        "every function with arguments",
        "An argument was left out.",
        "pass every argument that the function takes";
    0x80004004 E_ABORT, "RAC specification, Table 2-3",
        "The function was aborted.",
        "functions that move, Task_Start",
        "A halt, an emergency stop or a change of mode ended the function.",
        "look on the teach pendant for what stopped it, then call again";
    0x80004005 E_FAIL, "RAC specification, Table 2-3",
        "The function failed.",
        "every function",
        "The controller has no better code; its error list has the cause.",
        "read the cause with GetCurErrorInfo or on the teach pendant";
    0x8000FFFF E_UNEXPECTED, "RAC specification, Table 2-3",
        "A fatal error occurred.",
        "every function",
        "An internal error of the controller.",
        "read the error log, then connect again, and restart the controller if it comes back";

    0x80010000 E_INVALIDPACKET, "the vendor's libraries",
        "A packet could not be decoded.",
        "every function",
        "Another protocol was spoken on the port: RAC on 5007, or b-CAP on 5006.",
        "check that both ends speak b-CAP on this port, then connect again";
    0x80010001 E_INVALIDRCPACKET, "RAC specification, Table 2-3",
        "The controller received an invalid packet and cuts the connection.",
        "every function",
        "A wrong length or byte in the request, or two threads that write to one connection.",
        "record the traffic, correct the packet that was sent last, then connect again";
    0x80010002 E_INVALIDSNDPACKET, "RAC specification, Table 2-3",
        "The packet to be sent is invalid.",
        "every function",
        "A value that cannot be encoded, such as an array that is too long.",
        "record the call with its arguments, and check their types and sizes";
    0x80010003 E_INVALIDARGTYPE, "RAC specification, Table 2-3",
        "An argument has the wrong type.",
        "every function with arguments",
        "An I4 where an R4 is expected, or a number where the function takes text.",
        "check the VARTYPE of each argument against the function's signature; through a gateway, the type of the variable";
    0x80010004 E_ROBOTISBUSY, "RAC specification, Table 2-3",
        "A motion command came while the robot was moving.",
        "Robot_Move, Robot_Drive and the other functions that move",
        "A motion was started with NEXT, and the following one was sent before the first ended.",
        "wait until @BUSY_STATUS is false, or halt the motion, then call again";
    0x80010005 E_INVALIDCOMMAND, "RAC specification, Table 2-3",
        "The command string is invalid.",
        "Controller_Execute, Robot_Execute",
        "A typing error in the command or in its parameters.",
        "check the spelling of the command and of its parameters";
    0x80010011 E_PACKETSIZEOVER, "RAC specification, Table 2-3",
        "The received packet is over 16 MiB.",
        "File_PutValue, Variable_PutValue",
        "A file that was sent in one call.",
        "split the data over several calls";
    0x80010012 E_ARGSIZEOVER, "RAC specification, Table 2-3",
        "An argument of the received packet is over 16 MiB.",
        "File_PutValue, Variable_PutValue",
        "A file that was sent as one argument.",
        "split the argument over several calls";

    0x80020005 DISP_E_TYPEMISMATCH, "the vendor's libraries",
        "The value cannot be converted to this type.",
        "RAC's PUT, and functions with text that is converted",
        "Text that is not a number where a number is expected, or a decimal comma.",
        "write the value in the form of its type, without blanks after numbers";
    0x80020008 DISP_E_BADVARTYPE, "the vendor's libraries",
        "The VARTYPE cannot be converted.",
        "RAC's PUT, Variable_PutValue",
        "A type in front of the value that RAC does not have.",
        "use one of the types of the RAC table, such as 3, 5, 8 or 8197";
    0x8002000A DISP_E_OVERFLOW, "the vendor's libraries",
        "The value is out of the range of its type.",
        "RAC's PUT, Variable_PutValue",
        "70000 written to an I2, for example.",
        "send a smaller value, or a wider type";
    0x8002000B DISP_E_BADINDEX, "the vendor's libraries",
        "The index is outside of the array.",
        "functions with arrays",
        "An array with too few elements, such as a pose of three numbers.",
        "check the length of the array";

    0x80070005 E_ACCESSDENIED, "RAC specification, Table 2-3",
        "Access is denied.",
        "Variable_PutValue, functions that move, Robot_Execute slvChangeMode",
        "Manual mode, no executable token, or read-only communication permission.",
        "through a gateway, a rule refuses this client or variable: see the gateway's log; at a robot, set Auto mode, and give \
         this client's address the executable token and the Read/Write permission";
    0x80070006 E_HANDLE, "RAC specification, Table 2-3",
        "The handle is invalid.",
        "every function with a handle",
        "The object was released, or the handle was got on an earlier or another connection.",
        "get the object again: a handle dies with its release and belongs to the connection that got it";
    0x8007000E E_OUTOFMEMORY, "RAC specification, Table 2-3",
        "The memory does not suffice.",
        "every function",
        "Handles are not released, or a value is too large.",
        "release handles, send less at once, then restart the controller";
    0x80070057 E_INVALIDARG, "RAC specification, Table 2-3",
        "An argument is invalid.",
        "every function with arguments",
        "A value out of its range, an argument too many, or an option that the function does not know.",
        "check the number, order, types and ranges of the arguments, and the option string; through a gateway, the range that its \
         rule allows";
    0x8007FFFF E_WINDOWS_MASK, "the vendor's libraries",
        "The mask that Windows errors are combined with, not an error by itself.",
        "no known function",
        "The answering program has lost the number of the error.",
        "look in the log of the program that answered for the error it has lost";
    0x809100AA E_BUSY_PROC, "the vendor's libraries",
        "The previous call of this connection is still running.",
        "every function",
        "A second call on the same connection before the reply to the first.",
        "wait until the previous call has ended, or use a second connection; through a gateway, send fewer requests than its rate";
    0x8091FFFF E_WINSOCK_MASK, "the vendor's libraries",
        "The mask that errors of the operating system are combined with, not an error by itself.",
        "no known function",
        "The answering program has lost the number of the error.",
        "look in the log of the program that answered for the error it has lost";

    0x81501003 E_MOTOR_OFF, "public clients; the name is this project's",
        "The command needs the motor on.",
        "Robot_Move and the other functions that move",
        "The motor was never turned on, or an error or a stop turned it off.",
        "turn the motor on, wait until @SERVO_ON is true, then call again";
    0x81501025 E_ERROR_PRESENT, "public clients; the name is this project's",
        "The command is refused while the controller has an error.",
        "functions that move, Robot_Execute Motor, Task_Start",
        "An earlier error was not cleared.",
        "read the errors with GetCurErrorInfo, remove their causes, then send ClearError";
    0x81501069 E_MOTION_UNPREPARED, "a public client; the name is this project's",
        "A COBOTTA has not made its motion preparation.",
        "Robot_Execute Motor on a COBOTTA",
        "The controller was started, and nothing has prepared its motion yet.",
        "send ManualResetPreparation and MotionPreparation, then turn the motor on";
    0x83201483 E_BUF_FULL, "b-CAP specification, section 5.3.1",
        "The slave-mode buffer is full, and the pose was not stored.",
        "Robot_Execute slvMove",
        "The client sends faster than the control cycle, or repeats a pose that was stored.",
        "wait one control cycle (8 ms) and send the same pose again";
    0x83500076 E_MOTION_STOPPED, "the log of a real RC8A; the name is this project's",
        "A motion of a client was stopped.",
        "Robot_Move and the other functions that move, without NEXT",
        "A halt, an emergency stop, a switch of the mode or another error stopped the robot.",
        "read with GetCurErrorInfo whether there is another error, look where the robot is, send ClearError";
    0x83500121 E_SLVMODE_OFF, "named by an older client of the vendor",
        "slvMove was sent while slave mode was not selected.",
        "Robot_Execute slvMove",
        "Slave Mode was never selected, or an error such as an empty buffer ended it.",
        "read with GetCurErrorInfo what ended slave mode, send ClearError, turn the motor on, then slvChangeMode";
    0x83500372 E_MANUAL_RESET_UNPREPARED, "the vendor's ROS driver; the name is this project's",
        "A COBOTTA wants ManualResetPreparation before a command that concerns safety.",
        "Controller_Execute MotionPreparation on a COBOTTA",
        "ManualResetPreparation was not sent since the last start or stop.",
        "send ManualResetPreparation, then the same command again";
    0x83501024 E_ARM_NOT_TAKEN, "public clients; the name is this project's",
        "The client does not have the arm, or cannot take it.",
        "Robot_Execute TakeArm, Robot_Move and the other functions that move",
        "Another task or client has the arm, or TakeArm was not sent on this connection.",
        "send TakeArm, after ending the task or client that holds the arm";
    0x83501028 E_TOKEN_NOT_ETHERNET, "public reports; the name is this project's",
        "The executable token is not with Ethernet.",
        "functions that move, Robot_Execute Motor, Task_Start",
        "The executable token is with the teach pendant, I/O or another interface.",
        "set the executable token to Ethernet, or to Any, on the teach pendant";
    0x83501029 E_TOKEN_ADDRESS, "public clients; the name is this project's",
        "The executable token is not with this client's address.",
        "functions that move, Robot_Execute Motor, Task_Start",
        "The executable token is with the address of another computer.",
        "enter this client's IP address for the executable token on the teach pendant";
    0x83501032 E_SLVMODE_ON, "the vendor's ROS issues; the name is this project's",
        "The command is refused in slave mode.",
        "functions that move, and IO variables",
        "A command that Slave Mode excludes was sent between two poses.",
        "send slvChangeMode 0 first, or do it before slave mode; IO travels inside slvMove";
    0x8350106E E_MOTOR_TURNING_OFF, "a public client; the name is this project's",
        "The motor was to be turned on while it was being turned off.",
        "Robot_Execute Motor",
        "The motor was turned off and on again within a second.",
        "send ClearError, wait a moment, then turn the motor on again";
    0x84201482 E_COMMAND_BUFFER_EMPTY, "b-CAP specification, Table 5-6; named by an older client of the vendor",
        "The slave-mode buffer ran empty while the robot was moving, and slave mode was released.",
        "Robot_Execute slvMove",
        "A pose came late: the client was not scheduled in time, or the network was delayed.",
        "fill the buffer before pacing, send a pose each 8 ms or use mode 2, and end with the same pose twice";
    0x84201486 E_COMMAND_POSITION_GEN_STOPPED, "named by an older client of the vendor",
        "The controller has stopped generating command positions.",
        "Robot_Execute slvMove",
        "An emergency stop or a change of mode during Slave Mode.",
        "release the emergency stop, return to Auto mode, send ClearError, then start slave mode again";
}

#[cfg(test)]
mod tests {
    extern crate std;

    use std::format;
    use std::string::ToString as _;
    use std::vec::Vec;

    use super::*;

    #[test]
    fn the_table_ascends_and_its_columns_are_parallel() {
        let codes: Vec<u32> = CODES.iter().map(|code| code.to_u32()).collect();
        assert!(codes.is_sorted_by(|a, b| a < b), "{codes:x?}");
        let columns = [NAMES, MEANINGS, FUNCTIONS, CAUSES, SOURCES, HINTS];
        assert_eq!(columns.map(<[_]>::len), [codes.len(); 6]);
        for text in MEANINGS.iter().chain(CAUSES) {
            assert!(text.ends_with('.') && !text.contains('\n'), "{text}");
        }
    }

    #[test]
    fn the_specified_codes_have_the_specified_values() {
        for (code, value) in [
            (HResult::S_OK, 0x0000_0000),
            (HResult::S_EXECUTING, 0x0000_0900),
            (HResult::S_BUF_FULL, 0x0F20_0501),
            (HResult::E_CAO_PRELOAD, 0x8000_020D),
            (HResult::E_CAOP_NOT_WRITABLE, 0x8000_0404),
            (HResult::E_TIMEOUT, 0x8000_0900),
            (HResult::E_NOT_CONNECTED, 0x8000_0902),
            (HResult::E_UNEXPECTED, 0x8000_FFFF),
            (HResult::E_INVALIDRCPACKET, 0x8001_0001),
            (HResult::E_PACKETSIZEOVER, 0x8001_0011),
            (HResult::DISP_E_TYPEMISMATCH, 0x8002_0005),
            (HResult::E_HANDLE, 0x8007_0006),
            (HResult::E_INVALIDARG, 0x8007_0057),
            (HResult::E_BUSY_PROC, 0x8091_00AA),
            (HResult::E_BUF_FULL, 0x8320_1483),
            (HResult::E_MOTION_STOPPED, 0x8350_0076),
            (HResult::E_SLVMODE_OFF, 0x8350_0121),
            (HResult::E_COMMAND_BUFFER_EMPTY, 0x8420_1482),
        ] {
            assert_eq!(code.to_u32(), value, "{code:?}");
            assert_eq!(HResult::from_u32(value), code);
        }
        assert_eq!(HResult::default(), HResult::S_OK);
        assert_eq!(HResult::E_TIMEOUT.0, -2_147_481_344);
    }

    #[test]
    fn names_round_trip_in_any_case() {
        for code in CODES {
            let name = code.name().unwrap();
            assert_eq!(HResult::from_name(name), Some(*code));
            assert_eq!(HResult::from_name(&name.to_ascii_lowercase()), Some(*code));
        }
        assert_eq!(HResult::from_name("e_Timeout"), Some(HResult::E_TIMEOUT));
        for unknown in ["", "E_", "E_TIMEOUT ", "0x80000900", "É_TIMEOUT"] {
            assert_eq!(HResult::from_name(unknown), None, "{unknown:?}");
        }
    }

    #[test]
    fn names_have_the_prefix_of_their_severity() {
        for code in CODES {
            let name = code.name().unwrap();
            assert_eq!(name.starts_with("S_"), code.is_ok(), "{name}");
            assert_eq!(name.starts_with("E_") || name.starts_with("DISP_E_"), code.is_err(), "{name}");
        }
    }

    #[test]
    fn ranges_and_known_codes_have_the_meanings_of_their_codes() {
        assert!(HResult::known().all(|code| code.name().is_some()));
        assert_eq!(HResult::known().len(), CODES.len());
        for (first, last, meaning) in HResult::ranges() {
            for code in [first, last].into_iter().filter(|code| code.name().is_none()) {
                assert_eq!(code.meaning(), Some(meaning), "{code}");
            }
        }
    }

    #[test]
    fn texts_keep_to_their_form() {
        let families = [0x8004_0200, 0x8007_0001, 0x8000_0001, 0x8091_0001, 0x8420_4041, 0x8420_4051, 0x8320_4071];
        let levels = [0x8150_0001, 0x8250_0001, 0x8350_0001, 0x8450_0001, 0x8550_0001];
        let ranged = families.into_iter().chain(levels).map(HResult::from_u32);
        for code in CODES.iter().copied().chain(ranged) {
            let meaning = code.meaning().unwrap();
            assert!(meaning.ends_with('.') && !meaning.contains(". "), "{meaning}");
            let hint = code.hint().unwrap();
            assert!(hint.starts_with(|first: char| first.is_ascii_lowercase()), "{hint}");
            assert!(!hint.ends_with('.') && !hint.contains("  ") && !hint.contains('\n'), "{hint}");
        }
    }

    #[test]
    fn only_bit_31_decides_success() {
        for code in [0, 1, 0x900, 0x0F20_0501, 0x7FFF_FFFF] {
            let code = HResult::from_u32(code);
            assert!(code.is_ok() && !code.is_err(), "{code}");
        }
        for code in [0x8000_0000, 0x8000_0900, 0x8320_1483, 0xFFFF_FFFF] {
            let code = HResult::from_u32(code);
            assert!(code.is_err() && !code.is_ok(), "{code}");
        }
    }

    #[test]
    fn an_axis_is_read_from_the_limit_families_only() {
        for family in [0x8420_4040, 0x8420_4050, 0x8440_4530, 0x8440_4540, 0x8320_4070] {
            for axis in 1..=8_u8 {
                let code = HResult::from_u32(family | u32::from(axis));
                assert_eq!(code.axis(), Some(axis), "{code}");
                assert_eq!(code.name(), None, "{code}");
            }
            for no_axis in [0, 9, 0xF] {
                assert_eq!(HResult::from_u32(family | no_axis).axis(), None);
            }
        }
        assert_eq!(HResult::E_COMMAND_BUFFER_EMPTY.axis(), None);
        assert_eq!(HResult::S_FALSE.axis(), None);

        let acceleration = HResult::from_u32(0x8420_4043);
        assert_eq!(acceleration.meaning(), Some("The commanded acceleration of an axis is over its limit."));
        assert_eq!(HResult::from_u32(0x8440_4543).hint(), acceleration.hint());
        assert_ne!(HResult::from_u32(0x8420_4053).hint(), acceleration.hint());
    }

    #[test]
    fn an_os_error_is_the_low_half_of_0x8091() {
        assert_eq!(HResult::from_u32(0x8091_006F).os_error(), Some(111));
        assert_eq!(HResult::from_u32(0x8091_274C).os_error(), Some(10060));
        assert_eq!(HResult::from_u32(0x8091_0000).os_error(), Some(0));
        assert_eq!(HResult::E_BUSY_PROC.os_error(), None);
        assert_eq!(HResult::E_WINSOCK_MASK.os_error(), None);
        assert_eq!(HResult::from_u32(0x8090_006F).os_error(), None);
        assert_eq!(HResult::from_u32(0x0091_006F).os_error(), None);
    }

    #[test]
    fn a_level_is_the_second_digit_of_a_controller_error() {
        assert_eq!(HResult::E_MOTOR_OFF.level(), Some(1));
        assert_eq!(HResult::E_SLVMODE_OFF.level(), Some(3));
        assert_eq!(HResult::E_COMMAND_BUFFER_EMPTY.level(), Some(4));
        assert_eq!(HResult::from_u32(0x8540_0001).level(), Some(5));
        for code in [HResult::S_BUF_FULL, HResult::E_TIMEOUT, HResult::from_u32(0x8640_0001)] {
            assert_eq!(code.level(), None, "{code}");
        }
    }

    #[test]
    fn a_row_goes_before_its_family_and_a_family_before_nothing() {
        let hint = |code| HResult::from_u32(code).hint().unwrap();
        assert_ne!(HResult::E_HANDLE.hint(), Some(hint(0x8007_06BE)));
        assert!(hint(0x8007_06BE).contains("Windows"));
        assert!(hint(0x8091_006F).contains("errno"));
        assert_eq!(hint(0x8004_0200), hint(0x8004_FFFF));
        assert_eq!(hint(0x8000_0206), hint(0x8001_01FF));
        assert!(hint(0x8550_0001).contains("restart"));
        for outside in [2, 0x0F20_0502, 0x8004_01FF, 0x8001_0200, 0x8002_0001, 0x8600_0000, 0xFFFF_FFFF] {
            let code = HResult::from_u32(outside);
            assert_eq!((code.meaning(), code.hint(), code.axis()), (None, None, None), "{code}");
        }
    }

    #[test]
    fn known_codes_print_their_name_and_unknown_ones_their_number() {
        assert_eq!(format!("{:?}", HResult::E_TIMEOUT), "E_TIMEOUT");
        assert_eq!(format!("{:?}", HResult::from_u32(0x8420_404F)), "HResult(0x8420404f)");
        assert_eq!(format!("{:?}", HResult(2)), "HResult(0x00000002)");
        assert_eq!(HResult::E_TIMEOUT.to_string(), "0x80000900 (E_TIMEOUT)");
        assert_eq!(HResult::S_OK.to_string(), "0x00000000 (S_OK)");
        assert_eq!(HResult::from_u32(0x8420_404F).to_string(), "0x8420404f");
        assert_eq!(HResult(-1).to_string(), "0xffffffff");
    }
}
