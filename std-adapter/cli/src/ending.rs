//! Ctrl-C for commands that can end between two calls: the first signal ends them there, the second at once. After the end of
//! such a command, as in a shell, its signals are no concern of this module.

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
        // the thread outlives the command
        let flag = Arc::downgrade(&ending.0);
        thread::Builder::new().name("interrupt".into()).spawn(move || {
            if signals.recv().is_err() {
                return;
            }
            let Some(flag) = flag.upgrade() else { return };
            flag.store(true, Ordering::Release);
            let flag = Arc::downgrade(&flag);
            // an error of printing cannot be reported
            let _ = writeln!(io::stderr(), "ends after this call; press Ctrl-C again to end at once");
            if signals.recv().is_ok() && flag.strong_count() > 0 {
                process::exit(130);
            }
        })?;
        Ok(ending)
    }

    pub(crate) fn has_come(&self) -> bool {
        self.0.load(Ordering::Acquire)
    }
}
