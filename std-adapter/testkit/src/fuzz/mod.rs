//! Sends sessions to a device and keeps the findings.
//!
//! ```text
//!  engine    a seed -> sessions; reduces, confirms and saves findings
//!  device    runs steps and judges the replies; a new client must be served afterwards
//!  channel   a connection with the datagrams that it has sent
//!  gate      what may be sent
//!  session   the handles of a connection, and what they may be used for
//!  minimise  delta debugging
//! ```
//!
//! The engine prints nothing and handles no signals: [`Device`] has a function that returns whether to end, and a [`Recording`]
//! turns a run into a capture.

mod channel;
mod device;
mod engine;
mod finding;
mod gate;
mod minimise;
mod save;
mod session;

use std::fmt;
use std::io;
use std::path::{Path, PathBuf};

pub use self::channel::Protocol;
pub use self::device::Device;
pub use self::engine::{Plan, Saved, fuzz};
pub use self::finding::{Finding, Kind};
pub use self::gate::{Gate, Range};
pub use self::save::{Files, read};
use crate::wire::Recorder;

/// Why a run ends early.
#[derive(Debug)]
#[non_exhaustive]
pub enum Error {
    /// The caller has ended the run.
    Ended,
    /// A file of a finding cannot be read or written.
    File(PathBuf, io::Error),
    /// The steps of a file are wrong.
    Steps(PathBuf, String),
}

impl fmt::Display for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Ended => f.write_str("interrupted"),
            Self::File(path, error) => write!(f, "{}: {error}", path.display()),
            Self::Steps(path, error) => write!(f, "{}: {error}", path.display()),
        }
    }
}

impl std::error::Error for Error {}

/// Records the run of a finding to a file.
pub trait Recording {
    /// Returns the recorder of the connections.
    fn recorder(&self) -> &dyn Recorder;

    /// Completes the file.
    ///
    /// # Errors
    ///
    /// When the file cannot be written.
    fn finish(self: Box<Self>) -> io::Result<()>;
}

/// Begins a recording to a file.
pub type Record<'a> = &'a mut dyn FnMut(&Path) -> io::Result<Box<dyn Recording>>;
