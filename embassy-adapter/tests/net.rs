//! Tests clients and servers over two embassy-net stacks connected by a simulated cable.

use std::net::Ipv4Addr;

use crate::common::{Controller, address, ask, between, dial, number, serve, serve_udp};
use bcap_core::bcap::Client;
use bcap_core::bcap::call::{self, ControllerHandle, VariableHandle};
use bcap_core::bcap::client::{ClientError, Config, Timeout, Timing};
use bcap_core::endpoint::Endpoint as _;
use bcap_core::hresult::HResult;
use bcap_core::io::CallError;
use bcap_core::rac;
use bcap_core::time::Instant;
use bcap_core::variant::Variant;
use bcap_embassy::net::{Connection, NetError, Options, TcpClient, TcpTransport, UdpTransport};
use bcap_embassy::server::{Limits, Listener};
use bcap_test_support::frames;
use embassy_futures::join::join;
use embassy_futures::select::{Either, select};
use embassy_net::Stack;
use embassy_net::udp::{PacketMetadata, UdpSocket};
use embassy_time::{Duration, Timer, with_timeout};

fn left(shared: &Controller) -> usize {
    shared.view(|number| number.left).unwrap()
}

async fn connect<'s>(stack: Stack<'s>, memory: &'s mut [[u8; 512]; 2]) -> TcpClient<'s, [u8; 512]> {
    let [rx, tx] = memory;
    let mut transport = TcpTransport::new(stack, rx, tx, Options::default());
    // a listener that is still closing its last connection refuses
    while transport.connect((address(1), 5007)).await == Err(NetError::Reset) {
        Timer::after_millis(1).await;
    }
    Connection::new(transport, Client::new(Config::TCP, [0; 512], [0; 512]))
}

async fn open<'s>(robot: &mut TcpClient<'s, [u8; 512]>) -> VariableHandle {
    robot.call(call::service_start("")).await.unwrap();
    let controller = robot.call(call::controller_connect("", "P", "", "")).await.unwrap();
    assert_eq!(controller, ControllerHandle(1));
    robot.call(call::controller_get_variable(controller, "I1", "")).await.unwrap()
}

#[test]
fn a_client_reads_and_writes_over_tcp() {
    between(|_, client, server| async move {
        let shared = number(42);
        let test = async {
            let mut memory = [[0; 512]; 2];
            let mut robot = connect(client, &mut memory).await;
            let variable = open(&mut robot).await;
            assert_eq!(robot.call(call::variable_get_value(variable)).await, Ok(Variant::I4(42)));
            robot.call(call::variable_put_value(variable, 43_i32)).await.unwrap();
            assert_eq!(robot.call(call::variable_get_value(variable)).await, Ok(Variant::I4(43)));
            let foreign = robot.call(call::variable_get_value(VariableHandle(8))).await;
            assert_eq!(foreign, Err(CallError::Refused(HResult::E_HANDLE)));
            robot.transport().close().await;
            // the listener accepts the next connection
            drop(robot);
            let mut memory = [[0; 512]; 2];
            let mut robot = connect(client, &mut memory).await;
            let variable = open(&mut robot).await;
            assert_eq!(robot.call(call::variable_get_value(variable)).await, Ok(Variant::I4(43)));
            assert_eq!(left(&shared), 1);
        };
        select(serve(server, &shared, Limits::default()), test).await;
    });
}

#[test]
fn an_unplugged_cable_ends_calls_and_sessions() {
    between(|cable, client, server| async move {
        let shared = number(42);
        let test = async {
            let mut memory = [[0; 512]; 2];
            let mut robot = connect(client, &mut memory).await;
            let variable = open(&mut robot).await;
            cable.cut(true);
            let call = robot.call(call::variable_get_value(variable)).await;
            assert_eq!(call, Err(CallError::Io(NetError::Down)));
            assert_eq!(robot.transport().connect((address(1), 5007)).await, Err(NetError::Down));
            // the server detects it itself
            while left(&shared) == 0 {
                Timer::after_millis(10).await;
            }
            cable.cut(false);
            client.wait_link_up().await;
            server.wait_link_up().await;
            while robot.transport().connect((address(1), 5007)).await.is_err() {
                Timer::after_millis(1).await;
            }
            robot.client().reset();
            let variable = open(&mut robot).await;
            assert_eq!(robot.call(call::variable_get_value(variable)).await, Ok(Variant::I4(42)));
        };
        let test = with_timeout(Duration::from_secs(20), test);
        let (_, done) = join(async {}, select(serve(server, &shared, Limits::default()), test)).await;
        assert!(matches!(done, embassy_futures::select::Either::Second(Ok(()))));
    });
}

#[test]
fn a_closed_port_refuses_and_a_missing_peer_times_out() {
    between(|_, client, _| async move {
        let mut memory = [[0; 512]; 2];
        let [rx, tx] = &mut memory;
        for (side, limit_ms, error) in [(1, 30_000, NetError::Reset), (8, 200, NetError::Timeout)] {
            let options = Options { connect_timeout: Duration::from_millis(limit_ms), ..Options::default() };
            let mut transport = TcpTransport::new(client, rx, tx, options);
            assert_eq!(transport.connect((address(side), 5007)).await, Err(error));
        }
    });
}

#[test]
fn a_client_over_udp_survives_losses() {
    between(|cable, client, server| async move {
        let shared = number(0);
        let test = async {
            let (mut rx_meta, mut tx_meta) = ([PacketMetadata::EMPTY; 2], [PacketMetadata::EMPTY; 2]);
            let (mut rx, mut tx) = ([0; 1024], [0; 1024]);
            let socket = UdpSocket::new(client, &mut rx_meta, &mut rx, &mut tx_meta, &mut tx);
            let transport = UdpTransport::new(client, socket, (address(1), 5007)).unwrap();
            let timing = Timing { attempt_timeout: core::time::Duration::from_millis(50), attempts: 20, ..Timing::UDP };
            let config = Config { timing, ..Config::UDP };
            let mut robot = Connection::new(transport, Client::new(config, [0; 488], [0; 505]));
            robot.call(call::service_start("")).await.unwrap();
            let controller = robot.call(call::controller_connect("", "P", "", "")).await.unwrap();
            let variable = robot.call(call::controller_get_variable(controller, "I1", "")).await.unwrap();
            cable.lose(3);
            for value in 1..20 {
                robot.call(call::variable_put_value(variable, value)).await.unwrap();
                assert_eq!(robot.call(call::variable_get_value(variable)).await, Ok(Variant::I4(value)));
            }
            cable.lose(1);
            robot.client().set_timing(Timing { attempts: 2, ..timing });
            let silent = robot.call(call::variable_get_value(variable)).await;
            assert_eq!(silent, Err(CallError::Client(ClientError::Timeout(Timeout::Attempt))));
        };
        select(serve_udp(server, &shared), test).await;
    });
}

#[test]
fn the_slot_of_a_udp_peer_is_free_after_service_stop() {
    between(|_, client, server| async move {
        let shared = number(7);
        let mut memory: [_; 4] = std::array::from_fn(|_| ([PacketMetadata::EMPTY; 4], [[0; 1024]; 2]));
        let [a, b, c, d] = memory.each_mut().map(|(meta, [rx, tx])| {
            let (rx_meta, tx_meta) = meta.split_at_mut(2);
            let socket = UdpSocket::new(client, rx_meta, rx, tx_meta, tx);
            let transport = UdpTransport::new(client, socket, (address(1), 5007)).unwrap();
            Connection::new(transport, Client::new(Config::UDP, [0; 488], [0; 505]))
        });
        let test = async {
            let (mut stopped, mut working, mut next, mut last) = (a, b, c, d);
            for peer in [&mut stopped, &mut working] {
                peer.call(call::service_start("")).await.unwrap();
            }
            let controller = working.call(call::controller_connect("", "P", "", "")).await.unwrap();
            let full = next.call(call::service_start("")).await;
            assert_eq!(full, Err(CallError::Refused(HResult::E_MAX_CONNECT)));
            stopped.call(call::service_stop()).await.unwrap();
            next.call(call::service_start("")).await.unwrap();
            // neither of the two peers with a service lost its slot
            let full = last.call(call::service_start("")).await;
            assert_eq!(full, Err(CallError::Refused(HResult::E_MAX_CONNECT)));
            working.call(call::controller_get_variable(controller, "I1", "")).await.unwrap();
        };
        select(serve_udp(server, &shared), test).await;
    });
}

#[test]
fn replies_to_addresses_that_do_not_exist_hold_up_no_other_ones() {
    between(|cable, client, server| async move {
        let shared = number(7);
        let test = async {
            let (mut rx_meta, mut tx_meta) = ([PacketMetadata::EMPTY; 2], [PacketMetadata::EMPTY; 2]);
            let (mut rx, mut tx) = ([0; 1024], [0; 1024]);
            let socket = UdpSocket::new(client, &mut rx_meta, &mut rx, &mut tx_meta, &mut tx);
            let transport = UdpTransport::new(client, socket, (address(1), 5007)).unwrap();
            let mut robot = Connection::new(transport, Client::new(Config::UDP, [0; 488], [0; 505]));
            robot.call(call::service_start("")).await.unwrap();
            let mut request = Client::new(Config::UDP, [0; 488], [0; 505]);
            request.start(&call::controller_connect("", "", "", ""), Timing::UDP, Instant::ZERO).unwrap();
            // no host has the first address, and the second has no route
            for unused in [address(100), Ipv4Addr::new(10, 0, 0, 9)] {
                let frame =
                    frames::datagram([2, 0, 0, 0, 0, 1], unused, address(1), [40_000, 5007], request.transmit());
                for _ in 0..6 {
                    cable.send(1, frame.clone());
                }
                robot.call(call::controller_connect("", "P", "", "")).await.unwrap();
            }
        };
        let ended = select(serve_udp(server, &shared), with_timeout(Duration::from_secs(60), test)).await;
        assert!(matches!(ended, Either::Second(Ok(()))), "it hangs");
    });
}

/// Serves RAC on port 5006 forever.
async fn serve_rac(stack: Stack<'_>, shared: &Controller, limits: Limits) {
    let (mut rx, mut tx) = ([0; 512], [0; 512]);
    let mut slot = None;
    let make = || rac::server::Session::new(rac::server::Config::TCP, [0; 64]);
    Listener::new(stack, rac::PORT, &mut rx, &mut tx).run(&mut slot, make, shared, &limits).await
}

#[test]
fn lines_are_answered_and_waiting_requests_polled_after_changes() {
    between(|_, client, server| async move {
        let shared = number(0);
        let serving =
            join(serve_rac(server, &shared, Limits::default()), serve_rac(server, &shared, Limits::default()));
        let test = async {
            let mut memory = [[[0; 512]; 2]; 2];
            let [a, b] = &mut memory;
            let (mut a, mut b) = (dial(client, a, rac::PORT).await, dial(client, b, rac::PORT).await);

            assert_eq!(ask(&mut a, "GET:RC8:1:I:\r").await, "0,3,0\r");
            // 200 bytes too many do not end the session
            assert_eq!(
                ask(&mut a, &(["X"; 456].concat() + "\r")).await,
                ask(&mut b, &(["Y"; 300].concat() + "\r")).await
            );
            // several lines in one segment
            a.write(b"GET:RC8:1:I:\rPUT:RC8:1:I:3,5\rGET:RC8:1:I:\r").await.unwrap();
            assert_eq!(ask(&mut a, "").await, "0,3,0\r");
            assert_eq!(ask(&mut a, "").await, "0\r");
            assert_eq!(ask(&mut a, "PUT:RC8:1:I:3,0\r").await, "0,3,5\r");
            assert_eq!(ask(&mut a, "").await, "0\r");
            // a request waits until another client sets the number
            let (waited, put) = join(ask(&mut a, "GET:RC8:2:I:\r"), async {
                Timer::after_millis(20).await;
                ask(&mut b, "PUT:RC8:1:I:3,7\r").await
            })
            .await;
            assert_eq!((waited.as_str(), put.as_str()), ("0,3,7\r", "0\r"));
            // or until the board sets it
            shared.update(|number| number.value = 0).unwrap();
            let (waited, _) = join(ask(&mut a, "GET:RC8:2:I:\r"), async {
                Timer::after_millis(20).await;
                shared.update(|number| number.value = 8).unwrap();
            })
            .await;
            assert_eq!(waited, "0,3,8\r");
        };
        select(serving, test).await;
    });
}

#[test]
fn idle_peers_and_partial_requests_end_their_sessions() {
    between(|_, client, server| async move {
        let short = core::time::Duration::from_millis(100);
        for (limits, line) in [
            (Limits { idle: Some(short), ..Limits::default() }, ""),
            (Limits { receive: short, ..Limits::default() }, "GET:RC8"),
        ] {
            let shared = number(0);
            let test = async {
                let mut memory = [[0; 512]; 2];
                let mut socket = dial(client, &mut memory, rac::PORT).await;
                if !line.is_empty() {
                    socket.write(line.as_bytes()).await.unwrap();
                }
                let mut buffer = [0; 8];
                assert_eq!(socket.read(&mut buffer).await, Ok(0));
                assert_eq!(left(&shared), 1);
            };
            select(serve_rac(server, &shared, limits), test).await;
        }
    });
}

#[test]
fn lines_split_across_packets_do_not_count_as_slow() {
    between(|_, client, server| async move {
        let limits = Limits { receive: core::time::Duration::from_secs(1), ..Limits::default() };
        let shared = number(7);
        let test = async {
            let mut memory = [[0; 512]; 2];
            let mut socket = dial(client, &mut memory, rac::PORT).await;
            socket.write(b"GET:RC8:1:").await.unwrap();
            for _ in 0..30 {
                Timer::after_millis(40).await;
                let answer = ask(&mut socket, "I:\rGET:RC8:1:").await;
                assert_eq!(answer, "0,3,7\r");
            }
        };
        select(serve_rac(server, &shared, limits), test).await;
    });
}
