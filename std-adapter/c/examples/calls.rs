//! As `calls.c`, in Rust.

use std::hint::black_box;

use bcap_std::blocking::Controller;
use bcap_std::{Error, MainError, Settings};

/// Returns the processor time of this process in seconds.
fn processor_time() -> Option<f64> {
    let stat = std::fs::read_to_string("/proc/self/schedstat").ok()?;
    Some(stat.split(' ').next()?.parse::<f64>().ok()? / 1e9)
}

fn call(cell: &mut Controller, operation: &str) -> Result<(), Error> {
    match operation {
        "write" => return cell.write("I1", 5),
        "pose" => _ = black_box(cell.read::<Vec<f64>>("P1")?),
        "joints" => _ = black_box(cell.robot()?.joints()?),
        _ => _ = black_box(cell.read::<i64>("I1")?),
    }
    Ok(())
}

fn main() -> Result<(), MainError> {
    let mut arguments = std::env::args().skip(1);
    let address = arguments.next().unwrap_or_else(|| "tcp:127.0.0.1".into());
    let count: u32 = arguments.next().map_or(Ok(10_000), |count| count.parse())?;
    let operation = arguments.next().unwrap_or_default();
    let mut cell = Controller::connect(&address, &Settings::rc8())?;
    let used = processor_time().unwrap_or(0.0);
    for _ in 0..count {
        call(&mut cell, &operation)?;
    }
    println!("{:.2}", (processor_time().unwrap_or(0.0) - used) * 1e6 / f64::from(count));
    Ok(())
}
