//! An LLDP frame, which identifies the board to the switch port that it is connected to (IEEE 802.1AB).
//!
//! ```text
//!  01:80:c2:00:00:0e  MAC of the board  0x88cc
//!    chassis: MAC    port: MAC    time to live: 120 s    name    description: board and version    management: IPv4
//!  each: type (7 bits), length (9 bits), value
//! ```

use core::net::Ipv4Addr;

/// The maximum size of a frame in bytes: a name has 32 at most, a description 53.
pub(crate) const FRAME: usize = 160;
/// How long a switch keeps the contents of a frame, in seconds. Four times the interval of frames, as the standard suggests.
const TIME_TO_LIVE: u16 = 120;

/// The address of all switches next to the sender, and the type of LLDP.
const NEAREST: [u8; 6] = [0x01, 0x80, 0xc2, 0, 0, 0x0e];
const LLDP: [u8; 2] = [0x88, 0xcc];
/// The types of entries.
const END: u8 = 0;
const CHASSIS: u8 = 1;
const PORT: u8 = 2;
const TIME: u8 = 3;
const NAME: u8 = 5;
const DESCRIPTION: u8 = 6;
const MANAGEMENT: u8 = 8;
/// The kinds of a chassis and of a port that are MAC addresses.
const CHASSIS_MAC: u8 = 4;
const PORT_MAC: u8 = 3;

/// Writes the frame of a board, and returns its length.
pub(crate) fn write(mac: [u8; 6], own: Ipv4Addr, name: &str, description: [&str; 3], out: &mut [u8; FRAME]) -> usize {
    let mut frame = LldpFrame { out, len: 0 };
    frame.add(&[&NEAREST, &mac, &LLDP]);
    frame.entry(CHASSIS, &[&[CHASSIS_MAC], &mac]);
    frame.entry(PORT, &[&[PORT_MAC], &mac]);
    frame.entry(TIME, &[&TIME_TO_LIVE.to_be_bytes()]);
    if !name.is_empty() {
        frame.entry(NAME, &[name.as_bytes()]);
    }
    frame.entry(DESCRIPTION, &description.map(str::as_bytes));
    // the length and the family of the address; an interface without a number and an object without an identifier
    frame.entry(MANAGEMENT, &[&[5, 1], &own.octets(), &[1, 0, 0, 0, 0, 0]]);
    frame.entry(END, &[]);
    frame.len
}

struct LldpFrame<'a> {
    out: &'a mut [u8; FRAME],
    len: usize,
}

impl LldpFrame<'_> {
    /// Adds an entry, if there is room.
    fn entry(&mut self, kind: u8, value: &[&[u8]]) {
        let len = value.iter().map(|part| part.len()).sum::<usize>();
        if let Ok(short) = u8::try_from(len)
            && self.len + 2 + len <= FRAME
        {
            self.add(&[&[kind << 1, short]]);
            self.add(value);
        }
    }

    fn add(&mut self, parts: &[&[u8]]) {
        let bytes = parts.iter().copied().flatten();
        for (to, from) in self.out.iter_mut().skip(self.len).zip(bytes) {
            *to = *from;
            self.len += 1;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MAC: [u8; 6] = [2, 0, 0, 0xbc, 0xa9, 3];
    const OWN: Ipv4Addr = Ipv4Addr::new(192, 168, 0, 9);

    #[test]
    fn a_frame_has_the_entries_of_the_standard() {
        let mut out = [0; FRAME];
        let len = write(MAC, OWN, "cell-7", ["pico", " ", "0.1.0"], &mut out);
        let expected: [&[u8]; 9] = [
            &[0x01, 0x80, 0xc2, 0, 0, 0x0e, 2, 0, 0, 0xbc, 0xa9, 3, 0x88, 0xcc],
            &[2, 7, 4, 2, 0, 0, 0xbc, 0xa9, 3],
            &[4, 7, 3, 2, 0, 0, 0xbc, 0xa9, 3],
            &[6, 2, 0, 120],
            &[10, 6, b'c', b'e', b'l', b'l', b'-', b'7'],
            &[12, 10],
            b"pico 0.1.0",
            &[16, 12, 5, 1, 192, 168, 0, 9, 1, 0, 0, 0, 0, 0],
            &[0, 0],
        ];
        assert_eq!(out[..len], expected.concat());
    }

    #[test]
    fn the_longest_frame_fits_and_a_longer_one_lacks_entries() {
        let (name, board, version) = ("n".repeat(32), "b".repeat(32), "1".repeat(20));
        let mut out = [0; FRAME];
        let len = write(MAC, OWN, &name, [&board, " ", &version], &mut out);
        assert!(len <= FRAME && out[..len].ends_with(&[1, 0, 0, 0, 0, 0, 0, 0]), "{len}");
        let len = write(MAC, OWN, &"n".repeat(300), [&board, &board, &"x".repeat(100)], &mut out);
        assert!(out[..len].ends_with(&[16, 12, 5, 1, 192, 168, 0, 9, 1, 0, 0, 0, 0, 0, 0, 0]), "{len}");
    }
}
