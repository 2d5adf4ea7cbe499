//! The calls in a capture of Wireshark, tcpdump or a [recording](crate::record).
//!
//! ```text
//!  file    blocks of pcap or pcapng          -> packets with their time
//!  packet  link layer, IP, TCP or UDP        -> segments
//!  conversation                              -> the protocol; which end is the client
//!  stream  segments of one direction         -> bytes in order; missing bytes are reported
//!  session frames of both directions         -> calls with their replies; handles become names
//!  line    lines of RAC in both directions   -> the same
//!  print, csv, stats                         -> lines of text, JSON or CSV
//! ```

mod call;
mod conversation;
pub mod csv;
mod file;
mod filter;
mod fragments;
mod line;
mod live;
mod packet;
mod print;
mod session;
mod stats;
mod stream;

use std::path::Path;

use bcap_core::limits::Strictness;

pub use self::call::{Argument, Call, Event, Link, Note, Reply};
use self::conversation::Conversations;
pub(crate) use self::filter::is_object;
pub use self::filter::{ErrorFilter, Filter, function_name};
pub use self::live::Live;
pub use self::print::{Format, Printer};
pub(crate) use self::print::{reply_text, request_text};
pub use self::stats::Stats;
use crate::error::Error;

/// Reads a file, pcap or pcapng, and returns its connections and calls by the time of their first packet.
///
/// A file that ends inside a packet still has the calls before it, so the calls and the result of reading are returned
/// separately.
///
/// # Examples
///
/// ```no_run
/// use bcap_capture::decode::{self, Event};
/// use bcap_core::limits::Strictness;
///
/// let (events, read) = decode::events("session.pcapng".as_ref(), Strictness::Strict);
/// read?;
/// let refused = events.iter().filter(|event| matches!(event, Event::Call(call) if call.error().is_some()));
/// println!("{} calls were refused", refused.count());
/// # Ok::<(), bcap_capture::Error>(())
/// ```
pub fn events(path: &Path, strictness: Strictness) -> (Vec<Event>, Result<(), Error>) {
    let mut conversations = Conversations::new(strictness);
    let read = file::read(path, |packet| conversations.packet(packet));
    conversations.end();
    let mut events = conversations.take_events();
    // calls are listed by the time of their requests, but are complete only with their replies
    events.sort_by_key(Event::at);
    (events, read)
}
