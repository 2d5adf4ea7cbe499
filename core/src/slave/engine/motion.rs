//! The stream itself: each pose at its time, and the poses of a stop.

use core::time::Duration;

use super::{Engine, EngineAction, RECEIVED_MAX, Stop};
use crate::hresult::HResult;
use crate::slave::call::Step;
use crate::slave::fault::Cause;
use crate::slave::limits::{self, PoseError};
use crate::slave::pose::Pose;
use crate::slave::reply::MoveReply;
use crate::time::{Instant, micros_u32};
use crate::variant::Variant;

/// The minimum number of repeats of the last pose: enough to empty the buffer, and two more.
const REPEATS_MIN: u16 = 5;
/// The number of repeats after which the stop no longer waits for the robot.
const REPEATS_MAX: u16 = 250;
/// The number of replies in a row without motion after which the robot counts as at rest.
const STILL: u8 = 2;
/// The largest motion that counts as rest, in mm or degrees per cycle.
const STILL_WITHIN: f64 = 0.002;
impl<const N: usize> Engine<N> {
    /// Returns the action that must precede the next slvMove; `None` when slvMove can be sent.
    pub(super) fn pace(&mut self, now: Instant) -> Option<EngineAction> {
        if !self.pacer.loaded {
            if self.stop.is_none() {
                return Some(EngineAction::Pose { deadline: self.pacer.deadline });
            }
            if !self.load_stop() {
                self.leave();
                return None;
            }
        }
        if now < self.pacer.deadline {
            return Some(EngineAction::Wait(self.pacer.deadline));
        }
        self.step = Step::Move;
        self.pacer.sending(&self.config, &mut self.stats, now);
        None
    }

    pub(super) fn load(&mut self, pose: Pose) -> Result<(), PoseError> {
        self.frame.set_pose(&pose)?;
        self.last = pose;
        self.pacer.loaded = true;
        Ok(())
    }

    pub(super) fn handle_move<'a>(&mut self, code: HResult, value: Variant<'a>, now: Instant) -> Option<MoveReply<'a>> {
        self.stats.rtt.record(micros_u32(now.saturating_since(self.sent_at)));
        if code == HResult::E_BUF_FULL {
            self.stats.refused = self.stats.refused.saturating_add(1);
            if self.pacer.refused(&self.config, now) {
                self.fail(Cause::Stalled);
            }
            return None;
        }
        if code.is_err() {
            self.fail(Cause::Refused(code));
            return None;
        }
        self.stats.cycles = self.stats.cycles.saturating_add(1);
        self.pacer.stored(&self.config, code == HResult::S_BUF_FULL, now);
        match self.config.format.receive.read(value) {
            Ok(reply) => {
                self.update_received(&reply);
                Some(reply)
            }
            Err(error) => {
                self.fail(Cause::Reply(error));
                None
            }
        }
    }

    pub(super) fn begin_stop(&mut self, ramp: Duration) {
        let cycle = self.config.seconds();
        let by_limits = limits::slow_down(&self.config.limits, cycle, &self.velocity);
        let ramp = ramp.as_secs_f64();
        let by_ramp = if ramp > cycle { cycle / ramp } else { 1.0 };
        let moving = self.velocity.iter().any(|step| *step != 0.0);
        let speed = if moving { 1.0 } else { 0.0 };
        self.stop = Some(Stop { delta: self.delta, speed, part: by_limits.min(by_ramp), repeats: 0, still: 0 });
        if self.pacer.taken == 0 && !self.pacer.loaded {
            // no pose was commanded, so the robot does not move
            self.leave();
        }
    }

    /// Puts the next pose of the stop into the frame; `false` when the robot is at rest, or the stop has waited long enough.
    fn load_stop(&mut self) -> bool {
        let Some(stop) = &mut self.stop else { return false };
        let stands = stop.repeats >= REPEATS_MIN && stop.still >= STILL;
        if stands || stop.repeats >= REPEATS_MAX {
            return false;
        }
        stop.speed -= stop.part;
        let pose = if stop.speed > 0.0 {
            self.last.shifted(&stop.delta.scaled(stop.speed))
        } else {
            stop.repeats = stop.repeats.saturating_add(1);
            self.last
        };
        self.load(pose).is_ok()
    }

    /// Compares the position of the robot with the previous one, except joints that it does not have.
    fn update_received(&mut self, reply: &MoveReply<'_>) {
        let mut numbers = [0.0; RECEIVED_MAX];
        for (slot, number) in numbers.iter_mut().zip(reply.pose().iter()) {
            *slot = number;
        }
        let before = self.received.replace(numbers);
        let Some(stop) = self.stop.as_mut().filter(|stop| stop.repeats > 0) else { return };
        let joints_at = self.config.format.receive.pose.joints_at().unwrap_or(RECEIVED_MAX);
        let (seven, eight) = self.config.format.extended.has();
        let is_used = |index: usize| match index.checked_sub(joints_at) {
            Some(joint) => joint < usize::from(self.config.joints) || (joint == 6 && seven) || (joint == 7 && eight),
            None => true,
        };
        let still = before.is_some_and(|before| {
            let mut pairs = numbers.iter().zip(before).enumerate().filter(|(index, _)| is_used(*index));
            pairs.all(|(_, (now, before))| (now - before).abs() <= STILL_WITHIN)
        });
        stop.still = if still { stop.still.saturating_add(1) } else { 0 };
    }
}
