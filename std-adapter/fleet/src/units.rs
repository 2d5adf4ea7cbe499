//! The elements of positions, and their units.

use bcap_core::rac::VariableKind;

/// Returns the name and unit of each element of a value; an empty slice for a scalar.
pub(crate) const fn elements(kind: Option<VariableKind>) -> &'static [(&'static str, &'static str)] {
    match kind {
        Some(VariableKind::V) => &[("X", ""), ("Y", ""), ("Z", "")],
        Some(VariableKind::P) => {
            &[("X", "mm"), ("Y", "mm"), ("Z", "mm"), ("RX", "deg"), ("RY", "deg"), ("RZ", "deg"), ("FIG", "")]
        }
        Some(VariableKind::J) => &[
            ("J1", "deg"),
            ("J2", "deg"),
            ("J3", "deg"),
            ("J4", "deg"),
            ("J5", "deg"),
            ("J6", "deg"),
            ("J7", "deg"),
            ("J8", "deg"),
        ],
        Some(VariableKind::T) => &[
            ("X", "mm"),
            ("Y", "mm"),
            ("Z", "mm"),
            ("OX", ""),
            ("OY", ""),
            ("OZ", ""),
            ("AX", ""),
            ("AY", ""),
            ("AZ", ""),
            ("FIG", ""),
        ],
        _ => &[],
    }
}
