//! SIGINT and SIGTERM, which end commands that run until they are interrupted.

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
    Ok(async move {
        tokio::select! {
            _ = interrupt.recv() => {}
            _ = terminate.recv() => {}
        }
    })
}

/// Returns a future that completes on Ctrl-C.
#[cfg(not(unix))]
pub(crate) fn wait() -> io::Result<impl Future<Output = ()>> {
    Ok(async {
        let _ = tokio::signal::ctrl_c().await;
    })
}
