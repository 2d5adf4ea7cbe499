//! The robot and the state of its controller: `bcap move`, `bcap halt`, `bcap task`, `bcap errors` and
//! `bcap recover`.

mod destination;
pub(crate) mod errors;
pub(crate) mod halt;
pub(crate) mod messages;
pub(crate) mod motion;
pub(crate) mod recover;
mod silence;
pub(crate) mod task;
