//! `bcap sim --web`: the page of `bcap web` for the virtual controller or the replay of this process.

use std::future::pending;
use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::sync::{Arc, Mutex, PoisonError};

use bcap_live::link::Access;
use bcap_live::tap::Tap;
use bcap_sim::pace::Paced;
use bcap_web::{Config, Replay};

use crate::commands::web;
use crate::failure::Failure;
use crate::output::Printer;

/// Starts the page of a virtual controller at `bcap`, with its panel. It ends with the runtime. Returns its address.
pub(super) async fn start(bcap: SocketAddr, listen: SocketAddr, shared: Arc<Mutex<Paced>>) -> Result<String, Failure> {
    let model = shared.lock().unwrap_or_else(PoisonError::into_inner).controller().config().model.clone();
    let access = access(bcap, model.provider, None, String::new())?;
    let robots = vec![(format!("virtual {}", model.name), access)];
    serve(Config { allow_write: true, allow_motion: true, panel: Some(shared), ..Config::new(listen, robots) }).await
}

/// Starts the page of a replay at `bcap`, which opens the session of the capture again. The page only reads.
pub(super) async fn replay(
    bcap: SocketAddr,
    listen: SocketAddr,
    session: Option<[String; 3]>,
    replay: Replay,
) -> Result<String, Failure> {
    let [provider, machine, option] =
        session.ok_or_else(|| Failure::Input("the capture has no Controller_Connect, which a page needs".into()))?;
    let robots = vec![("replay".to_owned(), access(bcap, provider, Some(machine), option)?)];
    serve(Config { replay: Some(replay), ..Config::new(listen, robots) }).await
}

async fn serve(config: Config) -> Result<String, Failure> {
    // its thread prints until the process ends
    let page = web::bind(config, "--web", &Printer::start(false)?).await?;
    let url = page.url();
    tokio::spawn(page.run(pending()));
    Ok(url)
}

/// Returns the access of a client of this computer.
fn access(mut bcap: SocketAddr, provider: String, machine: Option<String>, option: String) -> Result<Access, Failure> {
    if bcap.ip().is_unspecified() {
        bcap.set_ip(IpAddr::V4(Ipv4Addr::LOCALHOST));
    }
    let address = format!("tcp:{bcap}").parse().map_err(|error| Failure::Input(format!("{bcap}: {error}")))?;
    Ok(Access { address, provider: Some(provider), machine, option, tap: Tap::default() })
}
