//! Scenarios: faults that happen by themselves, each time at the same places.
//!
//! ```toml
//! seed = 7                                        # of everything that is left to chance; 0 unless given
//!
//! [[fault]]
//! when = { call = 3, of = "slvMove" }             # the third slvMove
//! then = { refuse = "E_BUF_FULL" }
//!
//! [[fault]]
//! when = { chance = 0.01 }                        # one in a hundred calls
//! then = "drop"
//!
//! [[fault]]
//! when = { cycle = 250 }                          # two seconds after slave mode was entered
//! then = { error = "0x84204043" }
//! ```
//!
//! | `when`            | it happens                                                                             |
//! |-------------------|----------------------------------------------------------------------------------------|
//! | `call = n`        | at the n-th call, from 1; with `to = m` at each up to the m-th                         |
//! | `every = n`       | at every n-th call                                                                     |
//! | `chance = p`      | at a call with the probability p, 0 to 1                                               |
//! | `cycle = n`       | when the n-th cycle of slave mode begins, counted from entering it; once               |
//! | `at_ms = t`       | at the time t of the controller's clock, in milliseconds; once                         |
//!
//! Calls are counted of all clients, each repetition that the link asks for as the one call it is. `of` counts those of
//! one function (`"Robot_Move"`) or one command (`"slvMove"`) only.
//!
//! | `then`                  | what happens                                                                     |
//! |-------------------------|----------------------------------------------------------------------------------|
//! | `{ refuse = code }`     | the call is not carried out, and answered with this code; only calls             |
//! | `{ delay_ms = t }`      | the call is carried out, and answered that much later; only calls                |
//! | `"drop"`                | the answer is lost on the wire; only calls                                       |
//! | `"wrong_serial"`        | the answer has another serial; only calls                                        |
//! | `"corrupt"`             | one bit of the answer is wrong, by chance any; only calls                        |
//! | `"disconnect"`          | the connection is closed instead of the answer; only calls                       |
//! | `{ error = code }`      | an error of the controller occurs; at a call, before it is carried out           |
//! | `{ emergency_stop = b }`| the emergency stop is pressed (true) or released (false)                         |
//! | `{ link_loss_ms = t }`  | for this time nothing arrives and nothing is answered; 0 is for good             |
//!
//! A code is a name or a number: `"E_BUF_FULL"`, `"0x83201483"`. `bcap sim --scenario FILE` plays a file.
//!
//! # On the wire
//!
//! The controller has no wire. Whoever moves its replies asks [`Controller::deliver`] about each one, with its bytes:
//! it says whether they go out, and changes them where the scenario wants that. Without being asked, `"drop"`,
//! `"wrong_serial"`, `"corrupt"` and `"disconnect"` have no effect; during a link loss calls are not carried out and
//! not answered in any case.

use std::time::Duration;

use bcap_core::bcap::FunctionId;
use bcap_core::bcap::server::Request;
use bcap_core::handler::{Outcome, PeerId, ReplyValue};
use bcap_core::hresult::HResult;
use bcap_core::time::Instant;
use serde::Deserialize;

use crate::controller::Controller;
use crate::value::{keep, kept};

/// A list of faults.
///
/// # Examples
///
/// ```
/// use bcap_core::hresult::HResult;
/// use bcap_core::time::Instant;
/// use bcap_sim::{Config, Controller, Scenario};
///
/// let scenario = Scenario::parse(
///     r#"
///     [[fault]]
///     when = { at_ms = 40 }
///     then = { error = "E_COMMAND_BUFFER_EMPTY" }
///     "#,
/// )?;
/// let mut controller = Controller::new(Config::default());
/// controller.play(scenario);
/// controller.advance(Instant::from_millis(100));
/// let error = controller.errors().next().map(|error| (error.code, error.at));
/// assert_eq!(error, Some((HResult::E_COMMAND_BUFFER_EMPTY, Instant::from_millis(40))));
/// # Ok::<(), bcap_sim::scenario::ScenarioError>(())
/// ```
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Scenario {
    /// The seed of what is left to chance.
    pub seed: u64,
    /// The faults; of several that one call has met, all happen, in this order.
    pub faults: Vec<Fault>,
}

/// A fault: when it happens, and what does.
#[derive(Clone, Debug, PartialEq)]
pub struct Fault {
    /// When.
    pub when: Trigger,
    /// What.
    pub then: Effect,
}

/// When a fault happens.
#[derive(Clone, Debug, PartialEq)]
pub enum Trigger {
    /// At calls.
    Call {
        /// Which of those that are counted.
        which: Which,
        /// The function or the command that is counted; `None` counts all.
        of: Option<String>,
    },
    /// When this cycle of slave mode begins, from 1.
    Cycle(u64),
    /// At this time.
    At(Instant),
}

/// At which calls a fault happens, counted from 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Which {
    /// From the first to the last of these.
    Range(u64, u64),
    /// Every n-th.
    Every(u64),
    /// Any, with this probability.
    Chance(f64),
}

/// What happens.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Effect {
    /// The call is not carried out, and answered with this code.
    Refuse(HResult),
    /// The answer comes so much later.
    Delay(Duration),
    /// The answer suffers on the wire.
    Wire(WireFault),
    /// An error of the controller.
    Error(HResult),
    /// The emergency stop is pressed or released.
    EmergencyStop(bool),
    /// The link is lost for a time, or for good.
    LinkLoss(Option<Duration>),
}

/// What happens to an answer on its way.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum WireFault {
    /// It is lost.
    Drop,
    /// Its serial is another.
    WrongSerial,
    /// One of its bits is wrong.
    Corrupt,
    /// The connection is closed in its place.
    Disconnect,
}

/// What is to be done with the bytes of a reply.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[must_use]
pub enum Delivery {
    /// They are to be sent.
    Send,
    /// They are not.
    Drop,
    /// They are not, and the connection is to be closed.
    Disconnect,
}

/// Why a text is no scenario.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ScenarioError {
    /// It is not the TOML that is expected; the message says where.
    #[error("{0}")]
    Toml(#[from] toml::de::Error),
    /// A fault does not make sense.
    #[error("fault {number}: {problem}")]
    Fault {
        /// Its number in the file, from 1.
        number: usize,
        /// What is wrong, and what would be right.
        problem: &'static str,
    },
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    #[serde(default)]
    seed: u64,
    #[serde(default)]
    fault: Vec<FaultEntry>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct FaultEntry {
    when: WhenEntry,
    then: ThenEntry,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct WhenEntry {
    call: Option<u64>,
    to: Option<u64>,
    every: Option<u64>,
    chance: Option<f64>,
    cycle: Option<u64>,
    at_ms: Option<u64>,
    of: Option<String>,
}

#[derive(Deserialize)]
#[serde(rename_all = "snake_case")]
enum ThenEntry {
    Refuse(String),
    DelayMs(u64),
    Drop,
    WrongSerial,
    Corrupt,
    Disconnect,
    Error(String),
    EmergencyStop(bool),
    LinkLossMs(u64),
}

impl Scenario {
    /// Reads a scenario from TOML.
    ///
    /// # Errors
    ///
    /// A [`ScenarioError`] that says where the text is wrong.
    pub fn parse(text: &str) -> Result<Self, ScenarioError> {
        let file: File = toml::from_str(text)?;
        let faults = file
            .fault
            .into_iter()
            .enumerate()
            .map(|(n, entry)| entry.read().map_err(|problem| ScenarioError::Fault { number: n + 1, problem }));
        Ok(Self { seed: file.seed, faults: faults.collect::<Result<_, _>>()? })
    }
}

impl FaultEntry {
    fn read(self) -> Result<Fault, &'static str> {
        let (when, then) = (self.when.read()?, self.then.read()?);
        let of_calls = matches!(then, Effect::Refuse(_) | Effect::Delay(_) | Effect::Wire(_));
        if of_calls && !matches!(when, Trigger::Call { .. }) {
            return Err("what concerns the answer of a call needs `when` to be call, every or chance");
        }
        Ok(Fault { when, then })
    }
}

impl WhenEntry {
    fn read(self) -> Result<Trigger, &'static str> {
        if self.to.is_some() && self.call.is_none() {
            return Err("`to` is the end of a range that `call` begins");
        }
        let which = match (self.call, self.every, self.chance, self.cycle, self.at_ms) {
            (Some(call), None, None, None, None) => Which::Range(call, self.to.unwrap_or(call)),
            (None, Some(every), None, None, None) => Which::Every(every),
            (None, None, Some(chance), None, None) => Which::Chance(chance),
            (None, None, None, Some(_), None) | (None, None, None, None, Some(_)) if self.of.is_some() => {
                return Err("`of` says what calls are counted; it goes with call, every or chance");
            }
            (None, None, None, Some(0), None) => return Err("cycles are counted from 1"),
            (None, None, None, Some(cycle), None) => return Ok(Trigger::Cycle(cycle)),
            (None, None, None, None, Some(at)) => {
                return Ok(Trigger::At(Instant::ZERO.saturating_add(Duration::from_millis(at))));
            }
            _ => return Err("`when` needs exactly one of call, every, chance, cycle and at_ms"),
        };
        match which {
            Which::Range(from, to) if from == 0 || to < from => Err("calls are counted from 1, and `to` is not before"),
            Which::Every(0) => Err("`every` is 1 or more"),
            Which::Chance(p) if !(0.0..=1.0).contains(&p) => Err("`chance` is 0 to 1"),
            which => Ok(Trigger::Call { which, of: self.of }),
        }
    }
}

impl ThenEntry {
    fn read(self) -> Result<Effect, &'static str> {
        Ok(match self {
            Self::Refuse(code) => Effect::Refuse(read_code(&code)?),
            Self::Error(code) => Effect::Error(read_code(&code)?),
            Self::DelayMs(millis) => Effect::Delay(Duration::from_millis(millis)),
            Self::Drop => Effect::Wire(WireFault::Drop),
            Self::WrongSerial => Effect::Wire(WireFault::WrongSerial),
            Self::Corrupt => Effect::Wire(WireFault::Corrupt),
            Self::Disconnect => Effect::Wire(WireFault::Disconnect),
            Self::EmergencyStop(pressed) => Effect::EmergencyStop(pressed),
            Self::LinkLossMs(0) => Effect::LinkLoss(None),
            Self::LinkLossMs(millis) => Effect::LinkLoss(Some(Duration::from_millis(millis))),
        })
    }
}

fn read_code(text: &str) -> Result<HResult, &'static str> {
    let number = |digits: &str| u32::from_str_radix(digits, 16).ok().map(HResult::from_u32);
    let code = match text.strip_prefix("0x").or_else(|| text.strip_prefix("0X")) {
        Some(digits) => number(digits),
        None => HResult::from_name(text),
    };
    code.ok_or("a code is a known name or eight hexadecimal digits, as in \"E_BUF_FULL\" or \"0x83201483\"")
}

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
                let value = reply.get().and_then(|value| keep(&value).ok()).unwrap_or_default();
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
