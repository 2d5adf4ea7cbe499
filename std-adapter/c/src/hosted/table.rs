//! The handles, and the activities on their controllers.

use std::collections::BTreeMap;
use std::ffi::c_int;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::sync::{Arc, Mutex, MutexGuard, Once, PoisonError, TryLockError};
use std::time::{Duration, Instant};
use std::{mem, process, thread};

use bcap_std::Settings;
use bcap_std::blocking::{Controller, KeptMotion, Stopper};
use bcap_std::core::slave::Next;
use bcap_stream::steps::Steps;

use super::Failure;
use crate::status::{BCAP_E_BUSY, BCAP_E_CLOSED, BCAP_E_HANDLE, BCAP_E_PANIC, BCAP_E_STREAMING, Status};

/// Maximum time that the end of the program waits for the calls of other threads, before and after it halts their robots.
const GRACE: Duration = Duration::from_millis(100);
const LIMIT: Duration = Duration::from_secs(5);
const PAUSE: Duration = Duration::from_millis(2);

/// A controller of a program, and the activities on it.
pub(super) struct Cell {
    /// `None` after a panic, and while a stream has it.
    pub(super) controller: Option<Controller>,
    /// A motion that `bcap_start` has started, until its end was waited for.
    pub(super) motion: Option<KeptMotion>,
    pub(super) stream: Option<Steps>,
    /// Whether this session has the arm: it may move the robot. It is read while a call has the cell.
    pub(super) has_arm: Arc<AtomicBool>,
}

impl Cell {
    fn record_arm(&self) {
        let has_arm = self.stream.is_some() || self.controller.as_ref().is_some_and(Controller::has_arm);
        self.has_arm.store(has_arm, Relaxed);
    }

    pub(super) fn controller(&mut self) -> Result<&mut Controller, Failure> {
        match (&self.stream, &mut self.controller) {
            (Some(_), _) => Err(BCAP_E_STREAMING.into()),
            (None, Some(controller)) => Ok(controller),
            (None, None) => Err(BCAP_E_CLOSED.into()),
        }
    }

    /// Returns the controller if no motion is running.
    pub(super) fn at_rest(&mut self) -> Result<&mut Controller, Failure> {
        if self.motion.is_some() {
            return Err(Failure::new(BCAP_E_BUSY, "a motion is under way; call bcap_wait or bcap_halt first"));
        }
        self.controller()
    }
}

/// The object of a handle.
#[derive(Clone)]
enum Object {
    Controller(Arc<Shared>),
    Stopper(Stopper),
}

/// A controller, and how to connect again while a call has it.
struct Shared {
    cell: Mutex<Cell>,
    has_arm: Arc<AtomicBool>,
    address: String,
    settings: Settings,
}

/// An object, and the process that opened it. A forked process inherits objects, but must not use them: their sessions and their
/// threads are the parent's.
struct Entry {
    process: u32,
    object: Object,
}

impl Entry {
    fn is_own(&self) -> bool {
        self.process == process::id()
    }
}

type Entries = BTreeMap<u64, Entry>;

/// The generation of the latest handle, and the objects of those that are open. Each handle has a new generation, so that one that
/// was closed is never valid again; 0 is invalid.
static OBJECTS: Mutex<(u64, Entries)> = Mutex::new((0, Entries::new()));

fn objects() -> MutexGuard<'static, (u64, Entries)> {
    OBJECTS.lock().unwrap_or_else(PoisonError::into_inner)
}

fn insert(object: Object) -> u64 {
    let (generation, objects) = &mut *objects();
    *generation += 1;
    objects.insert(*generation, Entry { process: process::id(), object });
    *generation
}

/// Returns the object of a handle of this process, or with `take` removes it.
fn find(id: u64, take: bool) -> Result<Object, Failure> {
    let (_, objects) = &mut *objects();
    let found = objects.get(&id).filter(|entry| entry.is_own()).map(|entry| entry.object.clone());
    if take && found.is_some() {
        objects.remove(&id);
    }
    Ok(found.ok_or(BCAP_E_HANDLE)?)
}

fn controller(id: u64) -> Result<Arc<Shared>, Failure> {
    let Object::Controller(shared) = find(id, false)? else { return Err(BCAP_E_HANDLE.into()) };
    Ok(shared)
}

pub(super) fn add_controller(controller: Controller, address: &str, settings: Settings) -> u64 {
    end_at_exit();
    let has_arm = Arc::<AtomicBool>::default();
    let cell = Cell { controller: Some(controller), motion: None, stream: None, has_arm: Arc::clone(&has_arm) };
    insert(Object::Controller(Arc::new(Shared {
        cell: Mutex::new(cell),
        has_arm,
        address: address.to_owned(),
        settings,
    })))
}

pub(super) fn add_stopper(stopper: Stopper) -> u64 {
    insert(Object::Stopper(stopper))
}

/// Runs the body of a function on a controller, after calls of other threads, and returns its status.
pub(super) fn on(id: u64, body: impl FnOnce(&mut Cell) -> Result<(), Failure>) -> Status {
    super::enter(|| with(id, body))
}

/// Runs calls on a controller, after calls of other threads.
pub(super) fn with<T>(id: u64, calls: impl FnOnce(&mut Cell) -> Result<T, Failure>) -> Result<T, Failure> {
    let shared = controller(id)?;
    // poisoned by a panic
    let mut cell = shared.cell.lock().map_err(|_| BCAP_E_PANIC)?;
    let ended = catch_unwind(AssertUnwindSafe(|| calls(&mut cell))).unwrap_or_else(|payload| {
        // after a panic its object must not be used; its end halts the robot, and has logged its error
        let _ = end(&mut cell);
        resume_unwind(payload)
    });
    cell.record_arm();
    ended
}

pub(super) fn stopper(id: u64) -> Result<Stopper, Failure> {
    let Object::Stopper(stopper) = find(id, false)? else { return Err(BCAP_E_HANDLE.into()) };
    Ok(stopper)
}

/// Closes a stopper.
pub(super) fn close_stopper(id: u64) -> Result<(), Failure> {
    stopper(id)?;
    find(id, true).map(drop)
}

/// Ends a stream and a motion, gives the arm back, and closes a controller. The handle is immediately invalid, even if that
/// fails.
pub(super) fn close_controller(id: u64) -> Result<(), Failure> {
    let shared = controller(id)?;
    // only one of several threads closes it
    find(id, true)?;
    end(&mut shared.cell.lock().unwrap_or_else(PoisonError::into_inner))
}

fn end(cell: &mut Cell) -> Result<(), Failure> {
    if let Some(stream) = cell.stream.take() {
        // the end of the session matters, not the outcome of the stream
        (cell.controller, _) = stream.end(Next::Stop);
    }
    cell.motion = None;
    Ok(cell.controller.take().map_or(Ok(()), Controller::close)?)
}

/// Takes the objects of this process. Inherited ones stay: their drop would end sessions of the parent.
fn take_own() -> Entries {
    let (_, objects) = &mut *objects();
    let (own, inherited): (Entries, Entries) = mem::take(objects).into_iter().partition(|(_, entry)| entry.is_own());
    *objects = inherited;
    own
}

/// Closes all controllers of this process when it ends, even by `exit`, so that no robot continues to move.
fn end_at_exit() {
    static ONCE: Once = Once::new();

    unsafe extern "C" {
        safe fn atexit(function: extern "C" fn()) -> c_int;
    }

    extern "C" fn close_all() {
        // not `enter`, because a log callback may call `exit`
        super::catch(|| {
            let own = take_own();
            let controller = |entry: &Entry| match &entry.object {
                Object::Controller(shared) => Some(Arc::clone(shared)),
                Object::Stopper(_) => None,
            };
            close_at_exit(own.values().filter_map(controller).collect());
            Ok(())
        });
    }

    ONCE.call_once(|| {
        if atexit(close_all) != 0 {
            tracing::warn!("the end of the program will not halt robots: atexit failed");
        }
    });
}

/// Closes controllers whose handles are invalid already. Calls of other threads may still use some. If these calls do not end soon,
/// they may wait for a motion, so the robot is halted over another connection, but only if this session has its arm.
fn close_at_exit(mut open: Vec<Arc<Shared>>) {
    let grace = Instant::now() + GRACE;
    let mut until = grace + LIMIT;
    loop {
        open.retain(|shared| !closed(shared));
        if open.is_empty() || Instant::now() >= until {
            break;
        }
        for shared in open.iter().filter(|shared| Instant::now() >= grace && shared.has_arm.swap(false, Relaxed)) {
            let halted = Stopper::connect(&shared.address, &shared.settings).and_then(|stopper| stopper.halt());
            if let Err(error) = halted {
                tracing::error!(%error, "the program ends during a call, and the robot was not halted");
            }
            until = Instant::now() + LIMIT;
        }
        thread::sleep(PAUSE);
    }
    for shared in open {
        let address = &shared.address;
        tracing::error!(address, "the program ends during a call: if it had the arm, it did not give it back");
    }
}

/// Closes a controller, unless a call uses it.
fn closed(shared: &Shared) -> bool {
    let mut cell = match shared.cell.try_lock() {
        Err(TryLockError::WouldBlock) => return false,
        Err(TryLockError::Poisoned(poisoned)) => poisoned.into_inner(),
        Ok(cell) => cell,
    };
    if let Err(failure) = end(&mut cell) {
        tracing::warn!(?failure, "the program ends, and a controller was not closed");
    }
    true
}

#[cfg(test)]
mod tests {
    use std::io::{self, Cursor, Read};

    use bcap_std::blocking::Transport;
    use bcap_std::core::bcap::FunctionId;
    use bcap_std::core::bcap::header::Header;
    use bcap_std::core::time::Instant;

    use super::*;
    use crate::status::BCAP_OK;

    /// A controller that answers every call with the number 1, and records the functions.
    struct Peer {
        calls: Arc<Mutex<Vec<FunctionId>>>,
        reply: Cursor<Vec<u8>>,
    }

    impl Transport for Peer {
        type Error = io::Error;

        fn now(&self) -> Instant {
            bcap_std::now()
        }

        fn send(&mut self, request: &[u8], _: Instant) -> io::Result<Option<usize>> {
            let header = Header::read(request).unwrap();
            self.calls.lock().unwrap().push(header.function());
            // its length, I4, one element, 1
            let argument: [u8; 14] = [10, 0, 0, 0, 3, 0, 1, 0, 0, 0, 1, 0, 0, 0];
            let reply = Header { length: 30, code: 0, count: 1, ..header }.to_bytes();
            self.reply = Cursor::new([reply.as_slice(), &argument, &[4]].concat());
            Ok(Some(request.len()))
        }

        fn receive(&mut self, buffer: &mut [u8], _: Instant) -> io::Result<Option<usize>> {
            let count = self.reply.read(buffer)?;
            Ok((count > 0).then_some(count))
        }

        fn sleep_until(&mut self, _: Instant) {}
    }

    #[test]
    fn a_panic_ends_the_session_before_the_function_returns() {
        let calls = Arc::<Mutex<Vec<FunctionId>>>::default();
        let stopped = || calls.lock().unwrap().contains(&FunctionId::SERVICE_STOP);
        let settings = Settings::rc8();
        let peer = Peer { calls: Arc::clone(&calls), reply: Cursor::default() };
        let id = add_controller(Controller::over(peer, &settings).unwrap(), "", settings);
        assert_eq!(on(id, |_| Ok(())), BCAP_OK);
        assert!(!stopped());
        assert_eq!(on(id, |_| panic!("a defect")), BCAP_E_PANIC);
        assert!(stopped());
        assert_eq!(on(id, |_| Ok(())), BCAP_E_PANIC);
    }
}
