//! Real-time settings of Linux for a stream: SCHED_FIFO priority, locked memory, CPU affinity.

use std::io;

/// Real-time settings for the thread that streams.
///
/// Without them a thread keeps the cycle of 8 ms on a machine that is not overloaded; with them even on a busy machine.
///
/// # Examples
///
/// ```
/// use bcap_std::slave::Realtime;
///
/// // the default requests nothing, so nothing can be refused
/// Realtime::default().apply()?;
/// # Ok::<(), bcap_std::slave::RealtimeError>(())
/// ```
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub struct Realtime {
    /// The SCHED_FIFO priority, 1 to 99: the thread runs before all threads of the normal policy.
    pub fifo: Option<u8>,
    /// Whether to lock the memory of the process, present and future, so that it is never paged out.
    pub lock_memory: bool,
    /// The processor core to run on, counted from 0.
    pub core: Option<usize>,
}

setters! { Realtime {
    fifo: Option<u8>;
    lock_memory: bool;
    core: Option<usize>;
} }

/// The operating system refused a setting; settings that were applied before remain.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RealtimeError {
    /// The scheduling policy cannot be set.
    #[error(
        "cannot set SCHED_FIFO priority {priority}: {reason}; run as root, grant the capability with \
         `setcap cap_sys_nice,cap_ipc_lock+ep PROGRAM`, or allow an rtprio in /etc/security/limits.conf"
    )]
    Fifo {
        /// The priority.
        priority: u8,
        /// The operating system's error, or the accepted range.
        reason: String,
    },
    /// The memory cannot be locked.
    #[error(
        "cannot lock memory: {0}; run as root, grant the capability with `setcap \
         cap_sys_nice,cap_ipc_lock+ep PROGRAM`, or raise `ulimit -l`"
    )]
    Memory(#[source] io::Error),
    /// The thread cannot be pinned to the core.
    #[error(
        "cannot pin the thread to core {core}: {source}; /proc/self/status lists the cores that this process may use"
    )]
    Core {
        /// The core.
        core: usize,
        /// The operating system's error.
        source: io::Error,
    },
    /// The operating system is not Linux.
    #[error("SCHED_FIFO, locked memory and pinned cores need Linux")]
    Unsupported,
}

impl Realtime {
    /// Applies priority and core to the calling thread, and locks the memory of the process.
    ///
    /// Under tokio, call this in a current-thread runtime: in a multi-thread runtime the stream may run on another thread.
    ///
    /// # Errors
    ///
    /// The first setting that was refused. The usual cause is a missing privilege; the message says how to grant it.
    pub fn apply(&self) -> Result<(), RealtimeError> {
        if *self == Self::default() {
            return Ok(());
        }
        self.request()
    }

    #[cfg(target_os = "linux")]
    fn request(&self) -> Result<(), RealtimeError> {
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
                return Err(refused("the priority must be 1 to 99".into()));
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
    fn request(&self) -> Result<(), RealtimeError> {
        Err(RealtimeError::Unsupported)
    }
}

#[cfg(all(test, target_os = "linux"))]
mod tests {
    use super::*;

    #[test]
    fn errors_name_the_refused_setting_and_the_remedy() {
        let error = Realtime::default().core(Some(1_000_000)).apply().unwrap_err().to_string();
        assert!(error.starts_with("cannot pin the thread to core 1000000"), "{error}");
        let error = Realtime::default().fifo(Some(0)).apply().unwrap_err().to_string();
        assert!(error.contains("SCHED_FIFO priority 0: the priority must be 1 to 99"), "{error}");
        assert!(error.contains("setcap"), "{error}");
    }

    #[test]
    fn the_thread_is_pinned_to_its_core() {
        let allowed = rustix::thread::sched_getaffinity(None).unwrap();
        let core = (0..rustix::thread::CpuSet::MAX_CPU).find(|core| allowed.is_set(*core)).unwrap();
        let pinned = std::thread::spawn(move || {
            Realtime::default().core(Some(core)).apply().unwrap();
            let now = rustix::thread::sched_getaffinity(None).unwrap();
            (now.count(), now.is_set(core))
        });
        assert_eq!(pinned.join().unwrap(), (1, true));
    }
}
