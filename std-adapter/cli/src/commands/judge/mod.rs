//! Judges of devices: `bcap conform` and `bcap fuzz`.

pub(crate) mod conform;
pub(crate) mod fuzz;

use std::time::Duration;

use bcap_capture::duration;
use clap::Args;

/// How a device that has stopped comes back.
#[derive(Debug, Args)]
pub(crate) struct Recovery {
    /// Waits this time for a device that has stopped
    #[arg(long, value_name = "TIME", value_parser = duration::parse, default_value = "30s")]
    pub(crate) wait: Duration,

    /// Runs this command in a shell when the device has stopped, and then waits for the device
    ///
    /// The command may end at once, or be the device itself; in the latter case it ends with the run. Its output goes to the
    /// standard error.
    #[arg(long, value_name = "COMMAND")]
    pub(crate) restart: Option<String>,

    /// Runs --restart at most this number of times
    #[arg(long, value_name = "N", default_value_t = 100, requires = "restart")]
    pub(crate) restarts: u32,
}
