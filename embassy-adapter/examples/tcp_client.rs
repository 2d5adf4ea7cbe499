//! A b-CAP client over TCP on embassy-net: it reads a variable, and connects again when the connection breaks.
//!
//! Like its neighbours this is a library of tasks, which a firmware calls with its own network stack.
#![no_std]

use bcap_core::bcap::client::Config;
use bcap_core::bcap::{Client, call};
use bcap_core::io::CallError;
use bcap_embassy::net::{Connection, NetError, Options, TcpClient, TcpTransport};
use embassy_net::{IpEndpoint, Stack};
use embassy_time::Timer;

/// Memory of the socket and of the client, which a board places where it likes.
#[derive(Debug)]
pub struct Memory {
    rx: [u8; 512],
    tx: [u8; 512],
    request: [u8; 512],
    reply: [u8; 512],
}

/// Reads `I1` ten times a second and gives it to `seen`.
pub async fn watch(stack: Stack<'_>, robot: IpEndpoint, memory: &mut Memory, mut seen: impl FnMut(i32)) -> ! {
    let Memory { rx, tx, request, reply } = memory;
    let transport = TcpTransport::new(stack, rx, tx, Options::default());
    let mut connection = Connection::new(transport, Client::new(Config::TCP, &mut request[..], &mut reply[..]));
    loop {
        if connection.transport().connect(robot).await.is_ok() {
            connection.client().reset();
            // why it ended does not matter here: all there is to do is to connect again
            let _ = read(&mut connection, &mut seen).await;
        }
        Timer::after_secs(1).await;
    }
}

async fn read(
    robot: &mut TcpClient<'_, &mut [u8]>,
    seen: &mut impl FnMut(i32),
) -> Result<core::convert::Infallible, CallError<NetError>> {
    robot.call(call::service_start("WDT=400")).await?;
    let controller = robot.call(call::controller_connect("", "CaoProv.DENSO.VRC9", "localhost", "")).await?;
    let variable = robot.call(call::controller_get_variable(controller, "I1", "")).await?;
    loop {
        if let Some(value) = robot.call(call::variable_get_value(variable)).await?.as_i32() {
            seen(value);
        }
        Timer::after_millis(100).await;
    }
}
