//! A terminal in which a command runs as a person runs it. It needs tmux.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use bcap_tests::tools;

/// A terminal; dropping this ends it.
pub(crate) struct Terminal {
    socket: PathBuf,
}

impl Terminal {
    /// Runs `bcap` in a terminal; `None` without tmux.
    pub(crate) fn start(size: (u16, u16), args: &[&str], folder: &Path) -> Option<Self> {
        Self::run(size, &[&[env!("CARGO_BIN_EXE_bcap")], args].concat(), folder)
    }

    /// Runs a command in a terminal of UTF-8 without tmux's own status line; `None` without tmux.
    pub(crate) fn run(size: (u16, u16), command_line: &[&str], folder: &Path) -> Option<Self> {
        tools::find("tmux")?;
        // a new name, because the server of the previous terminal may still be ending
        static NUMBER: AtomicUsize = AtomicUsize::new(0);
        let terminal = Self { socket: folder.join(format!("tmux{}", NUMBER.fetch_add(1, Ordering::Relaxed))) };
        let settings = folder.join("tmux.conf");
        std::fs::write(&settings, "set -g status off\n").unwrap();
        let history = format!("BCAP_HISTORY={}", folder.join("history").display());
        let (width, height) = (size.0.to_string(), size.1.to_string());
        let mut command = terminal.tmux();
        command.args(["-u", "-f"]).arg(settings).args(["new-session", "-d", "-x", &width, "-y", &height]);
        command.args(["-e", &history, "-e", "LC_ALL=C.UTF-8"]);
        assert!(command.args(command_line).status().unwrap().success());
        Some(terminal)
    }

    fn tmux(&self) -> Command {
        let mut command = Command::new("tmux");
        command.arg("-S").arg(&self.socket).env_remove("TMUX").env_remove("BCAP_ROBOT").env_remove("NO_COLOR");
        command
    }

    /// Presses keys, in tmux's notation.
    pub(crate) fn keys(&self, keys: &[&str]) {
        assert!(self.tmux().arg("send-keys").args(keys).status().unwrap().success());
    }

    /// Types text.
    pub(crate) fn text(&self, text: &str) {
        self.keys(&["-l", text]);
    }

    pub(crate) fn enter(&self, line: &str) {
        self.text(line);
        self.keys(&["Enter"]);
    }

    pub(crate) fn screen(&self) -> String {
        let output = self.tmux().args(["capture-pane", "-p"]).output().unwrap();
        String::from_utf8(output.stdout).unwrap()
    }

    /// Returns the screen with its colours and attributes as escape sequences.
    pub(crate) fn styled_screen(&self) -> String {
        let output = self.tmux().args(["capture-pane", "-e", "-p"]).output().unwrap();
        String::from_utf8(output.stdout).unwrap()
    }

    /// Returns a variable of tmux, such as `alternate_on`.
    pub(crate) fn variable(&self, name: &str) -> String {
        let output = self.tmux().args(["display-message", "-p", &format!("#{{{name}}}")]).output().unwrap();
        String::from_utf8(output.stdout).unwrap().trim_end().to_owned()
    }

    /// Changes the size of the terminal.
    pub(crate) fn resize(&self, (width, height): (u16, u16)) {
        let (width, height) = (width.to_string(), height.to_string());
        assert!(self.tmux().args(["resize-window", "-x", &width, "-y", &height]).status().unwrap().success());
    }

    /// Waits until the screen contains a text, and returns the screen.
    #[track_caller]
    pub(crate) fn wait_for(&self, text: &str) -> String {
        self.wait_until(text, |screen| screen.contains(text))
    }

    /// Waits until the screen is as it should be, and returns the screen.
    #[track_caller]
    pub(crate) fn wait_until(&self, what: &str, is_right: impl Fn(&str) -> bool) -> String {
        let began = Instant::now();
        loop {
            let screen = self.screen();
            if is_right(&screen) {
                return screen;
            }
            assert!(began.elapsed() < Duration::from_secs(60), "{what:?} is missing:\n{screen}");
            // each look is a process
            thread::sleep(Duration::from_millis(20));
        }
    }
}

impl Drop for Terminal {
    fn drop(&mut self) {
        let _ = self.tmux().arg("kill-server").output();
    }
}
