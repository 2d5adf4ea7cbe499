//! The console and the log over any serial port: a UART or a USB CDC port.

use core::cell::RefCell;
use core::convert::Infallible;
use core::fmt::Write as _;

use bcap_core::rac;
use embassy_futures::join::join3;
use embassy_futures::select::{Either, select};
use embassy_net::Ipv4Cidr;
use embassy_time::Duration;
use embedded_io_async::{Read, Write};
use embedded_storage::nor_flash::NorFlash;
use heapless::{String, Vec};
use static_cell::ConstStaticCell;

use crate::console::{Action, Console};
use crate::slots::Slots;
use crate::{address, log, memory};
#[cfg(feature = "update")]
use crate::{trial, update::Updates};

/// The maximum size of an answer in bytes, or of a part of the settings: more than a request, which errors quote.
const ANSWER: usize = 896;
/// How long an update on a board may take to serve its first request.
pub const TRIAL: Duration = Duration::from_secs(600);

/// The maximum number of bytes per write to a port: a packet of USB.
const PART: usize = 64;

/// The bytes of an answer, which are sent after it is complete.
#[derive(Debug)]
pub struct AnswerBuf(Vec<u8, ANSWER>);

impl embedded_io::ErrorType for AnswerBuf {
    type Error = Infallible;
}

impl embedded_io::Write for AnswerBuf {
    /// Takes all bytes. An answer that does not fit, because it escapes a request, is cut; it keeps its line feed.
    fn write(&mut self, bytes: &[u8]) -> Result<usize, Infallible> {
        let room = self.0.capacity() - self.0.len();
        let _ = self.0.extend_from_slice(bytes.get(..room).unwrap_or(bytes));
        if let (true, Some(last), b"\n") = (self.0.is_full(), self.0.last_mut(), bytes) {
            *last = b'\n';
        }
        Ok(bytes.len())
    }

    fn flush(&mut self) -> Result<(), Infallible> {
        Ok(())
    }
}

/// Returns the memory of the answers. Call it once.
#[must_use]
pub fn answer() -> &'static mut AnswerBuf {
    static ANSWER_MEMORY: ConstStaticCell<AnswerBuf> = ConstStaticCell::new(AnswerBuf(Vec::new()));
    ANSWER_MEMORY.take()
}

/// Creates a console for the settings in these slots and in the image.
#[must_use]
pub fn console<F: NorFlash>(slots: Slots<F>) -> Console<'static, F> {
    Console::new(slots, memory::image())
}

/// Creates a console as [`console`] does, which also receives updates if the image has partitions for them.
///
/// Call it after [`Parts::after`](crate::parts::Parts::after), which passes on why an update was rolled back.
#[cfg(feature = "update")]
#[must_use]
pub fn console_with_updates<F: NorFlash>(slots: Slots<F>, updates: Option<Updates>) -> Console<'static, F> {
    trial::console(slots, updates)
}

/// Serves a host that changes the settings, until it requests a restart. Writes a line with the address once the board has one.
///
/// # Errors
///
/// An error of the port, such as an unplugged cable; serve it again once it works.
pub async fn serve<F: NorFlash, R: Read, W: Write<Error = R::Error>>(
    console: &RefCell<Console<'_, F>>,
    answer: &mut AnswerBuf,
    receiver: &mut R,
    sender: &mut W,
) -> Result<Action, R::Error> {
    let (mut bytes, mut told) = ([0; PART], None);
    loop {
        let count = match select(receiver.read(&mut bytes), address::changed(told)).await {
            Either::First(count) => count?,
            Either::Second(found) => {
                told = Some(found);
                tell(found, sender).await?;
                continue;
            }
        };
        for byte in bytes.iter().take(count) {
            answer.0.clear();
            // other tasks of the port borrow it between two bytes only
            let Ok(action) = console.borrow_mut().receive_byte(*byte, answer);
            loop {
                // in parts, because some UARTs refuse more than their buffer has room for
                for part in answer.0.chunks(PART) {
                    sender.write_all(part).await?;
                }
                if answer.0.is_empty() {
                    break;
                }
                answer.0.clear();
                let Ok(()) = console.borrow_mut().show_more(answer);
                if answer.0.is_empty() {
                    sender.flush().await?;
                }
            }
            if let Some(action) = action {
                return Ok(action);
            }
        }
    }
}

/// Prints the address for a person at a terminal. Hosts skip the line, because it is not an answer.
async fn tell<W: Write>(found: Ipv4Cidr, sender: &mut W) -> Result<(), W::Error> {
    let mut line = String::<PART>::new();
    // there is room for the longest one
    let _ = write!(line, "address {found}, RAC on port {}\r\n", rac::PORT);
    sender.write_all(line.as_bytes()).await?;
    sender.flush().await
}

/// Sends the log to a port.
///
/// # Errors
///
/// An error of the port; up to 64 bytes of the log are then lost.
pub async fn send_log<W: Write>(sender: &mut W) -> Result<Infallible, W::Error> {
    let mut bytes = [0; PART];
    loop {
        let count = log::read(&mut bytes).await;
        sender.write_all(bytes.get(..count).unwrap_or_default()).await?;
        sender.flush().await?;
    }
}

/// Serves the console on one UART and sends the log to another; calls `restart` when the host requests it. Call it once.
pub async fn run<F: NorFlash, R: Read, W: Write<Error = R::Error>>(
    slots: Slots<F>,
    receiver: R,
    sender: W,
    log: impl Write,
    restart: fn() -> !,
) {
    run_console(|| console(slots), receiver, sender, log, restart).await;
}

/// Same as [`run`], and receives updates, if the image has partitions for them.
#[cfg(feature = "update")]
pub async fn run_with_updates<F: NorFlash, R: Read, W: Write<Error = R::Error>>(
    slots: Slots<F>,
    updates: Option<Updates>,
    receiver: R,
    sender: W,
    log: impl Write,
    restart: fn() -> !,
) {
    run_console(|| console_with_updates(slots, updates), receiver, sender, log, restart).await;
}

/// Creates a console. Not inlined: its temporaries, of 2.8 KB each, would be in the frame of each poll of the task.
#[inline(never)]
pub(crate) fn cell<F: NorFlash>(make: impl FnOnce() -> Console<'static, F>) -> RefCell<Console<'static, F>> {
    RefCell::new(make())
}

/// `make` makes the console here, because an async function has a second copy of each argument.
async fn run_console<F: NorFlash, R: Read, W: Write<Error = R::Error>>(
    make: impl FnOnce() -> Console<'static, F>,
    mut receiver: R,
    mut sender: W,
    mut log: impl Write,
    restart: fn() -> !,
) {
    let (console, answer) = (cell(make), answer());
    let serve = async {
        loop {
            // after a line error the request is invalid, and the host repeats it
            if serve(&console, answer, &mut receiver, &mut sender).await.is_ok() {
                restart();
            }
        }
    };
    let send_log = async {
        loop {
            let _ = send_log(&mut log).await;
        }
    };
    join3(serve, send_log, judge(&console, TRIAL, restart)).await;
}

/// Confirms an update on trial when the gateway has served a request; without one in the time `trial`, calls `restart`. It also
/// performs the requests of hosts on the network: updates, and settings from the page.
pub async fn judge<F: NorFlash>(console: &RefCell<Console<'_, F>>, trial: Duration, restart: fn() -> !) {
    #[cfg(feature = "update")]
    let updates =
        embassy_futures::join::join(trial::judge(console, trial, restart), crate::remote::attend(console, restart));
    #[cfg(not(feature = "update"))]
    let updates = async { trial };
    #[cfg(feature = "health")]
    embassy_futures::join::join(updates, crate::saving::attend(console, restart)).await;
    #[cfg(not(feature = "health"))]
    {
        let _ = (console, restart);
        updates.await;
    }
}
