//! Measures how long a small call waits while another client sends large requests and requests large replies.
//!
//! ```text
//! cargo bench -p bcap-tests --bench fairness
//! ```
//!
//! The server runs on one thread, the large client sends frames of nearly 16 MiB without a pause, and the small client
//! makes one short call after another for some seconds. The goal is a maximum below 20 ms; all figures are printed and
//! not judged, because they include the delays of a busy machine's scheduler.

use std::io::{Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc;
use std::thread;
use std::time::{Duration, Instant};

use bcap_core::bcap::call::{self, Call, ControllerHandle, VariableHandle};
use bcap_core::bcap::server::{Handler, Request};
use bcap_core::bcap::{FrameWriter, FunctionId};
use bcap_core::handler::{Outcome, PeerId, ReplyValue};
use bcap_core::hresult::HResult;
use bcap_core::variant::{Encode, Variant};
use bcap_std::blocking;
use bcap_std::server::Server;

type Failure = Box<dyn std::error::Error + Send + Sync>;

const TIME: Duration = Duration::from_secs(4);
/// Bytes of a large value: with the frame around it just less than 16 MiB.
const LARGE: usize = (16 << 20) - 100;
/// Strings of a large array: 16 MiB with 4 bytes for the length and 2 for the character.
const STRINGS: usize = LARGE / 6;

fn main() -> ExitCode {
    match run() {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("fairness: {error}");
            ExitCode::FAILURE
        }
    }
}

fn run() -> Result<(), Failure> {
    println!("{:<34} {:>9} {:>9} {:>9} {:>9} {:>8}", "small call with", "median", "p99", "max", "large/s", "calls");
    let bytes = vec![7_u8; LARGE];
    let strings = vec!["x"; STRINGS];
    let nested: Vec<Variant<'_>> = vec![Variant::Empty; LARGE / 6];
    measure("nothing", None)?;
    measure("requests: 16 bytes each", Some(request(call::service_start(""))))?;
    let put = |value: &dyn Encode| request(call::variable_put_value(VariableHandle(2), value));
    measure("requests: 16 MiB of UI1", Some(put(&&bytes[..])))?;
    measure("requests: 16 MiB of BSTR", Some(put(&&strings[..])))?;
    measure("requests: 16 MiB of VARIANT", Some(put(&&nested[..])))?;
    measure("replies: 16 MiB of UI1", Some(request(call::variable_get_value(VariableHandle(2)))))
}

/// Encodes a call.
fn request(call: impl Call) -> Vec<u8> {
    let mut buffer = vec![0; 17 << 20];
    let mut writer = FrameWriter::new(&mut buffer).expect("there is room");
    call.arguments(&mut writer).expect("there is room");
    writer.finish(1, 0, call.function().0).expect("there is room").to_vec()
}

fn measure(title: &str, large: Option<Vec<u8>>) -> Result<(), Failure> {
    let address = serve()?;
    let stop = Arc::new(AtomicBool::new(false));
    let served = Arc::new(AtomicU64::new(0));
    let flood = large.map(|large| Flood::start(address, large, &stop, &served)).transpose()?;
    let mut client = blocking::connect_tcp(address, &Default::default())?;
    client.call(call::service_start(""))?;
    let controller = client.call(call::controller_connect("", "", "", ""))?;
    let (begun, mut times) = (Instant::now(), Vec::new());
    while begun.elapsed() < TIME {
        let sent = Instant::now();
        client.call(call::controller_get_name(controller))?;
        times.push(sent.elapsed());
        // a client that polls; without a pause it would take the processor itself
        thread::sleep(Duration::from_micros(200));
    }
    let rate = served.load(Ordering::Relaxed) as f64 / begun.elapsed().as_secs_f64();
    stop.store(true, Ordering::Relaxed);
    if let Some(flood) = flood {
        flood.end();
    }
    times.sort_unstable();
    let at = |part: usize| times[(times.len() * part / 100).min(times.len() - 1)];
    println!("{title:<34} {:>9.1?} {:>9.1?} {:>9.1?} {rate:>9.1} {:>8}", at(50), at(99), at(100), times.len());
    Ok(())
}

/// A client that sends the same large request without a pause, and reads the answers.
struct Flood {
    stream: TcpStream,
    threads: [thread::JoinHandle<()>; 2],
}

impl Flood {
    fn start(
        address: SocketAddr,
        large: Vec<u8>,
        stop: &Arc<AtomicBool>,
        served: &Arc<AtomicU64>,
    ) -> Result<Self, Failure> {
        let mut client = TcpStream::connect(address)?;
        client.set_nodelay(true)?;
        for opening in [
            request(call::service_start("")),
            request(call::controller_connect("", "", "", "")),
            request(call::controller_get_variable(ControllerHandle(1), "I1", "")),
        ] {
            client.write_all(&opening)?;
            read_frame(&mut client)?;
        }
        let (mut to, mut from) = (client.try_clone()?, client.try_clone()?);
        let (stop, served) = (Arc::clone(stop), Arc::clone(served));
        let writer = thread::spawn(move || while !stop.load(Ordering::Relaxed) && to.write_all(&large).is_ok() {});
        let reader = thread::spawn(move || {
            while read_frame(&mut from).is_ok() {
                served.fetch_add(1, Ordering::Relaxed);
            }
        });
        Ok(Self { stream: client, threads: [writer, reader] })
    }

    fn end(self) {
        let _ = self.stream.shutdown(std::net::Shutdown::Both);
        for thread in self.threads {
            let _ = thread.join();
        }
    }
}

fn read_frame(stream: &mut TcpStream) -> std::io::Result<()> {
    let mut head = [0; 5];
    stream.read_exact(&mut head)?;
    let [_, length @ ..] = head;
    let rest = u64::from(u32::from_le_bytes(length)).saturating_sub(5);
    let copied = std::io::copy(&mut stream.take(rest), &mut std::io::sink())?;
    if copied == rest { Ok(()) } else { Err(std::io::ErrorKind::UnexpectedEof.into()) }
}

/// Starts a server on a separate thread, and returns its address.
fn serve() -> Result<SocketAddr, Failure> {
    let (told, address) = mpsc::channel();
    thread::spawn(move || {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().ok()?;
        runtime.block_on(async {
            let handler = Large { next_handle: 0, value: vec![7; LARGE] };
            let server = Server::new(handler).bcap_tcp("127.0.0.1:0").await.ok()?;
            told.send(server.addresses().bcap_tcp[0]).ok()?;
            server.run(std::future::pending()).await.ok()
        })
    });
    Ok(address.recv()?)
}

/// Opens anything, takes any value, and answers GetValue with 16 MiB.
struct Large {
    next_handle: i32,
    value: Vec<u8>,
}

impl Handler for Large {
    fn call(
        &mut self,
        _: PeerId,
        request: &Request<'_>,
        reply: &mut ReplyValue<'_>,
        _: bcap_core::time::Instant,
    ) -> Outcome {
        let set = match request.function {
            FunctionId::SERVICE_START => Ok(()),
            function if function.opens().is_some() => {
                self.next_handle += 1;
                reply.set(&self.next_handle)
            }
            FunctionId::VARIABLE_GET_VALUE => reply.set(&self.value[..]),
            FunctionId::CONTROLLER_GET_NAME => reply.set("name"),
            _ => Ok(()),
        };
        set.map_or(HResult::E_FAIL, |()| HResult::S_OK).into()
    }
}
