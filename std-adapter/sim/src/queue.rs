//! The queue of the arm's motions: the current motion, and the motions after it.
//!
//! ```text
//!  speed       first            second         a motion with a pass (@P, @n) hands over while it brakes:
//!            ________         _________        the second begins before the first is at rest, and the
//!           /        \       /         \       position is the sum of both
//!          /          \     /           \
//!         /            \ . /             \     with @0 and @E, the second begins when the first is at rest
//!        /              X                 \
//!  _____/______________/_\_________________\__> t
//! ```
//!
//! At most two motions move at a time. Each event (an end, a handover) happens at its own time, however late the queue
//! is advanced, so the same commands at the same times give the same motion.

use std::collections::VecDeque;
use std::time::Duration;

use bcap_core::handler::PeerId;
use bcap_core::hresult::HResult;
use bcap_core::time::Instant;

use crate::kinematics::Axes;
use crate::motion::Motion;
use crate::path::Blocked;
use crate::waits::{Wait, Waits};

/// Maximum number of motions in the queue, including the current one.
///
/// No public source names the number. A motion beyond it is refused with `E_ROBOTISBUSY`.
pub(crate) const CAPACITY: usize = 16;

/// The state of the motions.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Stage {
    Running,
    /// Braking for Hold, or at rest until Unhold.
    Holding,
    /// Braking, to continue when the arm is at rest.
    Resuming,
    /// Braking for MotionSkip; the next motion begins when the arm is at rest or, if `held`, only after Unhold.
    Skipping {
        held: bool,
    },
    /// Braking for Halt.
    Halting,
}

/// Delay between an error of the controller and the reply that the motion was stopped: 16 to 31 ms in the log of an RC8A.
const REPORT_DELAY: Duration = Duration::from_millis(20);

/// The motions of the arm.
#[derive(Clone, Debug)]
pub(crate) struct Queue {
    /// The position at rest, while there is no motion.
    rest: Axes,
    motions: VecDeque<Motion>,
    /// Number of motions whose start time is planned: the first, and possibly the second.
    begun: usize,
    /// When the first motion reached the front of the queue.
    since: Instant,
    stage: Stage,
}

impl Queue {
    pub(crate) fn new(rest: Axes) -> Self {
        Self { rest, motions: VecDeque::new(), begun: 0, since: Instant::ZERO, stage: Stage::Running }
    }

    pub(crate) fn is_empty(&self) -> bool {
        self.motions.is_empty()
    }

    pub(crate) fn is_full(&self) -> bool {
        self.motions.len() >= CAPACITY
    }

    /// Returns whether the motions brake to their end.
    pub(crate) fn is_halting(&self) -> bool {
        self.stage == Stage::Halting && !self.is_empty()
    }

    /// Returns the client of the last motion, unless the motions brake to their end.
    pub(crate) fn accepts(&self) -> Option<PeerId> {
        self.motions.back().filter(|_| self.stage != Stage::Halting).map(|motion| motion.peer)
    }

    /// Returns the client of the current motion.
    pub(crate) fn mover(&self) -> Option<PeerId> {
        self.motions.front().map(|motion| motion.peer)
    }

    pub(crate) fn axes(&self, now: Instant) -> Axes {
        let Some(first) = self.motions.front() else { return self.rest };
        match self.motions.get(1).filter(|_| self.begun > 1) {
            Some(next) => {
                let (here, more) = (first.axes(now), next.progress(now));
                [0, 1, 2, 3, 4, 5, 6, 7].map(|i| here[i] + more[i])
            }
            None => first.axes(now),
        }
    }

    /// Returns the end of the current motion, or the position at rest.
    pub(crate) fn destination(&self) -> Axes {
        self.motions.front().map_or(self.rest, Motion::destination)
    }

    /// Returns where a further motion begins.
    pub(crate) fn last_destination(&self) -> Axes {
        match self.motions.len() {
            // the begun motions are cut short
            n if matches!(self.stage, Stage::Skipping { .. }) && n == self.begun => self.axes(self.at_rest()),
            _ => self.motions.back().map_or(self.rest, Motion::destination),
        }
    }

    /// Adds a motion. It begins now if the arm is at rest.
    pub(crate) fn push(&mut self, motion: Motion, now: Instant) {
        self.motions.push_back(motion);
        if self.motions.len() == 1 {
            (self.stage, self.since) = (Stage::Running, now);
            self.begin(now);
        } else if self.stage == Stage::Running {
            self.schedule(now);
        }
    }

    /// Adds a motion that brakes to rest, and ends as if Halt had begun it.
    pub(crate) fn brake(&mut self, motion: Motion, now: Instant) {
        self.motions.push_back(motion);
        (self.stage, self.since, self.begun) = (Stage::Halting, now, 1);
    }

    /// Starts the first motion.
    fn begin(&mut self, at: Instant) {
        self.begun = self.motions.len().min(1);
        if let Some(first) = self.motions.front_mut() {
            first.run(at);
        }
        self.schedule(at);
    }

    /// Plans when the second motion begins.
    fn schedule(&mut self, now: Instant) {
        if self.begun == 1
            && let (Some(first), Some(next)) = (self.motions.front(), self.motions.get(1))
        {
            let at = first.handover(next, now);
            self.motions[1].run(at);
            self.begun = 2;
        }
    }

    /// Returns when all that moves is at rest.
    fn at_rest(&self) -> Instant {
        self.motions.iter().take(self.begun).map(Motion::end).max().unwrap_or(self.since).max(self.since)
    }

    /// Performs what happens until `now`, and ends the calls that wait for it.
    pub(crate) fn advance(&mut self, now: Instant, waits: &mut Waits) {
        while let Some(at) = self.next_event() {
            if let Some(first) = self.motions.front()
                && self.stage == Stage::Running
                && first.pass_time() <= now
            {
                waits.end(Wait::Motion(first.id), HResult::S_OK);
            }
            if let Some(first) = self.motions.front() {
                waits.cover(first.id, first.covered(now), HResult::S_OK);
            }
            if at > now {
                return;
            }
            self.perform(at, waits);
        }
    }

    /// Returns when the current stage ends; `None` at rest, and while it is held.
    fn next_event(&self) -> Option<Instant> {
        let first = self.motions.front()?;
        match self.stage {
            Stage::Running => Some(first.end().max(self.since)),
            Stage::Holding => None,
            Stage::Resuming | Stage::Skipping { .. } | Stage::Halting => Some(self.at_rest()),
        }
    }

    /// Ends the current stage.
    fn perform(&mut self, at: Instant, waits: &mut Waits) {
        match self.stage {
            Stage::Running => {
                let Some(ended) = self.motions.pop_front() else { return };
                // through rounding, it may end just before the whole path is covered
                waits.cover(ended.id, 1.0, HResult::S_OK);
                // exactly, without the rounding of the path
                (self.rest, self.since) = (ended.destination(), at);
                self.begun -= 1;
                if self.begun == 0 { self.begin(at) } else { self.schedule(at) }
            }
            Stage::Holding => {}
            Stage::Resuming => {
                (self.stage, self.since) = (Stage::Running, at);
                self.begin(at);
            }
            Stage::Skipping { held } => {
                self.rest = self.axes(at);
                for skipped in self.motions.drain(..self.begun) {
                    waits.end(Wait::Motion(skipped.id), HResult::S_OK);
                    waits.cover(skipped.id, 1.0, HResult::S_OK);
                }
                self.since = at;
                if held && !self.is_empty() {
                    // the next motion rests at its beginning, as if Hold had stopped it there
                    (self.stage, self.begun) = (Stage::Holding, 1);
                } else {
                    self.stage = Stage::Running;
                    self.begin(at);
                }
            }
            Stage::Halting => self.stop(HResult::E_ABORT, at, waits),
        }
    }

    /// Returns the number of the current motion.
    pub(crate) fn first(&self) -> Option<u64> {
        self.motions.front().map(|motion| motion.id)
    }

    /// Returns when to look again for a part of a motion; `None` while it is held.
    pub(crate) fn end_of_part(&self, id: u64, part: f64, now: Instant) -> Option<Instant> {
        let end = self.end(now)?;
        let motion = self.motions.front().filter(|motion| motion.id == id);
        Some(motion.map_or(end, |motion| motion.time_of(part).min(end)))
    }

    /// Returns when to look again for the end of a motion; `None` while it is held.
    pub(crate) fn end(&self, now: Instant) -> Option<Instant> {
        let end = self.next_event()?;
        let pass = self.motions.front().filter(|_| self.stage == Stage::Running).map(Motion::pass_time);
        Some(pass.filter(|pass| *pass > now).map_or(end, |pass| pass.min(end)))
    }

    /// Returns whether no command is in execution: the arm may still move to the end of its last motion.
    pub(crate) fn commands_are_complete(&self, now: Instant) -> bool {
        match self.motions.front() {
            None => true,
            Some(last) => self.motions.len() == 1 && self.stage == Stage::Running && last.pass_time() <= now,
        }
    }

    /// Brakes all motions to their end; returns whether there was one.
    pub(crate) fn halt(&mut self, now: Instant) -> bool {
        if self.stage != Stage::Halting {
            self.slow_down(Stage::Halting, now, false);
        }
        !self.is_empty()
    }

    /// Brakes until [`unhold`](Self::unhold); `false` without a motion, or if it is held or halts already.
    pub(crate) fn hold(&mut self, now: Instant) -> bool {
        if self.is_empty() {
            return false;
        }
        match self.stage {
            Stage::Running | Stage::Resuming => self.slow_down(Stage::Holding, now, false),
            // it brakes as before, because the next path is planned from the place where that ends
            Stage::Skipping { held: false } => self.stage = Stage::Skipping { held: true },
            Stage::Skipping { held: true } | Stage::Holding | Stage::Halting => return false,
        }
        true
    }

    /// Continues when the arm is at rest; `false` if it is not held.
    pub(crate) fn unhold(&mut self, now: Instant) -> bool {
        if self.is_empty() {
            return false;
        }
        match self.stage {
            Stage::Holding => (self.stage, self.since) = (Stage::Resuming, now),
            Stage::Skipping { held: true } => self.stage = Stage::Skipping { held: false },
            _ => return false,
        }
        true
    }

    /// Brakes the begun motions, at full deceleration or, if `gently`, at the deceleration of each motion. Then the next motion
    /// begins where the arm comes to rest.
    ///
    /// After Hold, the next motion begins only after Unhold. Returns `false` if there is no motion that can be skipped.
    ///
    /// # Errors
    ///
    /// The reason why a queued motion cannot begin there. That motion and all motions after it are dropped.
    pub(crate) fn skip(&mut self, gently: bool, now: Instant, waits: &mut Waits) -> Result<bool, Blocked> {
        if self.is_empty() || matches!(self.stage, Stage::Halting | Stage::Skipping { .. }) {
            return Ok(false);
        }
        // a motion that was to begin later has not begun
        if self.begun > 1 && self.motions[1].progress(now) == [0.0; 8] {
            self.begun = 1;
        }
        let held = self.stage == Stage::Holding;
        self.slow_down(Stage::Skipping { held }, now, gently);
        let mut here = self.axes(self.at_rest());
        for n in self.begun..self.motions.len() {
            let motion = &self.motions[n];
            match motion.route.as_ref().map(|(route, tool)| route.path(motion.arm(), &here, tool)) {
                Some(Ok(path)) => {
                    here = path.end();
                    self.motions[n].replace(path, now);
                }
                Some(Err(blocked)) => {
                    self.motions.drain(n..).for_each(|lost| waits.end(Wait::Motion(lost.id), blocked.code()));
                    return Err(blocked);
                }
                None => {}
            }
        }
        Ok(true)
    }

    fn slow_down(&mut self, stage: Stage, now: Instant, gently: bool) {
        self.stage = stage;
        let begun = self.begun;
        self.motions.iter_mut().take(begun).for_each(|motion| motion.brake(now, gently));
    }

    /// Stops without braking because of `code`, and drops all motions. Their clients are notified: immediately, or after a
    /// short delay if `code` is an error of the controller.
    pub(crate) fn stop(&mut self, code: HResult, now: Instant, waits: &mut Waits) {
        self.set_rest(self.axes(now));
        let report = if code.level().is_some() { now.saturating_add(REPORT_DELAY) } else { now };
        // the braking after Slave Mode has no route, and no call waits for it
        for dropped in self.motions.drain(..).filter(|motion| motion.route.is_some()) {
            waits.stop(dropped.id, dropped.peer, report);
        }
        self.begun = 0;
        self.stage = Stage::Running;
    }

    /// Sets the position of an arm without motions.
    pub(crate) fn set_rest(&mut self, rest: Axes) {
        self.rest = rest;
    }
}
