//! Tests a gateway board without a network in QEMU: the robot and the PLC are at the other ends of serial lines.
//!
//! ```text
//!  bcap sim ─ pseudo-terminals ─ this test ─ Unix socket ─► QEMU: second port ─► gateway ◄─ third port ◄─ Unix socket ─ PLC
//! ```

use std::io::{BufRead, BufReader, Write};
use std::os::unix::net::UnixStream;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};
use std::{env, process, thread};

use crate::line::{connect, join};
use bcap_core::hresult::HResult;
use bcap_qemu::{Board, TIMEOUT, bcap, error};
use serialport::{SerialPort, TTYPort};

/// A process that is killed when this is dropped.
struct Robot(Child);

impl Drop for Robot {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

#[test]
fn a_plc_and_a_robot_on_serial_lines_need_no_network() {
    let bcap = bcap();
    let (cable, device) = TTYPort::pair().unwrap();
    let address = format!("{}?baud=115200", device.name().unwrap());
    let mut robot = Command::new(bcap);
    robot.args(["sim", "--no-network", "--serial", &address]).stdin(Stdio::null()).stdout(Stdio::piped());
    let mut robot = Robot(robot.spawn().unwrap());
    let mut ready = String::new();
    BufReader::new(robot.0.stdout.take().unwrap()).read_line(&mut ready).unwrap();
    assert!(ready.starts_with("ready serial="), "{ready}");

    let [to_robot, to_plc] = ["robot", "plc"].map(|end| env::temp_dir().join(format!("bcap-{end}-{}", process::id())));
    let lines = format!("{}:{}", to_robot.display(), to_plc.display());
    let settings = ["provider=CaoProv.DENSO.VRC", "put=I/10-19=-10..10"];
    let mut board = Board::start_image("serial", "127.0.0.1:5007", &["--lines", &lines], &settings);
    join(cable, connect(&mut board, &to_robot));
    let plc = connect(&mut board, &to_plc);
    plc.set_read_timeout(Some(TIMEOUT)).unwrap();
    let mut plc = BufReader::new(plc);
    let since = Instant::now();
    while ask(&mut plc, "GET:RC8:1:I:\r") != "0,3,0\r" {
        assert!(since.elapsed() < TIMEOUT, "the robot is not connected: {}", board.log());
        thread::sleep(Duration::from_millis(50));
    }
    for number in -10..=10 {
        assert_eq!(ask(&mut plc, &format!("PUT:RC8:12:I:3,{number}\r")), "0\r");
        assert_eq!(ask(&mut plc, "GET:RC8:12:I:\r"), format!("0,3,{number}\r"));
    }
    assert_eq!(ask(&mut plc, "PUT:RC8:12:I:3,11\r"), error(HResult::E_INVALIDARG));
    assert_eq!(ask(&mut plc, "PUT:RC8:20:I:3,1\r"), error(HResult::E_ACCESSDENIED));
    assert_eq!(ask(&mut plc, "HELLO\r"), error(HResult::E_INVALIDCOMMAND));
    // a robot that is gone costs errors until it is back
    robot.0.kill().unwrap();
    while ask(&mut plc, "GET:RC8:12:I:\r") != error(HResult::E_NOT_CONNECTED) {}
    assert!(board.is_running(), "{}", board.log());
}

/// Sends a line and returns its answer; both end with a CR.
fn ask(plc: &mut BufReader<UnixStream>, line: &str) -> String {
    plc.get_mut().write_all(line.as_bytes()).unwrap();
    let mut answer = Vec::new();
    plc.read_until(b'\r', &mut answer).unwrap();
    String::from_utf8(answer).unwrap()
}
