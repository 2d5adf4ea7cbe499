//! Moves a robot, while a line on the standard input stops it.
//!
//! ```text
//! bcap sim
//! cargo run -p bcap-std --example move_and_stop -- tcp:127.0.0.1
//! ```

use std::thread;
use std::time::Duration;

use bcap_std::blocking::Controller;
use bcap_std::{Error, Joints, MainError, Motion, Move, Settings};

fn main() -> Result<(), MainError> {
    Ok(run(&std::env::args().nth(1).unwrap_or_else(|| "tcp:127.0.0.1".into()))?)
}

/// Runs the example with the controller at `address`.
pub(crate) fn run(address: &str) -> Result<(), Error> {
    let mut cell = Controller::connect(address, &Settings::rc8())?;
    let stopper = cell.stopper()?;
    thread::spawn(move || {
        let pressed = std::io::stdin().read_line(&mut String::new());
        // the end of the input is not the button
        if pressed.is_ok_and(|bytes| bytes > 0) {
            println!("{:?}", stopper.halt());
        }
    });
    let mut arm = cell.robot()?.take_arm()?;
    arm.motor_on()?;
    let motion = Move::joint(Joints::new([20.0, 45.0, 90.0, 0.0, 45.0, 0.0])).speed_percent(50.0);
    match arm.move_to(&motion, Duration::from_secs(30))? {
        Motion::Arrived => println!("arrived"),
        other => println!("stopped: {other:?}"),
    }
    arm.give()
}
