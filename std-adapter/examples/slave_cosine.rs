//! Streams poses in Slave Mode: joint 1 swings by 10 degrees, as in the sample program of the specification.
//!
//! ```text
//! bcap sim
//! cargo run -p bcap-std --example slave_cosine -- udp:127.0.0.1
//! ```

use bcap_std::blocking::Controller;
use bcap_std::core::slave::{
    AxisLimits, Cycle, Format, Mode, Next, Pose, PoseType, ReceiveFormat, ReceivePose, SlaveMode,
};
use bcap_std::{Error, MainError, Settings};

fn main() -> Result<(), MainError> {
    Ok(run(&std::env::args().nth(1).unwrap_or_else(|| "udp:127.0.0.1".into()), 1000)?)
}

/// Streams one swing of so many cycles of 8 ms to the controller at `address`.
pub(crate) fn run(address: &str, cycles: u32) -> Result<(), Error> {
    let mut cell = Controller::connect(address, &Settings::rc8())?;
    let mut arm = cell.robot()?.take_arm()?;
    arm.motor_on()?;
    let mode = SlaveMode { mode: Mode::Mode0, pose: PoseType::J };
    let format = Format::new(mode, ReceiveFormat::pose(ReceivePose::J));
    let mut swing = |cycle: &Cycle<'_>| {
        let mut joints: [f64; 8] = cycle.start.numbers().try_into().unwrap_or_default();
        let part = f64::from(cycle.number + 1) / f64::from(cycles);
        joints[0] += 5.0 * (1.0 - (part * std::f64::consts::TAU).cos());
        if cycle.number < cycles { Next::Pose(Pose::j(joints)) } else { Next::Finish }
    };
    let stats = arm.stream(format, AxisLimits::uniform(100.0, 800.0), &mut swing)?;
    println!("{} cycles, {} late", stats.cycles, stats.late);
    arm.give()
}
