//! A controller with one number, on one of two stacks.

use bcap_core::bcap::{self, FunctionId};
use bcap_core::handler::{Outcome, PeerId, ReplyValue};
use bcap_core::hresult::HResult;
use bcap_core::rac::{self, Request, VariableKind};
use bcap_core::time::Instant;
use bcap_core::variant::Variant;
use bcap_embassy::server::{Limits, Listener, SharedHandler, UdpPeer, UdpServer};
pub(crate) use bcap_test_support::stacks::{address, between};
use embassy_net::Stack;
use embassy_net::tcp::TcpSocket;
use embassy_net::udp::{PacketMetadata, UdpSocket};
use embassy_sync::blocking_mutex::raw::NoopRawMutex;
use embassy_time::Timer;

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
