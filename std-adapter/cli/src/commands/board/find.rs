//! `bcap board find`: asks the boards of a network for their addresses ([`bcap_board::find`]).

use std::collections::BTreeMap;
use std::io::{self, ErrorKind};
use std::net::{Ipv4Addr, SocketAddr, ToSocketAddrs, UdpSocket};
use std::time::{Duration, Instant};

use bcap_board::find::{Found, PORT, REQUEST, request};
use clap::Args;
use if_addrs::IfAddr;
use serde_json::json;

use crate::failure::Failure;
use crate::link::LinkArgs;
use crate::output;

/// Finds the gateway boards of the networks of this computer
///
/// It asks with three broadcasts over UDP, and prints a line for each board that answers within --timeout [default: 1 s]: its address,
/// the port of RAC, its MAC address, the board, the version, and its name from the setting `hostname`. A board answers only hosts of
/// its own network, unless its settings have find=no.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  bcap board find
  bcap board find 192.168.0.255
  bcap board find 192.168.0.9 --json")]
pub(crate) struct Find {
    /// Boards or broadcast addresses (HOST[:PORT]) [default: the broadcast address of each network of this computer]
    #[arg(value_name = "HOST")]
    pub(crate) hosts: Vec<String>,
}

/// How long boards may take to answer.
const LIMIT: Duration = Duration::from_secs(1);
/// A datagram can be lost, so each is sent this often.
const TIMES: u32 = 3;

/// The facts about a board, by its address, so that each is printed once.
type Boards = BTreeMap<SocketAddr, (String, serde_json::Value)>;

pub(super) fn find(args: &Find, link: &LinkArgs, json: bool) -> Result<(), Failure> {
    let limit = link.within(LIMIT).timeout();
    let failed = |error: io::Error| Failure::Connection {
        message: format!("cannot ask the network: {error}"),
        hint: "check that this computer has an address in the network of the board".into(),
    };
    let targets = targets(&args.hosts).map_err(failed)?;
    let boards = ask(&targets, limit).map_err(failed)?;
    for (line, object) in boards.values() {
        output::print_result(json, object, line)?;
    }
    if !boards.is_empty() {
        return Ok(());
    }
    let names: Vec<String> = targets.iter().map(ToString::to_string).collect();
    Err(Failure::Connection {
        message: format!("no board answers at {} within {} ms", names.join(", "), limit.as_millis()),
        hint: "a board answers once it has an address, which it also prints on its console, and only to its own network; a firewall \
               may drop the answer"
            .into(),
    })
}

/// Returns the addresses to ask.
fn targets(hosts: &[String]) -> io::Result<Vec<SocketAddr>> {
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

/// Sends the requests, and collects the answers until the time is over.
fn ask(targets: &[SocketAddr], limit: Duration) -> io::Result<Boards> {
    let mut number = [0; 8];
    getrandom::fill(&mut number).map_err(|error| io::Error::other(error.to_string()))?;
    let socket = UdpSocket::bind((Ipv4Addr::UNSPECIFIED, 0))?;
    socket.set_broadcast(true)?;
    let start = Instant::now();
    let mut boards = Boards::new();
    for turn in 1..=TIMES {
        let sent: Vec<_> = targets.iter().map(|target| socket.send_to(&request(number), target)).collect();
        // a network that is down does not keep the others from being asked
        if sent.iter().all(Result::is_err) {
            sent.into_iter().collect::<io::Result<Vec<_>>>()?;
        }
        // a third of the time for each turn, so the last one has its time as well
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
                    boards.insert(from, shown(&found));
                }
            }
            Err(error)
                if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut | ErrorKind::Interrupted) => {}
            // a host that is no board refused the datagram
            Err(error) if error.kind() == ErrorKind::ConnectionRefused => {}
            Err(error) => return Err(error),
        }
    }
}

fn shown(found: &Found<'_>) -> (String, serde_json::Value) {
    let Found { name, board, version, address: (address, prefix), port, mac } = found;
    let [a, b, c, d, e, f] = mac;
    let mac = format!("{a:02x}:{b:02x}:{c:02x}:{d:02x}:{e:02x}:{f:02x}");
    let line = format!("{address}:{port}  {mac}  {board} {version}  {name}");
    let object = json!({ "address": address, "prefix": prefix, "port": port, "mac": mac, "board": board, "version": version, "name": name });
    (line.trim_end().to_owned(), object)
}
