//! `bcap doctor` against virtual controllers with one fault each: it reports exactly that fault.

use std::fs;
use std::path::Path;

use crate::common::fake::{Fake, usual, value};
use crate::common::virtual_robot::Virtual;
use crate::common::{Run, bcap};
use bcap_core::bcap::{FunctionId, call};
use bcap_core::hresult::HResult;
use bcap_core::procedure::{Provider, open_robot};
use bcap_std::{Options, blocking};
use serde_json::Value;

/// A virtual controller and its provider.
struct Sim {
    robot: Virtual,
    provider: &'static str,
}

impl Sim {
    /// Starts a controller, with the motor off.
    fn start(more: &[&str]) -> Self {
        let provider = if more.contains(&"rc9") { "CaoProv.DENSO.VRC9" } else { "CaoProv.DENSO.VRC" };
        Self { robot: Virtual::start(more), provider }
    }

    /// Starts a controller and prepares it, with the motor on.
    fn ready(more: &[&str]) -> Self {
        let sim = Self::start(more);
        // a COBOTTA must be prepared first; the other models do not have these commands
        let prepare = [&["ManualResetPreparation"][..], &["MotionPreparation"]];
        let commands = if more.contains(&"cobotta") { &prepare[..] } else { &[] };
        for command in commands.iter().chain(&[&["Motor", "1"][..]]) {
            let run = sim.bcap(&[&["exec", "robot"], *command].concat());
            assert_eq!(run.code, 0, "{run:?}");
        }
        sim
    }

    /// Runs a command with the address and the provider of the controller.
    fn bcap(&self, command: &[&str]) -> Run {
        bcap(&[command, &["--robot", &self.robot.tcp, "--provider", self.provider]].concat())
    }

    fn doctor(&self, more: &[&str]) -> Run {
        self.bcap(&[&["doctor", "--udp-port", self.robot.udp.rsplit_once(':').unwrap().1], more].concat())
    }
}

/// Returns the failed checks with their details.
fn failed(run: &Run) -> Vec<(String, String)> {
    let lines = run.out.lines().map(|line| serde_json::from_str::<Value>(line).unwrap());
    let text = |value: &Value| value.as_str().unwrap().to_owned();
    let checks = lines.filter(|line| line.get("check").is_some());
    let failed = checks.filter(|line| line["result"] == "failed");
    failed
        .map(|line| {
            assert!(!text(&line["hint"]).is_empty(), "{line}");
            (text(&line["check"]), text(&line["detail"]))
        })
        .collect()
}

/// Returns the result and the detail of a check.
fn result(run: &Run, check: &str) -> (String, String) {
    let mut lines = run.out.lines().map(|line| serde_json::from_str::<Value>(line).unwrap());
    let line = lines.find(|line| line["check"] == check).unwrap();
    let text = |key: &str| line[key].as_str().unwrap().to_owned();
    (text("result"), text("detail"))
}

/// Checks that exactly this check fails, with this word in its detail.
#[track_caller]
fn names(sim: &Sim, check: &str, word: &str, code: i32) {
    let run = sim.doctor(&["--json"]);
    let failed = failed(&run);
    assert_eq!(failed.len(), 1, "{run:?}");
    assert_eq!(failed[0].0, check, "{run:?}");
    assert!(failed[0].1.contains(word), "{failed:?}");
    assert_eq!(run.code, code, "{run:?}");
    assert!(run.err.contains(word) && run.err.contains("hint: "), "{}", run.err);
}

fn scenario(name: &str, faults: &[(&str, &str)]) -> String {
    let text: String =
        faults.iter().map(|(when, then)| format!("[[fault]]\nwhen = {{ {when} }}\nthen = {then}\n")).collect();
    let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
    fs::write(&path, text).unwrap();
    path.to_str().unwrap().to_owned()
}

#[test]
fn a_ready_controller_passes_and_its_state_is_unchanged() {
    for (model, family) in [("rc8", "RC8"), ("rc9", "RC9"), ("cobotta", "it is a COBOTTA")] {
        let sim = Sim::ready(&["--model", model]);
        let run = sim.doctor(&[]);
        assert_eq!((run.code, run.err.as_str()), (0, ""), "{}", run.out);
        let checks: Vec<&str> = run.out.lines().map(|line| line[7..21].trim_end()).collect();
        let all = "tcp udp provider version permission mode token errors emergency stop arm motor licence formats";
        assert_eq!(checks.join(" "), all);
        // no function returns the permission
        assert!(
            run.out.lines().all(|line| line.starts_with("ok ") || line.starts_with("-      permission")),
            "{}",
            run.out
        );
        assert!(run.out.contains(family), "{}", run.out);
        assert_eq!(run.out.contains("all but sending HandIO, receiving HandIO"), model == "cobotta", "{}", run.out);
        // the controller has no error and the arm is free
        let state = sim.bcap(&["exec", "controller", "SysState"]);
        assert_eq!(state.out.trim().parse::<i32>().unwrap() & 0b10, 0, "no error");
        assert_eq!(sim.bcap(&["exec", "robot", "TakeArm", "8195,0,1"]).code, 0);
    }
}

#[test]
fn an_unreachable_link_is_reported() {
    let sim = Sim::ready(&[]);
    // another test could take a free port
    let closed = "1";
    let run = sim.doctor(&["--json", "--tcp-port", closed]);
    assert_eq!((failed(&run).iter().map(|(check, _)| check.as_str()).collect::<Vec<_>>(), run.code), (vec!["tcp"], 3));
    let silent = std::net::UdpSocket::bind("127.0.0.1:0").unwrap();
    let port = silent.local_addr().unwrap().port().to_string();
    let run = bcap(&["doctor", "--json", "--robot", &sim.robot.tcp, "--udp-port", &port]);
    assert_eq!((failed(&run).iter().map(|(check, _)| check.as_str()).collect::<Vec<_>>(), run.code), (vec!["udp"], 4));
    // without any link all other checks are skipped
    let run = bcap(&[
        "doctor",
        "--json",
        "--robot",
        &sim.robot.tcp,
        "--tcp-port",
        closed,
        "--udp-port",
        &port,
        "--timeout",
        "500",
    ]);
    assert_eq!((failed(&run).len(), run.code), (2, 3), "{run:?}");
    assert_eq!(run.out.matches("\"skipped\"").count(), 11);
}

#[test]
fn a_wrong_provider_is_reported_with_the_accepted_one() {
    let refuse = ("call = 2, of = 'Controller_Connect'", "{ refuse = 'E_CAO_PROVIDER_NOTFOUND' }");
    let only_once = scenario("doctor-provider.toml", &[(refuse.0, "{ refuse = 'E_FAIL' }")]);
    let sim = Sim::ready(&["--lenient", "--scenario", &only_once]);
    names(&sim, "provider", "CaoProv.DENSO.VRC9 (RC9) is accepted", 1);
    let all =
        scenario("doctor-providers.toml", &[("call = 2, to = 3, of = 'Controller_Connect'", "{ refuse = 'E_FAIL' }")]);
    let sim = Sim::ready(&["--scenario", &all]);
    names(&sim, "provider", "CaoProv.DENSO.VRC9 is refused with", 1);
}

#[test]
fn an_unreadable_version_is_reported() {
    let fault = [("every = 2, of = 'Variable_GetValue'", "{ refuse = 'E_ACCESSDENIED' }")];
    // the first variable read is @TYPE, the second @VERSION
    let sim = Sim::ready(&["--scenario", &scenario("doctor-version.toml", &fault)]);
    names(&sim, "version", "@VERSION cannot be read", 1);
}

#[test]
fn a_wrong_mode_is_reported() {
    names(&Sim::start(&["--mode", "manual"]), "mode", "Manual", 1);
    names(&Sim::start(&["--mode", "teach-check"]), "mode", "teach check", 1);
}

#[test]
fn a_missing_token_is_reported() {
    names(&Sim::start(&["--token", "pendant"]), "token", "the teach pendant has it", 1);
    let fault = [("call = 1, of = 'TakeArm'", "{ refuse = 'E_TOKEN_ADDRESS' }")];
    let sim = Sim::ready(&["--scenario", &scenario("doctor-token.toml", &fault)]);
    names(&sim, "token", "E_TOKEN_ADDRESS", 1);
}

#[test]
fn errors_are_reported_with_the_first_cause() {
    let faults = [("at_ms = 0", "{ error = '0x84204043' }"), ("at_ms = 1", "{ error = '0x83204072' }")];
    let sim = Sim::start(&["--scenario", &scenario("doctor-error.toml", &faults)]);
    names(&sim, "errors", "2, the first cause is 0x84204043", 1);
}

#[test]
fn the_emergency_stop_is_reported() {
    let pressed = [("at_ms = 0", "{ emergency_stop = true }")];
    for model in ["rc8", "rc9"] {
        let sim = Sim::start(&["--model", model, "--scenario", &scenario(&format!("doctor-{model}.toml"), &pressed)]);
        names(&sim, "emergency stop", "pressed", 1);
    }
    // on an RC9 the torque stays off after the release
    let released = [pressed[0], ("at_ms = 1", "{ emergency_stop = false }")];
    let sim = Sim::start(&["--model", "rc9", "--scenario", &scenario("doctor-sto.toml", &released)]);
    sim.bcap(&["exec", "controller", "ClearError"]);
    names(&sim, "emergency stop", "torque is still off", 1);
}

#[test]
fn an_arm_of_another_client_is_reported() {
    let sim = Sim::ready(&[]);
    let mut other = blocking::connect_tcp(sim.robot.tcp.trim_start_matches("tcp:"), &Options::default()).unwrap();
    let handles = other.run(open_robot(Provider::RC8, None)).unwrap();
    other.call(call::robot_execute(handles.robot, "TakeArm", [0, 0])).unwrap();
    let run = sim.doctor(&["--json"]);
    assert_eq!(failed(&run).iter().map(|(check, _)| check.as_str()).collect::<Vec<_>>(), ["arm"], "{run:?}");
    assert_eq!(run.code, 1);
    // the other client still owns the arm
    let state = other.call(call::robot_execute(handles.robot, "TakeArmState", -1)).unwrap();
    assert_eq!(state.as_i32(), Some(1));
}

#[test]
fn a_motor_that_is_off_is_no_failure() {
    let run = Sim::start(&[]).doctor(&["--json"]);
    assert_eq!((failed(&run).len(), run.code), (0, 0), "{run:?}");
    let (result, detail) = result(&run, "motor");
    assert!(result == "passed" && detail.contains("off; `bcap move`"), "{detail}");
}

#[test]
fn a_missing_licence_is_reported() {
    names(&Sim::ready(&["--no-slave-licence"]), "licence", "E_NO_LICENSE", 1);
}

#[test]
fn a_missing_format_is_reported() {
    let fault = [("every = 1, of = 'slvRecvFormat'", "{ refuse = 'E_INVALIDARG' }")];
    let sim = Sim::ready(&["--scenario", &scenario("doctor-format.toml", &fault)]);
    names(&sim, "formats", "slvRecvFormat 0x1 (P) is refused", 1);
}

#[test]
fn an_inconclusive_licence_check_is_untested() {
    for (command, code) in [
        // without this command a refusal of slvChangeMode does not show that there is a licence
        ("slvSendFormat", "E_NOTIMPL"),
        ("slvSendFormat", "E_INVALID_CMD_NAME"),
        ("slvRecvFormat", "E_NOT_USE"),
        ("slvChangeMode", "E_NOTIMPL"),
        ("slvChangeMode", "E_FAIL"),
        ("slvGetMode", "E_NOTIMPL"),
    ] {
        let refuse = format!("{{ refuse = '{code}' }}");
        let when = format!("every = 1, of = '{command}'");
        let name = format!("doctor-untested-{command}-{code}.toml");
        let sim = Sim::ready(&["--scenario", &scenario(&name, &[(&when, &refuse)])]);
        let run = sim.doctor(&["--json"]);
        let (result, detail) = result(&run, "licence");
        assert_eq!((result.as_str(), run.code), ("untested", 1), "{run:?}");
        assert!(detail.contains(command) && detail.contains(code), "{detail}");
        assert!(run.err.contains("licence: could not be tested"), "{}", run.err);
        let run = sim.doctor(&[]);
        assert!(run.out.lines().any(|line| line.starts_with("?      licence ")), "{}", run.out);
    }
}

#[test]
fn a_missing_licence_is_reported_for_every_command() {
    for command in ["slvSendFormat", "slvGetMode"] {
        let when = format!("every = 1, of = '{command}'");
        let text = [(when.as_str(), "{ refuse = 'E_NO_LICENSE' }")];
        let sim = Sim::ready(&["--scenario", &scenario(&format!("doctor-licence-{command}.toml"), &text)]);
        let run = sim.doctor(&["--json"]);
        assert_eq!((result(&run, "licence").0.as_str(), run.code), ("failed", 1), "{run:?}");
    }
}

#[test]
fn formats_are_not_set_while_a_client_may_be_in_slave_mode() {
    let fault = [("every = 1, of = 'slvGetMode'", "{ refuse = 'E_FAIL' }")];
    let sim = Sim::ready(&["--scenario", &scenario("doctor-slave-mode.toml", &fault)]);
    let run = sim.doctor(&["--json"]);
    let (licence, detail) = result(&run, "licence");
    assert_eq!((licence.as_str(), run.code), ("untested", 1));
    assert!(detail.contains("a client may be in Slave Mode"), "{detail}");
    for check in ["mode", "token", "errors", "emergency stop", "arm", "motor", "formats"] {
        let (skipped, detail) = result(&run, check);
        assert_eq!(skipped, "skipped", "{check}: {detail}");
        assert!(detail.contains("may run, and SysState would end it"), "{detail}");
    }
}

#[test]
fn status_shows_the_state_and_the_command_that_changes_it() {
    let sim = Sim::start(&[]);
    let run = sim.bcap(&["status"]);
    assert_eq!((run.code, run.err.as_str()), (0, ""), "{}", run.out);
    let items: Vec<&str> = run.out.lines().map(|line| line[7..21].trim_end()).collect();
    let all = "controller mode permission token errors emergency stop motor arm speed position tasks ready";
    assert_eq!(items.join(" "), all, "{}", run.out);
    assert!(!run.out.contains("FAILED"), "{}", run.out);
    for text in ["RC8 2.8.0", "Auto", "off; `bcap move`", "100 %", "364.159992,0,278.5", "none runs; `bcap task start`"]
    {
        assert!(run.out.contains(text), "{text}: {}", run.out);
    }
    assert!(run.out.contains("yes, after the motor is on"), "{}", run.out);
    assert_eq!(sim.bcap(&["task", "start", "Pro1", "--forever"]).code, 0);
    assert_eq!(
        result(&sim.bcap(&["status", "--json"]), "tasks").1,
        "Pro1 running; `bcap task stop` stops one, `bcap halt` the robot"
    );
    // it left the arm free, and no error
    assert_eq!(sim.bcap(&["errors"]).out, "no errors\n");
}

#[test]
fn status_of_a_controller_without_a_robot_has_the_other_lines() {
    let fake = Fake::tcp(|request| match request.function() {
        FunctionId::CONTROLLER_GET_ROBOT => HResult::E_ACCESSDENIED.into(),
        FunctionId::CONTROLLER_GET_ROBOT_NAMES => value(vec!["Arm".to_owned()]),
        FunctionId::VARIABLE_GET_VALUE => value("RC8"),
        FunctionId::CONTROLLER_GET_TASK_NAMES => value(vec!["Pro1".to_owned()]),
        _ => usual(request),
    });
    let run = bcap(&["status", "--robot", &fake.address]);
    assert_eq!((run.code, run.err.as_str()), (0, ""), "{run:?}");
    for text in [
        "controller     RC8",
        "arm            the controller gives no robot",
        "FAILED ready          the first robot: Controller_GetRobot: ",
        "`bcap names robot`",
    ] {
        assert!(run.out.contains(text), "{text}: {}", run.out);
    }
    assert_eq!(run.out.matches("E_ACCESSDENIED").count(), 2, "only with its cause: {}", run.out);
}

#[test]
fn status_names_the_first_cause_and_why_the_robot_is_not_ready() {
    let faults = [("at_ms = 0", "{ error = '0x84204043' }"), ("at_ms = 1", "{ error = '0x83204072' }")];
    let sim = Sim::start(&["--scenario", &scenario("status-errors.toml", &faults)]);
    let run = sim.bcap(&["status", "--json"]);
    assert_eq!(run.code, 0, "{run:?}");
    let (found, detail) = result(&run, "errors");
    assert!(found == "failed" && detail.starts_with("2, the first cause is 0x84204043"), "{detail}");
    assert_eq!(result(&run, "ready").0, "failed", "{}", run.out);
}
