//! `bcap shell` in a terminal, as a person uses it. It needs tmux.

use std::process::Command;

use crate::common::tmux::Terminal;
use crate::common::virtual_robot::Virtual;

#[test]
fn ctrl_c_in_the_shell_halts_the_robot_and_gives_the_arm_back() {
    for size in [(80, 24), (200, 50)] {
        let robot = Virtual::start(&[]);
        let folder = tempfile::tempdir().unwrap();
        let Some(terminal) = Terminal::start(size, &["shell", "--robot", &robot.tcp], folder.path()) else { return };
        terminal.wait_for("RC8 auto ok>");
        terminal.enter("exec robot TakeArm 0 1");
        terminal.wait_for("RC8 auto ok arm>");
        terminal.enter("exec robot Motor 1 0");
        terminal.wait_for("RC8 auto ok arm motor>");
        // during a motion
        terminal.enter("move 'J(90, 45, 90, 0, 45, 0)' --speed 1");
        robot.wait_for_motion();
        terminal.keys(&["C-c"]);
        terminal.wait_for("error: interrupted: the robot was halted, and the arm was given back");
        // the message of the controller precedes the prompt
        terminal.wait_for("RC8 0x83500076: E_MOTION_STOPPED");
        terminal.wait_for("RC8 auto error 0x83500076>");
        robot.assert_at_rest_with_free_arm();
        // an empty screen, so that the prompts below are not found in the lines above
        terminal.keys(&["C-l"]);
        terminal.wait_until("an empty screen", |screen| !screen.contains("arm>"));
        // at the prompt, while the robot moves
        terminal.enter("exec robot TakeArm 0 1");
        terminal.wait_for("RC8 auto ok arm>");
        terminal.enter("move 'J(-90, 45, 90, 0, 45, 0)' --speed 1 --no-wait");
        terminal.wait_for("on the way to J(-90, 45, 90, 0, 45, 0)");
        robot.wait_for_motion();
        terminal.keys(&["C-c"]);
        terminal.wait_for(" note: the robot was halted, and the arm was given back");
        robot.assert_at_rest_with_free_arm();
        terminal.enter("exit");
    }
}

#[test]
fn ctrl_c_halts_the_motion_to_the_start_of_a_stream_in_the_shell() {
    let robot = Virtual::start(&[]);
    let folder = tempfile::tempdir().unwrap();
    let Some(terminal) = Terminal::start((80, 24), &["shell", "--robot", &robot.tcp], folder.path()) else { return };
    terminal.wait_for("RC8 auto ok>");
    // the second time too, although each line has opened and closed its own sessions
    for to in ["J(90, 45, 90, 0, 45, 0)", "J(-90, 45, 90, 0, 45, 0)"] {
        terminal.enter(&format!("slave cosine --from '{to}' --speed 1 --yes"));
        robot.wait_for_motion();
        terminal.keys(&["C-c"]);
        terminal.wait_for("error: interrupted: the robot was halted, and the arm was given back");
        // the message of the controller precedes the prompt
        terminal.wait_for("RC8 0x83500076: E_MOTION_STOPPED");
        terminal.wait_for("RC8 auto error 0x83500076>");
        robot.assert_at_rest_with_free_arm();
        // a prompt without the error, and an empty screen, so that the next round does not find the text of this one
        terminal.keys(&["Enter"]);
        terminal.wait_for("RC8 auto error 0x83500076>\nRC8 auto ok>");
        terminal.keys(&["C-l"]);
        terminal.wait_until("an empty screen", |screen| !screen.contains("error"));
    }
    // the shell itself continues
    terminal.enter("get I1");
    terminal.wait_for("I1 = 0");
    terminal.enter("exit");
}

#[test]
fn tab_completes_and_the_history_is_kept() {
    let robot = Virtual::start(&[]);
    let folder = tempfile::tempdir().unwrap();
    let args = ["shell", "--robot", &robot.tcp];
    let Some(terminal) = Terminal::start((80, 24), &args, folder.path()) else { return };
    terminal.wait_for("RC8 auto ok>");
    // a command, a function, a command of a robot, a variable of a robot
    for (typed, completed) in [
        ("prof", "> profile"),
        ("call robot_mo", "> call Robot_Move"),
        ("exec controller ClearE", "> exec controller ClearError"),
        ("get robot/@SERVO", "> get robot/@SERVO_ON"),
        ("task:Pro1 get task:Pro", "task:Pro1"),
    ] {
        terminal.keys(&["-l", typed]);
        terminal.keys(&["Tab"]);
        terminal.wait_for(completed);
        terminal.keys(&["C-a", "C-k"]);
    }
    terminal.enter("put I7 1234");
    terminal.wait_for("I7 = 1234");
    terminal.enter("exit");
    let history = folder.path().join("history");
    while !std::fs::read_to_string(&history).is_ok_and(|lines| lines.contains("put I7 1234")) {
        std::thread::sleep(std::time::Duration::from_millis(5));
    }
    drop(terminal);
    let terminal = Terminal::start((80, 24), &args, folder.path()).unwrap();
    terminal.wait_for("RC8 auto ok>");
    terminal.keys(&["Up", "Up"]);
    terminal.wait_for("> put I7 1234");
}

#[test]
fn ctrl_z_suspends_the_shell_after_the_arm_is_given_back_and_fg_continues_it() {
    let robot = Virtual::start(&[]);
    let folder = tempfile::tempdir().unwrap();
    // a shell with job control
    let Some(terminal) = Terminal::run((120, 24), &["bash", "--norc", "-i"], folder.path()) else { return };
    terminal.enter("PS1='%% '");
    terminal.enter(&format!("{} shell --robot {}", env!("CARGO_BIN_EXE_bcap"), robot.tcp));
    terminal.wait_for("RC8 auto ok>");
    // at the prompt, and during a motion
    for line in ["", "move 'J(90, 45, 90, 0, 45, 0)' --speed 1"] {
        terminal.enter("exec robot TakeArm 0 1");
        terminal.wait_for("RC8 auto ok arm>");
        if !line.is_empty() {
            terminal.enter("exec robot Motor 1 0");
            terminal.wait_for("RC8 auto ok arm motor>");
            terminal.enter(line);
            robot.wait_for_motion();
        }
        terminal.keys(&["C-z"]);
        terminal.wait_for("Stopped");
        robot.assert_at_rest_with_free_arm();
        terminal.keys(&["C-l"]);
        terminal.wait_until("an empty screen", |screen| !screen.contains("Stopped"));
        terminal.enter("fg");
        terminal.wait_for("shell --robot");
        terminal.enter("get I1");
        terminal.wait_for("I1 = 0");
        terminal.keys(&["C-l"]);
        terminal.wait_until("an empty screen", |screen| !screen.contains("I1 = 0"));
    }
    terminal.enter("exit");
}

/// The terminal would stop a process in the background at its first output (`stty tostop`) or input, with the arm taken.
#[test]
fn the_terminal_does_not_stop_a_command_in_the_background() {
    let robot = Virtual::start(&[]);
    let folder = tempfile::tempdir().unwrap();
    let script = folder.path().join("script.bcap");
    let lines = ["exec robot TakeArm 0 1", "exec robot Motor 1 0", "get I1"];
    std::fs::write(&script, lines.join("\n")).unwrap();
    let Some(terminal) = Terminal::run((120, 24), &["bash", "--norc", "-i"], folder.path()) else { return };
    terminal.enter("PS1='%% '; stty tostop");
    let bcap = env!("CARGO_BIN_EXE_bcap");
    let run = format!("run {}", script.display());
    for (line, end) in [(run.as_str(), "Done"), ("shell", "Exit")] {
        terminal.enter(&format!("{bcap} {line} --robot {} &", robot.tcp));
        // the shell reports the end of a job before its next prompt
        terminal.wait_until(end, |screen| {
            assert!(!screen.contains("Stopped"), "{screen}");
            terminal.keys(&["Enter"]);
            screen.contains(end)
        });
        robot.assert_at_rest_with_free_arm();
    }
}

/// The prompt reads single keys without an echo; the shell that a person returns to must not.
#[test]
fn sigterm_at_the_prompt_restores_the_terminal() {
    let robot = Virtual::start(&[]);
    let folder = tempfile::tempdir().unwrap();
    let script = folder.path().join("script");
    let shell = format!(
        "before=$(stty -g)\n{} shell --robot {}\n[ \"$before\" = \"$(stty -g)\" ] && echo restored || echo changed\nsleep 60\n",
        env!("CARGO_BIN_EXE_bcap"),
        robot.tcp
    );
    std::fs::write(&script, shell).unwrap();
    let Some(terminal) = Terminal::run((80, 24), &["sh", script.to_str().unwrap()], folder.path()) else { return };
    terminal.wait_for("RC8 auto ok>");
    let parent = terminal.variable("pane_pid");
    assert!(Command::new("pkill").args(["-TERM", "-P", &parent, "bcap"]).status().unwrap().success());
    terminal.wait_for("restored");
}
