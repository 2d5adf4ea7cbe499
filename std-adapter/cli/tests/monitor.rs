//! `bcap monitor` in a terminal, as a person uses it. It needs tmux.

use std::io::{BufRead, BufReader};
use std::process::{Child, Stdio};

use crate::common;
use crate::common::tmux::Terminal;
use crate::common::virtual_robot::Virtual;
use crate::common::{bare, bcap, command};
use bcap_tests::cable::{Cable, End, Quality};

const SIZES: [(u16, u16); 2] = [(80, 24), (200, 50)];

/// Starts a shell in a terminal and `bcap` in it.
fn monitor(size: (u16, u16), args: &str, folder: &tempfile::TempDir) -> Option<Terminal> {
    let terminal = Terminal::run(size, &["sh"], folder.path())?;
    terminal.enter(&format!("PS1='ready> '; {} {args}", env!("CARGO_BIN_EXE_bcap")));
    Some(terminal)
}

/// Asserts that the terminal is as it was: no alternate screen, a cursor, an echo, and lines.
#[track_caller]
fn assert_sane(terminal: &Terminal) {
    terminal.wait_for("ready>");
    terminal.enter("stty -a | tr ' ;' '\\n\\n' | grep -xE -- '-?(icanon|echo|isig)' | tr '\\n' '.'");
    // the shell runs this after the command, which has then restored all of the terminal
    terminal.wait_for("isig.icanon.echo.");
    assert_eq!(["alternate_on", "cursor_flag"].map(|name| terminal.variable(name)), ["0", "1"]);
}

#[test]
fn a_person_watches_writes_halts_and_quits() {
    for size in SIZES {
        let robot = Virtual::start(&[]);
        let folder = tempfile::tempdir().unwrap();
        let args = format!("monitor I1 I2 IO128 --interval 50 --robot {}", robot.tcp);
        let Some(terminal) = monitor(size, &args, &folder) else { return };
        for text in ["> I1    = 0", "IO128 = false", "RC8 auto ok", "J2    45.000", "no errors"] {
            terminal.wait_for(text);
        }
        terminal.wait_for("Pro1             ready");
        // a change is marked, bold, for 2 s, which may be over when the command has ended
        let put = robot.spawn(&["put", "I1", "5", "--timeout", "20s"]);
        terminal.wait_until("a bold change", |screen| {
            screen.contains(">*I1    = 5") && terminal.styled_screen().contains("\u{1b}[1m")
        });
        assert!(put.wait_with_output().unwrap().status.success());
        terminal.wait_for(" I4(5) = Variable_GetValue(");
        // a value is confirmed before it is written
        terminal.keys(&["Down", "w"]);
        terminal.wait_for("write NAME=VALUE: I2=_");
        terminal.text("3,5");
        terminal.keys(&["Enter"]);
        terminal.wait_for("I2: 3,5: this could be TYPE,DATA");
        terminal.keys(&["w"]);
        terminal.text("7");
        terminal.keys(&["Enter"]);
        terminal.wait_for("write I2 = 7, now 0? y/N");
        assert_eq!(robot.run(&["get", "I2"]).out, "I2 = 0\n");
        terminal.keys(&["y"]);
        terminal.wait_for("I2 = 7 is written");
        assert_eq!(robot.run(&["get", "I2"]).out, "I2 = 7\n");
        // a value that has changed since the question is not replaced
        terminal.keys(&["w"]);
        terminal.text("8");
        terminal.keys(&["Enter"]);
        terminal.wait_for("write I2 = 8, now 7? y/N");
        assert_eq!(robot.run(&["put", "I2", "9"]).code, 0);
        terminal.keys(&["y"]);
        terminal.wait_for("not written: I2 has changed meanwhile from 7 to 9");
        assert_eq!(robot.run(&["get", "I2"]).out, "I2 = 9\n");
        // halts the motion of another client
        let mover = robot.spawn(&["move", "J(90, 45, 90, 0, 45, 0)", "--speed", "1"]);
        robot.wait_for_motion();
        terminal.wait_for("motor moving");
        terminal.keys(&["h"]);
        terminal.wait_for("the robot rests");
        let moved = mover.wait_with_output().unwrap();
        assert!(String::from_utf8_lossy(&moved.stderr).contains("the robot was halted"), "{moved:?}");
        robot.assert_at_rest_with_free_arm();
        // all packets, and no more packets
        terminal.keys(&["a"]);
        terminal.wait_for("packets, all");
        terminal.keys(&["p"]);
        terminal.wait_for("packets, paused");
        terminal.keys(&["q"]);
        assert_sane(&terminal);
    }
}

#[test]
fn every_end_restores_the_terminal() {
    let robot = Virtual::start(&[]);
    for end in ["C-c", "-INT", "-TERM", "-HUP"] {
        let folder = tempfile::tempdir().unwrap();
        let Some(terminal) = monitor((80, 24), &format!("monitor I1 --robot {}", robot.tcp), &folder) else { return };
        terminal.wait_for("I1 = 0");
        assert_eq!(terminal.variable("alternate_on"), "1");
        if end == "C-c" {
            terminal.keys(&[end]);
        } else {
            let shell = terminal.variable("pane_pid");
            let kill = ["-c", &format!("kill {end} $(pgrep -P {shell})")];
            assert!(std::process::Command::new("sh").args(kill).status().unwrap().success());
        }
        assert_sane(&terminal);
    }
}

#[test]
fn a_halt_is_waited_for_at_the_end() {
    let robot = Virtual::start(&[]);
    let folder = tempfile::tempdir().unwrap();
    let Some(terminal) = monitor((80, 24), &format!("monitor I1 --robot {}", robot.tcp), &folder) else { return };
    terminal.wait_for("I1 = 0");
    let mover = robot.spawn(&["move", "J(90, 45, 90, 0, 45, 0)", "--speed", "1"]);
    robot.wait_for_motion();
    terminal.keys(&["h", "q"]);
    assert_sane(&terminal);
    let moved = mover.wait_with_output().unwrap();
    assert!(String::from_utf8_lossy(&moved.stderr).contains("the robot was halted"), "{moved:?}");
    robot.assert_at_rest_with_free_arm();
}

#[test]
fn a_halt_over_a_serial_line_uses_its_only_session() {
    let cable = Cable::new(Quality { baud: Some(115_200), ..Quality::default() });
    let line = format!("{}?baud=115200", cable.path(End::Controller).display());
    let robot = Virtual::start(&["--serial", &line]);
    let folder = tempfile::tempdir().unwrap();
    let args = format!("monitor I1 --robot '{}'", cable.address(115_200));
    let Some(terminal) = monitor((80, 24), &args, &folder) else { return };
    terminal.wait_for("I1 = 0");
    let mover = robot.spawn(&["move", "J(90, 45, 90, 0, 45, 0)", "--speed", "1"]);
    robot.wait_for_motion();
    terminal.keys(&["h"]);
    terminal.wait_for("the robot rests");
    let moved = mover.wait_with_output().unwrap();
    assert!(String::from_utf8_lossy(&moved.stderr).contains("the robot was halted"), "{moved:?}");
    robot.assert_at_rest_with_free_arm();
    terminal.keys(&["q"]);
    assert_sane(&terminal);
}

#[cfg(target_os = "linux")]
#[test]
fn a_terminal_that_is_gone_ends_the_monitor() {
    let robot = Virtual::start(&[]);
    let folder = tempfile::tempdir().unwrap();
    let args = ["monitor", "I1", "--robot", &robot.tcp];
    let Some(terminal) = Terminal::start((80, 24), &args, folder.path()) else { return };
    terminal.wait_for("I1 = 0");
    let process = format!("/proc/{}", terminal.variable("pane_pid"));
    assert!(std::path::Path::new(&process).exists());
    drop(terminal);
    while std::path::Path::new(&process).exists() {
        std::thread::sleep(std::time::Duration::from_millis(5));
    }
}

/// Starts a virtual controller at an address.
fn sim_at(address: &str) -> Child {
    let address = address.strip_prefix("tcp:").unwrap_or(address);
    let args = ["sim", "--bcap", address, "--udp", "127.0.0.1:0", "--rac", "127.0.0.1:0"];
    let mut child = command(&args).stdout(Stdio::piped()).spawn().unwrap();
    BufReader::new(child.stdout.as_mut().unwrap()).read_line(&mut String::new()).unwrap();
    child
}

#[test]
fn a_lost_connection_is_shown_and_opened_again() {
    let robot = Virtual::start(&[]);
    let address = robot.tcp.clone();
    let folder = tempfile::tempdir().unwrap();
    let args = format!("monitor I1 --interval 20 --timeout 10000 --robot {address}");
    let Some(terminal) = monitor((80, 24), &args, &folder) else { return };
    terminal.wait_for("RC8 auto ok");
    drop(robot);
    terminal.wait_for("NOT CONNECTED: ");
    terminal.keys(&["h"]);
    terminal.wait_for("NOT HALTED, use the emergency stop: ");
    let mut again = sim_at(&address);
    let screen = terminal.wait_for("RC8 auto ok");
    assert!(!screen.contains("NOT CONNECTED"), "{screen}");
    // the halting connection is also opened again
    terminal.keys(&["h"]);
    terminal.wait_for("the robot rests");
    terminal.keys(&["q"]);
    assert_sane(&terminal);
    again.kill().unwrap();
    again.wait().unwrap();
}

#[test]
fn a_small_terminal_shows_the_variables() {
    let robot = Virtual::start(&[]);
    let folder = tempfile::tempdir().unwrap();
    let Some(terminal) = monitor((40, 8), &format!("monitor I1 --robot {}", robot.tcp), &folder) else { return };
    terminal.wait_for("> I1 = 0");
    terminal.wait_for("RC8 auto ok");
    terminal.wait_for("70x18 shows all panels");
    terminal.resize((80, 24));
    terminal.wait_for("┌ variables ─");
    terminal.keys(&["q"]);
    assert_sane(&terminal);
}

#[test]
fn a_long_value_next_to_a_long_name_is_whole() {
    for width in [80, 86] {
        let robot = Virtual::start(&[]);
        assert_eq!(robot.run(&["put", "I1", "123456789"]).code, 0);
        let folder = tempfile::tempdir().unwrap();
        let args = format!("monitor I1 D1 task:Pro1/@CYCLE_TIME --interval 20 --robot {}", robot.tcp);
        let Some(terminal) = monitor((width, 24), &args, &folder) else { return };
        let shown = |screen: &str, name: &str, value: &str| {
            let row = screen.lines().find(|line| line.contains(name)).unwrap_or_default().to_owned();
            row.split('│').nth(1).is_some_and(|row| row.split(" = ").nth(1).is_some_and(|text| text.starts_with(value)))
        };
        // there is room for a sparkline only next to the values
        terminal.wait_until("sparklines", |screen| screen.contains("▁▁▁▁"));
        let screen = terminal.screen();
        assert!(shown(&screen, "I1 ", "123456789"), "{screen}");
        assert!(shown(&screen, "Pro1/@CYCLE_TIME", "1000"), "{screen}");
        terminal.keys(&["q"]);
        assert_sane(&terminal);
    }
}

#[test]
fn six_errors_are_counted_and_explained() {
    let folder = tempfile::tempdir().unwrap();
    let scenario = folder.path().join("scenario.toml");
    let codes = ["0x84201482", "0x81501003", "0x81501025", "0x83204232", "0x84204041", "0x81501004"];
    std::fs::write(&scenario, format!("[controller]\nerrors = {codes:?}\n")).unwrap();
    let robot = Virtual::start(&["--scenario", scenario.to_str().unwrap()]);
    let errors = robot.run(&["errors"]).out;
    let first = errors.split(' ').next().unwrap().to_uppercase().replace("0X", "0x");
    let Some(terminal) = monitor((80, 24), &format!("monitor I1 --robot {}", robot.tcp), &folder) else { return };
    let screen = terminal.wait_for("(4 more)");
    assert!(screen.contains("┌ 6 errors, first cause first ─"), "{screen}");
    assert!(screen.contains(&format!("│{first} ")), "{first}:\n{screen}");
    terminal.keys(&["Tab", "Tab", "Enter"]);
    let details = terminal.wait_for("Hint: ");
    let meaning = errors.lines().next().unwrap().split(") ").nth(1).unwrap();
    assert!(details.contains(&meaning[..30]), "{details}\n{errors}");
    terminal.keys(&["?"]);
    terminal.wait_for("> 0x");
    terminal.keys(&["?"]);
    terminal.wait_for("shows the keys");
    terminal.keys(&["q"]);
    assert_sane(&terminal);
}

#[test]
fn each_function_and_object_is_shown_once() {
    let robot = Virtual::start(&[]);
    let folder = tempfile::tempdir().unwrap();
    let args = format!("monitor I1 --packets --interval 50 --robot {}", robot.tcp);
    let Some(terminal) = monitor((200, 50), &args, &folder) else { return };
    terminal.wait_for("Variable_GetValue I1");
    assert_eq!(robot.run(&["put", "I1", "5"]).code, 0);
    let screen = terminal.wait_until("I4(5) of I1", |screen| screen.contains(" s  Variable_GetValue I1 = I4(5) "));
    assert_eq!(screen.matches("Variable_GetValue I1 ").count(), 1, "{screen}");
    terminal.keys(&["o"]);
    terminal.wait_for("I1 = 5");
    terminal.keys(&["q"]);
    assert_sane(&terminal);
}

#[test]
fn a_screen_without_colours_has_none() {
    let robot = Virtual::start(&[]);
    let folder = tempfile::tempdir().unwrap();
    let Some(terminal) = Terminal::run((80, 24), &["sh"], folder.path()) else { return };
    terminal.enter(&format!("NO_COLOR=1 {} monitor I1 --robot {}", env!("CARGO_BIN_EXE_bcap"), robot.tcp));
    terminal.wait_for("I1 = 0");
    // a change is marked for 2 s, which may be over when the command has ended
    let put = robot.spawn(&["put", "I1", "1", "--timeout", "20s"]);
    terminal.wait_until("a bold change", |screen| {
        let styled = terminal.styled_screen();
        assert!(!styled.contains("\u{1b}[33") && !styled.contains("[38"), "{styled:?}");
        screen.contains(">*I1 = 1") && styled.contains("\u{1b}[1m")
    });
    assert!(put.wait_with_output().unwrap().status.success());
    terminal.keys(&["q"]);
}

#[test]
fn the_examples_of_the_help_run() {
    let robot = Virtual::start(&[]);
    let folder = tempfile::tempdir().unwrap();
    let help = bcap(&["monitor", "--help"]).out;
    let (_, examples) = help.split_once("Examples:\n").unwrap();
    let Some(terminal) = Terminal::run((80, 24), &["sh"], folder.path()) else { return };
    terminal.enter(&format!("PS1='ready> '; export BCAP_ROBOT={}", robot.tcp));
    let examples: Vec<&str> = examples.lines().map(str::trim).filter(|line| !line.is_empty()).collect();
    assert!(examples.len() >= 3, "{help}");
    for example in examples {
        let line = example.replace("tcp:192.168.0.1", &robot.tcp);
        terminal.enter(&line.replace("bcap ", concat!(env!("CARGO_BIN_EXE_bcap"), " ")));
        terminal.wait_for("RC8 auto ok");
        terminal.wait_for("J2    45.000");
        terminal.keys(&["q"]);
        assert_sane(&terminal);
        terminal.enter("clear");
        terminal.wait_until("a clear screen", |screen| screen.trim() == "ready>");
    }
}

#[test]
fn a_live_screen_needs_a_terminal() {
    let run = bcap(&["monitor", "I1"]);
    assert_eq!(run.code, 2);
    assert!(run.err.contains("needs a terminal as input and output; `bcap watch` prints"), "{}", run.err);
    let dumb: common::Run = bare(&["monitor"]).env("TERM", "dumb").output().unwrap().into();
    assert_eq!(dumb.code, 2);
    assert!(dumb.err.contains("TERM=dumb: this terminal cannot move its cursor"), "{}", dumb.err);
    let json = bcap(&["monitor", "--json"]);
    assert!(json.err.contains("`bcap watch --json`"), "{}", json.err);
    let trace = bcap(&["monitor", "--trace"]);
    assert!(trace.err.contains("leave --trace out"), "{}", trace.err);
    assert_eq!(bcap(&["monitor", "I1-J5"]).code, 2);
}
