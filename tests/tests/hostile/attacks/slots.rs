//! Connections that occupy slots and send nothing.

use std::net::{IpAddr, SocketAddr, TcpStream};

use bcap_core::bcap::FunctionId;
use bcap_tests::tools;
use socket2::{Domain, Socket, Type};

use crate::target::{Target, limits};
use crate::wire::{Raw, bytes};

/// Connects from another loopback address than the bystanders.
fn connect_from(source: IpAddr, server: SocketAddr) -> std::io::Result<TcpStream> {
    let socket = Socket::new(Domain::IPV4, Type::STREAM, None)?;
    socket.bind(&SocketAddr::new(source, 0).into())?;
    socket.connect(&server.into())?;
    Ok(socket.into())
}

/// Half of the connections send no bytes at all, and the others none after Service_Start.
pub(super) fn idle_connections_of_one_address_leave_slots_to_others(target: &mut Target) {
    let attacker = IpAddr::from([127, 0, 0, 2]);
    let mut all = Vec::new();
    for server in [target.tcp, target.rac] {
        for n in 0..limits().connections + 10 {
            let Ok(stream) = connect_from(attacker, server) else {
                return tools::missing("the loopback has one address only");
            };
            let mut raw = Raw::new(stream);
            if n % 2 == 1 && server == target.tcp {
                raw.send(&bytes(FunctionId::SERVICE_START, vec![]));
            }
            all.push(raw);
        }
    }
    target.serves_others();
}
