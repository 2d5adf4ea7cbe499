#![doc = include_str!("../README.md")]

mod app;
mod arm;
mod assets;
mod audit;
mod backup;
mod call;
mod control;
mod guard;
mod halt;
mod job;
mod jog;
mod line;
mod login;
mod panel;
mod raw;
mod recover;
mod restore;
mod robot;
mod save;
mod secret;
mod serve;
mod socket;
mod tasks;
mod text;
mod tls;
mod view;

use std::collections::BTreeMap;
use std::net::SocketAddr;
use std::path::PathBuf;
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
use crate::login::SHORTEST;
use crate::panel::Panel;
use crate::robot::Robot;
use crate::tls::Acceptor;

/// The most robots of a page.
const ROBOTS: usize = 32;

/// The most open pages.
const PAGES: usize = 16;

/// The robots of a server, and the rights of its pages.
#[derive(Debug)]
pub struct Config {
    /// The address to listen on; of this computer only, without `remote`.
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
    /// The folder of the backups. Without it the page makes no backups.
    pub backups: Option<PathBuf>,
    /// TLS and a password, without which no other computer can reach the server.
    pub remote: Option<Remote>,
}

/// TLS and a password, for a server that other computers can reach.
pub struct Remote {
    /// The certificate and its chain, in PEM.
    pub certificate: PathBuf,
    /// The private key of the certificate, in PEM.
    pub key: PathBuf,
    /// The password, of at least 12 characters.
    pub password: String,
    /// The names with which browsers reach this server, as the certificate has them.
    pub names: Vec<String>,
}

impl std::fmt::Debug for Remote {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Remote").field("names", &self.names).finish_non_exhaustive()
    }
}

impl Config {
    /// Returns the configuration of a server that only reads.
    #[must_use]
    pub const fn new(listen: SocketAddr, robots: Vec<(String, Access)>) -> Self {
        let labels = BTreeMap::new();
        Self {
            listen,
            robots,
            allow_write: false,
            allow_motion: false,
            labels,
            panel: None,
            backups: None,
            remote: None,
        }
    }
}

impl Remote {
    /// Reads the certificate, and checks the rest.
    fn acceptor(&self, listen: SocketAddr) -> Result<Acceptor, Error> {
        let length = self.password.chars().count();
        if length < SHORTEST {
            return Err(Error::Password(length));
        }
        if listen.ip().is_unspecified() && self.names.is_empty() {
            return Err(Error::NoName(listen));
        }
        Acceptor::new(&self.certificate, &self.key).map_err(Error::Tls)
    }
}

/// Why a server does not start.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// Other computers could reach the address.
    #[error(
        "{0} can be reached by other computers, which needs TLS and a password: give --certificate, --key and \
         --password-file, or listen on 127.0.0.1"
    )]
    NotLocal(SocketAddr),
    /// The password is too short.
    #[error("the password has {0} characters; it needs at least {SHORTEST}")]
    Password(usize),
    /// A server on all addresses has no name.
    #[error(
        "{0} is every address of this computer: give --name with the name in the certificate, or listen on one address"
    )]
    NoName(SocketAddr),
    /// The certificate or the key cannot be used, or there is no TLS in this program.
    #[error("TLS: {0}")]
    Tls(String),
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
    tls: Option<Acceptor>,
    app: Arc<App>,
}

impl Server {
    /// Listens, and begins to read the robots. `audit` gets a line for each action of a user.
    ///
    /// # Errors
    ///
    /// An [`Error`]; nothing runs then.
    pub async fn bind(config: Config, audit: impl Fn(&str) + Send + Sync + 'static) -> Result<Self, Error> {
        let Config { listen, robots, allow_write, allow_motion, labels, panel, backups, remote } = config;
        let tls = match &remote {
            None if !listen.ip().is_loopback() => return Err(Error::NotLocal(listen)),
            None => None,
            Some(remote) => Some(remote.acceptor(listen)?),
        };
        if !(1..=ROBOTS).contains(&robots.len()) {
            return Err(Error::Robots(robots.len()));
        }
        if let Some((name, _)) = robots.iter().find(|(_, access)| matches!(access.address, Address::Serial(_))) {
            return Err(Error::Serial(name.clone()));
        }
        let listener = TcpListener::bind(listen).await?;
        let address = listener.local_addr()?;
        let app = App {
            guard: match remote {
                Some(Remote { names, password, .. }) => Guard::remote(address, &names, password),
                None => Guard::new(address),
            }
            .map_err(Error::Random)?,
            robots: robots.into_iter().map(|(name, access)| Robot::start(name, access)).collect::<Result<_, _>>()?,
            allow_write,
            allow_motion,
            labels,
            panel: panel.map(Panel::new),
            backups,
            audit: Audit::new(audit),
            clients: AtomicU64::new(1),
            pages: Arc::new(Semaphore::new(PAGES)),
        };
        Ok(Self { listener, tls, app: Arc::new(app) })
    }

    /// Returns the address of the page. It has the token of a server without a password; anyone who has it may use the page.
    #[must_use]
    pub fn url(&self) -> String {
        self.app.guard.url()
    }

    /// Serves until `shutdown` completes.
    pub async fn run(self, shutdown: impl Future<Output = ()>) {
        tokio::select! {
            () = serve::accept(&self.listener, &self.app, self.tls.as_ref()) => {}
            () = shutdown => {}
        }
    }
}
