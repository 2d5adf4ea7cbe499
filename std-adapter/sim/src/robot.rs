//! The state of the robot: its motor, the arm authority, its speeds, and the motion or the Slave Mode that moves it.

use bcap_core::handler::PeerId;
use bcap_core::hresult::HResult;
use bcap_core::time::Instant;

use crate::config::Config;
use crate::context::Context;
use crate::coordinates::{Coordinates, Definitions};
use crate::kinematics::{Axes, Geometry, Joints, six, with_joints};
use crate::motion::{Motion, Rates};
use crate::options::Pass;
use crate::path::Blocked;
use crate::path::Path;
use crate::queue::Queue;
use crate::route::Route;
use crate::rules::{Authority, Rule};
use crate::stream::Stream;
use crate::waits::{Wait, Waits};

/// The highest numbers of a tool and of work or base coordinates, in the backup of a real RC8A.
const LAST_TOOL: i32 = 63;
const LAST_WORK: i32 = 7;

/// The motor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Servo {
    Off,
    /// On from this time.
    TurningOn(Instant),
    On,
}

/// Speed, acceleration and deceleration in percent.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Percent {
    pub(crate) speed: f32,
    pub(crate) accel: f32,
    pub(crate) decel: f32,
}

impl Percent {
    const FULL: Self = Self { speed: 100.0, accel: 100.0, decel: 100.0 };

    /// Sets a speed, and accelerations that are its square.
    pub(crate) fn of_speed(speed: f32) -> Self {
        let accel = speed * speed / 100.0;
        Self { speed, accel, decel: accel }
    }

    fn times(self, other: Self) -> Rates {
        let part = |a: f32, b: f32| f64::from(a) / 100.0 * (f64::from(b) / 100.0);
        Rates {
            speed: part(self.speed, other.speed),
            accel: part(self.accel, other.accel),
            decel: part(self.decel, other.decel),
        }
    }
}

/// The settings of a client for the motions of the arm.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Settings {
    /// Internal speed of motions along lines.
    pub(crate) line: Percent,
    /// Internal speed of motions of joints.
    pub(crate) joint: Percent,
    /// External speed.
    pub(crate) external: Percent,
    pub(crate) tool: i32,
    pub(crate) work: i32,
    pub(crate) load: Load,
}

/// The load as set by a client, and how the robot uses it. Motions do not depend on it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Load {
    /// In g.
    pub(crate) mass: i32,
    pub(crate) centre: [f64; 3],
    pub(crate) inertia: [f64; 3],
    /// SpeedMode: 0 off, 1 for motions of joints, 2 along lines, 3 both.
    pub(crate) speed_mode: i32,
}

/// The robot's state.
#[derive(Clone, Debug)]
pub(crate) struct Robot {
    geometry: Geometry,
    queue: Queue,
    /// Slave Mode. While it is on, the queue is empty.
    stream: Option<Stream>,
    last_motion: u64,
    servo: Servo,
    /// Number of times that the motor was switched on.
    motor_starts: i32,
    /// The client that owns the arm, and the arm group.
    owner: Option<(PeerId, i32)>,
    settings: Settings,
    pub(crate) tools: Definitions,
    pub(crate) works: Definitions,
    pub(crate) bases: Definitions,
}

impl Robot {
    pub(crate) fn new(config: &Config) -> Self {
        let home = with_joints(&config.home, &[0.0; 8]);
        let internal = Percent { speed: config.speed, ..Percent::FULL };
        Self {
            geometry: config.geometry,
            queue: Queue::new(home),
            stream: None,
            last_motion: 0,
            servo: Servo::Off,
            motor_starts: 0,
            owner: None,
            tools: Definitions::new(),
            works: Definitions::new(),
            bases: Definitions::new(),
            settings: Settings {
                line: internal,
                joint: internal,
                external: Percent::of_speed(config.ext_speed),
                tool: 0,
                work: 0,
                load: Load::default(),
            },
        }
    }

    /// Advances the motor and the motion to `now`, and ends the calls that wait for them.
    pub(crate) fn advance(&mut self, now: Instant, waits: &mut Waits) {
        if let Servo::TurningOn(at) = self.servo
            && at <= now
        {
            self.servo = Servo::On;
        }
        self.queue.advance(now, waits);
        if self.motor_is_on() {
            waits.end(Wait::Servo, HResult::S_OK);
        }
        if !self.is_moving() {
            waits.end(Wait::Rest, HResult::S_OK);
        }
    }

    pub(crate) fn servo(&self) -> Servo {
        self.servo
    }

    /// Returns the number of times that clients switched the motor on.
    pub(crate) fn motor_starts(&self) -> i32 {
        self.motor_starts
    }

    pub(crate) fn motor_is_on(&self) -> bool {
        self.servo == Servo::On
    }

    /// Starts to switch the motor on, if it is off.
    pub(crate) fn turn_on(&mut self, at: Instant) {
        if self.servo == Servo::Off {
            self.motor_starts = self.motor_starts.saturating_add(1);
            self.servo = Servo::TurningOn(at);
        }
    }

    /// Switches the motor on immediately.
    pub(crate) fn force_on(&mut self) {
        self.servo = Servo::On;
    }

    /// Switches the motor off, and stops motion and Slave Mode. Calls that wait for the motor or for Slave Mode end with `code`.
    pub(crate) fn turn_off(&mut self, code: HResult, now: Instant, waits: &mut Waits) {
        self.servo = Servo::Off;
        self.leave(code, now, waits);
        self.queue.stop(HResult::E_ABORT, now, waits);
        waits.end(Wait::Servo, code);
    }

    /// Returns the client that owns the arm.
    pub(crate) fn owner(&self) -> Option<PeerId> {
        self.owner.map(|(peer, _)| peer)
    }

    /// Returns the arm group that a client owns.
    pub(crate) fn group_of(&self, peer: PeerId) -> Option<i32> {
        self.owner.filter(|(owner, _)| *owner == peer).map(|(_, group)| group)
    }

    pub(crate) fn set_owner(&mut self, owner: Option<(PeerId, i32)>) {
        self.owner = owner;
    }

    pub(crate) fn settings(&self) -> &Settings {
        &self.settings
    }

    pub(crate) fn settings_mut(&mut self) -> &mut Settings {
        &mut self.settings
    }

    /// Returns the dimensions, ranges and speeds of the arm.
    pub(crate) fn geometry(&self) -> &Geometry {
        &self.geometry
    }

    /// Returns the current tool and work coordinates.
    pub(crate) fn coordinates(&self) -> Coordinates {
        let (tool, work) = (self.tools.get(self.settings.tool), self.works.get(self.settings.work));
        Coordinates { arm: self.geometry, tool, work }
    }

    /// Sets internal speeds, tool and work coordinates back, as TakeArm does.
    pub(crate) fn reset_settings(&mut self) {
        self.settings = Settings { line: Percent::FULL, joint: Percent::FULL, tool: 0, work: 0, ..self.settings };
    }

    /// Returns whether a motion is running or held, or an axis moves in Slave Mode.
    pub(crate) fn is_moving(&self) -> bool {
        !self.queue.is_empty() || self.stream.as_ref().is_some_and(Stream::is_moving)
    }

    /// Returns whether the motions brake to their end.
    pub(crate) fn is_halting(&self) -> bool {
        self.queue.is_halting()
    }

    /// Returns whether the queue has motions of this client that continue to their end, and room for one more.
    pub(crate) fn may_follow(&self, peer: PeerId) -> bool {
        self.queue.accepts() == Some(peer) && !self.queue.is_full()
    }

    /// Returns whether all motion commands are complete; after a pass the robot may still move.
    pub(crate) fn commands_are_complete(&self, now: Instant) -> bool {
        self.queue.commands_are_complete(now)
    }

    /// Returns the client whose motion or Slave Mode moves the robot.
    pub(crate) fn mover(&self) -> Option<PeerId> {
        self.stream.as_ref().map(|stream| stream.peer).or_else(|| self.queue.mover())
    }

    /// Returns when to look again for the end of the motion; `None` without a motion, or while it is held.
    pub(crate) fn motion_end(&self, now: Instant) -> Option<Instant> {
        self.queue.end(now)
    }

    /// Returns the number of the current motion.
    pub(crate) fn motion(&self) -> Option<u64> {
        self.queue.first()
    }

    /// Returns when to look again for a part of a motion; `None` while it is held.
    pub(crate) fn end_of_part(&self, id: u64, part: f64, now: Instant) -> Option<Instant> {
        self.queue.end_of_part(id, part, now)
    }

    pub(crate) fn joints(&self, now: Instant) -> Joints {
        six(&self.axes(now))
    }

    /// Returns J1 to J8.
    pub(crate) fn axes(&self, now: Instant) -> Axes {
        self.stream.as_ref().map_or_else(|| self.queue.axes(now), |stream| stream.axes(now))
    }

    /// Returns the commanded position of the axes.
    pub(crate) fn destination(&self) -> Axes {
        self.stream.as_ref().map_or_else(|| self.queue.destination(), Stream::commanded)
    }

    /// Adds a motion to the queue and returns its number.
    ///
    /// # Errors
    ///
    /// The reason why the route cannot be followed from the end of the queue.
    pub(crate) fn start(
        &mut self,
        peer: PeerId,
        (route, pass): (Route, Pass),
        internal: Percent,
        now: Instant,
    ) -> Result<u64, Blocked> {
        let tool = self.coordinates().tool;
        let path = route.path(&self.geometry, &self.queue.last_destination(), &tool)?;
        self.last_motion += 1;
        let rates = internal.times(self.settings.external);
        let mut motion = Motion::new(self.last_motion, peer, path, rates, now);
        (motion.route, motion.pass) = (Some((route, tool)), pass);
        self.queue.push(motion, now);
        Ok(self.last_motion)
    }

    /// Brakes the motions to their end; returns whether there was one.
    pub(crate) fn halt_motion(&mut self, now: Instant, waits: &mut Waits) -> bool {
        let halted = self.queue.halt(now);
        // a held motion that is at rest ends now
        self.advance(now, waits);
        halted
    }

    /// Brakes the motion until [`unhold`](Self::unhold); returns whether it was running.
    pub(crate) fn hold(&mut self, now: Instant) -> bool {
        self.queue.hold(now)
    }

    /// Continues a held motion; returns whether there was one.
    pub(crate) fn unhold(&mut self, now: Instant) -> bool {
        self.queue.unhold(now)
    }

    /// Ends the current motion early; the next motion begins when the arm is at rest. Returns whether there was a motion.
    ///
    /// # Errors
    ///
    /// The reason why the next motion cannot begin there.
    pub(crate) fn skip_motion(&mut self, gently: bool, now: Instant, waits: &mut Waits) -> Result<bool, Blocked> {
        let skipped = self.queue.skip(gently, now, waits)?;
        self.advance(now, waits);
        Ok(skipped)
    }

    /// Stops motion and Slave Mode without braking. Calls that wait for Slave Mode end with `code`.
    pub(crate) fn stop(&mut self, code: HResult, now: Instant, waits: &mut Waits) {
        self.leave(code, now, waits);
        self.queue.stop(code, now, waits);
    }

    pub(crate) fn stream(&self) -> Option<&Stream> {
        self.stream.as_ref()
    }

    pub(crate) fn stream_mut(&mut self) -> Option<&mut Stream> {
        self.stream.as_mut()
    }

    /// Enters Slave Mode.
    pub(crate) fn enter(&mut self, stream: Stream) {
        self.stream = Some(stream);
    }

    /// Ends Slave Mode without braking. Calls that wait for it end with `code`.
    pub(crate) fn leave(&mut self, code: HResult, now: Instant, waits: &mut Waits) -> Option<Stream> {
        let stream = self.stream.take()?;
        self.queue.set_rest(stream.axes(now));
        waits.end(Wait::Stored, code);
        waits.end(Wait::Left, code);
        Some(stream)
    }

    /// Brakes all axes together from these speeds to rest, as hard as these limits of acceleration allow.
    pub(crate) fn brake(&mut self, peer: PeerId, speeds: &Axes, limits: &Axes, now: Instant) {
        let Some(path) = Path::braking(&self.geometry, self.queue.axes(now), speeds, limits) else { return };
        self.last_motion += 1;
        self.queue.brake(Motion::braking(self.last_motion, peer, path, now), now);
    }

    /// Checks the conditions of a rule, in the order of its fields.
    pub(crate) fn may(&self, ctx: &Context<'_>, rule: &Rule) -> Result<(), HResult> {
        ctx.may(rule)?;
        let may_own = match (rule.arm, self.owner()) {
            (Authority::Any, _) | (Authority::Free, None) => true,
            (Authority::Own, None) => false,
            (_, Some(owner)) => owner == ctx.peer,
        };
        if !may_own {
            return Err(HResult::E_ARM_NOT_TAKEN);
        }
        if rule.motor && !self.motor_is_on() {
            return Err(HResult::E_MOTOR_OFF);
        }
        if rule.rest && (self.is_moving() || self.stream.is_some()) {
            return Err(HResult::E_ROBOTISBUSY);
        }
        Ok(())
    }
}

/// Checks a speed or an acceleration in percent, 0.0001 to 100.
pub(crate) fn percent(value: f64) -> Result<f32, HResult> {
    // the lower bound keeps squares and products of these far from 0, with which no motion could be planned
    if (0.0001..=100.0).contains(&value) { Ok(value as f32) } else { Err(HResult::E_INVALIDARG) }
}

/// Checks the number of a tool.
pub(crate) fn tool(number: i32) -> Result<i32, HResult> {
    if (0..=LAST_TOOL).contains(&number) { Ok(number) } else { Err(HResult::E_INVALIDARG) }
}

/// Checks the number of work coordinates, or of base coordinates.
pub(crate) fn work(number: i32) -> Result<i32, HResult> {
    if (0..=LAST_WORK).contains(&number) { Ok(number) } else { Err(HResult::E_INVALIDARG) }
}
