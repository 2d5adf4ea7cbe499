//! A virtual RC8 on real sockets, motions of its arm, and its states.

use std::time::Duration;

use bcap_sim::{Config, Controller, Profile};
use bcap_std::server::Limits;
use bcap_std::{Joints, Motion, Move};

use crate::served::Served;

/// Returns the configuration of a model whose motor switches on immediately.
#[must_use]
pub fn quick(profile: Profile) -> Config {
    Config { motor_on_delay: Duration::from_millis(1), ..Config::new(profile) }
}

/// Starts a virtual RC8.
#[must_use]
pub fn simulated() -> Served<Controller> {
    Served::of(Controller::new(quick(Profile::Rc8)), Limits::default())
}

/// A motion that turns the first joint.
pub fn to(degrees: f64) -> Move {
    turn(degrees, 0.0)
}

/// A motion that turns the first and the sixth joint.
pub fn turn(first: f64, sixth: f64) -> Move {
    Move::joint(Joints::new([first, 45.0, 90.0, 0.0, 45.0, sixth]))
}

impl Served<Controller> {
    /// Returns the address over TCP.
    #[must_use]
    pub fn address(&self) -> String {
        format!("tcp:{}", self.tcp)
    }

    /// Returns whether the controller is currently in a state.
    pub fn is(&self, state: impl Fn(&Controller) -> bool) -> bool {
        let mut controller = self.application();
        controller.advance(bcap_std::now());
        state(&controller)
    }

    /// Waits until the controller is in a state.
    ///
    /// # Panics
    ///
    /// When that takes longer than a minute.
    pub fn until(&self, state: impl Fn(&Controller) -> bool) {
        let end = bcap_std::now() + Duration::from_secs(60);
        while !self.is(&state) {
            assert!(bcap_std::now() < end, "the controller did not get there");
            std::thread::sleep(Duration::from_millis(1));
        }
    }

    /// Clears the errors of the controller.
    pub fn clear(&self) {
        self.application().clear_errors(bcap_std::now());
    }

    /// Asserts that no client has the arm, a session or an object, and that the motor is off.
    ///
    /// # Panics
    ///
    /// When something is left.
    pub fn assert_left(&self) {
        let sim = self.application();
        assert_eq!((sim.arm_owner(), sim.motor_is_on(), sim.is_moving(), sim.open_objects()), (None, false, false, 0));
    }
}

/// The outcomes of motions that are stopped at random times.
#[derive(Debug, Default)]
pub struct Outcomes {
    arrived: u32,
    halted: u32,
    dropped: u32,
}

impl Outcomes {
    /// Returns the number of trials: `TRIALS`, or 30.
    #[must_use]
    pub fn trials() -> u32 {
        std::env::var("TRIALS").ok().and_then(|n| n.parse().ok()).unwrap_or(30)
    }

    /// Counts the reported end of a motion, `None` for a dropped motion, and clears the errors. `ends` are the angles of the
    /// first and the sixth joint at its destination.
    ///
    /// # Panics
    ///
    /// When the report does not agree with the position of the robot.
    pub fn count(&mut self, sim: &Served<Controller>, ended: Option<Motion>, ends: [f64; 2]) {
        let joints = sim.application().joints();
        let off = (joints[0] - ends[0]).abs().max((joints[5] - ends[1]).abs());
        match ended {
            Some(Motion::Arrived) => {
                assert!(off <= 0.05, "{off} degrees from the end; {self:?}");
                self.arrived += 1;
            }
            Some(Motion::Halted) => {
                // a halt can arrive when the robot is almost there; it leaves its error
                assert!(off > 0.05 || sim.application().errors().count() > 0, "it is there; {self:?}");
                self.halted += 1;
            }
            None => self.dropped += 1,
            Some(other) => panic!("{other:?}; {self:?}"),
        }
        sim.clear();
    }

    /// Asserts that some motions were stopped.
    ///
    /// # Panics
    ///
    /// When all arrived.
    pub fn assert_stopped(&self) {
        println!("{self:?}");
        assert!(self.halted + self.dropped > 0, "no stop came in time");
    }
}
