//! Reads variables of a controller every 100 ms and prints their changes.
//!
//! ```text
//! bcap sim
//! cargo run -p bcap-std --features tokio --example scan -- tcp:127.0.0.1
//! ```

use std::time::Duration;

use bcap_std::asynch::Controller;
use bcap_std::{Error, Settings};

#[tokio::main(flavor = "current_thread")]
async fn main() -> Result<(), Error> {
    run(&std::env::args().nth(1).unwrap_or_else(|| "tcp:127.0.0.1".into()), usize::MAX).await
}

/// Prints so many changes of the controller at `address`.
pub(crate) async fn run(address: &str, changes: usize) -> Result<(), Error> {
    let cell = Controller::connect(address, &Settings::rc8()).await?;
    let interval = Duration::from_millis(100);
    let (mut count, mut door) = (cell.subscribe("I1", interval), cell.subscribe("IO128", interval));
    for _ in 0..changes {
        let (name, reading) = tokio::select! {
            Some(reading) = count.next() => ("I1", reading),
            Some(reading) = door.next() => ("IO128", reading),
            else => break,
        };
        match reading {
            Ok(value) => println!("{name} = {value:?}"),
            Err(error) => println!("{name} is unknown: {error}"),
        }
    }
    cell.close().await
}
