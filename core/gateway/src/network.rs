//! Networks of clients, by IPv4 address.

use core::fmt;
use core::net::Ipv4Addr;

/// A network of clients: an address and the length of its prefix.
///
/// # Examples
///
/// ```
/// use bcap_gateway::Network;
///
/// let network = Network::parse("192.168.0.0/24").ok_or("no network")?;
/// assert!(network.contains(Some([192, 168, 0, 7].into())));
/// assert!(!network.contains(Some([192, 168, 1, 7].into())));
/// assert!(Network::ANY.contains(None), "a client on a serial line has no address");
/// # Ok::<(), &str>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Network {
    address: Ipv4Addr,
    prefix: u8,
}

impl Network {
    /// All clients, even without an address.
    pub const ANY: Self = Self { address: Ipv4Addr::UNSPECIFIED, prefix: 0 };

    /// Creates the network of the first `prefix` bits of an address; `None` if there are more than 32.
    #[must_use]
    pub const fn new(address: Ipv4Addr, prefix: u8) -> Option<Self> {
        if prefix <= 32 { Some(Self { address, prefix }) } else { None }
    }

    /// Parses `ADDRESS/PREFIX`, or `ADDRESS` for one client.
    #[must_use]
    pub fn parse(text: &str) -> Option<Self> {
        let (address, prefix) = text.split_once('/').unwrap_or((text, "32"));
        Self::new(address.parse().ok()?, prefix.parse().ok()?)
    }

    /// Returns whether a client belongs to the network. A client without an address belongs to [`ANY`](Self::ANY) only.
    #[must_use]
    pub fn contains(&self, client: Option<Ipv4Addr>) -> bool {
        let mask = u32::MAX.checked_shl(32_u32.saturating_sub(self.prefix.into())).unwrap_or(0);
        match client {
            Some(client) => (client.to_bits() ^ self.address.to_bits()) & mask == 0,
            None => self.prefix == 0,
        }
    }
}

impl Default for Network {
    fn default() -> Self {
        Self::ANY
    }
}

/// Writes the network as [`parse`](Network::parse) takes it.
impl fmt::Display for Network {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}", self.address, self.prefix)
    }
}

#[cfg(feature = "defmt")]
impl defmt::Format for Network {
    fn format(&self, f: defmt::Formatter<'_>) {
        let [a, b, c, d] = self.address.octets();
        defmt::write!(f, "{=u8}.{=u8}.{=u8}.{=u8}/{=u8}", a, b, c, d, self.prefix);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_network_contains_the_clients_with_its_prefix() {
        let client = |a, b, c, d| Some(Ipv4Addr::new(a, b, c, d));
        for (text, inside, outside) in [
            ("10.0.2.15", client(10, 0, 2, 15), client(10, 0, 2, 14)),
            ("10.0.2.15/24", client(10, 0, 2, 255), client(10, 0, 3, 15)),
            ("128.0.0.0/1", client(255, 0, 0, 1), client(127, 255, 255, 255)),
            ("10.0.2.2/31", client(10, 0, 2, 3), None),
        ] {
            let network = Network::parse(text).unwrap();
            assert!(network.contains(inside) && !network.contains(outside), "{text}");
        }
        let any = Network::parse("1.2.3.4/0").unwrap();
        assert!(any.contains(None) && any.contains(client(255, 255, 255, 255)));
        for text in ["", "10.0.2", "10.0.2.2/33", "10.0.2.2/", "10.0.2.2/-1", "10.0.2.2/256"] {
            assert_eq!(Network::parse(text), None, "{text}");
        }
    }
}
