//! `bcap report` against virtual controllers.

use std::fs;
use std::process::Command;
use std::time::Duration;

use crate::common::bcap;
use crate::common::virtual_robot::Virtual;
use bcap_sim::{Config, Controller, Profile};
use bcap_std::server::Limits;
use bcap_tests::served::Served;
use serde_json::Value;

/// Returns the line of a call in a report with `--json`.
#[track_caller]
fn line(out: &str, call: &str) -> Value {
    let mut lines = out.lines().map(|line| serde_json::from_str::<Value>(line).unwrap());
    lines.find(|line| line["call"] == call).unwrap_or_else(|| panic!("no line of {call}"))
}

#[test]
fn a_report_names_what_differs_from_the_virtual_controller() {
    let sim = Virtual::start(&["--model", "cobotta"]);
    let run = sim.run(&["report", "--rounds", "2", "--model", "rc8", "--json"]);
    assert_eq!((run.code, run.err.as_str()), (0, ""), "{run:?}");
    let pose = line(&run.out, "robot CurPos");
    assert_eq!([&pose["answer"], &pose["virtual"]], ["R8[7]", ""]);
    assert_eq!((&pose["value"], pose["count"].as_u64()), (&Value::Null, Some(2)));
    assert!(pose["p50_us"].as_u64() > Some(0) && pose["p50_us"].as_u64() <= pose["p99_us"].as_u64(), "{pose}");
    let state = line(&run.out, "controller StoState");
    assert_eq!([&state["answer"], &state["virtual"]], ["BOOL", "80000904 E_INVALID_CMD_NAME"]);
    let unknown = line(&run.out, "unknown @NO_SUCH_VARIABLE");
    assert_eq!([&unknown["answer"], &unknown["virtual"]], ["80000204 E_CAO_OBJECT_NOTFOUND", ""]);
    assert_eq!(unknown["count"], 1, "a refused call is not repeated");
    assert_eq!(line(&run.out, "variable @TYPE")["value"], "COBOTTA");
}

#[test]
fn an_rc9_is_compared_with_one() {
    let sim = Virtual::start(&["--model", "rc9"]);
    let run = sim.run(&["report", "--rounds", "1", "--json"]);
    assert_eq!(run.code, 0, "{run:?}");
    let lines = run.out.lines().map(|line| serde_json::from_str::<Value>(line).unwrap());
    let differs = |line: &Value| line["virtual"].as_str().is_some_and(|text| !text.is_empty());
    let different: Vec<_> = lines.filter(differs).map(|line| line["call"].clone()).collect();
    // only the virtual controller of `bcap sim` has files
    assert_eq!(different, ["names controller Controller_GetFileNames"]);
}

#[test]
fn a_report_is_a_new_file_without_values() {
    let sim = Virtual::start(&[]);
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("rc8.report");
    let name = file.to_str().unwrap();
    assert_eq!(sim.run(&["put", "S0", "secret"]).code, 0);
    let run = sim.run(&["report", "--rounds", "1", name]);
    assert_eq!((run.code, run.out.as_str()), (0, ""), "{run:?}");
    let text = fs::read_to_string(&file).unwrap();
    assert!(text.starts_with("bcap report, format 1\n# Read this file before you send it."), "{text}");
    assert!(
        text.contains("\nmodel        RC8 Controller\n") && text.contains("\nended        after all rounds\n"),
        "{text}"
    );
    let row = |text: &str| text.lines().find(|line| line.starts_with("variable S0 ")).unwrap().to_owned();
    assert!(row(&text).contains(" BSTR "), "{text}");
    for private in ["secret", &sim.tcp["tcp:".len()..], "127.0.0.1"] {
        assert!(!text.contains(private), "{private}: {text}");
    }
    let again = sim.run(&["report", "--rounds", "1", name]);
    assert!(again.code == 2 && again.err.contains("exists; name a new file"), "{again:?}");
    let shown = sim.run(&["report", "--rounds", "1", "--values"]);
    assert!(row(&shown.out).ends_with("  secret"), "{shown:?}");
}

#[test]
fn a_report_skips_calls_that_would_end_a_stream() {
    let config = Config { motor_on_delay: Duration::from_millis(1), ..Config::new(Profile::Rc8) };
    let sim = Served::of(Controller::new(config), Limits::default());
    let robot = format!("tcp:{}", sim.tcp);
    let mut cell = bcap_std::blocking::Controller::connect(&robot, &bcap_std::Settings::rc8()).unwrap();
    let mut arm = cell.robot().unwrap().take_arm().unwrap();
    arm.motor_on().unwrap();
    arm.robot().execute::<()>("slvChangeMode", 0x202).unwrap();
    let run = bcap(&["report", "--rounds", "1", "--json", "--robot", &robot]);
    assert_eq!(run.code, 0, "{run:?}");
    let skipped = "skipped: a stream of Slave Mode runs, and SysState would end it";
    assert_eq!(line(&run.out, "controller SysState")["answer"], skipped);
    assert_eq!(line(&run.out, "robot CurJnt")["answer"], "R8[8]");
    assert_eq!(sim.application().slave_mode(), 0x202);
}

#[test]
fn a_report_ends_with_the_first_refusal_that_the_controller_keeps() {
    let folder = tempfile::tempdir().unwrap();
    let scenario = folder.path().join("refused.toml");
    fs::write(&scenario, "[[fault]]\nwhen = { every = 1, of = \"CurFig\" }\nthen = { refuse = \"0x81501012\" }\n")
        .unwrap();
    let sim = Virtual::start(&["--scenario", scenario.to_str().unwrap()]);
    let run = sim.run(&["report", "--json"]);
    assert_eq!(run.code, 0, "{run:?}");
    assert!(line(&run.out, "robot CurFig")["answer"].as_str().unwrap().starts_with("81501012"), "{run:?}");
    assert_eq!(line(&run.out, "robot CurSpd")["answer"], "not asked");
    let end: Value = serde_json::from_str(run.out.lines().last().unwrap()).unwrap();
    let why = "the controller refused `robot CurFig` and may keep that as an error: look with `bcap errors`";
    assert_eq!(end["ended"], why);
}

#[test]
fn a_report_becomes_observations_of_the_tests() {
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/../sim/tests/provider/from-report");
    let sim = Virtual::start(&[]);
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("cell.report");
    assert_eq!(sim.run(&["report", "--rounds", "1", file.to_str().unwrap()]).code, 0);
    let output = Command::new(script).arg(file).args(["R1", "rc8", "a cell"]).output().unwrap();
    assert!(output.status.success(), "{output:?}");
    let text = String::from_utf8(output.stdout).unwrap();
    assert_eq!(toml::from_str::<toml::Table>(&text).unwrap().len(), text.matches("[R1-").count());
    for play in [
        r#"[["robot.get", "@SERVO_ON", "BOOL"]]"#,
        r#"[["robot.GetSrvData", 1, "R8[8]"]]"#,
        r#"[["controller.StoState", {}, "!80000904"]]"#,
        r#"[["Controller_GetTask", ["NoSuchTask", ""], "!80000204"]]"#,
        r#"[["Controller_GetTaskNames", [""], "*"]]"#,
    ] {
        assert!(text.contains(&format!("\nplay = {play}\n")), "{play}: {text}");
    }
}
