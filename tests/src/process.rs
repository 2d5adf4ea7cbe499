//! What a process takes of the machine, as `/proc` tells it; nothing where there is no `/proc`.

use std::time::Duration;

/// A process.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Process {
    id: u32,
}

/// The resident memory of a process, in bytes.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Memory {
    pub(crate) now: u64,
    pub(crate) most: u64,
}

impl Process {
    pub(crate) const fn new(id: u32) -> Self {
        Self { id }
    }

    /// Returns the process that asks.
    pub(crate) fn this() -> Self {
        Self::new(std::process::id())
    }

    /// Returns its memory.
    pub(crate) fn memory(self) -> Option<Memory> {
        let status = self.read("status")?;
        let kibibytes = |key: &str| {
            let line = status.lines().find_map(|line| line.strip_prefix(key))?;
            line.trim().trim_end_matches("kB").trim().parse::<u64>().ok()
        };
        Some(Memory { now: kibibytes("VmRSS:")? << 10, most: kibibytes("VmHWM:")? << 10 })
    }

    /// Returns the processor time that it has used.
    pub(crate) fn processor_time(self) -> Option<Duration> {
        let stat = self.read("stat")?;
        // the name in front of the `)` may have blanks; utime and stime are the fields 14 and 15
        let fields: Vec<&str> = stat.rsplit_once(')')?.1.split_whitespace().collect();
        let ticks = fields.get(11)?.parse::<u64>().ok()? + fields.get(12)?.parse::<u64>().ok()?;
        // a tick is 1/100 s on every Linux that people use
        Some(Duration::from_millis(10 * ticks))
    }

    /// Returns how many file descriptors it has open.
    pub(crate) fn descriptors(self) -> Option<usize> {
        std::fs::read_dir(format!("/proc/{}/fd", self.id)).ok().map(Iterator::count)
    }

    fn read(self, name: &str) -> Option<String> {
        std::fs::read_to_string(format!("/proc/{}/{name}", self.id)).ok()
    }
}
