//! `bcap sim`, and the other commands against a virtual controller.

use std::collections::BTreeSet;
use std::fs;
use std::io::{BufRead, BufReader, Read};
use std::net::TcpListener;
use std::path::Path;
use std::process::{Command, Stdio};

use crate::common::running::Running;
use crate::common::virtual_robot::Virtual;
use crate::common::{Run, bcap, command};
use bcap_tests::process::{Signal, send};
use serde_json::Value;

/// A virtual controller, and the command over each of its links.
struct Sim(Virtual);

impl Sim {
    fn start(more: &[&str]) -> Self {
        Self(Virtual::start(more))
    }

    fn tcp(&self, args: &[&str]) -> Run {
        self.0.run(args)
    }

    fn udp(&self, args: &[&str]) -> Run {
        bcap(&[args, &["--robot", &self.0.udp]].concat())
    }

    fn rac(&self, args: &[&str]) -> Run {
        self.0.process.rac(args)
    }
}

/// A variable of each kind, three plain values for it, and its VARTYPE.
const KINDS: [(&str, [&str; 3], u16); 9] = [
    ("I1", ["-5", "2147483647", "0"], 3),
    ("F2", ["1.5", "-0.1", "16777216"], 4),
    ("D3", ["0.1", "-1e300", "5e-324"], 5),
    ("S4", ["hello, world", "(a", ""], 8),
    ("V5", ["1,2,3", "-1.5,0,0.25", "0,0,0"], 8196),
    ("P6", ["1,2,3,4,5,6,-1", "400,0,300.5,180,0,180,5", "0,0,0,0,0,0,0"], 8196),
    ("J7", ["1,2,3,4,5,6,7,8", "0,45,90,0,45,0,0,0", "-1,0,0,0,0,0,0,0"], 8196),
    ("T8", ["1,2,3,4,5,6,7,8,9,5", "0,0,0,1,0,0,0,1,0,5", "9,8,7,6,5,4,3,2,1,-1"], 8196),
    ("IO128", ["true", "false", "true"], 11),
];

#[test]
fn all_kinds_of_variables_agree_over_all_links() {
    let sim = Sim::start(&[]);
    type Link = fn(&Sim, &[&str]) -> Run;
    let links: [Link; 3] = [Sim::tcp, Sim::udp, Sim::rac];
    for (name, values, vartype) in KINDS {
        for (writer, value) in links.iter().zip(values) {
            let put = writer(&sim, &["put", name, value]);
            assert_eq!((put.code, put.err.as_str()), (0, ""), "{name} {value}");
            assert_eq!(put.out, format!("{name} = {value}\n"));
            let json: Vec<String> = links
                .map(|reader| {
                    let plain = reader(&sim, &["get", name]);
                    assert_eq!((plain.out, plain.code), (format!("{name} = {value}\n"), 0), "{}", plain.err);
                    reader(&sim, &["get", name, "--json"]).out
                })
                .into();
            assert!(json.iter().all(|line| *line == json[0]), "{json:?}");
            let line: Value = serde_json::from_str(&json[0]).unwrap();
            assert_eq!((&line["name"], &line["vt"]), (&name.into(), &vartype.into()));
        }
    }
}

#[test]
fn a_session_of_commands_works() {
    let sim = Sim::start(&[]);
    let names = sim.tcp(&["names"]);
    assert_eq!(names.code, 0, "{names:?}");
    assert!(names.out.lines().any(|line| line == "task:Pro1"), "{}", names.out);
    assert!(names.out.lines().any(|line| line.starts_with("robot:") && line.ends_with("/@SERVO_ON")), "{}", names.out);

    // each command is a separate session, and the arm authority belongs to one session
    assert_eq!(sim.tcp(&["exec", "robot", "TakeArm", "8195,0,0"]).code, 0);
    assert_eq!(sim.tcp(&["get", "robot/@SERVO_ON"]).out, "robot/@SERVO_ON = false\n");
    assert_eq!(sim.udp(&["exec", "robot", "Motor", "1"]).code, 0);
    assert_eq!(sim.tcp(&["get", "robot/@SERVO_ON"]).out, "robot/@SERVO_ON = true\n");
    let joints = sim.tcp(&["exec", "robot", "CurJnt", "--json"]);
    let reply: Value = serde_json::from_str(&joints.out).unwrap();
    assert_eq!((&reply["name"], &reply["value"]["vt"]), (&"S_OK".into(), &8197.into()));
    assert_eq!(reply["value"]["v"].as_array().unwrap().len(), 8);

    assert_eq!(sim.tcp(&["get", "task:Pro1/@STATUS"]).code, 0);
    let state = sim.tcp(&["call", "ControllerExecute", "controller", "8,SysState", "0,"]);
    assert!(state.code == 0 && state.out.trim_end().parse::<i32>().is_ok(), "{state:?}");
    let text = sim.tcp(&["exec", "controller", "GetErrorDescription", "-2147481344"]);
    assert!(text.code == 0 && text.out.len() > 1, "{text:?}");
    let watch = sim.tcp(&["watch", "I1", "IO1", "--count", "3", "--interval", "1", "--changed"]);
    assert_eq!((watch.out.lines().count(), watch.code), (2, 0), "{watch:?}");
}

#[test]
fn refusals_are_explained_over_all_links() {
    let sim = Sim::start(&[]);
    let put = ["put", "I1", "--typed", "8,x"];
    for run in [sim.tcp(&put), sim.udp(&put), sim.rac(&put)] {
        assert_eq!((run.out.as_str(), run.code), ("", 1));
        assert!(run.err.contains("0x80010003 (E_INVALIDARGTYPE)") && run.err.contains("hint: "), "{}", run.err);
    }
    for run in [sim.tcp(&["get", "I100"]), sim.rac(&["get", "I100"])] {
        assert!(run.code == 1 && run.err.contains("0x8"), "{run:?}");
    }
    let run = sim.tcp(&["get", "I1", "--provider", "NoSuchProvider"]);
    assert!(run.code == 1 && run.err.contains("Controller_Connect: the controller refused"), "{run:?}");
}

#[test]
fn a_refused_argument_is_explained_on_stderr_and_by_its_description() {
    let mut sim = Sim(Running::sim(&["--explain"]).into());
    assert_eq!(sim.tcp(&["exec", "robot", "TakeArm", "8195,0,0,0"]).code, 1);
    let line = sim.0.process.error_line();
    let why = "Robot_Execute \"TakeArm\": given [I4(0), I4(0), I4(0)]; accepted nothing, the group, or [group, keep]: \
               group 0 to 31, keep 0 or 1";
    assert!(line.contains("E_INVALIDARG") && line.trim_end().ends_with(why), "{line}");
    let text = sim.tcp(&["exec", "controller", "GetErrorDescription", "-2147024809"]).out;
    assert!(text.trim_end().ends_with(why), "{text}");
}

#[test]
fn an_argument_of_the_wrong_type_is_named_on_stderr() {
    let mut sim = Sim(Running::sim(&["--explain"]).into());
    let run = sim.tcp(&["call", "Robot_Speed", "robot", "8,fast", "4,10"]);
    assert!(run.code == 1 && run.err.contains("E_INVALIDARGTYPE"), "{run:?}");
    let line = sim.0.process.error_line();
    let why = "Robot_Speed: axis: given \"fast\"; accepted I4, or another integer type whose value fits";
    assert!(line.contains("E_INVALIDARGTYPE") && line.trim_end().ends_with(why), "{line}");
}

#[test]
fn the_help_names_all_that_is_not_simulated() {
    let help = bcap(&["sim", "--help"]).out;
    let words: BTreeSet<_> = help.split(|c: char| !c.is_ascii_alphanumeric() && c != '_').collect();
    let page = include_str!("../../../docs/virtual-controller.md");
    let commands = page.split("\n## Commands").nth(1).unwrap().lines().filter(|line| line.starts_with('|'));
    let cells = commands.map(|line| line.split('|').map(str::trim).collect::<Vec<_>>());
    let missing: Vec<_> = cells.filter(|cells| ["no", "unknown"].contains(&cells[3])).map(|cells| cells[2]).collect();
    assert!(["ForceCtrl", "HandCurPressure"].iter().all(|name| missing.contains(name)), "{missing:?}");
    assert!(missing.iter().all(|name| words.contains(name)), "{missing:?}");
}

#[test]
fn a_lenient_controller_names_what_it_tolerates() {
    let strict = Sim::start(&["--model", "rc9"]);
    let run = strict.tcp(&["get", "I1", "--provider", "CaoProv.DENSO.VRC"]);
    assert!(run.code == 1 && run.err.contains("E_CAO_PROV_INVALID"), "{run:?}");
    let mut sim = Sim(Running::sim(&["--model", "rc9", "--lenient"]).into());
    assert_eq!(sim.tcp(&["get", "I1"]).code, 0);
    let line = sim.0.process.error_line();
    let tolerated = "tolerated: Controller_Connect: provider \"CaoProv.DENSO.VRC\" is not that of RC9";
    assert!(line.starts_with(tolerated), "{line}");
}

#[test]
fn the_rc9_has_commands_that_the_rc8_does_not_have() {
    let rc9 = Sim::start(&["--model", "rc9"]);
    let run = rc9.tcp(&["exec", "controller", "StoState", "--provider", "CaoProv.DENSO.VRC9"]);
    assert_eq!(run.code, 0, "{run:?}");
    let rc8 = Sim::start(&[]);
    assert_eq!(rc8.tcp(&["exec", "controller", "StoState"]).code, 1);
}

/// Writes a scenario to a file, and returns its path.
fn scenario(name: &str, text: &str) -> String {
    let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
    fs::write(&path, text).unwrap();
    path.to_str().unwrap().to_owned()
}

fn fault(when: &str, then: &str) -> String {
    format!("[[fault]]\nwhen = {{ {when}, of = 'Variable_GetValue' }}\nthen = {then}\n")
}

#[test]
fn a_scenario_can_refuse_drop_and_corrupt() {
    let text = fault("call = 1", "{ refuse = 'E_FAIL' }") + &fault("call = 3", "'disconnect'");
    let sim = Sim::start(&["--scenario", &scenario("stream.toml", &text)]);
    let run = sim.tcp(&["get", "I1"]);
    assert!(run.code == 1 && run.err.contains("E_FAIL"), "{run:?}");
    assert_eq!(sim.tcp(&["get", "I1"]).out, "I1 = 0\n");
    let run = sim.tcp(&["get", "I1"]);
    assert!(run.code != 0 && run.out.is_empty(), "the connection is cut: {run:?}");
    assert_eq!(sim.tcp(&["get", "I1"]).out, "I1 = 0\n");

    // the UDP client retransmits after a lost or corrupt reply, and the call is executed at most once
    let text = ["'drop'", "'wrong_serial'", "'corrupt'"].iter().enumerate();
    let text: String = text.map(|(n, then)| fault(&format!("call = {}", n + 1), then)).collect();
    let sim = Sim::start(&["--scenario", &scenario("datagrams.toml", &text)]);
    for _ in 0..4 {
        assert_eq!(sim.udp(&["get", "I1", "--timeout", "5000"]).out, "I1 = 0\n");
    }
}

#[test]
fn a_scenario_sets_the_initial_state() {
    let text = "[controller]\ntoken = 'pendant'\nerrors = ['0x84201482']\nversion = '1.2.3'\n";
    let sim = Sim::start(&["--scenario", &scenario("beginning.toml", text)]);
    assert_eq!(sim.tcp(&["get", "@VERSION"]).out, "@VERSION = 1.2.3\n");
    assert_eq!(sim.tcp(&["exec", "controller", "GetCurErrorCount"]).out, "1\n");
    let run = sim.tcp(&["exec", "robot", "TakeArm"]);
    assert!(run.code == 1 && run.err.contains("E_TOKEN_NOT_ETHERNET"), "{run:?}");
}

#[test]
fn the_controllers_files_are_those_of_a_folder() {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("files");
    fs::create_dir_all(&folder).unwrap();
    fs::write(folder.join("a.pcs"), "Sub Main").unwrap();
    let sim = Sim::start(&["--files", folder.to_str().unwrap()]);
    assert_eq!(sim.tcp(&["call", "ControllerGetFileNames", "controller", "8,"]).out, "a.pcs\n");
    // without --files the controller has a source file for each task
    let sim = Sim::start(&[]);
    let run = sim.tcp(&["call", "ControllerGetFileNames", "controller", "8,"]);
    assert_eq!((run.code, run.out.as_str()), (0, "Pro1.pcs,Pro2.pcs,Pro3.pcs\n"), "{run:?}");
    let run = sim.tcp(&["call", "FileGetValue", "file:Pro2.pcs"]);
    assert_eq!(run.out, r#""'!TITLE \"Pro2\"\r\nSub Main\r\nEnd Sub\r\n""#.to_owned() + "\n");
    let run = bcap(&["sim", "--files", "no/such/folder"]);
    assert!(run.code == 2 && run.err.contains("--files no/such/folder: the folder does not exist"), "{run:?}");
}

#[cfg(unix)]
#[test]
fn a_fifo_in_the_folder_blocks_neither_b_cap_nor_rac_nor_signals() {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("files-with-a-fifo");
    let _ = fs::remove_dir_all(&folder);
    fs::create_dir_all(&folder).unwrap();
    fs::write(folder.join("a.pcs"), "Sub Main").unwrap();
    assert!(Command::new("mkfifo").arg(folder.join("fifo")).status().unwrap().success());
    let mut sim = Sim::start(&["--files", folder.to_str().unwrap()]);
    let names = sim.tcp(&["call", "ControllerGetFileNames", "controller", "8,"]);
    assert_eq!((names.out.as_str(), names.code), ("a.pcs\n", 0), "{names:?}");
    let read = |name: &str| sim.tcp(&["call", "FileGetValue", &format!("file:{name}")]);
    assert_eq!(read("a.pcs").out, "Sub Main\n");
    let fifo = read("fifo");
    assert!(fifo.code == 1 && fifo.err.contains("E_ACCESSDENIED"), "{fifo:?}");

    let copy = sim.tcp(&["call", "FileCopy", "file:fifo", "8,b.pcs", "8,"]);
    assert_eq!(copy.code, 1, "{copy:?}");
    assert_eq!(sim.rac(&["get", "I1"]).out, "I1 = 0\n");
    assert_eq!(sim.udp(&["get", "I1"]).out, "I1 = 0\n");
    sim.0.end(Signal::TERM);
}

#[cfg(unix)]
#[test]
fn a_fifo_is_no_model_arm_or_scenario() {
    let folder = tempfile::tempdir().unwrap();
    let fifo = folder.path().join("fifo.toml");
    assert!(Command::new("mkfifo").arg(&fifo).status().unwrap().success());
    let fifo = fifo.to_str().unwrap();
    for (option, more) in [("model", &[][..]), ("model", &["--print-model"]), ("arm", &[]), ("scenario", &[])] {
        let run = bcap(&[&["sim", &format!("--{option}"), fifo], more].concat());
        let error = format!("cannot read the {option} {fifo}: it is not a regular file");
        assert!(run.code == 2 && run.err.contains(&error), "{run:?}");
    }
}

#[test]
fn the_robot_type_can_be_set() {
    let type_of = |more: &[&str]| Sim::start(more).tcp(&["get", "robot/@TYPE_NAME", "@VERSION"]).out;
    assert_eq!(type_of(&[]), "robot/@TYPE_NAME = VS060A3\n@VERSION = 2.8.0\n");
    assert_eq!(type_of(&["--model", "cobotta"]), "robot/@TYPE_NAME = CVR038A1\n@VERSION = 2.8.0\n");
    assert_eq!(type_of(&["--robot-type", "HS035"]), "robot/@TYPE_NAME = HS035\n@VERSION = 2.8.0\n");
    let text = "[controller]\nrobot_type = 'VM060'\naxes = 7\narm_name = 'Left'\nversion = '1.2.3'\n";
    let path = scenario("robot.toml", text);
    assert_eq!(type_of(&["--scenario", &path]), "robot/@TYPE_NAME = VM060\n@VERSION = 1.2.3\n");
}

#[test]
fn an_invalid_scenario_is_reported() {
    let wrong = scenario("wrong.toml", "[[fault]]\nwhen = { cal = 1 }\nthen = 'drop'");
    let run = bcap(&["sim", "--scenario", &wrong]);
    assert!(run.code == 2 && run.err.contains("wrong.toml") && run.err.contains("unknown field `cal`"), "{run:?}");
    let run = bcap(&["sim", "--scenario", "no/such/file.toml"]);
    assert!(run.code == 2 && run.err.contains("cannot read the scenario no/such/file.toml"), "{run:?}");
}

#[cfg(unix)]
#[test]
fn signals_end_sim_with_0() {
    for signal in [Signal::INT, Signal::TERM] {
        let mut sim = Sim::start(&[]);
        // a connected client does not delay the exit
        let mut watch = command(&["watch", "I1", "--interval", "1", "--robot", &sim.0.tcp]);
        let mut watch = watch.stdout(Stdio::piped()).stderr(Stdio::null()).spawn().unwrap();
        watch.stdout.as_mut().unwrap().read_exact(&mut [0; 8]).unwrap();
        assert_eq!(sim.0.process.end(signal), "", "one line and no more");
        // the client's connection is closed
        drop(watch.stdout.take());
        watch.wait().unwrap();
    }
}

#[cfg(unix)]
#[test]
fn a_watch_ends_with_0_when_it_is_interrupted() {
    let sim = Sim::start(&[]);
    let mut watch =
        command(&["watch", "I1", "--interval", "1", "--robot", &sim.0.tcp]).stdout(Stdio::piped()).spawn().unwrap();
    let mut out = BufReader::new(watch.stdout.take().unwrap());
    out.read_line(&mut String::new()).unwrap();
    send(Signal::INT, &watch);
    out.read_to_string(&mut String::new()).unwrap();
    assert_eq!(watch.wait().unwrap().code(), Some(0));
}

#[test]
fn an_address_in_use_is_reported() {
    let taken = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = taken.local_addr().unwrap().to_string();
    let run = bcap(&["sim", "--bcap", &address, "--udp", "127.0.0.1:0", "--rac", "127.0.0.1:0"]);
    assert_eq!((run.out.as_str(), run.code), ("", 3));
    assert!(run.err.contains(&address) && run.err.contains("hint: ") && run.err.contains("--bcap"), "{}", run.err);
    assert_eq!(bcap(&["sim", "--bcap", "nonsense"]).code, 2);
}

#[test]
fn the_trajectory_is_recorded_as_csv() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("motion.csv");
    let sim = Sim::start(&["--record", file.to_str().unwrap()]);
    drop(sim);
    let text = fs::read_to_string(&file).unwrap();
    assert_eq!(text.lines().next(), Some("time_s,J1,J2,J3,J4,J5,J6,J7,J8,X,Y,Z,RX,RY,RZ,tool,work"), "{text}");
}

#[test]
fn a_file_that_cannot_be_recorded_is_named() {
    let run = bcap(&["sim", "--bcap", "127.0.0.1:0", "--record", "/no/such/folder/motion.csv"]);
    assert_ne!(run.code, 0);
    assert!(run.err.contains("--record /no/such/folder/motion.csv"), "{}", run.err);
}

#[test]
fn a_printed_model_is_changed_and_loaded() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("cell7.toml");
    let printed = bcap(&["sim", "--model", "rc9", "--print-model"]);
    assert_eq!(printed.code, 0);
    let changed = printed.out.replace("VS060A3", "VM060A1").replace("i = 100", "i = 7").replace("\"RC9\"", "\"CELL7\"");
    assert_ne!(changed, printed.out);
    fs::write(&file, &changed).unwrap();
    let sim = Sim::start(&["--model", file.to_str().unwrap()]);
    let get = |name: &str| sim.tcp(&["get", name, "--provider", "CaoProv.DENSO.VRC9"]).out;
    assert_eq!(get("robot/@TYPE_NAME"), "robot/@TYPE_NAME = VM060A1\n");
    assert_eq!(get("@TYPE"), "@TYPE = CELL7\n");
    assert_eq!(get("@VAR_I_LEN"), "@VAR_I_LEN = 7\n");
}

#[test]
fn a_controller_drives_another_arm() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("scara.toml");
    let printed = bcap(&["sim", "--arm", "hsr065", "--print-arm"]);
    assert_eq!(printed.code, 0);
    fs::write(&file, printed.out.replace("HSR065A1-N32-NNN-NNN A", "LONG").replace("a2 = 275.0", "a2 = 325.0"))
        .unwrap();
    for (arm, name, y) in [("hsr065", "HSR065A1-N32-NNN-NNN A", 275), (file.to_str().unwrap(), "LONG", 325)] {
        let sim = Sim::start(&["--model", "rc9", "--arm", arm]);
        let get = |name: &str| sim.tcp(&["get", name, "--provider", "CaoProv.DENSO.VRC9"]).out;
        assert_eq!(get("robot/@TYPE_NAME"), format!("robot/@TYPE_NAME = {name}\n"));
        // with J2 = 90, the second link points along y
        assert_eq!(get("robot/@CURRENT_POSITION"), format!("robot/@CURRENT_POSITION = 375,{y},0,0,0,90,0\n"));
    }
    let run = bcap(&["sim", "--arm", "vs999"]);
    assert!(run.err.contains("vs060, vs087, hsr065"), "{}", run.err);
    fs::write(&file, printed.out.replace("a1 = 375.0", "d6 = 375.0")).unwrap();
    let run = bcap(&["sim", "--arm", file.to_str().unwrap()]);
    assert!(run.err.contains("scara.toml is not a valid arm: line"), "{}", run.err);
}

#[test]
fn an_invalid_model_is_named_with_its_line() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("cell7.toml");
    let text = bcap_sim::Profile::Rc8.text().replace("speed = 405.0", "speed = -1.0");
    fs::write(&file, &text).unwrap();
    let line = text.lines().position(|line| line.contains("speed = -1.0")).unwrap() + 1;
    let run = bcap(&["sim", "--model", file.to_str().unwrap()]);
    assert_ne!(run.code, 0);
    let expected = format!("cell7.toml is not a valid model: line {line}: J3: the speed is -1; it is above 0");
    assert!(run.err.contains(&expected), "{}", run.err);
    let run = bcap(&["sim", "--model", "rc7"]);
    assert!(run.err.contains("rc8, rc8a, rc9, cobotta, cobotta-pro"), "{}", run.err);
}

#[test]
fn the_token_of_an_address_is_for_clients_of_that_address() {
    let take = ["exec", "robot", "TakeArm"];
    for (token, taken) in [("127.0.0.1", true), ("192.0.2.1", false)] {
        let sim = Sim::start(&["--token", token]);
        for run in [sim.tcp(&take), sim.udp(&take)] {
            assert_eq!(run.code == 0, taken, "{token}: {}", run.err);
            assert!(taken || run.err.contains("E_TOKEN_ADDRESS"), "{}", run.err);
        }
    }
    let run = bcap(&["sim", "--token", "cell7"]);
    assert!(run.err.contains("it is any, pendant, or an IP address"), "{}", run.err);
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("clients.pcapng");
    let run = bcap(&["sim", "--token", "192.0.2.1", "--bcap", "127.0.0.1:0", "--write", file.to_str().unwrap()]);
    assert!(run.code != 0 && run.err.contains("leave out --write"), "{}", run.err);
    // nor with the errors of a scenario
    let scenario = folder.path().join("scenario.toml");
    for text in
        ["[controller]\ntoken = '192.0.2.1'\n", "[[fault]]\nwhen = { at_ms = 1 }\nthen = { token = '192.0.2.1' }\n"]
    {
        std::fs::write(&scenario, text).unwrap();
        let [scenario, file] = [&scenario, &file].map(|path| path.to_str().unwrap());
        let run = bcap(&["sim", "--scenario", scenario, "--bcap", "127.0.0.1:0", "--write", file]);
        assert!(run.code == 2 && run.err.contains("the address of the token of the scenario"), "{text}: {}", run.err);
    }
}

#[test]
fn a_model_without_rac_serves_it_only_on_request() {
    let free = ["sim", "--bcap", "127.0.0.1:0", "--udp", "127.0.0.1:0", "--model", "rc9"];
    let ready = |more: &[&str]| Running::of(&mut command(&[&free[..], more].concat())).ready.clone();
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("clients.pcapng");
    let write = ["--write", file.to_str().unwrap()];
    for more in [&[][..], &write[..]] {
        assert!(!ready(more).contains(" rac="), "{more:?}");
        assert!(ready(&[&["--rac", "127.0.0.1:0"], more].concat()).contains(" rac=127.0.0.1:"), "{more:?}");
    }
}
