//! Access control of the settings page: the client must name the board by its address, send the password, and not come from a
//! page of another site.

use core::hint::black_box;
use core::net::Ipv4Addr;

use bcap_core::time::Instant;

/// Minimum and maximum length of a password in bytes.
pub(crate) const LEAST: usize = 8;
pub(crate) const MOST: usize = 63;
/// The maximum size of the name and the password of a client together in bytes; a longer one is wrong.
const CREDENTIALS: usize = 96;
/// The pause after a wrong password in seconds, which doubles with each further one: 1, 2, 4 and so on.
const FIRST: u64 = 1;
const DOUBLINGS: u32 = 6;

/// The headers of a request that determine access.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Headers<'a> {
    pub(crate) host: Option<&'a str>,
    pub(crate) origin: Option<&'a str>,
    pub(crate) authorization: Option<&'a str>,
    /// Whether the request changes something. A browser then sends the origin.
    pub(crate) is_change: bool,
}

/// Why a client may not use the page.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Denied {
    /// `Host` is not the board's address: another site may have a name that resolves to it.
    Host,
    /// The request was sent by a page of another site.
    Origin,
    /// There is no password in the request.
    NoPassword,
    WrongPassword,
    /// Too early after a wrong password: the password was not checked.
    Pause {
        seconds: u64,
    },
}

/// Counts wrong passwords, and delays the next try.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Guard {
    wrong: u32,
    /// Wrong passwords since the last correct one.
    in_row: u32,
    next: Instant,
}

impl Guard {
    pub(crate) const fn new() -> Self {
        Self { wrong: 0, in_row: 0, next: Instant::ZERO }
    }

    /// Returns the number of wrong passwords since the start.
    pub(crate) const fn wrong(&self) -> u32 {
        self.wrong
    }

    /// Checks a request to the board at this address and port.
    pub(crate) fn admit(
        &mut self,
        headers: Headers<'_>,
        own: (Ipv4Addr, u16),
        password: &str,
        now: Instant,
    ) -> Result<(), Denied> {
        let Headers { host, origin, authorization, is_change } = headers;
        if !host.is_some_and(|host| is_own(host, own)) {
            return Err(Denied::Host);
        }
        let is_own_page = match origin {
            Some(origin) => origin.strip_prefix("http://").is_some_and(|site| is_own(site, own)),
            None => !is_change,
        };
        if !is_own_page {
            return Err(Denied::Origin);
        }
        let authorization = authorization.ok_or(Denied::NoPassword)?;
        if now < self.next {
            let left = self.next.as_micros().saturating_sub(now.as_micros());
            return Err(Denied::Pause { seconds: left.div_ceil(1_000_000) });
        }
        let mut memory = [0; CREDENTIALS];
        if is_password(sent_password(authorization, &mut memory).unwrap_or_default(), password.as_bytes()) {
            self.in_row = 0;
            return Ok(());
        }
        let pause = FIRST << self.in_row.min(DOUBLINGS);
        self.wrong = self.wrong.saturating_add(1);
        self.in_row = self.in_row.saturating_add(1);
        self.next = Instant::from_micros(now.as_micros().saturating_add(pause * 1_000_000));
        Err(Denied::WrongPassword)
    }
}

/// Returns whether a `Host` is the board's address and port; without a port it is 80.
fn is_own(host: &str, (address, port): (Ipv4Addr, u16)) -> bool {
    let (name, number) = host.split_once(':').unwrap_or((host, "80"));
    name.parse() == Ok(address) && number.parse() == Ok(port)
}

/// Returns the password in an `Authorization: Basic`, after any user name.
fn sent_password<'m>(authorization: &str, memory: &'m mut [u8; CREDENTIALS]) -> Option<&'m [u8]> {
    let (scheme, encoded) = authorization.split_once(' ')?;
    if !scheme.eq_ignore_ascii_case("basic") {
        return None;
    }
    let credentials = decode(encoded.trim_matches(' ').as_bytes(), memory)?;
    let colon = credentials.iter().position(|byte| *byte == b':')?;
    credentials.get(colon + 1..)
}

/// Decodes base64 (RFC 4648), with or without its padding.
fn decode<'m>(encoded: &[u8], out: &'m mut [u8; CREDENTIALS]) -> Option<&'m [u8]> {
    let end = encoded.iter().position(|byte| *byte == b'=').unwrap_or(encoded.len());
    let (digits, padding) = encoded.split_at_checked(end)?;
    if padding.len() > 2 || padding.iter().any(|byte| *byte != b'=') {
        return None;
    }
    let (mut bits, mut count, mut len) = (0_u32, 0, 0);
    for digit in digits {
        let value = match digit {
            b'A'..=b'Z' => digit - b'A',
            b'a'..=b'z' => digit - b'a' + 26,
            b'0'..=b'9' => digit - b'0' + 52,
            b'+' => 62,
            b'/' => 63,
            _ => return None,
        };
        bits = bits << 6 | u32::from(value);
        count += 6;
        if count >= 8 {
            count -= 8;
            // the byte above the remaining bits
            *out.get_mut(len)? = u8::try_from(bits >> count & 0xff).ok()?;
            len += 1;
        }
    }
    out.get(..len)
}

/// Compares in a time that does not depend on how much of a password is right.
fn is_password(sent: &[u8], password: &[u8]) -> bool {
    let mut difference = u8::from(sent.len() != password.len());
    for at in 0..MOST {
        let [a, b] = [sent, password].map(|text| text.get(at).copied().unwrap_or_default());
        difference = black_box(difference | (a ^ b));
    }
    // if no password is set, every login is refused, even with an empty password
    difference == 0 && !password.is_empty()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::format;

    const OWN: (Ipv4Addr, u16) = (Ipv4Addr::new(192, 168, 0, 9), 80);
    const PASSWORD: &str = "pass:word";
    /// `admin:pass:word` in base64.
    const RIGHT: &str = "Basic YWRtaW46cGFzczp3b3Jk";

    fn at(seconds: u64) -> Instant {
        Instant::from_micros(seconds * 1_000_000)
    }

    fn get(authorization: &str) -> Headers<'_> {
        Headers { host: Some("192.168.0.9"), authorization: Some(authorization), ..Headers::default() }
    }

    fn admit(headers: Headers<'_>, own: (Ipv4Addr, u16)) -> Result<(), Denied> {
        Guard::new().admit(headers, own, PASSWORD, at(0))
    }

    #[test]
    fn the_host_is_the_address_of_the_board() {
        for (host, port, expected) in [
            ("192.168.0.9", 80, Ok(())),
            ("192.168.0.9:80", 80, Ok(())),
            ("192.168.0.9:8080", 8080, Ok(())),
            ("192.168.0.9", 8080, Err(Denied::Host)),
            ("192.168.0.9:8080", 80, Err(Denied::Host)),
            ("192.168.0.90", 80, Err(Denied::Host)),
            ("192.168.0.9:", 80, Err(Denied::Host)),
            ("192.168.0.9:80:80", 80, Err(Denied::Host)),
            ("192.168.0.9.evil.example", 80, Err(Denied::Host)),
            ("rebound.example", 80, Err(Denied::Host)),
            ("", 80, Err(Denied::Host)),
        ] {
            assert_eq!(admit(Headers { host: Some(host), ..get(RIGHT) }, (OWN.0, port)), expected, "{host} {port}");
        }
        assert_eq!(admit(Headers { host: None, ..get(RIGHT) }, OWN), Err(Denied::Host));
    }

    #[test]
    fn a_change_comes_from_a_page_of_the_board() {
        for (origin, is_change, expected) in [
            (None, false, Ok(())),
            (None, true, Err(Denied::Origin)),
            (Some("http://192.168.0.9"), true, Ok(())),
            (Some("http://192.168.0.9:80"), true, Ok(())),
            (Some("https://192.168.0.9"), true, Err(Denied::Origin)),
            (Some("http://192.168.0.8"), true, Err(Denied::Origin)),
            (Some("http://evil.example"), true, Err(Denied::Origin)),
            (Some("http://evil.example"), false, Err(Denied::Origin)),
            (Some("null"), true, Err(Denied::Origin)),
        ] {
            assert_eq!(admit(Headers { origin, is_change, ..get(RIGHT) }, OWN), expected, "{origin:?} {is_change}");
        }
    }

    #[test]
    fn the_password_follows_any_user_name() {
        for (authorization, expected) in [
            (RIGHT, Ok(())),
            ("basic  OnBhc3M6d29yZA==", Ok(())),
            ("Basic OnBhc3M6d29yZA", Ok(())),
            // another password, a shorter, a longer one, no colon, nothing, another scheme, no base64
            ("Basic OnBhc3M6d29yeA==", Err(Denied::WrongPassword)),
            ("Basic OnBhc3M6d29y", Err(Denied::WrongPassword)),
            ("Basic OnBhc3M6d29yZHM=", Err(Denied::WrongPassword)),
            ("Basic cGFzc3dvcmQ=", Err(Denied::WrongPassword)),
            ("Basic Og==", Err(Denied::WrongPassword)),
            ("Basic", Err(Denied::WrongPassword)),
            ("", Err(Denied::WrongPassword)),
            ("Bearer OnBhc3M6d29yZA==", Err(Denied::WrongPassword)),
            ("Basic OnBhc3M6d29yZA===", Err(Denied::WrongPassword)),
            ("Basic OnBhc3M6d29yZA=A", Err(Denied::WrongPassword)),
            ("Basic OnBhc3M6d29y\u{e4}", Err(Denied::WrongPassword)),
        ] {
            assert_eq!(admit(get(authorization), OWN), expected, "{authorization}");
        }
        let long = format!("Basic {}", "Og".repeat(CREDENTIALS));
        assert_eq!(admit(get(&long), OWN), Err(Denied::WrongPassword));
        assert_eq!(admit(Headers { authorization: None, ..get("") }, OWN), Err(Denied::NoPassword));
        let none = Guard::new().admit(get("Basic Og=="), OWN, "", at(0));
        assert_eq!(none, Err(Denied::WrongPassword), "a board without a password");
    }

    #[test]
    fn the_longest_password_is_compared_to_its_end() {
        let password = "x".repeat(MOST);
        assert!(is_password(password.as_bytes(), password.as_bytes()));
        for at in 0..MOST {
            let mut sent = password.clone().into_bytes();
            sent[at] = b'y';
            assert!(!is_password(&sent, password.as_bytes()), "{at}");
        }
        assert!(!is_password(&[password.as_bytes(), b"x"].concat(), password.as_bytes()));
    }

    #[test]
    fn each_wrong_password_doubles_the_pause() {
        let (mut guard, mut now) = (Guard::new(), 100);
        for pause in [1, 2, 4, 8, 16, 32, 64, 64, 64] {
            let mut try_at = |now, with| guard.admit(get(with), OWN, PASSWORD, at(now));
            assert_eq!(try_at(now, "Basic OnBhc3M="), Err(Denied::WrongPassword));
            // not even the correct password is checked, and no attempt extends the pause
            assert_eq!(try_at(now, RIGHT), Err(Denied::Pause { seconds: pause }));
            assert_eq!(try_at(now + pause - 1, "Basic OnBhc3M="), Err(Denied::Pause { seconds: 1 }));
            now += pause;
        }
        assert_eq!(guard.wrong(), 9);
        assert_eq!(guard.admit(get(RIGHT), OWN, PASSWORD, at(now)), Ok(()));
        assert_eq!(guard.admit(get("Basic OnBhc3M="), OWN, PASSWORD, at(now)), Err(Denied::WrongPassword));
        assert_eq!(guard.admit(get(RIGHT), OWN, PASSWORD, at(now + 1)), Ok(()), "1 s again after a right one");
        assert_eq!(guard.wrong(), 10);
        let missing = Headers { authorization: None, ..get("") };
        assert_eq!(guard.admit(missing, OWN, PASSWORD, at(now)), Err(Denied::NoPassword), "a browser asks first");
        assert_eq!(guard.wrong(), 10);
    }
}
