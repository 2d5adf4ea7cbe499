extern crate std;

use core::pin::pin;
use core::task::{Context, Poll, Waker};
use std::collections::VecDeque;
use std::vec::Vec;

use super::*;
use crate::bcap::call::{self, ControllerHandle, RobotHandle, VariableHandle};
use crate::bcap::client::Config;
use crate::bcap::{Decoder, FrameWriter, Progress};
use crate::slave::{
    self, Cause, Cycle, Engine, Failure, Format, Handles, Mode, PoseType, ReceiveFormat, ReceivePose, SlaveMode, Step,
    StreamError,
};
use crate::variant::Variant;

/// A link that is ready for one byte at every other poll, to a peer that answers each request with its own serial.
#[derive(Default)]
struct OneByte {
    ready: bool,
    received: Vec<u8>,
    requests: usize,
    pending: VecDeque<u8>,
}

impl OneByte {
    fn react(&mut self) {
        while let Ok(Progress::Complete(frame, used)) = Decoder::TCP.decode(&self.received) {
            self.requests = self.requests.saturating_add(1);
            let mut buffer = [0; 64];
            let mut reply = FrameWriter::new(&mut buffer).unwrap();
            // no stream runs
            let asks = frame.args.get(1).and_then(|name| name.as_bstr()).is_some_and(|name| name == "slvGetMode");
            reply.argument(&if asks { 0 } else { i32::from(frame.serial) }).unwrap();
            self.pending.extend(reply.finish(frame.serial, 0, 0).unwrap());
            self.received.drain(..used);
        }
    }

    fn poll<T>(&mut self, work: impl FnOnce(&mut Self) -> Option<T>) -> Poll<T> {
        self.ready = !self.ready;
        if self.ready {
            return Poll::Pending;
        }
        work(self).map_or(Poll::Pending, Poll::Ready)
    }
}

impl Transport for OneByte {
    type Error = core::convert::Infallible;

    fn now(&self) -> Instant {
        Instant::ZERO
    }

    async fn send(&mut self, bytes: &[u8], _: Instant) -> Result<Option<usize>, Self::Error> {
        core::future::poll_fn(|_| {
            self.poll(|link| {
                link.received.push(bytes[0]);
                link.react();
                Some(Ok(Some(1)))
            })
        })
        .await
    }

    async fn receive(&mut self, buffer: &mut [u8], until: Instant) -> Result<Option<usize>, Self::Error> {
        core::future::poll_fn(|_| {
            self.poll(|link| match link.pending.pop_front() {
                Some(byte) => {
                    buffer[0] = byte;
                    Some(Ok(Some(1)))
                }
                None => (until <= link.now()).then_some(Ok(None)),
            })
        })
        .await
    }

    async fn sleep_until(&mut self, _: Instant) {
        core::future::poll_fn(|_| self.poll(|_| Some(()))).await;
    }
}

/// Polls a future `count` times, and returns its output if it ended.
fn poll_times<T>(future: impl Future<Output = T>, times: usize) -> Option<T> {
    let mut future = pin!(future);
    let mut cx = Context::from_waker(Waker::noop());
    (0..times).find_map(|_| match future.as_mut().poll(&mut cx) {
        Poll::Ready(output) => Some(output),
        Poll::Pending => None,
    })
}

#[test]
fn a_call_dropped_at_any_point_leaves_the_connection_good() {
    for polls in 0..140 {
        let client = Client::new(Config::TCP, [0; 64], [0; 64]);
        let mut connection = Connection::new(OneByte::default(), client);
        let get = || call::variable_get_value(VariableHandle(3));
        let first = poll_times(connection.call(get()), polls).is_some();
        // the next call gets its own answer, whatever is left of the first
        let value = poll_times(connection.call(get()), 1000).expect("it must end").unwrap();
        let Variant::I4(serial) = value else { panic!("{value:?}") };
        // a call begins when nothing early is left to be read
        assert_eq!(serial, if polls < 2 { 1 } else { 2 }, "after {polls} polls");
        // the peer has received the whole first request, or nothing
        let requests = connection.transport.requests;
        assert!(requests == 2 || (requests == 1 && !first), "{requests} after {polls} polls");
    }
}

#[test]
fn a_stream_may_be_dropped_at_any_point_and_run_again() {
    let mode = SlaveMode { mode: Mode::Mode1, pose: PoseType::J };
    let format = Format::new(mode, ReceiveFormat::pose(ReceivePose::J));
    let handles = Handles { controller: ControllerHandle(1), robot: RobotHandle(2) };
    let mut steps = Vec::new();
    for polls in 0..1500 {
        let mut engine = Engine::<256>::new(slave::Config::new(format, handles)).unwrap();
        let mut connection = Connection::new(OneByte::default(), Client::new(Config::TCP, [0; 256], [0; 256]));
        let mut hold = |_: &Cycle<'_>| slave::Next::Stop;
        let ended = poll_times(connection.run(engine.stream(&mut hold)), polls).is_some();
        if !ended {
            // the engine is notified that its call was dropped, and queries the state of the controller
            let error =
                poll_times(connection.run(engine.stream(&mut hold)), 5000).expect("it must end").unwrap_err().error;
            let StreamError::Fault { step, cause, .. } = error else { panic!("{error:?}") };
            let expected = if step == Step::Position { Cause::NoValue } else { Cause::Failed(Failure::Timeout) };
            assert!(cause == expected || cause == Cause::Failed(Failure::Timeout), "{error} after {polls} polls");
            steps.push(step);
        }
    }
    steps.dedup();
    // before the first call, this peer's numbers are not a position
    let dropped = [
        Step::Position,
        Step::GetMode,
        Step::SendFormat,
        Step::ReceiveFormat,
        Step::TakeArm,
        Step::Motor,
        Step::Position,
    ];
    assert_eq!(steps, dropped);
}
