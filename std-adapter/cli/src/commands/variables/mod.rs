//! Variables: `bcap get`, `bcap put`, `bcap watch`, `bcap names`, and `bcap rac` for RAC, the text protocol.

pub(crate) mod get;
pub(crate) mod io;
pub(crate) mod labels;
pub(crate) mod names;
pub(crate) mod put;
pub(crate) mod rac;
pub(crate) mod watch;
