//! Two stacks of embassy-net that a cable in memory connects.

use std::cell::RefCell;
use std::collections::VecDeque;
use std::rc::Rc;
use std::task::{Context, Waker};

use embassy_futures::select::{Either3, select3};
use embassy_net::{Config, Ipv4Address, Ipv4Cidr, Stack, StackResources, StaticConfigV4};
use embassy_net_driver::{Capabilities, Driver, HardwareAddress, LinkState};

const MTU: usize = 1514;

/// The state of the cable: the frames to each end, and whether it is unplugged.
#[derive(Default)]
struct Wire {
    frames: [VecDeque<Vec<u8>>; 2],
    wakers: [Option<Waker>; 2],
    cut: bool,
    /// Loses every `lose`-th frame; 0 loses none.
    lose: usize,
    sent: usize,
}

/// A cable in memory.
#[derive(Clone, Default)]
pub struct Cable(Rc<RefCell<Wire>>);

impl Cable {
    /// Unplugs the cable, or plugs it in.
    pub fn cut(&self, cut: bool) {
        let mut wire = self.0.borrow_mut();
        wire.cut = cut;
        wire.frames.iter_mut().for_each(VecDeque::clear);
        wire.wakers.iter().flatten().for_each(Waker::wake_by_ref);
    }

    /// Puts a frame on its way to an end.
    pub fn send(&self, to: usize, frame: Vec<u8>) {
        let mut wire = self.0.borrow_mut();
        wire.frames[to].push_back(frame);
        wire.wakers.iter().flatten().for_each(Waker::wake_by_ref);
    }

    /// Loses every `nth` frame from now on.
    pub fn lose(&self, nth: usize) {
        self.0.borrow_mut().lose = nth;
    }
}

struct End {
    cable: Cable,
    side: usize,
}

struct Frame(Vec<u8>);

struct Slot {
    cable: Cable,
    to: usize,
}

impl embassy_net_driver::RxToken for Frame {
    fn consume<R, F: FnOnce(&mut [u8]) -> R>(mut self, read: F) -> R {
        read(&mut self.0)
    }
}

impl embassy_net_driver::TxToken for Slot {
    fn consume<R, F: FnOnce(&mut [u8]) -> R>(self, len: usize, fill: F) -> R {
        let mut frame = vec![0; len];
        let result = fill(&mut frame);
        let mut wire = self.cable.0.borrow_mut();
        wire.sent += 1;
        let lost = wire.cut || wire.lose > 0 && wire.sent.is_multiple_of(wire.lose);
        if !lost {
            wire.frames[self.to].push_back(frame);
            if let Some(waker) = wire.wakers[self.to].take() {
                waker.wake();
            }
        }
        result
    }
}

impl Driver for End {
    type RxToken<'a> = Frame;
    type TxToken<'a> = Slot;

    fn receive(&mut self, cx: &mut Context<'_>) -> Option<(Frame, Slot)> {
        let mut wire = self.cable.0.borrow_mut();
        let frame = wire.frames[self.side].pop_front();
        wire.wakers[self.side] = Some(cx.waker().clone());
        drop(wire);
        Some((Frame(frame?), Slot { cable: self.cable.clone(), to: 1 - self.side }))
    }

    fn transmit(&mut self, _: &mut Context<'_>) -> Option<Slot> {
        Some(Slot { cable: self.cable.clone(), to: 1 - self.side })
    }

    fn link_state(&mut self, cx: &mut Context<'_>) -> LinkState {
        let mut wire = self.cable.0.borrow_mut();
        wire.wakers[self.side] = Some(cx.waker().clone());
        if wire.cut { LinkState::Down } else { LinkState::Up }
    }

    fn capabilities(&self) -> Capabilities {
        let mut capabilities = Capabilities::default();
        capabilities.max_transmission_unit = MTU;
        capabilities
    }

    fn hardware_address(&self) -> HardwareAddress {
        HardwareAddress::Ethernet([2, 0, 0, 0, 0, u8::try_from(self.side).unwrap_or(0)])
    }
}

/// The address of an end of the cable.
pub const fn address(side: u8) -> Ipv4Address {
    Ipv4Address::new(192, 168, 69, 1 + side)
}

/// Runs a test between the client's and the server's stack.
pub fn between<F: Future<Output = ()>>(test: impl FnOnce(Cable, Stack<'static>, Stack<'static>) -> F) {
    between_addresses([address(0), address(1)].map(|address| Ipv4Cidr::new(address, 24)), test);
}

/// Runs a test between the client's and the server's stack, which have these addresses.
pub fn between_addresses<F: Future<Output = ()>>(
    addresses: [Ipv4Cidr; 2],
    test: impl FnOnce(Cable, Stack<'static>, Stack<'static>) -> F,
) {
    let cable = Cable::default();
    let make = |side: u8| {
        let resources = Box::leak(Box::new(StackResources::<8>::new()));
        let config = Config::ipv4_static(StaticConfigV4 {
            address: addresses[usize::from(side)],
            gateway: None,
            dns_servers: Default::default(),
        });
        let end = End { cable: cable.clone(), side: usize::from(side) };
        embassy_net::new(end, config, resources, 0x5eed + u64::from(side))
    };
    let ((client, mut client_runner), (server, mut server_runner)) = (make(0), make(1));
    let work = test(cable.clone(), client, server);
    let done = select3(client_runner.run(), server_runner.run(), work);
    assert!(matches!(embassy_futures::block_on(done), Either3::Third(())));
}
