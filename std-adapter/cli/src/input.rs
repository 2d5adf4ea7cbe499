//! The lines of an input, read on a thread, so that a signal is handled while a command waits for a line.

use std::io::{self, BufRead};
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel, sync_channel};
use std::thread;
use std::time::Duration;

use crate::failure::Failure;
use crate::interrupt::Interrupt;

/// Interval at which a command that waits for its next line checks for a signal.
const LOOK: Duration = Duration::from_millis(20);

/// Lines that may not have arrived yet.
pub(crate) struct Lines(Receiver<Result<String, String>>);

impl Lines {
    /// Reads lines from an input.
    pub(crate) fn read(input: impl BufRead + Send + 'static) -> io::Result<Self> {
        let (sender, receiver) = sync_channel(0);
        let read = move || {
            // without a receiver the command is ending
            let _ = input.lines().try_for_each(|line| sender.send(line.map_err(|error| error.to_string())));
        };
        thread::Builder::new().name("lines".into()).spawn(read)?;
        Ok(Self(receiver))
    }

    /// Returns lines that have been read before.
    pub(crate) fn of(lines: Vec<String>) -> Self {
        let (sender, receiver) = channel();
        // the receiver exists
        lines.into_iter().for_each(|line| drop(sender.send(Ok(line))));
        Self(receiver)
    }

    /// Waits for the next line; `None` at the end. A signal ends that with [`Failure::Interrupted`].
    pub(crate) fn next(&self, interrupt: &Interrupt) -> Result<Option<String>, Failure> {
        loop {
            match self.0.recv_timeout(LOOK) {
                _ if interrupt.is_interrupted() => return Err(Failure::Interrupted("interrupted".into())),
                Ok(line) => return line.map(Some).map_err(Failure::Input),
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => return Ok(None),
            }
        }
    }
}
