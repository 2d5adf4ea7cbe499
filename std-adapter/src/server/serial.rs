//! b-CAP over a serial line: one task, which serves the client at its other end. After the device was unplugged the task opens
//! it again.

use std::io::{self, ErrorKind};
use std::sync::Arc;
use std::time::Duration;

use bcap_core::bcap::server::{Config, Handler, Session};
use bcap_core::endpoint::Endpoint;
use bcap_core::handler::PeerId;
use bcap_core::limits::SERIAL_MAX;
use bcap_core::peers::datagrams::SharedState as _;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::sync::watch;
use tokio::time::{sleep, timeout};
use tokio_serial::{ClearBuffer, SerialPort, SerialStream};

use super::limits::Limits;
use super::shared::{Changes, ServerState};
use super::stream::sleep_until;
use crate::clock::now;
use crate::line::SerialLine;

/// The maximum number of open handles of the client.
const OBJECTS: usize = 1000;
/// The interval at which a device that was unplugged is opened again.
const REOPEN: Duration = Duration::from_millis(250);

type LineSession = Session<[u8; SERIAL_MAX + 1], [u8; SERIAL_MAX + 1], OBJECTS>;

/// A change of a server's serial line.
#[derive(Debug)]
#[non_exhaustive]
pub enum LineEvent<'a> {
    /// The device failed, usually because it was unplugged. The server has released the client's objects, and tries to open
    /// the device again until that succeeds.
    Lost(&'a io::Error),
    /// The device is open again.
    Reopened,
}

/// A function that is called at each [`LineEvent`] of a line. It must return quickly.
pub type LineReport = fn(&SerialLine, LineEvent<'_>);

/// An open serial line, and how to open it again.
#[derive(Debug)]
pub(super) struct Port {
    line: SerialLine,
    stream: SerialStream,
    report: LineReport,
}

impl Port {
    /// Opens a serial line for this process alone, and drops bytes that it received before.
    pub(super) fn open(line: &SerialLine, report: LineReport) -> io::Result<Self> {
        Ok(Self { line: line.clone(), stream: opened(line)?, report })
    }
}

fn opened(line: &SerialLine) -> io::Result<SerialStream> {
    let stream = SerialStream::open(&line.builder())?;
    stream.clear(ClearBuffer::Input)?;
    Ok(stream)
}

/// Serves a line until the server stops.
pub(super) async fn serve<H: Handler + Send + 'static>(
    port: Port,
    shared: Arc<ServerState<H>>,
    limits: Limits,
    mut stopped: watch::Receiver<()>,
) -> io::Result<()> {
    let Port { line, mut stream, report } = port;
    loop {
        let config = Config { invoke_timeout_max: limits.call, ..Config::SERIAL };
        let mut connection = LineConnection {
            stream,
            session: Box::new(LineSession::new(config, [0; SERIAL_MAX + 1], [0; SERIAL_MAX + 1])),
            peer: shared.next_peer(),
            changes: shared.changes(),
            shared: Arc::clone(&shared),
            limits,
        };
        let error = tokio::select! {
            error = connection.run() => Some(error),
            _ = stopped.changed() => None,
        };
        connection.end();
        let Some(error) = error else { return Ok(()) };
        // closes the device, which may not exist any more, before it is opened again
        drop(connection);
        report(&line, LineEvent::Lost(&error));
        stream = tokio::select! {
            stream = reopened(&line) => stream,
            _ = stopped.changed() => return Ok(()),
        };
        report(&line, LineEvent::Reopened);
    }
}

/// Opens a line as soon as that is possible.
async fn reopened(line: &SerialLine) -> SerialStream {
    loop {
        sleep(REOPEN).await;
        if let Ok(stream) = opened(line) {
            return stream;
        }
    }
}

/// The time between two openings of a device.
struct LineConnection<H> {
    stream: SerialStream,
    session: Box<LineSession>,
    peer: PeerId,
    shared: Arc<ServerState<H>>,
    changes: Changes<H>,
    limits: Limits,
}

impl<H: Handler + Send + 'static> LineConnection<H> {
    /// Moves bytes until the device fails.
    async fn run(&mut self) -> io::Error {
        loop {
            let Self { changes, session, shared, peer, .. } = self;
            changes.run(&mut **session, |session| shared.step(session, *peer, now()));
            let moved = if self.session.transmit().is_empty() { self.wait().await } else { self.send().await };
            if let Err(error) = moved {
                return error;
            }
        }
    }

    /// Waits until bytes arrive, a deadline passes or something changes.
    async fn wait(&mut self) -> io::Result<()> {
        let deadline = self.session.poll_timeout();
        let room = self.session.receive_buffer();
        let is_full = room.is_empty();
        tokio::select! {
            count = self.stream.read(room), if !is_full => match count {
                Ok(0) => return Err(ErrorKind::UnexpectedEof.into()),
                Ok(count) => self.session.received(count),
                // an error of one byte, such as its parity
                Err(error) if matches!(error.kind(), ErrorKind::Interrupted | ErrorKind::InvalidData) => {}
                Err(error) => return Err(error),
            },
            () = sleep_until(deadline) => {}
            () = self.changes.next() => {}
        }
        Ok(())
    }

    /// Sends the reply, unless the tap drops it.
    async fn send(&mut self) -> io::Result<()> {
        let bytes = self.session.transmit();
        let count = bytes.len();
        // a line has no connection to close
        let tapped = self.shared.tapped(self.peer, bytes).unwrap_or_default();
        timeout(self.limits.send, self.stream.write_all(&tapped)).await??;
        self.session.transmitted(count);
        Ok(())
    }

    /// Ends the session: releases the objects of the client.
    fn end(&mut self) {
        self.shared.close(&mut *self.session, self.peer, now());
    }
}
