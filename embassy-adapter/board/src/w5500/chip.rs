//! The registers of the chip. Its socket 0 has all of its memory, and exchanges Ethernet frames (MACRAW). Names and numbers are
//! those of the data sheet.

use embassy_time::{Duration, Timer};
use embedded_hal_async::spi::{Operation, SpiDevice};

/// Bytes of the largest frame, without its checksum.
pub(super) const MAX_FRAME: usize = 1514;
/// Bytes of the header of Ethernet, the least of a frame.
const MIN_FRAME: usize = 14;
/// Bytes of the largest frame that another network may have: with two VLAN tags.
const MAX_TAGGED: usize = MAX_FRAME + 8;
/// Bytes of the length before each received frame. It is a part of the length.
const LENGTH: usize = 2;
/// Bytes of the memory for received frames, and of the memory for frames to send.
const MEMORY: u16 = MEMORY_KIB as u16 * 1024;
const MEMORY_KIB: u8 = 16;
const SOCKETS: u8 = 8;

/// A register, or a place in a memory: the block in the control byte of SPI, and the address.
#[derive(Clone, Copy)]
struct Place(u8, u16);

const fn common(address: u16) -> Place {
    Place(0, address)
}

const fn socket(number: u8, address: u16) -> Place {
    Place(number << 2 | 1, address)
}

const MR: Place = common(0x00);
const SHAR: Place = common(0x09);
const SIMR: Place = common(0x18);
const PHYCFGR: Place = common(0x2e);
const VERSIONR: Place = common(0x39);
const SN_MR: Place = socket(0, 0x00);
const SN_CR: Place = socket(0, 0x01);
const SN_IR: Place = socket(0, 0x02);
const SN_SR: Place = socket(0, 0x03);
const SN_RXBUF_SIZE: u16 = 0x1e;
const SN_TX_FSR: Place = socket(0, 0x20);
const SN_TX_WR: Place = socket(0, 0x24);
/// Followed by `Sn_RX_RD`.
const SN_RX_RSR: Place = socket(0, 0x26);
const SN_RX_RD: Place = socket(0, 0x28);
const SN_IMR: Place = socket(0, 0x2c);
const TX_MEMORY: u8 = 2;
const RX_MEMORY: u8 = 3;

/// The bit of the control byte that writes.
const WRITE: u8 = 4;
const RESET: u8 = 0x80;
const VERSION: u8 = 4;
const LINK_UP: u8 = 1;
/// Frames for this MAC address, broadcasts and multicasts.
const MACRAW_FILTERED: u8 = 0x84;
const SOCK_MACRAW: u8 = 0x42;
const OPEN: u8 = 0x01;
const CLOSE: u8 = 0x10;
const SEND: u8 = 0x20;
const RECV: u8 = 0x40;
/// The interrupt of a received frame.
const RECEIVED: u8 = 0x04;

/// Number of reads of a register that should change immediately, before the chip counts as stuck.
const POLLS: u32 = 32;
/// The same for a frame that is being sent, once in a millisecond: a frame takes 1.2 ms at 10 Mbit/s.
const SLOW_POLLS: u32 = 50;

/// Why the chip cannot be used.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Error<E> {
    /// The bus failed.
    Spi(E),
    /// The version register has this value instead of 4: there is no W5500, or it is wired wrongly.
    Version(u8),
    /// A command, or a frame to send, did not complete.
    Stuck,
}

/// A finding in the chip.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Received {
    /// A frame of this length.
    Frame(usize),
    /// A frame that was too long, or a damaged length.
    Dropped,
    Nothing,
}

/// The chip at its bus.
#[derive(Debug)]
pub(super) struct Chip<S> {
    spi: S,
    address: [u8; 6],
}

impl<S: SpiDevice> Chip<S> {
    pub(super) fn new(spi: S, address: [u8; 6]) -> Self {
        Self { spi, address }
    }

    /// Resets the registers and opens the socket.
    pub(super) async fn init(&mut self) -> Result<(), Error<S::Error>> {
        self.write(MR, &[RESET]).await?;
        self.until(MR, 0).await?;
        let version = self.read_byte(VERSIONR).await?;
        if version != VERSION {
            return Err(Error::Version(version));
        }
        // the socket is opened last, because `check` takes an open one as a sign of all registers
        let address = self.address;
        self.write(SHAR, &address).await?;
        for number in 0..SOCKETS {
            // for received frames, and for frames to send
            let size = if number == 0 { MEMORY_KIB } else { 0 };
            self.write(socket(number, SN_RXBUF_SIZE), &[size; 2]).await?;
        }
        self.write(SN_IMR, &[RECEIVED]).await?;
        self.write(SIMR, &[1]).await?;
        self.open().await
    }

    /// Opens the socket, also again; frames in it are lost.
    async fn open(&mut self) -> Result<(), Error<S::Error>> {
        self.command(CLOSE).await?;
        self.write(SN_MR, &[MACRAW_FILTERED]).await?;
        self.command(OPEN).await?;
        self.until(SN_SR, SOCK_MACRAW).await
    }

    /// Returns whether the link is up; initialises a chip that has lost its registers, or whose last initialisation failed.
    pub(super) async fn check(&mut self) -> Result<bool, Error<S::Error>> {
        if self.read_byte(SN_SR).await? != SOCK_MACRAW {
            self.init().await?;
        }
        Ok(self.read_byte(PHYCFGR).await? & LINK_UP != 0)
    }

    /// Reads a received frame. Clears the interrupt if the chip has no frame.
    pub(super) async fn receive(&mut self, frame: &mut [u8]) -> Result<Received, Error<S::Error>> {
        let (mut size, mut from) = self.received().await?;
        if size == 0 {
            // cleared before the next check, so that a frame after that check sets it again
            self.write(SN_IR, &[RECEIVED]).await?;
            (size, from) = self.received().await?;
        }
        if size == 0 {
            return Ok(Received::Nothing);
        }
        let mut length = [0; LENGTH];
        self.read(Place(RX_MEMORY, from), &mut length).await?;
        let stored = u16::from_be_bytes(length);
        let len = usize::from(stored).saturating_sub(LENGTH);
        if stored > size || !(MIN_FRAME..=MAX_TAGGED).contains(&len) {
            self.open().await?;
            return Ok(Received::Dropped);
        }
        let found = match frame.get_mut(..len) {
            Some(frame) => {
                self.read(Place(RX_MEMORY, from.wrapping_add(2)), frame).await?;
                Received::Frame(len)
            }
            None => Received::Dropped,
        };
        self.write(SN_RX_RD, &from.wrapping_add(stored).to_be_bytes()).await?;
        self.command(RECV).await?;
        Ok(found)
    }

    /// Sends a frame.
    pub(super) async fn send(&mut self, frame: &[u8]) -> Result<(), Error<S::Error>> {
        if !self.has_sent().await? {
            self.open().await?;
            return Err(Error::Stuck);
        }
        let to = self.read_word(SN_TX_WR).await?;
        self.write(Place(TX_MEMORY, to), frame).await?;
        // a frame has at most `MAX_FRAME` bytes
        self.write(SN_TX_WR, &to.wrapping_add(frame.len() as u16).to_be_bytes()).await?;
        self.command(SEND).await
    }

    /// Waits until the frame before has left; usually it has.
    async fn has_sent(&mut self) -> Result<bool, Error<S::Error>> {
        for poll in 0..POLLS + SLOW_POLLS {
            if poll >= POLLS {
                Timer::after(Duration::from_millis(1)).await;
            }
            if self.read_word(SN_TX_FSR).await? == MEMORY {
                return Ok(true);
            }
        }
        Ok(false)
    }

    /// Returns the bytes in the memory, and where they begin. They are read until two reads are equal, because they may change
    /// in the middle of one.
    async fn received(&mut self) -> Result<(u16, u16), Error<S::Error>> {
        let mut last = [0; 4];
        self.read(SN_RX_RSR, &mut last).await?;
        for _ in 0..POLLS {
            let mut again = [0; 4];
            self.read(SN_RX_RSR, &mut again).await?;
            if again == last {
                break;
            }
            last = again;
        }
        let [a, b, c, d] = last;
        Ok((u16::from_be_bytes([a, b]), u16::from_be_bytes([c, d])))
    }

    /// Gives a command, and waits until the chip has taken it.
    async fn command(&mut self, command: u8) -> Result<(), Error<S::Error>> {
        self.write(SN_CR, &[command]).await?;
        self.until(SN_CR, 0).await
    }

    /// Waits until a register has a value.
    async fn until(&mut self, place: Place, value: u8) -> Result<(), Error<S::Error>> {
        for _ in 0..POLLS {
            if self.read_byte(place).await? == value {
                return Ok(());
            }
        }
        Err(Error::Stuck)
    }

    async fn read_byte(&mut self, place: Place) -> Result<u8, Error<S::Error>> {
        let mut byte = [0];
        self.read(place, &mut byte).await?;
        Ok(byte[0])
    }

    async fn read_word(&mut self, place: Place) -> Result<u16, Error<S::Error>> {
        let mut word = [0; 2];
        self.read(place, &mut word).await?;
        Ok(u16::from_be_bytes(word))
    }

    async fn read(&mut self, Place(block, address): Place, data: &mut [u8]) -> Result<(), Error<S::Error>> {
        let [high, low] = address.to_be_bytes();
        let header = [high, low, block << 3];
        self.spi.transaction(&mut [Operation::Write(&header), Operation::Read(data)]).await.map_err(Error::Spi)
    }

    async fn write(&mut self, Place(block, address): Place, data: &[u8]) -> Result<(), Error<S::Error>> {
        let [high, low] = address.to_be_bytes();
        let header = [high, low, block << 3 | WRITE];
        self.spi.transaction(&mut [Operation::Write(&header), Operation::Write(data)]).await.map_err(Error::Spi)
    }
}
