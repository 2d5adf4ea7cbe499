//! The robot and the state of its controller: `bcap move`, `bcap jog`, `bcap teach`, `bcap halt`, `bcap task`, `bcap errors`,
//! `bcap log` and `bcap recover`.

mod axis;
pub(crate) mod errors;
pub(crate) mod halt;
pub(crate) mod jog;
#[cfg(feature = "screens")]
mod keys;
pub(crate) mod log;
pub(crate) mod motion;
pub(crate) mod recover;
mod silence;
pub(crate) mod task;
