//! Watches the state of several controllers, which may disconnect and return.
//!
//! ```text
//! bcap sim
//! cargo run -p bcap-std --features tokio --example reconnecting_fleet -- tcp:127.0.0.1 tcp:192.0.2.1
//! ```

use bcap_std::asynch::{Controller, State};
use bcap_std::{AddressError, MainError, Settings};
use tokio::task::JoinSet;

#[tokio::main(flavor = "current_thread")]
async fn main() -> Result<(), MainError> {
    let addresses: Vec<_> = std::env::args().skip(1).collect();
    Ok(run(&addresses, std::future::pending()).await?)
}

/// Watches the controllers at `addresses` until `end` is ready.
pub(crate) async fn run(addresses: &[String], end: impl Future<Output = ()>) -> Result<(), AddressError> {
    let mut cells = JoinSet::new();
    for address in addresses {
        cells.spawn(watch(address.clone(), Controller::spawn(address, &Settings::rc8())?));
    }
    end.await;
    Ok(())
}

/// Counts the sessions of one controller in its I1.
async fn watch(address: String, cell: Controller) {
    let mut states = cell.states();
    while let Some(state) = states.next().await {
        println!("{address}: {state:?}");
        if state == State::Connected
            && let Err(error) = cell.write("I1", cell.statistics().connections).await
        {
            println!("{address}: {error}");
        }
    }
}
