//! A driver of the Ethernet controller LAN9118 for embassy-net and smoltcp.
//!
//! ```text
//!  wire ─► RX FIFO ──────── read a word at a time ─────► `received`   ─► RxToken
//!  wire ◄─ TX FIFO ◄─────── written a word at a time ─── `to_send`    ◄─ TxToken
//!             interrupt: frame received, or room to send ─► WAKER
//! ```
//!
//! * A received frame is copied out of the controller before its token is created. A frame to send is copied into the
//!   controller when its token is consumed. The two tokens of a pair borrow different fields, so they share no bytes.
//! * A `TxToken` is created only when the controller has room for the largest frame, so sending never waits.
//! * A controller that receives nothing for 30 s while its link is up is initialised again. After five minutes
//!   [`bcap_board::network`] lets the watchdog reset the board.
//! * The interrupt handler masks the interrupt and wakes the driver. The driver unmasks it when it has no more work. A
//!   frame that arrives in between keeps the interrupt pending and is not missed.

use core::sync::atomic::{AtomicU32, Ordering};
use core::task::{Context, Waker};

use bcap_board::mac::from_unique_id;
use bcap_board::network;
use embassy_net_driver::{Capabilities, Driver, HardwareAddress, LinkState};
use embassy_sync::waitqueue::AtomicWaker;
use embassy_time::{Duration, Instant};
use smoltcp::phy::{self, Device, DeviceCapabilities, Medium};

use crate::board::{self, ETHERNET};

/// Registers, as byte offsets from the base.
mod register {
    pub(super) const RX_DATA: usize = 0x00;
    pub(super) const TX_DATA: usize = 0x20;
    pub(super) const RX_STATUS: usize = 0x40;
    pub(super) const TX_STATUS: usize = 0x48;
    pub(super) const IRQ_CFG: usize = 0x54;
    pub(super) const INT_STS: usize = 0x58;
    pub(super) const INT_EN: usize = 0x5c;
    pub(super) const BYTE_TEST: usize = 0x64;
    pub(super) const FIFO_INT: usize = 0x68;
    pub(super) const TX_CFG: usize = 0x70;
    pub(super) const HW_CFG: usize = 0x74;
    pub(super) const RX_FIFO_INF: usize = 0x7c;
    pub(super) const TX_FIFO_INF: usize = 0x80;
    pub(super) const RX_DROP: usize = 0xa0;
    pub(super) const MAC_CSR_CMD: usize = 0xa4;
    pub(super) const MAC_CSR_DATA: usize = 0xa8;
}

/// Registers that are accessed through `MAC_CSR_CMD`.
mod mac {
    pub(super) const CR: u32 = 1;
    pub(super) const ADDR_HIGH: u32 = 2;
    pub(super) const ADDR_LOW: u32 = 3;
    pub(super) const MII_ACC: u32 = 6;
    pub(super) const MII_DATA: u32 = 7;
}

/// Registers of the PHY.
mod phy_register {
    pub(super) const BASIC_CONTROL: u32 = 0;
    pub(super) const BASIC_STATUS: u32 = 1;
}

const BYTE_TEST: u32 = 0x8765_4321;
const SOFT_RESET: u32 = 1;
/// 5 KiB for frames to send, the rest of the 16 KiB for frames received.
const HW_CFG: u32 = 5 << 16 | 1 << 20;
/// Interrupt output: enabled, active high, push-pull.
const IRQ_CFG: u32 = 1 << 8 | 1 << 4 | 1;
/// Interrupt bits: a frame was received; there is room for a frame to send.
const RX_STATUS_LEVEL: u32 = 1 << 3;
const TX_DATA_LEVEL: u32 = 1 << 9;
/// Levels: more than 24 blocks of 64 bytes free to send, more than 0 frames received.
const FIFO_INT: u32 = 24 << 24;
const TX_ON: u32 = 1 << 1;
const MAC_RX_TX_FULL_DUPLEX: u32 = 1 << 2 | 1 << 3 | 1 << 20;
const MAC_BUSY: u32 = 1 << 31;
const MAC_READ: u32 = 1 << 30;
const MII_BUSY: u32 = 1;
const PHY_ADDRESS: u32 = 1 << 11;
const PHY_NEGOTIATE: u32 = 1 << 12 | 1 << 9;
const PHY_LINK_UP: u32 = 1 << 2;
const RX_ERROR: u32 = 1 << 15;
const TX_FIRST_AND_LAST: u32 = 1 << 13 | 1 << 12;

/// Bytes of the largest frame, without its checksum.
const MAX_FRAME: usize = 1514;
/// Bytes of the checksum that the controller leaves after a received frame.
const CHECKSUM: usize = 4;
/// Bytes of the TX FIFO that a frame takes in addition to its own: two commands, and padding to words.
const TX_OVERHEAD: usize = 8 + 3;
/// Number of polls of a register that is not ready, before the controller counts as defective.
const READY_POLLS: usize = 100_000;
/// The interval at which the driver reads the link state from the PHY.
const LINK_INTERVAL: Duration = Duration::from_millis(250);

/// The time without a received frame after which the controller is initialised again. A test has less time.
const AGAIN: Duration = Duration::from_secs(if cfg!(feature = "faults") { 3 } else { 30 });

/// The silence after which the watchdog resets the board. A test has less time.
pub const SILENCE: Duration = if cfg!(feature = "faults") { Duration::from_secs(10) } else { network::SILENCE };

static WAKER: AtomicWaker = AtomicWaker::new();
static RECEIVED: AtomicU32 = AtomicU32::new(0);
static SENT: AtomicU32 = AtomicU32::new(0);
static DROPPED: AtomicU32 = AtomicU32::new(0);
/// Number of times the controller was reinitialised.
static RESTARTS: AtomicU32 = AtomicU32::new(0);

/// Wakes the driver; the interrupt handler calls it.
pub(crate) fn wake() {
    WAKER.wake();
}

/// Why the controller cannot be used.
#[derive(Clone, Copy, Debug, PartialEq, Eq, defmt::Format)]
pub enum InitError {
    /// The byte test register has this value instead of 0x87654321; the device is not a LAN9118.
    NotFound(u32),
    /// A reset, or an access to the MAC or the PHY, did not complete.
    Stuck,
}

/// Counters of received, sent and dropped frames.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, defmt::Format)]
pub struct Counters {
    /// Frames received.
    pub received: u32,
    /// Frames sent.
    pub sent: u32,
    /// Frames dropped: damaged, too long, or overrun in the controller.
    pub dropped: u32,
    /// Number of times the controller was reinitialised because it received no frames.
    pub restarts: u32,
}

/// Returns the counters since the start.
#[must_use]
pub fn counters() -> Counters {
    Counters {
        received: RECEIVED.load(Ordering::Relaxed),
        sent: SENT.load(Ordering::Relaxed),
        dropped: DROPPED.load(Ordering::Relaxed),
        restarts: RESTARTS.load(Ordering::Relaxed),
    }
}

/// Switches the controller off; with `for_good` it stays off even when it is reinitialised.
#[cfg(feature = "faults")]
pub(crate) fn switch_off(for_good: bool) {
    STAYS_OFF.store(for_good, Ordering::Relaxed);
    // a controller that does not respond is off as well
    let _ = write_mac(mac::CR, 0);
}

#[cfg(feature = "faults")]
static STAYS_OFF: core::sync::atomic::AtomicBool = core::sync::atomic::AtomicBool::new(false);

/// Buffers for the last received frame and for the frame to send.
#[derive(Debug)]
pub struct Frames {
    received: [u8; MAX_FRAME],
    to_send: [u8; MAX_FRAME],
}

impl Frames {
    /// Creates empty buffers.
    #[must_use]
    pub const fn new() -> Self {
        Self { received: [0; MAX_FRAME], to_send: [0; MAX_FRAME] }
    }

    /// Reads a received frame of this many words; bytes of a frame that is too long are dropped.
    fn read(&mut self, words: usize) {
        let (whole, rest) = self.received.as_chunks_mut::<4>();
        let more = words.saturating_sub(whole.len());
        for word in whole.iter_mut().take(words) {
            *word = ETHERNET.read::<{ register::RX_DATA }>().to_le_bytes();
        }
        for word in 0..more {
            let bytes = ETHERNET.read::<{ register::RX_DATA }>().to_le_bytes();
            for (to, from) in rest.iter_mut().skip(word * 4).zip(bytes) {
                *to = from;
            }
        }
    }
}

impl Default for Frames {
    fn default() -> Self {
        Self::new()
    }
}

/// The controller; there can be only one.
#[derive(Debug)]
pub struct Lan9118<'m> {
    address: [u8; 6],
    frames: &'m mut Frames,
    link: PhyLink,
}

/// The link state that the PHY last reported, and since when no frame has been received over it.
#[derive(Debug)]
struct PhyLink {
    up: bool,
    checked_at: Option<Instant>,
    received: u32,
    silent_since: Instant,
}

impl<'m> Lan9118<'m> {
    /// Resets the controller and sets its MAC address.
    ///
    /// `None` means an address derived from that in the controller's EEPROM, the only unique id of this board.
    ///
    /// # Errors
    ///
    /// An [`InitError`] when the controller is missing or does not respond.
    pub fn new(address: Option<[u8; 6]>, frames: &'m mut Frames) -> Result<Self, InitError> {
        reset()?;
        let address = match address {
            Some(address) => address,
            None => from_unique_id(&factory_address()?),
        };
        let link = PhyLink { up: false, checked_at: None, received: 0, silent_since: Instant::MIN };
        let controller = Self { address, frames, link };
        controller.init()?;
        Ok(controller)
    }

    /// Resets the controller, sets its MAC address and enables it.
    fn init(&self) -> Result<(), InitError> {
        reset()?;
        ETHERNET.write::<{ register::HW_CFG }>(HW_CFG);

        let [a, b, c, d, e, f] = self.address;
        write_mac(mac::ADDR_LOW, u32::from_le_bytes([a, b, c, d]))?;
        write_mac(mac::ADDR_HIGH, u32::from_le_bytes([e, f, 0, 0]))?;
        write_phy(phy_register::BASIC_CONTROL, PHY_NEGOTIATE)?;
        write_mac(mac::CR, MAC_RX_TX_FULL_DUPLEX)?;
        ETHERNET.write::<{ register::TX_CFG }>(TX_ON);

        ETHERNET.write::<{ register::FIFO_INT }>(FIFO_INT);
        ETHERNET.write::<{ register::INT_STS }>(u32::MAX);
        ETHERNET.write::<{ register::IRQ_CFG }>(IRQ_CFG);
        ETHERNET.write::<{ register::INT_EN }>(RX_STATUS_LEVEL);
        #[cfg(feature = "faults")]
        if STAYS_OFF.load(Ordering::Relaxed) {
            write_mac(mac::CR, 0)?;
        }
        Ok(())
    }

    /// Reinitialises the controller if it has received no frame for too long while its link is up.
    fn check_silence(&mut self, now: Instant) {
        let received = RECEIVED.load(Ordering::Relaxed);
        if received != self.link.received || !self.link.up {
            self.link.received = received;
            self.link.silent_since = now;
        }
        if now < self.link.silent_since + AGAIN {
            return;
        }
        self.link.silent_since = now;
        RESTARTS.store(RESTARTS.load(Ordering::Relaxed).saturating_add(1), Ordering::Relaxed);
        // a controller that does not respond stays silent, which is counted
        let _ = self.init();
        board::unmask(board::ETHERNET_IRQ);
    }

    /// Returns the MAC address.
    #[must_use]
    pub const fn address(&self) -> [u8; 6] {
        self.address
    }

    /// Copies the next valid frame out of the controller and returns its length.
    fn take_frame(&mut self) -> Option<usize> {
        while frames_waiting() > 0 {
            let status = ETHERNET.read::<{ register::RX_STATUS }>();
            let with_checksum = to_usize(status >> 16 & 0x3fff);
            let len = with_checksum.saturating_sub(CHECKSUM);
            self.frames.read(with_checksum.div_ceil(4));
            if status & RX_ERROR == 0 && (1..=MAX_FRAME).contains(&len) {
                RECEIVED.fetch_add(1, Ordering::Relaxed);
                return Some(len);
            }
            DROPPED.fetch_add(1, Ordering::Relaxed);
        }
        None
    }

    /// Checks for a received frame; without one, registers the waker.
    fn poll_frame(&mut self, waker: &Waker) -> Option<usize> {
        if let Some(len) = self.take_frame() {
            return Some(len);
        }
        WAKER.register(waker);
        ETHERNET.write::<{ register::INT_STS }>(RX_STATUS_LEVEL);
        // the interrupt of the previous frame became pending again while it was masked
        board::unpend(board::ETHERNET_IRQ);
        // a frame that arrived before raises no interrupt
        let found = self.take_frame();
        board::unmask(board::ETHERNET_IRQ);
        found
    }

    /// Checks for room for a frame; without room, registers the waker.
    fn poll_room(&mut self, waker: &Waker) -> bool {
        if has_room() {
            return true;
        }
        WAKER.register(waker);
        ETHERNET.write::<{ register::INT_STS }>(TX_DATA_LEVEL);
        ETHERNET.write::<{ register::INT_EN }>(RX_STATUS_LEVEL | TX_DATA_LEVEL);
        let room = has_room();
        board::unmask(board::ETHERNET_IRQ);
        room
    }

    fn tokens(&mut self, received: usize) -> (RxToken<'_>, TxToken<'_>) {
        let Frames { received: frame, to_send } = &mut *self.frames;
        let frame = frame.get_mut(..received).unwrap_or_default();
        (RxToken { frame }, TxToken { frame: to_send })
    }

    fn tx_token(&mut self) -> TxToken<'_> {
        TxToken { frame: &mut self.frames.to_send }
    }
}

/// A received frame.
#[derive(Debug)]
pub struct RxToken<'a> {
    frame: &'a mut [u8],
}

/// Room for a frame to send.
#[derive(Debug)]
pub struct TxToken<'a> {
    frame: &'a mut [u8; MAX_FRAME],
}

impl TxToken<'_> {
    /// Lets `fill` write the frame, and sends it.
    fn send<R>(self, len: usize, fill: impl FnOnce(&mut [u8]) -> R) -> R {
        // both stacks limit the size of a frame; a longer frame would be truncated here and dropped by its receiver
        let frame = self.frame.get_mut(..len.min(MAX_FRAME)).unwrap_or_default();
        let result = fill(frame);
        discard_tx_status();
        let length = u32::try_from(frame.len()).unwrap_or_default();
        ETHERNET.write::<{ register::TX_DATA }>(TX_FIRST_AND_LAST | length);
        ETHERNET.write::<{ register::TX_DATA }>(length);
        let (whole, rest) = frame.as_chunks::<4>();
        for word in whole {
            ETHERNET.write::<{ register::TX_DATA }>(u32::from_le_bytes(*word));
        }
        if !rest.is_empty() {
            let mut word = [0; 4];
            for (to, from) in word.iter_mut().zip(rest) {
                *to = *from;
            }
            ETHERNET.write::<{ register::TX_DATA }>(u32::from_le_bytes(word));
        }
        SENT.fetch_add(1, Ordering::Relaxed);
        result
    }
}

impl embassy_net_driver::RxToken for RxToken<'_> {
    fn consume<R, F: FnOnce(&mut [u8]) -> R>(self, read: F) -> R {
        read(self.frame)
    }
}

impl embassy_net_driver::TxToken for TxToken<'_> {
    fn consume<R, F: FnOnce(&mut [u8]) -> R>(self, len: usize, fill: F) -> R {
        self.send(len, fill)
    }
}

impl phy::RxToken for RxToken<'_> {
    fn consume<R, F: FnOnce(&[u8]) -> R>(self, read: F) -> R {
        read(self.frame)
    }
}

impl phy::TxToken for TxToken<'_> {
    fn consume<R, F: FnOnce(&mut [u8]) -> R>(self, len: usize, fill: F) -> R {
        self.send(len, fill)
    }
}

impl Driver for Lan9118<'_> {
    type RxToken<'a>
        = RxToken<'a>
    where
        Self: 'a;
    type TxToken<'a>
        = TxToken<'a>
    where
        Self: 'a;

    fn receive(&mut self, cx: &mut Context<'_>) -> Option<(RxToken<'_>, TxToken<'_>)> {
        // a frame stays in the controller until there is room for an answer
        if !self.poll_room(cx.waker()) {
            return None;
        }
        let len = self.poll_frame(cx.waker())?;
        Some(self.tokens(len))
    }

    fn transmit(&mut self, cx: &mut Context<'_>) -> Option<TxToken<'_>> {
        self.poll_room(cx.waker()).then(|| self.tx_token())
    }

    fn link_state(&mut self, cx: &mut Context<'_>) -> LinkState {
        let now = Instant::now();
        if self.link.checked_at.is_none_or(|checked_at| now >= checked_at + LINK_INTERVAL) {
            self.link.checked_at = Some(now);
            self.link.up = is_link_up();
            DROPPED.fetch_add(ETHERNET.read::<{ register::RX_DROP }>(), Ordering::Relaxed);
            self.check_silence(now);
        }
        // the controller signals no change of the link, so the driver wakes itself to poll it
        embassy_time_driver::schedule_wake((now + LINK_INTERVAL).as_ticks(), cx.waker());
        if self.link.up { LinkState::Up } else { LinkState::Down }
    }

    fn capabilities(&self) -> Capabilities {
        let mut capabilities = Capabilities::default();
        capabilities.max_transmission_unit = MAX_FRAME;
        capabilities.max_burst_size = Some(1);
        capabilities
    }

    fn hardware_address(&self) -> HardwareAddress {
        HardwareAddress::Ethernet(self.address)
    }
}

impl Device for Lan9118<'_> {
    type RxToken<'a>
        = RxToken<'a>
    where
        Self: 'a;
    type TxToken<'a>
        = TxToken<'a>
    where
        Self: 'a;

    fn receive(&mut self, _: smoltcp::time::Instant) -> Option<(RxToken<'_>, TxToken<'_>)> {
        if !has_room() {
            return None;
        }
        let len = self.poll_frame(Waker::noop())?;
        Some(self.tokens(len))
    }

    fn transmit(&mut self, _: smoltcp::time::Instant) -> Option<TxToken<'_>> {
        has_room().then(|| self.tx_token())
    }

    fn capabilities(&self) -> DeviceCapabilities {
        let mut capabilities = DeviceCapabilities::default();
        capabilities.medium = Medium::Ethernet;
        capabilities.max_transmission_unit = MAX_FRAME;
        capabilities.max_burst_size = Some(1);
        capabilities
    }
}

fn frames_waiting() -> u32 {
    ETHERNET.read::<{ register::RX_FIFO_INF }>() >> 16 & 0xff
}

fn has_room() -> bool {
    to_usize(ETHERNET.read::<{ register::TX_FIFO_INF }>() & 0xffff) >= MAX_FRAME + TX_OVERHEAD
}

/// Discards the status words of sent frames; the controller stops sending when their FIFO is full.
fn discard_tx_status() {
    for _ in 0..ETHERNET.read::<{ register::TX_FIFO_INF }>() >> 16 & 0xff {
        let _ = ETHERNET.read::<{ register::TX_STATUS }>();
    }
}

/// Reads the link state from the PHY; a PHY that does not respond has no link.
fn is_link_up() -> bool {
    // the bit stays low after a failure until it is read, so it is read twice
    let _ = read_phy(phy_register::BASIC_STATUS);
    read_phy(phy_register::BASIC_STATUS).is_ok_and(|status| status & PHY_LINK_UP != 0)
}

fn read_phy(register: u32) -> Result<u32, InitError> {
    write_mac(mac::MII_ACC, PHY_ADDRESS | register << 6 | MII_BUSY)?;
    mii_ready()?;
    read_mac(mac::MII_DATA)
}

fn write_phy(register: u32, value: u32) -> Result<(), InitError> {
    write_mac(mac::MII_DATA, value)?;
    write_mac(mac::MII_ACC, PHY_ADDRESS | register << 6 | 1 << 1 | MII_BUSY)?;
    mii_ready()
}

fn mii_ready() -> Result<(), InitError> {
    for _ in 0..READY_POLLS {
        if read_mac(mac::MII_ACC)? & MII_BUSY == 0 {
            return Ok(());
        }
    }
    Err(InitError::Stuck)
}

/// Resets the controller, which then loads its factory address from its EEPROM.
fn reset() -> Result<(), InitError> {
    let found = ETHERNET.read::<{ register::BYTE_TEST }>();
    if found != BYTE_TEST {
        return Err(InitError::NotFound(found));
    }
    ETHERNET.write::<{ register::HW_CFG }>(SOFT_RESET);
    wait_until(|| ETHERNET.read::<{ register::HW_CFG }>() & SOFT_RESET == 0)
}

/// Returns the MAC address from the EEPROM; valid after a reset until another address is set.
fn factory_address() -> Result<[u8; 6], InitError> {
    let [a, b, c, d] = read_mac(mac::ADDR_LOW)?.to_le_bytes();
    let [e, f, ..] = read_mac(mac::ADDR_HIGH)?.to_le_bytes();
    Ok([a, b, c, d, e, f])
}

fn read_mac(register: u32) -> Result<u32, InitError> {
    ETHERNET.write::<{ register::MAC_CSR_CMD }>(MAC_BUSY | MAC_READ | register);
    mac_ready()?;
    Ok(ETHERNET.read::<{ register::MAC_CSR_DATA }>())
}

fn write_mac(register: u32, value: u32) -> Result<(), InitError> {
    ETHERNET.write::<{ register::MAC_CSR_DATA }>(value);
    ETHERNET.write::<{ register::MAC_CSR_CMD }>(MAC_BUSY | register);
    mac_ready()
}

fn mac_ready() -> Result<(), InitError> {
    wait_until(|| ETHERNET.read::<{ register::MAC_CSR_CMD }>() & MAC_BUSY == 0)
}

fn wait_until(mut done: impl FnMut() -> bool) -> Result<(), InitError> {
    (0..READY_POLLS).any(|_| done()).then_some(()).ok_or(InitError::Stuck)
}

/// Converts a `u32` without loss, because `usize` has 32 bits on the board.
const fn to_usize(n: u32) -> usize {
    n as usize
}
