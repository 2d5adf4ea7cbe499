//! Plain data: the text form of a value without its type.

use bcap_core::error::{TextError, TextErrorKind};
use bcap_core::variant::{VarType, Variant};

use crate::value::{self, Value};

/// Parses `TYPE,DATA`. The comma is required: `0` and `1` alone are numbers, not EMPTY and NULL.
pub(crate) fn from_typed(text: &str) -> Result<Value, TextError> {
    let value = Value::parse_text(text.as_bytes())?;
    if text.contains(',') {
        Ok(value)
    } else {
        Err(TextError { kind: TextErrorKind::Comma, column: column(text.len() + 1) })
    }
}

/// Parses `text` as data of a type. A BOOL may also be `true`, `false`, `on` or `off`.
pub(crate) fn from_data(vartype: VarType, text: &str) -> Result<Value, TextError> {
    match (vartype, text.trim().to_ascii_lowercase().as_str()) {
        (VarType::BOOL, "true" | "on") => Value::parse_text(b"11,-1"),
        (VarType::BOOL, "false" | "off") => Value::parse_text(b"11,0"),
        _ => Value::parse_text(format!("{},{text}", vartype.0).as_bytes()),
    }
}

/// Parses user input for a variable that now holds `current`: plain data of its type, or `TYPE,DATA`.
///
/// Both readings can be possible: `8196,1,2` is also three numbers for a vector. The order of priority is `TYPE,DATA` with
/// the variable's own type, plain data, `TYPE,DATA` of another type. A reading with as many elements as the variable has
/// priority over readings with another number of elements.
pub(crate) fn from_input(text: &str, current: Variant<'_>) -> Result<Value, TextError> {
    let vartype = current.vartype();
    let typed = from_typed(text);
    if current.is_empty() || vartype == VarType::VARIANT {
        // the variable's type is unknown
        return typed;
    }
    let (own, other) = match typed {
        Ok(value) if value.as_variant().vartype() == vartype => (Some(value), None),
        typed => (None, typed.ok()),
    };
    let plain = from_data(vartype, text);
    let readings = || [own.as_ref(), plain.as_ref().ok(), other.as_ref()].into_iter().flatten();
    let fitting = readings().find(|value| elements(value.as_variant()) == elements(current));
    match fitting.or_else(|| readings().next()).cloned() {
        Some(value) => Ok(value),
        None => plain.map_err(|error| shifted(error, vartype)),
    }
}

/// Formats a value for people: its data, or its `Debug` form if the data have no readable text.
///
/// RAC writes a date as a number if its text is not exact; then the `Debug` form shows the date.
pub(crate) fn to_plain(value: Variant<'_>) -> String {
    let text = value::to_text(value).ok();
    let data = text.as_deref().and_then(|text| text.split_once(',')).map(|(_, data)| data.to_owned());
    let is_readable = |data: &String| match value {
        Variant::Bstr(_) => true,
        Variant::Date(_) => data.contains('/'),
        _ => !data.is_empty(),
    };
    data.filter(is_readable).unwrap_or_else(|| format!("{value:?}"))
}

/// Returns the number of elements of an array, `None` for a scalar.
fn elements(value: Variant<'_>) -> Option<usize> {
    value.as_array().map(|array| array.len())
}

/// Converts the column of an error in `TYPE,DATA` to a column in the data.
fn shifted(error: TextError, vartype: VarType) -> TextError {
    let prefix = column(vartype.0.to_string().len() + 1);
    TextError { column: error.column.saturating_sub(prefix), ..error }
}

fn column(column: usize) -> u32 {
    u32::try_from(column).unwrap_or(u32::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;
    use bcap_core::variant::{Encode, OleDate};

    #[track_caller]
    fn input(text: &str, current: &impl Encode) -> String {
        let current = Value::new(current).unwrap();
        match from_input(text, current.as_variant()) {
            Ok(value) => value::to_text(value.as_variant()).unwrap(),
            Err(error) => error.to_string(),
        }
    }

    #[test]
    fn plain_data_take_the_type_of_the_variable() {
        assert_eq!(input("5", &1_i32), "3,5");
        assert_eq!(input("-5", &1_i32), "3,-5");
        assert_eq!(input("2.5", &1_f32), "4,2.5");
        assert_eq!(input("1e300", &1_f64), "5,1e300");
        assert_eq!(input("hello, world", &"x"), "8,hello, world");
        assert_eq!(input("1,2,3", &[0_f32; 3]), "8196,1,2,3");
        assert_eq!(input("true", &false), "11,-1");
        assert_eq!(input("OFF", &false), "11,0");
        assert_eq!(input("1", &false), "11,-1");
    }

    #[test]
    fn a_type_before_the_data_is_recognised() {
        assert_eq!(input("3,5", &1_i32), "3,5");
        assert_eq!(input("5,2.5", &1_i32), "5,2.5");
        assert_eq!(input("8,hello", &"x"), "8,hello");
        assert_eq!(input("3,5", &"x"), "8,3,5");
        assert_eq!(input("8196,1,2,3", &[0_f32; 3]), "8196,1,2,3");
        assert_eq!(input("8196,1,2", &[0_f32; 3]), "8196,8196,1,2");
        assert_eq!(input("8196,1,2,3,4", &[0_f32; 3]), "8196,1,2,3,4");
        assert_eq!(input("8197,1,2,3", &[0_f32; 3]), "8197,1,2,3");
        assert_eq!(input("3,7", &()), "3,7");
    }

    #[test]
    fn a_number_without_a_comma_is_not_a_type() {
        assert_eq!(input("0", &7_i32), "3,0");
        assert_eq!(input("1", &7.5_f64), "5,1");
        assert_eq!(input("0,", &7_i32), "0,");
        assert_eq!(input("1", &()), "a comma is missing after the VARTYPE at column 2");
    }

    #[test]
    fn errors_have_columns_of_the_input() {
        assert_eq!(input("12x", &1_i32), "not a digit of the number at column 3");
        assert_eq!(input("1,2,x", &[0_f32; 3]), "not a digit of the number at column 5");
        assert!(input("5", &()).contains("comma"), "{}", input("5", &()));
    }

    #[test]
    fn values_are_printed_without_their_type() {
        let plain = |value: &dyn Encode| to_plain(Value::new(value).unwrap().as_variant());
        assert_eq!(plain(&5_i32), "5");
        assert_eq!(plain(&[1.5_f32, -2.0]), "1.5,-2");
        assert_eq!(plain(&"a,b"), "a,b");
        assert_eq!(plain(&""), "");
        assert_eq!(plain(&()), "EMPTY");
        assert_eq!(plain(&OleDate::from_raw(1.5)), "1899/12/31 12:00:00");
        assert_eq!(plain(&OleDate::from_raw(1.123)), format!("{:?}", Variant::Date(OleDate::from_raw(1.123))));
        assert_eq!(plain(&[0_i32; 0]), "I4[]");
    }
}
