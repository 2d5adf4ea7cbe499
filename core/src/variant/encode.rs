//! Encoding of Rust values.
//!
//! Every value that can be sent implements [`Encode`]. Its output is canonical: a scalar's count is 1, and BOOL is -1 or 0.

use super::{Array, Bstr, CivilTime, Currency, Nested, Null, OleDate, Scalar, VarType, Variant};
use crate::error::EncodeError;
use crate::hresult::HResult;
use crate::num::to_u32;
use crate::wire::Writer;

/// A value that can be sent: appends `u16 VARTYPE | u32 count | data`.
///
/// | Rust                                            | VARTYPE              |
/// |-------------------------------------------------|----------------------|
/// | `()`, [`Null`]                                  | EMPTY, NULL          |
/// | `i16 i32 i64 u8 u16 u32 u64 f32 f64 bool`       | I2 I4 I8 UI1 UI2 UI4 UI8 R4 R8 BOOL |
/// | [`Currency`], [`OleDate`], [`HResult`]          | CY, DATE, ERROR      |
/// | [`CivilTime`]                                   | DATE                 |
/// | `&str`, [`Bstr`], `String`                      | BSTR                 |
/// | `[T; N]`, `[T]`, `Vec<T>` of an [`Element`]     | ARRAY of its type    |
/// | tuples of 1 to 8 values                         | ARRAY of VARIANT     |
/// | `Option<T>`                                     | type of T; EMPTY     |
/// | [`Variant`], `VariantBuf`, references           | type of their value  |
pub trait Encode {
    /// Appends the value.
    ///
    /// # Errors
    ///
    /// [`EncodeError::Full`] if it does not fit; part of it may have been written. [`EncodeError::OutOfRange`] if the
    /// VARTYPE cannot represent it, such as a [`CivilTime`] that does not exist.
    fn encode(&self, out: &mut Writer<'_>) -> Result<(), EncodeError>;
}

/// A value that can be an element of an array.
pub trait Element {
    /// The type of the elements.
    const TYPE: VarType;

    /// Appends the element's data.
    ///
    /// # Errors
    ///
    /// [`EncodeError::Full`] when it does not fit.
    fn put(&self, out: &mut Writer<'_>) -> Result<(), EncodeError>;

    /// Appends the data of many elements.
    ///
    /// # Errors
    ///
    /// [`EncodeError::Full`] when they do not fit.
    #[inline]
    fn put_all(elements: &[Self], out: &mut Writer<'_>) -> Result<(), EncodeError>
    where
        Self: Sized,
    {
        elements.iter().try_for_each(|element| element.put(out))
    }
}

/// Appends type and count.
#[cfg_attr(target_os = "none", inline(never))]
#[cfg_attr(not(target_os = "none"), inline)]
pub(super) fn head(vartype: VarType, count: u32, out: &mut Writer<'_>) -> Result<(), EncodeError> {
    let [t0, t1] = vartype.0.to_le_bytes();
    let [c0, c1, c2, c3] = count.to_le_bytes();
    out.put([t0, t1, c0, c1, c2, c3])
}

#[inline]
fn scalar<T: Element>(value: &T, out: &mut Writer<'_>) -> Result<(), EncodeError> {
    head(T::TYPE, 1, out)?;
    value.put(out)
}

macro_rules! encode_scalars {
    ($($type:ty),*) => {$(
        impl Element for $type {
            const TYPE: VarType = <Self as Scalar>::TYPE;

            #[inline]
            fn put(&self, out: &mut Writer<'_>) -> Result<(), EncodeError> {
                out.put(self.to_wire())
            }

            #[inline]
            fn put_all(elements: &[Self], out: &mut Writer<'_>) -> Result<(), EncodeError> {
                let slot = out.reserve(elements.len().saturating_mul(size_of::<<$type as Scalar>::Wire>()))?;
                // one bounds check for all, then a loop that the compiler turns into a copy
                for (wire, element) in <$type as Scalar>::chunks_mut(slot).iter_mut().zip(elements) {
                    *wire = element.to_wire();
                }
                Ok(())
            }
        }

        impl Encode for $type {
            #[inline]
            fn encode(&self, out: &mut Writer<'_>) -> Result<(), EncodeError> {
                scalar(self, out)
            }
        }
    )*};
}

encode_scalars!(i16, i32, i64, u8, u16, u32, u64, f32, f64, bool, Currency, OleDate, HResult);

impl Encode for () {
    #[inline]
    fn encode(&self, out: &mut Writer<'_>) -> Result<(), EncodeError> {
        head(VarType::EMPTY, 1, out)
    }
}

impl Encode for Null {
    #[inline]
    fn encode(&self, out: &mut Writer<'_>) -> Result<(), EncodeError> {
        head(VarType::NULL, 1, out)
    }
}

impl Element for &str {
    const TYPE: VarType = VarType::BSTR;

    fn put(&self, out: &mut Writer<'_>) -> Result<(), EncodeError> {
        let len = self.len().saturating_mul(2);
        let start = out.len();
        out.put(to_u32(len).to_le_bytes())?;
        // names and commands are ASCII: one unit for each byte
        if let Ok(slot) = out.reserve(len)
            && widen_ascii(self.as_bytes(), slot)
        {
            return Ok(());
        }
        out.truncate(start);
        out.length_prefixed(&|out| self.encode_utf16().try_for_each(|unit| out.put(unit.to_le_bytes())))
    }
}

/// Writes a unit for each byte into a slot of twice their length; returns whether all bytes are ASCII.
fn widen_ascii(bytes: &[u8], slot: &mut [u8]) -> bool {
    // a command such as slvMove in two steps that overlap; a board does without for its flash
    #[cfg(not(target_os = "none"))]
    if bytes.len() <= 8
        && let (Some(first), Some(last)) = (bytes.first_chunk(), bytes.last_chunk())
        && let Some(units) = slot.first_chunk_mut()
    {
        *units = four_units(first);
        if let Some(units) = slot.last_chunk_mut() {
            *units = four_units(last);
        }
        return (u32::from_le_bytes(*first) | u32::from_le_bytes(*last)) & 0x8080_8080 == 0;
    }
    let mut seen = 0;
    for (unit, byte) in slot.as_chunks_mut().0.iter_mut().zip(bytes) {
        *unit = [*byte, 0];
        seen |= byte;
    }
    seen.is_ascii()
}

/// Puts a zero after each of four bytes.
#[cfg(not(target_os = "none"))]
#[inline]
fn four_units(bytes: &[u8; 4]) -> [u8; 8] {
    let units = u64::from(u32::from_le_bytes(*bytes));
    let units = (units | units << 16) & 0x0000_ffff_0000_ffff;
    ((units | units << 8) & 0x00ff_00ff_00ff_00ff).to_le_bytes()
}

impl Encode for str {
    fn encode(&self, out: &mut Writer<'_>) -> Result<(), EncodeError> {
        scalar(&self, out)
    }
}

impl Element for Bstr<'_> {
    const TYPE: VarType = VarType::BSTR;

    fn put(&self, out: &mut Writer<'_>) -> Result<(), EncodeError> {
        out.put(to_u32(self.as_bytes().len()).to_le_bytes())?;
        out.put_slice(self.as_bytes())
    }
}

impl Encode for Bstr<'_> {
    fn encode(&self, out: &mut Writer<'_>) -> Result<(), EncodeError> {
        scalar(self, out)
    }
}

impl<T: Element> Encode for [T] {
    #[inline]
    fn encode(&self, out: &mut Writer<'_>) -> Result<(), EncodeError> {
        head(T::TYPE.array_of(), to_u32(self.len()), out)?;
        T::put_all(self, out)
    }
}

impl<T: Element, const N: usize> Encode for [T; N] {
    #[inline]
    fn encode(&self, out: &mut Writer<'_>) -> Result<(), EncodeError> {
        self.as_slice().encode(out)
    }
}

impl<T: Encode + ?Sized> Encode for &T {
    #[inline]
    fn encode(&self, out: &mut Writer<'_>) -> Result<(), EncodeError> {
        (**self).encode(out)
    }
}

impl<T: Encode> Encode for Option<T> {
    fn encode(&self, out: &mut Writer<'_>) -> Result<(), EncodeError> {
        match self {
            Some(value) => value.encode(out),
            None => ().encode(out),
        }
    }
}

impl Element for CivilTime {
    const TYPE: VarType = VarType::DATE;

    fn put(&self, out: &mut Writer<'_>) -> Result<(), EncodeError> {
        OleDate::from_civil(*self).ok_or(EncodeError::OutOfRange(VarType::DATE.0))?.put(out)
    }
}

impl Encode for CivilTime {
    fn encode(&self, out: &mut Writer<'_>) -> Result<(), EncodeError> {
        scalar(self, out)
    }
}

#[cfg(feature = "alloc")]
impl Element for alloc::string::String {
    const TYPE: VarType = VarType::BSTR;

    fn put(&self, out: &mut Writer<'_>) -> Result<(), EncodeError> {
        self.as_str().put(out)
    }
}

#[cfg(feature = "alloc")]
impl Encode for alloc::string::String {
    fn encode(&self, out: &mut Writer<'_>) -> Result<(), EncodeError> {
        self.as_str().encode(out)
    }
}

#[cfg(feature = "alloc")]
impl<T: Element> Encode for alloc::vec::Vec<T> {
    fn encode(&self, out: &mut Writer<'_>) -> Result<(), EncodeError> {
        self.as_slice().encode(out)
    }
}

/// An element of an array of VARIANT.
impl Element for Variant<'_> {
    const TYPE: VarType = VarType::VARIANT;

    fn put(&self, out: &mut Writer<'_>) -> Result<(), EncodeError> {
        self.encode(out)
    }
}

/// An element of an array of VARIANT.
impl Element for &dyn Encode {
    const TYPE: VarType = VarType::VARIANT;

    fn put(&self, out: &mut Writer<'_>) -> Result<(), EncodeError> {
        self.encode(out)
    }
}

macro_rules! encode_tuples {
    ($($count:literal: $($name:ident)+;)*) => {$(
        #[doc = "An array of VARIANT with these elements."]
        impl<$($name: Encode),+> Encode for ($($name,)+) {
            #[inline]
            fn encode(&self, out: &mut Writer<'_>) -> Result<(), EncodeError> {
                #[expect(non_snake_case, reason = "the elements are named as their types")]
                let ($($name,)+) = self;
                head(VarType::VARIANT.array_of(), $count, out)?;
                $($name.encode(out)?;)+
                Ok(())
            }
        }
    )*};
}

encode_tuples! {
    1: A;
    2: A B;
    3: A B C;
    4: A B C D;
    5: A B C D E;
    6: A B C D E F;
    7: A B C D E F G;
    8: A B C D E F G H;
}

impl Encode for Variant<'_> {
    fn encode(&self, out: &mut Writer<'_>) -> Result<(), EncodeError> {
        match self {
            Self::Nested(nested) => nested.encode(out),
            Self::Array(array) => array.encode(out),
            Self::Opaque(opaque) => Err(EncodeError::Unsendable(opaque.vartype.0)),
            scalar => {
                head(scalar.vartype(), 1, out)?;
                put_scalar(scalar, out)
            }
        }
    }
}

/// Appends the data of a value that is neither an array nor a VARIANT.
fn put_scalar(value: &Variant<'_>, out: &mut Writer<'_>) -> Result<(), EncodeError> {
    // all numbers as 64 bits: a copy of this code for each type would take 1 KiB
    let (bits, width) = match *value {
        Variant::I2(n) => (u64::from(n.cast_unsigned()), 2),
        Variant::I4(n) | Variant::Error(HResult(n)) => (u64::from(n.cast_unsigned()), 4),
        Variant::R4(n) => (u64::from(n.to_bits()), 4),
        Variant::R8(n) => (n.to_bits(), 8),
        Variant::Date(n) => (n.raw().to_bits(), 8),
        Variant::Cy(n) => (n.raw().cast_unsigned(), 8),
        Variant::Bool(n) => (u64::from(n).wrapping_neg(), 2),
        Variant::Ui1(n) => (u64::from(n), 1),
        Variant::Ui2(n) => (u64::from(n), 2),
        Variant::Ui4(n) => (u64::from(n), 4),
        Variant::I8(n) => (n.cast_unsigned(), 8),
        Variant::Ui8(n) => (n, 8),
        Variant::Bstr(text) => return text.put(out),
        Variant::Empty | Variant::Null | Variant::Nested(_) | Variant::Array(_) | Variant::Opaque(_) => (0, 0),
    };
    put_bits(bits, width, out)
}

/// Appends the lower bytes of `bits`, at most 8.
#[cfg_attr(not(target_os = "none"), inline(always))]
pub(super) fn put_bits(bits: u64, width: u8, out: &mut Writer<'_>) -> Result<(), EncodeError> {
    let bytes = bits.to_le_bytes();
    // the loop is shorter on a board, and slower
    #[cfg(not(target_os = "none"))]
    match (width, bytes) {
        (4, [a, b, c, d, ..]) => return out.put([a, b, c, d]),
        (8, _) => return out.put(bytes),
        _ => {}
    }
    for (slot, byte) in out.reserve(usize::from(width))?.iter_mut().zip(bytes) {
        *slot = byte;
    }
    Ok(())
}

/// Encodes a scalar VARIANT with the value inside.
impl Encode for Nested<'_> {
    fn encode(&self, out: &mut Writer<'_>) -> Result<(), EncodeError> {
        head(VarType::VARIANT, 1, out)?;
        self.value().encode(out)
    }
}

/// Copies numbers, and normalises values that a lenient decoder accepted (a BOOL of 1, a string of odd length).
impl Encode for Array<'_> {
    fn encode(&self, out: &mut Writer<'_>) -> Result<(), EncodeError> {
        head(self.element().array_of(), to_u32(self.len()), out)?;
        match self.element() {
            VarType::BOOL | VarType::BSTR => self.iter().try_for_each(|element| put_scalar(&element, out)),
            VarType::VARIANT => self.iter().try_for_each(|value| value.encode(out)),
            _ => out.put_slice(self.as_bytes()),
        }
    }
}
