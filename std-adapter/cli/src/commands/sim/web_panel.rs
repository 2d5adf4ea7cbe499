//! `bcap sim --web`: the page of `bcap web` for the virtual controller of this process, with its panel.

use std::future::pending;
use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::ops::ControlFlow;
use std::path::Path;
use std::sync::{Arc, Mutex};

use bcap_core::handler::PeerId;
use bcap_live::link::Access;
use bcap_sim::Controller;
use bcap_sim::pace::Paced;
use bcap_std::server::Server;
use bcap_web::Config;

use super::args::Sim;
use super::delivery;
use crate::commands::web;
use crate::failure::Failure;
use crate::output::print_line;

/// Serves the controller and the page, until `ended`.
pub(super) async fn serve_with_page(
    controller: Controller,
    listen: SocketAddr,
    args: &Sim,
    rac: Option<SocketAddr>,
    file: Option<&Path>,
    ended: impl Future<Output = ()>,
) -> Result<(), Failure> {
    let (name, provider) = (controller.config().model.name.clone(), controller.config().model.provider.clone());
    let shared = Arc::new(Mutex::new(Paced::new(controller)));
    let server = Server::with_shared(Arc::clone(&shared)).tap(deliver).on_connect(connected);
    super::serve(server, args, rac, file, ended, async |line| {
        let address = address_of(line).ok_or_else(|| Failure::Input(format!("no address for the page: {line}")))?;
        let access = Access {
            address: format!("tcp:{address}").parse().map_err(bcap_std::Error::from).map_err(failed)?,
            provider: Some(provider),
            machine: None,
            option: String::new(),
        };
        let config = Config {
            allow_write: true,
            allow_motion: true,
            panel: Some(shared),
            ..Config::new(listen, vec![(format!("virtual {name}"), access)])
        };
        let page = web::bind(config, "--web").await?;
        print_line(&format!("{line} web={}", page.url()))?;
        // it ends with the runtime
        tokio::spawn(page.run(pending()));
        Ok(())
    })
    .await
}

fn failed(error: bcap_std::Error) -> Failure {
    Failure::Input(error.to_string())
}

/// Returns the address of b-CAP over TCP that the line `ready` has, as a client of this computer reaches it.
fn address_of(ready: &str) -> Option<SocketAddr> {
    let mut address: SocketAddr = ready.split(' ').find_map(|word| word.strip_prefix("bcap=")?.parse().ok())?;
    if address.ip().is_unspecified() {
        address.set_ip(IpAddr::V4(Ipv4Addr::LOCALHOST));
    }
    Some(address)
}

fn deliver(paced: &mut Paced, peer: PeerId, bytes: &mut Vec<u8>) -> ControlFlow<()> {
    delivery::deliver(paced.controller(), peer, bytes)
}

fn connected(paced: &mut Paced, peer: PeerId, address: IpAddr) {
    paced.controller().connected(peer, address);
}
