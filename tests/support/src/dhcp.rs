//! Answers of DHCP servers.

use std::net::Ipv4Addr;

use smoltcp::wire::{DhcpMessageType, DhcpOption, DhcpPacket, DhcpRepr, EthernetAddress};

use crate::frames::datagram;

/// The answer of a server to a request of the board.
#[derive(Clone, Copy, Debug)]
pub struct Answer {
    /// Whether it offers, confirms or refuses.
    pub kind: DhcpMessageType,
    /// The transaction of the request.
    pub transaction: u32,
    /// The server.
    pub server: Ipv4Addr,
    /// The address that the board gets.
    pub address: Ipv4Addr,
    /// The mask of its network.
    pub mask: Ipv4Addr,
    /// The router of its network.
    pub router: Option<Ipv4Addr>,
    /// The seconds of the lease, and until it has to be renewed.
    pub times: [Option<u32>; 3],
}

/// A valid lease.
pub const GOOD: Answer = Answer {
    kind: DhcpMessageType::Ack,
    transaction: 7,
    server: Ipv4Addr::new(10, 0, 2, 2),
    address: Ipv4Addr::new(10, 0, 2, 15),
    mask: Ipv4Addr::new(255, 255, 255, 0),
    router: Some(Ipv4Addr::new(10, 0, 2, 2)),
    times: [Some(3600), None, None],
};

impl Answer {
    /// Makes the frame, with the checksum of UDP.
    pub fn frame(&self, mac: [u8; 6]) -> Vec<u8> {
        let Self { kind, transaction, server, address, mask, router, times: [lease, renew, rebind] } = *self;
        let none = Ipv4Addr::UNSPECIFIED;
        // smoltcp writes only the time of the lease
        let later = [renew, rebind].map(|seconds| seconds.unwrap_or_default().to_be_bytes());
        let later: Vec<_> = [(58, renew, &later[0]), (59, rebind, &later[1])]
            .into_iter()
            .filter_map(|(kind, seconds, data)| seconds.map(|_| DhcpOption { kind, data }))
            .collect();
        let dhcp = DhcpRepr {
            message_type: kind,
            transaction_id: transaction,
            secs: 0,
            client_hardware_address: EthernetAddress(mac),
            client_ip: none,
            your_ip: address,
            server_ip: server,
            router,
            subnet_mask: Some(mask),
            relay_agent_ip: none,
            broadcast: true,
            requested_ip: None,
            client_identifier: None,
            server_identifier: Some(server),
            parameter_request_list: None,
            dns_servers: None,
            max_size: None,
            lease_duration: lease,
            renew_duration: None,
            rebind_duration: None,
            additional_options: &later,
        };
        let mut payload = vec![0; dhcp.buffer_len()];
        dhcp.emit(&mut DhcpPacket::new_unchecked(&mut payload[..])).unwrap();
        datagram(mac, server, Ipv4Addr::BROADCAST, [67, 68], &payload)
    }
}
