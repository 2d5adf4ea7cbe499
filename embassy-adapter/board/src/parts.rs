//! The state that the tasks of a gateway board share: the gateway, their numbers, and board-specific data.

use bcap_embassy::gateway::SharedGateway;
use bcap_embassy::net::{Backlog, Usage};
use embassy_sync::blocking_mutex::raw::NoopRawMutex;

use crate::identity::VERSION;
use crate::record::Cause;
#[cfg(feature = "modbus")]
use crate::sizes::MODBUS;
#[cfg(feature = "health")]
use crate::sizes::PAGES;
use crate::sizes::PLCS;
use crate::watchdog::Task;

/// The tasks that the watchdog watches; the PLCs' tasks have the numbers from `PLC` on.
pub(crate) const NETWORK: Task = Task::new(0);
pub(crate) const ROBOT: Task = Task::new(1);
pub(crate) const STATUS: Task = Task::new(2);
pub(crate) const DATAGRAMS: Task = Task::new(3);
pub(crate) const PLC: u32 = 4;
/// Listeners of RAC. One of them answers PLCs without a slot.
pub(crate) const LISTENERS: usize = PLCS + 1;
/// The first number after the listeners of RAC, and after the ones of Modbus.
pub(crate) const AFTER_PLCS: u32 = PLC + LISTENERS as u32;
#[cfg(feature = "modbus")]
pub(crate) const SPARE_TASK: Task = Task::new(AFTER_PLCS + MODBUS as u32);
#[cfg(feature = "modbus")]
const AFTER_MODBUS: u32 = AFTER_PLCS + MODBUS as u32 + 1;
#[cfg(not(feature = "modbus"))]
const AFTER_MODBUS: u32 = AFTER_PLCS;
#[cfg(feature = "health")]
pub(crate) const PAGE_TASK: u32 = AFTER_MODBUS;
#[cfg(feature = "health")]
const TASKS: u32 = PAGE_TASK + PAGES as u32;
#[cfg(not(feature = "health"))]
const TASKS: u32 = AFTER_MODBUS;
const _: () = assert!(TASKS <= 32, "the watchdog watches 32 tasks: use fewer listeners");

/// The gateway that the tasks share.
pub type Board = SharedGateway<'static, NoopRawMutex, PLCS>;

/// The buffers of the PLCs' sockets and of the robot's TCP socket, and their size in bytes.
pub(crate) static PLC_BUFFERS: Usage = Usage::new();
pub(crate) const PLC_BUFFER: usize = 256;
pub(crate) static ROBOT_BUFFERS: Usage = Usage::new();
pub(crate) const ROBOT_BUFFER: usize = 1024;

/// The listeners of PLCs, of Modbus and of the page.
pub(crate) static PLC_BACKLOG: Backlog = Backlog::new();
#[cfg(feature = "modbus")]
pub(crate) static MODBUS_BACKLOG: Backlog = Backlog::new();
#[cfg(feature = "health")]
pub(crate) static PAGE_BACKLOG: Backlog = Backlog::new();

/// Board-specific data for the status line and the page.
#[derive(Clone, Copy)]
pub struct Parts {
    /// The name of the board or the project, for `bcap board find`.
    pub name: &'static str,
    /// The version of the image; at most 20 bytes.
    pub version: &'static str,
    /// The cause of the last reset.
    pub last_reset: Cause,
    /// Writes the counters of the Ethernet controller.
    pub frames: fn(defmt::Formatter<'_>),
    /// Passes the name and the count of further counters, for the page.
    pub counters: fn(&mut dyn FnMut(&'static str, u32)),
    /// Returns the high-water mark and the size of the stack, in bytes; zeros where they are not measured.
    pub stack: fn() -> (usize, usize),
    /// Returns the high-water mark and the size of the buffer of the log, in bytes; zeros if the board has no log buffer.
    pub log: fn() -> (usize, usize),
    /// Returns the number of lines of the log that were dropped.
    pub dropped: fn() -> u32,
}

impl Parts {
    /// Logs the cause of the last reset, and returns the parts of a board of this name that has no separate counters. `version`
    /// is the version of the image, `env!("CARGO_PKG_VERSION")`.
    #[must_use]
    pub fn after(last_reset: Cause, name: &'static str, version: &'static str) -> Self {
        defmt::info!("last reset: {}", defmt::Display2Format(&last_reset));
        #[cfg(feature = "update")]
        crate::trial::set_last_reset(last_reset);
        Self {
            name,
            // a project can have a longer one
            version: version.get(..version.len().min(VERSION)).unwrap_or_default(),
            last_reset,
            frames: |_| {},
            counters: |_| {},
            #[cfg(all(feature = "cortex-m", target_arch = "arm"))]
            stack: || (crate::stack::high_water(), crate::stack::size()),
            #[cfg(not(all(feature = "cortex-m", target_arch = "arm")))]
            stack: || (0, 0),
            #[cfg(feature = "log")]
            log: || (usize::try_from(crate::log::ring().most()).unwrap_or_default(), crate::log::SIZE),
            #[cfg(not(feature = "log"))]
            log: || (0, 0),
            #[cfg(feature = "log")]
            dropped: crate::log::dropped,
            #[cfg(not(feature = "log"))]
            dropped: || 0,
        }
    }
}
