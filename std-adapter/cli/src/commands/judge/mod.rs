//! Judges of devices: `bcap conform` and `bcap fuzz`.

pub(crate) mod conform;
pub(crate) mod fuzz;
