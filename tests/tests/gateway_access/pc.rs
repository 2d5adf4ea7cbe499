//! The gateway of `bcap-std`, on sockets of the loopback.

use std::io::{self, ErrorKind};
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr};
use std::sync::mpsc;
use std::time::Duration;

use bcap_gateway::{Config, Gateway, Memory};
use bcap_std::gateway::{Driver, Report};
use socket2::{Domain, Socket, Type};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpListener, TcpSocket};
use tokio::time::timeout;

use super::{Protocol, Run, map};

/// Runs a gateway with listeners for IPv4; for a client without an IPv4 address, with listeners for IPv6.
pub(crate) fn run(config: Config<'static>, from: Option<Ipv4Addr>, protocol: Protocol, requests: &[Vec<u8>]) -> Run {
    let address = from.map_or(IpAddr::V6(Ipv6Addr::LOCALHOST), |_| IpAddr::V4(Ipv4Addr::LOCALHOST));
    run_at(address, config, from, protocol, requests)
}

/// Runs a gateway with listeners for both versions: a client over IPv4 has the address `::ffff:127.0.0.7` there.
pub(crate) fn run_mapped(
    config: Config<'static>,
    from: Option<Ipv4Addr>,
    protocol: Protocol,
    requests: &[Vec<u8>],
) -> Run {
    run_at(Ipv6Addr::UNSPECIFIED.into(), config, from, protocol, requests)
}

fn run_at(
    address: IpAddr,
    config: Config<'static>,
    from: Option<Ipv4Addr>,
    protocol: Protocol,
    requests: &[Vec<u8>],
) -> Run {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    runtime.block_on(async {
        let (rac, modbus) = (listen(address), listen(address));
        let port = match protocol {
            Protocol::Rac => rac.local_addr().unwrap().port(),
            Protocol::Modbus => modbus.local_addr().unwrap().port(),
        };
        let (log, reports) = mpsc::channel();
        let gateway = Gateway::new(config, Box::leak(Box::new(Memory::<2, 4>::new())));
        // no robot: no server listens on this port
        let driver = Driver::new(gateway, ("127.0.0.1", 1), move |report| match *report {
            Report::Connected { .. } => log.send("connected".to_owned()).unwrap(),
            Report::Denied { reason, .. } => log.send(format!("denied: {reason:?}")).unwrap(),
            _ => {}
        });
        let client = ask(port, from, protocol, requests);
        let responses = tokio::select! {
            _ = driver.modbus(modbus, map()).run(rac, std::future::pending()) => unreachable!(),
            responses = timeout(Duration::from_secs(60), client) => responses.expect("it hangs"),
        };
        Run { responses, reports: reports.try_iter().collect() }
    })
}

fn listen(address: IpAddr) -> TcpListener {
    let socket = Socket::new(Domain::for_address((address, 0).into()), Type::STREAM, None).unwrap();
    if address == Ipv6Addr::UNSPECIFIED {
        socket.set_only_v6(false).unwrap();
    }
    socket.bind(&SocketAddr::from((address, 0)).into()).unwrap();
    socket.listen(8).unwrap();
    socket.set_nonblocking(true).unwrap();
    TcpListener::from_std(socket.into()).unwrap()
}

/// Returns a response for each request; `None` after a reset.
async fn ask(port: u16, from: Option<Ipv4Addr>, protocol: Protocol, requests: &[Vec<u8>]) -> Option<Vec<Vec<u8>>> {
    let (socket, to) = match from {
        Some(from) => {
            let socket = TcpSocket::new_v4().unwrap();
            socket.bind((from, 0).into()).unwrap();
            (socket, SocketAddr::from((Ipv4Addr::LOCALHOST, port)))
        }
        None => (TcpSocket::new_v6().unwrap(), (Ipv6Addr::LOCALHOST, port).into()),
    };
    // a reset may arrive before this task runs again
    let mut stream = unless_reset(socket.connect(to).await)?;
    let mut responses = Vec::new();
    for request in requests {
        unless_reset(stream.write_all(request).await)?;
        let mut response = Vec::new();
        while !protocol.is_complete(&response) {
            let mut byte = [0];
            assert_eq!(unless_reset(stream.read(&mut byte).await)?, 1, "closed after {response:?}");
            response.extend(byte);
        }
        responses.push(response);
    }
    Some(responses)
}

fn unless_reset<T>(result: io::Result<T>) -> Option<T> {
    result.inspect_err(|error| assert!(matches!(error.kind(), ErrorKind::ConnectionReset | ErrorKind::BrokenPipe))).ok()
}
