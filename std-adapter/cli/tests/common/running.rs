//! A process of the command that runs until a signal.

use std::io::{BufRead, BufReader, Read};
use std::process::{Child, ChildStderr, ChildStdout, Command, Stdio};

use bcap_tests::process::{Signal, send};
use serde_json::Value;

use crate::common::{Run, bcap, command};

const FREE: [&str; 6] = ["--bcap", "127.0.0.1:0", "--udp", "127.0.0.1:0", "--rac", "127.0.0.1:0"];

/// A process that has printed `ready bcap=.. udp=.. rac=..`; dropping it kills it.
pub(crate) struct Running {
    pub(crate) child: Child,
    pub(crate) out: BufReader<ChildStdout>,
    err: Option<BufReader<ChildStderr>>,
    /// The line that it printed when it was ready.
    pub(crate) ready: String,
    /// The addresses, without a protocol; empty if the command does not serve one.
    pub(crate) bcap: String,
    pub(crate) udp: String,
    pub(crate) rac: String,
}

impl Running {
    pub(crate) fn start(args: &[&str]) -> Self {
        Self::of(command(args).stderr(Stdio::piped()))
    }

    /// Starts a command.
    pub(crate) fn of(command: &mut Command) -> Self {
        let mut child = command.stdout(Stdio::piped()).spawn().unwrap();
        let mut out = BufReader::new(child.stdout.take().unwrap());
        let err = child.stderr.take().map(BufReader::new);
        let mut ready = String::new();
        out.read_line(&mut ready).unwrap();
        assert!(ready.starts_with("ready "), "{ready:?}");
        let [bcap, udp, rac] = ["bcap", "udp", "rac"].map(|key| address(&ready, key));
        Self { child, out, err, ready, bcap, udp, rac }
    }

    /// Starts a virtual controller on free ports.
    pub(crate) fn sim(more: &[&str]) -> Self {
        Self::start(&[&["sim"], &FREE[..], more].concat())
    }

    /// Starts a virtual controller on free ports, which writes its notes to the standard error of the test.
    pub(crate) fn quiet_sim(more: &[&str]) -> Self {
        Self::of(&mut command(&[&["sim"], &FREE[..], more].concat()))
    }

    /// Starts a gateway on a free port.
    pub(crate) fn gateway_to(robot: &str, more: &[&str]) -> Self {
        Self::of(&mut command(&[&["gateway", "--rac", "127.0.0.1:0", "--robot", robot], more].concat()))
    }

    /// Starts a gateway on a free port, and waits until it has a session with its robot.
    pub(crate) fn gateway(robot: &str, more: &[&str]) -> Self {
        let mut gateway = Self::start(&[&["gateway", "--rac", "127.0.0.1:0", "--robot", robot], more].concat());
        gateway.log("robot_up");
        gateway
    }

    /// Returns the address after `key=` in the line that it printed when it was ready.
    pub(crate) fn address(&self, key: &str) -> String {
        let address = address(&self.ready, key);
        assert_ne!(address, "", "{key} in {:?}", self.ready);
        address
    }

    /// Reads the log up to the next line of this kind.
    pub(crate) fn log(&mut self, event: &str) -> Value {
        loop {
            let mut line = String::new();
            assert!(self.out.read_line(&mut line).unwrap() > 0, "no {event} in the log");
            let object: Value = serde_json::from_str(&line).unwrap();
            if object["event"] == event {
                return object;
            }
        }
    }

    /// Runs `bcap rac` with its address.
    pub(crate) fn rac(&self, args: &[&str]) -> Run {
        bcap(&[&["rac"], args, &["--robot", &self.address("rac")]].concat())
    }

    /// Waits for the next line of the standard error.
    pub(crate) fn error_line(&mut self) -> String {
        let mut line = String::new();
        self.err.as_mut().unwrap().read_line(&mut line).unwrap();
        line.trim_end().to_owned()
    }

    /// Sends a signal, waits for the exit, and returns the rest of the output.
    pub(crate) fn end(&mut self, signal: Signal) -> String {
        send(signal, &self.child);
        let mut rest = String::new();
        self.out.read_to_string(&mut rest).unwrap();
        assert_eq!(self.child.wait().unwrap().code(), Some(0));
        rest
    }

    /// Ends the process by SIGINT, and returns its output after the first line.
    pub(crate) fn interrupt(mut self) -> Run {
        send(Signal::INT, &self.child);
        let (mut out, mut err) = (String::new(), String::new());
        self.out.read_to_string(&mut out).unwrap();
        self.err.as_mut().unwrap().read_to_string(&mut err).unwrap();
        Run { out, err, code: self.child.wait().unwrap().code().unwrap() }
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

fn address(ready: &str, key: &str) -> String {
    let found = ready.split_whitespace().find_map(|word| word.strip_prefix(key)?.strip_prefix('='));
    found.unwrap_or_default().to_owned()
}
