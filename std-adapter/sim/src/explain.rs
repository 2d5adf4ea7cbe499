//! The reason of a refused call: its actual and its accepted arguments.
//!
//! The protocol carries no text with a code. So GetErrorDescription of that code ends with the reason, and an
//! [`Observer`] receives it too. The model keeps one reason for each code, from the last call of any client, because
//! drivers query descriptions over a session other than the refused one.
//!
//! The server refuses a call with a wrong number or wrong types of arguments before it reaches the model. The reason names the
//! argument.

use std::collections::BTreeMap;
use std::fmt::{self, Write as _};
use std::sync::Arc;

use bcap_core::bcap::server::{Request, StartOptions};
use bcap_core::bcap::{FunctionId, Kind};
use bcap_core::hresult::HResult;
use bcap_core::variant::Variant;

use crate::codes::WRONG_ARGUMENT;
use crate::command_name::executes;

/// The codes of refused arguments.
const CODES: [HResult; 7] = [
    WRONG_ARGUMENT,
    HResult::E_INVALIDARG,
    HResult::E_INVALIDARGTYPE,
    HResult::E_ARGSIZEOVER,
    HResult::DISP_E_TYPEMISMATCH,
    HResult::DISP_E_OVERFLOW,
    HResult::DISP_E_BADINDEX,
];

/// The largest number of shown elements of an array, characters of a string, and characters in total.
const ELEMENTS_MAX: usize = 16;
const TEXT_MAX: usize = 40;
const SHOWN_MAX: usize = 300;

/// The arguments that functions accept, without their handle; those of commands are in the tables of commands.
const FUNCTIONS: &[(FunctionId, &str)] = &[
    (
        FunctionId::ROBOT_MOVE,
        "interpolation I4: 1 joints, 2 line, 3 arc (BSTR \"P1, @E P2\": a point of the circle, and the end), 4 the \
         points of a path (its number, 1 to 20); pose BSTR (\"@E P1\", \"J(0,45,90,0,45,0) EXA((7,10))\"), an array of 7 (P), 8 (J) or 10 (T) numbers, or [numbers or index, type, pass, extended joints]; option BSTR: NEXT, \
         SPEED= (S=), ACCEL=, DECEL= with a number or a variable I, F or D in percent, 0.0001 to 100",
    ),
    (
        FunctionId::CONTROLLER_CONNECT,
        "name, provider, machine BSTR; option BSTR: @IfNotMember, @EventDisable=, WPJ=, Interval=, Server=",
    ),
    (FunctionId::CONTROLLER_GET_ROBOT, "name BSTR; option BSTR: ID=, @IfNotMember"),
    (FunctionId::ROBOT_GET_VARIABLE, OBJECT),
    (FunctionId::TASK_GET_VARIABLE, OBJECT),
    (FunctionId::CONTROLLER_GET_TASK, OBJECT),
    (FunctionId::CONTROLLER_GET_EXTENSION, OBJECT),
    (FunctionId::CONTROLLER_GET_COMMAND, OBJECT),
    (
        FunctionId::ROBOT_DRIVE,
        "axis I4: 1 to 6, and 7 and 8 where the arm has them; value: degrees or mm; option BSTR as for Robot_Move",
    ),
    (
        FunctionId::ROBOT_ROTATE,
        "plane BSTR: XY, YZ, ZX, of the tool XYH, YZH, ZXH, or three points (\"V1, V2, V3\", or an array of them); degrees: \
         -3600 to 3600; centre BSTR: V(x,y,z) or a variable V; option BSTR: @0, @P, @n, Pose=1 (the flange turns) or \
         Pose=2 (it does not; the default), and the options of Robot_Move",
    ),
    (FunctionId::ROBOT_SPEED, "axis I4: -1 or 0; speed: percent, 0.0001 to 100"),
    (FunctionId::ROBOT_ACCELERATE, "axis I4: -1 or 0; acceleration and deceleration: percent, 0.0001 to 100, or -1"),
    (FunctionId::ROBOT_CHANGE, "name BSTR: Tool with a number, 0 to 63, or Work with one, 0 to 7"),
    (FunctionId::ROBOT_CHUCK, "option BSTR: empty"),
    (FunctionId::ROBOT_UNCHUCK, "option BSTR: empty"),
    (FunctionId::TASK_START, "mode I4: 1 one cycle, 2 continuous, 3 one line, 4 one line back; option BSTR: empty"),
    (FunctionId::TASK_STOP, "mode I4: 0 to 4; option BSTR: empty"),
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
        "name BSTR: @NAME, or a user variable whose index is below @VAR_..._LEN; option BSTR: @IfNotMember",
    ),
];

const OBJECT: &str = "name BSTR; option BSTR: @IfNotMember";

const FILE_NAME: &str = "name BSTR: a path of at most 32 parts without control characters and < > : \" | ? *; option \
                         BSTR: @Create=, @IfNotMember";

/// Returns whether a code means that an argument is refused.
pub(crate) fn is_of_argument(code: HResult) -> bool {
    CODES.contains(&code)
}

type RefusalCallback = dyn Fn(HResult, &str) + Send + Sync;

/// Receives the code and the reason of each refused argument; and under `S_OK` the faults that a
/// [lenient](crate::Config::lenient) controller has tolerated, such as unknown options.
#[derive(Clone, Default)]
pub struct Observer(Option<Arc<RefusalCallback>>);

impl Observer {
    /// Creates an observer of a function, which must not block.
    #[must_use]
    pub fn new(tell: impl Fn(HResult, &str) + Send + Sync + 'static) -> Self {
        Self(Some(Arc::new(tell)))
    }

    /// Reports a tolerated fault, under the code `S_OK`.
    pub(crate) fn tolerated(&self, text: &str) {
        if let Some(tell) = &self.0 {
            tell(HResult::S_OK, text);
        }
    }
}

impl fmt::Debug for Observer {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Observer")
    }
}

/// The reasons of the last refusals, by their codes.
#[derive(Clone, Debug, Default)]
pub(crate) struct Refusals {
    last: BTreeMap<u32, String>,
}

impl Refusals {
    /// Records the reason of a refusal, if the code is one of refused arguments. `accepted` names the accepted arguments
    /// where they depend on more than the function.
    pub(crate) fn record(
        &mut self,
        request: &Request<'_>,
        accepted: Option<&'static str>,
        code: HResult,
        observer: &Observer,
    ) {
        if !CODES.contains(&code) {
            return;
        }
        self.keep(explain(request, accepted), code, observer);
    }

    /// Records why the server has refused a request whose arguments do not fit its function.
    pub(crate) fn record_signature(&mut self, request: &Request<'_>, code: HResult, observer: &Observer) {
        if !CODES.contains(&code) {
            return;
        }
        match wrong_arguments(request) {
            Some(text) => self.keep(text, code, observer),
            // the reason of an earlier call does not apply to this one
            None => drop(self.last.remove(&code.to_u32())),
        }
    }

    fn keep(&mut self, text: String, code: HResult, observer: &Observer) {
        if let Some(tell) = &observer.0 {
            tell(code, &text);
        }
        self.last.insert(code.to_u32(), text);
    }

    /// Returns the reason of the last refusal with this code.
    pub(crate) fn last(&self, code: HResult) -> Option<&str> {
        self.last.get(&code.to_u32()).map(String::as_str)
    }
}

/// Names an unknown function, a number of arguments that differs, the first argument of another type than the function has,
/// or a wrong option of Service_Start.
fn wrong_arguments(request: &Request<'_>) -> Option<String> {
    let mut text = request.function.to_string();
    let Some(signature) = request.function.signature() else {
        text.push_str(": unknown; accepted the functions 1 to 137");
        return Some(text);
    };
    let (kinds, names) = (signature.arguments, request.function.argument_names());
    let wrong = (0..).zip(kinds.iter().zip(names)).find(|(n, (kind, _))| !kind.accepts(&request.value(*n)));
    if let (FunctionId::SERVICE_START, 0..=1, None) = (request.function, request.args.len(), wrong) {
        let error = StartOptions::read(request.args.get(0)).err()?;
        let _ = write!(text, ": given ");
        show(&mut text, &request.value(0), 0);
        let _ = write!(text, ": {error}");
    } else if request.args.len() != kinds.len() {
        let _ =
            write!(text, ": given {} arguments; accepted {}: {}", request.args.len(), kinds.len(), names.join(", "));
    } else {
        let (n, (kind, name)) = wrong?;
        let _ = write!(text, ": {name}: given ");
        show(&mut text, &request.value(n), 0);
        let _ = write!(text, "; accepted {}", accepted_type(*kind));
    }
    Some(text)
}

const fn accepted_type(kind: Kind) -> &'static str {
    match kind {
        Kind::Handle(_) => "the handle of an object: I4",
        Kind::Int => "I4, or another integer type whose value fits",
        Kind::Float => "R4, R8 or an integer",
        Kind::Text => "BSTR, or EMPTY",
        Kind::Any | Kind::Maybe | Kind::Nothing => "a known VARTYPE",
    }
}

/// Describes the actual and the accepted arguments of a call.
fn explain(request: &Request<'_>, accepted: Option<&'static str>) -> String {
    let mut text = request.function.to_string();
    let command = match (executes(request.function), request.value(1)) {
        (true, Variant::Bstr(command)) => Some(beginning(command.chars())),
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
    let of_function = || FUNCTIONS.iter().find(|(function, _)| *function == request.function).map(|(_, text)| *text);
    let accepted = if command.is_some() { accepted } else { accepted.or_else(of_function) };
    if let Some(accepted) = accepted {
        text.push_str("; accepted ");
        text.push_str(accepted);
    }
    text
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

/// Shows a value; cuts long parts.
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
