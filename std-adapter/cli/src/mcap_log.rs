//! Time series as MCAP files, which Foxglove and PlotJuggler read: messages of JSON, with a JSON schema for each channel.
//!
//! The file has chunks with an index and is not compressed. It is complete after [`McapLog::end`]. After a crash the messages up
//! to the last second are in the file, and `mcap recover` restores its index.

use std::collections::{BTreeMap, HashMap};
use std::fs::File;
use std::io::{self, BufWriter, Seek, Write};
use std::path::Path;

use mcap::records::MessageHeader;
use mcap::{McapError, WriteOptions, Writer};
use serde_json::Value;

/// The longest time of messages that are not in the file yet, in nanoseconds.
const UNWRITTEN: u64 = 1_000_000_000;

/// The form of the messages of a channel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Schema {
    pub(crate) name: &'static str,
    /// A JSON schema.
    pub(crate) json: &'static str,
}

/// A file of time series that is being written.
pub(crate) struct McapLog<W: Write + Seek> {
    writer: Writer<W>,
    /// By topic and name of the schema.
    channels: HashMap<(String, &'static str), Channel>,
    /// The time of the first message that may not be in the file yet.
    unwritten: u64,
}

struct Channel {
    id: u16,
    /// The messages so far.
    messages: u32,
}

impl McapLog<BufWriter<File>> {
    /// Creates the file, in place of one that exists.
    pub(crate) fn create(path: &Path) -> io::Result<Self> {
        Self::new(BufWriter::new(File::create(path)?))
    }
}

impl<W: Write + Seek> McapLog<W> {
    pub(crate) fn new(out: W) -> io::Result<Self> {
        let options = WriteOptions::new().compression(None).library(concat!("bcap ", env!("CARGO_PKG_VERSION")));
        let writer = options.create(out).map_err(failed)?;
        Ok(Self { writer, channels: HashMap::new(), unwritten: 0 })
    }

    /// Adds a message; `at` is in nanoseconds since 1970. A topic whose schema changes continues in another channel.
    pub(crate) fn push(&mut self, topic: &str, schema: Schema, at: u64, message: &Value) -> io::Result<()> {
        let key = (topic.to_owned(), schema.name);
        if !self.channels.contains_key(&key) {
            let channel = self.channel(topic, schema).map_err(failed)?;
            self.channels.insert(key.clone(), channel);
        }
        let Some(channel) = self.channels.get_mut(&key) else { return Ok(()) };
        let (channel_id, sequence) = (channel.id, channel.messages);
        channel.messages = channel.messages.wrapping_add(1);
        let header = MessageHeader { channel_id, sequence, log_time: at, publish_time: at };
        self.writer.write_to_known_channel(&header, message.to_string().as_bytes()).map_err(failed)?;
        if at.saturating_sub(self.unwritten) >= UNWRITTEN {
            self.writer.flush().map_err(failed)?;
            self.unwritten = at;
        }
        Ok(())
    }

    fn channel(&mut self, topic: &str, schema: Schema) -> Result<Channel, McapError> {
        let schema = self.writer.add_schema(schema.name, "jsonschema", schema.json.as_bytes())?;
        let id = self.writer.add_channel(schema, topic, "json", &BTreeMap::new())?;
        Ok(Channel { id, messages: 0 })
    }

    /// Writes the rest and the index.
    pub(crate) fn end(&mut self) -> io::Result<()> {
        self.writer.finish().map(drop).map_err(failed)
    }
}

fn failed(error: McapError) -> io::Error {
    match error {
        McapError::Io(error) => error,
        error => io::Error::other(error),
    }
}
