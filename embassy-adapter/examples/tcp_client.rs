//! A b-CAP client over TCP on embassy-net that reads a variable and reconnects after a failure.
//!
//! Like the other examples, this is a library of tasks that a firmware calls with its own network stack.
#![no_std]

use bcap_core::bcap::client::Config;
use bcap_core::bcap::{Client, call};
use bcap_core::io::CallError;
use bcap_embassy::net::{Connection, NetError, Options, TcpClient, TcpTransport};
use embassy_net::{IpEndpoint, Stack};
use embassy_time::Timer;

/// The buffers of the socket and of the client.
#[derive(Debug)]
pub struct Memory {
    rx: [u8; 512],
    tx: [u8; 512],
    request: [u8; 512],
    reply: [u8; 512],
}

/// Reads `I1` ten times a second and calls `on_value` with it.
pub async fn watch(stack: Stack<'_>, robot: IpEndpoint, memory: &mut Memory, mut on_value: impl FnMut(i32)) -> ! {
    let Memory { rx, tx, request, reply } = memory;
    let transport = TcpTransport::new(stack, rx, tx, Options::default());
    let mut connection = Connection::new(transport, Client::new(Config::TCP, &mut request[..], &mut reply[..]));
    loop {
        if connection.transport().connect(robot).await.is_ok() {
            connection.client().reset();
            // every error has the same remedy: reconnect
            let _ = read(&mut connection, &mut on_value).await;
        }
        Timer::after_secs(1).await;
    }
}

async fn read(
    robot: &mut TcpClient<'_, &mut [u8]>,
    on_value: &mut impl FnMut(i32),
) -> Result<core::convert::Infallible, CallError<NetError>> {
    robot.call(call::service_start("WDT=400")).await?;
    let controller = robot.call(call::controller_connect("", "CaoProv.DENSO.VRC9", "localhost", "")).await?;
    let variable = robot.call(call::controller_get_variable(controller, "I1", "")).await?;
    loop {
        if let Some(value) = robot.call(call::variable_get_value(variable)).await?.as_i32() {
            on_value(value);
        }
        Timer::after_millis(100).await;
    }
}
