//! Signals to a process, and the resources that it uses, read from `/proc`; without `/proc`, no value.

use std::time::Duration;

#[cfg(unix)]
pub use rustix::process::Signal;

/// Sends a signal directly to a child process that was not waited for yet: a program such as `kill` may start late on a busy
/// machine.
///
/// # Panics
///
/// If the system refuses it.
#[cfg(unix)]
pub fn send(signal: Signal, child: &std::process::Child) {
    use rustix::process::{Pid, kill_process};

    kill_process(Pid::from_child(child), signal).unwrap_or_else(|error| panic!("{signal:?}: {error}"));
}

/// Returns the processor time that the calling thread has used.
#[must_use]
pub fn thread_time() -> Option<Duration> {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").ok()?;
    text.split_whitespace().next()?.parse().ok().map(Duration::from_nanos)
}

/// A process.
#[derive(Clone, Copy, Debug)]
pub struct Process {
    id: u32,
}

/// The resident memory of a process, in bytes.
#[derive(Clone, Copy, Debug)]
pub struct Memory {
    /// The current memory.
    pub now: u64,
    /// The part of `now` that is not the program or another file: heap and stacks.
    pub anonymous: u64,
    /// The peak memory so far.
    pub most: u64,
}

impl Process {
    /// Returns the process with this number.
    #[must_use]
    pub const fn new(id: u32) -> Self {
        Self { id }
    }

    /// Returns the calling process.
    #[must_use]
    pub fn this() -> Self {
        Self::new(std::process::id())
    }

    /// Returns its memory.
    #[must_use]
    pub fn memory(self) -> Option<Memory> {
        let status = self.read("status")?;
        let kibibytes = |key: &str| {
            let line = status.lines().find_map(|line| line.strip_prefix(key))?;
            line.trim().trim_end_matches("kB").trim().parse::<u64>().ok()
        };
        Some(Memory {
            now: kibibytes("VmRSS:")? << 10,
            anonymous: kibibytes("RssAnon:")? << 10,
            most: kibibytes("VmHWM:")? << 10,
        })
    }

    /// Returns the processor time that it has used.
    #[must_use]
    pub fn processor_time(self) -> Option<Duration> {
        let stat = self.read("stat")?;
        // the name in front of the `)` may have blanks; utime and stime are the fields 14 and 15
        let fields: Vec<&str> = stat.rsplit_once(')')?.1.split_whitespace().collect();
        let ticks = fields.get(11)?.parse::<u64>().ok()? + fields.get(12)?.parse::<u64>().ok()?;
        // a tick is 1/100 s on every Linux that people use
        Some(Duration::from_millis(10 * ticks))
    }

    /// Returns how many threads it has.
    #[must_use]
    pub fn threads(self) -> Option<usize> {
        std::fs::read_dir(format!("/proc/{}/task", self.id)).ok().map(Iterator::count)
    }

    /// Returns how many file descriptors it has open.
    #[must_use]
    pub fn descriptors(self) -> Option<usize> {
        std::fs::read_dir(format!("/proc/{}/fd", self.id)).ok().map(Iterator::count)
    }

    fn read(self, name: &str) -> Option<String> {
        std::fs::read_to_string(format!("/proc/{}/{name}", self.id)).ok()
    }
}
