//! `bcap call FUNCTION --help` and `bcap call --list`.

use crate::common::bcap;
use serde_json::Value;

#[test]
fn the_help_of_a_function_has_its_arguments_and_controllers() {
    let run = bcap(&["call", "TaskStop", "--help"]);
    let expected = "\
Task_Stop(task, mode, option): function 89

Stops the task.

* `task`: its handle, from Controller_GetTask.
* `mode`: 0 default, 1 at once, 2 after the step, 3 after the cycle, 4 stop and initialise (I4). The
  specification shows 3 only.
* `option`: an option string; the specification lists no options, its packets send an empty string.
* Returns no value.
* Controllers: all (b-CAP specification, section 4.2.2).

`bcap call --help` describes how the arguments are written.
";
    assert_eq!((run.out.as_str(), run.err.as_str(), run.code), (expected, "", 0));
    for same in [["call", "89", "-h"], ["call", "--help", "task_stop"], ["call", "bCap_TaskStop", "--help"]] {
        assert_eq!(bcap(&same).out, expected, "{same:?}");
    }
    // arguments do not matter, and no robot is called
    let run = bcap(&["call", "Task_Stop", "task:Pro1", "-1", "--help", "--robot", "tcp:127.0.0.1:1"]);
    assert_eq!((run.out.as_str(), run.code), (expected, 0));
    let run = bcap(&["call", "Task_Stopp", "--help"]);
    assert!(run.code == 2 && run.err.contains("no function Task_Stopp") && run.err.contains("call --list"), "{run:?}");
}

#[test]
fn without_a_function_the_help_is_that_of_the_command() {
    for help in ["--help", "-h"] {
        let run = bcap(&["call", help]);
        assert!(run.code == 0 && run.err.is_empty(), "{run:?}");
        for part in [
            "Usage: bcap call ",
            "Examples:\n  bcap call ",
            "--list",
            "--robot <ADDRESS>",
            "bcap call Robot_Move --help",
        ] {
            assert!(run.out.contains(part), "{part}: {}", run.out);
        }
    }
    let run = bcap(&["call"]);
    assert!(run.code == 2 && run.err.contains("FUNCTION"), "{run:?}");
}

#[test]
fn the_list_has_all_functions() {
    let run = bcap(&["call", "--list"]);
    assert_eq!((run.out.lines().count(), run.code), (137, 0));
    assert_eq!(
        run.out.lines().next(),
        Some(
            "  1 Service_Start(option): Starts the service of the controller for this client; the first call of a session."
        )
    );
    assert!(
        run.out.ends_with("137 Message_Release(message): Releases the message; its handle is then invalid.\n"),
        "{}",
        run.out
    );
    let run = bcap(&["call", "--list", "--json"]);
    let halt: Value = serde_json::from_str(run.out.lines().nth(69).unwrap()).unwrap();
    let summary = "Halts the motion of the robot: the statement HALT.";
    let expected = serde_json::json!({
        "number": 70, "name": "Robot_Halt", "arguments": ["robot", "option"], "summary": summary
    });
    assert_eq!(halt, expected);
    assert_eq!(bcap(&["call", "--list", "Robot_Halt"]).code, 2);
}

#[test]
fn the_list_of_effects_has_all_functions_and_their_commands() {
    let run = bcap(&["call", "--list", "--effects"]);
    let columns = |name: &str| -> Vec<&str> {
        let line = run.out.lines().find(|line| line.split(' ').next() == Some(name));
        line.unwrap_or_else(|| panic!("no {name}")).split_whitespace().skip(1).take(2).collect()
    };
    for (name, effect, in_slave_mode) in [
        ("Service_Start", "session", "allowed"),
        ("Variable_GetValue", "reads", "allowed"),
        ("Variable_PutValue", "writes", "unknown"),
        ("Robot_Halt", "moves", "allowed"),
        ("Robot_Move", "moves", "refused"),
        ("Controller_Execute", "moves", "unknown"),
        ("Controller_Execute/GetCurErrorCount", "reads", "refused"),
        ("Controller_Execute/ClearError", "writes", "refused"),
        ("Robot_Execute/CurPos", "reads", "allowed"),
        ("Robot_Execute/TakeArm", "moves", "refused"),
    ] {
        assert_eq!(columns(name), [effect, in_slave_mode], "{name}");
    }
    let of_functions = run.out.lines().filter(|line| !line.split(' ').next().unwrap().contains('/'));
    assert_eq!((of_functions.count(), run.code), (137, 0));
    let json = bcap(&["call", "--list", "--effects", "--json"]);
    let lines: Vec<Value> = json.out.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    assert_eq!(lines.len(), run.out.lines().count());
    let state = lines.iter().find(|line| line["name"] == "Controller_Execute/SysState").unwrap();
    assert_eq!([&state["effect"], &state["in_slave_mode"]], ["reads", "refused"]);
    assert!(state["source"].as_str().unwrap().starts_with("seen on a COBOTTA PRO 900"), "{state}");
    assert_eq!(bcap(&["call", "--effects"]).code, 2, "it belongs to --list");
}
