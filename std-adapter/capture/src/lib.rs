//! Captures of b-CAP and RAC traffic: decodes, records, replays, forwards and shows it.
//!
//! | module        | contents                                                                        |
//! |---------------|---------------------------------------------------------------------------------|
//! | [`decode`]    | the calls in a pcap or pcapng file, as text, JSON, CSV or statistics             |
//! | [`record`]    | records the bytes of connections as packets in a pcapng file                     |
//! | [`replay`]    | replays the calls of a capture, and compares the replies                         |
//! | [`playback`]  | a server that answers as the server of a capture did                             |
//! | [`proxy`]     | forwards to a robot, records, and injects [`faults`]                             |
//! | [`trace`]     | shows each packet of a client's transport as text                                |
//! | [`dissect`]   | a frame field by field, with offsets and bytes                                   |
//! | [`frame`]     | frames as lines of JSON and of text; [`json`] for their values, [`hex`] for bytes |
//! | [`facts`]     | the meaning of a result code, its cause and the remedy                          |
//! | [`mcap`]      | time series as files for Foxglove and PlotJuggler                                |
//! | [`wireshark`] | the dissector for Wireshark, one Lua file                                        |
//!
//! The library prints nothing and has no command line. Names and values of its texts come from a peer: escape them before they
//! are printed on a terminal.
//!
//! # Examples
//!
#![doc = include_str!("../README.md")]

mod call_name;
pub mod decode;
pub mod dissect;
pub mod duration;
mod error;
mod facts;
pub mod faults;
pub mod frame;
pub mod hex;
pub mod json;
mod log_entry;
pub mod mcap;
pub mod playback;
pub mod proxy;
pub mod record;
pub mod replay;
mod role;
pub mod times;
pub mod trace;
pub mod value;
pub mod wireshark;

pub use self::call_name::CallName;
pub use self::error::{ConvertError, Error};
pub use self::facts::facts;
pub use self::log_entry::LogEntry;
pub use self::role::Role;
