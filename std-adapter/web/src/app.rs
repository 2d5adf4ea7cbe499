//! The state that all connections share.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::AtomicU64;

use tokio::sync::Semaphore;

use crate::audit::Audit;
use crate::guard::Guard;
use crate::panel::Panel;
use crate::robot::Robot;

/// The state that all connections share.
#[derive(Debug)]
pub(crate) struct App {
    pub(crate) guard: Guard,
    pub(crate) robots: Vec<Arc<Robot>>,
    pub(crate) allow_write: bool,
    pub(crate) allow_motion: bool,
    /// The panel of the first robot, if that is a virtual controller of this process.
    pub(crate) panel: Option<Panel>,
    /// The labels of the variables, by names in upper case.
    pub(crate) labels: BTreeMap<String, String>,
    /// The folder of the backups.
    pub(crate) backups: Option<PathBuf>,
    pub(crate) audit: Audit,
    /// The number of the next page.
    pub(crate) clients: AtomicU64,
    /// The pages that may still be opened.
    pub(crate) pages: Arc<Semaphore>,
}
