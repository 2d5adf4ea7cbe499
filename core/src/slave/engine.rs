//! The engine: a stream of poses as a sans-IO state machine.
//!
//! ```text
//!              poll ──► Call ──► make request() over its channel ──► handle_reply, or handle_failure ──┐
//!               ▲  ├──► Pose ──► push, or stop ─────────────────────────────────────────────────────────┤
//!               │  └──► Wait ──► until then ────────────────────────────────────────────────────────────┤
//!               └───────────────────────────────────────────────────────────────────────────────────────┘
//!                  ──► Finished, Faulted
//!
//!  Starting ─► Streaming ─► Leaving ─► Finished         stop(), finish(): the last pose is repeated
//!     │  ▲         │           │
//!     ▼  │         ▼           ▼
//!  Diagnosing ─► Faulted ─► (recover()) ─► Recovering ─► Starting
//! ```
//!
//! Guarantees:
//!
//! * The engine never sends a pose that exceeds the limits, has another layout, or is not finite.
//! * After an error it sends no pose: it queries the controller, and leaves Slave Mode if it is on.
//! * It sends no call that starts or ends anything while a stream of Slave Mode runs that it has not started.
//! * Only [`Engine::recover`] clears the error list and switches the motor on again, and never after an emergency stop.
//! * It switches the motor off that it has switched on, unless [`Config::motor_off`] is unset, and before it gives the arm
//!   back.

mod diagnosis;
mod motion;
mod release;
mod start;

use core::time::Duration;

use super::call::{EngineCall, Step};
use super::command::{MOVE_FRAME, Outputs, PreparedMove};
use super::config::{Config, ConfigError};
use super::fault::{Cause, Fault, RecoverError, Released};
use super::format::FormatError;
use super::limits::{self, PoseError, Velocity};
use super::mode::Mode;
use super::pacer::Pacer;
use super::pose::{Delta, Pose};
use super::reply::MoveReply;
use super::stats::Stats;
use crate::bcap::client::Timing;
use crate::bcap::{Frame, Link, StreamState};
use crate::procedure::{Channel, Effects, Failure};
use crate::time::Instant;
use crate::variant::Variant;

/// The next action of an engine.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[must_use]
pub enum EngineAction {
    /// Make the call of [`Engine::request`], and pass in its reply or failure. Until then, this action is repeated.
    Call(Step, Channel),
    /// [`push`](Engine::push) a pose, or end with [`stop`](Engine::stop) or [`finish`](Engine::finish).
    Pose {
        /// When it will be sent; a pose that is pushed later makes the cycle late.
        deadline: Instant,
    },
    /// Poll again at this time.
    Wait(Instant),
    /// The robot is at rest, Slave Mode and the motor are off, and the arm is given back.
    Finished,
    /// The stream failed; [`Engine::fault`] says why. Slave Mode was left if that was possible.
    Faulted,
}

/// The phase of a stream.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Phase {
    Starting,
    Streaming,
    Leaving,
    Diagnosing,
    Recovering,
    Finished,
    Faulted,
}

/// The state of a connection; a reply makes it good again.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Health {
    Good,
    /// The last call timed out.
    Silent,
    Lost,
}

/// An orderly stop in progress.
#[derive(Clone, Copy, Debug)]
struct Stop {
    /// The step of the cycle in which the stop began.
    delta: Delta,
    /// The current fraction of that step, and by how much it shrinks every cycle.
    speed: f64,
    part: f64,
    /// Number of repeats of the last pose, and of replies in a row without motion.
    repeats: u16,
    still: u8,
}

/// The bit of SysState for the emergency stop.
const EMERGENCY_STOP: i32 = 1 << 10;
/// The maximum number of values of a received pose: T+J.
const RECEIVED_MAX: usize = 18;

/// A stream of Slave Mode; `N` is the size of the buffer for the frame of slvMove, in bytes.
///
/// # Examples
///
/// A loop that runs a stream; `call` makes a call, and `sleep_until` waits:
///
/// ```no_run
/// # use bcap_core::bcap::Frame;
/// # use bcap_core::bcap::call::{Call, ControllerHandle, RobotHandle};
/// # use bcap_core::slave::*;
/// # use bcap_core::time::Instant;
/// # fn now() -> Instant { Instant::ZERO }
/// # fn sleep_until(_: Instant) {}
/// # fn call<'a>(_: impl Call, _: Channel) -> Result<Frame<'a>, Failure> { Err(Failure::Lost) }
/// # let handles = Handles { controller: ControllerHandle(1), robot: RobotHandle(2) };
/// let mode = SlaveMode { mode: Mode::Mode2, pose: PoseType::J };
/// let format = Format::new(mode, ReceiveFormat::pose(ReceivePose::J));
/// let config = Config { limits: AxisLimits::uniform(100.0, 800.0), ..Config::new(format, handles) };
/// let mut engine = Engine::<256>::new(config)?;
/// let mut cycle = 0_u32;
/// loop {
///     match engine.poll(now()) {
///         EngineAction::Call(..) => {
///             let Some(request) = engine.request() else { continue };
///             match call(&request, request.channel()) {
///                 Ok(reply) => {
///                     let moved = engine.handle_reply(&reply, now());
///                     # let _ = moved;
///                 }
///                 Err(failure) => engine.handle_failure(failure, now()),
///             }
///         }
///         EngineAction::Pose { .. } if cycle == 500 => engine.stop(),
///         EngineAction::Pose { .. } => {
///             // one degree per second about the first joint, from the current position
///             let mut joints = engine.start_pose().map_or([0.0; 8], |p| p.numbers().try_into().unwrap_or_default());
///             joints[0] += f64::from(cycle) * 0.008;
///             engine.push(&Pose::j(joints))?;
///             cycle += 1;
///         }
///         EngineAction::Wait(until) => sleep_until(until),
///         EngineAction::Finished => break,
///         EngineAction::Faulted => return Err(engine.fault().cloned().ok_or("no fault")?.into()),
///     }
/// }
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug)]
pub struct Engine<const N: usize = MOVE_FRAME> {
    config: Config,
    frame: PreparedMove<N>,
    phase: Phase,
    /// The call that is in flight, or the next call.
    step: Step,
    channel: Channel,
    in_flight: bool,
    sent_at: Instant,
    motion: Health,
    watch: Health,
    has_arm: bool,
    /// Whether this engine may have switched the motor on, and whether its poses may move the robot.
    has_motor: bool,
    may_move: bool,
    /// Whether this engine may have entered Slave Mode, so that it must leave it.
    may_be_in_mode: bool,
    /// Whether this is a start after a fault, which accepts any position of the robot.
    restarted: bool,
    /// Whether `stop` was called while starting or recovering.
    stop_wanted: bool,
    stop: Option<Stop>,
    /// Whether the engine ends after a fault, and the first of its steps that failed at the end.
    gives_up: bool,
    unreleased: Option<(Step, Cause)>,
    /// Until when a step of the end is repeated, after the controller was busy with an abandoned call.
    busy_until: Option<Instant>,
    /// The start of the stream, in the layout of the format.
    start: Option<Pose>,
    /// The last pose in the frame, and its step and speed.
    last: Pose,
    delta: Delta,
    velocity: Velocity,
    pacer: Pacer,
    /// The pose in the last reply.
    received: Option<[f64; RECEIVED_MAX]>,
    fault: Option<Fault>,
    /// The index of the next error to read.
    error_index: i32,
    stats: Stats,
}

impl<const N: usize> Engine<N> {
    /// Creates an engine; the first [`poll`](Self::poll) starts Slave Mode.
    ///
    /// # Errors
    ///
    /// When the configuration is inconsistent, or the frame does not fit `N` bytes.
    pub fn new(config: Config) -> Result<Self, ConfigError> {
        let (expected, frame) = (config.format.layout(), PreparedMove::new(config.motion.robot, &config.format));
        if let Some(found) = config.start.map(|pose| pose.layout()).filter(|found| *found != expected) {
            return Err(ConfigError::Start(FormatError::Layout { expected, found }));
        }
        if config.cycle < Duration::from_micros(1) {
            return Err(ConfigError::Cycle);
        }
        if !config.has_numbers() {
            return Err(ConfigError::Number);
        }
        Ok(Self {
            config,
            frame: frame.map_err(ConfigError::Frame)?,
            phase: Phase::Starting,
            step: Step::GetMode,
            channel: Channel::Motion,
            in_flight: false,
            sent_at: Instant::ZERO,
            motion: Health::Good,
            watch: if config.watch.is_some() { Health::Good } else { Health::Lost },
            has_arm: false,
            has_motor: false,
            may_move: false,
            may_be_in_mode: false,
            restarted: false,
            stop_wanted: false,
            stop: None,
            gives_up: false,
            unreleased: None,
            busy_until: None,
            start: None,
            last: Pose::zero(expected),
            delta: Delta::ZERO,
            velocity: [0.0; 8],
            pacer: Pacer::new(Instant::ZERO),
            received: None,
            fault: None,
            error_index: 0,
            stats: Stats::default(),
        })
    }

    /// Returns the next action. If it is a call, `now` is the time of sending.
    pub fn poll(&mut self, now: Instant) -> EngineAction {
        if !self.in_flight {
            match self.phase {
                Phase::Finished => return EngineAction::Finished,
                Phase::Faulted => return EngineAction::Faulted,
                Phase::Streaming => {
                    if let Some(action) = self.pace(now) {
                        return action;
                    }
                }
                Phase::Leaving => {
                    if let Some(again) = self.again_at().filter(|again| now < *again) {
                        return EngineAction::Wait(again);
                    }
                }
                Phase::Starting | Phase::Diagnosing | Phase::Recovering => {}
            }
            self.in_flight = true;
            self.sent_at = now;
            self.channel = self.channel_for(self.step).unwrap_or(Channel::Motion);
        }
        EngineAction::Call(self.step, self.channel)
    }

    /// Returns the call in flight, which [`poll`](Self::poll) has requested; `None` when no call is in flight.
    #[must_use]
    #[inline]
    pub fn request(&self) -> Option<EngineCall<'_>> {
        self.in_flight.then(|| EngineCall {
            step: self.step,
            channel: self.channel,
            handles: match self.channel {
                Channel::Motion => self.config.motion,
                Channel::Watch => self.config.watch.unwrap_or(self.config.motion),
            },
            config: &self.config,
            slv_move: self.frame.view(),
            index: self.error_index,
        })
    }

    /// Handles the reply to the call, including an error code; returns the reply to a slvMove that succeeded.
    pub fn handle_reply<'a>(&mut self, reply: &Frame<'a>, now: Instant) -> Option<MoveReply<'a>> {
        if !core::mem::take(&mut self.in_flight) {
            return None;
        }
        *self.health(self.channel) = Health::Good;
        let (code, value) = (reply.hresult(), reply.value().unwrap_or(Variant::Empty));
        match self.phase {
            Phase::Streaming => return self.handle_move(code, value, now),
            Phase::Starting => self.handle_start(code, value, now),
            Phase::Leaving => self.handle_leave(code, now),
            Phase::Diagnosing => self.handle_diagnosis(code, value),
            Phase::Recovering => self.handle_recovery(code, value),
            Phase::Finished | Phase::Faulted => {}
        }
        None
    }

    /// Records that the call has no reply.
    ///
    /// An abandoned call counts as one that timed out: the controller may have executed it.
    pub fn handle_failure(&mut self, failure: Failure, _now: Instant) {
        if !core::mem::take(&mut self.in_flight) {
            return;
        }
        let health = self.health(self.channel);
        *health = match (failure, *health) {
            (Failure::NotSent, before) => before,
            (Failure::Timeout, Health::Good) => Health::Silent,
            (Failure::Timeout | Failure::Lost | Failure::Closed, _) => Health::Lost,
        };
        if failure != Failure::NotSent {
            self.record_unsure();
        }
        match self.phase {
            Phase::Diagnosing => self.skip_diagnosis(failure),
            Phase::Leaving if self.gives_up => self.keep_unreleased(Cause::Failed(failure)),
            _ => self.fail(Cause::Failed(failure)),
        }
    }

    /// Records the effect of a call that may have been executed.
    fn record_unsure(&mut self) {
        self.has_arm |= self.step == Step::TakeArm;
        self.has_motor |= self.step == Step::Motor;
        self.may_be_in_mode |= self.step == Step::Enter;
    }

    /// Sets the next pose, after [`EngineAction::Pose`].
    ///
    /// # Errors
    ///
    /// When the pose is invalid or exceeds the limits. The engine is unchanged, and another pose can be pushed.
    pub fn push(&mut self, pose: &Pose) -> Result<(), PoseError> {
        let asked = self.phase == Phase::Streaming && !self.pacer.loaded && !self.in_flight && self.stop.is_none();
        if !asked {
            return Err(PoseError::NotNow);
        }
        let (expected, found) = (self.config.format.layout(), pose.layout());
        if expected != found {
            return Err(FormatError::Layout { expected, found }.into());
        }
        let velocity = limits::check(&self.config.limits, self.config.seconds(), &self.last, &self.velocity, pose)?;
        self.delta = pose.since(&self.last);
        self.velocity = velocity;
        self.load(*pose)
    }

    /// Sets the bits of MiniIO for the next pose and those after it.
    ///
    /// # Errors
    ///
    /// When the format does not send them.
    pub fn set_mini_io(&mut self, bits: i32) -> Result<(), FormatError> {
        self.frame.set_mini_io(bits)
    }

    /// Sets the bits of HandIO for the next pose and those after it.
    ///
    /// # Errors
    ///
    /// When the format does not send them.
    pub fn set_hand_io(&mut self, bits: i32) -> Result<(), FormatError> {
        self.frame.set_hand_io(bits)
    }

    /// Sets the bytes of user IO for the next pose and those after it.
    ///
    /// # Errors
    ///
    /// When the format does not send user IO, or sends another number of bytes.
    pub fn set_user_io(&mut self, bytes: &[u8]) -> Result<(), FormatError> {
        self.frame.set_user_io(bytes)
    }

    /// Sets those outputs that the format sends, for the next pose and those after it.
    ///
    /// # Errors
    ///
    /// When the user IO has another number of bytes than the format's.
    pub fn set_outputs(&mut self, outputs: Outputs<'_>) -> Result<(), FormatError> {
        self.frame.set_outputs(outputs)
    }

    /// Ends a stream in motion.
    ///
    /// The robot slows down along its current direction, within the limits and for at least [`Config::ramp`]. Then the engine
    /// repeats the last pose until the robot is at rest, leaves Slave Mode, switches the motor off that it has switched on, and
    /// gives the arm back. After a fault it leaves Slave Mode if it may still be on, halts the robot if it may move, and
    /// releases the motor and the arm.
    pub fn stop(&mut self) {
        self.end(self.config.ramp);
    }

    /// Ends a stream at its last pose, for a trajectory that ends at rest.
    ///
    /// It differs from [`stop`](Self::stop) in that the robot slows down beyond the last pose only if the limits do not allow
    /// it to stop there.
    pub fn finish(&mut self) {
        self.end(Duration::ZERO);
    }

    fn end(&mut self, ramp: Duration) {
        match self.phase {
            Phase::Starting | Phase::Recovering => self.stop_wanted = true,
            Phase::Streaming if self.stop.is_none() => self.begin_stop(ramp),
            Phase::Faulted => {
                self.gives_up = true;
                self.release(None);
            }
            _ => {}
        }
    }

    /// Restarts after a fault: clears the controller's errors, switches the motor on and enters Slave Mode.
    ///
    /// The stream begins at the current position, not at [`Config::start`]. Before the engine clears the errors, it queries
    /// whether a stream of another client runs, and again whether the emergency stop is pressed. Either ends the recovery with
    /// a fault.
    ///
    /// # Errors
    ///
    /// When there is no fault, the connection is lost, or the emergency stop was seen pressed ([`Fault::emergency_stop`]).
    pub fn recover(&mut self) -> Result<(), RecoverError> {
        let fault = self.fault.as_ref().filter(|_| self.phase == Phase::Faulted).ok_or(RecoverError::NoFault)?;
        if fault.emergency_stop == Some(true) {
            return Err(RecoverError::EmergencyStop);
        }
        if self.motion == Health::Lost {
            return Err(RecoverError::Lost);
        }
        self.phase = Phase::Recovering;
        self.step = Step::GetMode;
        self.stop_wanted = false;
        self.gives_up = false;
        Ok(())
    }

    /// Returns the effects that this engine may have left on the robot, for [`reclaim`](crate::procedure::reclaim) over another
    /// connection. The claim to the arm is unknown.
    #[must_use]
    pub fn effects(&self) -> Effects {
        Effects {
            moving: self.may_move,
            streaming: self.may_be_in_mode,
            motor: self.has_motor && self.config.motor_off,
            ..Effects::default()
        }
    }

    /// Returns the fault that ended the stream; it is complete after [`EngineAction::Faulted`].
    #[must_use]
    pub const fn fault(&self) -> Option<&Fault> {
        self.fault.as_ref()
    }

    /// Returns the start of the stream: [`Config::start`], or else the position of the robot; `None` until it is known.
    #[must_use]
    pub const fn start_pose(&self) -> Option<&Pose> {
        self.start.as_ref()
    }

    /// Returns the last pose, pushed or computed by a stop; before the first pose, the start.
    #[must_use]
    pub const fn last_pose(&self) -> &Pose {
        &self.last
    }

    /// Returns the statistics of the stream, which continue after a recovery.
    #[must_use]
    pub const fn stats(&self) -> &Stats {
        &self.stats
    }

    /// Returns an estimate of how long the controller's buffer will last; `None` in mode 1.
    #[must_use]
    pub fn margin(&self, now: Instant) -> Option<Duration> {
        self.pacer.margin(now)
    }

    /// Returns the timing of the current call. On a lossy link, an attempt of a slvMove waits for two cycles in mode 2, where
    /// the controller may delay its reply, and for one cycle in the other modes.
    #[must_use]
    pub fn timing(&self, link: Link, usual: Timing) -> Timing {
        if self.phase != Phase::Streaming || !link.is_lossy() {
            return usual;
        }
        let cycles = if self.config.format.mode.mode == Mode::Mode2 { 2 } else { 1 };
        Timing { attempt_timeout: self.config.cycles(cycles), ..usual }
    }

    /// Returns the configuration.
    #[must_use]
    pub const fn config(&self) -> &Config {
        &self.config
    }

    const fn health(&mut self, channel: Channel) -> &mut Health {
        match channel {
            Channel::Motion => &mut self.motion,
            Channel::Watch => &mut self.watch,
        }
    }

    /// Returns the best connection for a call; `None` when all of them are lost.
    fn channel_for(&self, step: Step) -> Option<Channel> {
        let (motion, watch) = ((Channel::Motion, self.motion), (Channel::Watch, self.watch));
        let [first, second] = match step {
            Step::ErrorCount | Step::ErrorInfo | Step::SystemState => [watch, motion],
            // the first connection owns the arm; the second is used if the first is lost
            Step::GetMode | Step::Leave => [motion, watch],
            _ => return (self.motion != Health::Lost).then_some(Channel::Motion),
        };
        [Health::Good, Health::Silent]
            .iter()
            .find_map(|wanted| [first, second].iter().find(|(_, health)| health == wanted).map(|(channel, _)| *channel))
    }

    /// Ends the phase because the current step failed, and starts the diagnosis.
    fn fail(&mut self, cause: Cause) {
        self.stop = None;
        self.pacer.loaded = false;
        let (released, is_known) = match cause {
            Cause::NotAtStart { .. } | Cause::EmergencyStop => (Released::Yes, true),
            Cause::Occupied(StreamState::Runs) => (Released::No, true),
            Cause::Occupied(_) => (Released::Unknown, true),
            _ => (Released::Unknown, false),
        };
        let mut fault = Fault::new(self.step, cause, released);
        if cause == Cause::EmergencyStop {
            fault.emergency_stop = Some(true);
        }
        self.fault = Some(fault);
        if is_known {
            self.phase = Phase::Faulted;
        } else {
            self.phase = Phase::Diagnosing;
            self.diagnose(Step::GetMode);
        }
    }
}
