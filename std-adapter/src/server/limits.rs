//! Resource limits for the peers of a server.

use std::net::IpAddr;
use std::time::Duration;

use bcap_core::bcap::server::Config;
use bcap_core::peers::{Slots, TimeLimits};

/// Resource limits for the peers of a server.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct Limits {
    /// Connections at the same time, b-CAP and RAC each.
    pub connections: usize,
    /// Connections of one IP address at the same time, b-CAP and RAC each.
    pub connections_per_address: usize,
    /// The silence after which a connection without a running request may be closed when another connection needs its slot. A
    /// connection of the same address is closed first, otherwise the connection that has been idle longest.
    pub evict_after: Duration,
    /// UDP peers at the same time. A peer that has stopped its service, or was silent for `udp_idle`, makes room for another
    /// peer.
    pub udp_peers: usize,
    /// UDP peers of one IP address at the same time.
    pub udp_peers_per_address: usize,
    /// The silence after which a UDP peer may be dropped when another peer needs its slot.
    pub udp_idle: Duration,
    /// The silence after which a UDP peer is dropped in any case, and its objects are released.
    pub udp_lost: Duration,
    /// The time limit for receiving a request, from its first byte.
    pub receive: Duration,
    /// The maximum time in which a peer accepts no bytes of a reply.
    pub send: Duration,
    /// The maximum run time of a b-CAP call, whatever its client requests with `InvokeTimeout`. The default for b-CAP clients
    /// and the limit for RAC clients is 180 s.
    pub call: Duration,
    /// The silence after which a connection without a running request is closed; `None` for no limit.
    pub idle: Option<Duration>,
    /// The maximum size of a request in bytes.
    pub frame: u32,
    /// Bytes for requests and replies of b-CAP over TCP, of all connections together, beyond the 2 KiB that each connection
    /// has from the beginning. Without enough memory a request is answered with E_PACKETSIZEOVER, and a reply is replaced
    /// by E_TOO_MUCH_DATA; small ones always pass. A connection releases its memory when it ends or is silent for 5 s.
    pub memory: usize,
    /// The silence on TCP after which the operating system probes the peer.
    pub keep_alive: Option<Duration>,
}

setters! { Limits {
    connections: usize;
    connections_per_address: usize;
    evict_after: Duration;
    udp_peers: usize;
    udp_peers_per_address: usize;
    udp_idle: Duration;
    udp_lost: Duration;
    receive: Duration;
    send: Duration;
    call: Duration;
    idle: Option<Duration>;
    frame: u32;
    memory: usize;
    keep_alive: Option<Duration>;
} }

impl Limits {
    /// Returns the slots for connections of one protocol.
    pub(super) const fn connection_slots(&self) -> Slots {
        Slots { total: self.connections, per_host: self.connections_per_address, evict_after: Some(self.evict_after) }
    }

    /// Returns the slots for UDP peers.
    pub(super) const fn udp_slots(&self) -> Slots {
        Slots { total: self.udp_peers, per_host: self.udp_peers_per_address, evict_after: Some(self.udp_idle) }
    }

    /// Returns the time limits of a connection.
    pub(super) const fn times(&self) -> TimeLimits {
        TimeLimits { receive: self.receive, idle: self.idle }
    }
}

/// Returns whether two clients are on one host. A listener for both versions of IP shows `10.0.0.5` as `::ffff:10.0.0.5`.
pub(crate) fn is_same_host(one: IpAddr, other: IpAddr) -> bool {
    one.to_canonical() == other.to_canonical()
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            connections: 256,
            connections_per_address: 128,
            evict_after: Duration::from_secs(10),
            udp_peers: 32,
            udp_peers_per_address: 16,
            udp_idle: Duration::from_secs(10),
            udp_lost: Duration::from_secs(600),
            receive: Duration::from_secs(30),
            send: Duration::from_secs(10),
            call: Config::TCP.invoke_timeout_max,
            idle: None,
            frame: bcap_core::limits::Limits::STREAM.frame,
            memory: 256 << 20,
            keep_alive: Some(Duration::from_secs(60)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_ipv4_mapped_ipv6_address_is_the_same_host() {
        let address = std::net::Ipv4Addr::new(10, 0, 0, 9);
        let mapped = IpAddr::V6(address.to_ipv6_mapped());
        assert!(is_same_host(mapped, address.into()) && is_same_host(address.into(), mapped));
        assert!(!is_same_host(mapped, [10, 0, 0, 1].into()));
    }
}
