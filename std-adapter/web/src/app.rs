//! The state that all connections share.

use std::sync::Arc;
use std::sync::atomic::AtomicU64;
use std::time::Duration;

use tokio::sync::{Semaphore, watch};
use tokio::time::timeout;
use tokio_util::task::TaskTracker;

use crate::audit::Audit;
use crate::config::Config;
use crate::guard::Guard;
use crate::robot::Robot;
use crate::threads::{lock, spawn};

/// The maximum number of pages.
pub(crate) const PAGES: usize = 16;

/// Maximum time that the end of the server waits for halts, for the arms to be given back, and for running orders.
const END: Duration = Duration::from_secs(10);

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
    /// Becomes true at the end of the server, which closes the pages.
    pub(crate) ends: watch::Sender<bool>,
    /// The work that the end of the server waits for: pages, their orders and motions.
    pub(crate) work: TaskTracker,
}

impl App {
    /// Starts a thread for an order of a user, which the end of the server waits for. The error is for the user.
    pub(crate) fn spawn(&self, name: &str, work: impl FnOnce() + Send + 'static) -> Result<(), String> {
        let token = self.work.token();
        spawn(name, move || {
            work();
            drop(token);
        })
    }

    /// Closes the pages, which ends what they move, and the work on backups; waits until the robots are halted and given back.
    pub(crate) async fn end(&self) {
        self.ends.send_replace(true);
        for robot in &self.robots {
            if let Some(job) = &*lock(&robot.backup) {
                job.end("the server ends");
            }
        }
        self.work.close();
        let _ = timeout(END, self.work.wait()).await;
    }
}
