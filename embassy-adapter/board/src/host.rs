//! The addresses that one machine can have: for settings, and for the leases of DHCP servers.

use core::net::Ipv4Addr;

/// An address, and the length of its network prefix in bits.
pub(crate) type Own = (Ipv4Addr, u8);

/// Returns whether one machine can have an address. The network stack panics on any other address.
pub(crate) fn is_host(address: Ipv4Addr) -> bool {
    !(address.is_unspecified() || address.is_broadcast() || address.is_multicast() || address.is_loopback())
}

/// Returns whether a machine can have an address in its network.
pub(crate) fn is_host_in((address, prefix): Own) -> bool {
    is_host(address) && !is_edge((address, prefix), address)
}

/// Returns whether an address can be another machine's: neither `own` nor the first or last one of its network.
pub(crate) fn is_other(own: Own, address: Ipv4Addr) -> bool {
    address != own.0 && !is_edge(own, address)
}

/// Returns whether an address is the first or the last (broadcast) address of the network of `own`.
fn is_edge((own, prefix): Own, address: Ipv4Addr) -> bool {
    let hosts = u32::MAX.checked_shr(prefix.into()).unwrap_or(0);
    let (own, bits) = (own.to_bits(), address.to_bits());
    // a network of two addresses or one has no broadcast
    hosts > 1 && (own ^ bits) & !hosts == 0 && [0, hosts].contains(&(bits & hosts))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_machine_has_no_address_of_a_group() {
        for (address, expected) in [
            ([0, 0, 0, 0], false),
            ([255, 255, 255, 255], false),
            ([224, 0, 0, 1], false),
            ([239, 255, 255, 255], false),
            ([127, 0, 0, 1], false),
            ([192, 168, 0, 1], true),
            ([10, 0, 0, 255], true),
        ] {
            assert_eq!(is_host(address.into()), expected, "{address:?}");
        }
    }

    #[test]
    fn the_edges_of_a_network_belong_to_no_machine() {
        for (address, prefix, expected) in [
            ([192, 168, 0, 7], 24, true),
            ([192, 168, 0, 0], 24, false),
            ([192, 168, 0, 255], 24, false),
            ([192, 168, 0, 255], 16, true),
            ([192, 168, 0, 0], 31, true),
            ([192, 168, 0, 0], 32, true),
            ([224, 0, 0, 1], 24, false),
        ] {
            assert_eq!(is_host_in((address.into(), prefix)), expected, "{address:?}/{prefix}");
        }
    }
}
