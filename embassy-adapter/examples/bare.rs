//! b-CAP clients over TCP and UDP, a RAC server and a b-CAP server over UDP in one polling loop, on smoltcp without embassy.
#![no_std]

use bcap_core::bcap::Client;
use bcap_core::bcap::call::{self, VariableHandle};
use bcap_core::bcap::client::Event;
use bcap_core::bcap::server;
use bcap_core::rac::server::{Config, Handler, Session};
use bcap_core::time::Instant;
use bcap_embassy::bare::{self, LinkError, TcpServer, UdpServer};
use smoltcp::iface::{Interface, SocketHandle, SocketSet};
use smoltcp::phy::Device;
use smoltcp::socket::{tcp, udp};
use smoltcp::wire::IpEndpoint;

/// The sockets of the board; the first is connected to the robot, those for UDP are bound.
#[derive(Debug)]
pub struct Sockets<'m> {
    /// All sockets.
    pub set: SocketSet<'m>,
    /// The TCP socket to the robot.
    pub robot_tcp: SocketHandle,
    /// The UDP socket to the robot.
    pub robot_udp: SocketHandle,
    /// The TCP socket for a RAC client.
    pub rac: SocketHandle,
    /// The UDP socket for b-CAP clients.
    pub bcap: SocketHandle,
}

/// The clients and the server.
#[derive(Debug)]
pub struct Board {
    /// The client over TCP.
    pub tcp: Client<[u8; 512]>,
    /// The client over UDP.
    pub udp: Client<[u8; 505]>,
    /// The server.
    pub rac: TcpServer<Session<[u8; 64]>>,
    /// The server of b-CAP for two clients.
    pub bcap: UdpServer<2, 16>,
}

/// Does all work that is possible without waiting; call it when a frame arrives and when a timer expires.
///
/// # Errors
///
/// A [`LinkError`] when the connection to the robot ended.
pub fn poll<D: Device>(
    board: &mut Board,
    sockets: &mut Sockets<'_>,
    interface: &mut Interface,
    device: &mut D,
    robot: IpEndpoint,
    handler: &mut (impl Handler + server::Handler),
    now: Instant,
) -> Result<(), LinkError> {
    interface.poll(bare::to_smoltcp(now), device, &mut sockets.set);
    let socket = sockets.set.get_mut::<tcp::Socket<'_>>(sockets.robot_tcp);
    while let Some(event) = bare::poll_tcp(&mut board.tcp, socket, now)? {
        handle(&board.tcp, event);
    }
    if !board.tcp.is_busy() {
        let _ = board.tcp.start(&call::variable_get_value(VariableHandle(1)), board.tcp.timing(), now);
    }
    let socket = sockets.set.get_mut::<udp::Socket<'_>>(sockets.robot_udp);
    while let Some(event) = bare::poll_udp(&mut board.udp, socket, robot, now)? {
        handle(&board.udp, event);
    }
    let socket = sockets.set.get_mut::<tcp::Socket<'_>>(sockets.rac);
    board.rac.poll(socket, || Session::new(Config::TCP, [0; 64]), handler, now);
    board.bcap.poll(sockets.set.get_mut(sockets.bcap), handler, now);
    interface.poll(bare::to_smoltcp(now), device, &mut sockets.set);
    Ok(())
}

fn handle<const N: usize>(client: &Client<[u8; N]>, event: Event) {
    if let Event::Replied(result) = event
        && result.is_ok()
    {
        let _value = client.reply().and_then(|reply| reply.value());
    }
}
