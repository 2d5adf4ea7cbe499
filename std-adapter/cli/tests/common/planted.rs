//! A small device with one planted bug, for the fuzzer. It crashes like a process: every connection ends, and its ports
//! are closed until it has restarted.

use std::collections::HashMap;
use std::io::{self, Read, Write};
use std::net::{Shutdown, SocketAddr, TcpListener, TcpStream, UdpSocket};
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};
use std::thread;
use std::time::Duration;

use bcap_core::bcap::{FunctionId, Kind, Object};
use bcap_core::hresult::HResult;
use bcap_core::limits::UDP_RECEIVE_MAX;
use bcap_core::rac;
use bcap_testkit::frame::{TestFrame, field};
use bcap_testkit::judge::TCP;
use bcap_testkit::oracle::Verdict;
use bcap_testkit::value::{ARRAY, Value};

/// Makes the enum of faults, and the list of those that are bugs.
macro_rules! bugs {
    ($($bug:ident)+; $($(#[$what:meta])* $other:ident)+) => {
        /// The fault of the device; [`Bug::None`] is a device without one.
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        pub(crate) enum Bug {
            None,
            $($bug,)+
            $($(#[$what])* $other,)+
        }

        impl Bug {
            /// All bugs.
            pub(crate) const ALL: &[Self] = &[$(Self::$bug),+];
        }
    };
}

bugs! {
    // malformed frames
    LengthBelowHeaderCrashes HugeLengthCrashes ArgumentCountCrashes ArrayCountCrashes NestingCrashes OddStringHangs
    WrongEndIsIgnored
    // valid frames
    LongStringCrashes SurrogateResets UnknownFunctionResets UnknownFunctionSucceeds MissingArgumentSucceeds
    ExtraArgumentHangs ForeignHandleCrashes InvalidHandleHangs
    // delivery
    SplitHeaderHangs JoinedRequestHangs RetryIsAnsweredTwice
    // replies
    SerialIsCut LengthIsOffByOne NameIsNumber TwoValues NoValue ExecutingForever
    // handles
    HandleLivesOn NegativeHandleIsValid ReleaseLeaks DisconnectLeaks
    // RAC
    LongLineCrashes IndexResets DoubleIsSingle
    // UDP
    LongDatagramCrashes CutDatagramHangs RetransmissionIsExecuted OldReplyRepeats;
    /// The network loses first attempts, and the device drops a repeated serial number.
    LosesDatagrams
    /// Controller_Execute over UDP takes longer than any time limit.
    SlowExecute
    /// RAC has one slot, which is mostly taken.
    BusyRac
}

impl Bug {
    /// Returns whether only datagrams show it.
    pub(crate) const fn is_of_datagrams(self) -> bool {
        matches!(
            self,
            Self::LongDatagramCrashes
                | Self::CutDatagramHangs
                | Self::RetransmissionIsExecuted
                | Self::OldReplyRepeats
                | Self::LosesDatagrams
        )
    }
}

/// The time that a crashed device takes to restart.
const RESTART: Duration = Duration::from_millis(30);
/// The objects of all clients that a device with a leak has room for.
const ROOM: usize = 50;

/// The device.
pub(crate) struct Planted {
    pub(crate) bcap: String,
    pub(crate) udp: String,
    pub(crate) rac: String,
    udp_port: SocketAddr,
    device: Arc<Device>,
}

struct Device {
    bug: Bug,
    ports: [SocketAddr; 2],
    has_crashed: AtomicBool,
    is_over: AtomicBool,
    leaked: AtomicUsize,
    /// The file that starts a crashed device again; without one it starts after a time.
    starts_by: Option<PathBuf>,
    streams: Mutex<Vec<TcpStream>>,
    calls: Mutex<Vec<FunctionId>>,
    /// The functions of frames that begin in one datagram and end in the next.
    joined: Mutex<Vec<FunctionId>>,
    /// Datagrams that were lost, and retransmissions of them that arrived.
    lost: AtomicUsize,
    retransmitted: AtomicUsize,
}

/// The outcome of a connection.
enum Outcome {
    Reply(Vec<u8>),
    /// No reply.
    Silence,
    Close,
    Crash,
}

impl Planted {
    pub(crate) fn start(bug: Bug) -> Self {
        Self::with(bug, None)
    }

    /// A crashed device stays away until this file exists, which it removes.
    pub(crate) fn start_by_file(bug: Bug, file: PathBuf) -> Self {
        Self::with(bug, Some(file))
    }

    fn with(bug: Bug, starts_by: Option<PathBuf>) -> Self {
        let listeners = [(); 2].map(|()| TcpListener::bind("127.0.0.1:0").unwrap());
        let ports = listeners.each_ref().map(|listener| listener.local_addr().unwrap());
        let device = Arc::new(Device {
            bug,
            ports,
            has_crashed: AtomicBool::new(false),
            is_over: AtomicBool::new(false),
            leaked: AtomicUsize::new(0),
            starts_by,
            streams: Mutex::default(),
            calls: Mutex::default(),
            joined: Mutex::default(),
            lost: AtomicUsize::new(0),
            retransmitted: AtomicUsize::new(0),
        });
        for (listener, is_rac) in listeners.into_iter().zip([false, true]) {
            let device = Arc::clone(&device);
            thread::spawn(move || device.listen(listener, is_rac));
        }
        let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
        let udp_port = socket.local_addr().unwrap();
        thread::spawn({
            let device = Arc::clone(&device);
            move || device.serve_datagrams(socket)
        });
        let [bcap, rac] = ports.map(|port| port.to_string());
        Self { bcap, udp: format!("udp:{udp_port}"), rac, udp_port, device }
    }

    /// Returns the functions that were called.
    pub(crate) fn calls(&self) -> Vec<FunctionId> {
        self.device.calls.lock().unwrap().clone()
    }

    /// Returns the functions that a device calls if it joins two datagrams.
    pub(crate) fn joined(&self) -> Vec<FunctionId> {
        self.device.joined.lock().unwrap().clone()
    }

    /// Returns the number of lost datagrams, and of their retransmissions.
    pub(crate) fn lost(&self) -> (usize, usize) {
        (self.device.lost.load(Ordering::SeqCst), self.device.retransmitted.load(Ordering::SeqCst))
    }
}

impl Drop for Planted {
    fn drop(&mut self) {
        self.device.is_over.store(true, Ordering::SeqCst);
        self.device.crash();
        // wakes the thread that receives
        let _ = UdpSocket::bind("127.0.0.1:0").and_then(|socket| socket.send_to(&[], self.udp_port));
    }
}

impl Device {
    fn listen(self: Arc<Self>, mut listener: TcpListener, is_rac: bool) {
        for number in 0.. {
            let Ok((stream, _)) = listener.accept() else { continue };
            if self.is_over.load(Ordering::SeqCst) {
                return;
            }
            if self.has_crashed.load(Ordering::SeqCst) && !is_rac {
                drop(stream);
                drop(listener);
                self.awaits_the_start();
                listener = loop {
                    // the port may still be in use by connections that are closing
                    if let Ok(listener) = TcpListener::bind(self.ports[0]) {
                        break listener;
                    }
                    if self.is_over.load(Ordering::SeqCst) {
                        return;
                    }
                    thread::sleep(Duration::from_millis(5));
                };
                self.leaked.store(0, Ordering::SeqCst);
                self.has_crashed.store(false, Ordering::SeqCst);
                continue;
            }
            if is_rac && self.bug == Bug::BusyRac && number % 3 != 0 {
                continue;
            }
            stream.set_nodelay(true).unwrap();
            self.streams.lock().unwrap().push(stream.try_clone().unwrap());
            let device = Arc::clone(&self);
            thread::spawn(move || if is_rac { device.serve_rac(stream) } else { device.serve(stream) });
        }
    }

    /// Waits until a crashed device starts again.
    fn awaits_the_start(&self) {
        let Some(file) = &self.starts_by else { return thread::sleep(RESTART) };
        while !self.is_over.load(Ordering::SeqCst) && std::fs::remove_file(file).is_err() {
            thread::sleep(Duration::from_millis(2));
        }
    }

    fn crash(&self) {
        self.has_crashed.store(true, Ordering::SeqCst);
        for stream in self.streams.lock().unwrap().drain(..) {
            let _ = stream.shutdown(Shutdown::Both);
        }
        // wakes the threads that listen
        self.ports.iter().for_each(|port| drop(TcpStream::connect(port)));
    }

    /// Applies an outcome to a connection; returns whether the connection continues.
    fn goes_on(&self, stream: &mut TcpStream, outcome: Outcome) -> bool {
        match outcome {
            Outcome::Reply(bytes) => stream.write_all(&bytes).is_ok(),
            Outcome::Silence => true,
            Outcome::Close => false,
            Outcome::Crash => {
                self.crash();
                false
            }
        }
    }

    fn serve(&self, mut stream: TcpStream) {
        let (mut client, mut bytes, mut buffer) =
            (Client { device: self, open: Vec::new(), next: 0 }, Vec::new(), vec![0; 1 << 16]);
        while let Ok(count @ 1..) = stream.read(&mut buffer) {
            if self.bug == Bug::SplitHeaderHangs && bytes.is_empty() && count < 15 {
                continue;
            }
            bytes.extend_from_slice(&buffer[..count]);
            let mut is_first = true;
            loop {
                let outcome = match TCP.decode(&bytes) {
                    Verdict::Incomplete => break,
                    Verdict::Refused => {
                        let outcome = self.refuse(&bytes);
                        let is_silent = matches!(outcome, Outcome::Silence);
                        if !self.goes_on(&mut stream, outcome) || !is_silent {
                            let _ = stream.shutdown(Shutdown::Both);
                            client.leave();
                            return;
                        }
                        bytes.clear();
                        break;
                    }
                    Verdict::Frame(frame, length) => {
                        bytes.drain(..length);
                        match is_first || self.bug != Bug::JoinedRequestHangs {
                            true => client.call(&frame, &mut stream),
                            false => Outcome::Silence,
                        }
                    }
                };
                is_first = false;
                if !self.goes_on(&mut stream, outcome) {
                    let _ = stream.shutdown(Shutdown::Both);
                    client.leave();
                    return;
                }
            }
        }
        let _ = stream.shutdown(Shutdown::Both);
        client.leave();
    }

    /// Serves clients over UDP, with one session per port.
    fn serve_datagrams(&self, mut socket: UdpSocket) {
        let port = socket.local_addr().unwrap();
        let mut peers: HashMap<SocketAddr, Peer<'_>> = HashMap::new();
        let mut buffer = vec![0; 1 << 16];
        let mut before: HashMap<SocketAddr, Vec<u8>> = HashMap::new();
        let mut lost: HashMap<SocketAddr, Vec<u16>> = HashMap::new();
        let mut number = 0;
        loop {
            let Ok((count, from)) = socket.recv_from(&mut buffer) else { continue };
            if self.is_over.load(Ordering::SeqCst) {
                return;
            }
            let last = before.entry(from).or_default();
            self.joined.lock().unwrap().extend(joined(last, &buffer[..count]));
            *last = buffer[..count].to_vec();
            if count > UDP_RECEIVE_MAX && self.bug == Bug::LongDatagramCrashes {
                drop(socket);
                thread::sleep(RESTART);
                socket = UdpSocket::bind(port).unwrap();
                peers.clear();
                continue;
            }
            let frame = match TCP.decode(&buffer[..count]) {
                Verdict::Frame(frame, length) if length == count && count <= UDP_RECEIVE_MAX => frame,
                Verdict::Incomplete if count >= 15 && self.bug == Bug::CutDatagramHangs => {
                    // until the end of the test
                    while !self.is_over.load(Ordering::SeqCst) {
                        thread::sleep(RESTART);
                    }
                    return;
                }
                _ => continue,
            };
            let marker = if frame.reserved == 0 { frame.serial } else { frame.reserved };
            let lost = lost.entry(from).or_default();
            if self.bug == Bug::LosesDatagrams && FunctionId(frame.code).opens().is_some() {
                number += 1;
                if lost.contains(&frame.serial) {
                    continue;
                }
                if lost.contains(&frame.reserved) {
                    self.retransmitted.fetch_add(1, Ordering::SeqCst);
                } else if number % 20 == 0 && frame.reserved == 0 {
                    lost.push(frame.serial);
                    self.lost.fetch_add(1, Ordering::SeqCst);
                    continue;
                }
            }
            if self.bug == Bug::SlowExecute && frame.code == FunctionId::CONTROLLER_EXECUTE.0 {
                self.calls.lock().unwrap().push(FunctionId::CONTROLLER_EXECUTE);
                continue;
            }
            if self.bug == Bug::OldReplyRepeats
                && FunctionId(frame.code).name().is_some_and(|name| name.contains("Get"))
                && let Some((_, Some((_, _, reply)))) = peers.get(&from)
            {
                // until a datagram of another client arrives
                socket.set_read_timeout(Some(Duration::from_millis(5))).unwrap();
                while !socket.recv_from(&mut buffer).is_ok_and(|(_, other)| other != from)
                    && !self.is_over.load(Ordering::SeqCst)
                {
                    let _ = socket.send_to(reply, from);
                }
                socket.set_read_timeout(None).unwrap();
                continue;
            }
            let client = || (Client { device: self, open: Vec::new(), next: 0 }, None);
            let (client, last) = peers.entry(from).or_insert_with(client);
            let is_copy = last.as_ref().is_some_and(|(first, code, _)| (*first, *code) == (marker, frame.code));
            if !is_copy || self.bug == Bug::RetransmissionIsExecuted {
                let Outcome::Reply(reply) = client.call(&frame, &mut io::sink()) else { continue };
                *last = Some((marker, frame.code, reply));
            }
            let Some((_, _, reply)) = last else { continue };
            reply[field::SERIAL].copy_from_slice(&frame.serial.to_le_bytes());
            let _ = socket.send_to(reply, from);
        }
    }

    /// Answers malformed bytes.
    fn refuse(&self, bytes: &[u8]) -> Outcome {
        let number = |at: usize, length: usize| {
            bytes
                .get(at..at + length)
                .map_or(0, |field| field.iter().rev().fold(0_u64, |sum, byte| sum << 8 | u64::from(*byte)))
        };
        let length = number(1, 4);
        match self.bug {
            Bug::LengthBelowHeaderCrashes if length < 16 => Outcome::Crash,
            Bug::HugeLengthCrashes if length > 0x0100_0000 => Outcome::Crash,
            Bug::ArgumentCountCrashes if number(13, 2) > 64 => Outcome::Crash,
            Bug::ArrayCountCrashes if number(19, 2) & u64::from(ARRAY) != 0 && number(21, 4) > 0xffff => Outcome::Crash,
            Bug::NestingCrashes
                if bytes.len() > 500 && bytes[200..398].chunks_exact(6).all(|level| level.contains(&12)) =>
            {
                Outcome::Crash
            }
            Bug::OddStringHangs if number(19, 2) == 8 && number(25, 4) % 2 == 1 => Outcome::Silence,
            Bug::WrongEndIsIgnored if bytes.last() != Some(&4) => Outcome::Silence,
            _ => Outcome::Reply(
                TestFrame { serial: 0, reserved: 0, code: HResult::E_INVALIDRCPACKET.0, args: vec![] }.to_wire(false),
            ),
        }
    }

    fn serve_rac(&self, mut stream: TcpStream) {
        let (mut bytes, mut buffer) = (Vec::new(), vec![0; 1 << 14]);
        while let Ok(count @ 1..) = stream.read(&mut buffer) {
            bytes.extend_from_slice(&buffer[..count]);
            while let Some(end) = bytes.iter().position(|byte| *byte == b'\r') {
                let line: Vec<u8> = bytes.drain(..=end).collect();
                let outcome = self.line(&line[..end]);
                if !self.goes_on(&mut stream, outcome) {
                    let _ = stream.shutdown(Shutdown::Both);
                    return;
                }
            }
        }
        let _ = stream.shutdown(Shutdown::Both);
    }

    fn line(&self, line: &[u8]) -> Outcome {
        let mut memory = [0; 1024];
        let value = match rac::Request::parse(line, &mut memory) {
            _ if line.len() > 256 && self.bug == Bug::LongLineCrashes => return Outcome::Crash,
            Ok(rac::Request::Get(variable)) if variable.index > 99_999 && self.bug == Bug::IndexResets => {
                return Outcome::Close;
            }
            Ok(rac::Request::Get(variable)) => match variable.kind {
                rac::VariableKind::I => "0,3,5",
                rac::VariableKind::D if self.bug == Bug::DoubleIsSingle => "0,4,1.5",
                rac::VariableKind::D => "0,5,1.5",
                _ => "-2147024809",
            },
            _ => "-2147024809",
        };
        Outcome::Reply(format!("{value}\r").into_bytes())
    }
}

/// Returns the functions of frames whose header begins in `first` and ends in `then`.
fn joined(first: &[u8], then: &[u8]) -> Vec<FunctionId> {
    let joint = [first, then].concat();
    (first.len().saturating_sub(12)..first.len())
        .filter(|at| joint[*at] == 1)
        .filter_map(|at| joint.get(at + 9..at + 13)?.try_into().ok().map(i32::from_le_bytes).map(FunctionId))
        .collect()
}

/// A client over UDP, and its last call: the marker, the function and the reply.
type Peer<'a> = (Client<'a>, Option<(u16, i32, Vec<u8>)>);

struct Client<'a> {
    device: &'a Device,
    open: Vec<(Object, i32)>,
    next: i32,
}

impl Client<'_> {
    fn leave(&self) {
        if self.device.bug == Bug::DisconnectLeaks {
            self.device.leaked.fetch_add(self.open.len(), Ordering::SeqCst);
        }
    }

    fn call(&mut self, frame: &TestFrame, stream: &mut impl Write) -> Outcome {
        let (bug, function) = (self.device.bug, FunctionId(frame.code));
        self.device.calls.lock().unwrap().push(function);
        let strings =
            || frame.args.iter().filter_map(|value| if let Value::Bstr(units) = value { Some(units) } else { None });
        let lone = |units: &Vec<u16>| char::decode_utf16(units.iter().copied()).any(|unit| unit.is_err());
        match bug {
            Bug::LongStringCrashes if strings().any(|units| units.len() >= 16_384) => return Outcome::Crash,
            Bug::SurrogateResets if strings().any(lone) => return Outcome::Close,
            _ => {}
        }
        let (code, value) = match self.execute(function, frame, stream) {
            Ok(answer) => answer,
            Err(outcome) => return outcome,
        };
        let cut = |serial: u16| if bug == Bug::SerialIsCut { serial & 0x7fff } else { serial };
        let mut args: Vec<_> = value.into_iter().collect();
        if bug == Bug::TwoValues && matches!(args[..], [Value::Empty]) {
            args.push(Value::Empty);
        }
        let is_text = matches!(args[..], [Value::Bstr(_)]);
        let mut reply = TestFrame { serial: cut(frame.serial), reserved: 0, code: code.0, args }.to_wire(false);
        if bug == Bug::LengthIsOffByOne && is_text {
            reply[field::LENGTH.start] += 1;
        }
        if bug == Bug::RetryIsAnsweredTwice && frame.reserved != 0 {
            reply = [&reply[..], &reply].concat();
        }
        Outcome::Reply(reply)
    }

    fn execute(
        &mut self,
        function: FunctionId,
        frame: &TestFrame,
        stream: &mut impl Write,
    ) -> Result<(HResult, Option<Value>), Outcome> {
        let bug = self.device.bug;
        let Some(signature) = function.signature() else {
            return match bug {
                Bug::UnknownFunctionResets => Err(Outcome::Close),
                Bug::UnknownFunctionSucceeds => Ok((HResult::S_OK, None)),
                _ => Ok((HResult::E_NOTIMPL, None)),
            };
        };
        let (given, expected) = (frame.args.len(), signature.arguments.len());
        if given < expected && bug != Bug::MissingArgumentSucceeds {
            return Ok((HResult::E_INVALIDARG, None));
        }
        if given > expected {
            return if bug == Bug::ExtraArgumentHangs {
                Err(Outcome::Silence)
            } else {
                Ok((HResult::E_INVALIDARG, None))
            };
        }
        let handle = match (signature.arguments.first(), frame.args.first()) {
            (Some(Kind::Handle(object)), Some(Value::I4(handle))) => Some((*object, *handle)),
            (Some(Kind::Handle(_)), _) => return Ok((HResult::E_INVALIDARG, None)),
            _ => None,
        };
        if let Some((object, handle)) = handle
            && !self.open.contains(&(object, handle))
        {
            let is_valid = bug == Bug::NegativeHandleIsValid && handle < 0;
            let lives_on =
                bug == Bug::HandleLivesOn && handle > 0 && handle <= self.next && handle % 8 == object as i32;
            if bug == Bug::ForeignHandleCrashes && self.open.iter().any(|open| open.1 == handle) {
                return Err(Outcome::Crash);
            }
            if bug == Bug::InvalidHandleHangs && handle > 100 {
                return Err(Outcome::Silence);
            }
            if bug == Bug::ExecutingForever && handle == 0 {
                let executing =
                    TestFrame { serial: frame.serial, reserved: 0, code: HResult::S_EXECUTING.0, args: vec![] };
                while stream.write_all(&executing.to_wire(false)).is_ok() {
                    thread::sleep(Duration::from_millis(20));
                }
                return Err(Outcome::Close);
            }
            if !is_valid && !lives_on {
                return Ok((HResult::E_HANDLE, None));
            }
        }
        self.result(function, signature.result, handle)
    }

    /// Returns the result of a function that succeeds.
    fn result(
        &mut self,
        function: FunctionId,
        kind: Kind,
        handle: Option<(Object, i32)>,
    ) -> Result<(HResult, Option<Value>), Outcome> {
        let bug = self.device.bug;
        if function.releases().is_some() {
            self.open.retain(|open| Some(*open) != handle);
            if bug == Bug::ReleaseLeaks {
                self.device.leaked.fetch_add(1, Ordering::SeqCst);
            }
        }
        Ok((
            HResult::S_OK,
            match kind {
                Kind::Handle(object) => {
                    if self.device.leaked.load(Ordering::SeqCst) + self.open.len() > ROOM {
                        return Ok((HResult::E_OUTOFMEMORY, None));
                    }
                    self.next = (self.next / 8 + 1) * 8 + object as i32;
                    self.open.push((object, self.next));
                    Some(Value::I4(self.next))
                }
                Kind::Int if bug == Bug::NoValue => None,
                Kind::Int => Some(Value::I4(7)),
                Kind::Float => Some(Value::R4(1.0_f32.to_bits())),
                Kind::Text if bug == Bug::NameIsNumber => Some(Value::I4(7)),
                Kind::Text => Some(Value::text("name")),
                Kind::Any | Kind::Maybe => Some(Value::Empty),
                Kind::Nothing => None,
            },
        ))
    }
}
