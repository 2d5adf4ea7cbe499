//! A board that serves its two inputs over RAC and over b-CAP on TCP, UDP and a serial line.
#![no_std]

use bcap_core::bcap::{self, FunctionId, server as bcap_server};
use bcap_core::handler::{Outcome, PeerId, ReplyValue};
use bcap_core::hresult::HResult;
use bcap_core::io::asynch::Timed;
use bcap_core::rac::{self, Request, Variable, VariableKind, server as rac_server};
use bcap_core::time::Instant;
use bcap_embassy::clock::EmbassyClock;
use bcap_embassy::server::{Limits, Listener, SharedHandler, UdpPeer, UdpServer, serve};
use embassy_net::Stack;
use embassy_net::udp::{PacketMetadata, UdpSocket};
use embassy_sync::blocking_mutex::raw::NoopRawMutex;
use embedded_io_async::{Read, Write};

/// The state of the inputs; the task that reads the pins calls [`SharedHandler::update`].
#[derive(Debug, Default)]
pub struct Inputs(pub [bool; 2]);

impl Inputs {
    fn get(&self, index: usize, reply: &mut ReplyValue<'_>) -> HResult {
        match self.0.get(index) {
            Some(level) if reply.set(level).is_ok() => HResult::S_OK,
            _ => HResult::E_INVALIDARG,
        }
    }
}

impl rac_server::Handler for Inputs {
    fn call(&mut self, _: PeerId, request: &Request<'_>, reply: &mut ReplyValue<'_>, _: Instant) -> Outcome {
        let result = match *request {
            Request::Get(Variable { kind: VariableKind::Io, index }) => match usize::try_from(index) {
                Ok(index) => self.get(index, reply),
                Err(_) => HResult::E_INVALIDARG,
            },
            Request::Get(_) => HResult::E_INVALIDARG,
            Request::Put(..) => HResult::E_ACCESSDENIED,
        };
        result.into()
    }
}

impl bcap_server::Handler for Inputs {
    fn call(&mut self, _: PeerId, call: &bcap_server::Request<'_>, reply: &mut ReplyValue<'_>, _: Instant) -> Outcome {
        let handle = match call.function {
            FunctionId::CONTROLLER_CONNECT => 1,
            // the handle of a variable is its number plus 1
            FunctionId::CONTROLLER_GET_VARIABLE if call.text(1) == *"IO0" => 1,
            FunctionId::CONTROLLER_GET_VARIABLE if call.text(1) == *"IO1" => 2,
            FunctionId::VARIABLE_GET_VALUE => {
                let index = usize::try_from(call.handle()).ok().and_then(|handle| handle.checked_sub(1));
                return index.map_or(HResult::E_HANDLE, |index| self.get(index, reply)).into();
            }
            FunctionId::SERVICE_START
            | FunctionId::SERVICE_STOP
            | FunctionId::CONTROLLER_DISCONNECT
            | FunctionId::VARIABLE_RELEASE => return HResult::S_OK.into(),
            _ => return HResult::E_NOTIMPL.into(),
        };
        reply.set(&handle).map_or(HResult::E_FAIL, |()| HResult::S_OK).into()
    }
}

/// The inputs that four tasks share.
pub type Board = SharedHandler<NoopRawMutex, Inputs, 4>;

/// Serves one RAC client at a time.
pub async fn serve_rac(
    stack: Stack<'_>,
    [rx, tx]: &mut [[u8; 512]; 2],
    session: &mut Option<rac_server::Session<[u8; 64]>>,
    board: &Board,
) -> ! {
    let make = || rac_server::Session::new(rac_server::Config::TCP, [0; 64]);
    Listener::new(stack, rac::PORT, rx, tx).run(session, make, board, &Limits::default()).await
}

/// A session of b-CAP over TCP.
pub type BcapSession = bcap_server::Session<[u8; 512], [u8; 512], 8>;

/// Serves one b-CAP client over TCP at a time.
pub async fn serve_tcp(
    stack: Stack<'_>,
    [rx, tx]: &mut [[u8; 512]; 2],
    session: &mut Option<BcapSession>,
    board: &Board,
) -> ! {
    let make = || BcapSession::new(bcap_server::Config::TCP, [0; 512], [0; 512]);
    Listener::new(stack, 5007, rx, tx).run(session, make, board, &Limits::default()).await
}

/// Serves as many b-CAP clients over UDP as there are slots.
pub async fn serve_udp(
    stack: Stack<'_>,
    [rx_meta, tx_meta]: &mut [[PacketMetadata; 2]; 2],
    [rx, tx]: &mut [[u8; 1024]; 2],
    peers: &mut [Option<UdpPeer<8>>],
    board: &Board,
) {
    let mut socket = UdpSocket::new(stack, rx_meta, rx, tx_meta, tx);
    if socket.bind(5007).is_ok() {
        UdpServer::new(&mut socket, peers, board, Limits::default()).run().await
    }
}

/// Serves the b-CAP client at the other end of a serial line; returns when the line fails.
pub async fn serve_serial<U: Read + Write>(
    uart: U,
    session: &mut bcap_server::Session<[u8; bcap_core::limits::SERIAL_MAX]>,
    board: &Board,
) {
    let mut transport = Timed::new(uart, EmbassyClock);
    let _ = serve(&mut transport, session, board, &Limits::default()).await;
}

/// The configuration of a session on a serial line.
pub const SERIAL: bcap::server::Config = bcap::server::Config::SERIAL;
