//! Data: the text of a value without its type, as people write and read it.

use crate::value;
use bcap_core::error::{TextError, TextErrorKind};
use bcap_core::position::{Position, Transform};
use bcap_core::variant::{OwnedVariant as Value, VarType, Variant};

/// Parses `TYPE,DATA`. The comma is required: `0` and `1` alone are numbers, not EMPTY and NULL.
///
/// # Errors
///
/// When the text is not `TYPE,DATA`.
pub fn from_typed(text: &str) -> Result<Value, TextError> {
    let value = Value::parse_text(text.as_bytes())?;
    if text.contains(',') { Ok(value) } else { Err(TextError::new(TextErrorKind::Comma, column(text.len() + 1))) }
}

/// Parses `text` as data of a type. A BOOL may also be `true`, `false`, `on` or `off`.
///
/// # Errors
///
/// When the text is not data of this type.
pub fn from_data(vartype: VarType, text: &str) -> Result<Value, TextError> {
    let typed = |data: &str| Value::parse_text(format!("{},{data}", vartype.0).as_bytes());
    if vartype.element() != VarType::BOOL {
        return typed(text);
    }
    let number = |word| match str::trim(word).to_ascii_lowercase().as_str() {
        "true" | "on" => "-1".into(),
        "false" | "off" => "0".into(),
        _ => word.to_owned(),
    };
    typed(&text.split(',').map(number).collect::<Vec<_>>().join(","))
}

/// Parses the input of a user who gave `--typed`.
///
/// # Errors
///
/// A sentence with the whole input.
pub fn from_typed_input(text: &str) -> Result<Value, String> {
    from_typed(text).map_err(|error| format!("{text}: {error}"))
}

/// Parses user input for a variable that now holds `current`: plain data of its type.
///
/// An ambiguous input is refused, because `3,14` for a float is more likely a decimal comma than the I4 14. The exception is an
/// array: `TYPE,DATA` with the variable's own type and length is one value too long to be plain data.
///
/// # Errors
///
/// A sentence with the whole input.
pub fn from_input(text: &str, current: Variant<'_>) -> Result<Value, String> {
    let vartype = current.vartype();
    if [VarType::EMPTY, VarType::NULL, VarType::VARIANT].contains(&vartype) {
        return Err(format!("{text}: the variable's type is unknown; TYPE,DATA needs --typed"));
    }
    let (with_type, holds) = (from_typed(text), expected(current));
    // an empty array does not show its permitted length
    let fits = |value: &Value| match (elements(value.as_variant()), elements(current)) {
        (Some(_), Some(0)) => true,
        (found, holds) => found == holds,
    };
    let is_own = |value: &Value| value.as_variant().vartype() == vartype;
    let hint = hint(text, current);
    let needs_typed = if hint.is_empty() { "; TYPE,DATA needs --typed" } else { " TYPE,DATA needs --typed" };
    match (from_data(vartype, text), with_type) {
        // any text is plain data of a string, and any length fits an empty array
        (Ok(_), Ok(value)) if is_own(&value) && (vartype == VarType::BSTR || elements(current) == Some(0)) => {
            Err(format!(
                "{text}: this could be TYPE,DATA or plain data{holds}; write --typed {text} or --typed {},{text}",
                vartype.0
            ))
        }
        (Ok(plain), _) if fits(&plain) => Ok(plain),
        (_, Ok(value)) if vartype.is_array() && is_own(&value) && fits(&value) => Ok(value),
        (_, Ok(_)) => Err(format!("{text}: this could be TYPE,DATA{holds}{hint}{needs_typed}")),
        (Ok(plain), Err(_)) => Err(match elements(plain.as_variant()) {
            Some(1) => format!("{text}: this is 1 value{holds}{hint}"),
            found => format!("{text}: these are {} values{holds}{hint}", found.unwrap_or_default()),
        }),
        (Err(error), Err(_)) => {
            let error = shifted(error, vartype);
            let typed = if vartype.is_array() || !text.contains(',') { "" } else { needs_typed };
            Err(format!("{text}: {error}{holds}{hint}{typed}"))
        }
    }
}

/// Parses user input that is going to be written to a variable that now holds `current`.
///
/// Rarely meant values are refused unless the user writes their type: a number that is not finite, a BOOL that is neither 0 nor
/// 1, and a P or T whose figure is not a whole number.
///
/// # Errors
///
/// A sentence with the whole input.
pub fn to_write(name: &str, text: &str, current: Variant<'_>) -> Result<Value, String> {
    let value = from_input(text, current)?;
    if from_typed(text).is_ok_and(|typed| typed == value) {
        return Ok(value);
    }
    let (vartype, found) = (current.vartype(), value.as_variant());
    let wrong = match vartype.element() {
        VarType::R4 | VarType::R8 if !is_finite(found) => "a number is not finite",
        VarType::R4 | VarType::R8 if !has_figure(name, found) => "the figure is not a whole number",
        VarType::BOOL if !text.split(',').all(is_bool) => "a BOOL is true, false, on, off, 0, 1 or -1",
        _ => return Ok(value),
    };
    Err(format!("{text}: {wrong}; if that is intended, write --typed {},{text}", vartype.0))
}

/// Returns whether all numbers of a value are finite.
fn is_finite(value: Variant<'_>) -> bool {
    let is_finite = |number: Variant<'_>| number.as_f64().is_none_or(f64::is_finite);
    value.as_array().map_or_else(|| is_finite(value), |array| array.iter().all(is_finite))
}

/// Returns whether the last element of a P or T is a figure. Other variables have none.
fn has_figure(name: &str, value: Variant<'_>) -> bool {
    match name.split_at_checked(1) {
        Some((_, number)) if number.trim_matches(['[', ']']).parse::<u32>().is_err() => true,
        Some(("P" | "p", _)) => value.convert::<Position>().is_ok(),
        Some(("T" | "t", _)) => value.convert::<Transform>().is_ok(),
        _ => true,
    }
}

/// Returns whether a word is the usual text of a BOOL.
fn is_bool(word: &str) -> bool {
    ["true", "false", "on", "off", "0", "1", "-1"].iter().any(|usual| word.trim().eq_ignore_ascii_case(usual))
}

/// Describes the data that a variable takes, for an error.
fn expected(current: Variant<'_>) -> String {
    match current {
        Variant::Array(array) => format!("; the variable holds {} of {}", array.len(), array.element()),
        scalar => format!("; the variable holds {}", scalar.vartype()),
    }
}

/// Returns a suggestion that can be written unchanged: a point for a decimal comma, no separators of thousands, commas between
/// the elements of an array. It is empty if none of them is a value of the variable.
fn hint(text: &str, current: Variant<'_>) -> String {
    let groups: Vec<&str> = text.split(',').collect();
    let joined = match (current.vartype(), groups.as_slice()) {
        (vartype, _) if vartype.is_array() => {
            let words = text.split(|c: char| c.is_whitespace() || ";,".contains(c));
            words.filter(|word| !word.is_empty()).collect::<Vec<_>>().join(",")
        }
        (VarType::R4 | VarType::R8, [whole, part]) => format!("{whole}.{part}"),
        (_, [_, thousands @ ..]) if thousands.iter().all(|group| group.len() == 3) => groups.concat(),
        _ => return String::new(),
    };
    match from_data(current.vartype(), &joined) {
        Ok(value) if joined != text && elements(value.as_variant()) == elements(current) => {
            format!("; did you mean {joined}?")
        }
        _ => String::new(),
    }
}

/// Formats a value for people: its data, or its `Debug` form if the data have no readable text.
///
/// RAC writes a date as a number if its text is not exact; then the `Debug` form shows the date. The numbers of an array of
/// R8, such as a pose, have at most 15 digits: the 16th and 17th are often the rounding errors of a computation.
#[must_use]
pub fn format(value: Variant<'_>) -> String {
    match value {
        Variant::Bool(value) => value.to_string(),
        Variant::Array(array) if !array.is_empty() && array.element() == VarType::BOOL => {
            array.iter().map(format).collect::<Vec<_>>().join(",")
        }
        Variant::Array(array) if array.element() == VarType::R8 => {
            let rounded: Vec<f64> = array.iter().filter_map(|number| number.as_f64()).map(rounded).collect();
            Value::new(rounded.as_slice()).map_or_else(|_| data_of(value), |value| data_of(value.as_variant()))
        }
        value => data_of(value),
    }
}

/// Rounds to 15 significant digits, which a double always has.
fn rounded(number: f64) -> f64 {
    format!("{number:.14e}").parse().unwrap_or(number)
}

fn data_of(value: Variant<'_>) -> String {
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
    TextError::new(error.kind, error.column.saturating_sub(prefix))
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
            Err(error) => error,
        }
    }

    #[test]
    fn plain_data_take_the_type_of_the_variable() {
        assert_eq!(input("5", &1_i32), "3,5");
        assert_eq!(input("-5", &1_i32), "3,-5");
        assert_eq!(input("0", &7_i32), "3,0");
        assert_eq!(input("1", &7.5_f64), "5,1");
        assert_eq!(input("2.5", &1_f32), "4,2.5");
        assert_eq!(input("1e300", &1_f64), "5,1e300");
        assert_eq!(input("hello, world", &"x"), "8,hello, world");
        assert_eq!(input("3,5", &"x"), "8,3,5");
        assert_eq!(input("1,2,3", &[0_f32; 3]), "8196,1,2,3");
        assert_eq!(input("true", &false), "11,-1");
        assert_eq!(input("OFF", &false), "11,0");
        assert_eq!(input("1", &false), "11,-1");
        assert_eq!(input("on, 0", &[false; 2]), "8203,-1,0");
    }

    #[test]
    fn a_type_before_the_data_of_an_array_is_recognised() {
        assert_eq!(input("8196,1,2,3", &[0_f32; 3]), "8196,1,2,3");
        assert_eq!(input("8196,1,2", &[0_f32; 3]), "8196,8196,1,2");
    }

    #[test]
    fn what_could_mean_two_things_is_refused() {
        let typed = "TYPE,DATA needs --typed";
        assert_eq!(
            input("3,14", &1_f64),
            format!("3,14: this could be TYPE,DATA; the variable holds VT_R8; did you mean 3.14? {typed}")
        );
        assert_eq!(
            input("1,234,567", &1_i32),
            format!(
                "1,234,567: text after the end of the value at column 2; the variable holds VT_I4; did you mean 1234567? {typed}"
            )
        );
        assert_eq!(input("0,", &7_i32), format!("0,: this could be TYPE,DATA; the variable holds VT_I4; {typed}"));
        assert_eq!(input("3,7", &()), format!("3,7: the variable's type is unknown; {typed}"));
        let error = "8196,1: this could be TYPE,DATA or plain data; the variable holds 0 of VT_R4; write --typed 8196,1 or \
                     --typed 8196,8196,1";
        assert_eq!(input("8196,1", &[0_f32; 0]), error);
        assert_eq!(input("1,2", &[0_f32; 0]), "8196,1,2");
        assert_eq!(input("1,2", &[0_f32; 3]), "1,2: these are 2 values; the variable holds 3 of VT_R4");
        assert_eq!(input("1", &[0_f32; 3]), "1: this is 1 value; the variable holds 3 of VT_R4");
    }

    #[test]
    fn what_is_rarely_meant_is_written_only_with_its_type() {
        let write = |text: &str, current: &dyn Encode| {
            to_write("V1", text, Value::new(current).unwrap().as_variant())
                .map(|value| value::to_text(value.as_variant()).unwrap())
        };
        let finite = "a number is not finite; if that is intended, write --typed";
        assert_eq!(write("nan", &1_f32).unwrap_err(), format!("nan: {finite} 4,nan"));
        assert_eq!(write("-inf", &1_f64).unwrap_err(), format!("-inf: {finite} 5,-inf"));
        assert_eq!(write("1,nan,3", &[0_f32; 3]).unwrap_err(), format!("1,nan,3: {finite} 8196,1,nan,3"));
        let usual = "a BOOL is true, false, on, off, 0, 1 or -1; if that is intended, write --typed";
        assert_eq!(write("5", &false).unwrap_err(), format!("5: {usual} 11,5"));
        assert_eq!(write("1,2", &[false; 2]).unwrap_err(), format!("1,2: {usual} 8203,1,2"));
        // with its type, and the usual type
        assert_eq!(write("8196,1,nan,3", &[0_f32; 3]).unwrap(), "8196,1,NaN,3");
        assert_eq!(write("-1", &false).unwrap(), "11,-1");
        assert_eq!(write(" On", &false).unwrap(), "11,-1");
        assert_eq!(write("nan", &"").unwrap(), "8,nan");
        assert_eq!(write("5", &1_i32).unwrap(), "3,5");
    }

    #[test]
    fn errors_have_columns_of_the_input() {
        assert_eq!(input("12x", &1_i32), "12x: not a digit of the number at column 3; the variable holds VT_I4");
        let error = "1,2,x: not a digit of the number at column 5; the variable holds 3 of VT_R4";
        assert_eq!(input("1,2,x", &[0_f32; 3]), error);
        assert_eq!(from_typed_input("1").unwrap_err(), "1: a comma is missing after the VARTYPE at column 2");
    }

    #[test]
    fn values_are_printed_without_their_type() {
        let plain = |value: &dyn Encode| format(Value::new(value).unwrap().as_variant());
        assert_eq!(plain(&5_i32), "5");
        assert_eq!(plain(&[1.5_f32, -2.0]), "1.5,-2");
        assert_eq!(plain(&[400.000_000_000_000_06, 0.0]), "400,0");
        assert_eq!(plain(&true), "true");
        assert_eq!(plain(&[true, false]), "true,false");
        assert_eq!(plain(&[0_f64; 0]), "R8[]");
        assert_eq!(plain(&"a,b"), "a,b");
        assert_eq!(plain(&""), "");
        assert_eq!(plain(&()), "EMPTY");
        assert_eq!(plain(&OleDate::from_raw(1.5)), "1899/12/31 12:00:00");
        assert_eq!(plain(&OleDate::from_raw(1.123)), format!("{:?}", Variant::Date(OleDate::from_raw(1.123))));
        assert_eq!(plain(&[0_i32; 0]), "I4[]");
    }
}
