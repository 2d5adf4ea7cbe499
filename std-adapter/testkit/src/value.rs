//! An owned VARIANT for tests: a tree on the heap, with an encoder that shares no code with the core.

use bcap_core::error::EncodeError;
use bcap_core::hresult::HResult;
use bcap_core::limits::{Limits, MAX_DEPTH, Strictness};
use bcap_core::variant::{Bstr, Currency, Encode, Null, OleDate, Variant, Writer};

/// A value. Floats are stored as bits, so that values are equal if their bytes are equal.
#[derive(Clone, Debug, PartialEq, Eq)]
#[expect(missing_docs, reason = "the variants are the VARTYPEs")]
pub enum Value {
    Empty,
    Null,
    I2(i16),
    I4(i32),
    /// Bits of an `f32`.
    R4(u32),
    /// Bits of an `f64`.
    R8(u64),
    Cy(i64),
    /// Bits of an `f64`.
    Date(u64),
    /// 16-bit units, including any surrogates and NULs.
    Bstr(Vec<u16>),
    Error(i32),
    Bool(bool),
    Ui1(u8),
    Ui2(u16),
    Ui4(u32),
    I8(i64),
    Ui8(u64),
    /// A scalar VARIANT.
    Nested(Box<Value>),
    /// An array: the VARTYPE of its elements, and the elements.
    Array(u16, Vec<Value>),
    /// The result of a lenient decoder for an unknown VARTYPE: the bytes after it.
    Opaque(u16, Vec<u8>),
}

/// The VARTYPE of VARIANT.
pub const VARIANT: u16 = 12;
/// The bit of arrays.
pub const ARRAY: u16 = 0x2000;
/// The VARTYPEs of scalars, except VARIANT.
pub const SCALARS: [u16; 16] = [0, 1, 2, 3, 4, 5, 6, 7, 8, 10, 11, 17, 18, 19, 20, 21];

impl Value {
    /// Creates a string.
    #[must_use]
    pub fn text(text: &str) -> Self {
        Self::Bstr(text.encode_utf16().collect())
    }

    /// Describes the value in at most 160 characters. The core formats it, but judges nothing.
    #[must_use]
    pub fn short(&self) -> String {
        let (wire, deepest) = (self.to_wire(), Limits { depth: MAX_DEPTH, ..Limits::STREAM });
        let text = match Variant::decode(&wire, &deepest, Strictness::Strict) {
            Ok(value) => format!("{value:?}"),
            Err(_) => format!("{self:?}"),
        };
        match text.char_indices().nth(160) {
            Some((at, _)) => format!("{}... ({} characters)", &text[..at], text.chars().count()),
            None => text,
        }
    }

    /// Returns a float or an integer as a number.
    #[must_use]
    pub fn as_f64(&self) -> Option<f64> {
        Some(match self {
            Self::I2(n) => f64::from(*n),
            Self::I4(n) => f64::from(*n),
            Self::R4(bits) => f64::from(f32::from_bits(*bits)),
            Self::R8(bits) => f64::from_bits(*bits),
            Self::Ui1(n) => f64::from(*n),
            Self::Ui2(n) => f64::from(*n),
            Self::Ui4(n) => f64::from(*n),
            _ => return None,
        })
    }

    /// Returns the VARTYPE.
    #[must_use]
    pub fn vartype(&self) -> u16 {
        match self {
            Self::Empty => 0,
            Self::Null => 1,
            Self::I2(_) => 2,
            Self::I4(_) => 3,
            Self::R4(_) => 4,
            Self::R8(_) => 5,
            Self::Cy(_) => 6,
            Self::Date(_) => 7,
            Self::Bstr(_) => 8,
            Self::Error(_) => 10,
            Self::Bool(_) => 11,
            Self::Nested(_) => VARIANT,
            Self::Ui1(_) => 17,
            Self::Ui2(_) => 18,
            Self::Ui4(_) => 19,
            Self::I8(_) => 20,
            Self::Ui8(_) => 21,
            Self::Array(element, _) => ARRAY | element,
            Self::Opaque(vartype, _) => *vartype,
        }
    }

    /// Returns the canonical encoding.
    #[must_use]
    pub fn to_wire(&self) -> Vec<u8> {
        let mut wire = self.vartype().to_le_bytes().to_vec();
        if let Self::Opaque(_, bytes) = self {
            wire.extend(bytes);
            return wire;
        }
        let count = if let Self::Array(_, items) = self { items.len() } else { 1 };
        wire.extend((count as u32).to_le_bytes());
        wire.extend(self.data());
        wire
    }

    /// Returns the bytes after type and count.
    fn data(&self) -> Vec<u8> {
        match self {
            Self::Empty | Self::Null | Self::Opaque(..) => Vec::new(),
            Self::I2(n) => n.to_le_bytes().to_vec(),
            Self::I4(n) | Self::Error(n) => n.to_le_bytes().to_vec(),
            Self::R4(n) | Self::Ui4(n) => n.to_le_bytes().to_vec(),
            Self::R8(n) | Self::Date(n) | Self::Ui8(n) => n.to_le_bytes().to_vec(),
            Self::Cy(n) | Self::I8(n) => n.to_le_bytes().to_vec(),
            Self::Bstr(units) => {
                let length = 2 * units.len() as u32;
                length.to_le_bytes().into_iter().chain(units.iter().flat_map(|u| u.to_le_bytes())).collect()
            }
            Self::Bool(b) => vec![if *b { 0xff } else { 0 }; 2],
            Self::Ui1(n) => vec![*n],
            Self::Ui2(n) => n.to_le_bytes().to_vec(),
            Self::Nested(inner) => inner.to_wire(),
            Self::Array(VARIANT, items) => items.iter().flat_map(Self::to_wire).collect(),
            Self::Array(_, items) => items.iter().flat_map(Self::data).collect(),
        }
    }

    /// Returns how deep values are nested, as the core's limit counts them: 0 for a value without an inner value.
    #[must_use]
    pub fn depth(&self) -> usize {
        match self {
            Self::Nested(inner) => 1 + inner.depth(),
            Self::Array(VARIANT, items) => items.iter().map(|item| 1 + item.depth()).max().unwrap_or(0),
            _ => 0,
        }
    }

    /// Copies a value that the core decoded, through its public accessors.
    #[must_use]
    pub fn read(value: Variant<'_>) -> Self {
        match value {
            Variant::Empty => Self::Empty,
            Variant::Null => Self::Null,
            Variant::I2(n) => Self::I2(n),
            Variant::I4(n) => Self::I4(n),
            Variant::R4(n) => Self::R4(n.to_bits()),
            Variant::R8(n) => Self::R8(n.to_bits()),
            Variant::Cy(n) => Self::Cy(n.raw()),
            Variant::Date(n) => Self::Date(n.raw().to_bits()),
            Variant::Bstr(text) => Self::Bstr(text.units().collect()),
            Variant::Error(code) => Self::Error(code.0),
            Variant::Bool(b) => Self::Bool(b),
            Variant::Nested(inner) => Self::Nested(Box::new(Self::read(inner.value()))),
            Variant::Ui1(n) => Self::Ui1(n),
            Variant::Ui2(n) => Self::Ui2(n),
            Variant::Ui4(n) => Self::Ui4(n),
            Variant::I8(n) => Self::I8(n),
            Variant::Ui8(n) => Self::Ui8(n),
            Variant::Array(array) => Self::Array(array.element().0, array.iter().map(Self::read).collect()),
            Variant::Opaque(opaque) => Self::Opaque(opaque.vartype.0, opaque.bytes.to_vec()),
            other => unreachable!("a value that these tests do not know: {other:?}"),
        }
    }

    /// Sends the items of an array as a slice of one Rust type.
    fn slice<T>(items: &[Self], out: &mut Writer<'_>, pick: impl Fn(&Self) -> Option<T>) -> Result<(), EncodeError>
    where
        [T]: Encode,
    {
        let picked: Vec<T> = items.iter().map(|item| pick(item).expect("the items are of the array's type")).collect();
        picked.as_slice().encode(out)
    }
}

macro_rules! pick {
    ($variant:ident, $convert:expr) => {
        |value| if let Self::$variant(n) = value { Some($convert(*n)) } else { None }
    };
}

/// Sends the value as a user would: as native Rust values where possible, through the core's encoder.
impl Encode for Value {
    fn encode(&self, out: &mut Writer<'_>) -> Result<(), EncodeError> {
        match self {
            Self::Empty => ().encode(out),
            Self::Null => Null.encode(out),
            Self::I2(n) => n.encode(out),
            Self::I4(n) => n.encode(out),
            Self::R4(n) => f32::from_bits(*n).encode(out),
            Self::R8(n) => f64::from_bits(*n).encode(out),
            Self::Cy(n) => Currency::from_raw(*n).encode(out),
            Self::Date(n) => OleDate::from_raw(f64::from_bits(*n)).encode(out),
            Self::Bstr(units) => match String::from_utf16(units) {
                Ok(text) => text.as_str().encode(out),
                Err(_) => Bstr::from_utf16le(&self.data()[4..]).expect("whole units").encode(out),
            },
            Self::Error(n) => HResult(*n).encode(out),
            Self::Bool(b) => b.encode(out),
            Self::Ui1(n) => n.encode(out),
            Self::Ui2(n) => n.encode(out),
            Self::Ui4(n) => n.encode(out),
            Self::I8(n) => n.encode(out),
            Self::Ui8(n) => n.encode(out),
            Self::Array(2, items) => Self::slice(items, out, pick!(I2, i16::from)),
            Self::Array(3, items) => Self::slice(items, out, pick!(I4, i32::from)),
            Self::Array(4, items) => Self::slice(items, out, pick!(R4, f32::from_bits)),
            Self::Array(5, items) => Self::slice(items, out, pick!(R8, f64::from_bits)),
            Self::Array(6, items) => Self::slice(items, out, pick!(Cy, Currency::from_raw)),
            Self::Array(7, items) => Self::slice(items, out, pick!(Date, |n| OleDate::from_raw(f64::from_bits(n)))),
            Self::Array(10, items) => Self::slice(items, out, pick!(Error, HResult)),
            Self::Array(11, items) => Self::slice(items, out, pick!(Bool, bool::from)),
            Self::Array(VARIANT, items) => {
                items.iter().map(|item| item as &dyn Encode).collect::<Vec<_>>().as_slice().encode(out)
            }
            Self::Array(17, items) => Self::slice(items, out, pick!(Ui1, u8::from)),
            Self::Array(18, items) => Self::slice(items, out, pick!(Ui2, u16::from)),
            Self::Array(19, items) => Self::slice(items, out, pick!(Ui4, u32::from)),
            Self::Array(20, items) => Self::slice(items, out, pick!(I8, i64::from)),
            Self::Array(21, items) => Self::slice(items, out, pick!(Ui8, u64::from)),
            // strings that are not UTF-8, EMPTY in rows, scalar VARIANTs: Rust has no type for them
            Self::Array(..) | Self::Nested(_) => {
                let (wire, deepest) = (self.to_wire(), Limits { depth: u8::MAX, ..Limits::STREAM });
                let value = Variant::decode(&wire, &deepest, Strictness::Strict);
                value.map_err(|_| EncodeError::TooDeep)?.encode(out)
            }
            Self::Opaque(vartype, _) => Err(EncodeError::Unsendable(*vartype)),
        }
    }
}
