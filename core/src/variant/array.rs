//! Arrays: elements of one type, read in place.
//!
//! An [`Array`] is a view of the received bytes. It copies nothing and converts each element on access, so an array of a
//! million doubles is decoded as fast as an array of two.

use core::fmt;
use core::marker::PhantomData;

use super::{Bstr, Currency, Layout, OleDate, VarType, Variant};
use crate::hresult::HResult;
use crate::num::to_usize;
use crate::wire::{Reader, length_prefixed};

/// Elements of one type.
#[derive(Clone, Copy)]
pub struct Array<'a> {
    element: VarType,
    // 32 bits, as on the wire, so that a `Variant` is three words
    count: u32,
    /// Exactly `count` validated elements.
    data: &'a [u8],
}

impl<'a> Array<'a> {
    #[inline]
    pub(super) const fn from_checked(element: VarType, count: u32, data: &'a [u8]) -> Self {
        Self { element, count, data }
    }

    /// Returns the type of the elements.
    #[must_use]
    pub const fn element(self) -> VarType {
        self.element
    }

    /// Returns the number of elements.
    #[must_use]
    pub const fn len(self) -> usize {
        to_usize(self.count)
    }

    /// Returns whether there are no elements.
    #[must_use]
    pub const fn is_empty(self) -> bool {
        self.count == 0
    }

    /// Returns the elements in their encoding: packed little-endian numbers, or strings and values in a row.
    #[must_use]
    pub const fn as_bytes(self) -> &'a [u8] {
        self.data
    }

    /// Views the elements as numbers of type `T`; `None` if they have another type.
    #[must_use]
    pub fn items<T: Scalar>(self) -> Option<Items<'a, T>> {
        (self.element == T::TYPE).then_some(Items { data: self.data, element: PhantomData })
    }

    /// Iterates over the elements of any type.
    #[must_use]
    pub const fn iter(self) -> Elements<'a> {
        Elements { element: self.element, left: self.len(), reader: Reader::new(self.data) }
    }

    /// Returns an element; for strings and VARIANTs this reads all elements before it.
    #[must_use]
    pub fn get(self, index: usize) -> Option<Variant<'a>> {
        match self.element.layout() {
            Layout::Fixed(width) if index < self.len() => {
                let width = usize::from(width);
                let at = index.checked_mul(width)?;
                Some(Variant::read_element(self.element, &mut Reader::new(self.data.get(at..)?)))
            }
            Layout::Fixed(_) => None,
            _ => self.iter().nth(index),
        }
    }

    /// Iterates over the strings; `None` if the elements have another type.
    #[must_use]
    pub fn strings(self) -> Option<impl Iterator<Item = Bstr<'a>> + Clone + use<'a>> {
        let mut reader = Reader::new(self.data);
        let next = move |_| length_prefixed(&mut reader).map(Bstr::truncated);
        (self.element == VarType::BSTR).then(|| (0..self.len()).map_while(next))
    }
}

impl<'a> IntoIterator for Array<'a> {
    type Item = Variant<'a>;
    type IntoIter = Elements<'a>;

    fn into_iter(self) -> Elements<'a> {
        self.iter()
    }
}

impl PartialEq for Array<'_> {
    fn eq(&self, other: &Self) -> bool {
        self.element == other.element && self.count == other.count && self.iter().eq(other.iter())
    }
}

impl Eq for Array<'_> {}

impl fmt::Debug for Array<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let name = self.element.name().and_then(|name| name.strip_prefix("VT_")).unwrap_or("?");
        f.write_str(name)?;
        let mut list = f.debug_list();
        for element in *self {
            match element {
                other if self.element == VarType::VARIANT => list.entry(&other),
                // the type precedes the list
                Variant::R4(n) => list.entry(&n),
                Variant::R8(n) => list.entry(&n),
                Variant::Bool(b) => list.entry(&b),
                Variant::Ui8(n) => list.entry(&n),
                other => match other.as_i64() {
                    Some(n) => list.entry(&n),
                    None => list.entry(&other),
                },
            };
        }
        list.finish()
    }
}

#[cfg(feature = "defmt")]
impl defmt::Format for Array<'_> {
    fn format(&self, f: defmt::Formatter<'_>) {
        defmt::write!(f, "{} x {}", self.count, self.element);
    }
}

/// Iterates over the elements of an [`Array`].
#[derive(Clone)]
pub struct Elements<'a> {
    element: VarType,
    left: usize,
    reader: Reader<'a>,
}

impl<'a> Iterator for Elements<'a> {
    type Item = Variant<'a>;

    #[cfg_attr(not(target_os = "none"), inline(always))]
    fn next(&mut self) -> Option<Variant<'a>> {
        self.left = self.left.checked_sub(1)?;
        Some(Variant::read_element(self.element, &mut self.reader))
    }

    fn size_hint(&self) -> (usize, Option<usize>) {
        (self.left, Some(self.left))
    }
}

impl ExactSizeIterator for Elements<'_> {}
impl core::iter::FusedIterator for Elements<'_> {}

impl fmt::Debug for Elements<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Elements").field("element", &self.element).field("left", &self.left).finish_non_exhaustive()
    }
}

mod sealed {
    pub trait Sealed {}
}

/// A type whose values have a fixed width on the wire, so that an array of them can be indexed.
///
/// It is implemented for the types of this list and no others: `i16`, `i32`, `i64`, `u8`, `u16`, `u32`, `u64`, `f32`,
/// `f64`, `bool`, [`Currency`], [`OleDate`], [`HResult`].
pub trait Scalar: Copy + sealed::Sealed {
    /// Its VARTYPE.
    const TYPE: VarType;
    /// Its bytes on the wire.
    type Wire: Copy + 'static;

    #[doc(hidden)]
    fn from_wire(bytes: Self::Wire) -> Self;
    #[doc(hidden)]
    fn to_wire(self) -> Self::Wire;
    /// Views packed elements as their bytes, without an incomplete last element.
    #[doc(hidden)]
    fn chunks(data: &[u8]) -> &[Self::Wire];
    #[doc(hidden)]
    fn chunks_mut(data: &mut [u8]) -> &mut [Self::Wire];
}

macro_rules! scalars {
    ($($type:ty, $vartype:ident, $width:literal, $from:expr, $to:expr;)*) => {$(
        impl sealed::Sealed for $type {}

        impl Scalar for $type {
            const TYPE: VarType = VarType::$vartype;
            type Wire = [u8; $width];

            #[inline]
            fn from_wire(bytes: Self::Wire) -> Self {
                $from(bytes)
            }

            #[inline]
            fn to_wire(self) -> Self::Wire {
                $to(self)
            }

            #[inline]
            fn chunks(data: &[u8]) -> &[Self::Wire] {
                data.as_chunks().0
            }

            #[inline]
            fn chunks_mut(data: &mut [u8]) -> &mut [Self::Wire] {
                data.as_chunks_mut().0
            }
        }
    )*};
}

scalars! {
    i16, I2, 2, i16::from_le_bytes, i16::to_le_bytes;
    i32, I4, 4, i32::from_le_bytes, i32::to_le_bytes;
    f32, R4, 4, f32::from_le_bytes, f32::to_le_bytes;
    f64, R8, 8, f64::from_le_bytes, f64::to_le_bytes;
    Currency, CY, 8, |b| Currency::from_raw(i64::from_le_bytes(b)), |c: Currency| c.raw().to_le_bytes();
    OleDate, DATE, 8, |b| OleDate::from_raw(f64::from_le_bytes(b)), |d: OleDate| d.raw().to_le_bytes();
    HResult, ERROR, 4, |b| HResult(i32::from_le_bytes(b)), |h: HResult| h.0.to_le_bytes();
    bool, BOOL, 2, |b| b != [0, 0], |b| if b { [0xff, 0xff] } else { [0, 0] };
    u8, UI1, 1, u8::from_le_bytes, u8::to_le_bytes;
    u16, UI2, 2, u16::from_le_bytes, u16::to_le_bytes;
    u32, UI4, 4, u32::from_le_bytes, u32::to_le_bytes;
    i64, I8, 8, i64::from_le_bytes, i64::to_le_bytes;
    u64, UI8, 8, u64::from_le_bytes, u64::to_le_bytes;
}

/// A view of the elements of an array of numbers.
///
/// # Examples
///
/// ```
/// use bcap_core::variant::VariantBuf;
///
/// let joints = VariantBuf::<64>::new(&[10.0_f32, 20.0, 30.0])?;
/// let array = joints.as_variant().as_array().ok_or("no array")?;
/// assert!(array.items::<f64>().is_none());
/// let items = array.items::<f32>().ok_or("not R4")?;
/// assert_eq!(items.get(2), Some(30.0));
/// assert_eq!(items.to_array::<3>(), Some([10.0, 20.0, 30.0]));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub struct Items<'a, T> {
    data: &'a [u8],
    element: PhantomData<T>,
}

impl<'a, T: Scalar> Items<'a, T> {
    /// Returns the number of elements.
    #[must_use]
    pub fn len(&self) -> usize {
        T::chunks(self.data).len()
    }

    /// Returns whether there are no elements.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Returns an element.
    #[must_use]
    pub fn get(&self, index: usize) -> Option<T> {
        T::chunks(self.data).get(index).map(|wire| T::from_wire(*wire))
    }

    /// Iterates over the elements.
    pub fn iter(&self) -> impl ExactSizeIterator<Item = T> + DoubleEndedIterator + Clone + use<'a, T> {
        T::chunks(self.data).iter().map(|wire| T::from_wire(*wire))
    }

    /// Copies the elements to the front of `target` and returns their number; `None` if they do not fit.
    pub fn copy_to(&self, target: &mut [T]) -> Option<usize> {
        let slots = target.get_mut(..self.len())?;
        for (slot, value) in slots.iter_mut().zip(self.iter()) {
            *slot = value;
        }
        Some(self.len())
    }

    /// Returns the elements as a Rust array; `None` if it has another length.
    #[must_use]
    pub fn to_array<const N: usize>(&self) -> Option<[T; N]> {
        let wire: &[T::Wire; N] = T::chunks(self.data).try_into().ok()?;
        Some(wire.map(T::from_wire))
    }
}

impl<T> Clone for Items<'_, T> {
    fn clone(&self) -> Self {
        *self
    }
}

impl<T> Copy for Items<'_, T> {}

impl<T: Scalar + fmt::Debug> fmt::Debug for Items<'_, T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_list().entries(self.iter()).finish()
    }
}
