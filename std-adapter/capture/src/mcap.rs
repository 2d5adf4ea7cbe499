//! Time series as MCAP files, which Foxglove and PlotJuggler read: messages of JSON, with a JSON schema for each channel.
//!
//! ```text
//!  magic  Header  [Chunk: Schema, Channel, Message ...  MessageIndex ...] ...  DataEnd
//!                 Schema ...  Channel ...  Statistics  ChunkIndex ...  SummaryOffset ...  Footer  magic
//! ```
//!
//! A record is an opcode, the length of its content (8 bytes), and the content; all numbers are little-endian
//! (MCAP format specification, version 0). Chunks are not compressed. The file is complete after [`Log::end`]. After a crash the
//! messages up to the last second are in the file, and `mcap recover` restores its index.

use std::collections::{BTreeMap, HashMap};
use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::Path;

use bcap_core::variant::Variant;
use serde_json::Value;

use crate::value::data;

const MAGIC: &[u8] = b"\x89MCAP0\r\n";

/// The maximum time until a message is written to the file, in nanoseconds.
const UNWRITTEN: u64 = 1_000_000_000;

/// The size at which a chunk is written, in bytes.
const CHUNK: usize = 1 << 20;

/// The opcodes of records.
mod opcode {
    pub(super) const HEADER: u8 = 1;
    pub(super) const FOOTER: u8 = 2;
    pub(super) const SCHEMA: u8 = 3;
    pub(super) const CHANNEL: u8 = 4;
    pub(super) const MESSAGE: u8 = 5;
    pub(super) const CHUNK: u8 = 6;
    pub(super) const MESSAGE_INDEX: u8 = 7;
    pub(super) const CHUNK_INDEX: u8 = 8;
    pub(super) const STATISTICS: u8 = 11;
    pub(super) const SUMMARY_OFFSET: u8 = 14;
    pub(super) const DATA_END: u8 = 15;
}

/// The form of the messages of a channel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Schema {
    /// Its name, unique within the file.
    pub name: &'static str,
    /// A JSON schema.
    pub json: &'static str,
}

/// The schema of a number: `{"value":5}`.
pub const NUMBER: Schema =
    Schema { name: "bcap.Number", json: r#"{"type":"object","properties":{"value":{"type":"number"}}}"# };

const BOOL: Schema =
    Schema { name: "bcap.Bool", json: r#"{"type":"object","properties":{"value":{"type":"boolean"}}}"# };
const TEXT: Schema =
    Schema { name: "bcap.Text", json: r#"{"type":"object","properties":{"value":{"type":"string"}}}"# };
const NUMBERS: Schema = Schema {
    name: "bcap.Numbers",
    json: r#"{"type":"object","properties":{"value":{"type":"array","items":{"type":"number"}}}}"#,
};
const BOOLS: Schema = Schema {
    name: "bcap.Bools",
    json: r#"{"type":"object","properties":{"value":{"type":"array","items":{"type":"boolean"}}}}"#,
};

/// Converts the value of a variable to the `value` of a message, with its schema. NaN and infinities become null, because JSON does not
/// have them.
#[must_use]
pub fn sample(value: Variant<'_>) -> (Schema, Value) {
    match value {
        Variant::Bool(on) => (BOOL, on.into()),
        Variant::Array(array) => {
            let values: Vec<Value> = array.iter().map(|element| sample(element).1).collect();
            let has = |is: fn(&Value) -> bool| values.iter().all(is);
            match values {
                _ if has(|value| value.is_number() || value.is_null()) => (NUMBERS, values.into()),
                _ if has(Value::is_boolean) => (BOOLS, values.into()),
                _ => (TEXT, data::format(value).into()),
            }
        }
        // the shortest decimal of the float, not of the double with the same value
        Variant::R4(number) => (NUMBER, number.to_string().parse::<f64>().map_or(Value::Null, Value::from)),
        value => match value.as_i64() {
            Some(number) => (NUMBER, number.into()),
            None => value.as_f64().map_or_else(|| (TEXT, data::format(value).into()), |number| (NUMBER, number.into())),
        },
    }
}

/// A file of time series that is being written.
#[derive(Debug)]
pub struct Log<W: Write> {
    out: W,
    /// The number of bytes in `out`.
    length: u64,
    /// The records of all schemas and channels.
    definitions: [Vec<u8>; 2],
    /// By name, from 1 on.
    schemas: HashMap<&'static str, u16>,
    /// By topic and name of the schema.
    channels: HashMap<(String, &'static str), Channel>,
    chunk: Chunk,
    /// The records of the index of chunks.
    chunks: Vec<u8>,
    /// The number of chunks.
    chunk_count: u32,
    /// The times of the first and the last message.
    times: Option<(u64, u64)>,
}

#[derive(Debug)]
struct Channel {
    id: u16,
    /// The number of all its messages.
    messages: u32,
}

/// The records that are not in the file yet.
#[derive(Debug, Default)]
struct Chunk {
    records: Vec<u8>,
    /// The times of the first and the last message.
    times: Option<(u64, u64)>,
    /// The time and the offset of each message, by channel.
    index: BTreeMap<u16, Vec<u8>>,
}

impl Log<BufWriter<File>> {
    /// Creates the file; an existing file is replaced.
    ///
    /// # Errors
    ///
    /// When the file cannot be created.
    pub fn create(path: &Path) -> io::Result<Self> {
        Self::new(BufWriter::new(File::create(path)?))
    }
}

impl<W: Write> Log<W> {
    /// Begins a file.
    ///
    /// # Errors
    ///
    /// When `out` does not accept the header.
    pub fn new(out: W) -> io::Result<Self> {
        let mut log = Self {
            out,
            length: 0,
            definitions: [Vec::new(), Vec::new()],
            schemas: HashMap::new(),
            channels: HashMap::new(),
            chunk: Chunk::default(),
            chunks: Vec::new(),
            chunk_count: 0,
            times: None,
        };
        let library = concat!("bcap ", env!("CARGO_PKG_VERSION"));
        log.write(MAGIC)?;
        log.write(&record(opcode::HEADER, &[&text(""), &text(library)]))?;
        Ok(log)
    }

    /// Adds a message; `at` is in nanoseconds since 1970. A topic whose schema changes continues in another channel.
    ///
    /// # Errors
    ///
    /// When `out` does not accept the messages, and when the file has 65,535 channels.
    pub fn push(&mut self, topic: &str, schema: Schema, at: u64, message: &Value) -> io::Result<()> {
        let key = (topic.to_owned(), schema.name);
        if !self.channels.contains_key(&key) {
            let id = self.define(topic, schema)?;
            self.channels.insert(key.clone(), Channel { id, messages: 0 });
        }
        let Some(channel) = self.channels.get_mut(&key) else { return Ok(()) };
        let (id, sequence) = (channel.id.to_le_bytes(), channel.messages.to_le_bytes());
        channel.messages = channel.messages.wrapping_add(1);
        let (chunk, time) = (&mut self.chunk, at.to_le_bytes());
        chunk.index.entry(channel.id).or_default().extend([time, long(chunk.records.len())].concat());
        chunk.records.extend(record(opcode::MESSAGE, &[&id, &sequence, &time, &time, message.to_string().as_bytes()]));
        chunk.times = Some(including(chunk.times, at));
        self.times = Some(including(self.times, at));
        if chunk.records.len() >= CHUNK { self.flush() } else { self.write_older(at) }
    }

    /// Writes the pending messages if the first of them is a second older than `now`, in nanoseconds since 1970.
    ///
    /// For series whose next message may be much later.
    ///
    /// # Errors
    ///
    /// When `out` does not accept the messages.
    pub fn write_older(&mut self, now: u64) -> io::Result<()> {
        let is_old = self.chunk.times.is_some_and(|(first, _)| now.saturating_sub(first) >= UNWRITTEN);
        if is_old { self.flush() } else { Ok(()) }
    }

    /// Adds a channel, and its schema if it is new.
    fn define(&mut self, topic: &str, Schema { name, json }: Schema) -> io::Result<u16> {
        let mut add = |kind: usize, record: Vec<u8>| {
            self.chunk.records.extend(&record);
            self.definitions[kind].extend(record);
        };
        // 0 means that there is no schema
        let next = u16::try_from(self.schemas.len() + 1).map_err(io::Error::other)?;
        let schema = *self.schemas.entry(name).or_insert_with(|| {
            let (id, json) = (next.to_le_bytes(), text(json));
            add(0, record(opcode::SCHEMA, &[&id, &text(name), &text("jsonschema"), &json]));
            next
        });
        let id = u16::try_from(self.channels.len()).map_err(io::Error::other)?;
        let (number, schema) = (id.to_le_bytes(), schema.to_le_bytes());
        add(1, record(opcode::CHANNEL, &[&number, &schema, &text(topic), &text("json"), &prefixed(&[])]));
        Ok(id)
    }

    /// Writes the pending messages.
    fn flush(&mut self) -> io::Result<()> {
        let Chunk { records, times, index } = std::mem::take(&mut self.chunk);
        let Some((first, last)) = times else { return Ok(()) };
        let [first, last, size, offset] =
            [first.to_le_bytes(), last.to_le_bytes(), long(records.len()), self.length.to_le_bytes()];
        let crc = crc32(&records).to_le_bytes();
        let chunk = record(opcode::CHUNK, &[&first, &last, &size, &crc, &text(""), &size, &records]);
        self.write(&chunk)?;
        let (begin, mut offsets) = (self.length, Vec::new());
        for (channel, entries) in index {
            offsets.extend(channel.to_le_bytes());
            offsets.extend(self.length.to_le_bytes());
            self.write(&record(opcode::MESSAGE_INDEX, &[&channel.to_le_bytes(), &prefixed(&entries)]))?;
        }
        let [length, indexes] = [long(chunk.len()), (self.length - begin).to_le_bytes()];
        let fields: [&[u8]; 9] =
            [&first, &last, &offset, &length, &prefixed(&offsets), &indexes, &text(""), &size, &size];
        self.chunks.extend(record(opcode::CHUNK_INDEX, &fields));
        self.chunk_count += 1;
        self.out.flush()
    }

    /// Writes the rest and the index.
    ///
    /// # Errors
    ///
    /// When `out` does not accept them.
    pub fn end(&mut self) -> io::Result<()> {
        self.flush()?;
        self.write(&record(opcode::DATA_END, &[&[0; 4]]))?;
        let groups = [
            (opcode::SCHEMA, std::mem::take(&mut self.definitions[0])),
            (opcode::CHANNEL, std::mem::take(&mut self.definitions[1])),
            (opcode::STATISTICS, self.statistics()),
            (opcode::CHUNK_INDEX, std::mem::take(&mut self.chunks)),
        ];
        let (start, mut summary, mut offsets) = (self.length, Vec::new(), Vec::new());
        for (kind, records) in groups.iter().filter(|(_, records)| !records.is_empty()) {
            let begin = start + summary.len() as u64;
            offsets.extend(record(opcode::SUMMARY_OFFSET, &[&[*kind], &begin.to_le_bytes(), &long(records.len())]));
            summary.extend(records);
        }
        let places = [start.to_le_bytes(), (start + summary.len() as u64).to_le_bytes()].concat();
        summary.extend(offsets);
        // the checksum covers the footer up to itself
        let mut footer = record(opcode::FOOTER, &[&places, &[0; 4]]);
        footer.truncate(footer.len() - 4);
        summary.extend(footer);
        let crc = crc32(&summary).to_le_bytes();
        self.write(&[&summary, &crc[..], MAGIC].concat())?;
        self.out.flush()
    }

    /// Returns the output.
    #[must_use]
    pub fn into_inner(self) -> W {
        self.out
    }

    fn statistics(&self) -> Vec<u8> {
        let messages: u64 = self.channels.values().map(|channel| u64::from(channel.messages)).sum();
        let [schemas, channels] =
            [self.schemas.len(), self.channels.len()].map(|count| u32::try_from(count).unwrap_or(u32::MAX));
        let (first, last) = self.times.unwrap_or_default();
        let count =
            |channel: &Channel| [&channel.id.to_le_bytes()[..], &u64::from(channel.messages).to_le_bytes()].concat();
        let counts: Vec<u8> = self.channels.values().flat_map(count).collect();
        let fields: [&[u8]; 9] = [
            &messages.to_le_bytes(),
            &schemas.to_le_bytes()[..2],
            &channels.to_le_bytes(),
            // attachments
            &[0; 4],
            // metadata
            &[0; 4],
            &self.chunk_count.to_le_bytes(),
            &first.to_le_bytes(),
            &last.to_le_bytes(),
            &prefixed(&counts),
        ];
        record(opcode::STATISTICS, &fields)
    }

    fn write(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.length += bytes.len() as u64;
        self.out.write_all(bytes)
    }
}

/// Extends a range of times.
fn including(times: Option<(u64, u64)>, at: u64) -> (u64, u64) {
    times.map_or((at, at), |(first, last)| (first.min(at), last.max(at)))
}

/// Encodes a record of these fields.
fn record(opcode: u8, fields: &[&[u8]]) -> Vec<u8> {
    let content = fields.concat();
    [&[opcode][..], &long(content.len()), &content].concat()
}

/// Encodes a length of 8 bytes.
fn long(length: usize) -> [u8; 8] {
    (length as u64).to_le_bytes()
}

/// Encodes bytes with a length of 4 bytes before them.
fn prefixed(bytes: &[u8]) -> Vec<u8> {
    let length = u32::try_from(bytes.len()).unwrap_or(u32::MAX);
    [&length.to_le_bytes()[..], bytes].concat()
}

fn text(text: &str) -> Vec<u8> {
    prefixed(text.as_bytes())
}

/// Returns the CRC-32 of bytes, as in zlib.
fn crc32(bytes: &[u8]) -> u32 {
    let shifted = |crc: u32, _| (crc >> 1) ^ (0xedb8_8320 & (crc & 1).wrapping_neg());
    !bytes.iter().fold(u32::MAX, |crc, byte| (0..8).fold(crc ^ u32::from(*byte), shifted))
}

#[cfg(test)]
mod tests {
    use super::*;
    use bcap_core::variant::{Encode, OwnedVariant};

    #[test]
    fn values_are_json() {
        let sample = |value: &dyn Encode| {
            let value = OwnedVariant::new(value).unwrap();
            let (schema, json) = super::sample(value.as_variant());
            format!("{} {json}", schema.name)
        };
        assert_eq!(sample(&5_i32), "bcap.Number 5");
        assert_eq!(sample(&0.1_f32), "bcap.Number 0.1");
        assert_eq!(sample(&f64::NAN), "bcap.Number null");
        assert_eq!(sample(&f32::INFINITY), "bcap.Number null");
        assert_eq!(sample(&true), "bcap.Bool true");
        assert_eq!(sample(&"a\"b"), "bcap.Text \"a\\\"b\"");
        assert_eq!(sample(&[400.5_f32, -1.0]), "bcap.Numbers [400.5,-1.0]");
        assert_eq!(sample(&[true, false]), "bcap.Bools [true,false]");
        assert_eq!(sample(&["a", "b"]), "bcap.Text \"a,b\"");
        assert_eq!(sample(&()), "bcap.Text \"EMPTY\"");
    }

    #[test]
    fn schemas_are_json() {
        for schema in [NUMBER, BOOL, TEXT, NUMBERS, BOOLS] {
            assert_eq!(serde_json::from_str::<Value>(schema.json).unwrap()["type"], "object");
        }
    }
}
