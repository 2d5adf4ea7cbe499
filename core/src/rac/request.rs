//! Requests: lines that read and write variables.
//!
//! ```text
//!  GET:RC8:10:I:                     read integer variable 10
//!  PUT:RC8:10:P:8196,1,2,3,4,5,6,-1  write position variable 10
//!
//!  request = blanks verb ":" part ":" index ":" kind ":" [ blanks value ] CR
//!  verb    = "GET" | "PUT"                         a GET has no value, a PUT has one
//!  part    = [ "RC8" ]                             the fixed name of the controller, which may be omitted
//!  index   = digits                                at most 32 bits
//!  kind    = "I" | "F" | "D" | "S" | "V" | "P" | "J" | "T" | "IO"
//! ```
//!
//! The RAC specification has the grammar in section 2.1.2, and the samples, where a GET ends with a colon, in section
//! 4.1. Words are read in any case and written in capitals. An invalid line is a [`TextError`] that names the part of
//! the line and the column.

use core::fmt;
use core::str::FromStr;

use nom::Parser;
use nom::bytes::complete::take_till;

use super::line::{CR, MAX_LINE};
use crate::error::{RequestPart, TextError, TextErrorKind};
use crate::variant::text::{Parsed, blanks, complete, fault, value, write_integer};
use crate::variant::{VarType, Variant, Writer};

/// A type of user variables.
///
/// ```text
///  I   IO     F   D   S     V             P             J             T
///  I4  BOOL   R4  R8  BSTR  3 R4: x y z   7 R4: x y z   8 R4: joints  10 R4: x y z, orient, approach
///                                         rx ry rz fig                vectors, fig
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum VariableKind {
    // from 1, so that `None` is 0 and a table of `None` needs no memory in the flash
    /// Integer.
    I = 1,
    /// Single-precision number.
    F,
    /// Double-precision number.
    D,
    /// String.
    S,
    /// Vector.
    V,
    /// Position: mm, degrees and figure.
    P,
    /// Joints: degrees or mm.
    J,
    /// Homogeneous transform and figure.
    T,
    /// Input or output.
    Io,
}

impl VariableKind {
    /// All of them, in the order of the specification.
    pub const ALL: [Self; 9] = [Self::I, Self::F, Self::D, Self::S, Self::V, Self::P, Self::J, Self::T, Self::Io];

    /// Returns its name in a line.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::I => "I",
            Self::F => "F",
            Self::D => "D",
            Self::S => "S",
            Self::V => "V",
            Self::P => "P",
            Self::J => "J",
            Self::T => "T",
            Self::Io => "IO",
        }
    }

    /// Returns the kind with this name, in any case.
    #[must_use]
    pub fn from_name(name: &str) -> Option<Self> {
        Self::from_word(name.as_bytes())
    }

    fn from_word(word: &[u8]) -> Option<Self> {
        Self::ALL.into_iter().find(|kind| is(word, kind.name()))
    }

    /// Returns the type of the variable's value.
    #[must_use]
    pub const fn vartype(self) -> VarType {
        match self {
            Self::I => VarType::I4,
            Self::F => VarType::R4,
            Self::D => VarType::R8,
            Self::S => VarType::BSTR,
            Self::V | Self::P | Self::J | Self::T => VarType::R4.array_of(),
            Self::Io => VarType::BOOL,
        }
    }

    /// Returns the number of elements of the variable's value; 1 for a scalar.
    #[must_use]
    pub const fn elements(self) -> usize {
        match self {
            Self::V => 3,
            Self::P => 7,
            Self::J => 8,
            Self::T => 10,
            _ => 1,
        }
    }

    /// Returns whether a value has exactly the type and number of elements of such a variable.
    #[must_use]
    pub fn fits(self, value: &Variant<'_>) -> bool {
        value.vartype() == self.vartype() && value.as_array().is_none_or(|array| array.len() == self.elements())
    }
}

impl fmt::Display for VariableKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// A user variable of the controller.
///
/// # Examples
///
/// ```
/// use bcap_core::rac::{Variable, VariableKind};
///
/// let door: Variable = "IO128".parse()?;
/// assert_eq!(door, Variable::new(VariableKind::Io, 128));
/// assert_eq!("p[5]".parse(), Ok(Variable::new(VariableKind::P, 5)));
/// assert_eq!("I1.5".parse::<Variable>().unwrap_err().column, 2);
/// # Ok::<(), bcap_core::error::TextError>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Variable {
    /// Its type.
    pub kind: VariableKind,
    /// Its number.
    pub index: u32,
}

impl Variable {
    /// Names a variable.
    #[must_use]
    pub const fn new(kind: VariableKind, index: u32) -> Self {
        Self { kind, index }
    }
}

/// Writes `I[10]`.
impl fmt::Display for Variable {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}[{}]", self.kind, self.index)
    }
}

/// Reads `I10` or `I[10]`, in any case and without blanks.
impl FromStr for Variable {
    type Err = TextError;

    fn from_str(name: &str) -> Result<Self, TextError> {
        let letters = name.bytes().take_while(u8::is_ascii_alphabetic).count();
        let (kind, number) = name.split_at_checked(letters).unwrap_or((name, ""));
        let kind = VariableKind::from_name(kind).ok_or(TextError { kind: TextErrorKind::VariableType, column: 1 })?;
        let number = number.strip_prefix('[').and_then(|rest| rest.strip_suffix(']')).unwrap_or(number);
        let column = u32::try_from(letters).unwrap_or(u32::MAX).saturating_add(1);
        let index = index(number.as_bytes()).ok_or(TextError { kind: TextErrorKind::Index, column })?;
        Ok(Self { kind, index })
    }
}

/// A request of a client.
///
/// # Examples
///
/// ```
/// use bcap_core::rac::{Request, Variable, VariableKind};
/// use bcap_core::variant::{Variant, Writer};
///
/// let mut memory = [0; 64];
/// let request = Request::parse(b"PUT:RC8:10:I: 3, 123", &mut memory)?;
/// assert_eq!(request, Request::Put(Variable::new(VariableKind::I, 10), Variant::I4(123)));
///
/// let mut line = [0; 256];
/// let mut out = Writer::new(&mut line);
/// request.write_line(&mut out)?;
/// assert_eq!(out.as_bytes(), b"PUT:RC8:10:I:3,123\r");
/// # Ok::<(), bcap_core::error::TextError>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Request<'a> {
    /// Read a variable.
    Get(Variable),
    /// Write a variable.
    Put(Variable, Variant<'a>),
}

impl<'a> Request<'a> {
    /// Returns the variable to read or write.
    #[must_use]
    pub const fn variable(&self) -> Variable {
        match self {
            Self::Get(variable) | Self::Put(variable, _) => *variable,
        }
    }

    /// Returns the first word of the line.
    #[must_use]
    pub const fn verb(&self) -> Verb {
        match self {
            Self::Get(_) => Verb::Get,
            Self::Put(..) => Verb::Put,
        }
    }

    /// Returns the value to write; `None` for a GET.
    #[must_use]
    pub const fn value(&self) -> Option<Variant<'a>> {
        match self {
            Self::Get(_) => None,
            Self::Put(_, value) => Some(*value),
        }
    }

    /// Parses a line without its CR; the encoded value of a PUT is stored in `memory`.
    ///
    /// 1024 bytes hold any value that fits a line; 64 bytes hold any value but long strings.
    ///
    /// # Errors
    ///
    /// A [`TextError`] with the column in the line; [`TextErrorKind::Full`] when the value does not fit `memory`.
    pub fn parse(line: &[u8], memory: &'a mut [u8]) -> Result<Self, TextError> {
        let mut out = Writer::new(memory);
        match complete(line, |line| read(line, &mut out))? {
            (Verb::Get, variable) => Ok(Self::Get(variable)),
            (Verb::Put, variable) => Ok(Self::Put(variable, Variant::from_checked(out.into_bytes()))),
        }
    }

    /// Appends the line with its CR.
    ///
    /// # Errors
    ///
    /// A [`TextError`] without a column if the value has no text, or if the line does not fit 256 bytes or the buffer; part
    /// of the line may have been written.
    pub fn write_line(&self, out: &mut Writer<'_>) -> Result<(), TextError> {
        let start = out.len();
        let Variable { kind, index } = self.variable();
        out.put_slice(if self.value().is_some() { b"PUT:RC8:" } else { b"GET:RC8:" })?;
        write_integer(u64::from(index), out)?;
        out.put_slice(b":")?;
        out.put_slice(kind.name().as_bytes())?;
        out.put_slice(b":")?;
        if let Some(value) = self.value() {
            value.write_text(out)?;
        }
        end_line(start, out)
    }
}

/// Appends the CR of a line that began at `start`.
pub(super) fn end_line(start: usize, out: &mut Writer<'_>) -> Result<(), TextError> {
    out.put_slice(&[CR])?;
    if out.len().wrapping_sub(start) > MAX_LINE { Err(TextError::printing(TextErrorKind::Full)) } else { Ok(()) }
}

/// The first word of a request.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Verb {
    // from 1 as well
    /// Read.
    Get = 1,
    /// Write.
    Put,
}

impl Verb {
    const fn name(self) -> &'static str {
        match self {
            Self::Get => "GET",
            Self::Put => "PUT",
        }
    }
}

/// Writes `GET` or `PUT`.
impl fmt::Display for Verb {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// `request = blanks verb ":" part ":" index ":" kind ":" [ blanks value ]`
pub(super) fn read<'a>(line: &'a [u8], out: &mut Writer<'_>) -> Parsed<'a, (Verb, Variable)> {
    let rest = blanks(line);
    let (rest, (verb, (), index, kind)) = (
        field(TextErrorKind::Verb, RequestPart::Verb, verb),
        field(TextErrorKind::PartName, RequestPart::PartName, part),
        field(TextErrorKind::Index, RequestPart::Index, index),
        field(TextErrorKind::VariableType, RequestPart::VariableType, VariableKind::from_word),
    )
        .parse_complete(rest)?;
    let rest = blanks(rest);
    let (rest, ()) = match (verb, rest) {
        (Verb::Get, []) => (rest, ()),
        (Verb::Get, _) => return fault(TextErrorKind::GetWithData, rest),
        (Verb::Put, []) => return fault(TextErrorKind::PutWithoutData, rest),
        (Verb::Put, _) => value(rest, out)?,
    };
    Ok((rest, (verb, Variable { kind, index })))
}

/// `word ":"`, `word = { byte - ":" }`; `read` interprets the word, and `kind` is the error if it is invalid
fn field<'a, T>(
    kind: TextErrorKind,
    part: RequestPart,
    read: impl Fn(&[u8]) -> Option<T>,
) -> impl FnMut(&'a [u8]) -> Parsed<'a, T> {
    move |text| {
        let (rest, word) = word(text)?;
        match (read(word), rest) {
            (None, _) => fault(kind, text),
            (Some(_), []) => fault(TextErrorKind::Colon(part), rest),
            (Some(meaning), [_, rest @ ..]) => Ok((rest, meaning)),
        }
    }
}

/// `verb = "GET" | "PUT"`, in any case
fn verb(word: &[u8]) -> Option<Verb> {
    [Verb::Get, Verb::Put].into_iter().find(|verb| is(word, verb.name()))
}

/// `part = [ "RC8" ]`, in any case
fn part(word: &[u8]) -> Option<()> {
    (word.is_empty() || is(word, "RC8")).then_some(())
}

/// Compares a word, ignoring ASCII case.
#[cfg_attr(target_os = "none", inline(never))]
fn is(word: &[u8], name: &str) -> bool {
    word.eq_ignore_ascii_case(name.as_bytes())
}

/// `index = digits`
fn index(word: &[u8]) -> Option<u32> {
    let digit = |b: &u8| b.is_ascii_digit().then_some(u32::from(b & 0x0f));
    let (first, rest) = word.split_first()?;
    rest.iter().try_fold(digit(first)?, |n, b| n.checked_mul(10)?.checked_add(digit(b)?))
}

/// The bytes up to the next colon.
#[cfg_attr(target_os = "none", inline(never))]
fn word(text: &[u8]) -> Parsed<'_, &[u8]> {
    take_till(|b| b == b':').parse_complete(text)
}
