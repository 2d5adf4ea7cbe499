//! SIGINT, SIGTERM and SIGHUP, which end commands that run until they are interrupted.

use std::io;
use std::sync::mpsc::{Receiver, channel};
use std::thread;

/// Returns a receiver that gets a message on the first signal.
pub(crate) fn ended() -> io::Result<Receiver<()>> {
    let (sender, receiver) = channel();
    let runtime = tokio::runtime::Builder::new_current_thread().enable_io().build()?;
    // the handlers are in place before this returns
    let waiting = {
        let _inside = runtime.enter();
        wait()?
    };
    thread::Builder::new().name("signals".into()).spawn(move || {
        runtime.block_on(waiting);
        // without a receiver the command is ending already
        let _ = sender.send(());
    })?;
    Ok(receiver)
}

/// Returns a receiver that gets a message on each signal.
pub(crate) fn each() -> io::Result<Receiver<()>> {
    let (sender, receiver) = channel();
    let runtime = tokio::runtime::Builder::new_current_thread().enable_io().build()?;
    let waiting = {
        let _inside = runtime.enter();
        wait()?
    };
    thread::Builder::new().name("signals".into()).spawn(move || {
        runtime.block_on(async {
            let mut waiting = Some(waiting);
            // listen for the next signal before reporting this one, so that no signal is lost in between
            while let Some(current) = waiting.take() {
                current.await;
                waiting = wait().map(Some).unwrap_or_default();
                if sender.send(()).is_err() {
                    return;
                }
            }
        });
    })?;
    Ok(receiver)
}

/// Installs the signal handlers, and returns a future that completes on the first signal.
#[cfg(unix)]
pub(crate) fn wait() -> io::Result<impl Future<Output = ()>> {
    use tokio::signal::unix::{SignalKind, signal};
    let mut interrupt = signal(SignalKind::interrupt())?;
    let mut terminate = signal(SignalKind::terminate())?;
    // a handler would end what `nohup` lets run
    let mut hangup = (!ignores_hangup()).then(|| signal(SignalKind::hangup())).transpose()?;
    Ok(async move {
        let hung_up = async {
            match &mut hangup {
                Some(hangup) => drop(hangup.recv().await),
                None => std::future::pending().await,
            }
        };
        tokio::select! {
            _ = interrupt.recv() => {}
            _ = terminate.recv() => {}
            () = hung_up => {}
        }
    })
}

/// Returns whether this process ignores SIGHUP, as `nohup` arranges. Only Linux tells.
#[cfg(unix)]
fn ignores_hangup() -> bool {
    std::fs::read_to_string("/proc/self/status").is_ok_and(|status| has_ignored_hangup(&status))
}

/// Reads from the text of `/proc/PID/status` whether SIGHUP is ignored: it is bit 0 of the hexadecimal set `SigIgn`.
#[cfg(unix)]
fn has_ignored_hangup(status: &str) -> bool {
    let set = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    set.and_then(|set| u64::from_str_radix(set.trim(), 16).ok()).is_some_and(|set| set & 1 == 1)
}

/// Returns a future that completes on Ctrl-C.
#[cfg(not(unix))]
pub(crate) fn wait() -> io::Result<impl Future<Output = ()>> {
    Ok(async {
        let _ = tokio::signal::ctrl_c().await;
    })
}

#[cfg(all(test, unix))]
mod tests {
    use super::*;

    #[test]
    fn an_ignored_hangup_is_bit_0_of_its_set() {
        assert!(has_ignored_hangup("Name:\tbcap\nSigIgn:\t0000000000001001\nSigCgt:\t0000000000000000\n"));
        assert!(!has_ignored_hangup("SigIgn:\t0000000000001000\nSigCgt:\t0000000000000001\n"));
        assert!(!has_ignored_hangup(""));
    }
}
