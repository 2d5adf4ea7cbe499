//! `bcap conform`: its examples run, a correct device passes, and a broken one does not.

use std::env;
use std::io::{BufRead, BufReader, Read};
use std::path::Path;
use std::process::{Command, Stdio};

use crate::common;
use crate::common::virtual_robot::Virtual;
use crate::common::{Run, bcap, bcap_with};
use serde_json::Value;

#[test]
fn the_examples_of_the_help_run() {
    let robot = Virtual::start(&[]);
    let help = bcap(&["conform", "--help"]).out;
    let (_, examples) = help.split_once("Examples:\n").unwrap();
    let bin = Path::new(env!("CARGO_BIN_EXE_bcap")).parent().unwrap();
    let path = env::join_paths([bin.to_owned()].into_iter().chain(env::split_paths(&env::var_os("PATH").unwrap())));
    let port = robot.rac.rsplit(':').next().unwrap();
    let mut count = 0;
    // an example that listens waits for a client
    let lines = examples.lines().map(str::trim).filter(|line| line.starts_with("bcap ") && !line.contains("--listen"));
    for example in lines {
        let line = example.replace("tcp:192.168.0.1", &robot.tcp).replace("udp:192.168.0.1", &robot.udp);
        let mut shell = Command::new("sh");
        shell.args(["-c", &line]).env("PATH", path.as_ref().unwrap()).env("BCAP_RAC_PORT", port);
        let run: Run = shell.output().unwrap().into();
        assert_eq!(run.code, 0, "{example}: {run:?}");
        count += 1;
    }
    assert_eq!(count, 6);
}

#[test]
fn a_correct_device_passes_with_a_summary() {
    let robot = Virtual::start(&[]);
    let run = robot.run(&["conform", "--group", "frames", "--group", "rac", "--robot-rac", &robot.rac]);
    assert_eq!(run.code, 0, "{run:?}");
    let summary = run.out.lines().last().unwrap();
    assert!(summary.contains(" 0 failed, "), "{summary}");
    assert!(run.out.contains("pass frames/wrong-end\n") && run.out.contains("pass rac/get-i\n"), "{}", run.out);
    assert!(run.out.contains("skip rac/put-i: needs --level write\n"), "{}", run.out);
}

#[test]
fn nothing_that_listens_is_no_failure_of_the_cases() {
    let run = bcap(&["conform", "--robot", "tcp:127.0.0.1:1", "--group", "frames", "--wait", "1ms"]);
    assert!(run.code == 3 && run.err.contains("the device accepts no connection after 0 of "), "{run:?}");
    assert!(!run.out.contains("FAIL"), "{run:?}");
}

#[test]
fn a_refused_variable_is_a_failure_with_what_was_sent_and_what_came() {
    // a device of another provider: it answers, but it is not an RC9
    let robot = Virtual::start(&[]);
    let wrong = ["conform", "--case", "variables/type-of-i", "--provider", "CaoProv.NoSuch"];
    let run = robot.run(&wrong);
    assert_eq!(run.code, 1, "{run:?}");
    for part in [
        "FAIL variables/type-of-i\n",
        "rule:",
        "-> #2 Controller_Connect(",
        "<- #2 0x8",
        "expected: ",
        "came:     #2 0x8",
    ] {
        assert!(run.out.contains(part), "{part}: {}", run.out);
    }
    assert_eq!(run.err, "error: 1 of 1 cases failed\n");
    let json = robot.run(&[&wrong[..], &["--json"]].concat());
    let line: Value = serde_json::from_str(json.out.lines().next().unwrap()).unwrap();
    assert_eq!((&line["verdict"], &line["group"], json.code), (&"fail".into(), &"variables".into(), 1));
    let junit = robot.run(&[&wrong[..], &["--junit"]].concat());
    assert!(junit.out.starts_with("<?xml ") && junit.out.contains("failures=\"1\""), "{}", junit.out);
    assert_eq!((junit.code, junit.out.lines().last()), (1, Some("</testsuite>")));
}

#[test]
fn wrong_arguments_send_nothing() {
    let robot = Virtual::start(&[]);
    for (args, part) in [
        (&["--level", "motion"][..], "--yes-the-robot-may-move"),
        (&["--case", "frames/no-such"], "no case is named"),
        (&["--group", "colours"], "the groups are frames, "),
        (&["--group", "udp", "--case", "frames/wrong-end"], "in a group"),
    ] {
        let run = robot.run(&[&["conform"], args].concat());
        assert!(run.code == 2 && run.err.contains(part) && run.out.is_empty(), "{args:?}: {run:?}");
    }
}

#[test]
fn the_list_has_every_case_with_its_source() {
    let run = bcap(&["conform", "--list"]);
    assert_eq!(run.code, 0);
    let cases = bcap_conform::cases();
    assert_eq!(run.out.lines().count(), cases.len());
    let line = "frames/wrong-end (read): a frame that does not end with 04 is invalid [RAC specification, Table 2-3]";
    assert!(run.out.lines().any(|found| found == line), "{}", run.out);
    let json = bcap(&["conform", "--list", "--json", "--case", "frames/wrong-end"]);
    let found: Value = serde_json::from_str(&json.out).unwrap();
    assert_eq!(found["source"], "RAC specification, Table 2-3");
}

/// The counts of docs/conformance.md.
#[test]
fn the_documentation_has_the_number_of_cases_of_each_group() {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs/conformance.md");
    let text = std::fs::read_to_string(path).unwrap();
    let cases = bcap_conform::cases();
    for group in bcap_conform::Group::ALL {
        let count = |level| cases.iter().filter(|case| case.group() == group && case.level() == level).count();
        let [read, write, motion] =
            [bcap_conform::Level::Read, bcap_conform::Level::Write, bcap_conform::Level::Motion].map(count);
        let row = format!("| `{group}` | {read} | {write} | {motion} |");
        assert!(text.contains(&row), "{row}");
    }
    assert!(text.contains(&format!("{} cases", cases.len())), "{}", cases.len());
}

#[test]
fn a_client_is_judged_by_the_controller_that_it_connects_to() {
    for protocol in ["tcp", "udp"] {
        let listen = format!("{protocol}:127.0.0.1:0");
        let mut judge = common::command(&["conform", "--listen", &listen]).stdout(Stdio::piped()).spawn().unwrap();
        let mut out = BufReader::new(judge.stdout.take().unwrap());
        let mut line = String::new();
        out.read_line(&mut line).unwrap();
        let address = line.trim().strip_prefix("ready bcap=").unwrap();
        // a script is one session; the judge answers one read with an error
        let mut script = String::new();
        for number in 0..20 {
            script.push_str(&format!("get I{number}\n"));
        }
        let client = bcap_with(&["run", "-", "--robot", address], script.as_bytes());
        let mut rest = String::new();
        out.read_to_string(&mut rest).unwrap();
        assert!(rest.contains("pass client/handles-are-open\n"), "{rest} {client:?}");
        assert!(rest.contains(" 0 failed, "), "{rest} {client:?}");
        assert_eq!(judge.wait().unwrap().code(), Some(0), "{rest}");
    }
}

#[test]
fn without_a_client_the_judge_says_so() {
    let run = bcap(&["conform", "--listen", "127.0.0.1:0", "--timeout", "50"]);
    assert_eq!(run.code, 4, "{run:?}");
    assert!(run.err.contains("no client has sent a request within"), "{run:?}");
    let run = bcap(&["conform", "--listen", "nowhere"]);
    assert!(run.code == 2 && run.err.contains("write [tcp:|udp:]IP:PORT"), "{run:?}");
}
