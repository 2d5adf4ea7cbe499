//! `bcap dump`, `bcap diff` and `bcap restore`.

use std::fs;
#[cfg(unix)]
use std::io::Read;
use std::path::{Path, PathBuf};
use std::process::Stdio;
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::mpsc::Receiver;
use std::time::{Duration, Instant};

use crate::common::fake::{Fake, usual, value};
use crate::common::robot::Robot;
use crate::common::{Run, bcap, command};
use bcap_core::bcap::FunctionId;
use bcap_core::hresult::HResult;
use bcap_core::rac::VariableKind as Kind;
use bcap_core::variant::Variant;
use bcap_sim::{Config, Controller, Permission, Profile, Sizes};
use bcap_std::server::Limits;
use bcap_tests::hooked::Hooked;
use bcap_tests::process::{Signal, send};
use bcap_tests::served::Served;

/// A robot with files, and a folder for backups.
struct Cell {
    robot: Robot,
    folder: tempfile::TempDir,
    files: PathBuf,
}

impl Cell {
    fn start() -> Self {
        Self::with(Config::new(Profile::Rc8))
    }

    fn with(config: Config) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let files = folder.path().join("robot");
        fs::create_dir_all(files.join("Sub")).unwrap();
        fs::write(files.join("Pro1.pcs"), "Sub Main\r\n  I1 = 5 ' äöü\r\nEnd Sub\r\n").unwrap();
        fs::write(files.join("Sub").join("bytes.dat"), [0xff, 0, 1, 0x80]).unwrap();
        fs::write(files.join("empty.txt"), "").unwrap();
        let robot = Robot::with(Config { files: Some(files.clone()), ..config });
        Self { robot, folder, files }
    }

    fn path(&self, name: &str) -> String {
        self.folder.path().join(name).to_str().unwrap().to_owned()
    }

    #[track_caller]
    fn dump(&self, name: &str) -> String {
        let path = self.path(name);
        let run = self.robot.run(&["dump", &path]);
        assert_eq!((run.code, run.err.as_str()), (0, ""), "{run:?}");
        path
    }
}

/// Returns the files of a folder with their contents, without the parts that change with the time.
fn tree(path: &str) -> Vec<(PathBuf, Vec<u8>)> {
    let mut files = Vec::new();
    let mut folders = vec![PathBuf::from(path)];
    let replaced = Path::new(path).join("replaced");
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(&folder).unwrap().map(Result::unwrap) {
            if entry.path() == replaced {
                continue;
            }
            if entry.file_type().unwrap().is_dir() {
                folders.push(entry.path());
            } else {
                let below = entry.path().strip_prefix(path).unwrap().to_owned();
                files.push((below, fs::read(entry.path()).unwrap()));
            }
        }
    }
    let varies = |path: &Path| ["backup.json", "system.jsonl", "restore.jsonl"].iter().any(|name| path.ends_with(name));
    files.retain(|(path, _)| !varies(path));
    files.sort();
    files
}

fn lines(run: &Run) -> Vec<&str> {
    run.out.lines().collect()
}

#[test]
fn a_dump_is_text_that_other_tools_compare() {
    let cell = Cell::start();
    cell.robot.run(&["put", "I5=-7", "P2=1,2,3,4,5,6,7", "S1=a \"b\"", "IO200=true"]);
    let dir = cell.dump("a");
    let line = |file: &str, number: usize| {
        let text = fs::read_to_string(Path::new(&dir).join(file)).unwrap();
        text.lines().nth(number).unwrap().to_owned()
    };
    assert_eq!(line("variables/I.jsonl", 5), r#"{"name":"I5","vt":3,"v":-7}"#);
    assert_eq!(line("variables/P.jsonl", 2), r#"{"name":"P2","vt":8196,"v":[1.0,2.0,3.0,4.0,5.0,6.0,7.0]}"#);
    assert_eq!(line("variables/S.jsonl", 1), r#"{"name":"S1","vt":8,"v":"a \"b\""}"#);
    assert_eq!(line("variables/IO.jsonl", 200), r#"{"name":"IO200","vt":11,"v":-1}"#);
    let system = fs::read_to_string(Path::new(&dir).join("system.jsonl")).unwrap();
    for name in ["@MODE\",\"vt\":3,\"v\":3", "robot:Arm0/@SERVO_ON\",\"vt\":11", "task:Pro1/@STATUS\",\"vt\":3"] {
        assert!(system.contains(name), "{name}: {system}");
    }
    assert!(!system.contains("I*"));
    for file in ["Pro1.pcs", "Sub/bytes.dat", "empty.txt"] {
        assert_eq!(
            fs::read(Path::new(&dir).join("files").join(file)).unwrap(),
            fs::read(cell.files.join(file)).unwrap()
        );
    }
    let manifest: serde_json::Value =
        serde_json::from_str(&fs::read_to_string(Path::new(&dir).join("backup.json")).unwrap()).unwrap();
    assert_eq!((&manifest["complete"], &manifest["files"]), (&true.into(), &3.into()));
    assert_eq!((&manifest["controller"]["type"], &manifest["variables"]["IO"]), (&"RC8".into(), &512.into()));
    assert!(!tree(&dir).iter().any(|(path, _)| path.extension().is_some_and(|end| end == "part")));
    // its contents are not replaced
    let run = cell.robot.run(&["dump", &dir]);
    assert!(run.code == 2 && run.err.contains("the folder has a complete backup; choose another folder"), "{run:?}");
    let run = cell.robot.run(&["dump", cell.files.to_str().unwrap()]);
    assert!(run.code == 2 && run.err.contains("is not empty and has no backup"), "{run:?}");
}

#[test]
fn dump_change_100_values_diff_restore_dump_is_identical() {
    let cell = Cell::start();
    for (index, number) in (0..100).zip(1..) {
        cell.robot.set(Kind::I, index, &Variant::I4(number));
        cell.robot.set(Kind::D, index, &Variant::R8(f64::from(number) / 3.0));
    }
    let before = cell.dump("before");
    for index in 0..40 {
        cell.robot.set(Kind::I, index, &Variant::I4(-1));
        cell.robot.set(Kind::D, index + 1, &Variant::R8(f64::NAN));
    }
    for index in 100..118 {
        cell.robot.set(Kind::Io, index, &Variant::Bool(true));
    }
    cell.robot.run(&["put", "S7=changed", "P3=1,2,3,4,5,6,7"]);
    fs::write(cell.files.join("Pro1.pcs"), "changed").unwrap();
    fs::remove_dir_all(cell.files.join("Sub")).unwrap();
    fs::write(cell.files.join("new.pcs"), "new").unwrap();
    let run = cell.robot.run(&["diff", &before]);
    assert_eq!((run.code, run.err.as_str(), lines(&run).len()), (1, "", 103), "{run:?}");
    assert!(run.out.starts_with("I0: 1 -> -1\nI1: 2 -> -1\n"), "{}", run.out);
    assert!(run.out.contains("\nS7:  -> changed\n") && run.out.contains("\nIO100: false -> true\n"), "{}", run.out);
    assert!(
        run.out.ends_with("file:Sub/bytes.dat: only in the first\nfile:new.pcs: only in the second\n"),
        "{}",
        run.out
    );
    let after = cell.dump("after");
    assert_eq!(bcap(&["diff", &before, &after]).out, run.out);
    let json = bcap(&["diff", "--json", &before, &after]).out;
    assert!(json.starts_with("{\"name\":\"I0\",\"a\":{\"vt\":3,\"v\":1},\"b\":{\"vt\":3,\"v\":-1}}\n"), "{json}");

    let run = cell.robot.run(&["restore", "--yes", "--io", &before]);
    assert_eq!(run.code, 0, "{run:?}");
    assert!(run.out.contains("... and 82 more, which --dry-run shows\n"), "{}", run.out);
    assert!(run.out.contains("note: file:new.pcs is not in the backup and stays\n"), "{}", run.out);
    assert!(run.out.ends_with("is complete; 102 of 102 are written\n"), "{}", run.out);
    fs::remove_file(cell.files.join("new.pcs")).unwrap();
    let again = cell.dump("again");
    assert_eq!(tree(&again), tree(&before));
    let run = bcap(&["diff", &before, &again]);
    assert_eq!((run.out.as_str(), run.code), ("", 0));
    let run = cell.robot.run(&["restore", "--yes", "--io", &before]);
    assert!(run.code == 0 && run.out.contains("there is nothing to write"), "{run:?}");
}

#[test]
fn the_plan_is_shown_and_io_needs_an_option() {
    // any serial number other than the virtual controller's belongs to a real controller
    let cell = Cell::with(Config { serial_number: "1234567".into(), ..Config::new(Profile::Rc8) });
    let dir = cell.dump("a");
    cell.robot.run(&["put", "I5=7", "IO200=true"]);
    let shown = "I5: 7 -> 0\nnote: 1 IO differ; they switch outputs and are written only with --io\n";
    let run = cell.robot.run(&["restore", "--dry-run", &dir]);
    assert_eq!((run.out.as_str(), run.code), (shown, 0), "{run:?}");
    // without a terminal there is no question, and nothing is written
    let run = cell.robot.run(&["restore", &dir]);
    assert_eq!((run.out.as_str(), run.code), (shown, 2), "{run:?}");
    assert!(run.err.contains("give --yes"), "{run:?}");
    assert_eq!((cell.robot.i(5), Path::new(&dir).join("restore.jsonl").exists()), (7, false));
    let run = cell.robot.run(&["restore", "--yes", &dir]);
    assert_eq!((run.code, cell.robot.i(5)), (0, 0), "{run:?}");
    // a virtual controller needs no confirmation
    let virtual_cell = Cell::start();
    let dir_of_virtual = virtual_cell.dump("a");
    virtual_cell.robot.run(&["put", "I5=7"]);
    let run = virtual_cell.robot.run(&["restore", &dir_of_virtual]);
    assert_eq!((run.code, virtual_cell.robot.i(5)), (0, 0), "{run:?}");
    let run = cell.robot.run(&["diff", &dir]);
    assert_eq!((run.out.as_str(), run.code), ("IO200: false -> true\n", 1));
}

#[test]
fn nothing_is_written_in_an_unclear_state() {
    let cell = Cell::start();
    let dir = cell.dump("a");
    cell.robot.run(&["put", "I5=7"]);
    let refused = |part: &str, robot: &Robot| {
        let run = robot.run(&["restore", "--yes", &dir]);
        assert!(run.code == 1 && run.err.contains(part) && run.err.contains("Nothing was written"), "{part}: {run:?}");
        assert!(!Path::new(&dir).join("restore.jsonl").exists());
    };
    let now = bcap_std::now();
    cell.robot.served.application().emergency_stop(true, now);
    refused("the emergency stop is pressed: release it first (@EMERGENCY_STOP is true)", &cell.robot);
    cell.robot.served.application().emergency_stop(false, now);
    cell.robot.served.application().inject_error(HResult::E_MOTOR_OFF, now);
    refused("the controller has an error: clear it first (@NORMAL_STATUS is false)", &cell.robot);
    cell.robot.run(&["exec", "controller", "ClearError"]);
    cell.robot.run(&["call", "TaskStart", "task:Pro1", "2"]);
    refused("the controller is busy: stop its tasks", &cell.robot);
    cell.robot.run(&["call", "TaskStop", "task:Pro1", "4"]);
    assert_eq!(cell.robot.i(5), 7);

    let other = Robot::with(Config { serial_number: "OTHER".into(), ..Config::new(Profile::Rc8) });
    refused(
        "the backup is of RC8 with serial number VIRTUAL, version 2.8.0, and this is RC8 with serial number OTHER",
        &other,
    );
    let sizes = Sizes { i: 50, ..Sizes::default() };
    let small = Robot::with(Config { sizes, ..Config::new(Profile::Rc8) });
    refused("50 variables of the backup do not fit the controller: I50 (does not exist)", &small);
    // a state that cannot be read is not clear
    let mute = Fake::tcp(|request| match request.function() {
        FunctionId::VARIABLE_GET_VALUE => HResult::E_ACCESSDENIED.into(),
        _ => usual(request),
    });
    let run = bcap(&["restore", "--yes", &dir, "--robot", &mute.address]);
    assert!(run.code == 1 && run.err.contains("the state of the controller is not known"), "{run:?}");
    assert!(!mute.seen().iter().any(|call| call.starts_with("VariablePutValue")));
}

#[test]
fn a_restore_stops_at_the_first_refusal() {
    let cell = Cell::start();
    let dir = cell.dump("a");
    cell.robot.run(&["put", "I5=7", "I6=7"]);
    cell.robot.served.application().set_permission(Permission::ReadOnly);
    let run = cell.robot.run(&["restore", "--yes", &dir]);
    assert_eq!(run.code, 1, "{run:?}");
    assert!(run.err.contains("E_CAO_NOT_WRITABLE"), "{run:?}");
    assert!(run.out.contains("0 of 2 are written, I5 may be written, 1 are not written"), "{run:?}");
    cell.robot.served.application().set_permission(Permission::ReadWrite);
    let run = cell.robot.run(&["restore", "--yes", &dir]);
    assert!(run.code == 0 && run.out.ends_with("is complete; 2 of 2 are written\n"), "{run:?}");
}

/// Runs the command until the controller stalls, then kills it.
#[track_caller]
fn kill_when_stalled(args: &[&str], stalled: &Receiver<()>) {
    let mut child = command(args).stdin(Stdio::null()).stdout(Stdio::null()).spawn().unwrap();
    stalled.recv_timeout(Duration::from_secs(60)).unwrap();
    child.kill().unwrap();
    child.wait().unwrap();
}

/// A controller that answers `left` calls of a function.
fn stalling(controller: Controller, function: FunctionId, left: u32) -> (Served<Hooked<Controller>>, Receiver<()>) {
    let mut hooked = Hooked::new(controller);
    let stalled = hooked.stall(function, left);
    (Served::of(hooked, Limits::default()), stalled)
}

#[test]
fn a_killed_restore_says_what_was_written() {
    let cell = Cell::start();
    for index in 0..100 {
        cell.robot.set(Kind::I, index, &Variant::I4(1000));
    }
    let dir = cell.dump("a");
    let (served, stalled) = stalling(Controller::new(Config::new(Profile::Rc8)), FunctionId::VARIABLE_PUT_VALUE, 30);
    let address = format!("tcp:{}", served.tcp);
    kill_when_stalled(&["restore", "--yes", &dir, "--robot", &address], &stalled);

    let run = bcap(&["restore", "--status", &dir]);
    assert_eq!((run.code, lines(&run).len()), (1, 103), "{run:?}");
    assert_eq!(lines(&run)[29..32], ["I29: written", "I30: may be written", "I31: not written"]);
    let summary = "was interrupted or is running; 30 of 103 are written, I30 may be written, 72 are not written";
    assert!(run.err.contains(summary), "{run:?}");
    let values = |served: &Served<Hooked<Controller>>| {
        let controller = &served.application().inner;
        let value = |index| controller.variable::<16>(Kind::I, index).unwrap().as_variant().as_i32().unwrap();
        (0..100).map(value).collect::<Vec<_>>()
    };
    assert_eq!(values(&served), [vec![1000; 30], vec![0; 70]].concat());

    served.application().set(|_| None);
    // this controller has no files, so that the variables are restored and the first file is refused
    let run = bcap(&["restore", "--yes", &dir, "--robot", &address]);
    assert!(run.out.contains(summary) && run.code == 1, "{run:?}");
    assert!(run.err.contains("file:") || run.err.contains("/Pro1.pcs"), "{run:?}");
    assert!(run.out.contains("70 of 73 are written"), "{run:?}");
    assert_eq!(values(&served), vec![1000; 100]);
}

#[test]
fn a_killed_dump_goes_on_where_it_was() {
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path().join("a").to_str().unwrap().to_owned();
    let mut controller =
        Controller::new(Config { sizes: Sizes { i: 1000, ..Sizes::default() }, ..Config::new(Profile::Rc8) });
    for (index, number) in (0..1000).zip(0..) {
        controller.set_variable(Kind::I, index, &Variant::I4(number * 7)).unwrap();
    }
    let (served, stalled) = stalling(controller, FunctionId::VARIABLE_PUT_ID, 620);
    let address = format!("tcp:{}", served.tcp);
    kill_when_stalled(&["dump", &dir, "--robot", &address], &stalled);
    let part = Path::new(&dir).join("variables/I.jsonl.part");
    assert_eq!(fs::read_to_string(&part).unwrap().lines().count(), 600);
    let run = bcap(&["diff", &dir, &dir]);
    assert!(run.code == 2 && run.err.contains("the dump was interrupted"), "{run:?}");
    let other = Robot::with(Config { serial_number: "OTHER".into(), ..Config::new(Profile::Rc8) });
    let run = other.run(&["dump", &dir]);
    assert!(run.code == 2 && run.err.contains("interrupted dump of another controller"), "{run:?}");

    // a temporary file is not part of the backup
    fs::write(Path::new(&dir).join(".bcap-Xy12"), "half").unwrap();
    // a line that was cut off is read again
    fs::write(&part, fs::read_to_string(&part).unwrap().trim_end()).unwrap();
    let count = Arc::new(AtomicU32::new(0));
    let counted = Arc::clone(&count);
    served.application().set(move |request| {
        counted.fetch_add(u32::from(request.function == FunctionId::VARIABLE_PUT_ID), Ordering::Relaxed);
        None
    });
    let run = bcap(&["dump", &dir, "--robot", &address]);
    assert!(run.code == 0 && run.out.contains("the interrupted dump goes on"), "{run:?}");
    // two samples of I differ; all values of the other kinds are equal, so that only samples are read with PutID
    let all = 1000 - 599 + 2 + 7 * 16 + 17;
    assert_eq!(count.load(Ordering::Relaxed), all);
    assert!(!Path::new(&dir).join(".bcap-Xy12").exists());
    let text = fs::read_to_string(Path::new(&dir).join("variables/I.jsonl")).unwrap();
    let expected: String = (0..1000).map(|n| format!("{{\"name\":\"I{n}\",\"vt\":3,\"v\":{}}}\n", n * 7)).collect();
    assert!(text == expected);
}

#[test]
fn a_write_without_a_reply_may_have_been_made() {
    // few variables, so that the plan takes no time
    let sizes = Sizes { i: 10, f: 1, d: 1, v: 1, p: 1, j: 1, t: 1, s: 1, io: 32 };
    let config = || Config { sizes, ..Config::new(Profile::Rc8) };
    let cell = Cell::with(config());
    let dir = cell.dump("a");
    let mut controller = Controller::new(config());
    for index in 0..3 {
        controller.set_variable(Kind::I, index, &Variant::I4(7)).unwrap();
    }
    let (served, _stalled) = stalling(controller, FunctionId::VARIABLE_PUT_VALUE, 1);
    let address = format!("tcp:{}", served.tcp);
    // the backup has files that this controller does not have, so they are part of the plan
    let run = bcap(&["restore", "--yes", &dir, "--timeout", "8000", "--robot", &address]);
    assert_eq!(run.code, 4, "{run:?}");
    assert!(run.out.contains("1 of 6 are written, I1 may be written, 4 are not written"), "{run:?}");
}

#[test]
#[cfg(unix)]
fn a_signal_ends_a_dump_after_the_call_and_a_second_one_at_once() {
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path().join("a").to_str().unwrap().to_owned();
    let controller = Controller::new(Config::new(Profile::Rc8));
    let (served, stalled) = stalling(controller, FunctionId::VARIABLE_PUT_ID, 50);
    let address = format!("tcp:{}", served.tcp);
    let start = || {
        let child = command(&["dump", &dir, "--robot", &address]).stderr(Stdio::piped()).spawn().unwrap();
        stalled.recv_timeout(Duration::from_secs(60)).unwrap();
        child
    };
    let mut child = start();
    send(Signal::INT, &child);
    // the message says that the first signal was handled
    let mut first = [0; 20];
    child.stderr.as_mut().unwrap().read_exact(&mut first).unwrap();
    assert_eq!(&first, b"ends after this call");
    send(Signal::INT, &child);
    assert_eq!(child.wait().unwrap().code(), Some(130));

    let mut child = start();
    send(Signal::INT, &child);
    child.stderr.as_mut().unwrap().read_exact(&mut first).unwrap();
    served.application().set(|_| None);
    let run = Run::from(child.wait_with_output().unwrap());
    assert!(run.code == 130 && run.err.contains("interrupted; run `bcap dump"), "{run:?}");
    assert_eq!(bcap(&["dump", &dir, "--robot", &address]).code, 0);
}

#[test]
fn all_output_can_be_json() {
    let cell = Cell::start();
    let dir = cell.path("a");
    let parsed = |run: Run| -> Vec<serde_json::Value> {
        run.out
            .lines()
            .map(|line| serde_json::from_str(line).unwrap_or_else(|error| panic!("{line}: {error}")))
            .collect()
    };
    let dump = parsed(cell.robot.run(&["dump", "--json", &dir]));
    assert_eq!((&dump[0]["variables"], &dump[0]["controller"]["type"]), (&1312.into(), &"RC8".into()));
    cell.robot.run(&["put", "I5=7"]);
    fs::remove_file(cell.files.join("Pro1.pcs")).unwrap();
    let plan = parsed(cell.robot.run(&["restore", "--dry-run", "--json", &dir]));
    assert_eq!(plan[0].to_string(), r#"{"name":"I5","value":{"v":0,"vt":3},"was":{"v":7,"vt":3}}"#);
    assert_eq!((&plan[1]["name"], &plan[1]["was"]), (&"file:Pro1.pcs".into(), &serde_json::Value::Null));
    let restore = parsed(cell.robot.run(&["restore", "--yes", "--json", &dir]));
    assert_eq!((&restore[2]["end"], &restore[2]["written"]), (&"complete".into(), &2.into()));
    let status = parsed(bcap(&["restore", "--status", "--json", &dir]));
    assert_eq!(status[0].to_string(), r#"{"name":"I5","state":"written"}"#);
    let same = parsed(cell.robot.run(&["restore", "--yes", "--json", &dir]));
    assert!(same[0]["note"].as_str().unwrap().starts_with("there is nothing to write"), "{same:?}");
}

#[test]
fn ten_thousand_variables_are_complete_over_both_links() {
    let sizes = Sizes { i: 2000, f: 1000, d: 1000, v: 1000, p: 1000, j: 1000, t: 1000, s: 1000, io: 1000 };
    let cell = Cell::with(Config { sizes, ..Config::new(Profile::Rc8) });
    for index in 0..1000_u16 {
        let number = f32::from(index) / 7.0;
        cell.robot.set(Kind::I, index.into(), &Variant::I4(i32::from(index) - 500));
        cell.robot.set(Kind::F, index.into(), &Variant::R4(number));
        cell.robot.set(Kind::D, index.into(), &Variant::R8(f64::from(number)));
        cell.robot.set(Kind::Io, index.into(), &Variant::Bool(index % 3 == 0));
    }
    let mut dumps = Vec::new();
    for (name, address) in [("tcp", &cell.robot.tcp), ("udp", &cell.robot.udp)] {
        let (dir, began) = (cell.path(name), Instant::now());
        // a time limit for each answer, not for the whole dump, which takes long on a busy machine
        let run = bcap(&["dump", &dir, "--attempt-timeout", "6s", "--robot", address]);
        println!("10,000 variables over {name}: {} ms", began.elapsed().as_millis());
        assert_eq!(run.code, 0, "{run:?}");
        assert!(run.out.contains(": 10000 variables, 77 system variables and 3 files"), "{run:?}");
        dumps.push(tree(&dir));
    }
    assert!(dumps[0] == dumps[1]);
    let text = fs::read_to_string(Path::new(&cell.path("udp")).join("variables/F.jsonl")).unwrap();
    for (line, index) in text.lines().zip(0_u16..) {
        let line: serde_json::Value = serde_json::from_str(line).unwrap();
        assert_eq!(line["v"].as_f64().unwrap() as f32, f32::from(index) / 7.0);
    }
}

#[test]
fn a_controller_without_put_id_is_read_by_name() {
    // PutID is accepted and ignored: every variable of `I*` has the value of the first
    let fake = Fake::tcp(|request| {
        let text = |n: usize| request.args.get(n).and_then(|name| name.as_bstr()).map(|name| name.to_string());
        let handle = request.args.get(0).and_then(|handle| handle.as_i32()).unwrap_or_default();
        match request.function() {
            FunctionId::CONTROLLER_GET_VARIABLE => match text(1).unwrap().as_str() {
                "@VAR_I_LEN" => value(50),
                "I*" => value(100),
                name => match name.strip_prefix('I').and_then(|index| index.parse::<i32>().ok()) {
                    Some(index) => value(100 + index),
                    None => HResult::E_CAO_OBJECT_NOTFOUND.into(),
                },
            },
            FunctionId::VARIABLE_GET_VALUE if handle == 50 => value(20),
            FunctionId::VARIABLE_GET_VALUE => value((handle - 100) * 11),
            FunctionId::CONTROLLER_GET_FILE_NAMES | FunctionId::CONTROLLER_GET_VARIABLE_NAMES => {
                HResult::E_NOTIMPL.into()
            }
            _ => usual(request),
        }
    });
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path().join("a").to_str().unwrap().to_owned();
    let run = bcap(&["dump", &dir, "--robot", &fake.address]);
    // the other kinds are refused, as the exit code shows
    assert!(run.code == 1 && run.err.contains("the controller refused 8 parts"), "{run:?}");
    let text = fs::read_to_string(Path::new(&dir).join("variables/I.jsonl")).unwrap();
    let expected: String = (0..20).map(|n| format!("{{\"name\":\"I{n}\",\"vt\":3,\"v\":{}}}\n", n * 11)).collect();
    assert_eq!(text, expected);
}

#[test]
fn a_file_that_cannot_be_read_is_named() {
    let fake = Fake::tcp(|request| match request.function() {
        FunctionId::CONTROLLER_GET_FILE_NAMES => value(vec!["Pro1.pcs".to_owned()]),
        FunctionId::CONTROLLER_GET_FILE => value(5),
        FunctionId::FILE_GET_VALUE => HResult::E_NOTIMPL.into(),
        FunctionId::VARIABLE_GET_VALUE => value(0),
        FunctionId::CONTROLLER_GET_VARIABLE_NAMES => HResult::E_NOTIMPL.into(),
        _ => usual(request),
    });
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path().join("a").to_str().unwrap().to_owned();
    let run = bcap(&["dump", &dir, "--robot", &fake.address]);
    assert!(run.code == 1 && run.err.contains("/Pro1.pcs: File_GetValue: 0x80004001"), "{run:?}");
    let manifest = fs::read_to_string(Path::new(&dir).join("backup.json")).unwrap();
    assert!(manifest.contains("/Pro1.pcs: File_GetValue: 0x80004001 (E_NOTIMPL)"), "{manifest}");
}

#[test]
fn a_damaged_backup_is_refused() {
    let cell = Cell::start();
    let dir = cell.dump("a");
    let file = Path::new(&dir).join("variables/I.jsonl");
    let text = fs::read_to_string(&file).unwrap();
    let damaged = |text: &str, part: &str| {
        fs::write(&file, text).unwrap();
        let run = cell.robot.run(&["restore", "--yes", &dir]);
        assert!(run.code == 2 && run.err.contains(part), "{part}: {run:?}");
    };
    damaged(&text[..text.len() / 2], "line 51: ");
    damaged(&text.lines().take(50).map(|line| format!("{line}\n")).collect::<String>(), "the backup is damaged");
    damaged(&text.replace("\"I7\"", "\"I8\""), "I8 follows where I7 is expected");
    damaged(&text.replace("\"I7\",\"vt\":3,\"v\":0", "\"I7\",\"vt\":3,\"v\":x"), "I.jsonl, line 8: ");
    fs::write(&file, text).unwrap();
    let manifest = Path::new(&dir).join("backup.json");
    let newer = fs::read_to_string(&manifest).unwrap().replace("\"format\": 1", "\"format\": 2");
    fs::write(manifest, newer).unwrap();
    let run = bcap(&["diff", &dir, &dir]);
    assert!(run.code == 2 && run.err.contains("this is format 2"), "{run:?}");
    let run = bcap(&["diff", "/no/such/backup", &dir]);
    assert!(run.code == 2 && run.err.contains("backup.json is missing"), "{run:?}");
}
