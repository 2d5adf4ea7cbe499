//! Signals while a command may move the robot: SIGINT (Ctrl-C) halts it, SIGTERM and SIGHUP also end the command.
//!
//! The session of the command waits for a reply then, so the halt has a session of its own, which is opened before the motion
//! begins. The command gives the arm back when its call has ended.

use std::io::{self, Write as _};
use std::process;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, channel};
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

use crate::error::Failure;

/// How long a motion that begins beside a halt may run until the next halt.
const AGAIN: Duration = Duration::from_millis(50);

/// The further SIGINT that end a command whose call does not end.
const MAX_INTERRUPTS: u32 = 5;

/// Halts the robot over a session of its own.
pub(crate) type Halt = Box<dyn FnMut() -> Result<(), Failure> + Send>;

/// What signals do.
#[derive(Clone)]
pub(crate) struct Interrupt(Arc<Shared>);

struct Shared {
    /// Whether a signal arrived since the beginning of the line.
    interrupted: Mutex<bool>,
    changed: Condvar,
    /// Whether the command must end.
    ended: AtomicBool,
    /// Whether this command may move the robot now.
    moving: AtomicBool,
    /// Whether this command ends between two calls, and a second signal ends it at once.
    ends: AtomicBool,
    /// Whether the process goes on after the command: it is the shell, or runs a script.
    goes_on: AtomicBool,
    /// Whether the command always restores what it changed, so that no number of signals ends it before.
    restores: AtomicBool,
    /// How the robot is halted.
    stopper: Mutex<Option<Halt>>,
}

/// A signal.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Signal {
    /// SIGINT.
    Interrupt,
    /// SIGTERM or SIGHUP.
    End,
}

/// The handler of this process.
static INSTALLED: Mutex<Option<Interrupt>> = Mutex::new(None);

impl Interrupt {
    /// Handles signals from now on. `idle` is called after each that did not halt a motion; its argument is whether the command
    /// must end.
    ///
    /// A process has one handler: a later call, as by a line of the shell, returns it, and ignores its own `idle`.
    pub(crate) fn install(idle: impl Fn(bool) + Send + 'static) -> io::Result<Self> {
        let mut installed = INSTALLED.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(interrupt) = &*installed {
            return Ok(interrupt.clone());
        }
        let interrupt = Self::new();
        let (signals, handler) = (signals()?, interrupt.clone());
        thread::Builder::new().name("interrupt".into()).spawn(move || {
            while let Ok(signal) = signals.recv() {
                let was_answered = handler.signalled(signal, &signals);
                let must_end = handler.is_ended();
                if must_end || !was_answered {
                    idle(must_end);
                }
            }
        })?;
        Ok(installed.insert(interrupt).clone())
    }

    fn new() -> Self {
        Self(Arc::new(Shared {
            interrupted: Mutex::new(false),
            changed: Condvar::new(),
            ended: AtomicBool::new(false),
            moving: AtomicBool::new(false),
            ends: AtomicBool::new(false),
            goes_on: AtomicBool::new(false),
            restores: AtomicBool::new(false),
            stopper: Mutex::new(None),
        }))
    }

    /// Handles a signal, and those that arrive meanwhile. Returns whether the last one halted a motion: then it is not for the
    /// prompt, which may have begun since.
    fn signalled(&self, signal: Signal, more: &Receiver<Signal>) -> bool {
        let Self(shared) = self;
        if signal == Signal::End {
            shared.ended.store(true, Ordering::SeqCst);
        }
        if shared.ends.load(Ordering::SeqCst) {
            let goes_on = shared.goes_on.load(Ordering::SeqCst);
            if self.is_interrupted() && !goes_on {
                process::exit(130);
            }
            let again = if goes_on { "" } else { "; press Ctrl-C again to end at once" };
            // an error of printing cannot be reported
            let _ = writeln!(io::stderr(), "ends after this call{again}");
        }
        self.mark();
        let (mut reported, mut again, mut was_answered) = (false, 0, false);
        // a motion may begin just after a halt, so halt until the command has ended its call; then the next line may begin
        while shared.moving.load(Ordering::SeqCst) && self.is_interrupted() {
            if let Err(failure) = self.halt()
                && !reported
            {
                failure.print(false, None);
                reported = true;
            }
            was_answered = true;
            match more.recv_timeout(AGAIN) {
                Ok(Signal::End) => shared.ended.store(true, Ordering::SeqCst),
                Ok(Signal::Interrupt) => {
                    // for the next line, if the one that was interrupted has just ended
                    self.mark();
                    again += 1;
                    was_answered = false;
                }
                Err(_) => {}
            }
            if again == MAX_INTERRUPTS && !shared.restores.load(Ordering::SeqCst) {
                let what = "interrupted again and again, so the command ends; the controller gives the arm back when it \
                            notices the end of the connection";
                Failure::Interrupted(what.into()).print(false, None);
                process::exit(130);
            }
        }
        was_answered
    }

    /// Sets that the process goes on after the command, so that no signal ends it at once: its session must be closed.
    pub(crate) fn set_going_on(&self) {
        self.0.goes_on.store(true, Ordering::SeqCst);
    }

    /// Lets the command end between two calls on a signal, until the guard is dropped. A second signal ends the process at once,
    /// unless it [goes on](Self::set_going_on).
    pub(crate) fn end_between_calls(&self) -> EndsBetweenCalls {
        self.0.ends.store(true, Ordering::SeqCst);
        EndsBetweenCalls(self.clone())
    }

    /// Halts the robot on every signal until [`set_moving`](Self::set_moving) says that the command has restored what it changed;
    /// no number of signals ends the command before.
    pub(crate) fn halt_until_restored(&self) {
        self.0.restores.store(true, Ordering::SeqCst);
        self.set_moving(true);
    }

    /// Records a signal.
    fn mark(&self) {
        *self.0.interrupted.lock().unwrap_or_else(PoisonError::into_inner) = true;
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
        stopper.as_mut().map_or(Ok(false), |halt| halt().map(|()| true))
    }

    /// Returns whether there is a way to halt the robot while a call runs.
    pub(crate) fn can_halt(&self) -> bool {
        self.0.stopper.lock().unwrap_or_else(PoisonError::into_inner).is_some()
    }

    /// Returns the failure of a command that a signal interrupted while its session had the arm.
    pub(crate) fn failure(&self) -> Failure {
        let halted = if self.can_halt() { "the robot was halted" } else { "the motion was not halted: it has ended" };
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

    /// Begins a line: forgets earlier interruptions.
    pub(crate) fn begin(&self) {
        *self.0.interrupted.lock().unwrap_or_else(PoisonError::into_inner) = false;
    }

    /// Sets whether the command may move the robot from now on.
    pub(crate) fn set_moving(&self, moving: bool) {
        self.0.moving.store(moving, Ordering::SeqCst);
        if !moving {
            self.0.restores.store(false, Ordering::SeqCst);
        }
    }

    /// Returns whether a signal arrived since the beginning of the line.
    pub(crate) fn is_interrupted(&self) -> bool {
        *self.0.interrupted.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Returns whether the command must end.
    pub(crate) fn is_ended(&self) -> bool {
        self.0.ended.load(Ordering::SeqCst)
    }

    /// Waits; an interruption ends that with an error.
    pub(crate) fn sleep(&self, time: Duration) -> Result<(), Failure> {
        let until = Instant::now() + time;
        let mut interrupted = self.0.interrupted.lock().unwrap_or_else(PoisonError::into_inner);
        loop {
            let left = until.saturating_duration_since(Instant::now());
            if *interrupted {
                return Err(Failure::Interrupted("interrupted".into()));
            }
            if left.is_zero() {
                return Ok(());
            }
            let waited = self.0.changed.wait_timeout(interrupted, left);
            interrupted = waited.unwrap_or_else(PoisonError::into_inner).0;
        }
    }
}

/// Resets [`Interrupt::end_between_calls`] when it is dropped.
pub(crate) struct EndsBetweenCalls(Interrupt);

impl Drop for EndsBetweenCalls {
    fn drop(&mut self) {
        self.0.0.ends.store(false, Ordering::SeqCst);
    }
}

/// Returns a receiver of all further signals.
fn signals() -> io::Result<Receiver<Signal>> {
    let (sender, receiver) = channel();
    let runtime = tokio::runtime::Builder::new_current_thread().enable_io().build()?;
    let mut sources = {
        let _inside = runtime.enter();
        Sources::new()?
    };
    thread::Builder::new().name("signals".into()).spawn(move || {
        runtime.block_on(async { while sender.send(sources.next().await).is_ok() {} });
    })?;
    Ok(receiver)
}

#[cfg(unix)]
struct Sources {
    interrupt: tokio::signal::unix::Signal,
    terminate: tokio::signal::unix::Signal,
    hangup: tokio::signal::unix::Signal,
}

#[cfg(unix)]
impl Sources {
    fn new() -> io::Result<Self> {
        use tokio::signal::unix::{SignalKind, signal};
        let [interrupt, terminate, hangup] =
            [SignalKind::interrupt(), SignalKind::terminate(), SignalKind::hangup()].map(signal);
        Ok(Self { interrupt: interrupt?, terminate: terminate?, hangup: hangup? })
    }

    async fn next(&mut self) -> Signal {
        tokio::select! {
            _ = self.interrupt.recv() => Signal::Interrupt,
            _ = self.terminate.recv() => Signal::End,
            _ = self.hangup.recv() => Signal::End,
        }
    }
}

#[cfg(not(unix))]
struct Sources;

#[cfg(not(unix))]
impl Sources {
    fn new() -> io::Result<Self> {
        Ok(Self)
    }

    async fn next(&mut self) -> Signal {
        // without a handler there is no signal
        if tokio::signal::ctrl_c().await.is_err() {
            std::future::pending::<()>().await;
        }
        Signal::Interrupt
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A motion whose halt ends the command, as in the shell; `then` is called after it.
    fn halting(then: impl Fn() + Send + 'static) -> Interrupt {
        let interrupt = Interrupt::new();
        let motion = interrupt.clone();
        let halt = move || {
            motion.set_moving(false);
            then();
            Ok(())
        };
        interrupt.prepare(|| Ok(Some(Box::new(halt)))).unwrap();
        interrupt.set_moving(true);
        interrupt
    }

    #[test]
    fn a_signal_that_halted_a_motion_is_not_for_the_next_prompt() {
        let (_sender, more) = channel();
        let interrupt = halting(|| ());
        assert!(interrupt.signalled(Signal::Interrupt, &more));
        assert!(!interrupt.is_ended());
        // nothing moves now
        assert!(!interrupt.signalled(Signal::Interrupt, &more));
    }

    #[test]
    fn a_signal_after_the_end_of_the_motion_is_for_the_next_prompt() {
        let (sender, more) = channel();
        let interrupt = halting(move || sender.send(Signal::Interrupt).unwrap());
        assert!(!interrupt.signalled(Signal::Interrupt, &more));
        assert!(interrupt.is_interrupted());
    }
}
