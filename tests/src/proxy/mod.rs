//! Proxies between real clients and a real server that inject network faults.
//!
//! ```text
//!   client ── proxy ── server       [`TcpProxy`]: split, merged, stalled, doubled, corrupted, cut, reset, by a script
//!                                   [`UdpProxy`]: lost, doubled, delayed and so reordered, garbled, by chance
//! ```
//!
//! Each runs in its own thread until it is dropped. A seed determines all random decisions, but not their timing.

mod tcp;
mod udp;

pub use self::tcp::{Script, Step, StreamFault, TcpProxy};
pub use self::udp::{Counts, UdpProxy};

use std::net::SocketAddr;
use std::sync::mpsc;
use std::thread::JoinHandle;

use tokio::sync::oneshot;

/// A thread with a runtime, which ends when this is dropped.
#[derive(Debug)]
struct Thread {
    stop: Option<oneshot::Sender<()>>,
    thread: Option<JoinHandle<()>>,
}

impl Thread {
    /// Starts a proxy: `listen` makes it and its address, which is returned.
    fn start<L, F>(listen: L) -> (Self, SocketAddr)
    where
        L: AsyncFnOnce() -> (SocketAddr, F) + Send + 'static,
        F: Future<Output = ()>,
    {
        let (stop, stopped) = oneshot::channel();
        let (tell, told) = mpsc::channel();
        let thread = std::thread::spawn(move || {
            let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().expect("a runtime");
            runtime.block_on(async {
                let (address, run) = listen().await;
                tell.send(address).expect("the test waits");
                tokio::select! {
                    () = run => {}
                    _ = stopped => {}
                }
            });
        });
        let address = told.recv().expect("the proxy starts");
        (Self { stop: Some(stop), thread: Some(thread) }, address)
    }
}

impl Drop for Thread {
    fn drop(&mut self) {
        drop(self.stop.take());
        if let Some(thread) = self.thread.take()
            && thread.join().is_err()
            && !std::thread::panicking()
        {
            panic!("the proxy has panicked");
        }
    }
}
