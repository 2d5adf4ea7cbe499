//! Updates over TCP: the requests of the [`console`](crate::console) for updates, for hosts that the settings allow.
//!
//! ```text
//!  host ─► port 5010 ─► this task: lines ─► REQUEST ─► the task with the flash: Console::perform_remote ─► ANSWER ─► host
//! ```
//!
//! One host at a time. The port is closed without the setting `update` and in an image without a key.

use core::cell::RefCell;
use core::convert::Infallible;
use core::net::SocketAddrV4;

use embassy_executor::{SpawnError, Spawner};
use embassy_net::tcp::TcpSocket;
use embassy_net::{IpAddress, IpEndpoint, Stack};
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::signal::Signal;
use embassy_time::{Duration, Timer, with_timeout};
use embedded_io_async::Write;
use embedded_storage::nor_flash::NorFlash;
use heapless::Vec;
use static_cell::ConstStaticCell;

use crate::console::{Console, LINE};
use crate::signature::KEY;
use crate::{Settings, UPDATE_PORT as PORT, report};

/// How long a host may be silent, and how long the flash may take.
const SILENCE: Duration = Duration::from_secs(15);
/// Time limit for sending the rest to a host when a connection ends.
const END: Duration = Duration::from_secs(1);
/// The maximum size of an answer in bytes; a longer one is cut.
const ANSWER_SIZE: usize = 320;

type Request = Vec<u8, LINE>;

static REQUEST: Signal<CriticalSectionRawMutex, Request> = Signal::new();
static ANSWER: Signal<CriticalSectionRawMutex, Answer> = Signal::new();
/// The answer to `restart` has left.
static LEFT: Signal<CriticalSectionRawMutex, ()> = Signal::new();

/// An answer, and whether the board restarts after it.
struct Answer {
    text: AnswerText,
    restarts: bool,
}

struct AnswerText(Vec<u8, ANSWER_SIZE>);

impl embedded_io::ErrorType for AnswerText {
    type Error = Infallible;
}

impl embedded_io::Write for AnswerText {
    fn write(&mut self, bytes: &[u8]) -> Result<usize, Infallible> {
        // room for the line feed remains
        let room = (ANSWER_SIZE - 1).saturating_sub(self.0.len());
        let taken = if bytes == b"\n" { bytes } else { bytes.get(..room).unwrap_or(bytes) };
        let _ = self.0.extend_from_slice(taken);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> Result<(), Infallible> {
        Ok(())
    }
}

/// Performs the requests of hosts on the network, in the task that has the flash.
pub(crate) async fn attend<F: NorFlash>(console: &RefCell<Console<'_, F>>, restart: fn() -> !) {
    loop {
        let request = REQUEST.wait().await;
        let mut text = AnswerText(Vec::new());
        // other tasks of the port borrow it between two bytes only
        let Ok(restarts) = console.borrow_mut().perform_remote(&request, &mut text);
        ANSWER.signal(Answer { text, restarts });
        if restarts {
            let _ = with_timeout(END, LEFT.wait()).await;
            restart();
        }
    }
}

/// Starts the task, if the settings allow a host to send updates.
pub(crate) fn start(
    spawner: Spawner,
    stack: Stack<'static>,
    settings: &'static Settings<'static>,
) -> Result<(), SpawnError> {
    match (settings.has_updaters(), KEY) {
        (false, _) => Ok(()),
        (true, None) => {
            defmt::error!("no updates over the network: the image was built without BCAP_BOARD_KEY");
            Ok(())
        }
        (true, Some(_)) => {
            spawner.spawn(serve(stack, settings)?);
            Ok(())
        }
    }
}

/// Serves hosts in sequence.
#[embassy_executor::task]
async fn serve(stack: Stack<'static>, settings: &'static Settings<'static>) -> ! {
    static MEMORY: ConstStaticCell<([u8; 1024], [u8; 512])> = ConstStaticCell::new(([0; 1024], [0; 512]));
    let (rx, tx) = MEMORY.take();
    let mut socket = TcpSocket::new(stack, rx, tx);
    socket.set_timeout(Some(SILENCE));
    socket.set_nagle_enabled(false);
    loop {
        if socket.accept(PORT).await.is_ok() {
            let host = socket.remote_endpoint();
            let host = host.map(|IpEndpoint { addr: IpAddress::Ipv4(address), port }| SocketAddrV4::new(address, port));
            if host.is_some_and(|host| settings.may_update(*host.ip())) {
                defmt::info!("{}: sends an update", host);
                serve_host(&mut socket).await;
                socket.close();
                let _ = with_timeout(END, socket.flush()).await;
            } else {
                report::refused_host(host);
            }
        } else {
            Timer::after(END).await;
        }
        socket.abort();
        let _ = with_timeout(END, socket.flush()).await;
    }
}

/// Passes on requests until the host closes the connection or is silent.
async fn serve_host(socket: &mut TcpSocket<'_>) {
    let (mut request, mut part) = (Request::new(), [0; 64]);
    loop {
        let Ok(Ok(count @ 1..)) = with_timeout(SILENCE, socket.read(&mut part)).await else { return };
        for byte in part.iter().take(count) {
            if !matches!(byte, b'\r' | b'\n') {
                // a line that is too long is not from `bcap`
                if request.push(*byte).is_err() {
                    return;
                }
            } else if !request.is_empty() {
                ANSWER.reset();
                REQUEST.signal(core::mem::take(&mut request));
                let Ok(answer) = with_timeout(SILENCE, ANSWER.wait()).await else { return };
                let sent = socket.write_all(&answer.text.0).await.is_ok();
                if answer.restarts {
                    socket.close();
                    let _ = with_timeout(END, socket.flush()).await;
                    LEFT.signal(());
                }
                if !sent {
                    return;
                }
            }
        }
    }
}
