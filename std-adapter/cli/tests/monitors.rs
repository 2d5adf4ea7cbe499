//! A stream of Slave Mode with everything that reads the same controller: no call ends it, and each tool names the
//! items that it skips.
//!
//! A call that Slave Mode refuses ends Slave Mode, from any client.
//! `just stream-and-monitors` runs the long test, against `bcap sim` in real time.

use std::fs;
use std::io::{BufRead, BufReader};
use std::panic::{catch_unwind, resume_unwind};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::thread;
use std::time::Duration;

use crate::common;
use crate::common::running::Running;
use crate::common::tmux::Terminal;
use crate::common::virtual_robot::Virtual;
use crate::common::{Run, bcap, command, fleet_program};
use bcap_core::hresult::HResult;
use bcap_sim::{Config, Controller, Profile};
use bcap_std::server::Limits;
use bcap_tests::real_time::repeated;
use bcap_tests::served::Served;
use bcap_tests::slowed::Slowed;
use serde_json::Value;

/// The message of each tool.
const RUNS: &str = "skipped: a stream of Slave Mode runs, and ";

/// A stream, killed at the end of the test.
struct Stream {
    child: Child,
    robot: String,
}

impl Stream {
    /// Starts a stream, and waits until Slave Mode is on.
    fn start(robot: &str, seconds: &str) -> Self {
        let args = ["slave", "cosine", "--seconds", seconds, "--amplitude", "4", "--yes", "--robot", robot];
        let child = command(&args).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
        let mut stream = Self { child, robot: robot.to_owned() };
        while !stream.runs() {
            if stream.child.try_wait().unwrap().is_some() {
                panic!("the stream has ended before it ran: {:?}", stream.end());
            }
            thread::sleep(Duration::from_millis(20));
        }
        stream
    }

    fn runs(&self) -> bool {
        bcap(&["exec", "robot", "slvGetMode", "--robot", &self.robot]).out.trim() == "514"
    }

    fn end(&mut self) -> Run {
        let out = self.child.stdout.take().unwrap();
        let err = self.child.stderr.take().unwrap();
        let code = self.child.wait().unwrap().code().unwrap();
        let [out, err] = [std::io::read_to_string(out), std::io::read_to_string(err)].map(Result::unwrap);
        Run { code, out, err }
    }
}

impl Drop for Stream {
    fn drop(&mut self) {
        let _ = self.child.kill();
    }
}

/// A process that is killed at the end of the test.
struct Killed(Child);

impl Drop for Killed {
    fn drop(&mut self) {
        let _ = (self.0.kill(), self.0.wait());
    }
}

/// Writes a fleet of one controller with a broker that does not exist.
fn fleet(robot: &str, folder: &Path) -> String {
    let file = folder.join("fleet.toml");
    let text = format!(
        "group = 'plant'\nnode = 'edge1'\nformat = 'json'\n[broker]\nhost = '127.0.0.1'\nport = 1\n[[controller]]\n\
         name = 'cell1'\naddress = '{robot}'\n[[controller.publish]]\nnames = ['I1', 'mode', 'error', 'pose', 'joints', \
         'robot/@SERVO_ON', 'tasks', 'task/Pro1']\ninterval_ms = 100\n"
    );
    fs::write(&file, text).unwrap();
    file.to_str().unwrap().to_owned()
}

/// Runs every tool once, and asserts what it says if the stream still runs afterwards. Returns whether it does.
fn round(stream: &Stream, fleet: &str, gateway: &str) -> bool {
    let robot = ["--robot", &stream.robot];
    let errors = bcap(&[&["errors"], &robot[..]].concat());
    let messages = bcap(&[&["errors", "--follow", "--for", "1ms"], &robot[..]].concat());
    let clear = bcap(&[&["errors", "--clear"], &robot[..]].concat());
    let doctor = bcap(&[&["doctor", "--json"], &robot[..]].concat());
    let status = bcap(&[&["status"], &robot[..]].concat());
    let check = common::fleet(&[fleet, "--check"]);
    let rac = ["--robot", gateway];
    let put = bcap(&[&["rac", "put", "I1", "5"], &rac[..]].concat());
    let get = bcap(&[&["rac", "get", "I1"], &rac[..]].concat());
    if !stream.runs() {
        return false;
    }
    assert!(errors.code == 1 && errors.err.contains(&format!("{RUNS}GetCurErrorCount would end it")), "{errors:?}");
    assert!(messages.err.contains(&format!("{RUNS}Controller_GetMessage may end it")), "{messages:?}");
    assert!(clear.code == 1 && clear.err.contains(&format!("{RUNS}ClearError would end it")), "{clear:?}");
    assert!(status.code == 0 && status.out.contains("a client in Slave Mode has it"), "{status:?}");
    let line = |name: &str| -> Value {
        let mut lines = doctor.out.lines().map(|line| serde_json::from_str::<Value>(line).unwrap());
        lines.find(|line| line["check"] == name).unwrap_or_else(|| panic!("no {name}: {doctor:?}"))
    };
    assert_eq!(line("provider")["result"], "passed", "{doctor:?}");
    assert_ne!(doctor.code, 0, "{doctor:?}");
    for check in ["mode", "token", "errors", "emergency stop", "motor", "licence", "formats"] {
        let line = line(check);
        assert_eq!(line["result"], "skipped", "{line}");
        assert_eq!(line["detail"], format!("{RUNS}SysState would end it"));
    }
    assert_eq!(line("arm")["result"], "failed", "another client owns it");
    let row = |name: &str| check.out.lines().find(|line| line.contains(name)).unwrap_or_else(|| panic!("{check:?}"));
    assert!(row(" tasks ").contains(&format!("{RUNS}Controller_GetTaskNames may end it")), "{check:?}");
    assert!(row(" task/Pro1 ").contains(&format!("{RUNS}GetStatus may end it")), "{check:?}");
    assert!(row(" joints ").contains('['), "{check:?}");
    assert!(put.code == 1 && put.err.contains("0x83501032"), "{put:?}");
    assert_eq!((get.code, get.out.as_str()), (0, "I1 = 0\n"), "{get:?}");
    true
}

fn config() -> Config {
    Config { motor_on_delay: Duration::from_millis(1), ..Config::new(Profile::Rc8) }
}

/// The commands that list names, copy files or move the robot skip their calls too. The stream of this test sends no pose, so
/// that a busy machine does not end it.
#[test]
fn no_command_ends_the_stream_of_another_client() {
    let sim = Served::of(Controller::new(config()), Limits::default());
    let robot = format!("tcp:{}", sim.tcp);
    let mut cell = bcap_std::blocking::Controller::connect(&robot, &bcap_std::Settings::rc8()).unwrap();
    let mut arm = cell.robot().unwrap().take_arm().unwrap();
    arm.motor_on().unwrap();
    arm.robot().execute::<()>("slvChangeMode", 0x202).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let copy = folder.path().join("copy").to_str().unwrap().to_owned();
    for (reason, command) in [
        ("Controller_GetVariableNames may end it", vec!["names"]),
        ("Controller_GetVariableNames may end it", vec!["dump", &copy]),
        ("Controller_GetVariableNames may end it", vec!["diff", "robot:", "robot:"]),
        ("Controller_GetFileNames may end it", vec!["ls"]),
        ("Controller_GetFileNames may end it", vec!["cp", "robot:/a", &copy]),
        ("Controller_GetTask may end it", vec!["task", "status", "Pro1"]),
        ("TakeArm would end it", vec!["move", "J(1,45,90,0,45,0)", "--yes"]),
    ] {
        let run = bcap(&[&command, &["--robot", &robot][..]].concat());
        assert!(run.code != 0 && run.err.contains(&format!("{RUNS}{reason}")), "{run:?}");
        assert_eq!(sim.application().slave_mode(), 0x202, "{command:?}");
    }
}

/// Streams while every tool reads, and returns the number of rounds of the tools.
fn stream_and_monitors(robot: &str, seconds: &str) -> u32 {
    let folder = tempfile::tempdir().unwrap();
    let fleet = fleet(robot, folder.path());
    // before the stream, because it may have to be built
    let program = fleet_program();
    let mut stream = Stream::start(robot, seconds);
    let gateway = Running::gateway(robot, &["--allow-put", "I/0-9"]);
    let scan = Command::new(program).arg(&fleet).current_dir(folder.path()).stdout(Stdio::piped()).spawn();
    let mut scan = Killed(scan.unwrap());
    let events = BufReader::new(scan.0.stdout.take().unwrap()).lines().map(Result::unwrap);
    let mut skipped = events.filter(|line| line.contains("\"event\":\"skipped\""));
    let monitor = ["monitor", "I1", "--interval", "50", "--robot", robot];
    let bcap = env!("CARGO_BIN_EXE_bcap");
    let monitor = Terminal::run((200, 50), &[&[bcap], &monitor[..]].concat(), folder.path());
    let mut rounds = 0;
    let rac = gateway.rac.clone();
    while round(&stream, &fleet, &rac) {
        rounds += 1;
        if rounds == 1 {
            let event = skipped.next().unwrap();
            assert!(event.contains(RUNS) && event.contains("cell1"), "{event}");
            if let Some(monitor) = &monitor {
                let text = "skipped: a stream of Slave Mode runs";
                monitor.wait_until(text, |screen| screen.contains(text) || !stream.runs());
                assert!(stream.runs(), "the stream was over before the tools");
            }
        }
    }
    let run = stream.end();
    assert_eq!((run.code, run.err.as_str()), (0, ""), "{run:?}");
    assert!(run.out.contains("underflows         0"), "{run:?}");
    let errors = common::bcap(&["errors", "--robot", robot]);
    assert_eq!(errors.out, "no errors\n", "{errors:?}");
    if let Some(monitor) = &monitor {
        monitor.wait_for("no errors");
        monitor.wait_for("Pro1             ready");
    }
    assert_eq!(gateway.interrupt().code, 0);
    rounds
}

#[test]
fn no_tool_ends_a_stream() {
    repeated(|| {
        let sim = Served::<Slowed>::of(Slowed(Controller::new(config())), Limits::default());
        let ended = catch_unwind(|| stream_and_monitors(&format!("tcp:{}", sim.tcp), "2"));
        let mut errors = sim.application().0.errors().map(|error| error.code).collect::<Vec<_>>();
        errors.retain(|code| *code == HResult::E_COMMAND_BUFFER_EMPTY);
        assert!(errors.is_empty(), "{errors:?}");
        let rounds = ended.unwrap_or_else(|panic| resume_unwind(panic));
        assert!(rounds > 0, "the stream was over before the tools");
        assert_eq!(sim.application().0.errors().count(), 0);
    });
}

#[test]
#[ignore = "in real time; `just stream-and-monitors`"]
fn no_tool_ends_a_stream_in_real_time() {
    let sim = Virtual::start(&[]);
    let rounds = stream_and_monitors(&sim.tcp, "20");
    assert!(rounds > 0, "the stream was over before the tools");
    println!("20 s, {rounds} rounds of errors, messages, clear, doctor, fleet --check and gateway: 0 interruptions");
}
