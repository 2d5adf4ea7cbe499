//! The virtual controller of a trial, which records the truth: the end of each motion, and the event that stopped it.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::time::Duration;

use bcap_core::bcap::FunctionId;
use bcap_core::bcap::server::{Handler, Request};
use bcap_core::handler::{Outcome, PeerId, ReplyValue};
use bcap_core::rac;
use bcap_core::time::Instant;
use bcap_sim::Controller;
use bcap_std::now;

/// Maximum distance of an axis from a destination, in degrees or mm.
const TOLERANCE: f64 = 0.06;

/// Commands of Robot_Execute that move the robot.
const COMMANDS: [&str; 5] = ["DriveEx", "DriveAEx", "Approach", "Depart", "RotateH"];

/// The events so far, readable without the controller.
#[derive(Debug, Default)]
pub(super) struct Marks {
    /// A motion was accepted, or Slave Mode was entered.
    pub(super) motion: AtomicBool,
    /// Motions that a Robot_Halt, an error or the emergency stop has stopped.
    pub(super) stops: AtomicU32,
}

/// A virtual controller with the truth about its motions.
#[derive(Debug)]
pub(super) struct Watched {
    /// The controller.
    pub(super) sim: Controller,
    /// Where the last commanded motion ends.
    pub(super) destination: Option<[f64; 8]>,
    marks: Arc<Marks>,
}

/// The state of a controller at one time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Truth {
    /// Whether the robot is at the destination of the last commanded motion; `false` if there was no motion.
    pub(super) there: bool,
    /// Whether it moves.
    pub(super) moving: bool,
    /// Whether the motor is on.
    pub(super) motor: bool,
    /// Whether the arm is taken, or Slave Mode is on.
    pub(super) arm: bool,
    /// Number of motions that were stopped by a halt or an error.
    pub(super) stops: u32,
}

impl Watched {
    /// Watches a controller.
    #[must_use]
    pub(super) fn new(sim: Controller) -> Self {
        Self { sim, destination: None, marks: Arc::default() }
    }

    /// Returns the events so far.
    #[must_use]
    pub(super) fn marks(&self) -> Arc<Marks> {
        Arc::clone(&self.marks)
    }

    /// Returns the current state.
    pub(super) fn truth(&mut self) -> Truth {
        self.sim.advance(now());
        let axes = self.sim.axes();
        let there = |end: [f64; 8]| end.iter().zip(axes).all(|(end, axis)| (end - axis).abs() <= TOLERANCE);
        Truth {
            there: self.destination.is_some_and(there),
            moving: self.sim.is_moving(),
            motor: self.sim.motor_is_on(),
            arm: self.sim.arm_owner().is_some() || self.sim.slave_mode() != 0,
            stops: self.marks.stops.load(Ordering::SeqCst),
        }
    }

    /// Records that something stops the robot, if it moves.
    pub(super) fn stop(&self) {
        if self.sim.is_moving() || self.sim.slave_mode() != 0 {
            self.marks.stops.fetch_add(1, Ordering::SeqCst);
        }
    }

    /// Records the end of the motion that was just accepted: the position of a copy of the controller after it.
    fn accepted(&mut self, at: Instant) {
        let mut later = self.sim.clone();
        later.advance(at.saturating_add(Duration::from_secs(600)));
        self.destination = Some(later.axes());
        self.marks.motion.store(true, Ordering::SeqCst);
    }
}

/// Returns whether a request starts a motion.
fn moves(request: &Request<'_>) -> bool {
    match request.function {
        FunctionId::ROBOT_MOVE | FunctionId::ROBOT_ROTATE | FunctionId::ROBOT_DRIVE | FunctionId::ROBOT_GO_HOME => true,
        FunctionId::ROBOT_EXECUTE => COMMANDS.iter().any(|name| request.text(1).eq_ignore_ascii_case(name)),
        _ => false,
    }
}

impl Handler for Watched {
    fn call(&mut self, peer: PeerId, request: &Request<'_>, reply: &mut ReplyValue<'_>, at: Instant) -> Outcome {
        self.sim.advance(at);
        if request.function == FunctionId::ROBOT_HALT {
            self.stop();
        }
        let streams = self.sim.slave_mode() != 0;
        let outcome = Handler::call(&mut self.sim, peer, request, reply, at);
        // a call whose answer is delayed is executed immediately
        if moves(request) && !matches!(outcome, Outcome::Done(code) if code.is_err()) {
            self.accepted(at);
        }
        if !streams && self.sim.slave_mode() != 0 {
            self.marks.motion.store(true, Ordering::SeqCst);
        }
        outcome
    }

    fn resume(&mut self, peer: PeerId, request: &Request<'_>, reply: &mut ReplyValue<'_>, at: Instant) -> Outcome {
        Handler::resume(&mut self.sim, peer, request, reply, at)
    }

    fn abandoned(&mut self, peer: PeerId, at: Instant) {
        Handler::abandoned(&mut self.sim, peer, at);
    }

    fn left(&mut self, peer: PeerId, at: Instant) {
        self.sim.advance(at);
        if self.sim.arm_owner() == Some(peer) {
            self.stop();
        }
        Handler::left(&mut self.sim, peer, at);
    }
}

impl rac::server::Handler for Watched {
    fn call(&mut self, peer: PeerId, request: &rac::Request<'_>, reply: &mut ReplyValue<'_>, at: Instant) -> Outcome {
        rac::server::Handler::call(&mut self.sim, peer, request, reply, at)
    }
}
