//! b-CAP: binary calls on the objects of a controller, over TCP and UDP port 5007 or a serial line.

pub mod call;
pub mod client;
mod command;
mod effect;
mod frame;
pub mod function;
pub mod header;
mod link;
pub mod server;

pub use self::call::Call;
pub use self::client::Client;
pub use self::command::Command;
pub use self::effect::{Effect, InSlaveMode, Properties, Skipped, StreamState};
pub use self::frame::{Args, ArgsIter, Decoder, EOT, Frame, FrameWriter, MIN_FRAME, Progress, crc16};
pub use self::function::{FunctionId, Kind, Object, Signature};
pub use self::header::{HEADER_LEN, Header, SOH};
pub use self::link::{Link, OnMalformed};
pub use self::server::Session;

/// The port of b-CAP, TCP and UDP.
pub const PORT: u16 = 5007;
