//! The clients and the server of bcap-std, over sockets of the loopback, in a runtime of one thread.

use std::cell::Cell;
use std::collections::BTreeMap;
use std::future::poll_fn;
use std::io;
use std::net::{Ipv4Addr, SocketAddr};
use std::pin::pin;
use std::rc::Rc;
use std::sync::{Arc, Mutex, mpsc};
use std::task::{Context, Poll, Waker};
use std::time::Duration;

use bcap_core::bcap::call::{self, ControllerHandle};
use bcap_core::bcap::client::{Client, Config, Timing};
use bcap_core::rac::{Variable, VariableKind};
use bcap_core::time::Instant;
use bcap_core::variant::Variant;
use bcap_std::Options;
use bcap_std::asynch::{
    Connection, SerialTransport, TcpTransport, Transport, UdpTransport, connect_rac, connect_tcp, connect_udp,
};
use bcap_std::server::Server;
use bcap_testkit::network::answer_to;
use bcap_tests::served::Application;
use tokio::io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt};
use tokio::net::{TcpListener, TcpStream, UdpSocket};
use tokio::task::{JoinHandle, spawn_blocking, spawn_local, yield_now};
use tokio_serial::SerialStream;

const ANY: (Ipv4Addr, u16) = (Ipv4Addr::LOCALHOST, 0);
const LATER: Duration = Duration::from_secs(60);
/// The time limits of the clients: not the defaults; short on UDP, where the tests let them pass.
const TCP: Timing = Timing { attempt_timeout: Duration::from_millis(2900), ..Timing::TCP };
const UDP: Timing = Timing { attempt_timeout: Duration::from_millis(40), attempts: 50, ..Timing::UDP };

/// Drops a future after `polls` polls, and returns its output if it ended before.
async fn dropped_after<T>(polls: usize, future: impl Future<Output = T>) -> Option<T> {
    let (mut future, mut left) = (pin!(future), polls);
    poll_fn(|context| match future.as_mut().poll(context) {
        Poll::Ready(output) => Poll::Ready(Some(output)),
        Poll::Pending => {
            left -= 1;
            if left == 0 { Poll::Ready(None) } else { Poll::Pending }
        }
    })
    .await
}

/// Polls a name lookup `polls` times, then drops it; the first poll never gets the answer.
///
/// The runtime has one thread for lookups, which is kept busy until then.
async fn dropped_in_lookup<T>(polls: usize, future: impl Future<Output = T>) -> Option<T> {
    let (release, released) = mpsc::channel::<()>();
    let busy = spawn_blocking(move || released.recv());
    let (mut future, mut release) = (pin!(future), Some(release));
    let looked_up = poll_fn(|context| {
        let polled = future.as_mut().poll(context);
        release = None;
        polled
    });
    let output = dropped_after(polls, looked_up).await;
    drop(busy.await);
    output
}

/// A server of the small application on free ports.
struct Served {
    application: Arc<Mutex<Application>>,
    tcp: SocketAddr,
    udp: SocketAddr,
    rac: SocketAddr,
    task: JoinHandle<io::Result<()>>,
}

impl Served {
    async fn start() -> Self {
        Self::of(Arc::default()).await
    }

    async fn of(application: Arc<Mutex<Application>>) -> Self {
        let server = Server::with_shared(Arc::clone(&application));
        let server = server.bcap_tcp(ANY).await.unwrap().bcap_udp(ANY).await.unwrap().rac_tcp(ANY).await.unwrap();
        let addresses = server.addresses();
        let (tcp, udp, rac) = (addresses.bcap_tcp[0], addresses.bcap_udp[0], addresses.rac_tcp[0]);
        Self { application, tcp, udp, rac, task: spawn_local(server.run(std::future::pending())) }
    }

    fn executed(&self, token: i32) -> u32 {
        self.application.lock().unwrap().executed.get(&token).copied().unwrap_or(0)
    }
}

impl Drop for Served {
    fn drop(&mut self) {
        self.task.abort();
    }
}

/// A transport that records until when its client was ready to wait.
struct Recorded<X> {
    inner: X,
    limits: Vec<Instant>,
}

impl<X: Transport> Transport for Recorded<X> {
    type Error = X::Error;

    fn now(&self) -> Instant {
        self.inner.now()
    }

    async fn send(&mut self, bytes: &[u8], until: Instant) -> Result<Option<usize>, X::Error> {
        self.limits.push(until);
        self.inner.send(bytes, until).await
    }

    async fn receive(&mut self, buffer: &mut [u8], until: Instant) -> Result<Option<usize>, X::Error> {
        // a deadline in the past reads the bytes that arrived before the call, and does not wait
        if until > self.now() {
            self.limits.push(until);
        }
        self.inner.receive(buffer, until).await
    }

    async fn sleep_until(&mut self, at: Instant) {
        self.inner.sleep_until(at).await;
    }
}

type Robot<X> = Connection<Recorded<X>, [u8; 512]>;

async fn open<X: Transport<Error = io::Error>>(inner: X, config: Config) -> (Robot<X>, ControllerHandle) {
    let recorded = Recorded { inner, limits: Vec::new() };
    let mut robot = Connection::new(recorded, Client::new(config, [0; 512], [0; 512]));
    robot.call(call::service_start("")).await.unwrap();
    let controller = robot.call(call::controller_connect("", "", "", "")).await.unwrap();
    (robot, controller)
}

async fn token<X: Transport<Error = io::Error>>(
    robot: &mut Robot<X>,
    controller: ControllerHandle,
    token: i32,
) -> Option<i32> {
    let reply = robot.call(call::controller_execute(controller, "token", [token, 0])).await;
    reply.ok().and_then(|value| value.as_i32())
}

/// Sends an ordinary call and checks its reply, its time limits and that it was executed once.
async fn check<X: Transport<Error = io::Error>>(
    robot: &mut Robot<X>,
    controller: ControllerHandle,
    server: &Served,
    number: i32,
    timeout: Duration,
) -> Instant {
    robot.transport().limits.clear();
    let before = bcap_std::now();
    assert_eq!(token(robot, controller, number).await, Some(answer_to(number)));
    let after = bcap_std::now();
    for until in &robot.transport().limits {
        let range = before.saturating_add(timeout)..=after.saturating_add(timeout);
        assert!(range.contains(until), "{until} is not in {range:?}");
    }
    assert_eq!(server.executed(number), 1, "token {number}");
    before
}

/// Passes bytes on, one at a time.
async fn drip(from: impl AsyncReadExt, to: impl AsyncWriteExt) {
    let (mut from, mut to) = (pin!(from), pin!(to));
    while let Ok(byte) = from.read_u8().await {
        if to.write_u8(byte).await.is_err() {
            return;
        }
        yield_now().await;
    }
}

/// A relay between clients and a server that passes single bytes.
async fn dripping(server: SocketAddr) -> (SocketAddr, JoinHandle<()>) {
    let listener = TcpListener::bind(ANY).await.unwrap();
    let address = listener.local_addr().unwrap();
    let relay = spawn_local(async move {
        while let Ok((client, _)) = listener.accept().await {
            let server = TcpStream::connect(server).await.unwrap();
            client.set_nodelay(true).unwrap();
            server.set_nodelay(true).unwrap();
            let ((from_client, to_client), (from_server, to_server)) = (client.into_split(), server.into_split());
            spawn_local(drip(from_client, to_server));
            spawn_local(drip(from_server, to_client));
        }
    });
    (address, relay)
}

/// Drops calls over TCP; returns the number of await points.
async fn tcp_calls() -> usize {
    let server = Served::start().await;
    let (relay, task) = dripping(server.tcp).await;
    let config = Config { timing: TCP, ..Config::TCP };
    for polls in 1.. {
        let transport = TcpTransport::new(TcpStream::connect(relay).await.unwrap());
        let (mut robot, controller) = open(transport, config).await;
        let number = i32::try_from(polls).unwrap() * 2;
        let ended = dropped_after(polls, token(&mut robot, controller, number)).await.is_some();
        check(&mut robot, controller, &server, number + 1, TCP.attempt_timeout).await;
        assert!(server.executed(number) <= 1, "after {polls} polls");
        if ended {
            task.abort();
            return polls - 1;
        }
    }
    unreachable!("the call ends")
}

/// Relays datagrams between a client and a server; drops as many requests as the returned counter says.
async fn lossy(server: SocketAddr) -> (SocketAddr, Rc<Cell<u32>>, JoinHandle<()>) {
    let (front, back) = (UdpSocket::bind(ANY).await.unwrap(), UdpSocket::bind(ANY).await.unwrap());
    back.connect(server).await.unwrap();
    let (address, lose) = (front.local_addr().unwrap(), Rc::new(Cell::new(0_u32)));
    let losing = Rc::clone(&lose);
    let relay = spawn_local(async move {
        let (mut request, mut reply, mut client) = ([0; 512], [0; 512], None);
        loop {
            tokio::select! {
                Ok((count, from)) = front.recv_from(&mut request) => {
                    client = Some(from);
                    match losing.get().checked_sub(1) {
                        Some(left) => losing.set(left),
                        None => drop(back.send(&request[..count]).await),
                    }
                }
                Ok(count) = back.recv(&mut reply) => {
                    front.send_to(&reply[..count], client.unwrap()).await.unwrap();
                }
            }
        }
    });
    (address, lose, relay)
}

/// Drops calls over UDP, whose first attempt is lost as well; returns the number of await points.
async fn udp_calls() -> usize {
    let server = Served::start().await;
    let mut points = 0;
    for lost in [0, 1] {
        for polls in 1.. {
            let (relay, lose, task) = lossy(server.udp).await;
            let socket = UdpSocket::bind(ANY).await.unwrap();
            socket.connect(relay).await.unwrap();
            let (mut robot, controller) = open(UdpTransport::new(socket), Config { timing: UDP, ..Config::UDP }).await;
            let number = i32::try_from(polls).unwrap() * 4 + lost * 1000;
            lose.set(u32::try_from(lost).unwrap());
            let ended = dropped_after(polls, token(&mut robot, controller, number)).await.is_some();
            lose.set(0);
            check(&mut robot, controller, &server, number + 1, UDP.attempt_timeout).await;
            // a repeated call: the first attempt has its full timeout, and the call is executed once
            lose.set(1);
            let before = check(&mut robot, controller, &server, number + 2, UDP.attempt_timeout).await;
            let limits = &robot.transport().limits;
            let first = limits.iter().min().unwrap();
            let second = limits.iter().max().unwrap();
            assert!(*first >= before.saturating_add(UDP.attempt_timeout));
            assert!(*second >= first.saturating_add(UDP.attempt_timeout), "{limits:?}");
            assert!(server.executed(number) <= 1, "after {polls} polls");
            task.abort();
            if ended {
                points += polls - 1;
                break;
            }
        }
    }
    points
}

/// Drops connecting, by a name that must be looked up; returns the number of await points of each function.
async fn connecting() -> [usize; 3] {
    let server = Served::start().await;
    let options = Options::default();
    let mut points = [0; 3];
    let robot = |port: SocketAddr| ("localhost", port.port());
    for polls in 1.. {
        let ended = dropped_in_lookup(polls, connect_tcp(robot(server.tcp), &options)).await.is_some();
        let mut next = connect_tcp(server.tcp, &options).await.unwrap();
        next.call(call::service_start("")).await.unwrap();
        points[0] = polls - 1;
        if ended {
            break;
        }
    }
    for polls in 1.. {
        let ended = dropped_in_lookup(polls, connect_rac(robot(server.rac), &options)).await.is_some();
        let mut next = connect_rac(server.rac, &options).await.unwrap();
        let (variable, number) = (Variable::new(VariableKind::I, 3), i32::try_from(polls).unwrap());
        next.put(variable, Variant::I4(number)).await.unwrap();
        assert_eq!(next.get(variable).await.unwrap(), Variant::I4(number));
        points[1] = polls - 1;
        if ended {
            break;
        }
    }
    for polls in 1.. {
        let ended = dropped_in_lookup(polls, connect_udp(robot(server.udp), &options)).await.is_some();
        let mut next = connect_udp(server.udp, &options).await.unwrap();
        next.call(call::service_start("")).await.unwrap();
        points[2] = polls - 1;
        if ended {
            break;
        }
    }
    points
}

/// Returns byte `n` of a stream that repeats only after a prime number of bytes.
fn byte_at(n: usize) -> u8 {
    u8::try_from(n % 251).unwrap()
}

/// Returns the two ends of a TCP connection.
async fn connection() -> (TcpTransport, TcpStream) {
    let listener = TcpListener::bind(ANY).await.unwrap();
    let transport = TcpTransport::new(TcpStream::connect(listener.local_addr().unwrap()).await.unwrap());
    (transport, listener.accept().await.unwrap().0)
}

/// Returns the two ends of a serial line.
async fn line() -> (SerialTransport, SerialStream) {
    let (peer, port) = SerialStream::pair().expect("a pair of pseudo-terminals");
    (SerialTransport::new(port), peer)
}

/// Drops `send` of `total` bytes on a stream that takes nothing; returns the number of polls.
async fn stream_send<X: Transport<Error = io::Error>, P: AsyncRead + Unpin + 'static>(
    ends: impl AsyncFn() -> (X, P),
    total: usize,
) -> usize {
    let mut points = 0;
    for polls in 1..=4 {
        let (mut transport, mut peer) = ends().await;
        let bytes: Vec<u8> = (0..total).map(byte_at).collect();
        let until = transport.now().saturating_add(LATER);
        let mut sent = 0;
        let mut context = Context::from_waker(Waker::noop());
        // until the buffers of both ends are full
        loop {
            let (mut work, mut pending) = (pin!(transport.send(&bytes[sent..], until)), 0);
            while pending < polls {
                if let Poll::Ready(count) = work.as_mut().poll(&mut context) {
                    sent += count.unwrap().unwrap();
                    break;
                }
                pending += 1;
                yield_now().await;
            }
            if pending == polls {
                points += polls;
                break;
            }
        }
        assert!(sent < total, "the buffers are smaller");
        let reader = spawn_local(async move {
            let mut received = vec![0; total];
            peer.read_exact(&mut received).await.unwrap();
            received
        });
        while sent < total {
            sent += transport.send(&bytes[sent..], until).await.unwrap().unwrap();
        }
        assert!(reader.await.unwrap() == bytes, "bytes were lost or sent twice, after {polls} polls");
    }
    points
}

/// Drops `receive` between bytes that arrive one at a time; returns the number of await points.
async fn stream_receive<X: Transport<Error = io::Error>, P: AsyncWrite + Unpin + 'static>(
    (mut transport, mut peer): (X, P),
) -> usize {
    let mut points = 0;
    let bytes: Vec<u8> = (0..2000).map(byte_at).collect();
    let sent = bytes.clone();
    let dripping = spawn_local(async move {
        drip(&sent[..], &mut peer).await;
        // a serial line that is closed drops unread bytes
        std::future::pending::<()>().await;
    });
    let until = transport.now().saturating_add(LATER);
    let (mut received, mut buffer) = (Vec::<u8>::new(), [0; 16]);
    while received.len() < bytes.len() {
        match dropped_after(1, transport.receive(&mut buffer, until)).await {
            Some(count) => received.extend(&buffer[..count.unwrap().unwrap()]),
            None => points += 1,
        }
        yield_now().await;
    }
    assert_eq!(received, bytes);
    dripping.abort();
    points
}

/// Drops `receive`, and tries `send`, of datagrams; returns the number of await points of both.
async fn udp_transport() -> [usize; 2] {
    let (socket, peer) = (UdpSocket::bind(ANY).await.unwrap(), UdpSocket::bind(ANY).await.unwrap());
    socket.connect(peer.local_addr().unwrap()).await.unwrap();
    peer.connect(socket.local_addr().unwrap()).await.unwrap();
    let mut transport = UdpTransport::new(socket);
    let until = transport.now().saturating_add(LATER);
    let (mut points, mut sends) = (0, 0);
    let mut buffer = [0; 8];
    for number in 0..50_u8 {
        // dropped before bytes arrive
        points += usize::from(dropped_after(1, transport.receive(&mut buffer, until)).await.is_none());
        peer.send(&[number; 5]).await.unwrap();
        assert_eq!(transport.receive(&mut buffer, until).await.unwrap(), Some(5));
        assert_eq!(buffer[..5], [number; 5]);
        // a send that is not ready has sent nothing
        let sent = dropped_after(1, transport.send(&[number; 3], until)).await;
        if sent.is_none() {
            sends += 1;
            transport.send(&[number; 3], until).await.unwrap();
        }
        assert_eq!(peer.recv(&mut buffer).await.unwrap(), 3);
        assert_eq!(buffer[..3], [number; 3]);
    }
    assert_eq!(peer.try_recv(&mut buffer).unwrap_err().kind(), io::ErrorKind::WouldBlock);
    [points, sends]
}

/// Drops a pause; the next pause has its full length.
async fn sleeping<X: Transport>(mut transport: X) -> usize {
    let soon = |transport: &X| transport.now().saturating_add(Duration::from_millis(3));
    let at = soon(&transport);
    let dropped = dropped_after(1, transport.sleep_until(at)).await.is_none();
    let at = soon(&transport);
    transport.sleep_until(at).await;
    assert!(transport.now() >= at);
    usize::from(dropped)
}

/// Drops the functions that bind a server; returns the number of await points of each.
async fn binding() -> [usize; 3] {
    let mut points = [0; 3];
    let any = ("localhost", 0);
    for polls in 1..=3 {
        let server = || Server::new(Application::default());
        points[0] += usize::from(dropped_in_lookup(polls, server().bcap_tcp(any)).await.is_none());
        points[1] += usize::from(dropped_in_lookup(polls, server().bcap_udp(any)).await.is_none());
        points[2] += usize::from(dropped_in_lookup(polls, server().rac_tcp(any)).await.is_none());
        let served = Served::start().await;
        let mut robot = connect_tcp(served.tcp, &Options::default()).await.unwrap();
        robot.call(call::service_start("")).await.unwrap();
    }
    points
}

/// Drops a server after 1, 2, ... steps of its tasks, during calls of a client; returns the number of steps.
async fn running() -> usize {
    const STEPS: usize = 120;
    for steps in 1..=STEPS {
        let mut served = Served::start().await;
        let config = Config { timing: TCP, ..Config::TCP };
        let address = served.tcp;
        let client = spawn_local(async move {
            let transport = TcpTransport::new(TcpStream::connect(address).await?);
            let recorded = Recorded { inner: transport, limits: Vec::new() };
            let mut robot = Connection::new(recorded, Client::new(config, [0; 512], [0; 512]));
            let started = robot.call(call::service_start("")).await.is_ok();
            let Ok(controller) = robot.call(call::controller_connect("", "", "", "")).await else { return Ok(0) };
            let mut done = i32::from(started);
            while token(&mut robot, controller, done).await == Some(answer_to(done)) {
                done += 1;
            }
            Ok::<_, io::Error>(done)
        });
        for _ in 0..steps {
            yield_now().await;
        }
        served.task.abort();
        // the client's call ends, and each call that was answered has been executed once
        let answered = client.await.unwrap().unwrap_or_default();
        assert!((1..answered).all(|token| served.executed(token) == 1), "after {steps} steps");
        assert!(served.application.lock().unwrap().executed.values().all(|count| *count == 1), "after {steps} steps");
        // the handler serves another server's peers
        let application = std::mem::take(&mut served.application);
        let next = Served::of(application).await;
        let transport = TcpTransport::new(TcpStream::connect(next.tcp).await.unwrap());
        let (mut robot, controller) = open(transport, config).await;
        check(&mut robot, controller, &next, 1_000_000, TCP.attempt_timeout).await;
    }
    STEPS
}

/// Drops the functions of bcap-std at every await point; returns how many each has.
pub(crate) fn all() -> BTreeMap<&'static str, usize> {
    let runtime = tokio::runtime::Builder::new_current_thread().max_blocking_threads(1).enable_all().build().unwrap();
    tokio::task::LocalSet::new().block_on(&runtime, async {
        let (tcp, udp) = (tcp_calls().await, udp_calls().await);
        let [connect_tcp, connect_rac, connect_udp] = connecting().await;
        let [datagrams, sent_datagrams] = udp_transport().await;
        let [bcap_tcp, bcap_udp, rac_tcp] = binding().await;
        let listener = TcpListener::bind(ANY).await.unwrap();
        let stream = TcpStream::connect(listener.local_addr().unwrap()).await.unwrap();
        let socket = UdpSocket::bind(ANY).await.unwrap();
        BTreeMap::from([
            ("SerialTransport::send", stream_send(line, 1 << 20).await),
            ("SerialTransport::receive", stream_receive(line().await).await),
            ("SerialTransport::sleep_until", sleeping(line().await.0).await),
            ("TcpTransport::send", stream_send(connection, 8 << 20).await),
            ("TcpTransport::receive", stream_receive(connection().await).await + tcp),
            ("TcpTransport::sleep_until", sleeping(TcpTransport::new(stream)).await),
            ("UdpTransport::send", sent_datagrams + udp),
            ("UdpTransport::receive", datagrams + udp),
            ("UdpTransport::sleep_until", sleeping(UdpTransport::new(socket)).await),
            ("connect_tcp", connect_tcp),
            ("connect_rac", connect_rac),
            ("connect_udp", connect_udp),
            ("bcap_tcp", bcap_tcp),
            ("bcap_udp", bcap_udp),
            ("rac_tcp", rac_tcp),
            ("Server::run", running().await),
        ])
    })
}
