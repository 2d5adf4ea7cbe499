//! Requests over RAC.

use bcap_core::endpoint::{Endpoint, Serve};
use std::collections::{BTreeMap, VecDeque};
use std::convert::Infallible;
use std::future::poll_fn;
use std::task::Poll;
use std::time::Duration;

use bcap_core::handler::{Outcome, PeerId, ReplyValue};
use bcap_core::hresult::HResult;
use bcap_core::io::asynch::{RacConnection, Transport};
use bcap_core::rac::client::{Client, Config};
use bcap_core::rac::server::{self, Handler, Session};
use bcap_core::rac::{Request, Variable, VariableKind};
use bcap_core::time::Instant;
use bcap_core::variant::Variant;
use bcap_testkit::network::answer_to;

use crate::cancellation::sweep::{finish, poll_times};

/// How long a request may take: not the default.
const TIMEOUT: Duration = Duration::from_millis(2700);

/// Logs each request; the value of a variable says which one it is.
#[derive(Default)]
struct Variables(Vec<String>);

impl Handler for Variables {
    fn call(&mut self, _: PeerId, request: &Request<'_>, reply: &mut ReplyValue<'_>, _: Instant) -> Outcome {
        self.0.push(format!("{request:?}"));
        if let Request::Get(variable) = request {
            let index = i32::try_from(variable.index).expect("a small index");
            reply.set(&answer_to(index)).expect("a number fits");
        }
        HResult::S_OK.into()
    }
}

/// A server in memory that is ready for one byte at every other poll.
struct Line {
    session: Session<[u8; 64]>,
    variables: Variables,
    ready: bool,
    pending: VecDeque<u8>,
    limits: Vec<Instant>,
}

impl Line {
    fn poll<T>(&mut self, work: impl FnOnce(&mut Self) -> Option<T>) -> Poll<T> {
        self.ready = !self.ready;
        if self.ready {
            return Poll::Pending;
        }
        work(self).map_or(Poll::Pending, Poll::Ready)
    }

    fn put(&mut self, byte: u8) -> usize {
        self.session.receive_buffer()[0] = byte;
        self.session.received(1);
        while self.session.run(&mut self.variables, PeerId(1), Instant::ZERO).is_some() {
            self.pending.extend(self.session.transmit());
            self.session.transmitted(usize::MAX);
        }
        1
    }
}

impl Transport for Line {
    type Error = Infallible;

    fn now(&self) -> Instant {
        Instant::ZERO
    }

    async fn send(&mut self, bytes: &[u8], until: Instant) -> Result<Option<usize>, Infallible> {
        self.limits.push(until);
        Ok(Some(poll_fn(|_| self.poll(|line| Some(line.put(bytes[0])))).await))
    }

    async fn receive(&mut self, buffer: &mut [u8], until: Instant) -> Result<Option<usize>, Infallible> {
        if until <= self.now() {
            // reads the bytes that arrived before the call, and does not wait
            let byte = poll_fn(|_| self.poll(|line| Some(line.pending.pop_front()))).await;
            return Ok(byte.map(|byte| {
                buffer[0] = byte;
                1
            }));
        }
        self.limits.push(until);
        buffer[0] = poll_fn(|_| self.poll(|line| line.pending.pop_front())).await;
        Ok(Some(1))
    }

    async fn sleep_until(&mut self, _: Instant) {
        poll_fn(|_| self.poll(|_| Some(()))).await;
    }
}

type Robot = RacConnection<Line, [u8; 64]>;

fn robot() -> Robot {
    let session = Session::new(server::Config::TCP, [0; 64]);
    let line =
        Line { session, variables: Variables::default(), ready: false, pending: VecDeque::new(), limits: Vec::new() };
    RacConnection::new(line, Client::new(Config { timeout: TIMEOUT }, [0; 64]))
}

/// Drops a request at every await point; returns how many there are.
fn sweep(work: impl AsyncFn(&mut Robot) -> bool) -> usize {
    for polls in 1.. {
        let mut robot = robot();
        let ended = poll_times(work(&mut robot), polls).is_some();
        let dropped = robot.transport().variables.0.len();
        robot.transport().limits.clear();
        let value = finish(robot.get(Variable::new(VariableKind::I, 7))).map(|value| value.as_i32());
        assert_eq!(value, Ok(Some(answer_to(7))), "after {polls} polls");
        assert_eq!(robot.client().config().timeout, TIMEOUT);
        let line = robot.transport();
        assert!(line.limits.iter().all(|until| *until == Instant::ZERO.saturating_add(TIMEOUT)), "after {polls} polls");
        let log = &line.variables.0;
        // a request that had begun to be sent is executed, once
        assert!(log.len() - dropped <= 2 && log.len() <= 2, "after {polls} polls: {log:?}");
        assert_eq!(log.iter().filter(|call| call.contains("index: 7")).count(), 1, "after {polls} polls: {log:?}");
        if ended {
            return polls - 1;
        }
    }
    unreachable!("the request ends")
}

/// Drops requests at every await point; returns how many each function has.
pub(crate) fn all() -> BTreeMap<&'static str, usize> {
    let variable = Variable::new(VariableKind::F, 3);
    BTreeMap::from([
        ("get", sweep(async |robot| robot.get(variable).await.is_ok())),
        ("put", sweep(async |robot| robot.put(variable, Variant::R4(1.5)).await.is_ok())),
    ])
}
