//! Name resolution with a time limit.

use std::io;
use std::net::{IpAddr, SocketAddr, ToSocketAddrs};
use std::sync::mpsc::{self, RecvTimeoutError};
use std::thread;
use std::time::Duration;

use crate::address::NetworkAddress;
use crate::connect::ConnectError;

/// Resolves the host of an address, at most for `limit`; [`connect_tcp`](super::connect_tcp) and its siblings take the list.
///
/// IPv4 addresses are listed first: controllers use IPv4, `localhost` has addresses of both kinds, and over UDP connecting does
/// not show which address is in use.
///
/// # Errors
///
/// [`ConnectError::Resolve`], also when the time limit expires.
pub fn resolve(address: &NetworkAddress, limit: Option<Duration>) -> Result<Vec<SocketAddr>, ConnectError> {
    // a busy machine may start the thread of the resolver too late
    if let Ok(ip) = address.host.parse::<IpAddr>() {
        return Ok(vec![(ip, address.port).into()]);
    }
    let (sender, receiver) = mpsc::channel();
    let (host, port) = (address.host.clone(), address.port);
    // the system's resolver has no time limit, so it runs in its own thread
    let started = thread::Builder::new().name("resolver".into()).spawn(move || {
        let found = (host.as_str(), port).to_socket_addrs().map(Iterator::collect::<Vec<_>>);
        // the receiver is dropped at the time limit
        let _ = sender.send(found);
    });
    let received = started.and_then(|_| {
        let received = match limit {
            Some(limit) => receiver.recv_timeout(limit),
            None => receiver.recv().map_err(RecvTimeoutError::from),
        };
        received.unwrap_or_else(|_| Err(io::ErrorKind::TimedOut.into()))
    });
    let found = received.map_err(|source| ConnectError::Resolve { name: address.host.clone(), source })?;
    let (mut addresses, others): (Vec<_>, Vec<_>) = found.into_iter().partition(SocketAddr::is_ipv4);
    addresses.extend(others);
    Ok(addresses)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_of_ipv4_come_first() {
        let found = resolve(&NetworkAddress::parse_or_tcp("localhost", 7).unwrap(), None).unwrap();
        assert_eq!(found.first(), Some(&"127.0.0.1:7".parse().unwrap()));
        for (ip, expected) in [("127.0.0.1", "127.0.0.1:7"), ("[::1]", "[::1]:7")] {
            let found = resolve(&NetworkAddress::parse_or_tcp(ip, 7).unwrap(), Some(Duration::ZERO)).unwrap();
            assert_eq!(found, [expected.parse().unwrap()], "without the resolver");
        }
        let error = resolve(&NetworkAddress::parse_or_tcp("no-such-host.invalid", 7).unwrap(), None).unwrap_err();
        assert!(matches!(error, ConnectError::Resolve { name, .. } if name == "no-such-host.invalid"));
    }
}
