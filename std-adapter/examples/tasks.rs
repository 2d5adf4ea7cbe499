//! Starts a task of a controller, watches it, and stops it after its cycle.
//!
//! ```text
//! bcap sim
//! cargo run -p bcap-std --example tasks -- tcp:127.0.0.1
//! ```

use std::time::{Duration, Instant};
use std::{io, thread};

use bcap_std::blocking::Controller;
use bcap_std::{MainError, Settings, TaskStart, TaskStatus, TaskStop};

fn main() -> Result<(), MainError> {
    run(&std::env::args().nth(1).unwrap_or_else(|| "tcp:127.0.0.1".into()), Duration::from_secs(60))
}

/// Runs the example with the controller at `address`, whose task ends its cycle within `limit`.
pub(crate) fn run(address: &str, limit: Duration) -> Result<(), MainError> {
    let mut cell = Controller::connect(address, &Settings::rc8())?;
    let mut task = cell.task("Pro1")?;
    // its program may move the robot
    task.start(TaskStart::Continuous)?;
    let status = task.status();
    // also after an error: the end of this program does not stop the task
    task.stop(TaskStop::AfterCycle).or_else(|_| task.stop(TaskStop::Now))?;
    println!("Pro1 is {:?}", status?);
    let end = Instant::now() + limit;
    while task.status()? == TaskStatus::Running {
        if Instant::now() > end {
            task.stop(TaskStop::Now)?;
            return Err(io::Error::other("the cycle of Pro1 did not end in time, so it was stopped at once").into());
        }
        thread::sleep(Duration::from_millis(20));
    }
    println!("Pro1 is {:?}", task.status()?);
    Ok(cell.close()?)
}
