//! The gateway of `bcap-embassy`, on two embassy-net stacks that a simulated cable connects.

use std::cell::RefCell;
use std::net::Ipv4Addr;

use bcap_core::rac;
use bcap_embassy::gateway::{Front, Limits, Listener, ModbusListener, Report, SharedGateway, serve};
use bcap_embassy::net::Options;
use bcap_embassy::serial;
use bcap_gateway::modbus;
use bcap_gateway::{Config, Gateway, Memory};
use bcap_test_support::stacks::between_addresses;
use embassy_futures::select::{Either, Either3, select, select3};
use embassy_net::tcp::TcpSocket;
use embassy_net::{Ipv4Cidr, Stack};
use embassy_sync::blocking_mutex::raw::NoopRawMutex;
use embassy_time::{Duration, with_timeout};

use super::{Protocol, Run, map};

type Shared<'m> = SharedGateway<'m, NoopRawMutex, 2>;

const BOARD: Ipv4Addr = Ipv4Addr::new(10, 255, 0, 1);
/// The address of a client on the cable whose address is unknown to the gateway.
const UNKNOWN: Ipv4Addr = Ipv4Addr::new(10, 0, 0, 7);

thread_local! {
    static REPORTS: RefCell<Vec<String>> = const { RefCell::new(Vec::new()) };
}

fn log(report: &Report<'_>) {
    let text = match *report {
        Report::Connected { .. } => "connected".to_owned(),
        Report::Denied { reason, .. } => format!("denied: {reason:?}"),
        _ => return,
    };
    REPORTS.with_borrow_mut(|reports| reports.push(text));
}

/// Runs a gateway with a listener for each protocol; a client without an address is served as one on a serial line.
pub(crate) fn run(config: Config<'static>, from: Option<Ipv4Addr>, protocol: Protocol, requests: &[Vec<u8>]) -> Run {
    let mut got = None;
    let addresses = [from.unwrap_or(UNKNOWN), BOARD].map(|address| Ipv4Cidr::new(address, 8));
    let responses = &mut got;
    between_addresses(addresses, |_, plc, board| async move {
        let mut memory = Memory::<2, 4>::new();
        let shared = Shared::new(Gateway::new(config, &mut memory), log);
        let mut buffers = [[[0; 512]; 2]; 2];
        let [[rx0, tx0], [rx1, tx1]] = &mut buffers;
        let client = with_timeout(Duration::from_secs(60), ask(plc, protocol, requests));
        *responses = if from.is_some() {
            let (mut rac, limits) = (Listener::new(board, rac::PORT, rx0, tx0), Limits::default());
            let mut modbus = ModbusListener::new(board, modbus::PORT, map(), [rx1, tx1], Options::default());
            let served = select3(rac.run(&shared, &limits), modbus.run(&shared, &limits), client);
            match served.await {
                Either3::Third(responses) => responses.expect("it hangs"),
                Either3::First(never) | Either3::Second(never) => never,
            }
        } else {
            let socket = TcpSocket::new(board, rx0, tx0);
            let served = select(serve_line(socket, protocol, &shared), client);
            match served.await {
                Either::Second(responses) => responses.expect("it hangs"),
                Either::First(never) => never,
            }
        };
    });
    Run { responses: got, reports: REPORTS.take() }
}

/// Serves the first client like a client on a serial line, whose address is unknown to the gateway.
async fn serve_line(mut socket: TcpSocket<'_>, protocol: Protocol, shared: &Shared<'_>) -> ! {
    socket.accept(port(protocol)).await.unwrap();
    let is_admitted = shared.admits(None);
    if !is_admitted {
        socket.abort();
    }
    let mut transport = serial::transport(socket);
    if !is_admitted {
        // the stack sends the reset
    } else if protocol == Protocol::Rac {
        serve(&mut transport, Front::Rac, None, shared, &Limits::default()).await.unwrap();
    } else {
        let mut session = modbus::Session::new(map());
        serve(&mut transport, Front::Modbus(&mut session), None, shared, &Limits::default()).await.unwrap();
    }
    std::future::pending().await
}

const fn port(protocol: Protocol) -> u16 {
    match protocol {
        Protocol::Rac => rac::PORT,
        Protocol::Modbus => modbus::PORT,
    }
}

/// Returns a response for each request; `None` after a reset.
async fn ask(stack: Stack<'_>, protocol: Protocol, requests: &[Vec<u8>]) -> Option<Vec<Vec<u8>>> {
    let (mut rx, mut tx) = ([0; 512], [0; 512]);
    let mut socket = TcpSocket::new(stack, &mut rx, &mut tx);
    // a connection is refused until the board listens
    while socket.connect((BOARD, port(protocol))).await.is_err() {
        embassy_futures::yield_now().await;
    }
    let mut responses = Vec::new();
    for request in requests {
        assert_eq!(socket.write(request).await.ok()?, request.len());
        let mut response = Vec::new();
        while !protocol.is_complete(&response) {
            let mut byte = [0];
            assert_eq!(socket.read(&mut byte).await.ok()?, 1, "closed after {response:?}");
            response.extend(byte);
        }
        responses.push(response);
    }
    Some(responses)
}
