//! Live screens of `bcap monitor` and `bcap sim --screen`: what they show, and how it is drawn.
//!
//! A [`Screen`] is drawn by `draw` alone, which reads neither the clock nor the environment, so tests assert its lines. All
//! text is escaped there. [`Terminal`] restores the terminal on every exit.

mod draw;
mod live;
mod log;
mod parts;
mod robot;
mod spark;
mod terminal;

pub(crate) use live::Live;
pub(crate) use log::CallLog;
pub(crate) use parts::{Line, Mark, Panel, Part, Screen};
pub(crate) use robot::{numbered, robot_lines};
pub(crate) use terminal::{Terminal, require};
