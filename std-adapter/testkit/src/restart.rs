//! Restarts a device that has stopped, with a command of the user.

use std::io;
use std::process::{Child, Command, Stdio};

/// Runs a command in a shell each time that the device has stopped, a limited number of times.
///
/// The command may end immediately, or be the device itself. In the latter case the next run of the command ends it, and so
/// does dropping the restarter. It gets no input, and its output goes to the standard error of this process.
#[derive(Debug)]
pub struct Restarter {
    command: String,
    left: u32,
    running: Option<Child>,
}

impl Restarter {
    /// Creates a restarter that runs `command` at most `most` times.
    #[must_use]
    pub fn new(command: &str, most: u32) -> Self {
        Self { command: command.into(), left: most, running: None }
    }

    /// Runs the command; returns whether a run was left.
    ///
    /// # Errors
    ///
    /// When the shell does not start.
    pub fn run(&mut self) -> io::Result<bool> {
        let Some(left) = self.left.checked_sub(1) else { return Ok(false) };
        self.left = left;
        self.end();
        let mut shell = shell(&self.command);
        self.running = Some(shell.stdin(Stdio::null()).stdout(io::stderr()).spawn()?);
        Ok(true)
    }

    /// Ends a command that still runs.
    fn end(&mut self) {
        let Some(mut child) = self.running.take() else { return };
        // a command that has ended may have left the device in the background, where it keeps running
        if matches!(child.try_wait(), Ok(None)) {
            kill(&mut child);
            let _ = child.wait();
        }
    }
}

impl Drop for Restarter {
    fn drop(&mut self) {
        self.end();
    }
}

#[cfg(unix)]
fn shell(command: &str) -> Command {
    use std::os::unix::process::CommandExt as _;

    let mut shell = Command::new("sh");
    // the processes of the command are ended together
    shell.args(["-c", command]).process_group(0);
    shell
}

#[cfg(unix)]
fn kill(child: &mut Child) {
    let group = format!("-{}", child.id());
    if !Command::new("kill").args(["-9", "--", &group]).status().is_ok_and(|status| status.success()) {
        let _ = child.kill();
    }
}

#[cfg(not(unix))]
fn shell(command: &str) -> Command {
    let mut shell = Command::new("cmd");
    shell.args(["/C", command]);
    shell
}

#[cfg(not(unix))]
fn kill(child: &mut Child) {
    let _ = child.kill();
}
