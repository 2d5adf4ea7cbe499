//! The calls of connections while they run.

use bcap_core::limits::Strictness;
use pcap_parser::Linktype;

use super::call::{Event, Note};
use super::conversation::Conversations;
use super::file::Packet;
use super::print::{Format, Printer};
use crate::record::Recorded;

/// Turns recorded packets into lines, as a [`Printer`] writes them. A call becomes a line when its reply has arrived.
#[derive(Debug)]
pub struct Live {
    conversations: Conversations,
    format: Format,
    printer: Option<Printer>,
}

impl Live {
    /// No packets yet.
    #[must_use]
    pub fn new(format: Format) -> Self {
        Self { conversations: Conversations::new(Strictness::Lenient), format, printer: None }
    }

    /// Adds a packet, a remark or the end of a connection, and returns the new lines.
    pub fn lines(&mut self, recorded: &Recorded<'_>) -> Vec<String> {
        match *recorded {
            Recorded::Packet { at, bytes } => {
                self.printer.get_or_insert(Printer::new(self.format, at));
                self.conversations.packet(Packet { at, link: Linktype::RAW, bytes });
            }
            Recorded::Closed(ends) => self.conversations.close(ends.is_tcp, ends.client, ends.server),
            Recorded::Note { at, ends, text } => {
                let note = Event::Note(Note { at, link: ends.client.to_string(), text: text.to_owned() });
                return vec![self.printer.get_or_insert(Printer::new(self.format, at)).line(&note)];
            }
        }
        let Some(printer) = &self.printer else { return Vec::new() };
        self.conversations.take_events().iter().map(|event| printer.line(event)).collect()
    }
}
