//! `bcap sim --web`: the page of `bcap web` for the virtual controller of this process, with its panel.

use std::future::pending;
use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::sync::{Arc, Mutex, PoisonError};

use bcap_live::link::Access;
use bcap_sim::pace::Paced;
use bcap_web::Config;

use crate::commands::web;
use crate::failure::Failure;

/// Starts the page, which ends with the runtime, and returns its address. `ready` is the line with the addresses of the controller.
pub(super) async fn start(ready: &str, listen: SocketAddr, shared: Arc<Mutex<Paced>>) -> Result<String, Failure> {
    let model = shared.lock().unwrap_or_else(PoisonError::into_inner).controller().config().model.clone();
    let address = address_of(ready).ok_or_else(|| Failure::Input(format!("no address for the page: {ready}")))?;
    let address = format!("tcp:{address}").parse().map_err(|error| Failure::Input(format!("{address}: {error}")))?;
    let access = Access { address, provider: Some(model.provider), machine: None, option: String::new() };
    let robots = vec![(format!("virtual {}", model.name), access)];
    let config = Config { allow_write: true, allow_motion: true, panel: Some(shared), ..Config::new(listen, robots) };
    let page = web::bind(config, "--web").await?;
    let url = page.url();
    tokio::spawn(page.run(pending()));
    Ok(url)
}

/// Returns the address of b-CAP over TCP that the line `ready` has, as a client of this computer reaches it.
fn address_of(ready: &str) -> Option<SocketAddr> {
    let mut address: SocketAddr = ready.split(' ').find_map(|word| word.strip_prefix("bcap=")?.parse().ok())?;
    if address.ip().is_unspecified() {
        address.set_ip(IpAddr::V4(Ipv4Addr::LOCALHOST));
    }
    Some(address)
}
