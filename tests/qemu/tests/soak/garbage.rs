//! Clients that misbehave: refused PUTs, random bytes and random frames.

use std::fmt;
use std::io::{self, Read, Write};
use std::net::{Shutdown, TcpStream, UdpSocket};
use std::sync::atomic::{AtomicU32, Ordering};
use std::thread::sleep;
use std::time::{Duration, Instant};

use bcap_core::hresult::HResult;
use bcap_qemu::{Plc, error, free_port};
use fastrand::Rng;

use super::Shared;

/// The board's address, to which random frames are sent.
pub(super) const MAC: &str = "mac=02:00:00:00:00:15";
const MAC_BYTES: [u8; 6] = [2, 0, 0, 0, 0, 0x15];
/// Refused PUTs that are sent together.
const BATCH: usize = 32;
/// The pause between them, which leaves the processors to other programs.
const PAUSE: Duration = Duration::from_millis(10);
/// Requests to start from.
const REQUESTS: [&[u8]; 3] = [b"PUT:RC8:1:I:3,", b"\x12\x34\0\0\0\x06\x01\x03\0\0\0\x02", b"GET / HTTP/1.1\r\n"];

/// Counts the sent bytes.
#[derive(Default)]
pub(super) struct Garbage {
    refused: AtomicU32,
    connections: AtomicU32,
    frames: AtomicU32,
}

impl fmt::Display for Garbage {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [refused, connections, frames] =
            [&self.refused, &self.connections, &self.frames].map(|count| count.load(Ordering::Relaxed));
        write!(f, "{refused} refused PUTs, {connections} connections with random bytes, {frames} random frames")
    }
}

impl Garbage {
    /// Sends refused PUTs for two seconds at a time, whenever there is a free slot.
    pub(super) fn refused_puts(&self, address: &str, mut rng: Rng, shared: &Shared) {
        while !shared.is_over() {
            sleep(Duration::from_millis(rng.u64(200..2000)));
            if let Ok(plc) = Plc::try_connect(address, Duration::from_secs(15)) {
                // the connection may end with a cut of the link
                let _ = self.flood(plc);
            }
        }
    }

    fn flood(&self, mut plc: Plc) -> io::Result<()> {
        let (denied, since) = (error(HResult::E_ACCESSDENIED), Instant::now());
        while since.elapsed() < Duration::from_secs(2) {
            plc.try_send("PUT:RC8:90:I:3,1\r".repeat(BATCH).as_bytes())?;
            for _ in 0..BATCH {
                if plc.answer()? != denied {
                    return Ok(());
                }
                self.refused.fetch_add(1, Ordering::Relaxed);
            }
            sleep(PAUSE);
        }
        Ok(())
    }

    /// Sends random bytes to the ports of the board, one connection per attempt.
    pub(super) fn connections(&self, addresses: &[&str], mut rng: Rng, shared: &Shared) {
        while !shared.is_over() {
            sleep(Duration::from_millis(rng.u64(100..1000)));
            let address = addresses[rng.usize(..addresses.len())];
            if let Ok(mut stream) = TcpStream::connect(address) {
                let mut bytes = REQUESTS[rng.usize(..REQUESTS.len())].to_vec();
                bytes.extend((0..rng.usize(0..1500)).map(|_| rng.u8(..)));
                // the board may close the connection at any time
                let _ = stream.set_read_timeout(Some(Duration::from_millis(500)));
                let _ = stream.write_all(&bytes);
                let _ = stream.read(&mut bytes);
                let _ = stream.shutdown(Shutdown::Both);
                self.connections.fetch_add(1, Ordering::Relaxed);
            }
        }
    }

    /// Sends random frames to the board: most are IPv4, ARP or IPv6 by their head only.
    pub(super) fn frames(&self, frames: &Frames, mut rng: Rng, shared: &Shared) {
        while !shared.is_over() {
            sleep(Duration::from_millis(rng.u64(5..40)));
            let mut frame: Vec<u8> = (0..rng.usize(1..1514)).map(|_| rng.u8(..)).collect();
            let kind = [[8, 0], [8, 6], [0x86, 0xdd], [rng.u8(..), rng.u8(..)]][rng.usize(..4)];
            for (at, byte) in (0..).zip(MAC_BYTES) {
                frame.get_mut(at).into_iter().for_each(|to| *to = byte);
            }
            for (at, byte) in (12..).zip(kind.into_iter().chain([0x45])) {
                frame.get_mut(at).into_iter().for_each(|to| *to = byte);
            }
            let _ = frames.socket.send(&frame);
            self.frames.fetch_add(1, Ordering::Relaxed);
        }
    }
}

/// A way to the board's Ethernet for frames.
pub(super) struct Frames {
    socket: UdpSocket,
    /// The UDP ports, for the option `--frames` of `run`.
    pub(super) ports: String,
}

impl Frames {
    pub(super) fn open() -> Self {
        let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
        let to = free_port();
        socket.connect(("127.0.0.1", to)).unwrap();
        Self { ports: format!("{}:{to}", socket.local_addr().unwrap().port()), socket }
    }
}

/// Returns the JSON of the board's page.
pub(super) fn page(address: &str) -> String {
    let ask = || {
        let mut stream = TcpStream::connect(address)?;
        stream.set_read_timeout(Some(Duration::from_secs(5)))?;
        stream.write_all(b"GET /health.json HTTP/1.1\r\nHost: board\r\n\r\n")?;
        let mut response = String::new();
        stream.read_to_string(&mut response)?;
        response
            .split_once("\r\n\r\n")
            .map(|(_, body)| body.to_owned())
            .ok_or(io::Error::from(io::ErrorKind::UnexpectedEof))
    };
    // a connection of the random bytes may still be open
    let mut answers = (0..20).map(|_| ask());
    answers.find_map(Result::ok).expect("the board's page")
}
