//! A gateway board without a network: a robot and two PLCs that speak RAC, each at the other end of a serial line.
//!
//! Like the other examples, this is a library of tasks that a firmware calls, here with its UARTs. It needs the features
//! `gateway` and `serial`, and not embassy-net.
#![no_std]

use bcap_core::bcap::client;
use bcap_core::rac::VariableKind;
use bcap_embassy::gateway::{Front, Limits, Report, SerialRobot, SharedGateway, run_robot, serve};
use bcap_embassy::serial::transport;
use bcap_gateway::{Allow, Config, Event, Gateway, Memory, Rules};
use embassy_sync::blocking_mutex::raw::NoopRawMutex;
use embassy_time::Timer;
use embedded_io_async::{Read, Write};

/// The rate of the robot's line.
const BAUD: u32 = 115_200;

/// The variables that PLCs may write: `I0` to `I99`.
const PUT: [Allow<'static>; 1] = [Allow::range(VariableKind::I, 0, 99)];

/// The gateway that three tasks share.
pub type Board<'m> = SharedGateway<'m, NoopRawMutex, 2>;

/// Creates a gateway for two PLCs, with handles for 32 variables.
pub fn make(memory: &mut Memory<2, 32>) -> Board<'_> {
    let rules = Rules { put: &PUT, ..Rules::READ_ONLY };
    let client = client::Config::serial(BAUD);
    SharedGateway::new(Gateway::new(Config { client, rules, ..Config::RC9 }, memory), log)
}

/// The place where a firmware writes a report to its log.
fn log(report: &Report<'_>) {
    match report {
        Report::Answered { client: _, line: _, event: Event::Refused { refusal: _, .. } } => {}
        Report::Robot { event: _, cause: _ } => {}
        _ => {}
    }
}

/// Serves the PLC at the other end of a line, such as a buffered UART. A line has no end, so a session that ends, for example
/// because the PLC sent half a line, is followed by another.
pub async fn serve_plc<U: Read + Write>(uart: U, board: &Board<'_>) -> ! {
    let mut line = transport(uart);
    loop {
        if serve(&mut line, Front::Rac, None, board, &Limits::default()).await.is_none() {
            // the rules may allow no client without an address
            Timer::after_secs(1).await;
        }
    }
}

/// Runs the connection to the robot at the other end of a line.
pub async fn keep_robot<U: Read + Write>(uart: U, frame: &mut [u8; 512], board: &Board<'_>) -> ! {
    run_robot(&mut SerialRobot::new(uart), frame, board).await
}
