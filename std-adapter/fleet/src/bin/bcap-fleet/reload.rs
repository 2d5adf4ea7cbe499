//! SIGHUP reads the configuration again. If it is invalid, nothing changes and the running fleet continues.

use std::io::{self, IsTerminal as _};
use std::path::{Path, PathBuf};
use std::pin::Pin;

use bcap_fleet::{Config, Error, check_offline};
use bcap_service::events::Log;
use bcap_terminal::signal::{self, HangUp};
use serde::Serialize;

/// How a reload ended, as an event.
#[derive(Debug, Serialize)]
#[serde(tag = "event", rename_all = "snake_case")]
pub(crate) enum Outcome {
    Reloaded { controllers: usize },
    ReloadFailed { reason: String },
}

/// The signals of a fleet.
pub(crate) struct Reload {
    path: PathBuf,
    ended: Pin<Box<dyn Future<Output = ()>>>,
    hang_up: HangUp,
}

impl Reload {
    /// Installs the handlers. With a terminal as the standard output SIGHUP ends the program, because then the terminal is
    /// gone.
    pub(crate) fn new(path: &Path) -> io::Result<Self> {
        let (ended, hang_up): (Pin<Box<dyn Future<Output = ()>>>, _) = if io::stdout().is_terminal() {
            (Box::pin(signal::wait()?), HangUp::default())
        } else {
            let (ended, hang_up) = signal::wait_without_hang_up()?;
            (Box::pin(ended), hang_up)
        };
        Ok(Self { path: path.to_owned(), ended, hang_up })
    }

    /// Waits for the end, or for a new configuration without a fault. Don't call it again after the end.
    pub(crate) async fn wait(&mut self, log: &Log) -> Option<Config> {
        loop {
            tokio::select! {
                () = &mut self.ended => return None,
                () = self.hang_up.next() => {}
            }
            match read(&self.path) {
                Ok(config) => return Some(config),
                Err(error) => log.write(&Outcome::ReloadFailed { reason: error.to_string() }),
            }
        }
    }
}

/// Reads a configuration with its secrets and certificates.
fn read(path: &Path) -> Result<Config, Error> {
    let config = Config::read(path)?;
    check_offline(&config)?;
    Ok(config)
}
