//! `bcap ls` and `bcap cp`.

use std::fs;
use std::io::Read;
use std::path::PathBuf;
use std::process::Stdio;
use std::time::Duration;

use crate::common::fake::{Fake, usual, value};
use crate::common::robot::Robot;
use crate::common::{Run, bcap, command};
use bcap_core::bcap::FunctionId;
use bcap_core::hresult::HResult;
use bcap_sim::{Config, Controller, Profile};
use bcap_std::server::Limits;
use bcap_tests::hooked::Hooked;
use bcap_tests::process::{Signal, send};
use bcap_tests::served::Served;

/// A robot with files, and a folder of this machine in which the command runs.
struct Cell {
    robot: Robot,
    folder: tempfile::TempDir,
    /// The robot's files.
    files: PathBuf,
}

impl Cell {
    fn start() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let files = folder.path().join("robot");
        fs::create_dir_all(files.join("Sub").join("Deep")).unwrap();
        for (name, text) in [("Pro1.pcs", "one"), ("Pro2.PCS", "two"), ("a.txt", "text"), ("Sub/Pro1.pcs", "below")] {
            fs::write(files.join(name), text).unwrap();
        }
        fs::write(files.join("Sub/Deep/bytes.dat"), [0xff, 0, 0xfe]).unwrap();
        let robot = Robot::with(Config { files: Some(files.clone()), ..Config::new(Profile::Rc8) });
        Self { robot, folder, files }
    }

    fn run(&self, args: &[&str]) -> Run {
        let args = [args, &["--robot", &self.robot.tcp]].concat();
        command(&args).current_dir(self.folder.path()).output().unwrap().into()
    }

    #[track_caller]
    fn done(&self, args: &[&str]) -> String {
        let run = self.run(args);
        assert_eq!((run.err.as_str(), run.code), ("", 0), "{args:?}");
        run.out
    }

    #[track_caller]
    fn refused(&self, args: &[&str], part: &str) {
        let run = self.run(args);
        assert!(run.code == 2 && run.err.contains(part) && run.out.is_empty(), "{args:?}: {run:?}");
    }

    fn read(&self, name: &str) -> Vec<u8> {
        fs::read(self.folder.path().join(name)).unwrap_or_else(|error| panic!("{name}: {error}"))
    }
}

#[test]
fn ls_lists_folders_files_and_wildcards() {
    let cell = Cell::start();
    assert_eq!(cell.done(&["ls"]), "/Pro1.pcs\n/Pro2.PCS\n/Sub/\n/a.txt\n");
    assert_eq!(cell.done(&["ls", "Sub"]), "/Sub/Deep/\n/Sub/Pro1.pcs\n");
    assert_eq!(cell.done(&["ls", "robot:/Sub/Deep/"]), "/Sub/Deep/bytes.dat\n");
    assert_eq!(cell.done(&["ls", "/*.pcs"]), "/Pro1.pcs\n/Pro2.PCS\n");
    assert_eq!(cell.done(&["ls", "*/P*"]), "/Sub/Pro1.pcs\n");
    assert_eq!(cell.done(&["ls", "S*"]), "/Sub/\n");
    assert_eq!(cell.done(&["ls", "--long", "/Pro?.pcs"]), "         3  /Pro1.pcs\n         3  /Pro2.PCS\n");
    assert_eq!(cell.done(&["ls", "--recursive"]), "/Pro1.pcs\n/Pro2.PCS\n/Sub/Deep/bytes.dat\n/Sub/Pro1.pcs\n/a.txt\n");
    let json = cell.done(&["ls", "--long", "--json", "Sub"]);
    assert_eq!(
        json,
        "{\"folder\":true,\"path\":\"/Sub/Deep\"}\n{\"folder\":false,\"path\":\"/Sub/Pro1.pcs\",\"size\":5}\n"
    );
    cell.refused(&["ls", "none"], "robot:/none: the controller has no such file or folder");
}

#[test]
fn cp_downloads_files_wildcards_and_folders() {
    let cell = Cell::start();
    assert_eq!(cell.done(&["cp", "robot:/Pro1.pcs", "copy.pcs"]), "robot:/Pro1.pcs -> copy.pcs\n");
    assert_eq!(cell.read("copy.pcs"), b"one");
    cell.done(&["cp", "robot:/*.pcs", "programs/"]);
    assert_eq!([cell.read("programs/Pro1.pcs"), cell.read("programs/Pro2.PCS")], [b"one", b"two"]);
    cell.done(&["cp", "--recursive", "robot:/", "all"]);
    assert_eq!(cell.read("all/Sub/Deep/bytes.dat"), [0xff, 0, 0xfe]);
    assert_eq!(cell.read("all/a.txt"), b"text");
    cell.done(&["cp", "--recursive", "robot:/Sub", "robot:/a.txt", "some/"]);
    assert_eq!([cell.read("some/Sub/Pro1.pcs"), cell.read("some/a.txt")], [&b"below"[..], b"text"]);
    cell.refused(&["cp", "robot:/Sub", "x"], "robot:/Sub is a folder; give --recursive");
    cell.refused(&["cp", "robot:/*.none", "x"], "the controller has no such file");
}

#[test]
fn cp_uploads_and_reads_back() {
    let cell = Cell::start();
    fs::write(cell.folder.path().join("new.pcs"), "Sub Main ' äöü\r\n").unwrap();
    fs::create_dir_all(cell.folder.path().join("tree/below")).unwrap();
    fs::write(cell.folder.path().join("tree/below/b.dat"), [0x80, 0]).unwrap();
    assert_eq!(cell.done(&["cp", "new.pcs", "robot:/"]), "new.pcs -> robot:/new.pcs\n");
    assert_eq!(fs::read(cell.files.join("new.pcs")).unwrap(), "Sub Main ' äöü\r\n".as_bytes());
    cell.done(&["cp", "new.pcs", "robot:/Sub"]);
    assert!(cell.files.join("Sub/new.pcs").is_file());
    cell.done(&["cp", "new.pcs", "robot:/Made/Below/other.pcs"]);
    assert!(cell.files.join("Made/Below/other.pcs").is_file());
    cell.done(&["cp", "--recursive", "tree", "robot:/copied"]);
    assert_eq!(fs::read(cell.files.join("copied/below/b.dat")).unwrap(), [0x80, 0]);
    cell.refused(&["cp", "tree", "robot:/"], "tree is a folder; give --recursive");
    cell.refused(&["cp", "absent.pcs", "robot:/"], "absent.pcs: No such file");
    cell.refused(&["cp", "new.pcs", "robot:/S*"], "DEST has no wildcards");
}

#[test]
fn a_signal_ends_a_copy_between_two_files() {
    let folder = tempfile::tempdir().unwrap();
    let files = folder.path().join("robot");
    fs::create_dir(&files).unwrap();
    for name in ["a.pcs", "b.pcs"] {
        fs::write(folder.path().join(name), "text").unwrap();
    }
    let controller = Controller::new(Config { files: Some(files.clone()), ..Config::new(Profile::Rc8) });
    let served = Served::of(Hooked::new(controller), Limits::default());
    // the call that makes the first file
    let stalled = served.application().stall(FunctionId::CONTROLLER_GET_FILE, 0);
    let address = format!("tcp:{}", served.tcp);
    let mut command = command(&["cp", "--force", "a.pcs", "b.pcs", "robot:/", "--robot", &address]);
    command.current_dir(folder.path()).stdout(Stdio::piped()).stderr(Stdio::piped());
    let mut child = command.spawn().unwrap();
    stalled.recv_timeout(Duration::from_secs(60)).unwrap();
    send(Signal::INT, &child);
    // the message says that the signal was handled
    let mut first = [0; 20];
    child.stderr.as_mut().unwrap().read_exact(&mut first).unwrap();
    assert_eq!(&first, b"ends after this call");
    served.application().set(|_| None);
    let run = Run::from(child.wait_with_output().unwrap());
    assert_eq!((run.out.as_str(), run.code), ("a.pcs -> robot:/a.pcs\n", 130), "{run:?}");
    assert!(run.err.contains("interrupted between two files"), "{run:?}");
    assert_eq!(fs::read_to_string(files.join("a.pcs")).unwrap(), "text");
    assert!(!files.join("b.pcs").exists());
}

#[test]
fn nothing_is_overwritten_without_force() {
    let cell = Cell::start();
    let kept = |name: &str| fs::write(cell.folder.path().join(name), "kept").unwrap();
    fs::create_dir(cell.folder.path().join("to")).unwrap();
    kept("to/Pro2.PCS");
    kept("Pro1.pcs");
    cell.refused(&["cp", "robot:/*.pcs", "to"], "exists; give --force to replace it. No file was copied");
    // all destinations are checked before the first copy
    assert!(!cell.folder.path().join("to/Pro1.pcs").exists());
    cell.refused(&["cp", "Pro1.pcs", "robot:/"], "Pro1.pcs exists; give --force");
    assert_eq!(fs::read(cell.files.join("Pro1.pcs")).unwrap(), b"one");
    cell.done(&["cp", "--force", "Pro1.pcs", "robot:/"]);
    assert_eq!(fs::read(cell.files.join("Pro1.pcs")).unwrap(), b"kept");
    cell.done(&["cp", "--force", "robot:/Pro2.PCS", "to"]);
    assert_eq!(cell.read("to/Pro2.PCS"), b"two");
    cell.refused(&["cp", "--force", "robot:/Pro1.pcs", "robot:/Sub/Pro1.pcs", "to"], "two files would have this name");
    for sides in [["a", "b"], ["robot:/a", "robot:/b"]] {
        cell.refused(&[&["cp"], &sides[..]].concat(), "write robot:/NAME");
    }
    assert_eq!(cell.run(&["cp", "robot:/a"]).code, 2);
}

#[test]
fn rm_deletes_files_and_nothing_else() {
    let cell = Cell::start();
    assert_eq!(
        cell.done(&["rm", "robot:/Pro*", "robot:/Pro1.pcs", "--json"]),
        "{\"deleted\":\"robot:/Pro1.pcs\"}\n{\"deleted\":\"robot:/Pro2.PCS\"}\n"
    );
    assert_eq!(cell.done(&["rm", "robot:/Sub/Pro1.pcs"]), "robot:/Sub/Pro1.pcs is deleted\n");
    for (path, message) in [
        ("a.txt", "a.txt: write robot:/NAME"),
        ("robot:/Sub", "/Sub/ is not deleted: write the names of files"),
        ("robot:/*", "/Sub/ is not deleted"),
        ("robot:/", "is not deleted"),
        ("robot:/absent", "robot:/absent: the controller has no such file"),
    ] {
        // the first path is right, and is kept as well
        cell.refused(&["rm", "--yes", "robot:/a.txt", path], message);
    }
    assert_eq!(cell.done(&["ls", "--recursive"]), "/Sub/Deep/bytes.dat\n/a.txt\n");
}

#[test]
fn rm_asks_about_a_real_controller_and_reports_only_what_is_gone() {
    let fake = |remains: bool| {
        let mut is_deleted = false;
        let files = std::sync::Mutex::new(move |request: &bcap_core::bcap::Frame<'_>| match request.function() {
            FunctionId::CONTROLLER_GET_FILE_NAMES => value(vec!["a.pcs".to_owned()]),
            FunctionId::CONTROLLER_GET_FILE if is_deleted && !remains => HResult::E_CAO_OBJECT_NOTFOUND.into(),
            FunctionId::CONTROLLER_GET_FILE => value(5),
            FunctionId::FILE_DELETE => {
                is_deleted = true;
                HResult::S_OK.into()
            }
            _ => usual(request),
        });
        Fake::tcp(move |request| files.lock().unwrap()(request))
    };
    let deletes = |fake: &Fake| fake.seen().iter().filter(|call| call.starts_with("FileDelete")).count();
    let asked = fake(false);
    let run = bcap(&["rm", "robot:/a.pcs", "--robot", &asked.address]);
    let question = format!("{} deletes 1 files: robot:/a.pcs: cannot ask for confirmation", asked.address);
    assert!(run.code == 2 && run.err.contains(&question), "{run:?}");
    assert_eq!(deletes(&asked), 0);
    let run = bcap(&["rm", "--yes", "robot:/a.pcs", "--robot", &asked.address]);
    assert_eq!((run.out.as_str(), run.code, deletes(&asked)), ("robot:/a.pcs is deleted\n", 0, 1), "{run:?}");
    let kept = fake(true);
    let run = bcap(&["rm", "--yes", "robot:/a.pcs", "--robot", &kept.address]);
    assert!(run.code == 1 && run.out.is_empty() && run.err.contains("still has the file"), "{run:?}");
}

#[test]
fn a_file_is_copied_over_udp_although_the_list_of_names_does_not_fit() {
    let cell = Cell::start();
    for number in 0..40 {
        fs::write(cell.files.join(format!("a program with a long name {number}.pcs")), "x").unwrap();
    }
    let run = |args: &[&str]| -> Run {
        let args = [args, &["--robot", &cell.robot.udp]].concat();
        command(&args).current_dir(cell.folder.path()).output().unwrap().into()
    };
    let copied = run(&["cp", "--json", "robot:/Pro1.pcs", "over-udp.pcs"]);
    assert_eq!(
        (copied.out.as_str(), copied.code),
        ("{\"from\":\"robot:/Pro1.pcs\",\"to\":\"over-udp.pcs\"}\n", 0),
        "{copied:?}"
    );
    assert_eq!(cell.read("over-udp.pcs"), b"one");
    let copied = run(&["cp", "over-udp.pcs", "robot:/Sub/other.pcs"]);
    assert_eq!((copied.err.as_str(), copied.code), ("", 0));
    let listed = run(&["ls"]);
    assert!(listed.code == 1 && listed.err.contains("E_TOO_MUCH_DATA"), "{listed:?}");
}

#[test]
fn a_name_that_leaves_the_folder_is_refused() {
    for name in ["..\\x.pcs", "../x.pcs", "..", "/x.pcs", "C:x.pcs", ""] {
        let fake = Fake::tcp(move |request| match request.function() {
            FunctionId::CONTROLLER_GET_FILE_NAMES => value(vec![name.to_owned()]),
            FunctionId::CONTROLLER_GET_FILE => value(5),
            FunctionId::FILE_GET_VALUE => value("x".to_owned()),
            _ => usual(request),
        });
        let folder = tempfile::tempdir().unwrap();
        let inner = folder.path().join("a").join("b");
        let run = bcap(&["cp", "--recursive", "robot:/", inner.to_str().unwrap(), "--robot", &fake.address]);
        assert!(run.code == 3 && run.err.contains("unsafe name"), "{name}: {run:?}");
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0, "{name}");
    }
}

#[test]
fn one_unsafe_name_hides_no_other_file() {
    let fake = Fake::tcp(|request| match request.function() {
        FunctionId::CONTROLLER_GET_FILE_NAMES => {
            value(["b\n.pcs", "a.pcs", "..\\", "c.txt"].map(str::to_owned).to_vec())
        }
        FunctionId::CONTROLLER_GET_FILE => value(5),
        FunctionId::FILE_GET_VALUE => value("x".to_owned()),
        FunctionId::FILE_GET_SIZE => value(1),
        _ => usual(request),
    });
    let run = |args: &[&str]| bcap(&[args, &["--robot", &fake.address]].concat());
    for args in [&["ls"][..], &["ls", "--recursive"], &["ls", "/*"]] {
        let listed = run(args);
        assert_eq!((listed.err.as_str(), listed.code), ("", 0), "{args:?}");
        assert_eq!(listed.out, "\"/../\"\n/a.pcs\n\"/b\\n.pcs\"\n/c.txt\n", "{args:?}");
    }
    let listed = run(&["ls", "--long", "--json", "/*.pcs"]);
    let expected = "{\"folder\":false,\"path\":\"/a.pcs\",\"size\":1}\n\
                    {\"folder\":false,\"path\":\"/b\\n.pcs\",\"unsafe\":true}\n";
    assert_eq!((listed.out.as_str(), listed.code), (expected, 0), "{listed:?}");
    for (args, names) in [
        (&["cp", "robot:/*"][..], r#""/../", "/b\n.pcs""#),
        (&["cp", "robot:/*.pcs"], r#""/b\n.pcs""#),
        (&["cp", "--recursive", "robot:/"], r#""/../", "/b\n.pcs""#),
    ] {
        let folder = tempfile::tempdir().unwrap();
        let to = format!("{}/", folder.path().display());
        let copied = run(&[args, &[&to]].concat());
        let message = format!("unsafe names, which were not copied: {names}\n");
        assert!(copied.code == 3 && copied.err.contains(&message), "{args:?}: {copied:?}");
        assert_eq!(fs::read(folder.path().join("a.pcs")).unwrap(), b"x", "{args:?}");
    }
}

#[test]
fn folders_without_end_are_an_error() {
    let fake = Fake::tcp(|request| match request.function() {
        FunctionId::CONTROLLER_GET_FILE_NAMES | FunctionId::FILE_GET_FILE_NAMES => value(vec!["again\\".to_owned()]),
        FunctionId::CONTROLLER_GET_FILE => value(5),
        _ => usual(request),
    });
    let run = bcap(&["ls", "--recursive", "--robot", &fake.address]);
    assert!(run.code == 3 && run.err.contains("more than 32 folders in one another"), "{run:?}");
}
