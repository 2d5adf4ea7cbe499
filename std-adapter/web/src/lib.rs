#![doc = include_str!("../README.md")]

mod app;
mod arm;
mod assets;
mod audit;
mod call;
mod control;
mod guard;
mod halt;
mod jog;
mod line;
mod panel;
mod raw;
mod recover;
mod robot;
mod save;
mod serve;
mod socket;
mod tape;
mod tasks;
mod text;
mod view;

use std::collections::BTreeMap;
use std::net::SocketAddr;
use std::sync::atomic::AtomicU64;
use std::sync::{Arc, Mutex};

use bcap_live::link::Access;
use bcap_sim::pace::Paced;
use bcap_std::Address;
use tokio::net::TcpListener;
use tokio::sync::Semaphore;

use crate::app::App;
use crate::audit::Audit;
use crate::guard::Guard;
use crate::panel::Panel;
use crate::robot::Robot;

/// The most robots of a page.
const ROBOTS: usize = 32;

/// The most open pages.
const PAGES: usize = 16;

/// The robots of a server, and the rights of its pages.
#[derive(Debug)]
pub struct Config {
    /// The address to listen on, of this computer only.
    pub listen: SocketAddr,
    /// The robots, with the names that the page shows.
    pub robots: Vec<(String, Access)>,
    /// Whether a page may write variables and clear errors.
    pub allow_write: bool,
    /// Whether a page may move a robot by steps while a button is held.
    pub allow_motion: bool,
    /// The labels of variables, by names in upper case; a unit may be at the end: `pressure [bar]`.
    pub labels: BTreeMap<String, String>,
    /// The virtual controller, if the only robot is one of this process: the page has its panel.
    pub panel: Option<Arc<Mutex<Paced>>>,
}

impl Config {
    /// Returns the configuration of a server that only reads.
    #[must_use]
    pub const fn new(listen: SocketAddr, robots: Vec<(String, Access)>) -> Self {
        Self { listen, robots, allow_write: false, allow_motion: false, labels: BTreeMap::new(), panel: None }
    }
}

/// Why a server does not start.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// Other computers could reach the address.
    #[error("{0} can be reached by other computers, which needs TLS and a password; listen on 127.0.0.1")]
    NotLocal(SocketAddr),
    /// HALT needs a second connection.
    #[error("{0}: a serial line carries one session, so HALT would have no connection; use TCP or UDP")]
    Serial(String),
    /// There are no robots, or too many.
    #[error("{0} robots; a page shows 1 to {ROBOTS}")]
    Robots(usize),
    /// The system has no random numbers.
    #[error("cannot draw a token: {0}")]
    Random(getrandom::Error),
    /// The address is in use, or a thread cannot be started.
    #[error(transparent)]
    Io(#[from] std::io::Error),
}

/// A server of the page.
#[derive(Debug)]
pub struct Server {
    listener: TcpListener,
    address: SocketAddr,
    app: Arc<App>,
}

impl Server {
    /// Listens, and begins to read the robots. `audit` gets a line for each action of a user.
    ///
    /// # Errors
    ///
    /// An [`Error`]; nothing runs then.
    pub async fn bind(config: Config, audit: impl Fn(&str) + Send + Sync + 'static) -> Result<Self, Error> {
        let Config { listen, robots, allow_write, allow_motion, labels, panel } = config;
        if !listen.ip().is_loopback() {
            return Err(Error::NotLocal(listen));
        }
        if !(1..=ROBOTS).contains(&robots.len()) {
            return Err(Error::Robots(robots.len()));
        }
        if let Some((name, _)) = robots.iter().find(|(_, access)| matches!(access.address, Address::Serial(_))) {
            return Err(Error::Serial(name.clone()));
        }
        let listener = TcpListener::bind(listen).await?;
        let address = listener.local_addr()?;
        let app = App {
            guard: Guard::new(address).map_err(Error::Random)?,
            robots: robots.into_iter().map(|(name, access)| Robot::start(name, access)).collect::<Result<_, _>>()?,
            allow_write,
            allow_motion,
            labels,
            panel: panel.map(Panel::new),
            audit: Audit::new(audit),
            clients: AtomicU64::new(1),
            pages: Arc::new(Semaphore::new(PAGES)),
        };
        Ok(Self { listener, address, app: Arc::new(app) })
    }

    /// Returns the address of the page, with the token. Anyone who has it may use the page.
    #[must_use]
    pub fn url(&self) -> String {
        // after `#`, the token is in no request, and so in no log
        format!("http://{}/#token={}", self.address, self.app.guard.token())
    }

    /// Serves until `shutdown` completes.
    pub async fn run(self, shutdown: impl Future<Output = ()>) {
        tokio::select! {
            () = serve::accept(&self.listener, &self.app) => {}
            () = shutdown => {}
        }
    }
}
