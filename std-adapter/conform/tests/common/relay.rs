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

use bcap_core::bcap::{Decoder, FrameWriter, FunctionId, Progress};
use bcap_core::hresult::HResult;
use bcap_core::limits::Strictness;
use bcap_core::variant::OwnedVariant;

/// A decoded frame, which a hook may change.
#[derive(Clone, Debug)]
pub(crate) struct Parts {
    pub(crate) serial: u16,
    pub(crate) marker: u16,
    pub(crate) code: i32,
    pub(crate) args: Vec<OwnedVariant>,
}

impl Parts {
    fn read(bytes: &[u8]) -> Option<(Self, usize)> {
        match Decoder::TCP.strictness(Strictness::Lenient).decode(bytes) {
            Ok(Progress::Complete(frame, used)) => {
                let args = frame.args.iter().map(|value| OwnedVariant::new(&value).unwrap_or_default()).collect();
                let parts = Self { serial: frame.serial, marker: frame.reserved, code: frame.code, args };
                Some((parts, used))
            }
            _ => None,
        }
    }

    pub(crate) fn write(&self) -> Vec<u8> {
        let mut buffer = vec![0; 1 << 20];
        let mut frame = FrameWriter::new(&mut buffer).unwrap();
        self.args.iter().for_each(|value| frame.argument(&value.as_variant()).unwrap());
        frame.finish(self.serial, self.marker, self.code).unwrap().to_vec()
    }

    pub(crate) fn result(&self) -> HResult {
        HResult(self.code)
    }
}

/// The context of a reply hook.
#[derive(Clone, Debug)]
pub(crate) struct Request {
    pub(crate) function: FunctionId,
    pub(crate) args: Vec<OwnedVariant>,
}

/// The state of a fault's hooks.
#[derive(Debug, Default)]
pub(crate) struct Memory {
    pub(crate) handle: Option<i32>,
    /// Whether a datagram was invalid.
    pub(crate) had_invalid: bool,
}

/// Changes a request; `None` drops it.
pub(crate) type OnRequest = fn(&mut Memory, Parts) -> Option<Parts>;
/// Returns the bytes to send for a reply.
pub(crate) type OnReply = fn(&mut Memory, &Request, Parts) -> Vec<u8>;

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
        request: |_, parts| Some(parts),
        reply: |_, _, parts| parts.write(),
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

/// The state that both directions of a connection share.
#[derive(Default)]
struct Shared {
    memory: Memory,
    requests: HashMap<u16, Request>,
}

impl Shared {
    /// Returns the bytes for the device.
    fn request(&mut self, hooks: &Hooks, parts: Parts) -> Option<Vec<u8>> {
        let changed = (hooks.request)(&mut self.memory, parts.clone())?;
        let request = Request { function: FunctionId(parts.code), args: parts.args };
        self.requests.insert(changed.serial, request);
        Some(changed.write())
    }

    fn reply(&mut self, hooks: &Hooks, parts: Parts) -> Vec<u8> {
        let unknown = Request { function: FunctionId(0), args: Vec::new() };
        let request = self.requests.get(&parts.serial).cloned().unwrap_or(unknown);
        (hooks.reply)(&mut self.memory, &request, parts)
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
            while let Some((parts, used)) = Parts::read(&held) {
                held.drain(..used);
                let bytes = replies.lock().unwrap().reply(&hooks, parts);
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
        while let Some((parts, used)) = Parts::read(&held) {
            let original = held.drain(..used).collect::<Vec<_>>();
            // frames that only a lenient decoder accepts must reach the device unchanged
            let is_canonical = parts.write() == original;
            let changed = shared.lock().unwrap().request(&hooks, parts);
            let Some(bytes) = changed else { continue };
            let _ = to.write_all(if is_canonical { &bytes } else { &original });
        }
        // the device judges bytes that are not a frame
        if Decoder::TCP.strictness(Strictness::Lenient).decode(&held).is_err() {
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
                    let Some((parts, _)) = Parts::read(&buffer[..count]) else { continue };
                    let bytes = replies.lock().unwrap().reply(&hooks, parts);
                    if !bytes.is_empty() {
                        let _ = to.send_to(&bytes, client);
                    }
                }
            });
            (out, shared)
        });
        let mut shared = shared.lock().unwrap();
        let bytes = (hooks.bytes)(&mut device_memory, buffer[..count].to_vec());
        match Parts::read(&bytes) {
            Some((parts, used)) if used == bytes.len() => {
                if let Some(bytes) = shared.request(&hooks, parts) {
                    let _ = out.send(&bytes);
                }
            }
            _ => drop(out.send(&bytes)),
        }
    }
}
