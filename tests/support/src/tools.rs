//! Tools that tests need, and may be missing.
//!
//! With `CI=true` a missing tool is a failure. Elsewhere its tests end immediately, and each prints a line with their number.

use std::collections::BTreeMap;
use std::env;
use std::io::{self, Write as _};
use std::path::PathBuf;
use std::sync::{Mutex, PoisonError};

/// The number of tests that the lack of each tool has skipped.
static SKIPPED: Mutex<BTreeMap<String, u32>> = Mutex::new(BTreeMap::new());

/// Returns the path of a program, or `None` after [`missing`].
///
/// # Panics
///
/// With `CI=true`, if the program is missing.
#[must_use]
pub fn find(program: &str) -> Option<PathBuf> {
    let path = env::var_os("PATH").unwrap_or_default();
    // Debian installs servers there, which is not in the PATH of all users
    let folders = env::split_paths(&path).chain([PathBuf::from("/usr/sbin")]);
    let found = folders.map(|folder| folder.join(program)).find(|file| file.is_file());
    if found.is_none() {
        missing(&format!("{program} is not installed"));
    }
    found
}

/// Prints a line that says that a test is skipped, and which tool this machine lacks.
///
/// # Panics
///
/// With `CI=true`.
pub fn missing(what: &str) {
    assert!(env::var_os("CI").is_none_or(|value| value != "true"), "{what}");
    let mut skipped = SKIPPED.lock().unwrap_or_else(PoisonError::into_inner);
    let count = skipped.entry(what.to_owned()).or_default();
    *count += 1;
    // not `println`, whose lines a test that passes does not show
    let _ = writeln!(io::stderr(), "skipped: {what} ({count} tests so far)");
}
