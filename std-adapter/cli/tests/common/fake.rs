//! A fake controller with scripted answers, for behaviour that the virtual controller does not have.

use std::io::{Read, Write};
use std::net::{TcpListener, UdpSocket};
use std::sync::{Arc, Mutex};
use std::thread;

use bcap_core::bcap::{Decoder, Frame, FrameWriter, FunctionId, Progress};
use bcap_core::hresult::HResult;
use bcap_core::variant::Encode;

/// The controller's answer to a request.
pub(crate) struct Answer {
    pub(crate) code: HResult,
    pub(crate) value: Option<Box<dyn Encode>>,
}

impl From<HResult> for Answer {
    fn from(code: HResult) -> Self {
        Self { code, value: None }
    }
}

/// Answers with a value.
pub(crate) fn value(value: impl Encode + 'static) -> Answer {
    Answer { code: HResult::S_OK, value: Some(Box::new(value)) }
}

/// Answers the calls that begin and end a session, as any controller does.
pub(crate) fn usual(request: &Frame<'_>) -> Answer {
    match request.function() {
        FunctionId::CONTROLLER_CONNECT => value(1),
        FunctionId::CONTROLLER_GET_VARIABLE => value(2),
        FunctionId::CONTROLLER_GET_ROBOT => value(3),
        FunctionId::CONTROLLER_GET_TASK => value(4),
        FunctionId::ROBOT_EXECUTE if asks_for_stream(request) => value(0),
        _ => HResult::S_OK.into(),
    }
}

/// Returns whether a request queries if a stream of Slave Mode runs.
fn asks_for_stream(request: &Frame<'_>) -> bool {
    request.args.get(1).and_then(|command| command.as_bstr()).is_some_and(|command| command == "slvGetMode")
}

/// A controller on its own port, which serves one client at a time until the test ends.
pub(crate) struct Fake {
    /// The address in the form of `--robot`.
    pub(crate) address: String,
    /// The received requests, as `Function(argument, ...)`.
    pub(crate) seen: Arc<Mutex<Vec<String>>>,
}

impl Fake {
    /// Listens on TCP.
    pub(crate) fn tcp(answer: impl Fn(&Frame<'_>) -> Answer + Send + 'static) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = format!("tcp:{}", listener.local_addr().unwrap());
        let seen = Arc::new(Mutex::new(Vec::new()));
        let requests = Arc::clone(&seen);
        thread::spawn(move || {
            for stream in listener.incoming() {
                let (mut stream, mut bytes) = (stream.unwrap(), Vec::new());
                let mut part = [0; 4096];
                while let Ok(count @ 1..) = stream.read(&mut part) {
                    bytes.extend_from_slice(&part[..count]);
                    while let Progress::Complete(frame, used) = Decoder::TCP.decode(&bytes).unwrap() {
                        let reply = reply(&frame, &answer, &requests);
                        stream.write_all(&reply).unwrap();
                        bytes.drain(..used);
                    }
                }
            }
        });
        Self { address, seen }
    }

    /// Listens on UDP.
    pub(crate) fn udp(answer: impl Fn(&Frame<'_>) -> Answer + Send + 'static) -> Self {
        let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
        let address = format!("udp:{}", socket.local_addr().unwrap());
        let seen = Arc::new(Mutex::new(Vec::new()));
        let requests = Arc::clone(&seen);
        thread::spawn(move || {
            let mut bytes = [0; 600];
            while let Ok((count, peer)) = socket.recv_from(&mut bytes) {
                let frame = Decoder::UDP.decode_datagram(&bytes[..count]).unwrap();
                let reply = reply(&frame, &answer, &requests);
                socket.send_to(&reply, peer).unwrap();
            }
        });
        Self { address, seen }
    }

    /// Returns the requests received so far.
    pub(crate) fn seen(&self) -> Vec<String> {
        self.seen.lock().unwrap().clone()
    }
}

fn reply(request: &Frame<'_>, answer: &impl Fn(&Frame<'_>) -> Answer, seen: &Mutex<Vec<String>>) -> Vec<u8> {
    let arguments: Vec<String> = request.args.iter().map(|value| format!("{value:?}")).collect();
    seen.lock().unwrap().push(format!("{:?}({})", request.function(), arguments.join(", ")));
    let answer = answer(request);
    // large enough for any frame
    let mut buffer = vec![0; if answer.value.is_some() { 16 * 1024 * 1024 } else { 16 }];
    let mut frame = FrameWriter::new(&mut buffer).unwrap();
    if let Some(value) = answer.value {
        frame.argument(&*value).unwrap();
    }
    frame.finish(request.serial, 0, answer.code.0).unwrap().to_vec()
}
