//! `bcap decode FILE`: the calls in a capture of Wireshark or tcpdump.
//!
//! ```text
//!  file    blocks of pcap or pcapng          -> packets with their time
//!  packet  link layer, IP, TCP or UDP        -> segments
//!  stream  segments of one direction         -> bytes in order; what is missing is said
//!  session frames of both directions         -> calls with their replies; handles become names
//!  line    lines of RAC in both directions   -> the same
//!  print, stats                              -> lines of text or of JSON
//! ```

mod call;
mod file;
mod line;
mod packet;
mod print;
mod session;
mod stats;
mod stream;
mod talk;

use std::path::Path;

use bcap_core::limits::Strictness;

use crate::args::CaptureArgs;
use crate::error::Failure;
use crate::output::{print_json, print_line};
use call::Event;
use print::Printer;
use stats::Stats;
use talk::Talks;

/// Returns whether the words of `bcap decode` are the name of a capture instead of hexadecimal digits.
pub(crate) fn names_file(words: &[String]) -> bool {
    let [word] = words else { return false };
    let extension = Path::new(word).extension().and_then(|extension| extension.to_str()).unwrap_or_default();
    ["pcap", "pcapng", "cap"].iter().any(|known| extension.eq_ignore_ascii_case(known))
}

/// Runs `bcap decode FILE`.
pub(crate) fn decode(path: &Path, args: &CaptureArgs, strictness: Strictness, json: bool) -> Result<(), Failure> {
    let filter = print::Filter::new(args)?;
    let mut talks = Talks::new(strictness);
    let read = file::read(path, |packet| talks.packet(packet));
    talks.end();
    let mut events = talks.into_events();
    // calls are shown at the time of their requests, but known only with their replies
    events.sort_by_key(Event::at);

    let print = if json { print_json } else { print_line };
    let printer = Printer::new(json, &events);
    let accepted = events.iter().filter(|event| filter.accepts(event));
    if args.stats {
        let mut stats = Stats::default();
        for event in accepted {
            if let Event::Call(call) = event {
                stats.add(call);
            }
        }
        stats.lines(json).iter().try_for_each(|line| print(line))?;
    } else {
        accepted.map(|event| printer.line(event)).try_for_each(|line| print(&line))?;
    }
    // a file that ends inside a packet still has the calls before it
    read
}
