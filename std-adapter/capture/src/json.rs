//! Lossless conversion between values and JSON: `{"vt":3,"v":100}`.
//!
//! | VARTYPE                            | `v`                                                                  |
//! |------------------------------------|----------------------------------------------------------------------|
//! | EMPTY, NULL                        | `null`                                                               |
//! | I2 I4 I8 UI1 UI2 UI4 UI8, ERROR    | the number                                                           |
//! | R4, R8, DATE                       | the shortest number that reads back to the same bits, `-0.0` too     |
//! | the same, not finite               | `"NaN"` `"inf"` `"-inf"`; other NaNs by their bits, `"NaN(0x7fc00001)"` |
//! | CY                                 | the ten-thousandths, an integer                                      |
//! | BOOL                               | -1 or 0; `true` and `false` are accepted too                         |
//! | BSTR                               | a string; an unpaired surrogate is `\ud800`                          |
//! | VARIANT                            | the value inside, `{"vt":8,"v":"Sample"}`                            |
//! | ARRAY of VARIANT                   | a list of `{"vt":..,"v":..}`                                         |
//! | ARRAY of another type              | a list of the `v` of its elements                                    |
//!
//! A value of unknown VARTYPE, which only lenient decoding accepts, is `{"vt":16,"opaque":"010000007f"}`: the bytes after
//! the type, including the count. It cannot be encoded.

use std::borrow::Cow;
use std::fmt::Write as _;

use bcap_core::hresult::HResult;
use bcap_core::limits::{Limits, MAX_DEPTH, Strictness};
use bcap_core::variant::{Bstr, Currency, Element, Encode, Null, OleDate, VarType, Variant, Writer};
use serde::Deserialize;
use serde_json::value::RawValue;

use crate::error::ConvertError;
use crate::hex;

/// The limits of the tools: 16 MiB as in the specification, and the maximum number of arguments and depth.
pub const LIMITS: Limits = Limits { arguments: u16::MAX, depth: MAX_DEPTH, ..Limits::STREAM };

/// Appends a value.
pub fn put_value(out: &mut String, value: Variant<'_>) {
    put(out, format_args!("{{\"vt\":{},", value.vartype().0));
    if let Variant::Opaque(opaque) = value {
        put(out, format_args!("\"opaque\":\"{}\"}}", hex::compact(opaque.bytes)));
        return;
    }
    out.push_str("\"v\":");
    put_data(out, value);
    out.push('}');
}

/// Appends the data after `"v":`.
fn put_data(out: &mut String, value: Variant<'_>) {
    match value {
        Variant::Empty | Variant::Null | Variant::Opaque(_) => out.push_str("null"),
        Variant::R4(n) => {
            put_float(out, n.is_finite().then(|| serde_json::to_string(&n)), n.into(), n.to_bits().into())
        }
        Variant::R8(n) => put_float(out, n.is_finite().then(|| serde_json::to_string(&n)), n, n.to_bits()),
        Variant::Date(date) => put_data(out, Variant::R8(date.raw())),
        Variant::Cy(amount) => put(out, format_args!("{}", amount.raw())),
        Variant::Error(code) => put(out, format_args!("{}", code.0)),
        Variant::Bool(b) => out.push_str(if b { "-1" } else { "0" }),
        Variant::Bstr(text) => put_string(out, text),
        Variant::Nested(nested) => put_value(out, nested.value()),
        Variant::Array(array) => {
            out.push('[');
            for (i, element) in array.iter().enumerate() {
                if i > 0 {
                    out.push(',');
                }
                if array.element() == VarType::VARIANT { put_value(out, element) } else { put_data(out, element) }
            }
            out.push(']');
        }
        Variant::Ui8(n) => put(out, format_args!("{n}")),
        integer => put(out, format_args!("{}", integer.as_i64().unwrap_or_default())),
    }
}

/// Appends a float: its shortest digits, or a string if it is not finite.
fn put_float(out: &mut String, finite: Option<serde_json::Result<String>>, value: f64, bits: u64) {
    match finite {
        // numbers always serialize
        Some(digits) => out.push_str(&digits.unwrap_or_default()),
        None if value == f64::INFINITY => out.push_str("\"inf\""),
        None if value == f64::NEG_INFINITY => out.push_str("\"-inf\""),
        None if bits == f64::NAN.to_bits() || bits == u64::from(f32::NAN.to_bits()) => out.push_str("\"NaN\""),
        None => put(out, format_args!("\"NaN({bits:#x})\"")),
    }
}

/// Appends a string with the escapes of JSON, and with escapes for unpaired surrogates.
fn put_string(out: &mut String, text: Bstr<'_>) {
    out.push('"');
    for c in text.chars() {
        match c {
            Ok('"') => out.push_str("\\\""),
            Ok('\\') => out.push_str("\\\\"),
            Ok('\n') => out.push_str("\\n"),
            Ok('\r') => out.push_str("\\r"),
            Ok('\t') => out.push_str("\\t"),
            Ok(c) if c.is_control() => put(out, format_args!("\\u{:04x}", u32::from(c))),
            Ok(c) => out.push(c),
            Err(unit) => put(out, format_args!("\\u{unit:04x}")),
        }
    }
    out.push('"');
}

/// Appends formatted text; writing to a `String` cannot fail.
fn put(out: &mut String, text: std::fmt::Arguments<'_>) {
    let _ = out.write_fmt(text);
}

/// A value whose data are still text: their type depends on `vt`.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Item<'a> {
    vt: u16,
    /// `None` for `null` as well.
    #[serde(borrow)]
    v: Option<&'a RawValue>,
}

/// A part of the text of an item; its errors have offsets in the whole text.
#[derive(Clone, Copy, Debug)]
pub struct Part<'a> {
    whole: &'a str,
    /// A slice of `whole`.
    part: &'a str,
}

impl<'a> Part<'a> {
    /// The whole text of an item.
    #[must_use]
    pub fn whole(text: &'a str) -> Self {
        Self { whole: text, part: text }
    }

    /// A part that was deserialized from this one.
    #[must_use]
    pub fn of(self, raw: &'a RawValue) -> Self {
        Self { part: raw.get(), ..self }
    }

    /// Returns the text for a message, truncated to 40 characters.
    fn shown(self) -> Cow<'a, str> {
        match self.part.char_indices().nth(40) {
            Some((end, _)) => Cow::Owned(format!("{}...", &self.part[..end])),
            None => Cow::Borrowed(self.part),
        }
    }

    fn offset(self) -> usize {
        self.part.as_ptr().addr().saturating_sub(self.whole.as_ptr().addr())
    }

    /// An error at the start of the part.
    pub fn error(self, message: impl Into<String>) -> ConvertError {
        ConvertError::new(message, self.offset())
    }

    /// Deserializes the part.
    ///
    /// # Errors
    ///
    /// When it is not valid JSON of the type.
    pub fn parse<T: Deserialize<'a>>(self) -> Result<T, ConvertError> {
        serde_json::from_str(self.part).map_err(|error| {
            let message = error.to_string();
            let suffix = format!(" at line {} column {}", error.line(), error.column());
            let line =
                self.part.split_inclusive('\n').take(error.line().saturating_sub(1)).map(str::len).sum::<usize>();
            let at = self.offset() + line + error.column().saturating_sub(1);
            ConvertError::new(format!("{} (character {at})", message.strip_suffix(&suffix).unwrap_or(&message)), at)
        })
    }
}

/// Parses a value and returns its encoding.
///
/// # Errors
///
/// When it is not a value, or a receiver would refuse it.
pub fn parse_value(item: Part<'_>) -> Result<Vec<u8>, ConvertError> {
    // the zeros of an I8 array need 8 bytes for 2 characters; no other value needs more
    let mut buffer = vec![0; item.part.len() * 4 + 16];
    let mut out = Writer::new(&mut buffer);
    encode_value(item, 0, &mut out)?;
    let len = out.len();
    buffer.truncate(len);
    // the decoder checks the limits of a receiver, such as the nesting depth
    match Variant::decode(&buffer, &LIMITS, Strictness::Strict) {
        Ok(_) => Ok(buffer),
        Err(error) => Err(item.error(error.kind.to_string())),
    }
}

fn encode_value(item: Part<'_>, depth: u8, out: &mut Writer<'_>) -> Result<(), ConvertError> {
    let Item { vt, v } = item.parse()?;
    let vartype = VarType(vt);
    if !vartype.is_known() {
        return Err(item.error(format!("cannot encode the unknown VARTYPE {vt}")));
    }
    if depth > MAX_DEPTH {
        return Err(item.error(format!("VARIANTs are nested deeper than {MAX_DEPTH}")));
    }
    let data = match v {
        Some(v) => item.of(v),
        None if vartype == VarType::EMPTY => return Ok(().encode(out)?),
        None if vartype == VarType::NULL => return Ok(Null.encode(out)?),
        None => return Err(item.error(format!("\"v\" is missing: {vartype} needs data"))),
    };
    if !vartype.is_array() {
        head(vartype, 1, out)?;
        return encode_data(vartype, data, depth, out);
    }
    let elements: Vec<&RawValue> = data.parse()?;
    let count = u32::try_from(elements.len()).map_err(|_| data.error("the list is too long"))?;
    head(vartype, count, out)?;
    elements.into_iter().try_for_each(|element| encode_data(vartype.element(), data.of(element), depth, out))
}

fn head(vartype: VarType, count: u32, out: &mut Writer<'_>) -> Result<(), ConvertError> {
    out.put(vartype.0.to_le_bytes())?;
    Ok(out.put(count.to_le_bytes())?)
}

/// Appends the data of a scalar, or of an element.
fn encode_data(vartype: VarType, data: Part<'_>, depth: u8, out: &mut Writer<'_>) -> Result<(), ConvertError> {
    match vartype {
        VarType::I2 => integer::<i16>(data)?.put(out)?,
        VarType::I4 => integer::<i32>(data)?.put(out)?,
        VarType::I8 => integer::<i64>(data)?.put(out)?,
        VarType::UI1 => integer::<u8>(data)?.put(out)?,
        VarType::UI2 => integer::<u16>(data)?.put(out)?,
        VarType::UI4 => integer::<u32>(data)?.put(out)?,
        VarType::UI8 => integer::<u64>(data)?.put(out)?,
        VarType::CY => Currency::from_raw(integer(data)?).put(out)?,
        VarType::ERROR => HResult(code(data)?).put(out)?,
        VarType::BOOL => boolean(data)?.put(out)?,
        VarType::R4 => f32::from_bits(float_bits::<f32>(data)?).put(out)?,
        VarType::R8 => f64::from_bits(float_bits::<f64>(data)?).put(out)?,
        VarType::DATE => OleDate::from_raw(f64::from_bits(float_bits::<f64>(data)?)).put(out)?,
        VarType::BSTR => {
            let bytes: Vec<u8> = string(data)?.into_iter().flat_map(u16::to_le_bytes).collect();
            Bstr::from_utf16le(&bytes).unwrap_or_default().put(out)?;
        }
        VarType::VARIANT => encode_value(data, depth + 1, out)?,
        // EMPTY and NULL
        _ if data.part == "null" => {}
        other => return Err(data.error(format!("a value of {other} is null, found {}", data.shown()))),
    }
    Ok(())
}

/// Parses an integer in the range of its type.
fn integer<T: std::str::FromStr>(data: Part<'_>) -> Result<T, ConvertError> {
    data.part.parse().map_err(|_| {
        let name = std::any::type_name::<T>();
        data.error(format!("{} is not an integer in the range of {name} (character {})", data.shown(), data.offset()))
    })
}

/// Parses an HRESULT: the signed number that the tools print, or the unsigned number of manuals.
///
/// # Errors
///
/// When it is neither.
pub fn code(data: Part<'_>) -> Result<i32, ConvertError> {
    match data.part.parse::<u32>() {
        Ok(code) => Ok(code.cast_signed()),
        Err(_) => integer(data),
    }
}

fn boolean(data: Part<'_>) -> Result<bool, ConvertError> {
    match data.part {
        "-1" | "true" => Ok(true),
        "0" | "false" => Ok(false),
        _ => Err(data.error(format!("a BOOL is -1 or 0, found {} (character {})", data.shown(), data.offset()))),
    }
}

/// The operations that differ between f32 and f64 when parsing JSON.
trait Float: std::str::FromStr {
    type Bits: std::str::FromStr;
    /// The bits of the value; `None` if it is not finite.
    fn finite_bits(self) -> Option<Self::Bits>;
    fn inf() -> [Self::Bits; 2];
    fn nan() -> Self::Bits;
    /// Parses the bits of a NaN; `None` if they are another number.
    fn nan_from_hex(digits: &str) -> Option<Self::Bits>;
}

macro_rules! floats {
    ($($float:ident $bits:ident),*) => {$(
        impl Float for $float {
            type Bits = $bits;

            fn finite_bits(self) -> Option<$bits> {
                self.is_finite().then_some(self.to_bits())
            }

            fn inf() -> [$bits; 2] {
                [$float::INFINITY.to_bits(), $float::NEG_INFINITY.to_bits()]
            }

            fn nan() -> $bits {
                $float::NAN.to_bits()
            }

            fn nan_from_hex(digits: &str) -> Option<$bits> {
                $bits::from_str_radix(digits, 16).ok().filter(|bits| $float::from_bits(*bits).is_nan())
            }
        }
    )*};
}

floats!(f32 u32, f64 u64);

/// Parses a float and returns its bits, because moving a NaN as a float may change it.
fn float_bits<T: Float>(data: Part<'_>) -> Result<T::Bits, ConvertError> {
    let [inf, minus_inf] = T::inf();
    let bits = match data.part.strip_prefix('"').and_then(|text| text.strip_suffix('"')) {
        Some("NaN") => Some(T::nan()),
        Some("inf") => Some(inf),
        Some("-inf") => Some(minus_inf),
        Some(other) => {
            other.strip_prefix("NaN(0x").and_then(|hex| hex.strip_suffix(')')).and_then(|hex| T::nan_from_hex(hex))
        }
        None if data.part.starts_with(|c: char| c == '-' || c.is_ascii_digit()) => {
            data.part.parse::<T>().ok().and_then(T::finite_bits)
        }
        None => None,
    };
    bits.ok_or_else(|| {
        let name = std::any::type_name::<T>();
        let wanted = "a number, \"NaN\", \"inf\" or \"-inf\"";
        data.error(format!("{} is not {wanted} in the range of {name} (character {})", data.shown(), data.offset()))
    })
}

/// Parses a string as UTF-16 units, so that unpaired surrogates are preserved.
fn string(data: Part<'_>) -> Result<Vec<u16>, ConvertError> {
    let wrong = || data.error(format!("a BSTR is a string, found {} (character {})", data.shown(), data.offset()));
    let text = data.part.strip_prefix('"').and_then(|text| text.strip_suffix('"')).ok_or_else(wrong)?;
    let mut units = Vec::with_capacity(text.len());
    let mut rest = text.chars();
    while let Some(c) = rest.next() {
        if c != '\\' {
            units.extend_from_slice(c.encode_utf16(&mut [0; 2]));
            continue;
        }
        units.push(match rest.next() {
            Some('b') => 0x08,
            Some('f') => 0x0c,
            Some('n') => 0x0a,
            Some('r') => 0x0d,
            Some('t') => 0x09,
            Some('u') => {
                let unit = rest.as_str().get(..4).and_then(|digits| u16::from_str_radix(digits, 16).ok());
                rest.nth(3);
                unit.ok_or_else(wrong)?
            }
            // the JSON is valid, so this is a quotation mark, a solidus or a reverse solidus
            Some(itself) => u16::try_from(u32::from(itself)).map_err(|_| wrong())?,
            None => return Err(wrong()),
        });
    }
    Ok(units)
}

#[cfg(test)]
mod tests;
