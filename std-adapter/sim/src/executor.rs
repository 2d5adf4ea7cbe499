//! The executor of jobs that may block.

use std::fmt;
use std::sync::Arc;

/// A file job.
pub type Job = Box<dyn FnOnce() + Send>;

/// Runs file jobs, within the call or on another thread.
///
/// # Examples
///
/// ```
/// use std::sync::mpsc;
/// use std::thread;
/// use bcap_sim::Config;
/// use bcap_sim::files::{Executor, Job};
///
/// let (jobs, queue) = mpsc::sync_channel::<Job>(64);
/// thread::spawn(move || queue.into_iter().for_each(|job| job()));
/// // a full queue drops the job
/// let file_executor = Executor::new(move |job| drop(jobs.try_send(job)));
/// let config = Config { files: Some("/srv/robot".into()), file_executor, ..Config::default() };
/// ```
#[derive(Clone)]
pub struct Executor(Arc<dyn Fn(Job) + Send + Sync>);

impl Executor {
    /// Creates an executor of a function that runs a job, queues it, or drops it when its queue is full.
    #[must_use]
    pub fn new(run: impl Fn(Job) + Send + Sync + 'static) -> Self {
        Self(Arc::new(run))
    }

    pub(crate) fn run(&self, job: Job) {
        (self.0)(job);
    }
}

impl Default for Executor {
    /// Runs each job immediately, within the call.
    fn default() -> Self {
        Self::new(|job| job())
    }
}

impl fmt::Debug for Executor {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Executor")
    }
}
