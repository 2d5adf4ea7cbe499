//! Two embassy-net stacks connected by a simulated cable, and a controller with one number.

use std::cell::RefCell;
use std::collections::VecDeque;
use std::rc::Rc;
use std::task::{Context, Waker};

use bcap_core::bcap::{self, FunctionId};
use bcap_core::handler::{Outcome, PeerId, ReplyValue};
use bcap_core::hresult::HResult;
use bcap_core::rac::{self, Request, VariableKind};
use bcap_core::time::Instant;
use bcap_core::variant::Variant;
use bcap_embassy::server::{Limits, Listener, SharedHandler, UdpPeer, UdpServer};
use embassy_futures::select::{Either3, select3};
use embassy_net::tcp::TcpSocket;
use embassy_net::udp::{PacketMetadata, UdpSocket};
use embassy_net::{Config, Ipv4Address, Ipv4Cidr, Stack, StackResources, StaticConfigV4};
use embassy_net_driver::{Capabilities, Driver, HardwareAddress, LinkState};
use embassy_sync::blocking_mutex::raw::NoopRawMutex;
use embassy_time::Timer;

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

#[derive(Clone, Default)]
pub(crate) struct Cable(Rc<RefCell<Wire>>);

impl Cable {
    /// Unplugs the cable, or plugs it in.
    pub(crate) fn cut(&self, cut: bool) {
        let mut wire = self.0.borrow_mut();
        wire.cut = cut;
        wire.frames.iter_mut().for_each(VecDeque::clear);
        wire.wakers.iter().flatten().for_each(Waker::wake_by_ref);
    }

    /// Puts a frame on its way to an end.
    pub(crate) fn send(&self, to: usize, frame: Vec<u8>) {
        let mut wire = self.0.borrow_mut();
        wire.frames[to].push_back(frame);
        wire.wakers.iter().flatten().for_each(Waker::wake_by_ref);
    }

    /// Loses every `nth` frame from now on.
    pub(crate) fn lose(&self, nth: usize) {
        self.0.borrow_mut().lose = nth;
    }
}

pub(crate) struct End {
    cable: Cable,
    side: usize,
}

pub(crate) struct Frame(Vec<u8>);

pub(crate) struct Slot {
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
pub(crate) const fn address(side: u8) -> Ipv4Address {
    Ipv4Address::new(192, 168, 69, 1 + side)
}

/// Runs a test between the client's and the server's stack.
pub(crate) fn between<F: Future<Output = ()>>(test: impl FnOnce(Cable, Stack<'static>, Stack<'static>) -> F) {
    between_addresses([address(0), address(1)].map(|address| Ipv4Cidr::new(address, 24)), test);
}

/// Runs a test between the client's and the server's stack, which have these addresses.
pub(crate) fn between_addresses<F: Future<Output = ()>>(
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

/// A controller with one number, which is variable I1 of RAC and handle 7 of b-CAP; I2 waits until the number is set.
#[derive(Debug, Default)]
pub(crate) struct Number {
    pub(crate) value: i32,
    pub(crate) left: usize,
}

impl bcap::server::Handler for Number {
    fn call(
        &mut self,
        _: PeerId,
        request: &bcap::server::Request<'_>,
        reply: &mut ReplyValue<'_>,
        _: Instant,
    ) -> Outcome {
        let set = match request.function {
            FunctionId::CONTROLLER_CONNECT => reply.set(&1),
            FunctionId::CONTROLLER_GET_VARIABLE => reply.set(&7),
            FunctionId::CONTROLLER_GET_ROBOT => reply.set(&8),
            // slvGetMode: no stream runs
            FunctionId::ROBOT_EXECUTE => reply.set(&0),
            FunctionId::VARIABLE_GET_VALUE => reply.set(&self.value),
            FunctionId::VARIABLE_PUT_VALUE => {
                self.value = request.int(1);
                Ok(())
            }
            _ => Ok(()),
        };
        set.map_or(HResult::E_FAIL, |()| HResult::S_OK).into()
    }

    fn left(&mut self, _: PeerId, _: Instant) {
        self.left += 1;
    }
}

impl rac::server::Handler for Number {
    fn call(&mut self, _: PeerId, request: &Request<'_>, reply: &mut ReplyValue<'_>, _: Instant) -> Outcome {
        let result = match *request {
            Request::Get(variable) if variable.kind == VariableKind::I => match variable.index {
                2 if self.value == 0 => return Outcome::Wait(Instant::FAR_FUTURE),
                1 | 2 => reply.set(&self.value).map_or(HResult::E_FAIL, |()| HResult::S_OK),
                _ => HResult::E_INVALIDARG,
            },
            Request::Put(_, Variant::I4(value)) => {
                self.value = value;
                HResult::S_OK
            }
            _ => HResult::E_INVALIDARG,
        };
        result.into()
    }

    fn left(&mut self, _: PeerId, _: Instant) {
        self.left += 1;
    }
}

/// The controller, shared by its connections.
pub(crate) type Controller = SharedHandler<NoopRawMutex, Number, 4>;

pub(crate) fn number(value: i32) -> Controller {
    SharedHandler::new(Number { value, left: 0 })
}

/// Serves b-CAP over TCP on port 5007 forever, one connection at a time.
pub(crate) async fn serve(stack: Stack<'_>, number: &Controller, limits: Limits) {
    let (mut rx, mut tx) = ([0; 512], [0; 512]);
    let mut slot = None;
    let make = || bcap::server::Session::<_, _, 8>::new(bcap::server::Config::TCP, [0; 512], [0; 512]);
    Listener::new(stack, 5007, &mut rx, &mut tx).run(&mut slot, make, number, &limits).await
}

/// Serves b-CAP over UDP on port 5007 forever, two peers.
pub(crate) async fn serve_udp(stack: Stack<'_>, number: &Controller) {
    let (mut metas, mut buffers) = ([[PacketMetadata::EMPTY; 4]; 2], [[0; 2048]; 2]);
    let ([rx_meta, tx_meta], [rx, tx]) = (&mut metas, &mut buffers);
    let mut socket = UdpSocket::new(stack, rx_meta, rx, tx_meta, tx);
    socket.bind(5007).unwrap();
    let mut peers: [Option<UdpPeer<8>>; 2] = [None, None];
    UdpServer::new(&mut socket, &mut peers, number, Limits::default()).run().await
}

/// Connects to a port of the server's stack, retrying until it has a free slot.
pub(crate) async fn dial<'s>(stack: Stack<'s>, memory: &'s mut [[u8; 512]; 2], port: u16) -> TcpSocket<'s> {
    let [rx, tx] = memory;
    let mut socket = TcpSocket::new(stack, rx, tx);
    while socket.connect((address(1), port)).await.is_err() {
        Timer::after_millis(1).await;
    }
    socket
}

/// Sends a line of RAC and returns the answer.
pub(crate) async fn ask(socket: &mut TcpSocket<'_>, line: &str) -> String {
    let mut sent = 0;
    while sent < line.len() {
        sent += socket.write(&line.as_bytes()[sent..]).await.unwrap();
    }
    let mut reply = Vec::new();
    while reply.last() != Some(&b'\r') {
        // byte by byte, so that bytes after the line stay for the next read
        let mut byte = [0];
        assert_eq!(socket.read(&mut byte).await, Ok(1), "closed after {reply:?}");
        reply.extend(byte);
    }
    String::from_utf8(reply).unwrap()
}
