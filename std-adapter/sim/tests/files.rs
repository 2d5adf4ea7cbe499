//! Files over the handler of b-CAP, below a temporary folder.

use std::fs;
use std::sync::{Arc, Mutex};

use bcap_core::bcap::call::{self, FileHandle};
use bcap_core::handler::Outcome;
use bcap_core::hresult::HResult;
use bcap_core::variant::{OleDate, Variant};
use bcap_sim::files::{Executor, Job, write_sources};
use bcap_sim::{Config, Permission, TaskStatus};
use tempfile::TempDir;

use crate::common;
use crate::common::{Client, Reply, World, code, ok};

struct Rig {
    world: World,
    client: Client,
    folder: TempDir,
}

impl Rig {
    /// A controller with `a.pcs` and `Sub\b.txt`.
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        fs::write(folder.path().join("a.pcs"), "Sub Main\n").unwrap();
        fs::create_dir(folder.path().join("Sub")).unwrap();
        fs::write(folder.path().join("Sub/b.txt"), "b").unwrap();
        let mut world = World::with(Config { files: Some(folder.path().into()), ..Config::default() });
        let client = world.client(1);
        Self { world, client, folder }
    }

    fn get(&mut self, name: &str, option: &str) -> Reply {
        self.world.call(self.client.peer, call::controller_get_file(self.client.controller, name, option))
    }

    fn open(&mut self, name: &str) -> FileHandle {
        match self.get(name, "") {
            (HResult::S_OK, value) => match value.as_variant() {
                Variant::I4(handle) => FileHandle(handle),
                other => panic!("{other:?}"),
            },
            (refused, _) => panic!("{name}: {refused}"),
        }
    }

    fn call(&mut self, call: impl call::Call) -> Reply {
        self.world.call(self.client.peer, call)
    }

    fn names(&mut self) -> Reply {
        self.call(call::controller_get_file_names(self.client.controller, ""))
    }

    fn on_disk(&self, name: &str) -> Option<String> {
        fs::read_to_string(self.folder.path().join(name)).ok()
    }
}

#[test]
fn files_are_listed_read_and_written() {
    let mut rig = Rig::new();
    assert_eq!(rig.names(), ok(&["Sub\\", "a.pcs"]));
    let file = rig.open("a.pcs");
    assert_eq!(rig.call(call::file_get_value(file)), ok(&"Sub Main\n"));
    assert_eq!(rig.call(call::file_put_value(file, "End Sub é\n")), code(HResult::S_OK));
    assert_eq!(rig.on_disk("a.pcs").as_deref(), Some("End Sub é\n"));
    assert_eq!(rig.call(call::file_get_size(file)), ok(&11));
    assert_eq!(rig.call(call::file_get_type(file)), ok(&"pcs"));
    assert_eq!(rig.call(call::file_get_path(file)), ok(&"\\"));
    assert_eq!(rig.call(call::file_get_name(file)), ok(&"a.pcs"));
    // bytes that are not text
    assert_eq!(rig.call(call::file_put_value(file, [0xff_u8, 0])), code(HResult::S_OK));
    assert_eq!(rig.call(call::file_get_value(file)), ok(&[0xff_u8, 0]));
    assert_eq!(rig.call(call::file_put_value(file, 5)), code(HResult::E_INVALIDARGTYPE));
    assert_eq!(rig.call(call::file_release(file)), code(HResult::S_OK));
    assert_eq!(rig.call(call::file_get_value(file)), code(HResult::E_HANDLE));
}

#[test]
fn folders_have_files_of_their_own() {
    let mut rig = Rig::new();
    let folder = rig.open("Sub\\");
    assert_eq!(rig.call(call::file_get_file_names(folder, "")), ok(&["b.txt"]));
    assert_eq!(rig.call(call::file_get_type(folder)), ok(&"Folder"));
    assert_eq!(rig.call(call::file_get_value(folder)), code(HResult::E_INVALIDARG));
    assert_eq!(rig.call(call::file_get_size(folder)), ok(&0));
    let (result, handle) = rig.call(call::file_get_file(folder, "b.txt", ""));
    assert_eq!(result, HResult::S_OK);
    let file = FileHandle(handle.as_variant().as_i32().unwrap());
    assert_eq!(rig.call(call::file_get_value(file)), ok(&"b"));
    assert_eq!(rig.call(call::file_get_path(file)), ok(&"\\Sub\\"));
    // both separators
    let file = rig.open("/Sub/b.txt");
    assert_eq!(rig.call(call::file_get_name(file)), ok(&"Sub\\b.txt"));
    let file = rig.open("a.pcs");
    assert_eq!(rig.call(call::file_get_file_names(file, "")), code(HResult::E_CAO_OBJECT_NOTFOUND));
}

#[test]
fn what_is_not_there_is_made_on_request() {
    let mut rig = Rig::new();
    assert_eq!(rig.get("new.txt", ""), code(HResult::E_CAO_OBJECT_NOTFOUND));
    assert_eq!(rig.get("new.txt", "@Create=0"), code(HResult::E_CAO_OBJECT_NOTFOUND));
    assert_eq!(rig.get("new.txt", "@create=1").0, HResult::S_OK);
    assert_eq!(rig.get("Deep\\", "@Create=1").0, HResult::S_OK);
    assert_eq!(rig.get("Deep\\new.txt", "@Create=1").0, HResult::S_OK);
    assert_eq!(rig.get("None\\new.txt", "@Create=1"), code(HResult::E_CAO_OBJECT_NOTFOUND));
    assert_eq!(rig.names(), ok(&["Deep\\", "Sub\\", "a.pcs", "new.txt"]));
    assert_eq!(rig.on_disk("Deep/new.txt").as_deref(), Some(""));
}

#[test]
fn files_are_copied_moved_and_deleted() {
    let mut rig = Rig::new();
    let file = rig.open("a.pcs");
    assert_eq!(rig.call(call::file_copy(file, "c.pcs", "")), code(HResult::S_OK));
    assert_eq!(rig.call(call::file_copy(file, "Sub\\", "")), code(HResult::S_OK));
    assert_eq!(rig.on_disk("Sub/a.pcs").as_deref(), Some("Sub Main\n"));
    assert_eq!(rig.call(call::file_copy(file, "c.pcs", "")), code(HResult::E_CAO_COLLECTION_REGISTERED));
    assert_eq!(rig.call(call::file_move(file, "Sub\\d.pcs", "")), code(HResult::S_OK));
    assert_eq!(rig.call(call::file_get_path(file)), ok(&"\\Sub\\"));
    assert_eq!((rig.on_disk("a.pcs"), rig.on_disk("Sub/d.pcs").as_deref()), (None, Some("Sub Main\n")));
    let folder = rig.open("Sub");
    assert_eq!(rig.call(call::file_delete(folder, "")), code(HResult::E_ACCESSDENIED), "it is not empty");
    assert_eq!(rig.call(call::file_delete(file, "")), code(HResult::S_OK));
    assert_eq!(rig.call(call::file_get_value(file)), code(HResult::E_CAO_OBJECT_NOTFOUND));
    assert_eq!(rig.names(), ok(&["Sub\\", "c.pcs"]));
}

#[test]
fn dates_are_those_of_the_file() {
    let mut rig = Rig::new();
    let file = rig.open("a.pcs");
    let modified = fs::metadata(rig.folder.path().join("a.pcs")).unwrap().modified().unwrap();
    let millis = modified.duration_since(std::time::UNIX_EPOCH).unwrap().as_millis();
    let expected = OleDate::from_unix_millis(i64::try_from(millis).unwrap()).unwrap();
    assert_eq!(rig.call(call::file_get_date_last_modified(file)), ok(&expected));
    for (result, date) in
        [rig.call(call::file_get_date_created(file)), rig.call(call::file_get_date_last_accessed(file))]
    {
        assert!(result == HResult::S_OK && matches!(date.as_variant(), Variant::Date(_)));
    }
}

#[test]
fn nothing_leads_out_of_the_root() {
    let mut rig = Rig::new();
    let outside = tempfile::tempdir().unwrap();
    fs::write(outside.path().join("secret"), "x").unwrap();
    for name in ["..", "..\\x", "Sub\\..\\..\\x", "/../x"] {
        assert_eq!(rig.get(name, "@Create=1"), code(HResult::E_ACCESSDENIED), "{name}");
    }
    for name in ["C:\\x", "a*", "a\u{0}b", "a\nb"] {
        assert_eq!(rig.get(name, "@Create=1"), code(HResult::E_INVALIDARG), "{name}");
    }
    for root in ["", "\\", " / "] {
        assert_eq!(rig.get(root, ""), code(HResult::E_INVALIDARG), "{root:?}");
    }
    let file = rig.open("a.pcs");
    assert_eq!(rig.call(call::file_copy(file, "..\\x", "")), code(HResult::E_ACCESSDENIED));
    assert_eq!(rig.call(call::file_move(file, "", "")), code(HResult::E_INVALIDARG));
    #[cfg(unix)]
    {
        std::os::unix::fs::symlink(outside.path(), rig.folder.path().join("out")).unwrap();
        std::os::unix::fs::symlink(outside.path().join("new"), rig.folder.path().join("dangling")).unwrap();
        for name in ["out", "out\\secret", "out\\new", "dangling"] {
            assert_eq!(rig.get(name, "@Create=1"), code(HResult::E_ACCESSDENIED), "{name}");
        }
    }
    assert_eq!(fs::read_dir(outside.path()).unwrap().count(), 1);
}

#[test]
fn reading_alone_is_permitted_without_permission_to_write() {
    let mut rig = Rig::new();
    rig.world.sim.set_permission(Permission::ReadOnly);
    let file = rig.open("a.pcs");
    assert_eq!(rig.call(call::file_get_value(file)), ok(&"Sub Main\n"));
    let refused = code(HResult::E_CAO_NOT_WRITABLE);
    assert_eq!(rig.call(call::file_put_value(file, "x")), refused);
    assert_eq!(rig.call(call::file_copy(file, "x", "")), refused);
    assert_eq!(rig.call(call::file_move(file, "x", "")), refused);
    assert_eq!(rig.call(call::file_delete(file, "")), refused);
    assert_eq!(rig.get("new.txt", "@Create=1"), refused);
    assert_eq!(rig.on_disk("a.pcs").as_deref(), Some("Sub Main\n"));
}

#[test]
fn the_attribute_tells_folders_and_what_cannot_be_written() {
    let mut rig = Rig::new();
    let (file, folder) = (rig.open("a.pcs"), rig.open("Sub"));
    assert_eq!(rig.call(call::file_get_attribute(file)), ok(&0));
    assert_eq!(rig.call(call::file_get_attribute(folder)), ok(&16));
    let path = rig.folder.path().join("a.pcs");
    let mut permissions = fs::metadata(&path).unwrap().permissions();
    permissions.set_readonly(true);
    fs::set_permissions(&path, permissions).unwrap();
    assert_eq!(rig.call(call::file_get_attribute(file)), ok(&1));
}

#[test]
fn paths_have_no_more_than_32_parts() {
    let mut rig = Rig::new();
    let path = |parts| vec!["a"; parts].join("/");
    assert_eq!(rig.get(&path(32), ""), code(HResult::E_CAO_OBJECT_NOTFOUND));
    assert_eq!(rig.get(&path(33), ""), code(HResult::E_INVALIDARG));
    assert_eq!(rig.get(&"./".repeat(40_000), ""), code(HResult::E_INVALIDARG), "the root itself");
}

#[cfg(unix)]
#[test]
fn a_fifo_and_a_device_block_nothing() {
    use rustix::fs::{CWD, Mode, mkfifoat};
    let mut rig = Rig::new();
    let refused = code(HResult::E_ACCESSDENIED);
    mkfifoat(CWD, rig.folder.path().join("fifo"), Mode::RUSR | Mode::WUSR).unwrap();
    mkfifoat(CWD, rig.folder.path().join("Sub/fifo"), Mode::RUSR | Mode::WUSR).unwrap();
    std::os::unix::net::UnixListener::bind(rig.folder.path().join("socket")).unwrap();
    std::os::unix::fs::symlink("fifo", rig.folder.path().join("link")).unwrap();
    std::os::unix::fs::symlink("/dev/zero", rig.folder.path().join("zero")).unwrap();
    for name in ["fifo", "Sub\\fifo", "socket", "link", "zero"] {
        assert_eq!(rig.get(name, ""), refused, "{name}");
        assert_eq!(rig.get(name, "@Create=1"), refused, "{name}");
    }
    assert_eq!(rig.names(), ok(&["Sub\\", "a.pcs"]));
    let folder = rig.open("Sub");
    assert_eq!(rig.call(call::file_get_file_names(folder, "")), ok(&["b.txt"]));

    // one that takes the place of an open file
    let file = rig.open("a.pcs");
    let path = rig.folder.path().join("a.pcs");
    fs::remove_file(&path).unwrap();
    mkfifoat(CWD, &path, Mode::RUSR | Mode::WUSR).unwrap();
    assert_eq!(rig.call(call::file_get_value(file)), refused);
    assert_eq!(rig.call(call::file_put_value(file, "x")), refused);
    assert_eq!(rig.call(call::file_copy(file, "c.pcs", "")), refused);
    assert_eq!(rig.call(call::file_move(file, "c.pcs", "")), refused);
    assert_eq!(rig.call(call::file_delete(file, "")), refused);
    assert_eq!(rig.call(call::file_get_size(file)), refused);
}

/// Jobs that run when the test says so.
type Queue = Arc<Mutex<Vec<Job>>>;

fn queued() -> (Rig, Queue) {
    let queue = Queue::default();
    let jobs = Arc::clone(&queue);
    let folder = Rig::new().folder;
    let file_executor = Executor::new(move |job| jobs.lock().unwrap().push(job));
    let mut world = World::with(Config { files: Some(folder.path().into()), file_executor, ..Config::default() });
    let client = world.client(1);
    (Rig { world, client, folder }, queue)
}

fn run_all(queue: &Queue) {
    let jobs: Vec<Job> = queue.lock().unwrap().drain(..).collect();
    jobs.into_iter().for_each(|job| job());
}

#[test]
fn while_file_work_takes_its_time_other_clients_are_served() {
    let (mut rig, queue) = queued();
    let (peer, open) = (rig.client.peer, call::controller_get_file(rig.client.controller, "a.pcs", ""));
    rig.world.begin(peer, &open);
    let other = rig.world.client(2);
    assert_eq!(rig.world.put(other, "I1", 5), HResult::S_OK);
    assert_eq!(rig.world.rac("GET:RC8:1:I:"), ok(&5));
    assert!(matches!(rig.world.again(peer, &open).0, Outcome::Wait(_)));
    run_all(&queue);
    let (outcome, handle) = rig.world.again(peer, &open);
    assert_eq!(outcome, Outcome::Done(HResult::S_OK));
    let file = FileHandle(handle.as_variant().as_i32().unwrap());
    let read = call::file_get_value(file);
    rig.world.begin(peer, &read);
    run_all(&queue);
    assert_eq!(rig.world.again(peer, &read), (Outcome::Done(HResult::S_OK), common::value("Sub Main\n")));
    let moved = call::file_move(file, "c.pcs", "");
    rig.world.begin(peer, &moved);
    run_all(&queue);
    assert_eq!(rig.world.again(peer, &moved).0, Outcome::Done(HResult::S_OK));
    assert_eq!(rig.call(call::file_get_name(file)), ok(&"c.pcs"));
    assert_eq!(rig.on_disk("c.pcs").as_deref(), Some("Sub Main\n"));
}

#[test]
fn file_work_that_is_dropped_or_that_no_client_waits_for_changes_nothing() {
    let (mut rig, queue) = queued();
    let (peer, open) = (rig.client.peer, call::controller_get_file(rig.client.controller, "a.pcs", ""));
    rig.world.begin(peer, &open);
    queue.lock().unwrap().clear();
    assert_eq!(rig.world.again(peer, &open).0, Outcome::Done(HResult::E_BUSY_PROC));

    // a client that leaves
    rig.world.begin(peer, &open);
    let open_before = rig.world.sim.open_objects();
    bcap_core::bcap::server::Handler::left(&mut rig.world.sim, peer, rig.world.now);
    run_all(&queue);
    assert_eq!(rig.world.sim.open_objects(), open_before - 2, "controller and robot are gone, no file has come");
    let again = rig.world.client(1);
    let names = call::controller_get_file_names(again.controller, "");
    rig.world.begin(again.peer, &names);
    run_all(&queue);
    assert_eq!(rig.world.again(again.peer, &names), (Outcome::Done(HResult::S_OK), common::value(&["Sub\\", "a.pcs"])));
}

#[test]
fn a_file_runs_as_its_task() {
    let folder = tempfile::tempdir().unwrap();
    let mut world = World::with(Config { files: Some(folder.path().to_owned()), ..Config::default() });
    let client = world.client(1);
    let open = |world: &mut World, name: &str| {
        FileHandle(world.handle(client.peer, call::controller_get_file(client.controller, name, "@Create=1")))
    };
    let (file, other) = (open(&mut world, "pro2.pcs"), open(&mut world, "other.pcs"));
    assert_eq!(world.call(client.peer, call::file_run(file, "")), ok("Pro2"));
    assert_eq!(world.sim.task("Pro2").map(|task| task.0), Some(TaskStatus::Running));
    assert_eq!(world.call(client.peer, call::file_run(file, "")).0, HResult::E_CAO_CMD_EXECUTE);
    assert_eq!(world.call(client.peer, call::file_run(other, "")).0, HResult::E_CAO_OBJECT_NOTFOUND);
    assert_eq!(world.call(client.peer, call::file_execute(file, "Open", ())).0, HResult::E_INVALID_CMD_NAME);
    assert_eq!(world.call(client.peer, call::file_get_variable(file, "Size", "")).0, HResult::E_CAO_OBJECT_NOTFOUND);
    world.pass(5000);
    assert_eq!(world.sim.task("Pro2"), Some((TaskStatus::Ready, 1)));
}

#[test]
fn a_file_runs_only_with_permission_to_write() {
    let mut rig = Rig::new();
    write_sources(rig.folder.path(), ["Pro1"]).unwrap();
    let file = rig.open("Pro1.pcs");
    for permission in [Permission::ReadOnly, Permission::None] {
        rig.world.sim.set_permission(permission);
        assert_eq!(rig.call(call::file_run(file, "")), code(HResult::E_ACCESSDENIED), "{permission:?}");
        assert_eq!(rig.world.sim.task("Pro1"), Some((TaskStatus::Ready, 0)), "{permission:?}");
    }
    rig.world.sim.set_permission(Permission::ReadWrite);
    assert_eq!(rig.call(call::file_run(file, "")), ok("Pro1"));
}

#[test]
fn each_task_has_a_source_file_below_the_folder() {
    let mut rig = Rig::new();
    write_sources(rig.folder.path(), ["Pro1", "a", "Sub/Serve", "../out", "b?"]).unwrap();
    assert_eq!(rig.names(), ok(&["Pro1.pcs", "Sub\\", "a.pcs"]));
    let file = rig.open("Sub\\Serve.pcs");
    assert_eq!(rig.call(call::file_get_value(file)), ok(&"'!TITLE \"Sub/Serve\"\r\nSub Main\r\nEnd Sub\r\n"));
    assert_eq!(rig.on_disk("a.pcs").as_deref(), Some("Sub Main\n"), "a file that exists stays");
    assert!(!rig.folder.path().with_file_name("out.pcs").exists());
}
