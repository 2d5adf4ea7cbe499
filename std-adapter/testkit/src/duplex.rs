//! A pair of connected byte streams in memory, for clients and servers that read and write any `Read` and `Write`.
//!
//! # Examples
//!
//! ```
//! use std::io::{Read, Write};
//!
//! let (mut client, mut server) = bcap_testkit::duplex::pair();
//! // one read returns at most 2 bytes, as a slow network does
//! server.limit_reads(2);
//! client.write_all(b"GET:RC8:1:I:\r")?;
//! let mut bytes = [0; 64];
//! assert_eq!(server.read(&mut bytes)?, 2);
//! drop(client);
//! assert_eq!(std::io::read_to_string(server)?, "T:RC8:1:I:\r");
//! # Ok::<(), std::io::Error>(())
//! ```

use std::collections::VecDeque;
use std::io::{self, Read, Write};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use bcap_core::bcap::server::{Config, Handler, Session};
use bcap_core::endpoint::{Endpoint as _, Serve as _, ServerEndpoint as _};
use bcap_core::handler::PeerId;
use bcap_core::time::Instant;

/// Bytes in one direction.
#[derive(Debug, Default)]
struct Pipe {
    state: Mutex<State>,
    changed: Condvar,
}

#[derive(Debug, Default)]
struct State {
    bytes: VecDeque<u8>,
    is_closed: bool,
}

impl Pipe {
    fn lock(&self) -> MutexGuard<'_, State> {
        // the bytes are complete even after a panic of a thread
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn close(&self) {
        self.lock().is_closed = true;
        self.changed.notify_all();
    }
}

/// One end of a pair. Dropping it closes both directions.
#[derive(Debug)]
pub struct End {
    input: Arc<Pipe>,
    output: Arc<Pipe>,
    most: usize,
    timeout: Option<Duration>,
}

/// Returns two connected ends.
#[must_use]
pub fn pair() -> (End, End) {
    let (there, back) = (Arc::new(Pipe::default()), Arc::new(Pipe::default()));
    let end = |input: &Arc<Pipe>, output: &Arc<Pipe>| End {
        input: input.clone(),
        output: output.clone(),
        most: usize::MAX,
        timeout: None,
    };
    (end(&back, &there), end(&there, &back))
}

impl End {
    /// Limits the bytes that one read returns; 0 counts as 1.
    pub fn limit_reads(&mut self, most: usize) {
        self.most = most.max(1);
    }

    /// Limits the time that a read waits for bytes; then it fails with [`io::ErrorKind::TimedOut`]. `None` waits without limit.
    pub fn set_read_timeout(&mut self, timeout: Option<Duration>) {
        self.timeout = timeout;
    }
}

impl Read for End {
    /// Waits for bytes; returns 0 when the other end is dropped and all bytes are read.
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let state = self.input.lock();
        let is_waiting = |state: &mut State| state.bytes.is_empty() && !state.is_closed;
        let mut state = match self.timeout {
            None => self.input.changed.wait_while(state, is_waiting).unwrap_or_else(PoisonError::into_inner),
            Some(timeout) => {
                let waited = self.input.changed.wait_timeout_while(state, timeout, is_waiting);
                let (state, result) = waited.unwrap_or_else(PoisonError::into_inner);
                if result.timed_out() {
                    return Err(io::ErrorKind::TimedOut.into());
                }
                state
            }
        };
        let count = buffer.len().min(self.most).min(state.bytes.len());
        for (place, byte) in buffer.iter_mut().zip(state.bytes.drain(..count)) {
            *place = byte;
        }
        Ok(count)
    }
}

impl Write for End {
    /// Writes all bytes without waiting; fails with [`io::ErrorKind::BrokenPipe`] when the other end is dropped.
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let mut state = self.output.lock();
        if state.is_closed {
            return Err(io::ErrorKind::BrokenPipe.into());
        }
        state.bytes.extend(bytes);
        drop(state);
        self.output.changed.notify_all();
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl Drop for End {
    fn drop(&mut self) {
        self.input.close();
        self.output.close();
    }
}

/// Serves one b-CAP client at the other end until that end is dropped or sends a malformed frame. Run it on a separate
/// thread.
///
/// # Errors
///
/// When the stream fails.
pub fn serve(mut end: End, handler: &mut impl Handler) -> io::Result<()> {
    /// The one client.
    const PEER: PeerId = PeerId(1);
    /// A request or a reply of a test.
    const ROOM: usize = 1 << 16;
    let began = std::time::Instant::now();
    let now = || Instant::ZERO.saturating_add(began.elapsed());
    let mut session = Session::<_, _, 32>::new(Config::TCP, vec![0; ROOM], vec![0; ROOM]);
    let served = loop {
        while session.run(handler, PEER, now()).is_some() {}
        let count = session.transmit().len();
        if count > 0 {
            if let Err(error) = end.write_all(session.transmit()) {
                break Err(error);
            }
            session.transmitted(count);
            continue;
        }
        if session.is_finished() {
            break Ok(());
        }
        let left = session.poll_timeout().map(|at| at.saturating_since(now()));
        // a wait of zero would be refused
        end.set_read_timeout(left.map(|left| left.max(Duration::from_micros(1))));
        match end.read(session.receive_buffer()) {
            Ok(0) => break Ok(()),
            Ok(count) => session.received(count),
            Err(error) if error.kind() == io::ErrorKind::TimedOut => {}
            Err(error) => break Err(error),
        }
    };
    session.close(handler, PEER, now());
    // a client that has read its replies and gone has not failed
    served.or_else(|error| if error.kind() == io::ErrorKind::BrokenPipe { Ok(()) } else { Err(error) })
}

/// Splits `bytes` into chunks with the sizes of `sizes`, repeated, each plus one; without sizes, returns one chunk.
pub fn chunks<'a>(bytes: &'a [u8], sizes: &'a [u8]) -> impl Iterator<Item = &'a [u8]> {
    let mut rest = bytes;
    let mut sizes = sizes.iter().cycle();
    std::iter::from_fn(move || {
        let most = sizes.next().map_or(rest.len(), |size| usize::from(*size) + 1);
        let (chunk, after) = rest.split_at(most.min(rest.len()));
        rest = after;
        (!chunk.is_empty()).then_some(chunk)
    })
}
