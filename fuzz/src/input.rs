//! What several targets need to read their input.

use bcap_core::limits::Strictness;

/// Both strictnesses.
pub(crate) const BOTH: [Strictness; 2] = [Strictness::Strict, Strictness::Lenient];
