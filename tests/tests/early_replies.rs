//! Tests that no client accepts a reply that a server sent before the request.

use std::io::{Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream, UdpSocket};
use std::sync::mpsc::{self, Receiver, Sender};
use std::thread;
use std::time::Duration;

use bcap_core::bcap::call::{self, VariableHandle};
use bcap_core::bcap::{Decoder, FrameWriter, Progress};
use bcap_core::io::RacError;
use bcap_core::rac::client::ClientError;
use bcap_core::rac::{Variable, VariableKind};
use bcap_core::variant::Variant;
use bcap_std::{Options, asynch, blocking};

const ROUNDS: i32 = 20;
const FORGED: i32 = 666;

fn reply(serial: u16, value: i32) -> Vec<u8> {
    let mut buffer = [0; 64];
    let mut frame = FrameWriter::new(&mut buffer).unwrap();
    frame.argument(&value).unwrap();
    frame.finish(serial, 0, 0).unwrap().to_vec()
}

/// Returns the serial after this one.
fn next(serial: u16) -> u16 {
    serial.checked_add(1).unwrap_or(1)
}

/// A server, and a message for each forged reply that it has sent.
type Server = (SocketAddr, Receiver<()>);

/// Sends the reply to the first request before that arrives, and with each reply the one to the next request.
fn serve_together() -> Server {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap();
    let (sent, forged) = mpsc::channel();
    thread::spawn(move || {
        let (mut stream, _) = listener.accept().unwrap();
        stream.write_all(&reply(1, FORGED)).unwrap();
        sent.send(()).unwrap();
        for count in 0.. {
            let Some(serial) = request(&mut stream) else { return };
            let both = [reply(serial, count), reply(next(serial), FORGED)].concat();
            let _ = stream.write_all(&both);
        }
    });
    (address, forged)
}

/// Sends the reply to the next request early, after a message that the previous request has its reply.
fn serve_apart() -> (Server, Sender<()>) {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap();
    let ((sent, forged), (done, called)) = (mpsc::channel(), mpsc::channel::<()>());
    thread::spawn(move || {
        let (mut stream, _) = listener.accept().unwrap();
        stream.set_nodelay(true).unwrap();
        for count in 0.. {
            let Some(serial) = request(&mut stream) else { return };
            stream.write_all(&reply(serial, count)).unwrap();
            let Ok(()) = called.recv() else { return };
            stream.write_all(&reply(next(serial), FORGED)).unwrap();
            sent.send(()).unwrap();
        }
    });
    ((address, forged), done)
}

/// Reads a request and returns its serial; `None` when the client has closed.
fn request(stream: &mut TcpStream) -> Option<u16> {
    let (mut buffer, mut len) = ([0; 512], 0);
    loop {
        len += stream.read(&mut buffer[len..]).ok().filter(|count| *count > 0)?;
        if let Progress::Complete(frame, _) = Decoder::TCP.decode(&buffer[..len]).unwrap() {
            return Some(frame.serial);
        }
    }
}

fn serve_udp() -> Server {
    let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
    let address = socket.local_addr().unwrap();
    let (sent, forged) = mpsc::channel();
    thread::spawn(move || {
        let mut buffer = [0; 512];
        for count in 0..ROUNDS {
            let (length, from) = socket.recv_from(&mut buffer).unwrap();
            let serial = Decoder::UDP.decode_datagram(&buffer[..length]).unwrap().serial;
            socket.send_to(&reply(serial, count), from).unwrap();
            socket.send_to(&reply(next(serial), FORGED), from).unwrap();
            sent.send(()).unwrap();
        }
    });
    (address, forged)
}

fn serve_rac() -> Server {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap();
    let (sent, forged) = mpsc::channel();
    thread::spawn(move || {
        let (mut stream, _) = listener.accept().unwrap();
        stream.write_all(b"0,3,666\r").unwrap();
        sent.send(()).unwrap();
        let _ = stream.read(&mut [0; 64]);
        let _ = stream.write_all(b"0,3,1\r");
    });
    (address, forged)
}

/// Options of a client that retransmits nothing.
fn patient() -> Options {
    Options::default().timeout(Duration::from_secs(30))
}

fn get() -> impl bcap_core::bcap::call::Call<Reply = call::Any> {
    call::variable_get_value(VariableHandle(1))
}

/// Calls both servers over TCP; `$wait` is `.await` or nothing.
macro_rules! over_tcp {
    ($clients:ident $(, $wait:tt)?) => {{
        let (address, forged) = serve_together();
        let mut client = $clients::connect_tcp(address, &Options::default())$(.$wait)?.unwrap();
        forged.recv().unwrap();
        // it has not only been sent, it is there
        client.transport().stream().peek(&mut [0])$(.$wait)?.unwrap();
        for count in 0..ROUNDS {
            assert_eq!(client.call(get())$(.$wait)?.unwrap(), Variant::I4(count));
        }

        let ((address, forged), done) = serve_apart();
        let mut client = $clients::connect_tcp(address, &Options::default())$(.$wait)?.unwrap();
        for count in 0..ROUNDS {
            assert_eq!(client.call(get())$(.$wait)?.unwrap(), Variant::I4(count));
            done.send(()).unwrap();
            forged.recv().unwrap();
            client.transport().stream().peek(&mut [0])$(.$wait)?.unwrap();
        }
    }};
}

macro_rules! over_udp {
    ($clients:ident $(, $wait:tt)?) => {{
        let (address, forged) = serve_udp();
        let mut client = $clients::connect_udp(address, &patient())$(.$wait)?.unwrap();
        for count in 0..ROUNDS {
            assert_eq!(client.call(get())$(.$wait)?.unwrap(), Variant::I4(count));
            forged.recv().unwrap();
            client.transport().socket().peek(&mut [0; 64])$(.$wait)?.unwrap();
        }
    }};
}

macro_rules! over_rac {
    ($clients:ident $(, $wait:tt)?) => {{
        let (address, forged) = serve_rac();
        let mut client = $clients::connect_rac(address, &Options::default())$(.$wait)?.unwrap();
        forged.recv().unwrap();
        client.transport().stream().peek(&mut [0])$(.$wait)?.unwrap();
        let error = client.get(Variable::new(VariableKind::I, 1))$(.$wait)?.unwrap_err();
        assert!(matches!(error, RacError::Client(ClientError::Unsolicited)), "{error}");
    }};
}

#[test]
fn blocking_clients_drop_them_and_one_of_rac_ends_its_session() {
    over_tcp!(blocking);
    over_udp!(blocking);
    over_rac!(blocking);
}

#[tokio::test]
async fn tokio_clients_drop_them_and_one_of_rac_ends_its_session() {
    over_tcp!(asynch, await);
    over_udp!(asynch, await);
    over_rac!(asynch, await);
}

#[test]
fn clients_over_udp_begin_with_serials_of_their_own() {
    let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
    let address = socket.local_addr().unwrap();
    let server = thread::spawn(move || {
        let mut buffer = [0; 512];
        let serials = (0..20).map(|_| {
            let (length, from) = socket.recv_from(&mut buffer).unwrap();
            let frame = Decoder::UDP.decode_datagram(&buffer[..length]).unwrap();
            assert_eq!(frame.serial, frame.reserved);
            let serial = frame.serial;
            socket.send_to(&reply(serial, 0), from).unwrap();
            serial
        });
        serials.collect::<std::collections::BTreeSet<u16>>()
    });
    for _ in 0..20 {
        let mut client = blocking::connect_udp(address, &patient()).unwrap();
        client.call(get()).unwrap();
    }
    let serials = server.join().unwrap();
    assert!(!serials.contains(&0) && serials.len() > 10, "{serials:?}");
}
