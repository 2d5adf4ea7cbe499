//! The screen of backups: dump, difference, plan, restore.

use std::net::SocketAddr;
use std::path::Path;

use bcap_core::rac::VariableKind;
use bcap_core::variant::Variant;
use bcap_sim::Scenario;
use bcap_std::Settings;
use bcap_std::blocking::Controller;
use serde_json::{Value, json};

use crate::chromium::Browser;
use crate::support::{Page, Sim, Web, until};

fn serve(address: SocketAddr, folder: &Path, allow_write: bool) -> Web {
    let folder = folder.to_owned();
    let backups = move |config: &mut bcap_web::Config| {
        config.allow_motion = false;
        config.backups = Some(folder.clone());
    };
    Web::with(&backups, &[("press", address)], allow_write)
}

fn opened(web: &Web) -> Page {
    let mut page = web.page();
    page.until_state("ready, motor off");
    page.order("show", json!({ "robot": 0, "screen": "backup" })).unwrap();
    page
}

/// Does a work, and returns its outcome.
#[track_caller]
fn work(page: &mut Page, work: Value) -> Value {
    let name = work["work"].clone();
    page.order("work", json!({ "robot": 0, "work": work })).unwrap();
    ended(page, &name)
}

#[track_caller]
fn ended(page: &mut Page, name: &Value) -> Value {
    page.until("backup", |job| job["work"] == *name && job["running"] == false)
}

fn value(sim: &Sim, index: u32) -> i32 {
    sim.lock().variable::<16>(VariableKind::I, index).unwrap().as_variant().as_i32().unwrap()
}

#[test]
fn a_backup_is_made_compared_and_restored_by_the_page_that_planned_it() {
    let (sim, folder) = (Sim::start(), tempfile::tempdir().unwrap());
    sim.lock().set_variable(VariableKind::I, 5, &Variant::I4(7)).unwrap();
    let web = serve(sim.address(), folder.path(), true);
    // the server closes a page that does not read for 10 s, so each is opened for its work
    let mut anna = opened(&web);
    assert_eq!(anna.order("backups", json!({})), Ok(json!([])));
    let dumped = work(&mut anna, json!({ "work": "dump", "folder": "monday" }));
    assert!(dumped["outcome"].as_str().unwrap().starts_with("saved: "), "{dumped}");
    assert_eq!(anna.order("backups", json!({})), Ok(json!([["monday", null]])));
    sim.lock().set_variable(VariableKind::I, 5, &Variant::I4(8)).unwrap();
    let mut bob = opened(&web);
    let found = work(&mut bob, json!({ "work": "diff", "folder": "monday", "with": null }));
    assert_eq!(found["lines"], json!(["I5: 7 -> 8"]), "{found}");
    let mut anna = opened(&web);
    let restore = json!({ "robot": 0, "name": "press", "folder": "monday" });
    assert_eq!(anna.order("restore", restore.clone()).unwrap_err(), "take the control first");
    anna.order("take", json!({ "robot": 0, "name": "Anna" })).unwrap();
    assert_eq!(anna.order("restore", restore.clone()).unwrap_err(), "plan the restore first");
    let plan = json!({ "work": "plan", "folder": "monday", "io": false });
    bob.order("work", json!({ "robot": 0, "work": plan })).unwrap();
    ended(&mut anna, &json!("plan"));
    assert_eq!(
        anna.order("restore", restore.clone()).unwrap_err(),
        "plan the restore first",
        "Bob's plan is not Anna's"
    );
    work(&mut anna, plan);
    // the end of Bob's plan looks the same
    let plan = anna.until("backup", |job| job["can_restore"] == true && job["running"] == false);
    assert_eq!((&plan["lines"], &plan["outcome"]), (&json!(["I5: 8 -> 7"]), &json!("1 writes are planned")));
    let wrong = anna.order("restore", json!({ "robot": 0, "name": "welder", "folder": "monday" })).unwrap_err();
    assert_eq!(wrong, "welder is not the name of this robot; nothing was done");
    let late = json!({ "robot": 0, "name": "press", "folder": "monday", "revoked": 99 });
    assert!(anna.order("restore", late).unwrap_err().contains("HALT was pressed"), "the user agreed before a HALT");
    assert_eq!(value(&sim, 5), 8);
    anna.order("restore", restore.clone()).unwrap();
    let restored = ended(&mut anna, &json!("restore"));
    assert!(restored["failed"] == false && value(&sim, 5) == 7, "{restored}");
    assert!(anna.order("restore", restore).is_err(), "a plan is written once");
    let lines = web.lines().join("\n");
    for line in ["press: a page: dumps to monday: done", "press: Anna: restores monday: done"] {
        assert!(lines.contains(line), "{lines}");
    }
}

#[test]
fn a_comparison_says_what_it_could_not_compare() {
    let (sim, folder) = (Sim::start(), tempfile::tempdir().unwrap());
    let web = serve(sim.address(), folder.path(), false);
    let mut page = opened(&web);
    work(&mut page, json!({ "work": "dump", "folder": "monday" }));
    let refused =
        "[[fault]]\nwhen = { every = 1, of = \"Controller_GetFileNames\" }\nthen = { refuse = \"E_ACCESSDENIED\" }\n";
    sim.lock().play(Scenario::parse(refused).unwrap());
    let found = work(&mut page, json!({ "work": "diff", "folder": "monday", "with": null }));
    assert_eq!(found["outcome"], "no differences in what could be compared; parts not compared: 1", "{found}");
    let note = found["notes"][0].as_str().unwrap();
    assert!(note.starts_with("not compared: ") && note.ends_with(", in the other side"), "{note}");
}

/// A controller that changes after the plan stops the restore, and the next plan has the rest.
#[test]
fn a_restore_that_stops_goes_on_with_the_next_plan() {
    let (sim, folder) = (Sim::start(), tempfile::tempdir().unwrap());
    let set = |index, number| sim.lock().set_variable(VariableKind::I, index, &Variant::I4(number)).unwrap();
    let web = serve(sim.address(), folder.path(), true);
    let mut page = opened(&web);
    work(&mut page, json!({ "work": "dump", "folder": "monday" }));
    for index in [1, 2, 3] {
        set(index, 9);
    }
    page.order("take", json!({ "robot": 0, "name": "Anna" })).unwrap();
    work(&mut page, json!({ "work": "plan", "folder": "monday", "io": false }));
    set(2, 10);
    let restore = json!({ "robot": 0, "name": "press", "folder": "monday" });
    page.order("restore", restore.clone()).unwrap();
    let stopped = ended(&mut page, &json!("restore"));
    let outcome = stopped["outcome"].as_str().unwrap();
    assert!(
        outcome.starts_with("I2 is 10 now and was 9 in the plan")
            && outcome.ends_with("plan it again to write the rest"),
        "{outcome}"
    );
    assert_eq!([1, 2, 3].map(|index| value(&sim, index)), [0, 10, 9]);
    assert!(page.order("backups", json!({})).unwrap()[0][1].as_str().unwrap().contains("1 of 3"), "the page tells it");
    work(&mut page, json!({ "work": "plan", "folder": "monday", "io": false }));
    page.order("restore", restore).unwrap();
    page.until("backup", |job| job["work"] == "restore" && job["running"] == false && job["failed"] == false);
    assert_eq!([1, 2, 3].map(|index| value(&sim, index)), [0, 0, 0]);
}

/// The connection of the restore hangs until HALT was pressed.
#[test]
fn halt_ends_a_restore() {
    let (sim, folder) = (Sim::start(), tempfile::tempdir().unwrap());
    let relay = crate::support::Relay::start(sim.address());
    let web = serve(relay.address, folder.path(), true);
    let mut page = opened(&web);
    work(&mut page, json!({ "work": "dump", "folder": "monday" }));
    sim.lock().set_variable(VariableKind::I, 1, &Variant::I4(9)).unwrap();
    page.order("take", json!({ "robot": 0, "name": "Anna" })).unwrap();
    let attempt = |_| {
        work(&mut page, json!({ "work": "plan", "folder": "monday", "io": false }));
        relay.freeze(relay.count());
        page.order("restore", json!({ "robot": 0, "name": "press", "folder": "monday" })).unwrap();
        assert_eq!(web.halt(0)["ok"], true);
        relay.freeze(usize::MAX);
        let stopped = ended(&mut page, &json!("restore"));
        // a busy machine may let the connection hang for more than its 3 s
        (!stopped["outcome"].as_str().unwrap().contains("no reply")).then_some(stopped)
    };
    let stopped = (0..20).find_map(attempt).unwrap();
    assert!(stopped["outcome"].as_str().unwrap().contains("ended: HALT was pressed"), "{stopped}");
    assert_eq!(value(&sim, 1), 9);
}

#[test]
fn names_stay_in_the_folder_and_a_read_only_server_restores_nothing() {
    let (sim, folder) = (Sim::start(), tempfile::tempdir().unwrap());
    let web = serve(sim.address(), folder.path(), false);
    let mut page = opened(&web);
    for name in ["", ".", "..", "../etc", "a/b", "a\\b", ".hidden", "C:", "\u{202e}x", &"x".repeat(65)] {
        let refused =
            page.order("work", json!({ "robot": 0, "work": { "work": "dump", "folder": name } })).unwrap_err();
        assert!(refused.contains("a name has letters"), "{name}: {refused}");
    }
    work(&mut page, json!({ "work": "dump", "folder": "monday" }));
    work(&mut page, json!({ "work": "plan", "folder": "monday", "io": false }));
    let refused = page.order("restore", json!({ "robot": 0, "name": "press", "folder": "monday" })).unwrap_err();
    assert_eq!(refused, "this server is read-only; start it with --allow-write");
    let none = Web::start(&[("press", sim.address())], false);
    let refused = none.page().order("backups", json!({})).unwrap_err();
    assert_eq!(refused, "this server keeps no backups; start it with --backups DIR");
}

#[test]
fn a_dump_does_not_end_a_stream_of_another_client() {
    let (sim, folder) = (Sim::start(), tempfile::tempdir().unwrap());
    let web = serve(sim.address(), folder.path(), false);
    let mut page = opened(&web);
    let mut cell = Controller::connect(&format!("tcp:{}", sim.address()), &Settings::rc8()).unwrap();
    let mut arm = cell.robot().unwrap().take_arm().unwrap();
    arm.motor_on().unwrap();
    crate::support::stream(&sim, &mut arm, &mut page);
    let refused = work(&mut page, json!({ "work": "dump", "folder": "monday" }));
    assert_eq!(refused["failed"], true, "{refused}");
    assert_eq!(sim.lock().slave_mode(), 0x202);
    until("the connection of the dump is closed", || sim.lock().slave_mode() == 0x202);
}

/// Orders that wait for the disk have a time limit.
#[cfg(unix)]
#[test]
fn a_disk_that_hangs_does_not_keep_the_page_from_its_next_order() {
    let (sim, folder) = (Sim::start(), tempfile::tempdir().unwrap());
    let web = serve(sim.address(), folder.path(), true);
    let mut page = opened(&web);
    page.order("take", json!({ "robot": 0, "name": "Anna" })).unwrap();
    let (monday, journal) = (folder.path().join("monday"), folder.path().join("monday/restore.jsonl"));
    std::fs::create_dir(&monday).unwrap();
    std::fs::write(monday.join("backup.json"), "").unwrap();
    // the FIFO has no writer, so its reader waits
    assert!(std::process::Command::new("mkfifo").arg(&journal).status().unwrap().success());
    let refused = page.order("backups", json!({})).unwrap_err();
    assert_eq!(refused, "the disk has not answered for 5 s; it may still do this later");
    page.order("release", json!({ "robot": 0 })).unwrap();
    page.until("tiles", |tiles| tiles[0]["holder"].is_null());
    drop(std::fs::File::options().write(true).open(&journal).unwrap());
}

#[test]
fn the_screen_restores_after_a_question_with_the_name() {
    let (sim, folder) = (Sim::start(), tempfile::tempdir().unwrap());
    let web = serve(sim.address(), folder.path(), true);
    let Some(mut browser) = Browser::start() else { return };
    browser.open(web.url());
    browser.until_text("#state", "ready, motor off");
    browser.click("[data-id=backup]");
    browser.enter("#backup-name", "monday");
    browser.until_text("#backup-state", "dump monday: saved: ");
    browser.until_text("#backup-folder", "monday");
    sim.lock().set_variable(VariableKind::I, 5, &Variant::I4(8)).unwrap();
    browser.enter("#name", "Anna");
    browser.until_text("#control", "control: Anna (this page)");
    browser.click("#backup-plan");
    browser.until_text("#backup-lines", "I5: 8 -> 0");
    for scheme in ["light", "dark"] {
        browser.look((768, 1024), scheme);
        assert_eq!(browser.eval(include_str!("audit.js")), json!([]), "{scheme}");
    }
    browser.click("#backup-restore");
    browser.until_text("#question-robot", "press (tcp:");
    browser.until_text("#question-yes", "Restore to press");
    browser.click("#question-yes");
    browser.until_text("#backup-state", "restore monday: ");
    until("the value is restored", || value(&sim, 5) == 0);
    assert_eq!(browser.problems, [""; 0]);
}
