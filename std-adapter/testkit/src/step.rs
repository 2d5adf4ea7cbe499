//! The steps of a client as a text that can be replayed: one step a line.
//!
//! ```text
//! # a line that begins with # is a comment
//! call Service_Start 08000100000000000000
//! call Robot_Execute @Robot "TakeArm" 8195,0,0
//! call Controller_GetName @Controller            the latest handle of a controller
//! call Variable_GetValue ~Variable               the handle of the variable that was released last
//! call Robot_GetName @Robot serial=65535 retry split=7
//! call 65536 joined                              sent together with the next call
//! call Controller_GetName @Controller again      over UDP: sent again after its reply, as a retransmission
//! bytes 01100000000100000002000000000004         as they are; the last step of its connection
//! line "GET:RC8:1:I:\r"                          a line of RAC
//! reconnect                                      closes the connection and opens another
//! ```
//!
//! An argument is a handle or a value: a text in quotes, type and data as in RAC (`8195,1,2`), or the hexadecimal digits of an
//! encoded VARIANT. Text after two blanks is a comment too. The cases of `bcap-conform` are written with the same words.

use std::fmt;
use std::str::FromStr;

use bcap_core::bcap::{FunctionId, Object};
use bcap_core::limits::{Limits, MAX_DEPTH, Strictness};

use crate::frame::TestFrame;
use crate::oracle::Oracle;
use crate::text;
use crate::value::Value;

/// The rules of a value in a step.
const VALUE: Oracle =
    Oracle { limits: Limits { depth: MAX_DEPTH, ..Limits::STREAM }, strictness: Strictness::Strict, crc: false };

/// The kinds of objects that have handles.
pub const OBJECTS: [Object; 8] = [
    Object::Controller,
    Object::Extension,
    Object::File,
    Object::Robot,
    Object::Task,
    Object::Variable,
    Object::Command,
    Object::Message,
];

/// A step of a client.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Step {
    /// A call, whose reply is awaited.
    Call(Call),
    /// Bytes that are sent as they are; the connection ends with them, because its state is unknown then.
    Bytes(Vec<u8>),
    /// Bytes that are sent to the port of RAC: a line with its CR, or several.
    Line(Vec<u8>),
    /// Closes the connection without the calls that end a session, and opens another.
    Reconnect,
}

/// A call with arguments that are filled in when it is sent.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Call {
    /// The number of the function; any number.
    pub function: i32,
    /// The arguments.
    pub arguments: Vec<Argument>,
    /// The serial number; `None` is the next serial.
    pub serial: Option<u16>,
    /// Whether the reserved field claims a retry: it contains the previous serial number.
    pub is_retry: bool,
    /// How the bytes are written.
    pub delivery: Delivery,
}

impl Call {
    /// A call of a function with the next serial number, written in one piece.
    #[must_use]
    pub const fn new(function: FunctionId, arguments: Vec<Argument>) -> Self {
        Self { function: function.0, arguments, serial: None, is_retry: false, delivery: Delivery::Whole }
    }

    /// Creates the frame; `handle` returns the handle of an argument that is a handle.
    #[must_use]
    pub fn to_frame(&self, next_serial: u16, handle: impl Fn(&Argument) -> i32) -> TestFrame {
        let serial = self.serial.unwrap_or(next_serial);
        let args = self.arguments.iter().map(|argument| match argument {
            Argument::Value(value) => value.clone(),
            other => Value::I4(handle(other)),
        });
        let reserved = if self.is_retry { serial.wrapping_sub(1) } else { 0 };
        TestFrame { serial, reserved, code: self.function, args: args.collect() }
    }
}

/// An argument of a call.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Argument {
    /// A value.
    Value(Value),
    /// The latest handle of this kind that the connection received and has not released; 0 without one.
    Handle(Object),
    /// The handle of this kind that the connection released last; 0 without one.
    Released(Object),
}

/// How the bytes of a call are written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Delivery {
    /// All in one write.
    Whole,
    /// This number of bytes first, then the rest; over UDP then the whole frame.
    Split(u8),
    /// Together with the next call; over UDP immediately.
    Joined,
    /// Over UDP, also sends a retransmission after the reply. Over TCP, the same as `Whole`.
    Again,
}

impl fmt::Display for Step {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Call(call) => call.fmt(f),
            Self::Bytes(bytes) => write!(f, "bytes {}", Hex(bytes)),
            Self::Line(bytes) => write!(f, "line \"{}\"", bytes.escape_ascii()),
            Self::Reconnect => f.write_str("reconnect"),
        }
    }
}

impl fmt::Display for Call {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let function = FunctionId(self.function);
        match function.name() {
            Some(_) => write!(f, "call {function}")?,
            None => write!(f, "call {}", self.function)?,
        }
        for argument in &self.arguments {
            match argument {
                Argument::Value(value) => write!(f, " {}", Hex(&value.to_wire()))?,
                Argument::Handle(object) => write!(f, " @{}", object.name())?,
                Argument::Released(object) => write!(f, " ~{}", object.name())?,
            }
        }
        if let Some(serial) = self.serial {
            write!(f, " serial={serial}")?;
        }
        if self.is_retry {
            f.write_str(" retry")?;
        }
        match self.delivery {
            Delivery::Whole => Ok(()),
            Delivery::Split(count) => write!(f, " split={count}"),
            Delivery::Joined => f.write_str(" joined"),
            Delivery::Again => f.write_str(" again"),
        }
    }
}

/// Writes bytes as hexadecimal digits.
struct Hex<'a>(&'a [u8]);

impl fmt::Display for Hex<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.iter().try_for_each(|byte| write!(f, "{byte:02x}"))
    }
}

/// Parses the steps of a text.
///
/// # Errors
///
/// The fault, with the number of the line.
pub fn parse(text: &str) -> Result<Vec<Step>, String> {
    let lines = (1..).zip(text.lines().map(str::trim)).filter(|(_, line)| !line.is_empty() && !line.starts_with('#'));
    lines.map(|(number, line)| line.parse().map_err(|error| format!("line {number}: {error}"))).collect()
}

impl FromStr for Step {
    type Err = String;

    fn from_str(line: &str) -> Result<Self, String> {
        let (verb, rest) = line.trim().split_once(' ').unwrap_or((line.trim(), ""));
        if verb == "line" {
            return unescape(rest).map(Self::Line);
        }
        let words = words(rest)?;
        match (verb, words.as_slice()) {
            ("call", [name, words @ ..]) => call(name, words).map(Self::Call),
            ("bytes", []) => Ok(Self::Bytes(Vec::new())),
            ("bytes", [digits]) => unhex(digits).map(Self::Bytes),
            ("reconnect", []) => Ok(Self::Reconnect),
            _ => Err(format!("{verb:?} is not a step; expected call, bytes, line or reconnect")),
        }
    }
}

/// Splits a step into words. A text in quotes is one word; two blanks outside of quotes begin a comment.
///
/// # Errors
///
/// When a text has no second quote.
pub fn words(text: &str) -> Result<Vec<&str>, String> {
    let (mut words, mut rest) = (Vec::new(), text);
    while !rest.is_empty() && !rest.starts_with("  ") {
        rest = rest.strip_prefix(' ').unwrap_or(rest);
        let length = match rest.strip_prefix('"') {
            Some(quoted) => 1 + end_of_text(quoted).ok_or("the text has no second quote")?,
            None => rest.find(' ').unwrap_or(rest.len()),
        };
        let (word, after) = rest.split_at(length);
        words.extend(Some(word).filter(|word| !word.is_empty()));
        rest = after;
    }
    Ok(words)
}

/// Returns the length of a text up to its second quote.
fn end_of_text(quoted: &str) -> Option<usize> {
    let mut is_escaped = false;
    let end = quoted.bytes().position(|byte| {
        let is_end = byte == b'"' && !is_escaped;
        is_escaped = byte == b'\\' && !is_escaped;
        is_end
    });
    end.map(|at| at + 1)
}

/// Parses the name or the number of a function.
///
/// # Errors
///
/// When it is neither.
pub fn function(name: &str) -> Result<FunctionId, String> {
    let number = || name.parse().map(FunctionId).map_err(|_| format!("{name:?} is not a function"));
    FunctionId::parse(name).map_or_else(number, Ok)
}

/// Parses a value: a text in quotes, the type and the data of RAC, or hexadecimal digits.
///
/// # Errors
///
/// An error for any other word.
pub fn value(word: &str) -> Result<Value, String> {
    if word.starts_with('"') {
        return unquote(word).map(|text| Value::text(&text));
    }
    let value = match word.contains(',') {
        true => text::parse(word.as_bytes()),
        false => VALUE.decode_value(&unhex(word)?),
    };
    value.ok_or_else(|| format!("{word:?} is not an encoded VARIANT"))
}

/// Reads a text in quotes.
///
/// # Errors
///
/// When an escape is unknown, or the text is not UTF-8.
pub fn unquote(word: &str) -> Result<String, String> {
    String::from_utf8(unescape(word)?).map_err(|_| format!("{word} is no UTF-8"))
}

fn call(name: &str, words: &[&str]) -> Result<Call, String> {
    let mut call = Call::new(function(name)?, Vec::new());
    let number =
        |word: &str, text: &str| text.parse::<u16>().map_err(|_| format!("{word:?}: {text:?} is not a number"));
    for &word in words {
        match word.split_once('=').filter(|_| !word.starts_with('"')) {
            Some(("serial", text)) => call.serial = Some(number(word, text)?),
            Some(("split", text)) => {
                let count = u8::try_from(number(word, text)?).map_err(|_| format!("{word:?}: at most 255"))?;
                call.delivery = Delivery::Split(count);
            }
            _ if word == "retry" => call.is_retry = true,
            _ if word == "joined" => call.delivery = Delivery::Joined,
            _ if word == "again" => call.delivery = Delivery::Again,
            _ => call.arguments.push(argument(word)?),
        }
    }
    Ok(call)
}

fn argument(word: &str) -> Result<Argument, String> {
    let object = |name: &str| {
        let found = OBJECTS.into_iter().find(|object| object.name() == name);
        found.ok_or_else(|| format!("{name:?} is not a kind of object with handles"))
    };
    if let Some(name) = word.strip_prefix('@') {
        return object(name).map(Argument::Handle);
    }
    if let Some(name) = word.strip_prefix('~') {
        return object(name).map(Argument::Released);
    }
    value(word).map(Argument::Value)
}

/// Parses pairs of hexadecimal digits.
///
/// # Errors
///
/// An error if the words are invalid.
pub fn unhex(text: &str) -> Result<Vec<u8>, String> {
    let digits = text.bytes().map(|byte| char::from(byte).to_digit(16)).collect::<Option<Vec<_>>>();
    match digits {
        Some(digits) if digits.len() % 2 == 0 => {
            Ok(digits.chunks_exact(2).map(|pair| (pair[0] << 4 | pair[1]) as u8).collect())
        }
        _ => Err(format!("{text:?} are not pairs of hexadecimal digits")),
    }
}

/// Reads a quoted text with the escapes of [`u8::escape_ascii`].
fn unescape(text: &str) -> Result<Vec<u8>, String> {
    let text = text.trim().strip_prefix('"').ok_or("line needs a text in quotes")?;
    let (mut bytes, mut rest) = (Vec::new(), text.as_bytes());
    loop {
        (bytes, rest) = match rest {
            [] => return Err("the text has no second quote".into()),
            [b'"', ..] => return Ok(bytes),
            [b'\\', b'x', digits @ ..] if digits.len() >= 2 => {
                bytes.extend(unhex(&String::from_utf8_lossy(&digits[..2]))?);
                (bytes, &digits[2..])
            }
            [b'\\', letter, rest @ ..] => {
                bytes.push(match letter {
                    b't' => b'\t',
                    b'r' => b'\r',
                    b'n' => b'\n',
                    b'\\' | b'"' | b'\'' => *letter,
                    _ => return Err(format!("\\{} is not an escape", char::from(*letter))),
                });
                (bytes, rest)
            }
            [byte, rest @ ..] => {
                bytes.push(*byte);
                (bytes, rest)
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_text_of_a_step_is_parsed_to_the_same_step() {
        let arguments = vec![
            Argument::Handle(Object::Robot),
            Argument::Released(Object::Variable),
            Argument::Value(Value::text("a \"#\"")),
        ];
        let named = Call::new(FunctionId::ROBOT_GET_NAME, arguments);
        let strange =
            Call { function: -5, serial: Some(0), is_retry: true, delivery: Delivery::Split(7), ..named.clone() };
        let joined = Call { delivery: Delivery::Joined, ..Call::new(FunctionId(65_536), vec![]) };
        let line = (0..=255).collect::<Vec<u8>>();
        let again = Call { delivery: Delivery::Again, ..named.clone() };
        let steps = [named, strange, joined, again].map(Step::Call).into_iter();
        let bytes = [line.clone(), vec![]].map(Step::Bytes);
        let steps = steps.chain(bytes).chain([Step::Line(line), Step::Reconnect]).collect::<Vec<_>>();
        let text: String = steps.iter().map(|step| format!("{step}\n# a comment\n\n")).collect();
        assert_eq!(parse(&text), Ok(steps));
    }

    #[test]
    fn the_steps_of_the_documentation_are_steps() {
        let text: String = include_str!("step.rs")
            .lines()
            .skip_while(|line| !line.contains("```text"))
            .skip(1)
            .take_while(|line| !line.contains("```"))
            .map(|line| format!("{}\n", line.trim_start_matches("//!")))
            .collect();
        assert_eq!(parse(&text).map(|steps| steps.len()), Ok(10), "{text}");
    }

    #[test]
    fn an_error_names_the_line() {
        for (text, error) in [
            ("\nmove", "line 2: \"move\" is not a step; expected call, bytes, line or reconnect"),
            ("call Fly", "line 1: \"Fly\" is not a function"),
            ("call 1 @Arm", "line 1: \"Arm\" is not a kind of object with handles"),
            ("call 1 0800", "line 1: \"0800\" is not an encoded VARIANT"),
            ("bytes 012", "line 1: \"012\" are not pairs of hexadecimal digits"),
            ("line \"GET", "line 1: the text has no second quote"),
        ] {
            assert_eq!(parse(text).unwrap_err(), error);
        }
    }
}
