//! Counters, and their text in the format of OpenMetrics.

use std::fmt::Write as _;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

/// The counters of a fleet.
#[derive(Debug)]
pub(crate) struct Metrics {
    pub(crate) cells: Vec<CellMetrics>,
    /// Whether this process reads and publishes; a standby does not.
    pub(crate) active: AtomicBool,
    pub(crate) broker_up: AtomicBool,
    pub(crate) broker_connections: AtomicU64,
    /// Readings that the broker has.
    pub(crate) published: AtomicU64,
    /// Readings that were lost because the buffer was full or they were too old.
    pub(crate) dropped: AtomicU64,
    /// Readings on disk.
    pub(crate) stored: AtomicU64,
    pub(crate) stored_bytes: AtomicU64,
    /// Whether the buffer on disk did not take the last reading.
    pub(crate) buffer_failed: AtomicBool,
    pub(crate) commands: AtomicU64,
    pub(crate) refused: AtomicU64,
}

/// The counters of a controller.
#[derive(Debug, Default)]
pub(crate) struct CellMetrics {
    pub(crate) up: AtomicBool,
    pub(crate) readings: AtomicU64,
    pub(crate) errors: AtomicU64,
    /// Readings that were skipped while a stream of Slave Mode ran.
    pub(crate) skipped: AtomicU64,
    pub(crate) overruns: AtomicU64,
    /// The time of all reads, in microseconds; their number is `readings` and `errors`.
    pub(crate) read_us: AtomicU64,
    /// The time of the last scan, in microseconds: the reads of all points whose deadline had passed.
    pub(crate) scan_us: AtomicU64,
}

impl Metrics {
    pub(crate) fn new(cells: usize) -> Self {
        Self {
            cells: (0..cells).map(|_| CellMetrics::default()).collect(),
            active: AtomicBool::new(true),
            broker_up: AtomicBool::new(false),
            broker_connections: AtomicU64::new(0),
            published: AtomicU64::new(0),
            dropped: AtomicU64::new(0),
            stored: AtomicU64::new(0),
            stored_bytes: AtomicU64::new(0),
            buffer_failed: AtomicBool::new(false),
            commands: AtomicU64::new(0),
            refused: AtomicU64::new(0),
        }
    }

    /// Counts lost readings: dropped from a full queue or by the backlog.
    pub(crate) fn lose(&self, readings: u64) {
        self.dropped.fetch_add(readings, Ordering::Relaxed);
    }

    /// Writes all counters. `names` are the names of the controllers.
    pub(crate) fn text<'a>(&self, names: impl Iterator<Item = &'a str> + Clone, queued: usize) -> String {
        let mut text = String::new();
        let get = |counter: &AtomicU64| counter.load(Ordering::Relaxed);
        let mut per_cell = |name: &str, kind: &str, help: &str, value: &dyn Fn(&CellMetrics) -> String| {
            family(&mut text, name, kind, help);
            let suffix = if kind == "counter" { "_total" } else { "" };
            for (cell, label) in self.cells.iter().zip(names.clone()) {
                let _ = writeln!(text, "{name}{suffix}{{controller=\"{}\"}} {}", escape(label), value(cell));
            }
        };
        per_cell("bcap_controller_up", "gauge", "Whether there is a session.", &|cell| {
            u8::from(cell.up.load(Ordering::Relaxed)).to_string()
        });
        per_cell("bcap_readings", "counter", "Values that were read.", &|cell| get(&cell.readings).to_string());
        per_cell("bcap_read_errors", "counter", "Values that could not be read.", &|cell| {
            get(&cell.errors).to_string()
        });
        per_cell("bcap_read_skipped", "counter", "Values that were not read while a stream ran.", &|cell| {
            get(&cell.skipped).to_string()
        });
        per_cell(
            "bcap_scan_overruns",
            "counter",
            "Readings that were left out because the controller is too slow.",
            &|cell| get(&cell.overruns).to_string(),
        );
        per_cell("bcap_read_seconds", "counter", "The time of all reads.", &|cell| {
            format!("{:.6}", std::time::Duration::from_micros(get(&cell.read_us)).as_secs_f64())
        });
        per_cell("bcap_scan_seconds", "gauge", "The time of the last scan.", &|cell| {
            format!("{:.6}", std::time::Duration::from_micros(get(&cell.scan_us)).as_secs_f64())
        });
        let up = u64::from(self.broker_up.load(Ordering::Relaxed));
        let active = u64::from(self.active.load(Ordering::Relaxed));
        let buffer_failed = u64::from(self.buffer_failed.load(Ordering::Relaxed));
        for (name, kind, help, value) in [
            ("bcap_active", "gauge", "Whether this process is not a standby.", active),
            ("bcap_broker_up", "gauge", "Whether there is a connection to the broker.", up),
            ("bcap_broker_connections", "counter", "Connections to the broker.", get(&self.broker_connections)),
            ("bcap_published", "counter", "Readings that the broker has.", get(&self.published)),
            ("bcap_dropped", "counter", "Readings that were lost: full buffer, or too old.", get(&self.dropped)),
            ("bcap_queued", "gauge", "Readings in memory.", queued as u64),
            ("bcap_stored", "gauge", "Readings on disk.", get(&self.stored)),
            ("bcap_stored_bytes", "gauge", "Bytes of the readings on disk.", get(&self.stored_bytes)),
            ("bcap_buffer_failed", "gauge", "Whether the buffer on disk takes no readings.", buffer_failed),
            ("bcap_commands", "counter", "Commands from the broker.", get(&self.commands)),
            ("bcap_commands_refused", "counter", "Commands that were refused.", get(&self.refused)),
        ] {
            family(&mut text, name, kind, help);
            let suffix = if kind == "counter" { "_total" } else { "" };
            let _ = writeln!(text, "{name}{suffix} {value}");
        }
        family(&mut text, "bcap_build", "info", "The version of this program.");
        let _ = writeln!(text, "bcap_build_info{{version=\"{}\"}} 1", env!("CARGO_PKG_VERSION"));
        text.push_str("# EOF\n");
        text
    }
}

fn family(text: &mut String, name: &str, kind: &str, help: &str) {
    let _ = writeln!(text, "# TYPE {name} {kind}\n# HELP {name} {help}");
}

/// Escapes a label.
fn escape(label: &str) -> String {
    label.replace('\\', "\\\\").replace('"', "\\\"").replace('\n', "\\n")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_controller_has_a_line_with_its_name() {
        let metrics = Metrics::new(2);
        metrics.cells[1].up.store(true, Ordering::Relaxed);
        metrics.cells[1].readings.store(7, Ordering::Relaxed);
        let text = metrics.text(["a", "b\"c"].into_iter(), 3);
        for line in [
            "bcap_controller_up{controller=\"a\"} 0\n",
            "bcap_controller_up{controller=\"b\\\"c\"} 1\n",
            "bcap_readings_total{controller=\"b\\\"c\"} 7\n",
            "# TYPE bcap_dropped counter\n",
            "bcap_queued 3\n",
            concat!(
                "# TYPE bcap_build info\n# HELP bcap_build The version of this program.\nbcap_build_info{version=\"",
                env!("CARGO_PKG_VERSION"),
                "\"} 1\n"
            ),
        ] {
            assert!(text.contains(line), "{text}");
        }
        assert!(text.ends_with("# EOF\n"));
    }
}
