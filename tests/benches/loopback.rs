//! Round trips over loopback TCP, and a server with 100 connections, each compared with a minimal implementation.
//!
//! ```text
//! cargo bench -p bcap-tests --bench loopback
//! ```
//!
//! The frames are as in a Slave Mode cycle: a request of 132 bytes, a reply of 126.
//!
//! 1. *Round trip*: the blocking client against the tokio server, and a bare ping-pong in which two threads write and read the
//!    same bytes without parsing them. The measurements of both alternate in the same run, twice: with all threads on one
//!    processor, and with the servers on a second one. There, waking a sleeping processor takes several times as long as all
//!    the rest. The benchmark fails above 1.6 times the bare median.
//! 2. *100 connections*: the same driver keeps one request in flight on each of 100 connections, to the tokio server on
//!    one thread and to a bare answerer: one thread, epoll, a read and a write for each request. Shown are the requests
//!    answered in a second, the share of a processor that the server's thread took, and its time for each request, in
//!    the program and in the kernel. The server has a processor to itself where there are two.

use std::hint::black_box;
use std::io::{Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::mpsc;
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use bcap_core::bcap::call::{self, Call, ControllerHandle, RobotHandle};
use bcap_core::bcap::server::{Handler, Request};
use bcap_core::bcap::{Decoder, FrameWriter, Progress};
use bcap_core::handler::{Outcome, PeerId, ReplyValue};
use bcap_core::hresult::HResult;
use bcap_core::variant::Encode;
use bcap_std::blocking;
use bcap_std::server::Server;
use tokio::io::{AsyncReadExt, AsyncWriteExt};

type Failure = Box<dyn std::error::Error + Send + Sync>;

const POSE: [f64; 8] = [364.16, 0.0, 278.5355, 180.0, 1.25, 180.0, 5.0, 0.0];
/// A round trip may take at most this multiple of a bare round trip.
const BAR: f64 = 1.6;
const CONNECTIONS: usize = 100;

fn main() -> ExitCode {
    match run() {
        Ok(true) => ExitCode::SUCCESS,
        Ok(false) => ExitCode::FAILURE,
        Err(error) => {
            eprintln!("loopback: {error}");
            ExitCode::FAILURE
        }
    }
}

fn run() -> Result<bool, Failure> {
    println!("{:<28} {:>10} {:>10}", "round trip, 132/126 bytes", "median", "p99");
    let mut within = true;
    for (title, client, server) in placements() {
        println!("{title}");
        // a new thread, so that it may run on any core
        let trips = thread::spawn(move || round_trips(client, server));
        within &= trips.join().map_err(|_| "the client has panicked")??;
    }
    println!();
    if let Some((_, client, server)) = placements().pop() {
        let measured = thread::spawn(move || {
            client.take();
            connections("bare answerer", BareServer::start(server)?)?;
            connections("tokio server", CoreServer::start(server)?)
        });
        measured.join().map_err(|_| "the client has panicked")??;
    }
    Ok(within)
}

// --- one connection ------------------------------------------------------------------------------------------------

fn round_trips(client: Placement, server: Placement) -> Result<bool, Failure> {
    const WARM_UP: usize = 2_000;
    const TRIPS: usize = 20_000;

    client.take();
    let running = CoreServer::start(server)?;
    let mut client = blocking::connect_tcp(running.address, &Default::default())?;
    client.call(call::service_start(""))?;
    let controller = client.call(call::controller_connect("", "", "", ""))?;
    let robot = client.call(call::controller_get_robot(controller, "Arm", ""))?;
    let mut bare = BarePingPong::start(server)?;

    let (mut ours, mut theirs) = (Vec::with_capacity(TRIPS), Vec::with_capacity(TRIPS));
    for trip in 0..WARM_UP + TRIPS {
        let begun = Instant::now();
        bare.trip()?;
        let between = Instant::now();
        black_box(client.call(call::robot_execute(robot, "slvMove", black_box(&POSE)))?);
        if trip >= WARM_UP {
            theirs.push(between - begun);
            ours.push(between.elapsed());
        }
    }
    drop(client);
    running.stop()?;

    let (bare, client) = (Quantiles::of(theirs), Quantiles::of(ours));
    println!("{:<28} {:>10.1?} {:>10.1?}", "  bare ping-pong", bare.median, bare.p99);
    println!("{:<28} {:>10.1?} {:>10.1?}", "  client and server", client.median, client.p99);
    let ratio = |a: Duration, b: Duration| a.as_secs_f64() / b.as_secs_f64();
    let median = ratio(client.median, bare.median);
    let verdict = if median <= BAR { "" } else { "  OVER THE BAR" };
    println!("{:<28} {median:>10.2} {:>10.2}   (bar {BAR}){verdict}", "  ratio", ratio(client.p99, bare.p99));
    Ok(median <= BAR)
}

/// Where a thread runs: on one processor, or wherever the system puts it.
#[derive(Debug, Clone, Copy)]
struct Placement(Option<usize>);

impl Placement {
    const ANYWHERE: Self = Self(None);

    /// Binds the calling thread.
    #[cfg(target_os = "linux")]
    fn take(self) {
        let Some(processor) = self.0 else { return };
        let mut set = rustix::thread::CpuSet::new();
        set.set(processor);
        rustix::thread::sched_setaffinity(None, &set).expect("a processor that this thread may use");
    }

    #[cfg(not(target_os = "linux"))]
    fn take(self) {}
}

/// Where the client and both servers are put: a title, the client's place, the servers' place.
fn placements() -> Vec<(&'static str, Placement, Placement)> {
    let on = |processor| Placement(Some(processor));
    match processors()[..] {
        [] => vec![("anywhere: this system binds no threads", Placement::ANYWHERE, Placement::ANYWHERE)],
        [one] => vec![("one processor", on(one), on(one))],
        [first, .., last] => vec![("one processor", on(last), on(last)), ("two processors", on(first), on(last))],
    }
}

/// Returns the processors that this process may use; none where a thread can't be bound to one.
fn processors() -> Vec<usize> {
    #[cfg(target_os = "linux")]
    return rustix::thread::sched_getaffinity(None)
        .map(|set| (0..rustix::thread::CpuSet::MAX_CPU).filter(|&processor| set.is_set(processor)).collect())
        .unwrap_or_default();
    #[cfg(not(target_os = "linux"))]
    Vec::new()
}

struct Quantiles {
    median: Duration,
    p99: Duration,
}

impl Quantiles {
    fn of(mut times: Vec<Duration>) -> Self {
        times.sort_unstable();
        Self { median: times[times.len() / 2], p99: times[times.len() * 99 / 100] }
    }
}

/// Two threads that exchange the bytes without parsing them.
struct BarePingPong {
    stream: TcpStream,
    request: Vec<u8>,
    reply: Vec<u8>,
}

impl BarePingPong {
    fn start(place: Placement) -> Result<Self, Failure> {
        let (request, reply) = frames(3);
        let listener = TcpListener::bind("127.0.0.1:0")?;
        let stream = TcpStream::connect(listener.local_addr()?)?;
        stream.set_nodelay(true)?;
        let (mut peer, _) = listener.accept()?;
        peer.set_nodelay(true)?;
        let (mut received, sent) = (vec![0; request.len()], reply.clone());
        thread::spawn(move || {
            place.take();
            // it ends when the stream is dropped
            while peer.read_exact(&mut received).and_then(|()| peer.write_all(&sent)).is_ok() {}
        });
        Ok(Self { stream, request, reply })
    }

    fn trip(&mut self) -> Result<(), Failure> {
        self.stream.write_all(&self.request)?;
        Ok(self.stream.read_exact(&mut self.reply)?)
    }
}

/// Makes the request of a cycle, for a robot's handle, and a reply to it.
fn frames(robot: i32) -> (Vec<u8>, Vec<u8>) {
    let request = frame(&call::robot_execute(RobotHandle(robot), "slvMove", POSE));
    let reply = encode(0, &[&(POSE, 1_i32, 2_i32, 3_i32)]);
    assert_eq!((request.len(), reply.len()), (132, 126), "the frames of a slave-mode cycle");
    (request, reply)
}

fn frame(call: &impl Call) -> Vec<u8> {
    let mut buffer = [0; 512];
    let mut writer = FrameWriter::new(&mut buffer).expect("there is room");
    call.arguments(&mut writer).expect("there is room");
    writer.finish(1, 0, call.function().0).expect("there is room").to_vec()
}

fn encode(code: i32, arguments: &[&dyn Encode]) -> Vec<u8> {
    let mut buffer = [0; 512];
    let mut writer = FrameWriter::new(&mut buffer).expect("there is room");
    arguments.iter().for_each(|argument| writer.argument(*argument).expect("there is room"));
    writer.finish(1, 0, code).expect("there is room").to_vec()
}

// --- 100 connections -----------------------------------------------------------------------------------------------

fn connections(name: &str, server: Running) -> Result<(), Failure> {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    let (count, took) = runtime.block_on(drive(server.address))?;
    let busy = server.stop()?;
    let rate = count as f64 / took.as_secs_f64();
    print!("{CONNECTIONS} connections, {name:<16} {rate:>10.0} requests/s");
    match busy {
        Some(ProcessorTime { all, user }) => {
            let (each, took) = (1e6 * all.as_secs_f64() / count as f64, took.as_secs_f64());
            println!(
                ", server {:>3.0} % of a processor, {each:.1} us each: {:.1} user, {:.1} system",
                100.0 * all.as_secs_f64() / took,
                each * user,
                each * (1.0 - user)
            );
        }
        None => println!(),
    }
    Ok(())
}

/// Keeps a request in flight on each of many connections; returns how many were answered, and in what time.
async fn drive(address: SocketAddr) -> Result<(u64, Duration), Failure> {
    const TIME: Duration = Duration::from_secs(3);

    let mut streams = Vec::new();
    for _ in 0..CONNECTIONS {
        let mut stream = tokio::net::TcpStream::connect(address).await?;
        stream.set_nodelay(true)?;
        let robot = open_session(&mut stream).await?;
        streams.push((stream, frames(robot).0));
    }
    let begun = Instant::now();
    let tasks = streams.into_iter().map(|(mut stream, request)| {
        tokio::spawn(async move {
            let (mut reply, mut count) = ([0; 126], 0_u64);
            while begun.elapsed() < TIME {
                stream.write_all(&request).await?;
                stream.read_exact(&mut reply).await?;
                count += 1;
            }
            Ok::<_, std::io::Error>(count)
        })
    });
    let mut count = 0;
    for task in tasks.collect::<Vec<_>>() {
        count += task.await??;
    }
    Ok((count, begun.elapsed()))
}

/// Starts the service and opens a robot; returns its handle.
async fn open_session(stream: &mut tokio::net::TcpStream) -> Result<i32, Failure> {
    exchange(stream, frame(&call::service_start(""))).await?;
    let controller = exchange(stream, frame(&call::controller_connect("", "", "", ""))).await?;
    exchange(stream, frame(&call::controller_get_robot(ControllerHandle(controller), "Arm", ""))).await
}

/// Sends a request and returns the integer of the reply, or 0.
async fn exchange(stream: &mut tokio::net::TcpStream, request: Vec<u8>) -> Result<i32, Failure> {
    stream.write_all(&request).await?;
    let (mut buffer, mut len) = ([0; 512], 0);
    loop {
        len += stream.read(&mut buffer[len..]).await?;
        if let Progress::Complete(frame, _) = Decoder::TCP.decode(&buffer[..len])? {
            return Ok(frame.value().and_then(|value| value.as_i32()).unwrap_or(0));
        }
    }
}

// --- servers -------------------------------------------------------------------------------------------------------

/// A server on a separate thread.
struct Running {
    address: SocketAddr,
    stop: Box<dyn FnOnce() + Send>,
    thread: JoinHandle<Option<ProcessorTime>>,
}

impl Running {
    /// Ends the server and returns the time that its thread was on a processor.
    fn stop(self) -> Result<Option<ProcessorTime>, Failure> {
        (self.stop)();
        self.thread.join().map_err(|_| "the server has panicked".into())
    }
}

/// How long a thread has been on a processor, and the share of that outside of the kernel.
struct ProcessorTime {
    all: Duration,
    user: f64,
}

/// Returns the time of this thread; `None` where the system does not report it.
fn processor_time() -> Option<ProcessorTime> {
    let exact = std::fs::read_to_string("/proc/thread-self/schedstat").ok()?;
    let all = Duration::from_nanos(exact.split(' ').next()?.parse().ok()?);
    // the kernel divides in ticks of 10 ms, so only the shares count; the name before `)` may have blanks
    let stat = std::fs::read_to_string("/proc/thread-self/stat").ok()?;
    let mut ticks = stat.rsplit(')').next()?.split_whitespace().skip(11).map(|ticks| ticks.parse::<f64>().ok());
    let (user, system) = (ticks.next()??, ticks.next()??);
    Some(ProcessorTime { all, user: user / (user + system) })
}

/// The tokio server, with a handler that answers slvMove.
struct CoreServer;

struct Robot {
    next_handle: i32,
}

impl Handler for Robot {
    fn call(
        &mut self,
        _: PeerId,
        request: &Request<'_>,
        reply: &mut ReplyValue<'_>,
        _: bcap_core::time::Instant,
    ) -> Outcome {
        let set = if request.function.opens().is_some() {
            self.next_handle += 1;
            reply.set(&self.next_handle)
        } else {
            match request.value(2).as_array().and_then(|pose| pose.items::<f64>()?.to_array::<8>()) {
                Some(pose) if request.text(1) == "slvMove" => reply.set(&(pose, 1_i32, 2_i32, 3_i32)),
                _ => Ok(()),
            }
        };
        set.map_or(HResult::E_FAIL, |()| HResult::S_OK).into()
    }
}

impl CoreServer {
    fn start(place: Placement) -> Result<Running, Failure> {
        let (told, address) = mpsc::channel();
        let (stop, stopped) = tokio::sync::oneshot::channel::<()>();
        let thread = thread::spawn(move || {
            place.take();
            let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().ok()?;
            runtime.block_on(async {
                let server = Server::new(Robot { next_handle: 0 }).bcap_tcp("127.0.0.1:0").await.ok()?;
                told.send(server.addresses().bcap_tcp[0]).ok()?;
                server.run(async { drop(stopped.await) }).await.ok()
            })?;
            processor_time()
        });
        Ok(Running { address: address.recv()?, stop: Box::new(move || _ = stop.send(())), thread })
    }
}

/// The minimal server: epoll, one read and one write for each request.
struct BareServer;

impl BareServer {
    fn start(place: Placement) -> Result<Running, Failure> {
        const LISTENER: mio::Token = mio::Token(usize::MAX);
        const STOP: mio::Token = mio::Token(usize::MAX - 1);

        let mut poll = mio::Poll::new()?;
        let mut listener = mio::net::TcpListener::bind("127.0.0.1:0".parse()?)?;
        let address = listener.local_addr()?;
        poll.registry().register(&mut listener, LISTENER, mio::Interest::READABLE)?;
        // held by both sides: a waker that is dropped immediately removes its event from epoll again
        let waker = Arc::new(mio::Waker::new(poll.registry(), STOP)?);
        let held = Arc::clone(&waker);
        let thread = thread::spawn(move || {
            place.take();
            let (reply, _held) = (frames(3).1, held);
            let (mut events, mut streams, mut buffer) = (mio::Events::with_capacity(256), Vec::new(), [0; 1024]);
            loop {
                poll.poll(&mut events, None).ok()?;
                for event in &events {
                    match event.token() {
                        STOP => return processor_time(),
                        LISTENER => {
                            while let Ok((mut stream, _)) = listener.accept() {
                                let _ = stream.set_nodelay(true);
                                let token = mio::Token(streams.len());
                                poll.registry().register(&mut stream, token, mio::Interest::READABLE).ok()?;
                                streams.push(stream);
                            }
                        }
                        mio::Token(index) => {
                            let stream: &mut mio::net::TcpStream = &mut streams[index];
                            // each read is taken as one request, and its contents do not matter
                            if matches!(stream.read(&mut buffer), Ok(1..)) {
                                stream.write_all(&reply).ok()?;
                            }
                        }
                    }
                }
            }
        });
        Ok(Running { address, stop: Box::new(move || _ = waker.wake()), thread })
    }
}
