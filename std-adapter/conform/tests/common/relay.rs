//! A deliberately broken device: a relay in front of a correct one, which changes frames.
//!
//! ```text
//!  a case ─► request hook ─► the virtual controller
//!         ◄─ reply hook   ◄─
//! ```

use std::collections::HashMap;
use std::io::{Read, Write};
use std::net::{Shutdown, SocketAddr, TcpListener, TcpStream, UdpSocket};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::thread;
use std::time::Duration;

use bcap_core::limits::Strictness;
use bcap_testkit::frame::TestFrame;
use bcap_testkit::judge::TCP;
use bcap_testkit::oracle::{Oracle, Verdict};
use bcap_testkit::value::Value;

/// Frames with wrong lengths pass too: the device judges them.
const LENIENT: Oracle = Oracle { strictness: Strictness::Lenient, ..TCP };

/// Decodes the frame at the front of `bytes`; returns its length too.
fn read_frame(bytes: &[u8]) -> Option<(TestFrame, usize)> {
    match LENIENT.decode(bytes) {
        Verdict::Frame(frame, used) => Some((frame, used)),
        _ => None,
    }
}

/// The state of a fault.
#[derive(Debug, Default)]
pub(crate) struct Memory {
    pub(crate) handle: Option<Value>,
    /// Whether a datagram was invalid.
    pub(crate) had_invalid: bool,
}

/// Changes a request; `None` drops it.
pub(crate) type OnRequest = fn(&mut Memory, TestFrame) -> Option<TestFrame>;
/// Returns the bytes to send for a reply to this request.
pub(crate) type OnReply = fn(&mut Memory, &TestFrame, TestFrame) -> Vec<u8>;

/// A fault of a device.
#[derive(Clone, Copy)]
pub(crate) struct Hooks {
    pub(crate) request: OnRequest,
    pub(crate) reply: OnReply,
    /// Changes raw bytes of a client before they are decoded.
    pub(crate) bytes: fn(&mut Memory, Vec<u8>) -> Vec<u8>,
    /// Changes an answer of RAC.
    pub(crate) line: fn(&str) -> String,
}

impl Hooks {
    /// Changes nothing.
    pub(crate) const HONEST: Self = Self {
        request: |_, frame| Some(frame),
        reply: |_, _, frame| frame.to_wire(false),
        bytes: |_, bytes| bytes,
        line: str::to_owned,
    };
}

/// The listening relay.
pub(crate) struct Relay {
    pub(crate) tcp: SocketAddr,
    pub(crate) udp: SocketAddr,
    pub(crate) rac: SocketAddr,
    stop: Arc<AtomicBool>,
}

impl Relay {
    pub(crate) fn start(hooks: Hooks, tcp: SocketAddr, udp: SocketAddr, rac: SocketAddr) -> Self {
        let stop = Arc::new(AtomicBool::new(false));
        let bcap = listen(Arc::clone(&stop), move |client| relay_stream(&client, tcp, hooks));
        let lines = listen(Arc::clone(&stop), move |client| relay_lines(&client, rac, hooks));
        let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
        let local = socket.local_addr().unwrap();
        let ended = Arc::clone(&stop);
        thread::spawn(move || relay_datagrams(&socket, udp, hooks, &ended));
        Self { tcp: bcap, udp: local, rac: lines, stop }
    }
}

impl Drop for Relay {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Release);
        // wakes the listeners
        let _ = (TcpStream::connect(self.tcp), TcpStream::connect(self.rac));
    }
}

fn listen(stop: Arc<AtomicBool>, serve: impl Fn(TcpStream) + Send + Sync + 'static) -> SocketAddr {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap();
    let serve = Arc::new(serve);
    thread::spawn(move || {
        for client in listener.incoming() {
            if stop.load(Ordering::Acquire) {
                return;
            }
            let (client, serve) = (client.unwrap(), Arc::clone(&serve));
            thread::spawn(move || serve(client));
        }
    });
    address
}

/// The state of a connection in both directions.
#[derive(Default)]
struct Shared {
    memory: Memory,
    requests: HashMap<u16, TestFrame>,
}

impl Shared {
    /// Returns the bytes for the device.
    fn request(&mut self, hooks: &Hooks, frame: TestFrame) -> Option<Vec<u8>> {
        let changed = (hooks.request)(&mut self.memory, frame.clone())?;
        self.requests.insert(changed.serial, frame);
        Some(changed.to_wire(false))
    }

    fn reply(&mut self, hooks: &Hooks, frame: TestFrame) -> Vec<u8> {
        let unknown = TestFrame { serial: 0, reserved: 0, code: 0, args: Vec::new() };
        let request = self.requests.get(&frame.serial).cloned().unwrap_or(unknown);
        (hooks.reply)(&mut self.memory, &request, frame)
    }
}

fn relay_stream(client: &TcpStream, device: SocketAddr, hooks: Hooks) {
    let device = TcpStream::connect(device).unwrap();
    let _ = (client.set_nodelay(true), device.set_nodelay(true));
    let shared = Arc::new(Mutex::new(Shared::default()));
    let (mut from, mut to) = (device.try_clone().unwrap(), client.try_clone().unwrap());
    let replies = Arc::clone(&shared);
    thread::spawn(move || {
        let mut held = Vec::new();
        while read(&mut from, &mut held) {
            while let Some((frame, used)) = read_frame(&held) {
                held.drain(..used);
                let bytes = replies.lock().unwrap().reply(&hooks, frame);
                let _ = to.write_all(&bytes);
            }
        }
        let _ = to.shutdown(Shutdown::Both);
    });
    let (mut from, mut to) = (client.try_clone().unwrap(), device.try_clone().unwrap());
    let mut held = Vec::new();
    let mut chunk = Vec::new();
    while read(&mut from, &mut chunk) {
        held.extend((hooks.bytes)(&mut shared.lock().unwrap().memory, std::mem::take(&mut chunk)));
        while let Some((frame, used)) = read_frame(&held) {
            let original = held.drain(..used).collect::<Vec<_>>();
            // frames that only a lenient decoder accepts must reach the device unchanged
            let is_canonical = frame.to_wire(false) == original;
            let changed = shared.lock().unwrap().request(&hooks, frame);
            let Some(bytes) = changed else { continue };
            let _ = to.write_all(if is_canonical { &bytes } else { &original });
        }
        // the device judges what is not a frame
        if LENIENT.decode(&held) == Verdict::Refused {
            let _ = to.write_all(&std::mem::take(&mut held));
        }
    }
    let _ = to.write_all(&held);
    let _ = device.shutdown(Shutdown::Both);
}

fn read(stream: &mut TcpStream, held: &mut Vec<u8>) -> bool {
    let mut buffer = [0; 65536];
    match stream.read(&mut buffer) {
        Ok(0) | Err(_) => false,
        Ok(count) => {
            held.extend_from_slice(&buffer[..count]);
            true
        }
    }
}

fn relay_lines(client: &TcpStream, device: SocketAddr, hooks: Hooks) {
    let device = TcpStream::connect(device).unwrap();
    let (mut from, mut to) = (device.try_clone().unwrap(), client.try_clone().unwrap());
    thread::spawn(move || {
        let mut held = Vec::new();
        while read(&mut from, &mut held) {
            while let Some(end) = held.iter().position(|byte| *byte == b'\r') {
                let line: Vec<u8> = held.drain(..=end).collect();
                let _ = to.write_all((hooks.line)(&String::from_utf8_lossy(&line)).as_bytes());
            }
        }
        let _ = to.shutdown(Shutdown::Both);
    });
    let (mut from, mut to) = (client.try_clone().unwrap(), device.try_clone().unwrap());
    let mut chunk = Vec::new();
    while read(&mut from, &mut chunk) {
        let bytes = (hooks.bytes)(&mut Memory::default(), std::mem::take(&mut chunk));
        let _ = to.write_all(&bytes);
    }
    let _ = device.shutdown(Shutdown::Both);
}

/// Relays datagrams; each client has a separate socket.
fn relay_datagrams(socket: &UdpSocket, device: SocketAddr, hooks: Hooks, ended: &AtomicBool) {
    let mut clients: HashMap<SocketAddr, (UdpSocket, Arc<Mutex<Shared>>)> = HashMap::new();
    socket.set_read_timeout(Some(Duration::from_millis(200))).unwrap();
    // raw datagrams belong to no client
    let mut device_memory = Memory::default();
    let mut buffer = [0; 65536];
    while !ended.load(Ordering::Acquire) {
        let Ok((count, client)) = socket.recv_from(&mut buffer) else { continue };
        let (out, shared) = clients.entry(client).or_insert_with(|| {
            let out = UdpSocket::bind("127.0.0.1:0").unwrap();
            out.connect(device).unwrap();
            let shared = Arc::new(Mutex::new(Shared::default()));
            let (from, to, replies) = (out.try_clone().unwrap(), socket.try_clone().unwrap(), Arc::clone(&shared));
            thread::spawn(move || {
                let mut buffer = [0; 65536];
                while let Ok(count) = from.recv(&mut buffer) {
                    let Some((frame, _)) = read_frame(&buffer[..count]) else { continue };
                    let bytes = replies.lock().unwrap().reply(&hooks, frame);
                    if !bytes.is_empty() {
                        let _ = to.send_to(&bytes, client);
                    }
                }
            });
            (out, shared)
        });
        let mut shared = shared.lock().unwrap();
        let bytes = (hooks.bytes)(&mut device_memory, buffer[..count].to_vec());
        match read_frame(&bytes) {
            Some((frame, used)) if used == bytes.len() => {
                if let Some(bytes) = shared.request(&hooks, frame) {
                    let _ = out.send(&bytes);
                }
            }
            _ => drop(out.send(&bytes)),
        }
    }
}
