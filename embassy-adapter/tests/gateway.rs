//! Tests the gateway between PLCs and a robot, over two embassy-net stacks connected by a simulated cable.

use std::cell::RefCell;

use crate::common::{address, ask, between, dial, number, serve, serve_udp};
use bcap_core::bcap::client;
use bcap_core::hresult::HResult;
use bcap_core::rac::{self, VariableKind};
use bcap_embassy::gateway::{self, Ended, Report, RobotLink, TcpRobot, run_robot};
use bcap_embassy::net::{NetError, Options, Transport, UdpTransport};
use bcap_embassy::server::Limits;
use bcap_gateway::{Allow, Config, Event, Gateway, Memory, Network, Refusal, Rules};
use embassy_futures::join::{join, join3};
use embassy_futures::select::{select, select3};
use embassy_net::tcp::TcpSocket;
use embassy_net::udp::{PacketMetadata, UdpSocket};
use embassy_net::{IpEndpoint, Stack};
use embassy_sync::blocking_mutex::raw::NoopRawMutex;
use embassy_time::{Duration, Timer, with_timeout};

const PUT: [Allow<'static>; 1] = [Allow::all(VariableKind::I)];
/// The configuration of a board, with shorter pauses.
const CONFIG: Config<'static> = Config {
    rules: Rules { put: &PUT, ..Rules::READ_ONLY },
    first_pause: core::time::Duration::from_millis(20),
    longest_pause: core::time::Duration::from_millis(100),
    // a heartbeat could hide a missing wake-up
    heartbeat: core::time::Duration::from_secs(3600),
    ..Config::RC8
};

type Plant<'m> = gateway::SharedGateway<'m, NoopRawMutex, 2>;

thread_local! {
    /// The reports as texts.
    static LOG: RefCell<Vec<String>> = const { RefCell::new(Vec::new()) };
}

fn log(report: &Report<'_>) {
    let text = match *report {
        Report::Connected { client } => format!("connected {}", client.unwrap().ip()),
        Report::Disconnected { client, ended } => format!("gone {} {ended:?}", client.unwrap().ip()),
        Report::Answered { client, line, event: Event::Refused { refusal, .. } } => {
            assert!(matches!(refusal, Refusal::Line(_) | Refusal::Kind));
            format!("refused {} {}", client.unwrap().ip(), String::from_utf8_lossy(line))
        }
        Report::Denied { client, reason } => format!("denied {} {reason:?}", client.unwrap().ip()),
        Report::Answered { event: Event::Failed { result, .. }, .. } => format!("failed {result}"),
        Report::Robot { event: Event::RobotDown { .. }, cause } => format!("robot down {cause:?}"),
        Report::Robot { .. } => "robot up".to_owned(),
        _ => return,
    };
    LOG.with_borrow_mut(|log| log.push(text));
}

fn logged(text: &str) -> bool {
    LOG.with_borrow(|log| log.iter().any(|line| line == text))
}

/// Serves two PLCs, answers a third, and runs the connection to the robot, forever.
async fn run<L: gateway::RobotLink<Cause = NetError>>(
    stack: Stack<'_>,
    mut link: L,
    plant: &Plant<'_>,
    limits: gateway::Limits,
) {
    let mut memory = [[[0; 512]; 2]; 3];
    let [[rx0, tx0], [rx1, tx1], [rx2, tx2]] = &mut memory;
    let mut first = gateway::Listener::new(stack, rac::PORT, rx0, tx0);
    let mut second = gateway::Listener::new(stack, rac::PORT, rx1, tx1);
    let mut third = gateway::Listener::new(stack, rac::PORT, rx2, tx2);
    let mut frame = [0; 512];
    let plcs = join3(first.run(plant, &limits), second.run(plant, &limits), third.run(plant, &limits));
    join(run_robot(&mut link, &mut frame, plant), plcs).await;
}

fn robot() -> IpEndpoint {
    (address(0), 5007).into()
}

/// Creates a gateway with two slots, until the test's process ends.
fn plant(config: Config<'_>) -> Plant<'_> {
    Plant::new(Gateway::new(config, Box::leak(Box::new(Memory::<2, 4>::new()))), log)
}

fn tcp_robot(stack: Stack<'_>) -> TcpRobot<'_> {
    let [rx, tx] = Box::leak(Box::new([[0; 1024]; 2]));
    TcpRobot::new(stack, rx, tx, Options::default(), robot())
}

fn error(code: HResult) -> String {
    format!("{}\r", code.0)
}

/// Repeats a request until it has this answer.
async fn until(socket: &mut TcpSocket<'_>, line: &str, answer: &str) {
    while ask(socket, line).await != answer {
        Timer::after_millis(1).await;
    }
}

/// Fails a test that hangs.
async fn ends(test: impl Future<Output = ()>) {
    with_timeout(Duration::from_secs(60), test).await.unwrap();
}

#[test]
fn plcs_are_served_and_refusals_logged() {
    between(|_, plcs, board| async move {
        let number = number(7);
        let (plant, link) = (plant(CONFIG), tcp_robot(board));
        let test = ends(async {
            let (mut a, mut b) = ([[0; 512]; 2], [[0; 512]; 2]);
            let mut a = dial(plcs, &mut a, rac::PORT).await;
            let mut b = dial(plcs, &mut b, rac::PORT).await;
            until(&mut a, "GET:RC8:1:I:\r", "0,3,7\r").await;
            assert_eq!(ask(&mut b, "PUT:RC8:1:I:3,8\r").await, "0\r");
            assert_eq!(ask(&mut a, "GET:RC8:1:I:\r").await, "0,3,8\r");
            assert_eq!(ask(&mut b, "PUT:RC8:1:F:4,8\r").await, error(HResult::E_ACCESSDENIED));
            assert_eq!(ask(&mut b, &(["X"; 300].concat() + "\r")).await, error(HResult::E_PACKETSIZEOVER));
            // several lines in one segment, then the rest of a partial line
            a.write(b"GET:RC8:1:I:\rHELLO\rGET:RC8:1:I:\rGET:RC").await.unwrap();
            assert_eq!(ask(&mut a, "").await, "0,3,8\r");
            assert_eq!(ask(&mut a, "").await, error(HResult::E_INVALIDCOMMAND));
            assert_eq!(ask(&mut a, "").await, "0,3,8\r");
            assert_eq!(ask(&mut a, "8:1:I:\r").await, "0,3,8\r");
            let from = address(0);
            assert!(logged(&format!("connected {from}")) && logged("robot up"));
            assert!(logged(&format!("refused {from} PUT:RC8:1:F:4,8")));
            assert!(logged(&format!("refused {from} HELLO")));
            assert!(logged(&format!("refused {from} {}", ["X"; 256].concat())));
            let served = plant.view(|gateway| gateway.counters().served.count()).unwrap();
            assert!(served >= 6, "{served}");
            // the slot of a PLC is free after it disconnects
            a.abort();
            while !logged(&format!("gone {from} {:?}", Some(Ended::Failed::<()>(())))) {
                Timer::after_millis(1).await;
            }
            let mut c = [[0; 512]; 2];
            let mut c = dial(plcs, &mut c, rac::PORT).await;
            assert_eq!(ask(&mut c, "GET:RC8:1:I:\r").await, "0,3,8\r");
        });
        select3(run(board, link, &plant, gateway::Limits::default()), serve(plcs, &number, Limits::default()), test)
            .await;
    });
}

#[test]
fn a_full_gateway_answers_so_and_an_idle_client_makes_room() {
    between(|_, plcs, board| async move {
        let (plant, link) = (plant(CONFIG), tcp_robot(board));
        let limits =
            gateway::Limits { evict_after: Some(core::time::Duration::from_secs(3)), ..gateway::Limits::default() };
        let test = ends(async {
            let mut memory = [[[0; 512]; 2]; 4];
            let [a, b, c, d] = &mut memory;
            let answer = error(HResult::E_NOT_CONNECTED);
            let mut silent = dial(plcs, a, rac::PORT).await;
            assert_eq!(ask(&mut silent, "GET:RC8:1:I:\r").await, answer);
            let mut busy = dial(plcs, b, rac::PORT).await;
            assert_eq!(ask(&mut busy, "GET:RC8:1:I:\r").await, answer);
            // no client is idle yet
            let mut refused = dial(plcs, c, rac::PORT).await;
            assert_eq!(ask(&mut refused, "GET:RC8:1:I:\r").await, error(HResult::E_MAX_CONNECT));
            assert_eq!(refused.read(&mut [0]).await, Ok(0));
            assert!(logged(&format!("denied {} Full", address(0))));
            for _ in 0..400 {
                assert_eq!(ask(&mut busy, "GET:RC8:1:I:\r").await, answer);
                Timer::after_millis(10).await;
            }
            // now one of the two is
            let mut late = dial(plcs, d, rac::PORT).await;
            assert_eq!(ask(&mut late, "GET:RC8:1:I:\r").await, answer);
            assert!(silent.read(&mut [0]).await.is_err(), "it is reset");
            assert_eq!(ask(&mut busy, "GET:RC8:1:I:\r").await, answer);
            assert!(logged(&format!("gone {} {:?}", address(0), Some(Ended::Evicted::<()>))));
        });
        select(run(board, link, &plant, limits), test).await;
    });
}

#[test]
fn a_client_of_another_network_is_not_served() {
    between(|_, plcs, board| async move {
        let own = [Network::new(address(0), 32).unwrap()];
        let other = [Network::parse("10.0.0.0/8").unwrap()];
        for (clients, is_served) in [(&own, true), (&other, false)] {
            let plant = plant(Config { rules: Rules { clients, ..CONFIG.rules }, ..CONFIG });
            let test = ends(async {
                let mut a = [[0; 512]; 2];
                let mut a = dial(plcs, &mut a, rac::PORT).await;
                if is_served {
                    assert_eq!(ask(&mut a, "GET:RC8:1:I:\r").await, error(HResult::E_NOT_CONNECTED));
                } else {
                    assert!(a.read(&mut [0]).await.is_err(), "it is reset");
                }
            });
            select(run(board, tcp_robot(board), &plant, gateway::Limits::default()), test).await;
        }
        assert!(logged(&format!("denied {} Address", address(0))));
    });
}

#[test]
fn a_disconnected_robot_is_reported_at_once_and_reconnected() {
    between(|_, plcs, board| async move {
        let number = number(7);
        let (plant, link) = (plant(CONFIG), tcp_robot(board));
        let test = ends(async {
            let mut a = [[0; 512]; 2];
            let mut a = dial(plcs, &mut a, rac::PORT).await;
            assert_eq!(ask(&mut a, "GET:RC8:1:I:\r").await, error(HResult::E_NOT_CONNECTED), "there is no robot yet");
            for _ in 0..3 {
                select(serve(plcs, &number, Limits::default()), until(&mut a, "GET:RC8:1:I:\r", "0,3,7\r")).await;
                // dropping the server closes the connection
                until(&mut a, "GET:RC8:1:I:\r", &error(HResult::E_NOT_CONNECTED)).await;
            }
            assert!(logged(&format!("robot down {:?}", Some(NetError::Reset))));
            assert!(logged(&format!("failed {}", HResult::E_NOT_CONNECTED)));
        });
        select(run(board, link, &plant, gateway::Limits::default()), test).await;
    });
}

#[test]
fn slow_requests_end_a_session_and_an_unplugged_cable_ends_all() {
    between(|cable, plcs, board| async move {
        let number = number(7);
        let (plant, link) = (plant(CONFIG), tcp_robot(board));
        let limits = gateway::Limits { receive: core::time::Duration::from_millis(100), ..gateway::Limits::default() };
        let test = ends(async {
            let (mut a, mut b) = ([[0; 512]; 2], [[0; 512]; 2]);
            let mut a = dial(plcs, &mut a, rac::PORT).await;
            until(&mut a, "GET:RC8:1:I:\r", "0,3,7\r").await;
            // half a line without its rest
            a.write(b"GET:RC8").await.unwrap();
            assert_eq!(a.read(&mut [0]).await, Ok(0), "the session is over");
            let mut b = dial(plcs, &mut b, rac::PORT).await;
            assert!(logged(&format!("gone {} {:?}", address(0), Some(Ended::RequestTooSlow::<()>))));
            until(&mut b, "GET:RC8:1:I:\r", "0,3,7\r").await;
            cable.cut(true);
            while !logged(&format!("robot down {:?}", Some(NetError::Down))) {
                Timer::after_millis(10).await;
            }
            while LOG.with_borrow(|log| log.iter().filter(|line| line.starts_with("gone")).count()) < 2 {
                Timer::after_millis(10).await;
            }
            cable.cut(false);
            let mut c = [[0; 512]; 2];
            let mut c = dial(plcs, &mut c, rac::PORT).await;
            until(&mut c, "GET:RC8:1:I:\r", "0,3,7\r").await;
        });
        select3(run(board, link, &plant, limits), serve(plcs, &number, Limits::default()), test).await;
    });
}

#[test]
fn a_robot_over_udp_is_reached_despite_losses() {
    between(|cable, plcs, board| async move {
        let number = number(7);
        let client = client::Config {
            timing: client::Timing { attempt_timeout: core::time::Duration::from_millis(20), ..client::Timing::UDP },
            ..client::Config::UDP
        };
        let plant = plant(Config { client, ..CONFIG });
        let (mut metas, mut buffers) = ([[PacketMetadata::EMPTY; 2]; 2], [[0; 1024]; 2]);
        let ([rx_meta, tx_meta], [rx, tx]) = (&mut metas, &mut buffers);
        let link = UdpTransport::new(board, UdpSocket::new(board, rx_meta, rx, tx_meta, tx), robot()).unwrap();
        let test = ends(async {
            let mut a = [[0; 512]; 2];
            let mut a = dial(plcs, &mut a, rac::PORT).await;
            until(&mut a, "GET:RC8:1:I:\r", "0,3,7\r").await;
            cable.lose(9);
            for value in 0..6 {
                assert_eq!(ask(&mut a, &format!("PUT:RC8:1:I:3,{value}\r")).await, "0\r");
                assert_eq!(ask(&mut a, "GET:RC8:1:I:\r").await, format!("0,3,{value}\r"));
            }
        });
        select3(run(board, link, &plant, gateway::Limits::default()), serve_udp(plcs, &number), test).await;
    });
}

#[test]
fn a_datagram_that_was_not_sent_is_discarded_with_its_session() {
    between(|cable, peer, board| async move {
        let (mut metas, mut buffers) = ([[PacketMetadata::EMPTY; 2]; 4], [[0; 1024]; 4]);
        let ([rx_meta, tx_meta, peer_rx_meta, peer_tx_meta], [rx, tx, peer_rx, peer_tx]) = (&mut metas, &mut buffers);
        let mut peer = UdpSocket::new(peer, peer_rx_meta, peer_rx, peer_tx_meta, peer_tx);
        peer.bind(5007).unwrap();
        let mut link = UdpTransport::new(board, UdpSocket::new(board, rx_meta, rx, tx_meta, tx), robot()).unwrap();
        let port = link.socket().endpoint();
        let until = bcap_embassy::clock::now().saturating_add(core::time::Duration::from_secs(10));
        // the address of the robot is not resolved
        cable.lose(1);
        assert_eq!(link.send(b"old", until).await, Ok(Some(3)));
        Timer::after_millis(5).await;
        link.close();
        cable.lose(0);
        link.open().await.unwrap();
        assert_eq!(link.send(b"new", until).await, Ok(Some(3)));
        let mut buffer = [0; 8];
        let (count, from) = peer.recv_from(&mut buffer).await.unwrap();
        assert_eq!((&buffer[..count], from.endpoint.port), (&b"new"[..], port.port));
        Timer::after_millis(100).await;
        assert!(!peer.may_recv(), "an old datagram arrived too");
    });
}
