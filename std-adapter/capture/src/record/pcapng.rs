//! The blocks of a pcapng file: a section, one interface, and a block for each packet.
//!
//! The format is defined in draft-ietf-opsawg-pcapng. Three kinds of blocks need less code than a crate that writes all
//! kinds.

use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::Path;

const SECTION: u32 = 0x0a0d_0d0a;
const INTERFACE: u32 = 1;
const PACKET: u32 = 6;
/// The link type of packets that begin with an IP header.
const RAW_IP: u16 = 101;

// options
const COMMENT: u16 = 1;
const APPLICATION: u16 = 4;
const TIME_RESOLUTION: u16 = 9;

/// Writes a file.
#[derive(Debug)]
pub(super) struct Writer<W> {
    file: W,
    block: Vec<u8>,
}

impl Writer<BufWriter<File>> {
    /// Creates the file, or empties it, and writes its head.
    pub(super) fn create(path: &Path) -> io::Result<Self> {
        Self::new(BufWriter::new(File::create(path)?))
    }
}

impl<W: Write> Writer<W> {
    /// Writes the head of a file.
    pub(super) fn new(file: W) -> io::Result<Self> {
        let mut writer = Self { file, block: Vec::new() };
        // the byte order, version 1.0, a section of unknown length
        let mut section = 0x1a2b_3c4d_u32.to_le_bytes().to_vec();
        section.extend([1, 0, 0, 0]);
        section.extend((-1_i64).to_le_bytes());
        option(&mut section, APPLICATION, concat!("bcap ", env!("CARGO_PKG_VERSION")).as_bytes());
        end_of_options(&mut section);
        writer.write_block(SECTION, &section)?;
        // packets are not cut
        let mut interface = u32::from(RAW_IP).to_le_bytes().to_vec();
        interface.extend(0_u32.to_le_bytes());
        const NANOSECONDS: u8 = 9;
        option(&mut interface, TIME_RESOLUTION, &[NANOSECONDS]);
        end_of_options(&mut interface);
        writer.write_block(INTERFACE, &interface)?;
        writer.flush()?;
        Ok(writer)
    }

    /// Writes a packet, at nanoseconds since 1970.
    pub(super) fn packet(&mut self, at: u64, bytes: &[u8], comment: Option<&str>) -> io::Result<()> {
        let length = length(bytes.len())?;
        let mut block = std::mem::take(&mut self.block);
        block.clear();
        let [a, b, c, d, e, f, g, h] = at.to_be_bytes();
        let (high, low) = (u32::from_be_bytes([a, b, c, d]), u32::from_be_bytes([e, f, g, h]));
        for field in [0, high, low, length, length] {
            block.extend(field.to_le_bytes());
        }
        padded(&mut block, bytes);
        if let Some(comment) = comment {
            option(&mut block, COMMENT, comment.as_bytes());
            end_of_options(&mut block);
        }
        let written = self.write_block(PACKET, &block);
        self.block = block;
        written
    }

    pub(super) fn flush(&mut self) -> io::Result<()> {
        self.file.flush()
    }

    /// Writes a block whose body has a multiple of four bytes.
    fn write_block(&mut self, kind: u32, body: &[u8]) -> io::Result<()> {
        const HEAD_AND_TAIL: usize = 12;
        let length = length(body.len() + HEAD_AND_TAIL)?.to_le_bytes();
        self.file.write_all(&kind.to_le_bytes())?;
        self.file.write_all(&length)?;
        self.file.write_all(body)?;
        self.file.write_all(&length)
    }
}

fn length(bytes: usize) -> io::Result<u32> {
    u32::try_from(bytes).map_err(|_| io::Error::other("a packet has more than 4 GiB"))
}

/// Adds bytes and zeros up to a multiple of four.
fn padded(out: &mut Vec<u8>, bytes: &[u8]) {
    out.extend_from_slice(bytes);
    out.resize(out.len().next_multiple_of(4), 0);
}

fn option(out: &mut Vec<u8>, code: u16, value: &[u8]) {
    let value = value.get(..usize::from(u16::MAX)).unwrap_or(value);
    out.extend(code.to_le_bytes());
    out.extend(u16::try_from(value.len()).unwrap_or(0).to_le_bytes());
    padded(out, value);
}

fn end_of_options(out: &mut Vec<u8>) {
    out.extend([0; 4]);
}
