//! Tests Modbus TCP of the gateway board in QEMU with an independent client: pymodbus.

use std::path::Path;

use bcap_qemu::{Board, Sim, bcap, free_port, run};

use bcap_test_support::pymodbus::Pymodbus;

#[test]
fn an_independent_client_of_modbus_reads_and_writes_variables() {
    let bcap = bcap();
    let pymodbus = Pymodbus::find(Path::new(env!("CARGO_TARGET_TMPDIR"))).unwrap();
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
        ("client.mask_write_register(address=100, and_mask=0x04, or_mask=0x10)", "ok"),
        ("client.readwrite_registers(read_address=100, read_count=3, write_address=102, values=[1])", "[20, 65535, 1]"),
        ("client.read_device_information(object_id=0)", "{0: b'bcap', 1: b'bcap-gateway', 2: b'0.1.0'}"),
    ];
    pymodbus.check(&format!("127.0.0.1:{port}"), &exchanges);
    // RAC and Modbus read the same variables
    assert_eq!(run(&bcap, &["rac", "get", "I11", "--robot", &board.rac]).out, "I11 = -1\n");
    assert!(board.is_running(), "{}", board.log());
}
