//! Jogging: a robot moves by short steps while a person holds a button.
//!
//! ```text
//!  page thread:  Grip ─────── beat ── press ── beat ── beat ── lift ── beat ── end, or no beat for LAPSE
//!                                 │                        │                   │
//!  jog thread:   TakeArm, Motor ──┴─ step ── step ── step ─┴─ (wait) ──────────┴─ Robot_Halt, Motor off, GiveArm
//! ```
//!
//! Each step is a whole relative motion with an end, so that a program that is lost never leaves an endless motion. When a
//! button is lifted, the running step is not halted, because a halt leaves an error on a real controller; after [`REST`] it is
//! halted anyway.

use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use bcap_core::bcap::StreamState;
use bcap_std::blocking::{Arm, Controller, Moving};
use bcap_std::{Error, Motion};

use crate::axis::Axis;
use crate::link::{Access, Link};

/// The maximum time from one heartbeat to the next.
pub const LAPSE: Duration = Duration::from_millis(120);

/// The maximum time for a step after its button was lifted.
pub const REST: Duration = Duration::from_millis(200);

/// The maximum time without a step, after which the arm is given back.
pub const IDLE: Duration = Duration::from_secs(60);

/// The maximum step, in mm or degrees.
pub const LONGEST: f64 = 5.0;

/// The maximum speed, in percent of the arm's speed setting.
pub const FASTEST: f64 = 10.0;

/// The maximum speed of the tool centre point, in mm/s.
pub const FASTEST_MM: f64 = 250.0;

/// The maximum duration of a step. At 0.1 % of the speed a step of 5 degrees takes this time.
const STEP_LIMIT: Duration = Duration::from_secs(20);

/// The interval at which a moving robot is polled.
const LOOK: Duration = Duration::from_millis(5);

/// The step that a held button repeats.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Press {
    axis: Axis,
    by: f64,
    percent: f64,
}

impl Press {
    /// Checks a step: at most [`LONGEST`], at most [`FASTEST`] percent.
    ///
    /// # Errors
    ///
    /// A text that names the refused value and the accepted range.
    pub fn new(axis: Axis, by: f64, percent: f64) -> Result<Self, String> {
        if !(by.is_finite() && by != 0.0 && by.abs() <= LONGEST) {
            return Err(format!("{by}: a step is at most {LONGEST} mm or degrees, and not 0"));
        }
        if !(percent > 0.0 && percent <= FASTEST) {
            return Err(format!("{percent} %: the speed is above 0 and at most {FASTEST} %"));
        }
        Ok(Self { axis, by, percent })
    }
}

/// The activity of the jog thread.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Phase {
    /// It takes the arm, and switches the motor on.
    #[default]
    Starting,
    /// It waits for a button.
    Ready,
    /// The robot moves, or a step is about to be sent.
    Moving,
    /// The robot rests. The motor goes off, and the arm is given back.
    Ending,
    /// It has ended. [`Grip::outcome`] has the result.
    Ended,
}

/// The state of one jog, shared by the page and the jog thread. It cannot be restarted.
#[derive(Debug)]
pub struct Grip {
    state: Mutex<GripState>,
    changed: Condvar,
}

#[derive(Debug)]
struct GripState {
    beat: Instant,
    press: Option<Press>,
    /// When the last button was pressed or lifted.
    touched: Instant,
    /// Why it ends.
    end: Option<String>,
    phase: Phase,
    steps: u32,
    outcome: Option<Result<&'static str, String>>,
}

impl Default for Grip {
    /// A grip with a first heartbeat.
    fn default() -> Self {
        let now = Instant::now();
        let (phase, end, outcome) = Default::default();
        let state = GripState { beat: now, press: None, touched: now, end, phase, steps: 0, outcome };
        Self { state: Mutex::new(state), changed: Condvar::new() }
    }
}

impl Grip {
    fn lock(&self) -> MutexGuard<'_, GripState> {
        // after a panic of another thread the jog can only end
        let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        if state.end.is_none() && state.phase != Phase::Ended {
            let now = Instant::now();
            if now.saturating_duration_since(state.beat) > LAPSE {
                state.end = Some("the heartbeat of the page was lost".into());
            } else if state.press.is_none() && now.saturating_duration_since(state.touched) > IDLE {
                state.end = Some(format!("no button was pressed for {} s", IDLE.as_secs()));
            }
        }
        state
    }

    fn change(&self, change: impl FnOnce(&mut GripState)) {
        change(&mut self.lock());
        self.changed.notify_all();
    }

    /// Records a heartbeat that a page sent at this time or after it.
    pub fn beat(&self, at: Instant) {
        // no wake-up: a heartbeat only extends a wait
        let mut state = self.lock();
        state.beat = state.beat.max(at);
    }

    /// Records that a button is held.
    ///
    /// # Errors
    ///
    /// A text if another button is held, or the grip is not ready for a step. A second button ends the grip.
    pub fn press(&self, press: Press) -> Result<(), String> {
        let mut state = self.lock();
        if let Some(why) = &state.end {
            return Err(format!("the jog has ended: {why}"));
        }
        if state.press.is_some() {
            drop(state);
            self.end("a second button was pressed");
            return Err("a second button was pressed, so the jog ends".into());
        }
        if state.phase != Phase::Ready {
            return Err("the robot is not ready for a step; wait a moment".into());
        }
        (state.press, state.touched, state.steps) = (Some(press), Instant::now(), 0);
        drop(state);
        self.changed.notify_all();
        Ok(())
    }

    /// Records that the button was lifted. Returns the number of its steps.
    pub fn lift(&self) -> u32 {
        let mut steps = 0;
        self.change(|state| {
            steps = state.steps;
            if state.press.take().is_some() {
                state.touched = Instant::now();
            }
        });
        steps
    }

    /// Ends the grip: the robot is halted, and the arm given back. The first reason is kept.
    pub fn end(&self, why: &str) {
        self.change(|state| {
            state.end.get_or_insert_with(|| why.to_owned());
        });
    }

    /// Returns why the grip ends or has ended.
    #[must_use]
    pub fn ends(&self) -> Option<String> {
        self.lock().end.clone()
    }

    /// Returns what the jog thread is doing.
    #[must_use]
    pub fn phase(&self) -> Phase {
        self.lock().phase
    }

    /// Returns the outcome of the jog thread: the verified state, or what is unknown.
    #[must_use]
    pub fn outcome(&self) -> Option<Result<&'static str, String>> {
        self.lock().outcome.clone()
    }

    fn set_phase(&self, phase: Phase) {
        self.change(|state| state.phase = phase);
    }

    /// Waits for a button; `None` is the end.
    fn next(&self) -> Option<Press> {
        let mut state = self.lock();
        loop {
            match (&state.end, state.press) {
                (Some(_), _) => return None,
                (None, Some(press)) => return Some(press),
                (None, None) => {}
            }
            drop(self.changed.wait_timeout(state, LOOK).unwrap_or_else(PoisonError::into_inner));
            state = self.lock();
        }
    }

    /// Begins a step, if it belongs to the button that is held.
    fn begins(&self, press: Press) -> bool {
        let mut state = self.lock();
        let is_held = state.end.is_none() && state.press == Some(press);
        if is_held {
            state.phase = Phase::Moving;
        }
        is_held
    }

    /// Returns whether the running step must be halted.
    #[must_use]
    pub fn must_halt(&self) -> bool {
        let state = self.lock();
        let is_lifted = state.press.is_none() && state.touched.elapsed() > REST;
        state.phase == Phase::Moving && (state.end.is_some() || is_lifted)
    }
}

/// Jogs a robot over a new session until the grip ends. Then the robot rests, the motor that was switched on is off, and the
/// arm is free; the [outcome](Grip::outcome) says which part of this is unknown.
pub fn run(access: &Access, grip: &Grip) {
    let end = EndOnDrop(grip);
    let outcome = match ready(access).and_then(|mut controller| Ok(hold(&mut controller, grip)?)) {
        Ok(outcome) => {
            outcome.map_err(|error| format!("IT IS UNKNOWN whether the robot rests and the arm is free: {error}"))
        }
        // without the arm nothing can have moved
        Err(error) => {
            grip.end(&error.to_string());
            Ok("nothing was moved, and the arm was not taken")
        }
    };
    grip.change(|state| state.outcome = Some(outcome));
    drop(end);
}

/// Ends the phases of a grip, even after a panic.
struct EndOnDrop<'a>(&'a Grip);

impl Drop for EndOnDrop<'_> {
    fn drop(&mut self) {
        let unknown = || Err("IT IS UNKNOWN whether the robot rests and the arm is free: the jog panicked".into());
        self.0.change(|state| {
            (state.phase, state.press) = (Phase::Ended, None);
            state.outcome.get_or_insert_with(unknown);
        });
    }
}

/// Connects to a robot that may move.
fn ready(access: &Access) -> Result<Controller, crate::link::Error> {
    let mut controller = Link::for_motion(access)?;
    require_ready(&mut controller)?;
    Ok(controller)
}

/// Takes the arm until the grip ends. Fails if the arm was not taken; the inner error leaves the robot in an unknown state.
fn hold(controller: &mut Controller, grip: &Grip) -> Result<Result<&'static str, Error>, Error> {
    if grip.ends().is_some() {
        return Ok(Ok("nothing was moved, and the arm was not taken"));
    }
    let mut arm = match controller.robot()?.take_arm() {
        // the arm may have been taken, and it is unknown whether it was given back
        Err(error) if error.is_lost() || error.may_have_run() => {
            grip.end(&error.to_string());
            return Ok(Err(error));
        }
        taken => taken?,
    };
    let jogged = jog(&mut arm, grip);
    let rests = match &jogged {
        // a call failed, so it is unknown whether the robot moves
        Err(crate::link::Error::Call(_)) => arm.robot().halt().map(drop),
        _ => Ok(()),
    };
    if rests.is_ok() {
        grip.set_phase(Phase::Ending);
    }
    let given = arm.give();
    if let Err(error) = jogged {
        grip.end(&error.to_string());
    }
    Ok(rests.and(given).map(|()| "the robot rests, and the arm is free"))
}

/// Fails unless the robot may move. Nothing is sent that would end another client's stream.
fn require_ready(controller: &mut Controller) -> Result<(), crate::link::Error> {
    let refused = |why: String| Err(crate::link::Error::Invalid(why));
    let state = controller.robot()?.examine()?;
    if state.stream == StreamState::Runs {
        return refused("another client streams in Slave Mode; TakeArm would end the stream".into());
    }
    if let Some(obstacle) = state.obstacles().next() {
        return refused(obstacle.to_string());
    }
    if let Some(code) = state.errors().first() {
        return refused(format!("the controller has the error {code}; clear it first, on the screen Alarms"));
    }
    if state.state.is_none_or(|state| state.is_moving()) {
        return refused("the robot moves; wait until it rests".into());
    }
    Ok(())
}

fn jog(arm: &mut Arm<'_>, grip: &Grip) -> Result<(), crate::link::Error> {
    let is_on = arm.robot().read::<bool>("@SERVO_ON")?;
    // it may have ended during TakeArm
    if grip.ends().is_none() && !is_on {
        arm.motor_on()?;
    }
    grip.set_phase(Phase::Ready);
    while let Some(press) = grip.next() {
        step(arm, press, grip)?;
        grip.set_phase(Phase::Ready);
    }
    Ok(())
}

/// Executes a step, and halts it if the grip ends.
fn step(arm: &mut Arm<'_>, press: Press, grip: &Grip) -> Result<(), crate::link::Error> {
    let Press { axis, by, percent } = press;
    let invalid = |why: String| Err(crate::link::Error::Invalid(why));
    let Some(step) = axis.step(by, arm.robot())? else {
        return invalid(format!("{axis}: the position has no valid Fig"));
    };
    let outside: i32 = arm.robot().execute("OutRange", step.end.to_string().as_str())?;
    if outside != 0 {
        return invalid(format!("{axis} {by:+}: {}; nothing was moved", out_of_range(outside)));
    }
    if !grip.begins(press) {
        return Ok(());
    }
    let mut moving = arm.start(&step.motion.speed_percent(percent), STEP_LIMIT)?;
    if let Some(why) = watch(&mut moving, grip)? {
        // halts, and waits until the robot is verified to be at rest
        let _ = moving.robot().halt()?;
        drop(moving);
        return why.map_or(Ok(()), invalid);
    }
    match moving.wait()? {
        Motion::Arrived => grip.change(|state| state.steps += 1),
        // a halt by another client, or by HALT of this page
        Motion::Failed(code) => return invalid(format!("{axis} {by:+}: the step ended by the error {code}")),
        Motion::Unknown => return invalid(format!("{axis} {by:+}: it is unknown whether the step arrived")),
        _ => return invalid(format!("{axis} {by:+}: the step was halted before its end")),
    }
    Ok(())
}

/// Watches a moving robot. Returns `Some` if it must be halted, with the error that is the reason; `None` when the motion ends.
fn watch(moving: &mut Moving<'_>, grip: &Grip) -> Result<Option<Option<String>>, Error> {
    let mut last: Option<(Instant, [f64; 3])> = None;
    loop {
        if grip.must_halt() {
            return Ok(Some(None));
        }
        if !moving.robot().read::<bool>("@BUSY_STATUS")? {
            return Ok(None);
        }
        let asked = Instant::now();
        let place = moving.robot().position()?.xyz_mm;
        // from before the first request to after the second answer: the robot was not slower than this speed
        if let Some(speed) = last.map(|(since, from)| distance(from, place) / since.elapsed().as_secs_f64())
            && speed > FASTEST_MM
        {
            let text = format!("the tool moved at {speed:.0} mm/s, above {FASTEST_MM} mm/s; the robot was halted");
            return Ok(Some(Some(text)));
        }
        last = Some((asked, place));
        std::thread::sleep(LOOK);
    }
}

fn distance(a: [f64; 3], b: [f64; 3]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt()
}

/// Describes the value of OutRange: bits of axes, or a negative number.
fn out_of_range(value: i32) -> String {
    match value {
        -1 => "the end of the step is out of reach".into(),
        -2 => "the end of the step is singular".into(),
        bits if bits > 0 => {
            let axes: Vec<_> = (0..8).filter(|n| bits & (1 << n) != 0).map(|n| format!("J{}", n + 1)).collect();
            format!("{} would leave its range", axes.join(", "))
        }
        other => format!("the controller answers OutRange with {other}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_step_is_short_and_slow() {
        let press = |by, percent| Press::new(Axis::Joint(1), by, percent).map(drop);
        assert_eq!(press(-5.0, 10.0), Ok(()));
        for by in [0.0, 5.1, -5.1, f64::NAN, f64::INFINITY] {
            assert!(press(by, 1.0).unwrap_err().contains("at most 5 mm or degrees"), "{by}");
        }
        for percent in [0.0, -1.0, 10.1, f64::NAN] {
            assert!(press(1.0, percent).unwrap_err().contains("at most 10 %"), "{percent}");
        }
    }

    #[test]
    fn a_grip_ends_once_and_stays_ended() {
        let grip = Grip::default();
        // so that a delay of this thread does not count as a lost heartbeat
        grip.state.lock().unwrap().beat += IDLE;
        let press = Press::new(Axis::Joint(1), 1.0, 1.0).unwrap();
        assert!(grip.press(press).unwrap_err().contains("wait a moment"), "it is starting");
        grip.set_phase(Phase::Ready);
        grip.press(press).unwrap();
        assert!(grip.begins(press) && !grip.must_halt());
        assert!(grip.press(press).unwrap_err().contains("second button"));
        assert!(grip.must_halt() && !grip.begins(press) && grip.next().is_none());
        grip.set_phase(Phase::Ending);
        assert!(!grip.must_halt());
        grip.end("another reason");
        assert_eq!(grip.ends().as_deref(), Some("a second button was pressed"));
        grip.beat(Instant::now());
        assert!(grip.press(press).unwrap_err().starts_with("the jog has ended"));
    }

    #[test]
    fn a_late_heartbeat_does_not_revive_a_grip() {
        let grip = Grip::default();
        grip.set_phase(Phase::Ready);
        let now = Instant::now();
        grip.state.lock().unwrap().beat = now.checked_sub(LAPSE * 2).unwrap();
        grip.beat(now);
        assert_eq!(grip.ends().as_deref(), Some("the heartbeat of the page was lost"));
    }

    #[test]
    fn values_of_out_range_have_a_meaning() {
        assert_eq!(out_of_range(18), "J2, J5 would leave its range");
        assert_eq!(out_of_range(-1), "the end of the step is out of reach");
        assert_eq!(out_of_range(-9), "the controller answers OutRange with -9");
    }
}
