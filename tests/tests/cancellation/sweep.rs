//! Drops a future at every await point, and checks that the connection is as if nothing had happened.

use std::cell::RefCell;
use std::pin::{Pin, pin};
use std::rc::Rc;
use std::task::{Context, Poll, Waker};
use std::time::Duration;

use bcap_core::bcap::Link;
use bcap_core::bcap::call::{self, ControllerHandle, RobotHandle};
use bcap_core::bcap::client::{Client, Config, Timing};
use bcap_core::hresult::HResult;
use bcap_core::io::CallError;
use bcap_core::io::asynch::Connection;
use bcap_core::procedure::{Handles, Procedure, Provider, open_robot};
use bcap_core::time::Instant;
use bcap_testkit::network::answer_to;

use crate::cancellation::link::{Wire, World};

pub(crate) type Client512 = Connection<Wire, [u8; 512]>;
pub(crate) type Work<'a> = Pin<Box<dyn Future<Output = bool> + 'a>>;

/// Two connections to one controller, each with its robot.
pub(crate) struct Rig {
    pub(crate) motion: Client512,
    pub(crate) watch: Client512,
    pub(crate) handles: Handles,
    pub(crate) watching: Handles,
    pub(crate) world: Rc<RefCell<World>>,
    kind: Link,
}

/// The timing of the clients: none of the defaults.
pub(crate) const fn usual(kind: Link) -> Timing {
    match kind {
        Link::Stream => Timing { attempt_timeout: Duration::from_millis(2900), ..Timing::TCP },
        Link::Datagram | Link::Serial => Timing { attempt_timeout: Duration::from_millis(450), ..Timing::UDP },
    }
}

impl Rig {
    fn new(kind: Link) -> Self {
        let world = World::new();
        let connect = |kind, peer| {
            let config = match kind {
                Link::Stream => Config::TCP,
                Link::Datagram => Config::UDP,
                Link::Serial => Config::SERIAL,
            };
            let client = Client::new(Config { timing: usual(kind), ..config }, [0; 512], [0; 512]);
            Connection::new(Wire::new(kind, peer, &world), client)
        };
        let none = Handles { controller: ControllerHandle(0), robot: RobotHandle(0) };
        let (motion, watch) = (connect(kind, 1), connect(Link::Stream, 2));
        let mut rig = Self { motion, watch, handles: none, watching: none, world: Rc::clone(&world), kind };
        rig.handles = finish(rig.motion.run(open_robot(Provider::RC8, None))).unwrap();
        rig.watching = finish(rig.watch.run(open_robot(Provider::RC8, None))).unwrap();
        rig
    }

    fn executed(&self) -> usize {
        self.world.borrow().log.len()
    }

    /// Waits until the server is idle, and discards the recording of the link; returns the time.
    fn begin_check(&mut self) -> Instant {
        let wire = self.motion.transport();
        wire.settle();
        wire.sent.clear();
        wire.limits.clear();
        self.world.borrow().now
    }

    /// Sends an ordinary call and checks its reply and its timing; on a lossy link, even when its first attempt is lost.
    fn check(&mut self, token: i32, lost: bool) -> Result<(), String> {
        let usual = usual(self.kind);
        let name = format!("token {token}");
        let call = call::controller_connect(&name, "", "", "");
        let mut start = self.begin_check();
        if lost {
            self.motion.transport().deaf_until = start.saturating_add(usual.attempt_timeout);
        }
        let mut reply = finish(self.motion.call(&call));
        if reply == Err(CallError::Refused(HResult::E_BUSY_PROC)) && self.kind == Link::Serial {
            // a request whose rest was still to be sent has only now reached the server, and runs there
            start = self.begin_check();
            reply = finish(self.motion.call(&call));
        }
        if reply != Ok(ControllerHandle(answer_to(token))) {
            return Err(format!("the reply is {reply:?}, not that of token {token}"));
        }
        let second = start.saturating_add(usual.attempt_timeout);
        let wire = self.motion.transport();
        let third = second.saturating_add(usual.attempt_timeout);
        // in a frame on a serial line the next byte has an earlier limit; that it ends no attempt is seen from `sent`
        let in_frame = |limit: &&Instant| self.kind == Link::Serial && **limit < third && **limit != second;
        let (sent, limits): (Vec<_>, Vec<_>) = (
            wire.sent.iter().copied().collect(),
            wire.limits.iter().filter(|limit| !in_frame(limit)).copied().collect(),
        );
        let expected = if lost { (vec![start, second], vec![second, third]) } else { (vec![start], vec![second]) };
        if (&sent, &limits) != (&expected.0, &expected.1) {
            return Err(format!("the timing: sent at {sent:?} with the time limits {limits:?}, not {expected:?}"));
        }
        let timing = self.motion.client().timing();
        if timing == usual { Ok(()) } else { Err(format!("the timing is {timing:?} and not {usual:?}")) }
    }
}

/// An operation of a rig, and its preparation.
pub(crate) struct Sweep {
    pub(crate) name: &'static str,
    pub(crate) kind: Link,
    /// Bytes that the link takes together.
    pub(crate) piece: usize,
    pub(crate) prepare: fn(&mut Rig),
}

impl Sweep {
    /// Drops the operation at every await point; returns how many there are.
    pub(crate) fn run(&self, work: impl for<'a> Fn(&'a mut Rig) -> Work<'a>) -> Result<usize, String> {
        let mut rig = self.rig();
        let before = rig.executed();
        assert!(finish(work(&mut rig)), "{} fails when it is not dropped", self.name);
        let complete = rig.world.borrow().log[before..].to_vec();
        for polls in 1.. {
            let mut rig = self.rig();
            let before = rig.executed();
            let ended = poll_times(work(&mut rig), polls).is_some();
            let fault = self.after_drop(&mut rig, before, &complete);
            fault.map_err(|fault| format!("{} over {:?}, {polls} polls: {fault}", self.name, self.kind))?;
            if ended {
                return Ok(polls - 1);
            }
        }
        unreachable!("the operation ends")
    }

    /// Drops a procedure at every await point and runs it again to its end.
    pub(crate) fn run_again<P: Procedure>(&self, make: impl Fn(&Rig) -> P) -> Result<(), String> {
        for polls in 1.. {
            let mut rig = self.rig();
            let (before, objects) = (rig.executed(), rig.motion.transport().open_objects());
            let mut procedure = make(&rig);
            if poll_times(rig.motion.run(&mut procedure), polls).is_some() {
                return Ok(());
            }
            rig.motion.transport().settle();
            let ended = finish(rig.motion.run(&mut procedure)).is_err();
            let log = rig.world.borrow().log[before..].to_vec();
            let name = self.name;
            for function in ["Service_Start", "Robot_Move", "\"TakeArm\"", "Variable_PutValue"] {
                let count = log.iter().filter(|call| call.contains(function)).count();
                if count > 1 {
                    return Err(format!("{name}, {polls} polls: {function} ran {count} times: {log:?}"));
                }
            }
            // at most the object whose handle was lost is left
            let left = rig.motion.transport().open_objects();
            if ended && left > objects + 1 {
                return Err(format!("{name}, {polls} polls: {left} objects instead of {objects}: {log:?}"));
            }
            rig.check(1, false).map_err(|fault| format!("{name}, {polls} polls, run again: {fault}"))?;
        }
        unreachable!("the procedure ends")
    }

    fn rig(&self) -> Rig {
        let mut rig = Rig::new(self.kind);
        (self.prepare)(&mut rig);
        for connection in [&mut rig.motion, &mut rig.watch] {
            connection.transport().piece = self.piece;
        }
        rig
    }

    fn after_drop(&self, rig: &mut Rig, before: usize, complete: &[String]) -> Result<(), String> {
        rig.check(1, false)?;
        let mut tokens = vec![1];
        if self.kind.is_lossy() {
            rig.check(2, true)?;
            tokens.push(2);
        }
        let log = rig.world.borrow().log[before..].to_vec();
        let tokens: Vec<String> = tokens
            .into_iter()
            .map(|token| format!("Controller_Connect(\"token {token}\", \"\", \"\", \"\")"))
            .collect();
        let dropped = log.len().saturating_sub(tokens.len());
        if log[..dropped] != complete[..dropped.min(complete.len())] || log[dropped..] != tokens {
            return Err(format!("executed {log:?}\nof {complete:?}"));
        }
        Ok(())
    }
}

/// Polls a future `times` times, and returns its output if it ended.
pub(crate) fn poll_times<T>(future: impl Future<Output = T>, times: usize) -> Option<T> {
    let mut future = pin!(future);
    let mut context = Context::from_waker(Waker::noop());
    (0..times).find_map(|_| match future.as_mut().poll(&mut context) {
        Poll::Ready(output) => Some(output),
        Poll::Pending => None,
    })
}

/// Polls a future to its end.
pub(crate) fn finish<T>(future: impl Future<Output = T>) -> T {
    poll_times(future, 1_000_000).expect("the future ends")
}
