//! Parts of live screens that `bcap monitor` and `bcap sim --screen` share.

mod log;
mod robot;

pub(crate) use log::{CallLog, MARKED};
pub(crate) use robot::{numbered, robot_lines};
