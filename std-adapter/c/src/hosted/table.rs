//! The handles: a slot and a generation, so that a closed handle is recognised when its slot is used again.

use std::ffi::c_int;
use std::sync::{Arc, Mutex, MutexGuard, Once, PoisonError, TryLockError};

use bcap_std::Settings;
use bcap_std::blocking::{Controller, KeptMotion, Stopper};
use bcap_std::core::slave::Next;
use bcap_stream::steps::Steps;

use super::Failure;
use crate::status::{BCAP_E_BUSY, BCAP_E_CLOSED, BCAP_E_HANDLE, BCAP_E_PANIC, BCAP_E_STREAMING, Status};

/// A controller of a program, and what is under way on it.
pub(super) struct Cell {
    /// `None` after a panic, and while a stream has it.
    pub(super) controller: Option<Controller>,
    /// A motion that `bcap_start` has started, until its end was waited for.
    pub(super) motion: Option<KeptMotion>,
    pub(super) stream: Option<Steps>,
}

impl Cell {
    pub(super) fn controller(&mut self) -> Result<&mut Controller, Failure> {
        match (&self.stream, &mut self.controller) {
            (Some(_), _) => Err(BCAP_E_STREAMING.into()),
            (None, Some(controller)) => Ok(controller),
            (None, None) => Err(BCAP_E_CLOSED.into()),
        }
    }

    /// Returns the controller if no motion is under way.
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
    Controller { cell: Arc<Mutex<Cell>>, address: Arc<(String, Settings)> },
    Stopper(Stopper),
}

struct Slot {
    /// Never 0, so that a handle of zeros is invalid.
    generation: u32,
    object: Option<Object>,
}

static SLOTS: Mutex<Vec<Slot>> = Mutex::new(Vec::new());

fn slots() -> MutexGuard<'static, Vec<Slot>> {
    SLOTS.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Returns the number of a slot's handle.
fn handle(index: usize, generation: u32) -> Option<u64> {
    Some(u64::from(generation) << 32 | u64::from(u32::try_from(index).ok()?))
}

fn insert(object: Object) -> Result<u64, Failure> {
    let mut slots = slots();
    let index = slots.iter().position(|slot| slot.object.is_none()).unwrap_or(slots.len());
    if index == slots.len() {
        slots.push(Slot { generation: 0, object: None });
    }
    let slot = slots.get_mut(index).ok_or(BCAP_E_HANDLE)?;
    slot.generation = slot.generation.wrapping_add(1).max(1);
    slot.object = Some(object);
    Ok(handle(index, slot.generation).ok_or(BCAP_E_HANDLE)?)
}

/// Returns the object of a handle, or with `take` removes it.
fn find(id: u64, take: bool) -> Result<Object, Failure> {
    let mut slots = slots();
    let index = usize::try_from(id & u64::from(u32::MAX)).map_err(|_| BCAP_E_HANDLE)?;
    let slot = slots.get_mut(index).filter(|slot| handle(index, slot.generation) == Some(id)).ok_or(BCAP_E_HANDLE)?;
    let object = if take { slot.object.take() } else { slot.object.clone() };
    Ok(object.ok_or(BCAP_E_HANDLE)?)
}

pub(super) fn add_controller(controller: Controller, address: &str, settings: Settings) -> Result<u64, Failure> {
    end_at_exit();
    let cell = Cell { controller: Some(controller), motion: None, stream: None };
    insert(Object::Controller { cell: Arc::new(Mutex::new(cell)), address: Arc::new((address.to_owned(), settings)) })
}

pub(super) fn add_stopper(stopper: Stopper) -> Result<u64, Failure> {
    insert(Object::Stopper(stopper))
}

/// Runs the body of a function on a controller, after those of other threads, and returns its status.
pub(super) fn on(id: u64, body: impl FnOnce(&mut Cell) -> Result<(), Failure>) -> Status {
    super::enter(|| with(id, body))
}

/// Runs calls on a controller, after those of other threads.
pub(super) fn with<T>(id: u64, calls: impl FnOnce(&mut Cell) -> Result<T, Failure>) -> Result<T, Failure> {
    let Object::Controller { cell, .. } = find(id, false)? else { return Err(BCAP_E_HANDLE.into()) };
    // after a panic its object must not be used; its drop halts the robot
    let mut cell = cell.lock().map_err(|poisoned| {
        let mut cell = poisoned.into_inner();
        (cell.stream, cell.controller) = (None, None);
        BCAP_E_PANIC
    })?;
    calls(&mut cell)
}

pub(super) fn stopper(id: u64) -> Result<Stopper, Failure> {
    match find(id, false)? {
        Object::Stopper(stopper) => Ok(stopper),
        Object::Controller { .. } => Err(BCAP_E_HANDLE.into()),
    }
}

/// Closes a stopper.
pub(super) fn close_stopper(id: u64) -> Result<(), Failure> {
    stopper(id)?;
    find(id, true).map(drop)
}

/// Ends a stream and a motion, gives the arm back, and closes a controller. The handle is invalid at once, also if that fails.
pub(super) fn close_controller(id: u64) -> Result<(), Failure> {
    let Object::Controller { .. } = find(id, false)? else { return Err(BCAP_E_HANDLE.into()) };
    let Object::Controller { cell, .. } = find(id, true)? else { return Ok(()) };
    end(&mut cell.lock().unwrap_or_else(PoisonError::into_inner))
}

fn end(cell: &mut Cell) -> Result<(), Failure> {
    if let Some(stream) = cell.stream.take() {
        // the end of the session matters, not the outcome of the stream
        (cell.controller, _) = stream.end(Next::Stop);
    }
    cell.motion = None;
    Ok(cell.controller.take().map_or(Ok(()), Controller::close)?)
}

/// Closes all controllers when the program ends, also by `exit`, so that no robot moves on.
fn end_at_exit() {
    static ONCE: Once = Once::new();

    unsafe extern "C" {
        safe fn atexit(function: extern "C" fn()) -> c_int;
    }

    extern "C" fn close_all() {
        super::enter(|| {
            let objects: Vec<_> = slots().iter_mut().filter_map(|slot| slot.object.take()).collect();
            objects.into_iter().for_each(close_at_exit);
            Ok(())
        });
    }

    ONCE.call_once(|| {
        if atexit(close_all) != 0 {
            tracing::warn!("the end of the program will not halt robots: atexit failed");
        }
    });
}

fn close_at_exit(object: Object) {
    let Object::Controller { cell, address } = object else { return };
    let locked = match cell.try_lock() {
        Err(TryLockError::WouldBlock) => {
            // a call of another thread waits for a motion, which a halt ends
            let (address, settings) = &*address;
            let halted = Stopper::connect(address, settings).and_then(|stopper| stopper.halt());
            if let Err(error) = halted {
                tracing::warn!(%error, "the program ends during a motion, and the robot was not halted");
                return;
            }
            cell.lock().unwrap_or_else(PoisonError::into_inner)
        }
        Err(TryLockError::Poisoned(poisoned)) => poisoned.into_inner(),
        Ok(cell) => cell,
    };
    let mut cell = locked;
    if let Err(failure) = end(&mut cell) {
        tracing::warn!(?failure, "the program ends, and a controller was not closed");
    }
}
