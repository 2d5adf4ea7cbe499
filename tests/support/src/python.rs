//! Peers of other makes: packages of PyPI, which the tests install.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::{Mutex, PoisonError};

/// A Python with packages.
#[derive(Debug)]
pub struct Python {
    folder: PathBuf,
}

impl Python {
    /// Finds or installs packages, such as `pymodbus==3.16.1`, in a subfolder of this folder. `module` is a module of theirs.
    ///
    /// # Errors
    ///
    /// Why they cannot be installed.
    pub fn with(packages: &[&str], module: &str, folder: &Path) -> Result<Self, String> {
        // one test at a time: pip replaces the files of the folder
        static ONE: Mutex<()> = Mutex::new(());
        let _one = ONE.lock().unwrap_or_else(PoisonError::into_inner);
        let python = Self { folder: folder.join(packages.join("_")) };
        let import = format!("import {module}");
        let has_module = || python.command().args(["-c", &import]).output().is_ok_and(|run| run.status.success());
        if has_module() {
            return Ok(python);
        }
        let mut pip = python.command();
        pip.args(["-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--retries=0", "--timeout=10"]);
        pip.args(["--root-user-action=ignore", "--upgrade", "--target"]).arg(&python.folder).args(packages);
        let error = match pip.output() {
            Ok(run) => String::from_utf8_lossy(&run.stderr).trim().replace('\n', "; "),
            Err(error) => format!("python3: {error}"),
        };
        match has_module() {
            true => Ok(python),
            false => Err(format!("{} of PyPI cannot be installed: {error}", packages.join(" "))),
        }
    }

    /// Returns a command that runs Python.
    #[must_use]
    pub fn command(&self) -> Command {
        let mut command = Command::new("python3");
        command.env("PYTHONPATH", &self.folder);
        command
    }
}
