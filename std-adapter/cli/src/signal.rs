//! SIGINT and SIGTERM: the end of what would otherwise run for ever.

use std::io;
use std::sync::mpsc::{Receiver, channel};
use std::thread;

/// Returns a receiver that gets a message when the user, or a service manager, wants the command to end.
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
        // when nobody listens any more, the command is ending anyway
        let _ = sender.send(());
    })?;
    Ok(receiver)
}

/// Returns a receiver that gets a message each time.
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
            // the next wait begins before the news of the last one is out, so that no signal falls in between
            while let Some(now) = waiting.take() {
                now.await;
                waiting = wait().map(Some).unwrap_or_default();
                if sender.send(()).is_err() {
                    return;
                }
            }
        });
    })?;
    Ok(receiver)
}

/// Begins to listen for the signals, and returns a future that ends with the first of them.
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

/// Begins to listen for Ctrl-C, and returns a future that ends with it.
#[cfg(not(unix))]
pub(crate) fn wait() -> io::Result<impl Future<Output = ()>> {
    Ok(async {
        let _ = tokio::signal::ctrl_c().await;
    })
}
