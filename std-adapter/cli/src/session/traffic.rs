//! Recording (`--write`) and printing (`--trace`) of the command's connections.

use std::io::{self, Write as _};
use std::path::Path;
use std::sync::{Mutex, OnceLock, PoisonError};

use bcap_capture::Role;
use bcap_capture::record::{HasEnds, Recorder, Recording, Taped};
use bcap_capture::trace::{Level, Packets, with_arrow};
use bcap_core::rac::MAX_VALUE;
use bcap_std::blocking::{Connection, RacClient, RacConnection, TcpTransport};
use bcap_terminal::escape;

use crate::failure::Failure;

/// The recording of this command, if it was called with `--write`.
static RECORDING: Mutex<Option<Recording>> = Mutex::new(None);
static RECORDER: OnceLock<Recorder> = OnceLock::new();

/// Starts the recording of this command, whose recorder [`recorder`] returns.
pub(crate) fn record(file: &Path) -> Result<(), Failure> {
    let recording = Recording::start(Some(file), |_| {})?;
    // a command has one recording
    let _ = RECORDER.set(recording.recorder().clone());
    *RECORDING.lock().unwrap_or_else(PoisonError::into_inner) = Some(recording);
    Ok(())
}

/// Completes the recording of this command, if it has one.
pub(crate) fn finish() -> Result<(), Failure> {
    let recording = RECORDING.lock().unwrap_or_else(PoisonError::into_inner).take();
    Ok(recording.map_or(Ok(()), Recording::finish)?)
}

/// Returns the recorder of this command, if it has one.
pub(crate) fn recorder() -> Option<&'static Recorder> {
    RECORDER.get()
}

/// Records a connection from now on, if the command is recorded.
pub(crate) fn taped<X: HasEnds>(connection: Connection<X, Vec<u8>>) -> Connection<Taped<X>, Vec<u8>> {
    Taped::connection(connection, recorder())
}

/// A TCP socket that records.
pub(crate) type TapedTcp = Taped<TcpTransport>;

/// Records a connection of RAC from now on, if the command is recorded.
pub(crate) fn taped_rac(connection: RacClient) -> RacConnection<TapedTcp, [u8; MAX_VALUE]> {
    Taped::rac_connection(connection, recorder())
}

/// Returns the packets of a session; with a level they are printed on the standard error.
pub(crate) fn packets(level: Option<Level>) -> Packets {
    let mut packets = Packets::new();
    if let Some(level) = level {
        packets.watch(level, print);
    }
    packets
}

fn print(role: Role, packet: &str) {
    let text = with_arrow(role.arrow(), packet);
    // an error of the standard error cannot be reported
    let _ = writeln!(io::stderr().lock(), "{}", escape::block(&text));
}
