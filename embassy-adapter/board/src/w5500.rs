//! A driver of WIZnet's W5500 for embassy-net, over `embedded-hal-async`.
//!
//! ```text
//!  wire ─► 16 KiB in the chip ─ SPI ─► channel ─► Device, for embassy-net
//!  wire ◄─ 16 KiB in the chip ◄ SPI ── channel ◄─
//!             pin INT, or a tick: frames may be in the chip
//! ```
//!
//! * An interrupt stands for any number of frames, so frames are read until the chip has none. A tick also polls for frames, in
//!   case an interrupt was lost.
//! * A length that no frame can have means that the position in the chip's memory is unknown. The socket is then opened again,
//!   which drops the frames in it.
//! * A tick also reads the link, and initialises a chip that has lost its registers, as after a dip of its supply.

use core::future::pending;

use embassy_futures::select::{Either3, select3};
use embassy_net_driver_channel as channel;
use embassy_net_driver_channel::driver::{HardwareAddress, LinkState};
use embassy_time::{Duration, Ticker, Timer};
use embedded_hal::digital::OutputPin;
use embedded_hal_async::digital::Wait;
use embedded_hal_async::spi::SpiDevice;

mod chip;
#[cfg(test)]
mod model;
#[cfg(test)]
mod tests;

pub use self::chip::Error;
use self::chip::{Chip, MAX_FRAME, Received};

/// The interval of polling the link, and of polling for frames whose interrupt was lost.
const TICK: Duration = Duration::from_millis(250);
/// The pulse of the pin RSTn is 500 us at least; the clock of the chip is stable 1 ms after it.
const RESET: Duration = Duration::from_millis(2);
/// Number of attempts to read the version of the chip at the start, one per [`RESET`].
const ATTEMPTS: u32 = 50;

/// The driver of embassy-net.
pub type Device<'d> = channel::Device<'d, MAX_FRAME>;

/// Memory for `RX` received frames and `TX` frames to send, of 1514 bytes each.
pub struct State<const RX: usize, const TX: usize>(channel::State<MAX_FRAME, RX, TX>);

impl<const RX: usize, const TX: usize> State<RX, TX> {
    /// Creates empty memory.
    #[must_use]
    pub const fn new() -> Self {
        Self(channel::State::new())
    }
}

impl<const RX: usize, const TX: usize> Default for State<RX, TX> {
    fn default() -> Self {
        Self::new()
    }
}

impl<const RX: usize, const TX: usize> core::fmt::Debug for State<RX, TX> {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.debug_struct("State").finish_non_exhaustive()
    }
}

/// Moves frames between the chip and the network stack; a task must run it.
pub struct ChipRunner<'d, S, I, R> {
    chip: Chip<S>,
    channel: channel::Runner<'d, MAX_FRAME>,
    interrupt: I,
    /// Kept, because a pin that is dropped may float.
    _reset: R,
}

impl<S, I, R> core::fmt::Debug for ChipRunner<'_, S, I, R> {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.debug_struct("ChipRunner").finish_non_exhaustive()
    }
}

/// Resets the chip with its pin RSTn, and opens it with this MAC address. `interrupt` is its pin INTn.
///
/// # Errors
///
/// The last [`Error`] of a chip that does not answer in 100 ms.
pub async fn new<'d, const RX: usize, const TX: usize, S: SpiDevice, I: Wait, R: OutputPin>(
    address: [u8; 6],
    state: &'d mut State<RX, TX>,
    spi: S,
    interrupt: I,
    mut reset: R,
) -> Result<(Device<'d>, ChipRunner<'d, S, I, R>), Error<S::Error>> {
    // a pin that cannot be set leaves the reset to the register
    let _ = reset.set_low();
    Timer::after(RESET).await;
    let _ = reset.set_high();
    let mut chip = Chip::new(spi, address);
    let mut attempt = 1;
    loop {
        Timer::after(RESET).await;
        match chip.init().await {
            Ok(()) => break,
            Err(_) if attempt < ATTEMPTS => attempt += 1,
            Err(error) => return Err(error),
        }
    }
    let (channel, device) = channel::new(&mut state.0, HardwareAddress::Ethernet(address));
    Ok((device, ChipRunner { chip, channel, interrupt, _reset: reset }))
}

/// When the chip is polled for received frames.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Next {
    /// It may have some.
    Now,
    /// After the next interrupt.
    Interrupt,
    /// At the next tick: it does not answer, or an interrupt arrived without a frame. Such an interrupt may stay pending, and
    /// no other task would run.
    Tick,
}

impl<S: SpiDevice, I: Wait, R: OutputPin> ChipRunner<'_, S, I, R> {
    /// Runs the driver.
    pub async fn run(self) -> ! {
        let Self { mut chip, channel, mut interrupt, _reset } = self;
        let (state, mut received, mut to_send) = channel.split();
        let mut ticker = Ticker::every(TICK);
        let mut next = Next::Now;
        loop {
            let room = async {
                match next {
                    Next::Now => {}
                    Next::Interrupt if interrupt.wait_for_low().await.is_ok() => {}
                    Next::Interrupt | Next::Tick => pending().await,
                }
                received.rx_buf().await
            };
            // polled in this order, so that a flood of received frames delays neither frames to send nor the check of the link
            match select3(ticker.next(), to_send.tx_buf(), room).await {
                Either3::First(()) => {
                    let is_up = chip.check().await.unwrap_or(false);
                    state.set_link_state(if is_up { LinkState::Up } else { LinkState::Down });
                    next = Next::Now;
                }
                Either3::Second(frame) => {
                    // a frame that cannot be sent is lost, as on the wire
                    if chip.send(frame).await.is_err() {
                        next = Next::Tick;
                    }
                    to_send.tx_done();
                }
                Either3::Third(buffer) => {
                    next = match chip.receive(buffer).await {
                        Ok(Received::Frame(len)) => {
                            received.rx_done(len);
                            Next::Now
                        }
                        Ok(Received::Dropped) => Next::Now,
                        Ok(Received::Nothing) if next == Next::Now => Next::Interrupt,
                        Ok(Received::Nothing) | Err(_) => Next::Tick,
                    };
                }
            }
        }
    }
}
