//! The address of a controller as text: `tcp:HOST[:PORT]` or `udp:HOST[:PORT]`.

use std::fmt;
use std::str::FromStr;

use bcap_core::bcap;

/// The address of a controller's b-CAP server.
///
/// A host is a name, an IPv4 address, or an IPv6 address in brackets. Without a port it is 5007.
///
/// # Examples
///
/// ```
/// use bcap_std::Address;
///
/// let address: Address = "udp:192.168.0.1".parse()?;
/// assert_eq!(address, Address::Udp { host: "192.168.0.1".into(), port: 5007 });
/// assert_eq!("tcp:[fe80::1]:5008".parse::<Address>()?.to_string(), "tcp:[fe80::1]:5008");
/// # Ok::<(), bcap_std::AddressError>(())
/// ```
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum Address {
    /// b-CAP over TCP.
    Tcp {
        /// A name, or an IP address without brackets.
        host: String,
        /// The port.
        port: u16,
    },
    /// b-CAP over UDP.
    Udp {
        /// A name, or an IP address without brackets.
        host: String,
        /// The port.
        port: u16,
    },
}

/// A text is not an [`Address`].
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{text:?} is no address: {reason}; write tcp:HOST[:PORT] or udp:HOST[:PORT], such as tcp:192.168.0.1")]
pub struct AddressError {
    text: String,
    reason: &'static str,
}

impl Address {
    /// Returns host and port.
    pub(crate) fn host(&self) -> (&str, u16) {
        match self {
            Self::Tcp { host, port } | Self::Udp { host, port } => (host, *port),
        }
    }
}

impl FromStr for Address {
    type Err = AddressError;

    fn from_str(text: &str) -> Result<Self, AddressError> {
        let error = |reason| AddressError { text: text.to_owned(), reason };
        let (scheme, rest) = text.split_once(':').ok_or_else(|| error("it does not name the transport"))?;
        let (host, port) = split_port(rest).map_err(error)?;
        let host = host.to_owned();
        match scheme.to_ascii_lowercase().as_str() {
            "tcp" => Ok(Self::Tcp { host, port }),
            "udp" => Ok(Self::Udp { host, port }),
            _ => Err(error("the transport is neither tcp nor udp")),
        }
    }
}

/// Splits `HOST[:PORT]`, and removes the brackets of an IPv6 address.
fn split_port(text: &str) -> Result<(&str, u16), &'static str> {
    let (host, port) = match text.strip_prefix('[').map(|rest| rest.split_once(']').ok_or("a bracket is not closed")) {
        Some(bracketed) => {
            let (host, port) = bracketed?;
            (host, if port.is_empty() { None } else { Some(port.strip_prefix(':').ok_or("the port needs a colon")?) })
        }
        None => match text.rsplit_once(':') {
            Some((host, _)) if host.contains(':') => return Err("an IPv6 address stands in brackets"),
            Some((host, port)) => (host, Some(port)),
            None => (text, None),
        },
    };
    if host.is_empty() {
        return Err("the host is missing");
    }
    match port.map(str::parse) {
        None => Ok((host, bcap::PORT)),
        Some(Ok(port)) if port > 0 => Ok((host, port)),
        Some(_) => Err("the port is not a number from 1 to 65535"),
    }
}

impl fmt::Display for Address {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (scheme, (host, port)) = match self {
            Self::Tcp { .. } => ("tcp", self.host()),
            Self::Udp { .. } => ("udp", self.host()),
        };
        if host.contains(':') { write!(f, "{scheme}:[{host}]:{port}") } else { write!(f, "{scheme}:{host}:{port}") }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_address_is_read_and_written() {
        for (text, written) in [
            ("TCP:robot", "tcp:robot:5007"),
            ("tcp:10.0.0.1:80", "tcp:10.0.0.1:80"),
            ("udp:[::1]", "udp:[::1]:5007"),
            ("udp:[::1]:9", "udp:[::1]:9"),
        ] {
            assert_eq!(text.parse::<Address>().unwrap().to_string(), written);
        }
    }

    #[test]
    fn a_wrong_address_says_what_is_wrong() {
        for (text, reason) in [
            ("192.168.0.1", "it does not name the transport"),
            ("http:robot", "the transport is neither tcp nor udp"),
            ("tcp:", "the host is missing"),
            ("tcp:::1", "an IPv6 address stands in brackets"),
            ("tcp:[::1", "a bracket is not closed"),
            ("tcp:[::1]5", "the port needs a colon"),
            ("tcp:robot:0", "the port is not a number from 1 to 65535"),
            ("tcp:robot:x", "the port is not a number from 1 to 65535"),
        ] {
            let error = text.parse::<Address>().unwrap_err();
            assert_eq!(error.to_string().split("; ").next().unwrap(), format!("{text:?} is no address: {reason}"));
        }
    }
}
