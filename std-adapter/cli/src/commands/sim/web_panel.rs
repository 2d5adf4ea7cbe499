//! `bcap sim --web`: the page of `bcap web` for the virtual controller or the replay of this process.

use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::sync::{Arc, Mutex, PoisonError};

use bcap_live::link::Access;
use bcap_live::tap::Tap;
use bcap_sim::pace::Paced;
use bcap_web::{Config, Replay};
use tokio::sync::oneshot;
use tokio::task::JoinHandle;

use crate::commands::web;
use crate::failure::Failure;
use crate::output::Printer;

/// A page that is served.
pub(super) struct Page {
    pub(super) url: String,
    stop: oneshot::Sender<()>,
    served: JoinHandle<()>,
    printer: Printer,
}

impl Page {
    /// Ends the page, and prints its last lines.
    pub(super) async fn end(self) {
        drop(self.stop);
        // a panic has been printed
        let _ = self.served.await;
        self.printer.finish();
    }
}

/// Starts the page of a virtual controller at `bcap`, with its panel.
pub(super) async fn start(bcap: SocketAddr, listen: SocketAddr, shared: Arc<Mutex<Paced>>) -> Result<Page, Failure> {
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
) -> Result<Page, Failure> {
    let [provider, machine, option] =
        session.ok_or_else(|| Failure::Input("the capture has no Controller_Connect, which a page needs".into()))?;
    let robots = vec![("replay".to_owned(), access(bcap, provider, Some(machine), option)?)];
    serve(Config { replay: Some(replay), ..Config::new(listen, robots) }).await
}

async fn serve(config: Config) -> Result<Page, Failure> {
    let printer = Printer::start(false)?;
    let server = web::bind(config, "--web", &printer).await?;
    let (url, (stop, stopped)) = (server.url(), oneshot::channel::<()>());
    let served = tokio::spawn(server.run(async { drop(stopped.await) }));
    Ok(Page { url, stop, served, printer })
}

/// Returns the access of a client of this computer.
fn access(mut bcap: SocketAddr, provider: String, machine: Option<String>, option: String) -> Result<Access, Failure> {
    if bcap.ip().is_unspecified() {
        bcap.set_ip(IpAddr::V4(Ipv4Addr::LOCALHOST));
    }
    let address = format!("tcp:{bcap}").parse().map_err(|error| Failure::Input(format!("{bcap}: {error}")))?;
    Ok(Access { address, provider: Some(provider), machine, option, tap: Tap::default() })
}
