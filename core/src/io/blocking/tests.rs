extern crate std;

use std::collections::VecDeque;
use std::vec::Vec;

use super::*;
use crate::bcap::call::{self, VariableHandle};
use crate::bcap::client::{ClientError, Config, Timeout};
use crate::bcap::{Decoder, FrameWriter};
use crate::variant::Variant;

/// A peer that answers each whole request as its script says, over a link that takes and gives a few bytes at a time.
#[derive(Default)]
struct Scripted {
    now: Instant,
    heard: Vec<u8>,
    replies: VecDeque<Reaction>,
    pending: VecDeque<u8>,
    chunk: usize,
    closed: bool,
}

enum Reaction {
    /// A reply with this code and value.
    Value(HResult, i32),
    /// S_EXECUTING, then nothing.
    Executing,
    Silence,
    Close,
}

impl Scripted {
    fn new(chunk: usize, replies: impl IntoIterator<Item = Reaction>) -> Self {
        Self { chunk, replies: replies.into_iter().collect(), ..Self::default() }
    }

    fn react(&mut self) {
        let Ok(frame) = Decoder::TCP.decode_datagram(&self.heard) else { return };
        let mut buffer = [0; 64];
        let mut reply = FrameWriter::new(&mut buffer).unwrap();
        let code = match self.replies.pop_front() {
            Some(Reaction::Value(code, value)) => {
                reply.argument(&value).unwrap();
                code
            }
            Some(Reaction::Executing) => HResult::S_EXECUTING,
            Some(Reaction::Close) | None => {
                self.closed = true;
                HResult::S_OK
            }
            Some(Reaction::Silence) => {
                self.heard.clear();
                return;
            }
        };
        self.pending.extend(reply.finish(frame.serial, 0, code.0).unwrap());
        self.heard.clear();
    }
}

impl Transport for Scripted {
    type Error = core::convert::Infallible;

    fn now(&self) -> Instant {
        self.now
    }

    fn send(&mut self, bytes: &[u8], _: Instant) -> Result<Option<usize>, Self::Error> {
        let count = bytes.len().min(self.chunk);
        self.heard.extend(&bytes[..count]);
        self.react();
        Ok(Some(count))
    }

    fn receive(&mut self, buffer: &mut [u8], until: Instant) -> Result<Option<usize>, Self::Error> {
        if self.closed {
            return Ok(Some(0));
        }
        if self.pending.is_empty() {
            self.now = until;
            return Ok(None);
        }
        let count = buffer.len().min(self.chunk).min(self.pending.len());
        for (slot, byte) in buffer.iter_mut().zip(self.pending.drain(..count)) {
            *slot = byte;
        }
        Ok(Some(count))
    }
}

fn connection(chunk: usize, replies: impl IntoIterator<Item = Reaction>) -> Connection<Scripted, [u8; 64]> {
    Connection::new(Scripted::new(chunk, replies), Client::new(Config::TCP, [0; 64], [0; 64]))
}

fn get() -> impl Call<Reply = call::Any> {
    call::variable_get_value(VariableHandle(3))
}

#[test]
fn calls_return_values_whatever_the_link_takes_at_once() {
    for chunk in [1, 3, 16, 64] {
        let mut connection =
            connection(chunk, [Reaction::Value(HResult::S_OK, 1), Reaction::Value(HResult::S_BUF_FULL, 2)]);
        assert_eq!(connection.call(get()), Ok(Variant::I4(1)));
        assert_eq!(connection.call(get()), Ok(Variant::I4(2)));
        assert_eq!(connection.last_result(), Some(HResult::S_BUF_FULL));
    }
}

#[test]
fn errors_say_whose_fault_it_is() {
    let mut refused = connection(64, [Reaction::Value(HResult::E_HANDLE, 0), Reaction::Value(HResult::S_OK, 5)]);
    let error = refused.call(get()).unwrap_err();
    assert_eq!(error, CallError::Refused(HResult::E_HANDLE));
    assert!(error.is_recoverable());
    assert_eq!(refused.call(get()), Ok(Variant::I4(5)));

    let mut silent = connection(64, [Reaction::Silence, Reaction::Value(HResult::S_OK, 6)]);
    assert_eq!(silent.call(get()), Err(CallError::Client(ClientError::Timeout(Timeout::Attempt))));
    assert_eq!(silent.transport().now, Instant::from_millis(3000));
    assert_eq!(silent.call(get()), Ok(Variant::I4(6)));

    let mut busy = connection(64, [Reaction::Executing]);
    assert_eq!(busy.call(get()), Err(CallError::Client(ClientError::Timeout(Timeout::Attempt))));

    let mut gone = connection(64, [Reaction::Close]);
    let error = gone.call(get()).unwrap_err();
    assert_eq!(error, CallError::Disconnected);
    assert!(!error.is_recoverable());
}

#[test]
fn a_value_of_the_wrong_type_is_the_peers_fault() {
    let mut connection = connection(64, [Reaction::Value(HResult::S_OK, 1)]);
    let error = connection.call(call::controller_get_name(call::ControllerHandle(1))).unwrap_err();
    assert!(matches!(error, CallError::Client(ClientError::Reply(_))), "{error:?}");
}
