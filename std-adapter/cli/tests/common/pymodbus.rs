//! A client of Modbus of another make: pymodbus, a package of PyPI, which the test installs in the target directory.

use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

const VERSION: &str = "3.16.1";

/// Performs the requests of its lines, such as `client.read_coils(0, count=2)`, and prints a response a line.
const CLIENT: &str = r#"
import sys
from pymodbus.client import ModbusTcpClient
host, port = sys.argv[1].split(":")
client = ModbusTcpClient(host, port=int(port), timeout=10)
assert client.connect()
for line in sys.stdin:
    response = eval(line)
    if response.isError():
        print("exception", response.exception_code)
    elif "coils(" in line and "read" in line:
        print(response.bits)
    elif "read" in line:
        print(response.registers)
    else:
        print("ok")
"#;

/// pymodbus in a folder.
pub(crate) struct Pymodbus(PathBuf);

impl Pymodbus {
    /// Finds or installs it in this folder; `None` where it cannot be installed, with a line that says why.
    pub(crate) fn find(folder: &Path) -> Option<Self> {
        let found = Self(folder.join(format!("pymodbus-{VERSION}")));
        let is_there =
            || found.python(&["-c", "import pymodbus.client"]).output().is_ok_and(|run| run.status.success());
        if !is_there() {
            let package = format!("pymodbus=={VERSION}");
            let pip = ["-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--retries=0", "--timeout=10"];
            let target = ["--upgrade", "--root-user-action=ignore", &package, "--target", found.0.to_str()?];
            let error = match found.python(&[&pip[..], &target].concat()).output() {
                Ok(run) => String::from_utf8_lossy(&run.stderr).trim().replace('\n', "; "),
                Err(error) => format!("python3: {error}"),
            };
            if !is_there() {
                // not `eprintln`, which the tests of cargo show of failures only
                let line = format!("skipped: Python's package {package} cannot be installed: {error}\n");
                let _ = io::stderr().write_all(line.as_bytes());
                return None;
            }
        }
        Some(found)
    }

    fn python(&self, args: &[&str]) -> Command {
        let mut command = Command::new("python3");
        command.args(args).env("PYTHONPATH", &self.0);
        command
    }

    /// Performs requests at an address, and compares the responses.
    pub(crate) fn check(&self, address: &str, exchanges: &[(&str, &str)]) {
        let mut client = self.python(&["-c", CLIENT, address]);
        let mut client = client.stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().unwrap();
        let requests: String = exchanges.iter().map(|(request, _)| format!("{request}\n")).collect();
        client.stdin.take().unwrap().write_all(requests.as_bytes()).unwrap();
        let responses = String::from_utf8(client.wait_with_output().unwrap().stdout).unwrap();
        assert_eq!(responses.lines().count(), exchanges.len(), "{responses}");
        for ((request, expected), response) in exchanges.iter().zip(responses.lines()) {
            assert_eq!(response, *expected, "{request}");
        }
    }
}
