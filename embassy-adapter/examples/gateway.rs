//! A gateway board between a b-CAP robot and three RAC PLCs, all over the network. `serial_gateway` is one without a network.
//!
//! Like the other examples, this is a library of tasks that a firmware calls with its own network stack.
#![no_std]

use bcap_core::rac::{self, VariableKind};
use bcap_embassy::gateway::{Limits, Listener, Report, SharedGateway, TcpRobot, run_robot};
use bcap_embassy::net::Options;
use bcap_gateway::{Allow, Config, Event, Gateway, Memory, Rules};
use embassy_net::{IpEndpoint, Stack};
use embassy_sync::blocking_mutex::raw::NoopRawMutex;

/// The variables that PLCs may write: `I0` to `I99`.
const PUT: [Allow<'static>; 1] = [Allow::range(VariableKind::I, 0, 99)];

/// The gateway that four tasks share.
pub type Board<'m> = SharedGateway<'m, NoopRawMutex, 3>;

/// Creates a gateway for three PLCs, with handles for 32 variables.
pub fn make(memory: &mut Memory<3, 32>) -> Board<'_> {
    let rules = Rules { put: &PUT, ..Rules::READ_ONLY };
    SharedGateway::new(Gateway::new(Config { rules, ..Config::RC9 }, memory), log)
}

/// The place where a firmware writes a report to its log.
fn log(report: &Report<'_>) {
    match report {
        Report::Answered { client: _, line: _, event: Event::Refused { refusal: _, .. } } => {}
        Report::Robot { event: _, cause: _ } => {}
        _ => {}
    }
}

/// Serves one PLC at a time; run it three times to serve three.
pub async fn serve_plc(stack: Stack<'_>, [rx, tx]: &mut [[u8; 512]; 2], board: &Board<'_>) -> ! {
    Listener::new(stack, rac::PORT, rx, tx).run(board, &Limits::default()).await
}

/// Runs the connection to the robot.
pub async fn keep_robot(stack: Stack<'_>, robot: IpEndpoint, memory: &mut [[u8; 512]; 3], board: &Board<'_>) -> ! {
    let [rx, tx, frame] = memory;
    let mut link = TcpRobot::new(stack, rx, tx, Options::default(), robot);
    run_robot(&mut link, frame, board).await
}
