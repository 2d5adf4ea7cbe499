//! A b-CAP client over a serial line; its frames carry a CRC.
#![no_std]

use bcap_core::bcap::call;
use bcap_core::io::CallError;
use bcap_core::limits::SERIAL_MAX;
use bcap_embassy::serial::{self, Config};
use embedded_io_async::{Read, Write};

/// The client's buffers.
#[derive(Debug)]
pub struct Memory {
    request: [u8; SERIAL_MAX],
    reply: [u8; SERIAL_MAX],
}

/// Reads `I1` once over a buffered UART.
///
/// # Errors
///
/// A [`CallError`] when the line fails, or the robot does not answer or refuses a call.
pub async fn read<U: Read + Write>(uart: U, memory: &mut Memory) -> Result<Option<i32>, CallError<U::Error>> {
    let Memory { request, reply } = memory;
    let mut robot = serial::client(uart, Config::serial(38_400), &mut request[..], &mut reply[..]);
    robot.call(call::service_start("WDT=400")).await?;
    let controller = robot.call(call::controller_connect("", "CaoProv.DENSO.VRC", "localhost", "")).await?;
    let variable = robot.call(call::controller_get_variable(controller, "I1", "")).await?;
    Ok(robot.call(call::variable_get_value(variable)).await?.as_i32())
}
