//! Any function: `bcap call` and `bcap exec`.

pub(crate) mod call;
pub(crate) mod exec;
pub(crate) mod reference;
