//! Judges replies of a server by the protocol alone: form, serial number, HRESULT, and the type of the value.

use std::fmt;

use bcap_core::bcap::{FunctionId, Kind, Object};
use bcap_core::hresult::HResult;
use bcap_core::limits::{Limits, Strictness};
use bcap_core::rac::{Request, Variable, VariableKind};

use crate::frame::TestFrame;
use crate::oracle::{Oracle, Verdict};
use crate::text;
use crate::value::Value;

/// The strict rules of TCP.
pub const TCP: Oracle = Oracle { limits: Limits::STREAM, strictness: Strictness::Strict, crc: false };

/// The fault of a reply.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Fault {
    /// The bytes are not a frame, or not a response of RAC.
    Malformed,
    /// The reply has the serial number of another request: first the serial of the request, then the serial of the reply.
    Serial(u16, u16),
    /// A reply has at most one value; this is the number of values.
    Count(usize),
    /// A successful reply has no value, or not the required kind of value.
    Type {
        /// The kind, in words.
        expected: &'static str,
        /// The value.
        value: Option<Value>,
    },
    /// A function that does not exist was executed.
    Unknown(i32),
    /// A function was executed although this number of arguments was missing.
    Missing(usize),
}

impl fmt::Display for Fault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Malformed => f.write_str("the reply is malformed"),
            Self::Serial(request, reply) => write!(f, "the reply has serial {reply}, the request {request}"),
            Self::Count(count) => write!(f, "the reply has {count} values"),
            Self::Type { expected, value: Some(value) } => {
                write!(f, "the reply has a value of VARTYPE {}, expected {expected}", value.vartype())
            }
            Self::Type { expected, value: None } => write!(f, "the reply has no value, expected {expected}"),
            Self::Unknown(code) => write!(f, "the unknown function {code} succeeds"),
            Self::Missing(count) => write!(f, "the call succeeds with {count} arguments too few"),
        }
    }
}

/// Judges the reply to a request; the reply has exactly the bytes of one frame. An S_EXECUTING is a correct reply too.
///
/// # Errors
///
/// The [`Fault`].
pub fn reply(request: &TestFrame, bytes: &[u8]) -> Result<TestFrame, Fault> {
    let reply = match TCP.decode(bytes) {
        Verdict::Frame(frame, length) if length == bytes.len() => frame,
        _ => return Err(Fault::Malformed),
    };
    if reply.serial != request.serial {
        return Err(Fault::Serial(request.serial, reply.serial));
    }
    let code = HResult(reply.code);
    if code == HResult::S_EXECUTING || code.is_err() {
        return if reply.args.len() > 1 { Err(Fault::Count(reply.args.len())) } else { Ok(reply) };
    }
    let function = FunctionId(request.code);
    let Some(signature) = function.signature() else { return Err(Fault::Unknown(request.code)) };
    // Service_Start may omit its argument
    let least = if function == FunctionId::SERVICE_START { 0 } else { signature.arguments.len() };
    if request.args.len() < least {
        return Err(Fault::Missing(least - request.args.len()));
    }
    if reply.args.len() > 1 {
        return Err(Fault::Count(reply.args.len()));
    }
    let value = reply.args.first();
    // another success, such as S_FALSE, may have no value
    if code != HResult::S_OK {
        return Ok(reply);
    }
    if value.map_or(matches!(signature.result, Kind::Nothing | Kind::Maybe), |value| has_kind(value, signature.result))
    {
        return Ok(reply);
    }
    Err(Fault::Type { expected: noun(signature.result), value: value.cloned() })
}

/// Returns whether a value is of a kind of the function table.
#[must_use]
pub fn has_kind(value: &Value, kind: Kind) -> bool {
    let is_integer =
        matches!(value, Value::I2(_) | Value::I4(_) | Value::Ui1(_) | Value::Ui2(_) | Value::Ui4(_) | Value::Bool(_));
    match kind {
        Kind::Handle(Object::Service) | Kind::Any | Kind::Maybe | Kind::Nothing => true,
        Kind::Handle(_) => matches!(value, Value::I4(_) | Value::Ui4(_)),
        Kind::Int => is_integer || matches!(value, Value::I8(_) | Value::Ui8(_)),
        Kind::Float => is_integer || matches!(value, Value::R4(_) | Value::R8(_)),
        Kind::Text => matches!(value, Value::Bstr(_) | Value::Empty | Value::Null),
    }
}

const fn noun(kind: Kind) -> &'static str {
    match kind {
        Kind::Handle(_) => "a handle",
        Kind::Int => "an integer",
        Kind::Float => "a number",
        Kind::Text => "a string",
        Kind::Any | Kind::Maybe | Kind::Nothing => "a value",
    }
}

/// Returns whether a value has a type of this RAC variable (RAC specification, sections 3.2 to 4.1).
fn fits(value: &Value, kind: VariableKind) -> bool {
    match (kind.name(), value) {
        ("I", Value::I4(_)) | ("F", Value::R4(_)) | ("D", Value::R8(_)) | ("S", Value::Bstr(_)) => true,
        ("IO", Value::Bool(_)) => true,
        ("V", Value::Array(4, items)) => items.len() == 3,
        ("P", Value::Array(4, items)) => items.len() == 7,
        ("J", Value::Array(4, items)) => items.len() == 8,
        ("T", Value::Array(4, items)) => items.len() == 10,
        _ => false,
    }
}

/// Judges the response of RAC to a line; both without CR. A successful GET must return a value of the variable's type.
///
/// # Errors
///
/// The [`Fault`].
pub fn response(line: &[u8], response: &[u8]) -> Result<HResult, Fault> {
    let (code, value) = text::response(response).ok_or(Fault::Malformed)?;
    let mut memory = [0; 1024];
    if let (true, Ok(Request::Get(Variable { kind, .. }))) = (HResult(code).is_ok(), Request::parse(line, &mut memory))
        && !value.as_ref().is_some_and(|value| fits(value, kind))
    {
        return Err(Fault::Type { expected: "a value of the variable's type", value });
    }
    Ok(HResult(code))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn request(function: FunctionId, args: Vec<Value>) -> TestFrame {
        TestFrame { serial: 7, reserved: 0, code: function.0, args }
    }

    fn judged(request: &TestFrame, serial: u16, code: i32, args: Vec<Value>) -> Result<i32, Fault> {
        let wire = TestFrame { serial, reserved: 0, code, args }.to_wire(false);
        reply(request, &wire).map(|reply| reply.code)
    }

    #[test]
    fn a_reply_is_judged_by_the_function_table() {
        let name = request(FunctionId::ROBOT_GET_NAME, vec![Value::I4(1)]);
        assert_eq!(judged(&name, 7, 0, vec![Value::text("Arm")]), Ok(0));
        assert_eq!(judged(&name, 8, 0, vec![Value::text("Arm")]), Err(Fault::Serial(7, 8)));
        let wrong = Fault::Type { expected: "a string", value: Some(Value::I4(5)) };
        assert_eq!(judged(&name, 7, 0, vec![Value::I4(5)]), Err(wrong));
        assert_eq!(judged(&name, 7, 0, vec![]), Err(Fault::Type { expected: "a string", value: None }));
        assert_eq!(judged(&name, 7, HResult::E_HANDLE.0, vec![]), Ok(HResult::E_HANDLE.0));
        assert_eq!(judged(&name, 7, HResult::S_FALSE.0, vec![Value::Empty]), Ok(HResult::S_FALSE.0));
        assert_eq!(judged(&name, 7, HResult::S_EXECUTING.0, vec![]), Ok(HResult::S_EXECUTING.0));
        assert_eq!(judged(&name, 7, 0, vec![Value::text(""), Value::Empty]), Err(Fault::Count(2)));
        let none = request(FunctionId::ROBOT_GET_NAME, vec![]);
        assert_eq!(judged(&none, 7, 0, vec![Value::text("Arm")]), Err(Fault::Missing(1)));
        assert_eq!(judged(&request(FunctionId(999), vec![]), 7, 0, vec![]), Err(Fault::Unknown(999)));
        assert_eq!(judged(&request(FunctionId::SERVICE_START, vec![]), 7, 0, vec![]), Ok(0));
    }

    #[test]
    fn bytes_that_are_not_exactly_a_frame_are_malformed() {
        let start = request(FunctionId::SERVICE_START, vec![]);
        let wire = TestFrame { serial: 7, reserved: 0, code: 0, args: vec![] }.to_wire(false);
        assert!(reply(&start, &wire).is_ok());
        assert_eq!(reply(&start, &wire[..15]), Err(Fault::Malformed));
        assert_eq!(reply(&start, &[&wire[..], &[0]].concat()), Err(Fault::Malformed));
    }

    #[test]
    fn a_response_is_judged_by_the_type_of_the_variable() {
        assert_eq!(response(b"GET:RC8:1:I:", b"0,3,5"), Ok(HResult::S_OK));
        assert_eq!(response(b"GET:RC8:1:I:", b"-2147024809"), Ok(HResult::E_INVALIDARG));
        assert!(matches!(response(b"GET:RC8:1:I:", b"0,8,five"), Err(Fault::Type { .. })));
        assert!(matches!(response(b"GET:RC8:1:I:", b"0"), Err(Fault::Type { .. })));
        assert_eq!(response(b"GET:RC8:1:I:", b"OK"), Err(Fault::Malformed));
        assert_eq!(response(b"PUT:RC8:1:I:3,5", b"0"), Ok(HResult::S_OK));
    }
}
