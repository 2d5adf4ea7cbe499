//! Moves a robot, while a line on the standard input stops it.
//!
//! ```text
//! bcap sim
//! cargo run -p bcap-std --example move_and_stop -- tcp:127.0.0.1
//! ```

use std::io::{self, BufRead, BufReader};
use std::{sync::mpsc, thread, time::Duration};

use bcap_std::blocking::Controller;
use bcap_std::{Joints, MainError, Motion, Move, Settings};

fn main() -> Result<(), MainError> {
    let address = std::env::args().nth(1).unwrap_or_else(|| "tcp:127.0.0.1".into());
    run(&address, BufReader::new(io::stdin()).split(b'\n').map_while(Result::ok))
}

/// Runs the example with the controller at `address`. Each of `lines` stops the robot; their end does not.
pub(crate) fn run(address: &str, lines: impl Iterator<Item = Vec<u8>> + Send + 'static) -> Result<(), MainError> {
    let mut cell = Controller::connect(address, &Settings::rc8())?;
    let (stopper, (stop, stopped)) = (cell.stopper()?, mpsc::channel());
    thread::spawn(move || {
        for _ in lines {
            let _ = stop.send(()); // before the halt, which has no effect on a motion that begins later
            println!("{:?}", stopper.halt());
        }
    });
    let mut arm = cell.robot()?.take_arm()?;
    arm.motor_on()?;
    let motion = Move::joint(Joints::new([20.0, 45.0, 90.0, 0.0, 45.0, 0.0])).speed_percent(50.0);
    let mut ended = Motion::Halted;
    if stopped.try_recv().is_err() {
        let moving = arm.start(&motion, Duration::from_secs(30))?; // a halt may have come just before it
        ended = if stopped.try_recv().is_ok() { moving.halt().map(|_| ended)? } else { moving.wait()? };
    }
    arm.give()?;
    println!("the motion ended: {ended:?}");
    if matches!(ended, Motion::Arrived | Motion::Halted) { Ok(()) } else { Err(io::Error::other("not arrived").into()) }
}
