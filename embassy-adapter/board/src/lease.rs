//! Checks a lease of DHCP before the network stack receives it.
//!
//! smoltcp 0.13.1 installs the router of a lease unchecked, and panics when it resolves a router address such as 0.0.0.0. With
//! a lease of 0 s it repeats its request without a pause. Either stops the service of the board, so a frame with such a lease
//! is dropped, or its router is hidden. A board without a router still reaches the machines of its network.

use core::net::Ipv4Addr;

use crate::host::{Own, is_host, is_other};

/// Minimum lease in seconds, and minimum time after which it may have to be renewed.
const SHORTEST_LEASE: u32 = 10;
const SHORTEST_RENEWAL: u32 = 5;

/// The header of Ethernet, and the type of IPv4.
const ETHERNET: usize = 14;
const IPV4: [u8; 2] = [0x08, 0x00];
/// Minimum size of an IPv4 header, the protocol number of UDP, and the size of its header.
const IPV4_HEADER: usize = 20;
const UDP: u8 = 17;
const UDP_HEADER: usize = 8;
const UDP_CHECKSUM: usize = 6;
/// The ports of the server and the client.
const PORTS: [u8; 4] = [0, 67, 0, 68];

/// The fields of a message: the address of the lease, the address of the client, the options.
const YOUR_ADDRESS: usize = 16;
const CLIENT: usize = 28;
const OPTIONS: usize = 240;

/// The options.
const PAD: u8 = 0;
const MASK: u8 = 1;
const ROUTER: u8 = 3;
const LEASE_TIME: u8 = 51;
const MESSAGE_TYPE: u8 = 53;
const RENEWAL_TIME: u8 = 58;
const REBINDING_TIME: u8 = 59;
/// An option without a meaning, which the network stack skips.
const PRIVATE: u8 = 224;
const END: u8 = 255;

const OFFER: u8 = 2;

/// A lease that may pass to the network stack.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Lease {
    /// Whether it is offered, not confirmed.
    pub(crate) is_offer: bool,
}

/// A lease that must not pass to the network stack.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct RefusedLease {
    pub(crate) server: Ipv4Addr,
    pub(crate) address: Ipv4Addr,
    pub(crate) reason: Reason,
}

/// Why a lease is refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Reason {
    /// No machine has the address of the server.
    Server,
    /// The mask has gaps, or covers every address.
    Mask,
    /// The board cannot have the address: it is not a machine's, or it is the robot's.
    Address,
    /// The lease is shorter than [`SHORTEST_LEASE`].
    Time,
}

impl Reason {
    /// Returns the reason as a text for the log.
    #[cfg(feature = "embassy")]
    pub(crate) const fn text(self) -> &'static str {
        match self {
            Self::Server => "the address of the server is not a machine's",
            Self::Mask => "the mask is invalid",
            Self::Address => "the address is not a machine's, or belongs to another one in the settings",
            Self::Time => "it is shorter than 10 s",
        }
    }
}

/// Checks the lease in a received frame, if there is one for the client `mac`.
///
/// `accepts` returns whether the board may have an address. An invalid router is hidden, and so are renewal times that are too
/// short.
///
/// # Errors
///
/// The lease, when the frame must be dropped.
pub(crate) fn check(
    frame: &mut [u8],
    mac: [u8; 6],
    accepts: impl FnOnce(Own) -> bool,
) -> Result<Option<Lease>, RefusedLease> {
    let Some((server, udp)) = datagram(frame) else { return Ok(None) };
    let Some((header, message)) = udp.split_at_mut_checked(UDP_HEADER) else { return Ok(None) };
    let address = address(message, YOUR_ADDRESS).unwrap_or(Ipv4Addr::UNSPECIFIED);
    // a refusal of the server has no address
    if message.get(CLIENT..).and_then(|client| client.get(..6)) != Some(&mac) || address.is_unspecified() {
        return Ok(None);
    }
    let terms = Terms::read(message);
    let own = (address, terms.prefix);
    let reason = match () {
        () if !is_host(server) => Some(Reason::Server),
        () if !terms.has_valid_mask => Some(Reason::Mask),
        () if !accepts(own) => Some(Reason::Address),
        () if terms.is_too_short => Some(Reason::Time),
        () => None,
    };
    if let Some(reason) = reason {
        return Err(RefusedLease { server, address, reason });
    }
    hide_invalid(header, message, own);
    Ok(Some(Lease { is_offer: terms.is_offer }))
}

/// Returns the address of the server and the datagram of UDP, if a frame has one from a DHCP server to a client.
fn datagram(frame: &mut [u8]) -> Option<(Ipv4Addr, &mut [u8])> {
    let (ethernet, packet) = frame.split_at_mut_checked(ETHERNET)?;
    let header = packet.get(..IPV4_HEADER)?;
    let header_len = usize::from(header.first()? & 0xf) * 4;
    let (server, is_udp) = (self::address(header, 12)?, header.get(9) == Some(&UDP));
    let udp = packet.get_mut(header_len..)?;
    (ethernet.ends_with(&IPV4) && is_udp && udp.starts_with(&PORTS)).then_some((server, udp))
}

/// The terms of a lease.
struct Terms {
    is_offer: bool,
    has_valid_mask: bool,
    /// The length of the network prefix; 32 without a mask, which only an offer may lack.
    prefix: u8,
    is_too_short: bool,
}

impl Terms {
    /// Reads the options. If a code occurs several times, each value must be valid: the network stack may use any of them.
    fn read(message: &[u8]) -> Self {
        let mut terms = Self { is_offer: false, has_valid_mask: true, prefix: 32, is_too_short: false };
        let mut at = OPTIONS;
        while let Some(option) = Option4::next(message, &mut at) {
            match (option.kind, option.value) {
                (MESSAGE_TYPE, _) => terms.is_offer = message.get(option.at + 2) == Some(&OFFER),
                (MASK, Some(mask)) => {
                    let ones = mask.leading_ones();
                    terms.has_valid_mask &= ones > 0 && ones == mask.count_ones();
                    terms.prefix = u8::try_from(ones).unwrap_or(32);
                }
                (LEASE_TIME, Some(seconds)) => terms.is_too_short |= seconds < SHORTEST_LEASE,
                _ => {}
            }
        }
        terms
    }
}

/// Hides routers that cannot be one, and times of renewal that are too short.
fn hide_invalid(header: &mut [u8], message: &mut [u8], own: Own) {
    let mut at = OPTIONS;
    while let Some(option) = Option4::next(message, &mut at) {
        let is_valid = match (option.kind, option.value) {
            (ROUTER, Some(router)) => is_host(router.into()) && is_other(own, router.into()),
            (RENEWAL_TIME | REBINDING_TIME, Some(seconds)) => seconds >= SHORTEST_RENEWAL,
            _ => true,
        };
        if let (false, Some(kind)) = (is_valid, message.get_mut(option.at)) {
            *kind = PRIVATE;
            update_checksum(header, option.at, option.kind);
        }
    }
}

/// Updates the checksum of UDP after the byte `at` of the message changed from `old` to [`PRIVATE`] (RFC 1624).
fn update_checksum(header: &mut [u8], at: usize, old: u8) {
    let Some(field) = header.get_mut(UDP_CHECKSUM..).and_then(|field| field.first_chunk_mut()) else { return };
    let checksum = u16::from_be_bytes(*field);
    // without a checksum
    if checksum == 0 {
        return;
    }
    let word = |byte: u8| if at.is_multiple_of(2) { u16::from_be_bytes([byte, 0]) } else { byte.into() };
    let sum = u32::from(!checksum) + u32::from(!word(old)) + u32::from(word(PRIVATE));
    let [_, carry, high, low] = sum.to_be_bytes();
    let folded = u32::from(u16::from_be_bytes([high, low])) + u32::from(carry);
    let [_, carry, high, low] = folded.to_be_bytes();
    let folded = u16::from_be_bytes([high, low]).wrapping_add(carry.into());
    // a sum of 0 is sent as its complement
    *field = match !folded {
        0 => [0xff; 2],
        checksum => checksum.to_be_bytes(),
    };
}

/// An option of a message.
struct Option4 {
    kind: u8,
    /// Where it begins in the message.
    at: usize,
    /// Its value, if it has four bytes.
    value: Option<u32>,
}

impl Option4 {
    /// Reads the option at `at`, and moves `at` past it.
    fn next(message: &[u8], at: &mut usize) -> Option<Self> {
        while message.get(*at) == Some(&PAD) {
            *at += 1;
        }
        let [kind, len, rest @ ..] = message.get(*at..)? else { return None };
        let data = rest.get(..usize::from(*len)).filter(|_| *kind != END)?;
        let option = Self { kind: *kind, at: *at, value: data.try_into().ok().map(u32::from_be_bytes) };
        *at += 2 + data.len();
        Some(option)
    }
}

fn address(bytes: &[u8], at: usize) -> Option<Ipv4Addr> {
    bytes.get(at..)?.first_chunk::<4>().map(|octets| Ipv4Addr::from(*octets))
}

#[cfg(test)]
mod tests;
