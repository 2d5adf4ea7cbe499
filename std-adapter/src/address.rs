//! The address of a controller as text: `tcp:HOST[:PORT]`, `udp:HOST[:PORT]` or `serial:PATH[?OPTIONS]`.

use std::fmt;
use std::str::FromStr;

use bcap_core::bcap;

use crate::line::SerialLine;

/// The transport protocol of a [`NetworkAddress`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Protocol {
    /// TCP.
    Tcp,
    /// UDP.
    Udp,
}

/// The address of a controller: `tcp:HOST[:PORT]`, `udp:HOST[:PORT]` or `serial:PATH[?OPTIONS]`.
///
/// A host is a name, an IPv4 address, or an IPv6 address in brackets. Without a port it is 5007, the port of b-CAP.
/// The options of a serial line are `baud=N`, `parity=none`, `even` or `odd`, and `stop=1` or `2`, with `&` between them;
/// [`SerialLine`] has the defaults.
///
/// # Examples
///
/// ```
/// use bcap_std::{Address, Parity, SerialLine};
///
/// assert_eq!("udp:192.168.0.1".parse::<Address>()?.to_string(), "udp:192.168.0.1:5007");
/// assert_eq!("tcp:[fe80::1]:5008".parse::<Address>()?.to_string(), "tcp:[fe80::1]:5008");
/// let line = SerialLine::new("/dev/ttyUSB0").baud(38400).parity(Parity::Even);
/// assert_eq!("serial:/dev/ttyUSB0?baud=38400&parity=even".parse(), Ok(Address::Serial(line)));
/// # Ok::<(), bcap_std::AddressError>(())
/// ```
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum Address {
    /// A server in an IP network.
    Network(NetworkAddress),
    /// A serial line; connecting needs the feature `serial`.
    Serial(SerialLine),
}

/// The address of a server in an IP network.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct NetworkAddress {
    /// The protocol.
    pub protocol: Protocol,
    /// A name, or an IP address without brackets.
    pub host: String,
    /// The port.
    pub port: u16,
}

/// A text is not an [`Address`]. Its message contains the text, the fault, and the expected form.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct AddressError(String);

impl NetworkAddress {
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
        if let Some((scheme, rest)) = text.split_once(':')
            && scheme.eq_ignore_ascii_case("serial")
        {
            return SerialLine::parse(text, rest).map(Self::Serial).map_err(AddressError);
        }
        if split_protocol(text).0.is_none() {
            return Err(AddressError(format!(
                "{text}: write tcp:HOST[:PORT], udp:HOST[:PORT] or serial:PATH, such as tcp:192.168.0.1"
            )));
        }
        NetworkAddress::parse_or_tcp(text, bcap::PORT).map(Self::Network)
    }
}

/// Writes the address as it is parsed.
impl fmt::Display for Address {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Network(address) => address.fmt(f),
            Self::Serial(line) => write!(f, "serial:{line}"),
        }
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
impl fmt::Display for NetworkAddress {
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
            ("serial:/dev/ttyUSB0", "serial:/dev/ttyUSB0?baud=115200"),
            ("SERIAL:COM3?stop=2&baud=9600&parity=odd", "serial:COM3?baud=9600&parity=odd&stop=2"),
            ("serial:/dev/ttyS0?parity=none&stop=1", "serial:/dev/ttyS0?baud=115200"),
            ("serial:/dev/ttyS0?parity=even", "serial:/dev/ttyS0?baud=115200&parity=even"),
        ] {
            let address: Address = text.parse().unwrap();
            assert_eq!(address.to_string(), shown);
            assert_eq!(shown.parse(), Ok(address));
        }
        let short = |text| NetworkAddress::parse_or_tcp(text, 5006).unwrap().to_string();
        assert_eq!(short("192.168.0.1"), "tcp:192.168.0.1:5006");
        assert_eq!(short("robot:7000"), "tcp:robot:7000");
        assert_eq!(short("tcp:[::1]:7000"), "tcp:[::1]:7000");
    }

    #[test]
    fn errors_name_the_wrong_part_of_an_address() {
        for (text, word) in [
            ("192.168.0.1", "tcp:HOST"),
            ("com:1", "serial:PATH"),
            ("serial:", "device is missing"),
            ("serial:?baud=9600", "device is missing"),
            ("serial:/dev/ttyS0?baud=fast", "\"fast\" is not a baud rate; write a number from 300 to 4000000"),
            ("serial:/dev/ttyS0?baud", "\"\" is not a baud rate"),
            ("serial:/dev/ttyS0?baud=0", "not a baud rate"),
            ("serial:/dev/ttyS0?parity=mark", "\"mark\" is not a parity; write none, even or odd"),
            ("serial:/dev/ttyS0?stop=3", "\"3\" is not a number of stop bits; write 1 or 2"),
            ("serial:/dev/ttyS0?speed=1", "\"speed\" is not an option of a serial line; write baud, parity or stop"),
            ("serial:/dev/ttyS0?stop=1&stop=2", "the option stop is given twice"),
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
