//! The state that all connections share.

use std::sync::Arc;
use std::sync::atomic::AtomicU64;

use tokio::sync::Semaphore;

use crate::audit::Audit;
use crate::config::Config;
use crate::guard::Guard;
use crate::robot::Robot;

/// The state that all connections share.
pub(crate) struct App {
    pub(crate) guard: Guard,
    pub(crate) robots: Vec<Arc<Robot>>,
    /// The configuration, without the robots and the password.
    pub(crate) config: Config,
    pub(crate) audit: Audit,
    /// The number of the next page.
    pub(crate) clients: AtomicU64,
    /// The pages that may still be opened.
    pub(crate) pages: Arc<Semaphore>,
}
