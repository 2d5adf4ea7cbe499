//! Programs that tests run, and may be missing.
//!
//! With `CI=true` a missing program is a failure. Elsewhere its tests end at once, and each prints a line with their number.

use std::collections::BTreeMap;
use std::env;
use std::io::{self, Write as _};
use std::path::PathBuf;
use std::sync::{Mutex, PoisonError};

/// The number of tests that each missing program has skipped.
static SKIPPED: Mutex<BTreeMap<String, u32>> = Mutex::new(BTreeMap::new());

/// Returns the path of a program, or `None` with a line that says that a test is skipped.
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
        skip(program);
    }
    found
}

fn skip(program: &str) {
    assert!(env::var_os("CI").is_none_or(|value| value != "true"), "{program} is not installed");
    let mut skipped = SKIPPED.lock().unwrap_or_else(PoisonError::into_inner);
    let count = skipped.entry(program.to_owned()).or_default();
    *count += 1;
    // not `println`, whose lines a test that passes does not show
    let _ = writeln!(io::stderr(), "skipped: {program} is not installed ({count} tests so far)");
}
