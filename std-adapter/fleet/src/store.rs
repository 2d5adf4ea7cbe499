//! Readings on disk while the broker is disconnected: files of JSON lines, the oldest first.
//!
//! A file is deleted after the broker has acknowledged all of its readings. If the process is killed before that, they are
//! sent again, with the same ids. A file that exceeds the limits of bytes or age is deleted, and its readings are counted
//! as dropped. Only regular files of the directory are used, and no links are followed. The functions block; the publisher
//! calls them on a thread for blocking work.

use std::collections::VecDeque;
use std::fs::{self, File, OpenOptions, TryLockError};
use std::io::{self, BufRead as _, BufReader, Write as _};
use std::path::{Path, PathBuf};
use std::time::Duration;

use serde::{Deserialize, Serialize};

use crate::config::{Buffer, Config};
use crate::reading::{Quality, Reading, Value};

/// A buffer on disk.
#[derive(Debug)]
pub(crate) struct Store {
    directory: PathBuf,
    /// The maximum size of all files in bytes.
    bytes: u64,
    /// The maximum size of a file in bytes.
    segment: u64,
    age: Duration,
    /// The oldest first.
    segments: VecDeque<Segment>,
    /// The number of the next file.
    next: u64,
    /// The file that is being written.
    open: Option<File>,
    /// The file that [`load`](Self::load) has returned, until it is acknowledged.
    loaded: Option<Segment>,
    /// Readings that were lost since the last [`take_dropped`](Self::take_dropped).
    dropped: u64,
    /// Locked, so that no other process uses the directory.
    _lock: File,
    /// The names of the configuration, to which the lines refer.
    names: Vec<(String, Vec<String>)>,
}

#[derive(Clone, Copy, Debug)]
struct Segment {
    number: u64,
    bytes: u64,
    readings: u64,
    /// The time of its last reading.
    newest: u64,
}

/// A reading with names, which stay valid when the configuration changes.
#[derive(Serialize, Deserialize)]
struct StoredReading {
    cell: String,
    point: String,
    time: u64,
    id: u64,
    value: Option<Value>,
    quality: Quality,
}

impl Store {
    /// Opens the directory, and finds the files of an earlier process.
    pub(crate) fn open(buffer: &Buffer, config: &Config) -> io::Result<Self> {
        fs::create_dir_all(&buffer.directory)?;
        let lock = lock(&buffer.directory.join("lock"))?;
        let bytes = u64::from(buffer.mib).max(1) << 20;
        let names = config
            .controllers
            .iter()
            .map(|cell| (cell.name.clone(), cell.points.iter().map(|point| point.name.clone()).collect()));
        let mut store = Self {
            directory: buffer.directory.clone(),
            bytes,
            segment: (bytes / 64).max(1 << 14),
            age: Duration::from_secs(u64::from(buffer.hours).max(1) * 3600),
            segments: VecDeque::new(),
            next: 0,
            open: None,
            loaded: None,
            dropped: 0,
            _lock: lock,
            names: names.collect(),
        };
        store.find()?;
        Ok(store)
    }

    fn find(&mut self) -> io::Result<()> {
        let mut numbers = Vec::new();
        for entry in fs::read_dir(&self.directory)? {
            let (name, is_file) = entry.and_then(|entry| Ok((entry.file_name(), entry.file_type()?.is_file())))?;
            let number = name.to_str().and_then(|name| name.strip_suffix(".jsonl")).and_then(|n| n.parse::<u64>().ok());
            // a folder, a link or a FIFO is left alone
            numbers.extend(number.filter(|_| is_file));
        }
        numbers.sort_unstable();
        for number in numbers {
            let file = open(&self.path(number), OpenOptions::new().read(true))?;
            let (bytes, (lines, unreadable)) = (file.metadata()?.len(), read_lines(file)?);
            let newest = lines.iter().map(|line| line.time).max().unwrap_or(0);
            // unreadable lines are counted as dropped when the file is loaded
            let readings = lines.len() as u64 + unreadable;
            self.segments.push_back(Segment { number, bytes, readings, newest });
            self.next = number + 1;
        }
        Ok(())
    }

    /// Appends readings, which it removes from the list, and deletes what exceeds the limits. After an error, such as a full
    /// disk, the list has the rest for the next call.
    pub(crate) fn append(&mut self, readings: &mut VecDeque<Reading>, now: u64) -> io::Result<()> {
        let mut done = Ok(());
        while let (Ok(()), Some(reading)) = (&done, readings.front()) {
            done = self.append_one(reading);
            if done.is_ok() {
                readings.pop_front();
            }
        }
        self.trim(now);
        done
    }

    fn append_one(&mut self, reading: &Reading) -> io::Result<()> {
        if self.open.is_none() || self.segments.back().is_some_and(|last| last.bytes >= self.segment) {
            self.begin()?;
        }
        let mut line = serde_json::to_vec(&self.named(reading)).map_err(io::Error::from)?;
        line.push(b'\n');
        let (Some(file), Some(last)) = (&mut self.open, self.segments.back_mut()) else { return Ok(()) };
        if let Err(error) = file.write_all(&line) {
            // removes the partial line, so that the next line can be written to the same file
            if file.set_len(last.bytes).is_err() {
                self.open = None;
            }
            return Err(error);
        }
        last.bytes += line.len() as u64;
        last.readings += 1;
        last.newest = last.newest.max(reading.time);
        Ok(())
    }

    fn begin(&mut self) -> io::Result<()> {
        loop {
            let (number, path) = (self.next, self.path(self.next));
            match OpenOptions::new().create_new(true).append(true).open(path) {
                Ok(file) => {
                    self.open = Some(file);
                    self.segments.push_back(Segment { number, bytes: 0, readings: 0, newest: 0 });
                    self.next += 1;
                    return Ok(());
                }
                // a file that does not belong to this store keeps its name
                Err(error) if error.kind() == io::ErrorKind::AlreadyExists => self.next += 1,
                Err(error) => return Err(error),
            }
        }
    }

    /// Deletes the oldest files until the limits are met.
    fn trim(&mut self, now: u64) {
        let oldest = now.saturating_sub(u64::try_from(self.age.as_millis()).unwrap_or(u64::MAX));
        while let Some(first) = self.segments.front().copied() {
            let is_old = first.newest < oldest && first.readings > 0;
            if self.stored_bytes() <= self.bytes && !is_old {
                break;
            }
            self.segments.pop_front();
            if self.segments.is_empty() {
                self.open = None;
            }
            self.dropped += first.readings;
            self.delete(first);
        }
    }

    /// Returns the readings of the oldest file. The file is kept until [`acknowledge`](Self::acknowledge).
    pub(crate) fn load(&mut self, now: u64) -> io::Result<Vec<Reading>> {
        self.trim(now);
        if self.loaded.is_some() {
            return Ok(Vec::new());
        }
        let Some(mut first) = self.segments.pop_front() else { return Ok(Vec::new()) };
        if self.segments.is_empty() {
            self.open = None;
        }
        let file = open(&self.path(first.number), OpenOptions::new().read(true));
        let (lines, _) = file.and_then(read_lines).inspect_err(|_| self.dropped += first.readings)?;
        let readings: Vec<_> = lines.into_iter().filter_map(|line| self.reading(line)).collect();
        // the configuration no longer has the variables of the others, or their lines cannot be read; counted once
        let left = readings.len() as u64;
        self.dropped += first.readings.saturating_sub(left);
        first.readings = left;
        if readings.is_empty() {
            self.delete(first);
        } else {
            self.loaded = Some(first);
        }
        Ok(readings)
    }

    /// Puts the loaded file back: the next [`load`](Self::load) returns its readings again.
    pub(crate) fn unload(&mut self) {
        if let Some(loaded) = self.loaded.take() {
            self.segments.push_front(loaded);
        }
    }

    /// Deletes the loaded file: its readings are acknowledged, or were appended again.
    pub(crate) fn acknowledge(&mut self) {
        if let Some(loaded) = self.loaded.take() {
            self.delete(loaded);
        }
    }

    /// Returns the number of lost readings since the last call.
    pub(crate) const fn take_dropped(&mut self) -> u64 {
        std::mem::replace(&mut self.dropped, 0)
    }

    pub(crate) fn stored(&self) -> u64 {
        self.segments.iter().map(|segment| segment.readings).sum()
    }

    pub(crate) fn stored_bytes(&self) -> u64 {
        self.segments.iter().chain(&self.loaded).map(|segment| segment.bytes).sum()
    }

    fn delete(&self, segment: Segment) {
        // a file that cannot be deleted is sent again by the next process
        let _ = fs::remove_file(self.path(segment.number));
    }

    fn path(&self, number: u64) -> PathBuf {
        self.directory.join(format!("{number:012}.jsonl"))
    }

    fn named(&self, reading: &Reading) -> StoredReading {
        let (cell, points) = &self.names[reading.cell];
        StoredReading {
            cell: cell.clone(),
            point: points[reading.point].clone(),
            time: reading.time,
            id: reading.id,
            value: reading.value.clone(),
            quality: reading.quality,
        }
    }

    fn reading(&self, stored: StoredReading) -> Option<Reading> {
        let cell = self.names.iter().position(|(name, _)| *name == stored.cell)?;
        let point = self.names[cell].1.iter().position(|name| *name == stored.point)?;
        let StoredReading { time, id, value, quality, .. } = stored;
        Some(Reading { cell, point, time, id, value, quality, historical: true })
    }
}

/// Locks a file until it is closed.
fn lock(path: &Path) -> io::Result<File> {
    let file = open(path, OpenOptions::new().create(true).truncate(false).write(true))?;
    match file.try_lock() {
        Ok(()) => Ok(file),
        Err(TryLockError::WouldBlock) => Err(io::Error::other("another process uses this directory")),
        Err(TryLockError::Error(error)) => Err(error),
    }
}

/// Opens a regular file. Follows no link, and does not wait for the other end of a FIFO.
fn open(path: &Path, options: &mut OpenOptions) -> io::Result<File> {
    #[cfg(unix)]
    {
        use rustix::fs::OFlags;
        use std::os::unix::fs::OpenOptionsExt as _;
        options.custom_flags((OFlags::NOFOLLOW | OFlags::NONBLOCK).bits().cast_signed());
    }
    let failed = |error: io::Error| io::Error::new(error.kind(), format!("{}: {error}", path.display()));
    let file = options.open(path).map_err(failed)?;
    if file.metadata()?.is_file() { Ok(file) } else { Err(failed(io::Error::other("it is not a regular file"))) }
}

/// Reads the lines of a file; skips those that cannot be read, such as one that a crash has truncated, and returns their number.
fn read_lines(file: File) -> io::Result<(Vec<StoredReading>, u64)> {
    let (mut lines, mut unreadable) = (Vec::new(), 0);
    for line in BufReader::new(file).split(b'\n') {
        match serde_json::from_slice(&line?) {
            Ok(line) => lines.push(line),
            Err(_) => unreadable += 1,
        }
    }
    Ok((lines, unreadable))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn config() -> Config {
        let text = "group = \"g\"\nnode = \"n\"\n[broker]\nhost = \"h\"\n[[controller]]\nname = \"a\"\n\
            address = \"tcp:127.0.0.1\"\n[[controller.publish]]\nnames = [\"I1\", \"S1\"]\n";
        Config::parse(text).unwrap()
    }

    fn opened(directory: &Path, hours: u32) -> Store {
        Store::open(&Buffer { directory: directory.to_owned(), mib: 1, hours }, &config()).unwrap()
    }

    fn reading(id: u64, time: u64) -> Reading {
        let value = Some(Value::Text("x".repeat(100)));
        Reading { cell: 0, point: 1, time, id, value, quality: Quality::Good, historical: true }
    }

    fn ids(readings: &[Reading]) -> Vec<u64> {
        readings.iter().map(|reading| reading.id).collect()
    }

    #[test]
    fn readings_come_back_in_order_also_in_another_process() {
        let folder = tempfile::tempdir().unwrap();
        let mut store = opened(folder.path(), 1);
        store.append(&mut [reading(1, 10), reading(2, 11)].into(), 11).unwrap();
        assert_eq!(ids(&store.load(11).unwrap()), [1, 2]);
        store.append(&mut [reading(3, 12)].into(), 12).unwrap();
        drop(store);
        let mut store = opened(folder.path(), 1);
        assert_eq!(store.stored(), 3, "1 and 2 were not acknowledged");
        assert_eq!(store.load(12).unwrap(), [reading(1, 10), reading(2, 11)]);
        store.acknowledge();
        assert_eq!(ids(&store.load(12).unwrap()), [3]);
        store.acknowledge();
        assert_eq!((ids(&store.load(12).unwrap()), store.stored_bytes(), store.take_dropped()), (vec![], 0, 0));
        let left: Vec<_> = fs::read_dir(folder.path()).unwrap().map(|entry| entry.unwrap().file_name()).collect();
        assert_eq!(left, ["lock"]);
    }

    #[test]
    fn a_directory_has_one_store() {
        let folder = tempfile::tempdir().unwrap();
        let buffer = Buffer { directory: folder.path().to_owned(), mib: 1, hours: 1 };
        let first = opened(folder.path(), 1);
        let error = Store::open(&buffer, &config()).unwrap_err();
        assert_eq!(error.to_string(), "another process uses this directory");
        drop(first);
        assert!(Store::open(&buffer, &config()).is_ok());
    }

    #[test]
    fn the_oldest_readings_are_dropped_and_counted() {
        let folder = tempfile::tempdir().unwrap();
        let mut store = opened(folder.path(), 1);
        for id in 0..10_000 {
            store.append(&mut [reading(id, 0)].into(), 0).unwrap();
        }
        assert!(store.stored_bytes() <= 1 << 20, "{}", store.stored_bytes());
        let dropped = store.take_dropped();
        assert!(dropped > 0);
        assert_eq!((store.stored() + dropped, store.load(0).unwrap()[0].id), (10_000, dropped));
        store.acknowledge();
        let rest = store.stored();
        assert_eq!(
            (store.load(3_600_001).unwrap().len(), store.take_dropped()),
            (0, rest),
            "an hour later all are too old"
        );
    }

    #[test]
    fn a_cut_line_is_left_out() {
        let folder = tempfile::tempdir().unwrap();
        opened(folder.path(), 1).append(&mut [reading(1, 10), reading(2, 11)].into(), 11).unwrap();
        let path = folder.path().join("000000000000.jsonl");
        let text = fs::read(&path).unwrap();
        fs::write(&path, &text[..text.len() - 5]).unwrap();
        let mut store = opened(folder.path(), 1);
        assert_eq!((ids(&store.load(11).unwrap()), store.take_dropped()), (vec![1], 1));
        // the same lines are counted once
        store.unload();
        assert_eq!((ids(&store.load(11).unwrap()), store.take_dropped()), (vec![1], 0));
    }

    #[test]
    fn numbers_that_json_does_not_have_come_back_as_nan() {
        let folder = tempfile::tempdir().unwrap();
        let mut store = opened(folder.path(), 1);
        let value = Some(Value::Numbers(vec![1.5, f64::NAN, f64::INFINITY]));
        store.append(&mut [Reading { value, ..reading(1, 10) }].into(), 10).unwrap();
        let loaded = store.load(10).unwrap();
        let [Reading { value: Some(Value::Numbers(numbers)), .. }] = &loaded[..] else { panic!("{loaded:?}") };
        assert_eq!(format!("{numbers:?}"), "[1.5, NaN, NaN]");
    }

    #[cfg(unix)]
    #[test]
    fn only_regular_files_of_the_directory_are_used() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        fs::create_dir(path("000000000000.jsonl")).unwrap();
        fs::write(path("elsewhere"), "untouched").unwrap();
        std::os::unix::fs::symlink("elsewhere", path("000000000001.jsonl")).unwrap();
        let fifo = |name| rustix::fs::mkfifoat(rustix::fs::CWD, path(name), rustix::fs::Mode::RUSR).unwrap();
        fifo("000000000002.jsonl");
        let mut first = opened(folder.path(), 1);
        first.append(&mut [reading(1, 10)].into(), 10).unwrap();
        assert!(path("000000000003.jsonl").is_file());
        drop(first);
        let mut second = opened(folder.path(), 1);
        assert_eq!(ids(&second.load(10).unwrap()), [1]);
        second.acknowledge();
        drop(second);
        assert_eq!(fs::read_to_string(path("elsewhere")).unwrap(), "untouched");
        for name in ["000000000000.jsonl", "000000000001.jsonl", "000000000002.jsonl"] {
            assert!(path(name).symlink_metadata().is_ok(), "{name}");
        }
        // a lock that would block
        fs::remove_file(path("lock")).unwrap();
        fifo("lock");
        let buffer = Buffer { directory: folder.path().to_owned(), mib: 1, hours: 1 };
        assert!(Store::open(&buffer, &config()).unwrap_err().to_string().contains("lock: "));
    }
}
