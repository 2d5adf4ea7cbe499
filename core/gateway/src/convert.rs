//! Conversion of values between a PLC and a robot: from one numeric type to another, if it is lossless.
//!
//! ```text
//!  to     from, if the number stays the same
//!  I4     any integer, R4 and R8 without a fraction
//!  R4 R8  any integer, R4, R8
//!  BOOL   the integers 0, 1 and -1
//!  BSTR   nothing else
//!  R4[n]  n elements of any type that converts to R4, also VARIANTs
//! ```
//!
//! The same means the same bits after the conversion back: 0.1 as R8 does not convert to R4, and -0.0 not to an integer.

use bcap_core::error::EncodeError;
use bcap_core::rac::VariableKind;
use bcap_core::variant::{Element, Encode, VarType, Variant, Writer};

/// Returns whether a value converts to the type of a variable of this kind without loss.
pub(super) fn converts(kind: VariableKind, value: &Variant<'_>) -> bool {
    match (value.flatten(), kind.vartype()) {
        (Variant::Array(array), to) => {
            to.is_array()
                && array.len() == kind.elements()
                && array.iter().all(|element| scalar(to.element(), &element).is_some())
        }
        (value, to) => !to.is_array() && scalar(to, &value).is_some(),
    }
}

/// A value that is encoded in the type of `kind`; unchanged if it cannot be converted.
pub(super) struct Converted<'a> {
    pub(super) kind: VariableKind,
    pub(super) value: Variant<'a>,
}

impl Encode for Converted<'_> {
    fn encode(&self, out: &mut Writer<'_>) -> Result<(), EncodeError> {
        if self.kind.fits(&self.value) || !converts(self.kind, &self.value) {
            return self.value.encode(out);
        }
        match self.value.flatten() {
            Variant::Array(array) => {
                // only V, P, J and T contain arrays
                out.put(VarType::R4.array_of().0.to_le_bytes())?;
                out.put(u32::try_from(array.len()).unwrap_or(u32::MAX).to_le_bytes())?;
                array.iter().try_for_each(|element| match scalar(VarType::R4, &element) {
                    Some(Variant::R4(number)) => number.put(out),
                    _ => Err(EncodeError::Unsendable(element.vartype().0)),
                })
            }
            value => scalar(self.kind.vartype(), &value).unwrap_or(value).encode(out),
        }
    }
}

/// Converts a value that is not an array; `None` if it would lose something.
fn scalar<'a>(to: VarType, value: &Variant<'a>) -> Option<Variant<'a>> {
    let value = value.flatten();
    match to {
        _ if value.vartype() == to => Some(value),
        VarType::I4 => value.as_i32().or_else(|| whole(float(&value)?)).map(Variant::I4),
        VarType::R4 => single(float(&value)?).map(Variant::R4),
        VarType::R8 => float(&value).map(Variant::R8),
        VarType::BOOL => match value.as_i64()? {
            0 => Some(Variant::Bool(false)),
            1 | -1 => Some(Variant::Bool(true)),
            _ => None,
        },
        _ => None,
    }
}

/// Returns the number as an R8, if that is lossless.
#[expect(clippy::as_conversions, reason = "compared with the number it came from")]
pub(super) fn float(value: &Variant<'_>) -> Option<f64> {
    value.as_f64().or_else(|| {
        let number = value.as_i64()?;
        let float = number as f64;
        // 2^63 would convert back to the largest number, which is one less
        (float as i64 == number && number != i64::MAX).then_some(float)
    })
}

/// Returns the number as an R4, if that is lossless.
#[expect(clippy::as_conversions, reason = "compared with the number it came from")]
fn single(number: f64) -> Option<f32> {
    let single = number as f32;
    (f64::from(single).to_bits() == number.to_bits()).then_some(single)
}

/// Returns the number as an I4, if that is lossless.
#[expect(clippy::as_conversions, reason = "compared with the number it came from")]
fn whole(number: f64) -> Option<i32> {
    let whole = number as i32;
    (f64::from(whole).to_bits() == number.to_bits()).then_some(whole)
}

#[cfg(test)]
mod tests {
    use super::*;
    use VariableKind as Kind;
    use bcap_core::variant::VariantBuf;

    /// Returns the converted value; `None` if it does not convert.
    fn converted(kind: Kind, value: &dyn Encode) -> Option<VariantBuf<128>> {
        let value = VariantBuf::<128>::new(value).unwrap();
        let encoded = VariantBuf::new(&Converted { kind, value: value.as_variant() }).unwrap();
        let is_converted = converts(kind, &value.as_variant());
        assert_eq!(kind.fits(&encoded.as_variant()), is_converted);
        if !is_converted {
            assert_eq!(encoded, value, "a value that does not convert is unchanged");
        }
        is_converted.then_some(encoded)
    }

    fn becomes(kind: Kind, value: &dyn Encode, expected: &dyn Encode) {
        assert_eq!(converted(kind, value), Some(VariantBuf::new(expected).unwrap()));
    }

    #[test]
    fn lossless_conversions() {
        becomes(Kind::I, &7_i32, &7_i32);
        becomes(Kind::I, &7_i16, &7_i32);
        becomes(Kind::I, &u64::from(u32::MAX >> 1), &i32::MAX);
        becomes(Kind::I, &-3.0_f64, &-3_i32);
        becomes(Kind::I, &f64::from(i32::MIN), &i32::MIN);
        becomes(Kind::F, &5_i32, &5.0_f32);
        becomes(Kind::F, &0.5_f64, &0.5_f32);
        becomes(Kind::F, &-0.0_f64, &-0.0_f32);
        becomes(Kind::F, &f64::INFINITY, &f32::INFINITY);
        becomes(Kind::D, &0.1_f32, &f64::from(0.1_f32));
        becomes(Kind::D, &(1_i64 << 60), &1_152_921_504_606_846_976.0_f64);
        becomes(Kind::D, &i64::MIN, &-9_223_372_036_854_775_808.0_f64);
        becomes(Kind::Io, &-1_i16, &true);
        becomes(Kind::Io, &0_u8, &false);
    }

    #[test]
    fn lossy_conversions_are_refused() {
        let refused: [(Kind, &dyn Encode); 16] = [
            (Kind::I, &0.5_f64),
            (Kind::I, &-0.0_f64),
            (Kind::I, &3e9_f64),
            (Kind::I, &f64::NAN),
            (Kind::I, &u32::MAX),
            (Kind::I, &true),
            (Kind::I, &"7"),
            (Kind::F, &0.1_f64),
            (Kind::F, &16_777_217_i32),
            (Kind::F, &1e300_f64),
            (Kind::D, &i64::MAX),
            (Kind::D, &9_007_199_254_740_993_i64),
            (Kind::Io, &2_i32),
            (Kind::Io, &1.0_f64),
            (Kind::S, &1_i32),
            (Kind::S, &()),
        ];
        for (kind, value) in refused {
            assert_eq!(converted(kind, value), None, "{kind}");
        }
    }

    #[test]
    fn arrays_convert_element_by_element_and_keep_their_length() {
        becomes(Kind::V, &[1.0_f64, 2.5, -3.0], &[1.0_f32, 2.5, -3.0]);
        becomes(Kind::V, &(1_i32, 2.5_f64, 3_u8), &[1.0_f32, 2.5, 3.0]);
        becomes(Kind::P, &[1_i32, 2, 3, 4, 5, 6, -1], &[1.0_f32, 2.0, 3.0, 4.0, 5.0, 6.0, -1.0]);
        assert_eq!(converted(Kind::V, &[1.0_f32, 2.0]), None);
        assert_eq!(converted(Kind::J, &[1.0_f32; 6]), None);
        assert_eq!(converted(Kind::V, &[1.0_f64, 2.0, 0.1]), None);
        assert_eq!(converted(Kind::V, &1.0_f32), None);
        assert_eq!(converted(Kind::F, &[1.0_f32]), None);
        assert_eq!(converted(Kind::V, &["1", "2", "3"]), None);
    }
}
