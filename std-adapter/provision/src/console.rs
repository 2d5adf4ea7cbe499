//! The serial port or the TCP connection to a board: requests and answers are lines ([`bcap_board::console`]).

use std::fmt;
use std::io::{self, ErrorKind, Read, Write};
use std::net::{TcpStream, ToSocketAddrs};
use std::time::{Duration, Instant};

use bcap_board::UPDATE_PORT;
use bcap_board::console::HELLO;
use bcap_board::slots::TEXT;

use crate::error::Error;

/// The maximum wait for bytes before the time limit is checked.
const LOOK: Duration = Duration::from_millis(20);
/// The maximum length of a line from a board; a longer line is not from a board.
const MAX_LINE: usize = 4096;
/// No board has more settings: each has a line feed in [`TEXT`] bytes.
const MAX_SETTINGS: usize = TEXT;

/// A serial port or a TCP connection.
trait Stream: Read + Write {}

impl<T: Read + Write + ?Sized> Stream for T {}

/// A board at the other end of a serial port or a TCP connection.
pub struct Console {
    stream: Box<dyn Stream>,
    is_network: bool,
    name: String,
    timeout: Duration,
    /// Received bytes without a line end.
    received: Vec<u8>,
}

impl fmt::Debug for Console {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter
            .debug_struct("Console")
            .field("name", &self.name)
            .field("timeout", &self.timeout)
            .finish_non_exhaustive()
    }
}

/// The answer to a request.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Answer {
    /// The last line, which starts with `ok` or `error`.
    pub text: String,
    /// The settings that preceded it, if the request was `show`.
    pub settings: Vec<String>,
}

impl Answer {
    /// Checks that the board has not refused the request.
    ///
    /// # Errors
    ///
    /// [`Error::Refused`] with the reason of the board, and with `hint`.
    pub fn accepted(&self, request: &str, hint: &str) -> Result<(), Error> {
        match self.text.strip_prefix("error ") {
            None => Ok(()),
            Some(reason) => Err(Error::refused(format!("the board refused \"{request}\": {reason}"), hint)),
        }
    }
}

impl Console {
    /// Opens a serial port with a rate in bits a second, or `tcp:HOST[:PORT]`, and checks that a board speaks the protocol there. Each
    /// answer must arrive within `timeout`.
    ///
    /// # Errors
    ///
    /// [`Error::Connection`] if the port or host does not exist, [`Error::Timeout`] if no board answers.
    pub fn open(name: &str, baud: u32, timeout: Duration) -> Result<Self, Error> {
        let stream: Box<dyn Stream> = match name.strip_prefix("tcp:") {
            Some(host) => Box::new(connect(host, timeout)?),
            None => Box::new(serialport::new(name, baud).timeout(LOOK).open().map_err(|error| Error::Connection {
                message: format!("cannot open {name}: {error}"),
                hint: "check the name and the permissions of the device, and that no other program uses it".into(),
            })?),
        };
        let is_network = name.starts_with("tcp:");
        let mut console = Self { stream, is_network, name: name.into(), timeout, received: Vec::new() };
        console.skip_answers()?;
        Ok(console)
    }

    /// Returns whether the board is reached over the network.
    #[must_use]
    pub const fn is_network(&self) -> bool {
        self.is_network
    }

    /// Skips the answers to earlier requests, including requests of an earlier program, and the log of a board.
    pub(crate) fn skip_answers(&mut self) -> Result<(), Error> {
        // the first line feed ends a line that an earlier program may have begun
        self.send("\nhello\n")?;
        let deadline = Instant::now() + self.timeout;
        while self.line(deadline)? != HELLO {}
        Ok(())
    }

    /// Sends a request and returns the answer, which may be a refusal ([`Answer::accepted`]).
    ///
    /// # Errors
    ///
    /// [`Error::Connection`] if the connection broke, or if a device sends more settings than a board has; [`Error::Timeout`].
    pub fn ask(&mut self, request: &str) -> Result<Answer, Error> {
        self.send(&format!("{request}\n"))?;
        let deadline = Instant::now() + self.timeout;
        let mut settings = Vec::new();
        loop {
            let line = self.line(deadline)?;
            if let Some(line) = line.strip_prefix("setting ") {
                if settings.len() == MAX_SETTINGS {
                    return Err(self.broken(&io::Error::other("more settings than a board has")));
                }
                settings.push(line.to_owned());
            } else if line == "ok" || line.starts_with("ok ") || line.starts_with("error ") {
                return Ok(Answer { text: line, settings });
            }
        }
    }

    /// Sends a block of an image; returns the reason of the board if the block must be sent again.
    pub(crate) fn send_block(&mut self, request: &str, number: u32) -> Result<Option<String>, Error> {
        // the first line feed ends a damaged line
        self.send(&format!("\n{request}\n"))?;
        let deadline = Instant::now() + self.timeout;
        let stored = format!("ok {number}");
        loop {
            match self.line(deadline) {
                Ok(line) if line == stored => return Ok(None),
                Ok(line) => {
                    // other lines are the log of the board, or answers to a block that was sent twice
                    if let Some(reason) = line.strip_prefix("error ") {
                        return Ok(Some(reason.to_owned()));
                    }
                }
                Err(Error::Timeout { message, .. }) => return Ok(Some(message)),
                Err(failure) => return Err(failure),
            }
        }
    }

    fn send(&mut self, text: &str) -> Result<(), Error> {
        self.stream.write_all(text.as_bytes()).and_then(|()| self.stream.flush()).map_err(|error| self.broken(&error))
    }

    /// Receives a line; bytes that are not UTF-8 are replaced.
    fn line(&mut self, deadline: Instant) -> Result<String, Error> {
        loop {
            // first, because a device that is not a board may send lines endlessly
            if Instant::now() >= deadline {
                return Err(Error::Timeout {
                    message: format!("no answer from a board at {} within {} ms", self.name, self.timeout.as_millis()),
                    hint: "check the port and its rate, and that the image of the board has the console; a longer time limit may help"
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
            match self.stream.read(&mut buffer) {
                Ok(0) if self.is_network => return Err(self.broken(&ErrorKind::ConnectionReset.into())),
                Ok(count) => self.received.extend_from_slice(buffer.get(..count).unwrap_or_default()),
                Err(error)
                    if matches!(error.kind(), ErrorKind::TimedOut | ErrorKind::WouldBlock | ErrorKind::Interrupted) => {
                }
                Err(error) => return Err(self.broken(&error)),
            }
        }
    }

    fn broken(&self, error: &io::Error) -> Error {
        Error::Connection {
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
fn connect(host: &str, timeout: Duration) -> Result<TcpStream, Error> {
    let address = if host.contains(':') { host.to_owned() } else { format!("{host}:{UPDATE_PORT}") };
    let failed = |error: io::Error| Error::Connection {
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
