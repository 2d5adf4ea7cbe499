//! `bcap decode FILE`: the calls in a capture of Wireshark or tcpdump.
//!
//! ```text
//!  file    blocks of pcap or pcapng          -> packets with their time
//!  packet  link layer, IP, TCP or UDP        -> segments
//!  conversation                              -> the protocol; which end is the client
//!  stream  segments of one direction         -> bytes in order; missing bytes are reported
//!  session frames of both directions         -> calls with their replies; handles become names
//!  line    lines of RAC in both directions   -> the same
//!  print, stats                              -> lines of text or of JSON
//! ```

mod call;
mod conversation;
mod csv;
mod file;
mod line;
mod live;
mod packet;
mod print;
mod session;
mod stats;
mod stream;

use std::path::Path;

use bcap_core::limits::Strictness;

use crate::args::CaptureArgs;
use crate::error::Failure;
use crate::output::{print_json, print_line};
pub(crate) use call::{Argument, Call, Event, Link, Reply};
use conversation::Conversations;
pub(crate) use live::Live;
use print::Printer;
pub(crate) use print::{is_object, reply_text, request_text};
use stats::Stats;

/// Returns the file that the words of `bcap decode` name; `None` if they are hexadecimal digits.
pub(crate) fn file(words: &[String]) -> Option<&Path> {
    let [word] = words else { return None };
    let path = Path::new(word);
    let extension = path.extension().and_then(|extension| extension.to_str()).unwrap_or_default();
    ["pcap", "pcapng", "cap"].iter().any(|known| extension.eq_ignore_ascii_case(known)).then_some(path)
}

/// Runs `bcap decode FILE`.
pub(crate) fn decode(path: &Path, args: &CaptureArgs, strictness: Strictness, json: bool) -> Result<(), Failure> {
    let (events, read) = events(path, strictness);
    let began = events.first().map_or(0, Event::at);
    let filter = print::Filter::new(args, began)?;
    let print = if json { print_json } else { print_line };
    let printer = Printer::new(json, began);
    let accepted = events.iter().filter(|event| filter.accepts(event));
    if args.stats {
        let mut stats = Stats::default();
        for event in accepted {
            if let Event::Call(call) = event {
                stats.add(call);
            }
        }
        stats.lines(json).iter().try_for_each(|line| print(line))?;
    } else if args.csv {
        print_line(&csv::heading())?;
        let calls = accepted.filter_map(|event| if let Event::Call(call) = event { Some(call) } else { None });
        calls.map(|call| csv::line(call, began)).try_for_each(|line| print_line(&line))?;
    } else {
        accepted.map(|event| printer.line(event)).try_for_each(|line| print(&line))?;
    }
    read
}

/// Reads a file, and returns its connections and calls by the time of their first packet.
///
/// A file that ends inside a packet still has the calls before it, so the error is returned together with them.
pub(crate) fn events(path: &Path, strictness: Strictness) -> (Vec<Event>, Result<(), Failure>) {
    let mut conversations = Conversations::new(strictness);
    let read = file::read(path, |packet| conversations.packet(packet));
    conversations.end();
    let mut events = conversations.take_events();
    // calls are shown at the time of their requests, but known only with their replies
    events.sort_by_key(Event::at);
    (events, read)
}
