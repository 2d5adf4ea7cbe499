//! Finds the boards of a network and their addresses ([`bcap_board::find`]).

use std::collections::BTreeMap;
use std::io::{self, ErrorKind};
use std::net::{Ipv4Addr, SocketAddr, ToSocketAddrs, UdpSocket};
use std::time::{Duration, Instant};

use bcap_board::find::{Found, PORT, REQUEST, request};
use if_addrs::IfAddr;

/// The number of times that each request is sent, because a datagram can be lost.
const TIMES: u32 = 3;

/// A board that has answered.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct Board {
    /// The name of the setting `hostname`; empty without it.
    pub name: String,
    /// The kind of board, such as `w5500-evb-pico`.
    pub board: String,
    /// The version of its image.
    pub version: String,
    /// Its address and the length of the network's prefix.
    pub address: (Ipv4Addr, u8),
    /// The port of RAC.
    pub port: u16,
    /// Its MAC address.
    pub mac: [u8; 6],
}

/// The boards by the addresses that they answered from.
pub type Boards = BTreeMap<SocketAddr, Board>;

/// Returns the addresses to query: boards or broadcast addresses (`HOST[:PORT]`), or, if `hosts` is empty, the broadcast
/// address of each network of this computer (255.255.255.255 if it has none).
///
/// # Errors
///
/// A name without an address, or a failure to list the networks of this computer.
pub fn targets(hosts: &[String]) -> io::Result<Vec<SocketAddr>> {
    if hosts.is_empty() {
        let broadcast = |interface: &if_addrs::Interface| match &interface.addr {
            IfAddr::V4(own) if !own.is_loopback() => own.broadcast,
            _ => None,
        };
        let found: Vec<SocketAddr> =
            if_addrs::get_if_addrs()?.iter().filter_map(broadcast).map(|address| (address, PORT).into()).collect();
        return Ok(if found.is_empty() { vec![(Ipv4Addr::BROADCAST, PORT).into()] } else { found });
    }
    let mut targets = Vec::new();
    for host in hosts {
        let host = if host.contains(':') { host.clone() } else { format!("{host}:{PORT}") };
        targets.extend(host.to_socket_addrs()?.filter(SocketAddr::is_ipv4));
    }
    Ok(targets)
}

/// Sends the requests, and collects the answers until the time expires.
///
/// # Errors
///
/// A network that cannot be queried.
pub fn ask(targets: &[SocketAddr], limit: Duration) -> io::Result<Boards> {
    let mut number = [0; 8];
    getrandom::fill(&mut number).map_err(|error| io::Error::other(error.to_string()))?;
    let socket = UdpSocket::bind((Ipv4Addr::UNSPECIFIED, 0))?;
    socket.set_broadcast(true)?;
    let start = Instant::now();
    let mut boards = Boards::new();
    for turn in 1..=TIMES {
        let sent: Vec<_> = targets.iter().map(|target| socket.send_to(&request(number), target)).collect();
        // a network that is down does not prevent requests to other networks
        if sent.iter().all(Result::is_err) {
            sent.into_iter().collect::<io::Result<Vec<_>>>()?;
        }
        // a third of the time for each round, so that answers to the last round are received too
        collect(&socket, number, start + limit * turn / TIMES, &mut boards)?;
    }
    Ok(boards)
}

fn collect(socket: &UdpSocket, number: [u8; 8], end: Instant, boards: &mut Boards) -> io::Result<()> {
    loop {
        let left = end.saturating_duration_since(Instant::now());
        if left.is_zero() {
            return Ok(());
        }
        socket.set_read_timeout(Some(left))?;
        let mut datagram = [0; REQUEST];
        match socket.recv_from(&mut datagram) {
            Ok((count, from)) => {
                if let Some(found) = datagram.get(..count).and_then(|answer| Found::read(answer, number)) {
                    boards.insert(from, board(&found));
                }
            }
            Err(error)
                if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut | ErrorKind::Interrupted) => {}
            // a host that is not a board refused the datagram
            Err(error) if error.kind() == ErrorKind::ConnectionRefused => {}
            Err(error) => return Err(error),
        }
    }
}

fn board(found: &Found<'_>) -> Board {
    let Found { name, board, version, address, port, mac } = *found;
    Board { name: name.into(), board: board.into(), version: version.into(), address, port, mac }
}
