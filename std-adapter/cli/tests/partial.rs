//! `bcap dump`, `bcap diff` and `bcap restore` with controllers that refuse a part, or change during the command.

use std::fs;
use std::path::PathBuf;

use crate::common::fake::{Fake, usual, value};
use crate::common::{Run, bcap};
use bcap_core::bcap::FunctionId;
use bcap_core::bcap::server::Request;
use bcap_core::hresult::HResult;
use bcap_core::rac::VariableKind as Kind;
use bcap_core::variant::Variant;
use bcap_sim::{Config, Controller, Profile, Sizes};
use bcap_std::server::Limits;
use bcap_tests::hooked::Hooked;
use bcap_tests::served::Served;

/// A controller with few variables and three files, and a folder for backups.
struct Cell {
    served: Served<Hooked<Controller>>,
    address: String,
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
        for (name, text) in [("Pro1.pcs", "one"), ("Pro2.pcs", "two"), ("Sub/Pro3.pcs", "three")] {
            fs::write(files.join(name), text).unwrap();
        }
        let sizes = Sizes { i: 20, f: 1, d: 1, v: 1, p: 1, j: 1, t: 1, s: 1, io: 32 };
        let controller = Controller::new(Config { sizes, files: Some(files.clone()), ..config });
        let served = Served::of(Hooked::new(controller), Limits::default());
        let address = format!("tcp:{}", served.tcp);
        Self { served, address, folder, files }
    }

    fn path(&self, name: &str) -> String {
        self.folder.path().join(name).to_str().unwrap().to_owned()
    }

    fn run(&self, args: &[&str]) -> Run {
        bcap(&[args, &["--robot", &self.address]].concat())
    }

    #[track_caller]
    fn dump(&self, name: &str) -> String {
        let path = self.path(name);
        let run = self.run(&["dump", &path]);
        assert_eq!((run.code, run.err.as_str()), (0, ""), "{run:?}");
        path
    }

    fn hook(&self, hook: impl FnMut(&Request<'_>) -> Option<HResult> + Send + 'static) {
        self.served.application().set(hook);
    }

    /// Refuses a function from now on.
    fn refuse(&self, function: FunctionId, code: HResult) {
        self.hook(move |request| (request.function == function).then_some(code));
    }

    fn set_i(&self, index: u32, number: i32) {
        self.served.application().inner.set_variable(Kind::I, index, &Variant::I4(number)).unwrap();
    }

    fn read(&self, name: &str) -> String {
        fs::read_to_string(self.folder.path().join(name)).unwrap_or_else(|error| panic!("{name}: {error}"))
    }
}

/// Returns a folder with the name of a backup in it.
fn new_folder() -> (tempfile::TempDir, String) {
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path().join("a").to_str().unwrap().to_owned();
    (folder, dir)
}

#[test]
fn a_restore_to_a_controller_that_cannot_be_read_completely_writes_nothing() {
    let cell = Cell::start();
    let dir = cell.dump("a");
    let refused = |part: &str| {
        for how in ["--yes", "--dry-run"] {
            let run = cell.run(&["restore", how, &dir]);
            assert!(run.code == 1 && run.out.is_empty() && run.err.contains("Nothing was written"), "{part}: {run:?}");
            let first = format!("the controller could not be read completely: {part}");
            assert!(run.err.contains(&first) && run.err.contains("over UDP, use TCP"), "{part}: {run:?}");
        }
    };
    cell.refuse(FunctionId::CONTROLLER_GET_FILE_NAMES, HResult::E_TOO_MUCH_DATA);
    refused("/: Controller_GetFileNames");
    cell.refuse(FunctionId::FILE_GET_FILE_NAMES, HResult::E_NOTIMPL);
    refused("/Sub: File_GetFileNames");
    cell.refuse(FunctionId::FILE_GET_VALUE, HResult::E_ACCESSDENIED);
    refused("/Pro1.pcs: File_GetValue");
    cell.hook(|request| {
        let is_length = request.value(1).as_bstr().is_some_and(|name| name == "@VAR_D_LEN");
        (request.function == FunctionId::CONTROLLER_GET_VARIABLE && is_length).then_some(HResult::E_FAIL)
    });
    refused("@VAR_D_LEN: Controller_GetVariable");
    // variables that the backup does not have cannot be overwritten
    cell.hook(|_| None);
    fs::write(cell.files.join("new.pcs"), "new").unwrap();
    cell.set_i(5, 7);
    cell.hook(|request| {
        let is_new = request.value(1).as_bstr().is_some_and(|name| name == "new.pcs");
        (request.function == FunctionId::CONTROLLER_GET_FILE && is_new).then_some(HResult::E_ACCESSDENIED)
    });
    let run = cell.run(&["restore", "--dry-run", &dir]);
    assert!(run.code == 0 && run.out.starts_with("I5: 7 -> 0\n"), "{run:?}");
}

#[test]
fn a_refused_folder_does_not_hide_the_others() {
    let cell = Cell::start();
    cell.refuse(FunctionId::FILE_GET_FILE_NAMES, HResult::E_NOTIMPL);
    let dir = cell.path("a");
    let run = cell.run(&["dump", &dir]);
    assert!(run.code == 1 && run.err.contains("the controller refused 1 parts"), "{run:?}");
    assert!(run.out.contains(" and 2 files of RC8"), "{run:?}");
    assert!(cell.read("a/backup.json").contains("/Sub: File_GetFileNames: 0x80004001 (E_NOTIMPL)"));
    assert_eq!([cell.read("a/files/Pro1.pcs"), cell.read("a/files/Pro2.pcs")], ["one", "two"]);
    // only a controller that does not list its root has no files
    cell.refuse(FunctionId::CONTROLLER_GET_FILE_NAMES, HResult::E_NOTIMPL);
    let run = cell.run(&["dump", &cell.path("b")]);
    assert!(run.code == 0 && run.out.contains(" and 0 files of RC8"), "{run:?}");
}

#[test]
fn what_is_omitted_is_not_a_difference() {
    let cell = Cell::start();
    let dir = cell.dump("a");
    let full = Fake::tcp(|request| match request.function() {
        FunctionId::SERVICE_START => HResult::E_MAX_CONNECT.into(),
        _ => usual(request),
    });
    let run = bcap(&["diff", &dir, "--robot", &full.address]);
    assert!(run.code == 2 && run.err.contains("E_MAX_CONNECT"), "{run:?}");
    let run = bcap(&["diff", &dir, "--json", "--robot", &full.address]);
    assert!(run.code == 2 && run.out.contains("\"hresult\":\"E_MAX_CONNECT\""), "{run:?}");

    cell.refuse(FunctionId::FILE_GET_FILE_NAMES, HResult::E_NOTIMPL);
    let not_compared = "not compared: /Sub: File_GetFileNames: 0x80004001 (E_NOTIMPL), in the second\n";
    let run = cell.run(&["diff", &dir]);
    assert_eq!((run.code, run.out.as_str()), (2, not_compared), "{run:?}");
    assert!(run.err.contains("no difference in what could be compared, and 1 parts could not"), "{run:?}");
    cell.set_i(5, 7);
    let run = cell.run(&["diff", &dir]);
    assert_eq!((run.code, run.out.as_str()), (1, format!("I5: 0 -> 7\n{not_compared}").as_str()), "{run:?}");
    let run = cell.run(&["diff", "--json", "robot:", &dir]);
    let line = "{\"not_compared\":\"/Sub: File_GetFileNames: 0x80004001 (E_NOTIMPL)\",\"side\":\"a\"}\n";
    assert!(run.code == 1 && run.out.ends_with(line) && run.out.lines().count() == 2, "{run:?}");

    let refused = cell.path("b");
    assert_eq!(cell.run(&["dump", &refused]).code, 1);
    cell.hook(|_| None);
    let run = cell.run(&["diff", &refused]);
    assert!(run.code == 2 && run.out.contains("(E_NOTIMPL), in the first\n"), "{run:?}");
}

/// Returns a controller with 100 variables of kind I, whose `I*` returns I0 whatever PutID said.
fn without_put_id(values: fn(i32) -> i32) -> Fake {
    Fake::tcp(move |request| {
        let text = |n: usize| request.args.get(n).and_then(|name| name.as_bstr()).map(|name| name.to_string());
        let handle = request.args.get(0).and_then(|handle| handle.as_i32()).unwrap_or_default();
        match request.function() {
            FunctionId::CONTROLLER_GET_VARIABLE => match text(1).unwrap().as_str() {
                "@VAR_I_LEN" => value(50),
                "I*" => value(60),
                name => match name.strip_prefix('I').and_then(|index| index.parse::<i32>().ok()) {
                    Some(index) => value(100 + index),
                    None => HResult::E_CAO_OBJECT_NOTFOUND.into(),
                },
            },
            FunctionId::VARIABLE_GET_VALUE if handle == 50 => value(100),
            FunctionId::VARIABLE_GET_VALUE if handle == 60 => value(values(0)),
            FunctionId::VARIABLE_GET_VALUE => value(values(handle - 100)),
            FunctionId::CONTROLLER_GET_FILE_NAMES | FunctionId::CONTROLLER_GET_VARIABLE_NAMES => {
                HResult::E_NOTIMPL.into()
            }
            _ => usual(request),
        }
    })
}

#[test]
fn a_put_id_without_effect_leaves_no_wrong_value() {
    // the samples agree with `I*`, or only one sample differs
    let all: [fn(i32) -> i32; 5] = [
        |n| if (40..60).contains(&n) { n } else { 0 },
        |n| i32::from(n == 99),
        |n| if n < 90 { n % 2 } else { 0 },
        |n| if n == 13 { 5 } else { 0 },
        |n| if n > 92 && n < 98 { 5 } else { 0 },
    ];
    for values in all {
        let fake = without_put_id(values);
        let (folder, dir) = new_folder();
        bcap(&["dump", &dir, "--robot", &fake.address]);
        let text = fs::read_to_string(folder.path().join("a/variables/I.jsonl")).unwrap();
        let expected: String =
            (0..100).map(|n| format!("{{\"name\":\"I{n}\",\"vt\":3,\"v\":{}}}\n", values(n))).collect();
        assert_eq!(text, expected);
    }
}

#[test]
fn a_file_that_changes_after_the_plan_is_not_overwritten() {
    let cell = Cell::start();
    let dir = cell.dump("a");
    for (changed, message) in [("Pro1.pcs", "file:Pro1.pcs"), ("Pro2.pcs", "file:Pro2.pcs")] {
        cell.hook(|_| None);
        // Pro1 is replaced by the restore, Pro2 is new to it
        fs::write(cell.files.join("Pro1.pcs"), "changed").unwrap();
        let _ = fs::remove_file(cell.files.join("Pro2.pcs"));
        cell.set_i(5, 7);
        let file = cell.files.join(changed);
        cell.hook(move |request| {
            if request.function == FunctionId::VARIABLE_PUT_VALUE {
                fs::write(&file, "by another program").unwrap();
            }
            None
        });
        let run = cell.run(&["restore", "--yes", &dir]);
        assert!(run.code == 1 && run.err.contains(message) && run.err.contains("another program"), "{run:?}");
        assert!(!run.out.contains("may be written"), "{run:?}");
        assert_eq!(fs::read_to_string(cell.files.join(changed)).unwrap(), "by another program");
    }
}

#[test]
fn a_replaced_file_is_saved() {
    let cell = Cell::start();
    let dir = cell.dump("a");
    for text in ["first", "second"] {
        fs::write(cell.files.join("Sub/Pro3.pcs"), text).unwrap();
        let run = cell.run(&["restore", "--yes", &dir]);
        assert_eq!((run.code, run.err.as_str()), (0, ""), "{run:?}");
        assert_eq!(fs::read_to_string(cell.files.join("Sub/Pro3.pcs")).unwrap(), "three");
        let journal = cell.read("a/restore.jsonl");
        let line = journal.lines().rfind(|line| line.starts_with("{\"writing\"")).unwrap();
        let line: serde_json::Value = serde_json::from_str(line).unwrap();
        assert_eq!(line["was"]["size"], text.len());
        let saved = line["was"]["saved"].as_str().unwrap();
        assert!(saved.starts_with("replaced/") && saved.ends_with("/Sub/Pro3.pcs"), "{saved}");
        assert_eq!(cell.read(&format!("a/{saved}")), text);
    }
    // the saved files are not part of the backup
    assert_eq!(cell.run(&["diff", &dir]).code, 0);
}

#[test]
fn an_unknown_serial_number_is_not_that_of_the_same_controller() {
    let cell = Cell::with(Config { serial_number: String::new(), ..Config::new(Profile::Rc8) });
    let dir = cell.dump("a");
    cell.set_i(5, 7);
    let run = cell.run(&["restore", "--yes", &dir]);
    assert!(run.code == 1 && run.err.contains("give --other-controller"), "{run:?}");
    assert!(run.err.contains("RC8 with unknown serial number"), "{run:?}");
    let run = cell.run(&["restore", "--yes", "--other-controller", &dir]);
    assert!(run.code == 0 && run.out.ends_with("is complete; 1 of 1 are written\n"), "{run:?}");
}

#[test]
fn a_serial_number_can_be_an_integer() {
    let fake = Fake::tcp(|request| {
        let name = request.args.get(1).and_then(|name| name.as_bstr()).map(|name| name.to_string());
        match request.function() {
            FunctionId::CONTROLLER_GET_VARIABLE if name.as_deref() == Some("@SERIAL_NO") => value(77),
            FunctionId::VARIABLE_GET_VALUE if request.args.get(0).and_then(|n| n.as_i32()) == Some(77) => value(4711),
            FunctionId::VARIABLE_GET_VALUE => value(0),
            FunctionId::CONTROLLER_GET_FILE_NAMES | FunctionId::CONTROLLER_GET_VARIABLE_NAMES => {
                HResult::E_NOTIMPL.into()
            }
            _ => usual(request),
        }
    });
    let (folder, dir) = new_folder();
    bcap(&["dump", &dir, "--robot", &fake.address]);
    let manifest = fs::read_to_string(folder.path().join("a/backup.json")).unwrap();
    assert!(manifest.contains("\"serial\": \"4711\""), "{manifest}");
}

#[test]
fn a_file_of_a_backup_has_the_size_of_the_dump() {
    let cell = Cell::start();
    let dir = cell.dump("a");
    let damaged = |part: &str| {
        let run = cell.run(&["restore", "--yes", &dir]);
        assert!(run.code == 2 && run.err.contains("the backup is damaged") && run.err.contains(part), "{run:?}");
    };
    let file = cell.folder.path().join("a/files/Sub/Pro3.pcs");
    fs::write(&file, "thr").unwrap();
    damaged("files/Sub/Pro3.pcs has 3 bytes, backup.json says 5");
    fs::rename(&file, cell.folder.path().join("a/files/Pro4.pcs")).unwrap();
    damaged("files/Pro4.pcs is not in backup.json");
    fs::remove_file(cell.folder.path().join("a/files/Pro4.pcs")).unwrap();
    damaged("files/Sub/Pro3.pcs is missing");
}

#[test]
fn a_bad_name_or_value_of_a_file_does_not_end_the_dump() {
    let fake = Fake::tcp(|request| {
        let name = request.args.get(1).and_then(|name| name.as_bstr()).map(|name| name.to_string());
        match request.function() {
            FunctionId::CONTROLLER_GET_FILE_NAMES => {
                value(["../x", "Pro1.pcs", "Pro2.pcs"].map(str::to_owned).to_vec())
            }
            FunctionId::CONTROLLER_GET_FILE if name.as_deref() == Some("Pro1.pcs") => value(5),
            FunctionId::CONTROLLER_GET_FILE => value(6),
            FunctionId::FILE_GET_VALUE if request.args.get(0).and_then(|n| n.as_i32()) == Some(5) => value(1.5),
            FunctionId::FILE_GET_VALUE => value("two".to_owned()),
            FunctionId::VARIABLE_GET_VALUE => value(0),
            FunctionId::CONTROLLER_GET_VARIABLE_NAMES => HResult::E_NOTIMPL.into(),
            _ => usual(request),
        }
    });
    let (folder, dir) = new_folder();
    let run = bcap(&["dump", &dir, "--robot", &fake.address]);
    assert!(run.code == 1 && run.err.contains("the controller refused 2 parts"), "{run:?}");
    let manifest = fs::read_to_string(folder.path().join("a/backup.json")).unwrap();
    for part in ["unsafe names, which were not copied: \\\"/../x\\\"", "/Pro1.pcs: the reply carries"] {
        assert!(manifest.contains(part), "{part}: {manifest}");
    }
    assert_eq!(fs::read_to_string(folder.path().join("a/files/Pro2.pcs")).unwrap(), "two");
}
