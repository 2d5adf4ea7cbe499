//! A `bcap sim` process with clients.

use std::io::{BufRead, BufReader};
use std::process::{Child, Command, Stdio};

use super::{Run, bcap, bcap_with, command};

/// A virtual controller; dropping this kills it.
pub(crate) struct Virtual {
    child: Child,
    pub(crate) tcp: String,
    pub(crate) udp: String,
    pub(crate) rac: String,
}

impl Virtual {
    pub(crate) fn start(more: &[&str]) -> Self {
        let free = ["--bcap", "127.0.0.1:0", "--udp", "127.0.0.1:0", "--rac", "127.0.0.1:0"];
        let mut child = command(&[&["sim"], &free[..], more].concat()).stdout(Stdio::piped()).spawn().unwrap();
        let mut line = String::new();
        BufReader::new(child.stdout.as_mut().unwrap()).read_line(&mut line).unwrap();
        let address = |key: &str| line.split_whitespace().find_map(|word| word.strip_prefix(key)).unwrap().to_owned();
        let (tcp, udp) = (format!("tcp:{}", address("bcap=")), format!("udp:{}", address("udp=")));
        Self { tcp, udp, rac: address("rac="), child }
    }

    pub(crate) fn run(&self, args: &[&str]) -> Run {
        bcap(&[args, &["--robot", &self.tcp]].concat())
    }

    /// Ends the controller with a signal, and waits until it has written its files.
    pub(crate) fn end(&mut self, name: &str) {
        signal(name, &self.child);
        assert_eq!(self.child.wait().unwrap().code(), Some(0));
    }

    /// Runs lines as a script.
    pub(crate) fn script(&self, lines: &str) -> Run {
        bcap_with(&["run", "-", "--robot", &self.tcp], lines.as_bytes())
    }

    /// Starts a command without a time limit.
    pub(crate) fn spawn(&self, args: &[&str]) -> Child {
        let mut command: Command = super::bare(&[args, &["--robot", &self.tcp]].concat());
        command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap()
    }

    /// Waits until the robot moves, as another client sees it.
    pub(crate) fn wait_for_motion(&self) {
        while self.run(&["get", "@BUSY_STATUS"]).out != "@BUSY_STATUS = true\n" {}
    }

    /// Waits until the robot rests, as another client sees it.
    pub(crate) fn wait_for_rest(&self) {
        while self.run(&["get", "@BUSY_STATUS"]).out != "@BUSY_STATUS = false\n" {}
    }

    /// Asserts that the robot rests with its motor off, and that another client can take the arm.
    #[track_caller]
    pub(crate) fn assert_at_rest_with_free_arm(&self) {
        let state = self.run(&["get", "@BUSY_STATUS", "robot/@SERVO_ON"]);
        assert_eq!(state.out, "@BUSY_STATUS = false\nrobot/@SERVO_ON = false\n");
        // a halted motion is an error
        let errors = self.run(&["errors"]).out;
        assert!(errors == "no errors\n" || errors.starts_with("0x83500076") && errors.lines().count() == 2, "{errors}");
        assert_eq!(self.run(&["clear"]).code, 0);
        assert_eq!(self.run(&["exec", "robot", "TakeArm", "0", "1"]).code, 0);
    }
}

impl Drop for Virtual {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Sends a signal to a process.
pub(crate) fn signal(name: &str, child: &Child) {
    assert!(Command::new("kill").args([name, &child.id().to_string()]).status().unwrap().success());
}
