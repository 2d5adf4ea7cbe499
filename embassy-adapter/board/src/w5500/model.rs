//! A model of the chip, with its pins and its faults.

use core::cell::RefCell;
use core::convert::Infallible;
use core::future::poll_fn;
use core::task::Poll;
use std::collections::VecDeque;
use std::rc::Rc;
use std::vec;
use std::vec::Vec;

use embedded_hal::digital::{self, OutputPin};
use embedded_hal::spi::{self, ErrorKind, Operation};
use embedded_hal_async::digital::Wait;
use embedded_hal_async::spi::SpiDevice;

const MEMORY: usize = 16 * 1024;
/// Where the memories begin after the socket is opened, so that the position and the memory soon wrap.
const START: u16 = 0xfff0;

const MR: u16 = 0x00;
const SIMR: u16 = 0x18;
const PHYCFGR: u16 = 0x2e;
const VERSIONR: u16 = 0x39;
const SN_MR: u16 = 0x00;
const SN_CR: u16 = 0x01;
const SN_IR: u16 = 0x02;
const SN_SR: u16 = 0x03;
const SN_RXBUF_SIZE: u16 = 0x1e;
const SN_TX_FSR: u16 = 0x20;
const SN_TX_RD: u16 = 0x22;
const SN_TX_WR: u16 = 0x24;
const SN_RX_RSR: u16 = 0x26;
const SN_RX_RD: u16 = 0x28;
const SN_RX_WR: u16 = 0x2a;
const SN_IMR: u16 = 0x2c;

/// The faults of a chip and its wires.
#[derive(Default)]
pub(super) struct Faults {
    /// The pin INTn is not connected.
    pub(super) has_no_interrupt: bool,
    /// The pin INTn is at ground.
    pub(super) has_shorted_interrupt: bool,
    pub(super) bus_fails: bool,
    /// Frames to send stay in the memory.
    pub(super) sends_nothing: bool,
    /// The next reads of the received bytes are of a register that changes.
    pub(super) torn_reads: VecDeque<u16>,
}

/// The chip.
pub(super) struct Model {
    pub(super) common: [u8; 0x40],
    sockets: [[u8; 0x30]; 8],
    tx: Vec<u8>,
    rx: Vec<u8>,
    pub(super) sent: Vec<Vec<u8>>,
    /// Number of times the socket was opened, and of transfers over the bus.
    pub(super) opened: u32,
    pub(super) transfers: u32,
    pub(super) faults: Faults,
    is_link_up: bool,
    pub(super) version: u8,
}

impl Model {
    pub(super) fn shared() -> Shared {
        let mut model = Self {
            common: [0; 0x40],
            sockets: [[0; 0x30]; 8],
            tx: vec![0; MEMORY],
            rx: vec![0; MEMORY],
            sent: Vec::new(),
            opened: 0,
            transfers: 0,
            faults: Faults::default(),
            is_link_up: true,
            version: 4,
        };
        model.reset();
        Shared(Rc::new(RefCell::new(model)))
    }

    /// Resets the registers, as a dip of the supply does.
    pub(super) fn reset(&mut self) {
        (self.common, self.sockets) = ([0; 0x40], [[0; 0x30]; 8]);
        self.common[usize::from(VERSIONR)] = self.version;
        for socket in &mut self.sockets {
            socket[usize::from(SN_RXBUF_SIZE)..][..2].fill(2);
        }
        self.set_link(self.is_link_up);
    }

    pub(super) fn set_link(&mut self, is_up: bool) {
        self.is_link_up = is_up;
        self.common[usize::from(PHYCFGR)] = 0xbe | u8::from(is_up);
    }

    fn word(&self, address: u16) -> u16 {
        u16::from_be_bytes(self.sockets[0][usize::from(address)..][..2].try_into().unwrap())
    }

    fn set_word(&mut self, address: u16, value: u16) {
        self.sockets[0][usize::from(address)..][..2].copy_from_slice(&value.to_be_bytes());
    }

    /// Returns the bytes that were received and not read.
    pub(super) fn unread(&self) -> u16 {
        self.word(SN_RX_WR).wrapping_sub(self.word(SN_RX_RD))
    }

    /// A frame from the network; one that does not fit is dropped. Returns whether it fitted.
    pub(super) fn receive(&mut self, frame: &[u8]) -> bool {
        self.receive_with_length(u16::try_from(frame.len() + 2).unwrap(), frame)
    }

    /// The same, with another length before it.
    pub(super) fn receive_with_length(&mut self, length: u16, frame: &[u8]) -> bool {
        let fits = usize::from(self.unread()) + frame.len() + 2 <= MEMORY;
        if !fits || self.sockets[0][usize::from(SN_SR)] != 0x42 {
            return false;
        }
        // one interrupt for all frames until it is cleared
        self.sockets[0][usize::from(SN_IR)] |= 4;
        for byte in length.to_be_bytes().iter().chain(frame) {
            let at = self.word(SN_RX_WR);
            self.rx[usize::from(at) % MEMORY] = *byte;
            self.set_word(SN_RX_WR, at.wrapping_add(1));
        }
        true
    }

    fn command(&mut self, command: u8) {
        match command {
            0x01 => {
                // the sizes of the memories of all sockets have a sum of 16 KiB
                let sizes = self.sockets.map(|socket| u32::from(socket[usize::from(SN_RXBUF_SIZE)]));
                assert_eq!(sizes, [16, 0, 0, 0, 0, 0, 0, 0]);
                assert_eq!(self.sockets[0][usize::from(SN_MR)], 0x84, "MACRAW with the filter of addresses");
                self.sockets[0][usize::from(SN_SR)] = 0x42;
                for pointer in [SN_TX_RD, SN_TX_WR, SN_RX_RD, SN_RX_WR] {
                    self.set_word(pointer, START);
                }
                self.opened += 1;
            }
            0x10 => self.sockets[0][usize::from(SN_SR)] = 0,
            0x20 if !self.faults.sends_nothing => {
                let (from, to) = (self.word(SN_TX_RD), self.word(SN_TX_WR));
                let frame = (0..to.wrapping_sub(from)).map(|at| self.tx[usize::from(from.wrapping_add(at)) % MEMORY]);
                self.sent.push(frame.collect());
                self.set_word(SN_TX_RD, to);
            }
            0x20 | 0x40 => {}
            _ => panic!("the command {command:#x}"),
        }
    }

    fn interrupt_is_low(&self) -> bool {
        let socket = &self.sockets[0];
        let is_set =
            socket[usize::from(SN_IR)] & socket[usize::from(SN_IMR)] != 0 && self.common[usize::from(SIMR)] & 1 != 0;
        self.faults.has_shorted_interrupt || is_set && !self.faults.has_no_interrupt
    }

    fn read(&mut self, block: u8, address: u16) -> u8 {
        let free = MEMORY as u16 - self.word(SN_TX_WR).wrapping_sub(self.word(SN_TX_RD));
        self.set_word(SN_TX_FSR, free);
        self.set_word(SN_RX_RSR, self.unread());
        match block {
            0 => self.common[usize::from(address)],
            2 => self.tx[usize::from(address) % MEMORY],
            3 => self.rx[usize::from(address) % MEMORY],
            _ => self.sockets[usize::from(block / 4)][usize::from(address)],
        }
    }

    fn write(&mut self, block: u8, address: u16, byte: u8) {
        match (block, address) {
            (0, MR) if byte & 0x80 != 0 => self.reset(),
            (0, _) => self.common[usize::from(address)] = byte,
            (1, SN_CR) => self.command(byte),
            (1, SN_IR) => self.sockets[0][usize::from(SN_IR)] &= !byte,
            (2, _) => self.tx[usize::from(address) % MEMORY] = byte,
            (3, _) => panic!("a write to the memory of received frames"),
            _ => self.sockets[usize::from(block / 4)][usize::from(address)] = byte,
        }
    }

    fn transfer(&mut self, operations: &mut [Operation<'_, u8>]) -> Result<(), ErrorKind> {
        self.transfers += 1;
        if self.faults.bus_fails {
            return Err(ErrorKind::Other);
        }
        let [Operation::Write(header), data] = operations else { panic!("{operations:?}") };
        let [high, low, control] = **header else { panic!("{header:?}") };
        let addresses = (0_u16..).map(|at| u16::from_be_bytes([high, low]).wrapping_add(at));
        match data {
            Operation::Read(bytes) => {
                assert_eq!(control & 7, 0);
                for (byte, address) in bytes.iter_mut().zip(addresses) {
                    *byte = self.read(control >> 3, address);
                }
                if (control >> 3, u16::from_be_bytes([high, low])) == (1, SN_RX_RSR)
                    && let Some(torn) = self.faults.torn_reads.pop_front()
                {
                    bytes[..2].copy_from_slice(&torn.to_be_bytes());
                }
            }
            Operation::Write(bytes) => {
                assert_eq!(control & 7, 4);
                bytes.iter().zip(addresses).for_each(|(byte, address)| self.write(control >> 3, address, *byte));
            }
            other => panic!("{other:?}"),
        }
        Ok(())
    }
}

/// The chip, for its bus, its pins and the test.
#[derive(Clone)]
pub(super) struct Shared(pub(super) Rc<RefCell<Model>>);

impl spi::ErrorType for Shared {
    type Error = ErrorKind;
}

impl SpiDevice for Shared {
    async fn transaction(&mut self, operations: &mut [Operation<'_, u8>]) -> Result<(), ErrorKind> {
        // a transfer takes time, in which other futures run
        embassy_futures::yield_now().await;
        self.0.borrow_mut().transfer(operations)
    }
}

impl digital::ErrorType for Shared {
    type Error = Infallible;
}

impl OutputPin for Shared {
    fn set_low(&mut self) -> Result<(), Infallible> {
        self.0.borrow_mut().reset();
        Ok(())
    }

    fn set_high(&mut self) -> Result<(), Infallible> {
        Ok(())
    }
}

impl Wait for Shared {
    async fn wait_for_low(&mut self) -> Result<(), Infallible> {
        // `block_on` polls without a waker
        poll_fn(|_| if self.0.borrow().interrupt_is_low() { Poll::Ready(Ok(())) } else { Poll::Pending }).await
    }

    async fn wait_for_high(&mut self) -> Result<(), Infallible> {
        panic!("the pin is low while frames are in the chip")
    }

    async fn wait_for_rising_edge(&mut self) -> Result<(), Infallible> {
        self.wait_for_high().await
    }

    async fn wait_for_falling_edge(&mut self) -> Result<(), Infallible> {
        self.wait_for_high().await
    }

    async fn wait_for_any_edge(&mut self) -> Result<(), Infallible> {
        self.wait_for_high().await
    }
}
