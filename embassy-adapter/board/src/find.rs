//! The search for boards over UDP: a request to a network, and the answer of each board.
//!
//! ```text
//!  host  ─► broadcast, port 5011   "BCAPFIND"  number, 8 bytes  zeros up to 192 bytes
//!  board ─► host                   "BCAPHERE"  the same number  "name=cell-7\nboard=w5500-evb-pico\nversion=0.1.0\n"
//!                                                               "address=192.168.0.9/24\nport=5006\nmac=02:00:00:bc:a9:03\n"
//! ```
//!
//! An answer is shorter than its request, so a board cannot amplify a flood. A board answers only hosts of its network, and at
//! most 20 times a second. `port` is the port of RAC. Unknown lines are skipped.

use core::fmt::{self, Write};
use core::net::Ipv4Addr;
use core::str;

/// The UDP port of a board.
pub const PORT: u16 = 5011;
/// The size of a request in bytes, and the most bytes of an answer.
pub const REQUEST: usize = 192;

const ASK: &[u8; 8] = b"BCAPFIND";
const HERE: &[u8; 8] = b"BCAPHERE";
const HEAD: usize = ASK.len() + 8;

/// The facts about a board that any host may know.
///
/// # Examples
///
/// ```
/// use bcap_board::find::{Found, REQUEST, number, request};
///
/// let asked = request(*b"a number");
/// let (address, mac) = (([192, 168, 0, 9].into(), 24), [2, 0, 0, 0xbc, 0xa9, 3]);
/// let board = Found { board: "w5500-evb-pico", version: "0.1.0", address, mac, ..Found::default() };
/// let mut answer = [0; REQUEST];
/// let len = board.write(number(&asked).unwrap(), &mut answer).unwrap();
/// assert_eq!(Found::read(&answer[..len], *b"a number"), Some(board));
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Found<'a> {
    /// Its host name; empty without one.
    pub name: &'a str,
    /// The hardware or the project.
    pub board: &'a str,
    /// The version of the image.
    pub version: &'a str,
    /// Its address, and the length of its network prefix in bits.
    pub address: (Ipv4Addr, u8),
    /// The port of RAC.
    pub port: u16,
    /// Its MAC address.
    pub mac: [u8; 6],
}

impl Default for Found<'_> {
    fn default() -> Self {
        Self { name: "", board: "", version: "", address: (Ipv4Addr::UNSPECIFIED, 0), port: 0, mac: [0; 6] }
    }
}

/// Returns a request. The number is random, so that an answer belongs to it.
#[must_use]
pub fn request(number: [u8; 8]) -> [u8; REQUEST] {
    let mut request = [0; REQUEST];
    if let Some((ask, rest)) = request.split_first_chunk_mut()
        && let Some(place) = rest.first_chunk_mut()
    {
        (*ask, *place) = (*ASK, number);
    }
    request
}

/// Returns the number of a request; `None` for any other datagram.
#[must_use]
pub fn number(datagram: &[u8]) -> Option<[u8; 8]> {
    let rest = datagram.strip_prefix(ASK).filter(|_| datagram.len() == REQUEST)?;
    rest.first_chunk().copied()
}

impl<'a> Found<'a> {
    /// Writes the answer to a request; returns its length, or `None` if a text is too long.
    pub fn write(&self, number: [u8; 8], out: &mut [u8]) -> Option<usize> {
        let Self { name, board, version, address: (address, prefix), port, mac: [a, b, c, d, e, f] } = self;
        let out = out.get_mut(..REQUEST)?;
        let (head, text) = out.split_first_chunk_mut::<HEAD>()?;
        let (here, place) = head.split_first_chunk_mut()?;
        *here = *HERE;
        *place.first_chunk_mut()? = number;
        let mut text = Text::new(text);
        write!(text, "name={name}\nboard={board}\nversion={version}\naddress={address}/{prefix}\nport={port}\n")
            .ok()?;
        writeln!(text, "mac={a:02x}:{b:02x}:{c:02x}:{d:02x}:{e:02x}:{f:02x}").ok()?;
        Some(HEAD + text.len)
    }

    /// Reads the answer to a request with this number.
    #[must_use]
    pub fn read(datagram: &'a [u8], number: [u8; 8]) -> Option<Self> {
        let text = datagram.strip_prefix(HERE)?.strip_prefix(&number)?;
        let mut found = Self::default();
        for line in str::from_utf8(text).ok()?.lines() {
            match line.split_once('=')? {
                ("name", value) => found.name = value,
                ("board", value) => found.board = value,
                ("version", value) => found.version = value,
                ("address", value) => {
                    let (address, prefix) = value.split_once('/')?;
                    found.address = (address.parse().ok()?, prefix.parse().ok().filter(|prefix| *prefix <= 32)?);
                }
                ("port", value) => found.port = value.parse().ok()?,
                ("mac", value) => found.mac = crate::mac::parse(value)?,
                _ => {}
            }
        }
        (!found.address.0.is_unspecified()).then_some(found)
    }
}

/// Text in a buffer.
pub(crate) struct Text<'a> {
    text: &'a mut [u8],
    /// The number of written bytes.
    pub(crate) len: usize,
}

impl<'a> Text<'a> {
    pub(crate) const fn new(text: &'a mut [u8]) -> Self {
        Self { text, len: 0 }
    }
}

impl Write for Text<'_> {
    fn write_str(&mut self, text: &str) -> fmt::Result {
        let room = self.text.get_mut(self.len..self.len + text.len()).ok_or(fmt::Error)?;
        room.copy_from_slice(text.as_bytes());
        self.len += text.len();
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const NUMBER: [u8; 8] = [0, 1, 2, 3, 4, 5, 0xfe, 0xff];
    const BOARD: Found<'_> = Found {
        name: "cell-7",
        board: "w5500-evb-pico",
        version: "0.1.0",
        address: (Ipv4Addr::new(192, 168, 0, 9), 24),
        port: 5006,
        mac: [2, 0, 0, 0xbc, 0xa9, 3],
    };

    #[test]
    fn an_answer_has_the_bytes_of_the_format() {
        let mut out = [0x55; REQUEST + 1];
        let len = BOARD.write(NUMBER, &mut out).unwrap();
        let text = "name=cell-7\nboard=w5500-evb-pico\nversion=0.1.0\naddress=192.168.0.9/24\nport=5006\nmac=02:00:00:bc:a9:03\n";
        assert_eq!(out[..len], *[&b"BCAPHERE\x00\x01\x02\x03\x04\x05\xfe\xff"[..], text.as_bytes()].concat());
        assert_eq!((out[len], out[REQUEST]), (0x55, 0x55));
        assert_eq!(Found::read(&out[..len], NUMBER), Some(BOARD));
    }

    #[test]
    fn the_longest_answer_is_shorter_than_a_request() {
        let (name, version) = ("n".repeat(32), "v".repeat(20));
        let address = (Ipv4Addr::new(192, 168, 100, 200), 24);
        let found = Found { name: &name, board: &name, version: &version, address, port: 65535, mac: [0xff; 6] };
        let len = found.write(NUMBER, &mut [0; REQUEST]).unwrap();
        assert!(len <= REQUEST, "{len} bytes");
        let long = "n".repeat(60);
        assert_eq!(Found { name: &long, ..found }.write(NUMBER, &mut [0; 500]), None, "a longer one is not sent");
        assert_eq!(BOARD.write(NUMBER, &mut [0; REQUEST - 1]), None);
    }

    #[test]
    fn other_datagrams_are_no_requests_and_no_answers() {
        let asked = request(NUMBER);
        assert_eq!(number(&asked), Some(NUMBER));
        // a shorter request would be amplified
        assert!((0..REQUEST).all(|len| number(&asked[..len]).is_none()));
        assert_eq!(number(&[&asked[..], b"x"].concat()), None);
        let mut other = asked;
        other[7] = b'X';
        assert_eq!(number(&other), None);
        let mut out = [0; REQUEST];
        let len = BOARD.write(NUMBER, &mut out).unwrap();
        assert_eq!(number(&out), None, "an answer is no request");
        assert_eq!(Found::read(&out[..len], [0; 8]), None, "another request's");
        // the last line may be cut without its end, all others are needed
        assert!((0..len - 1).all(|len| Found::read(&out[..len], NUMBER) != Some(BOARD)));
        for (from, to) in
            [("192.168.0.9/24", "192.168.0.9/99"), ("5006", "x006"), ("02:00", "0200:"), ("=cell-7", "\u{1}")]
        {
            let text = String::from_utf8_lossy(&out[HEAD..len]).replace(from, to);
            let answer = [HERE, &NUMBER[..], text.as_bytes()].concat();
            assert_eq!(Found::read(&answer, NUMBER), None, "{to}");
        }
    }

    use std::string::String;
}
