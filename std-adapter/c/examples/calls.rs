//! As `calls.c`, in Rust.

use std::time::Instant;

use bcap_std::blocking::Controller;
use bcap_std::{MainError, Settings};

/// Returns the processor time of this process in seconds.
fn processor_time() -> Option<f64> {
    let stat = std::fs::read_to_string("/proc/self/schedstat").ok()?;
    Some(stat.split(' ').next()?.parse::<f64>().ok()? / 1e9)
}

fn main() -> Result<(), MainError> {
    let mut arguments = std::env::args().skip(1);
    let address = arguments.next().unwrap_or_else(|| "tcp:127.0.0.1".into());
    let count: u32 = arguments.next().map_or(Ok(10_000), |count| count.parse())?;
    let mut cell = Controller::connect(&address, &Settings::rc8())?;
    let (began, used) = (Instant::now(), processor_time().unwrap_or(0.0));
    for _ in 0..count {
        std::hint::black_box(cell.read::<i64>("I1")?);
    }
    let (seconds, used) = (began.elapsed().as_secs_f64(), processor_time().unwrap_or(0.0) - used);
    let count = f64::from(count);
    println!("Rust: {:.0} calls/s, {:.2} us of processor time each", count / seconds, used * 1e6 / count);
    Ok(())
}
