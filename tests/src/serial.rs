//! Servers of serial framing: over TCP, where each connection is the other end of one line, and over any other [`Wire`].

use bcap_core::endpoint::{Endpoint, Serve};
use std::io::{self, ErrorKind, Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::Duration;

use bcap_core::bcap::server::{Config, Handler, Session};
use bcap_core::handler::PeerId;
use bcap_std::now;

/// A server of one line after the other, until this is dropped.
#[derive(Debug)]
pub struct SerialServer {
    /// Where lines are connected.
    pub address: SocketAddr,
    stopped: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl SerialServer {
    /// Starts a server on a free port of the loopback.
    ///
    /// # Panics
    ///
    /// When the machine has no socket for it.
    #[must_use]
    pub fn start<H: Handler + Send + 'static>(handler: Arc<Mutex<H>>) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
        let address = listener.local_addr().expect("the port's number");
        let stopped = Arc::new(AtomicBool::new(false));
        let stop = Arc::clone(&stopped);
        let thread = thread::spawn(move || {
            for (peer, line) in (1..).map(PeerId).zip(listener.incoming()) {
                if stop.load(Ordering::Acquire) {
                    return;
                }
                // an error is the end of this line: the client has gone
                _ = line.and_then(|line| line.set_nodelay(true).and_then(|()| serve(line, &handler, peer)));
            }
        });
        Self { address, stopped, thread: Some(thread) }
    }
}

impl Drop for SerialServer {
    fn drop(&mut self) {
        self.stopped.store(true, Ordering::Release);
        // wakes the thread, which waits for the next line
        _ = TcpStream::connect(self.address);
        if let Some(thread) = self.thread.take()
            && thread.join().is_err()
            && !thread::panicking()
        {
            panic!("the server has panicked");
        }
    }
}

/// One end of a line.
pub trait Wire: Read + Write {
    /// Sets how long a read waits; `None` means indefinitely.
    ///
    /// # Errors
    ///
    /// When the line has ended.
    fn set_wait(&mut self, wait: Option<Duration>) -> io::Result<()>;
}

impl Wire for TcpStream {
    fn set_wait(&mut self, wait: Option<Duration>) -> io::Result<()> {
        self.set_read_timeout(wait)
    }
}

type Line = Session<[u8; 512], [u8; 512], 64>;

/// Serves one client until its line ends.
///
/// # Errors
///
/// Why the line ended, unless the client closed it.
pub fn serve<H: Handler>(mut stream: impl Wire, handler: &Mutex<H>, peer: PeerId) -> io::Result<()> {
    let mut line = Line::new(Config::SERIAL, [0; 512], [0; 512]);
    let end = exchange(&mut stream, &mut line, handler, peer);
    line.close(&mut *handler.lock().unwrap_or_else(PoisonError::into_inner), peer, now());
    end
}

/// Moves bytes until the client closes the stream.
fn exchange<H: Handler>(stream: &mut impl Wire, line: &mut Line, handler: &Mutex<H>, peer: PeerId) -> io::Result<()> {
    loop {
        while line.run(&mut *handler.lock().unwrap_or_else(PoisonError::into_inner), peer, now()).is_some() {
            stream.write_all(line.transmit())?;
            line.transmitted(usize::MAX);
        }
        // a read without a time limit waits indefinitely; with a limit of zero it fails
        let wait = line.poll_timeout().map(|at| at.saturating_since(now()).max(Duration::from_millis(1)));
        let room = line.receive_buffer();
        if room.is_empty() {
            thread::sleep(wait.unwrap_or_default());
            continue;
        }
        stream.set_wait(wait)?;
        match stream.read(room) {
            Ok(0) => return Ok(()),
            Ok(count) => line.received(count),
            Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => {}
            Err(error) => return Err(error),
        }
    }
}
