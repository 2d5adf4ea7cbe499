extern crate std;

use core::time::Duration;
use std::collections::VecDeque;
use std::vec::Vec;

use super::*;
use crate::bcap::call::{self, ControllerHandle, RobotHandle, VariableHandle};
use crate::bcap::client::{ClientError, Config, Timeout};
use crate::bcap::{Decoder, FrameWriter};
use crate::slave::{
    self, Cause, Cycle, Engine, Failure, Format, Handles, Mode, MoveReply, Pose, PoseType, ReceiveFormat, ReceivePose,
    SlaveMode, Step, StreamError, Trajectory,
};
use crate::variant::Variant;

/// A peer that answers each whole request as its script says, over a link that takes and gives a few bytes at a time.
#[derive(Default)]
struct Scripted {
    now: Instant,
    received: Vec<u8>,
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
        let Ok(frame) = Decoder::TCP.decode_datagram(&self.received) else { return };
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
                self.received.clear();
                return;
            }
        };
        self.pending.extend(reply.finish(frame.serial, 0, code.0).unwrap());
        self.received.clear();
    }
}

impl Transport for Scripted {
    type Error = core::convert::Infallible;

    fn now(&self) -> Instant {
        self.now
    }

    fn send(&mut self, bytes: &[u8], _: Instant) -> Result<Option<usize>, Self::Error> {
        let count = bytes.len().min(self.chunk);
        self.received.extend(&bytes[..count]);
        self.react();
        Ok(Some(count))
    }

    fn receive(&mut self, buffer: &mut [u8], until: Instant) -> Result<Option<usize>, Self::Error> {
        if self.closed {
            return Ok(Some(0));
        }
        if self.pending.is_empty() {
            self.now = self.now.max(until);
            return Ok(None);
        }
        let count = buffer.len().min(self.chunk).min(self.pending.len());
        for (slot, byte) in buffer.iter_mut().zip(self.pending.drain(..count)) {
            *slot = byte;
        }
        Ok(Some(count))
    }

    fn sleep_until(&mut self, at: Instant) {
        self.now = self.now.max(at);
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

/// An engine that streams joints.
fn engine(mode: Mode) -> Engine {
    let mode = SlaveMode { mode, pose: PoseType::J };
    let format = Format::new(mode, ReceiveFormat::pose(ReceivePose::J));
    let handles = Handles { controller: ControllerHandle(1), robot: RobotHandle(2) };
    Engine::new(slave::Config::new(format, handles)).unwrap()
}

/// A controller in mode 0 that answers each command; every third datagram is lost, and the buffer is full at times.
struct Robot {
    now: Instant,
    reply: Option<Vec<u8>>,
    sent: u32,
    /// Time that the client waited without a reply.
    waited: Vec<Duration>,
}

impl Transport for Robot {
    type Error = core::convert::Infallible;

    fn now(&self) -> Instant {
        self.now
    }

    fn send(&mut self, bytes: &[u8], _: Instant) -> Result<Option<usize>, Self::Error> {
        self.sent = self.sent.wrapping_add(1);
        if self.sent.is_multiple_of(3) {
            return Ok(Some(bytes.len()));
        }
        let request = Decoder::UDP.decode_datagram(bytes).unwrap();
        let command = request.args.get(1).unwrap().as_bstr().unwrap();
        let mut code = HResult::S_OK;
        let mut buffer = [0; 128];
        let mut reply = FrameWriter::new(&mut buffer).unwrap();
        if command == "slvMove" || command == "CurJnt" {
            reply.argument(&[1.5; 8]).unwrap();
        }
        if command == "slvGetMode" {
            reply.argument(&0).unwrap();
        }
        if command == "slvMove" {
            code = if request.serial.is_multiple_of(5) { HResult::E_BUF_FULL } else { HResult::S_BUF_FULL };
        }
        self.reply = Some(reply.finish(request.serial, 0, code.0).unwrap().to_vec());
        Ok(Some(bytes.len()))
    }

    fn receive(&mut self, buffer: &mut [u8], until: Instant) -> Result<Option<usize>, Self::Error> {
        let Some(reply) = self.reply.take() else {
            if until > self.now {
                self.waited.push(until.saturating_since(self.now));
                self.now = until;
            }
            return Ok(None);
        };
        buffer[..reply.len()].copy_from_slice(&reply);
        Ok(Some(reply.len()))
    }

    fn sleep_until(&mut self, at: Instant) {
        self.now = at;
    }
}

/// Holds the robot where it is for a hundred poses, and counts the answers.
#[derive(Default)]
struct Hold {
    poses: u32,
    moved: u32,
}

impl Trajectory for Hold {
    fn next(&mut self, _: &Cycle<'_>) -> slave::Next {
        if self.poses == 100 {
            return slave::Next::Stop;
        }
        self.poses = self.poses.saturating_add(1);
        slave::Next::Pose(Pose::j([1.5; 8]))
    }

    fn moved(&mut self, reply: &MoveReply<'_>, _: Instant) {
        self.moved = self.moved.saturating_add(1);
        assert_eq!(reply.joints(), Some([1.5; 8]));
    }
}

#[test]
fn a_stream_runs_over_a_link_that_loses_datagrams() {
    let mut engine = engine(Mode::Mode0);
    let robot = Robot { now: Instant::ZERO, reply: None, sent: 0, waited: Vec::new() };
    let mut connection = Connection::new(robot, Client::new(Config::UDP, [0; 512], [0; 512]));
    let mut hold = Hold::default();
    assert_eq!(connection.run(engine.stream(&mut hold)), Ok(()));
    let Hold { poses, moved } = hold;
    let stats = engine.stats();
    assert_eq!((stats.cycles, moved, poses), (moved, moved, 100));
    assert!(stats.refused > 10);
    // a slvMove is repeated within a cycle, anything else after the usual time
    let waited = &connection.transport().waited;
    assert!(waited.iter().all(|wait| [8, 500].map(Duration::from_millis).contains(wait)), "{waited:?}");
    assert!(waited.contains(&Duration::from_millis(8)) && waited.contains(&Duration::from_millis(500)));
    assert_eq!(connection.client().timing(), Config::UDP.timing);
}

#[test]
fn a_connection_that_closes_ends_the_stream() {
    let mut engine = engine(Mode::Mode1);
    let replies = [Reaction::Value(HResult::S_OK, 0), Reaction::Close];
    let link = Scripted::new(512, replies);
    let mut connection = Connection::new(link, Client::new(Config::TCP, [0; 512], [0; 512]));
    let cause = Cause::Failed(Failure::Lost);
    let error = StreamError::Fault { step: Step::SendFormat, cause, code: None };
    let lost = Some(CallError::Disconnected);
    assert_eq!(connection.run(engine.stream(&mut Hold::default())), Err(RunError { error, call: lost }));
    let fault = engine.fault().unwrap();
    assert_eq!((fault.step, fault.cause), (Step::SendFormat, cause));
}
