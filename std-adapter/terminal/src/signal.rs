//! The signals that end or suspend a program.

use std::io;
use std::sync::mpsc::{Receiver, channel};
use std::thread;

/// A signal. A later one outranks an earlier one.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Signal {
    /// SIGINT: Ctrl-C.
    Interrupt,
    /// SIGTSTP: Ctrl-Z.
    Suspend,
    /// SIGTERM, SIGHUP, or SIGQUIT (Ctrl-\).
    End,
}

/// Handles signals from now on, and returns a receiver of them.
///
/// # Errors
///
/// When a handler cannot be installed, or no thread can be started.
pub fn receiver() -> io::Result<Receiver<Signal>> {
    let (sender, receiver) = channel();
    let runtime = tokio::runtime::Builder::new_current_thread().enable_io().build()?;
    // the handlers are in place before this returns
    let mut sources = {
        let _inside = runtime.enter();
        Sources::new()?
    };
    thread::Builder::new().name("signals".into()).spawn(move || {
        runtime.block_on(async { while sender.send(sources.next().await).is_ok() {} });
    })?;
    Ok(receiver)
}

/// Suspends this process, as Ctrl-Z does to a process without a handler; returns when it continues.
pub fn suspend() {
    #[cfg(unix)]
    {
        use rustix::process::{Signal, getpid, kill_process};
        // a process may always signal itself
        let _ = kill_process(getpid(), Signal::STOP);
    }
}

#[cfg(unix)]
struct Sources {
    interrupt: tokio::signal::unix::Signal,
    terminate: tokio::signal::unix::Signal,
    /// `None` if the process ignores it, as `nohup` arranges: a handler would end what `nohup` lets run.
    hangup: Option<tokio::signal::unix::Signal>,
    /// `None` if the process ignores it, as a shell arranges for a process in the background.
    quit: Option<tokio::signal::unix::Signal>,
    /// `None` if the process ignores it, as a shell without job control arranges.
    suspend: Option<tokio::signal::unix::Signal>,
}

#[cfg(unix)]
impl Sources {
    fn new() -> io::Result<Self> {
        use rustix::process::Signal;
        use tokio::signal::unix::{SignalKind, signal};
        let unless_ignored = |raw: i32| {
            let handled = (!is_ignored(raw)).then(|| signal(SignalKind::from_raw(raw)));
            handled.transpose()
        };
        Ok(Self {
            interrupt: signal(SignalKind::interrupt())?,
            terminate: signal(SignalKind::terminate())?,
            hangup: unless_ignored(Signal::HUP.as_raw())?,
            quit: unless_ignored(Signal::QUIT.as_raw())?,
            suspend: unless_ignored(Signal::TSTP.as_raw())?,
        })
    }

    async fn next(&mut self) -> Signal {
        tokio::select! {
            _ = self.interrupt.recv() => Signal::Interrupt,
            _ = self.terminate.recv() => Signal::End,
            () = received(&mut self.hangup) => Signal::End,
            () = received(&mut self.quit) => Signal::End,
            () = received(&mut self.suspend) => Signal::Suspend,
        }
    }
}

/// Waits for a signal; for ever if it is ignored.
#[cfg(unix)]
async fn received(source: &mut Option<tokio::signal::unix::Signal>) {
    match source {
        Some(source) => drop(source.recv().await),
        None => std::future::pending().await,
    }
}

#[cfg(not(unix))]
struct Sources;

#[cfg(not(unix))]
impl Sources {
    fn new() -> io::Result<Self> {
        Ok(Self)
    }

    async fn next(&mut self) -> Signal {
        // without a handler there is no signal
        if tokio::signal::ctrl_c().await.is_err() {
            std::future::pending::<()>().await;
        }
        Signal::Interrupt
    }
}

/// Installs the signal handlers, and returns a future that completes on the first signal. Needs a runtime of tokio.
///
/// # Errors
///
/// When a handler cannot be installed.
#[cfg(unix)]
pub fn wait() -> io::Result<impl Future<Output = ()>> {
    use tokio::signal::unix::{SignalKind, signal};
    let mut interrupt = signal(SignalKind::interrupt())?;
    let mut terminate = signal(SignalKind::terminate())?;
    let hangup = SignalKind::hangup();
    let mut hangup = (!is_ignored(hangup.as_raw_value())).then(|| signal(hangup)).transpose()?;
    Ok(async move {
        tokio::select! {
            _ = interrupt.recv() => {}
            _ = terminate.recv() => {}
            () = received(&mut hangup) => {}
        }
    })
}

/// Returns whether this process ignores a signal. Only Linux tells.
#[cfg(unix)]
fn is_ignored(signal: i32) -> bool {
    std::fs::read_to_string("/proc/self/status").is_ok_and(|status| has_ignored(&status, signal))
}

/// Reads from the text of `/proc/PID/status` whether a signal is ignored: signal 1 is bit 0 of the hexadecimal set `SigIgn`.
#[cfg(unix)]
fn has_ignored(status: &str, signal: i32) -> bool {
    let set = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    let bit = u32::try_from(signal - 1).ok().and_then(|shift| 1_u64.checked_shl(shift));
    let set = set.and_then(|set| u64::from_str_radix(set.trim(), 16).ok());
    set.zip(bit).is_some_and(|(set, bit)| set & bit != 0)
}

/// Returns a future that completes on Ctrl-C.
///
/// # Errors
///
/// None on this platform.
#[cfg(not(unix))]
pub fn wait() -> io::Result<impl Future<Output = ()>> {
    Ok(async {
        let _ = tokio::signal::ctrl_c().await;
    })
}

#[cfg(all(test, unix))]
mod tests {
    use super::*;

    #[test]
    fn an_ignored_signal_is_a_bit_of_its_set() {
        let status = "Name:\tbcap\nSigIgn:\t0000000000081001\nSigCgt:\t0000000000000000\n";
        assert!(has_ignored(status, 1) && has_ignored(status, 20) && !has_ignored(status, 2));
        assert!(!has_ignored("SigIgn:\t0000000000001000\nSigCgt:\t0000000000000001\n", 1));
        assert!(!has_ignored("", 1));
    }
}
