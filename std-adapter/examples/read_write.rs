//! Reads and writes variables of a controller.
//!
//! ```text
//! bcap sim
//! cargo run -p bcap-std --example read_write -- tcp:127.0.0.1
//! ```

use bcap_std::blocking::Controller;
use bcap_std::{Error, MainError, Position, Settings};

fn main() -> Result<(), MainError> {
    Ok(run(&std::env::args().nth(1).unwrap_or_else(|| "tcp:127.0.0.1".into()))?)
}

/// Runs the example with the controller at `address`.
pub(crate) fn run(address: &str) -> Result<(), Error> {
    let mut cell = Controller::connect(address, &Settings::rc8())?;
    let count: i32 = cell.read("I1")?;
    cell.write("I1", count + 1)?;
    cell.write("P1", Position::new([400.0, 0.0, 300.0], [180.0, 0.0, 180.0]).figure(5))?;
    let position: Position = cell.read("P1")?;
    println!("I1 was {count}; P1 is at {:?} mm", position.xyz_mm);
    cell.close()
}
