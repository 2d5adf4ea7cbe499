//! A `bcap sim` process with clients.

use std::process::{Child, Command, Stdio};
use std::thread;
use std::time::{Duration, Instant};

use super::running::Running;
use super::{Run, bcap, bcap_with};
use bcap_tests::process::Signal;

/// A virtual controller; dropping this kills it.
pub(crate) struct Virtual {
    pub(crate) process: Running,
    pub(crate) tcp: String,
    pub(crate) udp: String,
    pub(crate) rac: String,
}

impl From<Running> for Virtual {
    fn from(process: Running) -> Self {
        let (tcp, udp) = (format!("tcp:{}", process.bcap), format!("udp:{}", process.udp));
        Self { tcp, udp, rac: process.rac.clone(), process }
    }
}

impl Virtual {
    pub(crate) fn start(more: &[&str]) -> Self {
        Running::quiet_sim(more).into()
    }

    pub(crate) fn run(&self, args: &[&str]) -> Run {
        bcap(&[args, &["--robot", &self.tcp]].concat())
    }

    /// Ends the controller with a signal, and waits until it has written its files.
    pub(crate) fn end(&mut self, signal: Signal) {
        self.process.end(signal);
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
        let since = Instant::now();
        while self.run(&["get", "@BUSY_STATUS"]).out != "@BUSY_STATUS = true\n" {
            assert!(since.elapsed() < Duration::from_secs(60), "the robot does not move");
            thread::sleep(Duration::from_millis(20));
        }
    }

    /// Waits until the robot rests, as another client sees it.
    pub(crate) fn wait_for_rest(&self) {
        while self.run(&["get", "@BUSY_STATUS"]).out != "@BUSY_STATUS = false\n" {
            thread::sleep(Duration::from_millis(20));
        }
    }

    /// Asserts that the robot rests with its motor off, and that another client can take the arm.
    #[track_caller]
    pub(crate) fn assert_at_rest_with_free_arm(&self) {
        let state = self.run(&["get", "@BUSY_STATUS", "robot/@SERVO_ON"]);
        assert_eq!(state.out, "@BUSY_STATUS = false\nrobot/@SERVO_ON = false\n");
        // a halted motion is an error
        let errors = self.run(&["errors"]).out;
        assert!(errors == "no errors\n" || errors.starts_with("0x83500076") && errors.lines().count() == 2, "{errors}");
        assert_eq!(self.run(&["errors", "--clear"]).code, 0);
        assert_eq!(self.run(&["exec", "robot", "TakeArm", "0", "1"]).code, 0);
    }
}
