//! Live screens: their panels, and how they are drawn.
//!
//! A [`Screen`] is drawn by `draw` alone, which reads neither the clock nor the environment, so tests assert its lines. All
//! text is escaped there. [`Terminal`] restores the terminal on every exit.

mod draw;
mod live;
mod parts;
mod spark;
mod terminal;

pub use crossterm::event::{KeyCode, KeyEvent, KeyModifiers};

pub use self::live::Live;
pub use self::parts::{Line, Mark, Panel, Part, Screen};
pub use self::terminal::{Terminal, require};
