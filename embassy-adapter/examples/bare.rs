//! Clients over TCP and UDP, and a RAC server, on smoltcp without embassy: all in one loop.
#![no_std]

use bcap_core::bcap::Client;
use bcap_core::bcap::call::{self, VariableHandle};
use bcap_core::bcap::client::Event;
use bcap_core::rac::server::{Config, Handler, Session};
use bcap_core::time::Instant;
use bcap_embassy::bare::{self, LinkError, TcpServer};
use smoltcp::iface::{Interface, SocketHandle, SocketSet};
use smoltcp::phy::Device;
use smoltcp::socket::{tcp, udp};
use smoltcp::wire::IpEndpoint;

/// The sockets of the board; the first is connected to the robot, the second is bound.
#[derive(Debug)]
pub struct Sockets<'m> {
    /// All of them.
    pub set: SocketSet<'m>,
    /// To the robot over TCP.
    pub robot_tcp: SocketHandle,
    /// To the robot over UDP.
    pub robot_udp: SocketHandle,
    /// For a RAC client.
    pub rac: SocketHandle,
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
}

/// Does what can be done now; to be called when a frame has come and when time has passed.
///
/// # Errors
///
/// When the connection to the robot is over.
pub fn poll<D: Device>(
    board: &mut Board,
    sockets: &mut Sockets<'_>,
    interface: &mut Interface,
    device: &mut D,
    robot: IpEndpoint,
    handler: &mut impl Handler,
    now: Instant,
) -> Result<(), LinkError> {
    interface.poll(bare::to_smoltcp(now), device, &mut sockets.set);
    let socket = sockets.set.get_mut::<tcp::Socket<'_>>(sockets.robot_tcp);
    while let Some(event) = bare::poll_tcp(&mut board.tcp, socket, now)? {
        look(&board.tcp, event);
    }
    if !board.tcp.is_busy() {
        let _ = board.tcp.start(&call::variable_get_value(VariableHandle(1)), board.tcp.timing(), now);
    }
    let socket = sockets.set.get_mut::<udp::Socket<'_>>(sockets.robot_udp);
    while let Some(event) = bare::poll_udp(&mut board.udp, socket, robot, now)? {
        look(&board.udp, event);
    }
    let socket = sockets.set.get_mut::<tcp::Socket<'_>>(sockets.rac);
    board.rac.poll(socket, || Session::new(Config::TCP, [0; 64]), handler, now);
    interface.poll(bare::to_smoltcp(now), device, &mut sockets.set);
    Ok(())
}

fn look<const N: usize>(client: &Client<[u8; N]>, event: Event) {
    if let Event::Replied(result) = event
        && result.is_ok()
    {
        let _value = client.reply().and_then(|reply| reply.value());
    }
}
