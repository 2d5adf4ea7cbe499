//! A scenario that is being played: what is due, and what becomes of each call and its answer.

use std::time::Duration;

use bcap_core::bcap::FunctionId;
use bcap_core::bcap::server::Request;
use bcap_core::handler::{Outcome, PeerId, ReplyValue};
use bcap_core::hresult::HResult;
use bcap_core::time::Instant;

use super::{Delivery, Effect, Fault, Scenario, Trigger, Which, WireFault};
use crate::controller::Controller;
use crate::value::kept;

/// A scenario that is being played.
#[derive(Clone, Debug)]
pub(crate) struct Running {
    faults: Vec<Armed>,
    chance: fastrand::Rng,
    /// Until when the link is lost.
    lost_until: Instant,
}

/// A fault, and how far it has come.
#[derive(Clone, Debug)]
struct Armed {
    fault: Fault,
    /// Calls that were counted.
    calls: u64,
    /// It will not happen any more.
    over: bool,
}

/// What a scenario has in store for a call.
#[derive(Clone, Debug, Default)]
pub(crate) struct Fate {
    refused: Option<HResult>,
    wire: Option<WireFault>,
    /// Not answered before this time.
    until: Instant,
    /// The link was lost when it came: it is not carried out, and never answered.
    lost: bool,
    /// Its answer, which is held back.
    answer: Option<(HResult, Vec<u8>)>,
    /// The answer was made, and is on its way.
    answered: bool,
}

impl Default for Running {
    fn default() -> Self {
        Self::new(Scenario::default())
    }
}

impl Running {
    pub(crate) fn new(scenario: Scenario) -> Self {
        let armed = |fault| Armed { fault, calls: 0, over: false };
        Self {
            faults: scenario.faults.into_iter().map(armed).collect(),
            chance: fastrand::Rng::with_seed(scenario.seed),
            lost_until: Instant::ZERO,
        }
    }

    /// Takes the next fault that is due by this time, the earliest first.
    pub(crate) fn due(&mut self, now: Instant) -> Option<(Instant, Effect)> {
        let waiting = self.faults.iter_mut().filter(|armed| !armed.over);
        let timed = waiting.filter_map(|armed| match armed.fault.when {
            Trigger::At(at) if at <= now => Some((at, armed)),
            _ => None,
        });
        let (at, armed) = timed.min_by_key(|(at, _)| *at)?;
        armed.over = true;
        Some((at, armed.fault.then))
    }

    /// Takes the faults of a cycle.
    pub(crate) fn at_cycle(&mut self, cycle: u64) -> Vec<Effect> {
        let due = |armed: &&mut Armed| !armed.over && armed.fault.when == Trigger::Cycle(cycle);
        let take = |armed: &mut Armed| {
            armed.over = true;
            armed.fault.then
        };
        self.faults.iter_mut().filter(due).map(take).collect()
    }

    /// Returns how many cycles after this one have no fault.
    pub(crate) fn quiet_cycles(&self, cycle: u64) -> u64 {
        let waiting = self.faults.iter().filter(|armed| !armed.over);
        let next = waiting.filter_map(|armed| match armed.fault.when {
            Trigger::Cycle(n) if n > cycle => Some(n - cycle - 1),
            _ => None,
        });
        next.min().unwrap_or(u64::MAX)
    }

    pub(crate) fn lose_link(&mut self, time: Option<Duration>, now: Instant) {
        self.lost_until = time.map_or(Instant::FAR_FUTURE, |time| now.saturating_add(time));
    }

    /// Counts a call, and collects what happens at it.
    fn at_call(&mut self, request: &Request<'_>) -> Vec<Effect> {
        let mut effects = Vec::new();
        for armed in &mut self.faults {
            let Trigger::Call { which, of } = &armed.fault.when else { continue };
            if of.as_ref().is_some_and(|of| !is_of(request, of)) {
                continue;
            }
            armed.calls += 1;
            let happens = match *which {
                Which::Range(from, to) => (from..=to).contains(&armed.calls),
                Which::Every(n) => armed.calls.is_multiple_of(n),
                Which::Chance(p) => self.chance.f64() < p,
            };
            if happens {
                effects.push(armed.fault.then);
            }
        }
        effects
    }
}

/// Tells whether a request is of a function, or executes a command.
fn is_of(request: &Request<'_>, of: &str) -> bool {
    let executes = request.function.name().is_some_and(|name| name.ends_with("Execute"));
    let command = || request.text(1).to_string().trim().eq_ignore_ascii_case(of);
    FunctionId::parse(of) == Some(request.function) || (executes && command())
}

impl Controller {
    /// Plays a scenario from its beginning, instead of the one that was played: the controller is as its section
    /// `[controller]` says, and the faults happen as time passes.
    pub fn play(&mut self, scenario: Scenario) {
        self.set_up(&scenario.controller);
        self.scenario = Running::new(scenario);
    }

    /// Says what becomes of a reply's bytes on their way to a client, and changes them as the scenario wants it.
    ///
    /// It is to be asked about each frame once: the reply of a call, or `S_EXECUTING`.
    ///
    /// # Examples
    ///
    /// ```
    /// use bcap_core::handler::PeerId;
    /// use bcap_sim::scenario::Delivery;
    /// use bcap_sim::{Config, Controller};
    ///
    /// let mut controller = Controller::new(Config::default());
    /// let mut frame = *b"\x01\x10\0\0\0\x05\0\0\0\0\0\0\0\0\0\x04";
    /// assert_eq!(controller.deliver(PeerId(1), &mut frame), Delivery::Send);
    /// ```
    pub fn deliver(&mut self, peer: PeerId, frame: &mut [u8]) -> Delivery {
        if self.is_link_lost() {
            return Delivery::Drop;
        }
        let Some(fate) = self.fates.get(&peer).filter(|fate| fate.answered) else { return Delivery::Send };
        let (wire, lost) = (fate.wire, fate.lost);
        self.fates.remove(&peer);
        match wire {
            _ if lost => Delivery::Drop,
            None => Delivery::Send,
            Some(WireFault::Drop) => Delivery::Drop,
            Some(WireFault::Disconnect) => Delivery::Disconnect,
            Some(WireFault::WrongSerial) => {
                // far from those that a client uses at the same time
                frame.get_mut(6).into_iter().for_each(|high| *high ^= 0x40);
                Delivery::Send
            }
            Some(WireFault::Corrupt) => {
                let bit = self.scenario.chance.usize(..(frame.len() * 8).max(1));
                frame.get_mut(bit / 8).into_iter().for_each(|byte| *byte ^= 1 << (bit % 8));
                Delivery::Send
            }
        }
    }

    /// Tells whether nothing arrives now.
    pub(crate) fn is_link_lost(&self) -> bool {
        self.now < self.scenario.lost_until
    }

    /// Finds out what the scenario has in store for a new call.
    pub(crate) fn begin_fate(&mut self, peer: PeerId, request: &Request<'_>) {
        let mut fate = Fate::default();
        for effect in self.scenario.at_call(request) {
            match effect {
                Effect::Refuse(code) => fate.refused = Some(code),
                Effect::Delay(time) => fate.until = self.now.saturating_add(time),
                Effect::Wire(fault) => fate.wire = Some(fault),
                effect => self.happen(effect),
            }
        }
        fate.lost = self.is_link_lost();
        self.fates.insert(peer, fate);
    }

    /// Carries a call out, or goes on with it, as far as its fate lets it.
    pub(crate) fn meet_fate(&mut self, peer: PeerId, request: &Request<'_>, reply: &mut ReplyValue<'_>) -> Outcome {
        let fate = self.fates.get(&peer).cloned().unwrap_or_default();
        if fate.lost {
            return match self.is_link_lost() {
                true => Outcome::Wait(self.scenario.lost_until),
                false => self.answered(peer, HResult::E_TIMEOUT),
            };
        }
        if let Some((code, value)) = fate.answer {
            if self.now < fate.until {
                return Outcome::Wait(fate.until);
            }
            let fits = value.is_empty() || reply.set(&kept(&value)).is_ok();
            return self.answered(peer, if fits { code } else { HResult::E_TOO_MUCH_DATA });
        }
        let outcome = match fate.refused {
            Some(code) => Outcome::Done(self.refuse(code)),
            None => self.carry_out(peer, request, reply),
        };
        match outcome {
            Outcome::Done(code) if self.now < fate.until => {
                let value = reply.as_bytes().to_vec();
                reply.clear();
                if let Some(fate) = self.fates.get_mut(&peer) {
                    fate.answer = Some((code, value));
                }
                Outcome::Wait(fate.until)
            }
            Outcome::Done(code) => self.answered(peer, code),
            wait => wait,
        }
    }

    fn answered(&mut self, peer: PeerId, code: HResult) -> Outcome {
        match self.fates.get_mut(&peer) {
            Some(fate) if fate.lost || fate.wire.is_some() => fate.answered = true,
            // nothing happens to it any more
            _ => drop(self.fates.remove(&peer)),
        }
        Outcome::Done(code)
    }
}
