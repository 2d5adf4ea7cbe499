//! The packets of all connections, in the order in which their bytes were recorded.

use std::collections::HashMap;
use std::io::{self, Write};

use super::ends::{Ends, Recorded};
use super::packets::Flow;
use super::pcapng::Writer;
use crate::role::Role;

/// Makes packets, and passes them to the file and to the command.
pub(super) struct Tape<W, F> {
    file: Option<Writer<W>>,
    each: F,
    flows: HashMap<Ends, Flow>,
    /// The number of flows until now.
    count: u32,
}

impl<W: Write, F: FnMut(Recorded<'_>)> Tape<W, F> {
    pub(super) fn new(file: Option<Writer<W>>, each: F) -> Self {
        Self { file, each, flows: HashMap::new(), count: 0 }
    }

    /// Writes the packets that open a connection, if it is not open.
    pub(super) fn open(&mut self, at: u64, ends: Ends) -> io::Result<()> {
        if self.flows.contains_key(&ends) {
            return Ok(());
        }
        self.count = self.count.wrapping_add(1);
        let flow = Flow::new(ends, self.count);
        let handshake = flow.handshake();
        self.flows.insert(ends, flow);
        self.packets(at, &handshake, None)
    }

    /// Writes the packets of sent bytes.
    pub(super) fn bytes(
        &mut self,
        at: u64,
        ends: Ends,
        sender: Role,
        bytes: &[u8],
        note: Option<&str>,
    ) -> io::Result<()> {
        self.open(at, ends)?;
        let packets = self.flows.get_mut(&ends).map(|flow| flow.send(sender, bytes)).unwrap_or_default();
        self.packets(at, &packets, note)?;
        if let Some(text) = note {
            self.note(at, ends, text);
        }
        Ok(())
    }

    /// Writes the packets that close a connection.
    pub(super) fn close(&mut self, at: u64, ends: Ends) -> io::Result<()> {
        let packets = self.flows.remove(&ends).map(|mut flow| flow.close()).unwrap_or_default();
        self.packets(at, &packets, None)?;
        (self.each)(Recorded::Closed(ends));
        Ok(())
    }

    pub(super) fn note(&mut self, at: u64, ends: Ends, text: &str) {
        (self.each)(Recorded::Note { at, ends, text });
    }

    pub(super) fn flush(&mut self) -> io::Result<()> {
        self.file.as_mut().map_or(Ok(()), Writer::flush)
    }

    fn packets(&mut self, at: u64, packets: &[Vec<u8>], comment: Option<&str>) -> io::Result<()> {
        for bytes in packets {
            if let Some(file) = &mut self.file {
                file.packet(at, bytes, comment)?;
            }
            (self.each)(Recorded::Packet { at, bytes });
        }
        Ok(())
    }
}
