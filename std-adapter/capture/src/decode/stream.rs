//! One direction of a TCP connection: puts segments in order.

use std::collections::BTreeMap;

use super::packet::Tcp;

/// The maximum number of bytes that wait for missing bytes. Above that the missing bytes are skipped.
const MOST_WAITING: usize = 4 << 20;

/// The new bytes of a segment in its direction.
#[derive(Debug, PartialEq, Eq)]
pub(crate) enum Piece {
    /// The next bytes.
    Bytes(Vec<u8>),
    /// The capture does not have this many bytes.
    Missing(u64),
    /// A segment repeated earlier bytes.
    Retransmission,
    /// A segment arrived before bytes in front of it.
    Reordered,
}

/// Bytes received ahead of missing ones, by their position.
type Waiting = BTreeMap<u64, Vec<u8>>;

/// The state of a direction. Positions count from the first captured byte and do not wrap.
#[derive(Debug, Default)]
pub(crate) struct Half {
    /// The sequence number of the next byte, and its position.
    next: Option<(u32, u64)>,
    waiting: Waiting,
    waiting_bytes: usize,
}

impl Half {
    /// Adds a segment of this direction.
    pub(crate) fn segment(&mut self, tcp: &Tcp, payload: &[u8], out: &mut Vec<Piece>) {
        let first = tcp.sequence.wrapping_add(u32::from(tcp.syn));
        // far from zero, so that a segment before the first one has a position too
        let (next_sequence, next) = *self.next.get_or_insert((first, 1 << 40));
        if payload.is_empty() {
            return;
        }
        let distance = first.wrapping_sub(next_sequence).cast_signed();
        let position = next.saturating_add_signed(distance.into());
        if position > next {
            out.push(Piece::Reordered);
        } else if position + length(payload) <= next {
            // a keep-alive of TCP repeats one byte
            if payload.len() > 1 {
                out.push(Piece::Retransmission);
            }
            return;
        }
        let known = self.waiting.get(&position).map_or(0, Vec::len);
        if payload.len() > known {
            self.waiting.insert(position, payload.to_vec());
            self.waiting_bytes += payload.len() - known;
        }
        self.take(out);
        if self.waiting_bytes > MOST_WAITING {
            self.give_up(u64::MAX, out);
        }
    }

    /// Records that the receiver has all bytes before a sequence number: bytes that the capture lacks will not arrive
    /// later.
    pub(crate) fn acknowledged(&mut self, sequence: u32, out: &mut Vec<Piece>) {
        let Some((next_sequence, next)) = self.next else { return };
        let distance = sequence.wrapping_sub(next_sequence).cast_signed();
        if distance > 0 && !self.waiting.is_empty() {
            self.give_up(next.saturating_add_signed(distance.into()), out);
        }
    }

    /// Ends the direction: missing bytes will not arrive.
    pub(crate) fn end(&mut self, out: &mut Vec<Piece>) {
        self.give_up(u64::MAX, out);
    }

    /// Skips missing bytes that precede waiting bytes, as long as those begin before `limit`.
    fn give_up(&mut self, limit: u64, out: &mut Vec<Piece>) {
        while let (Some((sequence, next)), Some((&start, _))) = (self.next, self.waiting.first_key_value()) {
            if start >= limit {
                break;
            }
            let missing = start.saturating_sub(next);
            if missing > 0 {
                out.push(Piece::Missing(missing));
                self.next = Some((advanced(sequence, missing), start));
            }
            self.take(out);
        }
    }

    /// Takes the waiting bytes that are next.
    fn take(&mut self, out: &mut Vec<Piece>) {
        while let Some((sequence, next)) = self.next {
            let Some(entry) = self.waiting.first_entry().filter(|entry| *entry.key() <= next) else { break };
            let (start, mut bytes) = entry.remove_entry();
            self.waiting_bytes = self.waiting_bytes.saturating_sub(bytes.len());
            let known = usize::try_from(next - start).unwrap_or(usize::MAX).min(bytes.len());
            bytes.drain(..known);
            if bytes.is_empty() {
                continue;
            }
            self.next = Some((advanced(sequence, length(&bytes)), next + length(&bytes)));
            out.push(Piece::Bytes(bytes));
        }
    }
}

fn length(bytes: &[u8]) -> u64 {
    u64::try_from(bytes.len()).unwrap_or(u64::MAX)
}

/// Sequence numbers wrap.
fn advanced(sequence: u32, by: u64) -> u32 {
    let low = by & u64::from(u32::MAX);
    sequence.wrapping_add(u32::try_from(low).unwrap_or(0))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Adds segments of `abcdefgh`, given by first byte and length, and returns the new bytes.
    fn run(first: u32, parts: &[(u32, usize)]) -> (Half, Vec<Piece>) {
        let (mut half, mut out) = (Half::default(), Vec::new());
        let syn = Tcp { sequence: first.wrapping_sub(1), acknowledged: None, syn: true };
        half.segment(&syn, &[], &mut out);
        for (start, count) in parts {
            let tcp = Tcp { sequence: first.wrapping_add(*start), acknowledged: None, syn: false };
            let from = usize::try_from(*start).unwrap();
            half.segment(&tcp, &b"abcdefgh"[from..from + count], &mut out);
        }
        (half, out)
    }

    fn text(pieces: &[Piece]) -> String {
        let shown = |piece: &Piece| match piece {
            Piece::Bytes(bytes) => String::from_utf8(bytes.clone()).unwrap(),
            Piece::Missing(count) => format!("<{count} missing>"),
            Piece::Retransmission => "<again>".into(),
            Piece::Reordered => "<early>".into(),
        };
        pieces.iter().map(shown).collect()
    }

    #[test]
    fn segments_are_put_in_order() {
        for first in [1000, u32::MAX - 3, 0] {
            assert_eq!(text(&run(first, &[(0, 3), (3, 5)]).1), "abcdefgh");
            assert_eq!(text(&run(first, &[(0, 2), (5, 3), (2, 3)]).1), "ab<early>cdefgh");
            assert_eq!(text(&run(first, &[(0, 3), (0, 3), (3, 5)]).1), "abc<again>defgh");
            assert_eq!(text(&run(first, &[(0, 4), (2, 6)]).1), "abcdefgh");
            assert_eq!(text(&run(first, &[(4, 2), (4, 4), (0, 4)]).1), "<early><early>abcdefgh");
        }
    }

    #[test]
    fn missing_bytes_are_given_up_once_they_are_acknowledged_or_at_the_end() {
        let (mut half, mut out) = run(u32::MAX - 3, &[(0, 2), (5, 3)]);
        half.acknowledged(0, &mut out);
        assert_eq!(text(&out), "ab<early>");
        half.acknowledged(4, &mut out);
        assert_eq!(text(&out), "ab<early><3 missing>fgh");
        let (mut half, mut out) = run(7, &[(2, 2), (6, 2)]);
        half.end(&mut out);
        assert_eq!(text(&out), "<early><early><2 missing>cd<2 missing>gh");
    }
}
