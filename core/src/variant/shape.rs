//! The types of a value in one text, to compare answers whose numbers differ.

use core::fmt;

use super::{VarType, Variant};

/// The types of a value and the numbers of its elements: [`Variant::shape`].
#[derive(Clone, Copy, Debug)]
pub struct Shape<'a>(Variant<'a>);

impl<'a> Variant<'a> {
    /// Returns the types of the value and the numbers of its elements, to be displayed.
    ///
    /// ```
    /// use bcap_core::variant::VariantBuf;
    ///
    /// let value = VariantBuf::<64>::new(&(3, "ready", [1.0, 2.0]))?;
    /// assert_eq!(value.as_variant().shape().to_string(), "(I4 BSTR R8[2])");
    /// # Ok::<(), bcap_core::error::EncodeError>(())
    /// ```
    #[must_use]
    pub const fn shape(self) -> Shape<'a> {
        Shape(self)
    }
}

impl fmt::Display for Shape<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let vartype = self.0.vartype();
        let Variant::Array(array) = self.0 else { return write_name(f, vartype) };
        if vartype.element() != VarType::VARIANT {
            write_name(f, vartype.element())?;
            return write!(f, "[{}]", array.len());
        }
        f.write_str("(")?;
        for (place, item) in array.iter().enumerate() {
            if place > 0 {
                f.write_str(" ")?;
            }
            write!(f, "{}", item.flatten().shape())?;
        }
        f.write_str(")")
    }
}

/// Writes the name without its prefix; an unknown type has none.
fn write_name(f: &mut fmt::Formatter<'_>, vartype: VarType) -> fmt::Result {
    match vartype.name().and_then(|name| name.strip_prefix("VT_")) {
        Some(name) => f.write_str(name),
        None => write!(f, "{vartype}"),
    }
}
