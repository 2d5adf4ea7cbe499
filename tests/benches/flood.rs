//! Measures the processor time that a client and a gateway use in 5 s under a flood of S_EXECUTING.
//!
//! ```text
//! cargo bench -p bcap-tests --bench flood
//! ```
//!
//! A server answers a few requests and then sends S_EXECUTING as fast as it can, for the serial of the next request or to none.
//! The client makes calls in sequence, and reconnects after 100 ms when its session ends. The gateway is the core's, run by a
//! blocking loop, with a PLC that reads a variable continuously. The benchmark fails above 5 % of a processor. The server's own
//! work is not counted.

use std::io::{self, Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream, UdpSocket};
use std::process::ExitCode;
use std::thread;
use std::time::{Duration, Instant};

use bcap_core::bcap::call::{self, VariableHandle};
use bcap_core::bcap::{Decoder, FrameWriter, FunctionId, Progress};
use bcap_core::handler::PeerId;
use bcap_core::hresult::HResult;
use bcap_gateway::Gateway;
use bcap_std::{Options, blocking};

const TIME: Duration = Duration::from_secs(5);
/// The share of a processor that a flood may cost.
const BAR: f64 = 5.0;

fn main() -> ExitCode {
    let mut within = true;
    println!("{:<44} {:>12} {:>10}", "flooded for 5 s", "processor", "sessions");
    for (name, victim) in [
        ("client, TCP, a call in flight", tcp_client as fn() -> u64),
        ("client, UDP, a call in flight", udp_client),
        ("gateway, TCP, calls in flight", || gateway(true)),
        ("gateway, TCP, no call in flight", || gateway(false)),
    ] {
        let measured = thread::spawn(move || {
            let sessions = victim();
            (processor_time(), sessions)
        });
        let (Some(busy), sessions) = measured.join().expect("the victim does not panic") else {
            println!("{name:<44} {:>12}", "not measured");
            continue;
        };
        let share = 100.0 * busy.as_secs_f64() / TIME.as_secs_f64();
        let verdict = if share <= BAR { "" } else { "  OVER THE BAR" };
        println!("{name:<44} {share:>10.1} % {sessions:>10}{verdict}");
        within &= share <= BAR;
    }
    if within { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}

/// Returns how long this thread has been on a processor; `None` where the system does not report it.
fn processor_time() -> Option<Duration> {
    let line = std::fs::read_to_string("/proc/thread-self/schedstat").ok()?;
    line.split(' ').next()?.parse().ok().map(Duration::from_nanos)
}

// --- the server --------------------------------------------------------------------------------------------------------

fn reply(serial: u16, code: HResult, value: Option<i32>) -> Vec<u8> {
    let mut buffer = [0; 64];
    let mut frame = FrameWriter::new(&mut buffer).expect("there is room");
    if let Some(value) = value {
        frame.argument(&value).expect("there is room");
    }
    frame.finish(serial, 0, code.0).expect("there is room").to_vec()
}

/// Answers `right` requests of each connection and floods it then, with the serial of the next request.
fn flooding_tcp(right: usize) -> SocketAddr {
    let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
    let address = listener.local_addr().expect("an address");
    thread::spawn(move || {
        for stream in listener.incoming().flatten() {
            thread::spawn(move || flood(stream, right));
        }
    });
    address
}

fn flood(mut stream: TcpStream, right: usize) -> io::Result<()> {
    let (mut buffer, mut len, mut serial) = ([0; 512], 0, 0);
    for _ in 0..right {
        serial = loop {
            len += match stream.read(&mut buffer[len..])? {
                0 => return Ok(()),
                count => count,
            };
            if let Ok(Progress::Complete(frame, _)) = Decoder::TCP.decode(&buffer[..len]) {
                let opens = frame.function() == FunctionId::CONTROLLER_CONNECT;
                stream.write_all(&reply(frame.serial, HResult::S_OK, opens.then_some(1)))?;
                break frame.serial;
            }
        };
        len = 0;
    }
    let frames = reply(serial + 1, HResult::S_EXECUTING, None).repeat(1000);
    loop {
        stream.write_all(&frames)?;
    }
}

fn flooding_udp() -> SocketAddr {
    let socket = UdpSocket::bind("127.0.0.1:0").expect("a port");
    let address = socket.local_addr().expect("an address");
    thread::spawn(move || -> io::Result<()> {
        let mut buffer = [0; 512];
        loop {
            // the client of the last request is flooded
            let (length, from) = socket.recv_from(&mut buffer)?;
            let frame = Decoder::UDP.decode_datagram(&buffer[..length]).map_err(io::Error::other)?;
            let executing = reply(frame.serial, HResult::S_EXECUTING, None);
            socket.set_nonblocking(true)?;
            while socket.peek_from(&mut [0]).is_err() {
                for _ in 0..100 {
                    let _ = socket.send_to(&executing, from);
                }
            }
            socket.set_nonblocking(false)?;
        }
    });
    address
}

// --- the victims -------------------------------------------------------------------------------------------------------

fn tcp_client() -> u64 {
    let address = flooding_tcp(0);
    client(|| blocking::connect_tcp(address, &options()))
}

fn udp_client() -> u64 {
    let address = flooding_udp();
    client(|| blocking::connect_udp(address, &options()))
}

/// No call takes longer than the measurement.
fn options() -> Options {
    let mut options = Options::default();
    options.tcp.timing.deadline = TIME;
    options.udp.timing.deadline = TIME;
    options
}

/// Makes calls for the time of the measurement; returns how many sessions that took.
fn client<X: blocking::Transport>(
    mut connect: impl FnMut() -> Result<blocking::Connection<X, Vec<u8>>, bcap_std::ConnectError>,
) -> u64 {
    let (begun, mut sessions) = (Instant::now(), 0);
    while begun.elapsed() < TIME {
        let Ok(mut client) = connect() else { continue };
        sessions += 1;
        while begun.elapsed() < TIME {
            let ended = client.call(call::variable_get_value(VariableHandle(1)));
            if ended.is_err_and(|error| !error.is_recoverable()) {
                break;
            }
        }
        drop(client);
        thread::sleep(Duration::from_millis(100));
    }
    sessions
}

/// Runs a gateway for the time of the measurement, with or without a PLC that sends requests; returns the number of its
/// sessions.
fn gateway(asks: bool) -> u64 {
    // the session is begun and the controller connected before the flood
    let address = flooding_tcp(2);
    let mut memory = bcap_gateway::Memory::<1, 8>::new();
    let mut gateway = Gateway::new(bcap_gateway::Config::RC8, &mut memory);
    let plc = gateway.open().filter(|_| asks);
    let (begun, mut sessions, mut robot) = (Instant::now(), 0, None);
    let now = || bcap_core::time::Instant::ZERO.saturating_add(begun.elapsed());
    while begun.elapsed() < TIME {
        if let Some(plc) = plc {
            ask(&mut gateway, plc);
        }
        while let Some(event) = gateway.poll_event(now()) {
            sessions += u64::from(event == bcap_gateway::Event::RobotUp);
        }
        let deadline = gateway.poll_timeout().map_or(TIME, |deadline| deadline.saturating_since(now()));
        let wait = deadline.clamp(Duration::from_millis(1), Duration::from_millis(50));
        match (robot.take(), gateway.robot_wanted()) {
            (Some(stream), true) => match transfer(&mut gateway, &stream, wait) {
                Ok(()) => robot = Some(stream),
                Err(_) => gateway.robot_closed(now()),
            },
            (Some(_), false) => gateway.robot_closed(now()),
            (None, true) => {
                robot = TcpStream::connect(address).ok();
                match robot {
                    Some(_) => gateway.robot_opened(now()),
                    None => gateway.robot_closed(now()),
                }
            }
            (None, false) => thread::sleep(wait),
        }
    }
    sessions
}

/// Requests a variable when the last answer has been read.
fn ask(gateway: &mut Gateway<'_>, plc: PeerId) {
    let answered = gateway.transmit(plc).len();
    gateway.transmitted(plc, answered);
    let line = b"GET:RC8:1:I:\r";
    if gateway.is_up()
        && !gateway.is_running(plc)
        && let Some(room) = gateway.receive_buffer(plc).get_mut(..line.len())
    {
        room.copy_from_slice(line);
        gateway.received(plc, line.len());
    }
}

/// Moves bytes between the gateway and the robot.
fn transfer(gateway: &mut Gateway<'_>, mut stream: &TcpStream, wait: Duration) -> io::Result<()> {
    let request = gateway.robot_transmit();
    if !request.is_empty() {
        let sent = stream.write(request)?;
        gateway.robot_transmitted(sent);
        return Ok(());
    }
    stream.set_read_timeout(Some(wait))?;
    match stream.read(gateway.robot_receive_buffer()) {
        Ok(0) => Err(io::ErrorKind::UnexpectedEof.into()),
        Ok(count) => {
            gateway.robot_received(count);
            Ok(())
        }
        Err(error) if matches!(error.kind(), io::ErrorKind::WouldBlock | io::ErrorKind::TimedOut) => Ok(()),
        Err(error) => Err(error),
    }
}
