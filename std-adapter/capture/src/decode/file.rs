//! Reads the packets of a capture file, pcap or pcapng.

use std::fs::File;
use std::path::Path;

use pcap_parser::pcapng::Block;
use pcap_parser::{IDB_MAGIC, Linktype, PcapBlockOwned, PcapError, create_reader};

use crate::error::Error;

/// The buffer for one block of the file, which grows to [`LARGEST_BLOCK`].
const BUFFER: usize = 1 << 20;
const LARGEST_BLOCK: usize = 64 << 20;

/// A packet of a capture.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Packet<'a> {
    /// Nanoseconds since 1970.
    pub(crate) at: u64,
    /// The type of its first header.
    pub(crate) link: Linktype,
    /// The captured bytes; with a snap length not all of the packet.
    pub(crate) bytes: &'a [u8],
}

/// An interface of a capture: its link type and the ticks of its clock.
#[derive(Clone, Copy)]
struct Interface {
    link: Linktype,
    ticks_per_second: u64,
    /// Seconds to add to every time.
    offset: i64,
}

const NANOS: u64 = 1_000_000_000;

impl Interface {
    /// Converts ticks to nanoseconds since 1970.
    fn time(&self, ticks: u64) -> u64 {
        let unit = self.ticks_per_second.max(1);
        let part = u128::from(ticks % unit) * u128::from(NANOS) / u128::from(unit);
        let seconds = (ticks / unit).saturating_add_signed(self.offset);
        seconds.saturating_mul(NANOS).saturating_add(u64::try_from(part).unwrap_or(0))
    }
}

/// Passes each packet of a file to `each`.
///
/// An error is returned after the preceding packets were passed on.
pub(crate) fn read(path: &Path, mut each: impl FnMut(Packet<'_>)) -> Result<(), Error> {
    let failed = |reason: &str| Error::invalid(path, reason);
    let file = File::open(path).map_err(|source| Error::Open { path: path.to_owned(), source })?;
    let mut reader = create_reader(BUFFER, file).map_err(|error| failed(meaning(&error)))?;
    let mut interfaces = Vec::new();
    let mut capacity = BUFFER;
    loop {
        let needs = match reader.next() {
            Ok((used, block)) => {
                add_block(&block, &mut interfaces, &mut each);
                reader.consume(used);
                continue;
            }
            Err(PcapError::Eof) => return Ok(()),
            Err(PcapError::Incomplete(needs)) => needs,
            Err(PcapError::BufferTooSmall) => capacity,
            Err(error) => return Err(failed(meaning(&error))),
        };
        let unread = reader.data().len();
        if unread.saturating_add(needs) > capacity {
            capacity *= 2;
            if capacity > LARGEST_BLOCK {
                return Err(failed(&format!("a block is larger than {} MiB", LARGEST_BLOCK >> 20)));
            }
            reader.grow(capacity);
        }
        if reader.refill().is_err() {
            return Err(failed("the file cannot be read"));
        }
        if reader.reader_exhausted() && reader.data().len() == unread {
            return if unread == 0 { Ok(()) } else { Err(failed("the file ends inside a packet")) };
        }
    }
}

fn meaning<I>(error: &PcapError<I>) -> &'static str {
    match error {
        PcapError::Eof => "the file is empty",
        PcapError::HeaderNotRecognized => "the file is neither pcap nor pcapng",
        PcapError::BufferTooSmall => "a block of the file is too large",
        PcapError::ReadError => "the file cannot be read",
        PcapError::UnexpectedEof | PcapError::Incomplete(_) => "the file ends inside a packet",
        PcapError::NomError(..) | PcapError::OwnedNomError(..) => "the file has an invalid block",
    }
}

/// Returns the resolution that a byte of if_tsresol means: a power of 10, or of 2 with the highest bit. pcap-parser 0.17 does
/// not support powers of 2.
fn ticks_per_second(resolution: u8) -> u64 {
    let power = u32::from(resolution & 0x7f);
    let ticks = if resolution < 0x80 { 10_u64.checked_pow(power) } else { 1_u64.checked_shl(power) };
    ticks.unwrap_or(1_000_000)
}

fn add_block(block: &PcapBlockOwned<'_>, interfaces: &mut Vec<Interface>, each: &mut impl FnMut(Packet<'_>)) {
    match block {
        PcapBlockOwned::LegacyHeader(header) => {
            let ticks_per_second = if header.is_nanosecond_precision() { NANOS } else { 1_000_000 };
            // the upper bits may contain the length of the check sequence of Ethernet
            let link = Linktype(header.network.0 & 0xffff);
            interfaces.push(Interface { link, ticks_per_second, offset: 0 });
        }
        PcapBlockOwned::Legacy(packet) => {
            let Some(interface) = interfaces.first() else { return };
            let ticks = u64::from(packet.ts_sec) * interface.ticks_per_second + u64::from(packet.ts_usec);
            each(Packet { at: interface.time(ticks), link: interface.link, bytes: packet.data });
        }
        PcapBlockOwned::NG(Block::SectionHeader(_)) => interfaces.clear(),
        PcapBlockOwned::NG(Block::InterfaceDescription(description)) => interfaces.push(Interface {
            link: description.linktype,
            ticks_per_second: ticks_per_second(description.if_tsresol),
            // pcap-parser 0.17 reads the offset as little-endian, as it does with the type of the block
            offset: match description.block_type {
                IDB_MAGIC => description.ts_offset(),
                _ => description.ts_offset().swap_bytes(),
            },
        }),
        PcapBlockOwned::NG(Block::EnhancedPacket(packet)) => {
            let index = usize::try_from(packet.if_id).unwrap_or(usize::MAX);
            let Some(interface) = interfaces.get(index) else { return };
            let ticks = u64::from(packet.ts_high) << 32 | u64::from(packet.ts_low);
            let length = usize::try_from(packet.caplen).unwrap_or(usize::MAX);
            let bytes = packet.data.get(..length).unwrap_or(packet.data);
            each(Packet { at: interface.time(ticks), link: interface.link, bytes });
        }
        PcapBlockOwned::NG(Block::SimplePacket(packet)) => {
            let Some(interface) = interfaces.first() else { return };
            let length = usize::try_from(packet.origlen).unwrap_or(usize::MAX);
            let bytes = packet.data.get(..length).unwrap_or(packet.data);
            each(Packet { at: 0, link: interface.link, bytes });
        }
        PcapBlockOwned::NG(_) => {}
    }
}
