//! A server of serial framing over a pair of pseudo-terminals, with noise.

use std::io::{self, Read, Write};
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::{self, JoinHandle};
use std::time::Duration;

use bcap_core::bcap::server::Handler;
use bcap_core::handler::PeerId;
use bcap_testkit::network::Random;
use serialport::{SerialPort, TTYPort};

use crate::serial::{Wire, serve};

/// The interval at which the controller's end checks whether it was unplugged.
const LOOK: Duration = Duration::from_millis(5);

/// A line to a controller. Dropping it unplugs the line.
#[derive(Debug)]
pub struct Line {
    /// The client's end, kept open so that the line exists before and after the client.
    client: TTYPort,
    unplugged: Arc<AtomicBool>,
    corrupted: Arc<AtomicU32>,
    server: Option<JoinHandle<()>>,
}

/// The controller's end, which corrupts some of the bytes in both directions.
struct Noisy {
    port: TTYPort,
    random: Random,
    per_mille: u64,
    unplugged: Arc<AtomicBool>,
    corrupted: Arc<AtomicU32>,
}

/// Makes the two ends of a line, the controller's first.
///
/// # Panics
///
/// When this machine has no more pseudo-terminals.
#[must_use]
pub fn pair() -> (TTYPort, TTYPort) {
    TTYPort::pair().expect("a pair of pseudo-terminals")
}

/// Returns the address of a line for clients.
///
/// # Panics
///
/// When the port has no name.
#[must_use]
pub fn address(client: &TTYPort) -> String {
    format!("serial:{}?baud=115200", client.name().expect("the name of the port"))
}

impl Line {
    /// Connects to a controller over a line that corrupts `per_mille` of 1,000 bytes.
    ///
    /// # Panics
    ///
    /// When this machine has no more pseudo-terminals.
    #[must_use]
    pub fn to<H: Handler + Send + 'static>(controller: H, seed: u64, per_mille: u64) -> Self {
        let (port, client) = pair();
        let (unplugged, corrupted) = <(Arc<AtomicBool>, Arc<AtomicU32>)>::default();
        let random = Random(seed);
        let wire =
            Noisy { port, random, per_mille, unplugged: Arc::clone(&unplugged), corrupted: Arc::clone(&corrupted) };
        let controller = Mutex::new(controller);
        // an error is the end of the line
        let server = thread::spawn(move || drop(serve(wire, &controller, PeerId(1))));
        Self { client, unplugged, corrupted, server: Some(server) }
    }

    /// Returns the address for clients.
    #[must_use]
    pub fn address(&self) -> String {
        address(&self.client)
    }

    /// Returns how many bytes were corrupted.
    #[must_use]
    pub fn corrupted(&self) -> u32 {
        self.corrupted.load(Ordering::Relaxed)
    }

    /// Closes the controller's end.
    ///
    /// # Panics
    ///
    /// When the server has panicked.
    pub fn unplug(&mut self) {
        self.unplugged.store(true, Ordering::Release);
        if let Some(server) = self.server.take() {
            server.join().expect("the server");
        }
    }
}

impl Drop for Line {
    fn drop(&mut self) {
        self.unplug();
    }
}

impl Noisy {
    fn corrupt(&mut self, bytes: &mut [u8]) {
        for byte in bytes {
            if self.random.happens(self.per_mille) {
                *byte ^= 1 << self.random.below(8);
                self.corrupted.fetch_add(1, Ordering::Relaxed);
            }
        }
    }
}

impl Read for Noisy {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let count = self.port.read(buffer)?;
        self.corrupt(&mut buffer[..count]);
        Ok(count)
    }
}

impl Write for Noisy {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let mut bytes = bytes.to_vec();
        self.corrupt(&mut bytes);
        self.port.write_all(&bytes)?;
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        self.port.flush()
    }
}

impl Wire for Noisy {
    fn set_wait(&mut self, wait: Option<Duration>) -> io::Result<()> {
        if self.unplugged.load(Ordering::Acquire) {
            return Err(io::ErrorKind::BrokenPipe.into());
        }
        Ok(self.port.set_timeout(wait.unwrap_or(LOOK).min(LOOK))?)
    }
}
