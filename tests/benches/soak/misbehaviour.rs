//! The misbehaving clients: each violates the protocol about seven times a second.

use std::io;
use std::sync::atomic::Ordering;
use std::sync::{Arc, LazyLock};
use std::thread::JoinHandle;
use std::time::Duration;

use bcap_core::bcap::FunctionId;
use bcap_testkit::frame::{TestFrame, field};
use bcap_testkit::network::Random;
use bcap_testkit::value::Value;
use socket2::SockRef;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpStream, UdpSocket};
use tokio::time::{sleep, timeout};

use crate::server::Addresses;
use crate::work::PROVIDER;
use crate::{Plan, run_clients};

/// The average pause of a client between two violations.
const PACE: Duration = Duration::from_millis(100);

/// The bytes that the clients send. They are created only once, because the clients may share a processor with the server.
static MESSAGES: LazyLock<Messages> = LazyLock::new(Messages::new);

struct Messages {
    /// Random bytes.
    garbage: Vec<u8>,
    /// Arrays in arrays in a request, 10,000 deep.
    deep: Vec<u8>,
    /// An array that promises more elements than the request has bytes.
    long: Vec<u8>,
    /// The beginning of a frame of 16 MiB.
    promise: Vec<u8>,
    begin: Vec<u8>,
    begins: Vec<u8>,
    connect: Vec<u8>,
    connects: Vec<u8>,
    session: Vec<u8>,
    /// A request with an array of 100,000 bytes.
    large: Vec<u8>,
    line: Vec<u8>,
}

impl Messages {
    fn new() -> Self {
        let mut random = Random(0);
        let (begin, connect) = (begin(), connect());
        let much = Value::Array(17, vec![Value::Ui1(7); 100_000]);
        Self {
            garbage: (0..64 << 10).map(|_| random.number() as u8).collect(),
            deep: broken(&[0x0c, 0x20, 1, 0, 0, 0].repeat(10_000)),
            long: broken(&[5, 0x20, 1, 0, 0, 0x20]),
            promise: [&[1, 0, 0, 0, 1][..], &[0; 64 << 10]].concat(),
            begins: begin.repeat(200),
            connects: connect.repeat(50),
            session: [&begin[..], &connect].concat(),
            large: request(FunctionId::SERVICE_START, vec![much]),
            line: [&[b'x'; 2000][..], b"\r8204,(\r\xff\r", &b"(".repeat(200), b"\rGET:RC8:1"].concat(),
            begin,
            connect,
        }
    }

    /// Returns `len` random bytes.
    fn garbage(&self, len: usize, random: &mut Random) -> &[u8] {
        let at = random.below((self.garbage.len() - len) as u64) as usize;
        &self.garbage[at..at + len]
    }
}

/// Starts clients in a separate thread, which ends when all clients have ended.
pub(crate) fn start(server: Addresses, clients: usize, plan: Arc<Plan>) -> JoinHandle<()> {
    run_clients(clients, move |seed| client(server, Random(seed as u64), Arc::clone(&plan)))
}

async fn client(server: Addresses, mut random: Random, plan: Arc<Plan>) {
    while !plan.is_over.load(Ordering::Relaxed) {
        if plan.is_together.load(Ordering::Relaxed) {
            // the server defends itself, so most deeds end with an error
            let _ = timeout(Duration::from_secs(5), deed(server, &mut random)).await;
            plan.misbehaviour.fetch_add(1, Ordering::Relaxed);
        }
        sleep(Duration::from_micros(random.below(2 * PACE.as_micros() as u64))).await;
    }
}

/// Commits one random violation.
async fn deed(server: Addresses, random: &mut Random) -> io::Result<()> {
    let kind = random.below(14);
    match kind {
        0 => return datagrams(server, random).await,
        1 => return line(server).await,
        _ => {}
    }
    let mut stream = TcpStream::connect(server.tcp).await?;
    stream.set_nodelay(true)?;
    match kind {
        // connects and disconnects
        2 => {}
        // sends one byte, or a part, and stays connected
        3 => {
            stream.write_all(&[1]).await?;
            sleep(PACE).await;
        }
        4 => {
            stream.write_all(&MESSAGES.connect[..40]).await?;
            sleep(PACE).await;
            reset(&stream)?;
        }
        // sends bytes that are not a frame
        5 => ask(&mut stream, MESSAGES.garbage(1000, random)).await?,
        6 => ask(&mut stream, &MESSAGES.deep).await?,
        7 => ask(&mut stream, &MESSAGES.long).await?,
        // announces a long frame and sends little of it
        8 => {
            stream.write_all(&MESSAGES.promise).await?;
            sleep(PACE).await;
        }
        // sends many requests and reads no replies
        9 => {
            stream.write_all(&MESSAGES.begins).await?;
            sleep(PACE).await;
            reset(&stream)?;
        }
        // opens many objects and disconnects without releasing them
        10 => {
            session(&mut stream).await?;
            stream.write_all(&MESSAGES.connects).await?;
        }
        // disconnects in the middle of a long call
        11 => {
            let controller = session(&mut stream).await?;
            let args = vec![Value::I4(controller), Value::text("sleep"), Value::I4(3_600_000)];
            stream.write_all(&request(FunctionId::CONTROLLER_EXECUTE, args)).await?;
            sleep(PACE).await;
        }
        // a byte at a time
        12 => {
            for byte in &MESSAGES.begin {
                stream.write_all(&[*byte]).await?;
                sleep(Duration::from_millis(2)).await;
            }
            reset(&stream)?;
        }
        // a large request, and disconnects before the answer
        _ => {
            stream.write_all(&MESSAGES.large).await?;
            reset(&stream)?;
        }
    }
    Ok(())
}

async fn datagrams(server: Addresses, random: &mut Random) -> io::Result<()> {
    let socket = UdpSocket::bind("127.0.0.1:0").await?;
    socket.connect(server.udp).await?;
    for _ in 0..10 {
        let len = random.below(600) as usize;
        socket.send(MESSAGES.garbage(len, random)).await?;
        socket.send(&MESSAGES.begin[..9]).await?;
    }
    Ok(())
}

async fn line(server: Addresses) -> io::Result<()> {
    let mut stream = TcpStream::connect(server.rac).await?;
    stream.write_all(&MESSAGES.line).await?;
    stream.read_exact(&mut [0; 12]).await?;
    Ok(())
}

/// Sends bytes and reads to the end.
async fn ask(stream: &mut TcpStream, bytes: &[u8]) -> io::Result<()> {
    stream.write_all(bytes).await?;
    stream.shutdown().await?;
    stream.read_to_end(&mut Vec::new()).await?;
    Ok(())
}

/// Begins a session and returns the handle of the controller.
async fn session(stream: &mut TcpStream) -> io::Result<i32> {
    stream.write_all(&MESSAGES.session).await?;
    // a reply without a value, and one with an I4 in front of its last byte
    let mut replies = [0; 16 + 30];
    stream.read_exact(&mut replies).await?;
    let [.., a, b, c, d, _] = replies;
    Ok(i32::from_le_bytes([a, b, c, d]))
}

fn reset(stream: &TcpStream) -> io::Result<()> {
    SockRef::from(stream).set_linger(Some(Duration::ZERO))
}

fn request(function: FunctionId, args: Vec<Value>) -> Vec<u8> {
    TestFrame { serial: 1, reserved: 0, code: function.0, args }.to_wire(false)
}

fn begin() -> Vec<u8> {
    request(FunctionId::SERVICE_START, vec![])
}

fn connect() -> Vec<u8> {
    request(FunctionId::CONTROLLER_CONNECT, ["", PROVIDER, "", ""].map(Value::text).into())
}

/// A request with an argument that is not a value.
fn broken(value: &[u8]) -> Vec<u8> {
    let mut bytes = begin();
    bytes.pop();
    bytes[field::COUNT.start] = 1;
    bytes.extend((value.len() as u32).to_le_bytes());
    bytes.extend(value);
    bytes.push(4);
    let length = bytes.len() as u32;
    bytes[field::LENGTH].copy_from_slice(&length.to_le_bytes());
    bytes
}
