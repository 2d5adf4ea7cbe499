//! `arbitrary::Arbitrary` for values and frames, and a source of bytes from a seed.
//!
//! A fuzzer that has bytes passes them to [`Unstructured`]; a test that has only a seed takes [`bytes`].

use arbitrary::{Arbitrary, Result, Unstructured};

use crate::damage::Damage;
use crate::frame::TestFrame;
use crate::network::Random;
use crate::value::{SCALARS, VARIANT, Value};

/// Returns `count` bytes that depend only on the seed.
#[must_use]
pub fn bytes(seed: u64, count: usize) -> Vec<u8> {
    let mut random = Random(seed);
    std::iter::repeat_with(|| random.number().to_le_bytes()).flatten().take(count).collect()
}

/// Any value, nested up to six deep.
impl<'a> Arbitrary<'a> for Value {
    fn arbitrary(u: &mut Unstructured<'a>) -> Result<Self> {
        value(u, 6)
    }
}

/// A frame of any code with up to five values.
impl<'a> Arbitrary<'a> for TestFrame {
    fn arbitrary(u: &mut Unstructured<'a>) -> Result<Self> {
        let (serial, reserved, code) = (u.arbitrary()?, u.arbitrary()?, u.arbitrary()?);
        let args = (0..u.int_in_range(0..=5)?).map(|_| u.arbitrary()).collect::<Result<_>>()?;
        Ok(Self { serial, reserved, code, args })
    }
}

impl<'a> Arbitrary<'a> for Damage {
    fn arbitrary(u: &mut Unstructured<'a>) -> Result<Self> {
        let at = u.arbitrary()?;
        Ok(match u.int_in_range(0..=8)? {
            0..=2 => Self::Set(at, u.arbitrary()?),
            3..=5 => Self::Add(at, *u.choose(&[-2, -1, 1, 2, 32])?),
            6 => Self::Insert(at, u.arbitrary()?),
            7 => Self::Remove(at),
            _ => Self::Truncate(at),
        })
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
