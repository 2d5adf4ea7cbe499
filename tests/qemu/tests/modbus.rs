//! Tests Modbus TCP of the gateway board in QEMU with an independent client: pymodbus.
//!
//! Without pymodbus (`pip install pymodbus`) the test is skipped. `PYTHON` names another interpreter.
#![cfg(unix)]

use std::io::Write;
use std::process::{Command, Stdio};

use bcap_qemu::{Board, Sim, bcap, free_port, run};

/// Performs the requests of its lines, such as `client.read_coils(0, count=2)`, and prints a response a line.
const CLIENT: &str = r#"
import sys
from pymodbus.client import ModbusTcpClient
client = ModbusTcpClient("127.0.0.1", port=int(sys.argv[1]), timeout=10)
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

#[test]
fn an_independent_client_of_modbus_reads_and_writes_variables() {
    let Some(bcap) = bcap() else { return };
    let python = std::env::var("PYTHON").unwrap_or_else(|_| "python3".into());
    let probe = Command::new(&python).args(["-c", "import pymodbus"]).stderr(Stdio::null()).status();
    if !probe.is_ok_and(|status| status.success()) {
        let _ = writeln!(std::io::stderr(), "skipped: {python} has no pymodbus");
        return;
    }
    let sim = Sim::start(&bcap, "127.0.0.1:0");
    let port = free_port().to_string();
    let settings = [
        "provider=CaoProv.DENSO.VRC",
        "put=I/10-19=-100..100",
        "put=F/1",
        "put=IO/128-135",
        "register=100=I/10-20:i16",
        "register=200=F/1:low",
        "register=300=P/1",
        "coil=0=IO/128-143",
    ];
    // the image of the test of the page, so that one build serves both
    let page = free_port().to_string();
    let mut board = Board::start(&sim.bcap, &["--health", &page, "--modbus", &port], &settings).up();
    let mut client =
        Command::new(&python).args(["-c", CLIENT, &port]).stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().unwrap();
    let exchanges = [
        ("client.write_registers(100, [7, 65535, 9])", "ok"),
        ("client.read_holding_registers(100, count=3)", "[7, 65535, 9]"),
        ("client.read_input_registers(102, count=1)", "[9]"),
        ("client.write_register(103, 100)", "ok"),
        ("client.write_register(103, 101)", "exception 3"),
        ("client.write_register(110, 1)", "exception 2"),
        ("client.write_registers(109, [1, 1])", "exception 2"),
        ("client.read_holding_registers(103, count=1)", "[100]"),
        ("client.read_holding_registers(109, count=1)", "[0]"),
        ("client.write_registers(200, [0, 0x3fc0])", "ok"),
        ("client.read_holding_registers(200, count=2)", "[0, 16320]"),
        ("client.read_holding_registers(300, count=14)", "[0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0]"),
        ("client.write_coils(1, [True, False, True])", "ok"),
        ("client.read_coils(0, count=8)", "[False, True, False, True, False, False, False, False]"),
        ("client.write_coil(8, True)", "exception 2"),
        ("client.read_holding_registers(0, count=1)", "exception 2"),
        ("client.mask_write_register(address=100, and_mask=0, or_mask=0)", "exception 1"),
    ];
    let requests: String = exchanges.iter().map(|(request, _)| format!("{request}\n")).collect();
    client.stdin.take().unwrap().write_all(requests.as_bytes()).unwrap();
    let output = client.wait_with_output().unwrap();
    let responses = String::from_utf8(output.stdout).unwrap();
    assert_eq!(responses.lines().count(), exchanges.len(), "{responses}");
    for ((request, expected), response) in exchanges.iter().zip(responses.lines()) {
        assert_eq!(response, *expected, "{request}");
    }
    // RAC and Modbus read the same variables
    assert_eq!(run(&bcap, &["rac", "get", "I11", "--robot", &board.rac]).out, "I11 = -1\n");
    assert!(board.is_running(), "{}", board.log());
}
