//! The server of `bcap-std` on a serial line, in its own thread.

use std::path::Path;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::{self, JoinHandle};

use bcap_core::bcap::server::Handler;
use bcap_std::SerialLine;
use bcap_std::server::Server;
use tokio::sync::oneshot;

/// A server until this is dropped.
#[derive(Debug)]
pub struct LineServer<H> {
    handler: Arc<Mutex<H>>,
    stop: Option<oneshot::Sender<()>>,
    thread: Option<JoinHandle<()>>,
}

impl<H: Handler + Send + 'static> LineServer<H> {
    /// Serves a device.
    ///
    /// # Panics
    ///
    /// When the device cannot be opened.
    #[must_use]
    pub fn start(handler: H, device: &Path) -> Self {
        let handler = Arc::new(Mutex::new(handler));
        let line = SerialLine::new(device.display().to_string());
        let (stop, stopped) = oneshot::channel::<()>();
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().expect("a runtime");
        let server = {
            let _inside = runtime.enter();
            Server::with_shared(Arc::clone(&handler)).bcap_serial(&line, |_, _| {}).expect("the device")
        };
        let thread = thread::spawn(move || {
            let served = runtime.block_on(server.run(async { drop(stopped.await) }));
            served.expect("the server");
        });
        Self { handler, stop: Some(stop), thread: Some(thread) }
    }

    /// Locks the handler.
    pub fn handler(&self) -> MutexGuard<'_, H> {
        self.handler.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl<H> Drop for LineServer<H> {
    fn drop(&mut self) {
        drop(self.stop.take());
        if let Some(thread) = self.thread.take()
            && thread.join().is_err()
            && !thread::panicking()
        {
            panic!("the server has panicked");
        }
    }
}
