//! A b-CAP client over UDP on embassy-net; the client retransmits calls that are not answered.
#![no_std]

use bcap_core::bcap::client::Config;
use bcap_core::bcap::{Client, call};
use bcap_core::io::CallError;
use bcap_core::limits::{UDP_RECEIVE_MAX, UDP_SEND_MAX};
use bcap_embassy::net::{Connection, NetError, UdpTransport};
use embassy_net::udp::{PacketMetadata, UdpSocket};
use embassy_net::{IpEndpoint, Stack};

/// The buffers of the socket and of the client.
#[derive(Debug)]
pub struct Memory {
    meta: [[PacketMetadata; 2]; 2],
    socket: [[u8; 1024]; 2],
    request: [u8; UDP_SEND_MAX],
    /// One byte more than the longest datagram, so that a longer one is detected.
    reply: [u8; UDP_RECEIVE_MAX + 1],
}

/// Reads `I1` once.
///
/// # Errors
///
/// A [`CallError`] when the robot does not answer or refuses a call.
pub async fn read(
    stack: Stack<'_>,
    robot: IpEndpoint,
    memory: &mut Memory,
) -> Result<Option<i32>, CallError<NetError>> {
    let Memory { meta: [rx_meta, tx_meta], socket: [rx, tx], request, reply } = memory;
    let socket = UdpSocket::new(stack, rx_meta, rx, tx_meta, tx);
    let transport = UdpTransport::new(stack, socket, robot).map_err(CallError::Io)?;
    let mut robot = Connection::new(transport, Client::new(Config::UDP, &mut request[..], &mut reply[..]));
    robot.call(call::service_start("WDT=400")).await?;
    let controller = robot.call(call::controller_connect("", "CaoProv.DENSO.VRC9", "localhost", "")).await?;
    let variable = robot.call(call::controller_get_variable(controller, "I1", "")).await?;
    let value = robot.call(call::variable_get_value(variable)).await?.as_i32();
    robot.call(call::controller_disconnect(controller)).await?;
    robot.call(call::service_stop()).await?;
    Ok(value)
}
