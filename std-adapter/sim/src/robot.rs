//! The robot: its motor, its arm authority, its speeds, and where it is.

use bcap_core::handler::PeerId;
use bcap_core::hresult::HResult;
use bcap_core::time::Instant;

use crate::config::Config;
use crate::kinematics::{Axes, Frame, Joints, figure, forward, six, with_joints};
use crate::motion::{Ended, Motion, Path, Rates};
use crate::slave::Stream;

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
    pub(crate) const FULL: Self = Self { speed: 100.0, accel: 100.0, decel: 100.0 };

    /// Sets a speed, with the accelerations that belong to it: its square.
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

/// The robot's state.
#[derive(Clone, Debug)]
pub(crate) struct Robot {
    /// Where it stands while it does not move.
    rest: Axes,
    motion: Option<Motion>,
    /// Slave mode; there is no motion while it is on.
    pub(crate) slave: Option<Stream>,
    last_motion: u64,
    /// Where the last motion was to end.
    destination: Axes,
    pub(crate) servo: Servo,
    /// Who has the arm authority, and of which arm group.
    pub(crate) arm: Option<(PeerId, i32)>,
    /// Internal speed of motions along lines.
    pub(crate) hand: Percent,
    /// Internal speed of motions of joints.
    pub(crate) joint: Percent,
    /// External speed.
    pub(crate) external: Percent,
    pub(crate) tool: i32,
    pub(crate) work: i32,
}

impl Robot {
    pub(crate) fn new(config: &Config) -> Self {
        let home = with_joints(&config.home, &[0.0; 8]);
        Self {
            rest: home,
            motion: None,
            slave: None,
            last_motion: 0,
            destination: home,
            servo: Servo::Off,
            arm: None,
            hand: Percent { speed: config.speed, ..Percent::FULL },
            joint: Percent { speed: config.speed, ..Percent::FULL },
            external: Percent::of_speed(config.ext_speed),
            tool: 0,
            work: 0,
        }
    }

    /// Lets it go on until `now`; returns the motion that has ended, and how.
    pub(crate) fn advance(&mut self, now: Instant) -> Option<(u64, Ended)> {
        if let Servo::TurningOn(at) = self.servo
            && at <= now
        {
            self.servo = Servo::On;
        }
        let (id, ended) = self.motion.as_ref().and_then(|m| Some((m.id, m.ended(now)?)))?;
        let destination = self.destination;
        self.freeze(now);
        if ended == Ended::Arrived {
            // exactly, without the rounding of the way
            (self.rest, self.destination) = (destination, destination);
        }
        Some((id, ended))
    }

    pub(crate) fn motor_is_on(&self) -> bool {
        self.servo == Servo::On
    }

    pub(crate) fn motion(&self) -> Option<&Motion> {
        self.motion.as_ref()
    }

    pub(crate) fn motion_mut(&mut self) -> Option<&mut Motion> {
        self.motion.as_mut()
    }

    pub(crate) fn joints(&self, now: Instant) -> Joints {
        six(&self.axes(now))
    }

    /// Returns J1 to J8.
    pub(crate) fn axes(&self, now: Instant) -> Axes {
        match (&self.slave, &self.motion) {
            (Some(slave), _) => slave.axes(now),
            (None, Some(motion)) => motion.axes(now),
            (None, None) => self.rest,
        }
    }

    /// Returns where the axes are commanded to.
    pub(crate) fn destination(&self) -> Axes {
        self.slave.as_ref().map_or(self.destination, Stream::commanded)
    }

    /// Starts a motion and returns its number.
    pub(crate) fn start(&mut self, peer: PeerId, path: Path, internal: Percent, now: Instant) -> u64 {
        self.last_motion += 1;
        let motion = Motion::start(self.last_motion, peer, path, internal.times(self.external), now);
        self.destination = motion.destination();
        self.motion = Some(motion);
        self.last_motion
    }

    /// Stands still at once, wherever it is; returns the number of the motion that this has ended.
    pub(crate) fn freeze(&mut self, now: Instant) -> Option<u64> {
        let motion = self.motion.take()?;
        self.rest = motion.axes(now);
        self.destination = self.rest;
        Some(motion.id)
    }

    /// Ends slave mode at once, wherever the axes are.
    pub(crate) fn stop_slave(&mut self, now: Instant) -> Option<Stream> {
        let slave = self.slave.take()?;
        self.rest = slave.axes(now);
        self.destination = self.rest;
        Some(slave)
    }

    /// Brakes from these speeds to rest, all axes together, as fast as these limits of acceleration allow.
    pub(crate) fn brake(&mut self, peer: PeerId, speeds: &Axes, limits: &Axes, now: Instant) {
        let Some(path) = Path::braking(self.rest, speeds, limits) else { return };
        self.last_motion += 1;
        let motion = Motion::braking(self.last_motion, peer, path, now);
        self.destination = motion.destination();
        self.motion = Some(motion);
    }
}

/// Returns X Y Z RX RY RZ Fig of joints.
pub(crate) fn position(joints: &Joints) -> Vec<f64> {
    pose_numbers(&forward(joints), figure(joints))
}

/// Returns X Y Z RX RY RZ Fig.
pub(crate) fn pose_numbers(frame: &Frame, fig: u8) -> Vec<f64> {
    let mut numbers = frame.to_xyz_rpy().to_vec();
    numbers.push(f64::from(fig));
    numbers
}

/// Returns position, orient vector, approach vector and Fig of joints.
pub(crate) fn trans(joints: &Joints) -> Vec<f64> {
    let mut numbers = forward(joints).to_trans().to_vec();
    numbers.push(f64::from(figure(joints)));
    numbers
}

/// Returns J1 to J8 of joints alone: axes 7 and 8 are 0.
pub(crate) fn angle(joints: &Joints) -> Vec<f64> {
    let mut numbers = joints.to_vec();
    numbers.resize(8, 0.0);
    numbers
}

/// Checks a speed or an acceleration in percent, 0.0001 to 100.
pub(crate) fn percent(value: f64) -> Result<f32, HResult> {
    // the lower bound keeps squares and products of these far from 0, which no motion could be planned with
    if (0.0001..=100.0).contains(&value) { Ok(value as f32) } else { Err(HResult::E_INVALIDARG) }
}
