//! Values: one structure for the arguments that C passes, and for the values that it receives.
//!
//! ```text
//!  form         data        points to
//!  SCALAR       integer     or `number`, by the type; text is never a scalar here
//!  TEXT         pointer     `size` bytes of UTF-8
//!  ARRAY        pointer     `count` elements of C, which are the wire's, in `size` bytes
//!  LIST         pointer     `count` structures of this type: an array of VARIANT
//!  WIRE_TEXT    pointer     `size` bytes of UTF-16 in a received frame
//!  WIRE_ARRAY   pointer     `size` bytes of a received frame: a whole value with its type and count
//! ```
//!
//! A received value is validated again at each use, because the caller owns its memory and may have changed it.

use core::ffi::{c_char, c_void};

use bcap_core::error::EncodeError;
use bcap_core::hresult::HResult;
use bcap_core::limits::{Limits, Strictness};
use bcap_core::variant::{Bstr, ConvertError, Currency, Encode, FromVariant, OleDate, VarType, Variant, Writer};

use crate::entry::guard;
use crate::memory::{TextBuffer, caller, get, put, read_text, slice};
use crate::status::*;

const SCALAR: u16 = 0;
const TEXT: u16 = 1;
const ARRAY: u16 = 2;
const LIST: u16 = 3;
const WIRE_TEXT: u16 = 4;
const WIRE_ARRAY: u16 = 5;

/// The bytes of type and count before the data of a value.
const HEAD: usize = 6;

/// The content of a value.
#[repr(C)]
#[derive(Clone, Copy)]
pub union bcap_data {
    /// Integers, truth values, codes, and currency in ten-thousandths. Unsigned numbers of 64 bits have the same bits.
    pub integer: i64,
    /// R4, R8 and DATE.
    pub number: f64,
    /// Text and arrays.
    pub pointer: *const c_void,
}

/// A value (VARIANT) of a call or of a reply. `type`, `count` and for numbers `data` can be read; functions make it and read the rest.
///
/// It points to the memory of its text or array, which must not change while the value is used. A value of a reply points into the
/// buffer that received it.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct bcap_value {
    /// The VARTYPE, such as `BCAP_I4`, or `BCAP_ARRAY | BCAP_R8`.
    pub r#type: u16,
    /// Private.
    pub form: u16,
    /// The number of elements of an array; otherwise 1.
    pub count: u32,
    /// Private.
    pub size: usize,
    /// The content.
    pub data: bcap_data,
}

impl bcap_value {
    pub(crate) const EMPTY: Self = Self::scalar(VarType::EMPTY, bcap_data { integer: 0 });

    const fn scalar(vartype: VarType, data: bcap_data) -> Self {
        Self { r#type: vartype.0, form: SCALAR, count: 1, size: 0, data }
    }

    fn text(form: u16, bytes: &[u8]) -> Self {
        let data = bcap_data { pointer: bytes.as_ptr().cast() };
        Self { r#type: VarType::BSTR.0, form, count: 1, size: bytes.len(), data }
    }

    /// Views a received value, whose encoding is somewhere in the `size` bytes at `memory`.
    pub(crate) fn received(value: Variant<'_>, memory: *const u8, size: usize) -> Result<Self, Status> {
        let value = value.flatten();
        let integer = |integer: i64| bcap_data { integer };
        let data = match value {
            Variant::Bstr(text) => return Ok(Self::text(WIRE_TEXT, text.as_bytes())),
            Variant::Array(array) => {
                let data = array.as_bytes();
                let head = data.as_ptr().addr().checked_sub(memory.addr()).and_then(|start| start.checked_sub(HEAD));
                let (Some(head), whole) = (head, data.len().wrapping_add(HEAD)) else { return Err(BCAP_E_VALUE) };
                if head.saturating_add(whole) > size {
                    return Err(BCAP_E_VALUE);
                }
                let count = u32::try_from(array.len()).map_err(|_| BCAP_E_RANGE)?;
                let data = bcap_data { pointer: memory.wrapping_add(head).cast() };
                return Ok(Self { r#type: value.vartype().0, form: WIRE_ARRAY, count, size: whole, data });
            }
            Variant::R4(number) => bcap_data { number: number.into() },
            Variant::R8(number) => bcap_data { number },
            Variant::Date(date) => bcap_data { number: date.raw() },
            Variant::Cy(amount) => integer(amount.raw()),
            Variant::Error(code) => integer(code.0.into()),
            Variant::Bool(truth) => integer(truth.into()),
            Variant::Ui8(bits) => integer(bits.cast_signed()),
            Variant::Empty | Variant::Null => integer(0),
            other => integer(other.as_i64().ok_or(BCAP_E_TYPE)?),
        };
        Ok(Self::scalar(value.vartype(), data))
    }

    fn integer(&self) -> i64 {
        // SAFETY: all bits are an integer, and every constructor and C initialise them
        unsafe { self.data.integer }
    }

    fn number(&self) -> f64 {
        f64::from_bits(self.integer().cast_unsigned())
    }

    /// Returns the `size` bytes of a text or an array, or the `count` values of a list.
    fn content<T>(&self, len: usize) -> Result<&[T], Status> {
        // SAFETY: C initialises the whole union: all forms with a pointer come from a function that stored it
        let pointer: *const T = unsafe { self.data.pointer }.cast();
        caller!(slice(pointer, len))
    }

    fn vartype(&self) -> VarType {
        VarType(self.r#type)
    }

    /// Returns the value as the core's, unless it is text or an array of C.
    fn variant(&self) -> Result<Variant<'_>, Status> {
        match self.form {
            SCALAR => scalar(self.vartype(), self.integer(), self.number()),
            WIRE_TEXT => Bstr::from_utf16le(self.content(self.size)?).map(Variant::Bstr).ok_or(BCAP_E_VALUE),
            WIRE_ARRAY => decode(self.content(self.size)?),
            _ => Err(BCAP_E_VALUE),
        }
    }

    /// Converts the value to a number, without loss.
    pub(crate) fn convert<'a, T: FromVariant<'a>>(&'a self) -> Result<T, Status> {
        self.variant()?.convert().map_err(convert)
    }

    fn encode_at(&self, depth: u8, out: &mut Writer<'_>) -> Result<(), EncodeError> {
        let unsendable = |_| EncodeError::Unsendable(self.r#type);
        if matches!(self.form, ARRAY | LIST) {
            out.put(self.r#type.to_le_bytes())?;
            out.put(self.count.to_le_bytes())?;
        }
        match self.form {
            TEXT => {
                let bytes = self.content(self.size);
                let text = bytes.and_then(|bytes| core::str::from_utf8(bytes).map_err(|_| BCAP_E_TEXT));
                text.map_err(unsendable)?.encode(out)
            }
            ARRAY => out.put_slice(self.content(self.size).map_err(unsendable)?),
            LIST => {
                let depth = depth.checked_sub(1).ok_or(EncodeError::TooDeep)?;
                let values: &[Self] = self.content(self.count as usize).map_err(unsendable)?;
                values.iter().try_for_each(|value| value.encode_at(depth, out))
            }
            _ => self.variant().map_err(unsendable)?.encode(out),
        }
    }

    /// Writes text to a buffer of C.
    pub(crate) fn write_text(&self, buffer: *mut c_char, size: usize) -> Result<(), Status> {
        let Variant::Bstr(text) = self.variant()? else { return Err(BCAP_E_TYPE) };
        let mut out = caller!(TextBuffer::new(buffer, size));
        for character in text.chars() {
            out.push(character.map_err(|_| BCAP_E_TEXT)?.encode_utf8(&mut [0; 4]));
        }
        out.finish_whole()
    }

    /// Copies numbers to a buffer of C, and returns their number.
    pub(crate) fn write_numbers(&self, buffer: *mut f64, capacity: usize) -> Result<usize, Status> {
        let Variant::Array(array) = self.variant()? else { return Err(BCAP_E_TYPE) };
        if array.len() > capacity {
            return Err(BCAP_E_SHORT);
        }
        for (index, element) in array.iter().enumerate() {
            let number: f64 = element.convert().map_err(convert)?;
            caller!(put(buffer.wrapping_add(index), number))?;
        }
        Ok(array.len())
    }
}

/// Validates bytes of the caller.
pub(crate) fn decode(bytes: &[u8]) -> Result<Variant<'_>, Status> {
    Variant::decode(bytes, &Limits::STREAM, Strictness::Strict).map_err(|_| BCAP_E_VALUE)
}

/// An integer, or a truth value as one.
pub(crate) struct Integer(pub(crate) i64);

impl FromVariant<'_> for Integer {
    fn from_variant(value: Variant<'_>) -> Result<Self, ConvertError> {
        if let Variant::Bool(truth) = value { Ok(Self(truth.into())) } else { value.convert().map(Self) }
    }
}

/// Creates a scalar of the core.
fn scalar<'a>(vartype: VarType, integer: i64, number: f64) -> Result<Variant<'a>, Status> {
    fn small<T: TryFrom<i64>>(integer: i64) -> Result<T, Status> {
        T::try_from(integer).map_err(|_| BCAP_E_RANGE)
    }
    Ok(match vartype {
        VarType::EMPTY => Variant::Empty,
        VarType::NULL => Variant::Null,
        VarType::I2 => Variant::I2(small(integer)?),
        VarType::I4 => Variant::I4(small(integer)?),
        VarType::I8 => Variant::I8(integer),
        VarType::UI1 => Variant::Ui1(small(integer)?),
        VarType::UI2 => Variant::Ui2(small(integer)?),
        VarType::UI4 => Variant::Ui4(small(integer)?),
        VarType::UI8 => Variant::Ui8(integer.cast_unsigned()),
        VarType::BOOL => Variant::Bool(integer != 0),
        VarType::CY => Variant::Cy(Currency::from_raw(integer)),
        VarType::ERROR => Variant::Error(HResult(small(integer)?)),
        VarType::R4 => Variant::R4(number as f32),
        VarType::R8 => Variant::R8(number),
        VarType::DATE => Variant::Date(OleDate::from_raw(number)),
        _ => return Err(BCAP_E_VALUE),
    })
}

impl Encode for bcap_value {
    fn encode(&self, out: &mut Writer<'_>) -> Result<(), EncodeError> {
        self.encode_at(bcap_core::limits::MAX_DEPTH, out)
    }
}

/// Makes EMPTY, the value of a call without one.
#[unsafe(no_mangle)]
pub extern "C" fn bcap_empty() -> bcap_value {
    bcap_value::EMPTY
}

/// Creates an integer, a truth value, a code or a currency amount of any scalar type, such as `BCAP_UI2`. An integer out of
/// range of its type is refused when it is sent. For `BCAP_R4`, `BCAP_R8` and `BCAP_DATE` it is converted to the nearest
/// number.
#[unsafe(no_mangle)]
pub extern "C" fn bcap_integer(r#type: u16, integer: i64) -> bcap_value {
    let vartype = VarType(r#type);
    let data = match vartype {
        VarType::R4 | VarType::R8 | VarType::DATE => bcap_data { number: integer as f64 },
        _ => bcap_data { integer },
    };
    bcap_value::scalar(vartype, data)
}

/// Creates an I4: handles, I variables, modes.
#[unsafe(no_mangle)]
pub extern "C" fn bcap_i4(integer: i32) -> bcap_value {
    bcap_value::scalar(VarType::I4, bcap_data { integer: integer.into() })
}

/// Creates a BOOL: IO variables.
#[unsafe(no_mangle)]
pub extern "C" fn bcap_bool(truth: bool) -> bcap_value {
    bcap_value::scalar(VarType::BOOL, bcap_data { integer: truth.into() })
}

/// Creates an R4: F variables, speeds.
#[unsafe(no_mangle)]
pub extern "C" fn bcap_r4(number: f32) -> bcap_value {
    bcap_value::scalar(VarType::R4, bcap_data { number: number.into() })
}

/// Creates an R8: D variables.
#[unsafe(no_mangle)]
pub extern "C" fn bcap_r8(number: f64) -> bcap_value {
    bcap_value::scalar(VarType::R8, bcap_data { number })
}

/// Creates a text of UTF-8 that ends with NUL: names, options, S variables. Null creates a value that is refused.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn bcap_text(text: *const c_char) -> bcap_value {
    match caller!(read_text(text)) {
        Ok(text) => bcap_value::text(TEXT, text.as_bytes()),
        Err(_) => bcap_value::scalar(VarType::BSTR, bcap_data { integer: 0 }),
    }
}

/// Creates an array of numbers, such as `BCAP_R4` from `float` and `BCAP_I4` from `int32_t`. A BOOL is an `int16_t`, 0 or -1.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn bcap_array(r#type: u16, elements: *const c_void, count: usize) -> bcap_value {
    let vartype = VarType(r#type);
    let width = vartype.element_bytes().filter(|width| *width > 0 && !vartype.is_array()).map(usize::from);
    let (Some(size), Ok(count)) = (width.and_then(|width| count.checked_mul(width)), u32::try_from(count)) else {
        return bcap_value::scalar(vartype.array_of(), bcap_data { integer: 0 });
    };
    bcap_value { r#type: vartype.array_of().0, form: ARRAY, count, size, data: bcap_data { pointer: elements } }
}

/// Creates an array of values of any types (VARIANT), such as the pose of Robot_Move.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn bcap_list(values: *const bcap_value, count: usize) -> bcap_value {
    let vartype = VarType::VARIANT.array_of();
    let data = bcap_data { pointer: values.cast() };
    match u32::try_from(count) {
        Ok(count) => bcap_value { r#type: vartype.0, form: LIST, count, size: 0, data },
        Err(_) => bcap_value::scalar(vartype, bcap_data { integer: 0 }),
    }
}

/// Reads a value as an integer: any number that has no fraction, or a truth value.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn bcap_value_integer(value: *const bcap_value, integer: *mut i64) -> bcap_status {
    guard(|| {
        let Integer(found) = caller!(get(value))?.convert()?;
        caller!(put(integer, found))
    })
}

/// Reads a value as a number: any number that a double holds without loss.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn bcap_value_number(value: *const bcap_value, number: *mut f64) -> bcap_status {
    guard(|| {
        let found = caller!(get(value))?.convert()?;
        caller!(put(number, found))
    })
}

/// Reads a text as UTF-8 into `buffer`, with NUL. Text that does not fit is cut, and the result is `BCAP_E_SHORT`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn bcap_value_text(value: *const bcap_value, buffer: *mut c_char, size: usize) -> bcap_status {
    guard(|| caller!(get(value))?.write_text(buffer, size))
}

/// Reads an array of numbers into `numbers`, which has room for `capacity` of them. `count` gets their number; it may be null.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn bcap_value_numbers(
    value: *const bcap_value,
    numbers: *mut f64,
    capacity: usize,
    count: *mut usize,
) -> bcap_status {
    guard(|| {
        let written = caller!(get(value))?.write_numbers(numbers, capacity)?;
        if count.is_null() { Ok(()) } else { caller!(put(count, written)) }
    })
}

/// Reads an element of a received array of any type; the first has the index 0. It points into the same memory.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn bcap_value_element(
    value: *const bcap_value,
    index: usize,
    element: *mut bcap_value,
) -> bcap_status {
    guard(|| {
        let value = caller!(get(value))?;
        let Variant::Array(array) = value.variant()? else { return Err(BCAP_E_TYPE) };
        let found = array.get(index).ok_or(BCAP_E_RANGE)?;
        let bytes: &[u8] = value.content(value.size)?;
        let found = bcap_value::received(found, bytes.as_ptr(), bytes.len())?;
        caller!(put(element, found))
    })
}
