//! A log file that is rotated by its size: `log` becomes `log.1`, that becomes `log.2`, and the oldest is removed.

use std::ffi::OsString;
use std::fs::{self, File, OpenOptions};
use std::io::{self, Read as _, Seek as _, SeekFrom, Write};
use std::path::{Path, PathBuf};

use bcap_terminal::escape;

use crate::events::warn;

/// A file of bounded size, and its predecessors.
#[derive(Debug)]
pub(crate) struct Rotating {
    path: PathBuf,
    file: File,
    /// Bytes in the file.
    len: u64,
    /// The maximum size of the file in bytes; 0 does not rotate.
    max: u64,
    /// The number of old files to keep.
    keep: u32,
    /// Whether the last line of the file was truncated, such as by a full disk or a power failure.
    is_torn: bool,
}

impl Rotating {
    /// Opens the file to append to it. A file that is not regular, such as a device or a FIFO, is not rotated.
    pub(crate) fn open(path: &Path, max: u64, keep: u32) -> io::Result<Self> {
        let file = append(path)?;
        let metadata = file.metadata()?;
        let max = if metadata.is_file() { max } else { 0 };
        // a write-only file is used as it is
        let is_torn = metadata.is_file() && metadata.len() > 0 && last_byte(path).is_ok_and(|last| last != b'\n');
        Ok(Self { path: path.to_owned(), file, len: metadata.len(), max, keep, is_torn })
    }

    /// Renames the file and its predecessors, and begins a new file.
    fn rotate(&mut self) -> io::Result<()> {
        for n in (1..self.keep).rev() {
            let old = self.numbered(n);
            if old.exists() {
                fs::rename(old, self.numbered(n + 1))?;
            }
        }
        match self.keep {
            0 => fs::remove_file(&self.path)?,
            _ => fs::rename(&self.path, self.numbered(1))?,
        }
        self.file = append(&self.path)?;
        self.is_torn = false;
        Ok(())
    }

    fn numbered(&self, n: u32) -> PathBuf {
        let mut name = OsString::from(&self.path);
        name.push(format!(".{n}"));
        name.into()
    }
}

fn append(path: &Path) -> io::Result<File> {
    OpenOptions::new().append(true).create(true).open(path)
}

fn last_byte(path: &Path) -> io::Result<u8> {
    let (mut file, mut last) = (File::open(path)?, [0]);
    file.seek(SeekFrom::End(-1))?;
    file.read_exact(&mut last)?;
    Ok(last[0])
}

impl Write for Rotating {
    /// Writes `bytes` to a file that has room for all of them, so a rotation never splits a line.
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let len = u64::try_from(bytes.len()).unwrap_or(u64::MAX);
        if self.max > 0 && self.len > 0 && self.len.saturating_add(len) > self.max {
            // without permission to rename, the log continues in the same file, and tries again after another `max` bytes
            if let Err(error) = self.rotate() {
                warn(format_args!("the audit log cannot be rotated: {}", escape::failure(&error)));
            }
            self.len = 0;
        }
        if self.is_torn {
            self.file.write_all(b"\n")?;
            self.is_torn = false;
        }
        let count = self.file.write(bytes)?;
        self.len = self.len.saturating_add(u64::try_from(count).unwrap_or(0));
        Ok(count)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.file.flush()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Writes the lines 0 to 99, 10 bytes each, into files of 95 bytes; returns the files' texts in reverse order.
    fn rotated(keep: u32) -> Vec<String> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("log");
        let mut log = Rotating::open(&path, 95, keep).unwrap();
        for n in 0..100 {
            if n == 50 {
                // a restart
                log = Rotating::open(&path, 95, keep).unwrap();
            }
            log.write_all(format!("line {n:04}\n").as_bytes()).unwrap();
        }
        let files = fs::read_dir(folder.path()).unwrap().count();
        let names = std::iter::once(path.clone()).chain((1..).map(|n| log.numbered(n)));
        names.take(files).map(|name| fs::read_to_string(name).unwrap()).collect()
    }

    #[test]
    fn files_are_bounded_in_size_and_number() {
        for keep in [0, 1, 3] {
            let texts = rotated(keep);
            assert_eq!(texts.len(), keep as usize + 1);
            assert!(texts.iter().all(|text| text.len() <= 95));
            let all: String = texts.iter().rev().map(String::as_str).collect();
            let lines: Vec<_> = all.lines().collect();
            let first = 100 - lines.len();
            assert!(lines.iter().zip(first..).all(|(line, n)| **line == format!("line {n:04}")), "{lines:?}");
            assert_eq!(
                lines.len(),
                9 * keep as usize + 1,
                "the last file has the line that did not fit the one before"
            );
        }
    }

    #[test]
    fn a_size_of_0_does_not_rotate() {
        let folder = tempfile::tempdir().unwrap();
        let mut log = Rotating::open(&folder.path().join("log"), 0, 3).unwrap();
        (0..100).for_each(|_| log.write_all(&[b'x'; 100]).unwrap());
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
        assert_eq!(fs::metadata(&log.path).unwrap().len(), 10_000);
    }

    #[test]
    fn a_line_after_one_that_was_cut_off_begins_anew() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("log");
        for (before, after) in [("", "new\n"), ("old\n", "old\nnew\n"), ("old\nto", "old\nto\nnew\n")] {
            fs::write(&path, before).unwrap();
            Rotating::open(&path, 95, 1).unwrap().write_all(b"new\n").unwrap();
            assert_eq!(fs::read_to_string(&path).unwrap(), after);
        }
    }

    #[cfg(unix)]
    #[test]
    fn a_device_is_not_rotated() {
        let mut log = Rotating::open(Path::new("/dev/null"), 10, 3).unwrap();
        (0..10).for_each(|_| log.write_all(b"0123456789").unwrap());
        assert_eq!(log.max, 0);
    }
}
