//! A motion: a path of the axes, and the position on it at a time.
//!
//! ```text
//!  speed along      ____________            a path runs from 0 to 1, through knots of axes;
//!  the path        /            \           speed and acceleration are the highest at which each axis
//!                 /              \          (on a line, also the flange) keeps its limit
//!              __/                \__> t
//! ```
//!
//! The axes move together and arrive together. Halt and Hold brake along the path, at full deceleration.

use std::time::Duration;

use bcap_core::handler::PeerId;
use bcap_core::time::Instant;

use crate::kinematics::{AXIS_RANGES, AXIS_SPEEDS, Axes, Frame, OutOfReach, inverse_nearest, six, with_joints};

/// The largest speed of the flange on a line, in mm per second.
pub const LINE_SPEED: f64 = 2000.0;

/// The largest turning speed of the flange on a line, in degrees per second.
pub const TURN_SPEED: f64 = 360.0;

/// The time in which a motion at full acceleration reaches its full speed, in seconds.
pub const ACCELERATION_TIME: f64 = 0.2;

/// The number of parts in which a line is planned.
const LINE_PARTS: usize = 100;

/// The largest turn of a joint in one part of a line, in degrees; a larger one means a singularity.
const LARGEST_STEP: f64 = 30.0;

/// Positions of the axes, which a motion passes evenly.
#[derive(Clone, Debug)]
pub(crate) struct Path {
    /// At least two.
    knots: Vec<Axes>,
    /// The highest speed within all limits, in paths per second.
    full_speed: f64,
}

impl Path {
    /// Plans a motion in which every axis moves evenly.
    pub(crate) fn axes(from: Axes, to: Axes) -> Self {
        Self { full_speed: axis_limit(&from, &to, 1.0), knots: vec![from, to] }
    }

    /// Plans a motion of the flange on a straight line, while J7 and J8 move evenly to those of `end`.
    pub(crate) fn line(start: Axes, from: &Frame, to: &Frame, end: &Axes) -> Result<Self, OutOfReach> {
        let (distance, angle) = from.distance(to);
        let mut full_speed = (LINE_SPEED / distance).min(TURN_SPEED / angle);
        let mut knots = vec![start];
        let mut here = start;
        for n in 1..=LINE_PARTS {
            let part = n as f64 / LINE_PARTS as f64;
            let joints = inverse_nearest(&from.towards(to, part), &six(&here))?;
            let next = with_joints(&joints, &between(&start, end, part));
            if let Some(axis) = here.iter().zip(&next).take(6).position(|(a, b)| (a - b).abs() > LARGEST_STEP) {
                return Err(OutOfReach(u8::try_from(axis + 1).unwrap_or(0)));
            }
            full_speed = full_speed.min(axis_limit(&here, &next, LINE_PARTS as f64));
            knots.push(next);
            here = next;
        }
        Ok(Self { knots, full_speed })
    }

    /// Plans the path on which axes at these speeds come to rest together, within their limits of acceleration.
    ///
    /// `None` for axes at rest. An axis that would leave its range stops at the end of the range, so it brakes harder.
    pub(crate) fn braking(from: Axes, speeds: &Axes, limits: &Axes) -> Option<Self> {
        let seconds = speeds.iter().zip(limits).map(|(speed, limit)| speed.abs() / limit).fold(0.0, f64::max);
        let to = [0, 1, 2, 3, 4, 5, 6, 7].map(|i| {
            let (low, high) = AXIS_RANGES[i];
            // through rounding, an axis may be slightly beyond its range
            (from[i] + speeds[i] * seconds / 2.0).clamp(low.min(from[i]), high.max(from[i]))
        });
        (seconds > 1e-6).then(|| Self { knots: vec![from, to], full_speed: 2.0 / seconds })
    }

    /// Returns the position of the axes at its end.
    pub(crate) fn end(&self) -> Axes {
        self.knots.last().copied().unwrap_or_default()
    }

    fn at(&self, part: f64) -> Axes {
        let place = part.clamp(0.0, 1.0) * (self.knots.len() - 1) as f64;
        let before = (place as usize).min(self.knots.len() - 2);
        let (a, b, rest) = (&self.knots[before], &self.knots[before + 1], place - before as f64);
        if rest >= 1.0 { *b } else { between(a, b, rest) }
    }
}

/// Interpolates between two positions of the axes; `part` is 0 to 1.
fn between(a: &Axes, b: &Axes, part: f64) -> Axes {
    [0, 1, 2, 3, 4, 5, 6, 7].map(|i| a[i] + (b[i] - a[i]) * part)
}

/// Returns the speed at which the first axis reaches its limit, in paths per second.
fn axis_limit(from: &Axes, to: &Axes, parts: f64) -> f64 {
    let limits = from.iter().zip(to).zip(&AXIS_SPEEDS).map(|((a, b), speed)| speed / ((a - b).abs() * parts));
    limits.fold(f64::INFINITY, f64::min)
}

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

/// The stage of a motion.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Stage {
    Running,
    /// Braking for Hold, or at rest until Unhold.
    Holding,
    /// Braking for Halt.
    Halting,
}

/// A motion.
#[derive(Clone, Debug)]
pub(crate) struct Motion {
    /// Its number, which no other motion has.
    pub(crate) id: u64,
    /// The client that commanded it.
    pub(crate) peer: PeerId,
    path: Path,
    rates: Rates,
    ramp: Ramp,
    stage: Stage,
}

/// How a motion has ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Ended {
    Arrived,
    Halted,
}

impl Motion {
    pub(crate) fn start(id: u64, peer: PeerId, path: Path, rates: Rates, now: Instant) -> Self {
        // the end of a path without length
        let place = if path.full_speed.is_finite() { 0.0 } else { 1.0 };
        let mut motion = Self {
            id,
            peer,
            path,
            rates,
            ramp: Ramp { begin: now, place, speed: 0.0, spans: [(0.0, 0.0); 3] },
            stage: Stage::Running,
        };
        motion.run(now);
        motion
    }

    /// Starts at the full speed of a [braking](Path::braking) path, and comes to rest at its end.
    pub(crate) fn braking(id: u64, peer: PeerId, path: Path, now: Instant) -> Self {
        let speed = path.full_speed;
        // the path has length 1, so speed² = 2 decel
        let ramp = Ramp::brake(now, 0.0, speed, speed * speed / 2.0);
        let rates = Rates { speed: 1.0, accel: 1.0, decel: 1.0 };
        Self { id, peer, path, rates, ramp, stage: Stage::Halting }
    }

    pub(crate) fn axes(&self, now: Instant) -> Axes {
        self.path.at(self.ramp.at(now).0)
    }

    pub(crate) fn destination(&self) -> Axes {
        self.path.end()
    }

    /// Returns when it will end; `None` while it is held.
    pub(crate) fn end(&self) -> Option<Instant> {
        (self.stage != Stage::Holding).then(|| self.ramp.end())
    }

    /// Tells whether it has ended, and how.
    pub(crate) fn ended(&self, now: Instant) -> Option<Ended> {
        if now < self.end()? {
            return None;
        }
        Some(if self.stage == Stage::Halting { Ended::Halted } else { Ended::Arrived })
    }

    pub(crate) fn halt(&mut self, now: Instant) {
        if self.stage != Stage::Halting {
            self.brake(now, Stage::Halting);
        }
    }

    /// Tells whether it brakes to its end.
    pub(crate) fn is_halting(&self) -> bool {
        self.stage == Stage::Halting
    }

    /// Brakes until [`unhold`](Self::unhold); `false` if it is braking already.
    pub(crate) fn hold(&mut self, now: Instant) -> bool {
        let running = self.stage == Stage::Running;
        if running {
            self.brake(now, Stage::Holding);
        }
        running
    }

    /// Continues; `false` if it is not held.
    pub(crate) fn unhold(&mut self, now: Instant) -> bool {
        let held = self.stage == Stage::Holding;
        if held {
            self.stage = Stage::Running;
            self.run(now);
        }
        held
    }

    fn run(&mut self, now: Instant) {
        let (place, speed) = self.ramp.at(now);
        let full = self.path.full_speed;
        if full.is_finite() {
            let accel = full / ACCELERATION_TIME;
            let Rates { speed: top, accel: up, decel: down } = self.rates;
            self.ramp = Ramp::run(now, place, speed, full * top, accel * up, accel * down);
        }
    }

    fn brake(&mut self, now: Instant, stage: Stage) {
        let (place, speed) = self.ramp.at(now);
        // at full deceleration, whatever the deceleration of the motion
        let decel = self.path.full_speed / ACCELERATION_TIME;
        self.stage = stage;
        if decel.is_finite() {
            self.ramp = Ramp::brake(now, place, speed, decel);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kinematics::SPEEDS;

    const FULL: Rates = Rates { speed: 1.0, accel: 1.0, decel: 1.0 };

    fn turn_of_j1(degrees: f64, rates: Rates) -> Motion {
        let path = Path::axes([0.0; 8], [degrees, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
        Motion::start(1, PeerId(1), path, rates, Instant::ZERO)
    }

    fn seconds(motion: &Motion) -> f64 {
        motion.end().unwrap().as_micros() as f64 / 1e6
    }

    #[test]
    fn a_long_motion_takes_distance_by_speed_and_one_ramp() {
        let motion = turn_of_j1(150.0, FULL);
        assert!((seconds(&motion) - (150.0 / SPEEDS[0] + ACCELERATION_TIME)).abs() < 1e-5);
        let half = turn_of_j1(150.0, Rates { speed: 0.5, ..FULL });
        assert!((seconds(&half) - (150.0 / SPEEDS[0] * 2.0 + ACCELERATION_TIME / 2.0)).abs() < 1e-5);
        assert_eq!(motion.axes(motion.end().unwrap())[0], 150.0);
        assert_eq!(motion.ended(motion.end().unwrap()), Some(Ended::Arrived));
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
    fn halt_brakes_and_unhold_continues() {
        let mut motion = turn_of_j1(150.0, FULL);
        let at = Instant::from_millis(300);
        let before = motion.axes(at)[0];
        assert!(motion.hold(at) && !motion.hold(at));
        assert_eq!(motion.end(), None);
        let held = motion.axes(Instant::from_millis(10_000))[0];
        // braking from full speed takes half of speed times the ramp's time
        assert!((held - before - SPEEDS[0] * ACCELERATION_TIME / 2.0).abs() < 1e-6, "{before} {held}");
        assert!(motion.unhold(Instant::from_millis(10_000)) && !motion.unhold(at));
        assert_eq!(motion.axes(motion.end().unwrap())[0], 150.0);
        motion.halt(Instant::from_millis(10_001));
        let end = motion.end().unwrap();
        assert_eq!(motion.ended(end), Some(Ended::Halted));
        assert!(motion.axes(end)[0] < held + 1.0);
    }

    #[test]
    fn a_slow_motion_halts_as_soon_as_a_fast_one() {
        let slow = Rates { speed: 0.5, accel: 0.5, decel: 0.001 };
        let mut motion = turn_of_j1(150.0, slow);
        let at = Instant::from_millis(500);
        motion.halt(at);
        let braking = motion.end().unwrap().saturating_since(at);
        assert!(braking.as_secs_f64() <= ACCELERATION_TIME / 2.0 + 1e-6, "{braking:?}");
        // held and let go in the middle of braking, it still arrives
        let mut motion = turn_of_j1(150.0, slow);
        motion.hold(at);
        motion.unhold(Instant::from_millis(505));
        assert_eq!(motion.axes(motion.end().unwrap())[0], 150.0);
    }

    #[test]
    fn a_path_without_length_takes_no_time() {
        let mut motion = turn_of_j1(0.0, FULL);
        assert_eq!(motion.ended(Instant::ZERO), Some(Ended::Arrived));
        motion.hold(Instant::ZERO);
        motion.unhold(Instant::ZERO);
        assert_eq!(motion.ended(Instant::ZERO), Some(Ended::Arrived));
    }
}
