//! A process of the command that runs until a signal.

use std::io::{BufRead, BufReader, Read};
use std::process::{Child, ChildStderr, ChildStdout, Command, Stdio};

use crate::common::{Run, command};

/// A process that has printed `ready bcap=.. udp=.. rac=..`; dropping it kills it.
pub(crate) struct Running {
    child: Child,
    out: BufReader<ChildStdout>,
    err: BufReader<ChildStderr>,
    /// The addresses, without a protocol; empty if the command does not serve one.
    pub(crate) bcap: String,
    pub(crate) udp: String,
    pub(crate) rac: String,
}

impl Running {
    pub(crate) fn start(args: &[&str]) -> Self {
        let mut child = command(args).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
        let mut out = BufReader::new(child.stdout.take().unwrap());
        let err = BufReader::new(child.stderr.take().unwrap());
        let mut line = String::new();
        out.read_line(&mut line).unwrap();
        let address = |key: &str| -> String {
            let word = line.split_whitespace().find_map(|word| word.strip_prefix(key));
            word.unwrap_or_default().to_owned()
        };
        assert!(line.starts_with("ready "), "{line:?}");
        let [bcap, udp, rac] = ["bcap=", "udp=", "rac="].map(address);
        Self { child, out, err, bcap, udp, rac }
    }

    /// Starts a virtual controller on free ports.
    pub(crate) fn sim(more: &[&str]) -> Self {
        let free = ["--bcap", "127.0.0.1:0", "--udp", "127.0.0.1:0", "--rac", "127.0.0.1:0"];
        Self::start(&[&["sim"], &free[..], more].concat())
    }

    /// Starts a gateway on a free port, and waits until it has a session with its robot.
    pub(crate) fn gateway(robot: &str, more: &[&str]) -> Self {
        let mut gateway = Self::start(&[&["gateway", "--rac", "127.0.0.1:0", "--robot", robot], more].concat());
        let mut line = String::new();
        while !line.contains("robot_up") {
            line.clear();
            assert_ne!(gateway.out.read_line(&mut line).unwrap(), 0, "the gateway has ended");
        }
        gateway
    }

    /// Waits for the next line of the standard error.
    pub(crate) fn error_line(&mut self) -> String {
        let mut line = String::new();
        self.err.read_line(&mut line).unwrap();
        line.trim_end().to_owned()
    }

    /// Ends the process by SIGINT, and returns its output after the first line.
    pub(crate) fn interrupt(mut self) -> Run {
        assert!(Command::new("kill").args(["-INT", &self.child.id().to_string()]).status().unwrap().success());
        let (mut out, mut err) = (String::new(), String::new());
        self.out.read_to_string(&mut out).unwrap();
        self.err.read_to_string(&mut err).unwrap();
        Run { out, err, code: self.child.wait().unwrap().code().unwrap() }
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
