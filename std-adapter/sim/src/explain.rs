//! Why a call was refused: what it was given, and what its arguments may be.
//!
//! The wire has no text beside a code. So the text is kept, and GetErrorDescription of that code ends with it; an
//! [`Observer`] gets it too. There is one text for each code, of the last call of any client: drivers ask for
//! descriptions over another session than the one that was refused.
//!
//! A call that the server refuses before it reaches the model has no text.

use std::collections::BTreeMap;
use std::fmt::{self, Write as _};
use std::sync::Arc;

use bcap_core::bcap::FunctionId;
use bcap_core::bcap::server::Request;
use bcap_core::hresult::HResult;
use bcap_core::variant::Variant;

/// The codes that say that an argument is refused.
const CODES: [HResult; 6] = [
    HResult::E_INVALIDARG,
    HResult::E_INVALIDARGTYPE,
    HResult::E_ARGSIZEOVER,
    HResult::DISP_E_TYPEMISMATCH,
    HResult::DISP_E_OVERFLOW,
    HResult::DISP_E_BADINDEX,
];

/// Elements of an array, characters of a string and characters in all that are shown of what was given.
const ELEMENTS_MAX: usize = 16;
const TEXT_MAX: usize = 40;
const SHOWN_MAX: usize = 300;

/// Commands of robot, controller and hand, and what their parameter may be.
const COMMANDS: &[(&str, &str)] = &[
    ("TakeArm", "nothing, the group, or [group, keep]: group 0, keep 0 or 1"),
    ("TakeArmState", "nothing, or one number: the group 0, or -1"),
    ("Motor", "one number or BOOL: 0 off, otherwise on; or [state, no wait]"),
    ("ExtSpeed", "a speed, [speed, accel] or [speed, accel, decel], in percent, 0.0001 to 100"),
    ("RobInfo", "one number: 1"),
    ("DriveEx", DRIVE),
    ("DriveAEx", DRIVE),
    ("J2P", "6 to 8 numbers in degrees, \"J(...)\", \"J1\" or [numbers, \"J\"]"),
    ("J2T", "6 to 8 numbers in degrees, \"J(...)\", \"J1\" or [numbers, \"J\"]"),
    ("P2J", "6 or 7 numbers (X Y Z RX RY RZ Fig), \"P(...)\", \"P1\" or [numbers, \"P\"]"),
    ("P2T", "6 or 7 numbers (X Y Z RX RY RZ Fig), \"P(...)\", \"P1\" or [numbers, \"P\"]"),
    ("T2J", "9 or 10 numbers (position, orient, approach, Fig), \"T(...)\", \"T1\" or [numbers, \"T\"]"),
    ("T2P", "9 or 10 numbers (position, orient, approach, Fig), \"T(...)\", \"T1\" or [numbers, \"T\"]"),
    ("slvChangeMode", "one number: 0, 0x001 to 0x003, 0x101 to 0x103, 0x201 to 0x203"),
    ("slvSendFormat", "one number: 0, 0x20, 0x100, 0x120, 0x200 or 0x220, of the parts that the controller has"),
    ("slvRecvFormat", "format or [format, unit]: the pose 1 to 5, plus 0x10, 0x20, 0x40, 0x100, 0x200; unit 0 or 1"),
    (
        "slvMove",
        "an array of 7 (P), 8 (J) or 10 (T) numbers by the mode, with an option element and J7, J8 where the arm has \
         them; with IO: [pose, MiniIO, user IO offset, size, bytes, offset, size, HandIO] by the formats",
    ),
    ("GetErrorDescription", "one code: I4, UI4, ERROR or another integer"),
    ("GetCurErrorInfo", "one number: the index, from 0 to below GetCurErrorCount"),
    ("GetErrorLog", "one number: the index, from 0 to below GetErrorLogCount"),
    ("SysInfo", "one number: 0, the serial number"),
    ("HandMoveA", "[place, speed]: 0 to 30 mm, 1 to 100 percent"),
    ("HandMoveR", "[way, speed]: in mm and within 0 to 30 mm, 1 to 100 percent"),
    ("HandMoveH", "[force, close]: 6 to 20 N, BOOL or a number"),
];

const DRIVE: &str = "pairs or [pairs, option]: pairs are \"@E (axis, value), ...\" or [[axis, value], ...], with axes \
                     1 to 6, and 7 and 8 where the arm has them; option as for Robot_Move";

/// What the other functions take, without their handle.
const FUNCTIONS: &[(FunctionId, &str)] = &[
    (
        FunctionId::ROBOT_MOVE,
        "interpolation I4: 1 joints, 2 line; pose BSTR (\"@E P1\", \"J(0,45,90,0,45,0) EXA((7,10))\"), an array of \
         7 (P), 8 (J) or 10 (T) numbers, or [numbers or index, type, pass, extended joints]; option BSTR: NEXT, \
         SPEED= (S=), ACCEL=, DECEL= with a number or a variable I, F or D in percent, 0.0001 to 100",
    ),
    (
        FunctionId::ROBOT_DRIVE,
        "axis I4: 1 to 6, and 7 and 8 where the arm has them; value: degrees or mm; option BSTR as for Robot_Move",
    ),
    (FunctionId::ROBOT_SPEED, "axis I4: -1 or 0; speed: percent, 0.0001 to 100"),
    (FunctionId::ROBOT_ACCELERATE, "axis I4: -1 or 0; acceleration and deceleration: percent, 0.0001 to 100"),
    (FunctionId::ROBOT_CHANGE, "name BSTR: Tool or Work with a number, 0 to 63"),
    (FunctionId::ROBOT_CHUCK, "option BSTR: empty"),
    (FunctionId::ROBOT_UNCHUCK, "option BSTR: empty"),
    (FunctionId::TASK_START, "mode I4: 1 one cycle, 2 continuous, 3 one line; option BSTR"),
    (FunctionId::TASK_STOP, "mode I4: 0 to 4; option BSTR"),
    (FunctionId::COMMAND_EXECUTE, "mode I4: 0 waits for the result, 1 does not"),
    (FunctionId::COMMAND_PUT_TIMEOUT, "time I4: milliseconds, 0 or more"),
    (FunctionId::FILE_PUT_VALUE, "value: BSTR, or an array of UI1; a folder has no value"),
    (FunctionId::CONTROLLER_GET_FILE, FILE_NAME),
    (FunctionId::FILE_GET_FILE, FILE_NAME),
    (FunctionId::FILE_COPY, FILE_NAME),
    (FunctionId::FILE_MOVE, FILE_NAME),
    (FunctionId::VARIABLE_PUT_ID, "ID: one number, the index of a variable that exists"),
    (FunctionId::VARIABLE_GET_VALUE, "a variable, or a wildcard (I*) of which Variable_PutID has chosen one"),
    (
        FunctionId::CONTROLLER_GET_VARIABLE,
        "name BSTR: @NAME, or a user variable whose index is below @VAR_..._LEN; option BSTR",
    ),
];

const FILE_NAME: &str =
    "name BSTR: a path of at most 32 parts without control characters and < > : \" | ? *; option BSTR";

type Tell = dyn Fn(HResult, &str) + Send + Sync;

/// Is told the code and the text of each refusal of an argument.
#[derive(Clone, Default)]
pub struct Observer(Option<Arc<Tell>>);

impl Observer {
    /// Makes an observer of a function, which must not block.
    #[must_use]
    pub fn new(tell: impl Fn(HResult, &str) + Send + Sync + 'static) -> Self {
        Self(Some(Arc::new(tell)))
    }
}

impl fmt::Debug for Observer {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Observer")
    }
}

/// The texts of the last refusals, by their codes.
#[derive(Clone, Debug, Default)]
pub(crate) struct Refusals {
    last: BTreeMap<u32, String>,
}

impl Refusals {
    /// Notes that a request was refused, if it was for its arguments. `accepted` says what it takes, where that depends
    /// on more than its function and its command.
    pub(crate) fn note(
        &mut self,
        request: &Request<'_>,
        accepted: Option<&'static str>,
        code: HResult,
        observer: &Observer,
    ) {
        if !CODES.contains(&code) {
            return;
        }
        let text = explain(request, accepted);
        if let Some(tell) = &observer.0 {
            tell(code, &text);
        }
        self.last.insert(code.to_u32(), text);
    }

    /// Returns the text of the last refusal with this code.
    pub(crate) fn last(&self, code: HResult) -> Option<&str> {
        self.last.get(&code.to_u32()).map(String::as_str)
    }
}

/// Says what a call was given, and what it takes.
fn explain(request: &Request<'_>, accepted: Option<&'static str>) -> String {
    let mut text = request.function.to_string();
    let command = match (request.function.name(), request.value(1)) {
        (Some(name), Variant::Bstr(command)) if name.ends_with("Execute") => Some(beginning(command.chars())),
        _ => None,
    };
    if let Some(command) = &command {
        let _ = write!(text, " {command:?}");
    }
    text.push_str(": given ");
    // the handle and the command are known already
    let first = if command.is_some() { 2 } else { 1 };
    text.push_str(if request.args.len() <= first { "nothing" } else { "" });
    for n in first..request.args.len() {
        text.push_str(if n > first { "; " } else { "" });
        show(&mut text, &request.value(n), 0);
    }
    let accepted = accepted.or_else(|| match &command {
        Some(command) => find(COMMANDS, |name| name.eq_ignore_ascii_case(command.trim())),
        None => find(FUNCTIONS, |function| *function == request.function),
    });
    if let Some(accepted) = accepted {
        text.push_str("; accepted ");
        text.push_str(accepted);
    }
    text
}

fn find<K>(table: &'static [(K, &'static str)], is_it: impl Fn(&K) -> bool) -> Option<&'static str> {
    table.iter().find(|(key, _)| is_it(key)).map(|(_, text)| *text)
}

/// Returns the beginning of a string.
fn beginning(mut characters: impl Iterator<Item = Result<char, u16>>) -> String {
    let mut text: String =
        characters.by_ref().take(TEXT_MAX).map(|c| c.unwrap_or(char::REPLACEMENT_CHARACTER)).collect();
    if characters.next().is_some() {
        text.push_str("...");
    }
    text
}

/// Shows a value, of which long parts are cut.
fn show(text: &mut String, value: &Variant<'_>, depth: usize) {
    match value.flatten() {
        Variant::Bstr(string) => {
            let _ = write!(text, "{:?}", beginning(string.chars()));
        }
        Variant::Array(array) if array.len() > ELEMENTS_MAX || depth > 2 => {
            let _ = write!(text, "{:?} of {} elements", array.element(), array.len());
        }
        Variant::Array(array) => {
            text.push('[');
            for (n, item) in array.iter().enumerate() {
                text.push_str(if n > 0 { ", " } else { "" });
                if text.len() > SHOWN_MAX {
                    text.push_str("...");
                    break;
                }
                show(text, &item, depth + 1);
            }
            text.push(']');
        }
        other => {
            let _ = write!(text, "{other:?}");
        }
    }
}
