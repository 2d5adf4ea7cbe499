//! Structured input: values made from bytes.

use arbitrary::{Arbitrary, Result, Unstructured};
use bcap_testkit::value::{VARIANT, Value};

/// Both strictnesses.
pub(crate) const BOTH: [bcap_core::limits::Strictness; 2] =
    [bcap_core::limits::Strictness::Strict, bcap_core::limits::Strictness::Lenient];

/// The VARTYPEs of scalars, but for VARIANT.
const SCALARS: [u16; 16] = [0, 1, 2, 3, 4, 5, 6, 7, 8, 10, 11, 17, 18, 19, 20, 21];

/// Any value, nested up to six deep.
#[derive(Clone, Debug)]
pub(crate) struct AnyValue(pub(crate) Value);

impl<'a> Arbitrary<'a> for AnyValue {
    fn arbitrary(u: &mut Unstructured<'a>) -> Result<Self> {
        value(u, 6).map(Self)
    }
}

fn value(u: &mut Unstructured<'_>, depth: usize) -> Result<Value> {
    let kind = u.int_in_range(0..=7)?;
    Ok(match kind {
        0 if depth > 0 => Value::Nested(Box::new(value(u, depth - 1)?)),
        1 | 2 if depth > 0 => {
            let count = u.int_in_range(0..=4)?;
            Value::Array(VARIANT, (0..count).map(|_| value(u, depth - 1)).collect::<Result<_>>()?)
        }
        3 | 4 => {
            let (element, count) = (*u.choose(&SCALARS)?, u.int_in_range(0..=5)?);
            Value::Array(element, (0..count).map(|_| scalar(element, u)).collect::<Result<_>>()?)
        }
        _ => {
            let vartype = *u.choose(&SCALARS)?;
            scalar(vartype, u)?
        }
    })
}

fn scalar(vartype: u16, u: &mut Unstructured<'_>) -> Result<Value> {
    Ok(match vartype {
        0 => Value::Empty,
        1 => Value::Null,
        2 => Value::I2(u.arbitrary()?),
        3 => Value::I4(u.arbitrary()?),
        4 => Value::R4(u.arbitrary()?),
        5 => Value::R8(double_bits(u)?),
        6 => Value::Cy(u.arbitrary()?),
        7 => Value::Date(date_bits(u)?),
        8 => Value::Bstr(units(u)?),
        10 => Value::Error(u.arbitrary()?),
        11 => Value::Bool(u.arbitrary()?),
        17 => Value::Ui1(u.arbitrary()?),
        18 => Value::Ui2(u.arbitrary()?),
        19 => Value::Ui4(u.arbitrary()?),
        20 => Value::I8(u.arbitrary()?),
        _ => Value::Ui8(u.arbitrary()?),
    })
}

/// Doubles: any bits, integers, hundredths.
fn double_bits(u: &mut Unstructured<'_>) -> Result<u64> {
    Ok(match u.int_in_range(0..=3)? {
        0 => f64::from(u.arbitrary::<i32>()?).to_bits(),
        1 => (f64::from(u.arbitrary::<i32>()?) / 100.0).to_bits(),
        _ => u.arbitrary()?,
    })
}

/// Dates: any double, or a whole second of a recent year.
fn date_bits(u: &mut Unstructured<'_>) -> Result<u64> {
    if u.arbitrary()? {
        return double_bits(u);
    }
    let seconds = u.int_in_range(-60_000_000_000_i64..=250_000_000_000)?;
    Ok((seconds as f64 / 86_400.0).to_bits())
}

/// Strings: characters with a meaning in the text format, or any units.
fn units(u: &mut Unstructured<'_>) -> Result<Vec<u16>> {
    const SPECIAL: &[u8] = b"(),=: \t\r\n0aZ";
    let count = u.int_in_range(0..=12)?;
    (0..count)
        .map(|_| {
            let byte: u8 = u.arbitrary()?;
            Ok(match byte {
                0..128 => u16::from(SPECIAL[usize::from(byte) % SPECIAL.len()]),
                128..224 => u16::from(byte - 96),
                _ => u.arbitrary()?,
            })
        })
        .collect()
}

/// Splits `bytes` into chunks with the sizes of `sizes`, repeated; without sizes, returns one chunk.
pub(crate) fn chunks<'a>(bytes: &'a [u8], sizes: &'a [u8]) -> impl Iterator<Item = &'a [u8]> {
    let mut rest = bytes;
    let mut sizes = sizes.iter().cycle();
    std::iter::from_fn(move || {
        let most = sizes.next().map_or(rest.len(), |size| usize::from(*size) + 1);
        let (chunk, behind) = rest.split_at(most.min(rest.len()));
        rest = behind;
        (!chunk.is_empty()).then_some(chunk)
    })
}
