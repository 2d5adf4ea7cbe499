//! Parts of live screens that `bcap monitor` and `bcap sim --screen` share.

mod log;
mod robot;

pub(crate) use log::{calls_panel, log_key, log_panel};
pub(crate) use robot::{numbered, robot_lines};
