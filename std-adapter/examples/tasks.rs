//! Starts a task of a controller, watches it, and stops it after its cycle.
//!
//! ```text
//! bcap sim
//! cargo run -p bcap-std --example tasks -- tcp:127.0.0.1
//! ```

use std::thread;
use std::time::Duration;

use bcap_std::blocking::Controller;
use bcap_std::{Error, MainError, Settings, TaskStart, TaskStatus, TaskStop};

fn main() -> Result<(), MainError> {
    Ok(run(&std::env::args().nth(1).unwrap_or_else(|| "tcp:127.0.0.1".into()))?)
}

/// Runs the example with the controller at `address`.
pub(crate) fn run(address: &str) -> Result<(), Error> {
    let mut cell = Controller::connect(address, &Settings::rc8())?;
    let mut task = cell.task("Pro1")?;
    // its program may move the robot
    task.start(TaskStart::Continuous)?;
    println!("Pro1 is {:?}", task.status()?);
    task.stop(TaskStop::AfterCycle)?;
    while task.status()? == TaskStatus::Running {
        thread::sleep(Duration::from_millis(20));
    }
    println!("Pro1 is {:?}", task.status()?);
    cell.close()
}
