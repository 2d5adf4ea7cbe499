//! The controller: it composes its parts, advances their time, and offers to a test what happens around a robot.

mod command_calls;
pub mod controller_execute;
mod dispatch;
mod programs;
pub mod system;
mod variable_calls;

use std::collections::{BTreeMap, BTreeSet};
use std::net::IpAddr;
use std::time::Duration;

use bcap_core::handler::PeerId;
use bcap_core::hresult::HResult;
use bcap_core::rac::VariableKind as Kind;
use bcap_core::time::Instant;
use bcap_core::variant::{Variant, VariantBuf};

use crate::arm::Arm;
use crate::comm::Comm;
use crate::config::{ABSENT, Config, Mode, Permission, Token};
use crate::context::{Context, Panel};
use crate::errors::{ErrorEntry, Errors, Occurrence, Origin, SourceLine};
use crate::explain::Refusals;
use crate::files::Files;
use crate::kinematics::Joints;
use crate::levels::Effects;
use crate::messages::Messages;
use crate::objects::Objects;
use crate::operations::Operations;
use crate::scenario::{Delivery, Effect, Playback, Scenario, Setup};
use crate::slave::{self, Limits, SlaveCounters, SlaveCycle};
use crate::tasks::{self, TaskStatus, Tasks};
use crate::trace::TracePoint;
use crate::variables::{Family, Variables};
use crate::waits::{Wait, Waits};

/// Maximum interval at which a waiting call is polled, so that an event from outside (the emergency stop, an injected error)
/// ends its wait soon.
const POLL_INTERVAL: Duration = Duration::from_millis(50);

/// A virtual controller.
///
/// It has no clock and no socket: every call and every event brings the time with it, and the same calls at the same
/// times give the same answers. A time earlier than the latest time counts as the latest.
#[derive(Clone, Debug)]
pub struct Controller {
    shared: Shared,
    /// `@LOCK`.
    locked: bool,
    /// The clients that have called Service_Start.
    sessions: BTreeSet<PeerId>,
    objects: Objects,
    arm: Arm,
    comm: Comm,
    tasks: Tasks,
    files: Files,
    messages: Messages,
    refusals: Refusals,
    scenario: Playback,
}

/// The state that the [`Context`] of a call shows to the parts.
#[derive(Clone, Debug)]
struct Shared {
    config: Config,
    panel: Panel,
    /// The addresses of the clients, as far as they are known.
    addresses: BTreeMap<PeerId, IpAddr>,
    now: Instant,
    variables: Variables,
    waits: Waits,
    errors: Errors,
    operations: Operations,
}

impl Shared {
    fn context(&mut self, peer: PeerId) -> Context<'_> {
        Context {
            peer,
            address: self.addresses.get(&peer).copied(),
            now: self.now,
            config: &self.config,
            panel: self.panel,
            variables: &mut self.variables,
            waits: &mut self.waits,
            errors: &self.errors,
            operations: &mut self.operations,
        }
    }
}

impl Controller {
    /// Switches a controller on.
    #[must_use]
    pub fn new(config: Config) -> Self {
        Self {
            locked: false,
            sessions: BTreeSet::new(),
            objects: Objects::default(),
            arm: Arm::new(&config),
            comm: Comm::default(),
            tasks: Tasks::new(&config),
            files: Files::default(),
            messages: Messages::default(),
            refusals: Refusals::default(),
            scenario: Playback::default(),
            shared: Shared {
                panel: Panel::new(config.mode, config.token),
                addresses: BTreeMap::new(),
                now: Instant::ZERO,
                variables: Variables::new(&config.sizes),
                waits: Waits::default(),
                errors: Errors::default(),
                operations: Operations::default(),
                config,
            },
        }
    }

    /// Advances the controller to `now`: motions, Slave Mode and tasks continue, the motor switches on.
    pub fn advance(&mut self, now: Instant) {
        let now = self.shared.now.max(now);
        while let Some((at, effect)) = self.scenario.next_effect(now) {
            self.run_programs(at);
            self.pass(self.shared.now.max(at));
            self.apply(effect);
        }
        self.run_programs(now);
        self.pass(now);
    }

    /// Advances the controller to a time before which the scenario has no fault, except at cycles of Slave Mode, and no
    /// program a step.
    fn pass(&mut self, now: Instant) {
        while let Some(at) = self.arm.next_point(&self.shared.config, now) {
            self.pass_to(self.shared.now.max(at));
            self.arm.take_point(&self.shared.config, at);
        }
        self.pass_to(now);
    }

    /// Advances the controller to `now`. No point of the trace lies before that time.
    fn pass_to(&mut self, now: Instant) {
        self.pass_slave_cycles(now);
        self.shared.now = now;
        self.tasks.advance(now);
        self.arm.advance(now, &mut self.shared.waits);
        if !self.is_busy() {
            self.shared.waits.end(Wait::Tasks, HResult::S_OK);
        }
        self.report_stops();
    }

    /// Returns whether a task runs or the robot moves.
    fn is_busy(&self) -> bool {
        self.is_moving() || self.tasks.iter().any(tasks::Task::is_running)
    }

    /// Enters the errors of the clients whose motions were stopped.
    fn report_stops(&mut self) {
        while let Some((at, mover)) = self.shared.waits.next_stopped(self.shared.now) {
            if !self.is_task(mover) {
                self.enter(HResult::E_MOTION_STOPPED, at, Origin::Client, None);
            }
        }
    }

    /// Executes the cycles of Slave Mode that begin by `until`.
    fn pass_slave_cycles(&mut self, until: Instant) {
        while let Some(present) = self.arm.present_cycle() {
            let quiet = self.scenario.quiet_cycles(present);
            let Some((cycle, at)) = self.arm.next_cycle(until, quiet) else { break };
            self.shared.now = self.shared.now.max(at);
            for effect in self.scenario.at_cycle(cycle) {
                self.apply(effect);
            }
            let Shared { config, now, waits, .. } = &mut self.shared;
            if let Err(code) = self.arm.cycle(config, *now, waits) {
                self.raise(code);
            }
        }
    }

    /// Applies an effect of the scenario that concerns no call.
    fn apply(&mut self, effect: Effect) {
        match effect {
            Effect::Error(code) => self.raise(code),
            Effect::EmergencyStop(pressed) => self.press_emergency_stop(pressed),
            Effect::LinkLoss(time) => self.scenario.lose_link(time, self.shared.now),
            Effect::Mode(mode) => self.turn_mode_switch(mode),
            Effect::Token(token) => self.set_token(token),
            Effect::Permission(permission) => self.set_permission(permission),
            Effect::Motor(true) => self.turn_motor_on(),
            Effect::Motor(false) => self.arm.turn_off(HResult::E_MOTOR_OFF, self.shared.now, &mut self.shared.waits),
            Effect::Message(text) => self.messages.post_text(&text, "", self.shared.now),
            Effect::Comm { line, text } => self.comm.receive(line, &text),
            Effect::Refuse(_) | Effect::Delay(_) | Effect::Wire(_) => {}
        }
    }

    /// Plays a scenario from its beginning, in place of the previous one: the controller takes the state of its section
    /// `[controller]`, and the faults happen as time passes.
    pub fn play(&mut self, scenario: Scenario) {
        self.set_up(&scenario.controller);
        for program in &scenario.tasks {
            let place = self.tasks.define(program.clone());
            if let (Some(mode), Ok(task)) = (program.start, self.tasks.get_mut(place)) {
                // a program that was just defined can start
                let _ = task.start(mode, self.shared.now);
            }
        }
        self.free_arm_of_tasks();
        self.scenario.play(scenario);
    }

    /// Sets the state of the section `[controller]` of a scenario. The faults of the scenario that plays stay.
    pub fn set_up(&mut self, setup: &Setup) {
        if let Some(pressed) = setup.emergency_stop {
            self.press_emergency_stop(pressed);
        }
        setup.errors.iter().for_each(|code| self.raise(*code));
        let Shared { now, waits, config, panel, errors, .. } = &mut self.shared;
        let can_be_on = !panel.emergency_stop && errors.code().is_ok();
        if setup.torque_off {
            self.arm.preparation_mut().emergency_stop(config.model.functions);
            self.arm.turn_off(HResult::E_MOTOR_OFF, *now, waits);
        }
        if setup.prepared {
            self.arm.preparation_mut().complete_all();
        }
        match setup.motor {
            Some(true) if can_be_on => self.arm.force_on(),
            Some(false) => self.arm.turn_off(HResult::E_MOTOR_OFF, *now, waits),
            Some(true) | None => {}
        }
        if let Some(taken) = setup.arm_taken {
            self.arm.give_to(taken.then_some(ABSENT), *now, waits);
        }
        if let Some(mode) = setup.mode {
            self.turn_mode_switch(mode);
        }
        if let Some(token) = setup.token {
            self.set_token(token);
        }
        if let Some(permission) = setup.permission {
            self.set_permission(permission);
        }
        let panel = &mut self.shared.panel;
        panel.battery_low = setup.battery_low.unwrap_or(panel.battery_low);
        panel.warning = setup.warning.unwrap_or(panel.warning);
        panel.protective_stop = setup.protective_stop.unwrap_or(panel.protective_stop);
        setup.apply(&mut self.shared.config);
    }

    /// Applies the scenario's fault to the bytes of a reply, and says whether to send them.
    ///
    /// The caller calls it once for each frame: the reply of a call, or `S_EXECUTING`.
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
        self.scenario.deliver(peer, frame, self.shared.now)
    }

    /// Presses or releases the emergency stop.
    ///
    /// When pressed, it switches the motor off and stops motion and tasks immediately. It is not an error itself, but commands
    /// are refused with [`EMERGENCY_STOP`](crate::codes::EMERGENCY_STOP), and it ends Slave Mode with
    /// `E_COMMAND_POSITION_GEN_STOPPED`.
    pub fn emergency_stop(&mut self, pressed: bool, now: Instant) {
        self.advance(now);
        self.press_emergency_stop(pressed);
    }

    fn press_emergency_stop(&mut self, pressed: bool) {
        if pressed != self.shared.panel.emergency_stop {
            self.record_operation(if pressed { "emergency stop pressed" } else { "emergency stop released" });
        }
        if pressed && !self.shared.panel.emergency_stop {
            self.end_slave_mode();
            let Shared { config, now, waits, .. } = &mut self.shared;
            self.arm.emergency_stop(config.model.functions, *now, waits);
            self.tasks.kill(*now);
            self.free_arm_of_tasks();
        }
        self.shared.panel.emergency_stop = pressed;
    }

    /// Ends Slave Mode, if it is on, by the error of a stop from outside.
    fn end_slave_mode(&mut self) {
        if self.arm.robot().stream().is_some() {
            self.raise(HResult::E_COMMAND_POSITION_GEN_STOPPED);
        }
    }

    /// Turns the mode switch; leaving Auto mode halts the robot, ends Slave Mode by an error, and suspends the tasks.
    pub fn set_mode(&mut self, mode: Mode, now: Instant) {
        self.advance(now);
        self.turn_mode_switch(mode);
    }

    fn turn_mode_switch(&mut self, mode: Mode) {
        self.record_operation(match mode {
            Mode::Manual => "manual mode",
            Mode::TeachCheck => "teach check mode",
            Mode::Auto => "auto mode",
        });
        self.shared.panel.mode = mode;
        if mode != Mode::Auto {
            self.end_slave_mode();
            let Shared { config, now, waits, .. } = &mut self.shared;
            self.arm.halt(config, *now, waits);
            self.tasks.suspend(*now);
        }
    }

    /// Sets the holder of the executable token.
    pub fn set_token(&mut self, token: Token) {
        self.record_operation(match token {
            Token::Any => "executable token: any client",
            Token::TeachPendant => "executable token: teach pendant",
            Token::Client(_) => "executable token: one client",
            Token::Address(_) => "executable token: one address",
        });
        self.shared.panel.token = token;
    }

    fn record_operation(&mut self, operation: &str) {
        self.shared.operations.record(operation, self.shared.now);
    }

    /// Sets the communication permission.
    pub fn set_permission(&mut self, permission: Permission) {
        self.shared.config.permission = permission;
    }

    /// Starts to switch the motor on, unless the emergency stop, an error or a missing preparation prevents it.
    fn turn_motor_on(&mut self) {
        if !self.shared.panel.emergency_stop && self.shared.errors.code().is_ok() {
            self.arm.turn_on(self.shared.now.saturating_add(self.shared.config.motor_on_delay));
        }
    }

    /// Raises an error of the controller. Its level says what it stops.
    pub fn inject_error(&mut self, code: HResult, now: Instant) {
        self.advance(now);
        self.raise(code);
    }

    fn raise(&mut self, code: HResult) {
        self.enter(code, self.shared.now, Origin::Controller, None);
    }

    /// Clears the errors, as a person does at the teach pendant.
    pub fn clear_errors(&mut self, now: Instant) {
        self.advance(now);
        self.shared.errors.clear();
        self.record_operation("errors cleared");
    }

    /// Makes the refusal of a client's call an error, if its code is one of the controller.
    fn refuse(&mut self, code: HResult) {
        if code.level().is_some() {
            self.enter(code, self.shared.now, Origin::Client, None);
        }
    }

    /// Enters an error into the lists, and stops what its level says. `place` is the line of a task at which it occurred.
    fn enter(&mut self, code: HResult, at: Instant, origin: Origin, place: Option<SourceLine>) {
        let Shared { now, waits, errors, .. } = &mut self.shared;
        let source = place.as_ref().map_or(String::new(), |place| place.program.clone());
        if errors.enter(Occurrence { error: ErrorEntry { code, at }, origin, place }) {
            self.messages.post_error(code, &source, *now);
        }
        let effects = Effects::of(code);
        self.arm.fail(code, effects, *now, waits);
        self.tasks.fail(effects.tasks, *now);
        self.free_arm_of_tasks();
    }

    /// Records the address of a client, for [`Token::Address`]. A server calls it when the client connects.
    pub fn connected(&mut self, peer: PeerId, address: IpAddr) {
        self.shared.addresses.insert(peer, address.to_canonical());
    }

    /// Drops a client's part of the state: its objects are released, its motion halts, its arm authority is free.
    fn forget(&mut self, peer: PeerId) {
        let Shared { config, now, waits, .. } = &mut self.shared;
        self.objects.release_all(peer);
        self.sessions.remove(&peer);
        waits.forget(peer);
        self.messages.forget(peer);
        self.files.forget(peer);
        self.arm.forget(peer, config, *now, waits);
    }

    /// Returns when to poll a call that waits for an event.
    fn poll_time(&self, wait: Wait) -> Instant {
        let soon = self.shared.now.saturating_add(POLL_INTERVAL);
        self.arm.end_of(wait, self.shared.now).map_or(soon, |end| end.min(soon))
    }

    /// Reads a user variable into an encoding of at most `N` bytes.
    ///
    /// # Errors
    ///
    /// `DISP_E_BADINDEX` for a variable that does not exist, `E_TOO_MUCH_DATA` for a value that does not fit.
    pub fn variable<const N: usize>(&self, kind: Kind, index: u32) -> Result<VariantBuf<N>, HResult> {
        let value = self.shared.variables.get(Family::Plain(kind), index)?;
        VariantBuf::new(&value).map_err(|_| HResult::E_TOO_MUCH_DATA)
    }

    /// Writes a user variable, whatever the communication permission.
    ///
    /// # Errors
    ///
    /// The errors of Variable_PutValue.
    pub fn set_variable(&mut self, kind: Kind, index: u32, value: &Variant<'_>) -> Result<(), HResult> {
        self.shared.variables.put(Family::Plain(kind), index, value)
    }

    /// Returns the settings.
    #[must_use]
    pub const fn config(&self) -> &Config {
        &self.shared.config
    }

    /// Returns the mode.
    #[must_use]
    pub const fn mode(&self) -> Mode {
        self.shared.panel.mode
    }

    /// Returns whether the emergency stop is pressed.
    #[must_use]
    pub const fn emergency_stopped(&self) -> bool {
        self.shared.panel.emergency_stop
    }

    /// Returns the position of the robot at the current time: J1 to J6.
    #[must_use]
    pub fn joints(&self) -> Joints {
        self.arm.robot().joints(self.shared.now)
    }

    /// Returns the position of the robot at the current time with the extended axes: J1 to J8.
    #[must_use]
    pub fn axes(&self) -> [f64; 8] {
        self.arm.robot().axes(self.shared.now)
    }

    /// Returns the position of the arm at the current time: the axes and the tool centre point.
    #[must_use]
    pub fn point(&self) -> TracePoint {
        self.arm.point(self.shared.now)
    }

    /// Returns whether a motion is running or held, or an axis moves in Slave Mode.
    #[must_use]
    pub fn is_moving(&self) -> bool {
        self.arm.robot().is_moving()
    }

    /// Returns whether the motor is on.
    #[must_use]
    pub fn motor_is_on(&self) -> bool {
        self.arm.robot().motor_is_on()
    }

    /// Returns the client that owns the arm.
    #[must_use]
    pub fn arm_owner(&self) -> Option<PeerId> {
        self.arm.robot().owner()
    }

    /// Returns the distance between the fingers of the hand at the current time, in mm.
    #[must_use]
    pub fn hand_position(&self) -> f64 {
        self.arm.hand().position(self.shared.now)
    }

    /// Returns the number of slvGetMode; 0 while Slave Mode is off.
    #[must_use]
    pub fn slave_mode(&self) -> i32 {
        slave::mode(self.arm.robot())
    }

    /// Returns the limits of Slave Mode, if it is entered now.
    #[must_use]
    pub fn slave_limits(&self) -> Limits {
        self.arm.slave_limits(&self.shared.config)
    }

    /// Returns what Slave Mode has done.
    #[must_use]
    pub const fn slave_counters(&self) -> SlaveCounters {
        self.arm.slave().counters()
    }

    /// Iterates over the recorded cycles of Slave Mode that took a pose or moved, the oldest first.
    pub fn slave_record(&self) -> impl Iterator<Item = SlaveCycle> {
        self.arm.slave().record()
    }

    /// Returns the state of a task, and the number of cycles that it has completed.
    #[must_use]
    pub fn task(&self, name: &str) -> Option<(TaskStatus, u64)> {
        let task = self.tasks.get(self.tasks.position(name)?).ok()?;
        Some((task.status(), task.cycles()))
    }

    /// Iterates over the tasks: the name, the state, and the number of cycles that it has completed.
    pub fn tasks(&self) -> impl Iterator<Item = (&str, TaskStatus, u64)> {
        self.tasks.iter().map(|task| (task.name(), task.status(), task.cycles()))
    }

    /// Iterates over the current errors in reverse order.
    pub fn errors(&self) -> impl Iterator<Item = ErrorEntry> {
        self.shared.errors.present().iter().map(|occurrence| occurrence.error)
    }

    /// Iterates over the log of errors and refused calls in reverse order.
    pub fn error_log(&self) -> impl Iterator<Item = ErrorEntry> {
        self.shared.errors.log().iter().map(|occurrence| occurrence.error)
    }

    /// Returns the number of open objects.
    #[must_use]
    pub fn open_objects(&self) -> usize {
        self.objects.len()
    }
}
