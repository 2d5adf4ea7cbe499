//! The gateway's driver of bcap-std, dropped while a PLC writes to a robot over TCP or UDP.

use std::collections::BTreeMap;
use std::io;
use std::net::{Ipv4Addr, SocketAddr};
use std::sync::{Arc, Mutex};

use bcap_core::bcap::Link;
use bcap_core::bcap::client;
use bcap_core::rac::VariableKind;
use bcap_gateway::{Allow, Config, Counters, Event, Gateway, Memory, Rules};
use bcap_std::gateway::{Driver, Report};
use bcap_std::server::{Limits, Server};
use bcap_tests::served::Application;
use tokio::io::{AsyncBufReadExt as _, AsyncWriteExt as _, BufReader};
use tokio::net::{TcpListener, TcpStream};
use tokio::task::{JoinHandle, LocalSet, spawn_local, yield_now};

const ANY: (Ipv4Addr, u16) = (Ipv4Addr::LOCALHOST, 0);

/// Starts a gateway that allows every PUT to I variables; returns its address and its task.
async fn start(link: Link, robot: SocketAddr, up: Arc<Mutex<bool>>) -> (SocketAddr, JoinHandle<Counters>) {
    let client = if link == Link::Datagram { client::Config::UDP } else { client::Config::TCP };
    let rules = Rules { put: const { &[Allow::all(VariableKind::I)] }, ..Rules::READ_ONLY };
    let config = Config { client, rules, ..Config::RC8 };
    let gateway = Gateway::new(config, Box::leak(Box::new(Memory::<2, 4>::new())));
    let listener = TcpListener::bind(ANY).await.unwrap();
    let address = listener.local_addr().unwrap();
    let log = move |report: &Report<'_>| {
        if matches!(report, Report::Robot { event: Event::RobotUp, .. }) {
            *up.lock().unwrap() = true;
        }
    };
    let driver = Driver::new(gateway, (robot.ip().to_string(), robot.port()), log);
    (address, spawn_local(driver.run(listener, std::future::pending())))
}

async fn ask(plc: &mut BufReader<TcpStream>, line: String) -> io::Result<String> {
    plc.get_mut().write_all(line.as_bytes()).await?;
    let mut answer = Vec::new();
    plc.read_until(b'\r', &mut answer).await?;
    String::from_utf8(answer).map_err(io::Error::other)
}

/// Writes 1, 2, 3, ... to I1 until the connection ends; returns the last number that was answered.
async fn write(address: SocketAddr) -> io::Result<i32> {
    let mut plc = BufReader::new(TcpStream::connect(address).await?);
    let mut written = 0;
    loop {
        match ask(&mut plc, format!("PUT:RC8:1:I:3,{}\r", written + 1)).await.as_deref() {
            Ok("0\r") => written += 1,
            // until the robot is connected
            Ok("-2147481342\r") => {}
            _ => return Ok(written),
        }
    }
}

/// Drops gateways after 1, 2, ... steps of their tasks; returns the number of steps.
async fn dropped(link: Link, robot: SocketAddr) -> usize {
    const STEPS: usize = 120;
    for steps in 1..=STEPS {
        let (first, task) = start(link, robot, Arc::default()).await;
        let writer = spawn_local(write(first));
        for _ in 0..steps {
            yield_now().await;
        }
        task.abort();
        let written = writer.await.unwrap().unwrap_or_default();
        assert!(TcpStream::connect(first).await.is_err(), "{link:?}, {steps} steps: it still listens");
        // another gateway works, and at most one write was not answered
        let is_up = Arc::new(Mutex::new(false));
        let (next, task) = start(link, robot, Arc::clone(&is_up)).await;
        while !*is_up.lock().unwrap() {
            yield_now().await;
        }
        let mut plc = BufReader::new(TcpStream::connect(next).await.unwrap());
        let found = ask(&mut plc, "GET:RC8:1:I:\r".into()).await.unwrap();
        let expected = [written, written + 1].map(|value| format!("0,3,{value}\r"));
        assert!(expected.contains(&found), "{link:?}, {steps} steps: {found:?} after {written}");
        assert_eq!(ask(&mut plc, "PUT:RC8:1:I:3,0\r".into()).await.unwrap(), "0\r");
        task.abort();
    }
    STEPS
}

/// Drops the driver over both links; returns the number of steps at which it was dropped.
pub(crate) fn all() -> BTreeMap<&'static str, usize> {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    LocalSet::new().block_on(&runtime, async {
        // a dropped gateway leaves its session over UDP behind
        let limits = Limits::default().udp_peers(1000).udp_peers_per_address(1000);
        let server = Server::new(Application::default()).limits(limits);
        let server = server.bcap_tcp(ANY).await.unwrap().bcap_udp(ANY).await.unwrap();
        let addresses = server.addresses();
        let robot = spawn_local(server.run(std::future::pending()));
        // the variable exists before the first gateway is dropped
        let (first, task) = start(Link::Stream, addresses.bcap_tcp[0], Arc::default()).await;
        let mut plc = BufReader::new(TcpStream::connect(first).await.unwrap());
        while ask(&mut plc, "PUT:RC8:1:I:3,0\r".into()).await.unwrap() != "0\r" {}
        task.abort();
        let steps = dropped(Link::Stream, addresses.bcap_tcp[0]).await;
        let steps = steps + dropped(Link::Datagram, addresses.bcap_udp[0]).await;
        robot.abort();
        BTreeMap::from([("Driver::run", steps)])
    })
}
