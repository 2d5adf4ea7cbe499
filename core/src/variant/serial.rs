//! Serialisation of owned values with serde: the VARTYPE's name, and the data.
//!
//! ```text
//!  "EMPTY"  "NULL"  {"I4":7}  {"R8":1.5}  {"BOOL":true}  {"BSTR":"P1"}        as an enum of serde
//!  {"VARIANT":{"I4":7}}                                                       a scalar VARIANT
//!  {"ARRAY":{"R4":[1.5,2.0]}}  {"ARRAY":{"VARIANT":[{"I4":7},"EMPTY"]}}       arrays
//!  {"ARRAY":{"EMPTY":3}}                                                      an array without data, by its length
//! ```

use alloc::boxed::Box;
use alloc::string::String;
use alloc::vec::Vec;

use serde::de::Error as _;
use serde::ser::Error as _;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use super::encode::head;
use super::{Array, Currency, Encode, Null, OleDate, OwnedVariant, Scalar, VarType, Variant, Writer};
use crate::error::EncodeError;
use crate::hresult::HResult;
use crate::num::to_u32;

/// A value in the data model of serde.
#[derive(Serialize, Deserialize)]
#[serde(rename_all = "UPPERCASE")]
enum Form {
    Empty,
    Null,
    I2(i16),
    I4(i32),
    R4(f32),
    R8(f64),
    Cy(Currency),
    Date(OleDate),
    Bstr(String),
    Error(HResult),
    Bool(bool),
    Variant(Box<OwnedVariant>),
    Ui1(u8),
    Ui2(u16),
    Ui4(u32),
    I8(i64),
    Ui8(u64),
    Array(ArrayForm),
}

/// The elements of an array in the data model of serde.
#[derive(Serialize, Deserialize)]
#[serde(rename_all = "UPPERCASE")]
enum ArrayForm {
    Empty(u32),
    Null(u32),
    I2(Vec<i16>),
    I4(Vec<i32>),
    R4(Vec<f32>),
    R8(Vec<f64>),
    Cy(Vec<Currency>),
    Date(Vec<OleDate>),
    Bstr(Vec<String>),
    Error(Vec<HResult>),
    Bool(Vec<bool>),
    Variant(Vec<OwnedVariant>),
    Ui1(Vec<u8>),
    Ui2(Vec<u16>),
    Ui4(Vec<u32>),
    I8(Vec<i64>),
    Ui8(Vec<u64>),
}

/// The text of the error of a string that is not Unicode.
const SURROGATE: &str = "a BSTR with an unpaired surrogate cannot be serialised";

impl Form {
    fn of(value: Variant<'_>) -> Result<Self, &'static str> {
        Ok(match value {
            Variant::Empty => Self::Empty,
            Variant::Null => Self::Null,
            Variant::I2(n) => Self::I2(n),
            Variant::I4(n) => Self::I4(n),
            Variant::R4(n) => Self::R4(n),
            Variant::R8(n) => Self::R8(n),
            Variant::Cy(n) => Self::Cy(n),
            Variant::Date(n) => Self::Date(n),
            Variant::Bstr(_) => Self::Bstr(value.convert().map_err(|_| SURROGATE)?),
            Variant::Error(n) => Self::Error(n),
            Variant::Bool(n) => Self::Bool(n),
            Variant::Nested(nested) => Self::Variant(Box::new(nested.value().into())),
            Variant::Ui1(n) => Self::Ui1(n),
            Variant::Ui2(n) => Self::Ui2(n),
            Variant::Ui4(n) => Self::Ui4(n),
            Variant::I8(n) => Self::I8(n),
            Variant::Ui8(n) => Self::Ui8(n),
            Variant::Array(array) => Self::Array(ArrayForm::of(array)?),
            Variant::Opaque(_) => return Err("a value of unknown VARTYPE cannot be serialised"),
        })
    }
}

/// Copies numbers of type `T`.
fn items<T: Scalar>(array: Array<'_>) -> Vec<T> {
    array.items().map(|items| items.iter().collect()).unwrap_or_default()
}

impl ArrayForm {
    fn of(array: Array<'_>) -> Result<Self, &'static str> {
        Ok(match array.element() {
            VarType::NULL => Self::Null(to_u32(array.len())),
            VarType::I2 => Self::I2(items(array)),
            VarType::I4 => Self::I4(items(array)),
            VarType::R4 => Self::R4(items(array)),
            VarType::R8 => Self::R8(items(array)),
            VarType::CY => Self::Cy(items(array)),
            VarType::DATE => Self::Date(items(array)),
            VarType::BSTR => Self::Bstr(Variant::Array(array).convert().map_err(|_| SURROGATE)?),
            VarType::ERROR => Self::Error(items(array)),
            VarType::BOOL => Self::Bool(items(array)),
            VarType::VARIANT => Self::Variant(array.iter().map(OwnedVariant::from).collect()),
            VarType::UI1 => Self::Ui1(items(array)),
            VarType::UI2 => Self::Ui2(items(array)),
            VarType::UI4 => Self::Ui4(items(array)),
            VarType::I8 => Self::I8(items(array)),
            VarType::UI8 => Self::Ui8(items(array)),
            _ => Self::Empty(to_u32(array.len())),
        })
    }
}

impl Encode for Form {
    fn encode(&self, out: &mut Writer<'_>) -> Result<(), EncodeError> {
        match self {
            Self::Empty => ().encode(out),
            Self::Null => Null.encode(out),
            Self::I2(n) => n.encode(out),
            Self::I4(n) => n.encode(out),
            Self::R4(n) => n.encode(out),
            Self::R8(n) => n.encode(out),
            Self::Cy(n) => n.encode(out),
            Self::Date(n) => n.encode(out),
            Self::Bstr(text) => text.encode(out),
            Self::Error(n) => n.encode(out),
            Self::Bool(n) => n.encode(out),
            Self::Variant(value) => {
                head(VarType::VARIANT, 1, out)?;
                value.encode(out)
            }
            Self::Ui1(n) => n.encode(out),
            Self::Ui2(n) => n.encode(out),
            Self::Ui4(n) => n.encode(out),
            Self::I8(n) => n.encode(out),
            Self::Ui8(n) => n.encode(out),
            Self::Array(elements) => elements.encode(out),
        }
    }
}

impl Encode for ArrayForm {
    fn encode(&self, out: &mut Writer<'_>) -> Result<(), EncodeError> {
        match self {
            Self::Empty(count) => head(VarType::EMPTY.array_of(), *count, out),
            Self::Null(count) => head(VarType::NULL.array_of(), *count, out),
            Self::I2(items) => items.encode(out),
            Self::I4(items) => items.encode(out),
            Self::R4(items) => items.encode(out),
            Self::R8(items) => items.encode(out),
            Self::Cy(items) => items.encode(out),
            Self::Date(items) => items.encode(out),
            Self::Bstr(items) => items.encode(out),
            Self::Error(items) => items.encode(out),
            Self::Bool(items) => items.encode(out),
            Self::Variant(items) => items.encode(out),
            Self::Ui1(items) => items.encode(out),
            Self::Ui2(items) => items.encode(out),
            Self::Ui4(items) => items.encode(out),
            Self::I8(items) => items.encode(out),
            Self::Ui8(items) => items.encode(out),
        }
    }
}

impl Serialize for OwnedVariant {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        Form::of(self.as_variant()).map_err(S::Error::custom)?.serialize(serializer)
    }
}

impl<'de> Deserialize<'de> for OwnedVariant {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        Self::new(&Form::deserialize(deserializer)?).map_err(D::Error::custom)
    }
}
