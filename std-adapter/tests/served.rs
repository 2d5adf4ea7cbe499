//! A server in its own thread, and the bytes of single calls.

use std::io;
use std::net::SocketAddr;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, mpsc};
use std::thread::{self, JoinHandle, ThreadId};
use std::time::{Duration, Instant};

use bcap_core::bcap::FrameWriter;
use bcap_core::bcap::call::Call;
use bcap_core::bcap::server::Handler;
use bcap_std::server::{Addresses, Server};
use tokio::sync::oneshot;

/// A server; dropping this stops it.
pub(crate) struct Served<H> {
    addresses: Addresses,
    handler: Arc<Mutex<H>>,
    stop: Option<oneshot::Sender<()>>,
    thread: Option<JoinHandle<io::Result<()>>>,
}

impl<H: Handler + Send + 'static> Served<H> {
    /// Starts a server; `open` opens its ports.
    pub(crate) fn start(
        handler: H,
        open: impl AsyncFnOnce(Server<H>) -> io::Result<Server<H>> + Send + 'static,
    ) -> Self {
        let handler = Arc::new(Mutex::new(handler));
        let shared = Arc::clone(&handler);
        let (stop, stopped) = oneshot::channel();
        let (sender, addresses) = mpsc::channel();
        let thread = thread::spawn(move || {
            let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
            runtime.block_on(async {
                let server = open(Server::with_shared(shared)).await?;
                sender.send(server.addresses()).unwrap();
                server.run(async { drop(stopped.await) }).await
            })
        });
        Self { addresses: addresses.recv().unwrap(), handler, stop: Some(stop), thread: Some(thread) }
    }
}

impl<H> Served<H> {
    pub(crate) fn tcp(&self) -> SocketAddr {
        self.addresses.bcap_tcp[0]
    }

    pub(crate) fn udp(&self) -> SocketAddr {
        self.addresses.bcap_udp[0]
    }

    pub(crate) fn rac(&self) -> SocketAddr {
        self.addresses.rac_tcp[0]
    }

    /// Returns the server's thread, until it is stopped.
    pub(crate) fn thread(&self) -> ThreadId {
        self.thread.as_ref().unwrap().thread().id()
    }

    /// Locks the handler; a handler that panicked has poisoned its mutex.
    pub(crate) fn handler(&self) -> MutexGuard<'_, H> {
        self.handler.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Waits until `condition` holds for the handler.
    #[track_caller]
    pub(crate) fn until(&self, condition: impl Fn(&H) -> bool) {
        until(|| condition(&self.handler()));
    }

    /// Stops the server, which must still run and end without an error.
    pub(crate) fn stop(&mut self) {
        let Some(thread) = self.thread.take() else { return };
        let is_running = self.stop.take().is_some_and(|stop| stop.send(()).is_ok());
        thread.join().expect("the server's thread has not panicked").expect("the server ends without an error");
        assert!(is_running, "the server ran until it was stopped");
    }
}

impl<H> Drop for Served<H> {
    fn drop(&mut self) {
        if !thread::panicking() {
            self.stop();
        }
    }
}

/// Waits until `condition` holds, at most a minute.
#[track_caller]
pub(crate) fn until(mut condition: impl FnMut() -> bool) {
    let end = Instant::now() + Duration::from_secs(60);
    while !condition() {
        assert!(Instant::now() < end, "the condition did not hold within a minute");
        thread::sleep(Duration::from_millis(1));
    }
}

/// Encodes a request.
pub(crate) fn frame(call: impl Call) -> Vec<u8> {
    let mut buffer = vec![0; 17 << 20];
    let mut writer = FrameWriter::new(&mut buffer).unwrap();
    call.arguments(&mut writer).unwrap();
    writer.finish(1, 0, call.function().0).unwrap().to_vec()
}
