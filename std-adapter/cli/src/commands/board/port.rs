//! The serial port or the TCP connection to a board: requests and answers are lines.

use std::io::{self, ErrorKind, Read, Write};
use std::net::{TcpStream, ToSocketAddrs};
use std::time::{Duration, Instant};

use bcap_board::UPDATE_PORT;
use bcap_board::console::HELLO;

use crate::failure::Failure;

/// The longest wait for bytes before the time limit is checked.
const LOOK: Duration = Duration::from_millis(20);
/// The longest line that a board sends; more bytes belong to something else.
const MAX_LINE: usize = 4096;

/// A serial port or a TCP connection.
trait Stream: Read + Write {}

impl<T: Read + Write + ?Sized> Stream for T {}

/// An open port with a board at its other end.
pub(super) struct Port {
    port: Box<dyn Stream>,
    is_network: bool,
    name: String,
    timeout: Duration,
    /// Received bytes without a line end.
    received: Vec<u8>,
}

/// The last line of an answer: it starts with `ok` or `error`.
pub(super) struct Answer(pub(super) String);

impl Answer {
    /// Fails with `hint` if the board refused the request.
    pub(super) fn accepted(&self, request: &str, hint: &str) -> Result<(), Failure> {
        match self.0.strip_prefix("error ") {
            None => Ok(()),
            Some(reason) => Err(Failure::unfit(format!("the board refused \"{request}\": {reason}"), hint)),
        }
    }
}

impl Port {
    /// Opens a port, and checks that a board speaks the protocol there; each answer must arrive within `timeout`.
    pub(super) fn open(name: &str, baud: u32, timeout: Duration) -> Result<Self, Failure> {
        let port: Box<dyn Stream> = match name.strip_prefix("tcp:") {
            Some(host) => Box::new(connect(host, timeout)?),
            None => {
                Box::new(serialport::new(name, baud).timeout(LOOK).open().map_err(|error| Failure::Connection {
                    message: format!("cannot open {name}: {error}"),
                    hint: "check the name and the permissions of the device, and that no other program uses it".into(),
                })?)
            }
        };
        let is_network = name.starts_with("tcp:");
        let mut port = Self { port, is_network, name: name.into(), timeout, received: Vec::new() };
        port.skip_answers()?;
        Ok(port)
    }

    /// Tells whether the board is reached over the network.
    pub(super) const fn is_network(&self) -> bool {
        self.is_network
    }

    /// Skips the answers to earlier requests, even of an earlier program, and the log of a board.
    pub(super) fn skip_answers(&mut self) -> Result<(), Failure> {
        // the first line feed ends a line that an earlier program may have begun
        self.send("\nhello\n")?;
        let deadline = Instant::now() + self.timeout;
        while self.line(deadline)? != HELLO {}
        Ok(())
    }

    /// Sends a request and returns the answer; calls `setting` with each setting before it.
    pub(super) fn ask(
        &mut self,
        request: &str,
        mut setting: impl FnMut(&str) -> io::Result<()>,
    ) -> Result<Answer, Failure> {
        self.send(&format!("{request}\n"))?;
        let deadline = Instant::now() + self.timeout;
        loop {
            let line = self.line(deadline)?;
            if let Some(line) = line.strip_prefix("setting ") {
                setting(line)?;
            } else if line == "ok" || line.starts_with("ok ") || line.starts_with("error ") {
                return Ok(Answer(line));
            }
        }
    }

    /// Sends a block of an image; returns the reason of the board if the block must be sent again.
    pub(super) fn send_block(&mut self, request: &str, number: u32) -> Result<Option<String>, Failure> {
        // the first line feed ends a damaged line
        self.send(&format!("\n{request}\n"))?;
        let deadline = Instant::now() + self.timeout;
        let stored = format!("ok {number}");
        loop {
            match self.line(deadline) {
                Ok(line) if line == stored => return Ok(None),
                Ok(line) => {
                    // others are the log of the board, or answers to a block that was sent twice
                    if let Some(reason) = line.strip_prefix("error ") {
                        return Ok(Some(reason.to_owned()));
                    }
                }
                Err(Failure::Timeout { message, .. }) => return Ok(Some(message)),
                Err(failure) => return Err(failure),
            }
        }
    }

    fn send(&mut self, text: &str) -> Result<(), Failure> {
        self.port.write_all(text.as_bytes()).and_then(|()| self.port.flush()).map_err(|error| self.broken(&error))
    }

    /// Receives a line; bytes that are not UTF-8 are replaced.
    fn line(&mut self, deadline: Instant) -> Result<String, Failure> {
        loop {
            // first, because a device that is no board may send lines without end
            if Instant::now() >= deadline {
                return Err(Failure::Timeout {
                    message: format!("no answer from a board at {} within {} ms", self.name, self.timeout.as_millis()),
                    hint: "check the port, --baud and that the image of the board has the console; --timeout allows more time"
                        .into(),
                });
            }
            if let Some(end) = self.received.iter().position(|byte| *byte == b'\n') {
                let line: Vec<u8> = self.received.drain(..=end).collect();
                return Ok(String::from_utf8_lossy(&line).trim_end().to_owned());
            }
            if self.received.len() > MAX_LINE {
                self.received.clear();
            }
            let mut buffer = [0; 256];
            match self.port.read(&mut buffer) {
                Ok(0) if self.is_network => return Err(self.broken(&ErrorKind::ConnectionReset.into())),
                Ok(count) => self.received.extend_from_slice(buffer.get(..count).unwrap_or_default()),
                Err(error)
                    if matches!(error.kind(), ErrorKind::TimedOut | ErrorKind::WouldBlock | ErrorKind::Interrupted) => {
                }
                Err(error) => return Err(self.broken(&error)),
            }
        }
    }

    fn broken(&self, error: &io::Error) -> Failure {
        Failure::Connection {
            message: format!("{}: {error}", self.name),
            hint: match self.is_network {
                true => NETWORK_HINT.into(),
                false => "check the cable; the board has its earlier settings and image, or the new ones".into(),
            },
        }
    }
}

const NETWORK_HINT: &str = "the board takes updates over the network if its image has a key and its setting update= has this host; it has \
     its earlier image, or the new one";

/// Connects to a board; `host` is HOST[:PORT].
fn connect(host: &str, timeout: Duration) -> Result<TcpStream, Failure> {
    let address = if host.contains(':') { host.to_owned() } else { format!("{host}:{UPDATE_PORT}") };
    let failed = |error: io::Error| Failure::Connection {
        message: format!("cannot connect to tcp:{address}: {error}"),
        hint: NETWORK_HINT.into(),
    };
    let mut addresses = address.to_socket_addrs().map_err(failed)?;
    let first = addresses.next().ok_or_else(|| failed(ErrorKind::AddrNotAvailable.into()))?;
    let stream = TcpStream::connect_timeout(&first, timeout).map_err(failed)?;
    let prepared = stream.set_read_timeout(Some(LOOK)).and_then(|()| stream.set_write_timeout(Some(timeout)));
    prepared.and_then(|()| stream.set_nodelay(true)).map_err(failed)?;
    Ok(stream)
}
