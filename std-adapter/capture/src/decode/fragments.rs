//! Reassembles the fragments of IPv4 packets (RFC 791), with bounded memory.

use std::collections::{BTreeMap, VecDeque};
use std::net::Ipv4Addr;

use etherparse::{IpNumber, LaxIpv4Slice};

/// The maximum number of incomplete packets; one more drops the oldest.
const PACKETS: usize = 64;

/// The maximum payload of a packet, and the maximum number of bytes of its fragments, which may overlap.
const LARGEST: usize = 65_535;

/// The maximum time from the first fragment to the last, in nanoseconds, because identifications are reused.
const LONGEST: u64 = 30_000_000_000;

/// A fragment.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Fragment<'a> {
    pub(crate) key: Key,
    offset: usize,
    is_last: bool,
    bytes: &'a [u8],
}

/// Which packet a fragment belongs to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Key {
    pub(crate) from: Ipv4Addr,
    pub(crate) to: Ipv4Addr,
    pub(crate) protocol: IpNumber,
    identification: u16,
}

impl<'a> Fragment<'a> {
    /// Reads the header of a fragment; `None` if the capture has only a part of its bytes.
    pub(crate) fn new(ip: &LaxIpv4Slice<'a>) -> Option<Self> {
        let (header, payload) = (ip.header(), ip.payload());
        let key = Key {
            from: header.source_addr(),
            to: header.destination_addr(),
            protocol: header.protocol(),
            identification: header.identification(),
        };
        let offset = usize::from(header.fragments_offset().byte_offset());
        let is_last = !header.more_fragments();
        (!payload.incomplete).then_some(Self { key, offset, is_last, bytes: payload.payload })
    }
}

/// A packet of which some fragments are missing.
#[derive(Debug)]
struct Partial {
    key: Key,
    began: u64,
    /// The fragments by their offsets.
    pieces: BTreeMap<usize, Vec<u8>>,
    /// The bytes of all fragments.
    held: usize,
    /// The length of the payload, once the last fragment is known.
    length: Option<usize>,
}

impl Partial {
    /// Returns the payload if it is complete. Where fragments overlap, the one with the lower offset counts.
    fn payload(&self) -> Option<Vec<u8>> {
        let length = self.length?;
        let mut payload = Vec::new();
        for (offset, piece) in &self.pieces {
            let known = payload.len().checked_sub(*offset)?;
            payload.extend_from_slice(piece.get(known..).unwrap_or_default());
        }
        (payload.len() == length).then_some(payload)
    }
}

/// All packets of which some fragments are missing, the oldest first.
#[derive(Debug, Default)]
pub(crate) struct Fragments {
    partial: VecDeque<Partial>,
    dropped: usize,
}

impl Fragments {
    /// Adds a fragment; returns the payload of its packet if it is complete.
    pub(crate) fn add(&mut self, fragment: &Fragment<'_>, at: u64) -> Option<Vec<u8>> {
        let is_old = |partial: &Partial| at.saturating_sub(partial.began) > LONGEST;
        while self.partial.front().is_some_and(is_old) {
            self.drop_packet(0);
        }
        let found = self.partial.iter().position(|partial| partial.key == fragment.key);
        let number = found.unwrap_or_else(|| {
            if self.partial.len() >= PACKETS {
                self.drop_packet(0);
            }
            let (key, pieces) = (fragment.key, BTreeMap::new());
            self.partial.push_back(Partial { key, began: at, pieces, held: 0, length: None });
            self.partial.len().saturating_sub(1)
        });
        let partial = self.partial.get_mut(number)?;
        let end = fragment.offset + fragment.bytes.len();
        // a fragment that arrives twice replaces itself
        let replaced = partial.pieces.insert(fragment.offset, fragment.bytes.to_vec());
        partial.held = partial.held + fragment.bytes.len() - replaced.map_or(0, |piece| piece.len());
        if fragment.is_last {
            partial.length = Some(end);
        }
        if end > LARGEST || partial.held > LARGEST {
            self.drop_packet(number);
            return None;
        }
        let payload = partial.payload()?;
        self.partial.remove(number);
        Some(payload)
    }

    fn drop_packet(&mut self, number: usize) {
        self.dropped += self.partial.remove(number).map_or(0, |partial| partial.pieces.len());
    }

    /// Returns how many fragments belong to packets that did not become complete.
    pub(crate) fn incomplete(&self) -> usize {
        self.dropped + self.partial.iter().map(|partial| partial.pieces.len()).sum::<usize>()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const KEY: Key =
        Key { from: Ipv4Addr::LOCALHOST, to: Ipv4Addr::BROADCAST, protocol: IpNumber::UDP, identification: 7 };

    fn fragment(identification: u16, range: std::ops::Range<usize>, bytes: &[u8]) -> Fragment<'_> {
        let is_last = range.end == bytes.len();
        Fragment { key: Key { identification, ..KEY }, offset: range.start, is_last, bytes: &bytes[range] }
    }

    #[test]
    fn fragments_of_two_packets_in_any_order_and_twice_are_put_together() {
        let bytes: Vec<u8> = (0..3000).map(|n| n as u8).collect();
        let mut fragments = Fragments::default();
        let mut add = |id, range| fragments.add(&fragment(id, range, &bytes), 0);
        assert_eq!(add(1, 1480..2960), None);
        assert_eq!(add(2, 0..1480), None);
        assert_eq!(add(1, 2960..3000), None);
        assert_eq!(add(1, 1480..2960), None);
        assert_eq!(add(1, 0..1480), Some(bytes.clone()));
        // an overlap
        assert_eq!(add(2, 1000..2000), None);
        assert_eq!(add(2, 1600..3000), Some(bytes.clone()));
        assert_eq!(fragments.incomplete(), 0);
    }

    #[test]
    fn memory_is_bounded_and_old_fragments_are_dropped() {
        let bytes = vec![0; LARGEST];
        let mut fragments = Fragments::default();
        for identification in 0..1000 {
            assert_eq!(fragments.add(&fragment(identification, 8..60_000, &bytes), 0), None);
        }
        assert_eq!((fragments.partial.len(), fragments.incomplete()), (PACKETS, 1000));
        // fragments that overlap
        for offset in (0..8000).step_by(8) {
            assert_eq!(fragments.add(&fragment(1001, offset..offset + 1400, &bytes), 0), None);
            assert!(fragments.partial.iter().all(|partial| partial.held <= LARGEST));
        }
        // the rest of a packet arrives after its identification may have been reused
        assert_eq!(fragments.add(&fragment(2000, 0..8, &bytes[..16]), 0), None);
        assert_eq!(fragments.add(&fragment(2000, 8..16, &bytes[..16]), LONGEST + 1), None);
        assert_eq!(fragments.partial.len(), 1);
    }
}
