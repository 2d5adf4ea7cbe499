//! A client of Modbus of another make: pymodbus, a package of PyPI.

use std::io::Write as _;
use std::path::Path;
use std::process::Stdio;

use crate::python::Python;

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
    elif "information" in line:
        print(response.information)
    elif "coils(" in line and "read" in line:
        print(response.bits)
    elif "read" in line:
        print(response.registers)
    else:
        print("ok")
"#;

/// A Python with pymodbus.
#[derive(Debug)]
pub struct Pymodbus(Python);

impl Pymodbus {
    /// Finds or installs it in this folder.
    ///
    /// # Errors
    ///
    /// Why it cannot be installed.
    pub fn find(folder: &Path) -> Result<Self, String> {
        Python::with(&["pymodbus==3.16.1"], "pymodbus.client", folder).map(Self)
    }

    /// Performs requests at an address, and compares the responses.
    ///
    /// # Panics
    ///
    /// When a response differs.
    pub fn check(&self, address: &str, exchanges: &[(&str, &str)]) {
        let mut client = self.0.command();
        let mut client =
            client.args(["-c", CLIENT, address]).stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().unwrap();
        let requests: String = exchanges.iter().map(|(request, _)| format!("{request}\n")).collect();
        client.stdin.take().unwrap().write_all(requests.as_bytes()).unwrap();
        let responses = String::from_utf8(client.wait_with_output().unwrap().stdout).unwrap();
        assert_eq!(responses.lines().count(), exchanges.len(), "{responses}");
        for ((request, expected), response) in exchanges.iter().zip(responses.lines()) {
            assert_eq!(response, *expected, "{request}");
        }
    }
}
