//! Helpers that run the built command and read the test vectors.

pub(crate) mod capture;
pub(crate) mod fake;
pub(crate) mod planted;
pub(crate) mod recorded;
pub(crate) mod robot;
pub(crate) mod running;
pub(crate) mod tmux;
pub(crate) mod tshark;
pub(crate) mod virtual_robot;

use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::sync::Once;

use serde_json::Value;

/// The output and the exit code of a run.
#[derive(Debug)]
pub(crate) struct Run {
    pub(crate) out: String,
    pub(crate) err: String,
    pub(crate) code: i32,
}

impl From<Output> for Run {
    fn from(output: Output) -> Self {
        Self {
            out: String::from_utf8(output.stdout).unwrap(),
            err: String::from_utf8(output.stderr).unwrap(),
            code: output.status.code().unwrap(),
        }
    }
}

/// The command with a clean environment, and with a long --timeout unless the test gives one.
pub(crate) fn command(args: &[&str]) -> Command {
    let time = if args.contains(&"--timeout") { &[][..] } else { &["--timeout", "30000"] };
    bare(&[time, args].concat())
}

/// The command with exactly these arguments.
pub(crate) fn bare(args: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_bcap"));
    command.args(args).env_remove("NO_COLOR").env_remove("CLICOLOR_FORCE");
    for name in ["ROBOT", "TIMEOUT", "PROVIDER", "MACHINE", "OPTION", "ATTEMPTS", "RAC_PORT", "PROFILE"] {
        command.env_remove(format!("BCAP_{name}"));
    }
    command
}

/// Runs the command without input.
pub(crate) fn bcap(args: &[&str]) -> Run {
    command(args).stdin(Stdio::null()).output().unwrap().into()
}

/// Returns the path of the program `bcap-fleet`, which is built if it does not exist.
pub(crate) fn fleet_program() -> PathBuf {
    static BUILT: Once = Once::new();
    let program = Path::new(env!("CARGO_BIN_EXE_bcap")).with_file_name("bcap-fleet");
    BUILT.call_once(|| {
        if !program.exists() {
            // the profile of these tests, whose folder it is
            let profile = if cfg!(debug_assertions) { "dev" } else { "release" };
            let build = ["build", "--quiet", "--package", "bcap-fleet", "--profile", profile];
            assert!(Command::new(env!("CARGO")).args(build).status().unwrap().success());
        }
    });
    program
}

/// Runs `bcap-fleet` without input.
pub(crate) fn fleet(args: &[&str]) -> Run {
    Command::new(fleet_program()).args(args).stdin(Stdio::null()).output().unwrap().into()
}

/// Runs the command with this input.
pub(crate) fn bcap_with(args: &[&str], input: &[u8]) -> Run {
    let mut child = command(args).stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let mut stdin = child.stdin.take().unwrap();
    let input = input.to_vec();
    let writer = std::thread::spawn(move || stdin.write_all(&input));
    let run = child.wait_with_output().unwrap().into();
    writer.join().unwrap().unwrap();
    run
}

/// Reads a file of `tests/vectors`.
pub(crate) fn vectors(name: &str) -> Vec<Value> {
    let path = format!("{}/../../tests/vectors/{name}", env!("CARGO_MANIFEST_DIR"));
    let text = std::fs::read_to_string(&path).unwrap_or_else(|e| panic!("{path}: {e}"));
    text.lines().map(|line| serde_json::from_str(line).unwrap()).collect()
}

/// All frames of the vectors.
pub(crate) fn frames() -> Vec<Value> {
    ["bcap-rc8-guide.jsonl", "bcap-rc9-spec.jsonl"].iter().flat_map(|name| vectors(name)).collect()
}
