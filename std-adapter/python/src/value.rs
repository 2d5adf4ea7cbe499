//! Values of b-CAP as objects of Python.
//!
//! | VARIANT                    | from Python                                    | to Python            |
//! |----------------------------|------------------------------------------------|----------------------|
//! | EMPTY, NULL                | `None`, an empty list                          | `None`               |
//! | BOOL                       | `bool`                                         | `bool`               |
//! | I4; I8                     | `int`; one that I4 cannot contain              | `int`, as all integers |
//! | R8; R4                     | `float`; `ctypes.c_float`                      | `float`              |
//! | BSTR                       | `str`                                          | `str`                |
//! | DATE                       | `datetime`, in local time                      | `datetime`           |
//! | UI1[]                      | `bytes`, `bytearray`                           | `bytes`              |
//! | array of one type          | a sequence of that type, such as numpy's arrays | `list`              |
//! | VARIANT[]                  | a sequence of several types                    | `list`               |
//!
//! A sequence of `int` and `float` is an array of R8, or of VARIANT for scripts of the maker's client. Sets and dictionaries are refused.

use bcap_std::core::limits::MAX_DEPTH;
use bcap_std::core::variant::{CivilTime, Encode, OwnedVariant, VarType, Variant};
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::{PyBool, PyByteArray, PyBytes, PyDict, PyFloat, PyFrozenSet, PyInt, PyList, PySet, PyString};

/// A value that was read.
pub(crate) struct Value(pub(crate) OwnedVariant);

impl<'py> IntoPyObject<'py> for Value {
    type Target = PyAny;
    type Output = Bound<'py, PyAny>;
    type Error = PyErr;

    fn into_pyobject(self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        to_python(py, &self.0.as_variant())
    }
}

/// Returns the object for a value.
pub(crate) fn to_python<'py>(py: Python<'py>, value: &Variant<'_>) -> PyResult<Bound<'py, PyAny>> {
    Ok(match value {
        Variant::Empty | Variant::Null => py.None().into_bound(py),
        Variant::I2(number) => number.into_pyobject(py)?.into_any(),
        Variant::I4(number) => number.into_pyobject(py)?.into_any(),
        Variant::I8(number) => number.into_pyobject(py)?.into_any(),
        Variant::Ui1(number) => number.into_pyobject(py)?.into_any(),
        Variant::Ui2(number) => number.into_pyobject(py)?.into_any(),
        Variant::Ui4(number) => number.into_pyobject(py)?.into_any(),
        Variant::Ui8(number) => number.into_pyobject(py)?.into_any(),
        Variant::R4(number) => number.into_pyobject(py)?.into_any(),
        Variant::R8(number) => number.into_pyobject(py)?.into_any(),
        Variant::Cy(amount) => amount.raw().into_pyobject(py)?.into_any(),
        Variant::Error(code) => code.0.into_pyobject(py)?.into_any(),
        Variant::Bool(truth) => PyBool::new(py, *truth).to_owned().into_any(),
        Variant::Bstr(text) => text.to_string().into_pyobject(py)?.into_any(),
        Variant::Date(date) => match date.to_civil() {
            Some(time) => civil(py, time)?,
            None => date.raw().into_pyobject(py)?.into_any(),
        },
        Variant::Nested(inner) => to_python(py, &inner.value())?,
        Variant::Array(array) => {
            if let Some(bytes) = array.items::<u8>() {
                return Ok(PyBytes::new(py, &bytes.iter().collect::<Vec<_>>()).into_any());
            }
            let elements = array.iter().map(|element| to_python(py, &element)).collect::<PyResult<Vec<_>>>()?;
            PyList::new(py, elements)?.into_any()
        }
        Variant::Opaque(value) => PyBytes::new(py, value.bytes).into_any(),
        other => format!("{other:?}").into_pyobject(py)?.into_any(),
    })
}

fn civil<'py>(py: Python<'py>, time: CivilTime) -> PyResult<Bound<'py, PyAny>> {
    let CivilTime { year, month, day, hour, minute, second, millisecond } = time;
    let class = py.import("datetime")?.getattr("datetime")?;
    class.call1((year, month, day, hour, minute, second, u32::from(millisecond) * 1000))
}

/// Returns the value of an object.
pub(crate) fn from_python(object: &Bound<'_, PyAny>) -> PyResult<OwnedVariant> {
    value_of(object, true)
}

/// Returns the value of an object; `joins` is whether `int` and `float` in a sequence become R8.
///
/// # Errors
///
/// `TypeError` for an object without a VARIANT, `OverflowError` for a number that fits no type, `ValueError` for sequences that
/// are nested too deeply.
pub(crate) fn value_of(object: &Bound<'_, PyAny>, joins: bool) -> PyResult<OwnedVariant> {
    value_within(object, joins, MAX_DEPTH)
}

/// Returns the value of an object with at most `depth` levels of sequences. Each call of `tolist` counts as a level, too.
fn value_within(object: &Bound<'_, PyAny>, joins: bool, depth: u8) -> PyResult<OwnedVariant> {
    if let Some(value) = scalar(object)? {
        return Ok(value);
    }
    let depth = depth.checked_sub(1).ok_or_else(too_deep)?;
    // arrays and numbers of numpy, and of the module `array`
    if let Ok(plain) = object.call_method0("tolist") {
        return value_within(&plain, joins, depth);
    }
    // a set would be sent in the order of its hashes, and a dictionary without its values
    if object.is_instance_of::<PySet>() || object.is_instance_of::<PyFrozenSet>() || object.is_instance_of::<PyDict>() {
        return Err(unsupported(object));
    }
    let items = object.try_iter().map_err(|_| unsupported(object))?;
    let items = items.map(|item| value_within(&item?, joins, depth)).collect::<PyResult<Vec<_>>>()?;
    sequence(&items, joins)
}

/// Returns the value of an object that is not a sequence.
fn scalar(object: &Bound<'_, PyAny>) -> PyResult<Option<OwnedVariant>> {
    Ok(Some(if object.is_none() {
        OwnedVariant::EMPTY
    } else if let Ok(truth) = object.cast::<PyBool>() {
        encoded(&truth.is_true())?
    } else if object.is_instance_of::<PyInt>() {
        match object.extract::<i32>() {
            Ok(number) => encoded(&number)?,
            Err(_) => encoded(&object.extract::<i64>()?)?,
        }
    } else if object.is_instance_of::<PyFloat>() {
        encoded(&object.extract::<f64>()?)?
    } else if object.is_instance_of::<PyString>() {
        encoded(object.extract::<String>()?.as_str())?
    } else if object.is_instance_of::<PyBytes>() || object.is_instance_of::<PyByteArray>() {
        encoded(&object.extract::<Vec<u8>>()?)?
    } else if object.hasattr("timestamp")? && object.hasattr("microsecond")? {
        encoded(&from_datetime(object)?)?
    } else if object.get_type().getattr("__module__")?.eq("ctypes")? && object.hasattr("value")? {
        from_ctypes(object)?
    } else {
        return Ok(None);
    }))
}

fn unsupported(object: &Bound<'_, PyAny>) -> PyErr {
    let name = object.get_type().to_string();
    PyTypeError::new_err(format!(
        "a value of {name} cannot be sent; use None, bool, int, float, str, bytes, datetime, or a sequence of them"
    ))
}

fn too_deep() -> PyErr {
    PyValueError::new_err(format!(
        "the value cannot be sent: sequences are nested deeper than {MAX_DEPTH}, or contain themselves"
    ))
}

/// Returns whether a value that was read equals a wanted one, which is converted to the type of the other, element by element.
///
/// # Errors
///
/// Why the type of the value that was read cannot have the wanted value.
pub(crate) fn equals(read: Variant<'_>, wanted: Variant<'_>) -> Result<bool, String> {
    macro_rules! compare {
        ($($name:ident $type:ty;)*) => {
            match (read.flatten(), wanted.flatten()) {
                // a variable that has no value may get one of any type
                (read, wanted) if read.is_empty() || wanted.is_empty() => Ok(read.is_empty() && wanted.is_empty()),
                (Variant::Array(read), Variant::Array(wanted)) => {
                    let mut pairs = read.iter().zip(wanted.iter());
                    pairs.try_fold(read.len() == wanted.len(), |all, (read, wanted)| Ok(equals(read, wanted)? && all))
                }
                $((Variant::$name(read), wanted) => {
                    wanted.convert::<$type>().map(|wanted| wanted == read).map_err(|error| error.to_string())
                })*
                (read, wanted) if read.vartype() == wanted.vartype() => Ok(read == wanted),
                (read, wanted) => Err(format!("expected {}, found {}", read.vartype(), wanted.vartype())),
            }
        };
    }
    compare! { I2 i16; I4 i32; I8 i64; Ui1 u8; Ui2 u16; Ui4 u32; Ui8 u64; R4 f32; R8 f64; Bool bool; }
}

/// Encodes an array of one type, or of VARIANTs.
fn sequence(items: &[OwnedVariant], joins: bool) -> PyResult<OwnedVariant> {
    let variants = encoded(items)?;
    let Some(first) = items.first() else { return Ok(OwnedVariant::EMPTY) };
    let only = |types: &[VarType]| items.iter().all(|item| types.contains(&item.as_variant().vartype()));
    macro_rules! array_of {
        ($($type:ident $element:ty;)*) => {
            match first.as_variant().vartype() {
                $(VarType::$type if only(&[VarType::$type]) => variants.convert::<Vec<$element>>().map(|all| encoded(&all)),)*
                _ if joins && only(&[VarType::I4, VarType::I8, VarType::R8]) => variants.convert::<Vec<f64>>().map(|all| encoded(&all)),
                _ => return Ok(variants),
            }
        };
    }
    let array = array_of! {
        I2 i16; I4 i32; I8 i64; UI1 u8; UI2 u16; UI4 u32; UI8 u64; R4 f32; R8 f64; BOOL bool; BSTR String; DATE CivilTime;
    };
    array.unwrap_or(Ok(variants))
}

/// Returns the value of an instance of a class of `ctypes`, which chooses the type.
fn from_ctypes(object: &Bound<'_, PyAny>) -> PyResult<OwnedVariant> {
    let value = object.getattr("value")?;
    match &*object.get_type().getattr("__name__")?.extract::<String>()? {
        "c_bool" => encoded(&value.extract::<bool>()?),
        "c_ubyte" => encoded(&value.extract::<u8>()?),
        "c_short" => encoded(&value.extract::<i16>()?),
        "c_ushort" => encoded(&value.extract::<u16>()?),
        "c_int" => encoded(&value.extract::<i32>()?),
        "c_uint" => encoded(&value.extract::<u32>()?),
        "c_long" | "c_longlong" => encoded(&value.extract::<i64>()?),
        "c_ulong" | "c_ulonglong" => encoded(&value.extract::<u64>()?),
        "c_float" => encoded(&value.extract::<f32>()?),
        "c_double" => encoded(&value.extract::<f64>()?),
        "c_wchar_p" => encoded(value.extract::<String>()?.as_str()),
        _ => Err(unsupported(object)),
    }
}

/// Returns the time of a `datetime`: its fields, in the time zone of the controller.
fn from_datetime(object: &Bound<'_, PyAny>) -> PyResult<CivilTime> {
    let field = |name: &str| object.getattr(name);
    Ok(CivilTime {
        year: field("year")?.extract()?,
        month: field("month")?.extract()?,
        day: field("day")?.extract()?,
        hour: field("hour")?.extract()?,
        minute: field("minute")?.extract()?,
        second: field("second")?.extract()?,
        millisecond: field("microsecond")?.extract::<u32>().map(|micros| (micros / 1000) as u16)?,
    })
}

fn encoded<T: Encode + ?Sized>(value: &T) -> PyResult<OwnedVariant> {
    OwnedVariant::new(value).map_err(|error| PyValueError::new_err(format!("the value cannot be sent: {error}")))
}
