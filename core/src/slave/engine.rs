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
//! * It starts nothing, and ends nothing, while a stream of Slave Mode runs that it has not started.
//! * Only [`Engine::recover`] clears the error list and switches the motor on again, and never after an emergency stop.
//! * It switches the motor off that it has switched on, unless [`Config::motor_off`] is unset, and before it gives the arm back.

use core::time::Duration;

use super::command::{MOVE_FRAME, Outputs, PreparedMove};
use super::config::{Config, ConfigError};
use super::fault::{Cause, ControllerError, ERRORS_MAX, Fault, RecoverError, Released};
use super::format::FormatError;
use super::limits::{self, PoseError, Velocity};
use super::mode::{Mode, PoseType};
use super::pacer::Pacer;
use super::pose::{Delta, ExtendedAxes, Pose, half_turn};
use super::reply::MoveReply;
use super::request::{Request, Step};
use super::stats::Stats;
use crate::bcap::client::Timing;
use crate::bcap::{Frame, Link, Properties, StreamState};
use crate::hresult::HResult;
use crate::procedure::{Channel, Effects, Failure};
use crate::time::{Instant, micros_u32};
use crate::variant::Variant;

/// The next action of an engine.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[must_use]
pub enum Action {
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
    /// How often the last pose was repeated, and the number of replies in a row without motion.
    repeats: u16,
    still: u8,
}

/// The minimum number of repeats of the last pose: enough to empty the buffer, and two more.
const REPEATS_MIN: u16 = 5;
/// The number of repeats after which the stop no longer waits for the robot.
const REPEATS_MAX: u16 = 250;
/// The number of replies in a row without motion after which the robot counts as at rest.
const STILL: u8 = 2;
/// The largest motion that counts as rest, in mm or degrees per cycle.
const STILL_WITHIN: f64 = 0.002;
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
///         Action::Call(..) => {
///             let Some(request) = engine.request() else { continue };
///             match call(&request, request.channel()) {
///                 Ok(reply) => {
///                     let moved = engine.handle_reply(&reply, now());
///                     # let _ = moved;
///                 }
///                 Err(failure) => engine.handle_failure(failure, now()),
///             }
///         }
///         Action::Pose { .. } if cycle == 500 => engine.stop(),
///         Action::Pose { .. } => {
///             // one degree per second about the first joint, from the current position
///             let mut joints = engine.start_pose().map_or([0.0; 8], |p| p.numbers().try_into().unwrap_or_default());
///             joints[0] += f64::from(cycle) * 0.008;
///             engine.push(&Pose::j(joints))?;
///             cycle += 1;
///         }
///         Action::Wait(until) => sleep_until(until),
///         Action::Finished => break,
///         Action::Faulted => return Err(engine.fault().cloned().ok_or("no fault")?.into()),
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
    /// The start of the stream, in the shape of the format.
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
    /// Makes an engine; the first [`poll`](Self::poll) starts Slave Mode.
    ///
    /// # Errors
    ///
    /// When the configuration is inconsistent, or the frame does not fit `N` bytes.
    pub fn new(config: Config) -> Result<Self, ConfigError> {
        let (expected, frame) = (config.format.shape(), PreparedMove::new(config.motion.robot, &config.format));
        if let Some(found) = config.start.map(|pose| pose.shape()).filter(|found| *found != expected) {
            return Err(ConfigError::Start(FormatError::Shape { expected, found }));
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
    pub fn poll(&mut self, now: Instant) -> Action {
        if !self.in_flight {
            match self.phase {
                Phase::Finished => return Action::Finished,
                Phase::Faulted => return Action::Faulted,
                Phase::Streaming => {
                    if let Some(action) = self.pace(now) {
                        return action;
                    }
                }
                Phase::Starting | Phase::Leaving | Phase::Diagnosing | Phase::Recovering => {}
            }
            self.in_flight = true;
            self.sent_at = now;
            self.channel = self.channel_for(self.step).unwrap_or(Channel::Motion);
        }
        Action::Call(self.step, self.channel)
    }

    /// Returns the call in flight, which [`poll`](Self::poll) has requested; `None` when no call is in flight.
    #[must_use]
    #[inline]
    pub fn request(&self) -> Option<Request<'_>> {
        self.in_flight.then(|| Request {
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

    /// Handles the reply to the call, also one with an error code; returns the reply to a slvMove that succeeded.
    pub fn handle_reply<'a>(&mut self, reply: &Frame<'a>, now: Instant) -> Option<MoveReply<'a>> {
        if !core::mem::take(&mut self.in_flight) {
            return None;
        }
        *self.health(self.channel) = Health::Good;
        let (code, value) = (reply.hresult(), reply.value().unwrap_or(Variant::Empty));
        match self.phase {
            Phase::Streaming => return self.handle_move(code, value, now),
            Phase::Starting => self.handle_start(code, value, now),
            Phase::Leaving => self.handle_leave(code),
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
            // without a reply it may have been executed
            self.has_arm |= self.step == Step::TakeArm;
            self.has_motor |= self.step == Step::Motor;
            self.may_be_in_mode |= self.step == Step::Enter;
        }
        match self.phase {
            Phase::Diagnosing => self.skip_diagnosis(failure),
            Phase::Leaving if self.gives_up => self.keep_unreleased(Cause::Failed(failure)),
            _ => self.fail(Cause::Failed(failure)),
        }
    }

    /// Sets the next pose, after [`Action::Pose`].
    ///
    /// # Errors
    ///
    /// When the pose is invalid or exceeds the limits. The engine is unchanged, and another pose can be pushed.
    pub fn push(&mut self, pose: &Pose) -> Result<(), PoseError> {
        let asked = self.phase == Phase::Streaming && !self.pacer.loaded && !self.in_flight && self.stop.is_none();
        if !asked {
            return Err(PoseError::NotNow);
        }
        let (expected, found) = (self.config.format.shape(), pose.shape());
        if expected != found {
            return Err(FormatError::Shape { expected, found }.into());
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
    /// The robot slows down along its present direction, within the limits and for at least [`Config::ramp`]. Then the
    /// engine repeats the last pose until the robot is at rest, leaves Slave Mode, switches the motor off that it has switched
    /// on, and gives the arm back. After a fault it leaves Slave Mode if it may still be on, halts the robot if it may move,
    /// and releases the motor and the arm.
    pub fn stop(&mut self) {
        self.end(self.config.ramp);
    }

    /// Ends a stream at its last pose, for a trajectory that has come to rest.
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
    /// The stream begins at the current position, not at [`Config::start`]. Before the engine clears the errors, it asks the
    /// controller again whether the emergency stop is pressed.
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
        self.step = Step::SystemState;
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

    /// Returns the fault that ended the stream; it is complete after [`Action::Faulted`].
    #[must_use]
    pub const fn fault(&self) -> Option<&Fault> {
        self.fault.as_ref()
    }

    /// Returns the start of the stream: [`Config::start`], or else the position of the robot; `None` until it is known.
    #[must_use]
    pub const fn start_pose(&self) -> Option<&Pose> {
        self.start.as_ref()
    }

    /// Returns the last pose, pushed or computed by a stop; before the first one, the start.
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

    /// Returns the timing of the present call. On a lossy link, an attempt of a slvMove waits for two cycles in mode 2, where
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

    /// Ends the phase because the present step failed, and starts the diagnosis.
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

/// Starting, leaving and recovering.
impl<const N: usize> Engine<N> {
    fn handle_start(&mut self, code: HResult, value: Variant<'_>, now: Instant) {
        if self.step == Step::GetMode {
            let state = StreamState::from_reply(code, value.as_i32());
            if !state.allows(Properties::UNKNOWN) {
                return self.fail(Cause::Occupied(state));
            }
        } else if code.is_err() {
            return self.fail(Cause::Refused(code));
        }
        let done = match self.step {
            Step::TakeArm => {
                self.has_arm = true;
                Ok(())
            }
            Step::Motor => {
                self.has_motor = true;
                Ok(())
            }
            Step::Position => self.take_position(value),
            Step::Joints => self.take_joints(value),
            _ => Ok(()),
        };
        if let Err(cause) = done {
            return self.fail(cause);
        }
        if self.step == Step::Enter {
            return self.begin_stream(now);
        }
        if self.stop_wanted {
            return self.release(None);
        }
        self.step = self.next_start();
        if self.step == Step::Enter
            && let Err(cause) = self.check_start()
        {
            self.fail(cause);
        }
    }

    fn next_start(&self) -> Step {
        let config = &self.config;
        let extended = config.format.extended != ExtendedAxes::None && config.format.mode.pose != PoseType::J;
        match self.step {
            Step::GetMode => Step::SendFormat,
            Step::SendFormat => Step::ReceiveFormat,
            Step::ReceiveFormat if config.arm.is_some() => Step::TakeArm,
            Step::ReceiveFormat | Step::TakeArm if config.motor => Step::Motor,
            Step::ReceiveFormat | Step::TakeArm | Step::Motor => Step::Position,
            Step::Position if extended => Step::Joints,
            _ => Step::Enter,
        }
    }

    /// Reads the position of the robot.
    fn take_position(&mut self, value: Variant<'_>) -> Result<(), Cause> {
        let pose = self.config.format.mode.pose;
        let mut numbers = [0.0; 10];
        let count = read_numbers(value, numbers.get_mut(..pose.len()).unwrap_or_default()).ok_or(Cause::NoValue)?;
        if pose == PoseType::J {
            // controllers may send any value for joints that the robot does not have
            let absent = numbers.iter_mut().skip(usize::from(self.config.joints));
            absent.filter(|number| !number.is_finite()).for_each(|number| *number = 0.0);
        }
        let at = Pose::from_numbers(pose, numbers.get(..count).unwrap_or_default()).ok_or(Cause::NoValue)?;
        let [.., j7, j8] = at.axes();
        self.set_position(at.with_axes(self.config.format.extended, j7, j8))
    }

    /// Reads the position of the extended joints.
    fn take_joints(&mut self, value: Variant<'_>) -> Result<(), Cause> {
        let mut numbers = [0.0; 8];
        read_numbers(value, &mut numbers).filter(|count| *count == numbers.len()).ok_or(Cause::NoValue)?;
        let [.., j7, j8] = numbers;
        self.set_position(self.last.with_axes(self.config.format.extended, j7, j8))
    }

    /// Records the position of the robot. Rejects NaN, which would pass every limit check.
    fn set_position(&mut self, pose: Pose) -> Result<(), Cause> {
        if !pose.is_finite() {
            return Err(Cause::NoValue);
        }
        self.last = pose;
        Ok(())
    }

    /// Compares the position of the robot with the start of the stream.
    fn check_start(&mut self) -> Result<(), Cause> {
        if let Some(start) = self.config.start.filter(|_| !self.restarted) {
            if let Some((number, actual, expected)) = self.off_start(&start) {
                return Err(Cause::NotAtStart { number, actual, expected });
            }
            self.last = start;
        }
        self.start = Some(self.last);
        Ok(())
    }

    /// Finds the first number of the start that differs from the robot's by more than the tolerance.
    fn off_start(&self, start: &Pose) -> Option<(u8, f64, f64)> {
        /// One degree in radians, the tolerance of a component of a unit vector per degree.
        const PER_DEGREE: f64 = core::f64::consts::PI / 180.0;
        let (pose, tolerance) = (self.config.format.mode.pose, self.config.tolerance);
        let joints = usize::from(self.config.joints);
        let own =
            start.numbers().iter().zip(self.last.numbers()).zip(1_u8..).find_map(|((expected, actual), number)| {
                let off = actual - expected;
                let missed = match (pose, number) {
                    (PoseType::P, 4..=6) => half_turn(off).abs() > tolerance,
                    // a negative Fig stands for any figure
                    (PoseType::P, 7) | (PoseType::T, 10) => off != 0.0 && *expected >= 0.0 && *actual >= 0.0,
                    (PoseType::T, 4..=9) => off.abs() > tolerance * PER_DEGREE,
                    (PoseType::J, _) if usize::from(number) > joints => false,
                    _ => off.abs() > tolerance,
                };
                missed.then_some((number, *actual, *expected))
            });
        let extended = || {
            let axes = start.axes().into_iter().zip(self.last.axes()).zip(1_u8..).skip(6);
            let (seven, eight) = self.config.format.extended.has();
            let wanted = |number: u8| (number == 7 && seven) || (number == 8 && eight);
            axes.filter(|(_, number)| wanted(*number))
                .find(|((expected, actual), _)| (actual - expected).abs() > tolerance)
                .map(|((expected, actual), number)| (number, actual, expected))
        };
        own.or_else(extended)
    }

    fn begin_stream(&mut self, now: Instant) {
        self.phase = Phase::Streaming;
        self.may_be_in_mode = true;
        self.may_move = true;
        self.step = Step::Move;
        self.pacer = Pacer::new(now);
        self.delta = Delta::ZERO;
        self.velocity = [0.0; 8];
        self.received = None;
        if self.stop_wanted {
            self.leave();
        }
    }

    fn leave(&mut self) {
        self.phase = Phase::Leaving;
        self.step = Step::Leave;
    }

    /// Moves to the next step of the end, or ends.
    fn release(&mut self, after: Option<Step>) {
        const ORDER: [Step; 4] = [Step::Leave, Step::Halt, Step::MotorOff, Step::GiveArm];
        let done =
            after.and_then(|step| ORDER.iter().position(|other| *other == step)).map_or(0, |at| at.saturating_add(1));
        let next = ORDER.into_iter().skip(done).find(|step| self.is_unreleased(*step));
        // the calls of the end would end the stream of another client
        let is_foreign =
            !self.may_be_in_mode && self.fault.as_ref().is_some_and(|fault| fault.released == Released::No);
        match next.filter(|_| self.motion != Health::Lost && !is_foreign) {
            Some(step) => (self.phase, self.step) = (Phase::Leaving, step),
            None => self.end_release(),
        }
    }

    /// Tells whether a step of the end has something to undo.
    const fn is_unreleased(&self, step: Step) -> bool {
        match step {
            Step::Leave => self.gives_up && self.may_be_in_mode,
            // after a stop the robot is at rest
            Step::Halt => self.gives_up && self.may_move,
            Step::MotorOff => self.has_motor && self.config.motor_off,
            _ => self.has_arm,
        }
    }

    fn end_release(&mut self) {
        match self.unreleased.take() {
            None => self.phase = Phase::Finished,
            // the fault that ended the stream says more
            Some(_) if self.gives_up => self.phase = Phase::Faulted,
            Some((step, cause)) => {
                self.step = step;
                self.fail(cause);
            }
        }
    }

    /// Goes on after a step of the end that failed: the steps after it are more urgent than its reason.
    fn keep_unreleased(&mut self, cause: Cause) {
        self.unreleased.get_or_insert((self.step, cause));
        self.release(Some(self.step));
    }

    fn handle_leave(&mut self, code: HResult) {
        let is_off = self.gives_up && self.step == Step::Leave && code == HResult::E_SLVMODE_OFF;
        if code.is_err() && !is_off {
            return match self.step {
                Step::Leave if !self.gives_up => self.fail(Cause::Refused(code)),
                _ => self.keep_unreleased(Cause::Refused(code)),
            };
        }
        match self.step {
            Step::Leave => {
                self.may_be_in_mode = false;
                // a stop leaves Slave Mode at rest
                self.may_move &= self.gives_up;
            }
            Step::Halt => self.may_move = false,
            Step::MotorOff => self.has_motor = false,
            _ => self.has_arm = false,
        }
        self.release(Some(self.step));
    }

    fn handle_recovery(&mut self, code: HResult, value: Variant<'_>) {
        if code.is_err() {
            return self.fail(Cause::Refused(code));
        }
        if self.step == Step::SystemState {
            return match value.as_i32() {
                Some(bits) if bits & EMERGENCY_STOP != 0 => self.fail(Cause::EmergencyStop),
                Some(_) => self.step = Step::ClearError,
                None => self.fail(Cause::NoValue),
            };
        }
        self.fault = None;
        self.restarted = true;
        self.phase = Phase::Starting;
        self.step = Step::GetMode;
    }
}

/// Streaming and stopping.
impl<const N: usize> Engine<N> {
    /// Returns the action that must come before the next slvMove; `None` when the present step can be made.
    fn pace(&mut self, now: Instant) -> Option<Action> {
        if !self.pacer.loaded {
            if self.stop.is_none() {
                return Some(Action::Pose { deadline: self.pacer.deadline });
            }
            if !self.load_stop() {
                self.leave();
                return None;
            }
        }
        if now < self.pacer.deadline {
            return Some(Action::Wait(self.pacer.deadline));
        }
        self.step = Step::Move;
        self.pacer.sending(&self.config, &mut self.stats, now);
        None
    }

    fn load(&mut self, pose: Pose) -> Result<(), PoseError> {
        self.frame.set_pose(&pose)?;
        self.last = pose;
        self.pacer.loaded = true;
        Ok(())
    }

    fn handle_move<'a>(&mut self, code: HResult, value: Variant<'a>, now: Instant) -> Option<MoveReply<'a>> {
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

    fn begin_stop(&mut self, ramp: Duration) {
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

/// Diagnosing a fault.
impl<const N: usize> Engine<N> {
    /// Moves to a query, or to the next one that has a connection.
    fn diagnose(&mut self, step: Step) {
        let mut step = step;
        while self.channel_for(step).is_none() {
            step = match step {
                Step::GetMode | Step::Leave => Step::ErrorCount,
                Step::ErrorCount | Step::ErrorInfo => Step::SystemState,
                _ => return self.end_diagnosis(),
            };
        }
        self.step = step;
    }

    fn end_diagnosis(&mut self) {
        if self.fault.as_ref().is_some_and(Fault::is_underflow) {
            self.stats.underflows = self.stats.underflows.saturating_add(1);
        }
        self.phase = Phase::Faulted;
    }

    /// Continues without a reply: with the same query over the other connection, or with the next query.
    fn skip_diagnosis(&mut self, failure: Failure) {
        let other = self.channel_for(self.step).filter(|channel| *channel != self.channel);
        match (self.step, other) {
            (step, Some(_)) if failure != Failure::NotSent => self.diagnose(step),
            (Step::GetMode | Step::Leave, _) => self.diagnose(Step::ErrorCount),
            (Step::ErrorCount | Step::ErrorInfo, _) => self.diagnose(Step::SystemState),
            _ => self.end_diagnosis(),
        }
    }

    fn handle_diagnosis(&mut self, code: HResult, value: Variant<'_>) {
        let Some(fault) = &mut self.fault else { return self.end_diagnosis() };
        let int = value.as_i32().filter(|_| code.is_ok());
        match self.step {
            Step::GetMode => match int {
                Some(0) => {
                    fault.released = Released::Yes;
                    self.may_be_in_mode = false;
                    self.diagnose(Step::ErrorCount);
                }
                Some(_) => {
                    fault.released = Released::No;
                    // the other queries would end the stream of another client
                    if self.may_be_in_mode { self.diagnose(Step::Leave) } else { self.end_diagnosis() }
                }
                None => self.diagnose(Step::ErrorCount),
            },
            Step::Leave => {
                if code.is_ok() || code == HResult::E_SLVMODE_OFF {
                    fault.released = Released::Yes;
                    self.may_be_in_mode = false;
                }
                self.diagnose(Step::ErrorCount);
            }
            Step::ErrorCount => {
                // the last error of the list is the oldest, so the first cause
                self.error_index = int.unwrap_or(0).saturating_sub(1);
                self.diagnose(if self.error_index >= 0 { Step::ErrorInfo } else { Step::SystemState });
            }
            Step::ErrorInfo => {
                let error = ControllerError::read(value).filter(|_| code.is_ok());
                let more =
                    error.is_some() && self.error_index > 0 && fault.errors().len() < ERRORS_MAX.saturating_sub(1);
                error.into_iter().for_each(|error| fault.push(error));
                self.error_index = self.error_index.saturating_sub(1);
                self.diagnose(if more { Step::ErrorInfo } else { Step::SystemState });
            }
            _ => {
                fault.emergency_stop = int.map(|bits| bits & EMERGENCY_STOP != 0);
                self.end_diagnosis();
            }
        }
    }
}

/// Reads an array of numbers into `target`, up to the shorter length, and returns their count.
fn read_numbers(value: Variant<'_>, target: &mut [f64]) -> Option<usize> {
    let array = value.as_array()?;
    for (slot, element) in target.iter_mut().zip(array) {
        *slot = element.as_f64()?;
    }
    Some(array.len().min(target.len()))
}
