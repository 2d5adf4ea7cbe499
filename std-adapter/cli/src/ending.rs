//! Ctrl-C for commands that can end between two calls: the first signal ends them there, the second at once.

use std::io::{self, Write};
use std::process;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;

use crate::signal;

/// Whether a signal has arrived.
#[derive(Clone, Debug, Default)]
pub(crate) struct Ending(Arc<AtomicBool>);

impl Ending {
    /// Installs the handlers of SIGINT and SIGTERM.
    pub(crate) fn install() -> io::Result<Self> {
        let signals = signal::each()?;
        let ending = Self::default();
        let own = ending.clone();
        thread::Builder::new().name("interrupt".into()).spawn(move || {
            if signals.recv().is_err() {
                return;
            }
            own.0.store(true, Ordering::Release);
            // an error of printing cannot be reported
            let _ = writeln!(io::stderr(), "ends after this call; press Ctrl-C again to end at once");
            if signals.recv().is_ok() {
                process::exit(130);
            }
        })?;
        Ok(ending)
    }

    pub(crate) fn has_come(&self) -> bool {
        self.0.load(Ordering::Acquire)
    }
}
