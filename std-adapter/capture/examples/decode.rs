//! Prints the calls of a capture that failed: `cargo run -p bcap-capture --example decode -- session.pcapng`

use std::error::Error;
use std::path::PathBuf;

use bcap_capture::decode::{self, ErrorFilter, Event, Filter, Format, Printer};
use bcap_core::limits::Strictness;

fn main() -> Result<(), Box<dyn Error>> {
    let file = PathBuf::from(std::env::args_os().nth(1).ok_or("name a capture")?);
    let (events, read) = decode::events(&file, Strictness::Strict);
    let began = events.first().map_or(0, Event::at);
    let filter = Filter { error: Some(ErrorFilter::Any), ..Filter::default() };
    let printer = Printer::new(Format::Text, began);
    for event in events.iter().filter(|event| filter.accepts(event, began)) {
        // the text of a peer may act on a terminal
        println!("{}", printer.line(event).escape_default());
    }
    Ok(read?)
}
