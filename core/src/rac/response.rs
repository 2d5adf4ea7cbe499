//! Responses: the replies of a server.
//!
//! ```text
//!  0                   done
//!  0,3,123             done, and the value is I4 123
//!  -2147024809         refused: 0x80070057, E_INVALIDARG
//!
//!  response = blanks result [ "," value ] CR
//!  result   = integer                   an HRESULT: signed or unsigned decimal, or 0x and hex digits
//! ```
//!
//! The samples of the specification show no result but `0`. Every form of a 32-bit code is read; signed decimal is
//! written, the "integral value of the HRESULT type" (RAC specification, section 2.1.3).

use nom::combinator::map_opt;

use super::request::end_line;
use crate::error::{TextError, TextErrorKind};
use crate::hresult::HResult;
use crate::variant::text::{Integer, Parsed, blanks, complete, expect, fault, integer, put_integer, value};
use crate::variant::{Variant, Writer};

/// A reply of a server.
///
/// # Examples
///
/// ```
/// use bcap_core::hresult::HResult;
/// use bcap_core::rac::Response;
/// use bcap_core::variant::Variant;
///
/// let mut memory = [0; 64];
/// let response = Response::parse(b"0, 3, 123", &mut memory)?;
/// assert_eq!(response, Response { result: HResult::S_OK, value: Some(Variant::I4(123)) });
/// # Ok::<(), bcap_core::error::TextError>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Response<'a> {
    /// The result of the request.
    pub result: HResult,
    /// The value of a variable that was read.
    pub value: Option<Variant<'a>>,
}

impl<'a> Response<'a> {
    /// Parses a line without its CR; its encoded value is stored in `memory`.
    ///
    /// # Errors
    ///
    /// A [`TextError`] with the column in the line; [`TextErrorKind::Full`] when the value does not fit `memory`.
    pub fn parse(line: &[u8], memory: &'a mut [u8]) -> Result<Self, TextError> {
        let mut out = Writer::new(memory);
        let result = complete(line, |line| read(line, &mut out))?;
        let bytes = out.into_bytes();
        Ok(Self { result, value: (!bytes.is_empty()).then(|| Variant::from_checked(bytes)) })
    }

    /// Appends the line with its CR.
    ///
    /// # Errors
    ///
    /// A [`TextError`] without a column if the value has no text, or if the line does not fit 256 bytes or the buffer; part
    /// of the line may have been written.
    pub fn write_line(&self, out: &mut Writer<'_>) -> Result<(), TextError> {
        let start = out.len();
        put_integer(self.result.is_err(), u64::from(self.result.0.unsigned_abs()), out).map_err(TextError::printing)?;
        if let Some(value) = self.value {
            out.put_slice(b",")?;
            value.write_text(out)?;
        }
        end_line(start, out)
    }
}

/// `response = blanks result [ "," value ]`
pub(super) fn read<'a>(line: &'a [u8], out: &mut Writer<'_>) -> Parsed<'a, HResult> {
    let (rest, result) = result(blanks(line))?;
    let (rest, ()) = match rest {
        [] => (rest, ()),
        [b',', text @ ..] => value(text, out)?,
        _ => return fault(TextErrorKind::ResultCode, rest),
    };
    Ok((rest, result))
}

/// `result = integer`
fn result(text: &[u8]) -> Parsed<'_, HResult> {
    let code = |number: Integer| number.to_code(true).map(HResult);
    expect(TextErrorKind::ResultCode, map_opt(integer, code))(text)
}
