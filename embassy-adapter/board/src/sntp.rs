//! The time from a server of SNTP ([RFC 4330](https://www.rfc-editor.org/rfc/rfc4330)), for the log and syslog.
//!
//! ```text
//!  board ─► server   23 00 .. 00  number, 8 bytes, in place of the time of sending
//!  server ─► board   24 stratum .. the same number as the origin  time of receiving  time of sending, 8 bytes
//! ```
//!
//! An answer counts only if it has the number of the last request, which is random, and its server is synchronised. It is not
//! signed: an attacker who can read the network can forge the time, so only texts depend on it.

use core::fmt;

/// The UDP port of a server.
pub const PORT: u16 = 123;
/// The size of a request, and of an answer without extensions.
pub const SIZE: usize = 48;

/// Version 4, a client.
const CLIENT: u8 = 0x23;
const SERVER_MODE: u8 = 4;
const UNSYNCHRONISED: u8 = 3;
/// Offsets in a message.
const ORIGIN: usize = 24;
const TRANSMIT: usize = 40;
/// Seconds from 1900 to 1970, and from one era of the 32 bits to the next.
const UNIX: u64 = 2_208_988_800;
const ERA: u64 = 1 << 32;
/// 2026-01-01: no board with this software runs earlier.
const LEAST: u64 = 1_767_225_600;

/// Why an answer is refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Refused {
    /// It is too short, or not of version 3 or 4.
    Format,
    /// It is not from a server: the mode is not 4.
    Mode,
    /// It does not answer the last request.
    Origin,
    /// The server has no time: stratum 0 or above 15, or its clock is not synchronised.
    Unsynchronised,
    /// The time is before 2026 or after 2103.
    Time,
}

impl Refused {
    /// Returns a description.
    #[must_use]
    pub const fn text(self) -> &'static str {
        match self {
            Self::Format => "not an answer of SNTP",
            Self::Mode => "not from a server",
            Self::Origin => "not to the last request",
            Self::Unsynchronised => "the server is not synchronised",
            Self::Time => "an impossible time",
        }
    }
}

/// A point in time, in microseconds since 1970.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub struct Utc(pub u64);

/// Returns a request with a random number.
#[must_use]
pub fn request(number: [u8; 8]) -> [u8; SIZE] {
    let mut request = [0; SIZE];
    if let Some(first) = request.first_mut() {
        *first = CLIENT;
    }
    if let Some(place) = request.last_chunk_mut() {
        *place = number;
    }
    request
}

/// Reads the time of sending of an answer to the request with this number.
///
/// # Errors
///
/// Why the answer is [`Refused`].
pub fn read(answer: &[u8], number: [u8; 8]) -> Result<Utc, Refused> {
    let field = |at: usize| answer.get(at..).and_then(<[u8]>::first_chunk::<8>).copied();
    let ([head, stratum, ..], Some(origin), Some(sent)) = (answer, field(ORIGIN), field(TRANSMIT)) else {
        return Err(Refused::Format);
    };
    let (leap, version, mode) = (head >> 6, head >> 3 & 7, head & 7);
    if !matches!(version, 3 | 4) {
        return Err(Refused::Format);
    }
    if mode != SERVER_MODE {
        return Err(Refused::Mode);
    }
    if origin != number {
        return Err(Refused::Origin);
    }
    if leap == UNSYNCHRONISED || !(1..=15).contains(stratum) {
        return Err(Refused::Unsynchronised);
    }
    let sent = u64::from_be_bytes(sent);
    let (seconds, fraction) = (sent >> 32, sent & (ERA - 1));
    // the 32 bits wrap in 2036; the upper half of the next era is a time before 2026
    let seconds = if seconds < UNIX + LEAST { seconds + ERA } else { seconds };
    if seconds >= ERA + ERA / 2 {
        return Err(Refused::Time);
    }
    let seconds = seconds - UNIX;
    Ok(Utc(seconds * 1_000_000 + ((fraction * 1_000_000) >> 32)))
}

/// Writes the time as RFC 3339 does, to the millisecond.
impl fmt::Display for Utc {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (millis, seconds) = (self.0 / 1000 % 1000, self.0 / 1_000_000);
        let (days, second) = (seconds / 86_400, seconds % 86_400);
        let (year, month, day) = date(days);
        let (hour, minute, second) = (second / 3600, second / 60 % 60, second % 60);
        write!(f, "{year:04}-{month:02}-{day:02}T{hour:02}:{minute:02}:{second:02}.{millis:03}Z")
    }
}

/// Returns the date of a day, counted from 1970-01-01. A year begins with March here, so that the leap day is its last one.
fn date(days: u64) -> (u64, u64, u64) {
    // from 0000-03-01, in cycles of 400 years
    let days = days + 719_468;
    let (cycle, day) = (days / 146_097, days % 146_097);
    let year = (day - day / 1460 + day / 36_524 - day / 146_096) / 365;
    let day = day - (365 * year + year / 4 - year / 100);
    let month = (5 * day + 2) / 153;
    let (day, month) = (day - (153 * month + 2) / 5 + 1, if month < 10 { month + 3 } else { month - 9 });
    (cycle * 400 + year + u64::from(month <= 2), month, day)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::string::ToString;

    const NUMBER: [u8; 8] = [0x81, 2, 3, 4, 5, 6, 7, 0xff];

    /// An answer of a server of stratum 2, with a time in seconds since 1900 and a fraction.
    fn answer(seconds: u32, fraction: u32) -> [u8; SIZE] {
        let mut answer = [0; SIZE];
        (answer[0], answer[1]) = (0x24, 2);
        answer[24..32].copy_from_slice(&NUMBER);
        answer[40..44].copy_from_slice(&seconds.to_be_bytes());
        answer[44..48].copy_from_slice(&fraction.to_be_bytes());
        answer
    }

    /// 2026-11-26T15:41:40Z.
    const NOW: u32 = 4_004_696_500;

    #[test]
    fn the_time_of_an_answer_is_read() {
        let time = read(&answer(NOW, 0x8000_0000), NUMBER).unwrap();
        assert_eq!(time.to_string(), "2026-11-26T15:41:40.500Z");
        // with an authenticator
        assert!(read(&[&answer(NOW, 0)[..], &[0; 20]].concat(), NUMBER).is_ok());
        // the next era of the 32 bits begins on 2036-02-07
        let last = read(&answer(u32::MAX, u32::MAX), NUMBER).unwrap();
        assert_eq!(last.to_string(), "2036-02-07T06:28:15.999Z");
        assert_eq!(read(&answer(0, 0), NUMBER).unwrap().to_string(), "2036-02-07T06:28:16.000Z");
        let request = request(NUMBER);
        assert_eq!((request[0], &request[1..40], &request[40..]), (0x23, &[0; 39][..], &NUMBER[..]));
    }

    #[test]
    fn dates_are_right_at_the_edges() {
        for (seconds, expected) in [
            (0, "1970-01-01T00:00:00.000Z"),
            (951_782_399, "2000-02-28T23:59:59.000Z"),
            (951_782_400, "2000-02-29T00:00:00.000Z"),
            (951_868_800, "2000-03-01T00:00:00.000Z"),
            (1_798_761_599, "2026-12-31T23:59:59.000Z"),
            (1_830_297_600, "2028-01-01T00:00:00.000Z"),
            (4_107_542_400, "2100-03-01T00:00:00.000Z"),
        ] {
            assert_eq!(Utc(seconds * 1_000_000).to_string(), expected);
        }
    }

    #[test]
    fn an_answer_that_is_not_to_be_trusted_is_refused() {
        let good = answer(NOW, 0);
        let with = |at: usize, byte: u8| {
            let mut answer = good;
            answer[at] = byte;
            read(&answer, NUMBER)
        };
        assert!((0..SIZE).all(|len| read(&good[..len], NUMBER) == Err(Refused::Format)), "cut off");
        // versions 0 to 2 and 5
        for head in [0x04, 0x0c, 0x14, 0x2c] {
            assert_eq!(with(0, head), Err(Refused::Format), "{head:#x}");
        }
        // a client, a peer, a broadcast, and messages for control
        for mode in [0, 1, 2, 3, 5, 6, 7] {
            assert_eq!(with(0, 0x20 | mode), Err(Refused::Mode), "{mode}");
        }
        assert_eq!(with(0, 0xe4), Err(Refused::Unsynchronised), "the leap indicator is 3");
        // a kiss of death, and strata that do not exist
        for stratum in [0, 16, 255] {
            assert_eq!(with(1, stratum), Err(Refused::Unsynchronised), "{stratum}");
        }
        for (at, byte) in (24..).zip(NUMBER) {
            assert_eq!(with(at, byte ^ 1), Err(Refused::Origin), "{at}");
        }
        assert_eq!(read(&good, [0; 8]), Err(Refused::Origin));
        // 2025-12-31, which would be 2162
        assert_eq!(read(&answer(NOW - 331 * 86_400, 0), NUMBER), Err(Refused::Time));
    }

    #[test]
    fn no_datagram_panics() {
        let mut state = 1_u64;
        for _ in 0..20_000 {
            let mut datagram = answer(NOW, 0);
            for _ in 0..3 {
                state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
                datagram[(state >> 33) as usize % SIZE] = (state >> 56) as u8;
            }
            if let Ok(time) = read(&datagram, NUMBER) {
                assert_eq!(time.to_string().len(), "2026-11-26T15:41:40.500Z".len());
            }
        }
    }
}
