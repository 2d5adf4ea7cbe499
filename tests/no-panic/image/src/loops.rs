//! The blocking loops, with servers in the same program, and link faults that the input selects.
//!
//! The async loops cannot be searched: the compiler puts a panic into every `async fn` for a poll after its end, which
//! `.await` never does. They have no other panic.

use bcap_core::endpoint::{Endpoint, Serve};
use core::time::Duration;

use bcap_core::bcap::call::{self, ControllerHandle, RobotHandle};
use bcap_core::bcap::client::{self, Client};
use bcap_core::bcap::server;
use bcap_core::handler::{Outcome, PeerId, ReplyValue};
use bcap_core::hresult::HResult;
use bcap_core::io::blocking::{Connection, RacConnection, Transport};
use bcap_core::position::Position;
use bcap_core::procedure::{self, Motion, MotionConfig, MotionStart, Provider, Target};
use bcap_core::rac::{self, Variable, VariableKind};
use bcap_core::slave::{self, Engine};
use bcap_core::time::Instant;
use bcap_core::variant::Variant;

use crate::carry;

/// Number of calls of each loop.
const CALLS: u32 = 50;

/// The link was cut.
struct Cut;

/// The outcome of the next operation of the link, taken from the input.
struct Fate<'a> {
    input: &'a [u8],
    now: Instant,
}

impl Fate<'_> {
    fn next(&mut self) -> u8 {
        let (first, rest) = self.input.split_first().unwrap_or((&7, &[]));
        self.input = rest;
        self.now = Instant::from_micros(self.now.as_micros().wrapping_add(u64::from(*first)));
        *first
    }

    /// Moves bytes from one end to the other, or not.
    fn pass(&mut self, from: &[u8], to: &mut [u8], until: Instant) -> Result<Option<usize>, Cut> {
        let count = match self.next() {
            0 => return Err(Cut),
            most @ 1..16 => carry(from.get(..usize::from(most)).unwrap_or(from), to),
            16 => carry(self.input.get(..8).unwrap_or_default(), to),
            _ => carry(from, to),
        };
        if count == 0 {
            self.now = self.now.max(until);
            return Ok(None);
        }
        Ok(Some(count.min(from.len())))
    }
}

/// A server of b-CAP at the other end.
struct Binary<'a> {
    fate: Fate<'a>,
    session: server::Session<[u8; 512], [u8; 512], 8>,
}

/// A server of RAC at the other end.
struct Text<'a> {
    fate: Fate<'a>,
    session: rac::server::Session<[u8; 128]>,
}

/// Answers with a number, or lets wait.
struct Answers;

impl server::Handler for Answers {
    fn call(
        &mut self,
        peer: PeerId,
        request: &server::Request<'_>,
        reply: &mut ReplyValue<'_>,
        now: Instant,
    ) -> Outcome {
        if request.args.len() == 3 { Outcome::Wait(now) } else { self.resume(peer, request, reply, now) }
    }

    fn resume(&mut self, _: PeerId, _: &server::Request<'_>, reply: &mut ReplyValue<'_>, _: Instant) -> Outcome {
        reply.set(&7).map_or(HResult::E_FAIL, |()| HResult::S_OK).into()
    }
}

impl rac::server::Handler for Answers {
    fn call(&mut self, _: PeerId, request: &rac::Request<'_>, reply: &mut ReplyValue<'_>, _: Instant) -> Outcome {
        reply.set(&request.variable().index).map_or(HResult::E_FAIL, |()| HResult::S_OK).into()
    }
}

macro_rules! transports {
    ($($link:ident)*) => {$(
        impl Transport for $link<'_> {
            type Error = Cut;

            fn now(&self) -> Instant {
                self.fate.now
            }

            fn send(&mut self, bytes: &[u8], until: Instant) -> Result<Option<usize>, Cut> {
                let sent = self.fate.pass(bytes, self.session.receive_buffer(), until)?;
                self.session.received(sent.unwrap_or(0));
                while self.session.run(&mut Answers, PeerId(1), self.fate.now).is_some() {}
                Ok(sent)
            }

            fn receive(&mut self, buffer: &mut [u8], until: Instant) -> Result<Option<usize>, Cut> {
                while self.session.run(&mut Answers, PeerId(1), self.fate.now).is_some() {}
                let received = self.fate.pass(self.session.transmit(), buffer, until)?;
                self.session.transmitted(received.unwrap_or(0));
                Ok(received)
            }

            fn sleep_until(&mut self, at: Instant) {
                self.fate.now = at;
            }
        }
    )*};
}

transports! { Binary Text }

/// Makes calls and streams poses with the blocking loop; returns how many calls were answered.
pub fn binary(input: &[u8]) -> u32 {
    let session = server::Session::new(server::Config::TCP, [0; 512], [0; 512]);
    let link = Binary { fate: Fate { input, now: Instant::ZERO }, session };
    let mut connection = Connection::new(link, Client::new(client::Config::TCP, [0; 512], [0; 512]));
    let mut answered = 0_u32;
    for turn in 0..CALLS {
        let good = match turn % 3 {
            0 => connection.call(call::service_start("")).is_ok(),
            1 => connection.call(call::controller_connect("", "", "", "")).is_ok(),
            _ => connection.call(call::controller_get_robot(ControllerHandle(7), "", "")).is_ok(),
        };
        answered = answered.wrapping_add(u32::from(good && connection.last_result().is_some()));
        if connection.client().is_closed() {
            connection.client().reset();
        }
    }
    answered.wrapping_add(stream(&mut connection).unwrap_or(0))
}

/// Runs the procedures, and a stream that recovers from its faults; returns how many poses were taken.
fn stream(connection: &mut Connection<Binary<'_>, [u8; 512]>) -> Option<u32> {
    let mode = slave::SlaveMode { mode: slave::Mode::Mode0, pose: slave::PoseType::J };
    let format = slave::Format::new(mode, slave::ReceiveFormat::pose(slave::ReceivePose::J));
    let opened = connection.run(procedure::open_robot(Provider::RC9, None));
    let handles = opened.unwrap_or(slave::Handles { controller: ControllerHandle(7), robot: RobotHandle(7) });
    let number = procedure::read_variable(handles.controller, "I1", |value| value.as_i32()).ok()?;
    let mut moved = connection.run(number).ok().flatten().map_or(0, i32::unsigned_abs);
    let put = procedure::write_variable(handles.controller, "I1", &moved).ok()?;
    let put = connection.run(put).is_ok();
    let motion = MotionStart::Move { interpolation: 1, pose: "@E P1", option: "NEXT" };
    let prepared = connection.run(procedure::prepare_robot(handles.robot, [0, 1], true)).is_ok();
    let config = MotionConfig::within(Duration::from_secs(1));
    let target = Target::position(Position::new([400.0, 0.0, 300.0], [180.0, 0.0, 180.0])).back(20.0);
    let arrived = connection.run(procedure::move_and_wait(handles, motion, target, config));
    moved = moved.wrapping_add(u32::from(put)).wrapping_add(u32::from(prepared));
    moved = moved.wrapping_add(u32::from(matches!(arrived, Ok(Motion::Arrived))));
    let mut engine = Engine::<256>::new(slave::Config::new(format, handles)).ok()?;
    for _ in 0..CALLS {
        let mut stop = |_: &slave::Cycle<'_>| slave::Next::Stop;
        if connection.run(engine.stream(&mut stop)).is_ok() || engine.recover().is_err() {
            break;
        }
        moved = moved.wrapping_add(1);
    }
    let _ = connection.run(procedure::release_robot(handles));
    Some(moved.wrapping_add(engine.stats().cycles))
}

/// Reads and writes variables by the blocking loop; returns how many times that worked.
pub fn text(input: &[u8]) -> u32 {
    let session = rac::server::Session::new(rac::server::Config::TCP, [0; 128]);
    let link = Text { fate: Fate { input, now: Instant::ZERO }, session };
    let mut connection = RacConnection::new(link, rac::client::Client::new(rac::client::Config::TCP, [0; 64]));
    let mut done = 0_u32;
    for index in 0..CALLS {
        let variable = Variable::new(VariableKind::I, index);
        let good = [
            connection.get(variable).is_ok_and(|value| value.as_i64().is_some()),
            connection.put(variable, Variant::I4(1)).is_ok(),
        ];
        done = good.iter().fold(done, |sum, good| sum.wrapping_add(u32::from(*good)));
        if connection.client().is_closed() {
            connection.client().reset();
        }
    }
    done
}
