//! Values as text.

use super::grammar::StringContext;
use crate::error::TextErrorKind;
use crate::num::{to_u32, to_usize};
use crate::variant::float::{FloatFormat, divide_by_10, low};
use crate::variant::{Bstr, CivilTime, OUTER, OleDate, VarType, Variant, bstr};
use crate::wire::{Reader, Writer};

type Printed = Result<(), TextErrorKind>;

#[cfg_attr(target_os = "none", inline(never))]
fn put(bytes: &[u8], out: &mut Writer<'_>) -> Printed {
    out.put_slice(bytes).map_err(|_| TextErrorKind::Full)
}

#[cfg_attr(target_os = "none", inline(never))]
fn put_byte(byte: u8, out: &mut Writer<'_>) -> Printed {
    out.put([byte]).map_err(|_| TextErrorKind::Full)
}

fn put_type(vartype: VarType, out: &mut Writer<'_>) -> Printed {
    put_integer(false, u64::from(vartype.0), out)?;
    put_byte(b',', out)
}

pub(super) fn print(value: Variant<'_>, out: &mut Writer<'_>) -> Printed {
    if let Variant::Opaque(opaque) = value {
        return Err(TextErrorKind::Unsendable(opaque.vartype.0));
    }
    put_type(value.vartype(), out)?;
    match value {
        Variant::Nested(nested) => print_inner(&mut Reader::new(nested.0), 1, out),
        Variant::Array(array) if array.element() == VarType::VARIANT => {
            print_inner(&mut Reader::new(array.as_bytes()), to_u32(array.len()), out)
        }
        Variant::Array(array) => {
            let context = StringContext { nested: false, in_array: true };
            print_elements(array.element(), to_u32(array.len()), context, &mut Reader::new(array.as_bytes()), out)
        }
        scalar => print_scalar(scalar, StringContext { nested: false, in_array: false }, out),
    }
}

/// Writes `count` values of a container, each in parentheses, with their contents.
fn print_inner(r: &mut Reader<'_>, count: u32, out: &mut Writer<'_>) -> Printed {
    // remaining values of each outer level; `here` counts the innermost
    let mut outer = [0_u32; OUTER];
    let mut depth = 0_usize;
    let mut here = count;
    loop {
        here = here.checked_sub(1).ok_or(TextErrorKind::EmptyArray)?;
        put_byte(b'(', out)?;
        let (vartype, count) = split_head(r).unwrap_or_default();
        put_type(vartype, out)?;
        if vartype.element() == VarType::VARIANT {
            *outer.get_mut(depth).ok_or(TextErrorKind::TooDeep)? = here;
            depth = depth.wrapping_add(1);
            here = count;
            continue;
        }
        print_elements(vartype.element(), count, StringContext { nested: true, in_array: vartype.is_array() }, r, out)?;
        put_byte(b')', out)?;
        while here == 0 {
            let Some(up) = depth.checked_sub(1) else { return Ok(()) };
            depth = up;
            here = outer.get(up).copied().unwrap_or(0);
            put_byte(b')', out)?;
        }
        put_byte(b',', out)?;
    }
}

/// Splits type and count off a validated value; the count of a scalar is 1.
fn split_head(r: &mut Reader<'_>) -> Option<(VarType, u32)> {
    let vartype = VarType(u16::from_le_bytes(r.array()?));
    let count = r.u32()?;
    Some((vartype, if vartype.is_array() { count } else { 1 }))
}

/// Writes the elements of an array, or the one of a scalar; they hold no VARIANT.
fn print_elements(
    element: VarType,
    count: u32,
    context: StringContext,
    r: &mut Reader<'_>,
    out: &mut Writer<'_>,
) -> Printed {
    match element {
        VarType::EMPTY | VarType::NULL if context.in_array => return Err(TextErrorKind::ArrayOfNothing),
        _ if count == 0 => return Err(TextErrorKind::EmptyArray),
        _ => {}
    }
    for index in 0..to_usize(count) {
        if index > 0 {
            put_byte(b',', out)?;
        }
        print_scalar(Variant::read_data(element, r), context, out)?;
    }
    Ok(())
}

fn print_scalar(value: Variant<'_>, context: StringContext, out: &mut Writer<'_>) -> Printed {
    let number = match value {
        Variant::R4(n) => return print_float(u64::from(n.to_bits()), FloatFormat::Single, out),
        Variant::R8(n) => return print_float(n.to_bits(), FloatFormat::Double, out),
        Variant::Date(date) => return print_date(date, out),
        Variant::Bstr(text) => return print_string(text, context, out),
        Variant::Ui8(n) => return put_integer(false, n, out),
        Variant::Bool(b) => i64::from(b).wrapping_neg(),
        Variant::Error(code) => i64::from(code.0),
        Variant::Cy(amount) => amount.raw(),
        other => match other.as_i64() {
            Some(n) => n,
            // EMPTY and NULL
            None => return Ok(()),
        },
    };
    put_integer(number < 0, number.unsigned_abs(), out)
}

/// Digits of the largest 64-bit number.
const MAX_INTEGER: usize = 20;

/// Writes a decimal number.
pub(crate) fn put_integer(negative: bool, magnitude: u64, out: &mut Writer<'_>) -> Printed {
    if negative {
        put_byte(b'-', out)?;
    }
    if magnitude < 10 {
        return put_byte(digit(low(magnitude)), out);
    }
    put(decimal_digits(magnitude, &mut [0; MAX_INTEGER]), out)
}

/// Writes the digits of a number other than 0 to the end of a buffer, and returns them.
fn decimal_digits(number: u64, buffer: &mut [u8; MAX_INTEGER]) -> &[u8] {
    let (mut left, mut from) = (number, buffer.len());
    for slot in buffer.iter_mut().rev() {
        if left == 0 {
            break;
        }
        let last;
        (left, last) = divide_by_10(left);
        *slot = digit(last);
        from = from.wrapping_sub(1);
    }
    buffer.get(from..).unwrap_or_default()
}

#[inline]
fn digit(number: u32) -> u8 {
    b'0' | u8::try_from(number).unwrap_or(0)
}

/// Writes a number of a date, after a zero if it is below `least`.
fn put_padded(least: u16, number: u16, out: &mut Writer<'_>) -> Printed {
    if number < least {
        put_byte(b'0', out)?;
    }
    put_integer(false, u64::from(number), out)
}

/// Writes a float, given as its bits.
///
/// It has no exponent if that takes at most 16 digits before the point, or four zeros after it.
fn print_float(bits: u64, format: FloatFormat, out: &mut Writer<'_>) -> Printed {
    let magnitude = bits & !format.sign();
    if magnitude > format.infinity() && magnitude != format.nan() {
        return Err(TextErrorKind::NanPayload);
    }
    if magnitude != bits {
        put_byte(b'-', out)?;
    }
    if magnitude >= format.infinity() {
        return put(if magnitude == format.infinity() { b"inf" } else { b"NaN" }, out);
    }
    if let Some(whole) = format.whole(magnitude) {
        return put_integer(false, whole, out);
    }
    let (number, exponent) = format.digits(magnitude);
    let mut buffer = [0; MAX_INTEGER];
    put_decimal(decimal_digits(number, &mut buffer), exponent, out)
}

/// Writes `digits * 10^exponent`, the last digit of which is not 0.
fn put_decimal(digits: &[u8], exponent: i32, out: &mut Writer<'_>) -> Printed {
    // digits before the point
    let point = exponent.wrapping_add_unsigned(to_u32(digits.len()));
    let (front, zeros) = match point {
        1..=16 => (point, exponent.max(0)),
        -4..=0 => (0, point.wrapping_neg()),
        _ => (1, 0),
    };
    let (integer, fraction) = digits.split_at_checked(to_usize(front.unsigned_abs())).unwrap_or((digits, &[]));
    if front == 0 {
        put(b"0.", out)?;
    }
    put(integer, out)?;
    (0..zeros).try_for_each(|_| put_byte(b'0', out))?;
    if front > 0 && !fraction.is_empty() {
        put_byte(b'.', out)?;
    }
    put(fraction, out)?;
    if (-4..=16).contains(&point) {
        return Ok(());
    }
    put_byte(b'e', out)?;
    let exponent = point.wrapping_sub(1);
    put_integer(exponent < 0, u64::from(exponent.unsigned_abs()), out)
}

fn print_date(date: OleDate, out: &mut Writer<'_>) -> Printed {
    let same = |civil: &CivilTime| civil.millisecond == 0 && OleDate::from_civil(*civil) == Some(date);
    let Some(civil) = date.to_civil().filter(same) else {
        return print_float(date.raw().to_bits(), FloatFormat::Double, out);
    };
    let numbers = [civil.month, civil.day, civil.hour, civil.minute, civil.second];
    put_padded(1000, civil.year.unsigned_abs(), out)?;
    for (separator, number) in b"// ::".iter().zip(numbers) {
        put_byte(*separator, out)?;
        put_padded(10, u16::from(number), out)?;
    }
    Ok(())
}

fn print_string(text: Bstr<'_>, context: StringContext, out: &mut Writer<'_>) -> Printed {
    let mut open = 0_u32;
    let mut first = true;
    for c in text.chars() {
        let c = c.map_err(|_| TextErrorKind::LoneSurrogate)?;
        match c {
            ' ' | '\t' if first => return Err(TextErrorKind::LeadingBlank),
            '\r' | '\n' => return Err(TextErrorKind::LineBreak),
            ',' if context.in_array => return Err(TextErrorKind::CommaInString),
            '(' => open = open.wrapping_add(1),
            ')' if context.nested || context.in_array => open = open.checked_sub(1).ok_or(TextErrorKind::Unbalanced)?,
            _ => {}
        }
        first = false;
        let slot = out.reserve(c.len_utf8()).map_err(|_| TextErrorKind::Full)?;
        bstr::put_utf8(c, slot).ok_or(TextErrorKind::Full)?;
    }
    if open > 0 && (context.nested || context.in_array) { Err(TextErrorKind::Unbalanced) } else { Ok(()) }
}
