//! The server of `bcap-std` on a serial line, in its own thread.

use std::path::Path;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use bcap_core::bcap::server::Handler;
use bcap_std::SerialLine;
use bcap_std::server::Server;

use crate::background::Background;

/// A server until this is dropped.
#[derive(Debug)]
pub struct LineServer<H> {
    handler: Arc<Mutex<H>>,
    _background: Background,
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
        let shared = Arc::clone(&handler);
        let (background, ()) = Background::start(async move |stopped| {
            let server = Server::with_shared(shared).bcap_serial(&line, |_, _| {}).expect("the device");
            ((), async { server.run(async { drop(stopped.await) }).await.expect("the server") })
        });
        Self { handler, _background: background }
    }

    /// Locks the handler.
    pub fn handler(&self) -> MutexGuard<'_, H> {
        self.handler.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
