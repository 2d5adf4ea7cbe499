//! What a stream can ask of Linux: a place before others, memory that stays, a core of its own.

use std::io;

/// What the operating system shall do for the thread that streams.
///
/// An ordinary thread keeps 8 ms on a machine that is not overloaded; with these it does on a busy one, too.
///
/// # Examples
///
/// ```
/// use bcap_std::slave::Realtime;
///
/// // nothing is asked for, so nothing can be refused
/// Realtime::default().apply()?;
/// # Ok::<(), bcap_std::slave::RealtimeError>(())
/// ```
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Realtime {
    /// The priority for SCHED_FIFO, 1 to 99: the thread runs before all ordinary ones.
    pub fifo: Option<u8>,
    /// Whether all memory of the process, also what it gets later, is kept from being paged out.
    pub lock_memory: bool,
    /// The processor core to stay on, counted from 0.
    pub core: Option<usize>,
}

/// The operating system does not do what was asked for; what it did before stays.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RealtimeError {
    /// The thread's policy cannot be set.
    #[error(
        "SCHED_FIFO with priority {priority} cannot be had: {reason}; run as root, give the program the right with \
         `setcap cap_sys_nice,cap_ipc_lock+ep PROGRAM`, or allow an rtprio in /etc/security/limits.conf"
    )]
    Fifo {
        /// The priority.
        priority: u8,
        /// What the system said.
        reason: String,
    },
    /// The memory cannot be locked.
    #[error(
        "memory cannot be locked: {0}; run as root, give the program the right with `setcap \
         cap_sys_nice,cap_ipc_lock+ep PROGRAM`, or raise `ulimit -l`"
    )]
    Memory(#[source] io::Error),
    /// The thread cannot be put on the core.
    #[error("core {core} cannot be had: {source}; cores that this process may use are in /proc/self/status")]
    Core {
        /// The core.
        core: usize,
        /// What the system said.
        source: io::Error,
    },
    /// Only Linux is asked.
    #[error("priorities, locked memory and pinned cores are for Linux")]
    Unsupported,
}

impl Realtime {
    /// Asks for them, for the calling thread; the memory for the whole process.
    ///
    /// Under tokio the calling thread is the one that streams only in a runtime of the current thread.
    ///
    /// # Errors
    ///
    /// The first thing that was refused; most often rights are missing, and the message says how to give them.
    pub fn apply(&self) -> Result<(), RealtimeError> {
        if *self == Self::default() {
            return Ok(());
        }
        self.ask()
    }

    #[cfg(target_os = "linux")]
    fn ask(&self) -> Result<(), RealtimeError> {
        use rustix::mm::{MlockAllFlags, mlockall};
        use rustix::thread::{CpuSet, sched_setaffinity};
        use thread_priority::{
            RealtimeThreadSchedulePolicy, ThreadPriority, ThreadSchedulePolicy, set_thread_priority_and_policy,
            thread_native_id,
        };

        if let Some(core) = self.core {
            let refused = |source| RealtimeError::Core { core, source };
            if core >= CpuSet::MAX_CPU {
                return Err(refused(io::ErrorKind::InvalidInput.into()));
            }
            let mut cores = CpuSet::new();
            cores.set(core);
            sched_setaffinity(None, &cores).map_err(|error| refused(error.into()))?;
        }
        if self.lock_memory {
            let all = MlockAllFlags::CURRENT | MlockAllFlags::FUTURE;
            mlockall(all).map_err(|error| RealtimeError::Memory(error.into()))?;
        }
        if let Some(priority) = self.fifo {
            let refused = |reason: String| RealtimeError::Fifo { priority, reason };
            if !(1..=99).contains(&priority) {
                return Err(refused("priorities are 1 to 99".into()));
            }
            let wanted = ThreadPriority::try_from(priority).map_err(|error| refused(error.to_string()))?;
            let policy = ThreadSchedulePolicy::Realtime(RealtimeThreadSchedulePolicy::Fifo);
            set_thread_priority_and_policy(thread_native_id(), wanted, policy).map_err(|error| {
                refused(match error {
                    thread_priority::Error::OS(code) => io::Error::from_raw_os_error(code).to_string(),
                    other => other.to_string(),
                })
            })?;
        }
        Ok(())
    }

    #[cfg(not(target_os = "linux"))]
    fn ask(&self) -> Result<(), RealtimeError> {
        Err(RealtimeError::Unsupported)
    }
}

#[cfg(all(test, target_os = "linux"))]
mod tests {
    use super::*;

    #[test]
    fn what_cannot_be_had_is_said_with_what_to_do() {
        let error = Realtime { core: Some(1_000_000), ..Realtime::default() }.apply().unwrap_err().to_string();
        assert!(error.starts_with("core 1000000 cannot be had"), "{error}");
        let error = Realtime { fifo: Some(0), ..Realtime::default() }.apply().unwrap_err().to_string();
        assert!(error.contains("priority 0 cannot be had") && error.contains("setcap"), "{error}");
    }

    #[test]
    fn a_thread_stays_on_its_core() {
        // the first core that this process may use
        let allowed = rustix::thread::sched_getaffinity(None).unwrap();
        let core = (0..rustix::thread::CpuSet::MAX_CPU).find(|core| allowed.is_set(*core)).unwrap();
        let alone = std::thread::spawn(move || {
            Realtime { core: Some(core), ..Realtime::default() }.apply().unwrap();
            let now = rustix::thread::sched_getaffinity(None).unwrap();
            (now.count(), now.is_set(core))
        });
        assert_eq!(alone.join().unwrap(), (1, true));
    }
}
