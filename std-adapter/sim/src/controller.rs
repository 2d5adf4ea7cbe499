//! The controller: its state, what happens to it as time passes, and what a test can do to it.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::time::Duration;

use bcap_core::handler::PeerId;
use bcap_core::hresult::HResult;
use bcap_core::rac::VariableKind as Kind;
use bcap_core::time::Instant;
use bcap_core::variant::{Encode, Variant, VariantBuf};

use crate::config::{Config, Mode, Permission, Token};
use crate::errors::{ErrorEntry, Errors};
use crate::explain::Refusals;
use crate::files::Files;
use crate::hand::Hand;
use crate::kinematics::Joints;
use crate::messages::Messages;
use crate::motion::Ended;
use crate::objects::Objects;
use crate::preparation::Preparation;
use crate::robot::{Robot, Servo};
use crate::scenario::{Effect, Fate, Running};
use crate::slave::{Formats, SlaveCounters, SlaveCycle, Stream};
use crate::tasks::{Task, TaskStatus};
use crate::value::Value;
use crate::variables::{Family, Variables};

/// What the emergency stop enters into the list of errors.
///
/// No public source tells the code of the button itself; this one is what clients see when it has stopped the robot.
pub const EMERGENCY_STOP: HResult = HResult::E_COMMAND_POSITION_GEN_STOPPED;

/// A client that waits for a motion or for the motor is asked again at least this often, so that what happens from
/// outside (the emergency stop, an injected error) ends its wait soon.
const LOOK_AGAIN: Duration = Duration::from_millis(50);

/// What a client's call waits for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Wait {
    /// The end of the motion with this number.
    Motion(u64),
    /// The end of this client's own motion with NEXT; then its next motion begins.
    Turn,
    /// The motor being on.
    Servo,
    /// The arm being at rest.
    Rest,
    /// The fingers of the hand being where they shall.
    Hand,
    /// Room for a pose of slave mode.
    Stored,
    /// The end of slave mode.
    Left,
    /// Nothing any more: this is the result.
    Over(HResult),
}

/// A virtual controller.
///
/// It has no clock and no socket: every call and every event brings the time with it, and the same calls at the same
/// times give the same answers. A time that lies before one already seen counts as that one.
#[derive(Clone, Debug)]
pub struct Controller {
    config: Config,
    mode: Mode,
    token: Token,
    emergency_stop: bool,
    /// RC9, COBOTTA: torque is off since an emergency stop, until ManualReset.
    pub(crate) torque_off: bool,
    pub(crate) preparation: Preparation,
    /// `@LOCK`.
    pub(crate) locked: bool,
    pub(crate) now: Instant,
    pub(crate) objects: Objects,
    /// Who has called Service_Start.
    pub(crate) sessions: BTreeSet<PeerId>,
    pub(crate) variables: Variables,
    pub(crate) robot: Robot,
    pub(crate) hand: Hand,
    pub(crate) files: Files,
    pub(crate) tasks: Vec<Task>,
    pub(crate) errors: Errors,
    pub(crate) refusals: Refusals,
    pub(crate) messages: Messages,
    pub(crate) waits: BTreeMap<PeerId, Wait>,
    pub(crate) slave_formats: BTreeMap<PeerId, Formats>,
    pub(crate) slave_counters: SlaveCounters,
    pub(crate) slave_record: VecDeque<SlaveCycle>,
    pub(crate) scenario: Running,
    /// What the scenario has in store for the call that each client waits for.
    pub(crate) fates: BTreeMap<PeerId, Fate>,
}

impl Controller {
    /// Switches a controller on.
    #[must_use]
    pub fn new(config: Config) -> Self {
        let task = |name: &String| Task::new(name.clone(), config.task_cycle, config.task_lines);
        Self {
            mode: config.mode,
            token: config.token,
            emergency_stop: false,
            torque_off: false,
            preparation: Preparation::new(config.profile),
            locked: false,
            now: Instant::ZERO,
            objects: Objects::default(),
            sessions: BTreeSet::new(),
            variables: Variables::new(&config.sizes),
            robot: Robot::new(&config),
            hand: Hand::new(),
            files: Files::default(),
            tasks: config.tasks.iter().map(task).collect(),
            errors: Errors::default(),
            refusals: Refusals::default(),
            messages: Messages::default(),
            waits: BTreeMap::new(),
            slave_formats: BTreeMap::new(),
            slave_counters: SlaveCounters::default(),
            slave_record: VecDeque::new(),
            scenario: Running::default(),
            fates: BTreeMap::new(),
            config,
        }
    }

    /// Lets time pass: motions, slave mode and tasks go on, the motor comes on.
    pub fn advance(&mut self, now: Instant) {
        let now = self.now.max(now);
        while let Some((at, effect)) = self.scenario.due(now) {
            self.pass(self.now.max(at));
            self.happen(effect);
        }
        self.pass(now);
    }

    /// Lets time pass in which the scenario does nothing of its own, but at cycles of slave mode.
    fn pass(&mut self, now: Instant) {
        self.pass_slave_cycles(now);
        self.now = now;
        for task in &mut self.tasks {
            task.advance(self.now);
        }
        if let Some((id, ended)) = self.robot.advance(self.now) {
            let result = if ended == Ended::Arrived { HResult::S_OK } else { HResult::E_ABORT };
            self.end_waits(|wait| wait == Wait::Motion(id), result);
            if ended == Ended::Halted {
                self.end_waits(|wait| wait == Wait::Turn, result);
            }
        }
        if self.robot.motor_is_on() {
            self.end_waits(|wait| wait == Wait::Servo, HResult::S_OK);
        }
        if !self.is_moving() {
            self.end_waits(|wait| wait == Wait::Rest, HResult::S_OK);
        }
        if self.hand.end(self.now).is_none() {
            self.end_waits(|wait| wait == Wait::Hand, HResult::S_OK);
        }
    }

    /// Makes happen what a scenario says that concerns no call.
    pub(crate) fn happen(&mut self, effect: Effect) {
        match effect {
            Effect::Error(code) => self.raise(code),
            Effect::EmergencyStop(pressed) => self.press_emergency_stop(pressed),
            Effect::LinkLoss(time) => self.scenario.lose_link(time, self.now),
            Effect::Mode(mode) => self.turn_mode_switch(mode),
            Effect::Token(token) => self.set_token(token),
            Effect::Motor(true) => self.turn_motor_on(),
            Effect::Motor(false) => self.motor_off(HResult::E_MOTOR_OFF),
            Effect::Refuse(_) | Effect::Delay(_) | Effect::Wire(_) => {}
        }
    }

    /// Presses or releases the emergency stop.
    ///
    /// Pressed, it switches the motor off, stops motion and tasks at once and is an error ([`EMERGENCY_STOP`]) that
    /// cannot be cleared before it is released.
    pub fn emergency_stop(&mut self, pressed: bool, now: Instant) {
        self.advance(now);
        self.press_emergency_stop(pressed);
    }

    pub(crate) fn press_emergency_stop(&mut self, pressed: bool) {
        if pressed && !self.emergency_stop {
            self.torque_off = self.config.profile.has_safe_torque_off();
            self.unprepare();
            self.raise(EMERGENCY_STOP);
        }
        self.emergency_stop = pressed;
    }

    /// Turns the mode switch; leaving Auto mode halts the robot and suspends the tasks.
    pub fn set_mode(&mut self, mode: Mode, now: Instant) {
        self.advance(now);
        self.turn_mode_switch(mode);
    }

    pub(crate) fn turn_mode_switch(&mut self, mode: Mode) {
        self.mode = mode;
        if mode != Mode::Auto {
            self.halt();
            self.tasks.iter_mut().for_each(Task::suspend);
        }
    }

    /// Gives the executable token to somebody.
    pub fn set_token(&mut self, token: Token) {
        self.token = token;
    }

    /// Sets the communication permission.
    pub fn set_permission(&mut self, permission: Permission) {
        self.config.permission = permission;
    }

    /// Makes an error happen; it stops the motion and suspends the tasks, and from level 3 on it also switches the
    /// motor off and resets the tasks.
    pub fn inject_error(&mut self, code: HResult, now: Instant) {
        self.advance(now);
        self.raise(code);
    }

    /// Reads a user variable into an encoding of at most `N` bytes.
    ///
    /// # Errors
    ///
    /// `DISP_E_BADINDEX` when there is no such variable, `E_TOO_MUCH_DATA` when it does not fit.
    pub fn variable<const N: usize>(&self, kind: Kind, index: u32) -> Result<VariantBuf<N>, HResult> {
        let value = self.variables.get(Family::Plain(kind), index)?;
        VariantBuf::new(&value).map_err(|_| HResult::E_TOO_MUCH_DATA)
    }

    /// Writes a user variable, whatever the communication permission.
    ///
    /// # Errors
    ///
    /// What Variable_PutValue answers.
    pub fn set_variable(&mut self, kind: Kind, index: u32, value: &Variant<'_>) -> Result<(), HResult> {
        self.variables.put(Family::Plain(kind), index, value)
    }

    /// Returns the settings.
    #[must_use]
    pub const fn config(&self) -> &Config {
        &self.config
    }

    pub(crate) const fn config_mut(&mut self) -> &mut Config {
        &mut self.config
    }

    /// Returns the mode.
    #[must_use]
    pub const fn mode(&self) -> Mode {
        self.mode
    }

    /// Tells whether the emergency stop is pressed.
    #[must_use]
    pub const fn emergency_stopped(&self) -> bool {
        self.emergency_stop
    }

    /// Returns where the robot was when time was last heard of.
    #[must_use]
    pub fn joints(&self) -> Joints {
        self.robot.joints(self.now)
    }

    /// Returns where the robot was when time was last heard of, with the extended axes: J1 to J8.
    #[must_use]
    pub fn axes(&self) -> [f64; 8] {
        self.robot.axes(self.now)
    }

    /// Tells whether a motion is under way; one that is held is. In slave mode, whether an axis moves.
    #[must_use]
    pub fn is_moving(&self) -> bool {
        self.robot.motion().is_some() || self.robot.slave.as_ref().is_some_and(Stream::is_moving)
    }

    /// Tells whether the motor is on.
    #[must_use]
    pub fn motor_is_on(&self) -> bool {
        self.robot.motor_is_on()
    }

    /// Returns who has the arm authority.
    #[must_use]
    pub fn arm_owner(&self) -> Option<PeerId> {
        self.robot.arm.map(|(peer, _)| peer)
    }

    /// Returns what a task is doing, and how many cycles it has completed.
    #[must_use]
    pub fn task(&self, name: &str) -> Option<(TaskStatus, u64)> {
        let task = self.tasks.iter().find(|t| t.name().eq_ignore_ascii_case(name))?;
        Some((task.status(), task.cycles()))
    }

    /// Iterates over the errors present, the newest first.
    pub fn errors(&self) -> impl Iterator<Item = ErrorEntry> {
        self.errors.present().iter().copied()
    }

    /// Iterates over the log of errors and refused calls, the newest first.
    pub fn error_log(&self) -> impl Iterator<Item = ErrorEntry> {
        self.errors.log().iter().copied()
    }

    /// Returns the number of objects that clients hold.
    #[must_use]
    pub fn open_objects(&self) -> usize {
        self.objects.len()
    }

    /// Drops a client's part of the state: what it held is released, its motion halts, its arm authority is free.
    pub(crate) fn forget(&mut self, peer: PeerId) {
        self.objects.release_all(peer);
        self.sessions.remove(&peer);
        self.waits.remove(&peer);
        self.slave_formats.remove(&peer);
        self.fates.remove(&peer);
        self.messages.forget(peer);
        self.files.forget(peer);
        self.forget_hand(peer);
        let streams = self.robot.slave.as_ref().is_some_and(|stream| stream.peer == peer);
        if streams || self.robot.motion().is_some_and(|m| m.peer == peer) {
            self.halt();
        }
        if self.arm_owner() == Some(peer) {
            self.robot.arm = None;
        }
    }

    /// Enters an error and does what its level says.
    pub(crate) fn raise(&mut self, code: HResult) {
        self.errors.raise(code, self.now);
        self.messages.post(code, self.now);
        self.abort_motion(code);
        self.stop_hand(code);
        if code.level().is_some_and(|level| level >= 3) {
            self.motor_off(code);
            self.tasks.iter_mut().for_each(Task::reset);
        } else {
            self.tasks.iter_mut().for_each(Task::suspend);
        }
    }

    /// Removes the errors; one whose cause persists cannot be removed, and is the answer.
    pub(crate) fn clear_error(&mut self) -> Result<(), HResult> {
        if self.emergency_stop {
            return Err(EMERGENCY_STOP);
        }
        self.use_manual_reset()?;
        self.errors.clear();
        Ok(())
    }

    /// Checks what every command that makes something run needs: Auto mode, the executable token, no error.
    pub(crate) fn may_execute(&mut self, peer: PeerId) -> Result<(), HResult> {
        self.may_command(peer)?;
        if self.errors.code().is_err() { Err(self.refuse(HResult::E_ERROR_PRESENT)) } else { Ok(()) }
    }

    /// Checks Auto mode and the executable token.
    pub(crate) fn may_command(&mut self, peer: PeerId) -> Result<(), HResult> {
        if !self.is_auto() {
            return Err(self.refuse(HResult::E_ACCESSDENIED));
        }
        match self.token {
            Token::TeachPendant => Err(self.refuse(HResult::E_TOKEN_NOT_ETHERNET)),
            Token::Client(owner) if owner != peer => Err(self.refuse(HResult::E_TOKEN_ADDRESS)),
            _ => Ok(()),
        }
    }

    /// Notes in the log that a call is refused with a code of the controller.
    pub(crate) fn refuse(&mut self, code: HResult) -> HResult {
        if code.level().is_some() {
            self.errors.note(code, self.now);
        }
        code
    }

    /// Tells whether the executable token is not with the teach pendant.
    pub(crate) fn token_is_outside(&self) -> bool {
        self.token != Token::TeachPendant
    }

    /// Halts the motion, or slave mode, if there is one.
    pub(crate) fn halt(&mut self) -> bool {
        if self.halt_slave_mode() {
            return true;
        }
        let now = self.now;
        match self.robot.motion_mut() {
            Some(motion) => motion.halt(now),
            None => return false,
        }
        // one that stood already ends now
        self.advance(now);
        true
    }

    /// Stops the motion where it is, and slave mode; who waits for it gets `code`.
    pub(crate) fn abort_motion(&mut self, code: HResult) {
        self.end_slave_mode(code);
        if let Some(id) = self.robot.freeze(self.now) {
            self.end_waits(|wait| wait == Wait::Motion(id) || wait == Wait::Turn, code);
        }
    }

    /// Switches the motor off; who waits for it, or for a motion, gets `code`.
    pub(crate) fn motor_off(&mut self, code: HResult) {
        self.robot.servo = Servo::Off;
        self.abort_motion(code);
        self.end_waits(|wait| wait == Wait::Servo, code);
    }

    /// Returns when to ask again about what a client waits for.
    pub(crate) fn look_again(&self, wait: Wait) -> Instant {
        let soon = self.now.saturating_add(LOOK_AGAIN);
        let end = match wait {
            Wait::Motion(_) | Wait::Turn | Wait::Rest => self.robot.motion().and_then(|m| m.end()),
            Wait::Servo => match self.robot.servo {
                Servo::TurningOn(at) => Some(at),
                _ => None,
            },
            Wait::Hand => self.hand.end(self.now),
            Wait::Stored | Wait::Left => self.robot.slave.as_ref().map(Stream::next_cycle),
            Wait::Over(_) => Some(self.now),
        };
        end.map_or(soon, |end| end.min(soon))
    }

    pub(crate) fn end_waits(&mut self, which: impl Fn(Wait) -> bool, result: HResult) {
        self.waits.values_mut().filter(|wait| which(**wait)).for_each(|wait| *wait = Wait::Over(result));
    }

    /// Encodes a value into `reply`, or says why it cannot be sent.
    pub(crate) fn set_reply(reply: &mut bcap_core::handler::ReplyValue<'_>, value: &Value) -> HResult {
        match reply.set(value as &dyn Encode) {
            Ok(()) => HResult::S_OK,
            Err(_) => HResult::E_TOO_MUCH_DATA,
        }
    }
}
