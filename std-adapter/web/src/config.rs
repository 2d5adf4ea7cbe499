//! The configuration of a server.

use std::collections::BTreeMap;
use std::net::SocketAddr;
use std::path::PathBuf;
use std::sync::{Arc, Mutex};

use bcap_live::link::Access;
use bcap_sim::pace::Paced;
use serde_json::{Value, json};

use crate::text::safe;
use crate::threads::lock;

/// The robots of a server, and the rights of its pages.
#[derive(Debug)]
pub struct Config {
    /// The address to listen on; of this computer only, without `remote`.
    pub listen: SocketAddr,
    /// The robots, with the names that the page shows.
    pub robots: Vec<(String, Access)>,
    /// Whether a page may write variables, restore backups, clear errors, and make calls that write.
    pub allow_write: bool,
    /// Whether a page may move a robot: jog it, start tasks, recover it, and make any call that can move it.
    pub allow_motion: bool,
    /// The labels of variables, by names in upper case; a unit may be at the end: `pressure [bar]`.
    pub labels: BTreeMap<String, String>,
    /// The virtual controller, if the only robot is one of this process: the page has its panel.
    pub panel: Option<Arc<Mutex<Paced>>>,
    /// The folder of the backups. Without it the page makes no backups.
    pub backups: Option<PathBuf>,
    /// The recordings; `None` disables them.
    pub recordings: Option<Recordings>,
    /// The replay, if the only robot is one: the page says so, and shows which requests are missing in the capture.
    pub replay: Option<Replay>,
    /// TLS and a password, without which no other computer can reach the server.
    pub remote: Option<Remote>,
}

/// The recordings of a server.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Recordings {
    /// Their folder.
    pub folder: PathBuf,
    /// The size at which a file ends, in bytes.
    pub limit: u64,
}

/// The requests that are missing in the capture of a replay: their number, and the last request. Clones share them.
#[derive(Clone, Debug, Default)]
pub struct Replay(Arc<Mutex<(u64, String)>>);

impl Replay {
    /// Records a request that the capture lacks.
    pub fn lacks(&self, request: &str) {
        let (count, last) = &mut *lock(&self.0);
        *count += 1;
        request.clone_into(last);
    }

    /// Returns them for a page.
    pub(crate) fn section(&self) -> Value {
        let (count, last) = &*lock(&self.0);
        json!([count, safe(last)])
    }
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
        Self {
            listen,
            robots,
            allow_write: false,
            allow_motion: false,
            labels: BTreeMap::new(),
            panel: None,
            backups: None,
            recordings: None,
            replay: None,
            remote: None,
        }
    }
}
