#![doc = include_str!("../README.md")]

mod app;
mod arm;
mod assets;
mod audit;
mod backup;
mod call;
mod channel;
mod config;
mod control;
mod guard;
mod halt;
mod job;
mod jog;
mod login;
mod motions;
mod names;
mod order;
mod panel;
mod raw;
mod record;
mod recover;
mod robot;
mod save;
mod secret;
mod serve;
mod socket;
mod tasks;
mod text;
mod threads;
mod tls;
mod view;

use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::AtomicU64;

use bcap_std::Address;
use tokio::net::TcpListener;
use tokio::sync::{Semaphore, watch};
use tokio_util::task::TaskTracker;

use crate::app::{App, PAGES};
use crate::audit::Audit;
pub use crate::config::{Config, Recordings, Remote, Replay};
use crate::guard::Guard;
use crate::login::SHORTEST;
use crate::robot::Robot;
use crate::tls::Acceptor;

/// The maximum number of robots of a page.
const ROBOTS: usize = 32;

/// Reads the certificate, and checks the rest.
fn acceptor(remote: &Remote, listen: SocketAddr) -> Result<Acceptor, Error> {
    let length = remote.password.chars().count();
    if length < SHORTEST {
        return Err(Error::Password(length));
    }
    if listen.ip().is_unspecified() && remote.names.is_empty() {
        return Err(Error::NoName(listen));
    }
    tls::acceptor(&remote.certificate, &remote.key).map_err(Error::Tls)
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
pub struct Server {
    listener: TcpListener,
    tls: Option<Acceptor>,
    app: Arc<App>,
}

impl std::fmt::Debug for Server {
    // without the token, the password and the sessions
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Server").field("listener", &self.listener).finish_non_exhaustive()
    }
}

impl Server {
    /// Listens, and begins to read the robots. `audit` gets a line for each action of a user. It must not
    /// wait, for example for a terminal: HALT would wait too.
    ///
    /// # Errors
    ///
    /// An [`Error`]; no server is started then.
    pub async fn bind(mut config: Config, audit: impl Fn(&str) + Send + Sync + 'static) -> Result<Self, Error> {
        let (listen, robots, remote) = (config.listen, std::mem::take(&mut config.robots), config.remote.take());
        if remote.is_none() && !listen.ip().is_loopback() {
            return Err(Error::NotLocal(listen));
        }
        let tls = remote.as_ref().map(|remote| acceptor(remote, listen)).transpose()?;
        if !(1..=ROBOTS).contains(&robots.len()) {
            return Err(Error::Robots(robots.len()));
        }
        if let Some((name, _)) = robots.iter().find(|(_, access)| matches!(access.address, Address::Serial(_))) {
            return Err(Error::Serial(name.clone()));
        }
        let listener = TcpListener::bind(listen).await?;
        let app = App {
            guard: Guard::new(listener.local_addr()?, remote).map_err(Error::Random)?,
            robots: robots.into_iter().map(|(name, access)| Robot::start(name, access)).collect::<Result<_, _>>()?,
            config,
            audit: Audit::new(audit),
            clients: AtomicU64::new(1),
            pages: Arc::new(Semaphore::new(PAGES)),
            ends: watch::Sender::new(false),
            work: TaskTracker::new(),
        };
        Ok(Self { listener, tls, app: Arc::new(app) })
    }

    /// Returns the address of the page. Without a password it contains the token of the server: anyone who has the address may
    /// use the page.
    #[must_use]
    pub fn url(&self) -> String {
        self.app.guard.url()
    }

    /// Serves until `shutdown` completes. Then it halts what a page moves, and gives the arms back; it waits for that for 10 s.
    pub async fn run(self, shutdown: impl Future<Output = ()>) {
        let ended = async {
            shutdown.await;
            self.app.end().await;
        };
        tokio::select! {
            // HALT works until the end
            () = serve::accept(&self.listener, &self.app, self.tls.as_ref()) => {}
            () = ended => {}
        }
        record::finish(self.app);
    }
}
