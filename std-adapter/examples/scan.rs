//! Reads variables of a controller every 100 ms and prints their changes.
//!
//! ```text
//! bcap sim
//! cargo run -p bcap-std --features tokio --example scan -- tcp:127.0.0.1
//! ```

use std::time::Duration;

use bcap_std::asynch::{Controller, Reading};
use bcap_std::{Error, MainError, Settings};

#[tokio::main(flavor = "current_thread")]
async fn main() -> Result<(), MainError> {
    Ok(run(&std::env::args().nth(1).unwrap_or_else(|| "tcp:127.0.0.1".into()), usize::MAX).await?)
}

/// Prints `count` changes of the controller at `address`.
pub(crate) async fn run(address: &str, changes: usize) -> Result<(), Error> {
    let cell = Controller::connect(address, &Settings::rc8()).await?;
    let mut readings = cell.subscribe(&["I1", "IO128"], Duration::from_millis(100));
    for _ in 0..changes {
        let Some(Reading { name, value, .. }) = readings.next().await else { break };
        match value {
            Ok(value) => println!("{name} = {value:?}"),
            Err(error) => println!("{name} is unknown: {error}"),
        }
    }
    cell.close().await
}
