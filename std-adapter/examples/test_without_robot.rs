//! Tests a program without robot, socket and waiting.
//!
//! ```text
//! cargo run -p bcap-std --example test_without_robot
//! ```

use std::time::Duration;

use bcap_sim::memory::Network;
use bcap_sim::{Config, Profile};
use bcap_std::blocking::Controller;
use bcap_std::{Error, Joints, MainError, Motion, Move, Settings};

/// The program: it moves slowly, and counts the motions that arrive.
pub(crate) fn program(cell: &mut Controller) -> Result<Motion, Error> {
    let mut arm = cell.robot()?.take_arm()?;
    arm.motor_on()?;
    let there = Move::joint(Joints::new([40.0, 45.0, 90.0, 0.0, 45.0, 0.0])).speed_percent(2.5);
    let motion = arm.move_to(&there, Duration::from_secs(60))?;
    arm.give()?;
    if motion == Motion::Arrived {
        let count: i32 = cell.read("I1")?;
        cell.write("I1", count + 1)?;
    }
    Ok(motion)
}

fn main() -> Result<(), MainError> {
    Ok(run()?)
}

/// The test.
pub(crate) fn run() -> Result<(), Error> {
    let network = Network::new(Config::new(Profile::Rc8));
    let mut cell = Controller::over(network.connect(), &Settings::rc8())?;
    assert_eq!(program(&mut cell)?, Motion::Arrived);
    assert_eq!(cell.read::<i32>("I1")?, 1);
    println!("{} on the controller's clock", network.now());
    Ok(())
}
