//! Readers of input that several targets use.

use bcap_core::limits::Strictness;

/// Both strictnesses.
pub(crate) const BOTH: [Strictness; 2] = [Strictness::Strict, Strictness::Lenient];
