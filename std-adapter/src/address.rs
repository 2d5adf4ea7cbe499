//! The address of a controller as text: `tcp:HOST[:PORT]` or `udp:HOST[:PORT]`.

use std::fmt;
use std::str::FromStr;

use bcap_core::bcap;

/// The transport protocol of an [`Address`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Protocol {
    /// TCP.
    Tcp,
    /// UDP.
    Udp,
}

/// The address of a controller's server.
///
/// A host is a name, an IPv4 address, or an IPv6 address in brackets. Without a port it is 5007, the port of b-CAP.
///
/// # Examples
///
/// ```
/// use bcap_std::{Address, Protocol};
///
/// let address: Address = "udp:192.168.0.1".parse()?;
/// assert_eq!((address.protocol, address.host.as_str(), address.port), (Protocol::Udp, "192.168.0.1", 5007));
/// assert_eq!("tcp:[fe80::1]:5008".parse::<Address>()?.to_string(), "tcp:[fe80::1]:5008");
/// # Ok::<(), bcap_std::AddressError>(())
/// ```
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Address {
    /// The protocol.
    pub protocol: Protocol,
    /// A name, or an IP address without brackets.
    pub host: String,
    /// The port.
    pub port: u16,
}

/// A text is not an [`Address`]. Its message contains the text, what is wrong, and what to write.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct AddressError(String);

impl Address {
    /// Parses `[tcp:|udp:]HOST[:PORT]`, with TCP and `port` for missing parts.
    ///
    /// # Errors
    ///
    /// An [`AddressError`].
    pub fn parse_or_tcp(text: &str, port: u16) -> Result<Self, AddressError> {
        let (protocol, rest) = split_protocol(text);
        let (host, found) = split_port(text, rest).map_err(AddressError)?;
        Ok(Self { protocol: protocol.unwrap_or(Protocol::Tcp), host, port: found.unwrap_or(port) })
    }
}

impl FromStr for Address {
    type Err = AddressError;

    fn from_str(text: &str) -> Result<Self, AddressError> {
        if split_protocol(text).0.is_none() {
            let error = format!("{text}: write tcp:HOST[:PORT] or udp:HOST[:PORT], such as tcp:192.168.0.1");
            return Err(AddressError(error));
        }
        Self::parse_or_tcp(text, bcap::PORT)
    }
}

/// Splits off `tcp:` or `udp:`.
fn split_protocol(text: &str) -> (Option<Protocol>, &str) {
    match text.split_once(':') {
        Some((protocol, rest)) if protocol.eq_ignore_ascii_case("tcp") => (Some(Protocol::Tcp), rest),
        Some((protocol, rest)) if protocol.eq_ignore_ascii_case("udp") => (Some(Protocol::Udp), rest),
        _ => (None, text),
    }
}

/// Splits `HOST[:PORT]`; `text` is the whole address, for messages.
fn split_port(text: &str, rest: &str) -> Result<(String, Option<u16>), String> {
    let (host, port) = match rest.strip_prefix('[') {
        Some(bracketed) => {
            let missing = || format!("{text}: the ] is missing; write an IPv6 address as tcp:[fe80::1]:5007");
            let (host, after) = bracketed.split_once(']').ok_or_else(missing)?;
            match (after, after.strip_prefix(':')) {
                ("", _) => (host, None),
                (_, Some(port)) => (host, Some(port)),
                _ => return Err(format!("{text}: only :PORT may follow the ]")),
            }
        }
        None if rest.matches(':').count() > 1 => {
            return Err(format!("{text}: write an IPv6 address in brackets, such as tcp:[fe80::1]:5007"));
        }
        None => match rest.split_once(':') {
            Some((host, port)) => (host, Some(port)),
            None => (rest, None),
        },
    };
    if host.is_empty() {
        return Err(format!("{text}: the host is missing; write a name or an IP address"));
    }
    let port = port.map(|port| match port.parse::<u16>() {
        Ok(number) if number > 0 => Ok(number),
        _ => Err(format!("{text}: {port:?} is not a port; write a number from 1 to 65535")),
    });
    Ok((host.to_owned(), port.transpose()?))
}

/// Writes the address as it is parsed.
impl fmt::Display for Address {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { host, port, .. } = self;
        let protocol = match self.protocol {
            Protocol::Tcp => "tcp",
            Protocol::Udp => "udp",
        };
        if host.contains(':') { write!(f, "{protocol}:[{host}]:{port}") } else { write!(f, "{protocol}:{host}:{port}") }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_are_read() {
        for (text, shown) in [
            ("tcp:192.168.0.1", "tcp:192.168.0.1:5007"),
            ("udp:robot.local:6000", "udp:robot.local:6000"),
            ("TCP:[::1]", "tcp:[::1]:5007"),
            ("udp:[fe80::1]:7", "udp:[fe80::1]:7"),
        ] {
            let address: Address = text.parse().unwrap();
            assert_eq!(address.to_string(), shown);
            assert_eq!(shown.parse(), Ok(address));
        }
        let short = |text| Address::parse_or_tcp(text, 5006).unwrap().to_string();
        assert_eq!(short("192.168.0.1"), "tcp:192.168.0.1:5006");
        assert_eq!(short("robot:7000"), "tcp:robot:7000");
        assert_eq!(short("tcp:[::1]:7000"), "tcp:[::1]:7000");
    }

    #[test]
    fn errors_name_the_wrong_part_of_an_address() {
        for (text, word) in [
            ("192.168.0.1", "tcp:HOST"),
            ("com:1", "tcp:HOST"),
            ("tcp:", "host is missing"),
            ("tcp::5007", "host is missing"),
            ("tcp:a:b", "\"b\" is not a port"),
            ("tcp:a:0", "not a port"),
            ("tcp:a:65536", "not a port"),
            ("tcp:fe80::1", "brackets"),
            ("tcp:[::1", "]"),
            ("tcp:[::1]5007", "only :PORT may follow the ]"),
        ] {
            let error = text.parse::<Address>().unwrap_err().to_string();
            assert!(error.contains(word) && error.starts_with(text), "{error}");
        }
    }
}
