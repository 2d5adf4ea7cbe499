//! A running scenario: the faults to trigger, and the fault of each pending call.

use std::collections::BTreeMap;
use std::time::Duration;

use bcap_core::bcap::FunctionId;
use bcap_core::bcap::server::Request;
use bcap_core::handler::{Outcome, PeerId, ReplyValue};
use bcap_core::hresult::HResult;
use bcap_core::time::Instant;
use bcap_core::variant::OwnedVariant;

use super::{CallFilter, Delivery, Effect, Scenario, ScenarioFault, Trigger, WireFault};
use crate::command_name::command_of;

/// A scenario being played.
#[derive(Clone, Debug)]
pub(crate) struct Playback {
    faults: Vec<Armed>,
    chance: fastrand::Rng,
    /// When the link works again.
    lost_until: Instant,
    /// The fault of the pending call of each client.
    calls: BTreeMap<PeerId, CallFault>,
}

/// A fault and its progress.
#[derive(Clone, Debug)]
struct Armed {
    fault: ScenarioFault,
    /// The number of calls that it has counted.
    calls: u64,
    /// It does not occur again.
    over: bool,
}

/// The fault of a call and its answer.
#[derive(Clone, Debug, Default)]
struct CallFault {
    refused: Option<HResult>,
    wire: Option<WireFault>,
    /// The delay of the answer after the end of the call.
    delay: Duration,
    /// The link was lost when the call arrived: it is neither executed nor answered.
    lost: bool,
    /// The delayed answer, and its time.
    answer: Option<(Instant, HResult, Option<OwnedVariant>)>,
    /// The answer was made; [`deliver`](Playback::deliver) applies the fault.
    answered: bool,
}

impl Default for Playback {
    fn default() -> Self {
        Self::new(Scenario::default())
    }
}

impl Playback {
    fn new(scenario: Scenario) -> Self {
        let armed = |fault| Armed { fault, calls: 0, over: false };
        Self {
            faults: scenario.faults.into_iter().map(armed).collect(),
            chance: fastrand::Rng::with_seed(scenario.seed),
            lost_until: Instant::ZERO,
            calls: BTreeMap::new(),
        }
    }

    /// Starts another scenario. Pending calls keep their faults.
    pub(crate) fn play(&mut self, scenario: Scenario) {
        let calls = std::mem::take(&mut self.calls);
        *self = Self { calls, ..Self::new(scenario) };
    }

    /// Takes the earliest fault whose time has been reached.
    pub(crate) fn next_effect(&mut self, now: Instant) -> Option<(Instant, Effect)> {
        let waiting = self.faults.iter_mut().filter(|armed| !armed.over);
        let timed = waiting.filter_map(|armed| match armed.fault.when {
            Trigger::At(at) if at <= now => Some((at, armed)),
            _ => None,
        });
        let (at, armed) = timed.min_by_key(|(at, _)| *at)?;
        armed.over = true;
        Some((at, armed.fault.then.clone()))
    }

    /// Takes the faults of a cycle.
    pub(crate) fn at_cycle(&mut self, cycle: u64) -> Vec<Effect> {
        let is_met = |armed: &&mut Armed| !armed.over && armed.fault.when == Trigger::Cycle(cycle);
        let take = |armed: &mut Armed| {
            armed.over = true;
            armed.fault.then.clone()
        };
        self.faults.iter_mut().filter(is_met).map(take).collect()
    }

    /// Returns the number of cycles after this one that have no fault.
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

    /// Counts a call, and returns the effects of the faults that it meets.
    fn at_call(&mut self, request: &Request<'_>) -> Vec<Effect> {
        let mut effects = Vec::new();
        for armed in &mut self.faults {
            let Trigger::Call { filter, of } = &armed.fault.when else { continue };
            if of.as_ref().is_some_and(|of| !is_of(request, of)) {
                continue;
            }
            armed.calls += 1;
            let happens = match *filter {
                CallFilter::Range(from, to) => (from..=to).contains(&armed.calls),
                CallFilter::Every(n) => armed.calls.is_multiple_of(n),
                CallFilter::Chance(p) => self.chance.f64() < p,
            };
            if happens {
                effects.push(armed.fault.then.clone());
            }
        }
        effects
    }

    /// Starts a call. Returns the effects on the controller itself, to be applied before the call is executed.
    pub(crate) fn begin_call(&mut self, peer: PeerId, request: &Request<'_>, now: Instant) -> Vec<Effect> {
        let mut fault = CallFault::default();
        let mut others = Vec::new();
        for effect in self.at_call(request) {
            match effect {
                Effect::Refuse(code) => fault.refused = Some(code),
                Effect::Delay(time) => fault.delay = fault.delay.saturating_add(time),
                Effect::Wire(wire) => fault.wire = Some(wire),
                Effect::LinkLoss(time) => self.lose_link(time, now),
                effect => others.push(effect),
            }
        }
        fault.lost = self.is_link_lost(now);
        self.calls.insert(peer, fault);
        others
    }

    /// Returns the treatment of a call that is new or waits.
    pub(crate) fn call_plan(&mut self, peer: PeerId, now: Instant) -> CallPlan {
        let Some(fault) = self.calls.get(&peer) else { return CallPlan::Execute };
        if fault.lost {
            return match self.is_link_lost(now) {
                true => CallPlan::Wait(self.lost_until),
                false => self.answer(peer, HResult::E_TIMEOUT, None),
            };
        }
        match (&fault.answer, fault.refused) {
            (Some((until, ..)), _) if now < *until => CallPlan::Wait(*until),
            (Some((_, code, value)), _) => {
                let (code, value) = (*code, value.clone());
                self.answer(peer, code, value)
            }
            (None, Some(code)) => CallPlan::Refuse(code),
            (None, None) => CallPlan::Execute,
        }
    }

    fn answer(&mut self, peer: PeerId, code: HResult, value: Option<OwnedVariant>) -> CallPlan {
        self.answered(peer);
        CallPlan::Answer(code, value)
    }

    /// Ends a call that was executed or refused. Its fault may delay the answer.
    pub(crate) fn end_call(
        &mut self,
        peer: PeerId,
        outcome: Outcome,
        reply: &mut ReplyValue<'_>,
        now: Instant,
    ) -> Outcome {
        let Outcome::Done(code) = outcome else { return outcome };
        match self.calls.get_mut(&peer) {
            Some(fault) if !fault.delay.is_zero() => {
                let until = now.saturating_add(fault.delay);
                fault.answer = Some((until, code, reply.get().map(OwnedVariant::from)));
                reply.clear();
                Outcome::Wait(until)
            }
            _ => {
                self.answered(peer);
                outcome
            }
        }
    }

    /// Records that the answer of a call was made.
    fn answered(&mut self, peer: PeerId) {
        match self.calls.get_mut(&peer) {
            Some(fault) if fault.lost || fault.wire.is_some() => fault.answered = true,
            // no further fault applies to it
            _ => self.forget(peer),
        }
    }

    /// Drops the fault of an abandoned call, or of a call whose client has disconnected.
    pub(crate) fn forget(&mut self, peer: PeerId) {
        self.calls.remove(&peer);
    }

    /// Applies the fault of a call to the bytes of its answer.
    pub(crate) fn deliver(&mut self, peer: PeerId, frame: &mut [u8], now: Instant) -> Delivery {
        if self.is_link_lost(now) {
            return Delivery::Drop;
        }
        let Some(fault) = self.calls.get(&peer).filter(|fault| fault.answered) else { return Delivery::Send };
        let (wire, lost) = (fault.wire, fault.lost);
        self.forget(peer);
        match wire {
            _ if lost => Delivery::Drop,
            None => Delivery::Send,
            Some(WireFault::Drop) => Delivery::Drop,
            Some(WireFault::Disconnect) => Delivery::Disconnect,
            Some(WireFault::WrongSerial) => {
                // far from the serials that a client uses at the same time
                frame.get_mut(6).into_iter().for_each(|high| *high ^= 0x40);
                Delivery::Send
            }
            Some(WireFault::Corrupt) => {
                let bit = self.chance.usize(..(frame.len() * 8).max(1));
                frame.get_mut(bit / 8).into_iter().for_each(|byte| *byte ^= 1 << (bit % 8));
                Delivery::Send
            }
        }
    }

    pub(crate) fn is_link_lost(&self, now: Instant) -> bool {
        now < self.lost_until
    }
}

/// The treatment of a call.
#[derive(Debug)]
pub(crate) enum CallPlan {
    /// Poll it again at this time.
    Wait(Instant),
    /// Answer it with this code and this value.
    Answer(HResult, Option<OwnedVariant>),
    /// Refuse it with this code.
    Refuse(HResult),
    Execute,
}

/// Returns whether a request is for a function, or executes a command.
fn is_of(request: &Request<'_>, of: &str) -> bool {
    FunctionId::parse(of) == Some(request.function)
        || command_of(request).is_some_and(|command| command.eq_ignore_ascii_case(of))
}
