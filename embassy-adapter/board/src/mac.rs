//! MAC addresses: for a board that has none in hardware, and as text.

/// The offset basis and the prime of the hash FNV-1a with 64 bits.
const OFFSET_BASIS: u64 = 0xcbf2_9ce4_8422_2325;
const PRIME: u64 = 0x0000_0100_0000_01b3;
/// Bits of the first byte of an address.
const MULTICAST: u8 = 1 << 0;
const LOCALLY_ADMINISTERED: u8 = 1 << 1;

/// Derives a MAC address from the unique id of a chip.
///
/// The address is unicast and locally administered. The same id always gives the same address. Two ids give the same
/// address with a probability of 2^-46.
///
/// # Examples
///
/// ```
/// let mac = bcap_board::mac::from_unique_id(b"\x2a\x00\x31\x00\x0d\x51\x33\x32\x31\x31\x39\x36");
/// assert_eq!(mac[0] & 0b11, 0b10, "unicast, locally administered");
/// ```
#[must_use]
pub fn from_unique_id(id: &[u8]) -> [u8; 6] {
    let hash = id.iter().fold(OFFSET_BASIS, |hash, byte| (hash ^ u64::from(*byte)).wrapping_mul(PRIME));
    // the highest bits are the best mixed ones, so they take part in the lowest 48
    let [a, b, c, d, e, f, ..] = (hash ^ hash >> 48).to_le_bytes();
    [a & !MULTICAST | LOCALLY_ADMINISTERED, b, c, d, e, f]
}

/// Parses an address such as `02:00:00:bc:a9:03`.
pub(crate) fn parse(value: &str) -> Option<[u8; 6]> {
    let mut mac = [0; 6];
    let mut parts = value.split(':');
    for byte in &mut mac {
        *byte = parts.next().filter(|part| part.len() == 2).and_then(|part| u8::from_str_radix(part, 16).ok())?;
    }
    // a multicast address or the zero address cannot be a board's address
    (parts.next().is_none() && mac[0] & 1 == 0 && mac != [0; 6]).then_some(mac)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    #[test]
    fn addresses_are_unicast_local_and_differ() {
        let mut found = BTreeSet::new();
        // unique ids of one wafer: an x and a y coordinate in an id of 96 bits
        for x in 0..100_u8 {
            for y in 0..100_u8 {
                let mac = from_unique_id(&[x, 0, y, 0, 0x0d, 0x51, 0x33, 0x32, 0x31, 0x31, 0x39, 0x36]);
                assert_eq!(mac[0] & 0b11, 0b10);
                assert!(found.insert(mac), "{x} {y}");
            }
        }
    }

    #[test]
    fn an_address_never_changes() {
        // a changed address would take another lease, so this value is fixed
        assert_eq!(from_unique_id(b""), [0xd6, 0xe8, 0x22, 0x84, 0xe4, 0x9c]);
    }
}
