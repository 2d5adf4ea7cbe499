//! proptest strategies for values, frames and damaged frames.

use proptest::collection::vec;
use proptest::prelude::*;

use crate::damage::{Damage, damaged};
use crate::frame::TestFrame;
use crate::value::{SCALARS, VARIANT, Value};

/// Strings: plain text, any 16-bit units, surrogates without partners, NULs.
pub fn units() -> impl Strategy<Value = Vec<u16>> {
    let unit = prop_oneof![
        4 => 0x20_u16..0x7f,
        1 => any::<u16>(),
        1 => 0xd800_u16..=0xdfff,
        1 => Just(0_u16),
    ];
    prop_oneof![vec(unit, 0..12), any::<String>().prop_map(|text| text.encode_utf16().take(16).collect()),]
}

/// Scalars of one type, except VARIANT.
///
/// # Panics
///
/// When the VARTYPE is invalid.
pub fn scalar_of(vartype: u16) -> BoxedStrategy<Value> {
    match vartype {
        0 => Just(Value::Empty).boxed(),
        1 => Just(Value::Null).boxed(),
        2 => any::<i16>().prop_map(Value::I2).boxed(),
        3 => any::<i32>().prop_map(Value::I4).boxed(),
        4 => float_bits().prop_map(|n| Value::R4((f64::from_bits(n) as f32).to_bits())).boxed(),
        5 => float_bits().prop_map(Value::R8).boxed(),
        6 => any::<i64>().prop_map(Value::Cy).boxed(),
        7 => float_bits().prop_map(Value::Date).boxed(),
        8 => units().prop_map(Value::Bstr).boxed(),
        10 => any::<i32>().prop_map(Value::Error).boxed(),
        11 => any::<bool>().prop_map(Value::Bool).boxed(),
        17 => any::<u8>().prop_map(Value::Ui1).boxed(),
        18 => any::<u16>().prop_map(Value::Ui2).boxed(),
        19 => any::<u32>().prop_map(Value::Ui4).boxed(),
        20 => any::<i64>().prop_map(Value::I8).boxed(),
        21 => any::<u64>().prop_map(Value::Ui8).boxed(),
        other => panic!("{other} is no VARTYPE of a scalar"),
    }
}

/// Bits of doubles: any, and those typical of robots.
fn float_bits() -> impl Strategy<Value = u64> {
    prop_oneof![
        any::<u64>(),
        (-1000.0..1000.0_f64).prop_map(f64::to_bits),
        (-100_000..100_000_i32).prop_map(|n| (f64::from(n) / 100.0).to_bits()),
    ]
}

/// A VARTYPE of [`SCALARS`].
fn vartype() -> impl Strategy<Value = u16> {
    prop::sample::select(&SCALARS[..])
}

/// Scalars of every type.
pub fn scalar() -> impl Strategy<Value = Value> {
    vartype().prop_flat_map(scalar_of)
}

/// Arrays of every type except VARIANT, including empty arrays.
pub fn plain_array() -> impl Strategy<Value = Value> {
    vartype().prop_flat_map(|element| vec(scalar_of(element), 0..6).prop_map(move |items| Value::Array(element, items)))
}

/// Values of every kind, nested up to six deep.
pub fn value() -> impl Strategy<Value = Value> {
    let leaf = prop_oneof![3 => scalar(), 1 => plain_array()];
    leaf.prop_recursive(6, 24, 4, |inner| {
        prop_oneof![
            3 => vec(inner.clone(), 0..4).prop_map(|items| Value::Array(VARIANT, items)),
            1 => inner.prop_map(|value| Value::Nested(Box::new(value))),
        ]
    })
}

/// Frames of any code with up to five values.
pub fn frame() -> impl Strategy<Value = TestFrame> {
    (any::<u16>(), any::<u16>(), any::<i32>(), vec(value(), 0..5))
        .prop_map(|(serial, reserved, code, args)| TestFrame { serial, reserved, code, args })
}

/// Damage of every kind.
pub fn damage() -> impl Strategy<Value = Damage> {
    prop_oneof![
        3 => (any::<u16>(), any::<u8>()).prop_map(|(at, byte)| Damage::Set(at, byte)),
        3 => (any::<u16>(), prop::sample::select(&[-2_i8, -1, 1, 2, 32][..])).prop_map(|(at, n)| Damage::Add(at, n)),
        1 => (any::<u16>(), any::<u8>()).prop_map(|(at, byte)| Damage::Insert(at, byte)),
        1 => any::<u16>().prop_map(Damage::Remove),
        1 => any::<u16>().prop_map(Damage::Truncate),
    ]
}

/// Encoded frames with damage; some have a corrected length field, so that the decoder reaches the damage.
pub fn damaged_frame() -> impl Strategy<Value = Vec<u8>> {
    (frame(), vec(damage(), 1..4), any::<bool>()).prop_map(|(frame, damages, fixes)| damaged(&frame, &damages, fixes))
}
