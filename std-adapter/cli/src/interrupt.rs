//! Signals while a session is open: each halts the robot if this command may move it, and ends the command or its line.
//!
//! ```text
//!   state      a signal                                                a second one
//!   Idle       ends the process at once                                -
//!   Calling    lets the running call end; the session makes no other   ends the process at once
//!   Stepping   is looked for by the command, between its steps         ends the process at once
//!   Moving     halts the robot until the command has ended its call    the fifth ends the process at once
//!   Restoring  halts the robot until the command has restored          halts again
//!   Streaming  is looked for by the command, which stops the stream    is counted; it halts the robot
//! ```
//!
//! The end of a session halts the robot if it may move, switches the motor off if the session switched it on, gives the arm
//! back, releases all objects and stops the service. SIGTSTP does the same, and suspends the process afterwards.
//!
//! The session of the command waits for a reply during a motion, so the halt has another session, which is opened before the
//! motion begins.

use std::io::{self, Write as _};
use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};
use std::{process, thread};

use bcap_terminal::signal::{self, Signal};

use crate::failure::Failure;

/// Maximum time that a motion that begins just after a halt runs until the next halt.
const AGAIN: Duration = Duration::from_millis(50);

/// Delay after a signal until the command prints what it waits for.
const REMINDER: Duration = Duration::from_millis(300);

/// Number of further signals that end a command whose motion does not end.
const MAX_SIGNALS: u32 = 5;

/// The exit code of an interrupted command.
const EXIT_CODE: i32 = 130;

/// Halts the robot over a separate session.
pub(crate) type Halt = Box<dyn FnMut() -> Result<(), Failure> + Send>;

/// The activity of the command, which determines the reaction to a signal. A later state outranks an earlier one.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum State {
    /// No session has been opened.
    Idle,
    /// A session is open, and the command does not look for signals.
    Calling,
    /// The command looks for signals between its steps.
    Stepping,
    /// The command may move the robot.
    Moving,
    /// The command may move the robot, and always restores its changes.
    Restoring,
    /// The command streams poses.
    Streaming,
}

/// The reaction of this process to signals.
#[derive(Clone)]
pub(crate) struct Interrupt(Arc<Inner>);

struct Inner {
    status: Mutex<SignalState>,
    changed: Condvar,
    /// How the robot is halted. Separate from the status, because a halt may take long.
    stopper: Mutex<Option<Halt>>,
}

struct SignalState {
    state: State,
    /// The signal that outranks the others since the beginning of the line.
    received: Option<Signal>,
    /// The number of signals since the beginning of the line.
    count: u32,
    /// Whether the last halt since the beginning of the line failed.
    halt_failed: bool,
    /// Whether the process continues after the command: it is the shell, or runs a script.
    goes_on: bool,
}

/// The handler of this process.
static INSTALLED: Mutex<Option<Interrupt>> = Mutex::new(None);

impl Interrupt {
    /// Handles signals from now on, for a command that looks for them between its steps. `idle` is called after each that did
    /// not halt a motion.
    ///
    /// A process has one handler: a later call, as by a line of the shell, returns it, and ignores its own `idle`.
    pub(crate) fn install(idle: impl Fn(Signal) + Send + 'static) -> io::Result<Self> {
        let interrupt = Self::installed(idle)?;
        interrupt.raise(State::Stepping);
        Ok(interrupt)
    }

    /// Handles signals from now on, for a session of a command that does not look for them.
    pub(crate) fn of_session() -> io::Result<Self> {
        Self::installed(|_| {})
    }

    fn installed(idle: impl Fn(Signal) + Send + 'static) -> io::Result<Self> {
        let mut installed = INSTALLED.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(interrupt) = &*installed {
            return Ok(interrupt.clone());
        }
        let interrupt = Self::new();
        let (signals, handler) = (signal::receiver()?, interrupt.clone());
        thread::Builder::new().name("interrupt".into()).spawn(move || {
            while let Ok(signal) = signals.recv() {
                let was_answered = handler.signalled(signal, &signals);
                match handler.received() {
                    Some(Signal::End) => idle(Signal::End),
                    Some(received) if !was_answered => idle(received),
                    _ => {}
                }
            }
        })?;
        Ok(installed.insert(interrupt).clone())
    }

    /// Returns the handler of this process, if signals are handled.
    pub(crate) fn of_process() -> Option<Self> {
        INSTALLED.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    fn new() -> Self {
        let status = SignalState { state: State::Idle, received: None, count: 0, halt_failed: false, goes_on: false };
        Self(Arc::new(Inner { status: Mutex::new(status), changed: Condvar::new(), stopper: Mutex::new(None) }))
    }

    fn status(&self) -> MutexGuard<'_, SignalState> {
        self.0.status.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Handles a signal, and further signals that arrive during that. Returns whether the last signal halted a motion. If so,
    /// it does not concern the prompt, which may have begun since.
    fn signalled(&self, signal: Signal, more: &Receiver<Signal>) -> bool {
        match (self.state(), signal) {
            (State::Idle, Signal::Suspend) => {
                signal::suspend();
                true
            }
            (State::Idle, _) => process::exit(EXIT_CODE),
            (State::Calling | State::Stepping, _) => {
                self.mark(signal);
                self.remind(more)
            }
            (State::Moving | State::Restoring, _) => {
                self.mark(signal);
                self.halt_until_ended(more)
            }
            (State::Streaming, _) => {
                self.mark(signal);
                true
            }
        }
    }

    /// Waits for the end of a command that is between two calls. A second signal ends the process immediately, unless the
    /// process continues after the command.
    fn remind(&self, more: &Receiver<Signal>) -> bool {
        if self.status().goes_on {
            return false;
        }
        let second = more.recv_timeout(REMINDER);
        if second == Err(RecvTimeoutError::Timeout) {
            // an error of printing cannot be reported
            let _ = writeln!(io::stderr(), "ends after this call; press Ctrl-C again to end at once");
        }
        if self.status().goes_on {
            return false;
        }
        let Ok(second) = second.or_else(|_| more.recv()) else { return false };
        match self.state() {
            State::Idle | State::Calling | State::Stepping => process::exit(EXIT_CODE),
            // it has begun to move the robot since
            State::Moving | State::Restoring | State::Streaming => self.signalled(second, more),
        }
    }

    /// Halts the robot until the command has ended its call: a motion may begin just after a halt.
    fn halt_until_ended(&self, more: &Receiver<Signal>) -> bool {
        let (mut reported, mut again, mut was_answered) = (false, 1, false);
        // the next line may begin after the call
        while self.may_move() && self.is_interrupted() {
            if let Err(failure) = self.halt()
                && !reported
            {
                failure.print(false, None);
                reported = true;
            }
            was_answered = true;
            if let Ok(signal) = more.recv_timeout(AGAIN) {
                // for the next line, if the interrupted line has just ended
                self.mark(signal);
                again += 1;
                was_answered = signal == Signal::End;
            }
            if again > MAX_SIGNALS && self.state() != State::Restoring {
                let what = "interrupted again and again, so the command ends; the robot may be moving, and the controller gives \
                            the arm back when it notices the end of the connection";
                Failure::Interrupted(what.into()).print(false, None);
                process::exit(EXIT_CODE);
            }
        }
        was_answered
    }

    /// Returns the current state of the command.
    fn state(&self) -> State {
        self.status().state
    }

    /// Sets the state of the command.
    pub(crate) fn enter(&self, state: State) {
        self.status().state = state;
    }

    /// Sets the state of the command, unless the current state outranks it.
    pub(crate) fn raise(&self, state: State) {
        let mut status = self.status();
        status.state = status.state.max(state);
    }

    fn may_move(&self) -> bool {
        matches!(self.state(), State::Moving | State::Restoring)
    }

    /// Sets that the process continues after the command. No signal then ends it immediately, because its session must be
    /// closed.
    pub(crate) fn set_going_on(&self) {
        self.status().goes_on = true;
    }

    /// Records a signal.
    fn mark(&self, signal: Signal) {
        let mut status = self.status();
        status.received = status.received.max(Some(signal));
        status.count = status.count.saturating_add(1);
        self.0.changed.notify_all();
    }

    /// Closes the session that halts.
    pub(crate) fn dismiss(&self) {
        let stopper = self.0.stopper.lock().unwrap_or_else(PoisonError::into_inner).take();
        // after the lock is released: closing may take long, and another halt must not wait for it
        drop(stopper);
    }

    /// Halts the robot. Returns whether [`prepare`](Self::prepare) has given a way to do so.
    pub(crate) fn halt(&self) -> Result<bool, Failure> {
        let mut stopper = self.0.stopper.lock().unwrap_or_else(PoisonError::into_inner);
        let halted = stopper.as_mut().map_or(Ok(false), |halt| halt().map(|()| true));
        self.status().halt_failed = halted.is_err();
        halted
    }

    /// Returns whether there is a way to halt the robot while a call runs.
    pub(crate) fn can_halt(&self) -> bool {
        self.0.stopper.lock().unwrap_or_else(PoisonError::into_inner).is_some()
    }

    /// Returns the failure of a command that a signal interrupted while its session had the arm; `moved` is whether the robot
    /// moved until the arm was given back.
    pub(crate) fn failure(&self, moved: bool) -> Failure {
        // this waits for a halt in progress
        let was_halted = self.can_halt() && !self.status().halt_failed || moved;
        let halted = if was_halted { "the robot was halted" } else { "the motion was not halted: it has ended" };
        Failure::Interrupted(format!("interrupted: {halted}, and the arm was given back"))
    }

    /// Sets how the robot is halted, unless that is known; `open` may connect.
    pub(crate) fn prepare(&self, open: impl FnOnce() -> Result<Option<Halt>, Failure>) -> Result<(), Failure> {
        let mut stopper = self.0.stopper.lock().unwrap_or_else(PoisonError::into_inner);
        if stopper.is_none() {
            *stopper = open()?;
        }
        Ok(())
    }

    /// Begins a line: clears earlier signals, except a signal that ends the command.
    pub(crate) fn begin(&self) {
        let mut status = self.status();
        status.received = status.received.filter(|signal| *signal == Signal::End);
        (status.count, status.halt_failed) = (0, false);
    }

    /// Returns the signal that arrived since the beginning of the line.
    pub(crate) fn received(&self) -> Option<Signal> {
        self.status().received
    }

    /// Returns whether a signal arrived since the beginning of the line.
    pub(crate) fn is_interrupted(&self) -> bool {
        self.received().is_some()
    }

    /// Fails with this message if a signal arrived since the beginning of the line.
    pub(crate) fn check(&self, message: &str) -> Result<(), Failure> {
        if self.is_interrupted() { Err(Failure::Interrupted(message.into())) } else { Ok(()) }
    }

    /// Returns whether a signal forbids further calls of a session: its command does not look for signals.
    pub(crate) fn forbids_calls(&self) -> bool {
        let status = self.status();
        status.state == State::Calling && status.received.is_some()
    }

    /// Returns whether the command must end.
    pub(crate) fn is_ended(&self) -> bool {
        self.received() == Some(Signal::End)
    }

    /// Suspends the process if SIGTSTP has ended the line or the command, whose session has given the arm back. Returns whether
    /// that was so, after the process continues.
    pub(crate) fn suspend_if_requested(&self) -> bool {
        let is_requested = self.received() == Some(Signal::Suspend);
        if is_requested {
            self.begin();
            signal::suspend();
        }
        is_requested
    }

    /// Waits; an interruption ends that with an error.
    pub(crate) fn sleep(&self, time: Duration) -> Result<(), Failure> {
        match self.wait_for(1, time) {
            0 => Ok(()),
            _ => Err(Failure::Interrupted("interrupted".into())),
        }
    }

    /// Waits until `count` signals have arrived since the beginning of the line, at most for a time. Returns their number.
    pub(crate) fn wait_for(&self, count: u32, time: Duration) -> u32 {
        let until = Instant::now() + time;
        let mut status = self.status();
        loop {
            let left = until.saturating_duration_since(Instant::now());
            if left.is_zero() || status.count >= count {
                return status.count;
            }
            let waited = self.0.changed.wait_timeout(status, left);
            status = waited.unwrap_or_else(PoisonError::into_inner).0;
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::mpsc::channel;

    use super::*;

    /// A motion whose halt ends the command, as in the shell; `then` is called after it.
    fn halting(then: impl Fn() + Send + 'static) -> Interrupt {
        let interrupt = Interrupt::new();
        let motion = interrupt.clone();
        let halt = move || {
            motion.enter(State::Stepping);
            then();
            Ok(())
        };
        interrupt.prepare(|| Ok(Some(Box::new(halt)))).unwrap();
        interrupt.set_going_on();
        interrupt.enter(State::Moving);
        interrupt
    }

    #[test]
    fn a_signal_that_halted_a_motion_is_not_for_the_next_prompt() {
        for signal in [Signal::Interrupt, Signal::Suspend] {
            let (_sender, more) = channel();
            let interrupt = halting(|| ());
            assert!(interrupt.signalled(signal, &more));
            assert_eq!((interrupt.received(), interrupt.is_ended()), (Some(signal), false));
            // the motion has ended
            assert!(!interrupt.signalled(signal, &more));
        }
    }

    #[test]
    fn a_signal_after_the_end_of_the_motion_is_for_the_next_prompt() {
        let (sender, more) = channel();
        let interrupt = halting(move || sender.send(Signal::Interrupt).unwrap());
        assert!(!interrupt.signalled(Signal::Interrupt, &more));
        assert!(interrupt.is_interrupted());
    }

    #[test]
    fn only_a_command_that_does_not_look_for_signals_makes_no_further_call() {
        let (_sender, more) = channel();
        let interrupt = Interrupt::new();
        interrupt.set_going_on();
        interrupt.raise(State::Calling);
        assert!(!interrupt.forbids_calls());
        interrupt.signalled(Signal::Suspend, &more);
        assert!(interrupt.forbids_calls());
        interrupt.raise(State::Stepping);
        assert!(!interrupt.forbids_calls());
        // it cannot be lowered by a session that is opened later
        interrupt.raise(State::Calling);
        assert_eq!(interrupt.state(), State::Stepping);
    }

    #[test]
    fn the_end_outlasts_a_line_and_a_suspension_does_not() {
        let interrupt = Interrupt::new();
        interrupt.mark(Signal::Suspend);
        interrupt.mark(Signal::Interrupt);
        assert_eq!((interrupt.received(), interrupt.wait_for(9, Duration::ZERO)), (Some(Signal::Suspend), 2));
        interrupt.begin();
        assert_eq!((interrupt.received(), interrupt.wait_for(9, Duration::ZERO)), (None, 0));
        interrupt.mark(Signal::End);
        interrupt.begin();
        assert!(interrupt.is_ended());
    }
}
