//! Tests clients of Modbus TCP in front of the gateway, over two embassy-net stacks connected by a simulated cable.

use std::cell::RefCell;

use crate::common::{address, between, dial, number, serve};
use bcap_core::rac::VariableKind;
use bcap_embassy::gateway::{self, ModbusListener, Report, SharedGateway, TcpRobot, run_robot};
use bcap_embassy::net::{Options, Usage};
use bcap_embassy::server::Limits;
use bcap_gateway::modbus::{Entry, PORT};
use bcap_gateway::{Allow, Bounds, Config, Event, Gateway, Memory, Rules};
use embassy_futures::join::{join, join3};
use embassy_futures::select::{Either, select, select3};
use embassy_net::tcp::TcpSocket;
use embassy_net::{IpEndpoint, Stack};
use embassy_sync::blocking_mutex::raw::NoopRawMutex;
use embassy_time::{Duration, Timer, with_timeout};

type Plant<'m> = SharedGateway<'m, NoopRawMutex, 2>;

thread_local! {
    /// The refused lines and the ends of sessions.
    static LOG: RefCell<Vec<String>> = const { RefCell::new(Vec::new()) };
}

fn log(report: &Report<'_>) {
    let text = match *report {
        Report::Answered { line, event: Event::Refused { .. }, .. } => String::from_utf8_lossy(line).into_owned(),
        Report::Disconnected { ended, .. } => format!("{ended:?}"),
        _ => return,
    };
    LOG.with_borrow_mut(|log| log.push(text));
}

fn logged() -> Vec<String> {
    LOG.with_borrow_mut(std::mem::take)
}

/// Serves two Modbus clients, answers a third, and runs the connection to the robot, forever.
async fn run(stack: Stack<'_>, plant: &Plant<'_>, map: &[Entry]) {
    let mut memory = [[[0; 512]; 2]; 4];
    let [[rx, tx], rest @ ..] = &mut memory;
    let mut link = TcpRobot::new(stack, rx, tx, Options::default(), IpEndpoint::from((address(0), 5007)));
    let [mut a, mut b, mut c] =
        rest.each_mut().map(|[rx, tx]| ModbusListener::new(stack, PORT, map, [rx, tx], Options::default()));
    let (mut frame, limits) = ([0; 512], gateway::Limits::default());
    let clients = join3(a.run(plant, &limits), b.run(plant, &limits), c.run(plant, &limits));
    join(run_robot(&mut link, &mut frame, plant), clients).await;
}

/// Sends a request and returns the function and the data of the response.
async fn ask(socket: &mut TcpSocket<'_>, function: &[u8]) -> Vec<u8> {
    let length = u8::try_from(function.len() + 1).unwrap();
    let request = [&[0x12, 0x34, 0, 0, 0, length, 1], function].concat();
    assert_eq!(socket.write(&request).await, Ok(request.len()));
    let mut response = Vec::new();
    while response.len() < 6 || response.len() < 6 + usize::from(response[5]) {
        let mut byte = [0];
        assert_eq!(socket.read(&mut byte).await, Ok(1), "closed after {response:?}");
        response.extend(byte);
    }
    assert_eq!(response[..5], [0x12, 0x34, 0, 0, 0]);
    response[7..].to_vec()
}

#[test]
fn rules_slots_and_the_log_apply_to_clients_of_modbus() {
    between(|_, clients, board| async move {
        let values = [Bounds { min: -10.0, max: 10.0 }];
        let put = [
            Allow { values: &values, ..Allow::range(VariableKind::I, 1, 1) },
            Allow::range(VariableKind::F, 1, 1),
            Allow::range(VariableKind::D, 1, 1),
        ];
        let config = Config {
            rules: Rules { put: &put, ..Rules::READ_ONLY },
            first_pause: core::time::Duration::from_millis(20),
            longest_pause: core::time::Duration::from_millis(100),
            ..Config::RC8
        };
        let map = ["100=I/1-2", "200=I/1:i16", "300=F/1", "400=D/1"].map(|entry| Entry::registers(entry).unwrap());
        let number = number(70_000);
        let mut memory = Memory::<2, 4>::new();
        let plant = Plant::new(Gateway::new(config, &mut memory), log);
        let test = async {
            let mut memory = [[[0; 512]; 2]; 4];
            let [a, b, c, d] = &mut memory;
            let mut a = dial(clients, a, PORT).await;
            let mut b = dial(clients, b, PORT).await;
            // before the robot is connected, the path is not available
            while ask(&mut a, &[3, 0, 100, 0, 2]).await != [3, 4, 0, 1, 0x11, 0x70] {
                Timer::after_millis(1).await;
            }
            assert_eq!(ask(&mut b, &[3, 0, 200, 0, 1]).await, [0x83, 4], "70000 does not fit a register");
            assert_eq!(ask(&mut b, &[16, 0, 100, 0, 2, 4, 0xff, 0xff, 0xff, 0xf6]).await, [16, 0, 100, 0, 2]);
            assert_eq!(ask(&mut a, &[4, 0, 200, 0, 1]).await, [4, 2, 0xff, 0xf6]);
            assert_eq!(logged(), [""; 0]);
            // a value out of the range, a variable without a rule, two variables with a rule for only one of them, and
            // no variable
            assert_eq!(ask(&mut a, &[6, 0, 200, 0, 11]).await, [0x86, 3]);
            assert_eq!(ask(&mut a, &[16, 0, 102, 0, 2, 4, 0, 0, 0, 5]).await, [0x90, 2]);
            assert_eq!(ask(&mut a, &[16, 0, 100, 0, 4, 8, 0, 0, 0, 5, 0, 0, 0, 5]).await, [0x90, 2]);
            assert_eq!(ask(&mut a, &[1, 0, 0, 0, 1]).await, [0x81, 2]);
            let expected = ["PUT:RC8:1:I:3,11", "PUT:RC8:2:I:3,5", "PUT:RC8:2:I:3,5", "MODBUS:1:0:1"];
            assert_eq!(logged(), expected);
            // an infinity in F1, NaN and an infinity in D1
            assert_eq!(ask(&mut a, &[16, 1, 44, 0, 2, 4, 0x7f, 0x80, 0, 0]).await, [0x90, 3]);
            assert_eq!(ask(&mut a, &[16, 1, 144, 0, 4, 8, 0x7f, 0xf8, 0, 0, 0, 0, 0, 0]).await, [0x90, 3]);
            assert_eq!(ask(&mut a, &[16, 1, 144, 0, 4, 8, 0xff, 0xf0, 0, 0, 0, 0, 0, 0]).await, [0x90, 3]);
            assert_eq!(logged(), ["PUT:RC8:1:F:4,inf", "PUT:RC8:1:D:5,NaN", "PUT:RC8:1:D:5,-inf"]);
            assert_eq!(ask(&mut a, &[4, 0, 200, 0, 1]).await, [4, 2, 0xff, 0xf6], "nothing was written");
            // both slots are in use
            let mut c = dial(clients, c, PORT).await;
            assert_eq!(ask(&mut c, &[3, 0, 100, 0, 2]).await, [0x83, 6]);
            assert_eq!(c.read(&mut [0]).await, Ok(0), "closed");
            // bytes that are not Modbus end the connection and free its slot
            assert_eq!(b.write(b"GET:RC8:1:I:\r").await, Ok(13));
            assert_eq!(b.read(&mut [0]).await, Ok(0), "closed");
            assert_eq!(logged(), ["Some(NotModbus)"]);
            let mut d = dial(clients, d, PORT).await;
            assert_eq!(ask(&mut d, &[3, 0, 200, 0, 1]).await, [3, 2, 0xff, 0xf6]);
        };
        let test = with_timeout(Duration::from_secs(60), test);
        let ended = select3(run(board, &plant, &map), serve(clients, &number, Limits::default()), test).await;
        assert!(matches!(ended, embassy_futures::select::Either3::Third(Ok(()))), "it hangs");
    });
}

#[test]
fn a_part_of_a_frame_ends_a_session() {
    between(|_, clients, board| async move {
        let map = [Entry::registers("100=I/1-2").unwrap()];
        let mut memory = Memory::<2, 4>::new();
        let plant = Plant::new(Gateway::new(Config::RC8, &mut memory), log);
        let serve = async {
            let mut memory = [[0; 512]; 2];
            let [rx, tx] = &mut memory;
            let mut listener = ModbusListener::new(board, PORT, &map, [rx, tx], Options::default());
            let receive = core::time::Duration::from_secs(2);
            listener.run(&plant, &gateway::Limits { receive, ..gateway::Limits::default() }).await
        };
        let test = async {
            let mut memory = [[[0; 512]; 2]; 3];
            let [a, b, c] = &mut memory;
            // a part of the header, of the data, and of a request after a complete one
            let mut a = dial(clients, a, PORT).await;
            assert_eq!(a.write(&[0x12]).await, Ok(1));
            assert_eq!(a.read(&mut [0]).await, Ok(0), "closed");
            let mut b = dial(clients, b, PORT).await;
            assert_eq!(logged(), ["Some(RequestTooSlow)"]);
            for byte in [0x12, 0x34, 0, 0, 0, 6, 1, 3, 0] {
                assert_eq!(b.write(&[byte]).await, Ok(1));
                assert_eq!(b.flush().await, Ok(()));
            }
            assert_eq!(b.read(&mut [0]).await, Ok(0), "closed");
            let mut c = dial(clients, c, PORT).await;
            assert_eq!(logged(), ["Some(RequestTooSlow)"]);
            let request = [0x12, 0x34, 0, 0, 0, 6, 1, 3, 0, 100, 0, 2];
            for part in request.chunks(5) {
                assert_eq!(c.write(part).await, Ok(part.len()));
                assert_eq!(c.flush().await, Ok(()));
            }
            let mut response = [0; 9];
            assert_eq!(c.read(&mut response).await, Ok(9));
            assert_eq!(
                response,
                [0x12, 0x34, 0, 0, 0, 3, 1, 0x83, 0x0a],
                "a frame in parts is served, without a robot"
            );
            // without a frame there is no limit; the second request has its own
            Timer::after_millis(2500).await;
            assert_eq!(ask(&mut c, &[3, 0, 100, 0, 2]).await, [0x83, 0x0a]);
            assert_eq!(c.write(&[&request[..], &request[..7]].concat()).await, Ok(19));
            assert_eq!(c.read(&mut response).await, Ok(9));
            assert_eq!(c.read(&mut [0]).await, Ok(0), "closed");
            while plant.sessions() > 0 {
                Timer::after_millis(1).await;
            }
            assert_eq!(logged(), ["Some(RequestTooSlow)"]);
        };
        let ended = select(serve, with_timeout(Duration::from_secs(60), test)).await;
        assert!(matches!(ended, Either::Second(Ok(()))), "it hangs");
    });
}

#[test]
fn a_client_that_no_listener_can_serve_gets_an_exception_instead_of_a_reset() {
    static USAGE: Usage = Usage::new();
    let options = Options { usage: Some(&USAGE), ..Options::default() };
    between(|_, clients, board| async move {
        let map = [Entry::registers("100=I/1-2").unwrap()];
        let mut memory = Memory::<2, 4>::new();
        let plant = Plant::new(Gateway::new(Config::RC8, &mut memory), log);
        let serve = async {
            let mut memory = [[[0; 512]; 2]; 2];
            let [served, spare] =
                memory.each_mut().map(|[rx, tx]| ModbusListener::new(board, PORT, &map, [&mut rx[..], tx], options));
            let ([mut served, mut spare], limits) = ([served, spare], gateway::Limits::default());
            join(served.run(&plant, &limits), spare.refuse(&plant)).await;
        };
        let test = async {
            let mut memory = [[[0; 512]; 2]; 3];
            let [a, b, c] = &mut memory;
            let mut a = dial(clients, a, PORT).await;
            assert_eq!(ask(&mut a, &[3, 0, 100, 0, 2]).await, [0x83, 0x0a], "served, without a robot");
            let mut b = dial(clients, b, PORT).await;
            assert_eq!(ask(&mut b, &[3, 0, 100, 0, 2]).await, [0x83, 6]);
            assert_eq!(b.read(&mut [0]).await, Ok(0), "closed");
            a.close();
            assert_eq!(a.read(&mut [0]).await, Ok(0), "closed");
            let mut c = dial(clients, c, PORT).await;
            assert_eq!(ask(&mut c, &[3, 0, 100, 0, 2]).await, [0x83, 0x0a], "served");
        };
        let ended = select(serve, with_timeout(Duration::from_secs(60), test)).await;
        assert!(matches!(ended, Either::Second(Ok(()))), "it hangs");
    });
    assert_eq!(USAGE.most(), (12, 9), "a request and an exception");
}
