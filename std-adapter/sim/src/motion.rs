//! A motion: a path of the axes, and the position on it at a time.
//!
//! ```text
//!  speed along      ____________            a path runs from 0 to 1, through knots of axes;
//!  the path        /            \           speed and acceleration are the highest at which each axis
//!                 /              \          (on a line, also the flange) keeps its limit
//!              __/                \__> t
//! ```
//!
//! The axes move together and arrive together. Halt and Hold brake along the path, at full deceleration. How one motion
//! follows another is in `queue`.

use std::time::Duration;

use bcap_core::handler::PeerId;
use bcap_core::time::Instant;

pub use crate::kinematics::ACCELERATION_TIME;
use crate::kinematics::{Axes, Frame, Geometry, six};
use crate::options::Pass;
use crate::path::Path;
pub use crate::path::{LINE_SPEED, TURN_SPEED};
use crate::route::Route;

/// The rounding of a sum of positions, in degrees or mm.
const ROUNDING: f64 = 1e-9;

/// Speed, acceleration and deceleration, each as a part of its full value, 0 to 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Rates {
    pub(crate) speed: f64,
    pub(crate) accel: f64,
    pub(crate) decel: f64,
}

/// Up to three spans of constant acceleration.
#[derive(Clone, Copy, Debug)]
struct Ramp {
    begin: Instant,
    place: f64,
    speed: f64,
    /// Seconds, and acceleration.
    spans: [(f64, f64); 3],
}

impl Ramp {
    /// Plans a motion from a place and a speed to rest at 1.
    fn run(begin: Instant, place: f64, speed: f64, top: f64, accel: f64, decel: f64) -> Self {
        let distance = (1.0 - place).max(0.0);
        // the speed at which acceleration ends and braking begins, without regard to `top`
        let peak = ((2.0 * accel * decel * distance + decel * speed * speed) / (accel + decel)).sqrt();
        let cruise = peak.min(top).max(speed);
        let speeding = (cruise - speed) / accel;
        let braking = cruise / decel;
        let covered = (speed + cruise) / 2.0 * speeding + cruise / 2.0 * braking;
        let cruising = if cruise > 0.0 { ((distance - covered) / cruise).max(0.0) } else { 0.0 };
        Self { begin, place, speed, spans: [(speeding, accel), (cruising, 0.0), (braking, -decel)] }
    }

    /// Plans to brake to rest.
    fn brake(begin: Instant, place: f64, speed: f64, decel: f64) -> Self {
        Self { begin, place, speed, spans: [(speed / decel, -decel), (0.0, 0.0), (0.0, 0.0)] }
    }

    /// Rests at the beginning of a path; a path without length has only its end.
    fn still(begin: Instant, path: &Path) -> Self {
        let place = if path.full_speed.is_finite() { 0.0 } else { 1.0 };
        Self { begin, place, speed: 0.0, spans: [(0.0, 0.0); 3] }
    }

    /// Returns when the last span begins.
    fn braking(&self) -> Instant {
        let [(up, _), (even, _), _] = self.spans;
        self.begin.saturating_add(Duration::from_micros(((up + even) * 1e6).ceil() as u64))
    }

    fn end(&self) -> Instant {
        let seconds: f64 = self.spans.iter().map(|(seconds, _)| seconds).sum();
        // rounded up, so that the motion is complete at its end
        self.begin.saturating_add(Duration::from_micros((seconds * 1e6).ceil() as u64))
    }

    /// Returns place and speed.
    fn at(&self, now: Instant) -> (f64, f64) {
        let mut left = now.saturating_since(self.begin).as_secs_f64();
        let (mut place, mut speed) = (self.place, self.speed);
        for (seconds, accel) in self.spans {
            let time = left.min(seconds);
            place += speed * time + accel * time * time / 2.0;
            speed = (speed + accel * time).max(0.0);
            left -= time;
        }
        (place.clamp(0.0, 1.0), speed)
    }
}

/// A motion.
#[derive(Clone, Debug)]
pub(crate) struct Motion {
    /// Its number, which no other motion has.
    pub(crate) id: u64,
    /// The client that commanded it.
    pub(crate) peer: PeerId,
    /// The command and its tool, from which the path can be planned again; `None` for a motion that only brakes.
    pub(crate) route: Option<(Route, Frame)>,
    pub(crate) pass: Pass,
    /// See [`pass_time`](Self::pass_time).
    pass_time: Instant,
    path: Path,
    rates: Rates,
    ramp: Ramp,
}

impl Motion {
    /// Creates a motion at rest at the beginning of its path.
    pub(crate) fn new(id: u64, peer: PeerId, path: Path, rates: Rates, now: Instant) -> Self {
        let ramp = Ramp::still(now, &path);
        Self { id, peer, route: None, pass: Pass::Stop, pass_time: now, path, rates, ramp }
    }

    /// Starts at the full speed of a [braking](Path::braking) path, and comes to rest at its end.
    pub(crate) fn braking(id: u64, peer: PeerId, path: Path, now: Instant) -> Self {
        let speed = path.full_speed;
        let rates = Rates { speed: 1.0, accel: 1.0, decel: 1.0 };
        // the path has length 1, so speed² = 2 decel
        Self { ramp: Ramp::brake(now, 0.0, speed, speed * speed / 2.0), ..Self::new(id, peer, path, rates, now) }
    }

    /// Replaces the path by one from another position, at rest at its beginning.
    pub(crate) fn replace(&mut self, path: Path, now: Instant) {
        self.ramp = Ramp::still(now, &path);
        self.path = path;
    }

    pub(crate) fn axes(&self, now: Instant) -> Axes {
        self.path.at(self.ramp.at(now).0)
    }

    /// Returns the distance of each axis from the beginning of the path.
    pub(crate) fn progress(&self, now: Instant) -> Axes {
        let (here, start) = (self.axes(now), self.path.start());
        [0, 1, 2, 3, 4, 5, 6, 7].map(|i| here[i] - start[i])
    }

    /// Returns the part of its path that it has covered, 0 to 1.
    pub(crate) fn covered(&self, now: Instant) -> f64 {
        self.ramp.at(now).0
    }

    /// Returns when it has covered a part of its path; if it comes to rest before, that time.
    pub(crate) fn time_of(&self, part: f64) -> Instant {
        let (mut before, mut after) = (self.ramp.begin.as_micros(), self.end().as_micros());
        while before + 1 < after {
            let middle = before.midpoint(after);
            if self.covered(Instant::from_micros(middle)) < part { before = middle } else { after = middle }
        }
        Instant::from_micros(after)
    }

    /// Returns the arm that it moves.
    pub(crate) fn arm(&self) -> &Geometry {
        &self.path.arm
    }

    pub(crate) fn destination(&self) -> Axes {
        self.path.end()
    }

    /// Returns when it comes to rest.
    pub(crate) fn end(&self) -> Instant {
        self.ramp.end()
    }

    /// Plans to move to the end of the path, from rest or from the current speed.
    pub(crate) fn run(&mut self, now: Instant) {
        let (place, speed) = self.ramp.at(now);
        let full = self.path.full_speed;
        if full.is_finite() {
            let accel = self.path.full_accel;
            let Rates { speed: top, accel: up, decel: down } = self.rates;
            self.ramp = Ramp::run(now, place, speed, (full * top).min(self.path.bend_speed), accel * up, accel * down);
        }
        self.pass_time = self.plan_pass();
    }

    /// Brakes to rest: at full deceleration, or at the deceleration of the motion.
    pub(crate) fn brake(&mut self, now: Instant, gently: bool) {
        let (place, speed) = self.ramp.at(now);
        let decel = if gently { self.path.full_accel * self.rates.decel } else { self.path.full_accel };
        if decel.is_finite() {
            self.ramp = Ramp::brake(now, place, speed, decel);
        }
    }

    /// Returns when a pass motion is near enough to its end for the next motion to begin; otherwise its end.
    pub(crate) fn pass_time(&self) -> Instant {
        self.pass_time
    }

    fn plan_pass(&self) -> Instant {
        let braking = self.ramp.braking();
        match self.pass {
            Pass::Stop => self.end(),
            Pass::Near(None) => braking,
            Pass::Near(Some(distance)) => {
                let place = |axes: &Axes| self.path.arm.forward(&six(axes));
                let end = place(&self.destination());
                let far = |at: u64| place(&self.axes(Instant::from_micros(at))).distance(&end).0 > distance;
                // bisection, because the distance of the flange decreases while the motion brakes
                let (mut before, mut after) = (braking.as_micros(), self.end().as_micros());
                while far(before) && before + 1 < after {
                    let middle = before.midpoint(after);
                    if far(middle) { before = middle } else { after = middle }
                }
                Instant::from_micros(if far(before) { after } else { before })
            }
        }
    }

    /// Returns when the next motion, which is at rest, begins to move: at the end of this one, or earlier after a pass.
    ///
    /// While both move, no axis exceeds its speed: each motion's speed is a part of its path's full speed, at which each axis
    /// keeps its limit, and the sum of both parts stays within the greater of both rates. No axis leaves its range either.
    pub(crate) fn handover(&self, next: &Self, now: Instant) -> Instant {
        let end = self.end();
        let pass = self.pass_time().max(now);
        let top = self.rates.speed.max(next.rates.speed);
        let rise = next.path.full_speed * top / (next.path.full_accel * next.rates.accel);
        let mut overlap = end.saturating_since(pass).as_secs_f64().min(rise);
        for _ in 0..8 {
            let begin = Instant::from_micros(end.as_micros().saturating_sub((overlap * 1e6) as u64));
            if self.fits(next, begin) {
                return begin.max(now);
            }
            overlap /= 2.0;
        }
        end
    }

    /// Returns whether all axes stay in their ranges if the next motion begins at this time.
    fn fits(&self, next: &Self, begin: Instant) -> bool {
        let time = self.end().saturating_since(begin).as_secs_f64();
        let (from, _) = next.ramp.at(begin);
        let rise = next.path.full_accel * next.rates.accel * time * time / 2.0;
        let to = if rise.is_finite() { (from + rise).min(1.0) } else { 1.0 };
        let (here, there) = (self.path.bounds(self.ramp.at(begin).0, 1.0), next.path.bounds(from, to));
        let start = next.path.start();
        (0..8).all(|i| {
            let ((low, high), offset) = (self.path.arm.ranges[i], start[i]);
            here[i].0 + there[i].0 - offset >= low - ROUNDING && here[i].1 + there[i].1 - offset <= high + ROUNDING
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kinematics::SPEEDS;

    const FULL: Rates = Rates { speed: 1.0, accel: 1.0, decel: 1.0 };

    fn turn_of_j1(degrees: f64, rates: Rates) -> Motion {
        let path = Path::axes(&Geometry::DEFAULT, [0.0; 8], [degrees, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
        let mut motion = Motion::new(1, PeerId(1), path, rates, Instant::ZERO);
        motion.run(Instant::ZERO);
        motion
    }

    fn seconds(motion: &Motion) -> f64 {
        motion.end().as_micros() as f64 / 1e6
    }

    #[test]
    fn a_long_motion_takes_distance_by_speed_and_one_ramp() {
        let motion = turn_of_j1(150.0, FULL);
        assert!((seconds(&motion) - (150.0 / SPEEDS[0] + ACCELERATION_TIME)).abs() < 1e-5);
        let half = turn_of_j1(150.0, Rates { speed: 0.5, ..FULL });
        assert!((seconds(&half) - (150.0 / SPEEDS[0] * 2.0 + ACCELERATION_TIME / 2.0)).abs() < 1e-5);
        assert_eq!(motion.axes(motion.end())[0], 150.0);
    }

    #[test]
    fn a_short_motion_never_reaches_its_speed() {
        let motion = turn_of_j1(1.0, FULL);
        // up and down at 375/0.2 degrees per second squared
        let expected = 2.0 * (1.0 / (SPEEDS[0] / ACCELERATION_TIME)).sqrt();
        assert!((seconds(&motion) - expected).abs() < 1e-5, "{}", seconds(&motion));
        let middle = motion.axes(Instant::from_micros((expected * 5e5) as u64))[0];
        assert!((middle - 0.5).abs() < 1e-3);
    }

    #[test]
    fn the_axis_moves_forward_and_within_its_limit() {
        let motion = turn_of_j1(150.0, FULL);
        let places: Vec<f64> = (0..600).map(|n| motion.axes(Instant::from_millis(n))[0]).collect();
        for pair in places.windows(2) {
            assert!(pair[1] >= pair[0] && pair[1] - pair[0] <= SPEEDS[0] / 1000.0 + 1e-9);
        }
    }

    #[test]
    fn it_brakes_and_continues() {
        let mut motion = turn_of_j1(150.0, FULL);
        let at = Instant::from_millis(300);
        let before = motion.axes(at)[0];
        motion.brake(at, false);
        let held = motion.axes(Instant::from_millis(10_000))[0];
        // braking from full speed takes half of speed times the ramp's time
        assert!((held - before - SPEEDS[0] * ACCELERATION_TIME / 2.0).abs() < 1e-6, "{before} {held}");
        motion.run(Instant::from_millis(10_000));
        assert_eq!(motion.axes(motion.end())[0], 150.0);
    }

    #[test]
    fn a_slow_motion_brakes_as_soon_as_a_fast_one() {
        let mut motion = turn_of_j1(150.0, Rates { speed: 0.5, accel: 0.5, decel: 0.001 });
        let at = Instant::from_millis(500);
        motion.brake(at, false);
        let braking = motion.end().saturating_since(at);
        assert!(braking.as_secs_f64() <= ACCELERATION_TIME / 2.0 + 1e-6, "{braking:?}");
        // run again in the middle of braking, it still arrives
        motion.run(Instant::from_millis(505));
        assert_eq!(motion.axes(motion.end())[0], 150.0);
    }

    #[test]
    fn a_path_without_length_takes_no_time() {
        let mut motion = turn_of_j1(0.0, FULL);
        assert_eq!(motion.end(), Instant::ZERO);
        motion.brake(Instant::ZERO, false);
        motion.run(Instant::ZERO);
        assert_eq!(motion.end(), Instant::ZERO);
    }
}
