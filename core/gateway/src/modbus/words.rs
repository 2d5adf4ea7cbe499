//! Values in registers.

use super::map::{Entry, Format};
use bcap_core::rac::VariableKind;
use bcap_core::variant::{Variant, VariantBuf};

/// Bytes of the longest value in its encoding: the ten R4 of a T variable.
const VALUE: usize = 64;

/// Writes the value of a variable to its registers; `None` if it does not fit them.
pub(super) fn store(entry: &Entry, value: &Variant<'_>, registers: &mut [u8]) -> Option<()> {
    let value = value.flatten();
    match value {
        Variant::Array(array) if entry.kind.vartype().is_array() => {
            let mut elements = array.iter();
            for registers in registers.chunks_exact_mut(4) {
                store_element(entry, &elements.next()?, registers)?;
            }
            elements.next().is_none().then_some(())
        }
        _ if entry.kind.vartype().is_array() => None,
        _ => store_element(entry, &value, registers),
    }
}

fn store_element(entry: &Entry, value: &Variant<'_>, registers: &mut [u8]) -> Option<()> {
    let low_first = entry.low_first;
    match entry.format {
        Format::I16 => put(i16::try_from(value.as_i32()?).ok()?.to_be_bytes(), low_first, registers),
        Format::U16 => put(u16::try_from(value.as_i32()?).ok()?.to_be_bytes(), low_first, registers),
        Format::I32 => put(value.as_i32()?.to_be_bytes(), low_first, registers),
        Format::F32 => {
            let number = value.as_f64()?;
            // a variable D is rounded, but a finite one does not become infinite
            let rounded = to_f32(number);
            (rounded.is_finite() || !number.is_finite()).then_some(())?;
            put(rounded.to_be_bytes(), low_first, registers)
        }
        Format::F64 => put(value.as_f64()?.to_be_bytes(), low_first, registers),
        Format::Coil => None,
    }
}

/// Returns the nearest f32; infinite above its range.
#[expect(clippy::as_conversions, reason = "there is no other conversion from f64 to f32")]
const fn to_f32(value: f64) -> f32 {
    value as f32
}

fn put<const N: usize>(mut bytes: [u8; N], low_first: bool, registers: &mut [u8]) -> Option<()> {
    if low_first {
        bytes.as_chunks_mut::<2>().0.reverse();
    }
    *registers.first_chunk_mut()? = bytes;
    Some(())
}

/// Reads the value of a variable from its registers.
pub(super) fn load(entry: &Entry, registers: &[u8]) -> Option<VariantBuf<VALUE>> {
    let low_first = entry.low_first;
    if entry.kind.vartype().is_array() {
        let mut elements = [0.0; VariableKind::T.elements()];
        let elements = elements.get_mut(..entry.kind.elements())?;
        for (element, registers) in elements.iter_mut().zip(registers.chunks_exact(4)) {
            *element = f32::from_be_bytes(take(low_first, registers)?);
        }
        return VariantBuf::new(&*elements).ok();
    }
    let number = match entry.format {
        Format::I16 => return integer(i16::from_be_bytes(take(low_first, registers)?).into()),
        Format::U16 => return integer(u16::from_be_bytes(take(low_first, registers)?).into()),
        Format::I32 => return integer(i32::from_be_bytes(take(low_first, registers)?)),
        Format::F32 => f64::from(f32::from_be_bytes(take(low_first, registers)?)),
        Format::F64 => f64::from_be_bytes(take(low_first, registers)?),
        Format::Coil => return None,
    };
    match entry.kind {
        VariableKind::F => VariantBuf::new(&Some(to_f32(number)).filter(|single| f64::from(*single) == number)?),
        _ => VariantBuf::new(&number),
    }
    .ok()
}

fn integer(number: i32) -> Option<VariantBuf<VALUE>> {
    VariantBuf::new(&number).ok()
}

fn take<const N: usize>(low_first: bool, registers: &[u8]) -> Option<[u8; N]> {
    let mut bytes: [u8; N] = *registers.first_chunk()?;
    if low_first {
        bytes.as_chunks_mut::<2>().0.reverse();
    }
    Some(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;
    use bcap_core::variant::Encode;

    fn stored(entry: &str, value: &dyn Encode) -> Option<[u8; 40]> {
        let entry = Entry::registers(entry).unwrap();
        let value = VariantBuf::<128>::new(value).unwrap();
        let mut registers = [0; 40];
        let width = usize::from(entry.width()) * 2;
        store(&entry, &value.as_variant(), &mut registers[..width])?;
        if entry.format != Format::F32 || entry.kind != VariableKind::D {
            assert_eq!(load(&entry, &registers[..width]).unwrap(), value, "back from the registers");
        }
        Some(registers)
    }

    fn starts(entry: &str, value: &dyn Encode, expected: &[u8]) {
        let registers = stored(entry, value).unwrap();
        assert_eq!(&registers[..expected.len()], expected, "{entry}");
        assert!(registers[expected.len()..].iter().all(|byte| *byte == 0), "{entry}");
    }

    #[test]
    fn values_are_big_endian_and_the_order_of_words_can_be_changed() {
        starts("0=I", &0x0102_0304, &[1, 2, 3, 4]);
        starts("0=I:low", &0x0102_0304, &[3, 4, 1, 2]);
        starts("0=I:i16", &-2, &[0xff, 0xfe]);
        starts("0=I:u16", &0xfffe, &[0xff, 0xfe]);
        starts("0=F", &1.0_f32, &[0x3f, 0x80, 0, 0]);
        starts("0=F:low", &1.0_f32, &[0, 0, 0x3f, 0x80]);
        starts("0=D", &0.1_f64, &[0x3f, 0xb9, 0x99, 0x99, 0x99, 0x99, 0x99, 0x9a]);
        starts("0=D:low", &0.1_f64, &[0x99, 0x9a, 0x99, 0x99, 0x99, 0x99, 0x3f, 0xb9]);
        starts("0=D:f32", &0.1_f64, &[0x3d, 0xcc, 0xcc, 0xcd]);
        starts("0=V:low", &[1.0_f32, 2.0, -1.0], &[0, 0, 0x3f, 0x80, 0, 0, 0x40, 0, 0, 0, 0xbf, 0x80]);
        assert!(stored("0=T", &[1.0_f32; 10]).is_some());
    }

    #[test]
    fn a_value_that_does_not_fit_is_not_stored() {
        let cases: [(&str, &dyn Encode); 12] = [
            ("0=I:i16", &32_768),
            ("0=I:i16", &-32_769),
            ("0=I:u16", &-1),
            ("0=I:u16", &65_536),
            ("0=I", &"1"),
            ("0=I", &1.5_f32),
            ("0=V", &[1.0_f32, 2.0]),
            ("0=V", &[1.0_f32; 4]),
            ("0=V", &1.0_f32),
            ("0=F", &[1.0_f32]),
            ("0=D:f32", &1e39_f64),
            ("0=D:f32", &f64::MIN),
        ];
        for (entry, value) in cases {
            assert_eq!(stored(entry, value), None, "{entry}");
        }
    }
}
